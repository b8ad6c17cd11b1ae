"""The temperature of an IMU before a camera: what its biases do with it, where it both rose and fell."""

from dataclasses import replace

import numpy as np

from ...assess.imu.bias_steps import slope_finding
from ...estimate.camera_imu.result.bias_temperature import biases_along, control_times
from ...estimate.camera_imu.result.uncertainty import Uncertainty
from ...estimate.camera_imu.solution import Solution
from ...estimate.camera_imu.trajectory import BIAS
from ...estimate.multiposition.bias_changes import DECAYS
from ...estimate.multiposition.bias_segments import BENDS_K, WEAK_LAG_S
from ...findings import Finding
from ...options.requirements import USUAL_SLOPE
from ...recording import Floats, Recording
from ...recording.thermometer import temperature_course
from ...results.calibration import Calibration
from ...results.sensors import TemperatureDependence
from .temperature_while_turned import rose_and_fell, temperature_powers

_LIKELY = 1e-5
"""Probability by chance below which a bias follows the temperature."""


def biases_over_temperature(
    calibration: Calibration, solution: Solution, certain: Uncertainty, recording: Recording, origin_ns: int
) -> tuple[Calibration, list[Finding]]:
    """Return the calibration with the slopes of the first IMU's biases where they are told, and say how large they are.

    The biases stay means over the recording, which hold at its mean temperature. What they do with the temperature has
    to show beside their random walk and an exponential decay in time, whatever its time constant.

    Parameters
    ----------
    origin_ns : where the seconds of the trajectory start [ns]
    """
    (name, sensor), samples = next(iter(calibration.imus.items())), next(iter(recording.imus.values())).temperature
    course = temperature_course(samples) if samples is not None and rose_and_fell(samples) else None
    if course is None or sensor.accelerometer is None or sensor.gyroscope is None:
        return calibration, []
    from scipy.special import chdtrc  # on demand  # pyright: ignore[reportMissingTypeStubs]

    grid = solution.state.trajectory.grid
    t_ns = origin_ns + np.round(1e9 * control_times(grid)).astype(np.int64)
    degc = course.with_rate(t_ns)
    resting = degc[grid.knot_times()[0], 0]
    powers = temperature_powers(degc, resting, course.step_k)[:, :-1]  # sigmas are too large for that one to count
    since = (t_ns - t_ns[0]) / np.ptp(t_ns)
    decays = [np.exp(-since / tau)[:, None] for tau in DECAYS]
    each = [biases_along(solution, np.hstack([powers, decay]), _expected(powers.shape[1])) for decay in decays]
    kept = [0, *range(2, powers.shape[1] - 1)]  # not the rate, nor the highest power: they are there for what they hide
    known = TemperatureDependence(
        reference_degc=float(resting.mean()), low_degc=float(resting.min()), high_degc=float(resting.max())
    )
    blocks: dict[str, Floats] = {}
    for triad, scalars in (("accelerometer", range(3, 6)), ("gyroscope", range(3))):  # as the covariance lists them
        at = np.array([power * BIAS + scalar for power in kept for scalar in scalars])
        told = [
            (found.ravel()[at], covariance[np.ix_(at, at)] * _widened(certain, scalars)) for found, covariance in each
        ]
        values, own = min(told, key=lambda one: one[0][:3] @ np.linalg.solve(one[1][:3, :3], one[0][:3]))
        if chdtrc(3, float(values[:3] @ np.linalg.solve(own[:3, :3], values[:3]))) < _LIKELY:
            known = replace(known, **{f"{triad}_bias": values.reshape(-1, 3)})
            blocks[f"{triad}_bias"] = own
    if not blocks:
        return calibration, []
    findings = [slope_finding(part, getattr(known, part), own, known) for part, own in blocks.items()]
    return calibration.with_temperature(name, known, blocks), findings


def _expected(count: int) -> Floats:
    """Return what is expected of the coefficients of slope, rate, higher powers and a decay, (count + 1, 6) [SI]."""
    usual = np.repeat([USUAL_SLOPE["gyroscope"], USUAL_SLOPE["accelerometer"]], 3)
    curves = [usual / BENDS_K**power for power in range(1, count - 1)]
    return np.array([30 * usual, 30 * WEAK_LAG_S * usual, *curves, 3000 * usual])


def _widened(certain: Uncertainty, scalars: range) -> float:
    """Return by how much clusters of time widen the variance of the mean bias."""
    at = len(certain.names) + np.array(scalars)
    ratio = np.diag(certain.covariance)[at] / np.diag(certain.ordinary)[at]
    return float(max(np.mean(ratio), 1.0))
