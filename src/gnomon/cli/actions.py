"""What the commands do: read, call the library, print. Each returns its exit code."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import commands
from .camera_imu_actions import camera_imu, simulate_camera_imu
from .places import RESULT_FILES, default_folder, result_folder
from .results import (
    UNUSABLE,
    USABLE,
    calibration_document,
    exit_code,
    result_document,
    say_advice,
    say_assumptions,
    say_files,
    say_verdict,
    write_result,
)
from .terminal import Terminal

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..findings import Finding
    from ..recording import Recording

DEMO_RECORDING, TRUTH = "recording.npz", "truth.yaml"


def _imu(command: commands.Imu, terminal: Terminal) -> int:
    from ..calibrate import calibrate_imu

    folder = command.output or default_folder(command.recording.paths)
    with result_folder(folder) as staging:
        terminal.progress("reading the recording")
        recording = _read(command.recording)
        terminal.close()
        say_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
        result = calibrate_imu(recording, command.options, progress=terminal.progress)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    _say_result(result.calibration, folder, terminal, parameters=True)
    terminal.document(result_document(result.calibration, folder, recording.assumptions))
    return exit_code(result.calibration)


def _say_result(calibration: "Calibration", folder: Path, terminal: Terminal, *, parameters: bool) -> None:
    from . import summary

    say_verdict(calibration, terminal)
    terminal.say("\n".join(summary.facts(calibration)))
    say_advice(calibration, terminal)
    if parameters:
        terminal.say("\nestimate +- standard deviation; rows: sensor axes, columns: body axes")
        terminal.say("\n".join(summary.parameter_lines(calibration)))
    say_files(folder, terminal)


def _read(source: commands.Input) -> "Recording":
    from ..readers import read

    return read(*source.paths, columns=source.columns, rate_hz=source.rate, units=source.units)


def _check(command: commands.Check, terminal: Terminal) -> int:
    from ..assess.doctor import check

    recording = _read(command.recording)
    findings = check(recording)
    code = UNUSABLE if any(finding.severity == "problem" for finding in findings) else USABLE
    say_assumptions(recording.assumptions, terminal)
    _say_recording(recording, terminal)
    _say_findings(findings, terminal)
    terminal.document(
        {
            "exit_code": code,
            "assumptions": list(recording.assumptions),
            "imus": {
                name: {
                    triad: {
                        "samples": len(samples),
                        "rate_hz": samples.rate_hz,
                        "duration_s": samples.duration_s,
                        "unit": samples.unit,
                    }
                    for triad, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
                }
                for name, imu in recording.imus.items()
            },
            "findings": [asdict(finding) for finding in findings],
        }
    )
    return code


def _say_recording(recording: "Recording", terminal: Terminal) -> None:
    for name, imu in recording.imus.items():
        for triad, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope)):
            terminal.say(
                f"{name} {triad:<13} {len(samples)} samples, {samples.duration_s:.1f} s at {samples.rate_hz:.6g} Hz, "
                f"in {samples.unit}"
            )


def _say_findings(findings: Sequence["Finding"], terminal: Terminal) -> None:
    from . import summary

    styles = {"problem": "red", "warning": "yellow", "info": "", "good": "green"}
    for severity, style in styles.items():
        chosen = [finding for finding in findings if finding.severity == severity]
        if chosen:
            terminal.say("\n" + "\n".join(summary.advice(chosen, good=True)), style)


def _show(command: commands.Show, terminal: Terminal) -> int:
    from ..readers import load
    from ..writers.tables import form_tables, summary_table

    calibration = load(command.calibration)
    for table in (summary_table(calibration), *form_tables(calibration, command.form)):
        names = max(len(row.name) for row in table.rows)
        values = max(len(row.value) for row in table.rows)
        terminal.say(table.title, "bold")
        terminal.say(table.note, "dim")
        for row in table.rows:
            terminal.say(f"  {row.name:<{names}}  {row.value:>{values}}  {row.unit}".rstrip())
        terminal.say("")
    from . import summary

    if lines := list(summary.advice(calibration.assessment.findings)):
        terminal.say("\n".join(lines))
    terminal.document(calibration_document(calibration))
    return USABLE


def _apply(command: commands.Apply, terminal: Terminal) -> int:
    from ..readers import load
    from ..units import Units
    from ..writers.apply import apply_files

    source = command.recording
    name, imu = next(iter(load(command.calibration).imus.items()))
    rows = apply_files(
        imu,
        *source.paths,
        output=command.output,
        columns=source.columns,
        rate_hz=source.rate,
        units=None if source.units is None else Units.parse(source.units),
        imu=name,
    )
    terminal.say(f"{rows} rows in {command.output}")
    terminal.document({"rows": rows, "file": str(command.output)})
    return USABLE


def _convert(command: commands.Convert, terminal: Terminal) -> int:
    from ..readers import load
    from ..writers import convert
    from ..writers.conversion import exported

    calibration = load(command.calibration)
    folder = command.output or command.calibration.parent / command.to
    losses = convert(calibration, command.to, folder)
    files = [str(folder / name) for name in exported(calibration, command.to).files]
    for name in files:
        terminal.say(f"written: {name}")
    for loss in losses:
        terminal.say(f"lost:    {loss}")
    terminal.document({"files": files, "losses": [asdict(loss) for loss in losses]})
    return USABLE


def _simulate(command: commands.Simulate, terminal: Terminal) -> int:
    from ..simulate import simulate
    from ..writers import save
    from ..writers.recording_file import save_recording

    folder = command.output.parent
    with result_folder(folder, own=()) as staging:
        recording, truth = simulate(command.scenario, command.seed)
        names = [path.name for path in save_recording(recording, staging / command.output.name)]
        save(truth, staging / TRUTH)
    for name in names:
        terminal.say(f"recording    {folder / name}")
    terminal.say(f"truth        {folder / TRUTH}")
    terminal.document({"recording": [str(folder / name) for name in names], "truth": str(folder / TRUTH)})
    return USABLE


def _demo(command: commands.Demo, terminal: Terminal) -> int:
    from ..calibrate import calibrate_imu
    from ..options import ImuOptions
    from ..readers import read
    from ..simulate import simulate
    from ..writers import save
    from ..writers.recording_file import save_recording
    from .comparison import comparison_document, comparison_sentence, comparison_table

    with result_folder(command.output, own=(*RESULT_FILES, DEMO_RECORDING, TRUTH)) as staging:
        terminal.progress("simulating a recording")
        simulated, truth = simulate(command.scenario, command.seed)
        save_recording(simulated, staging / DEMO_RECORDING)
        save(truth, staging / TRUTH)
        recording = read(staging / DEMO_RECORDING)  # as a person's own recording would be
        options = replace(ImuOptions(), gravity=command.scenario.gravity)
        result = calibrate_imu(recording, options, progress=terminal.progress)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    if not command.json:
        terminal.draw(comparison_table(result.calibration, truth))
        terminal.say(comparison_sentence(result.calibration, truth))
    _say_result(result.calibration, command.output, terminal, parameters=False)
    document = result_document(result.calibration, command.output, recording.assumptions)
    terminal.document({**document, "comparison": comparison_document(result.calibration, truth)})
    return exit_code(result.calibration)


_ACTIONS: dict[type[commands.Command], Callable[[Any, Terminal], int]] = {
    commands.Imu: _imu,
    commands.CameraImu: camera_imu,
    commands.Check: _check,
    commands.Show: _show,
    commands.Apply: _apply,
    commands.Convert: _convert,
    commands.Simulate: _simulate,
    commands.SimulateCameraImu: simulate_camera_imu,
    commands.Demo: _demo,
}


def run(command: commands.Command, terminal: Terminal) -> int:
    """Carry out a command and return its exit code."""
    return _ACTIONS[type(command)](command, terminal)
