"""The noise of an IMU as files: noise.yaml (read back by `readers.own.noise_file`), Kalibr's imu.yaml, allan.csv."""

from math import isfinite, sqrt
from os import PathLike
from pathlib import Path
from typing import Any

from ..output import write_together, write_whole
from ..readers.own.noise_file import AXES, NOISE_SCHEMA
from ..sensor_noise import SENSOR_UNITS, UNITS, Coefficient, NoiseResult, SensorNoise, TriadNoise
from .calibration_file import finding_document, provenance_document
from .kalibr import IMU_FILE, StatedImu, stated_entry
from .kalibr_text import kalibr_yaml
from .yaml_text import yaml_lines

NOISE_FILE, ALLAN_FILE = "noise.yaml", "allan.csv"

_HEADER = """\
# Noise of an inertial sensor, made by gnomon from a recording at rest.
#
# Allan variance over the averaging time t (IEEE 952):
#
#     3 Q^2 / t^2 + N^2 / t + (2 ln 2 / pi) B^2 + K^2 t / 3 + R^2 t^2 / 2
#
# with white_noise N, bias_instability B (the floor of the Allan deviation is 0.664 B), random_walk K, quantisation Q
# and rate_ramp R, all of continuous time: N is a density, and does not depend on the sample rate. What a program needs
# that counts in samples stands apart and says so: a sample scatters by white_noise_per_sample = N sqrt(rate), and from
# one sample to the next the bias walks by random_walk_per_sample = K / sqrt(rate), the root mean squares of the axes.
# sigma is one standard deviation. `below` is an upper bound (about 97 %) of what the recording does not show. misfit is
# relative, of the Allan deviation. Times are in s, rates in Hz.
"""


def save_noise(noise: SensorNoise, path: str | PathLike[str]) -> None:
    """Write the noise of an IMU as noise.yaml.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, noise_text(noise))


def save_noise_files(result: NoiseResult, folder: str | PathLike[str]) -> tuple[Path, ...]:
    """Write noise.yaml, allan.csv and, where both sensors were recorded, Kalibr's imu.yaml into a folder that is there.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    texts = {NOISE_FILE: noise_text(result.noise), ALLAN_FILE: allan_text(result)}
    if len(result.noise.triads) == len(SENSOR_UNITS):
        texts[IMU_FILE] = imu_text(result.noise, result.topic)
    write_together(folder, texts)
    return tuple(Path(folder) / name for name in texts)


def noise_text(noise: SensorNoise) -> str:
    """Return the text of noise.yaml."""
    return _HEADER + "\n".join(yaml_lines(noise_document(noise))) + "\n"


def noise_document(noise: SensorNoise) -> dict[str, Any]:
    """Return what noise.yaml holds."""
    document: dict[str, Any] = {"schema": NOISE_SCHEMA, "verdict": noise.verdict}
    document |= {sensor: _triad(sensor, triad) for sensor, triad in noise.triads.items()}
    if isfinite(noise.t_init_s):
        document["t_init"] = noise.t_init_s
    document["findings"] = [finding_document(finding) for finding in noise.findings]
    document["provenance"] = provenance_document(noise.provenance)
    return document


def _triad(sensor: str, triad: TriadNoise) -> dict[str, Any]:
    axes = {
        name: {
            **{key: _coefficient(found) for key, found in axis.coefficients().items()},
            "fitted_from": axis.fitted_from_s,
            "misfit": axis.misfit,
        }
        for name, axis in zip(AXES, triad.axes, strict=True)
    }
    return {
        "update_rate": triad.rate_hz,
        "samples": triad.samples,
        "averaging_times": list(triad.tau_s),
        "units": {
            **UNITS[sensor],
            "white_noise_per_sample": SENSOR_UNITS[sensor],
            "random_walk_per_sample": SENSOR_UNITS[sensor],
        },
        "white_noise_per_sample": triad.noise_density * sqrt(triad.rate_hz),
        "random_walk_per_sample": triad.random_walk / sqrt(triad.rate_hz),
        "axes": axes,
    }


def _coefficient(found: Coefficient) -> dict[str, float]:
    return {"value": found.value, "sigma": found.sigma} if found.found else {"below": found.bound}


def imu_text(noise: SensorNoise, topic: str) -> str:
    """Return Kalibr's imu.yaml; both sensors must be there."""
    accelerometer, gyroscope = noise.accelerometer, noise.gyroscope
    assert accelerometer is not None
    assert gyroscope is not None
    rate_hz = gyroscope.rate_hz
    stated = StatedImu(noise=noise.imu_noise(), update_rate_hz=rate_hz, topic=topic)
    lines = [
        "Noise of an IMU in Kalibr's layout, made by gnomon from a recording at rest.",
        "Every number below is of continuous time; none of them depends on the sample rate:",
        "  accelerometer_noise_density [m/s^2/sqrt(Hz)]   accelerometer_random_walk [m/s^3/sqrt(Hz)]",
        "  gyroscope_noise_density [rad/s/sqrt(Hz)]       gyroscope_random_walk [rad/s^2/sqrt(Hz)]   update_rate [Hz]",
        "They are the root mean square of the three axes; noise.yaml has each axis, with its standard deviation.",
    ]
    for sensor, triad in noise.triads.items():
        lines += _comments(sensor, triad)
    return "".join(f"# {line}\n" for line in lines) + kalibr_yaml(stated_entry(stated))


def _comments(sensor: str, triad: TriadNoise) -> list[str]:
    """Say what numbers of the same noise look like in samples, and which of them are bounds."""
    unit = SENSOR_UNITS[sensor]
    lines = [
        f"{sensor} in samples of 1 / {triad.rate_hz:.6g} s, for programs that want that (not Kalibr): a sample",
        f"  scatters by {triad.noise_density * sqrt(triad.rate_hz):.4g} {unit}, its bias walks by "
        f"{triad.random_walk / sqrt(triad.rate_hz):.3g} {unit} from sample to sample.",
    ]
    hidden = [name for name, axis in zip(AXES, triad.axes, strict=True) if not axis.random_walk.found]
    if len(hidden) == len(AXES):
        lines.append(f"{sensor}_random_walk is an upper bound: the recording shows none.")
    elif hidden:
        lines.append(
            f"{sensor}_random_walk is that of the other axes: the recording shows none in {' and '.join(hidden)}."
        )
    return lines


def allan_text(result: NoiseResult) -> str:
    """Return a table of the Allan deviation with its interval of 95 %, and of the noise that was found."""
    rows = ["sensor,axis,tau_s,deviation,lower,upper,fitted,unit"]
    for sensor, curve in result.curves.items():
        columns = (curve.deviation, curve.lower, curve.upper, curve.fitted)
        for i, axis in enumerate(AXES):
            for k, tau in enumerate(curve.tau_s.tolist()):
                numbers = ",".join(repr(float(column[k, i])) for column in columns)
                rows.append(f"{sensor},{axis},{tau!r},{numbers},{SENSOR_UNITS[sensor]}")
    return "\n".join(rows) + "\n"
