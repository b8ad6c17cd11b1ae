"""Grids of AprilTags: which corners of the board are where in an image.

find black quadrilaterals -> read their codes -> take the tags that agree on where they are -> fit their corners
-> look for the others where their neighbours say -> drop corners that are not where those around them say

Kalibr's boards have a black square at every corner of a tag, so that each corner is a crossing of two edges; on plain
grids it is the tip of a black wedge.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .board import NOT_WITH_NEIGHBOURS, SECOND_BOARD, BoardView, comes_first, middle_of, nothing_seen
from .corner_fit import CornerKind, fit_corners
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
    quad_search_scale,
    quads_searched,
    unrepeated_tags,
    view_of,
)
from .plane_map import LensGuess, PlaneMap
from .tag_places import (
    TAG,
    consistent_additions,
    consistent_corners,
    far_apart,
    group_tags,
    locate_points,
    map_points,
    predict_points,
    shortest_side,
)
from .tags import BITS, Tags, likeness_of, read_tags, square_to_quads

_FEWEST_TAGS, _FEWEST_CORNERS = 2, 6  # a tag that is alone might be any
_REPEATED, _LARGER = 2, 2.0  # tags that are there again; how much smaller a picture of the board is, by its sides
_ENOUGH = 3  # tags; with fewer, the image is looked through in other ways, too
_COARSE_PX = 13.0
_DOUBTS = 0.5
_ASKED = 9  # tags that tell whether there are squares
_FEWEST_FOR_CHART = 4  # tags; fewer tell only in straight lines where the others are
_GROWTHS = 12
_SMOOTH_PX, _MOST = 0.2, 0.9  # of a map through all corners: the farthest one, and how many are near
_SAME_PX = 0.5  # places from which a fit finds the same corner
_LEAST_LIKENESS, _NOT_ANOTHER = 0.5, 0.4  # of a tag that is where it should be
_NEXT_TO = np.array([[3, 1], [0, 2], [1, 3], [2, 0]])  # the corners before and after each
_ARM = 0.45  # of a side that is looked at from the tip of a plain tag


def detect_aprilgrid(image: Grey, target: Target) -> BoardView:
    """Find the corners of a grid of AprilTags; parts of the board are enough.

    Parameters
    ----------
    image : (h, w)
    target : the board, an aprilgrid
    """
    return search_tags(np.ascontiguousarray(image), target).view()


@value_class
class TagSearch:
    """What was found in an image.

    Attributes
    ----------
    grid : the board; None where it was not found
    tags : all that were read; None where there are none
    second : another board like it; None where there is none
    """

    grid: "TagGrid | None"
    tags: Tags | None
    second: "TagGrid | None" = None

    @property
    def strangers(self) -> int:
        """Number of tags of the board that were read beside it, and beside a second one."""
        if self.tags is None:
            return 0
        beside = np.ones(len(self.tags), dtype=bool)
        for board in (self.grid, self.second):
            if board is not None:
                beside &= board.is_beside(self.tags)
        return int(np.count_nonzero(beside))

    def view(self, lens: LensGuess | None = None) -> BoardView:
        """Return the corners, without those that are doubtful."""
        dropped = Counter[str]({NOT_WITH_NEIGHBOURS: 4 * self.strangers})
        if self.second is not None:
            dropped[SECOND_BOARD] = int(self.second.seen.good.sum())
        return nothing_seen(+dropped) if self.grid is None else self.grid.view(dropped, lens)


def search_tags(image: Grey, target: Target) -> TagSearch:
    """Look for the board in the whole image, (h, w) and contiguous."""
    best, tags, second = None, None, None
    for search, tags in _searched(image, target):
        found, other = _largest(image, target, tags)
        again = other is not None and second is None  # which of both is taken is known from here on
        if found is not None and (best is None or again or len(found.seen.number) > len(best.seen.number)):
            best, second = found, other or second
        if best is not None and best.is_whole(doubts=0.0 if search == "coarse" else _DOUBTS):
            break
    return TagSearch(grid=best, tags=tags, second=second)


def _searched(image: Grey, target: Target) -> Iterator[tuple[Search, Tags]]:
    """Yield the tags that were read, as more and more ways to find them are tried."""
    for search, quads in quads_searched(image):
        tags = _read(image, quads, target)
        if search == "coarse" and not _is_coarse_enough(tags, quad_search_scale(image, search)):
            continue
        yield search, tags


def _is_coarse_enough(tags: Tags, scale: float) -> bool:
    """Return whether tags are so large that hardly one of them is lost where the image is looked through coarsely."""
    return len(tags) >= _ENOUGH and middle_of(shortest_side(tags.corners)) * scale > _COARSE_PX


def _read(image: Grey, quads: Floats, target: Target) -> Tags:
    """Return the tags of the target in some quadrilaterals; a tag that was found twice once."""
    tags = read_tags(image, quads, border_bits=target.border_bits, first=target.first_tag, count=target.tags)
    tags = tags.only(unrepeated_tags(tags.number, tags.corners))
    return replace(tags, number=tags.number - target.first_tag)


def _largest(image: Grey, target: Target, tags: Tags) -> "tuple[TagGrid | None, TagGrid | None]":
    """Return the board that most tags make up, and a second one like it; None where there are only single tags.

    Of two that are about as large the first is the same one in each image (`comes_first`).
    """
    first = None
    for members in group_tags(target, tags.number, tags.corners) if len(tags) else []:
        again = members if first is None else members[first.is_again(tags)[members]]
        if len(again) < (1 if first is None else _REPEATED):
            continue
        board = TagGrid.grown(image, target, tags.number[members], tags.corners[members])
        if board.is_one and first is not None:
            return (board, first) if board.is_before(first) else (first, board)
        first = board if board.is_one else first
    return first, None


def _border(target: Target) -> float:
    """Return the width of the tags' black border in tags."""
    return target.border_bits / (BITS + 2 * target.border_bits)


