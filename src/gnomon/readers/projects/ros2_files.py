"""ROS 2: static transforms in a launch file, and the calibration of a camera as camera_calibration_parsers has it.

A static transform is the pose of its child_frame_id in its frame_id, p_parent = T p_child.
"""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...calibration import CameraCalibration
from ...geometry.quaternion import normalised, rotation_from_quaternion
from ...geometry.so3 import inverse
from ...models.camera import Camera
from ...models.lens_names import DistortionName
from ...recording import Floats
from ..rig.kalibr_yaml import required, whole_number
from ..structured import Node
from .camera_places_in_body import lens, placed, text_of
from .foreign import ForeignCalibration, ForeignImu
from .foreign_yaml import matrix, read_foreign_yaml, unwrapped

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
        words = required(keys, "args", node, "--x, --y, ...")
        values = _arguments(words)
        found = _CAMERA.search(values["child-frame-id"])
        if re.fullmatch(r"imu\d+", values["child-frame-id"]) and values["frame-id"] == "imu0":
            imus[values["child-frame-id"]] = ForeignImu(T_imu_body=inverse(_pose(words, values)))
            continue
        if found is None or _IMU.search(values["frame-id"]) is None:
            notes.append(f"The transform from {values['frame-id']} to {values['child-frame-id']} was passed over.")
            continue
        name = f"cam{found[1]}"
        cameras[name] = placed(_pose(words, values), 0.0, _lens_beside(root, name, notes))
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
        imus={}, frame="accel-x", notes=tuple(notes), lenses={name: _lens(root)}, format="ROS 2, camera_info"
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


def _pose(node: Node, values: dict[str, str]) -> Floats:
    """Return T_parent_child (4, 4); numbers that are not given are zero, and qw is 1."""
    for key in ("roll", "pitch", "yaw"):
        if key in values:
            raise node.fail(f"found --{key}; gnomon reads quaternions (--qx --qy --qz --qw) only.")
    found = {key: _number(node, key, values) for key in _NUMBERS if key in values}
    q = np.array([found.get(key, 1.0 if key == "qw" else 0.0) for key in ("qw", "qx", "qy", "qz")])
    length = float(np.linalg.norm(q))
    if not 0.98 < length < 1.02:
        raise node.fail(f"the quaternion (qx, qy, qz, qw) has length {length:.3g}, expected 1.")
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(normalised(q))
    T[:3, 3] = [found.get(key, 0.0) for key in ("x", "y", "z")]
    return T


def _number(node: Node, key: str, values: dict[str, str]) -> float:
    """Return a number of the arguments.

    Raises
    ------
    FormatError
        If it is none.
    """
    return Node(file=node.file, path=f"{node.path}, --{key}", value=values[key], key=key).number()


def _lens_beside(root: Node, name: str, notes: list[str]) -> Camera:
    path = Path(root.file).parent / f"{name}_camera_info.yaml"
    if not path.is_file():
        raise root.fail(f"there is no file {path}, in which the lens of {name} should be. Put it beside this file.")
    return _lens(read_foreign_yaml(path, notes))


def _lens(root: Node) -> Camera:
    keys = {node.key: node for node in root.entries()}
    K = matrix(required(keys, "camera_matrix", root, "a matrix 3x3"), 3, 3)
    width, height = (whole_number(required(keys, key, root, "a number")) for key in ("image_width", "image_height"))
    kind = required(keys, "distortion_model", root, "a distortion").text(tuple(_DISTORTIONS))
    coeffs = unwrapped(required(keys, "distortion_coefficients", root, "a list of numbers"))
    return lens(
        root,
        intrinsics=K[[0, 1, 0, 1], [0, 1, 2, 2]],
        resolution=(width, height),
        coeffs=np.array([item.number() for item in coeffs.items()]),
        distortion=_DISTORTIONS[kind],
    )
