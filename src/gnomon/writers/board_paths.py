"""Edges of what is black on a board -> closed paths, in which no cell has a seam towards its neighbour."""

from functools import partial

import numpy as np

from ..models.board_pattern import Pattern
from ..recording import Floats

Place = tuple[int, int]

_STEP_M = 1e-9  # corners that are nearer are one


def board_paths(pattern: Pattern) -> list[Floats]:
    """Return closed paths (n, 2) [m] around all that is black; to their left it is black, and holes are inside others.

    Corners between edges of the same direction are left out. Where two cells touch with their corners alone the paths
    do so, too.
    """
    order = np.argsort(pattern.area, kind="stable")
    starts = np.flatnonzero(np.diff(pattern.area[order])) + 1
    return [path for edges in np.split(pattern.edges[order], starts) for path in _traced(edges)]


def _traced(edges: Floats) -> list[Floats]:
    """Return the closed paths that edges (n, 4) of one area make."""
    places = np.rint(edges / _STEP_M).astype(np.int64)
    where: dict[Place, Floats] = {}
    ahead: dict[Place, list[Place]] = {}
    for (x0, y0, x1, y1), edge in zip(places.tolist(), edges, strict=True):
        where[x0, y0] = edge[:2]
        ahead.setdefault((x0, y0), []).append((x1, y1))
    paths: list[Floats] = []
    while ahead:
        start = at = before = next(iter(ahead))
        path: list[Place] = []
        while at != start or not path:
            path.append(at)
            choice = ahead[at]
            after = choice[0] if len(choice) == 1 else max(choice, key=partial(_left, before, at))
            choice.remove(after)
            if not choice:
                del ahead[at]
            before, at = at, after
        paths.append(np.array([where[place] for place in _corners(path)]))
    return paths


def _left(before: Place, at: Place, after: Place) -> int:
    """Return how far a way turns to the left."""
    return (at[0] - before[0]) * (after[1] - at[1]) - (at[1] - before[1]) * (after[0] - at[0])


def _corners(path: list[Place]) -> list[Place]:
    """Return the places at which a closed path turns."""
    around = zip([path[-1], *path[:-1]], path, [*path[1:], path[0]], strict=True)
    return [at for before, at, after in around if _left(before, at, after) != 0]
