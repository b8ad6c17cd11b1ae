"""Whether a bias stepped or warmed up while a recording lasted, and when, by the evidence of the rests.

Each mean at rest is the constant model plus white noise, an unknown extra scatter, and an unknown random walk; the
likelihood is that of the best of a grid of both. Steps between two rests, an exponential decay, the temperature where
it both rose and fell, and single rests that stand out are added one by one, the one that raises the likelihood most
first, while the gain exceeds what one more set of parameters, and the number of places that were looked at, let expect
(Schwarz 1978, with the choice of the place as in the two-part codes of Rissanen 1983). A bias that wanders is therefore
not taken for many steps, and a step not for wander.
"""

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from itertools import product

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.samples import median_of
from .measurements import fit_magnitude

_MARGIN = 5.0  # of log-likelihood beyond the length of the description: one false alarm in some hundred recordings
_MOST = 8  # changes
_EXTRA = (0.0, 1.0, 10.0, 100.0, 1e4)  # variance of the scatter, in units of the white noise
_WALK = (0.0, 0.3, 3.0, 30.0, 300.0, 3e4)  # variance that a walk reaches over the recording, in the same unit
_FEW_EXTRA, _FEW_WALK, _MANY = (0.0, 10.0), (0.0, 3.0, 300.0), 120
_NUMBERS = 300_000  # that are held at once for some kinds of noise
DECAYS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)  # time constants over the length of the recording
_SLOW = slice(3, None, 3)  # of these, which together are much like any drift in time: the temperature has to tell more
_FINER_DECAYS = np.array([0.7, 0.84, 1.0, 1.19, 1.41]), np.array([0.92, 0.96, 1.0, 1.04, 1.08])  # times the best
_FINER_PLACES = (np.linspace(-0.9, 0.9, 19).round(1),)  # beside the best of them
_WITHIN = 4.0  # of log-likelihood by which a step within a rest must be likelier than one beside it
_TOLD = 1e-13  # squared, of a column that the model does not explain already
_LEAST_SCALE = 0.3  # of the white noise that is known: less is chance
_FEWEST = 12  # rests
_FEW, _ENOUGH = 5, 11  # rests on either side that tell a common scale with the bias, and scales and axes with it


@value_class
class BiasChanges:
    """How the bias of one triad changed.

    Attributes
    ----------
    steps : places, ascending: k where the bias stepped between the static intervals k - 1 and k, and k + x where it
        did within interval k, after a share x of it
    warm_up_s : time constant of an exponential decay [s]; 0 without
    temperature : whether it follows the temperature
    outlying : indices of static intervals that alone stand out
    sensor : index k > 0 of the static interval from which on scales and axes are others, too: another sensor; 0 without
    gain : log-likelihood of all changes together
    """

    steps: tuple[float, ...] = ()
    warm_up_s: float = 0.0
    temperature: bool = False
    outlying: tuple[int, ...] = ()
    sensor: int = 0
    gain: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.steps or self.warm_up_s or self.temperature)


@value_class
class RestMeans:
    """Means at rest, of which the search is made: of whole static intervals, and of parts of long ones.

    Attributes
    ----------
    rest : (m,) number of the static interval that each is of, ascending
    t_s, half_s : (m,) middle and half of the length [s]
    means, variance : (m, 3) and the variance that white noise gives them
    degc : (m, k) temperature above a reference [K], its rate [K/s], which takes up what a thermometer's lag leaves,
        higher powers [K^j], and temperature times rate; None where nothing tells its effect from that of the time
    """

    rest: Integers
    t_s: Floats
    half_s: Floats
    means: Floats
    variance: Floats
    degc: Floats | None = None

    def place(self, at: float) -> float:
        """Return a place among these means as one among the static intervals; see `BiasChanges.steps`."""
        k = int(at)
        own = np.flatnonzero(self.rest == self.rest[k])
        return float(self.rest[k]) + (at - float(own[0])) / len(own)


def shares_before(place: Floats | float, n: int) -> Floats:
    """Return the share (n, ...) of each of n static intervals that lies before a place of `BiasChanges.steps`."""
    place = np.asarray(place, dtype=np.float64)
    return np.clip(place - np.arange(n).reshape(-1, *[1] * place.ndim), 0.0, 1.0)


