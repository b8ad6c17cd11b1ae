"""gnomon's file of the noise of an IMU, schema "gnomon-noise/1"; written by `formats.own.noise_file`.

Data sheets of inertial sensors: those that gnomon knows, and files of the same form.
"""

from collections.abc import Mapping
from math import degrees, isfinite, sqrt
from os import PathLike
from pathlib import Path
from typing import Any, cast

from ...errors import FormatError, OptionError
from ...output import write_together, write_whole
from ...results.datasheet import QUANTITIES, Datasheet, StatedNoise, sheet_units
from ...results.sensor_noise import (
    COEFFICIENTS,
    DATASHEET_UNITS,
    SENSOR_UNITS,
    UNITS,
    AxisNoise,
    Coefficient,
    NoiseResult,
    SensorNoise,
    TriadNoise,
)
from ...results.trust import VERDICTS, Verdict
from ...units import STANDARD_GRAVITY_M_S2
from ..kalibr.imu import IMU_FILE, StatedImu, stated_entry
from ..shared.structured import Node, read_yaml
from ..shared.yaml_text import kalibr_yaml, yaml_lines
from .calibration_file import finding_entry, provenance_entry
from .calibration_text import finding_document, provenance_document

NOISE_SCHEMA = "gnomon-noise/1"
AXES = ("x", "y", "z")
_PER_SAMPLE = ("white_noise_per_sample", "random_walk_per_sample")


def load_noise(path: str | PathLike[str]) -> SensorNoise:
    """Read the noise of an IMU from gnomon's noise.yaml.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not as the schema says; the message names the key.
    """
    root = read_yaml(path)
    if not isinstance(root.value, dict) or "schema" not in root.value:
        raise FormatError(
            f"{path}: this is no noise.yaml of gnomon's (there is no key schema). Name the one that gnomon noise wrote."
        )
    if root.child("schema").text() != NOISE_SCHEMA:
        raise root.child("schema").fail(f'found "{root.child("schema").value}", expected {NOISE_SCHEMA}.')
    top = root.mapping(("schema", "verdict", "findings", "provenance"), ("accelerometer", "gyroscope", "t_init"))
    if "accelerometer" not in top and "gyroscope" not in top:
        raise root.fail("neither accelerometer nor gyroscope is in it. One of them is needed.")
    return SensorNoise(
        accelerometer=_read_triad(top["accelerometer"]) if "accelerometer" in top else None,
        gyroscope=_read_triad(top["gyroscope"]) if "gyroscope" in top else None,
        t_init_s=top["t_init"].number() if "t_init" in top else float("nan"),
        verdict=cast(Verdict, top["verdict"].text(VERDICTS)),
        findings=tuple(finding_entry(item) for item in top["findings"].items()),
        provenance=provenance_entry(top["provenance"]),
    )


def _read_triad(node: Node) -> TriadNoise:
    keys = node.mapping(("update_rate", "samples", "averaging_times", "units", "axes"), _PER_SAMPLE)
    units = keys["units"].mapping(COEFFICIENTS, _PER_SAMPLE)
    for name in COEFFICIENTS:
        units[name].text((UNITS[node.key][name],))
    rate_hz, samples = keys["update_rate"].number(), keys["samples"].integer()
    if rate_hz <= 0:
        raise keys["update_rate"].fail(f"found {rate_hz:g}, expected a rate greater than zero, in Hz.")
    if samples < 1:
        raise keys["samples"].fail(f"found {samples}, expected the number of samples.")
    first, last = keys["averaging_times"].floats(2).tolist()
    axes = keys["axes"].mapping(AXES)
    x, y, z = (_read_axis(axes[name]) for name in AXES)
    return TriadNoise(rate_hz=rate_hz, samples=samples, tau_s=(first, last), axes=(x, y, z))


def _read_axis(node: Node) -> AxisNoise:
    keys = node.mapping((*COEFFICIENTS, "fitted_from", "misfit"))
    return AxisNoise(
        **{name: _read_coefficient(keys[name]) for name in COEFFICIENTS},
        fitted_from_s=keys["fitted_from"].number(),
        misfit=keys["misfit"].number(),
    )


def _read_coefficient(node: Node) -> Coefficient:
    """Return a value with its sigma, or a bound."""
    keys = node.mapping((), ("value", "sigma", "below"))
    if set(keys) not in ({"value", "sigma"}, {"below"}):
        raise node.fail(
            f"expected value and sigma, or below where none was found; found {', '.join(keys) or 'nothing'}."
        )
    found = {key: child.number() for key, child in keys.items()}
    for key, number in found.items():
        if number <= 0:
            raise keys[key].fail(f"found {number:g}, expected a number greater than zero.")
    if "below" in found:
        return Coefficient(value=0.0, bound=found["below"])
    return Coefficient(value=found["value"], sigma=found["sigma"])


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
        texts[IMU_FILE] = kalibr_input_text(result.noise, result.topic)
    write_together(folder, texts)
    return tuple(Path(folder) / name for name in texts)


