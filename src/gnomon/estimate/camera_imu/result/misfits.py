"""What the measurements show beside the model: patterns in the corners' residuals, and triads that are off.

A detector's errors are not white. What stays with a corner of the board, in all frames, is an error of the board or a
bias of the detector; what stays with a part of the image is one of the lens. Both are found here from the residuals of
an estimate that has neither, before anything is estimated anew.

Behind a low-pass filter, a triad shows fast motion smaller than it is. A filter of first order with the time constant
tau does to a motion x, but for a delay, x + q x'' with q = tau^2 / 2, to the second order of tau times the frequency of
the motion. The delay is in the time shifts and in that of the accelerometer; q is held at zero, and tested by the step
that it would take if it were free (a score test, Rao 1948). So is an axis whose scale is another one for negative
readings: x + c |x| (scale factor asymmetry, IEEE 528).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from ....frozen import value_class
from ....models.camera import Camera
from ....recording import Floats, Integers
from ..batch import RigState, error_terms
from ..solution import Solution
from ..terms.assembly import TRIAD, by_span, taken_together
from ..terms.inertial_terms import InertialData, InertialNoise, predicted_readings
from ..terms.visual_terms import board_in_camera, exposure_times
from ..trajectory import BIAS, POSE, Bases
from .uncertainty import TriadMisfit, Uncertainty, bias_sides

_CLUSTER_S = 2.0
_CELLS = (8, 6)  # of the image, across and down
_FEWEST_CLUSTERS = 6
_DRAWS = 5000  # of signs
_ASKED = 3.0  # sigmas
_ENOUGH_CORNERS = 20_000  # that tell what a lens lacks
LAST_TERM = {"radtan": 4, "radtan5": 6}
"""Power of the radius, beside the radius itself, at which the series of a lens is cut off."""


@value_class(eq=True)
class ResidualPattern:
    """Residuals that come back at the same place in all clusters of time.

    Attributes
    ----------
    share : of the residuals' variance that is the same in different clusters, without bias; below zero by chance
    rms_px : of that part, per axis
    z : how far its sum of products between clusters lies above zero, in standard deviations under random signs of the
        clusters, however the residuals within a cluster are correlated
    chance : that residuals without a pattern would have such a z: the share of random signs that give it
    clusters : number of clusters of time
    """

    share: float
    rms_px: float
    z: float
    chance: float
    clusters: int


@value_class
class CountingCorners:
    """Corners of one camera that count.

    Attributes
    ----------
    residual : (m, 2) [px], robustly weighed
    on_board : (m, 2) the same along the board's axes
    frame, point : (m,) each
    t_s : (m,)
    pixels : (m, 2) over the image's size, 0 to 1
    """

    residual: Floats
    on_board: Floats
    frame: Integers
    point: Integers
    t_s: Floats
    pixels: Floats


def corner_correlation(corners: CountingCorners) -> float:
    """Return the correlation of a corner's residual with itself in the next frame; nan where there is none."""
    grid = np.full((int(corners.frame.max()) + 1, int(corners.point.max()) + 1, 2), np.nan)
    grid[corners.frame, corners.point] = corners.residual
    return _correlation(grid[:-1], grid[1:])


def board_evidence(every: Sequence[CountingCorners]) -> ResidualPattern:
    """Return whether corners of the board stay off their places: cheap, and before offsets are estimated."""
    return _pattern(
        np.concatenate([corners.on_board for corners in every]),
        np.concatenate([corners.point for corners in every]),
        np.concatenate([corners.t_s for corners in every]),
    )


def lens_evidence(every: Sequence[CountingCorners]) -> ResidualPattern:
    """Return whether residuals stay with parts of the image, as those of wrong intrinsics do."""
    across, down = _CELLS
    cells: list[Integers] = []
    for number, corners in enumerate(every):
        column, row = np.floor(corners.pixels * _CELLS).astype(np.int64).T
        cells.append((number * down + np.clip(row, 0, down - 1)) * across + np.clip(column, 0, across - 1))
    return _pattern(
        np.concatenate([corners.residual for corners in every]),
        np.concatenate(cells),
        np.concatenate([corners.t_s for corners in every]),
    )


