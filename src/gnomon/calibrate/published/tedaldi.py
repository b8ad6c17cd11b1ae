"""Tedaldi as published: Algorithm 1 as printed, the authors' script, and the program imu_tk.

    T_init -> for every threshold: static intervals, Eq. (3.4) -> smallest residual -> Eq. (3.8) -> Result

Kept to reproduce published numbers and to compare with; the default recipe is the better estimator. The sigmas are
those of ordinary least squares with independent residuals, which adjacent rotations do not have: they are lower bounds.
"""

import numpy as np

from ...assess.imu.imu_tables import (
    allan_curve,
    bin_edges,
    root_mean_square,
    signal_envelope,
    uncalibrated_error,
    uncalibrated_rotation_error,
)
from ...assess.imu.imu_verdict import axis_findings, convergence_findings, holdout_findings, unit_findings
from ...assess.verdict import gravity_findings, with_verdict
from ...detect.samples.stillness import variance_magnitude_squared, window_samples, window_variances
from ...errors import DetectionError, InitialisationError
from ...estimate.multiposition.measurements import UPPER, MagnitudeFit, MotionSegments, cut_segments, segments_between
from ...estimate.multiposition.noise_levels import resting_noise
from ...estimate.multiposition.problem import ImuEstimate, gyroscope_intervals
from ...estimate.multiposition.tedaldi import (
    RULES,
    SAMPLES_PER_INTERVAL,
    GyroscopeFit,
    TedaldiRules,
    fit_gyroscope,
    fit_published_accelerometer,
    leave_group_out,
    select_samples,
    static_directions,
)
from ...findings import make_finding
from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...options import ImuOptions
from ...progress import Progress
from ...recording import Floats, Recording, TriadSamples
from ...results.calibration import Assessment, Calibration, Covariance, Gravity, Holdout, Provenance, covariance_names
from ...results.result import Result, StaticIntervals, interval_means, runs_below
from ...results.sensor_diagnostics import DetectorTrace, ImuDiagnostics, IntervalTable, ModelTrial, RotationTable
from ..steps.preparation import PreparedImu, imu_calibration, local_gravity, stated_options, weighted_stream
from ..steps.stated_frame import in_stated_frame


@value_class
class Search:
    """M_inf of Algorithm 1: the threshold with the smallest residual, and all that were tried.

    Attributes
    ----------
    multiplier : the threshold, a multiple of the noise of T_init
    intervals : k static intervals that it finds
    samples : (k n, 3) of the accelerometer, n of each interval, in its unit
    fit : to these
    candidates : (thresholds, 4) multiplier, intervals, held-out residual (rms) [m/s^2] and cost; nan where too few
    statistic : (samples,) of the detector, relative to T_init
    """

    multiplier: float
    intervals: StaticIntervals
    samples: Floats
    fit: MagnitudeFit
    candidates: Floats
    statistic: Floats


@value_class
class Turned:
    """The gyroscope's half of Algorithm 1, of k - 1 rotations between k static intervals.

    Attributes
    ----------
    bias, bias_sigma : (3,) of the gyroscope, in its unit
    segments : samples of the rotations
    u : (k, 3) direction of the specific force at rest, over whole intervals
    start_s, stop_s : (k - 1,) of the rotations
    fit : of the gyroscope
    at_rest : static intervals, by the gyroscope's samples
    """

    bias: Floats
    bias_sigma: Floats
    segments: MotionSegments
    u: Floats
    start_s: Floats
    stop_s: Floats
    fit: GyroscopeFit
    at_rest: StaticIntervals


