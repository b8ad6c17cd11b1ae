"""The commands on an IMU over its temperature."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ...simulate.scenarios.recorded import TemperatureScenario
from ..arguments import Argument
from ..command import Command, FileOption, Flat, Report, Seed, StatedFacts, TableOptions, output_option
from ..files import default_folder, result_folder
from ..results import USABLE, VERDICTS, exit_code, print_files, print_findings, result_files, with_statements
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...results.temperature import TemperatureResult

FILES = ("calibration.yaml", "report.html")


@dataclass(frozen=True, kw_only=True)
class Temperature(Command, TableOptions):
    """Find how biases and scales of an IMU change with its temperature, from warm-ups at rest or turned recordings.

    Biases: switch the cold sensor on, such as from the freezer in a closed bag, and let it lie at rest until it is
    warm; three times. Scales and axes: turn it from rest to rest, as for gnomon imu, at three temperatures or more.
    Both may be given together. The recordings need the chip's thermometer.

    Examples
    --------
    $ gnomon temperature monday.csv tuesday.csv --calibration board-imu --reference-degc 31
    $ gnomon temperature cold.csv room.csv warm.csv
    """

    recordings: Annotated[tuple[Path, ...], Argument(positional=True)]
    """Recordings of one sensor, each from one switching-on; or a folder of them."""
    calibration: Annotated[Path | None, FileOption] = None
    """Calibration of the sensor, to which the temperature is added: a calibration.yaml or a result's folder."""
    reference_degc: float | None = None
    """Temperature of the chip at which that calibration was made (default: as it states; without one the middle)."""
    gravity: float | None = None
    """Local gravity in m/s^2 of recordings in which the sensor is turned, where you know it."""
    latitude: float | None = None
    """Latitude in degrees, from which normal gravity (WGS 84) is computed, unless it is stated."""
    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml and report.html (default: NAME-temperature beside the first recording)."""
    report: Report = True
    certificate: Annotated[StatedFacts, Flat] = field(default_factory=StatedFacts)

    def run(self, terminal: Terminal) -> int:
        """Find the temperature's effect, write and say it, and return the exit code."""
        from ...calibrate.temperature import calibrate_temperature
        from ...formats.own.calibration_file import load
        from ...formats.own.calibration_text import save
        from ...options import ImuOptions
        from ...readers.recordings import read, recordings_in
        from ...report.temperature import write_temperature_report

        options = ImuOptions(gravity=self.gravity, latitude=self.latitude, altitude=self.altitude)
        folder = self.output or default_folder(self.recordings[:1], "temperature")
        known = None if self.calibration is None else load(self.calibration)
        with result_folder(folder, "temperature", own=FILES) as staging:
            terminal.progress("reading the recordings")
            recordings = [read(path, **self.table) for named in self.recordings for path in recordings_in(named)]
            result = calibrate_temperature(
                recordings, known, reference_degc=self.reference_degc, options=options, progress=terminal.progress
            )
            result = replace(result, calibration=with_statements(result.calibration, self.certificate))
            save(result.calibration, staging / FILES[0])
            if self.report:
                terminal.progress("drawing the report")
                write_temperature_report(result, staging / FILES[1])
        _print(result, terminal)
        files = result_files(folder, FILES)
        print_files(folder, terminal, FILES)
        terminal.print("")
        terminal.propose("apply", folder / FILES[0], "RECORDING", "-o", "corrected.csv")
        code = exit_code(result.calibration)
        terminal.document(
            {"verdict": result.calibration.verdict, "exit_code": code, "files": files, **_numbers(result)}
        )
        return code


def _numbers(result: "TemperatureResult") -> dict[str, object]:
    found = next(iter(result.calibration.imus.values())).temperature
    assert found is not None
    return {
        "orders": {name: triad.order for name, triad in result.triads.items()},
        "sensitivity_orders": {name: triad.order for name, triad in result.sensitivities.items()},
        "lag_s": result.lag_s,
        "lag_sigma_s": result.lag_sigma_s,
        "reference_degc": found.reference_degc,
        "range_degc": [found.low_degc, found.high_degc],
        "coefficients": {name: value.tolist() for name, value in found.parts()},
        "findings": [
            {"code": one.code, "severity": one.severity, "message": one.message}
            for one in result.calibration.assessment.findings
        ],
    }


def _print(result: "TemperatureResult", terminal: Terminal) -> None:
    meaning, style = VERDICTS[result.calibration.verdict]
    terminal.print(f"{result.calibration.verdict}: {meaning}", style)
    for finding in result.calibration.assessment.findings:
        if finding.severity == "good" and finding.code.startswith("temperature-"):
            terminal.print(f"  {finding.message}")
    print_findings(result.calibration.assessment.findings, terminal)


@dataclass(frozen=True, kw_only=True)
class SimulateTemperature(Command):
    """Make recordings of a simulated IMU over its temperature, with its thermometer, and print the truth.

    Examples
    --------
    $ gnomon simulate temperature -o warm-ups --lag-s 20
    $ gnomon simulate temperature -o oven --turned
    """

    output: Annotated[Path, output_option("DIR")]
    """Folder for warm-up-1.npz, or turned-1.npz, and the others."""
    seed: Seed = 0
    scenario: Annotated[TemperatureScenario, Flat] = field(default_factory=TemperatureScenario)

    def run(self, terminal: Terminal) -> int:
        """Write simulated warm-ups, say where, and return the exit code."""
        from ...simulate.temperature import simulate_temperature
        from ...writers.recording_file import save_recording

        terminal.progress("simulating")
        made = simulate_temperature(self.scenario, self.seed)
        kind = "turned" if self.scenario.turned else "warm-up"
        names = tuple(f"{kind}-{i}.npz" for i in range(1, len(made.recordings) + 1))
        with result_folder(self.output, own=names) as staging:
            for name, recording in zip(names, made.recordings, strict=True):
                save_recording(recording, staging / name)
        files = [self.output / name for name in names]
        terminal.print(f"recordings   {', '.join(map(str, files))}")
        terminal.propose("temperature", *files)
        truth = {"reference_degc": made.truth.reference_degc, "lag_s": made.truth.lag_s}
        truth |= {name: value.tolist() for name, value in made.truth.parts()}
        terminal.document({"recordings": [str(path) for path in files], "truth": truth})
        return USABLE
