"""How a rig is waved before a board: a path in closed form, with exact derivatives, that no spline can represent.

Every coordinate of the path is a sum of sinusoids whose frequencies have no common measure. The camera stands at the
end of an arm of length r that turns about the middle of the board, and is shaken there:

    p_target_cam = middle + Ry(azimuth) Rx(elevation) (0, 0, r) + shake
    R_target_cam = Ry(azimuth) Rx(elevation) diag(1, -1, -1) Rz(roll) Ry(yaw) Rx(pitch)

so that it looks at the board but for yaw and pitch. Rates follow from each factor in turn: with R = A B, where B turns
about its own axis e by an angle b,

    omega = B' omega_A + e b',      alpha = B' alpha_A + e b'' - e b' x B' omega_A.

Which sinusoids, and how large, is drawn at random. Hand-held motions turn and shake most at low frequencies; turns and
shakes are scaled so that the mean rate and the mean acceleration are the stated ones, whatever was drawn.
"""

from dataclasses import replace
from typing import Self

import numpy as np

from ..frozen import field_names, value_class
from ..geometry.rotations import Floats, skew
from .scenarios.camera_imu import CameraImuScenario, MotionName

COORDINATES = ("azimuth", "elevation", "range", "roll", "yaw", "pitch", "shake_x", "shake_y", "shake_z")
TURNS, SHAKES = (3, 4, 5), (6, 7, 8)

BLOCK = 4096
"""Instants that are evaluated at a time; small enough for the cache."""


@value_class
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


@value_class
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
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in field_names(RigidMotion)}
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
        return camera_motion(self.middle, *self.coordinates(t_s))


def camera_motion(middle: Floats, value: Floats, rate: Floats, curvature: Floats) -> RigidMotion:
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


_CHECKS_HZ, _CHECKED_S = 25.0, 120.0
"""Instants at which means are taken, and the longest time for which."""

_SCALINGS = 6


@value_class(eq=True)
class _Band:
    """Sinusoids of some coordinates: `size` is the rms of each [rad or m], and amplitudes fall as frequency^-fall."""

    coordinates: tuple[int, ...]
    size: float
    low_hz: float
    high_hz: float
    sinusoids: int = 5
    fall: float = 1.0


@value_class(eq=True)
class _Style:
    """Bands of a motion; turns and shakes of `scaled` are scaled to the mean rate and acceleration, where stated."""

    scaled: tuple[_Band, ...] = ()
    added: tuple[_Band, ...] = ()
    mean_rate_rad_s: float | None = None
    mean_acceleration_m_s2: float | None = None
    turning_rad_s: float = 0.0
    turned: int = 3  # the coordinate that turns over and over


_ORBIT = (_Band(coordinates=(0, 1), size=0.1, low_hz=0.03, high_hz=0.12, sinusoids=3),)
_RANGE = (_Band(coordinates=(2,), size=0.05, low_hz=0.1, high_hz=0.5, sinusoids=3),)
_ROLL = _Band(coordinates=(3,), size=0.25, low_hz=0.1, high_hz=0.8)


def _by_hand(turns_to_hz: float, shakes_to_hz: float) -> tuple[_Band, ...]:
    return (
        _ROLL,
        _Band(coordinates=(4, 5), size=0.07, low_hz=0.15, high_hz=turns_to_hz),
        _Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=shakes_to_hz, fall=1.5),
    )


_NORMAL = _Style(scaled=_by_hand(2.5, 2.5), added=_ORBIT + _RANGE, mean_rate_rad_s=0.75, mean_acceleration_m_s2=3.9)
_STYLES: dict[MotionName, _Style] = {
    "gentle": _Style(
        scaled=_by_hand(1.2, 2.0), added=_ORBIT + _RANGE, mean_rate_rad_s=0.366, mean_acceleration_m_s2=3.12
    ),
    "normal": _NORMAL,
    "tremor": _Style(
        scaled=_NORMAL.scaled,
        added=(
            *_NORMAL.added,
            _Band(coordinates=TURNS, size=1.2e-3, low_hz=6.0, high_hz=12.0, sinusoids=4),
            _Band(coordinates=SHAKES, size=1.5e-4, low_hz=6.0, high_hz=12.0, sinusoids=4),
        ),
        mean_rate_rad_s=0.75,
        mean_acceleration_m_s2=3.9,
    ),
    "shaky": _Style(
        scaled=(
            *_NORMAL.scaled,
            _Band(coordinates=TURNS, size=0.01, low_hz=3.0, high_hz=20.0, sinusoids=6, fall=2.0),
            _Band(coordinates=SHAKES, size=0.004, low_hz=3.0, high_hz=20.0, sinusoids=6, fall=2.5),
        ),
        added=_ORBIT + _RANGE,
        mean_rate_rad_s=1.5,
        mean_acceleration_m_s2=10.0,
    ),
    "slow": _Style(
        scaled=(_ROLL, _Band(coordinates=(4, 5), size=0.07, low_hz=0.05, high_hz=0.3)),
        added=(_Band(coordinates=(0, 1), size=0.08, low_hz=0.02, high_hz=0.05, sinusoids=3),),
        mean_rate_rad_s=0.05,
    ),
    "static": _Style(),
    "one-axis": _Style(
        scaled=(_ROLL, _Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=2.5, fall=1.5)),
        mean_rate_rad_s=0.5,
        mean_acceleration_m_s2=3.9,
    ),
    "translation": _Style(
        scaled=(_Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=2.5, fall=1.5),),
        added=_RANGE,
        mean_acceleration_m_s2=3.9,
    ),
    "rolling": _Style(
        scaled=_NORMAL.scaled[1:],
        added=_NORMAL.added,
        mean_rate_rad_s=1.0,
        mean_acceleration_m_s2=3.9,
        turning_rad_s=0.6,
    ),
    "around": _Style(
        scaled=_NORMAL.scaled,
        added=_NORMAL.added,
        mean_rate_rad_s=1.0,
        mean_acceleration_m_s2=3.9,
        turning_rad_s=0.4,
        turned=4,
    ),
}
_LEAST_TURNS = 3