def calibrate_as_published(recording: Recording, prepared: PreparedImu, options: ImuOptions, tell: Progress) -> Result:
    """Calibrate an IMU as one of the published forms of Tedaldi does.

    Raises
    ------
    DetectionError
        If the first T_init seconds are not at rest, or no threshold finds enough static intervals.
    """
    rules = RULES[options.preset]
    stated = options.gravity is not None or options.latitude is not None
    gravity = (
        local_gravity(options)
        if stated
        else Gravity(value=rules.gravity, sigma=0.0, source=f"preset {options.preset}, {rules.gravity_source}")
    )
    t_init_s = options.t_init_s or rules.t_init_s
    tell(f"trying {len(rules.multipliers)} thresholds of the static detector")
    search = search_threshold(prepared, rules, gravity.value, t_init_s, options.window_s)
    tell(f"fitting the gyroscope to {len(search.intervals) - 1} rotations")
    turned = fit_rotations(prepared, rules, search, t_init_s)
    diagnostics = describe_tedaldi(prepared, search, turned, gravity.value)
    estimate = _estimate(search, turned)
    imus = {"imu0": imu_calibration(estimate, prepared.units)}
    calibration = Calibration(
        imus=imus,
        frame="accel-z",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=estimate.covariance),
        assessment=_assess(
            prepared,
            diagnostics,
            gravity,
            estimate,
            preset=options.preset,
            converged=search.fit.converged and turned.fit.converged,
        ),
        provenance=Provenance(method="imu", inputs=recording.sources, options=stated_options(options, [recording])),
    )
    if options.frame != "accel-z":
        rests = diagnostics.intervals
        calibration = in_stated_frame(calibration.in_frame("accel-x"), options.frame, rests.accelerometer, rests.sigma)
    return Result(calibration=calibration, diagnostics=diagnostics)


def search_threshold(
    prepared: PreparedImu, rules: TedaldiRules, gravity_m_s2: float, t_init_s: float, window_s: float
) -> Search:
    """Return what the threshold with the smallest residual gives.

    Raises
    ------
    DetectionError
        If T_init is too short or not at rest, or no threshold finds enough static intervals.
    """
    samples = prepared.accelerometer
    values, relative = samples.values, _relative_variance(samples, rules, t_init_s, window_s)
    rows: list[tuple[float, ...]] = []
    best: tuple[float, StaticIntervals, Floats, MagnitudeFit] | None = None
    for multiplier in rules.multipliers:
        threshold = multiplier**2 if rules.statistic == "magnitude" else multiplier
        intervals = runs_below(relative, float(threshold), SAMPLES_PER_INTERVAL)
        rows.append((multiplier, len(intervals), np.nan, np.nan))
        if len(intervals) < rules.fewest_intervals:
            continue
        chosen = select_samples(values, intervals, rules, samples.rate_hz)
        try:
            fit = fit_published_accelerometer(chosen, rules, gravity_m_s2)
        except InitialisationError:
            continue
        rows[-1] = (
            multiplier,
            len(intervals),
            root_mean_square(held_out_forces(fit, chosen, len(intervals), gravity_m_s2)),
            fit.cost,
        )
        if best is None or fit.cost < best[3].cost:
            best = (multiplier, intervals, chosen, fit)
    if best is None:
        most = max(int(row[1]) for row in rows)
        raise DetectionError(
            f"no threshold finds the {rules.fewest_intervals} static intervals of a second that this preset needs, in "
            f"attitudes that differ; the most were {most}. Record more attitudes, or use the default preset."
        )
    return Search(
        multiplier=best[0],
        intervals=best[1],
        samples=best[2],
        fit=best[3],
        candidates=np.array(rows, dtype=np.float64),
        statistic=relative,
    )


