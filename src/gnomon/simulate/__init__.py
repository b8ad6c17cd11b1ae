"""Truth -> Recording."""

from typing import TYPE_CHECKING

from .scenario import Scenario

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..recording import Recording

__all__ = ["Scenario", "simulate"]


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
