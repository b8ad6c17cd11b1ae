"""What cameras saw of a board: corners, frame by frame, and how good each image was.

Cameras that were recorded as images: streams of frames that are decoded only where they are needed.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from ..frozen import FrozenMapping, value_class
from ..models.camera import Camera
from .samples import Floats, Integers, frozen_array


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
