"""How the sensor moves: attitudes and accelerations as exact functions of time.

The world's z axis points up and its x axis north. A motion between two static intervals is a polynomial in
tau = (t - start) / duration whose value, first, second and third derivatives are continuous everywhere, so that rate
and acceleration are zero at both ends and smooth in between.

The synthetic signals of Tedaldi 2014, section 4.1, are there as well, as they are described: three sinusoids of
different pulsation, randomly modulated from motion to motion, are the accelerations; where all three are zero a static
interval is inserted. Gravity turns at a random zenith rate and a random azimuth rate in each motion, and the gyroscope
senses that turn.
"""

import numpy as np

from ..frozen import field_names, value_class
from ..geometry.rotations import normalise_quaternion, quaternion_product
from ..recording import Floats
from .scenarios.recorded import Scenario

AMPLITUDE_M_S2 = 2.0
RATE_RAD_S = 1.5
"""Largest amplitude, zenith rate and azimuth rate; Tedaldi 2014 does not state its own."""

HALF_WAVES = np.array([1.0, 2.0, 3.0])
"""Half waves of the three sinusoids between two common zeros."""

TOLERANCE_S = 1e-9
"""Instants this close to an end of a motion are that end; both are sums of rounded sample periods."""


@value_class
class Motions:
    """Motions in order of time; at rest between them.

    With a profile s from 0 to 1 and a bump b from 0 over 1 back to 0, the attitude in motion k is

        R_world_imu = R_k Exp(turn s) Exp(bend s^2) Exp(sway b)

    and the acceleration in the world is shift s'' + swing b'' + push b. All but `push` come to rest again.

    Attributes
    ----------
    start_s, duration_s : (m,) [s]
    q_before_wxyz, q_after_wxyz : (m, 4), R_world_imu before and after each motion
    turn, bend, sway : (m, 3) rotation vectors [rad], in the body frame
    shift, swing : (m, 3) [m], world
    push : (m, 3) [m/s^2], world
    """

    start_s: Floats
    duration_s: Floats
    q_before_wxyz: Floats
    q_after_wxyz: Floats
    turn: Floats
    bend: Floats
    sway: Floats
    shift: Floats
    swing: Floats
    push: Floats

    def evaluate(self, t_s: Floats, gravity: float, earth_rate_world: Floats) -> tuple[Floats, Floats]:
        """Return specific force [m/s^2] and angular rate [rad/s] in the body frame, each (n, 3), at ascending times."""
        motion = np.searchsorted(self.start_s, t_s, side="right") - 1  # the latest that has begun, -1 for none
        attitudes = np.concatenate([self.q_before_wxyz[:1], self.q_after_wxyz])
        up = np.array([0.0, 0.0, gravity])
        force = rotated_back(attitudes, up)[motion + 1]
        rate = rotated_back(attitudes, earth_rate_world)[motion + 1]
        ends_s = self.start_s + self.duration_s
        moving = np.flatnonzero((motion >= 0) & (t_s < ends_s[motion]))
        force[moving], rate[moving] = self._in_motion(motion[moving], t_s[moving], up, earth_rate_world)
        return force, rate

    def _in_motion(self, k: np.ndarray, t_s: Floats, up: Floats, earth_rate_world: Floats) -> tuple[Floats, Floats]:
        duration = self.duration_s[k][:, None]
        tau = (t_s - self.start_s[k])[:, None] / duration
        s, ds, dds = smooth_step(tau)
        b, db, ddb = smooth_bump(tau)
        bend, sway = rotvec_quaternions(self.bend[k], s * s), rotvec_quaternions(self.sway[k], b)
        rate = rotated_back(bend, self.turn[k] * ds) + self.bend[k] * (2 * s * ds)
        rate = (rotated_back(sway, rate) + self.sway[k] * db) / duration
        attitude = quaternion_product(self.q_before_wxyz[k], rotvec_quaternions(self.turn[k], s))
        attitude = quaternion_product(attitude, quaternion_product(bend, sway))
        acceleration = (self.shift[k] * dds + self.swing[k] * ddb) / duration**2 + self.push[k] * b
        return rotated_back(attitude, acceleration + up), rate + rotated_back(attitude, earth_rate_world)


def smooth_step(tau: Floats) -> tuple[Floats, Floats, Floats]:
    """Return s, ds/dtau and d2s/dtau2 of the polynomial of degree 7 from 0 to 1 that is flat to third order."""
    x = tau * (1 - tau)
    s = tau**4 * (35 - tau * (84 - tau * (70 - 20 * tau)))
    return s, 140 * x**3, 420 * x**2 * (1 - 2 * tau)


