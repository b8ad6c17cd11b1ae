"""What grids of tags and boards with markers have in common: how they are sought, and which corners are kept.

Black quadrilaterals in an image: where a tag might be.

A pixel is black where it is nearer to the darkest than to the lightest one of its neighbourhood, and where these are
far enough apart. The limit is below the middle: squares that touch at a corner, as on Kalibr's boards, come apart.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal

import cv2
import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .board import BoardView, middle_of, nothing_seen
from .corner_windows import CornerFits, PointFits
from .plane_map import LensGuess, PlaneMap, correct_corners

LARGE_IMAGE_PX = 1.3e6
"""Images with more pixels are first looked through at half of their resolution."""

_TILE_PX, _NEIGHBOURS = 4, 3  # side of a tile, and how many of them side by side are a neighbourhood
_STRONG = 0.95  # share of all neighbourhoods that have less contrast than the strongest
_LEAST_CONTRAST = 8  # grey levels
_SHORTEST_SIDE_PX = 7.0
_STRAIGHT = 0.055  # deviation of an outline from its polygon over the outline's length
_FILLED = 0.8  # area of the outline over that of the quadrilateral
_REFINED_PX = 2
_REFINEMENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 5, 0.05)
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
BORDER_PX = 5.0
"""Corners nearer to the image's border are left out."""

COVERED, NEAR_BORDER = "blurred or covered", "near the border"

MOVED_PX, MOVED = 1.5, 0.12
"""How far corners may be from where their neighbours say, in px, and in tags or squares."""

CONTRAST = 0.4
"""Of a corner over that of its neighbours."""

WINDOW = 0.85
"""Radius of the window over the distance to what else is printed there."""

_SAME_PX = 3.0  # of the middles of two tags that are one
_SIGMAS = 5.0  # what the sigma may be, over that of the others
_MISFIT, _MISFITS = 0.035, 3.0  # what the misfit may be, over the contrast and over that of the others


@value_class(eq=True)
class _Search:
    """How black regions are told from the rest.

    Attributes
    ----------
    black : how far from black to white the limit is
    contrast : of a neighbourhood, over that of the strongest ones; less has no black in it
    thinned : whether black regions lose a pixel all around, so that those come apart that motion has joined
    scale : of the image that is looked through
    rounded_px : what the corners of an outline lose along the diagonal
    """

    black: float
    contrast: float
    thinned: bool = False
    scale: float = 1.0
    rounded_px: float = 0.6


Search = Literal["usual", "coarse", "motion", "small"]
_SEARCHES: tuple[Search, ...] = ("coarse", "usual", "motion", "small")

_SEARCH_OPTIONS: dict[Search, _Search] = {
    "usual": _Search(black=0.25, contrast=0.4),
    "coarse": _Search(black=0.25, contrast=0.4, scale=0.5),
    "motion": _Search(black=0.35, contrast=0.15, thinned=True, rounded_px=1.7),
    "small": _Search(black=0.4, contrast=0.3, scale=2.0),
}


def quad_search_scale(image: Grey, search: Search) -> float:
    """Return at what part of its resolution an image is looked through."""
    scale = _SEARCH_OPTIONS[search].scale
    return scale / 2 if image.size > LARGE_IMAGE_PX else scale


def black_quads(image: Grey, search: Search = "usual") -> Floats:
    """Return the black quadrilaterals of an image, (q, 4, 2) [px], corners clockwise as one sees them.

    Parameters
    ----------
    image : (h, w)
    search : "coarse" looks at half of the resolution, which is fast and finds large ones; "motion" finds those in
        images that are blurred by motion, or faint; "small" looks at twice the resolution
    """
    how, scale = _SEARCH_OPTIONS[search], quad_search_scale(image, search)
    if min(image.shape) * scale < 2 * _SHORTEST_SIDE_PX:
        return np.empty((0, 4, 2))
    if scale != 1:
        shrink = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=shrink), dtype=np.uint8)
    found = _outlined(_white(image, how))
    if not found:
        return np.empty((0, 4, 2))
    quads = _sharpened(_clockwise(np.array(found, dtype=np.float64).reshape(-1, 4, 2)), how.rounded_px)
    if scale < 1:
        quads = _refined(image, quads)
    return (quads + 0.5) / scale - 0.5


