"""A magnetometer turned by hand through all attitudes; with an accelerometer beside it, in that one's frame.

prepare -> poses -> fit -> up, and the dip -> assess -> Result
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .._version import __version__
from ..assess.changes import with_changes
from ..assess.magnetometer_tables import FieldEvidence, describe_field
from ..assess.magnetometer_verdict import assess_field
from ..calibration import (
    AccelerometerCalibration,
    Calibration,
    Covariance,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    covariance_names,
)
from ..diagnostics import Result
from ..errors import InitialisationError, OptionError
from ..estimate.triads.blocks import Blocks, block_covariance, left_out, memory_s
from ..estimate.triads.dip import DipFit, fit_dip, in_body_frame
from ..estimate.triads.field_poses import FieldPoses, field_poses, sample_noise
from ..estimate.triads.field_trust import field_trust
from ..estimate.triads.gravity_along import GravityFit, fit_gravity, force_at
from ..estimate.triads.magnetometer import (
    MagnetometerFit,
    fit_magnetometer,
    stray_samples,
    with_soft_iron_unknown,
)
from ..evidence import Evidence, Priors, known_beforehand, refuse_own_data
from ..models.frames import frame_rotation, rotation_jacobian
from ..options import ImuOptions
from ..recording import Floats, Recording
from ..triad_options import MagnetometerOptions
from .arguments import check_arguments
from .magnetometer_preparation import PreparedField, check_field_options, prepare_field
from .preparation import local_gravity, stated_options

Progress = Callable[[str], None]

_LEAST_KNOWN_RAD = 0.1  # sigma of the rotation to the accelerometer beyond which it is not used


def calibrate_magnetometer(
    recording: Recording,
    options: MagnetometerOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
) -> Result:
    """Calibrate a magnetometer from a recording in which it was turned by hand through all attitudes.

    With an accelerometer in the recording the two are related by the constant dip of the field, and the accelerometer
    is calibrated along.

    Parameters
    ----------
    recording : of one IMU, or of a magnetometer alone
    options : see MagnetometerOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same sensors

    Raises
    ------
    RecordingError
        If the recording cannot be used; DetectionError where the sensor was not turned enough.
    OptionError
        If an option or the prior does not fit the recording.
    InitialisationError
        If its attitudes determine no calibration.
    """
    check_arguments("calibrate_magnetometer", recording)
    options = options or MagnetometerOptions()
    tell = progress or (lambda _: None)
    tell("checking the recording")
    check_field_options(prior, options)
    refuse_own_data(prior, recording.sources, ("magnetometer",))
    prepared = prepare_field(recording, options)
    known = _known(prepared, options, prior)
    tell(f"fitting the ellipsoid of {len(prepared.magnetometer)} samples")
    poses, fit, rivals = _fit_models(prepared, options, known)
    tell("relating the magnetometer to the accelerometer")
    gravity = local_gravity(ImuOptions())
    up, dip = _beside_accelerometer(prepared, poses, fit, known, gravity.value)
    tell("assessing the result")
    imu, covariance, dip_sigma = _calibrated(prepared, poses, fit=fit, up=up, dip=dip, options=options)
    evidence = FieldEvidence(
        t_s=prepared.t_s,
        values=prepared.magnetometer.values,
        usable=prepared.usable,
        unit=prepared.magnetometer.unit,
        field=options.field,
        stated_dip_deg=options.dip,
        latitude_deg=options.latitude,
        poses=poses,
        fit=fit,
        rivals=rivals,
        up=up,
        accelerometer=prepared.accelerometer,
        dip=dip,
        dip_sigma_rad=dip_sigma,
        imu=imu,
        covariance=covariance,
        gravity=gravity,
        trust=field_trust(rivals["full"], poses.t_s),
    )
    imus = {"imu0": imu}
    calibration = Calibration(
        imus=imus,
        frame="mag-x" if imu.accelerometer is None else "accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=covariance),
        assessment=assess_field(prepared.findings, evidence, known, prepared.accelerometer is not None),
        provenance=Provenance(
            gnomon_version=__version__,
            method="magnetometer",
            inputs=recording.sources,
            options=stated_options(options),
        ),
    )
    calibration = with_changes(calibration, evidence.trust.trust)
    return Result(calibration=calibration, diagnostics=describe_field(evidence))


def _known(prepared: PreparedField, options: MagnetometerOptions, prior: Priors) -> Evidence:
    units = {"magnetometer": prepared.magnetometer.unit}
    if prepared.accelerometer is not None:
        units["accelerometer"] = prepared.accelerometer.unit
    return known_beforehand(prior, options, units, free=options.free)


def _fit_models(
    prepared: PreparedField, options: MagnetometerOptions, known: Evidence
) -> tuple[FieldPoses, MagnetometerFit, dict[str, MagnetometerFit]]:
    """Fit a full sensitivity, and beside it, or where it is wanted instead, one scale.

    Soft iron that is not significant is no more certain for being left out, so that only an option leaves it out.
    """
    shape, usual, field = prepared.shape, prepared.usual, options.field or 1.0
    prior = known.triad_prior("magnetometer", own_frame=True)
    if prior is not None and options.model == "hard-iron":
        raise OptionError(
            "model hard-iron has one scale and takes no prior. Leave the prior out, or take --model full."
        )
    samples = prepared.magnetometer.values
    poses = field_poses(prepared.t_s, samples, prepared.usable, shape)
    fit = fit_magnetometer(poses, shape, usual, field=field, prior=prior)
    stray = stray_samples(samples, poses.noise, fit) & prepared.usable
    if stray.any():
        poses = field_poses(prepared.t_s, samples, prepared.usable & ~stray, shape)
        fit = fit_magnetometer(poses, shape, usual, field=field, prior=prior)
    rivals: dict[str, MagnetometerFit] = {"full": fit}
    if options.model != "full" and prior is None:
        rivals["hard-iron"] = fit_magnetometer(poses, shape, usual, field=field, model="hard-iron")
        if options.model == "hard-iron":
            fit = rivals["hard-iron"] = with_soft_iron_unknown(rivals["hard-iron"], rivals["full"])
    return poses, fit, rivals


def _beside_accelerometer(
    prepared: PreparedField, poses: FieldPoses, fit: MagnetometerFit, known: Evidence, gravity_m_s2: float
) -> tuple[GravityFit | None, DipFit | None]:
    """Calibrate the accelerometer along and find how the magnetometer stands to it; None where that cannot be told."""
    accelerometer = prepared.accelerometer
    if accelerometer is None:
        return None, None
    t_s = prepared.t_s
    force = force_at(prepared.accelerometer_t_s, accelerometer.values, t_s[poses.start], t_s[poses.stop - 1])
    prior = known.triad_prior("accelerometer", own_frame=True)
    noise = sample_noise(accelerometer.values)
    try:
        up = fit_gravity(poses.t_s, force, poses.length, noise=noise, gravity_m_s2=gravity_m_s2, prior=prior)
    except InitialisationError:
        return None, None
    used = up.used & fit.used
    sigma = np.hypot(up.sigma, fit.sigma / fit.field)
    turn = fit.iron.in_own_frame
    by = {"by_up": up.by_parameters, "by_field": fit.by_parameters}
    dip = fit_dip(up.up, fit.direction, sigma, used, **by, turn=turn)
    return up, dip


def _calibrated(
    prepared: PreparedField,
    poses: FieldPoses,
    *,
    fit: MagnetometerFit,
    up: GravityFit | None,
    dip: DipFit | None,
    options: MagnetometerOptions,
) -> tuple[ImuCalibration, Floats, float]:
    """Return the sensors, in the accelerometer's frame where it is known, their covariance, and the dip's sigma."""
    unit, field_unit = prepared.magnetometer.unit, "local field" if options.field is None else "uT"
    iron = fit.iron
    magnetometer = MagnetometerCalibration(
        sensitivity=iron.sensitivity, bias=iron.bias, unit=unit, field_unit=field_unit
    )
    covariance = iron.basis @ fit.covariance @ iron.basis.T
    if up is None or dip is None or prepared.accelerometer is None:
        return *_in_own_frame(magnetometer, covariance), float("nan")
    stages = [fit.stage, up.stage, dip.stage]
    t_s = poses.t_s
    slowest = max(memory_s(t_s[at], stage.residual[at]) for stage in stages if (at := stage.residual != 0).any())
    blocks = Blocks.of(t_s, max(slowest, fit.blocks.memory_s))
    joint = block_covariance(stages, blocks, left_out(stages, blocks.block))
    joint += _by_what_was_left_out(fit, up, dip)
    sigma = np.sqrt(np.diag(joint))
    dip_sigma = float(sigma[-1] / max(np.cos(dip.dip_rad), 1e-3))
    if iron.in_own_frame and not sigma[-4:-1].max() < _LEAST_KNOWN_RAD:
        return *_in_own_frame(magnetometer, covariance), dip_sigma
    body, jacobian = in_body_frame(iron.sensitivity, dip.rotation)
    own, beside = iron.basis.shape[1], np.flatnonzero(up.triad.free[:12])
    by = np.zeros((24, len(joint)))
    by[beside, own + np.arange(len(beside))] = 1.0
    by[12:21, :own] = jacobian[:, :9] @ iron.basis[:9]
    by[21:, :own] = iron.basis[9:]
    if iron.in_own_frame:
        by[12:21, -4:-1] = jacobian[:, 9:]
    imu = ImuCalibration(
        accelerometer=AccelerometerCalibration(
            sensitivity=up.triad.sensitivity, bias=up.triad.bias, unit=prepared.accelerometer.unit
        ),
        magnetometer=replace(magnetometer, sensitivity=body),
    )
    return imu, by @ joint @ by.T, dip_sigma


def _by_what_was_left_out(fit: MagnetometerFit, up: GravityFit, dip: DipFit) -> Floats:
    """Return what soft iron that was left out adds to the joint covariance, the dip's own parameters included."""
    turned = -dip.stage.covariance @ (dip.stage.jacobian.T @ (dip.stage.earlier[0] @ fit.left_out))
    shift = np.concatenate([fit.left_out, np.zeros(len(up.stage.covariance)), turned])
    return np.outer(shift, shift)


def _in_own_frame(sensor: MagnetometerCalibration, covariance: Floats) -> tuple[ImuCalibration, Floats]:
    """Return a magnetometer in frame mag-x, where a prior may have put it into another one, and its covariance."""
    turn = frame_rotation(sensor.sensitivity, "accel-x")
    jacobian = rotation_jacobian([sensor.sensitivity, sensor.bias], turn, "accel-x")
    sensitivity = np.tril(sensor.sensitivity @ turn.T)
    covariance = jacobian @ covariance @ jacobian.T
    return ImuCalibration(magnetometer=replace(sensor, sensitivity=sensitivity)), covariance
