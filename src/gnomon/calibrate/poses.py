"""An accelerometer by gravity's magnitude in many attitudes (Angrisano), and a gyroscope at rest (Krebs, 5.2).

prepare -> means of the rests -> known attitudes -> fit the accelerometer -> g-sensitivity -> assess -> Result
"""

from collections.abc import Callable

import numpy as np

from ..assess.changes import with_changes
from ..assess.imu.pose_tables import PoseFitSummary, RestingGyroscope, describe_poses
from ..assess.imu.poses_verdict import assess_poses
from ..assess.priors import NOTHING, Prior, Priors, gather_prior, prior_findings, prior_used, pulled_findings
from ..errors import DetectionError, InitialisationError, OptionError
from ..estimate.triads.attitudes import FEWEST, StatedAttitudes, compare_attitudes, rough_directions
from ..estimate.triads.gyroscope_at_rests import FEWEST_POSES
from ..estimate.triads.triad import PoseDrift, PoseStep, TriadFit, count_rival_step, fit_triad, fit_with_drift
from ..estimate.triads.triad_problem import PARAMETERS, TriadPoses, TriadPrior
from ..estimate.triads.triad_trust import robust_triad
from ..findings import Finding
from ..options import ImuOptions
from ..progress import Progress
from ..recording import Floats, Poses, Recording
from ..results.calibration import (
    AccelerometerCalibration,
    Calibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ..results.result import Result
from ..results.sensors import calibration_parameters
from ..units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2
from .published.angrisano import calibrate_poses_as_published
from .steps.pose_gyroscope import fit_gyroscope_at_rest
from .steps.pose_preparation import PreparedPoses, prepare_poses
from .steps.preparation import PreparedImu, local_gravity, refuse_evidence, stated_options
from .steps.stated_frame import in_stated_frame

_FEWEST_DETERMINED = 9
_APART_RAD = np.radians(10.0)
_LOWER = [3, 6, 7]  # of the sensitivity, in row order
_MISALIGNMENT = 0.02
"""Sigma of the angles between the axes of a triad that nobody measured, as data sheets state them [rad]."""
_JIG_RAD = np.radians(1.0)
_ROUNDS = 6
_TEXTBOOK = (9.8, 9.81, 9.807, 9.80665)


def calibrate_poses(
    recording: Recording,
    options: ImuOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
    checked: PreparedImu | None = None,
) -> Result:
    """Calibrate an accelerometer, and where there is a gyroscope its g-sensitivity, from rests in several attitudes.

    Parameters
    ----------
    recording : with rests, of poses that were averaged, or of one file each
    options : see ImuOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same sensor, which count as evidence; see `gnomon.assess.priors`
    checked : the recording as it was prepared before, with its rests

    Raises
    ------
    RecordingError
        If the recording cannot be used; DetectionError where it has too few attitudes.
    OptionError
        If an option does not fit the recording.
    InitialisationError
        If the attitudes determine no calibration.
    """
    options = options or ImuOptions()
    tell = progress or (lambda _: None)
    if options.preset not in ("gnomon", "angrisano"):
        raise OptionError(
            f"preset {options.preset} needs one recording with rests and rotations. For an accelerometer alone, "
            "averaged poses or files of one pose each choose the default preset or angrisano."
        )
    tell("finding the poses")
    prepared = prepare_poses(recording, options, checked)
    gravity = _gravity(prepared.poses, options)
    if options.preset == "angrisano":
        refuse_evidence(options, prior)
        return calibrate_poses_as_published(recording, prepared, gravity, options)
    poses = prepared.poses
    units = {"accelerometer": poses.accelerometer_unit}
    if poses.gyroscope is not None:
        units["gyroscope"] = poses.gyroscope_unit
    known = gather_prior(prior, options, units, free=options.free, gravity=gravity)
    attitudes = _distinct(poses)
    _require(attitudes, poses, known)
    tell(f"fitting {len(poses)} poses")
    fit, stated, drift, step = _fit_accelerometer(prepared, gravity, known, attitudes)
    fit, trust = robust_triad(fit, "imu0.accelerometer", t_s=poses.t_s, widened=options.covariance == "robust")
    gyroscope, why = _gyroscope(prepared, fit, known, gravity, options)
    tell("assessing the result")
    evidence = PoseFitSummary(
        poses=poses,
        start_s=prepared.start_s,
        stop_s=prepared.stop_s,
        noise_variance=prepared.variance,
        left_out=prepared.left_out,
        noticed=(*prepared.findings, *_agreement(prepared, fit, known, attitudes, gravity=gravity, options=options)),
        attitudes=attitudes,
        fit=fit,
        stated=stated,
        drift=drift,
        step=step,
        gyroscope=gyroscope,
        no_gyroscope=why,
        known=known,
        gravity=gravity,
        trust=trust,
    )
    diagnostics = describe_poses(evidence)
    imu, covariance = _sensor(fit, poses, gyroscope)
    imus = {"imu0": imu}
    calibration = Calibration(
        imus=imus,
        frame="accel-x" if stated is None else "user",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=covariance),
        assessment=assess_poses(evidence, diagnostics),
        provenance=Provenance(method="imu", inputs=recording.sources, options=stated_options(options, [recording])),
    )
    calibration = with_changes(calibration, diagnostics.trust)
    if stated is None:
        table = diagnostics.triads["accelerometer"].poses
        calibration = in_stated_frame(calibration, options.frame, table.measured, table.sigma)
    elif options.frame != "accel-x":
        raise OptionError(
            f'frame "{options.frame}": the known attitudes define the body frame, that of the jig. '
            "Leave out --frame, or the columns ref_x ref_y ref_z."
        )
    return Result(calibration=calibration, diagnostics=diagnostics)


