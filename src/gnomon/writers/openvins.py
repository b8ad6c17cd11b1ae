"""OpenVINS: `kalibr_imucam_chain.yaml` and `kalibr_imu_chain.yaml`, as its estimator takes them.

The model is its "kalibr": samples in m/s^2 and rad/s (see `writers.si_units`), body frame accel-x, Ta and Tw lower
triangular, and Tg on the specific force in the body frame, which is A C_gyro_i of Kalibr. The first line and the
indentation are those of OpenCV, by which OpenVINS reads them. Read back by `readers.kalibr_imu` and
`readers.kalibr_camchain`.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration, ImuCalibration
from ..errors import OptionError
from ..models.estimator_forms import OpenVinsAccelerometer, OpenVinsGyroscope
from ..models.noise import ImuNoise
from .export import Export, Loss, into_frame, magnetometer_losses, numbers_text, require_triads, uncertainty_loss
from .kalibr import StatedImu, stated_entry
from .kalibr_camchain import camera_chain
from .kalibr_text import kalibr_yaml
from .si_units import conversions, count_losses, si_imu

IMU_FILE, CAMERA_FILE = "kalibr_imu_chain.yaml", "kalibr_imucam_chain.yaml"

_HEADER = """\
%YAML:1.0

# {what} as OpenVINS takes {them}, made by gnomon; sigmas are in calibration.yaml.
"""
_CAMERAS = """\
# p_cam = T_cam_imu p_imu [m], t_imu = t_cam + timeshift_cam_imu [s], p_cn = T_cn_cnm1 p_cnm1.
"""
_EQUATIONS = """\
# With specific force f [m/s^2] and angular rate w [rad/s] in the IMU's frame (x along the sensitivity axis of the x
# accelerometer, the axis of the y accelerometer in the x-y plane):
#   accelerometer [m/s^2] = Ta R_IMUtoACC f + bias       gyroscope [rad/s] = Tw R_IMUtoGYRO w + Tg f + bias
"""


def export(calibration: Calibration) -> Export:
    """Return `kalibr_imu_chain.yaml`, and `kalibr_imucam_chain.yaml` where there are cameras.

    Raises
    ------
    OptionError
        If OpenVINS does not know the model of a camera, or an IMU has no accelerometer, which defines its frame.
    """
    require_triads(calibration, "openvins", "accelerometer", otherwise="imu_tk, c-header or csv")
    moved, losses = into_frame(calibration, OpenVinsAccelerometer.frame, "OpenVINS'")
    name, imu = next(iter(moved.imus.items()))
    files = {IMU_FILE: imu_chain_text(imu)}
    if moved.cameras:
        files[CAMERA_FILE] = camera_chain_text(moved)
    found = (*losses, *_imu_losses(name, imu), *other_imu_losses(moved, "OpenVINS"), *_camera_losses(moved))
    return Export(files=files, losses=(*found, *magnetometer_losses(moved, "OpenVINS"), uncertainty_loss("openvins")))


def imu_chain_text(imu: ImuCalibration, stated: StatedImu | None = None) -> str:
    """Return the text of `kalibr_imu_chain.yaml` for an IMU in body frame accel-x.

    Parameters
    ----------
    stated : noise, rate and topic; without them the file says that they have to be added
    """
    si, zero = si_imu(imu), np.zeros((3, 3))
    acc = OpenVinsAccelerometer.from_sensor(si.required_accelerometer.sensitivity, si.required_accelerometer.bias)
    gyro = OpenVinsGyroscope(T=np.eye(3), R=np.eye(3), b=np.zeros(3), Tg=zero)
    if si.gyroscope is not None:
        gyro = OpenVinsGyroscope.from_sensor(si.gyroscope.sensitivity, si.gyroscope.bias, si.gyroscope.g_sensitivity)
    entry: dict[str, Any] = {
        "T_i_b": np.eye(4),
        "time_offset": 0.0,
        "model": "kalibr",
        "Ta": acc.T,
        "R_IMUtoACC": acc.R,
        "Tw": gyro.T,
        "R_IMUtoGYRO": gyro.R,
        "Tg": gyro.Tg,
    }
    comments = [line for conversion in conversions(imu) for line in conversion.lines()]
    if stated is not None:
        entry |= stated_entry(stated)
        comments += stated.comments
    missing = [key for key in (*ImuNoise.__slots__, "update_rate", "rostopic") if key not in entry]
    if missing:
        comments.append(f"OpenVINS also needs {', '.join(missing)}: add them, or it does not start.")
    head = _HEADER.format(what="IMU intrinsics", them="them (model kalibr)") + _EQUATIONS
    return head + "".join(f"# {line}\n" for line in comments) + kalibr_yaml({"imu0": entry}, flush=False)


def camera_chain_text(calibration: Calibration) -> str:
    """Return the text of `kalibr_imucam_chain.yaml` for a calibration with cameras in body frame accel-x.

    Raises
    ------
    OptionError
        If OpenVINS does not know the model of a camera.
    """
    cameras = {name: _known(name, camera) for name, camera in calibration.cameras.items()}
    return (
        _HEADER.format(what="Cameras and their poses", them="them")
        + _CAMERAS
        + kalibr_yaml(camera_chain(cameras), flush=False)
    )


def _known(name: str, calibrated: CameraCalibration) -> CameraCalibration:
    """Return a camera in OpenVINS' terms: without distortion it is radtan with zeros."""
    camera = calibrated.camera
    if camera.projection != "pinhole" or camera.distortion == "fov":
        raise OptionError(
            f"{name} is {camera.model}, and OpenVINS knows pinhole-radtan and pinhole-equidistant only. Calibrate the "
            "camera with one of these, or convert to kalibr or basalt."
        )
    if camera.distortion != "none":
        return calibrated
    return replace(calibrated, camera=replace(camera, distortion="radtan", distortion_coeffs=np.zeros(4)))