def smooth_bump(tau: Floats) -> tuple[Floats, Floats, Floats]:
    """Return b, db/dtau and d2b/dtau2 of b = (4 tau (1 - tau))^4, flat to third order at both ends."""
    x, slope = tau * (1 - tau), 1 - 2 * tau
    return 256 * x**4, 1024 * x**3 * slope, 3072 * x**2 * slope**2 - 2048 * x**3


def rotvec_quaternions(rotvec: Floats, factor: Floats) -> Floats:
    """Return unit quaternions (n, 4) of rotation vectors (n, 3), each times its factor (n, 1)."""
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True) * factor
    half_sinc = 0.5 * factor * np.sinc(angle / (2 * np.pi))
    return np.concatenate([np.cos(0.5 * angle), half_sinc * rotvec], axis=-1)


def rotated_back(q_wxyz: Floats, v: Floats) -> Floats:
    """Return R' v, with R of the unit quaternions (n, 4) and vectors (n, 3) or (3,)."""
    w, x, y, z = q_wxyz.T
    a, b, c = np.broadcast_to(v, (len(q_wxyz), 3)).T
    tx, ty, tz = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)  # 2 v x (x, y, z)
    return np.column_stack([a + w * tx + ty * z - tz * y, b + w * ty + tz * x - tx * z, c + w * tz + tx * y - ty * x])


def hand_motions(scenario: Scenario, rng: np.random.Generator) -> tuple[Motions, float]:
    """Draw motions between attitudes that cover the sphere, and touches; return them and the recording's end [s]."""
    count = scenario.intervals - 1
    duration = rng.uniform(*scenario.motion_s, count)
    hold = rng.uniform(*scenario.hold_s, count)
    start = scenario.t_init_s + np.cumsum(duration + hold) - duration - hold
    attitudes = _attitudes(scenario, rng)
    turn = _directions(count, rng) * rng.uniform(0.3, 1.0, (count, 1))
    rest = quaternion_product(
        _conjugate(rotvec_quaternions(turn, np.ones((count, 1)))),
        quaternion_product(_conjugate(attitudes[:-1]), attitudes[1:]),
    )
    travel = Motions(
        start_s=start,
        duration_s=duration,
        q_before_wxyz=attitudes[:-1],
        q_after_wxyz=attitudes[1:],
        turn=turn,
        bend=_logarithm(rest),
        sway=0.3 * rng.standard_normal((count, 3)),
        shift=0.15 * rng.standard_normal((count, 3)),
        swing=0.05 * rng.standard_normal((count, 3)),
        push=np.zeros((count, 3)),
    )
    end_s = float(start[-1] + duration[-1] + hold[-1])
    touched = np.sort(rng.choice(count, scenario.touched, replace=False))
    touches = _touches(scenario, attitudes[1:][touched], (start + duration)[touched], hold[touched], rng)
    return _merged(travel, touches), end_s


def _touches(
    scenario: Scenario, attitudes: Floats, from_s: Floats, hold_s: Floats, rng: np.random.Generator
) -> Motions:
    """Return touches that last the middle half of their static intervals."""
    count = len(attitudes)
    nothing = np.zeros((count, 3))
    return Motions(
        start_s=from_s + 0.25 * hold_s,
        duration_s=0.5 * hold_s,
        q_before_wxyz=attitudes,
        q_after_wxyz=attitudes,
        turn=nothing,
        bend=nothing,
        sway=scenario.touch_angle * _directions(count, rng),
        shift=nothing,
        swing=nothing,
        push=scenario.touch_acceleration * _directions(count, rng),
    )


def _merged(first: Motions, second: Motions) -> Motions:
    order = np.argsort(np.concatenate([first.start_s, second.start_s]))
    return Motions(
        **{name: np.concatenate([getattr(first, name), getattr(second, name)])[order] for name in field_names(Motions)}
    )


def _attitudes(scenario: Scenario, rng: np.random.Generator) -> Floats:
    """Return attitudes R_world_imu (n, 4) whose vertical points in evenly spread directions of the body.

    The directions are a Fibonacci lattice, turned at random and shuffled, or a circle; the heading is random.
    """
    count = scenario.intervals
    z = 1 - (2 * np.arange(count) + 1) / count
    longitude = np.asarray(np.pi * (1 + np.sqrt(5)) * np.arange(count), dtype=np.float64)
    if scenario.attitudes == "one-axis":
        z = np.cos(2 * np.pi * np.arange(count) / count)
        longitude = np.where(np.arange(count) > count / 2, np.pi, 0.0)
    zenith_axis, heading_axis = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    zenith = np.asarray(np.arccos(z), dtype=np.float64)
    heading = rotvec_quaternions(heading_axis, rng.uniform(0, 2 * np.pi, (count, 1)))
    q_body_world = quaternion_product(
        rotvec_quaternions(heading_axis, longitude[:, None]), rotvec_quaternions(zenith_axis, zenith[:, None])
    )
    lattice = normalise_quaternion(rng.standard_normal(4))
    if scenario.attitudes == "one-axis":
        lattice = np.array([1.0, 0.0, 0.0, 0.0])
    return _conjugate(quaternion_product(lattice, quaternion_product(q_body_world, heading)))[rng.permutation(count)]


