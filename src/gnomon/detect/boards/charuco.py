"""ChArUco boards: which inner corners of the chessboard are where in an image; parts of the board are enough.

find black quadrilaterals -> read the markers -> take those that agree on where they are -> fit the corners next to them
-> go on to their neighbours -> drop corners that are not where those around them say

The markers only tell which corner is which. Each corner is a crossing of two edges and is fitted like one; where the
next ones are, those around tell, by a map of their own that follows perspective and lens.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ...frozen import value_class
from ...models.board_pattern import black_square, marker_cells
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .board import NOT_WITH_NEIGHBOURS, SECOND_BOARD, BoardView, comes_first, nothing_seen
from .corner_fit import fit_corners
from .corner_windows import CornerFits, join_corner_fits
from .marker_boards import (
    BORDER_PX,
    CONTRAST,
    COVERED,
    MOVED,
    MOVED_PX,
    NEAR_BORDER,
    WINDOW,
    Search,
    as_good_as,
    inside_image,
    quads_searched,
    unrepeated_tags,
    view_of,
)
from .plane_map import plane_map
from .tag_places import connected_tags, consistent_corners, locate_points, map_points, once_each, shortest_side
from .tags import Tags, corners_by_lattice, read_markers, square_to_quads

_FEW_CORNERS = 12  # with fewer of them, they are also sought as a lattice
_FEWEST_MARKERS, _FEWEST_CORNERS = 2, 4  # a marker that is alone might be any
_MISSED = {"coarse": 0.1}  # corners that are missed over those that are found, above which another search follows
_MISSED_LATER = 0.5
_APART_PX, _APART, _REACH = 1.5, 0.35, 2.9  # of markers from where others say: px, of a marker; over squares at most
_NEXT = 0.8  # squares from a marker's middle to corners that it tells
_LEAST_SPREAD = 0.6  # squares, of corners across the line that they are nearest to, to tell where others are
_STEP = 0.2  # squares, for the direction of the edges
_RIGHT, _UP = np.array([_STEP, 0.0]), np.array([0.0, _STEP])
_GROWTHS = 20
_FEWEST_FOR_MAP = 16
_ASTRAY_PX, _ASTRAY, _ASTRAY_SIGMAS = 0.1, 3.0, 3.0  # how far from the map a corner may be: px, medians, sigmas


def detect_charuco(image: Grey, target: Target) -> BoardView:
    """Find the inner corners of a ChArUco board; parts of the board are enough.

    Parameters
    ----------
    image : (h, w)
    target : the board, a charuco

    Raises
    ------
    OptionError
        If OpenCV has no dictionary of that name, or it has not as many markers.
    """
    image = np.ascontiguousarray(image)
    marker_cells(target.dictionary, target.first_tag + len(_layout(target).marker_corners) - 1)  # there must be such
    best, strangers = None, 0
    for search, markers in _searched(image, target):
        found = _board(image, target, markers)
        if found is None:
            strangers = max(strangers, len(markers))
            continue
        if best is None or len(found.number) > len(best.number):
            best = found
        few = len(best.number) < min(_FEW_CORNERS, len(target) // 2)
        if not few and best.missed <= _MISSED.get(search, _MISSED_LATER) * len(best.number):
            break
    if best is None or len(best.number) < min(_FEW_CORNERS, len(target) // 2):
        found = _by_lattice(image, target)
        if found is not None and (best is None or len(found.number) > len(best.number)):
            best = found
    if best is None:
        return nothing_seen({NOT_WITH_NEIGHBOURS: 2 * strangers} if strangers else None)
    return _view(image, target, best)


def _searched(image: Grey, target: Target) -> Iterator[tuple[Search, Tags]]:
    """Yield the markers that were read, as more and more ways to find them are tried."""
    count = len(_layout(target).marker_corners)
    for search, quads in quads_searched(image):
        found = read_markers(image, quads, target.dictionary, first=target.first_tag, count=count)
        kept = unrepeated_tags(found.number, found.corners)
        if kept.any():
            yield search, found.only(kept)


@value_class
class _Layout:
    """What is where on a board, lengths in squares.

    Attributes
    ----------
    points : (n, 2) the inner corners
    marker_corners : (k, 4, 2) of the markers, clockwise from the upper left as they stand
    falling : (n,) whether the square at the upper left of a corner is black
    gap : between a marker and the sides of its square
    """

    points: Floats
    marker_corners: Floats
    falling: Booleans
    gap: float


@lru_cache(maxsize=8)
def _layout(target: Target) -> _Layout:
    side = target.marker_size_m / target.square_size_m
    inner = side / 2 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    middles = [
        (col - 0.5, target.rows - 1.5 - row)
        for row, col in np.ndindex(target.rows, target.cols)
        if not black_square(target, row, col)
    ]
    row, col = np.divmod(np.arange(len(target)), target.cols - 1)
    return _Layout(
        points=target.points[:, :2] / target.square_size_m,
        marker_corners=np.array(middles)[:, None] + inner,
        falling=np.array([black_square(target, i, j) for i, j in zip(row.tolist(), col.tolist(), strict=True)]),
        gap=(1 - side) / 2,
    )


@value_class
class _Board:
    """Corners in an image: their numbers (m,), their fits (m,), and how many are missing that should be there.

    `strange` markers were read beside the board, `second` ones on another board like it.
    """

    number: Integers
    fits: CornerFits
    missed: int
    strange: int
    second: int = 0


def _board(image: Grey, target: Target, markers: Tags) -> _Board | None:
    """Return the board that most markers make up; None where there are only single ones."""
    layout = _layout(target)
    number = markers.number - target.first_tag
    H = _from_board(layout.marker_corners[number], markers.corners)
    groups = [members for members in _groups(layout, number, markers.corners, H) if len(members) >= _FEWEST_MARKERS]
    second = 0
    if again := [k for k in range(1, len(groups)) if _is_again(markers, groups[0], groups[k])]:
        other = again[0]
        if _is_before(markers.corners[groups[other]], markers.corners[groups[0]]):
            groups[0], groups[other] = groups[other], groups[0]
        second = len(groups.pop(other))
    for members in groups:
        start = _next_to_markers(image, target, number[members], H[members])
        if start is None:
            continue
        grown = _grown(image, target, *start, strange=len(markers) - len(members) - second)
        return replace(grown, second=second)
    return None


def _is_again(markers: Tags, first: Integers, other: Integers) -> bool:
    """Return whether two groups have markers in common, in different places."""
    _, one, two = np.intersect1d(markers.number[first], markers.number[other], return_indices=True)
    corners = markers.corners[first[one]]
    away = np.linalg.norm(corners.mean(axis=1) - markers.corners[other[two]].mean(axis=1), axis=1)
    return bool(np.count_nonzero(away > shortest_side(corners)) >= _FEWEST_MARKERS)


def _is_before(own: Floats, others: Floats) -> bool:
    """Return whether of two boards, of whose markers these are the corners (k, 4, 2), the first is the one to take."""
    every = np.stack([own.mean(axis=0), others.mean(axis=0)])
    middle, other = every.mean(axis=1)
    return comes_first(middle, other, every[:, 1] - every[:, 0], every[:, 0] - every[:, 3])


def _by_lattice(image: Grey, target: Target) -> _Board | None:
    """Return the board by the lattice of its corners; None where there is none, or no place of it is likely."""
    found = corners_by_lattice(image, target)
    if found is None or not _spread(_layout(target).points[found[0]]):
        return None
    number, pixels = found
    layout = _layout(target)
    points = layout.points[number]
    start = _charted(image, target, number, points, pixels)
    return None if start is None else _grown(image, target, *start, strange=0)


def _from_board(marker_corners: Floats, pixels: Floats) -> Floats:
    """Return the homographies (k, 3, 3) from the board, in squares, to the image that markers tell."""
    # from the board to the unit square, whose corners are (0,0) (1,0) (1,1) (0,1): the marker's upper left one first
    origin, side = marker_corners[:, 0], marker_corners[:, 1, 0] - marker_corners[:, 0, 0]
    to_unit = np.zeros((len(pixels), 3, 3))
    to_unit[:, 0, 0], to_unit[:, 1, 1], to_unit[:, 2, 2] = 1 / side, -1 / side, 1
    to_unit[:, 0, 2], to_unit[:, 1, 2] = -origin[:, 0] / side, origin[:, 1] / side
    return square_to_quads(pixels) @ to_unit


def _groups(layout: _Layout, number: Integers, corners: Floats, H: Floats) -> list[Integers]:
    """Return which markers agree with each other on where they are, the largest group first.

    A marker that is twice in a group is there once, as more of the others say.
    """
    middles = layout.marker_corners[number].mean(axis=1)
    told = map_points(H, np.broadcast_to(middles, (len(H), *middles.shape)))
    apart = np.linalg.norm(told - corners.mean(axis=1), axis=2)
    distance = np.linalg.norm(middles[:, None] - middles, axis=2)
    agrees = (apart < _APART_PX + _APART * shortest_side(corners) * distance) & (distance > 0) & (distance < _REACH)
    agrees &= agrees.T
    group = connected_tags(agrees)
    found = [once_each(np.flatnonzero(group == name), number, agrees) for name in sorted(set(group.tolist()))]
    return sorted(found, key=len, reverse=True)


def _next_to_markers(image: Grey, target: Target, number: Integers, H: Floats) -> tuple[Integers, CornerFits] | None:
    """Return the corners around markers; None where there are too few."""
    layout = _layout(target)
    middles = layout.marker_corners[number].mean(axis=1)
    near = np.linalg.norm(middles[:, None] - layout.points, axis=2) < _NEXT  # (k, n)
    # those at the marker's own square tell best
    weight = near / (0.1 + np.square(np.linalg.norm(middles[:, None] - layout.points, axis=2)))
    asked = np.flatnonzero(near.any(axis=0))
    share = weight[:, asked] / weight[:, asked].sum(axis=0)

    def told(points: Floats) -> Floats:
        return np.einsum("kn,knj->nj", share, map_points(H, np.broadcast_to(points, (len(H), *points.shape))))

    points = layout.points[asked]
    fits = _fit(image, target, asked, (told(points), told(points + _RIGHT), told(points + _UP)))
    return _bright(asked, fits)


def _bright(number: Integers, fits: CornerFits) -> tuple[Integers, CornerFits] | None:
    """Return the good ones of corners, without those of little contrast; None where there are too few."""
    if np.count_nonzero(fits.good) < _FEWEST_CORNERS:
        return None
    contrast = fits.white - fits.black
    good = fits.good & (contrast > CONTRAST * np.median(contrast[fits.good]))
    return number[good], fits.only(good)


def _charted(
    image: Grey, target: Target, number: Integers, points: Floats, pixels: Floats
) -> tuple[Integers, CornerFits] | None:
    """Return the fits of corners that are known to a pixel or two; None where there are too few."""
    right, up = np.split(locate_points(points, pixels, np.concatenate([points + _RIGHT, points + _UP])), 2)
    return _bright(number, _fit(image, target, number, (pixels, right, up)))


def _fit(image: Grey, target: Target, number: Integers, places: tuple[Floats, Floats, Floats]) -> CornerFits:
    """Return the fits of corners; good are those that are where they should be.

    Parameters
    ----------
    number : (m,) of the corners
    places : (m, 2) each, where they should be, and places to the right of them and above them on the board [px]
    """
    layout = _layout(target)
    expected, right, up = places
    across, along = (right - expected) / _STEP, (up - expected) / _STEP
    length = np.maximum(np.linalg.norm(np.stack([across, along]), axis=2), 1e-9)
    sine = np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]) / (length[0] * length[1])
    height = length.min(axis=0) * sine
    # the black wedge at the upper left lies between the ways to the left and up, that at the upper right otherwise
    sign = np.where(layout.falling[number], -1.0, 1.0)[:, None]
    edges = np.stack([sign * across / length[0][:, None], along / length[1][:, None]], axis=1)
    free = layout.gap * np.minimum(*(_to_marker(first, -sign * second) for first, second in _both(across, along)))
    fits = fit_corners(image, expected, edges, WINDOW * free)
    near = np.linalg.norm(fits.pixels - expected, axis=1) < MOVED_PX + MOVED * height
    return replace(fits, good=fits.good & near)


def _both(across: Floats, along: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    return (across, along), (along, across)


def _to_marker(first: Floats, second: Floats) -> Floats:
    """Return the distance of the nearest marker from corners, (m,) [px] over its gap to the sides of its square.

    Parameters
    ----------
    first, second : (m, 2) steps along the sides of the white square [px]
    """
    onward = -(first * second).sum(axis=1) / np.maximum(np.square(first).sum(axis=1), 1e-9)
    return np.linalg.norm(np.maximum(onward, 1)[:, None] * first + second, axis=1)


def _grown(image: Grey, target: Target, number: Integers, fits: CornerFits, *, strange: int) -> _Board:
    """Return the board with more corners next to those that were found, until there are none."""
    layout = _layout(target)
    asked = np.zeros(len(target), np.int64)  # by how many neighbours each corner was told its place already
    apart = np.abs(layout.points[:, None] - layout.points).max(axis=2)
    expected_inside = np.zeros(len(target), bool)
    for _ in range(_GROWTHS):
        missing = np.ones(len(target), bool)
        missing[number] = False
        tellers = (apart[:, number] < 1.5).sum(axis=1)
        chosen = np.flatnonzero(missing & (tellers > asked) & _spread(layout.points[number]))
        if not len(chosen):
            break
        asked[chosen] = tellers[chosen]
        points = layout.points[chosen]
        three = np.concatenate([points, points + _RIGHT, points + _UP])
        places = np.stack(np.split(locate_points(layout.points[number], fits.pixels, three), 3))
        visible = inside_image(image, places[0], BORDER_PX)
        expected_inside[chosen] = visible
        more = _fit(image, target, chosen[visible], (places[0, visible], places[1, visible], places[2, visible]))
        contrast = float(np.median(fits.white - fits.black))
        good = more.good & (more.white - more.black > CONTRAST * contrast)
        number, fits = np.concatenate([number, chosen[visible][good]]), join_corner_fits(fits, more.only(good))
    expected_inside[number] = False
    return _Board(
        number=number,
        fits=fits,
        missed=int(np.count_nonzero(expected_inside)),
        strange=strange,
    )


def _spread(points: Floats) -> bool:
    """Return whether points (m, 2) are not on a line."""
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] > _LEAST_SPREAD)


def _alike(fits: CornerFits, others: CornerFits) -> Booleans:
    """Return which corners look like a corner as much as the others do, and are told as well."""
    return as_good_as(fits, float(np.median(others.misfit)), float(np.median(others.sigma_px)))


def _again(
    image: Grey, target: Target, asked: Integers, found: tuple[Integers, CornerFits]
) -> tuple[Integers, CornerFits]:
    """Return the corners that were found, and those that are as good where the fit starts from what these tell."""
    (number, fits), board = found, _layout(target).points
    if not len(asked) or len(number) < _FEWEST_CORNERS or not _spread(board[number]):
        return found
    points = board[asked]
    three = locate_points(board[number], fits.pixels, np.concatenate([points, points + _RIGHT, points + _UP]))
    expected, right, up = np.split(three, 3)
    more = _fit(image, target, asked, (expected, right, up))
    good = more.good & inside_image(image, more.pixels, BORDER_PX) & _alike(more, fits)
    return np.concatenate([number, asked[good]]), join_corner_fits(fits, more.only(good))


def _where_they_belong(points: Floats, fits: CornerFits, size: tuple[int, int]) -> Booleans:
    """Return which corners are where those around them say, or a smooth map through those that are (wide lenses)."""
    kept, _ = consistent_corners(points, fits.pixels, fits.sigma_px)
    if kept.all() or np.count_nonzero(kept) < _FEWEST_FOR_MAP:
        return kept
    seen = plane_map(points[kept], fits.pixels[kept], size)
    away = seen.away_px(points, fits.pixels)
    return kept | (away < _ASTRAY_PX + np.maximum(_ASTRAY * np.median(away[kept]), _ASTRAY_SIGMAS * fits.sigma_px))


def _view(image: Grey, target: Target, board: _Board) -> BoardView:
    """Return the corners, without those that are doubtful."""
    number, fits = board.number, board.fits
    points = _layout(target).points
    dropped = Counter[str](
        {NOT_WITH_NEIGHBOURS: 2 * board.strange, SECOND_BOARD: 2 * board.second, COVERED: board.missed}
    )
    whole = inside_image(image, fits.pixels, BORDER_PX)
    dropped[NEAR_BORDER] += int(np.count_nonzero(~whole))
    number, fits = number[whole], fits.only(whole)
    alike = _alike(fits, fits)
    number, fits = _again(image, target, number[~alike], (number[alike], fits.only(alike)))
    dropped[COVERED] += int(np.count_nonzero(whole)) - len(number)
    kept = _where_they_belong(points[number], fits, image.shape[::-1])
    dropped[NOT_WITH_NEIGHBOURS] += int(np.count_nonzero(~kept))
    if np.count_nonzero(kept) < _FEWEST_CORNERS:
        return nothing_seen(+dropped)
    return view_of(image, number[kept], points[number[kept]], fits.only(kept), dropped)
