"""What a format can represent, and what of a calibration it cannot: the losses follow from that."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from math import degrees
from typing import Literal

import numpy as np

from ...errors import OptionError
from ...findings import join_names
from ...frozen import field_names, value_class
from ...recording import Floats
from ...recording.samples import ImuNoise
from ...results.calibration import Calibration, ImuCalibration
from ...results.temperature_dependence import TemperatureDependence
from ...units import STANDARD_GRAVITY_M_S2
from .losses import Context, Loss, StatedImu, formats_of, k3_losses, numbers_text, uncertainty_loss
from .si_units import Conversion, count_losses, si_conversions

_NOTHING = 1e-12
_SIGNIFICANT = 3.0  # sigmas; lever arms that a model holds may be no more than its noise


@value_class(eq=True)
class Holds:
    """What the files of a program can represent.

    Attributes
    ----------
    program : its name
    imus, cameras : how many, None for any number; cameras 0 for a format of inertial sensors
    samples_in_si : whether samples have to be in m/s^2 and rad/s, so that counts need a conversion
    sensitivity, bias, g_sensitivity, lever_arms, accelerometer_clock, magnetometer, temperature : whether there is a
        key
    temperature_scale : whether there is one of what the temperature does to sensitivities
    ideal_gyroscope : whether an ideal gyroscope stands in where none was calibrated
    time_shift : "each" camera has one, "one" for all, or "none"
    k3 : whether radtan may have a third radial coefficient
    undistorted : the model with zeros that stands for a lens without distortion; "" where there is one
    topics : whether the topics of cameras have a key
    without_noise : what the program does, or the file has instead, where noise and rate are not known; "" for a format
        without noise
    floats : what the program does in single precision, such as "reads"; "" where it does not
    settings : what else its configuration consists of; "" for none
    """

    program: str
    imus: int | None = None
    cameras: int | None = None
    samples_in_si: bool = True
    sensitivity: bool = True
    bias: bool = True
    g_sensitivity: bool = True
    lever_arms: bool = False
    accelerometer_clock: bool = False
    magnetometer: bool = False
    temperature: bool = False
    temperature_scale: bool = False
    ideal_gyroscope: bool = False
    time_shift: Literal["each", "one", "none"] = "each"
    k3: bool = True
    undistorted: str = ""
    topics: bool = True
    without_noise: str = ""
    floats: str = ""
    settings: str = ""


def not_representable(calibration: Calibration, holds: Holds, context: Context) -> Iterator[Loss]:
    """Yield what of a calibration the files of a program cannot represent."""
    program = holds.program
    if holds.cameras == 0:
        yield from rig_losses(calibration, program)
    for name, imu in list(calibration.imus.items())[: holds.imus]:
        yield from _imu_losses(name, imu, holds, context)
    for name in list(calibration.imus)[holds.imus or len(calibration.imus) :]:
        known, first = ("one IMU", next(iter(calibration.imus))) if holds.imus == 1 else (f"{holds.imus} IMUs", "")
        only = f"only {first} is in the file. Use kalibr, json or csv to write them all." if first else "not this one."
        yield Loss(what=name, why=f"{program} knows {known}; {only}")
    if not holds.g_sensitivity:
        yield from g_sensitivity_losses(calibration, program)
    if not holds.lever_arms:
        yield from _lever_arm_losses(calibration, program)
    if not holds.accelerometer_clock:
        yield from _triad_shift_losses(calibration, program)
    if holds.cameras != 0:
        yield from _camera_losses(calibration, holds)
    if not holds.magnetometer:
        yield from magnetometer_losses(calibration, program)
    if holds.floats:
        yield Loss(what="precision", why=f"{program} {holds.floats} floats.", size="6e-8 relative")
    if holds.settings:
        why = f"{holds.settings} are not of the rig. Take them from its own files."
        yield Loss(what="settings of the program", why=why)
    yield uncertainty_loss(program)


def _imu_losses(name: str, imu: ImuCalibration, holds: Holds, context: Context) -> Iterator[Loss]:
    if holds.samples_in_si:
        yield from count_losses(name, imu, holds.program)
    if not holds.sensitivity:
        yield from _ideal_losses(name, imu, holds.program)
    if not holds.bias:
        yield from _bias_losses(name, imu, holds.program)
    if holds.ideal_gyroscope and imu.gyroscope is None:
        yield Loss(what=f"gyroscope of {name}", why="it was not calibrated; the file has an ideal one.")
    if holds.without_noise:
        yield from _noise_losses(context.of(name), holds)
    if imu.temperature is not None:
        yield from _temperature_losses(name, imu.temperature, holds)


def _temperature_losses(name: str, found: TemperatureDependence, holds: Holds) -> Iterator[Loss]:
    """Yield what of a dependence on temperature has no place."""
    parts = {part for part, _ in found.parts() if holds.magnetometer or not part.startswith("magnetometer")}
    if not holds.temperature:
        if parts:
            only = f"it is right at {found.reference_degc:g} degC, the temperature to which the file refers."
            yield Loss(what=f"temperature of {name}", why=f"{holds.program} knows none; {only}")
        return
    if found.lag_s and parts:
        why = f"{holds.program} takes the thermometer's reading, which follows the sensor by {found.lag_s:.0f} s."
        yield Loss(what=f"lag of the thermometer of {name}", why=why)
    if not holds.temperature_scale and any(part.endswith("_sensitivity") for part in parts):
        only = f"All else is right at {found.reference_degc:g} degC; gnomon apply and the C header know all."
        yield Loss(
            what=f"sensitivity over the temperature of {name}", why=f"{holds.program} knows that of biases. {only}"
        )


def _camera_losses(calibration: Calibration, holds: Holds) -> Iterator[Loss]:
    for name in islice(calibration.cameras, holds.cameras or len(calibration.cameras), None):
        yield Loss(
            what=name, why=f"{holds.program} takes {holds.cameras} cameras at most; the first ones are in the file."
        )
    if not holds.k3:
        yield from k3_losses(calibration, holds.program)
    if holds.time_shift == "one":
        yield from _shift_losses(calibration, holds.program)
    elif holds.time_shift == "none":
        yield from _no_shift_losses(calibration, holds.program)
    if holds.time_shift != "each":
        yield from _line_delay_losses(calibration, holds.program)
    for name, camera in list(calibration.cameras.items())[: holds.cameras]:
        if holds.undistorted and camera.camera.distortion == "none":
            why = f"it has none; the file has {holds.undistorted} with zeros, which is the same."
            yield Loss(what=f"distortion of {name}", why=why)
        if not holds.topics and camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why=f"{holds.program} has no key for it.")


def at_middle_rows(calibration: Calibration) -> Calibration:
    """Return a calibration whose time shifts are those of the middle rows, for programs without a rolling shutter."""
    cameras = {
        name: replace(camera, time_shift_cam_imu=camera.time_shift_cam_imu + camera.middle_row_delay_s)
        for name, camera in calibration.cameras.items()
    }
    return replace(calibration, cameras=cameras)


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


def _shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that one time shift is used for all cameras, and that no row is later than another."""
    shifts = {name: camera.time_shift_cam_imu for name, camera in calibration.cameras.items()}
    first = next(iter(shifts), "")
    apart = max((abs(shift - shifts[first]) for shift in shifts.values()), default=0.0)
    if apart > 0:
        yield Loss(
            what="time shifts",
            why=f"{whose} takes one for all cameras, that of {first}.",
            size=f"the others differ by up to {1e3 * apart:.3g} ms",
        )


