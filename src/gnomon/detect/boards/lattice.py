"""Places where two edges cross, as corners of a checkerboard, and the lattices that they form.

At a crossing the smoothed image is a saddle: the determinant of its second derivatives is negative. Around it, on a
circle, the grey levels repeat after half a turn and cross their mean four times; where they do tells both edges.

Along an edge the next corner of a checkerboard lies in the edge's direction, has the same two edges, and its colours
are exchanged. Crossings that take each other for the next one are joined; what hangs together is laid out on integer
places.
"""

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.camera import Booleans
from ...recording import Floats, Integers
from ...recording.recording import Grey

_WINDOW, _LEVELS, _STEPS, _STEP_PX = 13, 2, 15, 0.05
Singles = NDArray[np.float32]

_SMOOTHING_PX = 1.0
_APART = 5  # one candidate in a square of so many pixels
_STRIP_PIXELS, _STRIP_ROWS = 40_000, 32
_HALO = 3  # rows beyond a strip on which its saddles depend: the derivatives' and those nearby
_LEAST_STRENGTH = 100.0  # of a saddle, in the units of Sobel's second derivatives squared
_MOST_MAXIMA, _MOST = 700, 360
_RADIUS_PX = 3.0
_ANGLES = 32
_LEAST_AMPLITUDE = 5.0  # grey levels, half the swing on the circle
_ODD = 0.75  # largest rms of what changes sign after half a turn, over the rms of what does not
_LEAST_SINE = 0.25  # between the two edges
_NEAR = 16  # crossings that are looked at for the next one; squares may be three times as long as wide
_ACROSS = 0.22  # how far beside an edge's direction the next corner may lie, over its distance
_TURN = 0.40  # between the directions of the edges of two neighbours [rad]
_LEAST_CONTRAST = 0.35  # across an edge, halfway between two corners, over the corners' own
_FEWEST = 4


def carry_corners(before: Grey, now: Grey, corners: Floats, guess: Floats, scale: int) -> tuple[Floats, Booleans]:
    """Return where corners are in the next image, (m, 2) [px], and which of them could be followed, (m,).

    Parameters
    ----------
    before, now : (h, w) both images, reduced by `scale`
    corners, guess : (m, 2) in the image before, and about where they are now [px of the whole image]
    scale : whole number
    """
    start, first = (
        ((places - (scale - 1) / 2) / scale).reshape(-1, 1, 2).astype(np.float32) for places in (corners, guess)
    )
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        start,
        first,
        winSize=(_WINDOW, _WINDOW),
        maxLevel=_LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, _STEPS, _STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return moved.reshape(-1, 2).astype(np.float64) * scale + (scale - 1) / 2, status.ravel() == 1


@value_class
class Saddles:
    """Crossings of two edges in an image.

    Attributes
    ----------
    pixels : (n, 2) [px], to about half a pixel
    edges : (n, 2) angles of both edges, 0 to pi from x towards y: turning on from the first one enters black
    swing : (n,) half the difference between white and black, in grey levels
    """

    pixels: Floats
    edges: Floats
    swing: Floats

    def __len__(self) -> int:
        return len(self.pixels)


def find_saddles(image: Grey) -> Saddles:
    """Return the crossings in an image, strongest first, in time that is bounded whatever the image shows."""
    smooth = np.asarray(cv2.GaussianBlur(image, (5, 5), _SMOOTHING_PX), np.uint8)
    pixels = _maxima(smooth)
    profile = _circles(smooth.astype(np.float32), pixels)
    half = _ANGLES // 2
    even, odd = 0.5 * (profile[:, :half] + profile[:, half:]), 0.5 * (profile[:, :half] - profile[:, half:])
    even = even - 0.5 * (even.min(axis=1) + even.max(axis=1))[:, None]
    swing = even.max(axis=1)
    changes = (even > 0) != np.roll(even > 0, -1, axis=1)
    plausible = (
        (changes.sum(axis=1) == 2)
        & (swing > _LEAST_AMPLITUDE)
        & (np.square(odd).sum(axis=1) < _ODD**2 * np.square(even).sum(axis=1))
    )
    edges = _edge_angles(even[plausible])
    pixels, swing = pixels[plausible], swing[plausible]
    wide = np.abs(np.sin(edges[:, 1] - edges[:, 0])) > _LEAST_SINE
    kept = np.flatnonzero(wide)[:_MOST]
    return Saddles(pixels=pixels[kept].astype(np.float64), edges=edges[kept], swing=swing[kept].astype(np.float64))


