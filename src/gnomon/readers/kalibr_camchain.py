"""Kalibr's camchain.yaml: cameras with their intrinsics, and what is known of their extrinsics and time shifts."""

from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from ..errors import OptionError
from ..models.camera import Camera, DistortionName, ProjectionName
from ..recording import Floats, frozen_array
from .kalibr_yaml import file_name, passed_over, required, sensors, whole_number
from .structured import Node, read_yaml

_EXPECTED = "Kalibr's camchain.yaml, with the cameras under cam0, cam1, ..."
_INTRINSICS: dict[ProjectionName, str] = {
    "pinhole": "fu fv pu pv",
    "omni": "xi fu fv pu pv",
    "eucm": "alpha beta fu fv pu pv",
    "ds": "xi alpha fu fv pu pv",
}
_COEFFS: dict[DistortionName, str] = {"none": "", "radtan": "k1 k2 p1 p2", "equidistant": "k1 k2 k3 k4", "fov": "w"}
_PROJECTION_ALIASES: dict[str, ProjectionName] = {
    "perspective": "pinhole",
    "mei": "omni",
    "omnidirectional": "omni",
    "unified": "omni",
    "extendedunified": "eucm",
    "doublesphere": "ds",
}
_DISTORTION_ALIASES: dict[str, DistortionName] = {
    "": "none",
    "null": "none",
    "nodistortion": "none",
    "plumbbob": "radtan",
    "radialtangential": "radtan",
    "brownconrady": "radtan",
    "equi": "equidistant",
    "fisheye": "equidistant",
    "kannalabrandt": "equidistant",
    "kb4": "equidistant",
    "atan": "fov",
}
_REQUIRED = ("camera_model", "intrinsics", "resolution")
_OPTIONAL = ("distortion_model", "distortion_coeffs", "T_cam_imu", "T_imu_cam", "T_cn_cnm1", "timeshift_cam_imu")
_IGNORED = ("cam_overlaps", "rostopic", "line_delay")
_NO_ROTATION = 0.02  # numbers typed by hand have few digits
_FARTHEST_M = 100.0
_LONGEST_SHIFT_S = 9e9  # clocks may have unrelated origins, but stamps fit into 64 bits of nanoseconds
_CONTRADICTION = 0.02  # [rad] and [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraInput:
    """What Kalibr's camchain.yaml says of one camera.

    Attributes
    ----------
    camera : lens and intrinsics
    T_cam_imu : (4, 4) initial guess, p_cam = T_cam_imu @ p_imu [m], or None
    time_shift_cam_imu_s : initial guess of t_imu - t_cam [s], or None
    """

    camera: Camera
    T_cam_imu: Floats | None = None
    time_shift_cam_imu_s: float | None = None


def read_camchain(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, CameraInput]:
    """Read cameras from Kalibr's camchain.yaml.

    Beyond what Kalibr takes, the names of the models may be written in any case and by their usual other names,
    T_imu_cam (the inverse, as OpenVINS has it) may stand for T_cam_imu, and line_delay [s] states the time from one
    image row to the next of a rolling shutter. Where only the first cameras have T_cam_imu, T_cn_cnm1 carries it on.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was passed over, or taken, are appended

    Returns
    -------
    mapping from "cam0", "cam1", ... to CameraInput

    Raises
    ------
    FormatError
        If the file cannot be read, a key is missing, or a value makes no camera or no rigid transformation.
    """
    root = read_yaml(path)
    said: list[str] = [] if notes is None else notes
    nodes = sensors(root, "cam", "camera_model", _EXPECTED)
    if root not in nodes.values():
        passed_over((node for node in root.entries() if node.key not in nodes), said)
    cameras: dict[str, CameraInput] = {}
    for name, node in nodes.items():
        before = cameras.get(f"cam{int(name.removeprefix('cam')) - 1}")
        cameras[name] = _chained(_camera_input(node, said), node, before, said)
    return cameras


def _camera_input(node: Node, notes: list[str]) -> CameraInput:
    keys = {child.key: child for child in node.entries()}
    passed_over((child for key, child in keys.items() if key not in (*_REQUIRED, *_OPTIONAL, *_IGNORED)), notes)
    shift = keys["timeshift_cam_imu"].number() if "timeshift_cam_imu" in keys else None
    if shift is not None and abs(shift) > _LONGEST_SHIFT_S:
        raise keys["timeshift_cam_imu"].fail(f"found {shift:g} s, expected t_imu - t_cam in seconds.")
    return CameraInput(camera=_camera(node, keys, notes), T_cam_imu=_extrinsics(keys), time_shift_cam_imu_s=shift)


