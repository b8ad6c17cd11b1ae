"""What an IMU tells of the motion between instants, whatever the motion before (Forster et al., T-RO 2017).

With R, v, p attitude, velocity and position of the body in the world, and gravity g, over an interval of length h

    R' = R dR,    v' = v + g h + R dv,    p' = p + v h + g h^2 / 2 + R dp.

dR, dv, dp depend on the biases, to first order by Jacobians: dR(b + e) = dR Exp(J e).
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import right_jacobian, rotation_from_rotvec
from ...geometry.so3 import skew
from ...recording import Floats


@value_class
class Increments:
    """Motion over k intervals.

    Attributes
    ----------
    length_s : (k,) [s]
    rotation : (k, 3, 3) dR
    velocity, position : (k, 3) dv [m/s], dp [m]
    by_bias : (k, 9, 6) derivatives of rotation (right), velocity and position by the biases of gyroscope and
        accelerometer
    covariance : (k, 9, 9) by the white noise of both, in the same order
    """

    length_s: Floats
    rotation: Floats
    velocity: Floats
    position: Floats
    by_bias: Floats
    covariance: Floats


def preintegrate_imu(
    t_s: Floats, rate: Floats, force: Floats, instants_s: Floats, densities: tuple[float, float]
) -> Increments:
    """Return the motion between neighbouring instants, by the rule of midpoints of linearly interpolated readings.

    Parameters
    ----------
    t_s : (n,) of the readings [s]
    rate, force : (n, 3) angular rate [rad/s] and specific force [m/s^2], body frame, less the biases of the start
    instants_s : (k + 1,) within the readings, rising [s]
    densities : of the white noise of gyroscope [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)]
    """
    length_s = np.diff(instants_s)
    steps = max(1, round(float(np.median(length_s)) / float(np.median(np.diff(t_s)))))
    k, h = len(length_s), length_s / steps
    middles = instants_s[:-1, None] + h[:, None] * (np.arange(steps) + 0.5)
    omega, f = (
        np.stack([np.interp(middles, t_s, values[:, axis]) for axis in range(3)], axis=-1) for values in (rate, force)
    )
    rotation, velocity, position = np.tile(np.eye(3), (k, 1, 1)), np.zeros((k, 3)), np.zeros((k, 3))
    by_bias, covariance = np.zeros((k, 9, 6)), np.zeros((k, 9, 9))
    across = h[:, None, None]
    noise = (densities[0] ** 2 * across, densities[1] ** 2 * across)
    for step in range(steps):
        turn = omega[:, step] * h[:, None]
        half = rotation_from_rotvec(turn / 2)
        middle = rotation @ half
        pushed = np.einsum("kij,kj->ki", middle, f[:, step])
        by_turn = -middle @ skew(f[:, step])  # of the force in the interval's first frame, by a turn at its middle
        step_by, by_rate = np.swapaxes(half @ half, 1, 2), right_jacobian(turn) * across
        whole = np.tile(np.eye(9), (k, 1, 1))
        whole[:, :3, :3] = step_by
        whole[:, 3:6, :3] = by_turn @ np.swapaxes(half, 1, 2) * across
        whole[:, 6:, :3] = whole[:, 3:6, :3] * across / 2
        whole[:, 6:, 3:6] = np.eye(3) * across
        own = np.zeros((k, 9, 6))
        own[:, :3, :3] = -by_rate
        own[:, 3:6, :3] = -by_turn * across**2 / 2
        own[:, 3:6, 3:] = -middle * across
        own[:, 6:, :] = own[:, 3:6, :] * across / 2
        by_bias = whole @ by_bias + own
        scattered = own[:, :, :3] @ np.swapaxes(own[:, :, :3], 1, 2) / across**2 * noise[0]
        scattered += own[:, :, 3:] @ np.swapaxes(own[:, :, 3:], 1, 2) / across**2 * noise[1]
        covariance = whole @ covariance @ np.swapaxes(whole, 1, 2) + scattered
        position = position + velocity * h[:, None] + pushed * h[:, None] ** 2 / 2
        velocity = velocity + pushed * h[:, None]
        rotation = middle @ half
    return Increments(
        length_s=length_s,
        rotation=rotation,
        velocity=velocity,
        position=position,
        by_bias=by_bias,
        covariance=covariance,
    )
