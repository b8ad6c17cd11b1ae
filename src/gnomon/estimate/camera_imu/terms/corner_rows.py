"""Sums of products over the corners of exposures, in NumPy: where no kernel was compiled, or columns are too many.

With p a corner in the camera's frame and G = dh/dp, the columns are those of `visual_terms`, whitened and robustly
weighed.
"""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ....models.camera import Camera
from ....recording import Floats, Integers
from .board_terms import CornerProducts

if TYPE_CHECKING:
    from .visual_terms import CornerNoise, Exposures

_Booleans = NDArray[np.bool_]


def add_corner_rows(
    exposures: "Exposures",
    camera: Camera,
    pose: tuple[Floats, Floats],
    noise: "CornerNoise",
    own: Integers,
    *,
    target_scale: float,
    scale_column: bool,
    shape: Floats | None,
    sums: Floats,
    of_exposure: tuple[Floats, Floats, Integers],
    of_corner: tuple[Floats, Floats, Floats],
    offsets: CornerProducts | None,
) -> None:
    """Sum up the corners of exposures, in place; see `corner_sums`.

    Parameters
    ----------
    pose : R_cam_target (e, 3, 3), p_cam_target (e, 3)
    sums : (e, w, w) or (e, 2, w)
    of_exposure : cost, mean square, number of valid corners (e,)
    of_corner : robust cost, robust weight (m,), residual (m, 2)
    """
    (R, p), (cost, square, valid), (each, weight, residual) = pose, of_exposure, of_corner
    single = sums.shape[1] != sums.shape[2]
    for first, last in exposures.chunks():
        corners = slice(int(exposures.start[first]), int(exposures.start[last]))
        lengths = np.diff(exposures.start[first : last + 1])
        which = np.repeat(np.arange(last - first), lengths)
        turned = _turned(R[first:last], which, exposures.points[corners], target_scale)
        point = turned + p[first:last].T[:, which]
        image = camera.project(point.T, parameters_jacobian=len(own) > 0)
        apart = image.pixels - exposures.pixels[corners]
        spread = 1.0 if exposures.spread is None else exposures.spread[corners]
        off = np.where(image.valid[:, None], apart, 0.0)  # what cannot be imaged must not spoil the sums
        root, rho, robust = _weights(off, image.valid, noise, spread)
        by_scale = turned / target_scale if scale_column else None
        columns = _columns(image.by_point, point, image.by_parameters, own, by_scale)
        by_offset = None
        if shape is not None or offsets is not None:
            assert image.by_point is not None
            by_offset = target_scale * np.matmul(image.by_point, R[first:last][which])  # (m, 2, 3)
            columns += [] if shape is None else _along(by_offset, shape[:, corners])
        columns.append((off[:, 0], off[:, 1]))
        if noise.probe_sign is not None:  # signs take the place of the whitened residual
            sign = noise.probe_sign[corners] * np.reshape(noise.sigma_px * spread, (-1, 1))
            columns.append((sign[:, 0], sign[:, 1]))
        root = np.where(image.valid, root, 0.0)
        rows = _weighted(columns, root)
        sums[first:last] = rows.transpose(1, 2, 0) if single else _grams(rows, lengths)
        if offsets is not None and by_offset is not None:
            offsets.add(corners, rows, (root[:, None, None] * by_offset).transpose(2, 0, 1))
        cost[first:last] = np.bincount(which, rho, last - first)
        valid[first:last] = np.bincount(which, image.valid, last - first)
        squares = np.where(image.valid, np.einsum("ij,ij->i", off, off), 0.0)
        some = valid[first:last] > 0
        total = np.bincount(which, squares, last - first)
        square[first:last][some] = total[some] / (2 * valid[first:last][some])
        residual[corners], weight[corners], each[corners] = apart, robust, rho


