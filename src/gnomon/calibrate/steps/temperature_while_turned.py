"""The temperature of a sensor while it is turned: what biases, and a magnetometer, do with it, where that can be told.

A bias that drifts with time looks like one that follows the temperature while that only rises, or only falls. The
temperature is therefore a candidate for what a bias follows (`estimate.multiposition.bias_changes`) where it did both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...assess.imu.recording_changes import slope_finding
from ...estimate.multiposition.bias_functions import FEWEST_FOR_COURSE, bias_course, temperature_columns
from ...estimate.multiposition.fit import MultiPositionFit
from ...estimate.multiposition.problem import MultiPositionProblem
from ...estimate.triads.field_poses import FieldPoses
from ...estimate.triads.magnetometer import MagnetometerFit, drift_over, drift_rows, field_windows
from ...frozen import value_class
from ...recording import Floats, Integers, TemperatureSamples
from ...recording.thermometer import known_readings, temperature_course
from ...results.calibration import Calibration
from ...results.temperature_dependence import TemperatureDependence

_BOTH_WAYS_K, _BOTH_WAYS_STEPS, _BOTH_WAYS_SHARE = 4.0, 4.0, 0.3
"""How far the temperature has to rise, and to fall: in kelvins, steps of the thermometer, and of its range."""

_ORDER_FROM_K, _STEPS = (4.0, 10.0, 20.0), 4.0
"""Range of temperature that order 1, 2, 3 needs: in kelvins, and in steps of the thermometer for each order."""

_SIGMAS = 4.0
"""From which on a lag is no chance."""


@value_class
class BiasPolynomials:
    """Biases that follow the temperature.

    Attributes
    ----------
    found : the dependence
    jacobian : (3 k, p) of its k rows of coefficients by the scaled parameters of the fit
    """

    found: TemperatureDependence
    jacobian: Floats


def rose_and_fell(samples: TemperatureSamples | None) -> bool:
    """Return whether a temperature rose and fell, both by enough."""
    read = None if samples is None else known_readings(samples)
    if samples is None or read is None or np.ptp(read[1]) < _BOTH_WAYS_K:
        return False
    course = temperature_course(samples)
    assert course is not None
    rise = np.max(course.degc - np.minimum.accumulate(course.degc))
    fall = np.max(np.maximum.accumulate(course.degc) - course.degc)
    steps = _BOTH_WAYS_STEPS * float(np.nan_to_num(course.step_k))
    least = max(_BOTH_WAYS_K, steps, _BOTH_WAYS_SHARE * float(np.ptp(course.degc)))
    return bool(min(rise, fall) >= least)


def supported_order(range_k: float, step_k: float) -> int:
    """Return the highest order that a range of temperatures supports, with a thermometer of such steps."""
    return sum(range_k >= max(least, _STEPS * order * step_k) for order, least in enumerate(_ORDER_FROM_K, 1))


def temperature_powers(degc: Floats, at_rest: Floats, step_k: float) -> Floats:
    """Return what a bias may follow: temperature above the mean at rest [K], rate [K/s], higher powers, both together.

    One power more than the range at rest supports: what is left of a curve would be in the other coefficients, and is
    so in their sigmas. Temperature times rate is what an error of the lag makes of a curve.

    Parameters
    ----------
    degc : (n, 2) temperature at samples [degC] and its rate [K/s]
    at_rest : (m,) the same temperature in each rest [degC]
    step_k : of the thermometer
    """
    d = degc[:, 0] - at_rest.mean()
    order = max(supported_order(float(np.ptp(at_rest)), float(np.nan_to_num(step_k))), 1)
    return np.column_stack([d, degc[:, 1], *(d**power for power in range(2, order + 2)), d * degc[:, 1]])


def bias_polynomials(
    fit: MultiPositionFit, problem: MultiPositionProblem, reference_degc: float, lag_s: float
) -> BiasPolynomials | None:
    """Return how the biases follow the temperature in a fit; None where they do not.

    The highest power is not stated: see `temperature_powers`.

    Parameters
    ----------
    reference_degc : from which the fit counts the temperature [degC]
    lag_s : of the thermometer, which is undone already [s]
    """
    columns = temperature_columns(fit.data)
    if fit.data.degc is None or not columns:
        return None
    low, high = (reference_degc + float(pick(fit.data.degc[0][:, 0])) for pick in (np.min, np.max))
    values: dict[str, Floats] = {}
    rows = list[Floats]()
    for triad in ("accelerometer", "gyroscope"):  # as the covariance lists them
        if triad in columns:
            spread = getattr(problem, triad).spread
            slopes, _, *curves, _, _ = columns[triad]
            values[f"{triad}_bias"] = np.array([spread * fit.state.theta[at] for at in (slopes, *curves)])
            for at in (slopes, *curves):
                rows.append(np.zeros((3, len(fit.free))))
                rows[-1][np.arange(3), at] = spread
    known = TemperatureDependence(
        reference_degc=reference_degc,
        low_degc=low,
        high_degc=high,
        lag_s=max(lag_s + _lag(fit, list(columns.values())), 0.0),
    )
    return BiasPolynomials(found=replace(known, **values), jacobian=np.concatenate(rows))


def _lag(fit: MultiPositionFit, columns: Sequence[Integers]) -> float:
    """Return the lag that is left [s], the rate's coefficients over the temperature's; 0 where it is chance."""
    at_slopes, at_rates = (np.concatenate([own[row] for own in columns]) for row in (0, 1))
    place = np.cumsum(fit.free) - 1
    slopes, rates = fit.state.theta[at_slopes], fit.state.theta[at_rates]
    variance = np.diag(fit.arrow.corner_covariance)[place[at_rates]]
    information = float(np.sum(slopes**2 / variance))
    lag = float(np.sum(slopes * rates / variance)) / max(information, 1e-300)
    return lag if abs(lag) > _SIGMAS / np.sqrt(max(information, 1e-300)) else 0.0


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
