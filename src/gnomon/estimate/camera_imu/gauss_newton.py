"""Steps of Gauss and Newton towards the minimum of the batch estimation, damped only where they would not go down.

The noise levels that the residuals show, by their variance components.

A group of residuals that was assumed to have sigma = 1 has sigma^2 = chi^2 / (number of residuals - trace of its part
of the hat matrix); the trace comes from random signs carried along as a further right-hand side.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import OptionError, SolveError
from ...frozen import value_class
from ...recording import Floats, Integers
from ...solve.bordered_band import Workspace
from ...solve.factorisation import Factor
from .batch import Measurements, NoiseLevels, NormalEquations, RigState, found_walks, linearize_batch, walk_sums
from .layout import BorderLayout
from .terms.inertial_terms import InertialNoise
from .terms.visual_terms import CornerSums, Exposures
from .trajectory import BIAS

_OVERSHOT = 0.25  # of the decrease that a step foretold: if less comes true, half of the step is tried, too
_WORTH = 1.0  # decrease of the cost below which nothing is
_SHARES = (1.0, 0.5, 0.25)
_DAMPINGS = tuple(10.0**power for power in range(-6, 5, 2))
"""Shares of the undamped step, then dampings, that are tried one after the other until the cost falls."""
_LONGEST = 100  # images over which errors of a point may last
_MOST_ROUNDS, _SAME = 20, 1e-3  # of Huber's proposal, and relative change after which it stands


@value_class
class GaussNewtonStep:
    """A Gauss-Newton step.

    Attributes
    ----------
    trajectory : (n, d) of the control points
    parameters : (p,) of the border; zero where held
    largest : largest step of a parameter in its sigmas
    decrease : predicted decrease of the cost
    factor : of the normal equations
    covariance : (f, f) of the free parameters
    """

    trajectory: Floats
    parameters: Floats
    largest: float
    decrease: float
    factor: Factor
    covariance: Floats

    @property
    def length(self) -> float:
        """Length of the whole step in sigmas, the trajectory's with it: nothing moves by more sigmas than this."""
        return float(np.sqrt(2 * max(self.decrease, 0.0)))

    def part(self, share: float) -> "GaussNewtonStep":
        """Return the same step, but only a share of the way."""
        return replace(self, trajectory=share * self.trajectory, parameters=share * self.parameters)


def gauss_newton_step(lin: NormalEquations, damping: float = 0.0) -> GaussNewtonStep:
    """Solve the normal equations.

    Parameters
    ----------
    damping : added to the diagonal, as a share of it

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not positive definite.
    """
    if damping:
        lin.system.damped(damping)
    return step_by(Factor.of(lin.system), lin.layout)


def step_by(factor: Factor, layout: BorderLayout) -> GaussNewtonStep:
    """Return the step by a factor of the normal equations.

    Where the model of an IMU would leave the range of its weak priors in one step, which happens far from the minimum
    in directions that the recording hardly determines, it is held this time.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the Schur complement is not positive definite.
    """
    free = layout.free_index
    parameters, covariance = _border_step(factor, free)
    leaves = layout.of_imu & layout.weak & (np.abs(parameters) > layout.prior_sigma)
    sigma = np.sqrt(np.diag(covariance))
    decrease = 0.5 * factor.quadratic(0, 0, free, covariance)
    if len(free):
        largest = float(np.max(np.abs(parameters[free]) / sigma))
    else:  # nothing but the trajectory is estimated: its mean step in sigmas
        largest = float(np.sqrt(2 * max(decrease, 0.0) / (factor.controls * factor.size)))
    if leaves[free].any():
        parameters, _ = _border_step(factor, np.flatnonzero(layout.free & ~layout.of_imu))
    return GaussNewtonStep(
        trajectory=factor.substituted(0, parameters),
        parameters=parameters,
        largest=largest,
        decrease=decrease,
        factor=factor,
        covariance=covariance,
    )


def _border_step(factor: Factor, free: Integers) -> tuple[Floats, Floats]:
    """Return the step of the border parameters (p,), zero outside of `free`, and the covariance of the free ones."""
    schur = factor.schur[np.ix_(free, free)]
    # Units differ by many powers of ten: scale to a unit diagonal before the inversion.
    scale = 1 / np.sqrt(np.maximum(np.diag(schur), 1e-300))
    whitener = np.linalg.inv(np.linalg.cholesky(schur * np.outer(scale, scale)))
    covariance = whitener.T @ whitener * np.outer(scale, scale)
    parameters = np.zeros(len(factor.schur))
    parameters[free] = covariance @ factor.schur_sides[free, 0]
    return parameters, covariance


