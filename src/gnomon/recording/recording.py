"""A recording: samples, frames of cameras, what is known of them beforehand, and where they come from.

Of a camera it holds what was seen of a board: corners, frame by frame, and how good each image was. Before the board
is found, a camera is a stream of frames that are decoded only where they are needed.

Files are known again by their hashes, samples by their fingerprints, also where they were written anew: in another file
format, in another unit, with fewer digits. A hash does not survive that, nor does one of rounded values: of thousands
some always lie at a border. Where the largest value of each eighth of a recording stands does: it moves only where two
values are as good as equal.
"""

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import field, replace
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import RecordingError
from ..findings import Finding
from ..frozen import FrozenMapping, value_class
from ..models.camera import Camera
from ..units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2, Units
from .samples import Floats, ImuSamples, Integers, Poses, TriadSamples, frozen_array, ns_from_s

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
class FrameQuality:
    """What the images themselves were like, one entry a frame of `CameraFrames.t_ns`.

    Attributes
    ----------
    blur_px : (n,) width of the edges at the corners, standard deviation of the blur [px]; nan where none was found
    black, white : (n,) grey levels of the board, 0 to 255; nan where it was not found
    dropped : reason -> number of corners that were found and left out, over all frames
    """

    blur_px: Floats
    black: Floats
    white: Floats
    dropped: Mapping[str, int] = field(default_factory=dict[str, int])

    def __post_init__(self) -> None:
        for name in ("blur_px", "black", "white"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "dropped", FrozenMapping(self.dropped))


