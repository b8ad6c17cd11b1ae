"""What a report shows of a calibration as document A published it."""

import numpy as np

from ..assess.imu_tables import (
    allan_curve,
    bin_edges,
    envelope,
    rms,
    uncalibrated_error,
    uncalibrated_rotation_error,
)
from ..detect.samples.noise import resting_noise
from ..diagnostics import DetectorTrace, ImuDiagnostics, IntervalTable, ModelTrial, RotationTable
from ..estimate.multiposition.rotations import MotionSegments
from ..estimate.multiposition.tedaldi import (
    leave_group_out,
)
from ..geometry.so3 import inverse
from ..intervals import interval_means
from .preparation import PreparedImu, stream
from .published_search import Search, Turned, held_out_forces


def describe(prepared: PreparedImu, search: Search, turned: Turned, gravity_m_s2: float) -> ImuDiagnostics:
    """Return signals, static intervals and rotations with their errors, and the thresholds that were tried."""
    accelerometer = prepared.accelerometer
    t_s = prepared.accelerometer_time.t_s
    edges = bin_edges(len(t_s))
    still = search.intervals
    intervals = _interval_table(prepared, search, turned, gravity_m_s2)
    rotations = _rotation_table(prepared, search, turned)
    density, _ = resting_noise(accelerometer.values, still, accelerometer.rate_hz)
    gyroscope = stream(prepared.gyroscope, prepared.gyroscope_time.t_s, prepared.gyroscope_saturated, turned.at_rest)
    sensitivity = inverse(turned.fit.correction)
    row = search.candidates[search.candidates[:, 0] == search.multiplier][0]
    return ImuDiagnostics(
        accelerometer=envelope(t_s, accelerometer.values, accelerometer.unit),
        gyroscope=envelope(prepared.gyroscope_time.t_s, prepared.gyroscope.values, prepared.gyroscope.unit),
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
                rotation_rms=rms(rotations.error_holdout),
                parameters=21,
            ),
        ),
        noise={
            "accelerometer.density": rms(np.sqrt(density) * np.linalg.norm(search.fit.correction, axis=0)),
            "gyroscope.density": rms(np.sqrt(gyroscope.density) / np.linalg.norm(sensitivity, axis=1)),
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


def _rotation_table(prepared: PreparedImu, search: Search, turned: Turned) -> RotationTable:
    count = len(turned.u) - 1
    raw = MotionSegments(
        gyroscope=turned.segments.gyroscope + turned.bias,
        accelerometer=turned.segments.accelerometer,
        dt_s=turned.segments.dt_s,
        lengths=turned.segments.lengths,
    )
    held = leave_group_out(turned.fit.jacobian, turned.fit.residual, turned.fit.covariance)
    sensitivity = inverse(turned.fit.correction)
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
