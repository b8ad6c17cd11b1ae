"""Crossings joined to a lattice as a checkerboard's corners form it.

Along an edge the next corner of a checkerboard lies in the edge's direction, has the same two edges, and its colours
are exchanged. Crossings that take each other for the next one are joined; what hangs together is laid out on integer
places.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ...images import Grey
from ...models.camera import Booleans
from ...recording import Floats, Integers
from .saddles import Saddles

_NEAR = 16  # crossings that are looked at for the next one; squares may be three times as long as wide
_ACROSS = 0.22  # how far beside an edge's direction the next corner may lie, over its distance
_TURN = 0.40  # between the directions of the edges of two neighbours [rad]
_LEAST_CONTRAST = 0.35  # across an edge, halfway between two corners, over the corners' own
_FEWEST = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    count = min(_NEAR + 1, len(pixels))
    _, near = KDTree(pixels).query(pixels, k=count)
    return np.asarray(near, np.int64)[:, 1:]


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
