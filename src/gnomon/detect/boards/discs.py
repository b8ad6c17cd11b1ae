"""Discs in an image: where circles of a grid might be, the ellipses that they are seen as, and the grid among them.

A pixel is dark where it is nearer to the darkest than to the lightest one of its neighbourhood; a dark region counts
whose area is that of the ellipse with its second moments.

The ellipse that a disc is seen as tells how its surroundings are foreshortened: where it is made a circle again, the
next discs are equally far off, a quarter turn apart. So perspective and lens do not matter, from disc to disc. Discs
that take each other for the next one are joined; what hangs together is laid out on integer places.
"""

from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial import KDTree

from ...frozen import value_class
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.frames import Grey
from .lattice import Lattice, laid_out
from .marker_boards import black_limits

_CONTRAST = 0.3  # a neighbourhood with less contrast than this share of the strongest has no disc
_LEAST_AREA_PX, _LARGEST = 8.0, 0.03  # of a disc; the latter over the image
_LIKE_ELLIPSE = 0.1  # how far the area may be from that of the ellipse with the same second moments
_SMALL_PX = 60.0  # area from which on that is asked; smaller ones are rough
_FEWEST_POINTS = 4
_MOMENTS = ("m00", "m10", "m01", "mu20", "mu11", "mu02")
_THINNEST = 0.15  # smaller half axis over the larger one
_NEAR = 24  # discs that are looked at for the next one; seen from aside, a row is three times as dense as a column
_ALIKE = (0.45, 2.2)  # area of a neighbour's outline over a disc's own
_TURN = np.radians(32)  # from the expected direction of a neighbour
_FARTHER = 1.7  # the farthest neighbour over the nearest one
_FEWEST_DISCS = 4
_SLACK = 2  # lines that may have been missed on one side
_FOUND = 0.85  # share of the circles that a lattice must have
_OF_SIDE = 0.6  # the same of the outermost ones on each side
_GOES_ON = 0.5  # share of the places beside the board that make it a larger one


@value_class
class Discs:
    """Ellipses in an image.

    Attributes
    ----------
    pixels : (n, 2) middles [px]
    shape : (n, 2, 2) symmetric: the outline is where (x - middle)' inv(shape) (x - middle) = 1 [px^2]
    """

    pixels: Floats
    shape: Floats

    def __len__(self) -> int:
        return len(self.pixels)


def find_discs(image: Grey) -> Discs:
    """Return the dark discs in an image; light ones are those of the negative.

    Parameters
    ----------
    image : (h, w)
    """
    outlines, tree = cv2.findContours(_dark(image), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return _no_discs()
    whole = np.asarray(tree)[0, :, 3] < 0  # not the outline of a hole
    found = [cv2.moments(outlines[i]) for i in np.flatnonzero(whole).tolist() if len(outlines[i]) >= _FEWEST_POINTS]
    moments = np.array([[m[name] for name in _MOMENTS] for m in found if m["m00"] > 0]).reshape(-1, len(_MOMENTS))
    area, by_x, by_y, xx, xy, yy = moments.T
    if not len(area):
        return _no_discs()
    squares, axes = np.linalg.eigh(np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2) / area[:, None, None])
    half = 2 * np.sqrt(np.maximum(squares, 1e-6))  # axes of the ellipse that has these second moments
    likeness = area / (np.pi * half.prod(axis=1))
    half += 0.5  # the outline runs through the middles of the outermost pixels
    good = (
        (area > _LEAST_AREA_PX)
        & (area < _LARGEST * image.size)
        & (np.abs(likeness - 1) < _LIKE_ELLIPSE * np.maximum(np.sqrt(_SMALL_PX / area), 1))
        & (half[:, 0] > _THINNEST * half[:, 1])
    )
    return Discs(
        pixels=np.stack([by_x / area, by_y / area], axis=1)[good],
        shape=np.einsum("nij,nj,nkj->nik", axes, np.square(half), axes)[good],
    )


def _no_discs() -> Discs:
    return Discs(pixels=np.empty((0, 2)), shape=np.empty((0, 2, 2)))


def _dark(image: Grey) -> Grey:
    """Return 255 for dark, 0 for light."""
    dark = np.asarray(cv2.compare(image, black_limits(image, 0.5, _CONTRAST), cv2.CMP_LT), np.uint8)
    dark[:1], dark[-1:], dark[:, :1], dark[:, -1:] = 0, 0, 0, 0
    return dark


def disc_lattices(discs: Discs) -> list[Lattice]:
    """Return the lattices that discs form, the largest first."""
    if len(discs) < _FEWEST_DISCS:
        return []
    following, onward = _neighbours(discs)
    return laid_out(discs.pixels, following, onward)


