"""How a rig is waved before a board: a path in closed form, with exact derivatives, that no spline can represent.

Every coordinate of the path is a sum of sinusoids whose frequencies have no common measure. The camera stands at the
end of an arm of length r that turns about the middle of the board, and is shaken there:

    p_target_cam = middle + Ry(azimuth) Rx(elevation) (0, 0, r) + shake
    R_target_cam = Ry(azimuth) Rx(elevation) diag(1, -1, -1) Rz(roll) Ry(yaw) Rx(pitch)

so that it looks at the board but for yaw and pitch. Rates follow from each factor in turn: with R = A B, where B turns
about its own axis e by an angle b,

    omega = B' omega_A + e b',      alpha = B' alpha_A + e b'' - e b' x B' omega_A.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from ..geometry.quaternion import Floats
from ..geometry.so3 import skew

COORDINATES = ("azimuth", "elevation", "range", "roll", "yaw", "pitch", "shake_x", "shake_y", "shake_z")
TURNS, SHAKES = (3, 4, 5), (6, 7, 8)

BLOCK = 4096
"""Instants that are evaluated at a time; small enough for the cache."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigidMotion:
    """Motion of a body at n instants.

    Attributes
    ----------
    R_target_body : (n, 3, 3)
    p_target_body : (n, 3) origin of the body in the target's frame [m]
    velocity, acceleration : (n, 3) of that origin, in the target's frame [m/s], [m/s^2]
    omega, alpha : (n, 3) angular rate and acceleration against the target, in the body's frame [rad/s], [rad/s^2]
    """

    R_target_body: Floats
    p_target_body: Floats
    velocity: Floats
    acceleration: Floats
    omega: Floats
    alpha: Floats

    def of(self, T_body_other: Floats) -> Self:
        """Return the motion of another frame of the same rigid body, p_body = T_body_other @ p_other, (4, 4)."""
        R, arm = T_body_other[:3, :3], T_body_other[:3, 3]
        spin = skew(self.omega)
        turning = spin @ arm
        bending = skew(self.alpha) @ arm + np.einsum("nij,nj->ni", spin, turning)
        return type(self)(
            R_target_body=self.R_target_body @ R,
            p_target_body=self.p_target_body + self.R_target_body @ arm,
            velocity=self.velocity + np.einsum("nij,nj->ni", self.R_target_body, turning),
            acceleration=self.acceleration + np.einsum("nij,nj->ni", self.R_target_body, bending),
            omega=self.omega @ R,
            alpha=self.alpha @ R,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPath:
    """Path of cam0.

    Attributes
    ----------
    middle : (3,) of the board [m]
    offset, slope : (9,) constant part and constant rate of each coordinate, in the order of COORDINATES [rad or m]
    pulsation, phase : (k,) of each sinusoid [rad/s], [rad]
    amplitude : (9, k) of each sinusoid in each coordinate; each belongs to one [rad or m]
    """

    middle: Floats
    offset: Floats
    slope: Floats
    pulsation: Floats
    phase: Floats
    amplitude: Floats

    def at(self, t_s: Floats) -> RigidMotion:
        """Return the motion of the camera at instants (n,) [s]."""
        parts = [self._motion(t_s[i : i + BLOCK]) for i in range(0, len(t_s), BLOCK)] or [self._motion(t_s)]
        if len(parts) == 1:
            return parts[0]
        return RigidMotion(
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in RigidMotion.__slots__}
        )

    def pose(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_target_cam (n, 3, 3) and p_target_cam (n, 3) [m] at instants (n,) [s]."""
        R, p = np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 3))
        for i in range(0, len(t_s), BLOCK):
            rows = slice(i, i + BLOCK)
            coordinates = self._values(t_s[rows], np.sin(self._argument(t_s[rows])))
            arm = _turned(_turned(_identity(len(coordinates[0])), 1, coordinates[0]), 0, coordinates[1])
            p[rows] = (self.middle[:, None] + arm[:, 2] * coordinates[2] + coordinates[6:]).T
            R[rows] = np.moveaxis(_looking(arm, coordinates), -1, 0)
        return R, p

    def _argument(self, t_s: Floats) -> Floats:
        return self.pulsation[:, None] * t_s + self.phase[:, None]

    def _values(self, t_s: Floats, sine: Floats) -> Floats:
        return self.amplitude @ sine + self.slope[:, None] * t_s + self.offset[:, None]

    def coordinates(self, t_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the coordinates and their first and second derivatives, each (9, n)."""
        argument = self._argument(t_s)
        sine, cosine = np.sin(argument), np.cos(argument)
        speed = self.amplitude * self.pulsation
        return (
            self._values(t_s, sine),
            speed @ cosine + self.slope[:, None],
            -(speed * self.pulsation) @ sine,
        )

    def _motion(self, t_s: Floats) -> RigidMotion:
        return motion_of(self.middle, *self.coordinates(t_s))


def motion_of(middle: Floats, value: Floats, rate: Floats, curvature: Floats) -> RigidMotion:
    """Return the motion of a camera from the coordinates of its path and their derivatives, each (9, n)."""
    zero = np.zeros((3, value.shape[1]))
    turns = list(zip(value, rate, curvature, strict=True))
    omega, alpha = _spun(*_spun(zero, zero, 1, turns[0]), 0, turns[1])
    arm = _turned(_turned(_identity(value.shape[1]), 1, value[0]), 0, value[1])
    # the end of the arm, (0, 0, r) in the arm's frame
    r, dr, ddr = value[2], rate[2], curvature[2]
    along = np.stack([omega[1] * r, -omega[0] * r, dr])
    across = np.stack([2 * omega[1] * dr + alpha[1] * r, -2 * omega[0] * dr - alpha[0] * r, ddr])
    across += _cross(omega, np.stack([omega[1] * r, -omega[0] * r, np.zeros_like(r)]))
    # diag(1, -1, -1): the camera looks back along the arm
    omega[1:], alpha[1:] = -omega[1:], -alpha[1:]
    for axis, i in ((2, 3), (1, 4), (0, 5)):
        omega, alpha = _spun(omega, alpha, axis, turns[i])
    return RigidMotion(
        R_target_body=np.ascontiguousarray(np.moveaxis(_looking(arm, value), -1, 0)),
        p_target_body=(middle[:, None] + arm[:, 2] * r + value[6:]).T,
        velocity=(np.einsum("ijn,jn->in", arm, along) + rate[6:]).T,
        acceleration=(np.einsum("ijn,jn->in", arm, across) + curvature[6:]).T,
        omega=omega.T,
        alpha=alpha.T,
    )


def _looking(arm: Floats, value: Floats) -> Floats:
    turned = arm * np.array([1.0, -1.0, -1.0])[:, None]
    for axis, i in ((2, 3), (1, 4), (0, 5)):
        turned = _turned(turned, axis, value[i])
    return turned


def _identity(n: int) -> Floats:
    return np.repeat(np.eye(3)[:, :, None], n, axis=2)


def _turned(R: Floats, axis: int, angle: Floats) -> Floats:
    """Return R (3, 3, n) times the rotations about a coordinate axis by angles (n,)."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    turned = R.copy()
    turned[:, j] = c * R[:, j] + s * R[:, k]
    turned[:, k] = c * R[:, k] - s * R[:, j]
    return turned


def _spun(omega: Floats, alpha: Floats, axis: int, angle: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats]:
    """Return angular rate and acceleration (3, n) after a further turn about a coordinate axis.

    `angle` is the turn's angle with its first and second derivative, each (n,).
    """
    j, k = (axis + 1) % 3, (axis + 2) % 3
    b, rate, curvature = angle
    c, s = np.cos(b), np.sin(b)
    w, a = omega.copy(), alpha.copy()
    w[j], w[k] = c * omega[j] + s * omega[k], c * omega[k] - s * omega[j]
    a[j], a[k] = c * alpha[j] + s * alpha[k] + rate * w[k], c * alpha[k] - s * alpha[j] - rate * w[j]
    w[axis] += rate
    a[axis] += curvature
    return w, a


def _cross(u: Floats, v: Floats) -> Floats:
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
