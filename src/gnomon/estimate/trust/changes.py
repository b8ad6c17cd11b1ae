"""Which block of parameters changed in the middle of a recording, when, and by how much.

Halves that are pooled over all parameters dilute what changes in few, and sigmas that a change widened hide it. Here
one block alone may differ between two parts of the recording, everything else is common to both. Stretch c with pull
s_c and information S_c (`clusters.py`) then has theta + i_c G d, i_c = 1 in the second part (of a drift rising from 0
to 1), and d is estimated beside theta from

    [ sum S_c + prior  sum i_c S_c G      ] [theta]   [ sum s_c + prior ]
    [ G' sum i_c S_c   G' sum i_c^2 S_c G ] [  d  ] = [ G' sum i_c s_c  ]

Its covariance is held against the scatter of what is left of the pulls once the change is in the model, so that neither
levels of noise that the change inflated nor its own scatter hide it: w = d in units of its ordinary covariance, stretch
c moves it by h_c, and T^2 = w' V^-1 w with V = sum over clusters of h h' over what is expected of independent errors,
drawn to the mean of all directions as far as few clusters tell it. T^2 / rank follows F (Hotelling, 1931). The largest
of all looks counts, and so does their number (Bonferroni). Views that may be of another lens each are sorted into two
kinds, too, by what each tells of a block: any such sorting is a look, of 2^n.

A lens or a board that the model does not quite describe errs by where the board is, and parts of a recording differ in
that for longer than any cluster lasts. So what the longest clusters certainly show beyond independent errors is taken
to average out no further.
"""

import math
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from ...findings import Finding
from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.samples import distinct_values, median_of, quantile_of
from ...results.calibration import Calibration
from ...results.result import Booleans
from ...results.trust import ParameterChange
from .clusters import ClusterSums

STEADILY = "steadily, from the first to the last"
TOLD_APART = 3.0  # standard deviations by which one course of a change has to be better than another

_CHANCE = 0.005
"""That a recording in which nothing changed is said to have changed; over all looks."""

_FEWEST_IN_PART = 5  # stretches
_MOST = 3  # changes that are told apart
_MOST_BORDERS = 48  # that are tried to find when
_BORDERS_COUNT = 8  # as so many looks: parts whose borders are near each other differ alike
_SORTED_FROM, _SORTINGS = (0.5, 0.2, 0.8), 10  # shares of one kind to start sorting from; steps at most
_MOST_LOOKS = 1000  # of which the logarithm to base 2
_LEAST_KNOWN = 1e-3  # of the whole recording's information on a direction; less does not tell how it changed
_LENGTHS = (1, 3, 9)  # stretches that a cluster has
_FEWEST_CLUSTERS = 12
_LEAST_LEFT = 0.01  # of the variance of errors, once a change is in the model: less is rounding, and tells no scatter
_CERTAIN = 2.0  # standard deviations of a variance
_POOLED_COUNTS = 12.0  # degrees of freedom that the mean of all directions counts as
_INFLATED = 100.0  # variances that a change may have inflated, at most
_SAME = 1e-8  # of the largest: rounding
_MOST_TERMS, _ROUNDING = 10_000, 1e-15  # of a continued fraction
_LOOSE = 1e-6  # of the information: keeps open what a part does not determine


Search = Callable[[], Sequence[object]]
_ALONE: ContextVar[tuple[list[Search], Calibration | None] | None] = ContextVar("alone", default=None)


@contextmanager
def estimates_alone(start: Calibration | None = None) -> Generator[list[Search]]:
    """Leave out within this context what judges an estimate and changes none of its numbers.

    That is whether other lenses, a prior or parts of the recording agree, which turns would go unseen, what is left out
    to be predicted, and most thresholds of rests. Searches for what is wrong with the recording, such as parameters
    that changed during it, are postponed: they are in the list that is given.

    Parameters
    ----------
    start : a calibration of the same sensors, from which iterations start where it is near enough; no evidence
    """
    postponed = list[Search]()
    before = _ALONE.set((postponed, start))
    try:
        yield postponed
    finally:
        _ALONE.reset(before)


