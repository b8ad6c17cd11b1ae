"""A gyroscope on a turntable (Angrisano, sections "Procedures" and "Results").

prepare: steady parts, their speeds, whole turns, attitudes -> accelerometer by gravity -> gyroscope by the speeds
-> choose the model -> hold out -> assess -> Result
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..assess.changes import with_changes
from ..assess.imu.recording_changes import slope_finding
from ..assess.imu.turntable_verdict import TurntableFitSummary, assess_turntable, describe_turntable
from ..assess.priors import NOTHING, Prior, Priors, gather_prior, prior_findings, prior_used, refuse_own_data
from ..errors import DetectionError, InitialisationError, OptionError, SolveError
from ..estimate.turntable.fit import AccelerometerInPoses, TurntableFit, fit_platter_accelerometer, fit_turntable
from ..estimate.turntable.parts import NO_SPEED, TurntableParts, reassign_speeds
from ..findings import Finding
from ..options import StatedRate, TurntableOptions
from ..progress import Progress
from ..recording import Recording
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
from ..results.sensor_diagnostics import PeriodCurve
from ..units import GYROSCOPE_UNITS_RAD_S
from .steps.preparation import check_arguments, local_gravity, recording_names, refuse_same_data, stated_options
from .steps.turntable_preparation import prepare_turntable

RATE_SCALE = "rate.scale"
_RATE_TOLERANCE = 0.05  # of a calibrated gyroscope; beyond, a part turned at another speed
_PARAMETERS_OF_G = 9  # in squared sigmas: what noise alone may gain
_ONE_ORIENTATION = 0.95  # share of the largest singular value of the axes: all within some 15 deg


def calibrate_turntable(
    recordings: Sequence[Recording],
    rates: Sequence[StatedRate],
    options: TurntableOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
    *,
    rate_of: Sequence[StatedRate | None] | None = None,
    videos: tuple[PeriodCurve, ...] = (),
) -> Result:
    """Calibrate a gyroscope, and how it lies to the accelerometer, from recordings on a turntable.

    Parameters
    ----------
    recordings : of one sensor in many orientations on the platter: one with many steady parts, or several
    rates : speeds that occur; each steady part has the one that is nearest to what it shows, or rests
    options : see TurntableOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same sensor, which count as evidence
    rate_of : of each recording its own speed, or None; may stand instead of `rates`
    videos : what videos showed of the speeds, for the report

    Raises
    ------
    OptionError
        If an option does not fit, or no speed but zero is stated.
    RecordingError
        If a recording cannot be used; DetectionError where nothing turns, or only in one orientation.
    InitialisationError
        If the orientations determine no calibration.
    """
    check_arguments("calibrate_turntable", *([recordings] if isinstance(recordings, str | Recording) else recordings))
    options = options or TurntableOptions()
    tell = progress or (lambda _: None)
    unknown_scale, free = RATE_SCALE in options.free, tuple(name for name in options.free if name != RATE_SCALE)
    for recording in recordings:
        refuse_own_data(prior, recording.sources)
    if len(recordings) > 1:
        refuse_same_data(recordings, recording_names(recordings))
    tell("finding the steady parts")
    prepared = prepare_turntable(recordings, rates, rate_of, options)
    prepared = replace(prepared, data=replace(prepared.data, walk=_known_walk(recordings, prepared)))
    gravity = local_gravity(options)
    known = gather_prior(prior, options, _units(prepared), free=free, gravity=gravity)
    tell(f"fitting {len(prepared.names)} steady parts")

    def fitted(parts: TurntableParts) -> tuple[TurntableParts, TurntableFit, dict[str, TurntableFit], str]:
        _refuse_one_orientation(parts)
        accelerometer, why = _accelerometer(parts, known, gravity)
        fit, rivals = _choose_model(parts, accelerometer, known, options, unknown_scale=unknown_scale)
        return parts, fit, rivals, why

    prepared, fit, rivals, why = fitted(prepared)
    again = _by_calibrated_rate(prepared, fit, unknown_scale=unknown_scale)
    if again is not prepared:
        prepared, fit, rivals, why = fitted(again)
    tell("assessing the result")
    evidence = TurntableFitSummary(
        parts=prepared, fit=fit, rivals=rivals, gravity=gravity, no_accelerometer=why, videos=videos
    )
    diagnostics = describe_turntable(evidence)
    imus = {"imu0": _sensor(fit, prepared)}
    calibration = Calibration(
        imus=imus,
        frame="gyro-x" if fit.accelerometer is None else "accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=fit.covariance),
        assessment=assess_turntable(
            evidence, diagnostics, options, agreement=_agreement(prepared, known, options, gravity)
        ),
        provenance=Provenance(
            method="turntable",
            inputs=tuple(source for recording in recordings for source in recording.sources),
            options={
                "rates": " ".join(rate.name for rate in prepared.rates[:-1]),
                **stated_options(options, recordings),
            },
        ),
    )
    calibration = with_changes(calibration, diagnostics.trust)
    return Result(calibration=_with_course(calibration, prepared, fit), diagnostics=diagnostics)


def _with_course(calibration: Calibration, parts: TurntableParts, fit: TurntableFit) -> Calibration:
    """Return the calibration with what the gyroscope's bias does with the temperature, where the rests tell it."""
    course, known = fit.course, parts.temperature
    if course is None or known is None:
        return calibration
    known = replace(known, gyroscope_bias=course.slopes)
    calibration = calibration.with_temperature("imu0", known, {"gyroscope_bias": course.covariance})
    uncertainty, assessed = calibration.uncertainty, calibration.assessment
    at = [uncertainty.names.index(f"imu0.gyroscope.bias[{axis}]") for axis in range(3)]
    matrix = uncertainty.matrix.copy()
    matrix[at, at] += course.at_reference
    factor = GYROSCOPE_UNITS_RAD_S[parts.gyroscope_unit]
    told = [] if factor is None else [
        slope_finding("gyroscope_bias", factor * course.slopes, factor**2 * course.covariance, known)
    ]  # fmt: skip
    return replace(
        calibration,
        uncertainty=replace(uncertainty, matrix=matrix),
        assessment=replace(assessed, findings=(*assessed.findings, *told)),
    )


