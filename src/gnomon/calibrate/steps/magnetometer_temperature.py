"""What the offsets and scales of a magnetometer do with a temperature that rose and fell while it was turned."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...assess.imu.recording_changes import slope_finding
from ...estimate.temperature.bias_course import FEWEST_FOR_COURSE, bias_course
from ...estimate.triads.field_poses import FieldPoses
from ...estimate.triads.magnetometer import MagnetometerFit, drift_over, drift_rows, field_windows
from ...frozen import value_class
from ...recording import Floats, Integers, TemperatureSamples
from ...recording.thermometer import temperature_course
from ...results.calibration import Calibration
from ...results.temperature_dependence import TemperatureDependence
from .temperature_while_turned import temperature_powers

_PARTS = ("magnetometer_bias", "magnetometer_sensitivity")  # as the covariance lists them
_MOST = 0.3  # that a scale changes


@value_class
class FieldOverTemperature:
    """What offsets and scales do with the temperature.

    Attributes
    ----------
    known : the dependence
    covariances : of each part that changes, of its coefficients power by power, (3 k, 3 k); of scales the three alone
    degc : (m,) temperature of all samples [degC]
    """

    known: TemperatureDependence
    degc: Floats
    covariances: Mapping[str, Floats]

    def widened(self, fit: MagnetometerFit, poses: FieldPoses) -> MagnetometerFit:
        """Return a fit whose parameters know how uncertain this is."""
        d = self.degc[_middle(poses)] - self.known.reference_degc
        rows, shifts = drift_rows(poses, fit), list[Floats]()
        for part, covariance in self.covariances.items():
            own = rows[:, :3] if part.endswith("_bias") else rows[:, 3:]
            powers = [d ** (j + 1) for j in range(len(covariance) // 3)]
            spread, axes = np.linalg.eigh(covariance)
            root = axes * np.sqrt(np.maximum(spread, 0.0))
            by_course = np.hstack([own * power[:, None] for power in powers]) @ root
            shifts.append(-fit.stage.covariance @ (fit.stage.jacobian.T @ by_course))
        return fit.with_left_out(np.hstack(shifts))

    def added_to(self, calibration: Calibration) -> Calibration:
        """Return the calibration with it, and what says how large it is."""
        name, sensor = next((name, imu.magnetometer) for name, imu in calibration.imus.items() if imu.magnetometer)
        findings, blocks = list(calibration.assessment.findings), dict[str, Floats]()
        for part, covariance in self.covariances.items():
            found, unit = _by_axis(self.known, part), "1"
            blocks[part] = covariance
            scale = np.ones(3)
            if part.endswith("_bias"):
                scale, unit = 1 / np.linalg.norm(sensor.sensitivity, axis=1), sensor.field_unit
            else:
                at = np.arange(9 * len(found)).reshape(-1, 3, 3).diagonal(axis1=1, axis2=2).ravel()
                blocks[part] = np.zeros((9 * len(found), 9 * len(found)))
                blocks[part][np.ix_(at, at)] = covariance
            each = np.tile(scale, len(found))
            findings.append(slope_finding(part, found * scale, covariance * np.outer(each, each), self.known, unit))
        calibration = calibration.with_temperature(name, self.known, blocks)
        return replace(calibration, assessment=replace(calibration.assessment, findings=tuple(findings)))


def _middle(poses: FieldPoses) -> Integers:
    """Return the number of the sample in the middle of each pose, (n,)."""
    return (poses.start + poses.stop - 1) // 2


def field_over_temperature(
    poses: FieldPoses,
    fit: MagnetometerFit,
    t_ns: Integers,
    thermometer: TemperatureSamples,
    taken: FieldOverTemperature | None,
) -> FieldOverTemperature | None:
    """Return what offsets and scales do with the temperature; None where nothing is told.

    First by least squares, whatever that is worth: without it, they would change within the windows of time in which
    both are then estimated anew. What these show is searched as the rests of a turned gyroscope are, for what the
    temperature tells beside steps, a decay and a random walk of the offset, or the scale.

    Parameters
    ----------
    poses, fit : of samples off which `taken` is taken already
    t_ns : (m,) timestamps of all samples [ns]
    taken : None at the first look
    """
    course = temperature_course(thermometer)
    assert course is not None
    seen, middle = course.at(t_ns), t_ns[_middle(poses)]
    powers = temperature_powers(course.with_rate(middle), seen, course.step_k)
    known = TemperatureDependence(
        reference_degc=float(seen.mean()), low_degc=float(seen.min()), high_degc=float(seen.max())
    )
    windows = field_windows(poses, fit, powers)
    if windows is None or len(windows.t_s) < FEWEST_FOR_COURSE:
        return None
    if taken is None:
        rough = drift_over(poses, fit, powers)[[0, *range(2, powers.shape[1] - 2)]]
        known = replace(
            known, **{part: _of_axes(part, one) for part, one in zip(_PARTS, np.hsplit(rough, 2), strict=True)}
        )
        wild = np.abs(known.change(_PARTS[1], seen)).max() > _MOST
        return None if wild else FieldOverTemperature(known=known, covariances={}, degc=seen)
    every, covariances = np.ones(len(windows.t_s), dtype=bool), dict[str, Floats]()
    for part, values, variance in (
        (_PARTS[0], windows.offset, windows.offset_variance),
        (_PARTS[1], windows.scale, windows.scale_variance),
    ):
        before = _by_axis(taken.known, part)
        change = windows.degc[:, [0, *range(2, len(before) + 1)]] @ before
        found = bias_course(windows.t_s, windows.degc, values + change, variance, at_rest=every)
        if found is not None:
            known, covariances[part] = replace(known, **{part: _of_axes(part, found.slopes)}), found.covariance
    return FieldOverTemperature(known=known, covariances=covariances, degc=seen) if covariances else None


def _of_axes(part: str, coefficients: Floats) -> Floats:
    """Return coefficients (k, 3) of the three axes as those of a part, which of scales are matrices."""
    return coefficients if part == _PARTS[0] else np.array([np.diag(row) for row in coefficients])


def _by_axis(known: TemperatureDependence, part: str) -> Floats:
    """Return the coefficients of each axis, (k, 3)."""
    value: Floats | None = getattr(known, part)
    if value is None:
        return np.zeros((1, 3))
    return value if value.ndim == 2 else np.diagonal(value, axis1=1, axis2=2)
