"""ROS 2: static transforms in a launch file, and the calibration of a camera as camera_calibration_parsers has it.

A static transform is the pose of its child_frame_id in its frame_id, p_parent = T p_child.
"""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.rotations import inverse_pose, invert_matrix, quaternion_from_rotation
from ..models.camera import Camera
from ..models.lens_names import DistortionName
from ..recording import Floats
from ..results.calibration import Calibration, CameraCalibration
from .foreign import ForeignCalibration, ForeignImu
from .shared.foreign_yaml import (
    place_camera,
    read_foreign_yaml,
    read_lens,
    read_matrix,
    required_value,
    text_of,
    unit_quaternion,
    unwrap_rows,
    whole_number,
)
from .shared.losses import Context, Export, Loss, uncertainty_loss, unknown_lens
from .shared.sensor_losses import Holds, not_representable, require_cameras
from .shared.structured import Node
from .shared.yaml_text import yaml_flow

_CAMERA = re.compile(r"cam(?:era)?_?(\d+)")
_IMU = re.compile(r"imu|base_link|body", re.IGNORECASE)
_NUMBERS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_DISTORTIONS: dict[str, DistortionName] = {
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
}


def is_launch(root: Node) -> bool:
    """Return whether a file is a launch file in YAML."""
    return isinstance(root.value, dict) and isinstance(root.value.get("launch"), list)


def is_camera_info(root: Node) -> bool:
    """Return whether a file is laid out as camera_calibration_parsers writes it."""
    return isinstance(root.value, dict) and {"camera_matrix", "distortion_model"} <= set(root.value)


def launch_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the cameras and IMUs whose poses a launch file publishes; lenses are read from the files beside it.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If no transform from an IMU to a camera is in it, or the file of a lens is missing.
    """
    cameras: dict[str, CameraCalibration] = {}
    imus: dict[str, ForeignImu] = {}
    for item in root.child("launch").items():
        node = item.child("node") if isinstance(item.value, dict) and "node" in item.value else None
        if node is None or "static_transform_publisher" not in str(node.value):
            continue
        keys = {child.key: child for child in node.entries()}
        words = required_value(keys, "args", node, "--x, --y, ...")
        values = _arguments(words)
        found = _CAMERA.search(values["child-frame-id"])
        if re.fullmatch(r"imu\d+", values["child-frame-id"]) and values["frame-id"] == "imu0":
            imus[values["child-frame-id"]] = ForeignImu(T_imu_body=invert_matrix(_read_pose(words, values)))
            continue
        if found is None or _IMU.search(values["frame-id"]) is None:
            notes.append(f"The transform from {values['frame-id']} to {values['child-frame-id']} was passed over.")
            continue
        name = f"cam{found[1]}"
        cameras[name] = place_camera(_read_pose(words, values), 0.0, _lens_beside(root, name, notes))
    if not cameras:
        raise root.fail("there is no static transform from an IMU (frame-id imu0) to a camera (child-frame-id cam0).")
    notes.append("ROS 2 knows no time shift; taken: zero.")
    return ForeignCalibration(
        imus={}, frame="accel-x", notes=tuple(notes), cameras=cameras, imu_data=imus, format="ROS 2"
    )


def camera_info_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return a lens by itself.

    Raises
    ------
    FormatError
        If it is not as camera_calibration_parsers writes it.
    """
    keys = {node.key: node for node in root.entries()}
    found = _CAMERA.search(f"{text_of(keys, 'camera_name')} {Path(root.file).name}")
    name = f"cam{found[1]}" if found else "cam0"
    return ForeignCalibration(
        imus={}, frame="accel-x", notes=tuple(notes), lenses={name: _read_lens(root)}, format="ROS 2, camera_info"
    )


