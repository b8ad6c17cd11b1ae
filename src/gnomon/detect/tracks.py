"""Landmarks found again: the piece of an image around each is warped to how it should look, and aligned with the image.

Each landmark is what one piece of one image shows, so that errors do not add up as they do from image to image. The
piece is warped as a plane that faces the camera which took it; in brightness and contrast both may differ.

Points of a scene, followed from image to image by optical flow (Lucas and Kanade), there and back again.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..models.camera import Camera
from ..recording import Floats, Integers
from ..recording.recording import Grey

_SIDE = 95
"""Side of a piece [px]; OpenCV looks up at most 32767 rows, those of 344 pieces."""

_LIKE = 16  # px about the middle of a piece by which landmarks are compared with each other
_PATCH_BORDER_PX = 14.0
_SIZES = 0.45, 2.2  # of the area of what is seen, over that in the piece
_MOST_TURNED = 0.6  # cosine of the angle between both lines of sight
_STEP_PX = 4.0  # longest
_NODE_PX, _NODES = 10.0, 9  # between the places at which a warp is known; how many there are


@value_class(eq=True)
class _Level:
    """Window of (2 half + 1)^2 samples, `stride` px apart, in blurred images; `rounds` it is moved at most.

    It is kept where both correlate by `alike` at least, and its last move is shorter than `rest_px`.
    """

    half: int
    stride: float
    blur_px: float
    rounds: int
    alike: float
    rest_px: float


_COARSE = _Level(half=6, stride=4.0, blur_px=2.5, rounds=8, alike=0.5, rest_px=1.5)
_FINE = _Level(half=8, stride=1.0, blur_px=0.0, rounds=5, alike=0.8, rest_px=0.15)


@value_class
class Landmarks:
    """Landmarks of a scene.

    Attributes
    ----------
    camera : the lens that took the pieces
    points : (n, 3) [m]
    R_anchor, p_anchor : (n, 3, 3), (n, 3) pose of the scene in the camera that took each one's piece
    pieces : (n side, side) these, one above the other
    blurred : the same, as they are looked for from afar
    """

    camera: Camera
    points: Floats
    R_anchor: Floats
    p_anchor: Floats
    pieces: NDArray[np.float32]
    blurred: NDArray[np.float32]

    def moved(self, kept: Integers, points: Floats, R_anchor: Floats, p_anchor: Floats) -> "Landmarks":
        """Return some of the landmarks, with other places and poses."""
        rows = (kept[:, None] * _SIDE + np.arange(_SIDE)).ravel()
        pieces, blurred = self.pieces[rows], self.blurred[rows]
        return replace(self, points=points, R_anchor=R_anchor, p_anchor=p_anchor, pieces=pieces, blurred=blurred)

    def likeness(self) -> float:
        """Return how much the usual landmark looks like the one that is most like it, as a correlation."""
        inner = slice(_SIDE // 2 - _LIKE, _SIDE // 2 + _LIKE + 1, 2)
        pieces = self.pieces.reshape(-1, _SIDE, _SIDE)[:, inner, inner].reshape(len(self.points), -1)
        pieces = pieces - pieces.mean(axis=1, keepdims=True)
        pieces /= np.maximum(np.linalg.norm(pieces, axis=1, keepdims=True), 1e-6)
        alike = pieces @ pieces.T
        np.fill_diagonal(alike, -1.0)
        return float(np.median(alike.max(axis=1)))

    def find(
        self, image: Grey, camera: Camera, R: Floats, p: Floats, *, reach_px: float, near: bool
    ) -> tuple[Integers, Floats]:
        """Return which landmarks are in an image, and where they are.

        Parameters
        ----------
        image, camera : to be looked at, and its lens
        R, p : (3, 3) and (3,) pose of the scene in the camera's frame, roughly
        reach_px : how far from where that puts them they may be
        near : whether that is a few px

        Returns
        -------
        landmark : (k,) which
        pixels : (k, 2) where [px]
        """
        which, expected, warps = self._expected(camera, R, p)
        places = expected.copy()
        limit = np.array(image.shape[::-1]) - 1 - _PATCH_BORDER_PX
        for level in (_FINE,) if near else (_COARSE, _FINE):
            places, alike, rest = self._aligned(level, blur_image(image, level.blur_px), which, places, warps)
            kept = (alike > level.alike) & (rest < level.rest_px)
            kept &= np.linalg.norm(places - expected, axis=1) < reach_px
            kept &= ((places >= _PATCH_BORDER_PX) & (places <= limit)).all(axis=1)
            which, expected, places, warps = which[kept], expected[kept], places[kept], warps[kept]
        return which, places

    def _expected(self, camera: Camera, R: Floats, p: Floats) -> tuple[Integers, Floats, Floats]:
        """Return which landmarks should be in an image, where (k, 2), and what of pieces is about them (k, 9, 2).

        That is where in the piece, from its middle, the nodes of `_nodes` show the plane that faces its camera [px].
        """
        sight = self.points + np.einsum("nji,nj->ni", self.R_anchor, self.p_anchor)
        placed = self.points @ R.T + p
        pixels = camera.project(placed, point_jacobian=False).pixels
        limit = np.array(camera.resolution) - 1 - _PATCH_BORDER_PX
        with np.errstate(all="ignore"):
            cosine = np.einsum("ni,ni->n", sight @ R.T, placed)
            cosine /= np.linalg.norm(sight, axis=1) * np.linalg.norm(placed, axis=1)
            inside = ((pixels >= _PATCH_BORDER_PX) & (pixels <= limit)).all(axis=1)
        which = np.flatnonzero(inside & (cosine > _MOST_TURNED))
        rays, known = camera.unproject((pixels[which, None] + _nodes()).reshape(-1, 2))
        rays = np.where(known[:, None], rays, np.nan).reshape(len(which), _NODES, 3) @ R
        away = np.einsum("ni,ni->n", sight[which], placed[which] @ R)[:, None]
        with np.errstate(all="ignore"):
            met = rays * (away / np.einsum("nsi,ni->ns", rays, sight[which]))[:, :, None] - p @ R  # in the scene
        anchored = met @ np.swapaxes(self.R_anchor[which], 1, 2) + self.p_anchor[which, None]
        there = self.camera.project(anchored.reshape(-1, 3), point_jacobian=False).pixels.reshape(len(which), _NODES, 2)
        about = there - there[:, 4:5]
        along, across = about[:, 5] - about[:, 3], about[:, 7] - about[:, 1]
        with np.errstate(all="ignore"):
            size = (2 * _NODE_PX) ** 2 / (along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
        kept = np.isfinite(about).all(axis=(1, 2)) & (size > _SIZES[0]) & (size < _SIZES[1])
        return which[kept], pixels[which[kept]], about[kept]

    def _aligned(
        self, level: _Level, image: NDArray[np.float32], which: Integers, places: Floats, warps: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return where pieces fit, how well (correlation), and the last step [px]."""
        if not len(which):
            return places, np.zeros(0), np.zeros(0)
        template, slope = self._templates(level, which, warps)
        square = slope @ np.swapaxes(slope, 1, 2) + np.float32(1e-9) * np.eye(2, dtype=np.float32)
        step_by = np.linalg.inv(square) @ slope
        length, alike = np.zeros(len(which)), np.zeros(len(which))
        for _ in range(level.rounds):
            seen = _normalised(_looked_up(image, places.T[:, :, None] + _grid(level)[:, None]))[0]
            alike = np.einsum("ns,ns->n", seen, template).astype(np.float64)
            step = (step_by @ (template - seen)[:, :, None])[:, :, 0].astype(np.float64)
            length = np.linalg.norm(step, axis=1)
            step *= np.minimum(1.0, _STEP_PX / np.maximum(length, 1e-9))[:, None]
            places = places + step
        return places, alike, length

    def _templates(
        self, level: _Level, which: Integers, warps: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return how pieces should look (k, s), of unit length about their mean, and their slopes (k, 2, s) per px."""
        wider = np.moveaxis(warps, 2, 0) @ _node_weights(level)
        centre = np.stack([np.full(len(which), _SIDE // 2), which * _SIDE + _SIDE // 2])
        side = 2 * level.half + 3
        values = _looked_up(self.blurred if level.blur_px else self.pieces, centre[:, :, None] + wider)
        values = values.reshape(-1, side, side)
        inner, scale = _normalised(values[:, 1:-1, 1:-1].reshape(len(which), -1))
        slopes = values[:, 1:-1, 2:] - values[:, 1:-1, :-2], values[:, 2:, 1:-1] - values[:, :-2, 1:-1]
        slope = np.stack([slope.reshape(inner.shape) for slope in slopes], axis=1)
        return inner, slope / np.float32(2 * level.stride) / scale[:, :, None]


def cut_pieces(
    images: Iterable[tuple[int, Grey]], taken: Integers, pixels: Floats
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the pieces of landmarks, and the same blurred, as `Landmarks` has them.

    Parameters
    ----------
    images : number and image, of those that are asked for
    taken, pixels : for each landmark, the number of the image that its piece is from (n,), and where it is there (n, 2)
    """
    pieces = np.zeros((len(taken), _SIDE, _SIDE), np.float32)
    for number, image in images:
        for k in np.flatnonzero(taken == number).tolist():
            u, v = pixels[k].tolist()
            pieces[k] = cv2.getRectSubPix(image, (_SIDE, _SIDE), (u, v), patchType=cv2.CV_32F)
    blurred = np.stack([blur_image(piece, _COARSE.blur_px) for piece in pieces])
    return pieces.reshape(-1, _SIDE), blurred.reshape(-1, _SIDE)


def blur_image(image: NDArray[Any], sigma_px: float) -> NDArray[np.float32]:
    """Return an image in float32, blurred."""
    light = image.astype(np.float32, copy=False)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), sigma_px), np.float32) if sigma_px else light


