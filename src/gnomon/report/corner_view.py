"""Corners of a camera as its figures need them: residuals, and sums over the image."""

from collections.abc import Mapping

import numpy as np

from ..frozen import value_class
from ..recording import Floats, Integers
from ..results.camera_diagnostics import CornerFit
from .numbers import positive_or

FIELD_COLUMNS, DENSITY_COLUMNS = 12, 32
"""Cells across the image for mean residuals, and for counts."""
_FEWEST = 8
"""Corners that a mean residual needs."""
_ENOUGH = 100_000
"""Numbers from which a quantile is taken."""


@value_class
class ImageGrid:
    """Cells over an image, row by row.

    Attributes
    ----------
    corner : (n, 2) upper left corners [px]
    size : width and height of a cell [px]
    count : (n,) corners used
    mean : (n, 2) their mean residual [px]; nan where there are too few
    """

    corner: Floats
    size: tuple[float, float]
    count: Floats
    mean: Floats


@value_class
class CornerView:
    """Corners of frames that were used, and that have a residual.

    Attributes
    ----------
    fit : where they come from
    residual : (k, 2) predicted minus detected [px]
    t_s : (k,) [s]
    weighed_down : number of corners whose robust weight is below one
    reach : how far residuals are drawn [px]: four to six sigma, nearly all corners
    density, field : over the image, in fine and in coarse cells
    word : what each is called
    """

    fit: CornerFit
    residual: Floats
    t_s: Floats
    weighed_down: int
    reach: float
    density: ImageGrid
    field: ImageGrid
    word: str = "corner"


def corner_view(fit: CornerFit, word: str = "corner") -> CornerView:
    """Return the corners of a camera, or whatever `word` is seen instead, as the figures need them."""
    kept = np.asarray(fit.frame_used, dtype=bool)[fit.frame]
    for part in (fit.residual, fit.pixels):
        kept &= np.isfinite(part[:, 0]) & np.isfinite(part[:, 1])
    residual, pixels = fit.residual[kept], fit.pixels[kept]
    sizes = np.abs(residual[:: max(1, len(residual) // _ENOUGH)])
    wanted = 1.05 * float(np.quantile(sizes, 0.999)) if sizes.size else 0.0
    sigma = positive_or(fit.sigma_px, 0.0)
    return CornerView(
        fit=fit,
        residual=residual,
        t_s=fit.frame_t_s[fit.frame[kept]],
        weighed_down=int((np.asarray(fit.weight)[kept] < 1).sum()),
        reach=positive_or(float(np.clip(wanted, 4 * sigma, 6 * sigma)), positive_or(wanted)),
        density=_grid(pixels, residual, fit.resolution, DENSITY_COLUMNS),
        field=_grid(pixels, residual, fit.resolution, FIELD_COLUMNS),
        word=word,
    )


def _grid(pixels: Floats, residual: Floats, resolution: tuple[int, int], columns: int) -> ImageGrid:
    width, height = resolution
    rows = max(1, round(columns * height / width))
    size = (width / columns, height / rows)
    column = _cell(pixels[:, 0], size[0], columns)
    place = _cell(pixels[:, 1], size[1], rows) * columns + column
    count = np.bincount(place, minlength=columns * rows).astype(np.float64)
    sums = [np.bincount(place, residual[:, i], minlength=columns * rows) for i in range(2)]
    mean = np.stack(sums, axis=1) / np.where(count < _FEWEST, np.nan, count)[:, None]
    y, x = np.divmod(np.arange(columns * rows), columns)
    corner = np.stack([x * size[0] - 0.5, y * size[1] - 0.5], axis=1)  # pixel 0 reaches from -0.5 to 0.5
    return ImageGrid(corner=corner, size=size, count=count, mean=mean)


def _cell(pixel: Floats, size: float, cells: int) -> Integers:
    return np.clip((pixel + 0.5) / size, 0, cells - 1).astype(np.int64)


def field_magnification(views: Mapping[str, CornerView]) -> float:
    """Return by how much the arrows of all cameras are lengthened: a long one spans most of a cell."""
    wanted: list[float] = []
    for view in views.values():
        size = np.hypot(*view.field.mean.T)
        size = size[np.isfinite(size)]
        if size.size and float(np.quantile(size, 0.95)) > 0:
            wanted.append(0.75 * view.field.size[0] / float(np.quantile(size, 0.95)))
    least = min(wanted, default=1.0)
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * max(step for step in (1, 1.5, 2, 3, 4, 5, 6, 8) if step * power <= least * 1.0001))
