"""Points of a scene, followed from image to image by optical flow (Lucas and Kanade), there and back again."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.images import Grey

_WINDOW, _LEVELS = (21, 21), 4
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.02)
_BACK_PX = 0.5  # from where a point was, when it is followed back
_POINTS, _APART_PX, _QUALITY = 220, 18, 0.005
_LEAST_CORNER = 2.5e-4  # smaller eigenvalue of the gradients that a noisy plain image does not reach
_BORDER_PX = 12
_REFILL = 0.8  # of the points, below which new ones are sought


@value_class
class PointTracks:
    """Where points were seen.

    Attributes
    ----------
    frame : (m,) image of each sighting, ascending
    track : (m,) point that was seen, by a number of its own
    pixels : (m, 2) where [px]
    """

    frame: Integers
    track: Integers
    pixels: Floats

    def where(self, kept: np.ndarray) -> "PointTracks":
        """Return some of the sightings, (m,) bool."""
        return replace(self, frame=self.frame[kept], track=self.track[kept], pixels=self.pixels[kept])

    def shared(self, first: int, second: int) -> tuple[Integers, Integers]:
        """Return where the sightings of the points that are in both of two images stand, (k,) each."""
        rows = [np.arange(*np.searchsorted(self.frame, [frame, frame + 1])) for frame in (first, second)]
        _, a, b = np.intersect1d(self.track[rows[0]], self.track[rows[1]], return_indices=True)
        return rows[0][a], rows[1][b]


def follow_points(images: Iterable[Grey]) -> PointTracks:
    """Return the points that can be followed through images, in their order; new ones come where old ones are lost."""
    before: Grey | None = None
    places, names, new = np.empty((0, 2), np.float32), np.empty(0, np.int64), 0
    found: list[tuple[Integers, Integers, Floats]] = []
    for number, now in enumerate(images):
        if before is not None and len(places):
            places, kept = _followed(before, now, places)
            names = names[kept]
        if len(places) < _REFILL * _POINTS:
            fresh = _fresh_points(now, places)
            places = np.concatenate([places, fresh])
            names = np.concatenate([names, new + np.arange(len(fresh))])
            new += len(fresh)
        found.append((np.full(len(names), number), names, places.astype(np.float64)))
        before = now
    if not found:
        found = [(np.empty(0, np.int64), names, places.astype(np.float64))]
    frame, track, pixels = (np.concatenate(part) for part in zip(*found, strict=True))
    return PointTracks(frame=frame, track=track, pixels=pixels)


def _followed(before: Grey, now: Grey, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where points (k, 2) went, of those that come back to where they were, and which these are (k,)."""
    ahead, seen, _ = cv2.calcOpticalFlowPyrLK(
        before, now, places, np.empty_like(places), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_CRITERIA
    )
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        now, before, ahead, np.empty_like(places), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_CRITERIA
    )
    limit = np.array(now.shape[::-1]) - 1 - _BORDER_PX
    kept = (seen.ravel() == 1) & (returned.ravel() == 1) & (np.linalg.norm(back - places, axis=1) < _BACK_PX)
    kept &= ((ahead >= _BORDER_PX) & (ahead <= limit)).all(axis=1)
    return ahead[kept], kept


def _fresh_points(image: Grey, taken: np.ndarray) -> np.ndarray:
    """Return corners (k, 2) away from points that are followed already."""
    mask = np.zeros(image.shape, np.uint8)
    mask[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = 255
    for x, y in taken.tolist():
        cv2.circle(mask, (round(x), round(y)), _APART_PX, 0, -1)
    strength = cv2.cornerMinEigenVal(image, 5)
    strength[mask == 0] = 0.0
    if not (strength > _LEAST_CORNER).any():
        return np.empty((0, 2), np.float32)
    mask[strength < _LEAST_CORNER] = 0
    found: Any = cv2.goodFeaturesToTrack(image, _POINTS - len(taken), _QUALITY, _APART_PX, mask=mask, blockSize=5)
    if found is None:  # which its stubs do not know
        return np.empty((0, 2), np.float32)
    return cv2.cornerSubPix(
        image, found, (3, 3), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 10, 0.05)
    ).reshape(-1, 2)
