"""Where labels go in a drawing: near what they name, off its lines and off each other."""

import numpy as np

from ..recording import Floats
from .figures import TEXT

_APART = 2.5  # figure units between the points by which lines are seen
_LETTER = 0.62  # width of a letter over its size
_ROOM = 1.25  # letters are larger on small screens
_LATER = 0.1  # cost of a later candidate
_COVERED = 12.0  # units of lines under a label beyond which it cannot be read


class LabelPlaces:
    """Hands out places for labels, in figure units (right, down).

    Parameters
    ----------
    lines : (n, 2, 2) ends of everything that is drawn
    width, height : of the drawing
    """

    def __init__(self, lines: Floats, width: float, height: float) -> None:
        steps = [np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / _APART))[:, None] for a, b in lines]
        points = [a + step * (b - a) for (a, b), step in zip(lines, steps, strict=True)]
        self._points = np.concatenate(points) if points else np.empty((0, 2))
        self._edge = np.array([width, height])
        self._taken: list[tuple[Floats, Floats]] = []

    def take(self, text: str, candidates: Floats) -> Floats:
        """Return the centre (2,) of the best place for a text, earlier candidates (n, 2) first."""
        best, _ = self._best(text, candidates)
        self._taken.append((best, half_size(text)))
        return best

    def take_free(self, text: str, candidates: Floats) -> Floats | None:
        """Return the same, and None where the text could not be read in any place."""
        best, cost = self._best(text, candidates)
        if cost > _COVERED:
            return None
        self._taken.append((best, half_size(text)))
        return best

    def _best(self, text: str, candidates: Floats) -> tuple[Floats, float]:
        costs = [self._cost(centre, half_size(text)) for centre in candidates]
        best = int(np.argmin(np.array(costs) + _LATER * np.arange(len(costs))))
        return candidates[best], costs[best]

    def _cost(self, centre: Floats, half: Floats) -> float:
        """Return units of lines under a label, more where it lies on another one or over the edge."""
        covered = _APART * float(np.count_nonzero((np.abs(self._points - centre) < half).all(axis=1)))
        shared = [np.clip(half + other_half - np.abs(centre - other), 0, None) for other, other_half in self._taken]
        beyond = np.clip(half - centre, 0, None) + np.clip(centre + half - self._edge, 0, None)
        return covered + 3 * sum(float(np.prod(s)) for s in shared) + 10 * float(beyond.sum())


def half_size(text: str) -> Floats:
    """Return half of the width and of the height (2,) that a label takes, with some room."""
    return 0.5 * _ROOM * TEXT * np.array([_LETTER * len(text), 1.0])
