"""The rig: board, cameras and IMU as they truly are, drawn at random where the scenario says so.

Table A.1 of Krebs is the default truth. It states one initial bias for each triad, which is taken for every axis,
and the gyroscope is turned by one degree about z.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..frozen import field_names, value_class
from ..geometry.rotations import Floats, rotation_from_quaternion, rotation_from_rotvec
from ..models.camera import Camera
from ..models.forms import DIAGONAL, FULL, LOWER
from ..models.gravity import EARTH_RATE_RAD_S
from ..models.target import Target
from ..recording.samples import ImuNoise
from ..results.calibration import AccelerometerCalibration, CameraCalibration, GyroscopeCalibration, ImuCalibration
from .scenarios.camera_imu import CameraImuScenario, ImuPreset

THESIS_NOISE = ImuNoise(
    accelerometer_noise_density=0.0039,
    accelerometer_random_walk=0.0012,
    gyroscope_noise_density=8.73e-5,
    gyroscope_random_walk=0.0087,
)
"""Table A.1 of Krebs, of the MPU-6000."""

CONSUMER_NOISE = ImuNoise(
    accelerometer_noise_density=2e-3,
    accelerometer_random_walk=3e-4,
    gyroscope_noise_density=1.7e-4,
    gyroscope_random_walk=2e-5,
)

NOISE: Mapping[ImuPreset, ImuNoise] = {"thesis": THESIS_NOISE, "consumer": CONSUMER_NOISE, "ideal": CONSUMER_NOISE}

_AXES_CAM_IMU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""The camera looks along the IMU's x axis, whose z axis points up."""

_TILT_CAM_IMU = np.array([0.03, -0.04, 0.05])
_P_CAM_IMU = np.array([0.103, -0.015, -0.010])
"""Table B.2 of Krebs."""

_TILT_CAM1_CAM0 = np.array([0.004, -0.012, 0.007])


@value_class
class ImuTruth:
    """The true parameters of Table 4.1 of Krebs, and the noise.

    accelerometer = S_a M_a f + b_a, gyroscope = S_g M_g C_bg' omega + B_g f + b_g, in the body frame "accel-x".

    Attributes
    ----------
    S_a, S_g : (3,) scale factors
    M_a, M_g : (3,) elements yz, zy, zx below the diagonal
    q_bg : (3,) rotation vector of C_bg [rad]
    B_g : (3, 3) [rad/s per m/s^2]
    places_m : (3, 3) where the x, y and z accelerometers sit, one row each, body frame
    b_a, b_g : (3,) initial biases [m/s^2], [rad/s]
    accelerometer_shift_s : t_gyroscope = t_accelerometer + accelerometer_shift_s [s]
    T_imu_body : (4, 4) of an IMU beside imu0, else None
    time_shift_s : t_body = t_imu + time_shift_s but for the offset of the clocks [s]
    clock_offset_ns : which is added to the timestamps
    separate_stamps : whether the accelerometer has timestamps of its own
    noise : densities and walks; each may be zero
    nominal : the same for who weighs measurements: where the true noise is zero, that of the preset
    """

    S_a: Floats
    M_a: Floats
    S_g: Floats
    M_g: Floats
    q_bg: Floats
    B_g: Floats
    places_m: Floats
    b_a: Floats
    b_g: Floats
    noise: Mapping[str, float]
    nominal: ImuNoise
    accelerometer_shift_s: float = 0.0
    T_imu_body: Floats | None = None
    time_shift_s: float = 0.0
    clock_offset_ns: int = 0
    separate_stamps: bool = False

    @property
    def C_bg(self) -> Floats:
        """Rotation from the gyroscope's frame to the body's, (3, 3)."""
        return rotation_from_rotvec(self.q_bg)

    def calibration(self, b_a: Floats, b_g: Floats) -> ImuCalibration:
        """Return the same in gnomon's form, with biases (3,) [m/s^2], [rad/s]."""
        apart = self.separate_stamps or bool(self.accelerometer_shift_s)
        return ImuCalibration(
            accelerometer=AccelerometerCalibration(
                sensitivity=DIAGONAL.matrix(self.S_a) @ LOWER.matrix(self.M_a),
                bias=b_a,
                unit="m/s^2",
                lever_arms_m=self.places_m if self.places_m.any() else None,
                time_shift_s=self.accelerometer_shift_s if apart else None,
            ),
            gyroscope=GyroscopeCalibration(
                sensitivity=DIAGONAL.matrix(self.S_g) @ LOWER.matrix(self.M_g) @ self.C_bg.T,
                bias=b_g,
                g_sensitivity=self.B_g,
                unit="rad/s",
            ),
            T_imu_body=self.T_imu_body,
            time_shift_s=self.time_shift_s - self.clock_offset_ns * 1e-9,
        )


