"""A grid of AprilTags in the images of one camera, one after the other.

optical flow carries some corners of the image before -> through the lens, these tell where all tags are -> fit their
corners -> keep those with their code

Where that finds less than a search of the image might, the image is searched. Corners are measured afresh in every
image, by the same fit as after a search.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats
from ...recording.recording import Grey
from .aprilgrid import TagGrid, TagSearch, search_tags
from .board import BoardView, middle_of
from .checkerboard import checkerboard_search_scale, reduce_image
from .corner_fit import CornerKind
from .lattice import carry_corners
from .plane_map import LensGuess
from .tag_places import locate_points

_SHIFT_SCALE = 4  # of the reduced image
_FEWEST_TAGS = 6  # that are followed; fewer tell little of where the others are
_FLOW_CORNERS = 48  # about so many tell where all of them are
_CARRIED = 0.7  # share of the corners that the flow must carry
_ASTRAY_PX, _ASTRAY = 1.0, 4.0  # from where the others say: px, typical distances
_AS_MANY = 0.95  # of the share of corners that could be fitted in the image before


@value_class
class _Before:
    """What is known from the image before.

    Attributes
    ----------
    small : the image, reduced
    places : (n, 4, 2) of all tags of the board [px]
    seen : (n,) which of them were found
    missing : (n,) which of them even a search does not find though they should be inside the image
    good : share of the corners that could be fitted
    kind, contrast : of the corners
    """

    small: Grey
    places: Floats
    seen: Booleans
    missing: Booleans
    good: float
    kind: CornerKind
    contrast: float


class AprilGridTracker:
    """Finds a grid of AprilTags in the images of one camera, in the order in which they were taken.

    Parameters
    ----------
    target : the board, an aprilgrid
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        corners = target.point_of_tag_corner(np.arange(target.tags)[:, None], np.arange(4))
        self._points = target.points[corners.ravel(), :2]  # corner by corner, tag by tag
        self._lens = LensGuess()
        self._before: _Before | None = None

    def detect(self, image: Grey) -> BoardView:
        """Return the corners in the next image, (h, w) grey levels."""
        image = np.ascontiguousarray(image)
        small = reduce_image(image, checkerboard_search_scale(image))
        followed = self._followed(image, small)
        if followed is not None and self._before is not None:
            grid, places = followed
            places[grid.seen.number] = grid.seen.corners
            self._before = self._known(grid, small, places, self._before.missing)
            return TagSearch(grid=grid, tags=None).view(self._lens)
        found = search_tags(image, self._target)
        grid = found.grid
        doubtful = grid is None or found.strangers or len(grid.seen.number) < _FEWEST_TAGS
        self._before = None if doubtful or grid is None else self._known(grid, small, grid.places(), grid.missing)
        return found.view(self._lens)

    def _known(self, grid: TagGrid, small: Grey, places: Floats, missing: Booleans) -> _Before:
        fits = grid.seen.fits
        seen = np.zeros(self._target.tags, dtype=bool)
        seen[grid.seen.number] = True
        return _Before(
            small=small,
            places=places,
            seen=seen,
            missing=missing,
            good=float(fits.good.mean()),
            kind=grid.kind,
            contrast=middle_of(fits.white - fits.black),
        )

    def _followed(self, image: Grey, small: Grey) -> tuple[TagGrid, Floats] | None:
        """Return the board of the image before where it is now, and where all its tags should be, (n, 4, 2) [px].

        None where a search might find more.
        """
        before = self._before
        if before is None or before.small.shape != small.shape:
            return None
        places = self._carried(before, image, small)
        if places is None:
            return None
        grid = TagGrid.at(image, self._target, before.kind, places, before.contrast)
        lost = (grid.missing & ~before.missing).any()
        if lost or len(grid.seen.number) < _FEWEST_TAGS or grid.seen.fits.good.mean() < _AS_MANY * before.good:
            return None
        return grid, places

    def _carried(self, before: _Before, image: Grey, small: Grey) -> Floats | None:
        """Return where the tags are by the optical flow of some corners, (n, 4, 2) [px]; None where it is lost."""
        scale, size = checkerboard_search_scale(image), (image.shape[1], image.shape[0])
        points, corners = self._points, before.places.reshape(-1, 2)
        seen = np.flatnonzero(np.repeat(before.seen, 4))
        few = seen[:: max(len(seen) // _FLOW_CORNERS, 1) | 1]
        guess = corners + scale * _shift(before.small, small)
        now, known = carry_corners(before.small, small, corners[few], guess[few], scale)
        while True:
            if known.sum() < _CARRIED * len(known):
                return None
            through = self._lens.through_lens(points[few[known]], now[known], size)
            if through is None:
                return None
            away = np.linalg.norm(through.residual_px, axis=1)
            astray = away > _ASTRAY_PX + _ASTRAY * middle_of(away)
            if not astray.any():
                break
            known[np.flatnonzero(known)[astray]] = False
        places = through.seen(points, guess)
        unknown = np.flatnonzero(~self._lens.knows(through, places))
        if len(unknown):
            places[unknown] = locate_points(points[few[known]], now[known], points[unknown])
        return places.reshape(before.places.shape)


def _shift(before: Grey, now: Grey) -> Floats:
    """Return how far most of the picture moved, (2,) [px of these images]; neighbouring tags look alike to the flow."""
    first, second = (reduce_image(image, _SHIFT_SCALE).astype(np.float32) for image in (before, now))
    shift, _ = cv2.phaseCorrelate(first, second, _hanning(*first.shape))
    return _SHIFT_SCALE * np.array(shift, dtype=np.float64)


@lru_cache(maxsize=4)
def _hanning(height: int, width: int) -> NDArray[np.float32]:
    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), dtype=np.float32)
