"""A gyroscope on a turntable, alone or together with the accelerometer (Angrisano; see estimate/triads/triad.py).

Alone, magnitudes are all that is known. With the accelerometer the axis of the platter is known in every attitude: it
stands upright, or upside down where the platter turns clockwise, and every entry of the sensitivity shows.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from ...errors import SolveError
from ...frozen import value_class
from ...models.gravity import EARTH_RATE_RAD_S
from ...recording import Floats, Integers
from ...results.result import Booleans
from ..multiposition.bias_functions import BiasCourse, bias_course
from ..triads.triad import TriadFit, TriadPoses, TriadPrior, fit_triad
from ..triads.triad_trust import robust_triad
from ..trust.parts import RobustCovariance
from .parts import AxisInSensor, TurntableData, drift_at, shown_density

Sense = Literal["clockwise", "counterclockwise"]

_FARTHEST_M = 0.1  # a sensor lies not much farther from the platter's axis
_TILT_THAT_COUNTS = 1e-3  # rad; its cosine is 5e-7 from 1
_ANGULAR = slice(12, 33)


@value_class
class AccelerometerInPoses:
    """The accelerometer by the magnitude of gravity, in body frame accel-x.

    Attributes
    ----------
    poses, fit : see estimate/triads/triad.py; the covariance is that from clusters of attitudes
    trust : what attitudes say of it
    attitude : (n,) index of the attitude of each pose
    tilt : angle of the platter's axis to the vertical [rad]
    """

    poses: TriadPoses
    fit: TriadFit
    trust: RobustCovariance
    attitude: Integers
    tilt: float


@value_class
class TurntableFit:
    """The gyroscope, and how it hangs together with the accelerometer.

    Attributes
    ----------
    poses, fit : parts as the estimator took them; the covariance is that from clusters of attitudes
    trust : what attitudes say of the gyroscope
    accelerometer : None where it was not recorded or not determined
    covariance : (33, 33) of accelerometer and gyroscope, or (21, 21) of the gyroscope alone
    sense : which way the platter turns, seen from above; None without accelerometer
    clockwise : (n,) bool of each part
    drift : (n, 3) bias of each part minus its mean [unit]; zero where it stays
    drifts : whether the bias wandered
    course : what it does with the temperature, which is part of `drift`; None where nothing tells
    """

    poses: TriadPoses
    fit: TriadFit
    trust: RobustCovariance
    accelerometer: AccelerometerInPoses | None
    covariance: Floats
    sense: Sense | None
    clockwise: Booleans
    drift: Floats
    drifts: bool
    course: BiasCourse | None


def fit_platter_accelerometer(
    data: TurntableData, gravity_m_s2: float, gravity_sigma_m_s2: float, prior: TriadPrior | None
) -> AccelerometerInPoses:
    """Calibrate the accelerometer by the magnitude of gravity in the attitudes on the platter.

    Raises
    ------
    InitialisationError
        If the attitudes do not determine it.
    """
    axes = data.axes
    upright = np.array([axis.upright for axis in axes])
    usable = np.array([bool(np.isfinite(axis.variance).all()) for axis in axes])
    pull = np.array([0.0 if axis.separated else axis.rate**2 * _FARTHEST_M for axis in axes])
    excess = pull**2 / (2 * gravity_m_s2)  # a pull across gravity lengthens it by that much
    attitude = np.flatnonzero(usable)

    def fitted(tilt: float) -> tuple[TriadPoses, TriadFit]:
        """Return poses and fit with the platter tilted [rad]: turning, its mean is shorter than gravity."""
        turning = np.array([axis.rate > 0 for axis in axes])
        poses = TriadPoses.of(
            upright[usable],
            np.where(turning, gravity_m_s2 * np.cos(tilt), gravity_m_s2)[usable],
            variance=np.array([axis.variance for axis in axes])[usable],
            magnitude_sigma=excess[usable],
            group_sigma=gravity_sigma_m_s2 / gravity_m_s2,
        )
        return poses, fit_triad(poses, prior=prior)

    poses, fit = fitted(0.0)
    tilt = platter_tilt(axes, fit.sensitivity, gravity_m_s2)
    if tilt > _TILT_THAT_COUNTS:
        poses, fit = fitted(tilt)
    t_s = np.bincount(data.pose, data.t_s, len(axes)) / np.maximum(np.bincount(data.pose, minlength=len(axes)), 1)
    fit, trust = robust_triad(fit, "imu0.accelerometer", t_s=t_s[usable])
    return AccelerometerInPoses(poses=poses, fit=fit, trust=trust, attitude=attitude, tilt=tilt)


def platter_tilt(axes: tuple[AxisInSensor, ...], sensitivity: Floats, gravity_m_s2: float) -> float:
    """Return the angle between the platter's axis and the vertical by how gravity goes round in the sensor [rad]."""
    round_ = [np.linalg.solve(sensitivity, axis.tilt) / gravity_m_s2 for axis in axes if axis.rate > 0]
    if not round_:
        return 0.0
    return float(np.arctan(np.sqrt(np.median([0.5 * np.sum(pair**2) for pair in round_]))))


