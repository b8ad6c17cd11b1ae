"""The command apply: a calibration and a recording -> specific force and angular rate."""

import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import OptionError
from . import commands
from .results import USABLE
from .terminal import Terminal


def apply(command: commands.Apply, terminal: Terminal) -> int:
    """Write the corrected samples of a recording, and return the exit code."""
    from ..readers import load
    from ..units import Units
    from ..writers.apply import apply_files

    source = command.recording
    imus = load(command.calibration).imus
    if not imus:
        raise OptionError(
            f"{command.calibration}: this calibration is of cameras alone; only samples of an IMU are corrected. Give "
            "the calibration of the IMU."
        )
    name = _chosen_imu(command, tuple(imus))
    imu = imus[name]
    rows = apply_files(
        imu,
        *_tables(source.paths, name),
        output=command.output,
        columns=source.columns,
        rate_hz=source.rate,
        units=None if source.units is None else Units.parse(source.units),
        imu=name,
    )
    terminal.say(f"{rows} rows in {command.output}")
    if imu.accelerometer is not None and imu.accelerometer.lever_arms_m is not None:
        terminal.say("Lever arms were not applied: each component of the specific force is that at its accelerometer.")
    terminal.document({"rows": rows, "file": str(command.output)})
    return USABLE


def _chosen_imu(command: commands.Apply, imus: tuple[str, ...]) -> str:
    """Return which IMU of a calibration recorded the samples: as stated, the only one, or by the name of the file."""
    known = f"{command.calibration}: this calibration is of {', '.join(imus)}"
    if command.imu is not None:
        if command.imu not in imus:
            raise OptionError(f"{known}, not of {command.imu}. Choose one of them with --imu.")
        return command.imu
    if len(imus) == 1:
        return imus[0]
    path = command.recording.path
    called = path.parent.name if path.stem == "data" else path.name
    named = [name for name in imus if re.match(rf"{name}(?!\d)", called)]
    if len(named) != 1:
        raise OptionError(f"{known}. Say with --imu which of them recorded {path}.")
    return named[0]


def _tables(paths: Sequence[Path], imu: str) -> Sequence[Path]:
    """Return the tables of one IMU of a folder of several; of anything else the paths themselves."""
    from ..readers.rig.camera_folder import holds_imu, imu_files, recording_folder

    if len(paths) != 1 or not paths[0].is_dir() or not holds_imu(recording_folder(paths[0])):
        return paths
    files = imu_files(recording_folder(paths[0]))
    if len(files) == 1 and imu == "imu0":
        return paths
    if imu not in files:
        raise OptionError(f"{paths[0]}: there are samples of {', '.join(files)}, and none of {imu}. Give its table.")
    return files[imu]
