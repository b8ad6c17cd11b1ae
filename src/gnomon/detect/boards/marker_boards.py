"""What grids of tags and boards with markers have in common: how they are sought, and which corners are kept."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ...models.camera import Booleans
from ...recording import Floats, Integers
from ...recording.frames import Grey
from ..corners.fitted_corners import CornerFits, PointFits
from .board import BoardView, middle_of, nothing_seen
from .plane_map import LensGuess, PlaneMap, correct_corners
from .quads import LARGE_IMAGE_PX, Search, black_quads

BORDER_PX = 5.0
"""Corners nearer to the image's border are left out."""

COVERED, NEAR_BORDER = "blurred or covered", "near the border"

MOVED_PX, MOVED = 1.5, 0.12
"""How far corners may be from where their neighbours say, in px, and in tags or squares."""

CONTRAST = 0.4
"""Of a corner over that of its neighbours."""

WINDOW = 0.85
"""Radius of the window over the distance to what else is printed there."""

_SEARCHES: tuple[Search, ...] = ("coarse", "usual", "motion", "small")
_SAME_PX = 3.0  # of the middles of two tags that are one
_SIGMAS = 5.0  # what the sigma may be, over that of the others
_MISFIT, _MISFITS = 0.035, 3.0  # what the misfit may be, over the contrast and over that of the others


def quads_searched(image: Grey) -> Iterator[tuple[Search, Floats]]:
    """Yield black quadrilaterals (q, 4, 2) [px], all so far, as more and more ways to find them are tried."""
    quads = np.empty((0, 4, 2))
    for search in _SEARCHES:
        if search == "coarse" and image.size > LARGE_IMAGE_PX:
            continue
        more = black_quads(image, search)
        if len(more):
            quads = np.concatenate([quads, more])
            yield search, quads


def unrepeated_tags(number: Integers, corners: Floats) -> Booleans:
    """Return which of tags (k,) with corners (k, 4, 2) [px] are no second finding of one before, in the same place."""
    middle = corners.mean(axis=1)
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    same = (number[:, None] == number) & (apart < _SAME_PX) & np.tri(len(number), k=-1, dtype=bool)
    return ~same.any(axis=1)


def inside_image(image: Grey, pixels: Floats, margin_px: float) -> Booleans:
    """Return which places (..., 2) are in the image and not nearer to its border than a margin [px]."""
    height, width = image.shape
    x, y = pixels[..., 0], pixels[..., 1]
    return (np.minimum(x, width - 1 - x) >= margin_px) & (np.minimum(y, height - 1 - y) >= margin_px)


def as_good_as(fits: PointFits, misfit: float, sigma_px: float) -> Booleans:
    """Return which points look as they should as much as the others do, and are told as well, by medians of those."""
    return (fits.misfit < _MISFIT + _MISFITS * misfit) & (fits.sigma_px < _SIGMAS * sigma_px)


def view_of(
    image: Grey,
    point: Integers,
    places: Floats,
    fits: CornerFits,
    dropped: Counter[str],
    *,
    lens: LensGuess | None = None,
    seen: PlaneMap | None = None,
) -> BoardView:
    """Return what is seen of a board.

    Parameters
    ----------
    image : (h, w)
    point : (m,) numbers of the corners
    places : (m, 2) of them on the board
    fits : of them
    dropped : reason -> number of corners that were left out
    lens : from the image before
    seen : the map through the corners, where it is known
    """
    order = np.argsort(point)
    if not len(order):
        return nothing_seen(+dropped)
    fits, size = fits.only(order), image.shape[::-1]
    if seen is None:
        seen = (lens or LensGuess()).plane_map(places[order], fits.pixels, size)
    return BoardView(
        point=point[order],
        pixels=correct_corners(fits, size, seen),
        sigma_px=fits.sigma_px,
        blur_px=middle_of(fits.blur_px),
        black=middle_of(fits.black),
        white=middle_of(fits.white),
        dropped=+dropped,
    )
