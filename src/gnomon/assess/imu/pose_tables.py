"""What a calibration from rests was made of and how well it explains them, as tables for the report."""

from collections.abc import Iterator

import numpy as np

from ...estimate.triads.angrisano import AngrisanoFit
from ...estimate.triads.attitudes import StatedAttitudes
from ...estimate.triads.gyroscope_at_rests import RotationSensitivity, StaticGSensitivity
from ...estimate.triads.triad import PoseDrift, PoseStep, TriadFit
from ...estimate.trust.parts import RobustCovariance
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats, Integers, Poses
from ...results.calibration import AccelerometerCalibration, Gravity
from ...results.result import Booleans
from ...results.sensor_diagnostics import GyroscopeAtRest, IterationHistory, PoseTable, TriadDiagnostics, TriadRecord
from ..priors import Prior
from .imu_tables import uncalibrated_error

_PREDICTABLE = 0.9  # leverage; beyond it the other poses say nothing of this one


@value_class
class RestingGyroscope:
    """A gyroscope calibrated from its means at rest.

    Attributes
    ----------
    fit : of bias, drift and g-sensitivity to the means
    used : (m,) index of the poses used
    sensitivity : (3, 3) [unit per rad/s], which rests do not show; None where nothing tells it
    assumed : whether it is what the unit says, and no prior calibration's nor by rotations
    turned : what the rotations between the rests say of it; None where they were not used
    rotation_reasons : why each rotation between rests cannot be used, or ""; none where none was recorded
    bias, g_sensitivity : (3,) [unit], (3, 3) [unit per m/s^2], with what was known beforehand
    covariance : (33, 33) of accelerometer and gyroscope, in the order of `parameters.calibration_parameters`
    measured, predicted, variance : (m, 3) means, what the fit says of them [unit], and variance by noise [unit^2]
    force : (m, 3) specific force [m/s^2]
    t_s : (m,) when [s]; the number of the pose where that is not known
    timed : whether it is known
    latitude_known : whether the Earth's vertical rate was taken off
    unit : of the measurements
    """

    fit: StaticGSensitivity
    used: Integers
    sensitivity: Floats | None
    assumed: bool
    bias: Floats
    g_sensitivity: Floats
    covariance: Floats
    measured: Floats
    predicted: Floats
    variance: Floats
    force: Floats
    t_s: Floats
    timed: bool
    latitude_known: bool
    unit: str
    turned: RotationSensitivity | None = None
    rotation_reasons: tuple[str, ...] = ()

    @property
    def unit_rad_s(self) -> Floats:
        """One unit of each axis in rad/s, (3,); nan where nothing tells it."""
        if self.sensitivity is None:
            return np.full(3, np.nan)
        return np.asarray(1 / np.linalg.norm(self.sensitivity, axis=1), dtype=np.float64)


@value_class
class PoseFitSummary:
    """Everything that a calibration from rests was made of.

    Attributes
    ----------
    poses : the means
    start_s, stop_s : (n,) [s], nan where unknown
    noise_variance : (n, 3) of the accelerometer's means [unit^2]; zero where nothing tells it
    left_out : name and reason of what gave no mean
    noticed : what was noticed before
    attitudes : that are more than 10 deg apart
    fit : of the accelerometer
    stated : how the known attitudes agree, or None where none were known
    drift : of the accelerometer's bias while the poses were recorded, or None where it was not estimated
    step : of that bias, which would explain all poses where the fit does not; None where none does
    gyroscope : at rest, or None
    no_gyroscope : why a gyroscope that was recorded is not calibrated, or ""
    known : beforehand
    gravity : what was taken for it
    trust : how far the accelerometer's parameters can be trusted
    """

    poses: Poses
    start_s: Floats
    stop_s: Floats
    noise_variance: Floats
    left_out: tuple[tuple[str, str], ...]
    noticed: tuple[Finding, ...]
    attitudes: int
    fit: TriadFit
    stated: StatedAttitudes | None
    drift: PoseDrift | None
    step: PoseStep | None
    gyroscope: RestingGyroscope | None
    no_gyroscope: str
    known: Prior
    gravity: Gravity
    trust: RobustCovariance