def _maxima(smooth: Grey) -> Singles:
    """Return where the image is most like a saddle, (n, 2), the strongest first.

    It is gone through in strips whose arrays stay in the processor's cache.
    """
    height, width = smooth.shape
    step = max(_STRIP_PIXELS // width, _STRIP_ROWS)
    strips = [_peaks(smooth, start, min(start + step, height)) for start in range(0, height, step)]
    rows, columns, strength = (np.concatenate(items) for items in zip(*strips, strict=True))
    border = int(np.ceil(_RADIUS_PX)) + 1
    inner = np.minimum(rows, columns) >= border
    inner &= (rows < height - border) & (columns < width - border)
    rows, columns, strength = rows[inner], columns[inner], strength[inner]
    if len(strength) > _MOST_MAXIMA:
        kept = np.argpartition(-strength, _MOST_MAXIMA)[:_MOST_MAXIMA]
        rows, columns, strength = rows[kept], columns[kept], strength[kept]
    order = np.lexsort((columns, rows, -strength))
    return np.stack([columns, rows], axis=1)[order].astype(np.float32)


def _peaks(smooth: Grey, start: int, stop: int) -> tuple[Integers, Integers, Singles]:
    """Return rows, columns and strengths of the saddles in some rows of an image that are the strongest nearby."""
    first = max(start - _HALO, 0)
    strip = smooth[first : stop + _HALO]
    xx = cv2.Sobel(strip, cv2.CV_16S, 2, 0, ksize=3)
    yy = cv2.Sobel(strip, cv2.CV_16S, 0, 2, ksize=3)
    xy = cv2.Sobel(strip, cv2.CV_16S, 1, 1, ksize=3)
    # Sobel's kernels sum to 4 for second derivatives along an axis and to 4 for the mixed one.
    strength = cv2.multiply(xy, xy, dtype=cv2.CV_32F)
    other = cv2.multiply(xx, yy, dtype=cv2.CV_32F)
    cv2.subtract(strength, other, dst=strength)
    highest = cv2.dilate(strength, np.ones((_APART, _APART), np.uint8), dst=other)
    peaks = np.flatnonzero(strength >= highest)
    values = np.asarray(strength, np.float32).ravel()[peaks]
    rows, columns = np.divmod(peaks, strip.shape[1])
    rows += first
    kept = (values > _LEAST_STRENGTH) & (rows >= start) & (rows < stop)
    return rows[kept], columns[kept], values[kept]


def _circles(smooth: Singles, pixels: Singles) -> Singles:
    """Return the grey levels on circles about pixels, (n, angles)."""
    if not len(pixels):
        return np.zeros((0, _ANGLES), np.float32)
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    x = pixels[:, :1] + (_RADIUS_PX * np.cos(angle)).astype(np.float32)
    y = pixels[:, 1:] + (_RADIUS_PX * np.sin(angle)).astype(np.float32)
    return np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR), np.float32)


def _edge_angles(even: Singles) -> Floats:
    """Return where the profile over half a turn falls through zero, and where it rises, (n, 2) [rad]."""
    following = np.concatenate([even[:, 1:], even[:, :1]], axis=1)
    rows = np.arange(len(even))
    angles = np.empty((len(even), 2))
    for k, crossing in enumerate(((even > 0) & (following <= 0), (even <= 0) & (following > 0))):
        at = crossing.argmax(axis=1)
        before, after = even[rows, at], following[rows, at]
        angles[:, k] = (at + before / (before - after)) * (2 * np.pi / _ANGLES)
    return np.mod(angles, np.pi)