def functions_of_time(changes: BiasChanges, t_s: Floats, half_s: Floats, degc: Floats | None = None) -> Floats:
    """Return what the bias follows at rest, (n, j): one in each segment but the last, the decay, the temperature."""
    n = len(t_s)
    steps = [shares_before(place, n) for place in changes.steps]
    if changes.warm_up_s:
        steps.append(_decay(t_s, half_s, changes.warm_up_s))
    if changes.temperature and degc is not None:
        steps.extend(degc.T)
    return np.stack(steps, axis=1) if steps else np.empty((n, 0))


def _decay(t_s: Floats, half_s: Floats, tau_s: Floats | float) -> Floats:
    """Return the means of an exponential decay over rests."""
    ratio = np.maximum(half_s / tau_s, 1e-9)
    return np.asarray(np.exp(-(t_s - t_s[0]) / tau_s) * np.sinh(ratio) / ratio, dtype=np.float64)


@value_class
class _Series:
    """Series of measurements with one design.

    Attributes
    ----------
    y : (n, a)
    design : (n, p) of what the constant model leaves open
    variance : (n, a) white noise
    pull : (n, d) of the bias' elements on each y
    """

    y: Floats
    design: Floats
    variance: Floats
    pull: Floats


@value_class
class _Candidates:
    """What may be added: functions of time (n, c), how many places they were chosen from, and what they are.

    The first are 1 in as many means as `before` says and 0 behind; those that stand out alone come last.
    """

    values: Floats
    places: Floats
    kind: tuple[str, ...]
    at: Floats
    before: Integers
    single: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))


@value_class
class _Whitened:
    """A series divided by the root of some kinds of noise.

    Attributes
    ----------
    series : as it was
    root, precision : (k, n, n) inverse roots and inverses of the kinds of noise
    y, design : (k, n, a), (k, n, p)
    typical : (a,) variance of white noise
    logdet : (k, 1) of the noise over `typical`
    """

    series: _Series
    root: Floats
    precision: Floats
    y: Floats
    design: Floats
    typical: Floats
    logdet: Floats

    @property
    def pulls(self) -> int:
        """Number of elements of the bias that pull on a measurement."""
        return self.series.pull.shape[1]


def gyroscope_changes(rests: RestMeans, u: Floats) -> BiasChanges:
    """Return how a gyroscope's bias changed.

    Parameters
    ----------
    rests : means of the gyroscope
    u : (n, 3) directions of gravity in the static intervals, which the bias may depend on
    """
    n, m = len(u), len(rests.t_s)
    if n < _FEWEST:
        return BiasChanges()
    design = np.column_stack([np.ones(m), u[rests.rest]]) if n > _FEWEST + 4 else np.ones((m, 1))
    if rests.degc is not None:
        design = np.column_stack([design, rests.degc[:, 1]])
    series = _Series(y=rests.means, design=design, variance=rests.variance, pull=np.ones((m, 1)))
    return _search(rests, lambda _: series, shortest=2)


def accelerometer_changes(rests: RestMeans) -> BiasChanges:
    """Return how an accelerometer's bias changed, by the magnitude of gravity alone."""
    n, means, variance = len(rests.t_s), rests.means, rests.variance
    if rests.rest[-1] + 1 < _FEWEST + 6:
        return BiasChanges()
    try:
        start = fit_magnitude(means, 1.0)
    except InitialisationError:
        return BiasChanges()
    # In units of gravity, so that the scales of the raw axes decide nothing.
    forces, variance = (means - start.bias) @ start.correction.T, variance @ (start.correction**2).T

    def magnitudes(moved: Floats) -> _Series:
        """Return |f| - 1 about the bias (n, 3) of each rest as far as it is known."""
        force = forces - moved
        length = np.linalg.norm(force, axis=1)
        u = force / length[:, None]
        rows = (u[:, :, None] * u[:, None, :]).reshape(n, 9)[:, [0, 3, 4, 6, 7, 8]]
        if rests.degc is not None:
            rows = np.concatenate([rows, rests.degc[:, 1:2] * u], axis=1)
        total = np.einsum("ni,ni->n", u, moved)  # what was taken off goes to the columns of the steps again
        return _Series(
            y=(length - 1 + total)[:, None],
            design=np.concatenate([rows, u], axis=1),
            variance=np.sum(u**2 * variance, axis=1)[:, None],
            pull=u,
        )

    return _search(rests, magnitudes, shortest=4)


