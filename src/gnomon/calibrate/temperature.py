"""Recordings at rest while the temperature changes -> TemperatureResult: the biases over temperature.

warm-ups -> bins -> the thermometer's lag -> order by evidence -> polynomials -> assess -> calibration that knows them
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from .._version import __version__
from ..assess.checks.temperature_checks import check_temperature
from ..assess.imu.temperature_verdict import temperature_findings
from ..assess.verdict import SEVERITIES, verdict_of
from ..errors import OptionError, RecordingError
from ..estimate.temperature.bias_drift import (
    HIGHEST_ORDER,
    AxisDrift,
    DriftProblem,
    DriftVariances,
    branch_difference,
    choose_order,
    fit_drift,
    fit_lag,
    fit_variances,
    left_out_deviations,
)
from ..findings import Finding
from ..frozen import value_class
from ..progress import Progress
from ..recording import Floats, ImuSamples, Recording, Source
from ..results.calibration import (
    UNSTATED_GRAVITY,
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ..results.sensors import TemperatureDependence
from ..results.temperature import AxisOverTemperature, TemperatureResult, TriadOverTemperature
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .steps.preparation import recording_names, refuse_same_data
from .steps.warm_ups import TRIADS, RestRecordings, average_at_rest, sensor_at_rest

_ORDER_FROM_K = (4.0, 10.0, 20.0)
"""Range of temperature that order 1, 2, 3 needs [K], and steps of the thermometer."""
_STEPS = 4.0
_LAG_GAIN = 15.0
"""Twice the log likelihood that a lag has to gain."""
_BEYOND = 0.05
"""Of the range, by which a polynomial is used beyond it."""
_CURVE = 60
_NOMINAL_SCALE, _NOMINAL_BIAS_M_S2 = 0.03, 1.0
"""Standard deviations of a sensor as its data sheet has it, that nobody calibrated."""


def calibrate_temperature(
    recordings: Sequence[Recording],
    calibration: Calibration | None = None,
    *,
    reference_degc: float | None = None,
    progress: Progress | None = None,
) -> TemperatureResult:
    """Find how the biases of an IMU change with its temperature, from recordings at rest while it changes.

    At rest in one attitude an accelerometer's change of bias and of scale look the same; both are stated as that of the
    bias.

    Parameters
    ----------
    recordings : of one sensor, each from one switching-on, at rest throughout, with its thermometer's readings
    calibration : of the same sensor, which holds at `reference_degc`; without one its other numbers are ideal
    reference_degc : temperature at which the calibration holds [degC]; that which it states where not given, and
        without a calibration the middle of the range
    progress : called with a sentence at each step

    Raises
    ------
    RecordingError
        If a recording has no thermometer, is not at rest, or tells too little.
    OptionError
        If the calibration is of other sensors, or does not tell at which temperature it holds.
    """
    tell = progress or (lambda _: None)
    if not recordings:
        raise OptionError("no recording given. Give at least one at rest while the temperature changes.")
    names = recording_names(recordings)
    refuse_same_data(recordings, names)
    tell("averaging the samples at rest")
    samples = [sensor_at_rest(name, recording) for name, recording in zip(names, recordings, strict=True)]
    base, nominal = _base(calibration, samples[0], names[0])
    bins = [average_at_rest(name, one) for name, one in zip(names, samples, strict=True)]
    recorded = RestRecordings(samples=samples, bins=bins)
    tell("finding the thermometer's lag")
    fit = _fit(recorded, reference_degc, calibration, tell)
    tell("assessing the result")
    result = TemperatureResult(
        calibration=_with_temperature(base, fit, nominal=nominal),
        triads={name: _describe(fit, name, base) for name in fit.axes},
        lag_s=fit.lag_s,
        lag_sigma_s=fit.lag_sigma_s,
        step_k=fit.step_k,
        low_degc=fit.span[0],
        high_degc=fit.span[1],
        supported_order=fit.most,
        stirred=float(np.mean([one.stirred for one in bins])),
        names=tuple(names),
        nominal=nominal,
    )
    thermometers = [finding for name, one in zip(names, samples, strict=True) for finding in _thermometer(name, one)]
    findings = (*temperature_findings(result, thermometers), *base.assessment.findings)
    stated = {} if reference_degc is None else {"reference_degc": f"{reference_degc:g}"}
    return _assessed(result, findings, [source for one in recordings for source in one.sources], stated)


def _assessed(
    result: TemperatureResult, findings: Sequence[Finding], sources: Sequence[Source], stated: Mapping[str, str]
) -> TemperatureResult:
    """Return the result with what there is to say of it, and where it came from."""
    findings = tuple(sorted(findings, key=lambda finding: SEVERITIES[finding.severity]))
    known = result.calibration
    return replace(
        result,
        calibration=replace(
            known,
            assessment=replace(known.assessment, findings=findings, verdict=verdict_of(findings)),
            provenance=Provenance(
                gnomon_version=__version__,
                method="temperature",
                inputs=(*sources, *known.provenance.inputs),
                options={**known.provenance.options, **stated},
            ),
        ),
    )


@value_class
class _Fit:
    """What was found: axes of each triad, order, variances and polynomial of each axis."""

    problem: DriftProblem
    axes: dict[str, Sequence[int]]
    orders: dict[str, int]
    variances: Sequence[DriftVariances]
    drifts: Sequence[AxisDrift]
    lag_s: float
    lag_sigma_s: float
    step_k: float
    most: int

    @property
    def span(self) -> tuple[float, float]:
        """Range of the temperatures, the lag of the thermometer undone [degC]."""
        ends = [pick(one.degc) for one in self.problem.warm_ups for pick in (np.min, np.max)]
        return float(min(ends)), float(max(ends))


def _base(calibration: Calibration | None, imu: ImuSamples, name: str) -> tuple[Calibration, bool]:
    """Return the calibration whose sensor changes with the temperature, and whether it is the data sheet's.

    Raises
    ------
    OptionError
        If it is of other sensors, or in other units, or there is none for a sensor in counts.
    """
    triads = [triad for triad in TRIADS if len(getattr(imu, triad))]
    if calibration is None:
        return _ideal(imu, triads, name), True
    if len(calibration.imus) != 1:
        raise OptionError(
            f"the calibration holds {len(calibration.imus)} IMUs; a temperature is found of one. Give that of one IMU."
        )
    sensor = next(iter(calibration.imus.values()))
    for triad in triads:
        known, unit = getattr(sensor, triad), getattr(imu, triad).unit
        if known is not None and known.unit != unit:
            raise OptionError(
                f"the calibration's {triad} is in {known.unit}, that of {name} in {unit}. State the units (--units)."
            )
    return calibration, False


def _ideal(imu: ImuSamples, triads: Sequence[str], name: str) -> Calibration:
    """Return a sensor as its data sheet has it, with standard deviations to match."""
    accelerometer = gyroscope = None
    sigma: list[Floats] = []
    if "accelerometer" in triads:
        unit = imu.accelerometer.unit
        scale = _per_si(unit, ACCELEROMETER_UNITS_M_S2[unit], name)
        accelerometer = AccelerometerCalibration(sensitivity=scale * np.eye(3), bias=np.zeros(3), unit=unit)
        sigma += [_NOMINAL_SCALE * scale * np.tri(3).ravel(), np.full(3, _NOMINAL_BIAS_M_S2 * scale)]
    if "gyroscope" in triads:
        unit = imu.gyroscope.unit
        scale = _per_si(unit, GYROSCOPE_UNITS_RAD_S[unit], name)
        gyroscope = GyroscopeCalibration(
            sensitivity=scale * np.eye(3), bias=np.zeros(3), g_sensitivity=np.zeros((3, 3)), unit=unit
        )
        lower = np.ones((3, 3)) if accelerometer is not None else np.tri(3)
        sigma += [_NOMINAL_SCALE * scale * lower.ravel(), np.zeros(3), np.zeros(9)]
    imus = {"imu0": ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)}
    return Calibration(
        imus=imus,
        frame="accel-x" if accelerometer is not None else "gyro-x",
        gravity=UNSTATED_GRAVITY,
        uncertainty=Covariance(names=covariance_names(imus), matrix=np.diag(np.concatenate(sigma) ** 2)),
        assessment=Assessment(verdict="pass", findings=(), model="temperature"),
        provenance=Provenance(gnomon_version=__version__, method="temperature"),
    )


def _per_si(unit: str, si: float | None, name: str) -> float:
    if si is None:
        raise OptionError(
            f"{name} is in {unit}, and nothing tells what one is. Give a calibration of the sensor (--calibration), or "
            "state the units (--units)."
        )
    return 1 / si


def _reference(stated: float | None, calibration: Calibration | None, span: tuple[float, float]) -> float:
    if stated is not None:
        return stated
    if calibration is None:
        return float(round(sum(span) / 2))
    if (known := calibration.provenance.options.get("temperature_c")) is not None:
        return float(known)
    raise OptionError(
        "nothing tells at which temperature of the chip the calibration was made. State it with --reference-degc; "
        "`gnomon check` shows it of the recording, and `gnomon imu --temperature-c` keeps it."
    )


def _supported(range_k: float, step_k: float) -> int:
    """Return the highest order that a range of temperatures supports."""
    return sum(range_k >= max(least, _STEPS * order * step_k) for order, least in enumerate(_ORDER_FROM_K, 1))


def _fit(
    recorded: RestRecordings, reference_degc: float | None, calibration: Calibration | None, tell: Progress
) -> _Fit:
    triads = recorded.bins[0].triads
    if any(one.triads != triads for one in recorded.bins):
        raise RecordingError("the recordings hold different sensors. Give those of one IMU alone.")
    axes = {triad: range(3 * i, 3 * i + 3) for i, triad in enumerate(triads)}
    every = [axis for part in axes.values() for axis in part]
    as_read = recorded.warm_ups(0.0)
    low, high = (float(pick([pick(one.degc) for one in as_read])) for pick in (min, max))
    reference = _reference(reference_degc, calibration, (low, high))
    step = max(one.step_k for one in as_read)
    most = _supported(high - low, step)

    @cache
    def at_lag(lag_s: float) -> DriftProblem:
        return DriftProblem(warm_ups=recorded.warm_ups(lag_s), reference_degc=reference)

    lag, sigma, gain = fit_lag(at_lag, every) if most else (0.0, 0.0, 0.0)
    if gain < _LAG_GAIN or not np.isfinite(sigma):
        lag, sigma = 0.0, 0.0
    problem = replace(at_lag(lag), nearby=recorded.warm_ups(lag + sigma) if sigma > 0 else None)
    tell("finding the polynomials")
    variances = [fit_variances(problem, axis, HIGHEST_ORDER if most else 0) for axis in every]
    orders = {
        triad: choose_order(problem, part, most, [variances[axis] for axis in part]) for triad, part in axes.items()
    }
    drifts = [fit_drift(problem, axis, orders[triad], variances[axis]) for triad, part in axes.items() for axis in part]
    return _Fit(
        problem=problem, axes=dict(axes), orders=orders, variances=variances, drifts=drifts, lag_s=lag,
        lag_sigma_s=sigma, step_k=step, most=most,
    )  # fmt: skip


def _dependence(fit: _Fit, base: Calibration) -> TemperatureDependence:
    sensor = next(iter(base.imus.values()))
    biases = {
        f"{triad}_bias": np.column_stack([fit.drifts[axis].coefficients[1:] for axis in part])
        for triad, part in fit.axes.items()
        if fit.orders[triad] and getattr(sensor, triad) is not None
    }
    low, high = fit.span
    beyond = _BEYOND * (high - low)
    return TemperatureDependence(
        reference_degc=fit.problem.reference_degc,
        low_degc=low - beyond,
        high_degc=high + beyond,
        lag_s=fit.lag_s,
        **biases,
    )


def _with_temperature(base: Calibration, fit: _Fit, *, nominal: bool) -> Calibration:
    """Return the calibration with the dependence, and the covariance of both; a bias that was ideal is found, too."""
    found = _dependence(fit, base)
    name, sensor = next(iter(base.imus.items()))
    known = {scalar: i for i, scalar in enumerate(base.uncertainty.names) if ".temperature." not in scalar}
    if nominal and sensor.gyroscope is not None:
        bias = np.array([fit.drifts[axis].coefficients[0] for axis in fit.axes["gyroscope"]])
        sensor = replace(sensor, gyroscope=replace(sensor.gyroscope, bias=bias))
    imus = {name: replace(sensor, temperature=found)}
    names = covariance_names(imus, base.cameras)
    at = {scalar: i for i, scalar in enumerate(names)}
    matrix = np.zeros((len(names), len(names)))
    rows = [at[scalar] for scalar in known]
    matrix[np.ix_(rows, rows)] = base.uncertainty.matrix[np.ix_(list(known.values()), list(known.values()))]
    for part, _ in found.parts():
        triad = part.split("_", 1)[0]
        for k, axis in enumerate(fit.axes[triad]):
            places = [at[f"{name}.temperature.{part}[{j},{k}]"] for j in range(fit.orders[triad])]
            matrix[np.ix_(places, places)] = fit.drifts[axis].covariance[1:, 1:]
    if nominal and sensor.gyroscope is not None:
        for k, axis in enumerate(fit.axes["gyroscope"]):
            place = at[f"{name}.gyroscope.bias[{k}]"]
            matrix[place, place] = fit.drifts[axis].covariance[0, 0] + fit.variances[axis].turn_on
    return replace(base, imus=imus, uncertainty=Covariance(names=names, matrix=matrix))


def _describe(fit: _Fit, triad: str, base: Calibration) -> TriadOverTemperature:
    """Return a triad over the temperature in SI units."""
    sensor = getattr(next(iter(base.imus.values())), triad)
    per_si = 1.0 if sensor is None else float(np.cbrt(abs(np.linalg.det(sensor.sensitivity))))
    part, order = fit.axes[triad], fit.orders[triad]
    chosen = [fit.variances[axis] for axis in part]
    several = len(fit.problem.warm_ups) > 1
    pairs = list(zip(part, chosen, strict=True))
    branches = [branch_difference(fit.problem, axis, order, one) for axis, one in pairs]
    z = [left_out_deviations(fit.problem, axis, order, one) for axis, one in pairs] if several else []
    return TriadOverTemperature(
        order=order,
        axes=tuple(_curve(fit, axis, per_si) for axis in part),
        turn_on=np.array([np.sqrt(one.turn_on) / per_si if several else np.nan for one in chosen]),
        walk=np.array([np.sqrt(one.walk) / per_si for one in chosen]),
        branches=np.array([np.nan if one is None else one[0] / per_si for one in branches]),
        branches_sigma=np.array([np.nan if one is None else one[1] / per_si for one in branches]),
        left_out_z=np.column_stack(z) if several else np.full((1, 3), np.nan),
    )


def _curve(fit: _Fit, axis: int, per_si: float) -> AxisOverTemperature:
    drift = fit.drifts[axis]
    at = np.linspace(*fit.span, _CURVE)

    def powers(degc: Floats) -> Floats:
        return np.vander(degc - fit.problem.reference_degc, len(drift.coefficients), increasing=True)[:, 1:]

    p, covariance = drift.coefficients[1:], drift.covariance[1:, 1:]
    off = [one.values[:, axis] - np.mean(one.values[:, axis] - powers(one.degc) @ p) for one in fit.problem.warm_ups]
    return AxisOverTemperature(
        degc=np.concatenate([one.degc for one in fit.problem.warm_ups]),
        values=np.concatenate(off) / per_si,
        warm_up=np.repeat(
            np.arange(len(fit.problem.warm_ups), dtype=np.float64), [len(one.degc) for one in fit.problem.warm_ups]
        ),
        at_degc=at,
        change=powers(at) @ p / per_si,
        sigma=np.sqrt(np.einsum("ij,jk,ik->i", powers(at), covariance, powers(at))) / per_si,
    )


def _thermometer(name: str, imu: ImuSamples) -> list[Finding]:
    assert imu.temperature is not None
    return check_temperature(imu.temperature, f"{name}, thermometer")
