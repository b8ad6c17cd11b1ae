"""The temperature of an IMU before a camera: what its biases do with it, where it both rose and fell."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...assess.imu.bias_steps import slope_finding
from ...estimate.camera_imu.result.bias_temperature import biases_along, control_times
from ...estimate.camera_imu.result.uncertainty import Uncertainty
from ...estimate.camera_imu.solution import Solution
from ...estimate.camera_imu.terms.inertial_data import InertialData, TriadData
from ...estimate.camera_imu.trajectory import BIAS
from ...estimate.multiposition.bias_changes import DECAYS
from ...estimate.multiposition.bias_segments import BENDS_K, WEAK_LAG_S
from ...frozen import value_class
from ...options.requirements import USUAL_SLOPE
from ...recording import Floats, Recording
from ...recording.thermometer import TemperatureCourse, temperature_course
from ...results.calibration import Calibration
from ...results.sensors import TemperatureDependence
from .camera_imu_preparation import PreparedCameraImu
from .temperature_while_turned import rose_and_fell, temperature_powers

_LIKELY = 1e-5
"""Probability by chance below which a bias follows the temperature."""


@value_class
class BiasesOverTemperature:
    """Slopes of the first IMU's biases: the dependence, and the covariance of each of its parts."""

    known: TemperatureDependence
    blocks: Mapping[str, Floats]

    def added_to(self, calibration: Calibration) -> Calibration:
        """Return the calibration with them, and what says how large they are."""
        if not self.blocks:
            return calibration
        findings = [
            slope_finding(part, getattr(self.known, part), own, self.known) for part, own in self.blocks.items()
        ]
        calibration = calibration.with_temperature(next(iter(calibration.imus)), self.known, self.blocks)
        assessed = calibration.assessment
        return replace(calibration, assessment=replace(assessed, findings=(*assessed.findings, *findings)))


def without_slopes(
    prepared: PreparedCameraImu, recording: Recording, known: TemperatureDependence
) -> PreparedCameraImu:
    """Return the readings without what the biases of the first IMU do with the temperature."""
    course = _course(recording)
    assert course is not None

    def without(data: InertialData, name: str) -> TriadData | None:
        triad: TriadData | None = getattr(data, name)
        degc = course.at(prepared.origin_ns + np.round(1e9 * data.t_s).astype(np.int64))
        return None if triad is None else replace(triad, values=triad.values - known.change(f"{name}_bias", degc))

    inertial = tuple(
        replace(data, **{name: without(data, name) for name in ("gyroscope", "accelerometer")})
        if not data.imu
        else data
        for data in prepared.inertial
    )
    return replace(prepared, inertial=inertial)


def biases_over_temperature(
    solution: Solution, certain: Uncertainty, recording: Recording, origin_ns: int, before: TemperatureDependence | None
) -> BiasesOverTemperature | None:
    """Return the slopes of the first IMU's biases where they are told.

    The biases stay means over the recording, which hold at its mean temperature. What they do with the temperature has
    to show beside their random walk and an exponential decay in time, whatever its time constant. Before it is taken
    off the readings it is among their errors and widens all sigmas: it has to show beside ordinary ones then, and once
    it is taken off beside those of clusters of time and of the walk that is left.

    Parameters
    ----------
    origin_ns : where the seconds of the trajectory start [ns]
    before : slopes that are taken off the readings already, to which what is found is added: no others are told
    """
    if (course := _course(recording)) is None:
        return None
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
        if before is not None and getattr(before, f"{triad}_bias") is None:
            continue
        taken = 0.0 if before is None else getattr(before, f"{triad}_bias").ravel()
        widened = 1.0 if before is None else _widened(solution, certain, scalars)
        told = [(found.ravel()[at] + taken, covariance[np.ix_(at, at)] * widened) for found, covariance in each]
        values, own = min(told, key=lambda one: one[0][:3] @ np.linalg.solve(one[1][:3, :3], one[0][:3]))
        if chdtrc(3, float(values[:3] @ np.linalg.solve(own[:3, :3], values[:3]))) < _LIKELY:
            known = replace(known, **{f"{triad}_bias": values.reshape(-1, 3)})
            blocks[f"{triad}_bias"] = own
    return BiasesOverTemperature(known=known, blocks=blocks)


def _course(recording: Recording) -> TemperatureCourse | None:
    """Return the temperature of the first IMU where it rose and fell."""
    samples = next(iter(recording.imus.values())).temperature
    return temperature_course(samples) if samples is not None and rose_and_fell(samples) else None


def _expected(count: int) -> Floats:
    """Return what is expected of the coefficients of slope, rate, higher powers and a decay, (count + 1, 6) [SI]."""
    usual = np.repeat([USUAL_SLOPE["gyroscope"], USUAL_SLOPE["accelerometer"]], 3)
    curves = [usual / BENDS_K**power for power in range(1, count - 1)]
    return np.array([30 * usual, 30 * WEAK_LAG_S * usual, *curves, 3000 * usual])


def _widened(solution: Solution, certain: Uncertainty, scalars: range) -> float:
    """Return by how much the variance is larger than levels of noise say: by clusters of time, and by the walk shown.

    A walk that is r times as strong as the prior Q makes the variance of p at most r^2 times as large.
    """
    at = len(certain.names) + np.array(scalars)
    clusters = float(np.mean(np.diag(certain.covariance)[at] / np.diag(certain.ordinary)[at]))
    triad = scalars.start // len(scalars)
    walk = solution.noise_found.walks[0][triad] / solution.noise.walks[0][triad]
    return max(clusters, walk**2, 1.0)
