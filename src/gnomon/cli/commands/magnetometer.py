"""The commands for a magnetometer."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ...options import MagnetometerOptions
from ...simulate.scenarios.recorded import FieldScenario
from ..command import CertificateFacts, Command, Flat, ForUse, Input, Report, Seed, output_option
from ..files import default_folder, read_priors, read_use_option, result_folder
from ..results import common_decimals, judged_result, print_assumptions, print_result, result_with_reading, write_result
from ..simulated import write_simulated
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...recording import Floats
    from ...results.calibration import Calibration
    from ...results.result import Result


@dataclass(frozen=True, kw_only=True)
class Magnetometer(Command):
    """Calibrate hard and soft iron of a magnetometer from one recording in which it was turned by hand.

    Turn the sensor slowly through all attitudes, in one place away from iron, for a minute or two. With the
    accelerometer in the recording both come out in one frame.

    Examples
    --------
    $ gnomon magnetometer recording.csv
    $ gnomon magnetometer recording.csv --latitude 52.5
    """

    recording: Annotated[Input, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-magnetometer beside the
    recording)."""
    use: ForUse = None
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)
    options: Annotated[MagnetometerOptions, Flat] = field(default_factory=MagnetometerOptions)

    def run(self, terminal: Terminal) -> int:
        """Calibrate, write the folder of the result, and return the exit code."""
        from ...calibrate.magnetometer import calibrate_magnetometer
        from ...readers.recordings import read

        source = self.recording
        folder = self.output or default_folder(source.paths, "magnetometer")
        use = read_use_option(self.use)
        with result_folder(folder, "magnetometer") as staging:
            terminal.progress("reading the recording")
            known = read_priors(self.options.prior)
            recording = read(*source.paths, **source.table)
            recording = known.known_of(recording)
            print_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
            options = replace(self.options, prior=known.stated)
            result = calibrate_magnetometer(recording, options, progress=terminal.progress, prior=known.calibrations)
            result = result_with_reading(judged_result(result, use), source.table | self.certificate.stated)
            write_result(result, staging, report=self.report, terminal=terminal)
        lines = magnetometer_lines(result)
        return print_result(result.calibration, lines, folder, recording.assumptions, terminal, source=source)


@dataclass(frozen=True, kw_only=True)
class SimulateMagnetometer(Command):
    """Make a recording of a simulated magnetometer turned by hand, and its true calibration beside it (truth.yaml).

    Examples
    --------
    $ gnomon simulate magnetometer -o magnetometer.csv
    """

    output: Annotated[Path, output_option("FILE")]
    """Recording to write, .npz or .csv."""
    seed: Seed = 0
    scenario: Annotated[FieldScenario, Flat] = field(default_factory=FieldScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate a recording, write it and its truth, and return the exit code."""
        from ...simulate import simulate_magnetometer as simulated

        return write_simulated(lambda: simulated(self.scenario, self.seed), self.output, terminal, then="magnetometer")


def magnetometer_lines(result: "Result") -> Iterator[str]:
    """Yield lines on hard and soft iron, dip, and how well the strength of the field is predicted."""
    from ...results.sensor_diagnostics import TriadDiagnostics

    calibration, diagnostics = result.calibration, result.diagnostics
    assert isinstance(diagnostics, TriadDiagnostics)
    found = calibration.assessment
    sensor = calibration.imus["imu0"].magnetometer
    assert sensor is not None
    sigma = calibration.sigma("imu0.magnetometer.bias")
    yield f"  hard iron          {_numbers(sensor.bias, sigma)} {sensor.unit}"
    shape, spread = soft_iron(sensor.sensitivity), _sigma(sensor.sensitivity, calibration)
    yield f"  soft iron          {_numbers(100 * shape[:3], 100 * spread[:3])} % (scales)"
    yield f"                     {_numbers(1e3 * shape[3:], 1e3 * spread[3:])} mrad (xy xz yz)"
    if diagnostics.dip is not None:
        dip, sigma = degrees(diagnostics.dip.estimated_rad), degrees(diagnostics.dip.sigma_rad)
        yield f"  dip of the field   {dip:.2f} +- {sigma:.2f} deg below the horizontal"
    noise = diagnostics.noise
    yield f"  strength, samples  {100 * noise['magnetometer.error_std']:.3g} % rms, robustly " + (
        f"{100 * noise['magnetometer.error_spread']:.3g} %"
    )
    yield f"  hold-out error     {100 * found.holdout.field_rms:.3g} % of the field (rms)"
    yield f"  stretches          {found.intervals_used} used of {found.intervals_found}"
    yield f"  model, body frame  {found.model}, {calibration.frame}; field in {sensor.field_unit}"


def soft_iron(sensitivity: "Floats") -> "Floats":
    """Return how far the scales of x, y, z are off their mean, then the axes off square, xy xz yz [rad], (6,)."""
    import numpy as np

    length = np.linalg.norm(sensitivity, axis=1)
    rows = sensitivity / length[:, None]
    cosines = np.array([rows[0] @ rows[1], rows[0] @ rows[2], rows[1] @ rows[2]])
    return np.concatenate([length / length.mean() - 1, np.arcsin(np.clip(cosines, -1, 1))])


def _sigma(sensitivity: "Floats", calibration: "Calibration") -> "Floats":
    """Return the sigmas of `soft_iron`, (6,)."""
    import numpy as np

    step = 1e-6 * float(np.abs(sensitivity).max())
    moves = step * np.eye(9).reshape(9, 3, 3)
    jacobian = np.stack([soft_iron(sensitivity + m) - soft_iron(sensitivity - m) for m in moves], axis=1) / (2 * step)
    covariance = jacobian @ calibration.covariance("imu0.magnetometer.sensitivity") @ jacobian.T
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _numbers(values: "Floats", sigma: "Floats") -> str:
    decimals = common_decimals(sigma)
    return "  ".join(f"{v:.{decimals}f} +- {s:.{decimals}f}" for v, s in zip(values, sigma, strict=True))
