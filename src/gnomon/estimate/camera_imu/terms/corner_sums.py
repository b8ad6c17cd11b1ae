"""Sums over the corners of one exposure: all that the normal equations need of its hundred corners.

The corners of one instant move as a rigid body in the camera's frame. With p a corner in the camera's frame, h(p) its
image and G = dh/dp, a small twist (rotation tau_r about the camera's origin, translation tau_t) moves the image by

    dh = -G [p]x tau_r + G tau_t,

whether the twist comes from the pose, the extrinsics, the time shift or the line delay. So each exposure is summed up
once, in the eight or so columns [-G [p]x | G | own parameters | residual | probe], and mapped to the unknowns later.
"""

from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ....frozen import value_class
from ....kernel import library
from ....models.camera import Camera
from ....recording import Floats, Integers

Booleans = NDArray[np.bool_]

TWIST = 6
"""Columns of the twist: rotation and translation."""

_CHUNK = 8_000  # corners at a time; bounds the memory and stays in the cache


class OffsetProducts(Protocol):
    """What takes the products of the columns of each corner's offset with those of its exposure."""

    def add(self, corners: slice, rows: Floats, own: Floats) -> None:
        """Take whitened columns of some corners: rows (6 + w, m, 2) of the exposure, own (3, m, 2) of the offset."""
        ...

    def taking(self) -> tuple[Integers, Booleans, Floats, Floats, Floats]:
        """Return for all corners their numbers and whether they count, and the arrays that take all products."""
        ...


@value_class
class Exposures:
    """Corners of one camera, gathered by the instant of their exposure.

    Attributes
    ----------
    frame : (e,) frame of each exposure
    start : (e + 1,) first corner of each exposure, and their number
    points : (m, 3) corners on the target [m]
    pixels : (m, 2) detected [px]
    delay_rows : (e,) image row that is exposed at this instant; zero for a global shutter
    spread : (m,) standard deviation of each corner over that of a usual one, or None where all are alike
    point : (m,) number of each corner on the target, or None where they are not asked for
    """

    frame: Integers
    start: Integers
    points: Floats
    pixels: Floats
    delay_rows: Floats
    spread: Floats | None = None
    point: Integers | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def of_corner(self) -> Integers:
        """Exposure of each corner, (m,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))


@value_class
class CornerNoise:
    """How corners are weighed.

    Attributes
    ----------
    sigma_px : standard deviation of a corner per axis
    huber : distance in sigmas beyond which a corner counts less (Huber); infinite for least squares
    probe_sign : (m, 2) random signs for the trace of the hat matrix, or None
    """

    sigma_px: float
    huber: float
    probe_sign: Floats | None = None


@value_class
class CornerSums:
    """Sums of products over the corners of each exposure.

    Attributes
    ----------
    sums : (e, w, w) products of the columns [twist 6 | own parameters | residual | probe, if any], in sigmas; or where
        every exposure is a single corner, as with a rolling shutter, (e, 2, w) the columns themselves
    cost : (e,) robust cost, half of chi-square for small residuals
    corner_cost : (m,) the same of each corner; zero where not valid
    mean_square : (e,) mean squared residual per axis [px^2]; nan without valid corners
    valid : (e,) corners that the camera model can image
    lengths : (e,) corners of each exposure
    residual : (m, 2) predicted minus detected [px]; nan where not valid
    weight : (m,) robust weight
    spread : (m,) or 1.0, standard deviation of each corner over that of a usual one
    """

    sums: Floats
    cost: Floats
    corner_cost: Floats
    mean_square: Floats
    valid: Integers
    lengths: Integers
    residual: Floats
    weight: Floats
    spread: Floats | float = 1.0

    @property
    def gram(self) -> Floats:
        """Products of the columns, (e, w, w)."""
        return np.swapaxes(self.sums, 1, 2) @ self.sums if self._single else self.sums

    def rows(self, chosen: Integers) -> Floats:
        """Return rows (n, r, w) of some exposures whose products are the sums: few, however many corners there are."""
        sums = self.sums[chosen]
        return sums if self._single else _square_roots(sums)

    @property
    def _single(self) -> bool:
        return self.sums.shape[1] != self.sums.shape[2]

    @property
    def comparable(self) -> Floats:
        """Residuals (m, 2), those of uncertain corners made as small as the others' [px]."""
        return self.residual / np.reshape(self.spread, (-1, 1))


