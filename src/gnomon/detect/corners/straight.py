"""What the fits of corners leave out and the board as a whole tells: edges that a lens bends, and uneven light.

The fit of a corner takes its edges for straight ones. A lens bends them, by l^2 / 2 times their curvature at the
distance l from the corner, and the fit lays a straight line through what it sees: with a usual lens it is 0.001 to
0.005 px beside the corner, towards the axis, and so all images together tell another distortion. The board as a whole
tells how the lens bends it; each fit tells what it makes of that (`CornerFits.bow`). Light that falls off towards the
border (vignetting) displaces corners, too, by 0.0005 px outwards and by more with black wedges one way or the other;
its slope is that of a paraboloid through the grey levels of all corners.
"""

import numpy as np

from ...recording import Floats
from ..boards.plane_map import PlaneMap, plane_map
from .fitted_corners import CornerFits

_FEWEST = 16  # corners that tell how the lens bends the board
_STEP = 0.08  # along the board, over its size, to both sides of a corner
_ASTRAY_PX = 1.0  # a map that is so far from half of the corners tells nothing
_MOST_PX = 0.1  # that a corner is moved


class LensGuess:
    """What an image told of the lens: a first guess for the next image of the same camera."""

    def __init__(self) -> None:
        self._last: PlaneMap | None = None

    def plane_map(self, points: Floats, pixels: Floats, size: tuple[int, int]) -> PlaneMap | None:
        """Return the map through points as `plane_map` does; None where it goes astray."""
        for near in dict.fromkeys((self._last, None)):
            found = plane_map(points, pixels, size, near)
            if np.median(np.abs(found.residual_px)) < _ASTRAY_PX:
                if near is None or not found.has_lens_of(near):
                    self._last = found
                return found
        return None


def corrected(points: Floats, fits: CornerFits, size: tuple[int, int], lens: LensGuess | None = None) -> Floats:
    """Return where the corners are, (m, 2) [px], without what bent edges and uneven light did to their fits.

    Parameters
    ----------
    points : (m, 2) on the board, whose edges are along both axes
    fits : of the corners, all of them good
    size : width and height of the image [px]
    lens : from the image before
    """
    spans = np.ptp(points, axis=0) if len(points) else np.zeros(2)
    if len(points) < _FEWEST or spans.min() <= 0:
        return fits.pixels
    seen = (lens or LensGuess()).plane_map(points, fits.pixels, size)
    if seen is None:
        return fits.pixels
    step = _STEP * float(spans.max())
    offsets = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    pixels = seen.pixels(points[:, None] + offsets, len(offsets))
    ahead, behind = pixels[:, 1::2] - pixels[:, :1], pixels[:, 2::2] - pixels[:, :1]
    along, bent = (ahead - behind) / 2, ahead + behind  # (m, axis of the board, 2)
    bent /= np.square(along).sum(axis=2, keepdims=True)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    # the axis of the board along which each edge runs
    axis = np.abs(np.einsum("mei,mai->mea", fits.normals, along)).argmin(axis=2)
    curvature = np.einsum("mei,mei->me", fits.normals, np.take_along_axis(bent, axis[:, :, None], axis=1))
    moved = np.einsum("mie,me->mi", fits.bow, curvature) + np.einsum("mie,me->mi", fits.slope, _light_slope(fits, size))
    moved[~(np.abs(moved).max(axis=1) < _MOST_PX)] = 0.0
    return fits.pixels - moved


def _light_slope(fits: CornerFits, size: tuple[int, int]) -> Floats:
    """Return by which share of it the light grows to the right and downwards, (m, 2) [1/px]."""
    scale = max(size) / 2
    x, y = ((fits.pixels - np.array(size) / 2) / scale).T
    one, none = np.ones_like(x), np.zeros_like(x)
    grey = np.maximum(fits.white + fits.black, 1.0)
    light, *_ = np.linalg.lstsq(np.stack([one, x, y, x * x, x * y, y * y], axis=1), np.log(grey), rcond=None)
    by_x = np.stack([none, one, none, 2 * x, y, none], axis=1)
    by_y = np.stack([none, none, one, none, x, 2 * y], axis=1)
    return np.stack([by_x @ light, by_y @ light], axis=1) / scale