@value_class
class CameraFrames:
    """What one camera saw of the board: the corners that were detected, frame by frame.

    Attributes
    ----------
    t_ns : (n,) int64 [ns]
        Timestamps of all frames, in the order of time, also of frames in which nothing was detected; any clock.
    frame : (m,) int64
        For each corner, its frame's index into `t_ns`; ascending.
    point : (m,) int64
        For each corner, its number on the target, as `Target.points` counts (Kalibr's order).
    pixels : (m, 2) float64 [px]
        Where it was detected; (0, 0) is the centre of the top-left pixel.
    camera : Camera
        Lens and intrinsics that were known beforehand.
    T_cam_imu : (4, 4) or None
        Initial guess of the extrinsics, where one was stated; it is not needed.
    time_shift_cam_imu_s : float or None
        Initial guess of t_imu - t_cam [s], where one was stated; it is not needed.
    sigma_px : (m,) or None
        Standard deviation of each corner, per axis, as its detector knows it [px]; None where all are alike.
    quality : FrameQuality or None
        What the images were like, where there were images.
    lens_covariance : (k, k) or None
        Covariance of intrinsics and distortion coefficients, in the order of `Camera.parameters`, where it is known;
        they are estimated along then, with it as their prior.
    detector_scale_sigma : float
        How far an unknown bias of the detector may feign another focal length, relative to it; 0 for gnomon's own
        detector.

    Raises
    ------
    RecordingError
        If the shapes do not fit, a corner belongs to no frame, or a coordinate is not a finite number.
    """

    t_ns: Integers
    frame: Integers
    point: Integers
    pixels: Floats
    camera: Camera
    T_cam_imu: Floats | None = None
    time_shift_cam_imu_s: float | None = None
    sigma_px: Floats | None = None
    quality: FrameQuality | None = None
    lens_covariance: Floats | None = None
    detector_scale_sigma: float = 0.0

    def __post_init__(self) -> None:
        for name in ("t_ns", "frame", "point"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), np.int64))
        object.__setattr__(self, "pixels", frozen_array(self.pixels))
        for name in ("T_cam_imu", "sigma_px", "lens_covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name)))
        self._check_optional()
        corners = len(self.frame)
        if self.pixels.shape != (corners, 2) or self.point.shape != (corners,) or self.t_ns.ndim != 1:
            raise RecordingError(
                f"corners must be (m, 2) with m frames and m points; found pixels {self.pixels.shape}, "
                f"frames {self.frame.shape}, points {self.point.shape}."
            )
        if corners and (self.frame.min() < 0 or self.frame.max() >= len(self.t_ns) or (np.diff(self.frame) < 0).any()):
            raise RecordingError("every corner must belong to a frame, and corners must be in the order of frames.")
        if not np.isfinite(self.pixels).all():
            raise RecordingError(f"corner {int(np.argmin(np.isfinite(self.pixels).all(axis=1)))} is not a number.")

    def where(self, kept: NDArray[np.bool_]) -> "CameraFrames":
        """Return the frames of (n,) that are kept, with their corners."""
        corner = kept[self.frame]
        sigma, quality = self.sigma_px, self.quality
        if quality is not None:
            chosen = {name: getattr(quality, name)[kept] for name in ("blur_px", "black", "white")}
            quality = FrameQuality(**chosen, dropped=quality.dropped)
        return replace(
            self,
            t_ns=self.t_ns[kept],
            frame=(np.cumsum(kept) - 1)[self.frame[corner]],
            point=self.point[corner],
            pixels=self.pixels[corner],
            sigma_px=None if sigma is None else sigma[corner],
            quality=quality,
        )

    def _check_optional(self) -> None:
        sigma, covariance = self.sigma_px, self.lens_covariance
        if sigma is not None and (sigma.shape != self.frame.shape or not (np.isfinite(sigma) & (sigma > 0)).all()):
            raise RecordingError("sigma_px must be a number greater than zero for each corner.")
        size = len(self.camera.parameters)
        if covariance is not None and covariance.shape != (size, size):
            raise RecordingError(
                f"lens_covariance must be ({size}, {size}), as the camera has {size} intrinsics and distortion "
                f"coefficients; found {covariance.shape}."
            )
        if self.quality is not None and self.quality.blur_px.shape != self.t_ns.shape:
            raise RecordingError(f"quality must hold one entry a frame, {len(self.t_ns)}.")


@value_class
class KnownRig:
    """Cameras as a calibration without an IMU knows them: their poses to cam0, and how sure that is.

    Attributes
    ----------
    T_cam_cam0 : "cam1", ... -> (4, 4) p_cam = T_cam_cam0 @ p_cam0 [m]
    names : (n,) scalars of all lenses and poses, such as "cam0.intrinsics[0]" and "cam1.T_cam_cam0.rotation[0]" (of a
        small rotation on the right), as in `Calibration.uncertainty`
    covariance : (n, n) their joint covariance
    """

    T_cam_cam0: Mapping[str, Floats]
    names: tuple[str, ...]
    covariance: Floats

    def __post_init__(self) -> None:
        poses = {name: frozen_array(T) for name, T in self.T_cam_cam0.items()}
        object.__setattr__(self, "T_cam_cam0", FrozenMapping(poses))
        object.__setattr__(self, "covariance", frozen_array(self.covariance))

    def of(self, cameras: Collection[str]) -> "KnownRig":
        """Return what is known of some of the cameras; without cam0 no pose."""
        poses = {name: T for name, T in self.T_cam_cam0.items() if name in cameras and "cam0" in cameras}
        kept = [
            i
            for i, name in enumerate(self.names)
            if name.partition(".")[0] in (poses if ".T_cam_cam0." in name else cameras)
        ]
        names = tuple(self.names[i] for i in kept)
        return KnownRig(T_cam_cam0=poses, names=names, covariance=self.covariance[np.ix_(kept, kept)])


Grey = NDArray[np.uint8]
"""An image (height, width); [0, 0] is the top left pixel."""


@value_class
class Frame:
    """One image as its file holds it.

    Attributes
    ----------
    t_ns : timestamp of the frame, in the camera's clock [ns]
    where : the file, or file, topic and timestamp, for messages
    decode : returns the image in 8 bits of grey; it may be called in another thread, and raises RecordingError where
        the image is damaged
    """

    t_ns: int
    where: str
    decode: Callable[[], Grey]


@value_class
class Arrivals:
    """When the messages of a stream were stamped, and when they reached the recorder.

    Attributes
    ----------
    t_ns : (n,) timestamps of the sensor's clock [ns]
    received_ns : (n,) of the recorder's clock [ns]
    """

    t_ns: Integers
    received_ns: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, np.int64))
        object.__setattr__(self, "received_ns", frozen_array(self.received_ns, np.int64))


@value_class
class ImageStream:
    """The images of one camera.

    Attributes
    ----------
    frames : yields all of them, in the order in which they were recorded, as often as it is called; the memory that it
        needs does not grow with their number. Where the recording ends early, what can be read is yielded and a
        sentence about the rest goes to the list that is given to it.
    count : how many there seem to be, for progress; zero where nothing tells
    topic : of a bag, else ""
    camera : lens and intrinsics, where the recording itself states them (EuRoC's sensor.yaml)
    T_cam_imu, time_shift_cam_imu_s : guesses of the extrinsics, where the recording states them
    arrivals : where the recorder's clock is known
    selection : which of the recording's frames these are, in words; empty for all
    """

    frames: Callable[[list[str]], Iterator[Frame]]
    count: int = 0
    topic: str = ""
    camera: Camera | None = None
    T_cam_imu: Floats | None = None
    time_shift_cam_imu_s: float | None = None
    arrivals: Arrivals | None = None
    selection: str = ""


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
