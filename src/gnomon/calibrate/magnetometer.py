"""A magnetometer turned by hand through all attitudes; with an accelerometer beside it, in that one's frame.

prepare -> poses -> fit -> up, and the dip -> assess -> Result
"""

from dataclasses import replace

import numpy as np

from ..assess.changes import with_changes
from ..assess.checks.doctor import check_field_samples
from ..assess.imu.magnetometer_verdict import FieldFitSummary, assess_field, describe_field
from ..assess.imu.temperature import check_temperature
from ..assess.priors import Prior, Priors, gather_prior, refuse_own_data
from ..detect.samples.faults import repair_samples, saturated_samples
from ..errors import DetectionError, InitialisationError, OptionError, RecordingError
from ..estimate.triads.attitudes import DipFit, GravityFit, fit_dip, fit_gravity, force_at, in_body_frame
from ..estimate.triads.field_poses import FieldPoses, field_poses, rough_ellipsoid, sample_noise, usual_distance
from ..estimate.triads.magnetometer import (
    MagnetometerFit,
    field_trust,
    fit_magnetometer,
    stray_samples,
    with_soft_iron_unknown,
)
from ..estimate.triads.triad_start import Ellipsoid, near_ellipsoid
from ..estimate.triads.triad_trust import TimeBlocks, block_covariance, leave_blocks_out, memory_s
from ..estimate.trust.changes import start_of_estimates
from ..findings import Finding, make_finding
from ..frozen import value_class
from ..geometry.rotations import frame_rotation, rotation_jacobian
from ..options import ImuOptions, MagnetometerOptions
from ..progress import Progress
from ..recording import Floats, Recording, TemperatureSamples, TriadSamples
from ..recording.samples import time_base
from ..results.calibration import (
    AccelerometerCalibration,
    Calibration,
    Covariance,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    covariance_names,
)
from ..results.result import Booleans, Result
from .steps.preparation import check_arguments, local_gravity, stated_options
from .steps.temperature_while_turned import FieldOverTemperature, field_over_temperature, rose_and_fell

_FIELDS_UT = (10.0, 200.0)
_FEWEST, _SHORTEST_S = 100, 5.0
_STILL = 15.0  # times the noise that the range of a turned sensor exceeds
_FLAT = 0.04  # of the widest direction


@value_class
class PreparedField:
    """A magnetometer's recording, ready for estimation.

    Attributes
    ----------
    magnetometer : samples without duplicates
    t_s : (n,) instants of sampling [s]
    usable : (n,) bool, not clipped
    accelerometer : beside it, or None where there is none that can be used
    accelerometer_t_s : its instants of sampling, on the same clock
    shape, usual : rough ellipsoid of radius 1, and the usual distance of samples from it
    findings : what was noticed
    thermometer : its readings, where they rose and fell
    """

    magnetometer: TriadSamples
    t_s: Floats
    usable: Booleans
    accelerometer: TriadSamples | None
    accelerometer_t_s: Floats
    shape: Ellipsoid
    usual: float
    findings: tuple[Finding, ...]
    thermometer: TemperatureSamples | None = None