def fit_turntable(
    data: TurntableData,
    accelerometer: AccelerometerInPoses | None,
    *,
    sense: Sense | None,
    latitude_deg: float | None,
    g_sensitivity: bool,
    unknown_scale: bool,
    prior: TriadPrior | None,
) -> TurntableFit:
    """Calibrate the gyroscope.

    Parameters
    ----------
    data : steady parts
    accelerometer : as calibrated before; None without
    sense : which way the platter turns, where that is stated; None to find it out
    latitude_deg : where the earth's rate is known
    g_sensitivity, unknown_scale, prior : as in `fit_triad`

    Raises
    ------
    InitialisationError
        If the parts determine no gyroscope.
    """
    if accelerometer is None:
        poses = magnitude_poses(data, latitude_deg)
        drift = np.zeros_like(data.measured)
        poses, fit, drift, drifts, course = _fit_with_drift(poses, data, unknown_scale, prior, g_sensitivity=False)
        fit, trust = robust_triad(fit, "imu0.gyroscope", t_s=data.t_s, stretch=data.pose, g_sensitivity=True)
        nobody = np.zeros(len(data.t_s), dtype=bool)
        return TurntableFit(
            poses=poses,
            fit=fit,
            trust=trust,
            accelerometer=None,
            covariance=fit.covariance,
            sense=None,
            clockwise=nobody,
            drift=drift,
            drifts=drifts,
            course=course,
        )
    clockwise = turning_senses(data, accelerometer, sense)
    poses = directed_poses(data, accelerometer, _theta(accelerometer), clockwise, latitude_deg)
    poses, fit, drift, drifts, course = _fit_with_drift(poses, data, unknown_scale, prior, g_sensitivity=g_sensitivity)
    fit, trust = robust_triad(fit, "imu0.gyroscope", t_s=data.t_s, stretch=data.pose, g_sensitivity=True)

    def at(theta: Floats) -> TriadPoses:
        return directed_poses(data, accelerometer, theta, clockwise, latitude_deg)

    turning = data.rate > 0
    return TurntableFit(
        poses=poses,
        fit=fit,
        trust=trust,
        accelerometer=accelerometer,
        covariance=_joint_covariance(accelerometer, poses, fit, prior, at),
        sense="clockwise" if np.mean(clockwise[turning]) > 0.5 else "counterclockwise",
        clockwise=clockwise,
        drift=drift,
        drifts=drifts,
        course=course,
    )


def magnitude_poses(data: TurntableData, latitude_deg: float | None) -> TriadPoses:
    """Return the parts as poses of which only magnitudes are known."""
    return TriadPoses.of(
        data.measured,
        data.rate,
        variance=data.variance,
        magnitude_sigma=np.where(data.rate > 0, data.wander, EARTH_RATE_RAD_S / np.sqrt(3)),
        group=data.speed,
        group_sigma=_group_sigmas(data, latitude_deg, earth_known=False),
    )


def directed_poses(
    data: TurntableData,
    accelerometer: AccelerometerInPoses,
    theta: Floats,
    clockwise: Booleans,
    latitude_deg: float | None,
) -> TriadPoses:
    """Return the parts as poses with the direction of the platter's axis and the specific force.

    Parameters
    ----------
    theta : (12,) sensitivity and bias of the accelerometer by which they are made
    clockwise : (n,) bool
    """
    assert data.force is not None
    fit, g = accelerometer.fit, float(np.median(accelerometer.poses.magnitude))
    inverse = np.linalg.inv(theta[:9].reshape(3, 3))
    up = (np.array([axis.upright for axis in data.axes]) - theta[9:]) @ inverse.T
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    noise = np.array([np.trace(inverse @ np.diag(axis.variance) @ inverse.T) / 3 for axis in data.axes])
    pulled = np.array([0.0 if axis.separated else axis.rate**2 * _FARTHEST_M for axis in data.axes])
    sigma = np.sqrt(noise + fit.extra_sigma**2 + pulled**2 / 2) / g
    sense = np.where(clockwise, -1.0, 1.0)
    turning = data.rate > 0
    earth = 0.0 if latitude_deg is None else EARTH_RATE_RAD_S * np.sin(np.radians(latitude_deg))
    level = EARTH_RATE_RAD_S / np.sqrt(3)  # at rest its direction in the sensor is left to chance
    return TriadPoses.of(
        data.measured,
        np.where(turning, data.rate + sense * earth, 0.0),
        variance=data.variance,
        magnitude_sigma=np.where(turning, data.wander, level),
        group=data.speed,
        group_sigma=_group_sigmas(data, latitude_deg, earth_known=True),
        direction=np.where(turning[:, None], sense[:, None] * up[data.pose], np.nan),
        direction_sigma=np.where(turning, np.maximum(sigma[data.pose], 1e-7), np.inf),
        force=(data.force - theta[9:]) @ inverse.T,
    )


