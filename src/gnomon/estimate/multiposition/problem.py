"""From a recording and its static intervals to the multi-position problem."""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans, StaticIntervals, interval_means, split_long
from .bias_changes import RestMeans
from .model import MultiPositionData
from .rotations import MotionSegments, cut_segments, segments_between
from .scaling import Scaling

_LONGEST_GAP_S = 0.05
_LONGEST_GAP_PERIODS = 3.5
_PARTS_OF_A_REST = 8  # most of them, between which a bias is looked at


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
    rest = np.median(means_g, axis=0)
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
