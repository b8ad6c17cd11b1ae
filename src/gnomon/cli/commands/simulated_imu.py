"""The commands that simulate a recording of an IMU, and calibrate one as a demonstration; `imu` loads none of this."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ...options import ImuOptions
from ...simulate import Scenario
from ..command import Command, Flat, Report, Seed, output_option
from ..output_folder import DEMO_RECORDING, RESULT_FILES, TRUTH, result_folder
from ..results import print_result, write_result
from ..simulated import write_simulated
from ..terminal import Terminal

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
        from ..summary import comparison_document, comparison_sentence, comparison_table, summary_lines

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