def _arguments(node: Node) -> dict[str, str]:
    """Return the words behind --x and the like."""
    text = node.value if isinstance(node.value, str) else " ".join(str(item.value) for item in node.items())
    words = text.split()
    found = {key.removeprefix("--"): value for key, value in pairwise(words) if key[:2] == "--"}
    for key in ("frame-id", "child-frame-id"):
        if key not in found:
            raise node.fail(f"--{key} is missing; older forms of the arguments are not read.")
    return found


def _read_pose(node: Node, values: dict[str, str]) -> Floats:
    """Return T_parent_child (4, 4); numbers that are not given are zero, and qw is 1."""
    for key in ("roll", "pitch", "yaw"):
        if key in values:
            raise node.fail(f"found --{key}; gnomon reads quaternions (--qx --qy --qz --qw) only.")
    found = {key: _number(node, key, values) for key in _NUMBERS if key in values}
    q = np.array([found.get(key, 1.0 if key == "qw" else 0.0) for key in ("qw", "qx", "qy", "qz")])
    T = np.eye(4)
    T[:3, :3] = unit_quaternion(node, q)
    T[:3, 3] = [found.get(key, 0.0) for key in ("x", "y", "z")]
    return T


def _number(node: Node, key: str, values: dict[str, str]) -> float:
    """Return a number of the arguments."""
    return Node(file=node.file, path=f"{node.path}, --{key}", value=values[key], key=key).number()


def _lens_beside(root: Node, name: str, notes: list[str]) -> Camera:
    path = Path(root.file).parent / f"{name}_camera_info.yaml"
    if not path.is_file():
        raise root.fail(f"there is no file {path}, in which the lens of {name} should be. Put it beside this file.")
    return _read_lens(read_foreign_yaml(path, notes))


def _read_lens(root: Node) -> Camera:
    keys = {node.key: node for node in root.entries()}
    K = read_matrix(required_value(keys, "camera_matrix", root, "a matrix 3x3"), 3, 3)
    width, height = (
        whole_number(required_value(keys, key, root, "a number")) for key in ("image_width", "image_height")
    )
    kind = required_value(keys, "distortion_model", root, "a distortion").text(tuple(_DISTORTIONS))
    coeffs = unwrap_rows(required_value(keys, "distortion_coefficients", root, "a list of numbers"))
    return read_lens(
        root,
        intrinsics=K[[0, 1, 0, 1], [0, 1, 2, 2]],
        resolution=(width, height),
        coeffs=np.array([item.number() for item in coeffs.items()]),
        distortion=_DISTORTIONS[kind],
    )


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

HOLDS = Holds(program=_WHOSE, samples_in_si=False, lever_arms=True, magnetometer=True, time_shift="none")
"""But for the IMU, which has no place at all."""


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
        *_clock_losses(calibration),
        *_lens_losses(calibration),
        *not_representable(calibration, HOLDS, context),
    )
    return Export(files={FILE: _launch_text(name, calibration, context), **infos}, losses=losses)


def _launch_text(imu: str, calibration: Calibration, context: Context) -> str:
    text = _HEAD.format(file=FILE, imu=imu, frame=calibration.frame) + context.comment()
    for name, camera in calibration.cameras.items():
        if camera.time_shift_cam_imu:
            text += _SHIFT.format(shift=float(camera.time_shift_cam_imu), name=name)
    poses = {name: known.T_imu_body for name, known in calibration.imus.items() if known.T_imu_body is not None}
    placed = {name: invert_matrix(pose) for name, pose in poses.items()}
    placed |= {
        name: inverse_pose(camera.T_cam_body) for name, camera in calibration.cameras.items() if name != camera.body
    }
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
                why=f"{_WHOSE} takes the timestamps of all sensors to be of one clock: add it to those of {name} "
                "(t_imu0 = t_imu + shift).",
                size=f"{imu.time_shift_s * 1e3:+.6g} ms",
            )


def _matrix(key: str, matrix: Floats) -> list[str]:
    rows, cols = matrix.shape
    return [f"{key}:", f"  rows: {rows}", f"  cols: {cols}", f"  data: {yaml_flow(matrix)}"]


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
