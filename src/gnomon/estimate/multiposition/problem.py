"""From a recording and its static intervals to the multi-position problem.

And where, half-way in a recording, axes began to be along others, or the gyroscope to show another share of a rotation.

Each rotation between two rests should lead gravity from where it was read before to where it is read after. Which way
the gyroscope's axes stand to the accelerometer's, and how much of a rotation it shows, is tried for all rotations;
where no one way explains them, two do, one up to some rotation and another one after it.
"""

from itertools import permutations, product

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans, StaticIntervals, interval_means, split_long
from .bias_changes import RestMeans
from .model import MultiPositionData
from .rotations import MotionSegments, cut_segments, integrate_rates, segment_moments, segments_between
from .scaling import Scaling
from .tedaldi import fit_magnitude

_LONGEST_GAP_S = 0.05
_LONGEST_GAP_PERIODS = 3.5
_PARTS_OF_A_REST = 8  # most of them, between which a bias is looked at
_LEAST_TILT = 0.5  # of gravity's unit vector; what turns about the vertical more than that tells too little
_SIGNED = np.array([
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
])  # fmt: skip
"""The 48 ways in which three axes can be along three others; of them the first one is as they are."""
_ALONG = 0.85  # cosine between what gravity did and what the gyroscope showed, of rotations that tell its scale
_NEAR, _REVERSED = np.cos(np.radians([25.0, 155.0]))  # raw scales and axes are off by some per cent
_FEWEST, _MOSTLY = 2, 0.9  # rotations on either side that only one way explains; share that it must explain
_FACTOR, _FACTORS = 1.6, 25  # ranges differ by two; shares of a rotation that are tried
_WORSE = 2.0  # times that gravity scatters more, from which on reversed axes do not explain it
_ACROSS = 0.7  # cosine to where a turn began, in its middle
_FINE = np.linspace(0.8, 1.25, 10)


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


@value_class
class AxesChange:
    """Where the axes of a triad, or the gyroscope's scale, began to be others.

    Attributes
    ----------
    row : rotation in which they did
    triad : "accelerometer", "gyroscope", or either where they could be of both
    after : (3, 3) signed permutation: what its axes read from then on, of what they would have read before
    factor : what the gyroscope shows of a rotation then, over what it had shown before
    """

    row: int
    triad: str
    after: Floats
    factor: float = 1.0


@value_class
class _Turns:
    """Rotations as both triads show them.

    Attributes
    ----------
    problem : they are of
    path : (n, 3) direction of what the accelerometer reads at the samples of the segments
    u : (m + 1, 3) direction of gravity before and after
    felt : (48, m, 3) change of u by the gyroscope for each way of `_SIGNED` [its unit per rad/s]
    """

    problem: MultiPositionProblem
    path: Floats
    u: Floats
    felt: Floats

    def passes_through(self, row: int) -> bool:
        """Return whether the accelerometer was turned, rather than reversed from one sample to the next."""
        first, length = self.problem.data.segments.first[row], self.problem.data.segments.lengths[row]
        return bool(np.sum(np.abs(self.path[first : first + length] @ self.u[row]) < _ACROSS) > 1)

    def cosines_and_factors(self) -> tuple[Floats, Floats]:
        """Return how well and how much of gravity's turn each way shows, (48, m) each; 0 where it hardly turned."""
        change = np.diff(self.u, axis=0)
        square = np.maximum(np.sum(change**2, axis=1), 1e-300)
        along = np.einsum("pkc,kc->pk", self.felt, change)
        length = np.maximum(np.linalg.norm(self.felt, axis=2) * np.sqrt(square), 1e-300)
        return np.where(square > _LEAST_TILT**2, along / length, 0.0), along / square

    def predicted(self, way: int, factor: float) -> Floats:
        """Return gravity's direction after each rotation as the gyroscope leads to it, (m, 3)."""
        rates = _rates(self.problem) @ _SIGNED[way].T / factor
        rotation = integrate_rates(self.problem.data.segments, rates).rotation
        return np.einsum("kji,kj->ki", rotation, self.u[:-1])


def _turns_of(problem: MultiPositionProblem) -> _Turns:
    """Return what the triads showed of each rotation, roughly.

    Gravity's direction u turns by u' = -omega x u in the body, so that of readings y = s omega the integral of -y x u
    is s times the change of u, with u all along the motion as the accelerometer has it: but for a fifth or so, without
    any guess, and without the ambiguity of whole turns. See `linear_start`.
    """
    data, segments = problem.data, problem.data.segments
    fit = fit_magnitude(data.accelerometer, 1.0)
    u_path, u = (
        _directions((read - fit.bias) @ fit.correction.T) for read in (segments.accelerometer, data.accelerometer)
    )
    sums = segment_moments(segments, _rates(problem), u_path)
    by_axes = -np.cross(np.eye(3)[None, None], sums[:, :, None])  # of axis a along j: -e_j x (sum of y_a u)
    return _Turns(problem=problem, path=u_path, u=u, felt=np.einsum("pja,kajc->pkc", _SIGNED, by_axes))


