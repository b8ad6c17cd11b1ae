"""Steps of Gauss and Newton towards the minimum of the batch estimation, damped only where they would not go down."""

from dataclasses import replace

import numpy as np

from ...errors import OptionError, SolveError
from ...frozen import value_class
from ...recording import Floats, Integers
from ...solve.bordered_band import Factor, Workspace
from .batch import Measurements, NoiseLevels, NormalEquations, RigState, linearize_batch
from .layout import BorderLayout

_OVERSHOT = 0.25  # of the decrease that a step foretold: if less comes true, half of the step is tried, too
_WORTH = 1.0  # decrease of the cost below which nothing is
_SHARES = (1.0, 0.5, 0.25)
_DAMPINGS = tuple(10.0**power for power in range(-6, 5, 2))
"""Shares of the undamped step, then dampings, that are tried one after the other until the cost falls."""


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
    return step_by(lin.system.factorised(), lin.layout)


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
    probing: bool,
    workspace: Workspace,
    damped: float = 0.0,
) -> tuple[RigState, NormalEquations, list[Iteration]]:
    """Take the Gauss-Newton step; a part of it, or a damped one, only if it would not lower the cost.

    Parameters
    ----------
    lin, state, step : where the step starts, and the undamped step
    layout, probing : for the linearisation after the step
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
        return there, linearize_batch(measurements, there, layout, noise, probing=probing, workspace=workspace)

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