def prepare_field(recording: Recording, options: MagnetometerOptions) -> PreparedField:
    """Check a recording and put its first magnetometer on its time base.

    Raises
    ------
    RecordingError
        If there is no magnetometer, or its samples are of no use.
    DetectionError
        If it was not turned, or about one axis only.
    """
    found = next(((name, imu) for name, imu in recording.imus.items() if imu.magnetometer is not None), None)
    if found is None:
        raise RecordingError(
            "the recording holds no magnetometer. Give a file with one; if its columns have other names, state them: "
            '--columns "t mx my mz" (_ skips a column).'
        )
    name, imu = found
    assert imu.magnetometer is not None
    findings = _checked(imu.magnetometer, f"{name} magnetometer")
    findings += [make_finding("assumed", text=sentence) for sentence in recording.assumptions]
    if imu.temperature is not None:
        findings += [one for one in check_temperature(imu.temperature, f"{name} thermometer") if one.severity != "good"]
    magnetometer = repair_samples(imu.magnetometer)
    accelerometer, more = _usable_accelerometer(imu.accelerometer, f"{name} accelerometer")
    origin = int(magnetometer.t_ns[0])
    if accelerometer is not None:
        origin = min(origin, int(accelerometer.t_ns[0]))
    t_s = time_base(magnetometer, origin).t_s
    usable = ~saturated_samples(magnetometer, options.magnetometer_range)
    if usable.sum() < _FEWEST:
        raise RecordingError(
            f"{int((~usable).sum())} of {len(usable)} samples of the magnetometer stand at the end of its range. "
            "Set a wider range, or go farther away from iron and magnets."
        )
    shape, usual = _rough(magnetometer.values[usable], None if (near := _near()) is None else near.magnetometer)
    return PreparedField(
        magnetometer=magnetometer,
        t_s=t_s,
        usable=usable,
        accelerometer=accelerometer,
        accelerometer_t_s=np.empty(0) if accelerometer is None else time_base(accelerometer, origin).t_s,
        shape=shape,
        usual=usual,
        findings=(*findings, *more),
        thermometer=imu.temperature if rose_and_fell(imu.temperature) else None,
    )


def _near() -> ImuCalibration | None:
    """Return the sensors from which iterations start, where an estimate alone is wanted."""
    start = start_of_estimates()
    return None if start is None else next(iter(start.imus.values()), None)


def _checked(samples: TriadSamples, label: str) -> list[Finding]:
    if len(samples) < _FEWEST or samples.duration_s < _SHORTEST_S:
        raise RecordingError(
            f"{label}: {len(samples)} samples over {samples.duration_s:.1f} s are too short a recording. "
            "Turn the sensor slowly through all attitudes, for a minute or two."
        )
    findings = check_field_samples(samples, label)
    for finding in findings:
        if finding.severity == "problem":
            raise RecordingError(str(finding))
    return [finding for finding in findings if finding.severity != "good"]


def _usable_accelerometer(samples: TriadSamples, label: str) -> tuple[TriadSamples | None, list[Finding]]:
    """Return the accelerometer where nothing is wrong with it, and else what is."""
    if len(samples) < _FEWEST:
        return None, []
    findings = check_field_samples(samples, label)
    wrong = [finding for finding in findings if finding.severity == "problem"]
    if not wrong:
        return repair_samples(samples), [finding for finding in findings if finding.severity != "good"]
    consequence = "The accelerometer is not used; the magnetometer is calibrated in a frame of its own."
    return None, [replace(wrong[0], severity="warning", consequence=consequence)]


def _rough(values: Floats, known: MagnetometerCalibration | None = None) -> tuple[Ellipsoid, float]:
    low, high = np.quantile(values, (0.01, 0.99), axis=0)
    if float((high - low).max()) < _STILL * float(sample_noise(values).max()):
        raise DetectionError(
            "the magnetometer shows the same field throughout: it was kept in one orientation. "
            "Turn the sensor through all attitudes, each axis once along the field and once against it."
        )
    inside = values[((values >= low - (high - low)) & (values <= high + (high - low))).all(axis=1)]
    centred = inside - inside.mean(axis=0)
    spread, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    thin = np.sqrt(max(float(spread[0]), 0.0))
    if thin < max(_FLAT * np.sqrt(float(spread[2])), 3 * float(sample_noise(values).max())):
        axis = "xyz"[int(np.argmax(np.abs(axes[:, 0])))]
        raise DetectionError(
            f"the magnetometer was turned about one axis only, most likely {axis}: all it measured lies in one plane. "
            f"Turn it about the other axes too, so that {axis} points along the field and against it."
        )
    if known is not None:
        near = near_ellipsoid(values, np.ones(len(values)), known.sensitivity, known.bias)
        if near is not None:
            return near, usual_distance(values, near)
    found = rough_ellipsoid(values)
    if found is None:
        raise DetectionError(
            "what the magnetometer measured surrounds no ellipsoid. Turn the sensor through all attitudes in one "
            "place, away from iron and magnets."
        )
    return found


