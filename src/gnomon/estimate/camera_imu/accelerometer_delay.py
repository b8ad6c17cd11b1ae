"""A first guess of the delay between the accelerometer and the gyroscope of an IMU.

The camera's own acceleration is the second difference of its positions (`first_guess.upright`). At each delay of a grid
gravity g, the place p of the accelerometer and its bias b are fitted in

    f = R_cam_imu' (R_cam_target (a - g)) + A p + b,     A = [alpha]x + [omega]x^2 by the gyroscope,

with f averaged as the second difference averages; the delay that leaves least is taken.
"""

import numpy as np

from ...geometry.rigid_body import acceleration_by_place
from ...recording import Floats
from .alignment import Alignment
from .board_poses import BoardPoses
from .first_guess import STEP_S, ImuStream, second_differences

_GRID_S = np.arange(-0.06, 0.0601, 0.002)
_EXPLAINED = 0.5
"""Share of the scatter of the specific force that has to be explained."""


def accelerometer_delay(alignment: Alignment, poses: BoardPoses, stream: ImuStream) -> float:
    """Return t_gyroscope - t_accelerometer of the stamps of one instant [s]; zero where nothing tells it.

    Parameters
    ----------
    alignment, poses : of a camera, and to this IMU
    stream : its readings by their stamps
    """
    t_s = poses.t_s + alignment.time_shift_s
    position = -np.einsum("nji,nj->ni", poses.R_cam_target, poses.p_cam_target)
    centre, acceleration = second_differences(t_s, position)
    if len(centre) < 10:
        return 0.0
    R_imu_target = alignment.R_cam_imu.T @ poses.R_cam_target[centre]
    offsets = np.linspace(-1, 1, 21)[1:-1] * STEP_S
    weights = (1 - np.abs(offsets) / STEP_S) / (1 - np.abs(offsets) / STEP_S).sum()
    at = t_s[centre][:, None] + offsets

    def averaged(values: Floats, times: Floats, by: Floats) -> Floats:
        return np.stack([np.interp(times, stream.t_s, values[:, i]) @ by for i in range(3)], axis=1)

    omega = averaged(stream.rate, at, weights)
    alpha = averaged(stream.rate, at, np.sign(offsets) / (9 * STEP_S))  # of the means of both sides, a step apart
    columns = np.concatenate(
        [-R_imu_target, acceleration_by_place(omega, alpha), np.broadcast_to(np.eye(3), R_imu_target.shape)], axis=2
    ).reshape(-1, 9)
    basis = np.linalg.qr(columns)[0]
    known = np.einsum("nij,nj->ni", R_imu_target, acceleration)
    left = np.empty(len(_GRID_S))
    for k, delay in enumerate(_GRID_S):
        error = (averaged(stream.force, at - delay, weights) - known).ravel()
        left[k] = error @ error - np.square(basis.T @ error).sum()
    best = int(np.argmin(left))
    force = averaged(stream.force, at, weights)
    if not 0 < best < len(left) - 1 or left[best] > _EXPLAINED * float(np.square(force - force.mean(axis=0)).sum()):
        return 0.0
    before, least, after = left[best - 1 : best + 2]
    step = _GRID_S[1] - _GRID_S[0]
    return float(_GRID_S[best] + 0.5 * step * (before - after) / (before - 2 * least + after))
