"""The batch estimation of Krebs, section 4.1.2: the normal equations of all error terms together.

    J = 1/2 sum e' Q^-1 e    over gyroscope, accelerometer, corners, random walks of the biases, and priors.

`gauss_newton` goes down from them, `noise_found` tells the noise levels from them.

Of these, how strongly the biases wander follows from the variance component of their random walk.

The steps of a walk from knot to knot are terms of the cost like readings. Those of level sigma = 1 have
sigma^2 = chi^2 / (number of steps - trace of their part of the hat matrix). Only slow wandering shows in a recording, a
few cycles of it; the estimate absorbs the rest. That leaves few degrees of freedom, so that several probes are needed
for the trace, and what was stated counts as a few further ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...solve.bordered_band import BorderedBand, Workspace
from ...solve.factorisation import Factor
from .layout import BorderLayout
from .parameters import RigParameters
from .terms.assembly import TRIAD, add_priors, add_smoothness, add_walks, random_walk_links, scalar_groups, summed_up
from .terms.board_terms import BoardBorder
from .terms.inertial_terms import InertialData, InertialNoise, InertialTerms, split_triads
from .terms.visual_terms import CornerNoise, CornerSums, VisualData, VisualTerms
from .trajectory import BIAS, POSE, Trajectory

PROBES = 4
"""For the walk of each triad; they find its degrees of freedom f to sqrt(f / 2)."""

_ASSUMED_FREEDOM = 1.0
"""Degrees of freedom that the assumed level counts for: it stays where a recording tells nothing."""

_LARGEST = 30.0
"""Multiple of the stated level beyond which none is believed: that is the trajectory's own error."""

_FASTER = 1.5
"""Exponent of the step to the found level: alone it goes two thirds of the way, since what a walk may absorb grows."""


_STRAYS = 0.1
"""Sigmas of the mean between two bends of a bias, by which it may stray from the straight line."""


@value_class(eq=True)
class WalkSums:
    """Steps of one triad's walk: sum of squares in sigmas, and their number."""

    chi2: float
    count: int


def walk_sums(trajectory: Trajectory, walks: tuple[tuple[float, float], ...]) -> tuple[WalkSums, ...]:
    """Return the sums for gyroscope and accelerometer of every IMU, one after the other."""
    squares, count = np.zeros(2 * len(walks)), 0
    variance = np.square(np.ravel(walks))
    for a, distance, time_s in random_walk_links(trajectory.grid):
        biases = trajectory.controls[:, POSE:]
        steps = (biases[a + distance] - biases[a]) ** 2 / time_s
        squares += steps.reshape(-1, 2 * len(walks), TRIAD).sum(axis=(0, 2)) / variance
        count += TRIAD * len(a) // (trajectory.grid.order - 1 if trajectory.grid.tied else 1)
    return tuple(WalkSums(chi2=float(chi2), count=count) for chi2 in squares)


def add_walk_probes(
    system: BorderedBand, trajectory: Trajectory, walks: tuple[tuple[float, float], ...], first: int
) -> None:
    """Put random signs of all steps among the right-hand sides, from `first` on, `PROBES` for each triad's walk.

    A step is from bend to bend: where biases bend at every (order - 1)-th knot only, the links between share its sign.
    """
    rng = np.random.default_rng(2000)
    grid = trajectory.grid
    links = grid.order - 1 if grid.tied else 1
    for triad, walk in enumerate(np.ravel(walks)):
        scalars = slice(POSE + TRIAD * triad, POSE + TRIAD * (triad + 1))
        side = slice(first + PROBES * triad, first + PROBES * (triad + 1))
        for a, distance, time_s in random_walk_links(grid):
            step = (a - grid.bias_offset) // links
            signs = 2.0 * rng.integers(0, 2, (step[-1] - step[0] + 1, TRIAD, PROBES)) - 1.0
            signs = signs[step - step[0]] / (walk * np.sqrt(links * time_s))
            system.rhs[a + distance, scalars, side] += signs
            system.rhs[a, scalars, side] -= signs


def found_walks(sums: tuple[WalkSums, ...], factor: Factor, first: int, free: Integers, covariance: Floats) -> Floats:
    """Return the level that the steps of each walk show, in units of the assumed one, (m, 2).

    Parameters
    ----------
    sums : of the steps
    factor : of the normal equations with the probes from `first` on
    free, covariance : border parameters that are estimated, and their covariance
    """
    levels = np.empty(len(sums))
    for triad, own in enumerate(sums):
        probes = range(first + PROBES * triad, first + PROBES * (triad + 1))
        absorbed = np.mean([factor.quadratic(probe, probe, free, covariance) for probe in probes])
        freedom = max(own.count - absorbed, 0.0)
        levels[triad] = np.sqrt((own.chi2 + _ASSUMED_FREEDOM) / (freedom + _ASSUMED_FREEDOM))
    return levels.reshape(-1, 2)


