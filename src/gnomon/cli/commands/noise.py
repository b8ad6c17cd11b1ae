"""The commands on noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from math import inf, nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...errors import OptionError
from ...options import NoiseOptions
from ...progress import Step
from ...simulate.scenarios.recorded import NoiseScenario
from ..arguments import Argument
from ..command import Command, Flat, Input, Report, Seed, output_option
from ..files import NOISE_FILES, default_folder, result_folder
from ..results import (
    UNUSABLE,
    USABLE,
    VERDICTS,
    common_decimals,
    common_power,
    print_assumptions,
    print_files,
    print_findings,
    result_files,
)
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...recording import Floats
    from ...results.datasheet import Datasheet, DatasheetComparison
    from ...results.sensor_noise import Coefficient, SensorNoise, TriadNoise


_LEGEND = """\
N white noise, B bias instability (floor of the curve: 0.664 B), K random walk,
Q quantisation, R rate ramp; +- standard deviation, < upper bound"""


@dataclass(frozen=True, kw_only=True)
class Noise(Command):
    """Identify the noise of an IMU from a long recording at rest: white noise, bias instability, random walk.

    Let the sensor lie where nothing can move it, at an even temperature, for 3 hours or longer.

    Examples
    --------
    $ gnomon noise night.npz
    $ gnomon noise night.npz --datasheet ADIS16470
    """

    recording: Annotated[Input, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for noise.yaml, Kalibr's imu.yaml, allan.csv and report.html (default: NAME-noise beside the
    recording)."""
    report: Report = True
    datasheet: Annotated[str | None, Argument(metavar="NAME|FILE")] = None
    """Compare with a data sheet: BMI088, BMI270, ICM-20948, ICM-42688, MPU-6050, LSM6DSO, ADIS16448, ADIS16470, or a
    YAML file."""
    bandwidth_hz: float | None = None
    """Bandwidth of the filter before the samples were taken, in Hz, for the data sheet: what lies above half the rate
    is folded down (default: a filter that ends below it)."""
    options: Annotated[NoiseOptions, Flat] = field(default_factory=NoiseOptions)

    def run(self, terminal: Terminal) -> int:
        """Identify the noise of an IMU, write and say it, and return the exit code."""
        from ...calibrate.noise import identify_noise
        from ...formats.own.noise_file import noise_document, save_noise_files
        from ...report.noise import write_noise_report
        from ...results.datasheet import compare_datasheet

        sheet = self._sheet()
        source = self.recording
        folder = self.output or default_folder(source.paths, "noise")
        with result_folder(folder, "noise", own=NOISE_FILES) as staging:
            result = identify_noise(source.paths, self.options, terminal.progress, **source.table)
            save_noise_files(result, staging)
            compared = None if sheet is None else compare_datasheet(result.noise, sheet, self.bandwidth_hz or nan)
            if self.report:
                terminal.progress("drawing the report")
                write_noise_report(result, staging / "report.html", compared)
        found = result.noise
        assumptions = [finding.message for finding in found.findings if finding.code == "assumed"]
        code = UNUSABLE if found.verdict == "fail" else USABLE
        print_assumptions(assumptions, terminal)
        _print(found, terminal)
        if compared is not None:
            terminal.print("\n".join(_compared_lines(compared)))
        print_files(folder, terminal, NOISE_FILES)
        if code == USABLE:
            terminal.print("")
            terminal.propose("camera-imu", "RECORDING", "--imu", folder / "imu.yaml")
        terminal.document(
            {
                "verdict": found.verdict,
                "exit_code": code,
                "assumptions": assumptions,
                "files": result_files(folder, NOISE_FILES),
                "noise": noise_document(found),
                **({} if compared is None else {"datasheet": _compared_document(compared)}),
            }
        )
        return code

    def _sheet(self) -> "Datasheet | None":
        from ...formats.own.noise_file import load_datasheet

        if self.bandwidth_hz is not None and not (self.datasheet and 0 < self.bandwidth_hz < inf):
            raise OptionError("--bandwidth-hz must be greater than zero, and goes with --datasheet.")
        return None if self.datasheet is None else load_datasheet(self.datasheet)


def _compared_lines(compared: "DatasheetComparison") -> Iterator[str]:
    """Yield what was found against a data sheet, a line for each quantity."""
    yield f"\n{'data sheet ' + compared.sheet.name:<43}{'found':<12}{'expected':<12}ratio"
    for one in compared.quantities:
        what = f"{one.sensor} {one.label}"
        found = f"{'< ' if one.bound else ''}{one.found:.3g}"
        ratio = f"{'< ' if one.bound else ''}{one.ratio:.2f}"
        yield f"  {what:<41}{found:<12}{f'{one.expected:.3g}':<12}{ratio:<7}{one.unit}"
    yield from compared.words()


