"""What the commands do: read, call the library, print. Each returns its exit code."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from ..errors import OptionError
from . import commands
from .apply_actions import apply
from .camera_actions import camera
from .camera_imu_actions import camera_imu, simulate_camera_imu
from .check_actions import check
from .command_parts import PosesInput
from .compare_actions import compare
from .convert_actions import convert
from .magnetometer_actions import magnetometer, simulate_magnetometer
from .noise_actions import noise, show_noise, simulate_noise
from .places import (
    DEMO_RECORDING,
    RESULT_FILES,
    TRUTH,
    check_folder,
    default_folder,
    finish_moves,
    joined_folder,
    result_folder,
    spared_inputs,
)
from .plan_actions import plan
from .platter_actions import rate, simulate_platter_video
from .poses_actions import simulate_poses
from .prior_files import read_priors
from .results import (
    USABLE,
    calibration_document,
    exit_code,
    propose_apply,
    result_document,
    say_assumptions,
    say_needs,
    say_result,
    write_result,
)
from .simulate_cameras_actions import simulate_cameras
from .simulated import write_simulated
from .study_actions import study
from .target_actions import print_target
from .terminal import WIDTH, Terminal
from .turntable_actions import simulate_turntable, turntable
from .use_option import judged_result, read_use_option

if TYPE_CHECKING:
    from ..recording import Recording
    from ..writers.tables import Table


def _imu(command: commands.Imu, terminal: Terminal) -> int:
    from ..calibrate import calibrate_imu
    from . import summary

    check_folder(command.output or default_folder(command.recording.paths, "imu"))  # before the work
    use = read_use_option(command.use)
    terminal.progress("reading the recording")
    known = read_priors(command.options.prior)
    recordings = [known.known_of(recording) for recording in _read(command.recording)]
    terminal.close()
    assumptions = _assumptions(recordings)
    say_assumptions(assumptions, terminal)  # before anything fails: they often explain why
    paths = command.recording.paths
    folder = command.output or (default_folder(paths, "imu") if len(recordings) == 1 else joined_folder(paths, "imu"))
    with result_folder(folder, "imu") as staging:
        options = replace(command.options, prior=known.stated)
        result = calibrate_imu(recordings, options, progress=terminal.progress, prior=known.calibrations)
        result = judged_result(result, use)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    say_result(result.calibration, summary.facts(result.calibration), folder, terminal)
    propose_apply(result.calibration, folder, command.recording, terminal)
    terminal.document(result_document(result.calibration, folder, assumptions))
    return exit_code(result.calibration)


def _read(source: PosesInput) -> "tuple[Recording, ...]":
    from ..readers.several_recordings import read_several

    return read_several(*source.paths, columns=source.columns, rate_hz=source.rate, units=source.units)


def _assumptions(recordings: "Sequence[Recording]") -> list[str]:
    """Return what had to be assumed; of several recordings each once, with those of which it was."""
    from ..calibrate.preparation import recording_names

    if len(recordings) == 1:
        return list(recordings[0].assumptions)
    of: dict[str, list[str]] = {}
    for name, recording in zip(recording_names(recordings), recordings, strict=True):
        for sentence in recording.assumptions:
            of.setdefault(sentence.removeprefix(f"{name}: "), []).append(name)
    words = ["all recordings" if len(names) == len(recordings) else ", ".join(names) for names in of.values()]
    return [f"{who}: {sentence}" for who, sentence in zip(words, of, strict=True)]


def _show(command: commands.Show, terminal: Terminal) -> int:
    from ..readers import load
    from ..readers.own.noise_file import is_noise
    from ..readers.own.own_root import calibration_at, is_own
    from ..writers.tables import form_tables, summary_table

    command = replace(command, calibration=Path(calibration_at(command.calibration)))
    own = is_own(command.calibration)
    if command.use is not None and (not own or is_noise(command.calibration)):
        raise OptionError(
            f"{command.calibration}: only a calibration.yaml of gnomon's can be judged for a use: it has the standard "
            "deviations. Leave out --for."
        )
    if not own:
        return _show_foreign(command, terminal)
    if is_noise(command.calibration):
        return show_noise(command.calibration, terminal)
    calibration = load(command.calibration)
    if command.use is not None:
        from ..calibrate.judging import judge

        calibration = judge(calibration, command.use)
    say_needs(calibration, terminal)
    _say_tables((summary_table(calibration), *form_tables(calibration, command.form)), terminal)
    from . import summary

    if lines := [*summary.held_facts(calibration), *summary.advice(calibration.assessment.findings)]:
        terminal.say("\n".join(lines))
    terminal.document(calibration_document(calibration))
    return USABLE


def _show_foreign(command: commands.Show, terminal: Terminal) -> int:
    from ..readers.projects.foreign_files import load_foreign
    from ..writers.foreign_tables import foreign_document, foreign_tables

    foreign = load_foreign(command.calibration)
    say_assumptions(foreign.notes, terminal)
    _say_tables(foreign_tables(foreign, command.form), terminal)
    terminal.document(foreign_document(foreign))
    return USABLE


def _say_tables(tables: "Sequence[Table]", terminal: Terminal) -> None:
    for table in tables:
        names = max(len(row.name) for row in table.rows)
        values = max(len(row.value) for row in table.rows)
        terminal.say(table.title, "bold")
        terminal.say("\n".join(wrap(table.note, WIDTH - 1)), "dim")
        for row in table.rows:
            terminal.say(f"  {row.name:<{names}}  {row.value:>{values}}  {row.unit}".rstrip())
        terminal.say("")


def _simulate(command: commands.Simulate, terminal: Terminal) -> int:
    from ..simulate import simulate

    return write_simulated(*simulate(command.scenario, command.seed), command.output, terminal, then="imu")


def _demo(command: commands.Demo, terminal: Terminal) -> int:
    from ..calibrate import calibrate_imu
    from ..options import ImuOptions
    from ..readers import read
    from ..simulate import simulate
    from ..writers import save
    from ..writers.recording_file import save_recording
    from . import summary
    from .comparison import comparison_document, comparison_sentence, comparison_table

    with result_folder(command.output, "demo", own=(*RESULT_FILES, DEMO_RECORDING, TRUTH)) as staging:
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
    say_result(result.calibration, summary.facts(result.calibration), command.output, terminal, parameters=False)
    document = result_document(result.calibration, command.output, recording.assumptions)
    terminal.document({**document, "comparison": comparison_document(result.calibration, truth)})
    return exit_code(result.calibration)


_ACTIONS: dict[type[commands.Command], Callable[[Any, Terminal], int]] = {
    commands.Imu: _imu,
    commands.CameraCommand: camera,
    commands.CameraImu: camera_imu,
    commands.Turntable: turntable,
    commands.Rate: rate,
    commands.Magnetometer: magnetometer,
    commands.Noise: noise,
    commands.Check: check,
    commands.Plan: plan,
    commands.PlanImu: plan,
    commands.PrintTarget: print_target,
    commands.Show: _show,
    commands.Apply: apply,
    commands.Convert: convert,
    commands.Compare: compare,
    commands.Simulate: _simulate,
    commands.SimulatePoses: simulate_poses,
    commands.SimulateTurntable: simulate_turntable,
    commands.SimulatePlatterVideo: simulate_platter_video,
    commands.SimulateMagnetometer: simulate_magnetometer,
    commands.SimulateNoise: simulate_noise,
    commands.SimulateCameras: simulate_cameras,
    commands.SimulateCameraImu: simulate_camera_imu,
    commands.Study: study,
    commands.Demo: _demo,
}


def run(command: commands.Command, terminal: Terminal) -> int:
    """Carry out a command and return its exit code."""
    finish_moves(command)
    with spared_inputs(command):
        return _ACTIONS[type(command)](command, terminal)
