"""A recording: samples, frames, what is known of them beforehand, and where they come from.

Files are known again by their hashes, samples by their fingerprints, also where they were written anew: in another file
format, in another unit, with fewer digits. A hash does not survive that, nor does one of rounded values: of thousands
some always lie at a border. Where the largest value of each eighth of a recording stands does: it moves only where two
values are as good as equal.
"""

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import field, replace
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import RecordingError
from ..findings import Finding
from ..frozen import FrozenMapping, value_class
from ..units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2, Units
from .frames import Arrivals, CameraFrames, ImageStream, KnownRig
from .samples import ImuSamples, Poses, TriadSamples, frozen_array, ns_from_s

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


@value_class
class Recording:
    """What was measured in one go.

    Attributes
    ----------
    imus : mapping from "imu0", "imu1", ... to ImuSamples
    cameras : mapping from "cam0", "cam1", ... to CameraFrames; empty for an IMU alone
    findings : what was noticed while it was read, such as clocks that drift
    poses : averages instead of samples; `imus` is empty then
    pieces : the parts of the only IMU's samples, where each was recorded on its own; a pose each
    sources : the files that were read
    assumptions : sentences on what the reader had to assume, such as units or the rate
    rig : what a calibration of the cameras alone tells of them, where one was given; None without
    """

    imus: Mapping[str, ImuSamples]
    sources: tuple[Source, ...] = ()
    assumptions: tuple[str, ...] = ()
    cameras: Mapping[str, CameraFrames] = field(default_factory=dict[str, "CameraFrames"])
    findings: tuple[Finding, ...] = ()
    poses: Poses | None = None
    pieces: tuple[Piece, ...] = ()
    rig: KnownRig | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "imus", FrozenMapping(self.imus))
        object.__setattr__(self, "cameras", FrozenMapping(self.cameras))
        if self.sources and not any(source.samples for source in self.sources):
            first = replace(self.sources[0], samples=self._fingerprints())
            object.__setattr__(self, "sources", (first, *self.sources[1:]))

    def _fingerprints(self) -> tuple[str, ...]:
        imus = [imu.accelerometer if len(imu.accelerometer) else imu.gyroscope for imu in self.imus.values()]
        fields = [imu.magnetometer for imu in self.imus.values() if imu.magnetometer is not None]
        series = [triad.values for triad in (*imus, *fields)] + [frames.pixels for frames in self.cameras.values()]
        return tuple(one for one in map(sample_fingerprint, series) if one)

    @classmethod
    def from_arrays(cls, t_s: ArrayLike, gyro: ArrayLike, accel: ArrayLike, units: str | Units = "si") -> Self:
        """Make a recording of one IMU from arrays.

        Parameters
        ----------
        t_s : (n,) [s], or a pair of them (gyroscope, accelerometer) where the two triads have their own timestamps
        gyro : (n, 3) [rad/s, or as `units` says]
        accel : (n, 3) [m/s^2, or as `units` says], specific force
        units : "si", "raw", a list such as "g deg/s", or Units

        Raises
        ------
        RecordingError
            If the shapes do not fit.
        OptionError
            If `units` names no unit.
        """
        stated = Units.parse(units) if isinstance(units, str) else units
        _refuse_swapped(gyro, accel, stated)
        t_gyro, t_accel = t_s if isinstance(t_s, tuple) else (t_s, t_s)
        samples = ImuSamples(
            accelerometer=TriadSamples(
                t_ns=ns_from_s(t_accel), values=frozen_array(accel), unit=stated.accelerometer or "m/s^2"
            ),
            gyroscope=TriadSamples(t_ns=ns_from_s(t_gyro), values=frozen_array(gyro), unit=stated.gyroscope or "rad/s"),
        )
        return cls(imus={"imu0": samples}, sources=(samples_fingerprint(samples),))


@value_class
class ImageRecording:
    """A recording whose cameras are images still.

    Attributes
    ----------
    imus : mapping from "imu0", ... to ImuSamples; empty where the recording has none
    streams : mapping from "cam0", ... to ImageStream; at least one
    sources : the files that were read, or are to be read: name and hash of all that the images come from
    assumptions : sentences on what the reader had to assume
    imu_arrivals : of the IMUs, where the recorder's clock is known
    """

    imus: Mapping[str, ImuSamples]
    streams: Mapping[str, ImageStream]
    sources: tuple[Source, ...] = ()
    assumptions: tuple[str, ...] = ()
    imu_arrivals: Mapping[str, Arrivals] = field(default_factory=dict[str, Arrivals])

    def __post_init__(self) -> None:
        for name in ("imus", "streams", "imu_arrivals"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))


_ABOUT_GRAVITY, _NO_GRAVITY = 0.15, 0.3
"""How far from gravity the median of an accelerometer may be, and what it never is, over gravity."""


def _refuse_swapped(gyro: ArrayLike, accel: ArrayLike, units: Units) -> None:
    """Refuse arrays of which the gyroscope's reads gravity all the time, and the accelerometer's hardly anything."""
    in_m_s2 = ACCELEROMETER_UNITS_M_S2[units.accelerometer or "m/s^2"]
    if in_m_s2 is None or in_m_s2 == STANDARD_GRAVITY_M_S2:  # a gyroscope may well read 1 deg/s all the time
        return
    middle = [float(np.median(np.linalg.norm(np.asarray(one, dtype=np.float64), axis=-1))) for one in (gyro, accel)]
    turned, felt = (value * in_m_s2 / STANDARD_GRAVITY_M_S2 for value in middle)
    if abs(turned - 1) < _ABOUT_GRAVITY and felt < _NO_GRAVITY:
        raise RecordingError(
            f"gyro and accel seem to be swapped: the median magnitude of gyro is {middle[0]:.4g}, which is gravity in "
            f"{units.accelerometer or 'm/s^2'}, and that of accel is {middle[1]:.4g}. The order is from_arrays(t_s, "
            "gyro, accel)."
        )
