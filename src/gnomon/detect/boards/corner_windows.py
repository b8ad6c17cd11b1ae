"""The pixels around corners that are looked at, and what a Gaussian blur makes of an edge there."""

from functools import lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...frozen import field_names, value_class
from ...models.camera import Booleans
from ...recording import Floats, Integers
from ...recording.recording import Grey

Singles = NDArray[np.floating[Any]]
SATURATED = 255

_FAR = np.float32(60.0)  # squared, in units of the blur
DAMPING = 1e-4


@value_class
class Windows:
    """Pixels around the corners, (m, n), and their weights; their places relative to the middle, (m or 1, 3, n).

    A place is x, y, 1.
    """

    values: Singles
    place: Singles
    weight: Singles
    saturated: bool

    def only(self, chosen: NDArray[np.integer]) -> "Windows":
        """Return some of the windows."""
        if len(chosen) == len(self.values):
            return self
        own = len(self.place) > 1
        return Windows(
            values=self.values[chosen],
            place=self.place[chosen] if own else self.place,
            weight=self.weight[chosen],
            saturated=self.saturated,
        )


@value_class
class PixelGrid:
    """Pixels around a middle, the nearest first.

    Attributes
    ----------
    x, y : (n,) [px]
    distance : (n,) from the middle [px]
    right, left, below, above : (k,) which pixels are beside those nearest to the middle
    """

    x: Singles
    y: Singles
    distance: Singles
    right: Integers
    left: Integers
    below: Integers
    above: Integers

    @property
    def place(self) -> Singles:
        """x, y and 1 of the pixels, (3, n)."""
        return np.stack([self.x, self.y, np.ones_like(self.x)])


@lru_cache(maxsize=16)
def grid_around(half: int) -> PixelGrid:
    """Return the pixels of the square that reaches so many pixels to all sides."""
    offset = np.arange(-half, half + 1)
    x, y = np.tile(offset, len(offset)), np.repeat(offset, len(offset))
    distance = np.hypot(x, y)
    order = np.argsort(distance, kind="stable")
    at = np.empty(len(order), np.int64)
    at[order] = np.arange(len(order))
    side = len(offset)
    core = np.flatnonzero((np.abs(x) <= min(2, half - 1)) & (np.abs(y) <= min(2, half - 1)))
    return PixelGrid(
        x=x[order].astype(np.float32),
        y=y[order].astype(np.float32),
        distance=distance[order].astype(np.float32),
        right=at[core + 1],
        left=at[core - 1],
        below=at[core + side],
        above=at[core - side],
    )


def gather_pixels(image: Grey, middle: Integers, grid: PixelGrid) -> tuple[Singles, Booleans | None]:
    """Return the pixels around middles, (m, n), and which are inside the image; None for all of them."""
    height, width = image.shape
    x, y = grid.x.astype(np.int64), grid.y.astype(np.int64)
    half = int(x.max())
    flat = image.reshape(-1)
    if (middle >= half).all() and (middle < [width - half, height - half]).all():
        place = (middle[:, 1] * width + middle[:, 0])[:, None] + (y * width + x)
        return flat.take(place).astype(np.float32), None
    u, v = middle[:, :1] + x, middle[:, 1:] + y
    seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return flat.take(np.where(seen, v * width + u, 0)).astype(np.float32), seen


def round_windows(values: Singles, seen: Booleans | None, grid: PixelGrid, reach: Floats) -> Windows:
    """Return the pixels of round windows."""
    count = int(np.searchsorted(grid.distance, reach.max() + 0.5))
    weight = np.clip((reach[:, None] + 0.5).astype(np.float32) - grid.distance[:count], 0, 1)
    if seen is not None:
        weight *= seen[:, :count]
    return _windows(np.ascontiguousarray(values[:, :count]), grid.place[None, :, :count], weight)


