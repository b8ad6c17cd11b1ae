"""Truth -> Recording."""

from typing import TYPE_CHECKING

from .camera_imu_scenario import CameraImuScenario
from .cameras_scenario import CamerasScenario
from .field_scenario import FieldScenario
from .plans import CameraImuPlan, ImuPlan
from .pose_scenario import PoseScenario
from .scenario import Scenario
from .turntable_scenario import TurntableScenario

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..recording import Recording
    from .camera_imu import CameraImuSimulation
    from .cameras import CamerasSimulation
    from .poses import PoseSimulation
    from .turntable import TurntableSimulation

__all__ = [
    "CameraImuPlan",
    "CameraImuScenario",
    "CamerasScenario",
    "FieldScenario",
    "ImuPlan",
    "PoseScenario",
    "Scenario",
    "TurntableScenario",
    "simulate",
    "simulate_camera_imu",
    "simulate_cameras",
    "simulate_magnetometer",
    "simulate_poses",
    "simulate_turntable",
]


def simulate(scenario: Scenario | None = None, seed: int = 0) -> "tuple[Recording, Calibration]":
    """Make a multi-position recording, and the calibration that is exactly true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    recording : one IMU, "imu0"
    truth : in body frame "accel-x", with zero covariance

    Examples
    --------
    >>> recording, truth = simulate(Scenario(intervals=12, t_init_s=20.0), seed=1)
    >>> round(recording.imus["imu0"].accelerometer.rate_hz)
    100
    >>> truth.frame
    'accel-x'
    """
    from .imu import simulate_imu  # NumPy is needed only here, not for the options

    return simulate_imu(scenario or Scenario(), seed)


def simulate_camera_imu(scenario: CameraImuScenario | None = None, seed: int = 0) -> "CameraImuSimulation":
    """Make a recording of cameras and an IMU that are waved together before a board, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    simulation : recording, target, and the truth about sensors, path, biases, frames and corners

    Raises
    ------
    OptionError
        If the scenario's lens or board is impossible.

    Examples
    --------
    >>> simulation = simulate_camera_imu(CameraImuScenario(duration_s=2.0), seed=1)
    >>> len(simulation.recording.cameras["cam0"].t_ns)
    40
    >>> float(simulation.truth_parameters["cam0.time_shift_cam_imu"])
    0.007
    """
    from .camera_imu import simulated_camera_imu

    return simulated_camera_imu(scenario or CameraImuScenario(), seed)


def simulate_cameras(scenario: CamerasScenario | None = None, seed: int = 0) -> "CamerasSimulation":
    """Make a recording of cameras that see a board in view after view, without an IMU, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    simulation : corners as a detector delivers them, the board, and the truth about lenses, poses and corners

    Raises
    ------
    OptionError
        If the scenario's lens or board is impossible, or the board does not fit into the image.

    Examples
    --------
    >>> simulation = simulate_cameras(CamerasScenario(views=12), seed=1)
    >>> len(simulation.recording.cameras["cam0"].t_ns), simulation.truth.frame
    (12, 'cam0')
    """
    from .cameras import simulate_cameras as simulated

    return simulated(scenario or CamerasScenario(), seed)


def simulate_poses(scenario: PoseScenario | None = None, seed: int = 0) -> "PoseSimulation":
    """Make an experiment in which a sensor lies still in one attitude after another, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None: document C's accelerometer in 18 poses
    seed : every random number follows from it; the same scenario and seed give the same experiment

    Returns
    -------
    simulation : samples and means of each pose, the attitudes, and the true calibration in body frame "accel-z"

    Examples
    --------
    >>> simulation = simulate_poses(PoseScenario(attitude_error_deg=10.0), seed=1)
    >>> simulation.accelerometer.shape, simulation.truth.frame
    ((18, 3), 'accel-z')
    """
    from .poses import simulated_poses

    return simulated_poses(scenario or PoseScenario(), seed)


def simulate_magnetometer(scenario: FieldScenario | None = None, seed: int = 0) -> "tuple[Recording, Calibration]":
    """Make a recording of a magnetometer that a hand turns over the sphere, and the calibration that is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    recording : one IMU, "imu0", with a magnetometer
    truth : in body frame "accel-x", or "mag-x" without accelerometer, with zero covariance; the field in uT

    Examples
    --------
    >>> recording, truth = simulate_magnetometer(FieldScenario(duration_s=20.0), seed=1)
    >>> len(recording.imus["imu0"].magnetometer), truth.frame
    (1000, 'accel-x')
    """
    from .magnetometer import simulated_magnetometer

    return simulated_magnetometer(scenario or FieldScenario(), seed)


def simulate_turntable(scenario: TurntableScenario | None = None, seed: int = 0) -> "TurntableSimulation":
    """Make recordings of a sensor on a turntable, and what is true of them.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None: document C's gyroscope on a record player at 16 rpm
    seed : every random number follows from it; the same scenario and seed give the same recordings

    Returns
    -------
    simulation : recordings, speeds, steady parts, and the truth in body frame "accel-x", "gyro-x" of a gyroscope alone

    Examples
    --------
    >>> simulation = simulate_turntable(TurntableScenario(poses=2, steady_s=8.0), seed=1)
    >>> len(simulation.recordings), simulation.truth.frame
    (1, 'accel-x')
    """
    from .turntable import simulated_turntable

    return simulated_turntable(scenario or TurntableScenario(), seed)