def _relative_variance(samples: TriadSamples, rules: TedaldiRules, t_init_s: float, window_s: float) -> Floats:
    """Return the detector's statistic of every sample over that of T_init, (n,); infinite at the ends."""
    values, t_s = samples.values, (samples.t_ns - samples.t_ns[0]) * 1e-9
    window = window_samples(samples, window_s)
    first = _t_init_samples(t_s, samples.rate_hz, rules, t_init_s)
    if len(values) < max(first, 2 * window):
        raise DetectionError(
            f"the recording of {samples.duration_s:.1f} s is shorter than T_init = {t_init_s:g} s of this preset. "
            "State a shorter --t-init-s, or use the default preset, which needs none."
        )
    half = window // 2
    if first < max(_FEWEST_AT_FIRST, half + 1):
        raise DetectionError(
            f"only {first} samples lie in T_init, the first {t_init_s:g} s, by which this preset finds the noise; it "
            f"needs {max(_FEWEST_AT_FIRST, half + 1)}, more than half a window. State a longer --t-init-s, or use the "
            "default preset, which needs none."
        )
    level = float(np.sum(np.var(values[:first], axis=0, ddof=1) ** 2))
    if not level > 0:
        raise DetectionError(
            f"the accelerometer reads one number throughout the first {t_init_s:g} s: its converter is coarser than "
            "its noise, and this preset's threshold is a multiple of the noise. Use the default preset."
        )
    statistic = variance_magnitude_squared(window_variances(values, window))
    statistic[:half], statistic[len(statistic) - half :] = np.inf, np.inf
    if rules.leading_sample_static:
        statistic[half - 1] = 0.0
    relative = statistic / level
    if np.median(relative[half:first]) > 10 or level > 100 * np.quantile(statistic[half:-half:window], 0.1):
        raise DetectionError(
            f"the first {t_init_s:g} s are not at rest, as this preset needs (T_init). "
            "State a shorter --t-init-s, or use the default preset, which needs none."
        )
    return relative


def _t_init_samples(t_s: Floats, rate_hz: float, rules: TedaldiRules, t_init_s: float) -> int:
    """Return the number of samples of T_init, by count or by timestamps as the published form does."""
    if rules.uniform_dt:
        return round(t_init_s * rate_hz)
    return int(np.searchsorted(t_s, t_init_s, "right")) + rules.t_init_extra


def fit_rotations(prepared: PreparedImu, rules: TedaldiRules, search: Search, t_init_s: float) -> Turned:
    """Return the gyroscope that takes each static direction to the next, Eq. (3.8)."""
    accelerometer, gyroscope = prepared.accelerometer, prepared.gyroscope
    origin = min(accelerometer.t_ns[0], gyroscope.t_ns[0])
    t_accel, t_gyro = (accelerometer.t_ns - origin) * 1e-9, (gyroscope.t_ns - origin) * 1e-9
    still = search.intervals
    start_s, stop_s = t_accel[still.stop[:-1] - 1], t_accel[still.start[1:]]
    first, lengths = segments_between(t_gyro, start_s, stop_s)
    if rules.stop_early:
        lengths = np.maximum(lengths - 1, 2)
    if rules.gyroscope_bias == "first interval":
        within = slice(
            int(np.searchsorted(t_gyro, t_accel[still.start[0]])),
            int(np.searchsorted(t_gyro, t_accel[still.stop[0] - 1], "right")),
        )
    else:
        within = slice(0, _t_init_samples(t_gyro - t_gyro[0], gyroscope.rate_hz, rules, t_init_s))
    bias = gyroscope.values[within].mean(axis=0)
    spread = gyroscope.values[within].std(axis=0, ddof=1) / np.sqrt(max(within.stop - within.start, 1))
    clock = np.arange(len(t_gyro)) / gyroscope.rate_hz if rules.uniform_dt else t_gyro
    at_gyro = accelerometer.values
    if not np.array_equal(t_accel, t_gyro):
        at_gyro = np.column_stack([np.interp(t_gyro, t_accel, at_gyro[:, axis]) for axis in range(3)])
    segments = cut_segments(clock, gyroscope.values - bias, at_gyro, first, lengths)
    forces = (segments.accelerometer - search.fit.bias) @ search.fit.correction.T
    u_start, u_end = static_directions(accelerometer.values, still, search.fit, rules, accelerometer.rate_hz)
    means = (interval_means(accelerometer.values, still) - search.fit.bias) @ search.fit.correction.T
    return Turned(
        bias=bias,
        bias_sigma=spread,
        segments=segments,
        u=means / np.linalg.norm(means, axis=1, keepdims=True),
        start_s=start_s,
        stop_s=stop_s,
        fit=fit_gyroscope(segments, forces, u_start, u_end),
        at_rest=gyroscope_intervals(t_gyro, t_accel[still.start], t_accel[still.stop - 1]),
    )


