"""A trajectory in the TUM format: timestamp tx ty tz qx qy qz qw, one line an instant."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import OptionError
from ..output import atomic_file
from ..recording import Floats, ImuSamples, Integers, Poses, Recording
from ..results.camera_diagnostics import TrajectoryTrack
from .recording_file import save_recording

TRAJECTORY_FILE = "trajectory.txt"

_HEADER = """\
# Pose of imu0 in the target's frame at the timestamps of the IMU, made by gnomon: p_target = R(q) p_imu + t.
# timestamp [s] tx ty tz [m] qx qy qz qw (Hamilton)
"""
_S_NS = 1_000_000_000


def trajectory_text(track: TrajectoryTrack) -> str:
    """Return the text of a trajectory; timestamps are exact to 1 ns, positions to 1 nm, quaternions to 1e-12."""
    q_xyzw = np.asarray(track.q_target_imu_wxyz)[:, [1, 2, 3, 0]]
    numbers = np.column_stack([track.p_target_imu, q_xyzw]).tolist()
    form = " ".join(["%s", *["%.9f"] * 3, *["%.12f"] * 4, ""]).rstrip() + "\n"
    stamps = seconds_texts(track.t_ns)
    return _HEADER + "".join(form % (stamp, *row) for stamp, row in zip(stamps, numbers, strict=True))


def seconds_texts(t_ns: Integers) -> list[str]:
    """Return timestamps (n,) [ns] as seconds with nine decimals, without a detour over floats.

    Examples
    --------
    >>> seconds_texts(np.array([1600000000005000001, -1, 0]))
    ['1600000000.005000001', '-0.000000001', '0.000000000']
    """
    seconds, rest = np.divmod(np.abs(t_ns), _S_NS)
    signs = ["-" if negative else "" for negative in (np.asarray(t_ns) < 0).tolist()]
    parts = zip(signs, seconds.tolist(), rest.tolist(), strict=True)
    return [f"{sign}{whole}.{fraction:09d}" for sign, whole, fraction in parts]


_AXES = "xyz"


def save_poses(poses: Poses, path: str | Path) -> None:
    """Write a table of averaged poses, one row each; the columns are documented in `gnomon.readers.samples.poses`.

    Parameters
    ----------
    poses : the averages
    path : ends in .csv

    Raises
    ------
    OptionError
        If the suffix is another one.
    OutputError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise OptionError(f"{path}: a table of poses is written as .csv.")
    header, columns = ["pose"], list[list[str]]([[name.replace(",", " ") for name in poses.name]])

    def add(names: list[str], values: Floats | None, unit: str) -> None:
        if values is not None:
            header.extend(f"{name} [{unit}]" for name in names)
            columns.extend([repr(float(x)) for x in column] for column in values.reshape(len(poses), -1).T)

    add(["t"], poses.t_s, "s")
    add([f"a{axis}" for axis in _AXES], poses.accelerometer, poses.accelerometer_unit)
    add([f"sigma_a{axis}" for axis in _AXES], poses.accelerometer_sigma, poses.accelerometer_unit)
    add([f"g{axis}" for axis in _AXES], poses.gyroscope, poses.gyroscope_unit)
    add([f"sigma_g{axis}" for axis in _AXES], poses.gyroscope_sigma, poses.gyroscope_unit)
    add([f"ref_{axis}" for axis in _AXES], poses.specific_force, "m/s^2")
    if poses.samples is not None:
        header.append("samples")
        columns.append([str(int(count)) for count in poses.samples])
    rows = [",".join(row) for row in zip(*columns, strict=True)]
    with atomic_file(path) as stream:
        stream.write(("\n".join([",".join(header), *rows]) + "\n").encode())


def save_pose_files(poses: Sequence[ImuSamples], folder: Path) -> list[Path]:
    """Write the samples of each pose into a file of its own, pose01.csv and so on, and return them.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    digits = len(str(len(poses)))
    files: list[Path] = []
    for k, samples in enumerate(poses, start=1):
        files += save_recording(Recording(imus={"imu0": samples}), folder / f"pose{k:0{digits}}.csv")
    return files