def _directions(count: int, rng: np.random.Generator) -> Floats:
    v = rng.standard_normal((count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _conjugate(q_wxyz: Floats) -> Floats:
    return q_wxyz * np.array([1.0, -1.0, -1.0, -1.0])


def _logarithm(q_wxyz: Floats) -> Floats:
    """Return rotation vectors (n, 3) of at most half a turn."""
    q = np.where(q_wxyz[:, :1] < 0, -q_wxyz, q_wxyz)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    # 2 atan2(sine, cosine) / sine, whose limit at zero is 2
    return q[:, 1:] * np.divide(2 * np.arctan2(sine, q[:, :1]), sine, out=np.full_like(sine, 2.0), where=sine > 0)


@value_class
class ThesisMotions:
    """Motions in order of time; at rest between them.

    Attributes
    ----------
    start_s, duration_s : (m,) [s]
    angles : (m + 1, 2) zenith and azimuth of the upward vertical in the body frame in each static interval [rad]
    amplitude : (m, 3) [m/s^2], body frame
    """

    start_s: Floats
    duration_s: Floats
    angles: Floats
    amplitude: Floats

    def evaluate(self, t_s: Floats, gravity: float, earth_rate_world: Floats) -> tuple[Floats, Floats]:
        """Return specific force [m/s^2] and angular rate [rad/s] in the body frame, each (n, 3), at ascending times.

        The rates jump at the ends of a motion; a sample there is the mean of both sides.
        """
        nearest = np.clip(np.searchsorted(self.start_s, t_s + TOLERANCE_S, side="right") - 1, 0, None)
        elapsed = t_s - self.start_s[nearest]
        duration = self.duration_s[nearest]
        tau = np.clip(elapsed / duration, 0.0, 1.0)[:, None]
        # 1 inside, 0 outside, 1/2 within rounding of an end
        inside = 0.5 * (np.sign(_snapped(elapsed)) - np.sign(_snapped(elapsed - duration)))[:, None]
        change = np.diff(self.angles, axis=0)[nearest]
        zenith, azimuth = (self.angles[nearest] + change * tau).T
        zenith_rate, azimuth_rate = (inside * change / duration[:, None]).T
        sin_zenith, cos_zenith = np.sin(zenith), np.cos(zenith)
        sin_azimuth, cos_azimuth = np.sin(azimuth), np.cos(azimuth)
        up = np.column_stack([sin_zenith * cos_azimuth, sin_zenith * sin_azimuth, cos_zenith])
        # The world seen from the body is Rz(azimuth) Ry(zenith); the body turns the other way.
        rate = np.column_stack([zenith_rate * sin_azimuth, -zenith_rate * cos_azimuth, -azimuth_rate])
        north = np.column_stack([cos_zenith * cos_azimuth, cos_zenith * sin_azimuth, -sin_zenith])
        rate += earth_rate_world[0] * north + earth_rate_world[2] * up
        acceleration = self.amplitude[nearest] * np.sin(np.pi * HALF_WAVES * tau)
        return gravity * up + acceleration, rate


def _snapped(t_s: Floats) -> Floats:
    return np.where(np.abs(t_s) < TOLERANCE_S, 0.0, t_s)


def thesis_motions(scenario: Scenario, rng: np.random.Generator) -> tuple[ThesisMotions, float]:
    """Draw motions; return them and the recording's end [s]. All lengths are whole numbers of samples."""
    count = scenario.intervals - 1
    step = 1 / scenario.rate_hz
    duration = np.rint(rng.uniform(*scenario.motion_s, count) / step) * step
    hold = np.rint(rng.uniform(*scenario.hold_s, count) / step) * step
    start = np.rint(scenario.t_init_s / step) * step + np.cumsum(duration + hold) - duration - hold
    turns = rng.uniform(-RATE_RAD_S, RATE_RAD_S, (count, 2)) * duration[:, None]
    angles = np.cumsum(np.concatenate([rng.uniform(0, np.pi, (1, 2)), turns]), axis=0)
    motions = ThesisMotions(
        start_s=start,
        duration_s=duration,
        angles=angles,
        amplitude=rng.uniform(-AMPLITUDE_M_S2, AMPLITUDE_M_S2, (count, 3)),
    )
    return motions, float(start[-1] + duration[-1] + hold[-1])