def held_out_forces(fit: MagnitudeFit, samples: Floats, intervals: int, gravity_m_s2: float) -> Floats:
    """Return |f| - g of every interval's mean when the whole interval was left out, (n,) [m/s^2]."""
    n = len(samples) // intervals
    centred = samples - fit.bias
    force = centred @ fit.correction.T
    norm = np.linalg.norm(force, axis=1)
    pull = force / norm[:, None]
    columns = [pull[:, i] * centred[:, j] for i, j in zip(*UPPER, strict=True)]
    jacobian = np.column_stack([*columns, -pull @ fit.correction]).reshape(intervals, n, 9)
    covariance = np.linalg.pinv(np.einsum("kij,kil->jl", jacobian, jacobian))
    return leave_group_out(jacobian, (norm - gravity_m_s2).reshape(intervals, n), covariance).mean(axis=1)


def _estimate(search: Search, turned: Turned) -> ImuEstimate:
    """Return the parameters in frame accel-z; sigmas by ordinary least squares."""
    fit, gyro = search.fit, turned.fit
    sensitivity, sensitivity_g = invert_matrix(fit.correction), invert_matrix(gyro.correction)
    covariance = np.zeros((33, 33))
    unit = np.zeros((12, 9))  # sensitivity (9) and bias (3) by the correction's upper triangle and the bias
    entries = [3 * i + j for i, j in zip(*UPPER, strict=True)]
    unit[:9, :6] = -np.kron(sensitivity, sensitivity.T)[:, entries]
    unit[9:, 6:] = np.eye(3)
    variance = 2 * fit.cost / max(len(fit.residual) - 9, 1)
    covariance[:12, :12] = variance * unit @ fit.covariance @ unit.T
    by_correction = -np.kron(sensitivity_g, sensitivity_g.T)
    dof = max(2 * len(gyro.residual) - 9, 1)  # a unit vector has two degrees of freedom
    covariance[12:21, 12:21] = float(np.sum(gyro.residual**2)) / dof * by_correction @ gyro.covariance @ by_correction.T
    covariance[21:24, 21:24] = np.diag(turned.bias_sigma**2)
    return ImuEstimate(
        accelerometer_sensitivity=sensitivity,
        accelerometer_bias=fit.bias,
        gyroscope_sensitivity=sensitivity_g,
        gyroscope_bias=turned.bias,
        g_sensitivity=np.zeros((3, 3)),
        covariance=covariance,
    )


def _assess(
    prepared: PreparedImu,
    diagnostics: ImuDiagnostics,
    gravity: Gravity,
    estimate: ImuEstimate,
    *,
    preset: str,
    converged: bool,
) -> Assessment:
    trial = diagnostics.trials[0]
    holdout = Holdout(accelerometer_rms=trial.accelerometer_rms, rotation_rms=trial.rotation_rms)
    findings = [
        *(f for f in prepared.findings if f.severity in ("warning", "info")),
        *holdout_findings(holdout, gravity.value),
        *axis_findings(estimate.gyroscope_sensitivity),
        *unit_findings("accelerometer", estimate.accelerometer_sensitivity, prepared.accelerometer.unit),
        *unit_findings("gyroscope", estimate.gyroscope_sensitivity, prepared.gyroscope.unit),
        *gravity_findings(gravity),
        make_finding("preset", preset=preset),
        *convergence_findings(converged),
    ]
    assessment = Assessment(
        holdout=holdout,
        intervals_found=len(diagnostics.intervals.used),
        intervals_used=len(diagnostics.intervals.used),
        rotations_found=len(diagnostics.rotations.used),
        rotations_used=len(diagnostics.rotations.used),
        model="basic",
    )
    return with_verdict(assessment, findings)