def _imu_losses(name: str, imu: ImuCalibration) -> Iterator[Loss]:
    yield from count_losses(name, imu, "OpenVINS")
    for conversion in conversions(imu):
        if conversion.unit != "count":
            yield Loss(
                what=f"{conversion.triad} bias of {name}",
                why="OpenVINS estimates the bias and has no key for it; it is in the file's comments.",
                size=f"{numbers_text(np.round(conversion.bias_si, 6), ', ')} {conversion.si}",
            )
    yield from missing_gyroscope_loss(name, imu)
    yield Loss(
        what="noise and rate",
        why=f"a gnomon calibration does not hold {', '.join((*ImuNoise.__slots__, 'update_rate'))}; without them "
        "OpenVINS does not start: add them by hand.",
    )


def missing_gyroscope_loss(name: str, imu: ImuCalibration) -> Iterator[Loss]:
    """Say that an ideal gyroscope stands in the file where none was calibrated."""
    if imu.gyroscope is None:
        yield Loss(what=f"gyroscope of {name}", why="it was not calibrated; the file has an ideal one.")


def other_imu_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say that only the first IMU is in the file."""
    for name in list(calibration.imus)[1:]:
        yield Loss(what=name, why=f"{whose} knows one IMU; only {next(iter(calibration.imus))} is in the file.")


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
    for name, camera in calibration.cameras.items():
        delay = camera.camera.line_delay_s
        if delay:
            yield Loss(
                what=f"line_delay of {name}",
                why=f"{whose} knows no rolling shutter.",
                size=f"{delay * 1e6:.3g} us a row, {abs(delay) * camera.camera.resolution[1] * 1e3:.3g} ms an image",
            )


def _camera_losses(calibration: Calibration) -> Iterator[Loss]:
    yield from shift_losses(calibration, "OpenVINS")
    if not calibration.cameras:
        yield Loss(what="cameras", why="this calibration is of an IMU alone; OpenVINS needs kalibr_imucam_chain.yaml.")
    for name, camera in calibration.cameras.items():
        if camera.camera.distortion == "none":
            yield Loss(
                what=f"distortion of {name}", why="it has none; the file has radtan with zeros, which is the same."
            )
        if not camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="it was not stated; add it by hand for a ROS node.")
