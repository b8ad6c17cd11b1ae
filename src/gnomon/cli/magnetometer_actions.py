"""What the commands for a magnetometer do."""

from dataclasses import replace

from .magnetometer_command import Magnetometer, SimulateMagnetometer
from .places import default_folder, result_folder
from .prior_files import read_priors
from .results import (
    exit_code,
    propose_apply,
    result_document,
    say_assumptions,
    say_result,
    write_result,
)
from .simulated import write_simulated
from .terminal import Terminal
from .use_option import judged_result, read_use_option


def magnetometer(command: Magnetometer, terminal: Terminal) -> int:
    """Calibrate, write the folder of the result, and return the exit code."""
    from ..calibrate.magnetometer import calibrate_magnetometer
    from ..readers import read
    from ..triad_diagnostics import TriadDiagnostics
    from .magnetometer_summary import facts

    source = command.recording
    folder = command.output or default_folder(source.paths, "magnetometer")
    use = read_use_option(command.use)
    with result_folder(folder, "magnetometer") as staging:
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
    propose_apply(result.calibration, folder, source, terminal)
    terminal.document(result_document(result.calibration, folder, recording.assumptions))
    return exit_code(result.calibration)


def simulate_magnetometer(command: SimulateMagnetometer, terminal: Terminal) -> int:
    """Simulate a recording, write it and its truth, and return the exit code."""
    from ..simulate import simulate_magnetometer as simulated

    return write_simulated(*simulated(command.scenario, command.seed), command.output, terminal, then="magnetometer")