def _refuse_one_orientation(parts: TurntableParts) -> None:
    """Refuse parts in which the platter's axis always lies alike in the sensor."""
    data = parts.data
    turning = data.rate > 0
    if not turning.any():
        raise DetectionError("no steady part turns at a stated speed; those that were left out: " + _why(parts))
    zero = data.measured[~turning].mean(axis=0) if (~turning).any() else data.measured.mean(axis=0)
    axes = data.measured[turning] - zero
    axes = axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)
    sizes = np.linalg.svd(axes, compute_uv=False) ** 2
    if len(axes) > 1 and sizes[0] < _ONE_ORIENTATION * sizes.sum():
        return
    many = f"all {len(axes)} steady parts" if len(axes) > 1 else "the one steady part"
    raise DetectionError(
        f"{many} in which the platter turns show one orientation of the sensor. Put it on the platter in at least "
        "nine, better eighteen: each face down, and each edge with a wedge of about 45 deg."
    )


def _why(parts: TurntableParts) -> str:
    return "; ".join(f"{name} ({why})" for name, why in parts.left_out[:4]) or "none"


def _known_walk(recordings: Sequence[Recording], parts: TurntableParts) -> float | None:
    """Return the random walk of the gyroscope's bias [unit^2/s], where it was stated; None for counts."""
    noise = next((imu.noise for recording in recordings for imu in recording.imus.values()), None)
    factor = GYROSCOPE_UNITS_RAD_S[parts.gyroscope_unit]
    return None if noise is None or factor is None else (noise.gyroscope_random_walk / factor) ** 2


def _units(parts: TurntableParts) -> dict[str, str]:
    units = {"gyroscope": parts.gyroscope_unit}
    return units if parts.accelerometer_unit is None else {"accelerometer": parts.accelerometer_unit, **units}


def _agreement(parts: TurntableParts, known: Prior, options: TurntableOptions, gravity: Gravity) -> list[Finding]:
    """Say what was known beforehand and, where the recordings determine both triads alone, whether they agree."""
    if not known:
        return []
    try:
        accelerometer, _ = _accelerometer(parts, NOTHING, gravity)
        alone, _ = _choose_model(parts, accelerometer, NOTHING, options, unknown_scale=RATE_SCALE in options.free)
    except InitialisationError:
        return prior_used(known)
    if alone.accelerometer is None:
        return prior_used(known)
    found = alone.accelerometer.fit
    values = [found.sensitivity, found.bias, alone.fit.sensitivity, alone.fit.bias, alone.fit.g_sensitivity]
    return prior_findings(known, np.concatenate([value.ravel() for value in values]), alone.covariance)