def describe_tedaldi(prepared: PreparedImu, search: Search, turned: Turned, gravity_m_s2: float) -> ImuDiagnostics:
    """Return signals, static intervals and rotations with their errors, and the thresholds that were tried."""
    accelerometer = prepared.accelerometer
    t_s = prepared.accelerometer_time.t_s
    edges = bin_edges(len(t_s))
    still = search.intervals
    intervals = _interval_table(prepared, search, turned, gravity_m_s2)
    rotations = _rotation_table(prepared, turned)
    density, _ = resting_noise(accelerometer.values, still, accelerometer.rate_hz)
    gyroscope = weighted_stream(
        prepared.gyroscope, prepared.gyroscope_time.t_s, prepared.gyroscope_saturated, turned.at_rest
    )
    sensitivity = invert_matrix(turned.fit.correction)
    row = search.candidates[search.candidates[:, 0] == search.multiplier][0]
    return ImuDiagnostics(
        accelerometer=signal_envelope(t_s, accelerometer.values, accelerometer.unit),
        gyroscope=signal_envelope(prepared.gyroscope_time.t_s, prepared.gyroscope.values, prepared.gyroscope.unit),
        detector=DetectorTrace(
            t_s=t_s[edges],
            statistic=np.maximum.reduceat(np.where(np.isfinite(search.statistic), search.statistic, 0.0), edges),
            multiplier=search.multiplier,
            candidates=search.candidates,
        ),
        intervals=intervals,
        rotations=rotations,
        allan=allan_curve(gyroscope, sensitivity),
        trials=(
            ModelTrial(
                model="basic",
                chosen=True,
                accelerometer_rms=float(row[2]),
                rotation_rms=root_mean_square(rotations.error_holdout),
                parameters=21,
            ),
        ),
        noise={
            "accelerometer.density": root_mean_square(np.sqrt(density) * np.linalg.norm(search.fit.correction, axis=0)),
            "gyroscope.density": root_mean_square(np.sqrt(gyroscope.density) / np.linalg.norm(sensitivity, axis=1)),
        },
    )


def _interval_table(prepared: PreparedImu, search: Search, turned: Turned, gravity_m_s2: float) -> IntervalTable:
    samples, still = prepared.accelerometer, search.intervals
    t_s = prepared.accelerometer_time.t_s
    means = interval_means(samples.values, still)
    error = np.linalg.norm((means - search.fit.bias) @ search.fit.correction.T, axis=1) - gravity_m_s2
    duration = (still.stop - still.start) / samples.rate_hz
    density, _ = resting_noise(samples.values, still, samples.rate_hz)
    per_unit = np.linalg.norm(search.fit.correction, axis=0)
    return IntervalTable(
        start_s=t_s[still.start],
        stop_s=t_s[still.stop - 1],
        samples=(still.stop - still.start).astype(np.float64),
        accelerometer=means,
        gyroscope=interval_means(prepared.gyroscope.values, turned.at_rest),
        direction=turned.u,
        error_before=uncalibrated_error(means, samples.unit, gravity_m_s2),
        error_after=error,
        error_holdout=held_out_forces(search.fit, search.samples, len(still), gravity_m_s2),
        sigma=np.sqrt(np.mean(density * per_unit**2) / duration),
        used=np.ones(len(still), dtype=bool),
        reason=("",) * len(still),
    )


def _rotation_table(prepared: PreparedImu, turned: Turned) -> RotationTable:
    count = len(turned.u) - 1
    raw = MotionSegments(
        gyroscope=turned.segments.gyroscope + turned.bias,
        accelerometer=turned.segments.accelerometer,
        dt_s=turned.segments.dt_s,
        lengths=turned.segments.lengths,
    )
    held = leave_group_out(turned.fit.jacobian, turned.fit.residual, turned.fit.covariance)
    sensitivity = invert_matrix(turned.fit.correction)
    return RotationTable(
        start_s=turned.start_s,
        stop_s=turned.stop_s,
        first=np.arange(count),
        angle_rad=np.arccos(np.clip(np.einsum("ki,ki->k", turned.u[1:], turned.u[:-1]), -1, 1)),
        measured=turned.u[1:],
        propagated=turned.fit.propagated,
        error_before=uncalibrated_rotation_error(raw, turned.bias, prepared.gyroscope.unit, sensitivity, turned.u),
        error_after=np.linalg.norm(turned.fit.residual, axis=1),
        error_holdout=np.linalg.norm(held, axis=1),
        sigma=np.full(count, np.nan),
        used=np.ones(count, dtype=bool),
        reason=("",) * count,
    )


_FEWEST_AT_FIRST = 10  # samples that tell the noise