def _no_shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that a format has no time shift at all."""
    for name, camera in calibration.cameras.items():
        shift = camera.time_shift_cam_imu
        if shift:
            yield Loss(
                what=f"time shift of {name}",
                why=f"{whose} takes the timestamps of images as those of the IMU: add it to the timestamps of {name} "
                "(t_imu = t_cam + shift).",
                size=f"{shift * 1e3:+.6g} ms",
            )


def _line_delay_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that no row of an image is later than another, and which row's the time shift is."""
    for name, camera in calibration.cameras.items():
        delay = camera.camera.line_delay_s
        if delay:
            yield Loss(
                what=f"line_delay of {name}",
                why=f"{whose} takes all rows of an image as of one instant; the time shift here is the middle row's.",
                size=f"{delay * 1e6:.3g} us a row, {abs(delay) * camera.camera.resolution[1] * 1e3:.3g} ms an image",
            )


def _bias_losses(name: str, imu: ImuCalibration, whose: str) -> Iterator[Loss]:
    """Say that a program estimates the biases and has no key for them."""
    for conversion in si_conversions(imu):
        if conversion.unit != "count" and conversion.bias_si.any():
            yield Loss(
                what=f"{conversion.triad} bias of {name}",
                why=f"{whose} estimates the bias and has no key for it; it is in the file's comments.",
                size=f"{numbers_text(np.round(conversion.bias_si, 6), ', ')} {conversion.si}",
            )


