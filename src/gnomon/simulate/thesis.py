"""The synthetic signals of document A, section 4.1, as they are described there.

Three sinusoids of different pulsation, randomly modulated from motion to motion, are the accelerations; where all three
are zero a static interval is inserted. Gravity turns at a random zenith rate and a random azimuth rate in each motion,
and the gyroscope senses that turn.
"""

from dataclasses import dataclass

import numpy as np

from ..recording import Floats
from .scenario import Scenario

AMPLITUDE_M_S2 = 2.0
RATE_RAD_S = 1.5
"""Largest amplitude, zenith rate and azimuth rate; document A does not state its own."""

HALF_WAVES = np.array([1.0, 2.0, 3.0])
"""Half waves of the three sinusoids between two common zeros."""

TOLERANCE_S = 1e-9
"""Instants this close to an end of a motion are that end; both are sums of rounded sample periods."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