def _compared_document(compared: "DatasheetComparison") -> dict[str, Any]:
    rows = [{**{f.name: getattr(one, f.name) for f in fields(one)}, "ratio": one.ratio} for one in compared.quantities]
    return {"name": compared.sheet.name, "source": compared.sheet.source, "quantities": rows}


def show_noise(path: Path, terminal: Terminal) -> int:
    """Show a noise.yaml."""
    from ...formats.own.noise_file import load_noise, noise_document

    found = load_noise(path)
    _print(found, terminal)
    terminal.document(noise_document(found))
    return USABLE


def _print(found: "SensorNoise", terminal: Terminal) -> None:
    meaning, style = VERDICTS[found.verdict]
    terminal.print(f"{found.verdict}: {meaning.replace('calibration', 'noise')}", style)
    for sensor, triad in found.triads.items():
        terminal.print("\n".join(_lines(sensor, triad)))
    terminal.print(_LEGEND, "dim")
    print_findings(found.findings, terminal)


def _lines(sensor: str, triad: "TriadNoise") -> Iterator[str]:
    """Yield the coefficients of a sensor, a line for each kind of noise, 80 columns wide."""
    from ...results.sensor_noise import COEFFICIENTS, DATASHEET_UNITS, SYMBOLS, UNITS

    yield f"\n{sensor:<15}{'x':<18}{'y':<18}z"
    for name in COEFFICIENTS:
        found = [axis.coefficients()[name] for axis in triad.axes]
        yield f"  {SYMBOLS[name]}  {_row(found, UNITS[sensor][name])}"
        for unit, factor in DATASHEET_UNITS[sensor].get(name, ()):
            yield f"     {_row([one.scaled(factor) for one in found], unit)}"


def _row(found: "Sequence[Coefficient]", unit: str) -> str:
    """Return the coefficients of three axes with one power of ten, and their unit."""
    import numpy as np

    values = np.array([one.most for one in found])
    sigmas = np.array([one.sigma if one.found else one.bound / 10 for one in found])
    power = common_power(values, sigmas)
    decimals = min(common_decimals(sigmas / 10.0**power), 4)
    cells = "".join(_cell(one, 10.0**-power, decimals) for one in found)
    return cells + (f"10^{power} {unit}" if power else unit)


def _cell(found: "Coefficient", factor: float, decimals: int) -> str:
    if not found.found:
        return f"< {factor * found.bound:.{decimals}f}".ljust(18)
    return f"{factor * found.value:.{decimals}f} +- {factor * found.sigma:.{decimals}f}".ljust(18)


@dataclass(frozen=True, kw_only=True)
class SimulateNoise(Command):
    """Make a long recording of a simulated IMU at rest, with noise of known coefficients.

    Examples
    --------
    $ gnomon simulate noise -o night.npz
    """

    output: Annotated[Path, output_option("FILE")]
    """Recording to write, .npz."""
    seed: Seed = 0
    scenario: Annotated[NoiseScenario, Flat] = field(default_factory=NoiseScenario)

    def run(self, terminal: Terminal) -> int:
        """Write a recording of simulated noise, say where, and return the exit code."""
        from ...results.sensor_noise import SENSOR_UNITS
        from ...simulate.sensor import noise_blocks
        from ...writers.recording_file import save_blocks

        scenario = self.scenario
        if self.output.suffix != ".npz":
            raise OptionError(f"{self.output}: such long recordings are written as .npz. Name the file so.")

        def told(sensor: str) -> Iterator["Floats"]:
            done = 0
            for block in noise_blocks(scenario, sensor, self.seed):
                terminal.progress(Step(f"simulating the {sensor}", done, scenario.samples))
                done += len(block)
                yield block

        sensors = {sensor: (unit, told(sensor)) for sensor, unit in SENSOR_UNITS.items()}
        with result_folder(self.output.parent, own=()) as staging:
            save_blocks(staging / self.output.name, sensors, samples=scenario.samples, rate_hz=scenario.rate_hz)
        terminal.print(f"recording    {self.output}")
        terminal.propose("noise", self.output)
        truth = {sensor: scenario.of(sensor) for sensor in SENSOR_UNITS}
        terminal.document({"recording": str(self.output), "samples": scenario.samples, "truth": truth})
        return USABLE
