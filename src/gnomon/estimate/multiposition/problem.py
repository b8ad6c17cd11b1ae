"""From a recording and its static intervals to the multi-position problem in scaled units, and back to the sensors'.

Every axis is centred and divided by its spread, so that offsets and scales of any size are the same problem.
"""

from typing import Protocol

import numpy as np

from ...frozen import value_class
from ...models.gravity import EARTH_RATE_RAD_S
from ...recording import Floats, Integers, frozen_array
from ...recording.samples import median_of
from ...results.result import Booleans, StaticIntervals, interval_means, split_long
from .bias_changes import RestMeans
from .measurements import MotionSegments, cut_segments, segments_between
from .model import B_, BG_, CG_, G_, LOWER, S_, MultiPositionData, MultiPositionState

_LONGEST_GAP_S = 0.05
_LONGEST_GAP_PERIODS = 3.5
_PARTS_OF_A_REST = 8  # most of them, between which a bias is looked at


@value_class
class Scaling:
    """scaled = (measured - centre) / spread, axis by axis.

    Attributes
    ----------
    centre, spread : (3,) [unit]
    """

    centre: Floats
    spread: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", frozen_array(self.centre))
        object.__setattr__(self, "spread", frozen_array(self.spread))

    @classmethod
    def of(cls, centre: Floats, deviations: Floats) -> "Scaling":
        """Return the scaling with a given centre and the rms of deviations (n, 3) as spread."""
        spread = np.sqrt(np.mean(deviations**2, axis=0)) if len(deviations) else np.ones(3)
        return cls(centre=centre, spread=np.where(spread > 0, spread, 1.0))

    def scaled(self, values: Floats) -> Floats:
        """Return scaled values (n, 3)."""
        return (values - self.centre) / self.spread


@value_class
class TriadStream:
    """Samples of a triad as estimation needs them.

    Attributes
    ----------
    t_s : (n,) instants [s]
    values : (n, 3) [unit]
    saturated : (n,) bool
    rate_hz : sample rate [Hz]
    density : (3,) noise density of means at rest [unit^2 s]
    density_in_motion : (3,) noise density of integrals in motion [unit^2 s]
    rounding : (k, 3) variance of each mean at rest that the converter's steps make, however long it rests [unit^2]
    intervals : its samples at rest
    degc : (n, k) temperature above a reference [K], its rate [K/s] and higher powers; None where nothing tells its
        effect from that of the time
    """

    t_s: Floats
    values: Floats
    saturated: Booleans
    rate_hz: float
    density: Floats
    density_in_motion: Floats
    rounding: Floats
    intervals: StaticIntervals
    degc: Floats | None = None

    @property
    def degc_at_rest(self) -> Floats | None:
        """Their means in each static interval, (n, k)."""
        return None if self.degc is None else interval_means(self.degc, self.intervals)


@value_class
class MultiPositionProblem:
    """The problem in scaled units, and the way back.

    Attributes
    ----------
    data : means and segments in scaled units
    accelerometer, gyroscope : the scaling of each triad
    accelerometer_means, gyroscope_means : (n, 3) [unit]
    start_s, stop_s : (n - 1,) where each rotation begins and ends [s]
    unlinked : (n - 1,) why a rotation is not used, or ""
    """

    data: MultiPositionData
    accelerometer: Scaling
    gyroscope: Scaling
    accelerometer_means: Floats
    gyroscope_means: Floats
    start_s: Floats
    stop_s: Floats
    unlinked: tuple[str, ...]


def gyroscope_intervals(t_s: Floats, start_s: Floats, stop_s: Floats) -> StaticIntervals:
    """Return the samples of another stream within static intervals that are given by time."""
    return StaticIntervals(
        start=np.searchsorted(t_s, start_s, side="left"), stop=np.searchsorted(t_s, stop_s, side="right")
    )


