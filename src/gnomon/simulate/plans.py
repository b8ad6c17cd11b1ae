"""What a person means to record; `gnomon plan` and `gnomon plan-imu` are made from these classes."""

from typing import Literal

from ..errors import OptionError
from ..frozen import value_class
from ..options import check_ranges
from .scenarios.camera_imu import HandMotionName

PlannedMotion = HandMotionName | Literal["planar"]


@value_class(eq=True)
class CameraImuPlan:
    """How cameras and an IMU are to be waved before a board."""

    duration_s: float = 60.0
    """Length of the recording in seconds."""

    motion: PlannedMotion = "normal"
    """How it is waved, as in gnomon simulate camera-imu: gentle, normal, tremor, shaky, rolling, translation, one-axis,
    slow, static; or planar: turned about the vertical and moved in the plane of the floor, as a vehicle does."""

    turning: float = 1.0
    """How much more briskly it is turned than that motion does by itself."""

    shaking: float = 1.0
    """How much more strongly it is moved to and fro."""

    turn_axes: str = "xyz"
    """Axes of the camera about which it is turned: x to the right, y down, z forward."""

    distance_m: float = 0.9
    """Mean distance from the camera to the middle of the board in metres."""

    camera_rate_hz: float = 20.0
    """Frame rate of the cameras."""

    imu_rate_hz: float | None = None
    """Sample rate of the IMU in Hz; as imu.yaml states it, or 200."""

    pixel_sigma: float = 0.3
    """Standard deviation of a detected corner in px, per axis."""

    model: Literal["basic", "scale-misalignment", "full"] = "full"
    """Model of the IMU that is to be estimated, as in gnomon camera-imu."""

    free: tuple[str, ...] = ()
    """Parameters to estimate that are fixed otherwise, such as cam0.intrinsics, as in gnomon camera-imu."""

    fix: tuple[str, ...] = ()
    """Parameters that are not to be estimated, such as imu0.B_g."""

    prior: tuple[str, ...] = ()
    """Parameters to estimate with a prior, NAME=SIGMA, such as cam0.intrinsics=2."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees; where it is stated, gravity is known."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="distance_m", not_negative="turning shaking")
        if set(self.turn_axes) - set("xyz") or len(set(self.turn_axes)) < len(self.turn_axes):
            raise OptionError(f'turn_axes "{self.turn_axes}": name axes of the camera, such as xyz or z.')
        if self.duration_s > 3600:
            raise OptionError(f"duration_s {self.duration_s:g}: plan an hour at most; sigmas fall as its square root.")
        if self.duration_s * self.camera_rate_hz < 3:
            raise OptionError(f"duration_s {self.duration_s:g}: that is less than three frames.")


@value_class(eq=True)
class ImuPlan:
    """How an IMU is to be turned by hand into many attitudes, at rest in each."""

    intervals: int = 40
    """Attitudes in which it rests, the first one included."""

    t_init_s: float = 50.0
    """Length of the first rest in seconds."""

    hold_s: float = 4.0
    """Length of the other rests in seconds."""

    motion_s: float = 2.25
    """Length of a turn from one attitude to the next in seconds."""

    attitudes: Literal["sphere", "one-axis"] = "sphere"
    """sphere: each axis points up, down and level, and between. one-axis: tilted about the y axis alone."""

    rate_hz: float = 100.0
    """Sample rate in Hz."""

    model: Literal["basic", "g-sensitivity"] = "g-sensitivity"
    """Gyroscope bias that is to be estimated: constant (basic), or linear in the specific force."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees; where it is stated, gravity and the Earth's rate are known."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="t_init_s hold_s motion_s")
        if not 10 <= self.intervals <= 1000:
            raise OptionError(f"intervals {self.intervals}: plan 10 to 1000; 36 to 50 are best.")
