"""The acceleration that a camera's positions tell, and an IMU's readings averaged as it is.

A second difference of positions is the acceleration averaged with a triangular window of two steps.
"""

import numpy as np

from ....recording import Floats, Integers
from .board_poses import BoardPoses

STEP_S = 0.1
"""Step of the second differences."""

OFFSETS_S = np.linspace(-1, 1, 21)[1:-1] * STEP_S
"""Instants (k,) about a frame at which readings are taken [s]."""

TRIANGLE = (1 - np.abs(OFFSETS_S) / STEP_S) / (1 - np.abs(OFFSETS_S) / STEP_S).sum()
"""Their weights (k,)."""

DIFFERENCE = np.sign(OFFSETS_S) / (9 * STEP_S)
"""Weights (k,) for the derivative: the means of both sides, which are a step apart [1/s]."""


def camera_accelerations(poses: BoardPoses, time_shift_s: float) -> tuple[Integers, Floats, Floats]:
    """Return frames that have neighbours at about a step before and after, and the camera's acceleration there.

    The step is STEP_S, or from frame to frame where these are rarer.

    Parameters
    ----------
    poses : of the board
    time_shift_s : t_imu = t_cam + time_shift_s

    Returns
    -------
    frame : (m,) indices into the poses
    acceleration : (m, 3) in the frame of the board [m/s^2]
    at_s : (m, k) instants of the IMU over which `averaged_readings` goes [s]
    """
    t_s = poses.t_s + time_shift_s
    step_s = max(STEP_S, float(np.median(np.diff(t_s)))) if len(t_s) > 1 else STEP_S
    position = -np.einsum("nji,nj->ni", poses.R_cam_target, poses.p_cam_target)
    before, after = _nearest(t_s, t_s - step_s), _nearest(t_s, t_s + step_s)
    back, ahead = t_s - t_s[before], t_s[after] - t_s
    usable = (np.abs(back - step_s) < 0.5 * step_s) & (np.abs(ahead - step_s) < 0.5 * step_s)
    frame = np.flatnonzero(usable)
    before, after, back, ahead = before[frame], after[frame], back[frame][:, None], ahead[frame][:, None]
    slope_after = (position[after] - position[frame]) / ahead
    slope_before = (position[frame] - position[before]) / back
    at_s = t_s[frame][:, None] + OFFSETS_S * (step_s / STEP_S)
    return frame, 2 * (slope_after - slope_before) / (back + ahead), at_s


def _nearest(t_s: Floats, at_s: Floats) -> Integers:
    """Return which of instants (n,), ascending, is nearest to others (m,)."""
    if len(t_s) < 2:
        return np.zeros(len(at_s), dtype=np.int64)
    after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    return after - (at_s - t_s[after - 1] < t_s[after] - at_s)


def averaged_readings(at_s: Floats, t_s: Floats, values: Floats, weights: Floats = TRIANGLE) -> Floats:
    """Return readings (n, 3) with timestamps (n,) [s] at instants (m, k) [s], summed with weights (k,), (m, 3)."""
    return np.stack([np.interp(at_s, t_s, values[:, i]) @ weights for i in range(3)], axis=1)


def averaged_derivative(at_s: Floats, t_s: Floats, values: Floats) -> Floats:
    """Return the derivative of readings as `averaged_readings` takes them, (m, 3)."""
    longer = (at_s[:, -1] - at_s[:, 0]) / (OFFSETS_S[-1] - OFFSETS_S[0])
    return averaged_readings(at_s, t_s, values, DIFFERENCE) / longer[:, None]