def describe_poses(evidence: PoseFitSummary) -> TriadDiagnostics:
    """Return the tables of a calibration from rests."""
    fit, poses = evidence.fit, evidence.poses
    scale = np.linalg.norm(fit.sensitivity, axis=1)
    noise = float(np.sqrt(np.mean(evidence.noise_variance / scale**2)))
    table = _pose_table(
        poses,
        (evidence.start_s, evidence.stop_s),
        evidence.gravity.value,
        direction=fit.direction,
        after=fit.magnitude_error,
        holdout=np.where(fit.leverage < _PREDICTABLE, fit.magnitude_holdout, np.nan),
        sigma=fit.magnitude_sigma,
        used=fit.used,
        reason=tuple("" if used else "gravity differs there from the others" for used in fit.used),
    )
    gyroscope = evidence.gyroscope
    return TriadDiagnostics(
        kind="poses",
        triads={"accelerometer": _record(poses, table, noise, fit.extra_sigma)},
        gravity=evidence.gravity,
        at_rest=None if gyroscope is None else _at_rest(gyroscope),
        noise={"accelerometer.mean": noise, "accelerometer.extra": fit.extra_sigma} | _gyroscope_noise(gyroscope),
        trust=evidence.trust.trust,
    )


def describe_published(
    poses: Poses,
    span_s: tuple[Floats, Floats],
    *,
    fit: AngrisanoFit,
    sensor: AccelerometerCalibration,
    holdout: Floats,
    gravity: Gravity,
) -> TriadDiagnostics:
    """Return the tables of preset angrisano, with the history of its iteration."""
    force = sensor.specific_force(poses.accelerometer)
    length = np.linalg.norm(force, axis=1)
    sigma = fit.residual_rms if np.isfinite(fit.residual_rms) else 0.0
    table = _pose_table(
        poses,
        span_s,
        gravity.value,
        direction=force / np.maximum(length, np.finfo(float).tiny)[:, None],
        after=length - gravity.value,
        holdout=holdout,
        sigma=np.full(len(poses), sigma),
        used=np.ones(len(poses), dtype=bool),
        reason=("",) * len(poses),
    )
    history = IterationHistory(q=fit.q, parameters=fit.visited[1:])
    return TriadDiagnostics(
        kind="poses",
        triads={"accelerometer": _record(poses, table, sigma, 0.0, history)},
        gravity=gravity,
        noise={"accelerometer.residual": sigma},
    )


def _record(
    poses: Poses, table: PoseTable, noise: float, extra: float, history: IterationHistory | None = None
) -> TriadRecord:
    return TriadRecord(
        quantity="specific force",
        unit=poses.accelerometer_unit,
        si_unit="m/s^2",
        poses=table,
        noise_sigma=noise,
        extra_sigma=extra,
        history=history,
    )


def _pose_table(
    poses: Poses,
    span_s: tuple[Floats, Floats],
    gravity_m_s2: float,
    *,
    direction: Floats,
    after: Floats,
    holdout: Floats,
    sigma: Floats,
    used: Booleans,
    reason: tuple[str, ...],
) -> PoseTable:
    n = len(poses)
    return PoseTable(
        name=poses.name,
        start_s=span_s[0],
        stop_s=span_s[1],
        samples=np.zeros(n, dtype=np.int64) if poses.samples is None else poses.samples,
        measured=poses.accelerometer,
        magnitude=np.full(n, gravity_m_s2),
        direction=direction,
        error_before=uncalibrated_error(poses.accelerometer, poses.accelerometer_unit, gravity_m_s2),
        error_after=after,
        error_holdout=holdout,
        sigma=sigma,
        used=used,
        reason=reason,
    )


def _at_rest(gyroscope: RestingGyroscope) -> GyroscopeAtRest:
    return GyroscopeAtRest(
        t_s=gyroscope.t_s,
        force=gyroscope.force,
        measured=gyroscope.measured,
        predicted=gyroscope.predicted,
        drift=gyroscope.fit.drift,
        sigma=np.sqrt(gyroscope.variance),
        unit=gyroscope.unit,
    )


def _gyroscope_noise(gyroscope: RestingGyroscope | None) -> dict[str, float]:
    """Return noise and scatter of the gyroscope's means [rad/s]."""
    if gyroscope is None or gyroscope.sensitivity is None:
        return {}
    by_axis = gyroscope.unit_rad_s
    return {
        "gyroscope.mean": float(np.sqrt(np.mean(gyroscope.variance * by_axis**2))),
        "gyroscope.extra": float(np.sqrt(np.mean((gyroscope.fit.extra_sigma * by_axis) ** 2))),
    }


_DRIFT_SIGMAS = 5.0
_SCATTER = 3.0  # times the noise at rest


