"""What the commands for cameras and an IMU do."""

import shlex
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OptionError, RecordingError
from . import commands
from .places import CAMERA_IMU_FILES, default_folder, result_folder
from .prior_files import read_priors
from .results import (
    USABLE,
    exit_code,
    result_document,
    say_advice,
    say_assumptions,
    say_files,
    say_verdict,
    write_result,
)
from .simulated import check_form, folder_document, replaces_simulated, say_folder
from .terminal import Terminal
from .topics import topics_of
from .use_option import judged_result, read_use_option

if TYPE_CHECKING:
    from ..diagnostics import Result
    from ..recording import Recording

_INPUTS = {
    "cam": ("camchain.yaml", "the cameras and their intrinsics"),
    "imu": ("imu.yaml", "the IMU's noise"),
    "target": ("target.yaml", "the board"),
}
"""Option -> Kalibr's file that is taken from the recording's folder, and what it describes."""

NO_TARGET = (
    "--target is missing: the file that describes the board. Name it, or put it into {folder} as target.yaml; "
    "gnomon target writes one beside the board that it prints; "
    "of an AprilGrid it holds five lines, such as target_type: aprilgrid, tagCols: 6, tagRows: 6, "
    "tagSize: 0.088 (metres), tagSpacing: 0.3 (gap over tagSize)."
)
_NO_CAM = (
    "--cam is missing: Kalibr's file of the cameras and their intrinsics, or gnomon's calibration.yaml. Name it, or "
    "put it into {folder} as camchain.yaml; gnomon camera {recording} --target {target} makes one."
)
_SIMULATED = ("imu0.csv.gz", "imu0-acc.csv.gz", "camchain.yaml", "imu.yaml", "target.yaml", "cam0", "mav0")


def camera_imu(command: commands.CameraImu, terminal: Terminal) -> int:
    """Calibrate, write the folder of the result, and return the exit code."""
    from ..calibrate import calibrate_camera_imu, read_camera_imu
    from ..writers.camera_imu_files import save_camera_imu_files

    folder = command.output or default_folder((command.recording,), "camera-imu")
    known, use = read_priors(command.options.prior), read_use_option(command.use)
    inputs, taken = kalibr_inputs(command)
    refuse_overwriting(folder, command.recording, inputs)
    with result_folder(folder, "camera-imu", own=CAMERA_IMU_FILES) as staging:
        terminal.progress("reading the recording")
        recording, target = read_camera_imu(
            command.recording,
            **inputs,
            units=command.units,
            topics=topics_of(command.topics),
            imu_table=command.imu_table,
            workers=command.workers,
            cache=folder if command.cache else None,
            progress=terminal.progress,
        )
        recording = replace(recording, assumptions=(*taken, *_noise_note(recording), *recording.assumptions))
        terminal.close()
        say_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
        recording = known.known_of(recording)
        compare = command.options.compare or command.report
        options = replace(command.options, compare=compare, prior=known.stated)
        result = calibrate_camera_imu(recording, target, options, progress=terminal.progress, prior=known.calibrations)
        result = judged_result(result, use)
        terminal.progress("writing the result")
        save_camera_imu_files(result, recording, target, staging)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    _say_result(result, folder, terminal)
    document = result_document(result.calibration, folder, recording.assumptions, CAMERA_IMU_FILES)
    if result.calibration.verdict != "fail":
        _propose(result, folder, terminal)
    terminal.document({**document, **_findings_of_the_solution(result)})
    return exit_code(result.calibration)


def _propose(result: "Result", folder: Path, terminal: Terminal) -> None:
    """Say how the result gets into a program: one that reads its lenses as they are, where there is one."""
    from .camera_summary import programs_reading

    reading = [name for name in programs_reading(result.calibration) if name != "kalibr"]  # whose files lie there
    terminal.say("")
    terminal.propose("convert", folder, "--to", (*reading, "openvins")[0])