def estimates_are_judged() -> bool:
    """Tell whether more is wanted than an estimate, see `estimates_alone`."""
    return _ALONE.get() is None


def start_of_estimates() -> Calibration | None:
    """Return from where iterations start, see `estimates_alone`."""
    return None if (alone := _ALONE.get()) is None else alone[1]


def look_or_postpone(look: Callable[[], Sequence[Finding]]) -> list[Finding]:
    """Return findings, none where an estimate alone is wanted: the grave ones are then searched for later."""
    return [] if postpone_search(lambda: grave_findings(look())) else [*look()]


def grave_findings(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings that may change a result."""
    return [one for one in findings if one.severity in ("problem", "warning")]


def postpone_search(search: Search) -> bool:
    """Put a search off where an estimate alone is wanted, and tell whether that is so."""
    if (alone := _ALONE.get()) is not None:
        alone[0].append(search)
    return alone is not None


@value_class
class _Cut:
    """A course of a change: its share (n,) in each stretch, zero in the first part and one in the second, in words.

    `at_s` is from when on, of a change at once; else nan [s]. `looks` is out of how many it was chosen for what the
    stretches hold.
    """

    share: Floats
    words: str
    at_s: float = math.nan
    looks: float = 1.0


@value_class
class _Term:
    """A change in the model: of the directions G (p, q), by the shares of a cut."""

    cut: _Cut
    directions: Floats


@value_class
class _Estimate:
    """What one change is estimated to be.

    Attributes
    ----------
    change : (q,) in its directions
    root : (q, r) of its ordinary covariance, r directions that both parts tell
    w : (r,) the change in units of it
    moves : (n, r) by which each stretch moves w, once the change is in the model
    arm, weighed : (n, r, p) of w by the pull of each stretch, and that times its information
    design, on : see `_design`
    normal : (k, k)
    """

    change: Floats
    root: Floats
    w: Floats
    moves: Floats
    arm: Floats
    weighed: Floats
    design: Floats
    on: Floats
    normal: Floats

    @property
    def by_errors(self) -> Floats:
        """Covariance (n, r, r) of the moves for independent errors of each stretch."""
        return self.weighed @ np.swapaxes(self.arm, 1, 2)

    @property
    def taken(self) -> tuple[Floats, Floats]:
        """What the estimate takes of the errors, (n, r, k) and (k, k): shared common shared' of any two stretches."""
        return self.weighed @ self.design * self.on[:, None], np.asarray(np.linalg.inv(self.normal), dtype=np.float64)


@value_class
class _Block:
    """A block of scalars: path, rows (k,) among all scalars, directions (p, q) of the parameters that move it alone."""

    path: str
    rows: Integers
    directions: Floats


def parameter_changes(
    sums: ClusterSums,
    jacobian: Floats,
    names: Sequence[str],
    *,
    biases: Collection[str] = (),
    judged: Booleans | None = None,
    order: Integers | None = None,
    by_cause: Callable[[], ParameterChange | None] | None = None,
) -> tuple[ParameterChange, ...]:
    """Return the blocks of parameters that changed during a recording, most certain first.

    Parameters
    ----------
    sums : of the shortest stretches of time, at their minimum
    jacobian : (m, p) of the scalars by the parameters of the sums
    names : (m,) of the scalars, such as "imu0.gyroscope.sensitivity[0,1]"
    biases : paths of biases, which may differ between parts and are not judged
    judged : (m,) bool, scalars that were estimated and are to be judged; all where not given
    order : (n,) number of each stretch as it was recorded, by which odd and even ones are compared, where each is a
        view by itself that may be of another kind than the next; not given where they follow each other in time
    by_cause : asked for a change by one cause, which may tell of a block that shows none otherwise
    """
    n = len(sums)
    if n < 2 * _FEWEST_IN_PART:
        return ()
    again = partial(parameter_changes, sums, jacobian, names, biases=biases, judged=judged, order=order)
    if postpone_search(partial(again, by_cause=by_cause)):
        return ()
    judged = np.ones(len(names), dtype=bool) if judged is None else judged
    sums, jacobian = _followed(sums, jacobian)
    blocks, wandering = _blocks(sums, jacobian, names, judged, biases)
    courses = _courses(sums.t_s, np.arange(n) if order is None else order)
    looks = len(blocks) * sum(min(len(course), _BORDERS_COUNT) for course in courses)
    scan = _Scan(sums=sums, wandering=wandering, looks=looks, sorting=order is not None)
    found: list[ParameterChange] = []
    for _ in range(min(_MOST, len(blocks))):
        best = scan.most_certain(blocks, courses)
        if best is None:
            break
        found.append(scan.published(*scan.to_ends(*best, courses), jacobian, names))
        scan = scan.beside(*best)
        blocks = [other for other in blocks if other.path != best[0].path]
    at_once = by_cause() if by_cause is not None else None
    if at_once is not None and at_once.block not in {one.block for one in found}:
        found.append(at_once)
    return tuple(found)


@value_class
class _Scan:
    """A search for changes: in `looks` looks, beside the changes that were found before.

    Attributes
    ----------
    sums : of stretches
    wandering : (p, b) directions of the biases, or None
    looks : how many independent ones are as likely to find something by chance
    sorting : whether the stretches may be of two kinds in no order
    given : changes found before
    """

    sums: ClusterSums
    wandering: Floats | None
    looks: int
    sorting: bool = False
    given: tuple[_Term, ...] = ()

    def beside(self, block: _Block, cut: _Cut) -> "_Scan":
        """Return the search for what changed beside this."""
        return replace(self, given=(*self.given, _Term(cut=cut, directions=block.directions)))

    def most_certain(self, blocks: Sequence[_Block], courses: Sequence[Sequence[_Cut]]) -> tuple[_Block, _Cut] | None:
        """Return the block and the cut that chance explains least; None where it explains all.

        Of each course the cut that explains most is held against the scatter: beside the true border a part of what
        changed would count as scatter.
        """
        best, least = None, _CHANCE / self.looks
        explained = self._explained(blocks, [cut for course in courses for cut in course])
        ends = np.cumsum([len(course) for course in courses])
        for course, own in zip(courses, np.split(explained, ends[:-1]), strict=True):
            for block, at in zip(blocks, np.argmax(own, axis=0), strict=True):
                chance = _chance(self._estimate(block, course[at]), len(self.sums), least)
                if chance < least:
                    best, least = (block, course[at]), chance
        for block in blocks if self.sorting else ():
            cut = self._sorted(block)
            chance = (
                1.0
                if cut is None
                else cut.looks * _chance(self._estimate(block, cut), len(self.sums), least / cut.looks)
            )
            if cut is not None and chance < least:
                best, least = (block, cut), chance
        return best

    def to_ends(self, block: _Block, cut: _Cut, courses: Sequence[Sequence[_Cut]]) -> tuple[_Block, _Cut]:
        """Return a change as a drift where it may as well be one: of its two ends the parts tell half."""
        steady, found = courses[-1][-1], self._estimate(block, cut)
        if steady.words != STEADILY or cut is steady or found is None or self._estimate(block, steady) is None:
            return block, cut
        of_cut, of_steady = self._explained([block], [cut, steady])[:, 0]
        scatter = np.trace(_scatter(found, _clusters(len(self.sums))[-1], lasting=True)[0]) / len(found.w)
        if of_cut - of_steady > TOLD_APART**2 * scatter:
            return block, cut
        return block, replace(steady, words=f"{STEADILY}, or {cut.words}")

    def _sorted(self, block: _Block) -> _Cut | None:
        """Return the cut between stretches that tell of two values of a block; None where a part has too few."""
        n, q = len(self.sums), block.directions.shape[1]
        own = block.directions.T @ self.sums.information @ block.directions
        told = np.linalg.solve(
            own + own.mean(axis=0) + _LOOSE * np.eye(q), (self.sums.pull @ block.directions)[..., None]
        )
        along = told[:, :, 0] @ np.linalg.svd(told[:, :, 0], full_matrices=False)[2][0]
        found = [self._sorted_from(block, along > quantile_of(along, level)) for level in _SORTED_FROM]
        second = max(found, key=lambda one: one[1])[0]
        if not _FEWEST_IN_PART <= second.sum() <= n - _FEWEST_IN_PART:
            return None
        words = f"in {min(second.sum(), n - second.sum())} of {n}, in no order"
        return _Cut(share=second.astype(np.float64), words=words, looks=2.0 ** min(n, _MOST_LOOKS))

    def _sorted_from(self, block: _Block, second: Booleans) -> tuple[Booleans, float]:
        """Return the stretches that are of the second kind, and by how much two kinds lower the cost."""
        sums, count, gained, weighed = self.sums, block.directions.shape[1], 0.0, dict[bytes, Floats]()
        for _ in range(_SORTINGS):
            cut = _Cut(share=second.astype(np.float64), words="")
            design, on = _design(sums, (*self.given, _Term(cut=cut, directions=block.directions)))
            normal, right = _normal_equations(sums, design, on, _size(sums), weighed)
            step = np.linalg.solve(normal, right)
            gained = float(step @ right)
            common = (on * step)[:, :-count] @ design[:, :-count].T
            left = sums.pull - (sums.information @ common[:, :, None])[:, :, 0]
            change = block.directions @ step[-count:]
            sorted_anew = left @ change > 0.5 * (sums.information @ change) @ change
            if (sorted_anew == second).all():
                break
            second = sorted_anew
        return second, gained

    def _explained(self, blocks: Sequence[_Block], cuts: Sequence[_Cut]) -> Floats:
        """Return the squares (cuts, blocks) of changes in units of their ordinary covariance.

        All that is common, and the changes found before, are eliminated once for all parameters of a cut.
        """
        size = _size(self.sums)
        pull, information = self.sums.pull * size, self.sums.information * np.outer(size, size)
        base, on = _design(self.sums, self.given)
        normal, right = _normal_equations(self.sums, base, on, size)
        wandering = np.zeros((len(size), 0)) if self.wandering is None else self.wandering
        directions = np.concatenate([wandering, *(block.directions for block in blocks)], axis=1) / size[:, None]
        starts = np.cumsum([wandering.shape[1], *(block.directions.shape[1] for block in blocks)])
        shares = np.array([cut.share for cut in cuts])
        told = information @ directions  # (n, p, q)
        by_base = on[:, :, None] * ((base / size[:, None]).T @ told)  # (n, k, q)
        cross = np.tensordot(shares, by_base, 1)  # (cuts, k, q)
        k, q = cross.shape[1:]
        solved = np.linalg.solve(normal, np.column_stack([right, np.moveaxis(cross, 1, 0).reshape(k, -1)]))
        follow = np.moveaxis(solved[:, 1:].reshape(k, -1, q), 1, 0)
        own = np.tensordot(shares**2, directions.T @ told, 1) - np.swapaxes(cross, 1, 2) @ follow
        score = shares @ (pull @ directions) - np.swapaxes(cross, 1, 2) @ solved[:, 0]
        return _squares(own, score, starts)

    def published(self, block: _Block, cut: _Cut, jacobian: Floats, names: Sequence[str]) -> ParameterChange:
        """Return a change in published units."""
        n, found = len(self.sums), self._estimate(block, cut)
        assert found is not None
        scatter = _scatter(found, _clusters(n)[-1], lasting=True)[0]
        by_change = jacobian[block.rows] @ block.directions
        root = by_change @ found.root
        return ParameterChange(
            block=block.path,
            names=tuple(names[int(row)] for row in block.rows),
            values=by_change @ found.change,
            covariance=root @ scatter @ root.T,
            where=cut.words,
            at_s=cut.at_s,
            chance=min(1.0, self.looks * cut.looks * _chance(found, n)),
        )

    def _estimate(self, block: _Block, cut: _Cut) -> _Estimate | None:
        biases = () if self.wandering is None else (_Term(cut=cut, directions=self.wandering),)
        return _estimate(self.sums, (*biases, *self.given), block, cut)


def _followed(sums: ClusterSums, jacobian: Floats) -> tuple[ClusterSums, Floats]:
    """Return the sums and the jacobian with parameters that no scalar shows only as they follow the others.

    Of hundreds of such (the points of a board) a change asks for few combinations: those in which the whole recording
    and its first half move them where the others are moved.
    """
    shown = (jacobian != 0).any(axis=0)
    free, held = np.flatnonzero(shown), np.flatnonzero(~shown)
    if len(held) <= 2 * len(free):
        return sums, jacobian
    scale, half = np.outer(_size(sums), _size(sums)), len(sums) // 2
    whole = sums.total * scale
    first = sums.information[:half].sum(axis=0) * scale
    pairs = np.ix_(held, free)
    follow = np.linalg.solve(whole[np.ix_(held, held)], np.concatenate([whole[pairs], first[pairs]], axis=1))
    basis, _, _ = np.linalg.svd(follow, full_matrices=False)
    way = np.zeros((len(sums.prior_pull), basis.shape[1]))  # of all, so that nothing large is copied
    way[held] = _size(sums)[held, None] * basis
    kept = sums.of_parameters(free)
    along, prior = sums.information @ way, sums.prior_information @ way
    cross, beside = along[:, free], prior[free]
    return (
        replace(
            sums,
            pull=np.concatenate([kept.pull, sums.pull @ way], axis=1),
            information=np.concatenate(
                [
                    np.concatenate([kept.information, cross], axis=2),
                    np.concatenate([cross.swapaxes(1, 2), way.T @ along], axis=2),
                ],
                axis=1,
            ),
            prior_pull=np.concatenate([kept.prior_pull, sums.prior_pull @ way]),
            prior_information=np.block([[kept.prior_information, beside], [beside.T, way.T @ prior]]),
        ),
        np.concatenate([jacobian[:, free], np.zeros((len(jacobian), way.shape[1]))], axis=1),
    )


def _squares(information: Floats, score: Floats, starts: Integers) -> Floats:
    """Return u' M^-1 u (cuts, blocks) of M (cuts, q, q) and u (cuts, q), by what is told, the first rows eliminated.

    A block is from one of `starts` to the next.
    """
    first = int(starts[0])
    with_score = np.concatenate([information, score[:, :, None]], axis=2)
    by_first = np.linalg.solve(information[:, :first, :first] + _LOOSE * np.eye(first), with_score[:, :first])
    with_score = with_score - information[:, :, :first] @ by_first
    found: list[Floats] = []
    for low, high in pairwise(starts):
        values, vectors = np.linalg.eigh(with_score[:, low:high, low:high])
        along = (np.swapaxes(vectors, 1, 2) @ with_score[:, low:high, -1:])[:, :, 0]
        told = values > _LEAST_KNOWN
        found.append(np.sum(np.where(told, along**2 / np.where(told, values, 1.0), 0.0), axis=1))
    return np.stack(found, axis=1)


def _blocks(
    sums: ClusterSums, jacobian: Floats, names: Sequence[str], judged: Booleans, biases: Collection[str]
) -> tuple[list[_Block], Floats | None]:
    """Return the blocks that are judged, and the directions of the biases."""
    size = _size(sums)
    covariance = np.linalg.pinv(sums.total * np.outer(size, size), rcond=1e-14, hermitian=True)
    scaled = jacobian * size
    of_row = np.sqrt(np.maximum(np.einsum("mp,pq,mq->m", scaled, covariance, scaled), 0.0))
    moved = judged & (of_row > 0)
    scaled = np.where(moved[:, None], scaled / np.where(of_row > 0, of_row, 1.0)[:, None], 0.0)
    inverse = np.linalg.pinv(scaled, rcond=_SAME)  # (p, m): what is not published stays as it is
    paths = np.array([name.partition("[")[0] for name in names], dtype=object)
    blocks: list[_Block] = []
    free: list[Floats] = []
    for path in dict.fromkeys(paths[moved]):
        rows = np.flatnonzero(moved & (paths == path))
        left, share, _ = np.linalg.svd(scaled[rows] @ inverse[:, rows])  # a projection
        basis = left[:, share > 0.5]
        along = basis.T @ scaled[rows]
        values, vectors = np.linalg.eigh(along @ covariance @ along.T)
        told = values > _SAME * values.max(initial=0.0)
        root = basis @ (vectors[:, told] * np.sqrt(values[told]))
        directions = size[:, None] * (inverse[:, rows] @ root)
        if path in biases:
            free.append(directions)
        elif directions.size:
            blocks.append(_Block(path=path, rows=rows, directions=directions))
    return blocks, np.concatenate(free, axis=1) if free else None


def _courses(t_s: Floats, order: Integers) -> list[list[_Cut]]:
    """Return ways in which something may change: at once, for a while, in every other stretch, steadily."""
    n, k = len(t_s), np.arange(len(t_s))
    borders = distinct_values(np.linspace(_FEWEST_IN_PART, n - _FEWEST_IN_PART, _MOST_BORDERS).astype(int))
    courses = [[_at(t_s, int(place)) for place in borders]]
    low, high = n // 4, n - n // 4
    if high - low >= _FEWEST_IN_PART:
        words = f"between {t_s[low]:.4g} and {t_s[high - 1]:.4g} s, against the time before and after"
        courses.append([_Cut(share=((k >= low) & (k < high)).astype(np.float64), words=words)])
    odd = order % 2 == 1
    if _FEWEST_IN_PART <= odd.sum() <= n - _FEWEST_IN_PART:
        courses.append([_Cut(share=odd.astype(np.float64), words="every other one against those between")])
    span = float(t_s[-1] - t_s[0])
    if span > 0:
        courses.append([_Cut(share=(t_s - t_s[0]) / span, words=STEADILY)])
    return courses


def _at(t_s: Floats, place: int) -> _Cut:
    at_s = float(t_s[place - 1] + t_s[place]) / 2
    share = (np.arange(len(t_s)) >= place).astype(np.float64)
    return _Cut(share=share, words=f"after {at_s:.4g} s, against the time before", at_s=at_s)


def _estimate(sums: ClusterSums, given: Sequence[_Term], block: _Block, cut: _Cut) -> _Estimate | None:
    """Estimate a change beside others; None where no direction of it is told by both parts."""
    terms = [*given, _Term(cut=cut, directions=block.directions)]
    design, on = _design(sums, terms)
    normal, right = _normal_equations(sums, design, on, _size(sums))
    k, count = len(normal), block.directions.shape[1]
    rest, tested = slice(0, k - count), slice(k - count, k)
    by_rest = np.linalg.solve(normal[rest, rest], np.column_stack([normal[rest, tested], right[rest]]))
    without, by_rest = by_rest[:, -1], by_rest[:, :-1]
    # In units of what the whole recording tells of the block, two halves tell a quarter of a difference.
    values, vectors = np.linalg.eigh(normal[tested, tested] - normal[tested, rest] @ by_rest)
    told = values > _LEAST_KNOWN
    if not told.any():
        return None
    root = vectors[:, told] / np.sqrt(values[told])
    gain = np.concatenate([-root.T @ by_rest.T, root.T], axis=1)  # (r, k): of w by the rows of the equations
    w = gain @ right
    step = np.concatenate([without - by_rest @ root @ w, root @ w])
    arm = (gain * on[:, None]) @ design.T  # of w by each pull, (n, r, p)
    weighed = arm @ sums.information
    left = sums.pull - (sums.information @ ((on * step) @ design.T)[:, :, None])[:, :, 0]
    return _Estimate(
        change=root @ w,
        root=root,
        w=w,
        moves=np.einsum("nrp,np->nr", arm, left),
        arm=arm,
        weighed=weighed,
        design=design,
        on=on,
        normal=normal,
    )


def _size(sums: ClusterSums) -> Floats:
    """Return by what (p,) parameters are multiplied to have information of about one."""
    diagonal = np.einsum("npp->p", sums.information) + np.diag(sums.prior_information)
    return 1 / np.sqrt(np.maximum(diagonal, np.finfo(np.float64).tiny))


def _design(sums: ClusterSums, terms: Sequence[_Term]) -> tuple[Floats, Floats]:
    """Return the columns (p, k) of the parameters, scaled, and of changes, and how far (n, k) they act on a stretch."""
    n, p = sums.pull.shape
    design = np.concatenate([np.diag(_size(sums)), *(term.directions for term in terms)], axis=1)
    switched = [np.repeat(term.cut.share[:, None], term.directions.shape[1], axis=1) for term in terms]
    return design, np.concatenate([np.ones((n, p)), *switched], axis=1)


def _normal_equations(
    sums: ClusterSums, design: Floats, on: Floats, size: Floats, weighed: dict[bytes, Floats] | None = None
) -> tuple[Floats, Floats]:
    """Return matrix (k, k) and right-hand side (k,) of the parameters, scaled, and of all changes.

    The information of stretches that weigh alike is summed up once for all equations that share `weighed`.
    """
    p, k = design.shape
    right = np.sum(on * (sums.pull @ design), axis=0)
    normal = np.zeros((k, k))
    starts = [0, *(np.flatnonzero(np.any(on[:, 1:] != on[:, :-1], axis=0)) + 1), k]  # columns that act alike
    alike = [slice(low, high) for low, high in pairwise(starts)]
    weighed = {} if weighed is None else weighed  # columns that switch weigh as much by their squares
    for i, one in enumerate(alike):
        for other in alike[: i + 1]:
            weight = on[:, one.start] * on[:, other.start]
            key = weight.tobytes()
            if key not in weighed:
                weighed[key] = np.tensordot(weight, sums.information, 1)
            normal[one, other] = design[:, one].T @ weighed[key] @ design[:, other]
            normal[other, one] = normal[one, other].T
    normal[:p, :p] += sums.prior_information * np.outer(size, size)
    right[:p] += sums.prior_pull * size
    normal[p:, p:] += _LOOSE * np.eye(k - p)
    return normal, right


def _chance(found: _Estimate | None, n: int, least: float = 0.0) -> float:
    """Return how often chance alone makes a change as large; a lower bound where it cannot be less than `least`."""
    if found is None:
        return 1.0
    if least and chi_square_tail(float(found.w @ found.w) * _INFLATED, len(found.w)) > least:
        return 1.0
    *shorter, longest = _clusters(n)
    largest = _chance_with(found, longest, least, lasting=True)
    for cluster in shorter:
        if largest > least > 0:
            break
        largest = max(largest, _chance_with(found, cluster, least, lasting=False))
    return largest


def _clusters(n: int) -> list[Integers]:
    """Return the number (n,) of the cluster of each stretch, for clusters of some lengths."""
    return [np.arange(n) // length for length in _LENGTHS if length == 1 or n // length >= _FEWEST_CLUSTERS]


def _chance_with(found: _Estimate, cluster: Integers, least: float, *, lasting: bool) -> float:
    """Return how often chance makes a change as large where clusters of stretches err on their own.

    Beyond `least` it is a lower bound: of many clusters; fewer make large changes more likely.
    """
    # The scatter is at least what the mean of all directions has of it, of errors of which the estimate takes nothing.
    count = int(cluster[-1]) + 1
    pooled = float(np.sum(_moves(found, cluster) ** 2) / np.sum(found.weighed * found.arm))
    least_scatter = pooled * _POOLED_COUNTS / (count + _POOLED_COUNTS)
    likely = chi_square_tail(float(found.w @ found.w) / least_scatter, len(found.w)) if least_scatter > 0 else 0.0
    if likely > least > 0:
        return likely
    scatter, freedom = _scatter(found, cluster, lasting=lasting)
    if freedom <= 0:
        return 1.0
    t2 = float(found.w @ np.linalg.solve(scatter, found.w))
    rank = len(found.w)
    of_many = chi_square_tail(t2, rank)
    if of_many > least > 0:
        return of_many
    return f_tail(t2 / rank, rank, max(freedom, 1.0))


def chi_square_tail(x: float, freedom: int) -> float:
    """Return how often a chi-square of so many degrees of freedom exceeds x (Abramowitz and Stegun, 26.4.4, 26.4.5)."""
    half = x / 2
    tail, odd = (math.erfc(math.sqrt(half)), 1) if freedom % 2 else (math.exp(-half), 0)
    for k in range(1 if odd else 2, freedom - 1, 2):
        tail += math.exp(k / 2 * math.log(half) - half - math.lgamma(k / 2 + 1)) if half > 0 else 0.0
    return tail


def f_tail(x: float, first: float, second: float) -> float:
    """Return how often F of so many degrees of freedom exceeds x (DLMF 8.17.22): loading scipy.special takes longer."""
    whole = second + first * x
    if not x > 0 or not whole < math.inf:
        return float(not x > 0)
    a, b, y = second / 2, first / 2, second / whole
    if y > (a + 1) / (a + b + 2):
        return 1 - f_tail(1 / x, second, first)
    tail = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(y) + b * math.log(first * x / whole)
    fraction, above, below = 1.0, 1.0, 0.0
    for k in range(1, _MOST_TERMS):  # from the first term on (Lentz), which is the same where none of them is zero
        m = k // 2
        term = -(a + m) * (a + b + m) * y if k % 2 else m * (b - m) * y
        term /= (a + k - 1) * (a + k)
        below, above = 1 / (1 + term * below), 1 + term / above
        fraction *= above * below
        if abs(above * below - 1) < _ROUNDING:
            break
    return math.exp(tail) / (a * fraction)


def _moves(found: _Estimate, cluster: Integers) -> Floats:
    """Return by how much each cluster moves w, (c, r)."""
    return np.add.reduceat(found.moves, np.flatnonzero(np.diff(cluster, prepend=-1)))


def _scatter(found: _Estimate, cluster: Integers, *, lasting: bool) -> tuple[Floats, float]:
    """Return the covariance (r, r) of w as clusters show it, and its degrees of freedom.

    With as many parameters as data nothing is left that shows it: no degree of freedom, and the ordinary covariance.

    Parameters
    ----------
    cluster : (n,) number of the cluster of each stretch
    lasting : whether what they show beyond independent errors averages out no further
    """
    rank = len(found.w)
    first = np.flatnonzero(np.diff(cluster, prepend=-1))
    moves, by_errors = _moves(found, cluster), found.by_errors
    shared, common = found.taken
    shared = np.add.reduceat(shared, first)
    taken = shared @ common @ np.swapaxes(shared, 1, 2)
    expected = np.add.reduceat(by_errors, first) - taken
    total = expected.sum(axis=0)
    if np.trace(total) < _LEAST_LEFT * np.trace(by_errors.sum(axis=0)):
        return np.eye(rank), 0.0
    values, vectors = np.linalg.eigh(total)
    root = vectors / np.sqrt(np.maximum(values, 1e-9 * values.max()))
    own = root.T @ (moves.T @ moves) @ root
    own = vectors @ own @ vectors.T
    pooled = float(np.trace(moves.T @ moves) / np.trace(total))
    flat = shared.reshape(-1, shared.shape[2])
    both = flat.T @ flat @ common
    apart = max(float(np.einsum("kl,lk->", both, both) - np.sum(taken**2)), 0.0)  # between two clusters, squared
    freedom = float(np.trace(total) ** 2 / (np.sum(expected**2) + apart))
    of_one = freedom / rank
    share = of_one / (of_one + _POOLED_COUNTS)
    known = 1 / (share**2 / of_one + (1 - share**2) / freedom)
    certain = pooled * (1 - _CERTAIN * np.sqrt(2 / freedom)) - 1 if lasting else 0.0
    halves = len(cluster) / 2 / float(median_of(np.bincount(cluster)))  # clusters in half of the recording
    longer = 1 + max(certain, 0.0) / pooled * max(halves - 1, 0.0)
    return longer * (share * own + (1 - share) * pooled * np.eye(rank)), known
