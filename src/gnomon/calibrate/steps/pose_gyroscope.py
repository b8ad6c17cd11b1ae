"""The gyroscope's part of a static experiment (Krebs, section 5.2): bias and g-sensitivity from rests.

Rests do not show the gyroscope's sensitivity. It is that of a prior calibration, or what its unit says give or take
what data sheets allow; of counts without prior nothing is known, and the g-sensitivity stays a number in counts.
"""

from dataclasses import replace

import numpy as np

from ...assess.imu.pose_tables import RestingGyroscope
from ...assess.priors import Prior
from ...estimate.triads.gyroscope_at_rests import (
    RestingRates,
    RotationSensitivity,
    StaticGSensitivity,
    fit_rotation_sensitivity,
    fit_static_g_sensitivity,
)
from ...estimate.triads.triad import TriadFit
from ...estimate.triads.triad_problem import B_, G_, S_, TriadPrior
from ...geometry.rotations import invert_matrix, nearest_rotation
from ...models.gravity import EARTH_RATE_RAD_S
from ...options import ImuOptions
from ...recording import Floats
from ...results.calibration import Gravity
from ...units import GYROSCOPE_UNITS_RAD_S
from .pose_preparation import PreparedPoses

_SCALE_SIGMA, _ANGLE_SIGMA_RAD = 0.03, 0.03
"""What data sheets allow of a scale, and of the angles between gyroscope and accelerometer axes."""


def fit_gyroscope_at_rest(
    prepared: PreparedPoses, fit: TriadFit, known: Prior, gravity: Gravity, options: ImuOptions
) -> RestingGyroscope:
    """Fit the gyroscope to its means at rest.

    Parameters
    ----------
    prepared : with means of the gyroscope
    fit : of the accelerometer to the same poses
    known : what is known beforehand
    gravity : as used for the accelerometer
    options : `latitude` for the rate of the Earth; with `model` basic no g-sensitivity is sought

    Raises
    ------
    InitialisationError
        If the attitudes do not determine the g-sensitivity.
    """
    poses = prepared.poses
    assert poses.gyroscope is not None
    used = np.flatnonzero(fit.used)
    prior = known.triad_prior("gyroscope") or TriadPrior.of(np.nan)
    sensitivity, spread = _sensitivity(fit, prior, poses.gyroscope_unit)
    turned = _by_rotations(prepared, fit, sensitivity, spread)
    if turned is not None:
        sensitivity, spread = turned.sensitivity, turned.covariance
    t_s, timed = _times(prepared, used)
    up = fit.direction[used]
    earth, unknown = _earth_rate(up, sensitivity, options.latitude)
    noise = prepared.gyroscope_variance[used]
    rates = RestingRates(
        measured=poses.gyroscope[used] - earth,
        variance=noise + unknown if noise.any() else noise,
        force=fit.physical(poses.accelerometer)[used],
        t_s=t_s,
    )
    found = fit_static_g_sensitivity(rates, g_sensitivity=options.model != "basic")
    theta = np.concatenate([found.bias, found.g_sensitivity.ravel()])
    by_force = _by_accelerometer(found, fit, rates.force)
    covariance = found.covariance + by_force @ fit.covariance[:12, :12] @ by_force.T
    covariance += _vertical_rate_unknown(sensitivity, gravity.value, options)
    theta, covariance, by_force = _with_prior(theta, covariance, by_force, prior)
    return RestingGyroscope(
        fit=found,
        used=used,
        sensitivity=sensitivity,
        assumed=not prior.precision[S_, S_].any()
        and not prior.fixed[S_].all()
        and (turned is None or not turned.measured.all()),
        turned=turned,
        rotation_reasons=() if prepared.rotations is None else prepared.rotations.reason,
        bias=theta[:3],
        g_sensitivity=theta[3:].reshape(3, 3),
        covariance=_joint(fit, spread, by_force, covariance),
        measured=poses.gyroscope[used],
        predicted=found.predicted + earth,
        variance=np.maximum(rates.variance, 0.0),
        force=rates.force,
        t_s=t_s,
        timed=timed,
        latitude_known=options.latitude is not None,
        unit=poses.gyroscope_unit,
    )


def _sensitivity(fit: TriadFit, prior: TriadPrior, unit: str) -> tuple[Floats | None, Floats]:
    """Return the sensitivity (3, 3) that the rests do not show, and its covariance (9, 9); None where unknown."""
    precision = prior.precision[S_, S_]
    if prior.fixed[S_].all():
        return prior.mean[S_].reshape(3, 3), np.zeros((9, 9))
    if np.all(np.diag(precision) > 0):
        known = np.flatnonzero(np.diag(prior.precision) > 0)
        marginal = invert_matrix(prior.precision[np.ix_(known, known)])
        rows = np.flatnonzero(known < 9)
        return prior.mean[S_].reshape(3, 3), marginal[np.ix_(rows, rows)]
    one = GYROSCOPE_UNITS_RAD_S[unit]
    if one is None:
        return None, np.zeros((9, 9))
    turn = nearest_rotation(fit.sensitivity)  # the axes of the gyroscope are about those of the accelerometer
    sigma = np.where(np.eye(3) > 0, _SCALE_SIGMA, _ANGLE_SIGMA_RAD) / one
    return turn / one, np.diag(sigma.ravel() ** 2)