def corner_sums(
    exposures: Exposures,
    camera: Camera,
    R_cam_target: Floats,
    p_cam_target: Floats,
    noise: CornerNoise,
    *,
    own_parameters: Integers | None = None,
    target_scale: float = 1.0,
    scale_column: bool = False,
    shape: Floats | None = None,
    offsets: OffsetProducts | None = None,
) -> CornerSums:
    """Sum up the corners of every exposure.

    Parameters
    ----------
    exposures : e of them
    camera : lens and intrinsics
    R_cam_target : (e, 3, 3), p_cam_target : (e, 3) [m] pose of the target in the camera's frame at each exposure
    noise : weights
    own_parameters : indices of `Camera.parameters` that get a column each
    target_scale : size of the target relative to `exposures.points`
    scale_column : give it a column, after the own parameters
    shape : (k, m, 3) where on the target, per unit, each corner moves with each of k parameters of the target's shape
        that get a column, after the scale's; or None
    offsets : takes the products with the offset of each corner, where these are wanted
    """
    own = np.empty(0, np.int64) if own_parameters is None else own_parameters
    bends = 0 if shape is None else len(shape)
    width = TWIST + len(own) + scale_column + bends + 1 + (noise.probe_sign is not None)
    count = len(exposures)
    single = bool((np.diff(exposures.start) == 1).all())
    sums = np.zeros((count, 2 if single else width, width))
    cost, square = np.zeros(count), np.full(count, np.nan)
    valid = np.zeros(count, np.int64)
    residual, weight, each = (np.empty((len(exposures.points), *shape)) for shape in ((2,), (), ()))
    chunks = exposure_chunks(exposures.start)
    if width <= library.MOST_COLUMNS and library.load_kernel() is not None:
        chunks = []
        library.add_corner_sums(
            start=exposures.start,
            pose=(R_cam_target, p_cam_target),
            points=exposures.points,
            pixels=exposures.pixels,
            lens=camera.packed(),
            own=own,
            scale=target_scale,
            scale_column=scale_column,
            shape=shape,
            spread=exposures.spread,
            sign=noise.probe_sign,
            sigma_px=noise.sigma_px,
            huber=noise.huber,
            sums=sums,
            of_exposure=(cost, square, valid),
            of_corner=(each, weight, residual),
            offsets=None if offsets is None else offsets.taking(),
        )
    for first, last in chunks:
        corners = slice(int(exposures.start[first]), int(exposures.start[last]))
        lengths = np.diff(exposures.start[first : last + 1])
        which = np.repeat(np.arange(last - first), lengths)
        turned = _turned(R_cam_target[first:last], which, exposures.points[corners], target_scale)
        point = turned + p_cam_target[first:last].T[:, which]
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
            by_offset = target_scale * np.matmul(image.by_point, R_cam_target[first:last][which])  # (m, 2, 3)
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
    return CornerSums(
        sums=sums,
        cost=cost,
        corner_cost=each,
        mean_square=square,
        valid=valid,
        lengths=np.diff(exposures.start),
        residual=residual,
        spread=1.0 if exposures.spread is None else exposures.spread,
        weight=weight,
    )


def frame_scatter(exposures: Exposures, sums: CornerSums, known: np.ndarray) -> Floats:
    """Return the variance of the corners of every frame per axis, (frames,) [px^2]; nan where nothing was imaged.

    It comes from the median squared distance, 2 ln 2 sigma^2 for a normal distribution: wrong corners do not count.

    Parameters
    ----------
    known : (e,) exposures whose sums mean something
    """
    corner = np.repeat(known, sums.lengths) & np.isfinite(sums.residual[:, 0])
    frame = np.repeat(exposures.frame, sums.lengths)[corner]
    comparable = sums.comparable[corner]
    order = np.argsort(frame, kind="stable")  # frames of a rolling shutter come row by row
    frame, squared = frame[order], np.einsum("ij,ij->i", comparable, comparable)[order]
    found = np.full(int(exposures.frame.max()) + 1, np.nan)
    counts = np.bincount(frame, minlength=len(found))
    some = np.flatnonzero(counts)
    by_frame = np.full((len(found), int(counts.max(initial=0))), np.inf)
    by_frame[frame, np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts)] = squared
    by_frame.sort(axis=1)
    found[some] = by_frame[some, counts[some] // 2] / (2 * np.log(2))
    return found


def exposure_chunks(start: Integers) -> list[tuple[int, int]]:
    """Return (first, last + 1) of consecutive exposures that have some thousand corners together."""
    edges = [0]
    while edges[-1] < len(start) - 1:
        stop = int(np.searchsorted(start, start[edges[-1]] + _CHUNK, side="right")) - 1
        edges.append(max(stop, edges[-1] + 1))
    return list(pairwise(edges))


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


def _square_roots(gram: Floats) -> Floats:
    """Return rows (e, w, w) whose products are the sums: as many rows as columns instead of two a corner."""
    diagonal = np.einsum("nii->ni", gram)
    w = gram.shape[1]
    eased = gram + (1e-13 * diagonal + 1e-30)[:, :, None] * np.eye(w)
    return np.swapaxes(np.linalg.cholesky(eased), 1, 2)


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


def _weights(off: Floats, valid: Booleans, noise: CornerNoise, spread: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Return by which to multiply the rows, the robust cost, and the robust weight of each corner."""
    sigma_px = noise.sigma_px * spread
    distance = np.sqrt(np.einsum("ij,ij->i", off, off)) / sigma_px
    distance = np.where(valid, distance, 0.0)
    with np.errstate(divide="ignore"):
        robust = np.minimum(1.0, noise.huber / distance)
    rho = np.where(robust < 1, noise.huber * (distance - 0.5 * noise.huber), 0.5 * distance**2)
    robust = np.where(valid, robust, 0.0)
    return np.sqrt(robust) / sigma_px, np.where(valid, rho, 0.0), robust


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
