"""The batch estimation of document B, section 4.1.2: all error terms, minimised together by Gauss-Newton.

    J = 1/2 sum e' Q^-1 e    over gyroscope, accelerometer, corners, random walks of the biases, and priors.

The noise levels are found beside it, by their variance components: a group of residuals that was assumed to have
sigma = 1 has sigma^2 = chi^2 / (number of residuals - trace of its part of the hat matrix), and the trace comes from
random signs carried along as a further right-hand side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import OptionError, SolveError
from ...recording import Floats, Integers
from ...solve.bordered_band import BorderedBand, Factor, Workspace
from .assembly import TRIAD, Columns, groups, summed_up
from .board_terms import BoardBorder
from .corner_sums import CornerNoise, CornerSums
from .inertial_terms import InertialData, InertialNoise, InertialTerms
from .parameters import Layout, Parameters
from .prior_terms import add_priors, add_smoothness, add_walks
from .trajectory import BIAS, POSE, Trajectory
from .visual_terms import VisualData, VisualTerms
from .walk_noise import PROBES, add_walk_probes, found_walks, walk_sums

_FIRST_DAMPING, _DAMPING_FACTOR, _LARGEST_DAMPING = 1e-8, 100.0, 1e4


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise levels that the estimation weighs by.

    Attributes
    ----------
    imus : for each IMU, standard deviation of single readings
    walks : for each IMU, random walk of the biases: gyroscope [rad/s/sqrt(s)], accelerometer [m/s^2/sqrt(s)]
    pixel_sigma : for each camera, of a corner per axis [px]
    huber : distance in sigmas from which on a corner counts less
    """

    imus: tuple[InertialNoise, ...]
    walks: tuple[tuple[float, float], ...]
    pixel_sigma: tuple[float, ...]
    huber: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Everything that is estimated."""

    trajectory: Trajectory
    parameters: Parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurements:
    """Everything that was measured.

    Attributes
    ----------
    inertial : readings
    visual : corners, camera by camera
    used : for each camera (e,) bool, exposures that take part
    """

    inertial: tuple[InertialData, ...]
    visual: tuple[VisualData, ...]
    used: tuple[np.ndarray, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearisation:
    """The normal equations at a state, and what was seen on the way.

    Attributes
    ----------
    system : normal equations
    cost : J
    inertial_chi2 : for each IMU (gyroscope, accelerometer) sum of squared residuals in sigmas
    inertial_count : for each IMU (gyroscope, accelerometer) number of scalar residuals
    trajectory : where it was linearised
    sums : for each camera, the sums over its exposures
    known : for each camera, exposures whose sums mean something: inside of the trajectory
    inside : for each camera, those of them that were used
    layout : columns of the border
    probing : whether probes and means of the biases are among the right-hand sides: minus the gradient, a probe for
        gyroscope and accelerometer of every IMU, one for each camera, then the means of all biases, and the probes of
        their random walks
    """

    system: BorderedBand
    cost: float
    inertial_chi2: tuple[tuple[float, float], ...]
    inertial_count: tuple[tuple[int, int], ...]
    trajectory: Trajectory
    sums: tuple[CornerSums, ...]
    known: tuple[np.ndarray, ...]
    inside: tuple[np.ndarray, ...]
    layout: Layout
    probing: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
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


def linearised(
    measurements: Measurements,
    state: State,
    layout: Layout,
    noise: Noise,
    *,
    probing: bool,
    workspace: Workspace | None = None,
) -> Linearisation:
    """Return the normal equations at a state.

    Parameters
    ----------
    probing : carry the right-hand sides along that tell noise levels (probes) and the means of the biases
    """
    trajectory = state.trajectory
    grid = trajectory.grid
    imus, cameras = len(noise.imus), len(noise.pixel_sigma)
    probes = 2 * imus + cameras
    board = None
    if len(layout) > layout.dense and state.parameters.board is not None:
        board = BoardBorder(len(state.parameters.board.points), grid.controls, grid.order, imus)
    system = BorderedBand(
        controls=grid.controls,
        order=grid.order,
        groups=groups(imus),
        parameters=layout.dense,
        sides=1 + (probes + (BIAS + 2 * PROBES) * imus if probing else 0),
        workspace=workspace,
        wide=board,
    )
    columns = Columns(order=grid.order, imus=imus, parameters=layout.dense, sides=system.rhs.shape[2])
    if probing:
        weights = mean_weights(trajectory)
        for i in range(BIAS * imus):
            system.rhs[:, POSE + i, 1 + probes + i] = weights
        add_walk_probes(system, trajectory, noise.walks, 1 + probes + BIAS * imus)
    inertial, visual = error_terms(measurements, state, layout, noise, columns, probing=probing)
    summed_up(system, grid, columns, (*inertial, *visual))
    if board is not None:
        board.fill(system, [coupling for term in visual if (coupling := term.coupling()) is not None])
    chi2 = [_chi2(inertial, i) for i in range(imus)]
    cost = 0.5 * float(np.sum(chi2)) + sum(term.cost for term in visual)
    cost += add_walks(system, trajectory, noise.walks)
    add_smoothness(system, trajectory)
    cost += add_priors(system, state.parameters, layout)
    return Linearisation(
        system=system,
        cost=cost,
        inertial_chi2=tuple(chi2),
        inertial_count=tuple(_counts(inertial, i) for i in range(imus)),
        trajectory=trajectory,
        sums=tuple(term.sums for term in visual),
        known=tuple(term.known for term in visual),
        inside=tuple(term.inside for term in visual),
        layout=layout,
        probing=probing,
    )


def error_terms(
    measurements: Measurements,
    state: State,
    layout: Layout,
    noise: Noise,
    columns: Columns,
    *,
    probing: bool,
    parts: Sequence[Integers] | None = None,
) -> tuple[list[InertialTerms], list[VisualTerms]]:
    """Return the error terms of everything that was measured, at a state; see `linearised`.

    Parameters
    ----------
    parts : for each camera, what `VisualTerms` takes as `part`
    """
    imus = len(noise.imus)
    inertial = [
        InertialTerms(
            data,
            state.trajectory,
            state.parameters,
            layout=layout,
            columns=columns,
            noise=noise.imus[data.imu],
            probe=1 + 2 * data.imu if probing else None,
            seed=number,
        )
        for number, data in enumerate(measurements.inertial)
    ]
    visual = [
        VisualTerms(
            data,
            state.trajectory,
            state.parameters,
            layout=layout,
            columns=columns,
            noise=CornerNoise(
                sigma_px=noise.pixel_sigma[data.camera],
                huber=noise.huber,
                probe_sign=_signs(data) if probing else None,
            ),
            used=used,
            probe=1 + 2 * imus + data.camera if probing else None,
            part=None if parts is None else parts[number],
        )
        for number, (data, used) in enumerate(zip(measurements.visual, measurements.used, strict=True))
    ]
    return inertial, visual


def mean_weights(trajectory: Trajectory) -> Floats:
    """Return the weights (n,) by which control points make up the mean of a bias over the trajectory."""
    grid = trajectory.grid
    weights = np.zeros(grid.controls)
    for segment in grid.segments:
        begin = segment.first + grid.bias_offset
        weights[begin : begin + segment.spans] += 0.5
        weights[begin + 1 : begin + segment.spans + 1] += 0.5
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def _chi2(terms: list[InertialTerms], imu: int) -> tuple[float, float]:
    """Return the sums of squared residuals of gyroscope and accelerometer of an IMU."""
    found = [term.chi2() for term in terms if term.data.imu == imu]
    return sum(pair[0] for pair in found), sum(pair[1] for pair in found)


def _counts(terms: list[InertialTerms], imu: int) -> tuple[int, int]:
    """Return the number of scalar residuals of gyroscope and accelerometer of an IMU."""
    own = [term.data for term in terms if term.data.imu == imu]
    gyroscope = sum(TRIAD * int(data.gyroscope.used.sum()) for data in own if data.gyroscope is not None)
    return gyroscope, sum(TRIAD * int(data.accelerometer.used.sum()) for data in own if data.accelerometer is not None)


def _signs(data: VisualData) -> Floats:
    rng = np.random.default_rng(1000 + data.camera)
    return 2.0 * rng.integers(0, 2, data.exposures.pixels.shape).astype(np.float64) - 1.0


def gauss_newton_step(lin: Linearisation, damping: float = 0.0, similar: Factor | None = None) -> Step:
    """Solve the normal equations.

    Parameters
    ----------
    damping : added to the diagonal, as a share of it
    similar : of similar equations, see `BorderedBand.factorised`; the step is an approximation then

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not positive definite.
    """
    if damping:
        lin.system.damped(damping)
    return step_by(lin.system.factorised(similar), lin.layout)


def step_by(factor: Factor, layout: Layout) -> Step:
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
    return Step(
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


def moved(state: State, layout: Layout, step: Step) -> State:
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
    return State(trajectory=state.trajectory.plus(step.trajectory), parameters=parameters)


def estimated_noise(lin: Linearisation, step: Step, noise: Noise) -> Noise:
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
    pixels: list[float] = []
    for camera, sigma in enumerate(noise.pixel_sigma):
        probe = 1 + 2 * len(noise.imus) + camera
        absorbed = step.factor.quadratic(probe, probe, free, step.covariance)
        factor = _pixel_factor(lin.sums[camera], lin.inside[camera], sigma, noise.huber, absorbed)
        pixels.append(sigma * factor)
    first = 1 + len(noise.pixel_sigma) + (2 + BIAS) * len(noise.imus)
    # After the step: under another level the biases are much smoother, or rougher, than before it.
    sums = walk_sums(lin.trajectory.plus(step.trajectory), noise.walks)
    walks = found_walks(sums, step.factor, first, free, step.covariance) * np.array(noise.walks)
    return replace(
        noise, imus=tuple(imus), pixel_sigma=tuple(pixels), walks=tuple((float(g), float(a)) for g, a in walks)
    )


def _pixel_factor(sums: CornerSums, inside: np.ndarray, sigma: float, huber: float, absorbed: float) -> float:
    """Return the scatter of the corners over the assumed one, by Huber's proposal 2 in two dimensions."""
    corners = np.repeat(inside, sums.lengths)
    residual = sums.comparable[corners]
    distance = np.sqrt(np.einsum("ij,ij->i", residual, residual)) / sigma
    distance = distance[np.isfinite(distance)]
    freedom = max(2 * len(distance) - absorbed, 0.05 * len(distance), 1.0)
    share = 1 - np.exp(-0.5 * huber**2) if np.isfinite(huber) else 1.0
    return float(np.sqrt((np.minimum(distance, huber) ** 2).sum() / (freedom * share)))