def noise_text(noise: SensorNoise) -> str:
    """Return the text of noise.yaml."""
    return _HEADER + _datasheet_comments(noise) + "\n".join(yaml_lines(noise_document(noise))) + "\n"


def _datasheet_comments(noise: SensorNoise) -> str:
    """Say the coefficients in the units of data sheets."""
    lines = ["", "In the units of data sheets (x, y, z), for people:"]
    for sensor, triad in noise.triads.items():
        for name, units in DATASHEET_UNITS[sensor].items():
            found = [axis.coefficients()[name] for axis in triad.axes]
            for unit, factor in units:
                values = "  ".join(f"{'' if one.found else '< '}{factor * one.most:.4g}" for one in found)
                lines.append(f"  {f'{sensor} {name}':<32}{values}  {unit}")
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def noise_document(noise: SensorNoise) -> dict[str, Any]:
    """Return what noise.yaml holds."""
    document: dict[str, Any] = {"schema": NOISE_SCHEMA, "verdict": noise.verdict}
    document |= {sensor: _triad_document(sensor, triad) for sensor, triad in noise.triads.items()}
    if isfinite(noise.t_init_s):
        document["t_init"] = noise.t_init_s
    document["findings"] = [finding_document(finding) for finding in noise.findings]
    document["provenance"] = provenance_document(noise.provenance)
    return document


def _triad_document(sensor: str, triad: TriadNoise) -> dict[str, Any]:
    axes = {
        name: {
            **{
                key: ({"value": found.value, "sigma": found.sigma} if found.found else {"below": found.bound})
                for key, found in axis.coefficients().items()
            },
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


def kalibr_input_text(noise: SensorNoise, topic: str) -> str:
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
    density = ", ".join(
        f"{factor * triad.noise_density:.4g} {unit}" for unit, factor in DATASHEET_UNITS[sensor]["white_noise"]
    )
    lines = [
        f"{sensor}_noise_density is {density}.",
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


_KNOWN = Path(__file__).with_name("datasheets.yaml")
_MG = 1e3 / STANDARD_GRAVITY_M_S2
_ALSO: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "accelerometer": {
        "noise_density": {"mg/sqrt(Hz)": _MG, "m/s^2/sqrt(Hz)": 1.0},
        "bias_stability": {"mg": _MG, "m/s^2": 1.0},
    },
    "gyroscope": {
        "noise_density": {"mdeg/s/sqrt(Hz)": degrees(1e3), "rad/s/sqrt(Hz)": 1.0},
        "bias_stability": {"deg/s": degrees(1.0), "rad/s": 1.0},
    },
}
"""Other units that data sheets use, and how many of them are one in SI."""


def load_datasheet(name: str) -> Datasheet:
    """Read what a data sheet states of the noise of a sensor.

    Parameters
    ----------
    name : of a sensor that gnomon knows, as "ADIS16470", or of a YAML file of the form of datasheets.yaml with one
        sensor

    Raises
    ------
    OptionError
        If there is neither such a sensor nor such a file, or the file has several sensors.
    FormatError
        If the file is not of that form; the message names the key.
    """
    known = list(read_yaml(_KNOWN).entries())
    entries = [node for node in known if _plain(node.key) == _plain(name)]
    if not entries:
        if not Path(name).is_file():
            raise OptionError(f"--datasheet {name}: neither a file nor one of {', '.join(n.key for n in known)}.")
        entries = list(read_yaml(name).entries())
    if len(entries) != 1:
        raise OptionError(f"--datasheet {name}: found {len(entries)} sensors, expected one.")
    return _read(entries[0])


def _plain(name: str) -> str:
    return name.replace("-", "").lower()


def _read(node: Node) -> Datasheet:
    keys = node.mapping(("source",), tuple(SENSOR_UNITS))
    sensors = {sensor: _stated(sensor, keys[sensor]) for sensor in SENSOR_UNITS if sensor in keys}
    return Datasheet(name=node.key, source=keys["source"].text(), sensors=sensors)


def _stated(sensor: str, node: Node) -> StatedNoise:
    keys = node.mapping(optional=(*QUANTITIES, "bandwidth"))
    values = {
        quantity: _quantity(keys[quantity], {unit: factor, **_ALSO[sensor].get(quantity, {})})
        for quantity, (unit, factor) in sheet_units(sensor).items()
        if quantity in keys
    }
    if "bandwidth" in keys:
        values["bandwidth_hz"] = _quantity(keys["bandwidth"], {"Hz": 1.0})
    return StatedNoise(**values)


def _quantity(node: Node, units: Mapping[str, float]) -> float:
    """Return a number with one of these units in SI."""
    number, _, unit = node.text().partition(" ")
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if unit.strip() not in units or not 0 < value < float("inf"):
        raise node.fail(f'found "{node.value}", expected a positive number with a unit: {" or ".join(units)}.')
    return value / units[unit.strip()]