def black_limits(image: Grey, black: float, contrast: float) -> Any:
    """Return the grey level below which each pixel counts as black, (h, w); 0 where nothing does.

    Parameters
    ----------
    black : how far from the darkest to the lightest one of the neighbourhood the limit is
    contrast : of a neighbourhood, over that of the strongest ones; less has no black in it
    """
    height, width = image.shape
    tile, tiles = np.ones((_TILE_PX, _TILE_PX), np.uint8), np.ones((_NEIGHBOURS, _NEIGHBOURS), np.uint8)
    every = slice(_TILE_PX // 2, None, _TILE_PX)
    darkest = cv2.erode(cv2.erode(image, tile)[every, every], tiles)
    lightest = cv2.dilate(cv2.dilate(image, tile)[every, every], tiles)
    apart = np.asarray(cv2.subtract(lightest, darkest))
    strongest = float(np.searchsorted(np.cumsum(np.bincount(apart.ravel(), minlength=256)), _STRONG * apart.size))
    limit = cv2.addWeighted(lightest, black, darkest, 1 - black, 0)
    limit = np.where(apart < max(contrast * strongest, _LEAST_CONTRAST), np.uint8(0), limit)
    # the middle of tile k is at pixel 4 k + 1.5, as resize takes it
    return cv2.resize(limit, (width, height), interpolation=cv2.INTER_LINEAR)


def _white(image: Grey, how: _Search) -> Grey:
    """Return 255 for white, 0 for black."""
    white = cv2.compare(image, black_limits(image, how.black, how.contrast), cv2.CMP_GT)
    if how.thinned:
        white = cv2.dilate(white, _CROSS)
    white = np.asarray(white, dtype=np.uint8)
    white[:1], white[-1:], white[:, :1], white[:, -1:] = 255, 255, 255, 255
    return white


def _outlined(white: Grey) -> list[Any]:
    """Return the quadrilaterals (4, 1, 2) among the black regions; a region is pixels that share sides."""
    outlines, tree = cv2.findContours(white, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return []
    hole = np.asarray(tree)[0, :, 3] >= 0
    points = np.fromiter(map(len, outlines), np.int64, len(outlines))
    longest = 2 * sum(white.shape)
    found: list[Any] = []
    for i in np.flatnonzero(hole & (points >= 4)).tolist():
        outline = outlines[i]
        length = cv2.arcLength(outline, True)
        if not 4 * _SHORTEST_SIDE_PX <= length <= longest:
            continue
        polygon = cv2.approxPolyDP(outline, _STRAIGHT * length, True)
        if len(polygon) != 4:
            continue
        area = cv2.contourArea(polygon)
        filled = cv2.contourArea(outline) >= _FILLED * area
        if area >= _SHORTEST_SIDE_PX**2 and filled and cv2.isContourConvex(polygon):
            found.append(polygon)
    return found


def _refined(image: Grey, quads: Floats) -> Floats:
    """Return the quadrilaterals with corners where the gradients point past them: less than a pixel is too coarse."""
    height, width = image.shape
    inside = ((quads >= 0) & (quads <= [width - 1, height - 1])).all(axis=(1, 2))
    start = np.ascontiguousarray(quads[inside].reshape(-1, 1, 2), dtype=np.float32)
    if not len(start):
        return quads
    found = cv2.cornerSubPix(image, start.copy(), (_REFINED_PX, _REFINED_PX), (-1, -1), _REFINEMENT)
    moved = np.asarray(found - start, dtype=np.float64).reshape(-1, 4, 2)
    refined = quads.copy()
    refined[inside] += np.where((np.abs(moved) < _REFINED_PX).all(axis=2, keepdims=True), moved, 0)
    return refined


def _clockwise(quads: Floats) -> Floats:
    following = np.roll(quads, -1, axis=1)
    area = (quads[:, :, 0] * following[:, :, 1] - following[:, :, 0] * quads[:, :, 1]).sum(axis=1)
    return np.where((area > 0)[:, None, None], quads, quads[:, ::-1])


def _sharpened(quads: Floats, by_px: float) -> Floats:
    """Return the quadrilaterals with their corners a little farther out: limits below the middle round them off."""
    outward = quads - quads.mean(axis=1, keepdims=True)
    distance = np.linalg.norm(outward, axis=2, keepdims=True)
    return quads + outward * (by_px / np.maximum(distance, 1))


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
