"""The minimum over all views at once, and how certain it is.

Levenberg-Marquardt on the shared parameters, the poses of the views eliminated (Schur); the scatter of the corners is
found in rounds between. Whole frames that fit far worse than the others are left out where the estimate is robust.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...errors import SolveError
from ...frozen import value_class
from ...recording import Floats
from ...results.camera_diagnostics import SolverStep
from ..camera_imu.terms.visual_terms import CornerNoise, Exposures
from ..trust.clusters import ClusterSums
from .normal import ReducedEquations, ViewNormalEquations, eliminate_poses, view_sums
from .problem import OTHER_BOARD, Problem
from .rig import CameraRig, RigSolution, RigViews, SeenCorners

_AT_REST = 3e-3  # sigmas of a shared parameter
_NEARLY = 0.3  # the same, for a round whose weights are not final yet
_SAME_SIGMA = 0.01
_ROUNDS = 8
_MOST_DAMPING = 1e10
_CORRECTIONS = 3
_BAD_FRAME = 4.0  # scatter of a frame over the usual one
_REMOVALS = 3
_IMAGED = 0.5  # of the corners in use


@value_class
class _State:
    """Where the iterations are."""

    problem: Problem
    rig: CameraRig
    noise: Mapping[str, CornerNoise]
    at: ViewNormalEquations
    steps: tuple[SolverStep, ...]
    converged: bool = False


def solve_rig(
    views: RigViews, start: CameraRig, *, board: tuple[str, ...] = (), robust: bool = True, most_iterations: int = 50
) -> RigSolution:
    """Estimate all lenses, the cameras' poses to each other, and parts of the board's shape.

    Parameters
    ----------
    views : of the board
    start : a rig near the minimum, of the same views
    board : what is estimated of its shape: of "aspect", "bow" and "corners"
    robust : single corners that fit badly count less, and frames that do are left out
    most_iterations : of one minimisation

    Raises
    ------
    SolveError
        If the cost is not a finite number at the start, or the estimation runs away.
    """
    try:
        with np.errstate(all="ignore"):  # what does not suit the views runs away, and is told by what comes out
            found = _solved(views, start, board, robust, most_iterations)
    except np.linalg.LinAlgError as error:
        raise SolveError(f"the estimation of the cameras runs away. {OTHER_BOARD}") from error
    for name, seen in found.corners.items():
        if not np.isfinite(seen.residual).mean() > _IMAGED:
            raise SolveError(f"{name}: the estimation runs away, its lens images few of the corners. {OTHER_BOARD}")
    return found


def _solved(
    views: RigViews, start: CameraRig, board: tuple[str, ...], robust: bool, most_iterations: int
) -> RigSolution:
    problem = Problem.of(views, start, board, robust)
    state = _minimum(problem, start, problem.first_noise(start), most_iterations)
    for _ in range(_REMOVALS if robust else 0):
        bad = _bad_frames(state)
        if not any(one.any() for one in bad):
            break
        kept = tuple(seen.only(~one) for seen, one in zip(state.problem.corners, bad, strict=True))
        further = _minimum(replace(state.problem, corners=kept), state.rig, state.noise, most_iterations)
        state = replace(further, steps=state.steps + further.steps)
    return _solution(state)


def _minimum(problem: Problem, rig: CameraRig, noise: Mapping[str, CornerNoise], most: int) -> _State:
    """Return the minimum with weights by its own residuals."""
    problem = problem.with_spread(noise)
    state = _State(problem=problem, rig=rig, noise=noise, at=problem.at(rig, noise), steps=())
    if not np.isfinite(problem.cost(state.at, rig)):
        raise SolveError("the corners cannot be compared with the first guess of the cameras: no finite residuals.")
    for number in range(_ROUNDS):
        left = most - len(state.steps)
        state = _descended(state, left, _NEARLY if number == 0 else _AT_REST)
        noise = state.problem.noise_at(state.at)
        change = max(abs(noise[name].sigma_px / old.sigma_px - 1) for name, old in state.noise.items())
        if (change < _SAME_SIGMA and number) or left <= 0:
            break
        problem = state.problem.with_spread(noise)
        state = replace(state, problem=problem, noise=noise, at=problem.at(state.rig, noise), converged=False)
    return state


def _descended(state: _State, most: int, at_rest: float) -> _State:
    """Return where Levenberg-Marquardt comes to rest, with the weights' sigmas held."""
    problem, rig, at = state.problem, state.rig, state.at
    steps, damping, growth, before = list(state.steps), 0.0, 2.0, 0.0
    cost = problem.cost(at, rig)
    for _ in range(most):
        equations = eliminate_poses(at)
        information = equations.information + problem.information
        gradient = equations.gradient + problem.prior_gradient(rig)
        held = problem.held(rig, gradient)
        step = _damped(information, gradient, held, damping)
        size = float(np.sqrt(max(step @ information @ step, 0.0)))
        trial = _Trial.of(state, rig, equations, step)
        for _ in range(_CORRECTIONS if size > at_rest else 0):
            if trial.cost <= cost or not np.isfinite(trial.cost):
                break
            trial = _brought_back(state, trial, information @ step, held)
        accepted = trial.cost <= cost * (1 + 1e-12)
        steps.append(SolverStep(cost=cost, largest_step=size, damping=damping, accepted=accepted))
        left = size * min(1.0, size / before if before else 1.0)  # as the last two steps foretell
        rest = left < at_rest and abs(trial.cost - cost) <= max(at_rest, 1e-9 * cost)
        if accepted:
            rig, at, cost, before = trial.rig, trial.at, trial.cost, size
            damping, growth = 0.0 if damping < 1e-8 else damping / 3, 2.0
        else:
            damping, growth = max(growth * damping, 1e-8), 2 * growth
        if rest or damping > _MOST_DAMPING:
            return replace(state, rig=rig, at=at, steps=tuple(steps), converged=rest)
    return replace(state, rig=rig, at=at, steps=tuple(steps), converged=False)


