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
from ...detect.samples.static_intervals import resting_noise
from ...estimate.multiposition.measurements import UPPER, MotionSegments
from ...estimate.multiposition.problem import ImuEstimate
from ...estimate.multiposition.tedaldi import RULES, leave_group_out
from ...findings import make_finding
from ...geometry.rotation_vector import invert_matrix
from ...options import ImuOptions
from ...progress import Progress
from ...recording import Recording
from ...results.calibration import Assessment, Calibration, Covariance, Gravity, Holdout, Provenance, covariance_names
from ...results.result import Result, interval_means
from ...results.sensor_diagnostics import DetectorTrace, ImuDiagnostics, IntervalTable, ModelTrial, RotationTable
from ..steps.preparation import PreparedImu, imu_calibration, local_gravity, stated_options, weighted_stream
from ..steps.stated_frame import in_stated_frame
from .tedaldi_search import Search, Turned, fit_rotations, held_out_forces, search_threshold


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
    imus = {"imu0": imu_calibration(estimate, prepared)}
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
