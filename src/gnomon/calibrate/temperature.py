"""Recordings at rest while the temperature changes -> TemperatureResult: the biases over temperature.

warm-ups -> bins -> the thermometer's lag -> order by evidence -> polynomials -> assess -> calibration that knows them
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ..assess.checks.signals import check_signal
from ..assess.imu.temperature import check_temperature, temperature_findings
from ..assess.verdict import SEVERITIES, verdict_of
from ..errors import OptionError, RecordingError
from ..estimate.temperature.bias_drift import (
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
from ..kernel import one_blas_thread
from ..options import ImuOptions
from ..progress import Progress
from ..recording import Floats, ImuSamples, Recording, Source
from ..recording.thermometer import temperature_course
from ..results.calibration import Calibration, Covariance, Provenance
from ..results.temperature import AxisOverTemperature, TemperatureResult, TriadOverTemperature
from ..results.temperature_dependence import HIGHEST_ORDER, TemperatureDependence
from .steps.preparation import recording_names, refuse_same_data, stated_options
from .steps.temperature_while_turned import supported_order
from .steps.warm_ups import (
    TRIADS,
    RestRecordings,
    average_at_rest,
    base_calibration,
    is_turned,
    sensor_with_thermometer,
)
from .turned_temperature import (
    FEWEST_TEMPERATURES,
    TurnedRecordings,
    describe_turned,
    fit_turned,
    turned_calibration,
)

_LAG_GAIN = 15.0
"""Twice the log likelihood that a lag has to gain."""
_BEYOND = 0.05
"""Of the range, by which a polynomial is used beyond it."""


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
    most: int
    stirred: float

    @property
    def span(self) -> tuple[float, float]:
        """Range of the temperatures, the lag of the thermometer undone [degC]."""
        ends = [pick(one.degc) for one in self.problem.warm_ups for pick in (np.min, np.max)]
        return float(min(ends)), float(max(ends))


def calibrate_temperature(
    recordings: Sequence[Recording],
    calibration: Calibration | None = None,
    *,
    reference_degc: float | None = None,
    options: ImuOptions | None = None,
    progress: Progress | None = None,
) -> TemperatureResult:
    """Find how biases and scales of an IMU change with its temperature, from warm-ups at rest or turned recordings.

    At rest in one attitude an accelerometer's change of bias and of scale look the same; both are stated as that of the
    bias. Three multi-position recordings or more, each at another temperature, tell them apart.

    Parameters
    ----------
    recordings : of one sensor, each from one switching-on, with its thermometer's readings: at rest throughout while it
        warms up, or turned from rest to rest at one temperature
    calibration : of the same sensor, which holds at `reference_degc`; without one its other numbers are ideal
    reference_degc : temperature at which the calibration holds [degC]; that which it states where not given, and
        without a calibration the middle of the range
    options : how turned recordings are calibrated, such as local gravity; with a `calibration` they tell changes alone
    progress : called with a sentence at each step

    Raises
    ------
    RecordingError
        If a recording has no thermometer, is neither at rest nor turned from rest to rest, or tells too little.
    OptionError
        If the calibration is of other sensors, or does not tell at which temperature it holds.
    """
    tell = progress or (lambda _: None)
    if not recordings:
        raise OptionError("no recording given. Give at least one at rest while the temperature changes.")
    names = recording_names(recordings)
    refuse_same_data(recordings, names)
    samples = [sensor_with_thermometer(name, recording) for name, recording in zip(names, recordings, strict=True)]
    base, nominal = base_calibration(calibration, samples[0], names[0])
    low, high, step = _as_read(samples)
    reference = _reference(reference_degc, calibration, (low, high))
    options = options or ImuOptions()
    turned = _turned(recordings, samples, names, reference, options=options, tell=tell)
    if turned is not None:
        base = turned_calibration(turned, None if nominal else base, *_beyond(turned.span))
    resting = [i for i, name in enumerate(names) if turned is None or name not in turned.names]
    fit = None
    if resting:
        tell("averaging the samples at rest")
        bins = [average_at_rest(names[i], samples[i]) for i in resting]
        with one_blas_thread():
            fit = _fit(RestRecordings(samples=[samples[i] for i in resting], bins=bins), reference, tell)
        base = _with_temperature(base, fit, nominal=nominal and turned is None, span=_known_span(fit, turned))
    tell("assessing the result")
    result = _result(base, fit, turned, names, step)
    result = replace(result, nominal=nominal and turned is None)
    noticed = [finding for i, one in enumerate(samples) for finding in _noticed(names[i], one, resting=i in resting)]
    findings = (*temperature_findings(result, noticed), *base.assessment.findings)
    stated = stated_options(options) | ({} if reference_degc is None else {"reference_degc": f"{reference_degc:g}"})
    return _assessed(result, findings, [source for one in recordings for source in one.sources], stated)


def _as_read(samples: Sequence[ImuSamples]) -> tuple[float, float, float]:
    """Return the lowest and highest temperature as read [degC], and the largest step [K]."""
    courses = [course for one in samples if one.temperature and (course := temperature_course(one.temperature))]
    steps = [np.nan_to_num(one.step_k) for one in courses]
    return (
        float(min(one.degc.min() for one in courses)),
        float(max(one.degc.max() for one in courses)),
        float(max(steps)),
    )


def _turned(
    recordings: Sequence[Recording],
    samples: Sequence[ImuSamples],
    names: Sequence[str],
    reference_degc: float,
    *,
    options: ImuOptions,
    tell: Progress,
) -> TurnedRecordings | None:
    """Return what the recordings tell in which the sensor is turned; None where these are too few."""
    which = [i for i, one in enumerate(samples) if is_turned(one)]
    if len(which) < FEWEST_TEMPERATURES:
        return None
    low, high, step = zip(*(_as_read([samples[i]]) for i in which), strict=True)
    degc = (np.array(low) + np.array(high)) / 2
    return fit_turned(
        [recordings[i] for i in which], [names[i] for i in which], degc, reference_degc,
        options=options, supported=supported_order(float(np.ptp(degc)), max(step)), progress=tell,
    )  # fmt: skip


def _beyond(span: tuple[float, float]) -> tuple[float, float]:
    """Return the range in which polynomials are used [degC]."""
    beyond = _BEYOND * (span[1] - span[0])
    return span[0] - beyond, span[1] + beyond


def _known_span(fit: _Fit, turned: TurnedRecordings | None) -> tuple[float, float]:
    """Return the range in which everything is known, biases and sensitivities [degC]."""
    if turned is None:
        return fit.span
    return max(fit.span[0], turned.span[0]), min(fit.span[1], turned.span[1])


def _result(
    calibration: Calibration, fit: _Fit | None, turned: TurnedRecordings | None, names: Sequence[str], step_k: float
) -> TemperatureResult:
    triads: dict[str, TriadOverTemperature] = {}
    sensitivities: dict[str, TriadOverTemperature] = {}
    spans, supported = list[tuple[float, float]](), list[int]()
    if turned is not None:
        triads = describe_turned(turned, calibration, "bias")
        sensitivities = describe_turned(turned, calibration, "scale")
        spans.append(turned.span)
        supported.append(turned.supported)
    if fit is not None:
        triads |= {name: _describe(fit, name, calibration) for name in fit.axes}
        spans.append(fit.span)
        supported.append(fit.most)
    return TemperatureResult(
        calibration=calibration,
        triads=triads,
        sensitivities=sensitivities,
        lag_s=0.0 if fit is None else fit.lag_s,
        lag_sigma_s=0.0 if fit is None else fit.lag_sigma_s,
        step_k=step_k,
        low_degc=min(low for low, _ in spans),
        high_degc=max(high for _, high in spans),
        supported_order=max(supported),
        stirred=0.0 if fit is None else fit.stirred,
        names=tuple(names),
        nominal=False,
    )


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
                method="temperature",
                inputs=(*sources, *known.provenance.inputs),
                options={**known.provenance.options, **stated},
            ),
        ),
    )


def _reference(stated: float | None, calibration: Calibration | None, span: tuple[float, float]) -> float:
    if stated is not None:
        return stated
    if calibration is None:
        return float(round(sum(span) / 2))
    if (sensor := next(iter(calibration.imus.values()))).temperature is not None:
        return sensor.temperature.reference_degc
    for key in ("temperature_c", "chip_degc"):
        if (known := calibration.provenance.options.get(key)) is not None:
            return float(known)
    raise OptionError(
        "nothing tells at which temperature of the chip the calibration was made. State it with --reference-degc; "
        "`gnomon check` shows it of the recording, and `gnomon imu --temperature-c` keeps it."
    )


def _fit(recorded: RestRecordings, reference: float, tell: Progress) -> _Fit:
    triads = recorded.bins[0].triads
    if any(one.triads != triads for one in recorded.bins):
        raise RecordingError("the recordings hold different sensors. Give those of one IMU alone.")
    axes = {triad: range(3 * i, 3 * i + 3) for i, triad in enumerate(triads)}
    every = [axis for part in axes.values() for axis in part]
    as_read = recorded.warm_ups(0.0)
    low, high = (float(pick([pick(one.degc) for one in as_read])) for pick in (min, max))
    most = supported_order(high - low, max(one.step_k for one in as_read))

    @cache
    def at_lag(lag_s: float) -> DriftProblem:
        return DriftProblem(warm_ups=recorded.warm_ups(lag_s), reference_degc=reference)

    lag = sigma = 0.0
    orders = dict.fromkeys(axes, HIGHEST_ORDER if most else 0)
    # A cubic takes up a part of what a lag does: once the orders are known the lag is sharper.
    for step in ("finding the thermometer's lag", "finding the polynomials"):
        tell(step)
        if most:
            tried = [orders[triad] for triad, part in axes.items() for _ in part]
            lag, sigma, gain = fit_lag(at_lag, every, tried)
            if gain < _LAG_GAIN or not np.isfinite(sigma):
                lag, sigma = 0.0, 0.0
        problem = replace(at_lag(lag), nearby=recorded.warm_ups(lag + sigma) if sigma > 0 else None)
        variances = [fit_variances(problem, axis, HIGHEST_ORDER if most else 0) for axis in every]
        before, orders = (
            orders,
            {
                triad: choose_order(problem, part, most, [variances[axis] for axis in part])
                for triad, part in axes.items()
            },
        )
        if not any(orders.values()) or orders == before:
            break
    drifts = [fit_drift(problem, axis, orders[triad], variances[axis]) for triad, part in axes.items() for axis in part]
    return _Fit(
        problem=problem, axes=dict(axes), orders=orders, variances=variances, drifts=drifts, lag_s=lag,
        lag_sigma_s=sigma, most=most, stirred=float(np.mean([one.stirred for one in recorded.bins])),
    )  # fmt: skip


def _dependence(fit: _Fit, base: Calibration, span: tuple[float, float]) -> TemperatureDependence:
    """Return the biases over the temperature, beside what is known of sensitivities."""
    sensor = next(iter(base.imus.values()))
    biases = {
        f"{triad}_bias": np.column_stack([fit.drifts[axis].coefficients[1:] for axis in part])
        if fit.orders[triad] and getattr(sensor, triad) is not None
        else None
        for triad, part in fit.axes.items()
    }
    low, high = _beyond(span)
    known = sensor.temperature or TemperatureDependence(reference_degc=0.0, low_degc=low, high_degc=high)
    return replace(
        known, reference_degc=fit.problem.reference_degc, low_degc=low, high_degc=high, lag_s=fit.lag_s, **biases
    )


def _with_temperature(base: Calibration, fit: _Fit, *, nominal: bool, span: tuple[float, float]) -> Calibration:
    """Return the calibration with the dependence, and the covariance of both; a bias that was ideal is found, too."""
    found = _dependence(fit, base, span)
    name, sensor = next(iter(base.imus.items()))
    blocks: dict[str, Floats] = {}
    for triad, part in fit.axes.items():
        if getattr(found, f"{triad}_bias") is not None:
            blocks[f"{triad}_bias"] = np.zeros((3 * fit.orders[triad],) * 2)
            for k, axis in enumerate(part):
                blocks[f"{triad}_bias"][k::3, k::3] = fit.drifts[axis].covariance[1:, 1:]
    warm = base.with_temperature(name, found, blocks)
    if not nominal or sensor.gyroscope is None:
        return warm
    axes, matrix = fit.axes["gyroscope"], warm.uncertainty.matrix.copy()
    bias = np.array([fit.drifts[axis].coefficients[0] for axis in axes])
    for k, axis in enumerate(axes):
        place = warm.uncertainty.names.index(f"{name}.gyroscope.bias[{k}]")
        matrix[place, place] = fit.drifts[axis].covariance[0, 0] + fit.variances[axis].turn_on
    imus = {name: replace(warm.imus[name], gyroscope=replace(sensor.gyroscope, bias=bias))}
    return replace(warm, imus=imus, uncertainty=Covariance(names=warm.uncertainty.names, matrix=matrix))


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
    drift, reference, warm_ups = fit.drifts[axis], fit.problem.reference_degc, fit.problem.warm_ups
    polynomial = np.polynomial.Polynomial([0.0, *drift.coefficients[1:]])
    left = [one.values[:, axis] - polynomial(one.degc - reference) for one in warm_ups]
    off = [one.values[:, axis] - rest.mean() for one, rest in zip(warm_ups, left, strict=True)]
    numbers = np.arange(len(warm_ups), dtype=np.float64)
    return AxisOverTemperature.from_polynomial(
        drift.coefficients[1:] / per_si,
        drift.covariance[1:, 1:] / per_si**2,
        reference_degc=reference,
        span_degc=fit.span,
        degc=np.concatenate([one.degc for one in warm_ups]),
        values=np.concatenate(off) / per_si,
        warm_up=np.repeat(numbers, [len(one.degc) for one in warm_ups]),
    )


def _noticed(name: str, imu: ImuSamples, *, resting: bool) -> list[Finding]:
    """Return what the samples show; where the sensor is turned, its calibration has told of the triads."""
    assert imu.temperature is not None
    triads = [triad for triad in TRIADS if resting and len(getattr(imu, triad))]
    signals = [finding for triad in triads for finding in check_signal(getattr(imu, triad), f"{name}, {triad}")]
    loud = [finding for finding in signals if finding.severity in ("problem", "warning")]
    return [*check_temperature(imu.temperature, f"{name}, thermometer"), *loud]