@value_class
class _Trial:
    """A rig that may be better, and its cost; infinite where it is not a finite number."""

    rig: CameraRig
    at: ViewNormalEquations
    cost: float

    @classmethod
    def of(cls, state: _State, rig: CameraRig, equations: ReducedEquations, shared: Floats) -> "_Trial":
        """Return the rig after a step of the shared parameters that the poses follow."""
        poses = equations.poses(shared)
        if not (np.isfinite(shared).all() and np.isfinite(poses).all()):
            return cls(rig=rig, at=state.at, cost=np.inf)
        moved = state.problem.layout.moved(rig, poses, shared)
        at = state.problem.at(moved, state.noise)
        cost = state.problem.cost(at, moved)
        return cls(rig=moved, at=at, cost=cost if np.isfinite(cost) else np.inf)


def _brought_back(state: _State, trial: _Trial, along: Floats, held: np.ndarray) -> _Trial:
    """Return a trial moved across the step that led there, to the floor of a valley that bends.

    Parameters
    ----------
    state : problem and weights
    trial : the step's end, where the cost is higher
    along : (p,) information times the step
    held : (p,) bool
    """
    problem = state.problem
    equations = eliminate_poses(trial.at)
    information = equations.information + problem.information
    gradient = equations.gradient + problem.prior_gradient(trial.rig)
    plain = _damped(information, gradient, held, 0.0)
    bent = -_damped(information, along, held, 0.0)
    step = plain - bent * (along @ plain) / max(along @ bent, 1e-300)
    moved = _Trial.of(state, trial.rig, equations, step)
    return moved if moved.cost < trial.cost else trial


def _damped(information: Floats, gradient: Floats, held: np.ndarray, damping: float) -> Floats:
    """Return the step of the shared parameters, those held left where they are."""
    free = np.flatnonzero(~held)
    step = np.zeros(len(gradient))
    if not len(free):
        return step
    matrix = information[np.ix_(free, free)]
    diagonal = np.diag(matrix)
    told = diagonal > 1e-200  # rounding leaves less than nothing of what a runaway lens does not show
    size = np.where(told, 1 / np.sqrt(np.where(told, diagonal, 1.0)), 0.0)
    scaled = matrix * size[:, None] * size + np.diag(np.where(told, damping + 1e-13, 1.0))
    step[free] = -size * np.linalg.solve(scaled, size * gradient[free])
    return step


def _bad_frames(state: _State) -> list[np.ndarray]:
    """Return which exposures of each camera scatter far more than the usual one, (e,) bool each."""
    found: list[np.ndarray] = []
    for seen, sums in zip(state.problem.corners, state.at.sums, strict=True):
        distance = np.linalg.norm(sums.comparable, axis=1)
        distance[~np.isfinite(distance)] = np.inf
        middle = _medians(distance, seen.exposures)
        usual = float(np.median(middle)) if len(middle) else 1.0
        found.append(middle > _BAD_FRAME * usual)
    return found


def _medians(values: Floats, exposures: Exposures) -> Floats:
    """Return the median of the values (m,) of each exposure."""
    order = np.lexsort((values, exposures.of_corner))
    lengths = np.diff(exposures.start)
    return values[order][exposures.start[:-1] + lengths // 2]


def _solution(state: _State) -> RigSolution:
    problem, rig, at = state.problem, state.rig, state.at
    pull, information = view_sums(at)
    gradient = -pull.sum(axis=0) + problem.prior_gradient(rig)
    free = np.flatnonzero(~problem.held(rig, gradient))
    t_ns = problem.views.t_ns
    sums = ClusterSums(
        t_s=(t_ns - t_ns[0]) * 1e-9 if len(t_ns) else np.empty(0),
        pull=pull,
        information=information,
        prior_pull=-problem.prior_gradient(rig),
        prior_information=problem.information,
    )
    names = problem.layout.names(rig.cameras)
    sums = sums if len(free) == len(names) else sums.of_parameters(free)
    return RigSolution(
        views=problem.views,
        rig=rig,
        names=tuple(names[k] for k in free),
        sums=sums,
        ordinary=_inverse(sums.total),
        corners=seen_corners(problem, at, problem.views),
        sigma_px={name: noise.sigma_px for name, noise in state.noise.items()},
        steps=state.steps,
        converged=state.converged,
    )


def seen_corners(problem: Problem, at: ViewNormalEquations, views: RigViews) -> dict[str, SeenCorners]:
    """Return the corners that take part, with their residuals."""
    seen = zip(problem.corners, at.sums, strict=True) if len(views) else ()
    return {corners.name: corners.with_residuals(sums, sums.spread) for corners, sums in seen}


def _inverse(matrix: Floats) -> Floats:
    size = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.inv(matrix * size[:, None] * size) * size[:, None] * size
