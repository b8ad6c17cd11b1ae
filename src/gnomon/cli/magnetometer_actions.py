"""What the commands for a magnetometer do."""

from dataclasses import replace
from typing import TYPE_CHECKING

from .magnetometer_command import Magnetometer, SimulateMagnetometer
from .places import default_folder, result_folder
from .prior_files import read_priors
from .results import (
    USABLE,
    exit_code,
    result_document,
    say_assumptions,
    say_result,
    write_result,
)
from .terminal import Terminal
from .use_option import judged_result, read_use_option

if TYPE_CHECKING:
    pass

TRUTH = "truth.yaml"


def magnetometer(command: Magnetometer, terminal: Terminal) -> int:
    """Calibrate, write the folder of the result, and return the exit code."""
    from ..calibrate.magnetometer import calibrate_magnetometer
    from ..readers import read
    from ..triad_diagnostics import TriadDiagnostics
    from .magnetometer_summary import facts

    source = command.recording
    folder = command.output or default_folder(source.paths)
    use = read_use_option(command.use)
    with result_folder(folder) as staging:
        terminal.progress("reading the recording")
        known = read_priors(command.options.prior)
        recording = read(*source.paths, columns=source.columns, rate_hz=source.rate, units=source.units)
        recording = known.known_of(recording)
        terminal.close()
        say_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
        options = replace(command.options, prior=known.stated)
        result = calibrate_magnetometer(recording, options, progress=terminal.progress, prior=known.calibrations)
        result = judged_result(result, use)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    assert isinstance(result.diagnostics, TriadDiagnostics)
    say_result(result.calibration, facts(result.calibration, result.diagnostics), folder, terminal)
    terminal.document(result_document(result.calibration, folder, recording.assumptions))
    return exit_code(result.calibration)


def simulate_magnetometer(command: SimulateMagnetometer, terminal: Terminal) -> int:
    """Simulate a recording, write it and its truth, and return the exit code."""
    from ..simulate import simulate_magnetometer as simulated
    from ..writers import save
    from ..writers.recording_file import save_recording

    folder = command.output.parent
    with result_folder(folder, own=()) as staging:
        recording, truth = simulated(command.scenario, command.seed)
        names = [path.name for path in save_recording(recording, staging / command.output.name)]
        save(truth, staging / TRUTH)
    for name in names:
        terminal.say(f"recording    {folder / name}")
    terminal.say(f"truth        {folder / TRUTH}")
    terminal.document({"recording": [str(folder / name) for name in names], "truth": str(folder / TRUTH)})
    return USABLE