def _neighbours(discs: Discs) -> tuple[Integers, Integers]:
    """Return the next disc in four directions, (n, 4), -1 where none is, and which way goes on there, (n, 4, 4).

    Ways 0 and 1 are to and fro, ways 2 and 3 those a quarter turn on.
    """
    count = len(discs)
    _, near = KDTree(discs.pixels).query(discs.pixels, k=min(_NEAR + 1, count))
    near = np.asarray(near, np.int64)[:, 1:]
    squares, axes = np.linalg.eigh(discs.shape)
    rounded = np.einsum("nij,nj,nkj->nik", axes, 1 / np.sqrt(squares), axes)  # makes an ellipse a circle
    step = np.einsum("nij,nkj->nki", rounded, discs.pixels[near] - discs.pixels[:, None])
    distance, angle = np.hypot(step[..., 0], step[..., 1]), np.arctan2(step[..., 1], step[..., 0])
    area = np.sqrt(squares.prod(axis=1))
    ratio = area[near] / area[:, None]
    seen = rounded[:, None] @ discs.shape[near] @ rounded[:, None]  # of a neighbour, where this one is a circle
    spread = np.linalg.eigvalsh(seen)
    possible = (ratio > _ALIKE[0]) & (ratio < _ALIKE[1]) & (spread[..., 1] < 4 * spread[..., 0])
    possible &= distance > 1.5
    distance = np.where(possible, distance, np.inf)
    nearest = distance.argmin(axis=1)[:, None]
    first = np.take_along_axis(angle, nearest, 1)
    least = np.take_along_axis(distance, nearest, 1)
    directions = first + np.array([0.0, np.pi, np.pi / 2, -np.pi / 2])
    following = np.full((count, 4), -1)
    for way in range(4):
        off = np.abs(np.angle(np.exp(1j * (angle - directions[:, way : way + 1]))))
        onward = np.where((off < _TURN) & (distance < _FARTHER * least), distance, np.inf)
        nearest = onward.argmin(axis=1)[:, None]
        found = np.isfinite(np.take_along_axis(onward, nearest, 1))
        following[:, way] = np.where(found, np.take_along_axis(near, nearest, 1), -1)[:, 0]
    target = np.where(following >= 0, following, 0)
    returned = (following[target] == np.arange(count)[:, None, None]).any(axis=2)
    following[~returned] = -1
    # where a way goes on: the direction there that is most alike in the image
    spread_back = np.linalg.inv(rounded)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=2)
    along = np.einsum("nij,nwj->nwi", spread_back, along)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    onward = np.einsum("nwi,nkvi->nkwv", along, along[target]).argmax(axis=3)
    return following, onward


@lru_cache(maxsize=8)
def _places(target: Target) -> Integers:
    """Return where the circles are on a square lattice of neighbours, (n, 2); the second axis a quarter turn on."""
    if not target.asymmetric:
        return np.stack(np.divmod(np.arange(len(target)), target.cols), axis=1)
    x, y = np.rint(target.points[:, :2] / target.spacing_m).astype(np.int64).T
    return np.stack([(x + y) // 2, (y - x) // 2], axis=1)


def grids_in(lattice: Lattice, target: Target) -> list[Integers]:
    """Return which nodes of a lattice are which circles, (n,), -1 where one is missing; each way it may be.

    Parameters
    ----------
    lattice : of discs
    target : the grid of circles
    """
    found: list[tuple[int, Integers]] = []
    handed = lattice.handed()
    if not handed or len(lattice) < _FOUND * len(target):
        return []
    at = np.full(lattice.size, -1)
    at[lattice.place[:, 0], lattice.place[:, 1]] = np.arange(len(lattice))
    if handed > 0:
        at = at[::-1]
    own = _places(target)
    own = own - own.min(axis=0)
    extent = own.max(axis=0) + 1
    sides, beside = _sides(target), _beside(target)
    for turn in range(4):
        turned = np.rot90(at, turn)
        padded = np.pad(turned, _SLACK + 1, constant_values=-1)
        taken = padded >= 0
        spare = np.array(padded.shape) - extent - 1
        if (spare < 2).any():
            continue
        rows, cols = np.arange(1, spare[0]), np.arange(1, spare[1])
        counts = taken[rows[:, None, None] + own[:, 0], cols[:, None] + own[:, 1]].sum(axis=2)
        for i, j in 1 + np.argwhere(counts >= _FOUND * len(target)):
            node = padded[i + own[:, 0], j + own[:, 1]]
            whole = all((node[side] >= 0).mean() >= _OF_SIDE for side in sides)
            goes_on = any(taken[i + line[:, 0], j + line[:, 1]].mean() > _GOES_ON for line in beside)
            if whole and not goes_on:
                found.append((int(counts[i - 1, j - 1]), node))
    return [node for _, node in sorted(found, key=lambda one: -one[0])]


@lru_cache(maxsize=8)
def _sides(target: Target) -> tuple[Integers, ...]:
    """Return the circles on the sides of the board."""
    number = np.arange(len(target)).reshape(target.rows, target.cols)
    if not target.asymmetric:
        return number[0], number[-1], number[:, 0], number[:, -1]
    return number[0], number[-1], number[::2, 0], number[1::2, -1]


@lru_cache(maxsize=8)
def _beside(target: Target) -> tuple[Integers, ...]:
    """Return the places (k, 2) in a line beside each side of the board, counted as `_places` from the least ones."""
    own = _places(target)
    low = own.min(axis=0)
    if not target.asymmetric:
        rows, cols = np.arange(target.rows), np.arange(target.cols)
        lines = [(np.full_like(cols, k), cols) for k in (-1, target.rows)]
        lines += [(rows, np.full_like(rows, k)) for k in (-1, target.cols)]
        return tuple(np.stack(line, axis=1) for line in lines)
    width, height = 2 * target.cols, target.rows
    lines = [[(x, y) for x in range(width) if (x + y) % 2 == 0] for y in (-1, height)]
    lines += [[(x, y) for y in range(height) if (x + y) % 2 == 0] for x in (-1, width)]
    return tuple(np.array([((x + y) // 2, (y - x) // 2) for x, y in line]) - low for line in lines)
