"""What to simulate of cameras and an IMU before a board; it is also the simulated recording's scenario file.

What to simulate of a camera and an IMU in a room without a board; it is also the recording's scenario file.
"""

from dataclasses import dataclass
from typing import Literal

from ...errors import OptionError
from ...options import check_ranges
from .cameras import DISTORTION_COEFFS, RenderedImages, SeenBoard, TrueLens

HandMotionName = Literal[
    "gentle", "normal", "tremor", "shaky", "static", "one-axis", "translation", "rolling", "around", "slow"
]
MotionName = Literal[HandMotionName, "walk"]
ImuPreset = Literal["thesis", "consumer", "ideal"]

MOST_IMUS = 8


@dataclass(frozen=True, kw_only=True)
class HandMotion:
    """How long cameras and IMU are waved, how, and at which rates they measure."""

    duration_s: float = 60.0
    """Length of the recording in seconds; 90 in Krebs."""

    motion: MotionName = "normal"
    """gentle: Krebs's mean rate 0.366 rad/s and acceleration 3.12 m/s^2. normal: by hand, up to 2.5 Hz. tremor:
    normal with a tremor up to 12 Hz. shaky: up to 20 Hz and 10 m/s^2. rolling: normal while turning over and over about
    the optical axis. around: normal while turning to all sides, for a room instead of a board. translation: without any
    turn. one-axis: turns about the optical axis alone. slow: 0.05 rad/s and hardly any acceleration, as who fears blur
    does. static: at rest. walk: carried once round an ellipse at 1.0 to 1.4 m/s, for a room."""

    imu_rate_hz: float = 200.0
    """Sample rate of the IMU."""

    camera_rate_hz: float = 20.0
    """Frame rate of the cameras."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImuScenario(RenderedImages, TrueLens, SeenBoard, HandMotion):
    """Cameras and an IMU that are waved together before a board (Krebs, section 5.1)."""

    board_bow_m: float = 0.0
    """How far the middle of the board bulges towards the viewer against its corners, in metres."""

    board_lean_deg: float = 3.0
    """How far the board's upper edge leans away from the viewer, in degrees; 90 lies on the floor."""

    board_turn_deg: float = 1.2
    """How far the board is turned in its plane, in degrees."""

    distance_m: float = 0.9
    """Mean distance from the camera to the middle of the board in metres."""

    focal_error: float = 0.0
    """By which fraction the focal length that goes with the recording is too long."""

    principal_point_error_px: float = 0.0
    """By how many px the principal point that goes with the recording is off, in u and v."""

    distortion_error: tuple[float, ...] = ()
    """By how much the coefficients of the distortion that go with the recording are off, one number each or none."""

    known_k3: bool = True
    """Whether the camera that goes with the recording states the k3 of radtan5, or is radtan."""

    pixel_noise_px: float = 0.3
    """Standard deviation of a detected corner, per axis."""

    exposure_s: float = 0.004
    """Exposure time of the images in seconds; timestamps are of its middle."""

    line_delay_s: float = 0.0
    """Time from one image row to the next in seconds (rolling shutter)."""

    known_line_delay: bool = True
    """Whether the camera that goes with the recording states the line delay, or none."""

    cameras: Literal[1, 2] = 1
    """Number of cameras."""

    synchronous_cameras: bool = True
    """Whether the cameras expose at the same instants, or each begins when it likes."""

    baseline_m: float = 0.11
    """Distance of the second camera from the first in metres, to its right."""

    random_extrinsics: bool = False
    """Draw T_cam_imu, any rotation, instead of a camera that looks along the IMU's x axis."""

    lever_arm_m: float = 0.3
    """Longest distance between the IMU and the camera that is drawn, in metres."""

    accelerometer_arms_m: tuple[float, ...] = ()
    """Where the y and z accelerometers sit from the x accelerometer, which is the body's origin: x y z of the one, then
    of the other, body frame, in metres. Without them all three sit at one point."""

    time_shift_s: float = 0.007
    """t_imu - t_cam of cam0 in seconds."""

    time_shift_range_s: float | None = None
    """Draw the time shift between minus and plus this instead, in seconds."""

    time_shift_difference_s: float = 0.002
    """How much larger the time shift of the second camera is, in seconds."""

    clock_offset_s: float = 0.0
    """Added to the cameras' timestamps: clocks of unrelated origin."""

    clock_offset_difference_s: float = 0.0
    """How much more is added to the timestamps of the second camera."""

    imus: int = 1
    """Number of IMUs; the first one, imu0, is the body."""

    further_imu_rate_hz: float | None = None
    """Sample rate of the IMUs after the first, in place of imu_rate_hz."""

    imu_places_m: tuple[tuple[float, float, float], ...] = ()
    """Where imu1, imu2, ... sit, x y z in the frame of imu0 in metres; those that are not stated are drawn."""

    imu_place_range_m: float = 0.15
    """Longest distance from imu0 that is drawn, in metres."""

    imu_rotations_deg: tuple[tuple[float, float, float], ...] = ()
    """How imu1, imu2, ... are turned: rotation vectors of R_imu_body in degrees; those that are not stated are drawn,
    any rotation."""

    imu_time_shift_s: float = 0.004
    """t_imu0 - t_imu1 in seconds; of imu2 twice as much, and so on."""

    imu_time_shift_range_s: float | None = None
    """Draw the time shift of each of the further IMUs between minus and plus this instead, in seconds."""

    imu_clock_offset_s: float = 0.0
    """Added to the timestamps of imu1, twice to those of imu2, and so on: clocks of unrelated origin."""

    accelerometer_rate_hz: float | None = None
    """Sample rate of the accelerometers where they have timestamps of their own; else they share the gyroscopes'."""

    accelerometer_delay_s: float = 0.0
    """How much older than its timestamp a reading of the accelerometer is, against one of the gyroscope, in seconds."""

    further_accelerometer_delay_s: float | None = None
    """The same of the IMUs after the first, in place of accelerometer_delay_s."""

    gravity: float = 9.80665
    """Local gravity in m/s^2."""

    earth_rate_latitude: float | None = None
    """Latitude in degrees where the Earth turns below the recording, whose viewer looks north; without it the Earth
    stands still."""

    imu: ImuPreset = "consumer"
    """True errors and noise of the IMU. thesis: Table A.1 of Krebs. consumer: the same errors, noise of a good
    consumer sensor. ideal: no errors, the same noise. Further IMUs have the same noise, and errors of that size that
    are drawn."""

    accelerometer_noise_density: float | None = None
    """White noise in m/s^2/sqrt(Hz), in place of the preset's."""

    accelerometer_random_walk: float | None = None
    """Walk of the bias in m/s^2/sqrt(s), in place of the preset's."""

    gyroscope_noise_density: float | None = None
    """White noise in rad/s/sqrt(Hz), in place of the preset's."""

    gyroscope_random_walk: float | None = None
    """Walk of the bias in rad/s/sqrt(s), in place of the preset's; Table A.1 can be read as 0.0087 or far less."""

    noise_factor: float = 1.0
    """Multiplies all noise and walk of the IMU; 1, 0.1 and 0.01 in Krebs."""

    scale_range: float | None = None
    """Draw the elements of S_a and S_g between 1 minus and plus this, in place of the preset's."""

    misalignment_range: float | None = None
    """Draw the elements of M_a and M_g between minus and plus this, in place of the preset's."""

    gyroscope_rotation_range: float | None = None
    """Draw the rotation vector of C_bg, each component between minus and plus this in radians."""

    g_sensitivity_range: float | None = None
    """Draw the elements of B_g between minus and plus this, in rad/s per m/s^2."""

    accelerometer_bias_range: float | None = None
    """Draw the initial bias between minus and plus this, in m/s^2, in place of the preset's."""

    gyroscope_bias_range: float | None = None
    """Draw the initial bias between minus and plus this, in rad/s, in place of the preset's."""

    accelerometer_range: float | None = None
    """Full scale of the accelerometer in m/s^2; readings stop there."""

    gyroscope_range: float | None = None
    """Full scale of the gyroscope in rad/s; readings stop there."""

    dropped_samples: float = 0.0
    """Fraction of the IMU's samples that are lost, one by one."""

    imu_jitter_s: float = 0.0
    """Standard deviation of the IMU's timestamps about the instants of sampling, in seconds."""

    imu_gaps_s: tuple[tuple[float, float], ...] = ()
    """Start and length of times without IMU samples, in seconds from the start."""

    outliers: float = 0.0
    """Fraction of the corners that are detected in a wrong place."""

    outlier_px: float = 10.0
    """Mean distance of such a wrong place, in px; from half to one and a half of it."""

    dropped_frames: float = 0.0
    """Fraction of the frames that are lost, one by one."""

    late_frames: float = 0.0
    """Fraction of the frames whose timestamp is 5 to 20 ms late."""

    shifted_frames: float = 0.0
    """Fraction of the frames all of whose corners are shifted by the same vector."""

    shift_px: float = 5.0
    """Length of that vector in px."""

    camera_jitter_s: float = 0.0
    """Standard deviation of the cameras' timestamps about the instants of exposure, in seconds."""

    camera_gaps_s: tuple[tuple[float, float], ...] = ()
    """Start and length of times without frames, in seconds from the start."""

    trajectory_seed: int | None = None
    """Draw the path and the instants of exposure from this seed, so that many recordings of one path can be made."""

    sensor_seed: int | None = None
    """Draw errors, initial biases, extrinsics and time shift from this seed, so that many recordings of one rig can be
    made."""

    def __post_init__(self) -> None:
        check_ranges(self, positive=_POSITIVE, not_negative=_NOT_NEGATIVE, fractions=_FRACTIONS)
        if self.scale_range is not None and self.scale_range >= 1:
            raise OptionError(f"scale_range {self.scale_range:g}: a scale of zero or less measures nothing.")
        if self.focal_error <= -1:
            raise OptionError(f"focal_error {self.focal_error:g} must be above -1.")
        self.check_lens()
        self._check_distortion_error()
        for name in ("imu_gaps_s", "camera_gaps_s"):
            for start, length in getattr(self, name):
                if not (start >= 0 and length > 0):
                    raise OptionError(f"{name} {start:g} {length:g}: give start and length, neither below zero.")
        if self.target_cols < 2 or self.target_rows < 2:
            raise OptionError(f"a board of {self.target_cols} x {self.target_rows} is too small; give at least 2 x 2.")
        if len(self.accelerometer_arms_m) not in (0, 6):
            raise OptionError(
                f"accelerometer_arms_m: give 6 numbers, x y z of the y and of the z accelerometer, or none; found "
                f"{len(self.accelerometer_arms_m)}."
            )
        self._check_imus()
        rates = (self.imu_rate_hz, self.camera_rate_hz, self.further_imu_rate_hz, self.accelerometer_rate_hz)
        if self.duration_s * min(rate for rate in rates if rate is not None) < 2:
            raise OptionError(f"duration_s {self.duration_s:g} is too short for two samples.")

    def _check_imus(self) -> None:
        if not 1 <= self.imus <= MOST_IMUS:
            raise OptionError(f"imus {self.imus}: give a number from 1 to {MOST_IMUS}.")
        for name in ("imu_places_m", "imu_rotations_deg"):
            stated = getattr(self, name)
            if len(stated) > self.imus - 1:
                raise OptionError(f"{name}: found {len(stated)} of them for {self.imus - 1} IMUs beside imu0.")

    def _check_distortion_error(self) -> None:
        wanted = DISTORTION_COEFFS[self.distortion]
        if len(self.distortion_error) not in (0, wanted):
            raise OptionError(
                f"distortion_error: {self.distortion} has {wanted} coefficients, found {len(self.distortion_error)}."
            )


