"""Losses that several formats share: cameras, shifts, and what is left of an IMU's errors."""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..errors import OptionError
from ..models.noise import ImuNoise
from ..recording import Floats
from ..units import STANDARD_GRAVITY_M_S2
from .losses import Loss, StatedImu, numbers_text
from .si_units import Conversion, conversions

_NOTHING = 1e-12
_SIGNIFICANT = 3.0  # sigmas; lever arms that a model holds may be no more than its noise


def require_cameras(calibration: Calibration, whose: str) -> None:
    """Refuse a calibration of an IMU alone for a format of cameras.

    Raises
    ------
    OptionError
        If there is no camera.
    """
    if not calibration.cameras:
        raise OptionError(
            f"{whose} takes cameras with an IMU whose model is ideal, and this calibration holds no camera. Convert to "
            "kalibr, imucal, c-header or csv."
        )


def first_cameras(calibration: Calibration, count: int, whose: str) -> Iterator[Loss]:
    """Say which cameras are too many."""
    for name in islice(calibration.cameras, count, None):
        yield Loss(what=name, why=f"{whose} takes {count} cameras at most; the first ones are in the file.")


def missing_gyroscope_loss(name: str, imu: ImuCalibration) -> Iterator[Loss]:
    """Say that an ideal gyroscope stands in the file where none was calibrated."""
    if imu.gyroscope is None:
        yield Loss(what=f"gyroscope of {name}", why="it was not calibrated; the file has an ideal one.")


def other_imu_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that only the first IMU is in the file."""
    for name in list(calibration.imus)[1:]:
        yield Loss(
            what=name,
            why=f"{whose} knows one IMU; only {next(iter(calibration.imus))} is in the file. Use kalibr, json or csv "
            "to write them all.",
        )


def shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that one time shift is used for all cameras, and that no row is later than another."""
    shifts = {name: camera.time_shift_cam_imu for name, camera in calibration.cameras.items()}
    first = next(iter(shifts), "")
    apart = max((abs(shift - shifts[first]) for shift in shifts.values()), default=0.0)
    if apart > 0:
        yield Loss(
            what="time shifts",
            why=f"{whose} takes one for all cameras, that of {first}.",
            size=f"the others differ by up to {apart * 1e6:.3g} us",
        )
    yield from line_delay_losses(calibration, whose)


def no_shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that a format has no time shift at all."""
    for name, camera in calibration.cameras.items():
        shift = camera.time_shift_cam_imu
        if shift:
            yield Loss(
                what=f"time shift of {name}",
                why=f"{whose} takes the stamps of images as those of the IMU: add it to the stamps of {name} "
                "(t_imu = t_cam + shift).",
                size=f"{shift * 1e3:+.6g} ms",
            )
    yield from line_delay_losses(calibration, whose)


def line_delay_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that no row of an image is later than another."""
    for name, camera in calibration.cameras.items():
        delay = camera.camera.line_delay_s
        if delay:
            yield Loss(
                what=f"line_delay of {name}",
                why=f"{whose} knows no rolling shutter.",
                size=f"{delay * 1e6:.3g} us a row, {abs(delay) * camera.camera.resolution[1] * 1e3:.3g} ms an image",
            )


def bias_losses(name: str, imu: ImuCalibration, whose: str) -> Iterator[Loss]:
    """Say that a program estimates the biases and has no key for them."""
    for conversion in conversions(imu):
        if conversion.unit != "count" and conversion.bias_si.any():
            yield Loss(
                what=f"{conversion.triad} bias of {name}",
                why=f"{whose} estimates the bias and has no key for it; it is in the file's comments.",
                size=f"{numbers_text(np.round(conversion.bias_si, 6), ', ')} {conversion.si}",
            )


def accelerometer_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that a program takes the three accelerometers to be at one point, on the clock of the gyroscope."""
    for name, imu in calibration.imus.items():
        arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
        if arms is not None and _proved(arms, calibration.sigma(f"{name}.accelerometer.lever_arms_m")):
            longest = float(np.linalg.norm(arms - arms[0], axis=1).max())
            yield Loss(
                what=f"lever arms of the accelerometers of {name}",
                why=f"{whose} takes the three to be at one point, the body's origin. Use kalibr, csv or json to keep "
                "them.",
                size=f"{1e3 * longest:.2g} mm: up to {25 * longest:.2g} m/s^2 at 5 rad/s",
            )
    yield from triad_shift_losses(calibration, whose)


def _proved(arms: Floats, sigma: Floats) -> bool:
    """Tell whether any lever arm is there beyond its uncertainty; without one, beyond zero."""
    return bool((np.abs(arms) > _SIGNIFICANT * np.nan_to_num(sigma)).any())


def triad_shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that a program takes accelerometer and gyroscope to be on one clock."""
    for name, imu in calibration.imus.items():
        shift = None if imu.accelerometer is None else imu.accelerometer.time_shift_s
        if shift:
            yield Loss(
                what=f"time shift of the accelerometer of {name}",
                why=f"{whose} takes accelerometer and gyroscope to be stamped alike: add it to the stamps of the "
                "accelerometer (t_gyroscope = t_accelerometer + shift), or run gnomon apply first. Use json or csv to "
                "keep it.",
                size=f"{shift * 1e3:+.6g} ms",
            )


def noise_losses(stated: StatedImu, whose: str, then: str) -> Iterator[Loss]:
    """Say that noise or rate are not known.

    Parameters
    ----------
    then : what the program does without them, or what is in the file instead
    """
    missing = [*(() if stated.noise else ImuNoise.__slots__), *(() if stated.update_rate_hz else ("update_rate",))]
    if missing:
        yield Loss(
            what="noise and rate" if not stated.noise else "rate",
            why=f"{', '.join(missing)} are not in a calibration, and no imu.yaml or noise.yaml was found beside it nor "
            f"given with --imu; {whose} {then}.",
        )


def ideal_losses(name: str, imu: ImuCalibration, whose: str) -> Iterator[Loss]:
    """Say what a program leaves uncorrected that takes an IMU for ideal but for its biases."""
    for conversion in conversions(imu):
        rest = si_sensitivity(imu, conversion) - np.eye(3)
        if np.abs(rest).max() > _NOTHING:
            yield Loss(
                what=f"scales and axes of the {conversion.triad} of {name}",
                why=f"{whose} takes the IMU for ideal. The pose holds for corrected samples: run gnomon apply first, "
                "or put the c-header into the driver.",
                size=rest_size(rest, conversion.triad),
            )


def si_sensitivity(imu: ImuCalibration, conversion: Conversion) -> Floats:
    """Return the sensitivity (3, 3) of a triad for samples in SI units."""
    return getattr(imu, conversion.triad).sensitivity * conversion.factor


def rest_size(rest: Floats, triad: str) -> str:
    """Say how large an error is that is left, result = (1 + rest) true, (3, 3), in the units of the sensor."""
    scale, whole = float(np.abs(np.diag(rest)).max()), float(np.linalg.norm(rest, 2))
    skew = float(np.linalg.norm(rest - np.diag(np.diag(rest)), 2))
    parts = [f"scale off by {100 * scale:.2g} %"] if scale > _NOTHING else []
    parts += [f"{1e3 * skew:.2g} mrad of misalignment"] if skew > _NOTHING else []
    effect = {
        "accelerometer": f"up to {whole * STANDARD_GRAVITY_M_S2:.2g} m/s^2 at 1 g",
        "gyroscope": f"up to {100 * whole:.2g} % of the rate",
    }[triad]
    return f"{', '.join(parts)}: {effect}"
