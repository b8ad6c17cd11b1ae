"""OpenVINS' kalibr_imu_chain.yaml: what its keys Tw, Ta, Tg, R_IMUtoGYRO and R_IMUtoACC say of an IMU.

OpenVINS inverts Tw and Ta and keeps a triangle of each: the lower one with the model "kalibr", also called
"calibrated", and the upper one with "rpng". Tg acts on the specific force in the IMU's frame.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..frozen import field_names
from ..geometry.rotations import invert_matrix
from ..models.project_forms import OpenVinsAccelerometer, OpenVinsGyroscope
from ..recording import Floats
from ..recording.samples import ImuNoise
from ..results.calibration import (
    Calibration,
    CameraCalibration,
    ImuCalibration,
)
from .foreign import imu_in_si
from .kalibr.camchain import camera_chain
from .shared.foreign_yaml import file_name, read_matrix, read_rotation
from .shared.losses import (
    Context,
    Export,
    Loss,
    StatedImu,
    into_frame,
    require_triads,
    stated_entry,
    unknown_lens,
    without_k3,
)
from .shared.sensor_losses import Holds, not_representable
from .shared.si_units import si_conversions, si_imu
from .shared.structured import Node
from .shared.yaml_text import kalibr_yaml

OPENVINS_KEYS = ("Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC")
_MODELS = ("kalibr", "calibrated", "rpng")


def openvins_imu(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuCalibration:
    """Return an IMU, without bias.

    Parameters
    ----------
    node : the IMU's entry
    keys : its values
    notes : where sentences on what was passed over, or is missing, are appended

    Raises
    ------
    FormatError
        If a value is not as expected.
    """
    model = keys["model"].text().lower() if "model" in keys else "kalibr"
    if model not in _MODELS:
        keys["model"].text(_MODELS)
    missing = [key for key in OPENVINS_KEYS if key not in keys]
    if missing:
        notes.append(
            f"{file_name(node)}: {', '.join(missing)} of {node.path} {'is' if len(missing) == 1 else 'are'} missing; "
            "taken: the identity, zero for Tg."
        )
    turns = {key: read_rotation(keys[key]) if key in keys else np.eye(3) for key in ("R_IMUtoACC", "R_IMUtoGYRO")}
    zero = np.zeros(3)
    S_a, b_a = OpenVinsAccelerometer(T=_used(keys, "Ta", model, notes), R=turns["R_IMUtoACC"], b=zero).to_sensor()
    Tg = read_matrix(keys["Tg"], 3, 3) if "Tg" in keys else np.zeros((3, 3))
    gyroscope = OpenVinsGyroscope(T=_used(keys, "Tw", model, notes), R=turns["R_IMUtoGYRO"], b=zero, Tg=Tg)
    S_g, b_g, G = gyroscope.to_sensor()
    return imu_in_si((S_a, b_a), (S_g, b_g), G)


def _used(keys: dict[str, Node], name: str, model: str, notes: list[str]) -> Floats:
    """Return Tw or Ta as OpenVINS uses it: with a triangular inverse."""
    if name not in keys:
        return np.eye(3)
    node, upper = keys[name], model == "rpng"
    T = read_matrix(node, 3, 3)
    if np.linalg.matrix_rank(T) < 3:
        raise node.fail("this matrix is singular: the three axes do not measure three directions.")
    triangle = np.triu if upper else np.tril
    if np.abs(T - triangle(T)).max() <= 1e-12 * np.abs(T).max():
        return triangle(T)
    place = "below" if upper else "above"
    notes.append(
        f'{file_name(node)}: with the model "{model}" OpenVINS passes over what stands {place} the diagonal of the '
        f"inverse of {node.path}; so it was done here."
    )
    return invert_matrix(triangle(invert_matrix(T)))


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

HOLDS = Holds(
    program="OpenVINS",
    imus=1,
    bias=False,
    ideal_gyroscope=True,
    time_shift="one",
    k3=False,
    undistorted="radtan",
    without_noise="does not start without: add them by hand",
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `kalibr_imu_chain.yaml`, and `kalibr_imucam_chain.yaml` where there are cameras.

    Raises
    ------
    OptionError
        If OpenVINS does not know the model of a camera, or an IMU has no accelerometer, which defines its frame.
    """
    require_triads(calibration, "openvins", "accelerometer")
    moved, losses = into_frame(calibration, OpenVinsAccelerometer.frame, "OpenVINS'")
    name, imu = next(iter(moved.imus.items()))
    files = {IMU_FILE: imu_chain_text(imu, context.of(name), context.comment())}
    if moved.cameras:
        files[CAMERA_FILE] = camera_chain_text(moved, context.comment())
    found = (*losses, *_camera_losses(moved), *not_representable(moved, HOLDS, context))
    return Export(files=files, losses=found)


def imu_chain_text(imu: ImuCalibration, stated: StatedImu | None = None, remarks: str = "") -> str:
    """Return the text of `kalibr_imu_chain.yaml` for an IMU in body frame accel-x.

    Parameters
    ----------
    stated : noise, rate and topic; without them the file says that they have to be added
    remarks : lines of comment
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
    comments = [line for conversion in si_conversions(imu) for line in conversion.lines()]
    if stated is not None:
        entry |= stated_entry(stated)
        comments += stated.comments
    missing = [key for key in (*field_names(ImuNoise), "update_rate", "rostopic") if key not in entry]
    if missing:
        comments.append(f"OpenVINS also needs {', '.join(missing)}: add them, or it does not start.")
    head = _HEADER.format(what="IMU intrinsics", them="them (model kalibr)") + _EQUATIONS + remarks
    return head + "".join(f"# {line}\n" for line in comments) + kalibr_yaml({"imu0": entry}, flush=False)


def camera_chain_text(calibration: Calibration, remarks: str = "") -> str:
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
        + remarks
        + kalibr_yaml(camera_chain(cameras), flush=False)
    )


def _known(name: str, calibrated: CameraCalibration) -> CameraCalibration:
    """Return a camera in OpenVINS' terms: without distortion it is radtan with zeros; no row is later than another."""
    camera = replace(calibrated.camera, line_delay_s=0.0)
    if camera.projection != "pinhole" or camera.distortion == "fov":
        raise unknown_lens(name, camera, "OpenVINS knows pinhole-radtan and pinhole-equidistant only")
    if camera.distortion != "none":
        return replace(calibrated, camera=without_k3(camera).camera)
    return replace(calibrated, camera=replace(camera, distortion="radtan", distortion_coeffs=np.zeros(4)))


def _camera_losses(calibration: Calibration) -> Iterator[Loss]:
    if not calibration.cameras:
        yield Loss(what="cameras", why="this calibration is of an IMU alone; OpenVINS needs kalibr_imucam_chain.yaml.")
    for name, camera in calibration.cameras.items():
        if not camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="it was not stated; add it by hand for a ROS node.")
