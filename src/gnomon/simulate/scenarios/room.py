"""What to simulate of a camera and an IMU in a room without a board; it is also the recording's scenario file."""

from dataclasses import dataclass
from typing import Literal

from ...errors import OptionError
from ...options import check_ranges
from ..seen_board import TrueLens
from .camera_imu import CameraImuScenario, HandMotion, ImuPreset

Surface = Literal["rich", "plain", "repeated"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomScenario(TrueLens, HandMotion):
    """Cameras and an IMU that are waved together in a furnished room."""

    duration_s: float = 30.0
    """Length of the recording in seconds."""

    room_m: tuple[float, float, float] = (4.0, 2.6, 4.0)
    """Width, height and depth of the room in metres; the rig is waved in its middle."""

    furniture: int = 10
    """Boxes that stand about, up to arm's length from the rig."""

    surface: Surface = "rich"
    """What walls and furniture look like. rich: edges, spots and texture of all sizes. plain: painted evenly.
    repeated: the same tile again and again."""

    moving: int = 0
    """Further boxes, that move through the room."""

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
        if min(self.furniture, self.moving) < 0:
            raise OptionError("furniture and moving count boxes: give none or more.")
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
