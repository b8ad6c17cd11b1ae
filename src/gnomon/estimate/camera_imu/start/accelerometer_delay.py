"""A first guess of the delay between the accelerometer and the gyroscope of an IMU.

The camera's own acceleration is told by its positions (`camera_acceleration`). At each delay of a grid
gravity g, the place p of the accelerometer and its bias b are fitted in

    f = R_cam_imu' (R_cam_target (a - g)) + A p + b,     A = [alpha]x + [omega]x^2 by the gyroscope,

with f averaged as the second difference averages; the delay that leaves least is taken.
"""

import numpy as np

from ....geometry.rotation_vector import acceleration_by_place
from .alignment import Alignment
from .board_poses import BoardPoses, averaged_derivative, averaged_readings, camera_accelerations
from .first_guess import ImuStream

_GRID_S = np.arange(-0.06, 0.0601, 0.002)
_FEWEST = 10  # accelerations
_EXPLAINED = 0.5
"""Share of the scatter of the specific force that has to be explained."""


def accelerometer_delay(alignment: Alignment, poses: BoardPoses, stream: ImuStream) -> float:
    """Return t_gyroscope - t_accelerometer of the timestamps of one instant [s]; zero where nothing tells it.

    Parameters
    ----------
    alignment, poses : of a camera, and to this IMU
    stream : its readings by their timestamps
    """
    centre, acceleration, at_s = camera_accelerations(poses, alignment.time_shift_s)
    if len(centre) < _FEWEST:
        return 0.0
    R_imu_target = alignment.R_cam_imu.T @ poses.R_cam_target[centre]
    omega = averaged_readings(at_s, stream.t_s, stream.rate)
    alpha = averaged_derivative(at_s, stream.t_s, stream.rate)
    columns = np.concatenate(
        [-R_imu_target, acceleration_by_place(omega, alpha), np.broadcast_to(np.eye(3), R_imu_target.shape)], axis=2
    ).reshape(-1, 9)
    basis = np.linalg.qr(columns)[0]
    known = np.einsum("nij,nj->ni", R_imu_target, acceleration)
    left = np.empty(len(_GRID_S))
    for k, delay in enumerate(_GRID_S):
        error = (averaged_readings(at_s - delay, stream.t_s, stream.force) - known).ravel()
        left[k] = error @ error - np.square(basis.T @ error).sum()
    best = int(np.argmin(left))
    force = averaged_readings(at_s, stream.t_s, stream.force)
    if not 0 < best < len(left) - 1 or left[best] > _EXPLAINED * float(np.square(force - force.mean(axis=0)).sum()):
        return 0.0
    before, least, after = left[best - 1 : best + 2]
    step = _GRID_S[1] - _GRID_S[0]
    return float(_GRID_S[best] + 0.5 * step * (before - after) / (before - 2 * least + after))