def edge_windows(
    values: Singles,
    seen: Booleans | None,
    grid: PixelGrid,
    edges: tuple[Floats, Floats],
    shape: tuple[Floats, Floats, Floats],
) -> Windows:
    """Return the pixels near either edge of tips.

    Parameters
    ----------
    edges : place of the corner (m, 2), and directions of the edges (m, 2, 2)
    shape : (m,) how far outwards from the edges, into the black, and along the edges [px]
    """
    (centre, directions), (outer, inner, arms) = edges, shape
    start, single = centre.astype(np.float32), directions.astype(np.float32)
    dx, dy = grid.x - start[:, :1], grid.y - start[:, 1:]
    turn = np.sign(single[:, 0, 0] * single[:, 1, 1] - single[:, 0, 1] * single[:, 1, 0])[:, None]
    chosen = np.zeros(dx.shape, dtype=bool)
    for i, into in ((0, turn), (1, -turn)):
        ex, ey = single[:, i, :1], single[:, i, 1:]
        along, depth = ex * dx + ey * dy, into * (ex * dy - ey * dx)
        across = (depth <= inner[:, None]) & (depth >= -outer[:, None])
        chosen |= across & (along <= arms[:, None]) & (along >= -outer[:, None])
    if seen is not None:
        chosen &= seen
    index, weight = pack_rows(chosen)
    return _windows(np.take_along_axis(values, index, axis=1), grid.place[:, index].transpose(1, 0, 2), weight)


def pack_rows(chosen: Booleans) -> tuple[Integers, Singles]:
    """Return the pixels of each row that are chosen of (m, n), (m, k), and their weights: 0 where a row has fewer."""
    row, pixel = np.nonzero(chosen)
    each = chosen.sum(axis=1)
    slot = np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each)
    index = np.zeros((len(chosen), max(int(each.max()), 1)), np.int64)
    weight = np.zeros(index.shape, np.float32)
    index[row, slot], weight[row, slot] = pixel, 1
    return index, weight


def _windows(values: Singles, place: Singles, weight: Singles) -> Windows:
    saturated = bool(values.max() >= SATURATED or values.min() <= 0)
    return Windows(values=values, place=place, weight=weight, saturated=saturated)


def normal_distribution(a: Singles) -> tuple[Singles, Singles]:
    """Return 2 Phi(a) - 1, to 2.5e-5 (Abramowitz and Stegun 7.1.25), and phi(a), as fast as pixels need it."""
    square = a * a
    np.minimum(square, _FAR, out=square)  # beyond, there is nothing but denormal numbers, which are slow
    square *= -0.5
    exponential = np.exp(square, out=square)
    t = np.abs(a)
    t *= np.float32(0.47047 / np.sqrt(2))
    t += 1
    np.reciprocal(t, out=t)
    series = t * np.float32(0.7478556)
    series -= np.float32(0.0958798)
    series *= t
    series += np.float32(0.3480242)
    series *= t
    series *= exponential
    exponential *= np.float32(1 / np.sqrt(2 * np.pi))
    return np.copysign(1 - series, a), exponential


@value_class
class PointFits:
    """Points as they were fitted, m of them.

    Attributes
    ----------
    pixels : (m, 2) [px]
    sigma_px : (m,) standard deviation per axis, from the residuals [px]
    blur_px : (m,) standard deviation of the blur, of corners the root mean square across both edges [px]
    misfit : (m,) rms of the residuals over the contrast
    good : (m,) whether the picture is that of such a point, near the guess
    """

    pixels: Floats
    sigma_px: Floats
    blur_px: Floats
    misfit: Floats
    good: Booleans

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, chosen: NDArray[np.integer] | Booleans) -> Self:
        """Return some of the points."""
        return type(self)(**{name: getattr(self, name)[chosen] for name in field_names(type(self))})


@value_class
class CornerFits(PointFits):
    """Corners as they were fitted.

    Attributes
    ----------
    black, white : (m,) grey levels
    normals : (m, 2, 2) unit normals of both edges
    bow, slope : (m, 2, 2) by how much the corner is found beside its place, as columns: for an edge that bends towards
        its normal with a curvature of one, the first or the second [px^2]; for light that grows by the whole of it in a
        pixel, to the right or downwards [px^2]
    """

    black: Floats
    white: Floats
    normals: Floats
    bow: Floats
    slope: Floats


def join_corner_fits(first: CornerFits, second: CornerFits) -> CornerFits:
    """Return the corners of both."""
    both = {name: (getattr(first, name), getattr(second, name)) for name in field_names(CornerFits)}
    return CornerFits(**{name: np.concatenate(values) for name, values in both.items()})


def damp_diagonals(matrix: Floats) -> None:
    """Make the diagonals of normal matrices (m, n, n) a little larger, in place."""
    diagonal = np.einsum("mii->mi", matrix)
    diagonal *= 1 + DAMPING
    diagonal += 1e-6
