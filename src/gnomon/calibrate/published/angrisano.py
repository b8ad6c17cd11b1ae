"""Preset angrisano: an accelerometer by the iteration of Angrisano, Eqs. (8)-(12), as its authors carry it out.

Kept to reproduce the document and to compare with; `calibrate_poses` needs no start and finds the same minimum. The
sigmas are those of the document (C11): ordinary least squares, with gravity taken as exact.
"""

from dataclasses import replace

import numpy as np

from ...assess.imu.pose_tables import describe_published
from ...assess.imu.poses_verdict import assess_published
from ...errors import InitialisationError, OptionError, SolveError
from ...estimate.triads.angrisano import (
    AngrisanoFit,
    canonical_parameters,
    datasheet_start,
    fit_components,
    fit_magnitudes,
)
from ...findings import make_finding
from ...options import ImuOptions
from ...recording import Floats, Poses, Recording
from ...results.calibration import (
    AccelerometerCalibration,
    Calibration,
    Covariance,
    Gravity,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ...results.result import Result
from ...units import ACCELEROMETER_UNITS_M_S2
from ..steps.pose_preparation import PreparedPoses
from ..steps.preparation import stated_options
from ..steps.stated_frame import in_stated_frame

_ALONE = "Preset angrisano calibrates the accelerometer alone; the gyroscope's samples are not used."


def calibrate_poses_as_published(
    recording: Recording, prepared: PreparedPoses, gravity: Gravity, options: ImuOptions
) -> Result:
    """Calibrate an accelerometer as Angrisano does: by magnitudes, or by components where they are known.

    Raises
    ------
    OptionError
        If the start of Eq. (12) needs options that were not given.
    InitialisationError
        If there are too few poses; SolveError where the iteration ends at no number.
    """
    poses = prepared.poses
    start, said = _start(poses, options)
    if poses.specific_force is not None:
        fit = fit_components(poses.accelerometer, poses.specific_force, start, geometry=options.geometry)
    else:
        fit = fit_magnitudes(poses.accelerometer, gravity.value, start, geometry=options.geometry)
    sensor, covariance = _sensor(fit, poses)
    left_out = _held_out(fit, poses, gravity, options)
    noticed = (*prepared.findings, make_finding("preset-start", said=said))
    if poses.gyroscope is not None:
        noticed += (make_finding("gyroscope-not-used", alone=_ALONE),)
    span_s = (prepared.start_s, prepared.stop_s)
    diagnostics = describe_published(poses, span_s, fit=fit, sensor=sensor, holdout=left_out, gravity=gravity)
    imus = {"imu0": ImuCalibration(accelerometer=sensor)}
    calibration = Calibration(
        imus=imus,
        frame="accel-z",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=covariance),
        assessment=assess_published(
            noticed, prepared.left_out, fit=fit, sensor=sensor, diagnostics=diagnostics, gravity=gravity
        ),
        provenance=Provenance(method="imu", inputs=recording.sources, options=stated_options(options, [recording])),
    )
    if options.frame not in ("accel-x", "accel-z"):  # the first is the default, which the document does not know
        table = diagnostics.triads["accelerometer"].poses
        calibration = in_stated_frame(calibration.in_frame("accel-x"), options.frame, table.measured, table.sigma)
    return Result(calibration=calibration, diagnostics=diagnostics)


def _start(poses: Poses, options: ImuOptions) -> tuple[Floats, str]:
    """Return X (9,) of Eq. (12), and a sentence on it.

    Counts that go below zero come from a converter that reads -2^(n-1) to 2^(n-1) - 1: Eq. (12) less 2^(n-1).
    """
    one = ACCELEROMETER_UNITS_M_S2[poses.accelerometer_unit]
    if one is not None:
        return (
            np.concatenate([np.zeros(6), np.full(3, one)]),
            f"The iteration starts at a bias of zero and the scale of {poses.accelerometer_unit}, {one:.6g} m/s^2.",
        )
    if options.bits is None or options.full_scale is None:
        raise OptionError(
            "preset angrisano starts from the data sheet (Angrisano, Eq. 12): for counts give the converter's bits "
            "and the full scale in m/s^2, such as --bits 16 --full-scale 50. The default preset needs no start."
        )
    start = datasheet_start(options.bits, options.full_scale)
    signed = poses.accelerometer.min() < 0
    if signed:
        start[3:6] -= 2 ** (options.bits - 1)
    return start, (
        f"The iteration starts from the data sheet, Eq. (12): bias {start[3]:.1f} counts"
        f"{', as counts go below zero,' if signed else ''} and {start[6]:.4g} m/s^2 per count."
    )


def _sensor(fit: AngrisanoFit, poses: Poses) -> tuple[AccelerometerCalibration, Floats]:
    """Return the sensor, also that of a wrong minimum, which a finding condemns."""
    if fit.status == "mirrored":
        fit = replace(fit, parameters=canonical_parameters(fit.parameters, fit.geometry))
    try:
        sensitivity, covariance = fit.sensitivity, fit.sensor_covariance
    except (np.linalg.LinAlgError, OptionError):
        sensitivity, covariance = np.full((3, 3), np.nan), np.full((12, 12), np.nan)
    if not (np.isfinite(sensitivity).all() and np.isfinite(covariance).all() and np.isfinite(fit.bias).all()):
        raise SolveError(
            f"the iteration of Angrisano diverged: after {fit.iterations} steps from its start there is no sensor. "
            "Check --bits and --full-scale, or use the default preset, which needs no start."
        )
    sensor = AccelerometerCalibration(sensitivity=sensitivity, bias=fit.bias, unit=poses.accelerometer_unit)
    return sensor, covariance


def _held_out(fit: AngrisanoFit, poses: Poses, gravity: Gravity, options: ImuOptions) -> Floats:
    """Return |s| - g (n,) of each pose by the same iteration without it; nan where too few are left."""
    n = len(poses)
    left = np.full(n, np.nan)
    if not fit.converged:
        return left
    for k in range(n):
        others = np.arange(n) != k
        try:
            if poses.specific_force is not None:
                again = fit_components(
                    poses.accelerometer[others], poses.specific_force[others], fit.parameters, geometry=options.geometry
                )
            else:
                again = fit_magnitudes(
                    poses.accelerometer[others], gravity.value, fit.parameters, geometry=options.geometry
                )
        except InitialisationError:
            return left
        force = (poses.accelerometer[k] - again.bias) @ np.linalg.inv(again.sensitivity).T
        left[k] = np.linalg.norm(force) - gravity.value
    return left
