"""What the corners' residuals have in common: over time, between neighbours, and for each corner of the board.

A detector's errors are not white. What stays with a corner of the board, in all frames, is an error of the board or a
bias of the detector; what stays with a part of the image is one of the lens. Both are found here from the residuals of
an estimate that has neither, before anything is estimated anew.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ....frozen import value_class
from ....models.camera import Camera
from ....recording import Floats, Integers
from ..terms.corner_sums import exposure_chunks
from ..terms.visual_terms import board_in_camera, exposure_times
from ..trajectory import Bases

if TYPE_CHECKING:
    from ..solution import Solution

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
        for first, last in exposure_chunks(exposures.start):
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