def _camera(node: Node, keys: dict[str, Node], notes: list[str]) -> Camera:
    projection, also = _projection(required(keys, "camera_model", node, f"one of {', '.join(_INTRINSICS)}"))
    expected = _INTRINSICS[projection]
    intrinsics = required(keys, "intrinsics", node, f"{expected} of {projection}")
    values = _numbers(intrinsics, expected, projection)
    if (values[-4:-2] <= 0).any():
        raise intrinsics.fail(f"found focal lengths {values[-4]:g} and {values[-3]:g}, expected numbers above zero.")
    size = list(required(keys, "resolution", node, "[width, height]").items())
    if len(size) != 2 or min(whole_number(item) for item in size) < 1:
        raise keys["resolution"].fail(f"found {keys['resolution'].value}, expected [width, height] in pixels.")
    width, height = (whole_number(item) for item in size)
    distortion, coeffs = _distortion(node, keys, also, projection, notes)
    if not (0 <= values[-2] < width and 0 <= values[-1] < height):
        notes.append(
            f"{file_name(node)}: the principal point of {node.path or 'cam0'}, {values[-2]:g} {values[-1]:g}, lies "
            f"outside the image of {width} x {height} px. Are resolution and intrinsics of the same camera?"
        )
    try:
        return Camera(
            projection=projection,
            intrinsics=values,
            distortion=distortion,
            distortion_coeffs=coeffs,
            resolution=(width, height),
            line_delay_s=_line_delay(keys, height),
            topic=keys["rostopic"].text() if "rostopic" in keys else "",
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def _plain(text: str) -> str:
    return "".join(letter for letter in text.lower() if letter.isalnum())


def _projection(node: Node) -> tuple[ProjectionName, str | None]:
    """Return the projection, and the distortion where both are one word, as on Kalibr's command line."""
    stated = node.text()
    first, _, also = stated.partition("-")
    for name, rest in ((stated, None), (first, also)):
        plain = _plain(name)
        for known in _INTRINSICS:
            if plain in {known, *(alias for alias, meant in _PROJECTION_ALIASES.items() if meant == known)}:
                return known, rest
    raise node.fail(f'found "{stated}", expected one of {", ".join(_INTRINSICS)}.')


def _distortion(
    node: Node, keys: dict[str, Node], also: str | None, projection: ProjectionName, notes: list[str]
) -> tuple[DistortionName, Floats]:
    if "distortion_model" in keys:
        stated = keys["distortion_model"]
        word = "" if stated.value is None else stated.text()
    elif also is not None:
        stated, word = keys["camera_model"], also
    elif "distortion_coeffs" not in keys and projection in {"eucm", "ds"}:
        return "none", np.empty(0)
    else:
        raise node.fail(
            f"the key distortion_model is missing. Expected one of {', '.join(_COEFFS)}; none for an image without "
            "distortion."
        )
    plain = _plain(word)
    name: DistortionName | None = next((known for known in _COEFFS if known == plain), None)
    name = name or _DISTORTION_ALIASES.get(plain)
    if name is None:
        raise stated.fail(f'found "{word}", expected one of {", ".join(_COEFFS)}.')
    if name == "none":
        _refuse_coeffs(keys)
        return name, np.empty(0)
    coeffs = required(keys, "distortion_coeffs", node, f"{_COEFFS[name]} of {name}")
    return name, _numbers(_without_zero_tail(coeffs, name, notes), _COEFFS[name], name)


def _refuse_coeffs(keys: dict[str, Node]) -> None:
    coeffs = keys.get("distortion_coeffs")
    if coeffs is not None and coeffs.value is not None and any(item.number() != 0 for item in coeffs.items()):
        raise coeffs.fail("found coefficients, but distortion_model is none. Which of the two is meant?")


def _without_zero_tail(node: Node, name: DistortionName, notes: list[str]) -> Node:
    """Return the coefficients without a fifth one, k3 of plumb_bob, that is zero."""
    count = len(_COEFFS[name].split())
    items = list(node.items())
    if name != "radtan" or len(items) <= count:
        return node
    if any(item.number() != 0 for item in items[count:]):
        raise node.fail(
            f"found {len(items)} coefficients, of which {items[count].number():g} is k3; radtan has k1 k2 p1 p2 only. "
            "Calibrate the camera with radtan of four coefficients, or with equidistant for a wide lens."
        )
    notes.append(f"{file_name(node)}: {node.path} has zeros behind k1 k2 p1 p2, which were passed over.")
    return replace(node, value=node.value[:count])


def _numbers(node: Node, names: str, model: str) -> Floats:
    found = list(node.items())
    count = len(names.split())
    if len(found) != count:
        raise node.fail(f"found {len(found)} numbers, expected {count} for {model}: {names}.")
    return node.floats(count)


def _line_delay(keys: dict[str, Node], height: int) -> float:
    if "line_delay" not in keys:
        return 0.0
    value = keys["line_delay"].number()
    if abs(value) * height > 1:
        raise keys["line_delay"].fail(
            f"found {value:g} s from one row to the next, which is {abs(value) * height:g} s for an image. "
            "The unit is the second; usual is 1e-5 to 5e-5."
        )
    return value


def _extrinsics(keys: dict[str, Node]) -> Floats | None:
    """Return T_cam_imu, from T_imu_cam where only that is stated."""
    found = [_rigid(keys["T_cam_imu"])] if "T_cam_imu" in keys else []
    if "T_imu_cam" in keys:
        found.append(frozen_array(np.linalg.inv(_rigid(keys["T_imu_cam"]))))
    if len(found) == 2 and _apart(found[0], found[1]) > _CONTRADICTION:
        raise keys["T_imu_cam"].fail("this is not the inverse of T_cam_imu beside it. Keep the one that is right.")
    return found[0] if found else None


def _rigid(node: Node) -> Floats:
    """Return a rigid transformation (4, 4); its rotation is made exact, since numbers in files are rounded."""
    flat = isinstance(node.value, list) and len(node.value) == 16
    T = node.floats(16).reshape(4, 4) if flat else node.floats(4, 4)
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-6:
        turned = " It seems to be transposed." if np.abs(T[:, 3] - [0, 0, 0, 1]).max() <= 1e-6 else ""
        raise node.fail(f"the last row of the matrix is {T[3].tolist()}, expected [0, 0, 0, 1].{turned}")
    R = T[:3, :3]
    error = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else float(np.abs(R).max())
    if error > _NO_ROTATION:
        raise node.fail(
            f"its left upper 3x3 part is no rotation matrix: its rows should be of length 1 and at right angles, and "
            f"miss that by {error:.2g}."
        )
    if np.linalg.det(R) < 0:
        raise node.fail(
            "its left upper 3x3 part is mirrored (determinant -1), which no rotation is. Is the sign of an axis wrong?"
        )
    if np.abs(T[:3, 3]).max() > _FARTHEST_M:
        raise node.fail(f"found the translation {T[:3, 3].tolist()} m. The unit is the metre; was it in millimetres?")
    u, _, v = np.linalg.svd(R)
    exact = T.copy()
    exact[:3, :3] = u @ v
    return frozen_array(exact)


def _apart(first: Floats, second: Floats) -> float:
    """Return how far two transformations differ, the larger one of angle [rad] and distance [m]."""
    angle = np.linalg.norm(first[:3, :3] - second[:3, :3]) / np.sqrt(2)
    return max(float(angle), float(np.linalg.norm(first[:3, 3] - second[:3, 3])))


def _chained(camera: CameraInput, node: Node, before: CameraInput | None, notes: list[str]) -> CameraInput:
    """Carry the extrinsics of the camera before over T_cn_cnm1, where this camera has none of its own."""
    if "T_cn_cnm1" not in node.value:
        return camera
    link = _rigid(node.child("T_cn_cnm1"))
    if before is None:
        passed_over([node.child("T_cn_cnm1")], notes)
        return camera
    if before.T_cam_imu is None:
        return camera
    T = frozen_array(link @ before.T_cam_imu)
    if camera.T_cam_imu is None:
        return replace(camera, T_cam_imu=T)
    if _apart(T, camera.T_cam_imu) > _CONTRADICTION:
        notes.append(
            f"{file_name(node)}: T_cam_imu and T_cn_cnm1 of {node.path} contradict each other; both are only guesses."
        )
    return camera