def _cost_change(lin: Linearisation, following: Linearisation) -> float:
    """Return how much the cost grew, but for corners that can be imaged at one of both states only.

    Where a lens folds back, at the border of a wide image, a step of its coefficients takes corners in or out.
    """
    change = following.cost - lin.cost
    for before, after, used in zip(lin.sums, following.sums, lin.inside, strict=True):
        counted = np.repeat(used, before.lengths)
        was, now = np.isfinite(before.residual[:, 0]), np.isfinite(after.residual[:, 0])
        change += float(before.corner_cost[counted & was & ~now].sum())
        change -= float(after.corner_cost[counted & now & ~was].sum())
    return change


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Iteration:
    """One iteration as it went: cost before it, largest step of a parameter in sigmas, damping, whether accepted."""

    cost: float
    largest_step: float
    damping: float
    accepted: bool


def descended(
    measurements: Measurements,
    lin: Linearisation,
    state: State,
    step: Step,
    noise: Noise,
    *,
    layout: Layout,
    probing: bool,
    workspace: Workspace,
) -> tuple[State, Linearisation, list[Iteration]]:
    """Take the Gauss-Newton step, damped only if it would not lower the cost.

    Parameters
    ----------
    lin, state, step : where the step starts, and the undamped step
    layout, probing : for the linearisation after the step
    workspace : of all linearisations; `lin.system` is used up

    Returns
    -------
    state, lin : after the step
    tried : one entry for each trial

    Raises
    ------
    SolveError
        If no step lowers the cost, or the equations are singular.
    """
    damping, tried = 0.0, list[Iteration]()
    while damping <= _LARGEST_DAMPING:
        try:
            if damping:  # the undamped equations were overwritten by those after the step
                again = linearised(measurements, state, lin.layout, noise, probing=lin.probing, workspace=workspace)
                step = gauss_newton_step(again, damping)
            candidate = moved(state, lin.layout, step)
            following = linearised(measurements, candidate, layout, noise, probing=probing, workspace=workspace)
            better = _cost_change(lin, following) <= 1e-9 * abs(lin.cost) + 1e-6
        except (np.linalg.LinAlgError, SolveError):
            candidate, following, better = state, lin, False
        tried.append(Iteration(cost=lin.cost, largest_step=step.largest, damping=damping, accepted=better))
        if better:
            return candidate, following, tried
        damping = damping * _DAMPING_FACTOR if damping else _FIRST_DAMPING
    raise SolveError(
        "no step lowers the cost of the batch estimation. The recording contradicts what was stated about it: check "
        "the target's size, the intrinsics and the units of the IMU."
    )