@value_class
class Lattice:
    """Crossings on integer places.

    Attributes
    ----------
    place : (n, 2) integer places, each once, from (0, 0); which axis is which, and its direction, is arbitrary
    pixels : (n, 2) [px]
    node : (n,) which of all crossings, or discs, they are
    """

    place: Integers
    pixels: Floats
    node: Integers

    def __len__(self) -> int:
        return len(self.place)

    @property
    def size(self) -> tuple[int, int]:
        """Number of places along both axes, from the first one to the last one that is taken."""
        first, second = self.place.max(axis=0) + 1
        return int(first), int(second)

    @property
    def spacing_px(self) -> float:
        """Median distance of neighbours along the first axis, or the second one where it is shorter; inf if none."""
        grid = self.grid()
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
        return min((float(np.nanmedian(step)) for step in steps if np.isfinite(step).any()), default=float("inf"))

    def handed(self) -> float:
        """Return the area that a step along the first axis and one along the second span, signed [px^2]; 0 of a line.

        It is below zero where the second axis is a quarter turn on from the first, seen with y upwards.
        """
        grid = self.grid()
        steps = [np.diff(grid, axis=axis).reshape(-1, 2) for axis in (0, 1)]
        known = [step[np.isfinite(step[:, 0])] for step in steps]
        if not (len(known[0]) and len(known[1])):
            return 0.0
        first, second = known[0].mean(axis=0), known[1].mean(axis=0)
        return float(first[0] * second[1] - first[1] * second[0])

    def grid(self) -> Floats:
        """Return the pixels at their places, (size, size, 2), nan where there are none."""
        grid = np.full((*self.size, 2), np.nan)
        grid[self.place[:, 0], self.place[:, 1]] = self.pixels
        return grid


def find_lattices(image: Grey, saddles: Saddles) -> list[Lattice]:
    """Return the lattices that the crossings form, the largest first.

    Parameters
    ----------
    image : in which the crossings were found
    saddles : the crossings
    """
    if len(saddles) < _FEWEST:
        return []
    directions, following = _neighbours(image, saddles)
    onward = _onward(directions, following)
    return laid_out(saddles.pixels, following, onward)


def laid_out(pixels: Floats, following: Integers, onward: Integers) -> list[Lattice]:
    """Return the lattices of nodes that are joined, the largest first.

    Parameters
    ----------
    pixels : (n, 2) of the nodes
    following : (n, 4) the next node in each of four directions, to and fro, and to and fro across; -1 where none is
    onward : (n, 4, 4) at the next node in one direction, its direction that goes the same way as each of a node's own
    """
    links = (following >= 0).sum(axis=1)
    free = links > 0
    next_ones, same_ways = following.tolist(), onward.tolist()
    lattices: list[Lattice] = []
    for seed in np.argsort(-links, kind="stable"):
        if free[seed]:
            nodes, places = _together(int(seed), next_ones, same_ways)
            free[nodes] = False
            if len(nodes) >= _FEWEST:
                place, node = np.array(places), np.array(nodes)
                lattices.append(Lattice(place=place - place.min(axis=0), pixels=pixels[node], node=node))
    return sorted(lattices, key=len, reverse=True)