def drawn_imu_truth(scenario: CameraImuScenario, rng: np.random.Generator, further: bool = False) -> ImuTruth:
    """Return the preset's IMU, with what the scenario wants drawn; all errors of one of the further IMUs."""
    # Everything is drawn, used or not: an option for one leaves the others as they are.
    draws = {name: rng.uniform(-1.0, 1.0, size) for name, size in _DRAWN.items()}
    ideal = scenario.imu == "ideal"

    def value(name: str, spread: float | None) -> Floats:
        centre = 1.0 if name.startswith("S_") else 0.0
        if spread is None and further and not ideal:
            spread = float(np.abs(TABLE_A1[name] - centre).max())
        if spread is not None:
            return centre + spread * draws[name]
        return np.full(_DRAWN[name], centre) if ideal else TABLE_A1[name]

    preset = NOISE[scenario.imu]
    noise: dict[str, float] = {}
    nominal: dict[str, float] = {}
    for name in field_names(ImuNoise):
        stated = getattr(scenario, name)
        noise[name] = scenario.noise_factor * (getattr(preset, name) if stated is None else stated)
        nominal[name] = noise[name] or getattr(preset, name)
    delay_s = scenario.further_accelerometer_delay_s if further else None
    return ImuTruth(
        S_a=value("S_a", scenario.scale_range),
        M_a=value("M_a", scenario.misalignment_range),
        S_g=value("S_g", scenario.scale_range),
        M_g=value("M_g", scenario.misalignment_range),
        q_bg=value("q_bg", scenario.gyroscope_rotation_range),
        B_g=FULL.matrix(value("B_g", scenario.g_sensitivity_range)),
        places_m=np.concatenate([np.zeros(3), scenario.accelerometer_arms_m or np.zeros(6)]).reshape(3, 3),
        b_a=value("b_a", scenario.accelerometer_bias_range),
        b_g=value("b_g", scenario.gyroscope_bias_range),
        noise=noise,
        nominal=ImuNoise(**nominal),
        accelerometer_shift_s=0.0 - (scenario.accelerometer_delay_s if delay_s is None else delay_s),
        separate_stamps=scenario.accelerometer_rate_hz is not None,
    )


def place_imu(scenario: CameraImuScenario, imu: ImuTruth, number: int, rng: np.random.Generator) -> ImuTruth:
    """Return imu1, imu2, ... with its pose and its clock.

    Parameters
    ----------
    scenario : what to simulate
    imu : its errors
    number : 1, 2, ...
    rng : for what the scenario wants drawn
    """
    direction, length, turn, shift = rng.standard_normal(3), rng.random(), rng.standard_normal(4), rng.uniform(-1, 1)
    place = scenario.imu_place_range_m * np.cbrt(length) * direction / np.linalg.norm(direction)
    R_imu_body = rotation_from_quaternion(turn / np.linalg.norm(turn))
    if number <= len(scenario.imu_places_m):
        place = np.array(scenario.imu_places_m[number - 1])
    if number <= len(scenario.imu_rotations_deg):
        R_imu_body = rotation_from_rotvec(np.radians(scenario.imu_rotations_deg[number - 1]))
    time_shift_s = number * scenario.imu_time_shift_s
    if scenario.imu_time_shift_range_s is not None:
        time_shift_s = scenario.imu_time_shift_range_s * shift
    return replace(
        imu,
        T_imu_body=_transform(R_imu_body, -R_imu_body @ place),
        time_shift_s=time_shift_s,
        clock_offset_ns=round(number * scenario.imu_clock_offset_s * 1e9),
    )


_DRAWN = {"S_a": 3, "M_a": 3, "S_g": 3, "M_g": 3, "q_bg": 3, "B_g": 9, "b_a": 3, "b_g": 3}

TABLE_A1: dict[str, Floats] = {
    "S_a": np.array([1.001, 1.0008, 0.9986]),
    "M_a": np.array([0.0052, -0.0017, 0.0026]),
    "S_g": np.array([1.002, 0.999, 1.0011]),
    "M_g": np.array([0.0035, -0.0026, -0.0044]),
    "q_bg": np.array([0.0, 0.0, np.radians(1.0)]),
    "B_g": np.array([-0.0012, 0.0008, 0.0015, -0.0013, 0.0001, -0.0014, 0.0016, 0.0013, -0.0009]),
    "b_a": np.full(3, 0.491),
    "b_g": np.full(3, 0.02),
}


