"""ROS 2: a launch file that publishes where the sensors are, and the calibration of each for its CameraInfo.

A static transform of frame_id imu0 and child_frame_id cam0 is the pose of the camera in the IMU's frame, p_imu0 = T
p_cam0, its quaternion Hamilton's, qx qy qz qw. Read back by `readers.projects.ros2_files`.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..calibration import Calibration
from ..geometry.quaternion import quaternion_from_rotation
from ..geometry.so3 import inverse
from ..models.camera import Camera
from ..recording import Floats
from .camera_poses import pose_in_body
from .context import Context
from .export import Export, Loss, uncertainty_loss
from .lens_formats import unknown_lens
from .opencv_yaml import flow
from .sensor_losses import no_shift_losses, require_cameras, triad_shift_losses

FILE, INFO = "static_transforms.launch.yaml", "{}_camera_info.yaml"

_WHOSE = "ROS 2"
_HEAD = """\
# Static transforms of the sensors for ROS 2, made by gnomon: ros2 launch ./{file}
# Each is the pose of a camera, or of another IMU, in the frame of {imu}: p_{imu} = T p_cam [m], quaternion qx qy qz qw
# of Hamilton. The frames of the cameras are optical ones (REP 103): x right, y down, z forward. Body frame {frame}.
"""
_SHIFT = "# There is no place for the time shift: t_imu = t_cam + {shift!r} s for {name}.\n"
_INFO_HEAD = """\
# Calibration of {name} in the layout of camera_calibration_parsers, for camera_info_url; made by gnomon.
# Pixel (0, 0) is the centre of the top-left pixel. rectification_matrix and projection_matrix are those of a single
# camera.{where}
"""
_MODELS = {
    "none": ("plumb_bob", 5),
    "radtan": ("plumb_bob", 5),
    "radtan5": ("plumb_bob", 5),
    "equidistant": ("equidistant", 4),
}


def export(calibration: Calibration, context: Context) -> Export:
    """Return `static_transforms.launch.yaml` and `cam0_camera_info.yaml`, ...

    Raises
    ------
    OptionError
        If there is no camera, or CameraInfo does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    name = next(iter(calibration.imus), "cam0")
    placed = calibration.imus or len(calibration.cameras) > 1
    where = f" Where it is: {FILE}." if placed else ""
    infos = {
        INFO.format(key): _info_text(key, known.camera, context, where) for key, known in calibration.cameras.items()
    }
    if not calibration.imus:
        losses = (*_lens_losses(calibration), uncertainty_loss(_WHOSE))
        there = {FILE: _launch_text(name, calibration, context)} if placed else {}
        return Export(files={**there, **infos}, losses=losses)
    losses = (
        Loss(
            what="IMU",
            why="sensor_msgs/Imu is of corrected samples: scales, axes, biases and noise have no place. Run gnomon "
            "apply, or put the c-header into the driver.",
        ),
        *no_shift_losses(calibration, _WHOSE),
        *_clock_losses(calibration),
        *triad_shift_losses(calibration, _WHOSE),
        *_lens_losses(calibration),
        uncertainty_loss(_WHOSE),
    )
    return Export(files={FILE: _launch_text(name, calibration, context), **infos}, losses=losses)


def _launch_text(imu: str, calibration: Calibration, context: Context) -> str:
    text = _HEAD.format(file=FILE, imu=imu, frame=calibration.frame) + context.comment()
    for name, camera in calibration.cameras.items():
        if camera.time_shift_cam_imu:
            text += _SHIFT.format(shift=float(camera.time_shift_cam_imu), name=name)
    poses = {name: known.T_imu_body for name, known in calibration.imus.items() if known.T_imu_body is not None}
    placed = {name: inverse(pose) for name, pose in poses.items()}
    placed |= {name: pose_in_body(camera) for name, camera in calibration.cameras.items() if name != camera.body}
    return text + "launch:\n" + "".join(_node(imu, name, pose) for name, pose in placed.items())


def _node(imu: str, name: str, pose: Floats) -> str:
    w, x, y, z = quaternion_from_rotation(pose[:3, :3]).tolist()
    px, py, pz = pose[:3, 3].tolist()
    numbers = {"x": px, "y": py, "z": pz, "qx": x, "qy": y, "qz": z, "qw": w}
    words = [f"--{key} {value!r}" for key, value in numbers.items()]
    arguments = " ".join([*words, f"--frame-id {imu}", f"--child-frame-id {name}"])
    return (
        "- node:\n"
        "    pkg: tf2_ros\n"
        "    exec: static_transform_publisher\n"
        f"    name: {imu}_to_{name}\n"
        f'    args: "{arguments}"\n'
    )


def _info_text(name: str, camera: Camera, context: Context, where: str) -> str:
    if camera.projection != "pinhole" or camera.distortion not in _MODELS:
        knows = "CameraInfo knows pinhole with radtan (plumb_bob), equidistant or no distortion"
        raise unknown_lens(name, camera, knows)
    fx, fy, cx, cy = camera.intrinsics.tolist()
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    model, count = _MODELS[camera.distortion]
    coeffs = np.zeros(count)
    coeffs[: len(camera.distortion_coeffs)] = camera.distortion_coeffs
    width, height = camera.resolution
    lines = [f"image_width: {width}", f"image_height: {height}", f"camera_name: {name}"]
    lines += _matrix("camera_matrix", K)
    lines += [f"distortion_model: {model}", *_matrix("distortion_coefficients", coeffs[None])]
    lines += _matrix("rectification_matrix", np.eye(3))
    lines += _matrix("projection_matrix", np.hstack([K, np.zeros((3, 1))]))
    return _INFO_HEAD.format(name=name, where=where) + context.comment() + "".join(f"{line}\n" for line in lines)


def _clock_losses(calibration: Calibration) -> Iterator[Loss]:
    for name, imu in calibration.imus.items():
        if imu.time_shift_s:
            yield Loss(
                what=f"time shift of {name}",
                why=f"{_WHOSE} takes the stamps of all sensors to be of one clock: add it to those of {name} "
                "(t_imu0 = t_imu + shift).",
                size=f"{imu.time_shift_s * 1e3:+.6g} ms",
            )


def _matrix(key: str, matrix: Floats) -> list[str]:
    rows, cols = matrix.shape
    return [f"{key}:", f"  rows: {rows}", f"  cols: {cols}", f"  data: {flow(matrix)}"]


def _lens_losses(calibration: Calibration) -> Iterator[Loss]:
    for name, camera in calibration.cameras.items():
        same: dict[str, Any] = {"none": "it has none; the file has plumb_bob with zeros, which is the same."}
        if camera.camera.distortion in same:
            yield Loss(what=f"distortion of {name}", why=same[camera.camera.distortion])
        if camera.camera.distortion == "equidistant":
            yield Loss(
                what=f"distortion_model of {name}",
                why="only newer versions of ROS 2's image_geometry and image_proc know equidistant.",
            )
        if camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="the files have no key for it.")