@cache
def _grid(level: _Level, border: int = 0) -> Floats:
    """Return the places of samples (2, s), from the middle of a window [px]."""
    reach = np.arange(-level.half - border, level.half + border + 1, dtype=np.float64) * level.stride
    v, u = np.meshgrid(reach, reach, indexing="ij")
    return np.asarray(np.stack([u.ravel(), v.ravel()]), np.float64)


def _nodes() -> Floats:
    """Return nine places about a pixel (9, 2), row by row [px]."""
    v, u = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij")
    return _NODE_PX * np.stack([u.ravel(), v.ravel()], axis=1)


@cache
def _node_weights(level: _Level) -> Floats:
    """Return the weights (9, s) by which values of the nodes are interpolated, as quadratics."""
    t = _grid(level, 1) / _NODE_PX
    u, v = np.moveaxis(np.stack([t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2]), 1, 0)
    return np.asarray((v[:, None] * u).reshape(_NODES, -1), np.float64)


def _looked_up(image: NDArray[np.float32], at: Floats) -> NDArray[np.float32]:
    u, v = at.astype(np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _normalised(values: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return values (k, s) about their mean, of unit length, and the lengths (k, 1) that they had."""
    values = values - values.mean(axis=1, keepdims=True)
    length = np.maximum(np.sqrt(np.einsum("ns,ns->n", values, values)), 1e-6)[:, None]
    return values / length, length


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
    found: Any  # None of an image without corners, which its stubs do not know
    found, strength = cv2.goodFeaturesToTrackWithQuality(
        image, _POINTS - len(taken), _QUALITY, _APART_PX, mask, blockSize=5
    )
    found = () if found is None else found[strength.ravel() >= _LEAST_CORNER]
    if not len(found):
        return np.empty((0, 2), np.float32)
    return cv2.cornerSubPix(
        image, found, (3, 3), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 10, 0.05)
    ).reshape(-1, 2)