def _rates(problem: MultiPositionProblem) -> Floats:
    """Return the gyroscope's readings in motion less those at rest on either side, whose bias may differ [unit]."""
    data, segments = problem.data, problem.data.segments
    at_rest = 0.5 * (data.gyroscope[:-1] + data.gyroscope[1:])
    return (segments.gyroscope - np.repeat(at_rest, segments.lengths, axis=0)) * problem.gyroscope.spread


def _directions(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)


def find_axes_change(problem: MultiPositionProblem) -> AxesChange | None:
    """Return the one rotation from which on axes are along others, or the gyroscope's scale is another; else None."""
    turns = _turns_of(problem)
    cosine, factors = turns.cosines_and_factors()
    alike = cosine > _ALONG
    usual = int(np.argmax(cosine.sum(axis=1)))
    if alike[usual].sum() < _FEWEST:
        return None
    linked = np.array([not why for why in problem.unlinked], dtype=bool)
    own = factors[usual][alike[usual]]
    rough = usual, float(np.median(own))
    predicted = turns.predicted(*rough)
    if (np.sum(predicted * turns.u[1:], axis=1) < _NEAR).any():
        predicted = turns.predicted(usual, _refined(turns, rough, slice(None)))
    agree = np.sum(predicted * turns.u[1:], axis=1)
    off, reverse = np.flatnonzero((agree < _NEAR) & linked), np.flatnonzero((agree < _REVERSED) & linked)
    if len(reverse) == 1 and len(off) <= 1 + (1 - _MOSTLY) * len(agree):
        row = int(reverse[0])
        unseen = float(predicted[row] @ turns.u[row]) > _NEAR and turns.passes_through(row)
        read = problem.data.accelerometer * problem.accelerometer.spread + problem.accelerometer.centre
        if unseen or not _fits_reversed(read, row):
            return None
        return AxesChange(row=row, triad="accelerometer", after=-np.eye(3))
    if len(off) < _FEWEST:
        return None
    ways = [(way, float(np.median(factors[way][alike[way]]))) for way in range(len(_SIGNED)) if alike[way].any()]
    ways += [(usual, factor) for factor in np.quantile(own, np.linspace(0, 1, _FACTORS)).tolist()]
    return _change_between(turns, ways, linked)


def _fits_reversed(read: Floats, row: int) -> bool:
    """Return whether means at rest fit with those behind a rotation reversed, bias and all; else files were joined."""
    errors: list[float] = []
    for signed in (read, np.concatenate([read[: row + 1], -read[row + 1 :]])):
        fit = fit_magnitude(signed, 1.0)
        errors.append(float(np.std(np.linalg.norm((signed - fit.bias) @ fit.correction.T, axis=1))))
    return errors[1] < _WORSE * errors[0]


def _change_between(turns: _Turns, ways: list[tuple[int, float]], linked: Booleans) -> AxesChange | None:
    """Return the change that splits the rotations into some that agree with one way, and some with another."""
    predicted = np.array([turns.predicted(*way) for way in ways])
    agree = np.where(linked, np.einsum("pki,ki->pk", predicted, turns.u[1:]), 0.0)
    sums = np.concatenate([np.zeros((len(ways), 1)), np.cumsum(agree, axis=1)], axis=1)
    before, after = sums[:, :-1], sums[:, -1:] - sums[:, 1:]
    row = int(np.argmax(before.max(axis=0) + after.max(axis=0)))
    one, other = int(np.argmax(before[:, row])), int(np.argmax(after[:, row]))
    sides = slice(0, row), slice(row + 1, None)
    for side, own, foreign in ((sides[0], one, other), (sides[1], other, one)):
        near, far = agree[own, side] > _NEAR, agree[foreign, side] < _NEAR
        if np.sum(near & far) < _FEWEST or np.mean(near[linked[side]]) < _MOSTLY:
            return None
    first, second = _SIGNED[ways[one][0]], _SIGNED[ways[other][0]]
    turned = second @ first.T
    if ways[one][0] == ways[other][0]:
        factor = _refined(turns, ways[other], sides[1]) / _refined(turns, ways[one], sides[0])
        changed = max(factor, 1 / factor) > _FACTOR
        return AxesChange(row=row, triad="gyroscope", after=np.eye(3), factor=factor) if changed else None
    if np.linalg.det(turned) < 0:  # as a change of the accelerometer's axes cannot look
        return AxesChange(row=row, triad="gyroscope", after=second.T @ first)
    for axes in (turned, -turned):
        if float(turns.u[row + 1] @ axes @ predicted[one, row]) > _NEAR:
            return AxesChange(row=row, triad="accelerometer", after=axes)
    return AxesChange(row=row, triad="gyroscope or the accelerometer", after=second.T @ first)


def _refined(turns: _Turns, way: tuple[int, float], side: slice) -> float:
    """Return the factor near that of a way that explains the rotations of one side best."""
    fits = [np.sum((turns.predicted(way[0], f * way[1]) * turns.u[1:])[side]) for f in _FINE]
    return way[1] * float(_FINE[int(np.argmax(fits))])