def build_problem(
    accelerometer: TriadStream, gyroscope: TriadStream, earth_rate_variance: float
) -> MultiPositionProblem:
    """Gather the means of all static intervals and the samples of the rotations between them.

    Parameters
    ----------
    accelerometer, gyroscope : streams, their intervals in the same order
    earth_rate_variance : see MultiPositionData
    """
    still = accelerometer.intervals
    means_a = interval_means(accelerometer.values, still)
    means_g = interval_means(gyroscope.values, gyroscope.intervals)
    start_s = accelerometer.t_s[still.stop[:-1] - 1]
    stop_s = accelerometer.t_s[still.start[1:]]
    first, lengths = segments_between(gyroscope.t_s, start_s, stop_s)
    segments = _segments(accelerometer, gyroscope, first, lengths)
    scale_a = Scaling.of(means_a.mean(axis=0), means_a - means_a.mean(axis=0))
    rest = median_of(means_g, axis=0)
    scale_g = Scaling.of(rest, segments.gyroscope - rest)
    unlinked = tuple(
        why_unlinked(gyroscope.t_s, gyroscope.saturated, gyroscope.rate_hz, slice(int(a), int(a + n)))
        for a, n in zip(first, lengths, strict=True)
    )
    data = MultiPositionData(
        accelerometer=scale_a.scaled(means_a),
        gyroscope=scale_g.scaled(means_g),
        accelerometer_variance=_variance_of_means(accelerometer, scale_a),
        # At rest a gyroscope shows its bias: what is rounded is the same in every rest, and more of them do not help.
        gyroscope_variance=_variance_of_means(gyroscope, scale_g, alike=len(means_g)),
        segments=MotionSegments(
            gyroscope=scale_g.scaled(segments.gyroscope),
            accelerometer=scale_a.scaled(segments.accelerometer),
            dt_s=segments.dt_s,
            lengths=segments.lengths,
        ),
        rotation_variance=(
            segments.duration_s[:, None] * gyroscope.density_in_motion
            + len(means_g) * 0.5 * (gyroscope.rounding[:-1] + gyroscope.rounding[1:]) * _quiet_s(segments) ** 2
        )
        / scale_g.spread**2,
        linked=np.array([not reason for reason in unlinked], dtype=bool),
        interval_s=0.5 * (accelerometer.t_s[still.start] + accelerometer.t_s[still.stop - 1]),
        half_s=0.5 * (accelerometer.t_s[still.stop - 1] - accelerometer.t_s[still.start]),
        rests=(
            rest_means(accelerometer, scale_a),
            rest_means(gyroscope, scale_g, alike=len(means_g)),
        ),
        rotation_s=0.5 * (start_s + stop_s),
        degc=None
        if accelerometer.degc is None or accelerometer.degc_at_rest is None
        else (
            accelerometer.degc_at_rest,
            accelerometer.degc[np.searchsorted(accelerometer.t_s, 0.5 * (start_s + stop_s))],
        ),
        span_s=(float(accelerometer.t_s[still.start[0]]), float(accelerometer.t_s[still.stop[-1] - 1])),
        earth_rate_variance=earth_rate_variance,
    )
    return MultiPositionProblem(
        data=data,
        accelerometer=scale_a,
        gyroscope=scale_g,
        accelerometer_means=means_a,
        gyroscope_means=means_g,
        start_s=start_s,
        stop_s=stop_s,
        unlinked=unlinked,
    )


def rest_means(stream: TriadStream, scaling: Scaling | None = None, alike: int = 1) -> RestMeans:
    """Return the means at rest of a stream, long static intervals in parts; in scaled units where a scaling is given.

    Parameters
    ----------
    alike : static intervals that are rounded alike
    """
    scaling = scaling or Scaling(centre=np.zeros(3), spread=np.ones(3))
    parts, rest = split_long(stream.intervals, _PARTS_OF_A_REST)
    start, stop = stream.t_s[parts.start], stream.t_s[parts.stop - 1]
    return RestMeans(
        rest=rest,
        t_s=0.5 * (start + stop),
        half_s=0.5 * (stop - start),
        means=scaling.scaled(interval_means(stream.values, parts)),
        variance=_variance_of_means(stream, scaling, alike)[rest] * np.bincount(rest)[rest, None],
        degc=None if stream.degc is None else interval_means(stream.degc, parts),
    )


def _variance_of_means(stream: TriadStream, scaling: Scaling, alike: int = 1) -> Floats:
    duration = (stream.intervals.stop - stream.intervals.start) / stream.rate_hz
    variance = (stream.density / duration[:, None] + alike * stream.rounding) / scaling.spread**2
    return np.maximum(variance, 1e-14)  # noiseless recordings keep a finite weight