def _search(rests: RestMeans, series: Callable[[Floats], _Series], shortest: int) -> BiasChanges:
    """Take one change after the other.

    Parameters
    ----------
    series : measurements about a bias (m, 3) that is known so far
    shortest : means in a segment
    """
    n = len(rests.t_s)
    candidates = _candidates(rests, shortest)
    taken: list[int] = []
    total = 0.0
    moved = np.zeros((n, 3))
    whitened = _whitened(rests, series(moved))
    slow = [k for k, kind in enumerate(candidates.kind) if kind == "warm-up"][_SLOW]
    warmth = [k for k, kind in enumerate(candidates.kind) if kind == "temperature"]
    for _ in range(_MOST):
        price = _price(candidates, n, taken, shortest)
        gains = _gains(whitened, candidates, _columns(whitened[0].series, candidates, taken)) - price
        gains[warmth] = -np.inf
        best = int(np.argmax(gains))
        gain, chosen = float(gains[best]), [best]
        if warmth and not set(warmth) & set(taken):
            beside = [*taken, *(k for k in slow if k not in taken)]
            powers_gain, powers = _powers_gain(whitened, candidates, taken, price[warmth])
            if powers_gain > max(gain, 0.0) and _powers_gain(whitened, candidates, beside, price[warmth])[0] > 0:
                gain, chosen = powers_gain, powers
        if gain <= 0:
            break
        taken += chosen
        total += gain
        candidates = _refined(rests, whitened, candidates, taken)
        if whitened[0].pulls > 1:  # the magnitude is not linear in the bias
            moved = _moved(series(np.zeros((n, 3))), candidates, taken)
            whitened = _whitened(rests, series(moved))
    given = _columns(whitened[0].series, candidates, taken)
    sensor = _other_sensor(whitened, given) if whitened[0].pulls > 1 else 0
    at = {
        kind: [float(candidates.at[k]) for k in taken if candidates.kind[k] == kind]
        for kind in ("step", "warm-up", "temperature", "single")
    }
    alone = np.bincount(rests.rest[np.array(at["single"], dtype=np.int64)], minlength=1)
    most = 2 * alone > np.bincount(rests.rest)[: len(alone)]
    return BiasChanges(
        steps=tuple(sorted(map(rests.place, at["step"]))),
        warm_up_s=next(iter(at["warm-up"]), 0.0),
        temperature=bool(at["temperature"]),
        outlying=tuple(map(int, np.flatnonzero(most))),
        sensor=int(rests.rest[sensor]),
        gain=total,
    )


def _candidates(rests: RestMeans, shortest: int) -> _Candidates:
    n, t_s = len(rests.t_s), rests.t_s
    span = max(float(t_s[-1] - t_s[0]), 1e-9)
    in_first = int(np.sum(rests.rest == 0))  # what came before is another turn-on, however short
    at = np.arange(1 if in_first > 1 else shortest, n - shortest + 1)
    at = at[(at >= shortest) | (at <= in_first)]
    steps = shares_before(at.astype(np.float64), n)
    tau = np.array(DECAYS) * span
    decays = _decay(t_s[:, None], rests.half_s[:, None], tau)
    warmth = np.empty((n, 0)) if rests.degc is None else rests.degc[:, [0, *range(2, rests.degc.shape[1] - 1)]]
    parts = {"step": steps, "warm-up": decays, "temperature": warmth, "single": np.eye(n)}
    counts = [part.shape[1] for part in parts.values()]
    return _Candidates(
        values=np.concatenate(list(parts.values()), axis=1),
        places=np.repeat(counts, counts).astype(float),
        kind=tuple(kind for kind, part in parts.items() for _ in range(part.shape[1])),
        at=np.concatenate([at, tau, np.zeros(counts[2]), np.arange(n)]).astype(float),
        before=at,
        single=np.arange(sum(counts)) >= sum(counts) - n,
    )


def _refined(
    rests: RestMeans, whitened: Sequence[_Whitened], candidates: _Candidates, taken: Sequence[int]
) -> _Candidates:
    """Return the candidates with the time constant of the decay, and the place of the last step, that are likeliest.

    A step stays between two means unless a place within one of them is likelier by far.
    """
    n = len(rests.t_s)
    values, at = candidates.values.copy(), candidates.at.copy()
    for k in (k for k in taken if candidates.kind[k] == "warm-up" or (k == taken[-1] and candidates.kind[k] == "step")):
        others = [other for other in taken if other != k]
        for grid in _FINER_DECAYS if candidates.kind[k] == "warm-up" else _FINER_PLACES:
            finer = at[k] * grid if candidates.kind[k] == "warm-up" else at[k] + grid
            columns = (
                _decay(rests.t_s[:, None], rests.half_s[:, None], finer)
                if candidates.kind[k] == "warm-up"
                else shares_before(finer, n)
            )
            chosen = [k] * len(finer)
            trial = _Candidates(
                values=columns,
                places=candidates.places[chosen],
                kind=(candidates.kind[k],) * len(finer),
                at=finer,
                before=np.empty(0, dtype=np.int64),
                single=candidates.single[chosen],
            )
            given = replace(candidates, values=values)
            gains = _gains(whitened, trial, _columns(whitened[0].series, given, others))
            gains[grid % 1 != 0] -= _WITHIN if candidates.kind[k] == "step" else 0.0
            best = int(np.argmax(gains))
            at[k], values[:, k] = finer[best], columns[:, best]
    return replace(candidates, values=values, at=at)


