"""Whether the axes or the scales of a triad changed half-way in a recording, a lot or a little.

**Along others**: each rotation between two rests should lead gravity from where it was read before to where it is read
after. Which way the gyroscope's axes stand to the accelerometer's, and how much of a rotation it shows, is tried for
all rotations; where no one way explains them, two do, one up to some rotation and another one after it.

**A little**, told from few rests: a triad turned in its housing, or its scales changed, at one instant or steadily.
One cause moves three numbers: the angles by which a triad turns, or its three gains. Where a rest r begins, three such
parameters d join the linearised problem of `model.py` beside all others. With the gyroscope's axes C, rotation k and
the direction of gravity p that it leads to

    gyroscope turned          C after r becomes (1 + [d]x) C
    accelerometer turned      the same, and gravity read after the rotation that ends in r becomes (1 + [d]x) p
    gyroscope's gains         C after r becomes C (1 - diag d)
    accelerometer's gains     S u after r becomes (1 + diag d) S u

Gains that drift do so by d times the share of the time that has passed. T = d' V^-1 d over the mean square of what is
left of the residuals of that kind, of nu degrees of freedom, follows 3 F(3, nu). Where the mean square is no larger
than what the noise at rest explains, that counts as so many degrees of freedom more (a prior on the variance, as Smyth,
2004). This is the likelihood-ratio test of a linear model, the most powerful that no choice of units changes (Lehmann
and Romano, Testing Statistical Hypotheses, 7.3). Over all causes the least chance counts, times their number and that
of instants, a drift being as likely as all instants together. Where it explains as much, a change is judged as one.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product
from statistics import NormalDist

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import skew, tangent_basis
from ...recording import Floats, Integers
from ...recording.samples import distinct_values, median_of, quantile_of
from ...results.result import Booleans
from ...results.trust import ParameterChange
from ...solve.least_squares import reduced_normal_equations
from ..trust.changes import STEADILY, TOLD_APART
from .evidence import with_runs
from .fit import GATE_SIGMA, MultiPositionFit, sum_of_squares
from .measurements import fit_magnitude, integrate_rates, segment_moments
from .model import CG_, Whitening, normal_equations
from .noise_levels import residual_freedom, rotation_variance
from .problem import MultiPositionProblem

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

_CHANCE = 0.005  # that a recording in which nothing changed is said to have changed
_FEWEST_BESIDE = 3  # rotations on either side
_CAUSES, _STEADY_CAUSES = 4, 2
_MOST_PLACES, _PLACES_COUNT = 40, 8  # that are tried, that count as looks
_NOISE_COUNTS = 20.0  # degrees of freedom that the noise at rest counts as: variances that it tells to 30 %
_FEWEST_LEFT = 6.0  # degrees of freedom
_LARGEST = 0.1  # standard deviation of a change beforehand [rad, 1]

_OF_THREE = 2 / 27


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
    rough = usual, float(median_of(own))
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
    ways = [(way, float(median_of(factors[way][alike[way]]))) for way in range(len(_SIGNED)) if alike[way].any()]
    ways += [(usual, factor) for factor in quantile_of(own, np.linspace(0, 1, _FACTORS)).tolist()]
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


@value_class
class _Cause:
    """What may have happened: derivatives of the residuals by it, at each of k rests, or the last of k steadily.

    `at_rest` (k, n, 3, 3) of the accelerometer, `rotation` (k, n - 1, 2, 3); `by_change` (9, 3) of the sensitivity.
    """

    triad: str
    jumps: bool
    at_rest: Floats
    rotation: Floats
    by_change: Floats

    @property
    def block(self) -> str:
        """Path of what changed."""
        return f"imu0.{self.triad}.sensitivity"


@value_class
class _Change:
    """A change (3,) at rest `place`, steady where None, its information at unit variance, the variance, its chance."""

    cause: _Cause
    place: int | None
    size: Floats
    information: Floats
    variance: float
    chance: float

    @property
    def covariance(self) -> Floats:
        """Covariance (3, 3)."""
        return np.asarray(self.variance * np.linalg.inv(self.information), dtype=np.float64)

    def explains_as(self, other: "_Change") -> bool:
        """Tell whether another change explains hardly more than this."""
        apart = other.size @ other.information @ other.size - self.size @ self.information @ self.size
        return bool(apart < TOLD_APART**2 * other.variance)


def change_by_one_cause(fit: MultiPositionFit, sensitivities: tuple[Floats, Floats]) -> ParameterChange | None:
    """Return the change that chance explains least, where it hardly does.

    Parameters
    ----------
    fit : of the whole recording
    sensitivities : (3, 3) published ones of accelerometer and gyroscope
    """
    first, last = _FEWEST_BESIDE + 1, len(fit.state.u) - 1 - _FEWEST_BESIDE
    if last < first:
        return None
    places = distinct_values(np.linspace(first, last, min(last - first + 1, _MOST_PLACES)).round().astype(int))
    causes, weights = _causes(fit, places, sensitivities), _Weights.of(fit, with_runs(fit))
    tried = [one for cause in causes for one in _tried(fit, weights, cause, places)]
    found = min(tried, key=lambda one: one.chance)
    if found.chance > _CHANCE:
        return None
    at_s, where = float("nan"), STEADILY
    if found.place is not None:
        at_s = float(fit.data.rotation_s[found.place - 1])
        where = f"after {at_s:.4g} s, against the time before"
        drifts = [one for one in tried if one.place is None and one.cause is found.cause]
        if drifts and drifts[0].explains_as(found):
            found, at_s, where = drifts[0], float("nan"), f"{STEADILY}, or {where}"
    by_change, block = found.cause.by_change, found.cause.block
    return ParameterChange(
        block=block,
        names=tuple(f"{block}[{i},{j}]" for i in range(3) for j in range(3)),
        values=by_change @ found.size,
        covariance=by_change @ found.covariance @ by_change.T,
        where=where,
        at_s=at_s,
        chance=found.chance,
    )


def least_turn_seen(fit: MultiPositionFit) -> float:
    """Return by how much a triad has to turn in the middle of a recording to be named whichever way it turns [rad]."""
    middle = np.array([len(fit.state.u) // 2])
    turned = next(_causes(fit, middle, (np.eye(3), np.eye(3))))
    problem = _Problem.of(fit, _Weights.of(fit, with_runs(fit)), turned)
    if problem.freedom < _FEWEST_LEFT:
        return float("inf")
    largest = _exceeded_by(_CHANCE / (2 * _CAUSES * _PLACES_COUNT), problem.freedom + _NOISE_COUNTS)
    return float(np.sqrt(3 * largest * np.linalg.eigvalsh(problem.change_at(0, int(middle[0])).covariance)[-1]))


def triad_causes(sensitivity: Floats) -> tuple[Floats, Floats]:
    """Return how elements of a sensitivity (3, 3) move, (9, 3) each, as the triad turns, and as its scales grow."""
    turn = (sensitivity @ skew(np.eye(3))).reshape(3, 9).T
    return turn, np.einsum("ki,kj->ijk", np.eye(3), sensitivity).reshape(9, 3)


def _causes(fit: MultiPositionFit, places: Integers, sensitivities: tuple[Floats, Floats]) -> Iterator[_Cause]:
    lines, (s, _, c_g, _, _) = fit.lines, fit.state.matrices
    k, n, t_s = len(places), len(fit.state.u), fit.data.interval_s
    after = np.arange(n) >= places[:, None]
    grown = [np.concatenate([after[:, : len(at)], [(at - t_s[0]) / np.ptp(t_s)]]) for at in (t_s, fit.data.rotation_s)]
    turn, gain = triad_causes(sensitivities[1])
    none, by_c = np.zeros((k, n, 3, 3)), lines.rotation_theta[..., CG_]
    turned = after[:, :-1, None, None] * (by_c @ np.moveaxis(skew(np.eye(3)) @ c_g, 0, -1).reshape(9, 3))
    yield _Cause(triad="gyroscope", jumps=False, at_rest=none, rotation=turned, by_change=-turn)
    jump = np.swapaxes(tangent_basis(fit.state.u[1:]), 1, 2) @ skew(lines.propagated)
    ends = np.arange(n - 1) == places[:, None] - 1
    turned = turned + ends[:, :, None, None] * jump
    yield _Cause(triad="gyroscope", jumps=True, at_rest=none, rotation=turned, by_change=-turn)
    gained = grown[1][:, :, None, None] * (by_c @ -np.einsum("ij,jk->ijk", c_g, np.eye(3)).reshape(9, 3))
    none, still = np.zeros((k + 1, n, 3, 3)), np.zeros((k + 1, n - 1, 2, 3))
    yield _Cause(triad="gyroscope", jumps=False, at_rest=none, rotation=gained, by_change=gain)
    gained = grown[0][:, :, None, None] * ((fit.state.u @ -s.T)[:, :, None] * np.eye(3))
    gain = triad_causes(sensitivities[0])[1]
    yield _Cause(triad="accelerometer", jumps=False, at_rest=gained, rotation=still, by_change=gain)


@value_class
class _Weights:
    """Which rotations are `kept` (n - 1,), their variance by noise, the weights, and how free residuals are.

    `at_rest` (n,) and `rotation` (n - 1,) are the degrees of freedom of each.
    """

    kept: Booleans
    noise: Floats
    whitening: Whitening
    at_rest: Floats
    rotation: Floats

    @classmethod
    def of(cls, fit: MultiPositionFit, kept: Booleans) -> "_Weights":
        """Return the weights in a fit with some of its rotations."""
        noise = rotation_variance(fit.data, fit.state)
        whitening = replace(fit.whitening, rotation=kept / np.sqrt(noise + fit.extra.rotation))
        rests, _, rotations = residual_freedom(fit.lines, fit.arrow, whitening, fit.free)
        return cls(kept=kept, noise=noise, whitening=whitening, at_rest=rests, rotation=rotations)


def _tried(fit: MultiPositionFit, weights: _Weights, cause: _Cause, places: Integers) -> Iterator[_Change]:
    """Yield a cause's change at each rest, and steadily.

    A rotation that was left out as an outlier may be the one in which the accelerometer turned: left out, it costs as
    much as the largest residual that is none.
    """
    kept, without = weights.kept, _Problem.of(fit, weights, cause)
    for k in range(len(cause.rotation)):
        place = int(places[k]) if k < len(places) else None
        if cause.jumps and place is not None and fit.data.linked[place - 1] and not kept[place - 1]:
            beside = _Problem.of(fit, _Weights.of(fit, kept | (np.arange(len(kept)) == place - 1)), cause)
            yield beside.change_at(k, place, GATE_SIGMA**2 + without.cost - beside.cost)
        else:
            yield without.change_at(k, place)


@value_class
class _Problem:
    """The linearised problem with changes of one cause, the directions eliminated.

    `cost` is the sum of squares at the minimum without a change; of the residuals of the cause's kind, `left` is their
    share of it, of `freedom`, and `known` what the noise at rest explains of their variance. `sizes` (k, 3) are the
    changes at each rest, of `information` (k, 3, 3) and `score` (k, 3).
    """

    cause: _Cause
    cost: float
    left: float
    freedom: float
    known: float
    score: Floats
    information: Floats
    sizes: Floats

    @classmethod
    def of(cls, fit: MultiPositionFit, weights: _Weights, cause: _Cause) -> "_Problem":
        """Return the problem of a fit with some of its rotations."""
        lines, p, new = fit.lines, len(fit.free), 3 * len(cause.rotation)
        whitening, kept = weights.whitening, weights.kept
        prior = np.pad(whitening.prior, (0, new))
        prior[p:, p:] = np.eye(new) / _LARGEST**2
        zero, columns = np.zeros((len(cause.at_rest[0]), 3, new)), (cause.at_rest, cause.rotation)
        at_rest, rotation = (np.moveaxis(one, 0, -1).reshape(*one.shape[1:3], new) for one in columns)
        beside = replace(
            lines,
            accelerometer_theta=np.concatenate([lines.accelerometer_theta, at_rest], axis=2),
            gyroscope_theta=np.concatenate([lines.gyroscope_theta, zero], axis=2),
            rotation_theta=np.concatenate([lines.rotation_theta, rotation], axis=2),
        )
        free = np.concatenate([fit.free, np.ones(new, dtype=bool)])
        system = normal_equations(beside, replace(whitening, prior=prior), np.pad(fit.from_prior, (0, new)), free, new)
        matrix, right, lowered = reduced_normal_equations(system, new)
        q = int(fit.free.sum())
        of_change = q + np.arange(new).reshape(3, -1).T
        across = matrix[:q, of_change.ravel()]
        solved = np.linalg.solve(matrix[:q, :q], np.column_stack([right[:q], across]))
        gained = lowered + float(right[:q] @ solved[:, 0])
        by_change, across = np.moveaxis(solved[:, 1:].reshape(q, -1, 3), 1, 0), across.reshape(q, -1, 3)
        own = matrix[of_change[:, :, None], of_change[:, None, :]] - np.einsum("qki,kqj->kij", across, by_change)
        if cause.triad == "gyroscope":
            left, freedom = whitening.rotation[:, None] * lines.rotation, float(weights.rotation[kept].sum())
            known = float(np.mean(weights.noise[kept] * whitening.rotation[kept] ** 2))
        else:
            left = np.einsum("kij,kj->ki", whitening.accelerometer, lines.accelerometer)
            freedom = float(weights.at_rest[fit.interval_used].sum())
            own_noise = whitening.accelerometer**2 @ fit.data.accelerometer_variance[:, :, None]
            known = float(np.mean(own_noise[fit.interval_used]))
        score = right[of_change] - np.einsum("qki,q->ki", across, solved[:, 0])
        return cls(
            cause=cause,
            cost=sum_of_squares(lines, whitening, fit.from_prior) - gained,
            left=float(np.sum(left**2)) - gained,
            freedom=freedom - 3,
            known=known,
            score=score,
            information=own,
            sizes=np.linalg.solve(own, score[:, :, None])[:, :, 0],
        )

    def change_at(self, k: int, place: int | None, allowed: float = 0.0) -> _Change:
        """Return the change at the k-th of the rests; `allowed` is by how much the cost was lower without it."""
        size = self.sizes[k]
        t2 = float(size @ self.score[k])
        left, freedom = max(self.left - t2, 0.0), self.freedom
        if left < freedom * self.known:
            left, freedom = left + _NOISE_COUNTS * self.known, freedom + _NOISE_COUNTS
        mean = left / max(freedom, 1.0)
        looks = _STEADY_CAUSES if place is None else _CAUSES * min(len(self.sizes), _PLACES_COUNT)
        chance = 1.0 if self.freedom < _FEWEST_LEFT else _chance(max(t2 + allowed, 0.0) / (3 * mean), freedom)
        told, chance = self.information[k], 2 * looks * chance
        return _Change(cause=self.cause, place=place, size=size, information=told, variance=mean, chance=chance)


def _chance(f: float, freedom: float) -> float:
    """Return how often F(3, freedom) exceeds a value (Paulson, 1942); in far tails it errs towards often."""
    root, of_left = np.cbrt(f), 2 / (9 * freedom)
    return NormalDist().cdf(-((1 - of_left) * root - 1 + _OF_THREE) / np.sqrt(of_left * root**2 + _OF_THREE))


def _exceeded_by(chance: float, freedom: float) -> float:
    """Return the value that F(3, freedom) exceeds so often, see `_chance`."""
    of_left, z2 = 2 / (9 * freedom), NormalDist().inv_cdf(chance) ** 2
    square, both, alone = (1 - of_left) ** 2 - z2 * of_left, (1 - of_left) * (1 - _OF_THREE), (1 - _OF_THREE) ** 2
    return (
        float(((both + np.sqrt(both**2 - square * (alone - z2 * _OF_THREE))) / square) ** 3) if square > 0 else np.inf
    )