def turning_senses(data: TurntableData, accelerometer: AccelerometerInPoses, stated: Sense | None) -> Booleans:
    """Return which parts turned clockwise seen from above, (n,), taking both triads for right-handed.

    A platter usually turns one way: then the sign of the determinant of what maps axes to readings tells which. Where
    single parts turned the other way, axes that are nearly parallel to those of the accelerometer tell.
    """
    if stated is not None:
        return np.full(len(data.t_s), stated == "clockwise")
    turning = data.rate > 0
    theta = _theta(accelerometer)
    inverse = np.linalg.inv(theta[:9].reshape(3, 3))
    up = (np.array([axis.upright for axis in data.axes]) - theta[9:]) @ inverse.T
    up = (up / np.linalg.norm(up, axis=1, keepdims=True))[data.pose]
    zero = np.median(data.measured[~turning], axis=0) if (~turning).any() else np.zeros(3)
    rate = np.where(turning, data.rate, 0.0)

    def unexplained(sense: Floats) -> tuple[float, float]:
        design = np.column_stack([(sense * rate)[:, None] * up, np.ones(len(up))])
        found, *_ = np.linalg.lstsq(design, data.measured, rcond=1e-9)
        return float(np.sum((data.measured - design @ found) ** 2)), float(np.linalg.det(found[:3]))

    along = np.sign(np.sum(up * (data.measured - zero), axis=1))
    along[along == 0] = 1.0
    one = np.ones(len(up))
    (by_one, hand), (by_each, _) = unexplained(one), unexplained(along)
    sense = along if by_each < 0.5 * by_one else one * (1.0 if hand > 0 else -1.0)
    return sense < 0


def _theta(accelerometer: AccelerometerInPoses) -> Floats:
    return np.concatenate([accelerometer.fit.sensitivity.ravel(), accelerometer.fit.bias])


def _group_sigmas(data: TurntableData, latitude_deg: float | None, *, earth_known: bool) -> Floats:
    """Return relative sigmas of the speeds (g,): as stated, and by the earth's vertical rate where it is not known."""
    earth = EARTH_RATE_RAD_S / np.sqrt(3)
    if latitude_deg is not None:
        earth = 0.0 if earth_known else EARTH_RATE_RAD_S * abs(np.sin(np.radians(latitude_deg)))
    turning = data.rates > 0
    return np.where(turning, np.hypot(data.rate_sigmas, earth) / np.where(turning, data.rates, 1.0), 0.0)


def _fit_with_drift(
    poses: TriadPoses, data: TurntableData, unknown_scale: bool, prior: TriadPrior | None, *, g_sensitivity: bool
) -> tuple[TriadPoses, TriadFit, Floats, bool, BiasCourse | None]:
    """Fit, look whether the residuals at rest follow the temperature, or each other in time, and fit without that."""
    fit = fit_triad(poses, g_sensitivity=g_sensitivity, unknown_scale=unknown_scale, prior=prior)
    at_rest = (poses.magnitude == 0) & fit.used
    if (at_rest == fit.used).all():
        raise SolveError(
            "no steady part that turned is left: they do not agree with each other about the gyroscope. Check the "
            "stated speeds, the full scale of the gyroscope, and that the sensor cannot slip on the platter."
        )
    residual = poses.measured - fit.bias
    if poses.force is not None:
        residual = residual - poses.force @ fit.g_sensitivity.T
    noise = poses.variance + (poses.magnitude_sigma**2)[:, None] * np.sum(fit.sensitivity**2, axis=1)
    course = bias_course(data.t_s, data.degc, residual, noise, at_rest=at_rest, force=poses.force)
    if course is not None:
        poses = replace(poses, measured=poses.measured - course.at_parts, variance=poses.variance + course.variance)
        residual, noise = residual - course.at_parts, noise + course.variance
    followed = np.zeros_like(poses.measured) if course is None else course.at_parts
    found = drift_at(data.t_s, residual, noise, at_rest, data.walk)
    shows = found is not None and (data.walk is None or shown_density(data.t_s, residual, noise, at_rest) is not None)
    if found is None:
        if course is not None:
            fit = fit_triad(poses, g_sensitivity=g_sensitivity, unknown_scale=unknown_scale, prior=prior)
        return poses, fit, followed, False, course
    drift, variance = found
    poses = replace(poses, measured=poses.measured - drift, variance=poses.variance + variance)
    fit = fit_triad(poses, g_sensitivity=g_sensitivity, unknown_scale=unknown_scale, prior=prior)
    return poses, fit, followed + drift, shows, course