def apply_step(state: RigState, layout: BorderLayout, step: GaussNewtonStep) -> RigState:
    """Return the state after a step.

    Raises
    ------
    SolveError
        If a lens would leave its domain.
    """
    try:
        parameters = layout.plus(state.parameters, step.parameters)
    except OptionError as error:
        raise SolveError(f"the intrinsics left the domain of their model: {error}") from error
    return RigState(trajectory=state.trajectory.plus(step.trajectory), parameters=parameters)


def _cost_change(lin: NormalEquations, following: NormalEquations) -> float:
    """Return how much the cost grew, but for what counts at one of both states only.

    A step of the time shift takes exposures at the ends of the trajectory in or out, and where a lens folds back, at
    the border of a wide image, a step of its coefficients does so with corners.
    """
    change = following.cost - lin.cost
    cameras = zip(lin.sums, following.sums, lin.inside, following.inside, strict=True)
    for before, after, inside, still_inside in cameras:
        change += float(before.cost[inside & ~still_inside].sum() - after.cost[still_inside & ~inside].sum())
        counted = np.repeat(inside & still_inside, before.lengths)
        was, now = np.isfinite(before.residual[:, 0]), np.isfinite(after.residual[:, 0])
        change += float(before.corner_cost[counted & was & ~now].sum())
        change -= float(after.corner_cost[counted & now & ~was].sum())
    return change


@value_class
class Iteration:
    """One iteration as it went: cost before it, largest step of a parameter in sigmas, damping, whether accepted."""

    cost: float
    largest_step: float
    damping: float
    accepted: bool


def _overshot(step: GaussNewtonStep, change: float) -> bool:
    """Tell whether much less came true than the step foretold."""
    return step.decrease > _WORTH and -change < _OVERSHOT * step.decrease


def line_search(
    measurements: Measurements,
    lin: NormalEquations,
    state: RigState,
    step: GaussNewtonStep,
    noise: NoiseLevels,
    *,
    layout: BorderLayout,
    workspace: Workspace,
    damped: float = 0.0,
) -> tuple[RigState, NormalEquations, list[Iteration]]:
    """Take the Gauss-Newton step; a part of it, or a damped one, only if it would not lower the cost.

    Parameters
    ----------
    lin, state, step : where the step starts, and the undamped step
    layout : for the linearisation after the step
    workspace : of all linearisations; `lin.system` is used up
    damped : by which the step before was damped: only a little less than that is tried again

    Returns
    -------
    state, lin : after the step
    tried : one entry for each trial

    Raises
    ------
    SolveError
        If no step lowers the cost, or the equations are singular.
    """

    def after(taken: GaussNewtonStep) -> tuple[RigState, NormalEquations]:
        there = apply_step(state, lin.layout, taken)
        return there, linearize_batch(measurements, there, layout, noise, probing=True, workspace=workspace)

    tried: list[Iteration] = []
    least = max((damping for damping in _DAMPINGS if damping < damped), default=0.0)
    dampings = [damping for damping in _DAMPINGS if damping >= least]
    for damping, share in (*((0.0, share) for share in _SHARES), *((damping, 1.0) for damping in dampings)):
        taken = step.part(share)
        try:
            if damping:  # the undamped equations were overwritten by those after the step
                again = linearize_batch(
                    measurements, state, lin.layout, noise, probing=lin.probing, workspace=workspace
                )
                taken = gauss_newton_step(again, damping)
            candidate, following = after(taken)
            change = _cost_change(lin, following)
            better = change <= 1e-9 * abs(lin.cost) + 1e-6
            if better and share == 1 and not damping and _overshot(step, change):
                shorter = after(step.part(0.5))
                nearer = _cost_change(lin, shorter[1]) < change
                candidate, following = shorter if nearer else after(step)  # one linearisation at a time has room
        except (np.linalg.LinAlgError, SolveError):
            candidate, following, better = state, lin, False
        tried.append(Iteration(cost=lin.cost, largest_step=taken.largest, damping=damping, accepted=better))
        if better:
            return candidate, following, tried
    raise SolveError(
        "no step lowers the cost of the batch estimation. The recording contradicts what was stated about it: check "
        "the target's size, the intrinsics and the units of the IMU."
    )