def drawn_path(scenario: CameraImuScenario, middle: Floats, T_cam_imu: Floats, rng: np.random.Generator) -> CameraPath:
    """Draw the path of cam0.

    Parameters
    ----------
    scenario : what to simulate
    middle : (3,) of the board [m]
    T_cam_imu : (4, 4) of the IMU whose mean acceleration the motion states
    rng : random numbers
    """
    style = _STYLES[scenario.motion]
    offset, slope = np.zeros(len(COORDINATES)), np.zeros(len(COORDINATES))
    offset[2] = scenario.distance_m
    if style.turning_rad_s:
        slope[style.turned] = max(style.turning_rad_s, 2 * np.pi * _LEAST_TURNS / scenario.duration_s)
        offset[style.turned] = rng.uniform(0, 2 * np.pi)
    drawn = [_sinusoids(band, rng) for band in style.scaled + style.added]
    path = CameraPath(
        middle=middle,
        offset=offset,
        slope=slope,
        pulsation=np.concatenate([np.empty(0), *(part[0] for part in drawn)]),
        phase=np.concatenate([np.empty(0), *(part[1] for part in drawn)]),
        amplitude=np.concatenate([np.empty((len(COORDINATES), 0)), *(part[2] for part in drawn)], axis=1),
    )
    scaled = sum(len(part[0]) for part in drawn[: len(style.scaled)])
    return _scaled(path, scaled, style, T_cam_imu, scenario.duration_s)


def _sinusoids(band: _Band, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return pulsation (k,), phase (k,) and amplitude (9, k); frequencies are spread evenly on a logarithmic scale."""
    count = len(band.coordinates) * band.sinusoids
    place = (np.tile(np.arange(band.sinusoids), len(band.coordinates)) + rng.random(count)) / band.sinusoids
    frequency_hz = band.low_hz * (band.high_hz / band.low_hz) ** place
    amplitude = np.zeros((len(COORDINATES), count))
    for i, coordinate in enumerate(band.coordinates):
        own = slice(i * band.sinusoids, (i + 1) * band.sinusoids)
        weight = frequency_hz[own] ** -band.fall
        amplitude[coordinate, own] = band.size * np.sqrt(2) * weight / np.linalg.norm(weight)
    return 2 * np.pi * frequency_hz, rng.uniform(0, 2 * np.pi, count), amplitude


def _scaled(path: CameraPath, count: int, style: _Style, T_cam_imu: Floats, duration_s: float) -> CameraPath:
    """Return the path with the turns and shakes among its first `count` sinusoids scaled to the style's means."""
    if style.mean_rate_rad_s is None and style.mean_acceleration_m_s2 is None:
        return path
    t_s = np.linspace(0, duration_s, 1 + int(_CHECKS_HZ * min(duration_s, _CHECKED_S)))
    free = path.amplitude.copy()
    free[:, :count] = 0.0
    scaled = path.amplitude - free
    rest = replace(path, amplitude=free).coordinates(t_s)
    extra = replace(path, amplitude=scaled, slope=0 * path.slope, offset=0 * path.offset).coordinates(t_s)

    def means(turn: float, shake: float) -> tuple[float, float]:
        size = _sizes(turn, shake)
        motion = camera_motion(path.middle, *(a + size * b for a, b in zip(rest, extra, strict=True))).of(T_cam_imu)
        return _mean_norm(motion.omega), _mean_norm(motion.acceleration)

    turn = shake = 1.0
    for _ in range(_SCALINGS):
        rate, acceleration = means(turn, shake)
        if style.mean_rate_rad_s is not None:
            turn *= _factor(style.mean_rate_rad_s, rate, means(0.0, shake)[0])
        if style.mean_acceleration_m_s2 is not None:
            shake *= _factor(style.mean_acceleration_m_s2, acceleration, means(turn, 0.0)[1])
    return replace(path, amplitude=free + _sizes(turn, shake) * scaled)


def _sizes(turn: float, shake: float) -> Floats:
    sizes = np.ones((len(COORDINATES), 1))
    sizes[list(TURNS)], sizes[list(SHAKES)] = turn, shake
    return sizes


def _factor(target: float, found: float, without: float) -> float:
    """Return by what to multiply a part that adds to the rest like independent signals do."""
    own, wanted = found**2 - without**2, target**2 - without**2
    return float(np.sqrt(np.clip(wanted / own, 0.01, 100.0))) if own > 0 else 1.0


def _mean_norm(v: Floats) -> float:
    return float(np.linalg.norm(v, axis=1).mean())