def _gravity(poses: Poses, options: ImuOptions) -> Gravity:
    """Return local gravity; where no place was stated, known components that say more than a textbook tell it."""
    if options.gravity is not None or options.latitude is not None or poses.specific_force is None:
        return local_gravity(options)
    length = float(np.median(np.linalg.norm(poses.specific_force, axis=1)))
    if min(abs(length - value) for value in _TEXTBOOK) < 1e-4 or abs(length - STANDARD_GRAVITY_M_S2) > 0.06:
        return local_gravity(options)
    return Gravity(value=length, sigma=0.0, source="length of the known components")


def _distinct(poses: Poses) -> int:
    """Return how many attitudes are at least 10 deg apart."""
    kept: list[Floats] = []
    for u in rough_directions(poses.accelerometer, ACCELEROMETER_UNITS_M_S2[poses.accelerometer_unit]):
        if all(np.linalg.norm(u - other) > 2 * np.sin(_APART_RAD / 2) for other in kept):
            kept.append(u)
    return len(kept)


def _require(attitudes: int, poses: Poses, known: Prior) -> None:
    """Refuse poses that cannot determine an accelerometer."""
    fewest = FEWEST if poses.specific_force is not None else FEWEST_POSES
    if known.knows("imu0.accelerometer.sensitivity"):
        fewest = 1
    if attitudes >= fewest:
        return
    raise DetectionError(
        f"{len(poses)} poses in {attitudes} attitude{'' if attitudes == 1 else 's'} more than 10 deg apart: nine "
        "parameters of the accelerometer need nine attitudes or more; with six, every axis up once and down once, its "
        "scales and its bias are determined. Record 18 or more attitudes, all axes up and down and between."
    )


def _fit_accelerometer(
    prepared: PreparedPoses, gravity: Gravity, known: Prior, attitudes: int
) -> tuple[TriadFit, StatedAttitudes | None, PoseDrift | None, PoseStep | None]:
    """Fit the accelerometer to gravity's magnitude, and to the known attitudes where there are some."""
    poses = prepared.poses
    prior = known.triad_prior("accelerometer")

    def problem(direction: Floats | None, sigma_rad: float) -> TriadPoses:
        return TriadPoses.of(
            poses.accelerometer,
            gravity.value,
            variance=prepared.variance,
            group_sigma=gravity.sigma / gravity.value,
            direction=direction,
            direction_sigma=sigma_rad,
        )

    if poses.specific_force is not None:
        if prior is not None:
            raise OptionError(
                "known attitudes define a body frame of their own, that of the jig, in which a prior calibration does "
                "not know the accelerometer. Leave out --prior and --fix, or the columns ref_x ref_y ref_z."
            )
        return *_in_jig(poses, problem), None, None
    if attitudes < _FEWEST_DETERMINED and not known.knows("imu0.accelerometer.sensitivity"):
        prior = _assumed_angles(poses, gravity.value, prior)
    fit, drift = fit_with_drift(problem(None, 0.0), poses.t_s, prior)
    fit, step = count_rival_step(problem(None, 0.0), fit, prior)
    return fit, None, drift, step