def _kind(image: Grey, corners: Floats, target: Target) -> CornerKind:
    """Return "crossing" where there are black squares at the corners of the tags, as on Kalibr's boards."""
    gap, border = target.tag_spacing, 0.5 * _border(target)
    sides = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])
    squares = TAG + np.sign(TAG - 0.5) * gap / 2
    points = np.concatenate([squares, 0.5 + sides * (0.5 + gap / 2), 0.5 + sides * (0.5 - border)])
    places = map_points(square_to_quads(corners[:_ASKED]), points).astype(np.float32)
    grey = cv2.remap(image, places[:, :, 0], places[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    square, light, dark = (middle_of(part.ravel()) for part in np.split(np.asarray(grey, np.float64), 3, axis=1))
    return "crossing" if square < (light + dark) / 2 else "tip"


@value_class
class _Seen:
    """Tags, (k,), and the fits of their corners, (4 k,)."""

    number: Integers
    fits: CornerFits

    def with_more(self, more: "_Seen") -> "_Seen":
        return _Seen(number=np.concatenate([self.number, more.number]), fits=join_corner_fits(self.fits, more.fits))

    @property
    def corners(self) -> Floats:
        return self.fits.pixels.reshape(-1, 4, 2)

    @property
    def good(self) -> Booleans:
        return self.fits.good.reshape(-1, 4)


class TagGrid:
    """A board in an image.

    Parameters
    ----------
    image : (h, w), contiguous
    target : the board
    kind : of its corners
    """

    def __init__(self, image: Grey, target: Target, kind: CornerKind) -> None:
        self._image, self._target = image, target
        self.kind: CornerKind = kind
        self.seen = _Seen(number=np.empty(0, np.int64), fits=self._fit(np.empty((0, 4, 2))))
        self._expected = np.zeros(target.tags, dtype=bool)  # tags that should be inside the image as a whole
        self._tried = np.full((target.tags, 4, 2), np.inf)  # from where corners were fitted [px]
        self._parts: dict[int, tuple[float, CornerFits]] = {}  # tags that are not sure: likeness, and corners

    @classmethod
    def grown(cls, image: Grey, target: Target, number: Integers, corners: Floats) -> "TagGrid":
        """Return the board that is found from some of its tags (k,), read at corners (k, 4, 2) [px]."""
        grid = cls(image, target, _kind(image, corners, target))
        fits = grid._fit(corners)
        grid._tried[number] = corners
        # a corner that could not be fitted is where the quadrilateral has it
        pixels = np.where(fits.good[:, None], fits.pixels, corners.reshape(-1, 2))
        grid.seen = _Seen(number=number, fits=replace(fits, pixels=pixels))
        grid._grow()
        return grid

    @classmethod
    def at(cls, image: Grey, target: Target, kind: CornerKind, places: Floats, contrast: float) -> "TagGrid":
        """Return the board whose tags are near places (n, 4, 2) [px], with this contrast in the image before."""
        grid = cls(image, target, kind)
        within = inside_image(image, places, BORDER_PX)
        number = np.flatnonzero(within.any(axis=1))
        grid._expected = within.all(axis=1)
        grid.seen = grid._confirmed(number, places[number], np.full(len(number), contrast)) or grid.seen
        return grid

    def places(self) -> Floats:
        """Return where all tags of the board are, (n, 4, 2) [px], also those that were not found."""
        seen, every = self.seen, np.arange(self._target.tags)
        places = np.empty((len(every), 4, 2))
        places[seen.number] = seen.corners
        others = np.flatnonzero(~_within(seen.number, len(every)))
        if len(others):
            places[others] = self._charted(others)
        return places

    def _charted(self, number: Integers) -> Floats:
        """Return where tags are by the corners around them, (k, 4, 2) [px]."""
        seen, points = self.seen, self._target.points[:, :2]
        found = points[self._points(seen.number)[seen.fits.good]]
        return locate_points(found, seen.fits.pixels[seen.fits.good], points[self._points(number)]).reshape(-1, 4, 2)

    @property
    def is_one(self) -> bool:
        """Whether there is more than a single tag, which might be any."""
        enough = len(self.seen.number) >= _FEWEST_TAGS and self.seen.fits.good.sum() >= _FEWEST_CORNERS
        return enough or self._target.tags == 1

    def is_whole(self, doubts: float) -> bool:
        """Return whether there are enough tags, and hardly others where some should be, `doubts` over those found."""
        found = len(self.seen.number)
        return found >= min(_ENOUGH, self._target.tags) and bool(self.missing.sum() <= doubts * found)

    def _fit(self, corners: Floats, chosen: Booleans | None = None) -> CornerFits:
        """Return the fits (4 k,) of the corners of tags (k, 4, 2), or of some of these (k, 4)."""
        edges = corners[:, _NEXT_TO] - corners[:, :, None]
        guess = corners.reshape(-1, 2)
        edges = edges.reshape(-1, 2, 2)
        if chosen is not None:
            guess, edges = guess[chosen.ravel()], edges[chosen.ravel()]
        length = np.maximum(np.hypot(edges[..., 0], edges[..., 1]), 1e-9)
        edges = edges / length[..., None]
        sine = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
        shortest = length.min(axis=1)
        free = WINDOW * min(_border(self._target), self._target.tag_spacing)
        return fit_corners(self._image, guess, edges, free * shortest * sine, self.kind, arm=_ARM * shortest)

    def _grow(self) -> None:
        """Look for more tags next to those that were found, until there are none."""
        asked = np.zeros(self._target.tags, np.int64)  # by how many neighbours each tag was told its place already
        for _ in range(_GROWTHS):
            more = self._next_to(asked)
            if more is None:
                break
            self.seen = self.seen.with_more(more)

    def _next_to(self, asked: Integers) -> _Seen | None:
        seen = self.seen
        missing = np.flatnonzero(~_within(seen.number, self._target.tags))
        if not len(missing):
            return None
        near = (far_apart(self._target, seen.number, missing) == 1) & (seen.good.sum(axis=1) >= 3)[:, None]
        tellers = near.sum(axis=0)
        chosen = np.flatnonzero(tellers > asked[missing])
        if not len(chosen):
            return None
        asked[missing[chosen]] = tellers[chosen]
        if len(seen.number) >= _FEWEST_FOR_CHART:
            expected = self._charted(missing[chosen])
        else:
            places = predict_points(self._target, seen.number, seen.corners, missing[chosen], TAG)
            expected = np.einsum("kn,knij->nij", near[:, chosen] / tellers[chosen], places)
        visible = inside_image(self._image, expected, BORDER_PX).any(axis=1)
        if not visible.any():
            return None
        number, expected, near = missing[chosen[visible]], expected[visible], near[:, chosen[visible]]
        self._expected[number[inside_image(self._image, expected, BORDER_PX).all(axis=1)]] = True
        contrasts = (seen.fits.white - seen.fits.black).reshape(-1, 4).mean(axis=1)
        contrast = (contrasts[:, None] * near).sum(axis=0) / near.sum(axis=0)
        return self._confirmed(number, expected, contrast)

    def _confirmed(self, number: Integers, expected: Floats, contrast: Floats) -> _Seen | None:
        """Return the tags that are there: with corners where they should be, and their code, as far as it is seen."""
        fits = self._fit(expected)
        self._tried[number] = expected
        pixels = fits.pixels.reshape(-1, 4, 2)
        good = (
            fits.good.reshape(-1, 4)
            & (np.linalg.norm(pixels - expected, axis=2) < MOVED_PX + MOVED * shortest_side(expected)[:, None])
            & ((fits.white - fits.black).reshape(-1, 4) > CONTRAST * contrast[:, None])
        )
        corners = _completed(np.where(good[:, :, None], pixels, expected), expected, good)
        likeness = likeness_of(self._image, corners, number + self._target.first_tag, self._target.border_bits)
        there = (good.sum(axis=1) >= 2) & (likeness > _LEAST_LIKENESS)
        kept = replace(fits, pixels=corners.reshape(-1, 2), good=good.ravel())
        for k in np.flatnonzero(~there & good.any(axis=1)).tolist():
            self._parts[int(number[k])] = float(likeness[k]), kept.only(np.arange(4 * k, 4 * k + 4))
        if not there.any():
            return None
        return _Seen(number=number[there], fits=kept.only(np.repeat(there, 4)))

    @property
    def missing(self) -> Booleans:
        """Which tags (n,) should be inside the image as a whole and were not found."""
        missing = self._expected.copy()
        missing[self.seen.number] = False
        return missing

    def is_beside(self, tags: Tags) -> Booleans:
        """Return which of the tags that were read are not where the board has them, (k,)."""
        at = np.full((self._target.tags, 4, 2), np.inf)
        at[self.seen.number] = self.seen.corners
        away = np.linalg.norm(at[tags.number] - tags.corners, axis=2).min(axis=1)
        return away > shortest_side(tags.corners) / 2

    def is_again(self, tags: Tags) -> Booleans:
        """Return which tags are on this board, too, in another place, (k,)."""
        return self.is_beside(tags) & _within(self.seen.number, self._target.tags)[tags.number]

    def is_before(self, other: "TagGrid") -> bool:
        """Return whether of two boards alike this is the one to take."""
        sides = [middle_of(shortest_side(board.seen.corners)) for board in (self, other)]
        if max(sides) > _LARGER * min(sides):  # one is a picture of the other, on a screen
            return sides[0] > sides[1]
        own, others = self.seen.corners, other.seen.corners
        every = np.stack([own.mean(axis=0), others.mean(axis=0)])
        middle, beside = every.mean(axis=1)
        return comes_first(middle, beside, every[:, 1] - every[:, 0], every[:, 3] - every[:, 0])

    def view(self, dropped: Counter[str], lens: LensGuess | None = None) -> BoardView:
        """Return the corners, without those that are doubtful.

        Parameters
        ----------
        dropped : reason -> number of corners that were left out; what is left out here is added
        lens : from the image before
        """
        seen = self.seen
        near_border = (
            seen.fits.good
            & ~inside_image(self._image, seen.fits.pixels, BORDER_PX)
            & inside_image(self._image, seen.fits.pixels, 0)
        )
        dropped[NEAR_BORDER] += int(np.count_nonzero(near_border))
        alike = self._alike(seen.fits, seen.fits)
        dropped[COVERED] += int(np.count_nonzero(seen.fits.good & ~alike))
        kept = seen.fits.good & alike
        point, fits = self._points(seen.number)[kept], seen.fits.only(kept)
        board = self._target.points[:, :2]
        through = self._plane_map(point, fits, lens or LensGuess())
        if through is None:
            kept, most = consistent_corners(board[point], fits.pixels, fits.sigma_px)
            dropped[NOT_WITH_NEIGHBOURS] += int(np.count_nonzero(~kept))
            point, fits = point[kept], fits.only(kept)
        else:
            by_size = np.sort(np.hypot(*through.residual_px.T))
            most = float(by_size[int(_MOST * len(by_size))])
        single, found = self._single(point, fits, dropped, through)
        if len(single):
            point, fits = np.concatenate([point, single]), join_corner_fits(fits, found)
            kept = consistent_additions(board[point], fits.pixels, fits.sigma_px, len(single), most)
            dropped[NOT_WITH_NEIGHBOURS] += int(np.count_nonzero(~kept))
            point, fits = point[kept], fits.only(kept)
        kept = inside_image(self._image, fits.pixels, BORDER_PX)
        point, fits = point[kept], fits.only(kept)
        return view_of(self._image, point, board[point], fits, dropped, lens=lens, seen=through)

    def _plane_map(self, point: Integers, fits: CornerFits, lens: LensGuess) -> PlaneMap | None:
        """Return a smooth map through all corners, so near to each that none is astray; None where there is none."""
        seen = lens.plane_map(self._target.points[point, :2], fits.pixels, self._image.shape[::-1])
        return seen if seen is not None and np.square(seen.residual_px).sum(axis=1).max() < _SMOOTH_PX**2 else None

    def _alike(self, fits: CornerFits, others: CornerFits) -> Booleans:
        """Return which corners look like a corner as much as the others do, and are told as well."""
        return as_good_as(fits, middle_of(others.misfit[others.good]), middle_of(others.sigma_px[others.good]))

    def _points(self, number: Integers) -> Integers:
        return _points_of_tags(self._target)[number].ravel()

    def _single(
        self, point: Integers, fits: CornerFits, dropped: Counter[str], through: PlaneMap | None
    ) -> tuple[Integers, CornerFits]:
        """Return corners of tags of which not all, or not the code, was found, where those around say they are."""
        found, more = point[:0], fits.only(np.empty(0, np.int64))
        if len(point) < _FEWEST_CORNERS:
            return found, more
        for number, corners in self._of_parts():
            found, more = np.concatenate([found, self._points(np.array([number]))]), join_corner_fits(more, corners)
        again = self._again(point, fits, through)
        found, more = np.concatenate([found, again[0]]), join_corner_fits(more, again[1])
        good = more.good & self._alike(more, fits)
        dropped[COVERED] += int(np.count_nonzero(~good & inside_image(self._image, more.pixels, BORDER_PX)))
        return found[good], more.only(good)

    def _of_parts(self) -> list[tuple[int, CornerFits]]:
        """Return tags that can hardly be seen.

        They must not look like others, or else, where nothing of the code is seen, be beside a block of tags.
        """
        row, col = np.divmod(self.seen.number, self._target.cols)
        block = bool(np.ptp(row) > 0 and np.ptp(col) > 0)
        return [
            (number, corners)
            for number, (likeness, corners) in self._parts.items()
            if number not in self.seen.number and (block if np.isnan(likeness) else likeness > _NOT_ANOTHER)
        ]

    def _again(self, point: Integers, fits: CornerFits, through: PlaneMap | None) -> tuple[Integers, CornerFits]:
        """Return the corners of tags that were read which could not be fitted, from where those around them say."""
        seen, board = self.seen, self._target.points[:, :2]
        left_out = ~_within(point, len(self._target))[self._points(seen.number)].reshape(-1, 4)
        tag = np.flatnonzero(left_out.any(axis=1))
        if not len(tag):
            return point[:0], fits.only(np.empty(0, np.int64))
        corners = self._points(seen.number[tag])
        if through is None:
            expected = locate_points(board[point], fits.pixels, board[corners])
        else:
            expected = through.seen(board[corners], seen.corners[tag].reshape(-1, 2))
        expected = expected.reshape(-1, 4, 2)
        tried = np.square(expected - self._tried[seen.number[tag]]).sum(axis=2) < _SAME_PX**2
        missing = left_out[tag] & ~tried & inside_image(self._image, expected, BORDER_PX)
        if not missing.any():
            return point[:0], fits.only(np.empty(0, np.int64))
        found = self._fit(expected, missing)
        limit = MOVED_PX + MOVED * np.repeat(shortest_side(expected), 4)[missing.ravel()]
        near = np.linalg.norm(found.pixels - expected[missing], axis=1) < limit
        bright = found.white - found.black > CONTRAST * middle_of(fits.white - fits.black)
        return corners[missing.ravel()], replace(found, good=found.good & near & bright)


@lru_cache(maxsize=8)
def _points_of_tags(target: Target) -> Integers:
    """Return the numbers of the corners of all tags, (n, 4)."""
    return target.point_of_tag_corner(np.arange(target.tags)[:, None], np.arange(4))


def _within(numbers: Integers, count: int) -> Booleans:
    """Return which of the numbers 0 ... count - 1 are there."""
    there = np.zeros(count, dtype=bool)
    there[numbers] = True
    return there


def _completed(corners: Floats, expected: Floats, good: Booleans) -> Floats:
    """Return corners (k, 4, 2), those that are not good moved as the good ones of their tag were."""
    count = np.maximum(good.sum(axis=1), 1)[:, None]
    moved = np.where(good[:, :, None], corners - expected, 0).sum(axis=1) / count
    return np.where(good[:, :, None], corners, expected + moved[:, None])
