"""A first guess of where the IMU is in the camera's frame.

The camera's own acceleration a is told by its positions (`camera_acceleration`). The place r of the IMU, seen from the
camera, gravity g and the accelerometer's bias b are fitted in

    f = R_cam_imu' R_cam_target (a - g) + A r + b,     A = [alpha]x + [omega]x^2 by the gyroscope,

with f and A averaged as the second difference averages. From there the batch estimation starts nearer: a metre off,
where the rig is shaken, readings are wrong by thousands of their sigmas.
"""

import numpy as np

from ....geometry.rotation_vector import skew
from ....recording import Floats
from .alignment import Alignment
from .board_poses import BoardPoses
from .camera_acceleration import averaged_derivative, averaged_readings, camera_accelerations
from .first_guess import ImuStream

_FEWEST = 20  # frames with an acceleration
_ROUNDS, _ROBUST = 3, 3.0
_USUAL = np.array([1.0] * 3 + [np.inf] * 3 + [5.0] * 3)
"""Place [m], gravity and bias [m/s^2] as they are without any measurement."""


def first_place(alignment: Alignment, poses: BoardPoses, stream: ImuStream, delay_s: float = 0.0) -> Floats:
    """Return p_cam_imu (3,) [m], drawn to zero where the recording hardly tells it.

    Parameters
    ----------
    alignment, poses : of the camera
    stream : of the IMU
    delay_s : t_gyroscope - t_accelerometer of the timestamps of one instant
    """
    centre, acceleration, at_s = camera_accelerations(poses, alignment.time_shift_s)
    good = alignment.consistent[centre] & (at_s[:, 0] >= stream.t_s[0]) & (at_s[:, -1] <= stream.t_s[-1])
    if good.sum() < _FEWEST:
        return np.zeros(3)
    at_s = at_s[good]
    R = alignment.R_cam_imu.T @ poses.R_cam_target[centre[good]]
    columns = np.concatenate([_by_place(alignment, stream, at_s), -R, np.broadcast_to(np.eye(3), R.shape)], axis=2)
    right = averaged_readings(at_s - delay_s, stream.t_s, stream.force) - np.einsum("nij,nj->ni", R, acceleration[good])
    used, found = np.ones(len(R), dtype=bool), np.zeros(9)
    scatter = float(np.sqrt(np.mean(right**2)))
    for _ in range(_ROUNDS):
        rows = columns[used].reshape(-1, 9)
        normal = rows.T @ rows / scatter**2 + np.diag(1 / _USUAL**2)
        found = np.linalg.solve(normal, rows.T @ right[used].ravel() / scatter**2)
        error = np.linalg.norm(right - columns @ found, axis=1)
        used = error <= _ROBUST * float(np.median(error))
        scatter = float(np.sqrt(np.mean(error[used] ** 2) / 3)) + 1e-9
    return alignment.R_cam_imu @ found[:3]


def _by_place(alignment: Alignment, stream: ImuStream, at_s: Floats) -> Floats:
    """Return A, averaged over instants (m, k) [s], (m, 3, 3)."""
    omega = stream.rate - alignment.gyroscope_bias
    x, y, z = omega.T
    squares = averaged_readings(at_s, stream.t_s, omega**2)
    products = averaged_readings(at_s, stream.t_s, np.stack([y * z, z * x, x * y], axis=1))
    found = skew(averaged_derivative(at_s, stream.t_s, omega)) - squares.sum(axis=1)[:, None, None] * np.eye(3)
    found += squares[:, :, None] * np.eye(3)
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        found[:, i, j] += products[:, k]
        found[:, j, i] += products[:, k]
    return found