def gyroscope_findings(gyroscope: RestingGyroscope | None, why_not: str) -> list[Finding]:
    """Say what the rests show of a gyroscope.

    Parameters
    ----------
    gyroscope : None where it was not calibrated
    why_not : the reason, or "" where none was recorded
    """
    if gyroscope is None:
        if not why_not:
            return []
        return [make_finding("gyroscope-not-calibrated", why_not=why_not)]
    findings = [
        _static_finding(gyroscope),
        *_rotation_findings(gyroscope),
        *_scale_findings(gyroscope),
        *_scatter_findings(gyroscope),
    ]
    if not gyroscope.timed:
        findings.append(make_finding("order-as-time"))
    if not gyroscope.latitude_known and gyroscope.sensitivity is not None:
        findings.append(make_finding("earth-rate-unknown"))
    return findings


def _static_finding(gyroscope: RestingGyroscope) -> Finding:
    how = f"{len(gyroscope.used)} rests, {gyroscope.fit.degrees_of_freedom} more than a fit without error needs"
    if gyroscope.sensitivity is None:
        G = "; ".join(" ".join(f"{x:.3g}" for x in row) for row in gyroscope.g_sensitivity)
        return make_finding("static-experiment/none", how=how, g=G, unit=gyroscope.unit)
    sigma = np.sqrt(np.diag(gyroscope.covariance)[24:33]).reshape(3, 3) * gyroscope.unit_rad_s[:, None]
    size = np.abs(gyroscope.g_sensitivity) * gyroscope.unit_rad_s[:, None]
    clear = int(np.sum(size > 2 * sigma))
    return make_finding("static-experiment/found", how=how, sigma=sigma.max(), clear=clear)


def _rotation_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    """Say what the rotations between few rests were used for, and of which gravity shows no angle."""
    turned, reasons = gyroscope.turned, gyroscope.rotation_reasons
    if turned is None:
        if not reasons:
            return []
        why = sorted({reason for reason in reasons if reason}) or ["counts tell no scale to count whole turns by"]
        return [make_finding("rotations-unused", count=len(reasons), why="; ".join(why[:3]))]
    sensitivity = turned.sensitivity
    size = np.linalg.norm(sensitivity, axis=1)
    share = 100 * np.sqrt(np.diag(turned.covariance)[[0, 4, 8]]) / size
    named = [f"{axis} {share[k]:.2g} %" for k, axis in enumerate("xyz") if turned.measured[k]]
    said = f"known to {', '.join(named)} (1 sigma)" if named else "no better known by them"
    held = [axis for k, axis in enumerate("xyz") if not turned.measured[k]]
    findings = [
        make_finding(
            "rotations-few-attitudes",
            case="held" if held else "",
            rotations=int(turned.used.sum()),
            total=len(turned.used),
            said=said,
            rms_rad=turned.rms_rad,
            held=" and ".join(held),
        )
    ]
    if turned.vertical.any():
        angles = ", ".join(f"{np.degrees(a):.1f}" for a in turned.angle_rad[turned.vertical][:6])
        findings.append(make_finding("turns-about-vertical", count=int(turned.vertical.sum()), angles=angles))
    return findings


def _scale_findings(gyroscope: RestingGyroscope) -> Iterator[Finding]:
    if gyroscope.sensitivity is None:
        yield make_finding("gyroscope-scale-unknown")
        return
    if not gyroscope.assumed:
        return
    if gyroscope.turned is not None and gyroscope.turned.measured.any():
        return
    yield make_finding(
        "gyroscope-scale-assumed",
        unit=gyroscope.unit,
        case="not-level" if gyroscope.rotation_reasons else "",
    )


def _scatter_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    """Say how far bias and drift move the means, where noise does not explain it."""
    unit = gyroscope.unit_rad_s if gyroscope.sensitivity is not None else np.ones(3)
    name = "rad/s" if gyroscope.sensitivity is not None else gyroscope.unit
    drift = float(np.max(np.ptp(gyroscope.fit.drift, axis=0) * unit))
    noise = float(np.sqrt(np.mean(gyroscope.variance * unit**2)))
    scatter = float(np.max(gyroscope.fit.extra_sigma * unit))
    findings: list[Finding] = []
    if noise > 0 and drift > _DRIFT_SIGMAS * noise:
        findings.append(make_finding("gyroscope-drift/rests", drift=drift, unit=name))
    if noise > 0 and scatter > _SCATTER * noise:
        findings.append(make_finding("rests-scatter", scatter=scatter, unit=name, noise=noise))
    return findings
