"""Axes of a moving accelerometer that are reversed or exchanged half-way, by what a camera saw of the motion.

Each axis reads a linear map of attitude and acceleration, which is fitted by least squares. It is fitted once more to
readings that are put together from two axes, or an axis and its mirror image, at any instant k: with Q an orthonormal
basis of the design's columns what remains is |y|^2 - |Q' y|^2, and both terms are sums before and after k.
"""

import numpy as np

from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...findings import Finding, make_finding
from ...recording import Floats
from .rig_axes import felt_force

_BETTER, _LEFT = 0.1, 0.1  # what a change leaves, of what no change leaves and of the readings' power
_LEAST = 0.05  # of the frames, on either side


def check_accelerometer_change(poses: BoardPoses, stream: ImuStream, time_shift_s: float, imu: str) -> list[Finding]:
    """Return a problem where axes of the accelerometer are others from one instant on (code axes-changed).

    Parameters
    ----------
    poses, stream : of the board, of the IMU
    time_shift_s : t_imu - t_cam, about
    imu : its name
    """
    felt = felt_force(poses, stream, time_shift_s)
    if felt is None:
        return []
    t_s, design, read = felt
    changes = [one for axis in range(3) if (one := _change(design, read, axis)) is not None]
    if not changes:
        return []
    told = ", ".join(f"{'xyz'[axis]} reads what would have been {source}" for axis, source, _ in changes)
    at_s = float(np.median([t_s[k] for *_, k in changes]) - stream.t_s[0])
    return [make_finding("axes-changed/rig", label=imu, read=told, at_s=at_s)]


def _change(design: Floats, read: Floats, axis: int) -> tuple[int, str, int] | None:
    """Return the axis, what it reads later, such as -x, and the first frame of that; None where nothing changes."""
    basis, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
    part = np.cumsum(basis[:, None, :] * read[:, :, None], axis=0)  # (n, 3, p)
    power = np.cumsum(read**2, axis=0)
    same = float(power[-1, axis] - (part[-1, axis] ** 2).sum())
    edge = max(1, round(_LEAST * len(read)))
    best: tuple[float, str, int] | None = None
    for source in range(3):
        for sign in (1, -1):
            if (source, sign) == (axis, 1):
                continue
            own = part[:-1, axis] + sign * (part[-1, source] - part[:-1, source])
            whole = power[:-1, axis] + power[-1, source] - power[:-1, source]
            left = (whole - (own**2).sum(axis=1))[edge:-edge]
            k = int(np.argmin(left))
            if left[k] < _BETTER * same and left[k] < _LEFT * whole[edge + k] and (best is None or left[k] < best[0]):
                best = float(left[k]), f"{'-' if sign < 0 else ''}{'xyz'[source]}", edge + k + 1
    return None if best is None else (axis, best[1], best[2])
