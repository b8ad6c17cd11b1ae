"""Grids of AprilTags: which corners of the board are where in an image.

find black quadrilaterals -> read their codes -> fit their corners -> keep the tags that are where their neighbours
say -> look for the missing ones where their neighbours say

Kalibr's boards have a black square at every corner of a tag, so that each corner is a crossing of two edges; on plain
grids it is the tip of a black wedge.
"""

from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images import Grey
from ..models.target import Target
from ..recording import Floats, Integers
from .board import BoardView, nothing_seen
from .corner_fit import CornerFits, CornerKind, fit_corners, joined
from .quads import black_quads
from .tags import BITS, Tags, likeness_of, read_tags, square_to_quads

Booleans = NDArray[np.bool_]

BORDER_PX = 5.0
"""Corners nearer to the image's border are left out."""

_ENOUGH = 0.5  # of the tags; below, the image is looked through for faint ones, too
_FAINT = 0.4
_APART_PX, _APART = 1.5, 0.25  # how far, in px and in tags, a tag may be from where another one says
_REACH = 2  # tags; farther neighbours do not judge each other
_GROWTHS = 3
_MOVED_PX, _MOVED = 1.5, 0.12  # how far the corners of a tag may be from where its neighbours say
_LEAST_LIKENESS = 0.55  # of a tag that is where it should be
_CONTRAST = 0.4  # of a corner over that of the board
_WINDOW = 0.85  # radius of the window over the distance to what else is printed there
_OUTLINE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def detect_aprilgrid(image: Grey, target: Target) -> BoardView:
    """Find the corners of a grid of AprilTags; parts of the board are enough.

    Parameters
    ----------
    image : (h, w)
    target : the board, an aprilgrid
    """
    tags = _tags(image, target)
    if not len(tags):
        return nothing_seen()
    board = _Board(image, target, "crossing" if _has_squares(image, tags, target) else "tip")
    fits = board.fit(tags.corners)
    together = _together(target, tags.number, fits.pixels)
    dropped = Counter({"not where its neighbours say": 4 * int(np.count_nonzero(~together))})
    if not together.any():
        return nothing_seen(+dropped)
    seen = _Seen(number=tags.number[together], fits=_of_tags(fits, np.flatnonzero(together)))
    return board.view(board.grown(seen), dropped)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Tags, (k,), and the fits of their corners, (4 k,)."""

    number: Integers
    fits: CornerFits

    def with_more(self, more: "_Seen") -> "_Seen":
        return _Seen(number=np.concatenate([self.number, more.number]), fits=joined(self.fits, more.fits))


def _tags(image: Grey, target: Target) -> Tags:
    quads = black_quads(image)
    tags = _read(image, quads, target)
    if len(tags) >= _ENOUGH * target.tags:
        return tags
    return _read(image, np.concatenate([quads, black_quads(image, _FAINT)]), target)


def _read(image: Grey, quads: Floats, target: Target) -> Tags:
    """Return the tags of the target in some quadrilaterals; a tag that was found twice once."""
    tags = read_tags(
        image,
        quads,
        border_bits=target.border_bits,
        first=target.first_tag,
        count=target.tags,
    )
    middle = tags.corners.mean(axis=1)
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    same = (tags.number[:, None] == tags.number) & (apart < 3) & np.tri(len(tags), k=-1, dtype=bool)
    once = ~same.any(axis=1)
    return Tags(
        number=tags.number[once] - target.first_tag,
        corners=tags.corners[once],
        likeness=tags.likeness[once],
    )


def _has_squares(image: Grey, tags: Tags, target: Target) -> bool:
    """Return whether there are black squares at the corners of the tags, as on Kalibr's boards."""
    gap = target.tag_spacing
    border = 0.5 * _border(target)
    squares = _OUTLINE + np.sign(_OUTLINE - 0.5) * gap / 2
    white = 0.5 + (np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])) * (0.5 + gap / 2)
    black = 0.5 + (np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])) * (0.5 - border)
    places = _through(square_to_quads(tags.corners), np.concatenate([squares, white, black])).astype(np.float32)
    grey = cv2.remap(image, places[:, :, 0], places[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    square, light, dark = (np.median(part) for part in np.split(np.asarray(grey, np.float64), 3, axis=1))
    return bool(square < (light + dark) / 2)


def _border(target: Target) -> float:
    """Return the width of the tags' black border in tags."""
    return target.border_bits / (BITS + 2 * target.border_bits)


def _through(H: Floats, points: Floats) -> Floats:
    """Return points (n, 2), or (k, n, 2), mapped by homographies, (k, n, 2)."""
    x, y = points[..., 0], points[..., 1]
    H = H[:, None]
    w = H[..., 2, 0] * x + H[..., 2, 1] * y + H[..., 2, 2]
    w = np.where(np.abs(w) < 1e-9, 1e-9, w)
    u = (H[..., 0, 0] * x + H[..., 0, 1] * y + H[..., 0, 2]) / w
    v = (H[..., 1, 0] * x + H[..., 1, 1] * y + H[..., 1, 2]) / w
    return np.stack([u, v], axis=-1)


def _predictions(target: Target, by: Integers, pixels: Floats, of: Integers) -> tuple[Floats, Integers]:
    """Return where tags should be by what each of some others says, (k, n, 4, 2), and how far apart these are in tags.

    Parameters
    ----------
    by : (k,) tags that were found, with their corners' `pixels` (4 k, 2)
    of : (n,) tags that are asked for
    """
    row, col = np.divmod(by, target.cols)
    other_row, other_col = np.divmod(of, target.cols)
    right, up = other_col - col[:, None], other_row - row[:, None]
    pitch = 1 + target.tag_spacing
    local = pitch * np.stack([right, up], axis=-1)[:, :, None, :] + _OUTLINE
    H = square_to_quads(pixels.reshape(-1, 4, 2))
    places = _through(H, local.reshape(len(by), -1, 2)).reshape(len(by), len(of), 4, 2)
    return places, np.maximum(np.abs(right), np.abs(up))


def _together(target: Target, number: Integers, pixels: Floats) -> Booleans:
    """Return which tags agree with each other on where they are: the largest group of neighbours, of two at least."""
    places, distance = _predictions(target, number, pixels, number)
    corners = pixels.reshape(-1, 4, 2)
    size = _size(corners)
    apart = np.linalg.norm(places - corners, axis=3).max(axis=2)
    agrees = (apart < _APART_PX + _APART * size * distance) & (distance > 0) & (distance <= _REACH)
    agrees &= agrees.T
    group = np.arange(len(number))
    while True:
        joined_group = np.where(agrees, group, len(number)).min(axis=1, initial=len(number))
        smaller = np.minimum(group, joined_group)
        if (smaller == group).all():
            break
        group = smaller
    sizes = np.bincount(group)
    chosen = group == sizes.argmax()
    if sizes.max() < 2:
        return np.zeros(len(number), dtype=bool)
    return chosen & ~_weaker_twin(number, agrees.sum(axis=1), chosen)


def _weaker_twin(number: Integers, votes: Integers, chosen: Booleans) -> Booleans:
    """Return which of the chosen tags are there another time, with more votes."""
    same = (number[:, None] == number) & chosen & ~np.eye(len(number), dtype=bool)
    later = np.tri(len(number), k=-1, dtype=bool)
    better = (votes > votes[:, None]) | ((votes == votes[:, None]) & later)
    return (same & better).any(axis=1)


def _size(corners: Floats) -> Floats:
    """Return the shortest side of tags, (k,) [px]."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)


def _of_tags(fits: CornerFits, tags: Integers) -> CornerFits:
    return fits.only((4 * tags[:, None] + np.arange(4)).ravel())


class _Board:
    """One image of one board."""

    def __init__(self, image: Grey, target: Target, kind: CornerKind) -> None:
        self._image, self._target, self._kind = image, target, kind

    def fit(self, corners: Floats) -> CornerFits:
        """Return the fits (4 k,) of the corners of tags (k, 4, 2)."""
        before, after = np.roll(corners, 1, axis=1) - corners, np.roll(corners, -1, axis=1) - corners
        edges = np.stack([before, after], axis=2)
        length = np.linalg.norm(edges, axis=3)
        free = _WINDOW * min(_border(self._target), self._target.tag_spacing)
        return fit_corners(
            self._image,
            corners.reshape(-1, 2),
            (edges / np.maximum(length, 1e-9)[..., None]).reshape(-1, 2, 2),
            free * length.min(axis=2).ravel(),
            self._kind,
        )

    def grown(self, seen: _Seen) -> _Seen:
        """Return the tags with those that are found where their neighbours say."""
        tried = np.zeros(self._target.tags, dtype=bool)
        for _ in range(_GROWTHS):
            more = self._next_to(seen, tried)
            if not len(more.number):
                break
            seen = seen.with_more(more)
        return seen

    def _next_to(self, seen: _Seen, tried: Booleans) -> _Seen:
        missing = np.setdiff1d(np.flatnonzero(~tried), seen.number)
        places, distance = _predictions(self._target, seen.number, seen.fits.pixels, missing)
        near = distance == 1
        asked = np.flatnonzero(near.any(axis=0))
        if not len(asked):
            return _Seen(number=missing[:0], fits=seen.fits.only(np.empty(0, np.int64)))
        told = np.where(near[:, asked, None, None], places[:, asked], np.nan)
        expected = np.nanmedian(told, axis=0)
        visible = self._inside(expected.reshape(-1, 2), 0).reshape(-1, 4).any(axis=1)
        asked, expected = asked[visible], expected[visible]
        number = missing[asked]
        tried[number] = True
        fits = self.fit(expected)
        return self._confirmed(number, expected, fits, seen)

    def _confirmed(self, number: Integers, expected: Floats, fits: CornerFits, seen: _Seen) -> _Seen:
        """Return the tags that are there: by their code where all of it is in the image, else by their corners."""
        size = _size(expected)
        moved = np.linalg.norm(fits.pixels.reshape(-1, 4, 2) - expected, axis=2)
        contrast = np.median((seen.fits.white - seen.fits.black)[seen.fits.good]) if seen.fits.good.any() else 255.0
        good = (
            fits.good.reshape(-1, 4)
            & (moved < _MOVED_PX + _MOVED * size[:, None])
            & ((fits.white - fits.black).reshape(-1, 4) > _CONTRAST * contrast)
        )
        corners = np.where(good[:, :, None], fits.pixels.reshape(-1, 4, 2), expected)
        whole = self._inside(expected.reshape(-1, 2), 0).reshape(-1, 4).all(axis=1)
        likeness = likeness_of(
            self._image,
            corners,
            number + self._target.first_tag,
            self._target.border_bits,
        )
        there = np.where(whole, (good.sum(axis=1) >= 2) & (likeness > _LEAST_LIKENESS), good.any(axis=1))
        kept = replace(fits, pixels=corners.reshape(-1, 2), good=good.ravel())
        return _Seen(number=number[there], fits=_of_tags(kept, np.flatnonzero(there)))

    def _inside(self, pixels: Floats, margin_px: float) -> Booleans:
        height, width = self._image.shape
        low, high = margin_px - 0.5, np.array([width, height]) - 0.5 - margin_px
        return ((pixels >= low) & (pixels <= high)).all(axis=1)

    def view(self, seen: _Seen, dropped: Counter[str]) -> BoardView:
        """Return the corners, without those that are doubtful."""
        fits = seen.fits
        point = self._target.point_of_tag_corner(np.repeat(seen.number, 4), np.tile(np.arange(4), len(seen.number)))
        within, in_image = self._inside(fits.pixels, BORDER_PX), self._inside(fits.pixels, 0)
        dropped["near the border"] += int(np.count_nonzero(in_image & ~within))
        dropped["blurred or covered"] += int(np.count_nonzero(within & ~fits.good))
        kept = np.flatnonzero(within & fits.good)
        kept = kept[np.argsort(point[kept])]
        if not len(kept):
            return nothing_seen(+dropped)
        return BoardView(
            point=point[kept],
            pixels=fits.pixels[kept],
            sigma_px=fits.sigma_px[kept],
            blur_px=float(np.median(fits.blur_px[kept])),
            black=float(np.median(fits.black[kept])),
            white=float(np.median(fits.white[kept])),
            dropped=+dropped,
        )