_POSITIVE = "target_size_m target_scale distance_m accelerometer_range gyroscope_range marker_share"
_NOT_NEGATIVE = """
    target_spacing pixel_noise_px line_delay_s lever_arm_m time_shift_range_s corner_offset_m blur_px image_noise
    defocus_px shot_noise accelerometer_noise_density accelerometer_random_walk gyroscope_noise_density
    gyroscope_random_walk noise_factor scale_range misalignment_range gyroscope_rotation_range g_sensitivity_range
    accelerometer_bias_range gyroscope_bias_range outlier_px shift_px imu_jitter_s camera_jitter_s imu_place_range_m
    imu_time_shift_range_s
"""
_FRACTIONS = "vignetting dropped_samples outliers dropped_frames late_frames shifted_frames"


Surface = Literal["rich", "plain", "repeated"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomScenario(TrueLens, HandMotion):
    """Cameras and an IMU that are waved together in a furnished room."""

    duration_s: float = 30.0
    """Length of the recording in seconds."""

    room_m: tuple[float, float, float] = (4.0, 2.6, 4.0)
    """Width, height and depth of the room in metres; the rig is waved in its middle. A walk widens it."""

    furniture: int = 10
    """Boxes that stand about, up to arm's length from the rig, or of both sides of its way."""

    surface: Surface = "rich"
    """What walls and furniture look like. rich: edges, spots and texture of all sizes. plain: painted evenly.
    repeated: the same tile again and again."""

    moving: int = 0
    """Further boxes, that move through the room."""

    people: int = 0
    """People, as boxes of their size, who walk up and down before the rig."""

    mirror: bool = False
    """The wall that the rig faces is a mirror."""

    exposure_s: float = 0.004
    """Exposure time of the images in seconds; timestamps are of its middle."""

    line_delay_s: float = 0.0
    """Time from one image row to the next in seconds (rolling shutter)."""

    blur_px: float = 0.6
    """Standard deviation of the blur of lens and focus in the images, in px."""

    image_noise: float = 2.0
    """Standard deviation of the noise in the images, in grey levels."""

    light: float = 1.0
    """How bright the images are; 1 is well exposed."""

    cameras: Literal[1, 2] = 1
    """Number of cameras."""

    baseline_m: float = 0.11
    """Distance of the second camera from the first in metres, to its right."""

    random_extrinsics: bool = False
    """Draw T_cam_imu, any rotation, instead of a camera that looks along the IMU's x axis."""

    time_shift_s: float = 0.007
    """t_imu - t_cam in seconds."""

    imu: ImuPreset = "consumer"
    """True errors and noise of the IMU. thesis: Table A.1 of Krebs, an MPU-6000. consumer: the same errors, noise of a
    good consumer sensor. ideal: no errors, the same noise."""

    noise_factor: float = 1.0
    """Multiplies all noise and walk of the IMU."""

    gyroscope_random_walk: float | None = None
    """Walk of the bias in rad/s/sqrt(s), in place of the preset's."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="light", not_negative="exposure_s line_delay_s blur_px image_noise noise_factor")
        if min(self.room_m) < _NARROWEST_M:
            raise OptionError(f"room_m {min(self.room_m):g}: a rig is not waved in less than {_NARROWEST_M:g} m.")
        if min(self.furniture, self.moving, self.people) < 0:
            raise OptionError("furniture, moving and people are numbers: give none or more.")
        self.rig()

    def rig(self) -> CameraImuScenario:
        """Return the rig and its motion, in the middle of the room's frame: x to the right, y up, z to the viewer."""
        shared = {name: getattr(self, name) for name in _SHARED.split()}
        return CameraImuScenario(**shared, board_lean_deg=0.0, board_turn_deg=0.0, images=True)


_NARROWEST_M = 1.6
_SHARED = """
    duration_s motion imu_rate_hz camera_rate_hz projection intrinsics distortion distortion_coeffs resolution
    exposure_s line_delay_s blur_px image_noise cameras baseline_m random_extrinsics time_shift_s imu noise_factor
    gyroscope_random_walk
"""
