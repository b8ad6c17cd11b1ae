"""Truth -> Recording."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..recording import Recording
    from ..results.calibration import Calibration
    from .camera_imu import simulate_camera_imu
    from .cameras import simulate_cameras
    from .imu import simulate_poses
    from .magnetometer import simulate_magnetometer
    from .planned import CameraImuPlan, ImuPlan
    from .scenarios.camera_imu import CameraImuScenario, RoomScenario
    from .scenarios.cameras import CamerasScenario
    from .scenarios.recorded import FieldScenario, PoseScenario, Scenario
    from .scenarios.turntable import TurntableScenario
    from .turntable import simulate_turntable

_HOMES = {
    "CameraImuPlan": "planned",
    "CameraImuScenario": "scenarios.camera_imu",
    "CamerasScenario": "scenarios.cameras",
    "FieldScenario": "scenarios.recorded",
    "ImuPlan": "planned",
    "PoseScenario": "scenarios.recorded",
    "RoomScenario": "scenarios.camera_imu",
    "Scenario": "scenarios.recorded",
    "TurntableScenario": "scenarios.turntable",
    "simulate_poses": "imu",
}

__all__ = [
    "CameraImuPlan",
    "CameraImuScenario",
    "CamerasScenario",
    "FieldScenario",
    "ImuPlan",
    "PoseScenario",
    "RoomScenario",
    "Scenario",
    "TurntableScenario",
    "simulate",
    "simulate_camera_imu",
    "simulate_cameras",
    "simulate_magnetometer",
    "simulate_poses",
    "simulate_turntable",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    # Imported when they are used: NumPy is not needed for the options, and few commands need all of these.
    value = getattr(import_module(f".{_HOMES.get(name, name.removeprefix('simulate_'))}", __name__), name)
    globals()[name] = value
    return value


def simulate(scenario: "Scenario | None" = None, seed: int = 0) -> "tuple[Recording, Calibration]":
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
    from .imu import simulate_imu
    from .scenarios.recorded import Scenario

    return simulate_imu(scenario or Scenario(), seed)