def _by_rotations(
    prepared: PreparedPoses, fit: TriadFit, sensitivity: Floats | None, spread: Floats
) -> RotationSensitivity | None:
    """Return what the rotations between rests that are used say; None where there are none, or nothing is open."""
    rotations = prepared.rotations
    if rotations is None or sensitivity is None or not (np.diag(spread) > 0).all():
        return None
    used = fit.used[rotations.first] & fit.used[rotations.first + 1]
    reason = tuple(
        why if ok else why or "a rest beside it is left out" for why, ok in zip(rotations.reason, used, strict=True)
    )
    if all(reason):
        return None
    up = fit.direction
    force = fit.physical(prepared.poses.accelerometer)
    length = np.linalg.norm(force, axis=1)
    up = np.where(np.isfinite(up), up, force / length[:, None])
    by_force = _force_by_accelerometer(fit, force)
    across = by_force - up[:, :, None] * np.einsum("ni,nip->np", up, by_force)[:, None]
    return fit_rotation_sensitivity(
        replace(rotations, reason=reason),
        up,
        across / length[:, None, None],
        fit.covariance[:12, :12],
        (sensitivity, spread),
    )


def _force_by_accelerometer(fit: TriadFit, force: Floats) -> Floats:
    """Return derivatives (n, 3, 12) of the specific force by the accelerometer's sensitivity and bias."""
    back = invert_matrix(fit.sensitivity)
    by = np.zeros((len(force), 3, 12))
    for i in range(3):
        for j in range(3):
            by[:, :, 3 * i + j] = -force[:, j : j + 1] * back[:, i]
        by[:, :, 9 + i] = -back[:, i]
    return by


def _times(prepared: PreparedPoses, used: np.ndarray) -> tuple[Floats, bool]:
    """Return when the poses were measured [s], and whether that is known; their order counts where it is not."""
    t_s = prepared.poses.t_s
    return (np.arange(len(used), dtype=np.float64), False) if t_s is None else (t_s[used], True)


def _earth_rate(up: Floats, sensitivity: Floats | None, latitude_deg: float | None) -> tuple[Floats, Floats]:
    """Return what the Earth's rate adds to the means (n, 3), as far as it is known, and the rest's variance (n, 3).

    Its vertical part is known with the latitude; its level part has an unknown heading, another one in each pose.
    """
    if sensitivity is None:
        return np.zeros_like(up), np.zeros_like(up)
    sine, cosine_squared = 0.0, 2 / 3
    if latitude_deg is not None:
        sine, cosine_squared = float(np.sin(np.radians(latitude_deg))), float(np.cos(np.radians(latitude_deg)) ** 2)
    level = np.sum(sensitivity**2, axis=1) - (up @ sensitivity.T) ** 2
    return EARTH_RATE_RAD_S * sine * up @ sensitivity.T, 0.5 * EARTH_RATE_RAD_S**2 * cosine_squared * level


def _vertical_rate_unknown(sensitivity: Floats | None, gravity_m_s2: float, options: ImuOptions) -> Floats:
    """Return the covariance (12, 12) by the Earth's vertical rate: it follows gravity, as g-sensitivity does."""
    covariance = np.zeros((12, 12))
    if options.latitude is None and sensitivity is not None and options.model != "basic":
        like = (sensitivity / gravity_m_s2).ravel()
        covariance[3:, 3:] = EARTH_RATE_RAD_S**2 / 3 * np.outer(like, like)  # the mean of sine squared over the sphere
    return covariance


def _by_accelerometer(found: StaticGSensitivity, fit: TriadFit, force: Floats) -> Floats:
    """Return derivatives (12, 12) of bias and g-sensitivity by the accelerometer's sensitivity and bias."""
    by = _force_by_accelerometer(fit, force)
    moved = np.einsum("aj,njp->anp", found.g_sensitivity, by)  # of what g-sensitivity adds to each mean
    per_axis = -np.einsum("akn,anp->akp", found.gain, moved)
    return np.concatenate([per_axis[:, 0], per_axis[:, 1:].reshape(9, 12)])


def _with_prior(
    theta: Floats, covariance: Floats, by_force: Floats, prior: TriadPrior
) -> tuple[Floats, Floats, Floats]:
    """Return bias and g-sensitivity with what is known of them beforehand, as one more measurement."""
    places = np.r_[B_, G_]
    known = np.flatnonzero(np.diag(prior.precision) > 0)
    inside = np.flatnonzero(np.isin(known, places))
    held = np.flatnonzero(prior.fixed[places])
    if len(inside):
        marginal = np.linalg.inv(prior.precision[np.ix_(known, known)])[np.ix_(inside, inside)]
        rows = np.searchsorted(places, known[inside])
        gain = covariance[:, rows] @ np.linalg.inv(covariance[np.ix_(rows, rows)] + marginal)
        theta = theta + gain @ (prior.mean[known[inside]] - theta[rows])
        covariance = covariance - gain @ covariance[rows]
        by_force = by_force - gain @ by_force[rows]
    if len(held):
        gain = covariance[:, held] @ np.linalg.pinv(covariance[np.ix_(held, held)])
        theta = theta + gain @ (prior.mean[places[held]] - theta[held])
        theta[held] = prior.mean[places[held]]
        covariance = covariance - gain @ covariance[held]
        by_force = by_force - gain @ by_force[held]
        covariance[held] = covariance[:, held] = 0.0
        by_force[held] = 0.0
    return theta, 0.5 * (covariance + covariance.T), by_force


def _joint(fit: TriadFit, spread: Floats, by_force: Floats, covariance: Floats) -> Floats:
    """Return the covariance (33, 33) of accelerometer, the gyroscope's sensitivity, its bias and g-sensitivity."""
    joint = np.zeros((33, 33))
    accelerometer = fit.covariance[:12, :12]
    joint[:12, :12] = accelerometer
    joint[12:21, 12:21] = spread
    joint[21:, 21:] = covariance
    joint[21:, :12] = by_force @ accelerometer
    joint[:12, 21:] = joint[21:, :12].T
    return joint
