"""What the command for cameras alone does."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..camera_options import CameraOptions
from ..errors import OptionError, RecordingError
from ..models.lens_programs import refit_models
from .camera_command import CameraCommand
from .camera_imu_actions import NO_TARGET, refuse_overwriting
from .places import CAMERA_FILES, default_folder, result_folder
from .results import exit_code, result_document, say_advice, say_assumptions, say_files, say_verdict, write_result
from .terminal import Terminal
from .topics import topics_of

if TYPE_CHECKING:
    from ..diagnostics import Result

_TARGET = "target.yaml"


def camera(command: CameraCommand, terminal: Terminal) -> int:
    """Calibrate, write the folder of the result, and return the exit code."""
    from ..calibrate.camera_reading import read_camera_views
    from ..calibrate.cameras import calibrate_cameras
    from ..writers.camera_files import save_camera_files

    folder = command.output or default_folder((command.recording,), "camera")
    target, taken = _target(command)
    refuse_overwriting(folder, command.recording, {"cam": command.cam, "target": target}, CAMERA_FILES)
    with result_folder(folder, "camera", own=CAMERA_FILES) as staging:
        terminal.progress("reading the recording")
        recording, board = read_camera_views(
            command.recording,
            target=target,
            cam=command.cam,
            resolution=command.resolution,
            units=command.units,
            topics=topics_of(command.topics),
            workers=command.workers,
            cache=folder if command.cache else None,
            progress=terminal.progress,
        )
        recording = replace(recording, assumptions=(*taken, *recording.assumptions))
        terminal.close()
        say_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
        result = calibrate_cameras(recording, board, _options(command), progress=terminal.progress)
        terminal.progress("writing the result")
        save_camera_files(result, board, staging)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    _say_result(result, folder, terminal)
    document = result_document(result.calibration, folder, recording.assumptions, CAMERA_FILES)
    if result.calibration.verdict != "fail":
        terminal.say("")
        _propose(command, folder, target, terminal)
    terminal.document({**document, **_lenses(result)})
    return exit_code(result.calibration)


def _options(command: CameraCommand) -> CameraOptions:
    """Return the options with the lens models of the program that shall read the result, where one is named."""
    if command.program is None:
        return command.options
    return replace(command.options, among=refit_models(command.program))


def _target(command: CameraCommand) -> tuple[Path, tuple[str, ...]]:
    """Return the file of the board, and a sentence where it was not named."""
    place = command.recording
    if not place.exists():
        raise RecordingError(f"{place}: there is no such file or folder. Check the path.")
    if command.target is not None:
        return command.target, ()
    folder = place if place.is_dir() else place.parent
    if (folder / _TARGET).is_file():
        return folder / _TARGET, (f"{_TARGET} in the recording's folder is used.",)
    raise OptionError(NO_TARGET.format(folder=folder))


def _say_result(result: "Result", folder: Path, terminal: Terminal) -> None:
    from .camera_summary import baseline_lines, facts, parameter_table, trial_table
    from .summary import held_facts, trust_facts

    calibration = result.calibration
    say_verdict(calibration, terminal)
    trusted = (*trust_facts(calibration.assessment.trust), *held_facts(calibration))
    terminal.say("\n".join([*facts(result), *trusted]))
    say_advice(calibration, terminal)
    for table in (trial_table(result), *(parameter_table(calibration, name) for name in calibration.cameras)):
        terminal.say("")
        terminal.draw(table)
    if lines := list(baseline_lines(calibration)):
        terminal.say("\n" + "\n".join(lines))
    say_files(folder, terminal, CAMERA_FILES)


def _propose(command: CameraCommand, folder: Path, target: Path, terminal: Terminal) -> None:
    """Say how to go on: with the IMU of this recording where it has one, else with that of another."""
    from ..readers.images.image_recording import holds_imu

    here = holds_imu(command.recording)
    stated = ["--topics", *command.topics] if here and command.topics else []
    words = ("--target", target, "--cam", folder / "calibration.yaml", *stated)
    terminal.propose("camera-imu", command.recording if here else "RECORDING", *words)


def _lenses(result: "Result") -> dict[str, Any]:
    from ..diagnostics import CamerasDiagnostics
    from .camera_summary import programs_reading

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CamerasDiagnostics)
    return {
        "noise": [asdict(level) for level in diagnostics.noise],
        "trials": [asdict(trial) for trial in diagnostics.trials],
        "read_by": programs_reading(result.calibration),
    }