def next_walk(found: float, used: float, stated: float) -> float:
    """Return the level of a walk to go on with: never less than what was stated, nor far more.

    A walk that is assumed too weak makes sigmas too small, one that is assumed too strong hardly makes them larger.
    """
    return float(np.clip(used * (found / used) ** _FASTER, stated, _LARGEST * stated))


@value_class(eq=True)
class NoiseLevels:
    """Noise levels that the estimation weighs by.

    Attributes
    ----------
    imus : for each IMU, standard deviation of single readings
    walks : for each IMU, random walk of the biases: gyroscope [rad/s/sqrt(s)], accelerometer [m/s^2/sqrt(s)]
    pixel_sigma : for each camera, of a corner per axis [px]
    huber : distance in sigmas from which on a corner counts less
    lasting : whether errors of a point last from image to image, as those of landmarks do; pixel_sigma is then larger
        than they are, so that all images together count as much as they tell
    """

    imus: tuple[InertialNoise, ...]
    walks: tuple[tuple[float, float], ...]
    pixel_sigma: tuple[float, ...]
    huber: float
    lasting: bool = False


def with_tied_biases(trajectory: Trajectory, noise: NoiseLevels, rates_hz: Sequence[tuple[float, float]]) -> Trajectory:
    """Return the trajectory, its biases bending less often where their walks are far below the readings' noise.

    Between bends T apart a random walk strays by half of its sigma sqrt(T) from the straight line, while readings tell
    the mean over T to their density / sqrt(T).

    Parameters
    ----------
    rates_hz : of gyroscope and accelerometer of each IMU
    """
    grid = trajectory.grid
    apart_s = grid.spacing_s * (grid.order - 1)
    strays = [
        0.5 * walk * apart_s / (sigma / rate**0.5)
        for levels, walks, rates in zip(noise.imus, noise.walks, rates_hz, strict=True)
        for sigma, walk, rate in zip((levels.gyroscope, levels.accelerometer), walks, rates, strict=True)
    ]
    tied = len(grid.segments) == 1 and grid.order > 2 and max(strays) < _STRAYS
    return replace(trajectory, grid=replace(grid, tied=tied))


@value_class
class RigState:
    """Everything that is estimated."""

    trajectory: Trajectory
    parameters: RigParameters


@value_class
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


@value_class
class NormalEquations:
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
    layout: BorderLayout
    probing: bool


def linearize_batch(
    measurements: Measurements,
    state: RigState,
    layout: BorderLayout,
    noise: NoiseLevels,
    *,
    probing: bool,
    workspace: Workspace | None = None,
) -> NormalEquations:
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
        board = BoardBorder(len(state.parameters.board.points), grid.controls, imus)
    system = BorderedBand(
        controls=grid.controls,
        order=grid.order,
        groups=scalar_groups(imus),
        parameters=layout.dense,
        sides=1 + (probes + (BIAS + 2 * PROBES) * imus if probing else 0),
        workspace=workspace,
        wide=board,
        tied=grid.bias_offset if grid.tied else None,
    )
    if probing:
        weights = mean_weights(trajectory)
        for i in range(BIAS * imus):
            system.rhs[:, POSE + i, 1 + probes + i] = weights
        add_walk_probes(system, trajectory, noise.walks, 1 + probes + BIAS * imus)
    inertial, visual = error_terms(measurements, state, layout, noise, probing=probing)
    summed_up(system, grid, (*inertial, *visual))
    if board is not None:
        couplings = [term.coupling(system.rhs.shape[2]) for term in visual]
        board.fill(system, [coupling for coupling in couplings if coupling is not None])
    chi2 = [_chi2(inertial, i) for i in range(imus)]
    cost = 0.5 * float(np.sum(chi2)) + sum(term.cost for term in visual)
    cost += add_walks(system, trajectory, noise.walks)
    add_smoothness(system, trajectory)
    cost += add_priors(system, state.parameters, layout)
    return NormalEquations(
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
    state: RigState,
    layout: BorderLayout,
    noise: NoiseLevels,
    *,
    probing: bool,
    parts: Sequence[Integers] | None = None,
) -> tuple[list[InertialTerms], list[VisualTerms]]:
    """Return the error terms of everything that was measured, at a state; see `linearize_batch`.

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
            noise=noise.imus[data.imu],
            probe=1 + 2 * data.imu if probing else None,
            seed=number,
        )
        for number, data in enumerate(_by_clock(measurements.inertial, state.parameters))
    ]
    visual = [
        VisualTerms(
            data,
            state.trajectory,
            state.parameters,
            layout=layout,
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


def _by_clock(inertial: tuple[InertialData, ...], parameters: RigParameters) -> Iterator[InertialData]:
    """Yield the readings, those of triads that share their timestamps but not their delay one by one."""
    for data in inertial:
        yield from split_triads(data) if parameters.imus[data.imu].accelerometer_shift_s else (data,)


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