def _neighbours(image: Grey, saddles: Saddles) -> tuple[Floats, Integers]:
    """Return directions (n, 4, 2) along both edges, to and fro, and the next corner there (n, 4), -1 where none is."""
    along = np.stack([np.cos(saddles.edges), np.sin(saddles.edges)], axis=2)
    directions = np.stack([along[:, 0], -along[:, 0], along[:, 1], -along[:, 1]], axis=1)
    near = _near(saddles.pixels)
    step = saddles.pixels[near] - saddles.pixels[:, None]
    # The falling edge of one corner is the rising one of the next; angles between lines are taken by the sine.
    first, second = saddles.edges.T
    alike = np.abs(np.sin(first[:, None] - second[near])) < np.sin(_TURN)
    alike &= np.abs(np.sin(second[:, None] - first[near])) < np.sin(_TURN)
    ahead = step @ along.swapaxes(1, 2)  # (n, near, edge)
    aside = step[:, :, :1] * along[:, None, :, 1] - step[:, :, 1:] * along[:, None, :, 0]
    possible = alike[:, :, None] & (np.abs(aside) < _ACROSS * np.abs(ahead))
    following = np.full((len(saddles), 4), -1)
    for way in range(4):
        onward = ahead[:, :, way // 2] * (1 - 2 * (way % 2))
        distance = np.where(possible[:, :, way // 2] & (onward > 0), onward, np.inf)
        nearest = distance.argmin(axis=1)[:, None]
        found = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
        following[:, way] = np.where(found, np.take_along_axis(near, nearest, axis=1), -1)[:, 0]
    following[~_edge_between(image, saddles, directions, following)] = -1
    # Both must take each other for the next one.
    target = np.where(following >= 0, following, 0)
    returned = (following[target] == np.arange(len(saddles))[:, None, None]).any(axis=2)
    following[~returned] = -1
    return directions, following


def _near(pixels: Floats) -> Integers:
    """Return the nearest other ones of each pixel, (n, k)."""
    apart = squared_distances(pixels, pixels)
    np.fill_diagonal(apart, np.inf)
    count = min(_NEAR, len(pixels) - 1)
    return np.argpartition(apart, count - 1, axis=1)[:, :count]


def squared_distances(first: Floats, second: Floats) -> Floats:
    """Return how far points (n, 2) are from points (m, 2), squared, (n, m): few points need no tree."""
    step = first[:, None] - second
    return np.asarray(np.einsum("nmk,nmk->nm", step, step), np.float64)


def _edge_between(image: Grey, saddles: Saddles, directions: Floats, following: Integers) -> Booleans:
    """Tell where there is an edge halfway to the next corner, (n, 4), as strong as both corners have it."""
    node, way = np.nonzero(following >= 0)
    other = following[node, way]
    step = saddles.pixels[other] - saddles.pixels[node]
    middle = 0.5 * (saddles.pixels[other] + saddles.pixels[node])
    beside = np.where((way < 2)[:, None], directions[node, 2], directions[node, 0])
    sine = np.abs(step[:, 0] * beside[:, 1] - step[:, 1] * beside[:, 0]) / np.linalg.norm(step, axis=1)
    offset = beside * np.maximum(0.25 * np.linalg.norm(step, axis=1) * sine, 1.0)[:, None]
    left, right = _levels(image, middle + offset), _levels(image, middle - offset)
    contrast = np.minimum(saddles.swing[node], saddles.swing[other])
    strong = np.zeros(following.shape, bool)
    strong[node, way] = np.abs(left - right) > 2 * _LEAST_CONTRAST * contrast
    return strong


def _levels(image: Grey, pixels: Floats) -> Floats:
    x, y = np.clip(np.rint(pixels), 0, [image.shape[1] - 1, image.shape[0] - 1]).astype(np.int64).T
    return image[y, x].astype(np.float64)


def _onward(directions: Floats, following: Integers) -> Integers:
    """Return which of the next corner's directions goes the same way as each one of a corner, (n, 4 ways, 4).

    Edge 0 of a corner is edge 1 of the next one.
    """
    target = np.where(following >= 0, following, 0)
    onward = np.empty((*following.shape, 4), np.int64)
    for way in range(4):
        swapped = 2 - 2 * (way // 2)  # first direction of the other edge
        same = np.einsum("ni,nki->nk", directions[:, way], directions[target, swapped]) > 0
        onward[:, :, way] = np.where(same, swapped, swapped + 1)
    return onward


def _together(
    seed: int, following: list[list[int]], onward: list[list[list[int]]]
) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the corners that hang together with one, and their places; its edges 0 and 1 are the axes."""
    frames = {seed: (0, 0, 0, 2)}  # node -> place, its direction along +x, its direction along +y
    taken = {(0, 0): seed}
    queue = deque([seed])
    while queue:
        node = queue.popleft()
        i, j, x, y = frames[node]
        for way, di, dj in ((x, 1, 0), (x ^ 1, -1, 0), (y, 0, 1), (y ^ 1, 0, -1)):
            other = following[node][way]
            place = (i + di, j + dj)
            if other < 0 or other in frames or place in taken:
                continue
            frames[other] = (*place, onward[node][way][x], onward[node][way][y])
            taken[place] = other
            queue.append(other)
    return list(taken.values()), list(taken)