def _quiet_s(segments: MotionSegments) -> Floats:
    """Return how long each axis read one and the same number during each rotation, (m, 3) [s]."""
    if not len(segments.lengths):
        return np.empty((0, 3))
    same = np.zeros(segments.gyroscope.shape)
    same[:-1] = np.diff(segments.gyroscope, axis=0) == 0
    return np.add.reduceat(same * segments.dt_s[:, None], segments.first)


def _segments(accelerometer: TriadStream, gyroscope: TriadStream, first: Integers, lengths: Integers) -> MotionSegments:
    """Cut out the rotations; the specific force is interpolated where it has timestamps of its own."""
    if np.array_equal(accelerometer.t_s, gyroscope.t_s):
        return cut_segments(gyroscope.t_s, gyroscope.values, accelerometer.values, first, lengths)
    cut = cut_segments(gyroscope.t_s, gyroscope.values, gyroscope.values, first, lengths)
    offsets = np.cumsum(lengths) - lengths
    instants = gyroscope.t_s[np.arange(lengths.sum()) - np.repeat(offsets - first, lengths)]
    force = [np.interp(instants, accelerometer.t_s, accelerometer.values[:, axis]) for axis in range(3)]
    return MotionSegments(gyroscope=cut.gyroscope, accelerometer=np.column_stack(force), dt_s=cut.dt_s, lengths=lengths)


def why_unlinked(t_s: Floats, saturated: Booleans, rate_hz: float, part: slice) -> str:
    """Return why a rotation cannot be used, or "".

    Parameters
    ----------
    t_s, saturated : (n,) instants and clipped samples of the gyroscope
    rate_hz : of the gyroscope
    part : the samples of the rotation
    """
    clipped = int(saturated[part].sum())
    if clipped:
        return f"the gyroscope is saturated in {clipped} samples"
    gap = float(np.max(np.diff(t_s[part]), initial=0.0))
    if gap > max(_LONGEST_GAP_S, _LONGEST_GAP_PERIODS / rate_hz):
        return f"a gap of {gap:.2f} s in the gyroscope's samples"
    return "" if part.stop - part.start >= 3 else "fewer than three gyroscope samples"


@value_class
class ImuEstimate:
    """An IMU's parameters in the sensors' units, in frame accel-x, with their covariance.

    Attributes
    ----------
    accelerometer_sensitivity : (3, 3) [unit per m/s^2]
    accelerometer_bias : (3,) [unit]
    gyroscope_sensitivity : (3, 3) [unit per rad/s]
    gyroscope_bias : (3,) [unit]
    g_sensitivity : (3, 3) [unit per m/s^2]
    covariance : (33, 33), elements in the order of the attributes, matrices in row order
    """

    accelerometer_sensitivity: Floats
    accelerometer_bias: Floats
    gyroscope_sensitivity: Floats
    gyroscope_bias: Floats
    g_sensitivity: Floats
    covariance: Floats

    @property
    def values(self) -> Floats:
        """All scalars (33,), in the order of the covariance."""
        parts = (
            self.accelerometer_sensitivity,
            self.accelerometer_bias,
            self.gyroscope_sensitivity,
            self.gyroscope_bias,
            self.g_sensitivity,
        )
        return np.concatenate([part.ravel() for part in parts])


class Fitted(Protocol):
    """What a fit says in scaled units: the state, the covariance (30, 30), and which parameters were estimated."""

    @property
    def state(self) -> MultiPositionState:
        """Where it stands."""
        ...

    @property
    def covariance(self) -> Floats:
        """Of theta."""
        ...

    @property
    def free(self) -> Booleans:
        """Whether each of theta was estimated."""
        ...