def _agreement(
    prepared: PreparedPoses, fit: TriadFit, known: Prior, attitudes: int, *, gravity: Gravity, options: ImuOptions
) -> list[Finding]:
    """Say what was known beforehand and, where the poses determine the sensors alone, whether they agree."""
    if not known or prepared.poses.specific_force is not None:
        return prior_used(known)
    if attitudes < _FEWEST_DETERMINED:
        sensor, covariance = _sensor(fit, prepared.poses, None)
        return pulled_findings(
            known, np.concatenate([value.ravel() for _, value in calibration_parameters({"": sensor})]), covariance
        )
    try:
        alone, *_ = _fit_accelerometer(prepared, gravity, NOTHING, attitudes)
        gyroscope, _ = _gyroscope(prepared, alone, NOTHING, gravity, options)
    except InitialisationError:
        return prior_used(known)
    sensor, covariance = _sensor(alone, prepared.poses, gyroscope)
    return prior_findings(
        known, np.concatenate([value.ravel() for _, value in calibration_parameters({"": sensor})]), covariance
    )


def _assumed_angles(poses: Poses, gravity_m_s2: float, prior: TriadPrior | None) -> TriadPrior:
    """Return the prior with the angles between the axes as a data sheet states them: zero, give or take 0.02 rad."""
    scale = np.ptp(poses.accelerometer, axis=0) / (2 * gravity_m_s2)
    mean = np.zeros(PARAMETERS) if prior is None else prior.mean.copy()
    precision = np.zeros((PARAMETERS, PARAMETERS)) if prior is None else prior.precision.copy()
    for entry in _LOWER:
        precision[entry, entry] += 1 / (_MISALIGNMENT * scale[entry // 3]) ** 2
    fixed = np.zeros(PARAMETERS, dtype=bool) if prior is None else prior.fixed
    return TriadPrior(mean=mean, precision=precision, fixed=fixed)


def _in_jig(
    poses: Poses, problem: Callable[[Floats | None, float], TriadPoses]
) -> tuple[TriadFit, StatedAttitudes | None]:
    """Fit in the frame of the jig; how exactly the attitudes were set is found from how well they agree."""
    assert poses.specific_force is not None
    stated = poses.specific_force / np.linalg.norm(poses.specific_force, axis=1, keepdims=True)
    unit_si = ACCELEROMETER_UNITS_M_S2[poses.accelerometer_unit]
    found = compare_attitudes(rough_directions(poses.accelerometer, unit_si), stated)
    right = ~found.wrong
    n = int(right.sum())
    if n < FEWEST:
        raise InitialisationError(
            f"only {n} of {len(poses)} known attitudes agree with each other. Check the signs and the order of the "
            "columns ref_x ref_y ref_z: at rest the specific force points up, so the axis that points up reads +g."
        )
    direction = np.where(right[:, None], stated, np.nan)
    redundant = 2 * n - 3 if n >= _FEWEST_DETERMINED else 3 * n - 12
    sigma = _JIG_RAD
    fit = fit_triad(problem(direction, sigma))
    for _ in range(_ROUNDS if redundant > 0 else 0):
        x = fit.physical(poses.accelerometer)
        kept = right & fit.used
        off = np.linalg.norm(np.cross(x, stated), axis=1)[kept] / np.linalg.norm(x, axis=1)[kept]
        old, sigma = sigma, max(float(np.sqrt(np.sum(off**2) / redundant)), 1e-7)
        fit = fit_triad(problem(direction, sigma))
        if abs(sigma - old) < 0.03 * sigma:
            break
    return fit, StatedAttitudes(
        turn=found.turn, angle_rad=found.angle_rad, wrong=found.wrong, guess=found.guess, sigma_rad=sigma
    )


def _gyroscope(
    prepared: PreparedPoses, fit: TriadFit, known: Prior, gravity: Gravity, options: ImuOptions
) -> tuple[RestingGyroscope | None, str]:
    """Fit the gyroscope at rest; None where there is none, or why its rests do not suffice."""
    if prepared.poses.gyroscope is None:
        return None, ""
    try:
        return fit_gyroscope_at_rest(prepared, fit, known, gravity, options), ""
    except InitialisationError as error:
        if options.model == "static":
            raise
        return None, str(error)


def _sensor(fit: TriadFit, poses: Poses, gyroscope: RestingGyroscope | None) -> tuple[ImuCalibration, Floats]:
    """Return the sensor and the covariance of its scalars."""
    accelerometer = AccelerometerCalibration(sensitivity=fit.sensitivity, bias=fit.bias, unit=poses.accelerometer_unit)
    if gyroscope is None or gyroscope.sensitivity is None:
        return ImuCalibration(accelerometer=accelerometer), fit.covariance[:12, :12]
    sensor = GyroscopeCalibration(
        sensitivity=gyroscope.sensitivity,
        bias=gyroscope.bias,
        g_sensitivity=gyroscope.g_sensitivity,
        unit=poses.gyroscope_unit,
    )
    return ImuCalibration(accelerometer=accelerometer, gyroscope=sensor), gyroscope.covariance