def _weights(
    off: Floats, valid: _Booleans, noise: "CornerNoise", spread: Floats | float
) -> tuple[Floats, Floats, Floats]:
    """Return by which to multiply the rows, the robust cost, and the robust weight of each corner."""
    sigma_px = noise.sigma_px * spread
    distance = np.sqrt(np.einsum("ij,ij->i", off, off)) / sigma_px
    distance = np.where(valid, distance, 0.0)
    with np.errstate(divide="ignore"):
        robust = np.minimum(1.0, noise.huber / distance)
    rho = np.where(robust < 1, noise.huber * (distance - 0.5 * noise.huber), 0.5 * distance**2)
    robust = np.where(valid, robust, 0.0)
    return np.sqrt(robust) / sigma_px, np.where(valid, rho, 0.0), robust


def _turned(R_cam_target: Floats, which: Integers, points: Floats, scale: float) -> Floats:
    """Return R p of the corners of many exposures, components first (3, m)."""
    turned = np.empty((3, len(points)))
    x, y, z = points.T
    flat = not z.any()
    for i in range(3):
        turned[i] = R_cam_target[:, i, 0][which] * x
        turned[i] += R_cam_target[:, i, 1][which] * y
        if not flat:
            turned[i] += R_cam_target[:, i, 2][which] * z
    if scale != 1.0:
        turned *= scale
    return turned


def _columns(
    by_point: Floats | None, point: Floats, by_parameters: Floats | None, own: Integers, by_scale: Floats | None
) -> list[tuple[Floats, Floats]]:
    """Return the columns of twist and own parameters, each as its two rows."""
    assert by_point is not None
    G = by_point
    x, y, z = point
    rotation = [  # -G [p]x, column by column
        [G[:, i, 2] * y - G[:, i, 1] * z for i in (0, 1)],
        [G[:, i, 0] * z - G[:, i, 2] * x for i in (0, 1)],
        [G[:, i, 1] * x - G[:, i, 0] * y for i in (0, 1)],
    ]
    columns = [(rows[0], rows[1]) for rows in rotation]
    columns += [(G[:, 0, j], G[:, 1, j]) for j in range(3)]
    if len(own):
        assert by_parameters is not None
        columns += [(by_parameters[:, 0, j], by_parameters[:, 1, j]) for j in own]
    if by_scale is not None:
        columns.append((np.einsum("ij,ji->i", G[:, 0], by_scale), np.einsum("ij,ji->i", G[:, 1], by_scale)))
    return columns


def _along(by_offset: Floats, shape: Floats) -> list[tuple[Floats, Floats]]:
    """Return the columns of moves (k, m, 3) on the target, of the derivatives (m, 2, 3) by them."""
    moved = np.einsum("mij,kmj->kim", by_offset, shape)
    return [(pair[0], pair[1]) for pair in moved]


def _weighted(columns: list[tuple[Floats, Floats]], root: Floats) -> Floats:
    """Return weighted columns, (w, m, 2)."""
    rows = np.empty((len(columns), len(root), 2))
    for row, pair in zip(rows, columns, strict=True):
        np.multiply(root, pair[0], out=row[:, 0])
        np.multiply(root, pair[1], out=row[:, 1])
    return rows


def _grams(rows: Floats, lengths: Integers) -> Floats:
    """Return the products of weighted columns (w, m, 2), summed over the corners of each exposure, (e, w, w)."""
    w, m, _ = rows.shape
    flat = rows.reshape(w, 2 * m)
    if (lengths == lengths[0]).all():
        equal = flat.reshape(w, len(lengths), -1).transpose(1, 0, 2)
        return np.matmul(equal, equal.transpose(0, 2, 1))
    gram = np.empty((len(lengths), w, w))
    edges = [0, *(2 * np.cumsum(lengths)).tolist()]
    for i, (start, stop) in enumerate(pairwise(edges)):
        part = flat[:, start:stop]
        np.dot(part, part.T, out=gram[i])
    return gram
