"""Where axes began to be along others, or the gyroscope to show another share of a rotation, half-way in a recording.

Each rotation between two rests should lead gravity from where it was read before to where it is read after. Which way
the gyroscope's axes stand to the accelerometer's, and how much of a rotation it shows, is tried for all rotations;
where no one way explains them, two do, one up to some rotation and another one after it.
"""

from itertools import permutations, product

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from .magnitude import fit_magnitude
from .problem import MultiPositionProblem
from .rotations import integrate_rates, segment_moments

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
_ACROSS = 0.7  # cosine to where a turn began, in its middle
_FINE = np.linspace(0.8, 1.25, 10)


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
        return None if unseen else AxesChange(row=row, triad="accelerometer", after=-np.eye(3))
    if len(off) < _FEWEST:
        return None
    ways = [(way, float(np.median(factors[way][alike[way]]))) for way in range(len(_SIGNED)) if alike[way].any()]
    ways += [(usual, factor) for factor in np.quantile(own, np.linspace(0, 1, _FACTORS)).tolist()]
    return _change_between(turns, ways, linked)


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
