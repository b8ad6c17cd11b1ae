"""What was measured: samples, as recorded, with their timestamps and their unit."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import RecordingError
from .findings import Finding
from .fingerprint import alike, fingerprint
from .frozen import FrozenMapping
from .models.camera import Camera
from .models.noise import ImuNoise
from .units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2, Units


def close_gaps(stamps: Sequence[NDArray[np.int64]], longest_ns: int) -> list[NDArray[np.int64]]:
    """Return timestamps of one clock, which stands still wherever none of them came for longer than `longest_ns`.

    An even grid over what is returned has at most `longest_ns` over its step points for each timestamp. Where there is
    no such gap the timestamps are returned as they are.

    Parameters
    ----------
    stamps : of several sensors, each (n,) and not falling [ns]
    longest_ns : what remains of a gap [ns]

    Examples
    --------
    >>> close_gaps([np.array([0, 10, 9000, 9010])], 100)
    [array([  0,  10, 110, 120])]
    """
    every = np.unique(np.concatenate(stamps))
    surplus = np.maximum(np.diff(every) - longest_ns, 0)
    if not surplus.any():
        return list(stamps)
    taken = np.concatenate([[0], np.cumsum(surplus)])
    return [np.asarray(t_ns - taken[np.searchsorted(every, t_ns)], dtype=np.int64) for t_ns in stamps]


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


_LONGEST_PAUSE_NS = 2_000_000_000  # between packets
_PACKET_FACTOR = 3.0  # a mean step this much longer than the median comes from packets, not from gaps


def frozen_array(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only C-ordered array; values are copied unless they already are one."""
    if isinstance(values, np.ndarray) and values.dtype == dtype and values.flags.c_contiguous:
        if not values.flags.writeable:
            return values
        array = values.copy()
    else:
        array = np.array(values, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def usual_step(steps: NDArray[Any], unit_ns: float = 1.0) -> float:
    """Return the usual one of steps between timestamps (n,): the median, or the mean where samples came in packets.

    Parameters
    ----------
    steps : [`unit_ns`]
    """
    step = float(np.median(steps))
    together = steps[steps < max(_LONGEST_PAUSE_NS / unit_ns, step)]  # what was cut out between poses is no pause
    mean = float(np.mean(together)) if len(together) else step
    return mean if mean > _PACKET_FACTOR * step else step


_LARGEST = 1e100  # squares and sums of samples stay finite; no sensor reads a number like that


def measurable(values: Floats) -> NDArray[np.bool_]:
    """Return which numbers a sensor can have read: not NaN, not infinite, not beyond all measure."""
    return np.abs(values) < _LARGEST


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSamples:
    """Samples of one three-axis sensor.

    Attributes
    ----------
    t_ns : (n,) int64 [ns]
        Timestamps in any clock; not necessarily uniform.
    values : (n, 3) float64 [unit]
        x, y, z as recorded.
    unit : str
        "count", or a key of the tables in `gnomon.units`.

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    t_ns: Integers
    values: Floats
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, np.int64))
        object.__setattr__(self, "values", frozen_array(self.values))
        if self.values.ndim != 2 or self.values.shape[1] != 3 or self.t_ns.shape != self.values.shape[:1]:
            raise RecordingError(
                f"samples must be (n, 3) with n timestamps; found values {self.values.shape} and timestamps "
                f"{self.t_ns.shape}."
            )

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def t_s(self) -> Floats:
        """Seconds since the first timestamp, (n,)."""
        return (self.t_ns - self.t_ns[0]) * 1e-9 if len(self) else np.empty(0)

    @property
    def rate_hz(self) -> float:
        """Sample rate [Hz]: by the median step, or the mean where samples were stamped in packets; nan if unknown."""
        if len(self) < 2:
            return float("nan")
        step = usual_step(np.diff(self.t_ns))
        return 1e9 / step if step > 0 else float("nan")

    @property
    def duration_s(self) -> float:
        """Time from the first to the last timestamp [s]."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9 if len(self) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuSamples:
    """The triads of one IMU; they may differ in rate and timestamps, but share one clock.

    Attributes
    ----------
    accelerometer, gyroscope : without samples where the recording has none
    magnetometer : None where the recording has none
    noise : what its data sheet or its Allan deviation says, where that was stated
    topic : ROS topic that Kalibr's files name, or ""
    T_imu_body : (4, 4) how it lies to the first IMU, p_imu = T_imu_body @ p_body, where stated; it is not needed
    time_shift_s : t_body = t_imu + time_shift_s, between timestamps [s], where stated; it is not needed
    """

    accelerometer: TriadSamples
    gyroscope: TriadSamples
    noise: ImuNoise | None = None
    topic: str = ""
    magnetometer: TriadSamples | None = None
    T_imu_body: Floats | None = None
    time_shift_s: float | None = None

    def __post_init__(self) -> None:
        if self.T_imu_body is not None:
            object.__setattr__(self, "T_imu_body", frozen_array(self.T_imu_body))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Poses:
    """Averages of an IMU at rest in several attitudes, one row a pose: a table that somebody made, or a file per pose.

    Attributes
    ----------
    name : (n,) what a person knows each pose by: a file, or the row of a table
    accelerometer : (n, 3) mean [accelerometer_unit]
    gyroscope : (n, 3) mean [gyroscope_unit], or None
    accelerometer_sigma, gyroscope_sigma : (n, 3) standard deviation of each mean [unit], or None where it is not known
    samples : (n,) samples in each mean; 0 where that is not known
    t_s : (n,) when [s], or None where it is not known
    specific_force : (n, 3) known specific force in the frame of the jig [m/s^2], or None (Angrisano, Eqs. 4 to 7)

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    name: tuple[str, ...]
    accelerometer: Floats
    accelerometer_unit: str
    gyroscope: Floats | None = None
    gyroscope_unit: str = "rad/s"
    accelerometer_sigma: Floats | None = None
    gyroscope_sigma: Floats | None = None
    samples: Integers | None = None
    t_s: Floats | None = None
    specific_force: Floats | None = None

    def __post_init__(self) -> None:
        n = len(self.name)
        for field_name in ("accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma", "specific_force"):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values))
                if np.shape(values) != (n, 3):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n}, 3); found {np.shape(values)}.")
        for field_name, dtype in (("samples", np.int64), ("t_s", np.float64)):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values, dtype))
                if np.shape(values) != (n,):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n},); found {np.shape(values)}.")

    def __len__(self) -> int:
        return len(self.name)


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True, kw_only=True)
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
        if source.sha256 in hashes or any(alike(one, other) for one in source.samples for other in known)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        return tuple(one for one in map(fingerprint, series) if one)

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
                t_ns=_ns_from_s(t_accel), values=frozen_array(accel), unit=stated.accelerometer or "m/s^2"
            ),
            gyroscope=TriadSamples(
                t_ns=_ns_from_s(t_gyro), values=frozen_array(gyro), unit=stated.gyroscope or "rad/s"
            ),
        )
        return cls(imus={"imu0": samples}, sources=(_fingerprint(samples),))


def _fingerprint(samples: ImuSamples) -> Source:
    """Return arrays as a source, by which the same recording is known again."""
    digest = hashlib.sha256()
    for triad in (samples.accelerometer, samples.gyroscope):
        digest.update(triad.t_ns.tobytes())
        digest.update(triad.values.tobytes())
    return Source(name="recording from memory", sha256=digest.hexdigest())


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


def _ns_from_s(t_s: ArrayLike) -> Integers:
    t = np.asarray(t_s, dtype=np.float64)
    if not np.isfinite(t).all():
        raise RecordingError(f"timestamp {int(np.argmin(np.isfinite(t)))} is not a finite number of seconds.")
    return np.rint(t * 1e9).astype(np.int64)