def _joint_covariance(
    accelerometer: AccelerometerInPoses,
    poses: TriadPoses,
    fit: TriadFit,
    prior: TriadPrior | None,
    at: Callable[[Floats], TriadPoses],
) -> Floats:
    """Return the covariance (33, 33): errors of the accelerometer move the directions, and these the gyroscope.

    Parameters
    ----------
    at : poses by the accelerometer's sensitivity and bias (12,)
    """
    of_force = accelerometer.fit.covariance[:12, :12]
    theta, sigma = _theta(accelerometer), np.sqrt(np.diag(of_force))
    gain = _gain(poses, fit, prior)
    jacobian = np.zeros((21, 12))
    for j in np.flatnonzero(sigma > 0):
        step = np.zeros(12)
        step[j] = sigma[j]
        upper, lower = (_predicted(at(theta + sign * step), fit) for sign in (1, -1))
        jacobian[:, j] = -gain @ (upper - lower).ravel() / (2 * step[j])
    covariance = np.zeros((33, 33))
    covariance[:12, :12] = of_force
    covariance[_ANGULAR, :12] = jacobian @ of_force
    covariance[:12, _ANGULAR] = covariance[_ANGULAR, :12].T
    covariance[_ANGULAR, _ANGULAR] = fit.covariance + jacobian @ of_force @ jacobian.T
    return covariance


def _vectors(poses: TriadPoses) -> tuple[Floats, Floats]:
    """Return true rates (n, 3) [rad/s] and specific forces (n, 3) of directed poses."""
    assert poses.direction is not None and poses.force is not None  # noqa: PT018
    at_rest = poses.magnitude == 0
    rate = np.where(at_rest[:, None], 0.0, poses.magnitude[:, None] * poses.direction)
    return rate, poses.force


def _predicted(poses: TriadPoses, fit: TriadFit) -> Floats:
    """Return what the gyroscope should show, (n, 3) [unit]."""
    rate, force = _vectors(poses)
    return rate @ fit.sensitivity.T + fit.bias + force @ fit.g_sensitivity.T


def _gain(poses: TriadPoses, fit: TriadFit, prior: TriadPrior | None) -> Floats:
    """Return how errors of what the parts show move the parameters, (21, 3 n), by linear least squares."""
    rate, force = _vectors(poses)
    n, groups, eye = len(rate), len(poses.group_sigma), np.eye(3)
    assert poses.direction_sigma is not None
    along = rate @ fit.sensitivity.T
    level = along[:, :, None] * (poses.group[:, None] == np.arange(groups))[:, None, :]
    design = np.concatenate(
        [
            np.einsum("ab,nc->nabc", eye, rate).reshape(n, 3, 9),
            np.broadcast_to(eye, (n, 3, 3)),
            np.einsum("ab,nc->nabc", eye, force).reshape(n, 3, 9),
            level,
        ],
        axis=2,
    )
    turning = poses.magnitude > 0
    size = np.where(turning, poses.magnitude, 1.0)[:, None]
    unit = rate / size
    across = np.where(turning, poses.magnitude * np.where(turning, poses.direction_sigma, 0.0), poses.magnitude_sigma)
    beyond = across**2 + fit.extra_sigma**2
    lengths = (poses.magnitude_sigma**2 + fit.extra_sigma**2 - beyond) * turning
    spread = beyond[:, None, None] * eye + lengths[:, None, None] * unit[:, :, None] * unit[:, None, :]
    noise = poses.variance[:, :, None] * eye + fit.sensitivity @ spread @ fit.sensitivity.T
    weight = np.linalg.inv(noise) * fit.used[:, None, None]
    weighted = np.einsum("nia,nij->naj", design, weight)
    information = np.einsum("naj,njb->ab", weighted, design)
    if prior is not None:
        information[:21, :21] += prior.precision
    held = np.isin(poses.group_sigma, 0.0)
    information[21:, 21:] += np.diag(1 / np.where(held, 1.0, poses.group_sigma) ** 2)
    free = np.concatenate([fit.free, ~held])
    gain = np.zeros((21 + groups, 3 * n))
    scale = np.sqrt(np.diag(information)[free])
    inverse = np.linalg.pinv(information[np.ix_(free, free)] / np.outer(scale, scale), hermitian=True, rcond=1e-13)
    gain[free] = (inverse / np.outer(scale, scale)) @ weighted.transpose(1, 0, 2).reshape(21 + groups, 3 * n)[free]
    return gain[:21]
