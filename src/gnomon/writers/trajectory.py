"""A trajectory in the TUM format: timestamp tx ty tz qx qy qz qw, one line an instant."""

import numpy as np

from ..diagnostics import TrajectoryTrack
from ..recording import Integers

TRAJECTORY_FILE = "trajectory.txt"

_HEADER = """\
# Pose of imu0 in the target's frame at the stamps of the IMU, made by gnomon: p_target = R(q) p_imu + t.
# timestamp [s] tx ty tz [m] qx qy qz qw (Hamilton)
"""
_S_NS = 1_000_000_000


def trajectory_text(track: TrajectoryTrack) -> str:
    """Return the text of a trajectory; stamps are exact to the nanosecond, positions to 1 nm, quaternions to 1e-12."""
    q_xyzw = np.asarray(track.q_target_imu_wxyz)[:, [1, 2, 3, 0]]
    numbers = np.column_stack([track.p_target_imu, q_xyzw]).tolist()
    form = " ".join(["%s", *["%.9f"] * 3, *["%.12f"] * 4, ""]).rstrip() + "\n"
    stamps = seconds_texts(track.t_ns)
    return _HEADER + "".join(form % (stamp, *row) for stamp, row in zip(stamps, numbers, strict=True))


def seconds_texts(t_ns: Integers) -> list[str]:
    """Return stamps (n,) [ns] as seconds with nine decimals, without a detour over floats.

    Examples
    --------
    >>> seconds_texts(np.array([1600000000005000001, -1, 0]))
    ['1600000000.005000001', '-0.000000001', '0.000000000']
    """
    seconds, rest = np.divmod(np.abs(t_ns), _S_NS)
    signs = ["-" if negative else "" for negative in (np.asarray(t_ns) < 0).tolist()]
    parts = zip(signs, seconds.tolist(), rest.tolist(), strict=True)
    return [f"{sign}{whole}.{fraction:09d}" for sign, whole, fraction in parts]
