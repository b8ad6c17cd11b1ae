"""Where measurements come from: files by their hashes, samples by their fingerprints.

Knowing measurements again that were written anew: in another file format, in another unit, with fewer digits.

A hash of a file does not survive that, nor does one of rounded values: of thousands some always lie at a border. Where
the largest value of each eighth of a recording stands does: it moves only where two values are as good as equal.
"""

import hashlib
from collections.abc import Collection
from dataclasses import field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from .samples import ImuSamples

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


@value_class(eq=True)
class Piece:
    """A part of a recording that was recorded on its own, as one file a pose.

    Attributes
    ----------
    name : what a person knows it by: its file
    start, stop : first sample and one past the last, of each of the triads, which have the same timestamps
    """

    name: str
    start: int
    stop: int


@value_class(eq=True)
class Source:
    """A file that was read.

    Attributes
    ----------
    name : without folder
    sha256 : of its bytes
    samples : fingerprints of what a recording holds, with its first file: in another format they are the same
    """

    name: str
    sha256: str
    samples: tuple[str, ...] = field(default=(), compare=False)  # the file is the same without


_SETTINGS = (".yaml", ".yml")


def recorded_hashes(sources: Collection[Source]) -> frozenset[str]:
    """Return the hashes of the files that hold what was measured; settings are the same in many recordings."""
    return frozenset(source.sha256 for source in sources if not source.name.lower().endswith(_SETTINGS))


def shared_sources(first: Collection[Source], second: Collection[Source]) -> tuple[Source, ...]:
    """Return the files of one recording that another holds, too, or whose measurements it holds in another format."""
    hashes = recorded_hashes(first) & recorded_hashes(second)
    known = [other for source in second for other in source.samples]
    return tuple(
        source
        for source in first
        if source.sha256 in hashes or any(same_measurements(one, other) for one in source.samples for other in known)
    )


def samples_fingerprint(samples: ImuSamples) -> Source:
    """Return arrays as a source, by which the same recording is known again."""
    digest = hashlib.sha256()
    for triad in (samples.accelerometer, samples.gyroscope):
        digest.update(triad.t_ns.tobytes())
        digest.update(triad.values.tobytes())
    return Source(name="recording from memory", sha256=digest.hexdigest())
