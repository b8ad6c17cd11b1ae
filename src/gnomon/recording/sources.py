"""Where measurements come from: files by their hashes, samples by their fingerprints."""

import hashlib
from collections.abc import Collection
from dataclasses import field

from ..frozen import value_class
from .fingerprint import same_measurements
from .samples import ImuSamples


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
