"""A grid of AprilTags in the images of one camera, one after the other.

optical flow carries the tags of the image before -> fit their corners -> keep those with their code

Where that finds less than a search of the image might, the image is searched. Corners are measured afresh in every
image, by the same fit as after a search.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats
from ...recording.images import Grey
from ..corners.corner_fit import CornerKind
from .aprilgrid import TagGrid, TagSearch, search_tags
from .board import BoardView, middle_of
from .checkerboard import reduced, search_scale
from .optical_flow import carry_corners
from .plane_map import LensGuess
from .tag_places import homography, through

_SHIFT_SCALE = 2  # of the reduced image
_FEWEST_TAGS = 6  # that are followed; fewer tell little of where the others are
_CARRIED = 0.7  # share of the corners that the flow must carry
_ASTRAY_PX, _ASTRAY = 1.0, 4.0  # from where the others say: px, typical distances
_AS_MANY = 0.95  # of the share of corners that could be fitted in the image before


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        self._lens = LensGuess()
        self._before: _Before | None = None

    def detect(self, image: Grey) -> BoardView:
        """Return the corners in the next image, (h, w) grey levels."""
        image = np.ascontiguousarray(image)
        small = reduced(image, search_scale(image))
        grid = self._followed(image, small)
        if grid is not None and self._before is not None:
            self._before = self._known(grid, small, self._before.missing)
            return TagSearch(grid=grid, tags=None).view(self._lens)
        found = search_tags(image, self._target)
        doubtful = found.grid is None or found.strangers or len(found.grid.seen.number) < _FEWEST_TAGS
        self._before = None if doubtful or found.grid is None else self._known(found.grid, small, found.grid.missing)
        return found.view(self._lens)

    def _known(self, grid: TagGrid, small: Grey, missing: Booleans) -> _Before:
        fits, places = grid.seen.fits, grid.places()
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

    def _followed(self, image: Grey, small: Grey) -> TagGrid | None:
        """Return the board of the image before where it is now; None where a search might find more."""
        before = self._before
        if before is None or before.small.shape != small.shape:
            return None
        places = _carried(before, small, search_scale(image))
        if places is None:
            return None
        grid = TagGrid.at(image, self._target, before.kind, places, before.contrast)
        lost = (grid.missing & ~before.missing).any()
        if lost or len(grid.seen.number) < _FEWEST_TAGS or grid.seen.fits.good.mean() < _AS_MANY * before.good:
            return None
        return grid


def _shift(before: Grey, now: Grey) -> Floats:
    """Return how far most of the picture moved, (2,) [px of these images]; neighbouring tags look alike to the flow."""
    first, second = (reduced(image, _SHIFT_SCALE).astype(np.float32) for image in (before, now))
    height, width = first.shape
    shift, _ = cv2.phaseCorrelate(first, second, cv2.createHanningWindow((width, height), cv2.CV_32F))
    return _SHIFT_SCALE * np.array(shift, dtype=np.float64)


def _carried(before: _Before, small: Grey, scale: int) -> Floats | None:
    """Return where the tags are by the optical flow, (n, 4, 2) [px]; None where it is lost."""
    corners = before.places[before.seen].reshape(-1, 2)
    guess = corners + scale * _shift(before.small, small)
    now, known = carry_corners(before.small, small, corners, guess, scale)
    if known.sum() < _CARRIED * len(known):
        return None
    away = np.linalg.norm(through(homography(corners[known], now[known])[None], corners)[0] - now, axis=1)
    known &= away < _ASTRAY_PX + _ASTRAY * middle_of(away[known])
    if known.sum() < _CARRIED * len(known):
        return None
    H = homography(corners[known], now[known])  # without what went astray
    places = through(H[None], before.places.reshape(-1, 2))[0].reshape(before.places.shape)
    places[before.seen] = np.where(known[:, None], now, places[before.seen].reshape(-1, 2)).reshape(-1, 4, 2)
    return places