def estimated_noise(lin: NormalEquations, step: GaussNewtonStep, noise: NoiseLevels) -> NoiseLevels:
    """Return the noise levels that the residuals show, at a linearisation that was made with `noise` and probes."""
    free = lin.layout.free_index
    imus: list[InertialNoise] = []
    for i, used in enumerate(noise.imus):
        levels: list[float] = []
        for which, sigma in enumerate((used.gyroscope, used.accelerometer)):
            count, probe = lin.inertial_count[i][which], 1 + 2 * i + which
            absorbed = step.factor.quadratic(probe, probe, free, step.covariance)
            freedom = max(count - absorbed, 0.05 * count, 1.0)
            levels.append(sigma * float(np.sqrt(lin.inertial_chi2[i][which] / freedom)))
        imus.append(InertialNoise(gyroscope=levels[0], accelerometer=levels[1]))
    first = 1 + len(noise.pixel_sigma) + (2 + BIAS) * len(noise.imus)
    # After the step: under another level the biases are much smoother, or rougher, than before it.
    sums = walk_sums(lin.trajectory.plus(step.trajectory), noise.walks)
    walks = found_walks(sums, step.factor, first, free, step.covariance) * np.array(noise.walks)
    return replace(
        noise,
        imus=tuple(imus),
        pixel_sigma=pixel_levels(lin.sums, lin.inside, noise, step, free),
        walks=tuple((float(g), float(a)) for g, a in walks),
    )


def pixel_levels(
    sums: Sequence[CornerSums], inside: Sequence[np.ndarray], noise: NoiseLevels, step: GaussNewtonStep, free: Integers
) -> tuple[float, ...]:
    """Return the noise levels of corners that residuals of the cameras show.

    Parameters
    ----------
    sums, inside : of the exposures of each camera, and which count
    step, free : by equations with probes, and its columns: what of the residuals it absorbs
    """
    pixels: list[float] = []
    for camera, sigma in enumerate(noise.pixel_sigma):
        probe = 1 + 2 * len(noise.imus) + camera
        absorbed = step.factor.quadratic(probe, probe, free, step.covariance)
        pixels.append(sigma * _pixel_factor(sums[camera], inside[camera], sigma, noise.huber, absorbed))
    return tuple(pixels)


def lasting_factor(exposures: Exposures, sums: CornerSums) -> float:
    """Return by how much a mean over images scatters more than if the errors of a point were new in each.

    Its square is 1 + 2 sum rho(lag), with the correlations of the residuals of a point in images lag apart, none larger
    than one before it, up to the first that is not positive (initial monotone sequence, Geyer 1992): it changes by
    little where they do.
    """
    if exposures.point is None:
        return 1.0
    weight = np.where(np.isfinite(sums.residual).all(axis=1), sums.weight, 0.0)
    residual = np.nan_to_num(sums.comparable) * np.sqrt(weight)[:, None]
    frame = exposures.frame[exposures.of_corner]
    images = int(frame.max()) + 1
    place = exposures.point * (images + _LONGEST) + frame
    order = np.argsort(place, kind="stable")
    place, residual = place[order], residual[order]
    own, total, rho = float(np.mean(residual**2)), 1.0, 1.0
    for lag in range(1, _LONGEST):
        at = np.minimum(np.searchsorted(place, place + lag), len(place) - 1)
        pair = np.flatnonzero(place[at] == place + lag)
        rho = min(rho, float(np.mean(residual[pair] * residual[at[pair]])) / own) if len(pair) else 0.0
        if rho <= 0:
            break
        total += 2 * rho
    return float(np.sqrt(total))


def _pixel_factor(sums: CornerSums, inside: np.ndarray, sigma: float, huber: float, absorbed: float) -> float:
    """Return the scatter of the corners over the assumed one, by Huber's proposal 2 in two dimensions."""
    corners = np.repeat(inside, sums.lengths)
    residual = sums.comparable[corners]
    distance = np.sqrt(np.einsum("ij,ij->i", residual, residual)) / sigma
    distance = distance[np.isfinite(distance)]
    freedom = max(2 * len(distance) - absorbed, 0.05 * len(distance), 1.0)
    share = 1 - np.exp(-0.5 * huber**2) if np.isfinite(huber) else 1.0
    total = 1.0
    for _ in range(_MOST_ROUNDS):
        factor = float(np.sqrt((np.minimum(distance / total, huber) ** 2).sum() / (freedom * share)))
        total *= factor
        if abs(factor - 1) < _SAME:
            break
    return total
