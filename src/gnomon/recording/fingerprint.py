"""Knowing measurements again that were written anew: in another file format, in another unit, with fewer digits.

A hash of a file does not survive that, nor does one of rounded values: of thousands some always lie at a border. Where
the largest value of each eighth of a recording stands does: it moves only where two values are as good as equal.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

_PARTS, _SHORTEST = 8, 16
_NOT_TOLD = 0xFFFF
_FEWEST, _ALIKE = 12, 0.6  # places told by both, and share of them that agree


def sample_fingerprint(values: NDArray[np.float64]) -> str:
    """Return where the largest values of n samples of k axes (n, k) stand, as hexadecimal digits.

    Places where the largest value occurs more than once are not told; nothing ("") is of short or coarse series.
    """
    n = len(values)
    if n < _PARTS * _SHORTEST:
        return ""
    places: list[NDArray[np.int64]] = []
    for begin, end in pairwise(np.linspace(0, n, _PARTS + 1).astype(int)):
        part = values[begin:end]
        once = np.count_nonzero(part == part.max(axis=0), axis=0) == 1
        places.append(np.where(once, part.argmax(axis=0) % _NOT_TOLD, _NOT_TOLD))
    found = np.array(places)
    return found.astype(">u2").tobytes().hex() if np.count_nonzero(found != _NOT_TOLD) >= _FEWEST else ""


def same_measurements(first: str, second: str) -> bool:
    """Return whether two fingerprints are of the same measurements; rows may have been added or lost at an end."""
    if len(first) != len(second) or not first:
        return False
    try:
        a, b = (np.frombuffer(bytes.fromhex(one), dtype=">u2").astype(np.int64) for one in (first, second))
    except ValueError:  # a file edited by hand
        return False
    told = (a != _NOT_TOLD) & (b != _NOT_TOLD)
    return bool(told.sum() >= _FEWEST and np.mean(np.abs(a - b)[told] <= 1) >= _ALIKE)