def _price(candidates: _Candidates, n: int, taken: Sequence[int], shortest: int) -> Floats:
    """Return what the log-likelihood must gain; infinite where a candidate does not go with what was taken."""
    price = np.log(candidates.places) + 1.5 * np.log(n) + _MARGIN
    price[candidates.single] += _MARGIN
    price[list(taken)] = np.inf
    kinds = np.array(candidates.kind)
    if len(slopes := np.flatnonzero(kinds == "temperature")):
        price[slopes] = 1.5 * np.log(n)  # of the powers, of which only the first asks whether there is any
        price[slopes[0]] += 2 * _MARGIN
    if sum(kinds[k] == "single" for k in taken) >= n // 10:
        price[candidates.single] = np.inf
    if any(kinds[k] == "warm-up" for k in taken):
        price[kinds == "warm-up"] = np.inf
    for k in taken:
        if kinds[k] == "step":
            price[(kinds == "step") & (np.abs(candidates.at - candidates.at[k]) < shortest)] = np.inf
    return price


def _blocks(series: _Series, candidates: _Candidates, some: Sequence[int] | Integers) -> Floats:
    """Return the columns of some candidates, (n, s, d); one that stands out needs no more than one."""
    some = np.array(some, dtype=np.int64)
    values, single = candidates.values[:, some], candidates.single[some]
    blocks = values[:, :, None] * series.pull[:, None, :]
    blocks[:, single, 1:] = 0.0
    blocks[:, single, 0] = values[:, single]
    return blocks


def _columns(series: _Series, candidates: _Candidates, taken: Sequence[int]) -> Floats:
    """Return the columns of the candidates that were taken, (n, s d)."""
    return _blocks(series, candidates, taken).reshape(len(series.pull), -1)