def _lever_arm_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
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


def _proved(arms: Floats, sigma: Floats) -> bool:
    """Tell whether any lever arm is there beyond its uncertainty; without one, beyond zero."""
    return bool((np.abs(arms) > _SIGNIFICANT * np.nan_to_num(sigma)).any())


def _triad_shift_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that a program takes accelerometer and gyroscope to be on one clock."""
    for name, imu in calibration.imus.items():
        shift = None if imu.accelerometer is None else imu.accelerometer.time_shift_s
        if shift:
            yield Loss(
                what=f"time shift of the accelerometer of {name}",
                why=f"{whose} takes accelerometer and gyroscope to be stamped alike: add it to the timestamps of the "
                "accelerometer (t_gyroscope = t_accelerometer + shift), or run gnomon apply first. Use json or csv to "
                "keep it.",
                size=f"{shift * 1e3:+.6g} ms",
            )


def _noise_losses(stated: StatedImu, holds: Holds) -> Iterator[Loss]:
    missing = [*(() if stated.noise else field_names(ImuNoise)), *(() if stated.update_rate_hz else ("update_rate",))]
    if missing:
        yield Loss(
            what="noise and rate" if not stated.noise else "rate",
            why=f"{', '.join(missing)} are not in a calibration, and no imu.yaml or noise.yaml was found beside it nor "
            f"given with --imu; {holds.program} {holds.without_noise}.",
        )


def _ideal_losses(name: str, imu: ImuCalibration, whose: str) -> Iterator[Loss]:
    """Say what a program leaves uncorrected that takes an IMU for ideal but for its biases."""
    for conversion in si_conversions(imu):
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


def magnetometer_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format has no place for magnetometers."""
    for name, imu in calibration.imus.items():
        if imu.magnetometer is not None:
            yield Loss(
                what=f"magnetometer of {name}",
                why=f"{format_name} knows none. Use c-header or csv to write it too, or keep calibration.yaml.",
            )


def rig_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format of inertial sensors has no place for cameras, nor for where several IMUs are."""
    if calibration.cameras:
        yield Loss(
            what=", ".join(calibration.cameras),
            why=f"{format_name} knows no cameras: T_cam_imu, time shift and lens are left out. "
            f"Use {join_names(formats_of(c.camera for c in calibration.cameras.values()), 'or')} to write them too, or "
            "keep calibration.yaml.",
        )
    for name, imu in calibration.imus.items():
        if imu.T_imu_body is not None:
            yield Loss(
                what=f"pose and clock of {name}",
                why=f"{format_name} does not say how IMUs lie to each other: T_imu_body and time shift are left out. "
                "Use kalibr, json or csv to write them too.",
                size=f"{1e3 * float(np.linalg.norm(imu.T_imu_body[:3, 3])):.3g} mm, {1e3 * imu.time_shift_s:+.6g} ms",
            )


def g_sensitivity_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say what leaving out the g-sensitivity costs, for each gyroscope that has one."""
    for name, imu in calibration.imus.items():
        size = g_sensitivity_rate(imu)
        if size:
            yield Loss(
                what=f"g-sensitivity of {name}",
                why=f"{format_name} knows no gyroscope bias that depends on the specific force. Use kalibr, "
                "openvins, imucal, c-header or csv to keep it, or calibrate with --model basic so that the bias "
                "absorbs what it can.",
                size=f"up to {size:.2g} rad/s = {degrees(size):.2g} deg/s at 1 g",
            )


def g_sensitivity_rate(imu: ImuCalibration) -> float:
    """Return the largest rate that the g-sensitivity feigns at 1 g, over all attitudes [rad/s]."""
    if imu.gyroscope is None:
        return 0.0
    response = np.linalg.inv(imu.gyroscope.sensitivity) @ imu.gyroscope.g_sensitivity
    return float(np.linalg.norm(response, 2)) * STANDARD_GRAVITY_M_S2
