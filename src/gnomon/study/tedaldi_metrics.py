"""How document A measures a calibration, section 4.1.1: the signals before and after against those without errors."""

from dataclasses import dataclass

import numpy as np

from ..estimate.multiposition.rotations import cut_segments, integrate, propagate, segments_between
from ..intervals import StaticIntervals, interval_means
from ..recording import Floats
from ..simulate.imu import TrueSignals


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalErrors:
    """Metrics 2 to 4 of one recording.

    Attributes
    ----------
    force, rate : (3,) mean absolute error along each axis [m/s^2] [rad/s]
    divergence : (2,) mean and largest of | |a| - g | over the samples at rest [m/s^2]
    tilt : (2,) the same as an angle, if all of it were along a level axis [rad]
    rotation, rotation_angle : (2,) mean and largest difference between the acceleration sensed at rest and that which
        the gyroscope carries there from the rest before [m/s^2] [rad]
    drift, drift_angle : (2,) the same, carried on from the first rest through the whole recording
    """

    force: Floats
    rate: Floats
    divergence: Floats
    tilt: Floats
    rotation: Floats
    rotation_angle: Floats
    drift: Floats
    drift_angle: Floats


def signal_errors(truth: TrueSignals, force: Floats, rate: Floats, gravity: float) -> SignalErrors:
    """Compare signals (n, 3), in SI units, with the true ones.

    As in document A, the gyroscope's mean over the first rest is removed before it carries anything (metric 4).
    """
    rests = _rests(truth)
    away = np.abs(np.linalg.norm(force[~truth.moving], axis=1) - gravity)
    sensed = interval_means(force, rests)
    free = rate - rate[rests.start[0] : rests.stop[0]].mean(axis=0)
    last, following = truth.t_s[rests.stop - 1], truth.t_s[rests.start]
    once = propagate(_turned(truth.t_s, free, last[:-1], following[1:]), sensed[:-1])
    middle = 0.5 * (last + following)
    middle[0] = last[0]
    carried = sensed.copy()
    for k, rotation in enumerate(_turned(truth.t_s, free, middle[:-1], middle[1:])):
        carried[k + 1] = rotation.T @ carried[k]
    return SignalErrors(
        force=np.mean(np.abs(force - truth.force), axis=0),
        rate=np.mean(np.abs(rate - truth.rate), axis=0),
        divergence=_mean_and_most(away),
        tilt=_mean_and_most(np.arcsin(np.minimum(away / gravity, 1.0))),
        rotation=_mean_and_most(np.linalg.norm(sensed[1:] - once, axis=1)),
        rotation_angle=_mean_and_most(_angle(sensed[1:], once)),
        drift=_mean_and_most(np.linalg.norm(sensed[1:] - carried[1:], axis=1)),
        drift_angle=_mean_and_most(_angle(sensed[1:], carried[1:])),
    )


def _rests(truth: TrueSignals) -> StaticIntervals:
    edges = np.flatnonzero(np.diff(np.concatenate([[True], truth.moving, [True]]).astype(np.int8)))
    return StaticIntervals(start=edges[::2], stop=edges[1::2])


def _turned(t_s: Floats, rate: Floats, start_s: Floats, stop_s: Floats) -> Floats:
    """Return R_start_stop (m, 3, 3) of the turns between two instants, by Eqs. (3.10)-(3.16)."""
    first, lengths = segments_between(t_s, start_s, stop_s)
    segments = cut_segments(t_s, rate, rate, first, lengths)
    return integrate(segments, segments.gyroscope).rotation


def _angle(a: Floats, b: Floats) -> Floats:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ki,ki->k", a, b))


def _mean_and_most(values: Floats) -> Floats:
    return np.array([values.mean(), values.max()])