def missing_term(lens: Camera, corners: CountingCorners) -> Floats:
    """Return how the parameters (q,) of a lens would move by the term that its series lacks; zeros where by chance.

    The term is as large as the corners' residuals ask for, beside the lens and turns of the camera.
    """
    some = slice(None, None, max(len(corners.point) // _ENOUGH_CORNERS, 1))
    rays, seen = lens.unproject(corners.pixels[some] * lens.resolution)
    image = lens.project(rays[seen], parameters_jacobian=True)
    assert image.by_point is not None
    assert image.by_parameters is not None
    flat = rays[seen][:, :2] / rays[seen][:, 2:]
    radius = np.linalg.norm(flat, axis=1, keepdims=True)
    term = (lens.intrinsics[-4:-2] * flat * radius ** (LAST_TERM[lens.distortion] + 2)).ravel()
    turned = np.cross(image.by_point, rays[seen][:, None, :])
    known = np.concatenate([turned, image.by_parameters], axis=2).reshape(len(term), -1)
    gain = np.linalg.lstsq(known, term, rcond=None)[0]
    left, residual = term - known @ gain, corners.residual[some][seen].ravel()
    size = float(left @ residual / (left @ left))
    cluster = np.repeat((corners.t_s[some][seen] // _CLUSTER_S).astype(np.int64), 2)
    pulls = np.bincount(cluster - cluster.min(), left * (residual - size * left))
    asked = abs(size) > _ASKED * float(np.linalg.norm(pulls) / (left @ left))
    return np.asarray(asked * size * gain[turned.shape[2] :])


def with_next_term(found: Uncertainty, solution: Solution) -> Uncertainty:
    """Return the uncertainty with that of the radial term that estimated lenses of radtan or radtan5 lack (Schmidt).

    The coefficients of a series that is cut off depend on where in the image the corners were seen, and no clusters of
    one recording show that. Where corners ask for the term that follows, they are as uncertain as it moves them. What
    the lens does where the corners are hardly changes, and nothing else does.
    """
    column = {name: i for i, name in enumerate(found.names)}
    free = any(name.endswith(".distortion_coeffs[0]") for name in column)
    covariance = found.covariance
    for entry, seen in zip(solution.state.parameters.cameras, counting_corners(solution) if free else (), strict=free):
        lens = [column.get(f"{entry.name}.{name}") for name in entry.camera.parameter_names]
        columns = [place for place in lens if place is not None]
        if entry.camera.distortion in LAST_TERM and len(columns) == len(lens):
            along = np.zeros(len(covariance))
            along[columns] = missing_term(entry.camera, seen)
            covariance = covariance + np.outer(along, along)
    return replace(found, covariance=covariance)


def _pattern(residual: Floats, label: Integers, t_s: Floats) -> ResidualPattern:
    """Return what residuals (m, 2) of the same label (m,) have in common between clusters of time."""
    cluster = np.floor((t_s - np.min(t_s, initial=np.inf)) / _CLUSTER_S).astype(np.int64)
    return common_pattern(residual, label, cluster)


def common_pattern(residual: Floats, label: Integers, cluster: Integers) -> ResidualPattern:
    """Return what residuals (m, 2) of the same label (m,) have in common between clusters (m,), numbered in time.

    M_cd = sum over labels of s_c s_d', s the sums of residuals of a label in clusters c and d, is without a pattern as
    likely positive as negative for c and d that are not neighbours.
    """
    if not len(cluster):
        return ResidualPattern(share=0.0, rms_px=0.0, z=0.0, chance=1.0, clusters=0)
    clusters, labels = int(cluster.max()) + 1, int(label.max()) + 1
    place = cluster * labels + label
    sums = np.stack([np.bincount(place, r, clusters * labels) for r in residual.T], axis=1).reshape(clusters, -1)
    count = np.bincount(place, minlength=clusters * labels).reshape(clusters, labels).astype(np.float64)
    number = np.arange(clusters)
    apart = np.abs(number[:, None] - number) > 1
    products, pairs = np.where(apart, sums @ sums.T, 0.0), np.where(apart, count @ count.T, 0.0)
    if clusters < _FEWEST_CLUSTERS or not products.any():
        return ResidualPattern(share=0.0, rms_px=0.0, z=0.0, chance=1.0, clusters=clusters)
    z = float(products.sum() / np.sqrt(2 * (products**2).sum()))
    square = float(products.sum() / (2 * pairs.sum()))
    return ResidualPattern(
        share=square / float(np.mean(residual**2)),
        rms_px=float(np.sqrt(max(square, 0.0))),
        z=z,
        chance=_chance(products),
        clusters=clusters,
    )


def _chance(products: Floats) -> float:
    """Return how likely random signs of the clusters give a sum of products (c, c) as large."""
    signs = 2.0 * np.random.default_rng(1).integers(0, 2, (_DRAWS, len(products))) - 1
    drawn = np.einsum("nc,nc->n", signs @ products, signs)
    return float((1 + np.sum(drawn >= products.sum())) / (1 + _DRAWS))


def counting_corners(solution: "Solution") -> list[CountingCorners]:
    """Return the corners of every camera that count, at the estimate."""
    trajectory, parameters = solution.state.trajectory, solution.state.parameters
    found: list[CountingCorners] = []
    for data, used, sigma_px in zip(
        solution.measurements.visual, solution.measurements.used, solution.noise.pixel_sigma, strict=True
    ):
        exposures, entry = data.exposures, parameters.cameras[data.camera]
        assert exposures.point is not None
        places = trajectory.grid.places(exposure_times(data, entry))
        motion = trajectory.motion(places, Bases.at(places, trajectory.grid, entry.exposure_s2))
        R, p = board_in_camera(motion, entry)
        where = exposures.points
        if parameters.board is not None:
            where = where + parameters.board.offsets[exposures.point]
        size, every = len(where), exposures.of_corner
        counts, residual, on_board = np.zeros(size, dtype=bool), np.empty((size, 2)), np.empty((size, 2))
        for first, last in exposures.chunks():
            at = slice(int(exposures.start[first]), int(exposures.start[last]))
            of = every[at]
            turned = R[of]
            points = np.einsum("mij,mj->mi", turned, parameters.target_scale * where[at]) + p[of]
            image = entry.camera.project(points)
            assert image.by_point is not None
            counts[at] = (used & places.inside)[of] & image.valid
            off = image.pixels - exposures.pixels[at]
            distance = np.linalg.norm(off, axis=1) / sigma_px
            residual[at] = off * np.minimum(1.0, solution.noise.huber / np.maximum(distance, 1e-12))[:, None]
            on_board[at] = along_board(image.by_point @ turned[:, :, :2], residual[at])
        found.append(
            CountingCorners(
                residual=residual[counts],
                on_board=on_board[counts],
                frame=exposures.frame[every][counts],
                point=exposures.point[counts],
                t_s=data.t_s[every][counts],
                pixels=exposures.pixels[counts] / entry.camera.resolution,
            )
        )
    return found


def along_board(by_place: Floats, residual: Floats) -> Floats:
    """Return residuals (m, 2) turned so that they point along the board's axes, by their derivative (m, 2, 2)."""
    mirrored = by_place[:, 0, 0] * by_place[:, 1, 1] < by_place[:, 0, 1] * by_place[:, 1, 0]
    side = np.where(mirrored, -1.0, 1.0)  # the board's y axis points up, the image's down
    angle = np.arctan2(by_place[:, 1, 0] - side * by_place[:, 0, 1], by_place[:, 0, 0] + side * by_place[:, 1, 1])
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = residual.T
    return np.stack([cos * x + sin * y, side * (cos * y - sin * x)], axis=1)


def _correlation(a: Floats, b: Floats) -> float:
    """Return the correlation of residuals (..., 2) that are there in both; nan where there are none."""
    both = np.isfinite(a[..., 0]) & np.isfinite(b[..., 0])
    if not both.any():
        return float("nan")
    x, y = a[both], b[both]
    return float((x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum()))


_LEAST_APART_S = 0.01  # between the readings whose second difference is x'': motion up to some 15 Hz counts
_SHARE, _USUAL_S2 = 0.2, 32e-6  # of triads that have a filter, and its q: that of 20 Hz
_LEAST_SHARE = 1e-6  # of x'' that the rest must leave
_HELD = {"gravity.magnitude": 0.02, "target.scale": 3e-3}  # m/s^2, 1; what is held may be off by, and feigns a filter
_PROBES = 4  # of a triad: x'', and |x| of each axis
_ASYMMETRY, _LOPSIDED = 0.01, 4.5  # what c may be at all; sigmas that are asked for of one of six
_SHAPES = (("S_g", "M_g", "q_bg"), ("S_a", "M_a"))


def with_misfits(found: Uncertainty, solution: Solution) -> Uncertainty:
    """Return the uncertainty with that by filters, by how likely they are (Schmidt), and with what is proved.

    Only triads whose scales and axes are estimated are looked at: errors of these look like x'', too. So do those of
    gravity and of the board's size, which may move along by what they usually are off.
    """
    step, free, means = solution.step, solution.layout.free_index, bias_sides(solution)
    ratios = np.array([_ratio(found, imu, kind) for imu in range(len(solution.noise.imus)) for kind in (0, 1)])
    if not ratios.any():
        return found
    right, border, own, pull = _products(solution)
    inner, with_sides, sides = step.factor.further_sides(right, border, np.concatenate([[0], means]))
    moves, also = step.covariance @ sides[free], _moving_along(solution)
    along_with = also.covariance @ sides[also.columns]
    pull -= with_sides[0] + step.factor.schur_sides[also.columns, 0] @ along_with
    information = np.diag(own) - inner - sides[also.columns].T @ along_with
    moves = np.concatenate([moves, with_sides[1:] + step.factor.schur_sides[free][:, means].T @ moves])
    score = _Score(information, own, pull, moves, ratios)
    filters, added = _filters(found, score)
    misfits = (*filters, *_asymmetries(found, score))
    return replace(found, covariance=found.covariance + added, ordinary=found.ordinary + added, misfits=misfits)


class _Score(NamedTuple):
    """Of the probes: information (k, k), own one (k,), pull (k,), moves (f + 6 m, k); of the triads `_ratio` (2 m,)."""

    information: Floats
    own: Floats
    pull: Floats
    moves: Floats
    ratios: Floats

    def misfit(self, found: Uncertainty, probe: int, size: float, variance: float) -> TriadMisfit:
        """Return the probe's size [s^2 of x'', 1 of |x|] and variance as what is wrong with its triad."""
        triad, axis = divmod(probe, _PROBES)
        return TriadMisfit(
            imu=triad // 2,
            kind=triad % 2,
            axis=axis - 1 if axis else None,
            size=float(size),
            sigma=float(np.sqrt(variance) * self.ratios[triad]) if variance > 0 else np.inf,  # rounding, of a bad fit
            moved=float(np.max(np.abs(size * self.moves[:, probe]) / np.sqrt(np.diag(found.covariance)))),
        )


def _filters(found: Uncertainty, score: _Score) -> tuple[list[TriadMisfit], Floats]:
    """Return the triads that are proved to be filtered, and what filters add to the covariance."""
    triads, added = _PROBES * np.arange(len(score.ratios)), np.zeros_like(found.covariance)
    told = triads[(np.diag(score.information) > _LEAST_SHARE * score.own)[triads] & (score.ratios > 0)]
    information = score.information[np.ix_(told, told)]
    if not len(told) or np.linalg.det(information) <= _LEAST_SHARE * np.prod(np.diag(information)):
        return [], added  # the trajectory, or one triad the other's, takes up all of it
    covariance = np.linalg.inv(information)
    sizes = covariance @ score.pull[told]
    misfits = [score.misfit(found, *one) for one in zip(told.tolist(), sizes, np.diag(covariance), strict=True)]
    if any(one.size < -_ASKED * one.sigma or one.sigma == np.inf for one in misfits):
        return [], added  # no filter of first order makes fast motion larger: another one, whose noise is not white
    for one, along in zip(misfits, score.moves[:, told].T, strict=True):
        added += np.outer(along, along) * expected_square(one.size, one.sigma)
    return [one for one in misfits if one.size > _ASKED * one.sigma], added


def _asymmetries(found: Uncertainty, score: _Score) -> list[TriadMisfit]:
    """Return the axes that are proved to have another scale for negative readings."""
    chosen = np.flatnonzero((np.arange(len(score.own)) % _PROBES > 0) & (np.repeat(score.ratios, _PROBES) > 0))
    information = score.information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / _ASYMMETRY**2
    covariance = np.linalg.inv(information)
    sizes = covariance @ score.pull[chosen]
    misfits = [score.misfit(found, *one) for one in zip(chosen.tolist(), sizes, np.diag(covariance), strict=True)]
    return [one for one in misfits if abs(one.size) > _LOPSIDED * one.sigma]


def expected_square(q: float, sigma: float) -> float:
    """Return the expected q^2 [s^4] of a triad that may be filtered or not, after q was found with this sigma [s^2].

    Before, it is filtered with the probability `_SHARE`, by a q that is half-normal, of `_USUAL_S2`; else q is zero
    (Mitchell and Beauchamp 1988). So a filter that is told by two sigmas is in the covariance by half, one that is
    contradicted not at all.
    """
    shrunk = 1 / (1 + (sigma / _USUAL_S2) ** 2)
    y = q / sigma * sqrt(shrunk)
    positive = erfc(-y / sqrt(2)) / 2
    odds = _SHARE / (1 - _SHARE) * 2 * sqrt(1 - shrunk) * exp(min(y**2, 900.0) / 2) * positive
    if_filtered = sigma**2 * shrunk * (1 + y**2 + y * exp(-(y**2) / 2) / (sqrt(2 * pi) * positive))
    return odds / (1 + odds) * if_filtered


@value_class
class _MovingAlong:
    """Columns that are free, or held at what may be off, and their covariance."""

    columns: Integers
    covariance: Floats


def _moving_along(solution: Solution) -> _MovingAlong:
    layout = solution.layout
    held = {
        column: sigma
        for name, sigma in _HELD.items()
        if (block := layout.get(name)) is not None
        for column in range(block.start, block.stop)
        if not layout.free[column]
    }
    columns = np.concatenate([layout.free_index, np.array([*held], dtype=np.int64)])
    known = np.concatenate([np.zeros(len(layout.free_index)), 1 / np.square([*held.values()])])
    information = solution.step.factor.schur[np.ix_(columns, columns)] + np.diag(known)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes = np.outer(scale, scale)
    return _MovingAlong(columns=columns, covariance=np.linalg.inv(information * sizes) * sizes)


def _ratio(found: Uncertainty, imu: int, kind: int) -> float:
    """Return how much larger sigmas of a triad's own parameters are than for independent errors; 0 of held ones."""
    own = tuple(f"imu{imu}.{shape}" for shape in _SHAPES[kind])
    at = [k for k, name in enumerate(found.names) if name.partition("[")[0] in own]
    wider, independent = (np.diag(matrix)[at] for matrix in (found.covariance, found.ordinary))
    return float(np.sqrt(np.max(wider / independent, initial=0.0)))


def _products(solution: Solution) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the products of the probes of each triad, as a right-hand side, with the rows of its readings.

    Returns
    -------
    right : (n, d, 8 m) columns of the control points, of gyroscope and accelerometer of each IMU
    border : (p, 8 m) columns of the border, but for the corners of a board
    own, pull : (8 m,) the probe itself, and minus the residuals
    """
    state, grid = _linearised_at(solution), solution.state.trajectory.grid
    count = 2 * _PROBES * len(solution.noise.imus)
    right = np.zeros((grid.controls, solution.step.factor.size, count))
    border, own, pull = np.zeros((solution.layout.dense, count)), np.zeros(count), np.zeros(count)
    measured = replace(solution.measurements, visual=(), used=())
    for term in error_terms(measured, state, solution.layout, solution.noise, probing=False)[0]:
        columns, imu = term.columns, term.data.imu
        biases = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
        probes, shapes = _probes(term.data, state, solution.noise.imus[imu])
        for part in taken_together(term):
            rows = term.rows(part)
            shape = shapes(part, rows[:, :, columns.side])
            spans, gathered = by_span(term.first[part], rows)
            sums = by_span(term.first[part], shape)[1].transpose(0, 2, 1) @ gathered
            for a in range(grid.order):
                right[spans + a, :POSE, probes] += sums[:, :, POSE * a : POSE * (a + 1)].transpose(0, 2, 1)
            for knot in (0, 1):
                right[spans + grid.bias_offset + knot, biases, probes] += sums[:, :, columns.bias(knot)].transpose(
                    0, 2, 1
                )
            for to, at in columns.pieces:
                border[to, probes] += sums[:, :, at].sum(axis=0).T
            pull[probes] += sums[:, :, columns.side].sum(axis=0)
            own[probes] += np.einsum("nrk,nrk->k", shape, shape)
    return right, border, own, pull


def _linearised_at(solution: Solution) -> RigState:
    """Return the state before the last step: rows from elsewhere do not belong to the factor."""
    state, trajectory = solution.state, solution.lin.trajectory
    if state.trajectory is trajectory:
        return state
    return RigState(trajectory=trajectory, parameters=solution.layout.plus(state.parameters, -solution.step.parameters))


def _probes(
    data: InertialData, state: RigState, noise: InertialNoise
) -> tuple[slice, Callable[[slice, Floats], Floats]]:
    """Return which probes those of some readings are, and what tells them in noises of a reading, (n, 3 t, 4 t).

    It is asked for some of the readings, with minus their residuals, (n, 3 t). Of what each of the t triads should have
    read, they are x'', and |x| of each axis. The readings that tell x'' lie whole knots apart: what a spline cannot
    follow repeats with the knots, and is in the residuals, too.
    """
    spacing_s = state.trajectory.grid.spacing_s
    apart_s = spacing_s * ceil(_LEAST_APART_S / spacing_s - 1e-6)
    before, after = (
        predicted_readings(state.trajectory, state.parameters, replace(data, t_s=data.t_s + shift_s))
        for shift_s in (-apart_s, apart_s)
    )
    triads = ((data.gyroscope, noise.gyroscope), (data.accelerometer, noise.accelerometer))
    there = [(kind, triad, triad.used / sigma) for kind, (triad, sigma) in enumerate(triads) if triad is not None]
    first, axes = _PROBES * (2 * data.imu + there[0][0]), np.arange(TRIAD)

    def shapes(part: slice, left: Floats) -> Floats:
        found = np.zeros((*left.shape, _PROBES * len(there)))
        for number, (kind, triad, weight) in enumerate(there):
            own, scale = TRIAD * number + axes, weight[part, None]
            at = triad.values[part] * scale - left[:, own]
            bent = (before[kind][part] + after[kind][part]) * scale - 2 * at
            found[:, own, _PROBES * number] = np.nan_to_num(bent) / apart_s**2
            found[:, own, _PROBES * number + 1 + axes] = np.abs(at)
        return found

    return slice(first, first + _PROBES * len(there)), shapes