def drawn_cameras(scenario: CameraImuScenario, rng: np.random.Generator) -> dict[str, CameraCalibration]:
    """Return the true cameras; their time shifts do not hold the offset of the clocks yet."""
    direction, length, turn, shift = rng.standard_normal(3), rng.random(), rng.standard_normal(4), rng.uniform(-1, 1)
    T_cam_imu = nominal_extrinsics()
    if scenario.random_extrinsics:
        T_cam_imu[:3, :3] = rotation_from_quaternion(turn / np.linalg.norm(turn))
        T_cam_imu[:3, 3] = scenario.lever_arm_m * np.cbrt(length) * direction / np.linalg.norm(direction)
    time_shift_s = scenario.time_shift_s
    if scenario.time_shift_range_s is not None:
        time_shift_s = scenario.time_shift_range_s * shift
    cameras = {
        "cam0": CameraCalibration(T_cam_body=T_cam_imu, time_shift_cam_imu=time_shift_s, camera=true_lens(scenario))
    }
    if scenario.cameras == 2:
        T_cam1_cam0 = _transform(rotation_from_rotvec(_TILT_CAM1_CAM0), np.array([-scenario.baseline_m, 0.0, 0.0]))
        cameras["cam1"] = CameraCalibration(
            T_cam_body=T_cam1_cam0 @ T_cam_imu,
            time_shift_cam_imu=time_shift_s + scenario.time_shift_difference_s,
            camera=true_lens(scenario),
        )
    return cameras


def nominal_extrinsics() -> Floats:
    """Return T_cam_imu (4, 4) where none is drawn."""
    return _transform(_AXES_CAM_IMU @ rotation_from_rotvec(_TILT_CAM_IMU), _P_CAM_IMU)


def _transform(R: Floats, p: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def true_lens(scenario: CameraImuScenario) -> Camera:
    """Return the true camera."""
    return Camera(
        projection=scenario.projection,
        intrinsics=np.array(scenario.intrinsics),
        distortion=scenario.distortion,
        distortion_coeffs=np.array(scenario.distortion_coeffs),
        resolution=scenario.resolution,
        line_delay_s=scenario.line_delay_s,
    )


def stated_lens(scenario: CameraImuScenario, topic: str) -> Camera:
    """Return the camera that goes with the recording, with the errors that the scenario wants."""
    intrinsics = np.array(scenario.intrinsics)
    intrinsics[-4:-2] *= 1 + scenario.focal_error
    intrinsics[-2:] += scenario.principal_point_error_px
    line_delay_s = scenario.line_delay_s if scenario.known_line_delay else 0.0
    coeffs, distortion = np.array(scenario.distortion_coeffs), scenario.distortion
    if scenario.distortion_error:
        coeffs = coeffs + scenario.distortion_error
    if distortion == "radtan5" and not scenario.known_k3:
        coeffs, distortion = coeffs[:4], "radtan"
    return replace(
        true_lens(scenario),
        intrinsics=intrinsics,
        distortion=distortion,
        distortion_coeffs=coeffs,
        line_delay_s=line_delay_s,
        topic=topic,
    )


def corner_offsets(scenario: CameraImuScenario, target: Target, rng: np.random.Generator) -> Floats:
    """Return how far the corners of the true board are off their places, (k, 3) [m], the board as a whole apart."""
    points = target.points
    offsets = scenario.corner_offset_m * rng.standard_normal(points.shape)
    centred = points - points.mean(axis=0)
    far = np.sum(centred**2, axis=1) / np.max(np.sum(centred**2, axis=1))
    offsets[:, 2] += scenario.board_bow_m * (1 - far)
    return beside_the_whole(offsets, points)


def beside_the_whole(offsets: Floats, points: Floats) -> Floats:
    """Return offsets (k, 3) of a board's points without what moves, turns or scales the board as a whole."""
    centred = points - points.mean(axis=0)
    whole = [np.tile(axis, (len(points), 1)) for axis in np.eye(3)]
    whole += [np.cross(axis, centred) for axis in np.eye(3)] + [centred]
    basis = np.linalg.qr(np.array([move.ravel() for move in whole]).T)[0]
    return (offsets.ravel() - basis @ (basis.T @ offsets.ravel())).reshape(-1, 3)


def gravity_target(scenario: CameraImuScenario) -> Floats:
    """Return gravity in the target's frame, (3,) [m/s^2]: down is -y of an upright board."""
    lean, turn = np.radians(scenario.board_lean_deg), np.radians(scenario.board_turn_deg)
    down = np.array([np.sin(turn) * np.cos(lean), -np.cos(turn) * np.cos(lean), -np.sin(lean)])
    return scenario.gravity * down


def earth_rate_target(scenario: CameraImuScenario) -> Floats:
    """Return the Earth's rate in the target's frame, (3,) [rad/s]: the viewer looks north."""
    if scenario.earth_rate_latitude is None:
        return np.zeros(3)
    up = -gravity_target(scenario) / scenario.gravity
    # away from the viewer; if the board lies flat, what is its upper edge
    ahead = np.array([0.0, 0.0, -1.0]) if abs(up[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    north = ahead - (ahead @ up) * up
    latitude = np.radians(scenario.earth_rate_latitude)
    return EARTH_RATE_RAD_S * (np.cos(latitude) * north / np.linalg.norm(north) + np.sin(latitude) * up)