def to_physical_units(
    fit: Fitted,
    accelerometer: Scaling,
    gyroscope: Scaling,
    *,
    gravity_m_s2: float,
    gravity_sigma_m_s2: float,
    latitude_deg: float | None,
) -> ImuEstimate:
    """Return the fit in the sensors' units.

    The uncertainty of gravity goes to the sensitivities, which are proportional to 1 / g. The vertical part of the
    earth's rate turns with the attitude like gravity and hides in the g-sensitivity: it is taken off where the latitude
    is known, and is part of the sigma where it is not.
    """
    values, jacobian = sensor_scalars(
        fit.state, accelerometer, gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=latitude_deg
    )
    covariance = jacobian @ fit.covariance @ jacobian.T
    estimated = bool(fit.free[G_].any())
    if not estimated:
        values[24:] = 0.0
    by_gravity = np.zeros(33)
    by_gravity[:9], by_gravity[24:] = -values[:9] / gravity_m_s2, -values[24:] / gravity_m_s2
    covariance += gravity_sigma_m_s2**2 * np.outer(by_gravity, by_gravity)
    if estimated and latitude_deg is None:
        by_earth = np.zeros(33)
        by_earth[24:] = values[12:21] / gravity_m_s2
        covariance += EARTH_RATE_RAD_S**2 / 3 * np.outer(by_earth, by_earth)
    return ImuEstimate(
        accelerometer_sensitivity=values[:9].reshape(3, 3),
        accelerometer_bias=values[9:12],
        gyroscope_sensitivity=values[12:21].reshape(3, 3),
        gyroscope_bias=values[21:24],
        g_sensitivity=values[24:].reshape(3, 3),
        covariance=covariance,
    )


def blocks_of_scalars(values: Floats) -> tuple[tuple[str, Floats, str], ...]:
    """Return of each block of scalars (33,) its path, the factors (33,) by which it is shown, and the unit of that.

    Sensitivities are shown as shares of the axis' own, biases and g-sensitivity as what they make of the rate or force.
    """
    force, rate = (np.linalg.norm(values[part].reshape(3, 3), axis=1) for part in (slice(0, 9), slice(12, 21)))
    shares = {
        "imu0.accelerometer.sensitivity": (slice(0, 9), 100 / np.repeat(force, 3), "%"),
        "imu0.accelerometer.bias": (slice(9, 12), 1 / force, "m/s^2"),
        "imu0.gyroscope.sensitivity": (slice(12, 21), 100 / np.repeat(rate, 3), "%"),
        "imu0.gyroscope.bias": (slice(21, 24), 1 / rate, "rad/s"),
        "imu0.gyroscope.g_sensitivity": (slice(24, 33), 1 / np.repeat(rate, 3), "rad/s per m/s^2"),
    }
    found: list[tuple[str, Floats, str]] = []
    for path, (part, share, unit) in shares.items():
        factor = np.zeros(len(values))
        factor[part] = share
        found.append((path, factor, unit))
    return tuple(found)


def sensor_scalars(
    state: MultiPositionState,
    accelerometer: Scaling,
    gyroscope: Scaling,
    *,
    gravity_m_s2: float,
    latitude_deg: float | None,
) -> tuple[Floats, Floats]:
    """Return the scalars (33,) in the sensors' units, in the order of `ImuEstimate.covariance`, and their derivative.

    The derivative (33, 30) is by the scaled parameters theta.
    """
    s, b, c_g, b_g, g = state.matrices
    s_g = np.linalg.inv(c_g) if np.any(c_g) else np.zeros((3, 3))
    da, dg = accelerometer.spread, gyroscope.spread
    vertical = EARTH_RATE_RAD_S * np.sin(np.radians(latitude_deg)) if latitude_deg is not None else 0.0
    gyro_sensitivity = dg[:, None] * s_g
    values = np.concatenate(
        [
            (da[:, None] * s / gravity_m_s2).ravel(),
            da * b + accelerometer.centre,
            gyro_sensitivity.ravel(),
            dg * b_g + gyroscope.centre,
            (dg[:, None] * g / gravity_m_s2 - gyro_sensitivity * vertical / gravity_m_s2).ravel(),
        ]
    )
    jacobian = np.zeros((33, 30))
    for column, (i, j) in enumerate(zip(*LOWER, strict=True)):
        jacobian[3 * i + j, S_.start + column] = da[i] / gravity_m_s2
    jacobian[9:12, B_] = np.diag(da)
    jacobian[12:21, CG_] = -np.kron(np.diag(dg) @ s_g, s_g.T)  # d inv(C) = -inv(C) dC inv(C)
    jacobian[21:24, BG_] = np.diag(dg)
    jacobian[24:33, G_] = np.kron(np.diag(dg), np.eye(3)) / gravity_m_s2
    return values, jacobian
