"""What a calibration on a turntable was made of and how well it explains it, as tables."""

import numpy as np

from ...estimate.triads.triad import TriadFit, TriadPoses
from ...estimate.triads.triad_trust import merge_trusts
from ...estimate.trust.parts import RobustCovariance
from ...estimate.turntable.fit import TurntableFit
from ...estimate.turntable.parts import TurntableParts
from ...frozen import value_class
from ...recording import Floats
from ...results.calibration import Gravity
from ...results.sensor_diagnostics import (
    GyroscopeAtRest,
    PeriodCurve,
    PoseTable,
    TriadDiagnostics,
    TriadRecord,
    TriadTrial,
    TurntableRate,
)


@value_class
class TurntableFitSummary:
    """Everything that a calibration on a turntable was made of.

    Attributes
    ----------
    parts : steady parts and their speeds
    fit : the calibration
    rivals : model -> its fit, of those that were compared
    gravity : what was taken for gravity
    no_accelerometer : why the accelerometer was not used, or ""
    videos : what videos of the platter showed
    """

    parts: TurntableParts
    fit: TurntableFit
    rivals: dict[str, TurntableFit]
    gravity: Gravity
    no_accelerometer: str
    videos: tuple[PeriodCurve, ...]


def holdout_rms(fit: TriadFit) -> float:
    """Return the rms of |x| minus the magnitude of the parts that were left out, one at a time [SI]."""
    return float(np.sqrt(np.mean(fit.magnitude_holdout[fit.used] ** 2)))


def describe_turntable(evidence: TurntableFitSummary) -> TriadDiagnostics:
    """Return the diagnostics of a calibration on a turntable."""
    parts, found = evidence.parts, evidence.fit
    triads = {"gyroscope": _gyroscope(parts, found)}
    if found.accelerometer is not None and parts.accelerometer_unit is not None:
        triads = {"accelerometer": _accelerometer(parts, found), **triads}
    chosen = "g-sensitivity" if found.fit.free[12:].any() else "basic"
    noise = {"gyroscope.density": float(np.sqrt(np.mean(parts.noise / np.sum(found.fit.sensitivity**2, axis=1))))}
    if found.accelerometer is not None:
        noise["platter.tilt"] = found.accelerometer.tilt
    return TriadDiagnostics(
        kind="turntable",
        triads=triads,
        gravity=None if found.accelerometer is None else evidence.gravity,
        at_rest=_at_rest(parts, found),
        rates=_rates(parts, found.fit),
        videos=evidence.videos,
        trials=tuple(
            TriadTrial(
                model=model,
                chosen=model == chosen,
                holdout_rms=holdout_rms(rival.fit),
                parameters=int(rival.fit.free.sum()),
            )
            for model, rival in evidence.rivals.items()
        ),
        noise=noise,
        trust=merge_trusts([one.trust for one, _ in turntable_trusts(found)]),
    )


def turntable_trusts(found: TurntableFit) -> list[tuple[RobustCovariance, TriadFit]]:
    """Return what attitudes say of each triad, and its fit."""
    trusts = [(found.trust, found.fit)]
    return trusts if found.accelerometer is None else [(found.accelerometer.trust, found.accelerometer.fit), *trusts]


def _gyroscope(parts: TurntableParts, found: TurntableFit) -> TriadRecord:
    fit = found.fit
    return TriadRecord(
        quantity="angular rate",
        unit=parts.gyroscope_unit,
        si_unit="rad/s",
        poses=_table(fit, found.poses, parts.names, (parts.start_s, parts.stop_s), parts.samples),
        noise_sigma=_noise_sigma(found.poses, fit),
        extra_sigma=fit.extra_sigma,
    )


def _accelerometer(parts: TurntableParts, found: TurntableFit) -> TriadRecord:
    assert found.accelerometer is not None and parts.accelerometer_unit is not None  # noqa: PT018
    fit, poses, attitude = found.accelerometer.fit, found.accelerometer.poses, found.accelerometer.attitude
    members = [np.flatnonzero(parts.data.pose == k) for k in attitude]
    names = tuple(f"attitude {k + 1}" for k in attitude)
    start_s = np.array([parts.start_s[m].min() if len(m) else np.nan for m in members])
    stop_s = np.array([parts.stop_s[m].max() if len(m) else np.nan for m in members])
    return TriadRecord(
        quantity="specific force",
        unit=parts.accelerometer_unit,
        si_unit="m/s^2",
        poses=_table(fit, poses, names, (start_s, stop_s), np.zeros(len(attitude), dtype=np.int64)),
        noise_sigma=_noise_sigma(poses, fit),
        extra_sigma=fit.extra_sigma,
    )


def _table(
    fit: TriadFit, poses: TriadPoses, names: tuple[str, ...], span_s: tuple[Floats, Floats], samples: np.ndarray
) -> PoseTable:
    return PoseTable(
        name=names,
        start_s=span_s[0],
        stop_s=span_s[1],
        samples=samples,
        measured=poses.measured,
        magnitude=poses.magnitude,
        direction=fit.direction,
        error_before=_uncalibrated(poses.measured, poses.magnitude, fit),
        error_after=fit.magnitude_error,
        error_holdout=fit.magnitude_holdout,
        sigma=fit.magnitude_sigma,
        used=fit.used,
        reason=tuple("" if used else "it does not agree with the others" for used in fit.used),
    )


def _uncalibrated(measured: Floats, magnitude: Floats, fit: TriadFit) -> Floats:
    """Return |x| - magnitude with one scale for all axes, and of the offset no more than that of counts."""
    size = float(np.abs(np.linalg.det(fit.sensitivity))) ** (1 / 3)
    offset = np.mean(fit.bias) if np.abs(fit.bias).max() > size * magnitude.max() else 0.0
    return np.linalg.norm(measured - offset, axis=1) / size - magnitude


def _noise_sigma(poses: TriadPoses, fit: TriadFit) -> float:
    return float(np.sqrt(np.median(poses.variance / np.sum(fit.sensitivity**2, axis=1))))


def _rates(parts: TurntableParts, fit: TriadFit) -> tuple[TurntableRate, ...]:
    rates: list[TurntableRate] = []
    for k, rate in enumerate(parts.rates):
        count = int(np.count_nonzero(parts.data.speed == k))
        if count:
            rates.append(
                TurntableRate(
                    name=rate.name,
                    stated=rate.rate_rad_s,
                    stated_sigma=rate.sigma_rad_s,
                    estimated=rate.rate_rad_s * float(fit.group_factor[k]),
                    estimated_sigma=rate.rate_rad_s * float(fit.group_sigma[k]),
                    parts=count,
                    turns=rate.turns,
                )
            )
    return tuple(rates)


def _at_rest(parts: TurntableParts, found: TurntableFit) -> GyroscopeAtRest | None:
    """Return the gyroscope at rest in several attitudes; None without accelerometer or rests."""
    rest, force = parts.data.rate == 0, found.poses.force
    if force is None or not rest.any():
        return None
    fit, drift = found.fit, found.drift[rest]
    earth = found.poses.magnitude_sigma[rest, None] * np.linalg.norm(fit.sensitivity, axis=1)
    return GyroscopeAtRest(
        t_s=parts.data.t_s[rest],
        force=force[rest],
        measured=parts.data.measured[rest],
        predicted=fit.bias + drift + force[rest] @ fit.g_sensitivity.T,
        drift=drift,
        sigma=np.sqrt(found.poses.variance[rest] + earth**2),
        unit=parts.gyroscope_unit,
    )
