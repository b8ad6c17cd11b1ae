"""The commands that simulate a recording of an IMU, and calibrate one as a demonstration; `imu` loads none of this."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...options import ImuOptions
from ...simulate import Scenario
from ..command import Command, Flat, Report, Seed, output_option
from ..files import DEMO_RECORDING, RESULT_FILES, TRUTH, result_folder
from ..results import common_decimals, common_power, print_result, summary_lines, write_result
from ..simulated import write_simulated
from ..terminal import Terminal

if TYPE_CHECKING:
    from rich.table import Table

    from ...results.calibration import Calibration

_DEMO_SCENARIO = Scenario(g_sensitivity=3e-4)


@dataclass(frozen=True, kw_only=True)
class Simulate(Command):
    """Make a recording of a simulated sensor, and its true calibration beside it (truth.yaml).

    Examples
    --------
    $ gnomon simulate imu -o recording.npz
    $ gnomon simulate imu -o recording.csv --intervals 20 --seed 7
    """

    output: Annotated[Path, output_option("FILE")]
    """Recording to write, .npz or .csv."""
    seed: Seed = 0
    scenario: Annotated[Scenario, Flat] = field(default_factory=Scenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate, write recording and truth, and return the exit code."""
        from ...simulate import simulate

        return write_simulated(lambda: simulate(self.scenario, self.seed), self.output, terminal, then="imu")


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Calibrate a simulated recording and compare the result with the truth.

    Examples
    --------
    $ gnomon demo
    """

    output: Annotated[Path, output_option("DIR")] = Path("gnomon-demo")
    """Folder for the recording, the truth and the results."""
    seed: Seed = 0
    report: Report = True

    def run(self, terminal: Terminal) -> int:
        """Simulate, calibrate, write both, print them beside the truth, and return the exit code."""
        from ...calibrate.imu import calibrate_imu
        from ...formats.own.calibration_text import save
        from ...readers.recordings import read
        from ...simulate import simulate
        from ...writers.recording_file import save_recording

        with result_folder(self.output, "demo", own=(*RESULT_FILES, DEMO_RECORDING, TRUTH)) as staging:
            terminal.progress("simulating a recording")
            simulated, truth = simulate(_DEMO_SCENARIO, self.seed)
            save_recording(simulated, staging / DEMO_RECORDING)
            save(truth, staging / TRUTH)
            recording = read(staging / DEMO_RECORDING)  # as a person's own recording would be
            options = ImuOptions(gravity=_DEMO_SCENARIO.gravity)
            result = calibrate_imu(recording, options, progress=terminal.progress)
            write_result(result, staging, report=self.report, terminal=terminal)
        if not self.json:
            terminal.draw(comparison_table(result.calibration, truth))
            terminal.print(comparison_sentence(result.calibration, truth))
        more = {"comparison": comparison_document(result.calibration, truth)}
        lines = summary_lines(result.calibration)
        return print_result(
            result.calibration, lines, self.output, recording.assumptions, terminal, parameters=False, more=more
        )


def compare_with_truth(estimate: "Calibration", truth: "Calibration") -> Iterator[tuple[str, float, float, float]]:
    """Yield name, estimate, sigma and truth of every scalar that was estimated."""
    from ...results.calibration import calibration_parameters, element_names

    true = truth.in_frame(estimate.frame)
    known = dict(calibration_parameters(true.imus))
    for path, value in calibration_parameters(estimate.imus):
        names = element_names(path, value.shape)
        truly = known.get(path, 0 * value)  # without lever arms they are zero
        columns = value.ravel(), estimate.sigma(path).ravel(), truly.ravel()
        for name, number, sigma, expected in zip(names, *columns, strict=True):
            if sigma > 0:
                yield name, float(number), float(sigma), float(expected)


def comparison_table(estimate: "Calibration", truth: "Calibration") -> "Table":
    """Return a table of estimates, their sigmas, the truth, and the errors in sigmas."""
    import numpy as np
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from ...results.sensors import parameter_unit

    table = Table(box=box.SIMPLE_HEAD, title="estimate and truth", pad_edge=False)
    table.add_column("parameter", max_width=26)
    for title in ("estimate", "sigma", "truth", "error/sigma"):
        table.add_column(title, justify="right", no_wrap=True)
    for path, rows in groupby(compare_with_truth(estimate, truth), key=lambda row: row[0].split("[", maxsplit=1)[0]):
        block = list(rows)
        numbers = np.array([row[1:] for row in block])
        power = common_power(numbers[:, 0], numbers[:, 1])
        decimals = common_decimals(numbers[:, 1] / 10.0**power)
        scale = f"10^{power} " if power else ""
        unit = f"[{scale}{parameter_unit(estimate, path)}]"
        table.add_row(Text(path.removeprefix("imu0."), style="bold"), *[""] * 4)
        table.add_row(Text(f"  {unit}"), *[""] * 4)
        for name, number, sigma, expected in block:
            cells = [f"{value / 10.0**power:.{decimals}f}" for value in (number, sigma, expected)]
            element = name.removeprefix(path)
            table.add_row(Text(f"  {element}"), *cells, f"{(number - expected) / sigma:+.2f}")
        table.add_section()
    return table


def comparison_sentence(estimate: "Calibration", truth: "Calibration") -> str:
    """Return how large the errors are for their sigmas."""
    ratios = [(number - expected) / sigma for _, number, sigma, expected in compare_with_truth(estimate, truth)]
    rms = sqrt(sum(ratio**2 for ratio in ratios) / len(ratios))
    return f"{len(ratios)} parameters: rms of error/sigma {rms:.2f}, where 1 is expected.\n"


def comparison_document(estimate: "Calibration", truth: "Calibration") -> list[dict[str, Any]]:
    """Return the same for a program."""
    keys = ("parameter", "estimate", "sigma", "truth")
    return [dict(zip(keys, row, strict=True)) for row in compare_with_truth(estimate, truth)]