def kalibr_inputs(command: commands.CameraImu) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return Kalibr's files by the option that names them, and sentences on those that were not named.

    Raises
    ------
    RecordingError
        If there is no such recording.
    OptionError
        If a file that is needed was not named, and is not in the recording's folder.
    """
    from ..readers.images.image_recording import tells_no_lens

    if not command.recording.exists():
        raise RecordingError(f"{command.recording}: there is no such file or folder. Check the path.")
    folder = command.recording if command.recording.is_dir() else command.recording.parent
    files: dict[str, Any] = {option: getattr(command, option) or None for option in _INPUTS}
    found = [option for option, file in files.items() if file is None and (folder / _INPUTS[option][0]).is_file()]
    files |= {option: folder / _INPUTS[option][0] for option in found}
    names = [_INPUTS[option][0] for option in found]
    taken = [f"{_listed(names)} in the recording's folder {'is' if len(names) == 1 else 'are'} used."] if names else []
    missing = [NO_TARGET.format(folder=folder)] if files["target"] is None else []
    if files["cam"] is None and tells_no_lens(command.recording):
        target = shlex.quote(str(files["target"] or "target.yaml"))
        recording = shlex.quote(str(command.recording))
        missing.append(_NO_CAM.format(folder=folder, recording=recording, target=target))
    if missing:
        raise OptionError(" ".join(missing))
    return files, tuple(taken)


def _noise_note(recording: "Recording") -> tuple[str, ...]:
    if all(samples.noise is not None for samples in recording.imus.values()):
        return ()
    return ("no imu.yaml was given: the noise of a consumer IMU is assumed until the residuals tell it.",)


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def refuse_overwriting(
    folder: Path, recording: Path, inputs: dict[str, Any], files: tuple[str, ...] = CAMERA_IMU_FILES
) -> None:
    """Refuse a folder in which the result, some `files`, would take the place of an input: both know an imu.yaml.

    Raises
    ------
    OptionError
        If the folder is that of the recording, or a file of the result would be one of the inputs.
    """
    place = folder.resolve()
    if recording.is_dir() and place == recording.resolve():
        raise OptionError(
            f"{folder}: this is the recording's folder, whose {files[-2]} the result would replace. "
            "Choose another folder with -o."
        )
    for option, file in inputs.items():
        for path in file if isinstance(file, tuple) else (file,) if file else ():
            if path.resolve() in {place / name for name in files}:
                raise OptionError(
                    f"{path}: the result would replace this file of --{option}. Choose another folder with -o."
                )


def _say_result(result: "Result", folder: Path, terminal: Terminal) -> None:
    from .camera_imu_summary import camera_lines, facts, imu_lines
    from .summary import held_facts, parameter_lines, trust_facts

    say_verdict(result.calibration, terminal)
    trusted = (*trust_facts(result.calibration.assessment.trust), *held_facts(result.calibration))
    terminal.say("\n".join([*facts(result), *trusted]))
    say_advice(result.calibration, terminal)
    poses = (*camera_lines(result.calibration), *imu_lines(result.calibration))
    terminal.say("\nestimate +- standard deviation\n" + "\n".join(poses))
    terminal.say("\nIMU; rows: sensor axes, columns: body axes")
    terminal.say("\n".join(parameter_lines(result.calibration)))
    say_files(folder, terminal, CAMERA_IMU_FILES)


def _findings_of_the_solution(result: "Result") -> dict[str, Any]:
    from ..diagnostics import CameraImuDiagnostics

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CameraImuDiagnostics)
    return {
        "noise": [asdict(level) for level in diagnostics.noise],
        "gravity_target": {"value": diagnostics.gravity_target, "sigma": diagnostics.gravity_sigma},
        "baselines": diagnostics.baselines,
    }


def simulate_camera_imu(command: commands.SimulateCameraImu, terminal: Terminal) -> int:
    """Simulate a recording, write its folder, and return the exit code."""
    from ..simulate import simulate_camera_imu
    from ..writers.camera_imu_recording import CAMERA_FILES, save_camera_imu_recording
    from ..writers.cameras_recording import CAMERAS_FILES

    folder = command.output
    replaced = replaces_simulated(folder, _SIMULATED)
    check_form(command.form, images=command.options.images)
    own = (*CAMERA_FILES, *CAMERAS_FILES) if replaced else CAMERA_FILES
    with result_folder(folder, own=own) as staging:
        terminal.progress("simulating")
        simulation = simulate_camera_imu(command.options, command.seed)
        files = save_camera_imu_recording(simulation, staging, terminal.progress, command.form)
        names = [path.relative_to(staging) for path in files]
    terminal.close()
    cameras = {name: len(frames.t_ns) for name, frames in simulation.recording.cameras.items()}
    frames = ", ".join(f"{count} frames of {name}" for name, count in cameras.items())
    samples = ", ".join(f"{len(imu.gyroscope)} samples of {name}" for name, imu in simulation.recording.imus.items())
    contents = f"{command.options.duration_s:g} s, {frames}, {samples}; {simulation.target.describe()}"
    say_folder(folder, contents, terminal, replaced=replaced)
    terminal.propose("camera-imu", folder)
    statistics = {item.name: getattr(simulation.statistics, item.name) for item in fields(simulation.statistics)}
    terminal.document(folder_document(folder, names) | {"statistics": statistics})
    return USABLE
