"""The commands for a magnetometer."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from ...options import MagnetometerOptions
from ...simulate import FieldScenario
from ..command import CertificateFacts, Command, Flat, ForUse, Input, Report, Seed, output_option
from ..inputs import judged_result, read_priors, read_use_option, result_with_reading
from ..output_folder import default_folder, result_folder
from ..results import print_assumptions, print_result, write_result
from ..simulated import write_simulated
from ..terminal import Terminal


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
        from ..summary import magnetometer_lines

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