def check_field_options(prior: Priors, options: MagnetometerOptions) -> None:
    """Refuse options that cannot be meant, and to mix sensitivities per uT with those per local field.

    Raises
    ------
    OptionError
        If the field, the place or the range is none, or a prior's or a stated sensitivity is in the other unit.
    """
    if options.field is not None and not _FIELDS_UT[0] < options.field < _FIELDS_UT[1]:
        raise OptionError(
            f"field {options.field:g} uT is found nowhere on Earth (22 to 67 uT). Give the local strength in "
            "microtesla, or leave it out."
        )
    if options.dip is not None and not -90 <= options.dip <= 90:
        raise OptionError(f"dip {options.dip:g} deg is not between -90 and 90.")
    if options.magnetometer_range is not None and not options.magnetometer_range > 0:
        raise OptionError(f"magnetometer_range {options.magnetometer_range:g} must be greater than zero.")
    here = "local field" if options.field is None else "uT"
    priors = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    sensors: list[MagnetometerCalibration] = [
        imu.magnetometer for one in priors for imu in one.imus.values() if imu.magnetometer is not None
    ]
    for sensor in sensors:
        if sensor.field_unit != here:
            hint = "State --field in uT." if here == "local field" else "Leave --field out."
            raise OptionError(f"the prior calibration's field is in {sensor.field_unit}, here it is in {here}. {hint}")
    named = [
        text for text in (*options.fix, *options.prior) if "magnetometer.sens" in text or text.endswith("magnetometer")
    ]
    if named and here == "local field" and not sensors:
        raise OptionError(
            f"{named[0]}: the sensitivity has no value to be held at while the strength of the field is unknown. "
            "State it with --field in uT."
        )


_ROUNDS = 3  # a rough one, and two by windows of time
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
    fitted = _fit_models(prepared, options, known)
    prepared, (poses, fit, rivals), warm = _without_temperature(prepared, fitted, options, known)
    tell("relating the magnetometer to the accelerometer")
    gravity = local_gravity(ImuOptions())
    up, dip = _beside_accelerometer(prepared, poses, fit, known, gravity.value)
    tell("assessing the result")
    imu, covariance, dip_sigma = _calibrated(prepared, poses, fit=fit, up=up, dip=dip, options=options)
    evidence = FieldFitSummary(
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
            method="magnetometer", inputs=recording.sources, options=stated_options(options, [recording])
        ),
    )
    calibration = with_changes(calibration, evidence.trust.trust)
    calibration = calibration if warm is None else warm.added_to(calibration)
    return Result(calibration=calibration, diagnostics=describe_field(evidence))


def _known(prepared: PreparedField, options: MagnetometerOptions, prior: Priors) -> Prior:
    units = {"magnetometer": prepared.magnetometer.unit}
    if prepared.accelerometer is not None:
        units["accelerometer"] = prepared.accelerometer.unit
    return gather_prior(prior, options, units, free=options.free)


_Fitted = tuple[FieldPoses, MagnetometerFit, dict[str, MagnetometerFit]]


