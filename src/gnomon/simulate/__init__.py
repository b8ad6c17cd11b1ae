"""Truth -> Recording."""

from typing import TYPE_CHECKING

from .camera_imu_scenario import CameraImuScenario
from .scenario import Scenario

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..recording import Recording
    from .camera_imu import CameraImuSimulation

__all__ = ["CameraImuScenario", "Scenario", "simulate", "simulate_camera_imu"]


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