def _accelerometer(parts: TurntableParts, known: Prior, gravity: Gravity) -> tuple[AccelerometerInPoses | None, str]:
    """Calibrate the accelerometer in the same attitudes, or say why not."""
    if parts.accelerometer_unit is None or parts.data.force is None:
        return None, "it was not recorded"
    try:
        beforehand = known.triad_prior("accelerometer")
        return fit_platter_accelerometer(parts.data, gravity.value, gravity.sigma, beforehand), ""
    except InitialisationError as error:
        return None, str(error)


def _choose_model(
    parts: TurntableParts,
    accelerometer: AccelerometerInPoses | None,
    known: Prior,
    options: TurntableOptions,
    *,
    unknown_scale: bool,
) -> tuple[TurntableFit, dict[str, TurntableFit]]:
    """Fit with and without g-sensitivity, and keep it where parts that were left out are predicted better with it."""
    alone = accelerometer is None
    beforehand = known.triad_prior("gyroscope", own_frame=alone)

    def fitted(*, g_sensitivity: bool) -> TurntableFit:
        """Return the fit of one model."""
        return fit_turntable(
            parts.data,
            accelerometer,
            sense=None if options.sense == "auto" else options.sense,
            latitude_deg=options.latitude,
            g_sensitivity=g_sensitivity,
            unknown_scale=unknown_scale,
            prior=beforehand,
        )

    if options.model == "g-sensitivity" and alone:
        raise OptionError("a g-sensitivity needs the accelerometer, which was not recorded. Choose --model basic.")
    if options.model != "auto" or alone:
        fit = fitted(g_sensitivity=options.model == "g-sensitivity")
        return fit, {"basic" if options.model != "g-sensitivity" else "g-sensitivity": fit}
    rivals = {"basic": fitted(g_sensitivity=False)}
    try:
        rivals["g-sensitivity"] = fitted(g_sensitivity=True)
    except (InitialisationError, SolveError):
        return rivals["basic"], rivals
    if rivals["g-sensitivity"].fit.held_by_prior.any():
        return rivals["basic"], rivals
    scale = rivals["g-sensitivity"].fit.magnitude_sigma
    used = rivals["basic"].fit.used & rivals["g-sensitivity"].fit.used
    errors = {name: float(np.sum((rival.fit.magnitude_holdout / scale)[used] ** 2)) for name, rival in rivals.items()}
    return rivals["g-sensitivity" if errors["basic"] - errors["g-sensitivity"] > _PARAMETERS_OF_G else "basic"], rivals


def _by_calibrated_rate(parts: TurntableParts, fit: TurntableFit, *, unknown_scale: bool) -> TurntableParts:
    """Return the parts without those that, by the calibration, turned at no stated speed; the same if there are none.

    Where most parts of one speed are off, it is the speed that was stated wrong, and they stay.
    """
    if unknown_scale:
        return parts
    shown = np.linalg.norm(fit.fit.physical(fit.poses.measured, fit.poses.force), axis=1)
    factor = fit.fit.group_factor[parts.data.speed]
    nearest = reassign_speeds(
        shown / factor, parts.data.rates, np.ones((len(shown), len(parts.rates)), bool), _RATE_TOLERANCE
    )
    wrong = nearest != parts.data.speed
    for k in range(len(parts.rates)):
        same = parts.data.speed == k
        wrong[same] &= wrong[same].mean() < 0.5 if same.any() else False
    if not wrong.any():
        return parts
    names = tuple(
        (parts.names[i], f"it turned at {shown[i]:.4g} rad/s" + _meant(parts, int(nearest[i])))
        for i in np.flatnonzero(wrong)
    )
    return replace(parts.where(~wrong), left_out=(*parts.left_out, *names))


def _meant(parts: TurntableParts, nearest: int) -> str:
    return ", no stated speed" if nearest == NO_SPEED else f", perhaps {parts.rates[nearest].name}"


def _sensor(fit: TurntableFit, parts: TurntableParts) -> ImuCalibration:
    """Return the calibrated sensor."""
    gyroscope = GyroscopeCalibration(
        sensitivity=fit.fit.sensitivity,
        bias=fit.fit.bias,
        g_sensitivity=fit.fit.g_sensitivity,
        unit=parts.gyroscope_unit,
    )
    if fit.accelerometer is None or parts.accelerometer_unit is None:
        return ImuCalibration(gyroscope=gyroscope)
    found = fit.accelerometer.fit
    accelerometer = AccelerometerCalibration(
        sensitivity=found.sensitivity, bias=found.bias, unit=parts.accelerometer_unit
    )
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)