def _without_temperature(
    prepared: PreparedField, fitted: _Fitted, options: MagnetometerOptions, known: Prior
) -> tuple[PreparedField, _Fitted, FieldOverTemperature | None]:
    """Return samples as they would be at the mean temperature, their fits, and what was taken off; None where nothing.

    What the temperature does is found beside a fit that lacks it, so that both are found again without it.
    """
    samples, before, warm = prepared.magnetometer, (prepared, fitted), None
    for _ in range(0 if prepared.thermometer is None else _ROUNDS):
        poses, fit, rivals = fitted
        assert prepared.thermometer is not None
        found = field_over_temperature(poses, rivals["full"], samples.t_ns, prepared.thermometer, warm)
        if found is None:
            return *before, None
        warm = found
        values = warm.known.to_reference("magnetometer", samples.values, warm.degc, rivals["full"].iron.bias)
        try:
            shape, usual = _rough(values[prepared.usable])
            prepared = replace(prepared, magnetometer=replace(samples, values=values), shape=shape, usual=usual)
            fitted = _fit_models(prepared, options, known)
        except (DetectionError, InitialisationError):
            return *before, None
    if warm is None:
        return *before, None
    poses, fit, rivals = fitted
    wider = warm.widened(fit, poses)
    return prepared, (poses, wider, {name: wider if one is fit else one for name, one in rivals.items()}), warm


def _fit_models(prepared: PreparedField, options: MagnetometerOptions, known: Prior) -> _Fitted:
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
    near = _near() is not None
    poses = field_poses(prepared.t_s, samples, prepared.usable, shape)
    fit = fit_magnetometer(poses, shape, usual, field=field, prior=prior, near=near)
    stray = stray_samples(samples, poses.noise, fit) & prepared.usable
    if stray.any():
        poses = field_poses(prepared.t_s, samples, prepared.usable & ~stray, shape)
        fit = fit_magnetometer(poses, shape, usual, field=field, prior=prior, near=near)
    rivals: dict[str, MagnetometerFit] = {"full": fit}
    if options.model != "full" and prior is None and not near:
        try:
            rivals["hard-iron"] = fit_magnetometer(poses, shape, usual, field=field, model="hard-iron")
        except InitialisationError:  # on a small part of a sphere
            if options.model == "hard-iron":
                raise
        if options.model == "hard-iron":
            fit = rivals["hard-iron"] = with_soft_iron_unknown(rivals["hard-iron"], rivals["full"])
    return poses, fit, rivals


def _beside_accelerometer(
    prepared: PreparedField, poses: FieldPoses, fit: MagnetometerFit, known: Prior, gravity_m_s2: float
) -> tuple[GravityFit | None, DipFit | None]:
    """Calibrate the accelerometer along and find how the magnetometer stands to it; None where that cannot be told."""
    accelerometer = prepared.accelerometer
    if accelerometer is None:
        return None, None
    t_s = prepared.t_s
    force = force_at(prepared.accelerometer_t_s, accelerometer.values, t_s[poses.start], t_s[poses.stop - 1])
    prior = known.triad_prior("accelerometer", own_frame=True)
    near = _near()
    try:
        up = fit_gravity(
            poses.t_s,
            force,
            poses.length,
            noise=sample_noise(accelerometer.values),
            gravity_m_s2=gravity_m_s2,
            prior=prior,
            known=None if near is None else near.accelerometer,
        )
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
    blocks = TimeBlocks.of(t_s, max(slowest, fit.blocks.memory_s))
    joint = block_covariance(stages, blocks, leave_blocks_out(stages, blocks.block))
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
    """Return what was left out of the model, or taken off before, adds to the joint covariance, the dip included."""
    turned = -dip.stage.covariance @ (dip.stage.jacobian.T @ (dip.stage.earlier[0] @ fit.left_out))
    shift = np.concatenate([fit.left_out, np.zeros((len(up.stage.covariance), fit.left_out.shape[1])), turned])
    return shift @ shift.T


def _in_own_frame(sensor: MagnetometerCalibration, covariance: Floats) -> tuple[ImuCalibration, Floats]:
    """Return a magnetometer in frame mag-x, where a prior may have put it into another one, and its covariance."""
    turn = frame_rotation(sensor.sensitivity, "accel-x")
    jacobian = rotation_jacobian([sensor.sensitivity, sensor.bias], turn, "accel-x")
    sensitivity = np.tril(sensor.sensitivity @ turn.T)
    covariance = jacobian @ covariance @ jacobian.T
    return ImuCalibration(magnetometer=replace(sensor, sensitivity=sensitivity)), covariance
