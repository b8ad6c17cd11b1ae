"""The commands that simulate an IMU or its poses, and calibrate it as a demonstration; `imu` loads none of this."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...options import ImuOptions
from ...simulate.scenarios.recorded import PoseScenario, Scenario
from ..command import Command, Flat, Report, Seed, output_option
from ..files import DEMO_RECORDING, RESULT_FILES, TRUTH, result_folder
from ..results import USABLE, common_decimals, common_power, print_result, summary_lines, write_result
from ..simulated import truth_name, write_simulated
from ..terminal import Terminal

if TYPE_CHECKING:
    from rich.table import Table

    from ...recording import Floats, Poses, Recording
    from ...results.calibration import Calibration
    from ...simulate.imu import PoseSimulation

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


@dataclass(frozen=True, kw_only=True)
class SimulatePoses(Command):
    """Make an experiment in which a simulated sensor lies still in one attitude after another, and its truth.

    `gnomon imu` takes the table, the folder or the recording as it is.

    Examples
    --------
    $ gnomon simulate poses -o poses
    """

    output: Annotated[Path, output_option("PATH")]
    """A name that ends in .csv: a table of averaged poses; in .npz: one recording of all samples; any other: a folder
    with a file for each pose. The true calibration, truth.yaml, is written beside it, or into the folder."""
    seed: Seed = 0
    scenario: Annotated[PoseScenario, Flat] = field(default_factory=PoseScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate poses, write them and their truth, and return the exit code."""
        from ...formats.own.calibration_text import save
        from ...simulate import simulate_poses
        from ...writers.recording_file import save_pose_files, save_poses, save_recording

        path = self.output
        as_file = path.suffix.lower() in {".csv", ".npz"}
        folder = path.parent if as_file else path
        with result_folder(folder, own=()) as staging:
            terminal.progress("simulating")
            simulation = simulate_poses(self.scenario, self.seed)
            if path.suffix.lower() == ".csv":
                save_poses(pose_averages(simulation), staging / path.name)
                files = [path]
            elif path.suffix.lower() == ".npz":
                files = [
                    path.with_name(file.name) for file in save_recording(join_poses(simulation), staging / path.name)
                ]
            else:
                files = [path / file.name for file in save_pose_files(simulation.poses, staging)]
            true = truth_name(folder, [file.name for file in files])
            save(simulation.truth, staging / true)
        terminal.print(f"poses        {len(simulation.poses)} in {path}")
        terminal.print(f"truth        {folder / true}")
        terminal.propose("imu", path)
        terminal.document({"poses": [str(file) for file in files], "truth": str(folder / true)})
        return USABLE


def pose_averages(simulation: "PoseSimulation") -> "Poses":
    """Return the means of a simulation with what a person would know of them."""
    import numpy as np

    from ...recording import Poses

    count = simulation.scenario.samples

    def sigma(quantity: str) -> "Floats | None":
        """Return the sigma of the means by the scatter of the samples; None where they do not scatter."""
        values = np.array([getattr(samples, quantity).values for samples in simulation.poses])
        found = values.std(axis=1, ddof=1) / np.sqrt(count) if count > 1 else np.zeros((len(values), 3))
        return found if bool((found > 0).all()) else None

    return Poses(
        name=tuple(f"pose {k + 1}" for k in range(len(simulation.poses))),
        accelerometer=simulation.accelerometer,
        accelerometer_unit=simulation.poses[0].accelerometer.unit,
        gyroscope=simulation.gyroscope,
        gyroscope_unit=simulation.poses[0].gyroscope.unit,
        accelerometer_sigma=sigma("accelerometer"),
        gyroscope_sigma=sigma("gyroscope"),
        samples=np.full(len(simulation.poses), count),
        t_s=simulation.t_s,
        specific_force=simulation.meant if simulation.scenario.known else None,
    )


def join_poses(simulation: "PoseSimulation") -> "Recording":
    """Return the samples of all poses as one recording, without what happened between them."""
    import numpy as np

    from ...recording import ImuSamples, Recording, TriadSamples

    def triad(quantity: str) -> TriadSamples:
        parts = [getattr(samples, quantity) for samples in simulation.poses]
        return TriadSamples(
            t_ns=np.concatenate([part.t_ns for part in parts]),
            values=np.concatenate([part.values for part in parts]),
            unit=parts[0].unit,
        )

    samples = ImuSamples(accelerometer=triad("accelerometer"), gyroscope=triad("gyroscope"))
    return Recording(imus={"imu0": samples})