def _whitened(rests: RestMeans, series: _Series) -> list[_Whitened]:
    """Return the series by each kind of noise on the grid, as many at once as memory bears.

    The parts of one rest have its scatter in common.
    """
    (n, d), t_s = series.pull.shape, rests.t_s
    typical = median_of(series.variance, axis=0)
    white = np.mean(series.variance / typical, axis=1)
    since = (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-9)
    walk = np.minimum(since[:, None], since) * (series.pull @ series.pull.T) / np.mean(series.pull**2) / d
    scatter = (rests.rest[:, None] == rests.rest).astype(np.float64)
    kinds = np.array(list(product(_EXTRA, _WALK) if n <= _MANY else product(_FEW_EXTRA, _FEW_WALK)))
    at_once = max(1, _NUMBERS // (n * (n + series.design.shape[1] ** 2)))
    found: list[_Whitened] = []
    for some in np.split(kinds, range(at_once, len(kinds), at_once)):
        a, b = some.T[:, :, None, None]
        factor = np.linalg.cholesky(np.diag(white) + a * scatter + b * walk)
        root = np.linalg.inv(factor)
        found.append(
            _Whitened(
                series=series,
                root=root,
                precision=_across(root) @ root,
                y=root @ series.y,
                design=root @ series.design,
                typical=typical,
                logdet=2 * np.sum(np.log(np.einsum("knn->kn", factor)), axis=1)[:, None],
            )
        )
    return found


def _likelihood(squares: Floats, freedom: Floats, logdet: Floats, typical: Floats) -> Floats:
    """Return log-likelihoods by sums of squares (..., a), the scale the best one that is not below the known noise."""
    relative = squares / typical
    scale = np.maximum(relative / freedom, _LEAST_SCALE)
    return np.asarray(-0.5 * (relative / scale + freedom * np.log(scale) + logdet), dtype=np.float64)


def _gains(whitened: Sequence[_Whitened], candidates: _Candidates, given: Floats) -> Floats:
    """Return by how much each candidate raises the log-likelihood beside given columns (n, m), (c,)."""
    axes = whitened[0].y.shape[2]
    base, raised = np.full(axes, -np.inf), np.full((len(candidates.kind), axes), -np.inf)
    for some in whitened:
        left, squares, freedom = _without(some, given)
        base = np.maximum(base, _likelihood(squares, freedom, some.logdet, some.typical).max(axis=0))
        lower = np.maximum(squares[:, None] - _explained(some, left, candidates), 0.0)
        likelier = _likelihood(lower, freedom[:, None], some.logdet[:, None], some.typical)
        raised = np.maximum(raised, likelier.max(axis=0))
    return np.asarray(np.sum(raised - base, axis=1), dtype=np.float64)


def _explained(some: _Whitened, left: Floats, candidates: _Candidates) -> Floats:
    """Return the squares (k, c, axes) that each candidate explains of what a model leaves, see `_without`."""
    pull, whole, last = some.series.pull, some.precision, candidates.before - 1
    of_y = left @ some.series.y
    others = np.flatnonzero(~candidates.single)[len(last) :]
    blocks = _blocks(some.series, candidates, others)
    flat = blocks.reshape(len(blocks), -1)
    of_blocks, whole_blocks = ((one @ flat).reshape(-1, *blocks.shape) for one in (left, whole))
    parts = (
        (
            _products_before(left, pull)[:, last],
            _squares_before(whole, pull)[:, last],
            np.cumsum(pull[:, :, None] * of_y[:, :, None], axis=1)[:, last],
        ),
        (
            np.einsum("nci,kncj->kcij", blocks, of_blocks),
            np.einsum("nci,knci->kci", blocks, whole_blocks),
            np.einsum("nci,kna->kcia", blocks, of_y),
        ),
        (
            np.einsum("knn->kn", left)[:, :, None, None],
            np.einsum("knn->kn", whole)[:, :, None],
            of_y[:, :, None],
        ),
    )
    return np.concatenate([_fitted(*part) for part in parts[: 3 if candidates.single.any() else 2]], axis=1)


def _fitted(gram: Floats, size: Floats, cross: Floats) -> Floats:
    """Return cross' inv(gram) cross, (k, c, axes), of columns whose squares were `size` before the model took some."""
    # What the design explains already, or nothing moves, is no candidate.
    told = np.einsum("kcdd->kcd", gram) > 1e-6 * size
    beside = np.where(told, 1e-9 * size + 1e-300, np.maximum(size, 1.0) * 1e12)
    return np.sum(cross * np.linalg.solve(gram + beside[..., None] * np.eye(gram.shape[-1]), cross), axis=2)


def _powers_gain(
    whitened: Sequence[_Whitened], candidates: _Candidates, taken: Sequence[int], price: Floats
) -> tuple[float, list[int]]:
    """Return what powers of the temperature raise the log-likelihood beyond their price, and which these are."""
    powers = [k for k, kind in enumerate(candidates.kind) if kind == "temperature"]
    own = [_columns(whitened[0].series, candidates, [*taken, *powers[:i]]) for i in range(len(powers))]
    each = [_gains(whitened, candidates, given)[k] for k, given in zip(powers, own, strict=True)]
    gains = np.cumsum(np.array(each) - price)
    best = int(np.argmax(gains))
    return float(gains[best]), powers[: best + 1]


def _without(some: _Whitened, given: Floats) -> tuple[Floats, Floats, Floats]:
    """Return what is left beside the design and given columns (n, m): P, the squares y' P y (k, a), and the freedom.

    P (k, n, n) is the precision less what these explain, so that x' P x is what remains of the squares of x.
    """
    q, rank = _orthonormal(np.concatenate([some.design, some.root @ given], axis=2))
    left = some.y - q @ (_across(q) @ some.y)
    back = _across(some.root) @ q
    freedom = np.maximum(some.y.shape[1] - rank, 1.0)[:, None]
    return some.precision - back @ _across(back), np.sum(left**2, axis=1), freedom


def _across(matrices: Floats) -> Floats:
    return np.swapaxes(matrices, -1, -2)


def _products_before(matrices: Floats, columns: Floats) -> Floats:
    """Return x' M x by the first 1, 2 ... n of the rows of columns x (n, c), (k, n, c, c), of symmetric M (k, n, n)."""
    earlier = np.tril(matrices, -1) @ columns + 0.5 * np.einsum("knn->kn", matrices)[..., None] * columns
    added = columns[:, :, None] * earlier[:, :, None, :]
    added += columns[:, None, :] * earlier[:, :, :, None]
    return np.cumsum(added, axis=1, out=added)


def _squares_before(matrices: Floats, columns: Floats) -> Floats:
    """Return the diagonals of `_products_before`, (k, n, c)."""
    earlier = np.tril(matrices, -1) @ columns + 0.5 * np.einsum("knn->kn", matrices)[..., None] * columns
    return np.cumsum(2 * columns * earlier, axis=1)


def _other_sensor(whitened: Sequence[_Whitened], given: Floats) -> int:
    """Return from which static interval on all scales and axes are others, beside the bias; 0 where they stay.

    Where one side has too few static intervals for nine parameters, a common factor stands for scales and axes.
    """
    series = whitened[0].series
    n = len(series.pull)
    cuts = np.arange(_FEW, n - _FEW + 1)
    few = np.minimum(cuts, n - cuts) < _ENOUGH
    without, with_one = -np.inf, np.full(len(cuts), -np.inf)
    for some in whitened:
        left, squares, freedom = _without(some, given)
        likelihood = _likelihood(squares, freedom, some.logdet, some.typical)
        without = max(without, float(likelihood.sum(axis=1).max()))
        for chosen, before in ((few, np.column_stack([np.ones(n), series.pull])), (~few, series.design)):
            explained = _explained_before(some, left, before, cuts[chosen])
            rest = np.maximum(squares[:, None] - explained, 0.0)
            likelihood = _likelihood(rest, freedom[:, None], some.logdet[:, None], some.typical)
            with_one[chosen] = np.maximum(with_one[chosen], likelihood.sum(axis=2).max(axis=0))
    gains = with_one - without - (np.log(n) + 0.5 * np.where(few, 4, 9) * np.log(n) + _MARGIN)
    best = int(np.argmax(gains)) if len(cuts) else -1
    return int(cuts[best]) if best >= 0 and gains[best] > 0 else 0


def _explained_before(some: _Whitened, left: Floats, before: Floats, cuts: Integers) -> Floats:
    """Return the squares that parameters of their own explain before each of some static intervals, (k, cuts, axes).

    Parameters
    ----------
    left : see `_without`
    before : (n, c) derivatives by these parameters
    cuts : numbers of static intervals
    """
    squares = _squares_before(some.precision, before)[:, cuts - 1]
    size = np.sqrt(np.where(squares > 0, squares, 1.0))
    of_y = left @ some.series.y
    cross = np.cumsum(before[:, :, None] * of_y[:, :, None], axis=1)[:, cuts - 1] / size[..., None]
    gram = _products_before(left, before)[:, cuts - 1] / (size[..., None] * size[..., None, :])
    told = max(_TOLD, 4 * np.finfo(np.float64).eps * len(before))  # beyond the rounding of the sums
    return np.sum(cross * np.linalg.solve(gram + told * np.eye(before.shape[1]), cross), axis=2)


def _orthonormal(design: Floats) -> tuple[Floats, Floats]:
    """Return orthonormal bases (k, n, p) of what the columns span, filled up with zeros, and their ranks (k,)."""
    size = np.linalg.norm(design, axis=1, keepdims=True)
    u, s, _ = np.linalg.svd(design / np.where(size > 0, size, 1.0), full_matrices=False)
    kept = s > 1e-9 * s.max(axis=1, keepdims=True, initial=0.0)
    return u * kept[:, None], kept.sum(axis=1).astype(np.float64)


def _moved(series: _Series, candidates: _Candidates, taken: Sequence[int]) -> Floats:
    """Return the bias (n, 3) that steps and a warm-up add, by least squares."""
    d = series.pull.shape[1]
    changes = [k for k in taken if candidates.kind[k] != "single"]
    alone = [k for k in taken if candidates.kind[k] == "single"]
    blocks = _columns(series, candidates, changes)
    root = 1 / np.sqrt(series.variance)
    design = np.concatenate([series.design, blocks, candidates.values[:, alone]], axis=1) * root
    size = np.linalg.norm(design, axis=0)
    size = np.where(size > 0, size, 1.0)
    found = np.linalg.lstsq(design / size, (series.y * root)[:, 0], rcond=1e-9)[0] / size
    first = series.design.shape[1]
    steps = found[first : first + d * len(changes)].reshape(len(changes), d)
    return np.asarray(candidates.values[:, changes] @ steps, dtype=np.float64)
