"""From a first guess to the estimate: descend, find the noise and the frames that do not belong, and come to rest."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import SolveError
from ...frozen import value_class
from ...progress import Progress, Step
from ...recording import Floats
from ...results.trust import ModelStep
from ...solve.bordered_band import Workspace
from .batch import Measurements, NoiseLevels, NormalEquations, RigState, error_terms, linearize_batch, next_walk
from .gauss_newton import (
    GaussNewtonStep,
    Iteration,
    apply_step,
    estimated_noise,
    gauss_newton_step,
    lasting_factor,
    line_search,
    pixel_levels,
)
from .layout import BorderLayout
from .terms.inertial_terms import InertialNoise
from .terms.visual_terms import CornerSums, Exposures, frame_scatter

GATE = 4.0
"""A frame whose corners scatter more than those of the median frame, by this factor in variance, is left out."""

_NEAR = 20.0  # sigmas: nearer than this to the minimum noise levels and frames are judged,
_SETTLED, _SETTLED_NEAR = 5e-3, 0.02  # if no more than this share of the cost is left to gain; roughly,
_NEARLY_SETTLED = 0.1  # if no more than this is
_AT_REST = 0.1  # sigmas that anything may be left after the step, as the last two steps foretell;
_WIDE_AT_REST = 0.5  # with the corners of a board, whose errors make sigmas of independent errors too small by far
_NOISE_AT_REST, _NOISE_ROUGHLY = 0.06, 0.2  # relative change of a level
_WALK_SHARE = 0.3  # by which a relative change of a random walk counts: sigmas follow it less
_FEW = 0.01
"""Share of the frames that may be judged otherwise without a further round: they lie at the limit."""

_JUDGEMENTS = 3  # of frames, after which they stay as they are
_LEAST_NOISE = 1e-2
"""Share of the first noise level below which none is believed: simulated data without noise must not end in zero."""
_PATIENCE = 10  # iterations after which steps must shrink
_FALLS = 0.9  # ratio of the costs of some iterations below which it is still going down
_FEWEST_FRAMES = 5


@value_class
class Solution:
    """The estimate.

    Attributes
    ----------
    state : trajectory and parameters
    measurements : with the exposures that were used
    noise : levels that were used
    noise_found : levels that the residuals show
    layout : columns of the border
    lin, step : last linearisation and the step from it to the estimate; step.covariance is that of the free parameters
    iterations : how it went
    converged : whether it came to rest, or was on its way when it was paused
    proven : the step for which it was left before it came to rest, as a larger model is estimated from here, or None
    """

    state: RigState
    measurements: Measurements
    noise: NoiseLevels
    noise_found: NoiseLevels
    layout: BorderLayout
    lin: NormalEquations
    step: GaussNewtonStep
    iterations: tuple[Iteration, ...]
    converged: bool
    proven: ModelStep | None = None

    @property
    def paused(self) -> bool:
        """Whether it was left before it came to rest."""
        return self.proven is not None

    def spare_workspace(self) -> Workspace:
        """Return memory for another solution: that of the equations, of which the factor alone is needed on."""
        return self.lin.system.workspace.beside_a_factor()


@value_class
class _Judged:
    """What the residuals say of the noise and of the frames.

    Attributes
    ----------
    found : levels that the residuals show
    noise, used : levels and exposures to go on with
    same : whether these are the ones that were used
    """

    found: NoiseLevels
    noise: NoiseLevels
    used: tuple[np.ndarray, ...]
    same: bool


def minimise_cost(
    measurements: Measurements,
    start: RigState,
    layout: BorderLayout,
    extended: BorderLayout,
    noise: NoiseLevels,
    *,
    estimate_noise: bool,
    estimate_walks: bool = False,
    gate: bool,
    max_iterations: int,
    tell: Progress = lambda _: None,
    stage: str = "estimating",
    workspace: Workspace | None = None,
    before: tuple[float, float] | None = None,
    proves: Callable[[Solution], ModelStep | None] = lambda _: None,
    near: bool = False,
) -> Solution:
    """Minimise the cost from a start.

    Parameters
    ----------
    measurements, start, layout : the problem
    extended : `layout` with further columns that are held; for the last linearisations
    noise : first levels
    estimate_noise : weigh by the levels that the residuals show
    estimate_walks : also by those of the biases' random walks
    gate : leave out frames that fit badly as a whole
    tell, stage : called with how far this stage is
    before : largest and length of the step that led to the start, by equations with the columns of `extended`
    proves : asked near the minimum, once noise levels and frames are roughly known: for which step to pause there
    near : whether it starts so near that the second step is the last, with levels that are roughly known

    Raises
    ------
    SolveError
        If the minimum cannot be found.
    """
    state, iterations, converged = start, list[Iteration](), False
    first, judgements, workspace = noise, 0, workspace or Workspace()
    far = before is None
    lin = linearize_batch(measurements, state, layout if far else extended, noise, probing=not far, workspace=workspace)
    step = _step(lin)
    found, changed, since = noise, False, 0  # since: the problem is the same
    largest, length = before or (np.inf, np.inf)  # of the step before
    rest = _AT_REST if layout.dense == len(layout) else _WIDE_AT_REST
    while (done := sum(one.accepted for one in iterations)) < max_iterations:
        _tell_iteration(tell, stage, done, step.largest)
        if lin.probing and step.decrease < _NEARLY_SETTLED * lin.cost:
            settled = step.largest < _NEAR and step.decrease < (_SETTLED_NEAR if near else _SETTLED) * lin.cost
            judgements += settled
            judged = _judged(
                measurements,
                lin,
                step,
                noise,
                first,
                estimate_noise=estimate_noise,
                estimate_walks=estimate_walks,
                gate=gate and settled and judgements <= _JUDGEMENTS,
                tolerance=_NOISE_AT_REST if settled and not near else _NOISE_ROUGHLY,
            )
            found = judged.found
            at_rest = settled and judged.same and _left(step, length) < rest  # noise was judged by the strict measure
            changed = not (judged.same or (changed and step.largest > largest))
            if at_rest or changed:
                state = apply_step(state, lin.layout, step)
                iterations.append(Iteration(cost=lin.cost, largest_step=step.largest, damping=0.0, accepted=True))
            if at_rest:
                converged = True
                break
            if changed:  # another problem from here on: costs are not comparable
                noise, measurements = judged.noise, replace(measurements, used=judged.used)
                if settled and judgements == 1:
                    here = Solution(
                        state=state,
                        measurements=measurements,
                        noise=noise,
                        noise_found=found,
                        layout=lin.layout,
                        lin=lin,
                        step=step,
                        iterations=tuple(iterations),
                        converged=True,
                    )
                    if (proven := proves(here)) is not None:
                        return replace(here, proven=proven)
                lin = linearize_batch(measurements, state, extended, noise, probing=True, workspace=workspace)
                largest, length = step.largest, step.length
                step, since = _step(lin), len(iterations)
                continue
        if _stalled(iterations[since:]):
            break
        state, lin, tried = line_search(
            measurements,
            lin,
            state,
            step,
            noise,
            layout=extended,
            workspace=workspace,
            damped=iterations[-1].damping if iterations else 0.0,
        )
        iterations += tried
        largest, length = step.largest, step.length
        del step  # its factor is large, and no longer valid
        step = _step(lin)
    if not lin.probing:
        lin = linearize_batch(measurements, state, extended, noise, probing=True, workspace=workspace)
        step = _step(lin)
        found = _shown_noise(measurements, lin, step, noise)
    return Solution(
        state=state,
        measurements=measurements,
        noise=noise,
        noise_found=found,
        layout=lin.layout,
        lin=lin,
        step=step,
        iterations=tuple(iterations),
        converged=converged,
    )


def _judged(
    measurements: Measurements,
    lin: NormalEquations,
    step: GaussNewtonStep,
    noise: NoiseLevels,
    first: NoiseLevels,
    *,
    estimate_noise: bool,
    estimate_walks: bool,
    gate: bool,
    tolerance: float,
) -> _Judged:
    """Judge noise levels, where they change by more than a tolerance, and frames near the minimum."""
    found = _at_least(_shown_noise(measurements, lin, step, noise), first)
    proposed = replace(found, walks=_next_walks(found, noise, first) if estimate_walks else noise.walks)
    kept = _gate_outliers(measurements, lin, noise) if gate else measurements.used
    same_noise = not estimate_noise or noise_change(proposed, noise) < tolerance
    same_frames = all(np.mean(a != b) < _FEW for a, b in zip(kept, measurements.used, strict=True))
    return _Judged(
        found=found,
        noise=noise if same_noise else proposed,
        used=measurements.used if same_frames else kept,
        same=same_noise and same_frames,
    )


def _tell_iteration(tell: Progress, stage: str, done: int, largest: float) -> None:
    """Tell how far a stage is: each iteration that is left makes the step some thirty times smaller."""
    tell(Step(f"iteration {done + 1}: largest step {largest:.2g} sigma", detail=True))
    left = 1 + max(np.log(largest / _AT_REST), 0.0) / np.log(30)
    tell(Step(stage, int(100 * done / (done + left)), 100))


def _stalled(iterations: list[Iteration]) -> bool:
    """Tell whether steps no longer shrink nor the cost falls, as where a direction is determined by noise alone."""
    taken = [one for one in iterations if one.accepted]
    if len(taken) <= _PATIENCE or taken[-1].cost < _FALLS * taken[-_PATIENCE // 2].cost:
        return False
    steps = [one.largest_step for one in taken]
    return min(steps[-_PATIENCE // 2 :]) > 0.5 * min(steps[: -_PATIENCE // 2])


def _left(step: GaussNewtonStep, before: float) -> float:
    """Return how far the minimum lies from the end of a step, in sigmas, as its length and that before it foretell.

    Steps of the parameters alone would not do: they may be done when the trajectory, which follows a clock that moved
    by forty sigmas, is not, and moves them again.
    """
    return step.length * min(1.0, step.length / max(before, 1e-12))


def _step(lin: NormalEquations) -> GaussNewtonStep:
    """Return the step to the minimum."""
    try:
        return gauss_newton_step(lin)
    except np.linalg.LinAlgError as error:
        raise SolveError(
            "the recording does not determine all that is estimated, or a part of it contradicts the rest (the normal "
            f"equations are singular: {error}). `gnomon check` on it says what it looks like; else look for long "
            "gaps and corners with wrong ids, or let fewer parameters be estimated."
        ) from error


def _shown_noise(
    measurements: Measurements, lin: NormalEquations, step: GaussNewtonStep, noise: NoiseLevels
) -> NoiseLevels:
    """Return the noise levels that the residuals show, those of images by how long errors of a point last."""
    found = estimated_noise(lin, step, noise)
    if not noise.lasting:
        return found
    cameras = zip(found.pixel_sigma, measurements.visual, lin.sums, strict=True)
    return replace(
        found, pixel_sigma=tuple(sigma * lasting_factor(data.exposures, sums) for sigma, data, sums in cameras)
    )


def _at_least(found: NoiseLevels, first: NoiseLevels) -> NoiseLevels:
    """Return noise levels that are not below a small share of the first ones."""
    return replace(
        found,
        imus=tuple(
            InertialNoise(
                gyroscope=max(a.gyroscope, _LEAST_NOISE * b.gyroscope),
                accelerometer=max(a.accelerometer, _LEAST_NOISE * b.accelerometer),
            )
            for a, b in zip(found.imus, first.imus, strict=True)
        ),
        pixel_sigma=tuple(max(a, _LEAST_NOISE * b) for a, b in zip(found.pixel_sigma, first.pixel_sigma, strict=True)),
    )


def _next_walks(found: NoiseLevels, used: NoiseLevels, stated: NoiseLevels) -> tuple[tuple[float, float], ...]:
    """Return the random walks of the biases to go on with."""
    return tuple(
        (next_walk(f[0], u[0], s[0]), next_walk(f[1], u[1], s[1]))
        for f, u, s in zip(found.walks, used.walks, stated.walks, strict=True)
    )


def noise_change(a: NoiseLevels, b: NoiseLevels) -> float:
    """Return the largest relative difference of two sets of noise levels."""
    pairs = [
        *zip(a.pixel_sigma, b.pixel_sigma, strict=True),
        *((x.gyroscope, y.gyroscope) for x, y in zip(a.imus, b.imus, strict=True)),
        *((x.accelerometer, y.accelerometer) for x, y in zip(a.imus, b.imus, strict=True)),
    ]
    walks = [(x, y) for one, other in zip(a.walks, b.walks, strict=True) for x, y in zip(one, other, strict=True)]
    largest = max(abs(x / y - 1) for x, y in pairs)
    return max(largest, *(_WALK_SHARE * abs(x / y - 1) for x, y in walks))


def _gate_outliers(measurements: Measurements, lin: NormalEquations, noise: NoiseLevels) -> tuple[np.ndarray, ...]:
    """Return for each camera which exposures belong to frames that fit."""
    return tuple(
        _fitting(data.exposures, sums, known, used, sigma_px)
        for data, sums, known, used, sigma_px in zip(
            measurements.visual, lin.sums, lin.known, measurements.used, noise.pixel_sigma, strict=True
        )
    )


def judged_after(
    measurements: Measurements, state: RigState, columns: BorderLayout, noise: NoiseLevels, step: GaussNewtonStep
) -> tuple[Measurements, NoiseLevels]:
    """Return the frames that fit after a step of these columns, by equations with probes, and the noise of corners."""
    terms = error_terms(replace(measurements, inertial=()), state, columns, noise, probing=False)[1]
    sums, free = [term.sums for term in terms], columns.free_index
    sigma_px = pixel_levels(sums, [term.inside for term in terms], noise, step, free)
    used = tuple(
        _fitting(data.exposures, term.sums, term.known, term.inside, sigma)
        for data, term, sigma in zip(measurements.visual, terms, sigma_px, strict=True)
    )
    inside = [term.known & own for term, own in zip(terms, used, strict=True)]
    return replace(measurements, used=used), replace(noise, pixel_sigma=pixel_levels(sums, inside, noise, step, free))


def _fitting(
    exposures: Exposures, sums: CornerSums, known: np.ndarray, used: np.ndarray, sigma_px: float
) -> np.ndarray:
    variance = frame_scatter(exposures, sums, known)
    seen = np.isfinite(variance)
    if seen.sum() < _FEWEST_FRAMES:
        return used
    limit = GATE * max(float(np.median(variance[seen])), sigma_px**2)
    frames = ~(variance > limit)
    return frames[exposures.frame]


def frame_mean_square(exposures: Exposures, sums: CornerSums, known: np.ndarray) -> Floats:
    """Return the mean squared residual per axis of every frame, (frames,) [px^2]; nan where nothing was imaged.

    Parameters
    ----------
    known : (e,) exposures whose sums mean something
    """
    count = int(exposures.frame.max()) + 1
    corners = sums.valid * known
    total = np.bincount(exposures.frame, np.nan_to_num(sums.mean_square) * corners, count)
    valid = np.bincount(exposures.frame, corners, count)
    return np.where(valid > 0, total / np.maximum(valid, 1), np.nan)
