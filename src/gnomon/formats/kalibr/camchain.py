"""Kalibr's camchain.yaml and camchain-imucam.yaml: cameras with lens, pose and time shift."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...models.camera import Camera
from ...models.lens_names import COEFFICIENTS, LINEAR, SHAPES, DistortionName, ProjectionName
from ...recording import Floats, frozen_array
from ...results.calibration import Calibration, CameraCalibration
from ..shared.foreign_yaml import (
    file_name,
    passed_over,
    read_foreign_yaml,
    read_sensors,
    read_transform,
    required_value,
    unwrap_rows,
    whole_number,
)
from ..shared.losses import cameras_without_k3, k3_losses
from ..shared.structured import Node
from ..shared.yaml_text import kalibr_yaml

_EXPECTED = "Kalibr's camchain.yaml, with the cameras under cam0, cam1, ..."
_INTRINSICS: dict[ProjectionName, str] = {name: " ".join((*shape, *LINEAR)) for name, shape in SHAPES.items()}
_NOT_OF_KALIBR = "radtan5"
_COEFFS: dict[DistortionName, str] = {
    name: " ".join(coeffs) for name, coeffs in COEFFICIENTS.items() if name != _NOT_OF_KALIBR
}
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
_SIGMAS = ("intrinsics_sigma", "distortion_coeffs_sigma")  # no keys of Kalibr's
_OTHER_KEYS = {"distortion_coefficients": "distortion_coeffs", "projection_model": "camera_model"}  # of EuRoC
_IGNORED = ("cam_overlaps", "rostopic", "line_delay")
_LONGEST_SHIFT_S = 9e9  # clocks may have unrelated origins, but timestamps fit into 64 bits of nanoseconds
_CONTRADICTION = 0.02  # [rad] and [m]


@value_class
class CameraInput:
    """What Kalibr's camchain.yaml says of one camera.

    Attributes
    ----------
    camera : lens and intrinsics
    T_cam_imu : (4, 4) initial guess, p_cam = T_cam_imu @ p_imu [m], or None
    time_shift_cam_imu_s : initial guess of t_imu - t_cam [s], or None
    lens_covariance : (k, k) covariance of intrinsics and distortion coefficients, in the order of `Camera.parameters`,
        or None where it is not known
    T_cam_cam0 : (4, 4) p_cam = T_cam_cam0 @ p_cam0 [m] by the chain of T_cn_cnm1, or None
    """

    camera: Camera
    T_cam_imu: Floats | None = None
    time_shift_cam_imu_s: float | None = None
    lens_covariance: Floats | None = None
    T_cam_cam0: Floats | None = None


def read_camchain(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, CameraInput]:
    """Read cameras from Kalibr's camchain.yaml.

    Beyond what Kalibr takes, the names of the models may be written in any case and by their usual other names,
    T_imu_cam (the inverse, as OpenVINS has it) may stand for T_cam_imu, line_delay [s] states the time from one image
    row to the next of a rolling shutter, and intrinsics_sigma with distortion_coeffs_sigma the standard deviations of
    both lists. Where only the first cameras have T_cam_imu, T_cn_cnm1 carries it on.

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
    said: list[str] = [] if notes is None else notes
    return cameras_of(read_foreign_yaml(path, said), said)


def cameras_of(root: Node, notes: list[str]) -> dict[str, CameraInput]:
    """Return the cameras of a file that was parsed; see `read_camchain`.

    Raises
    ------
    FormatError
        If a key is missing, or a value makes no camera or no rigid transformation.
    """
    nodes = read_sensors(root, "cam", "camera_model", _EXPECTED)
    if root not in nodes.values():
        passed_over((node for node in root.entries() if node.key not in nodes), notes)
    cameras: dict[str, CameraInput] = {}
    for name, node in nodes.items():
        before = cameras.get(f"cam{int(name.removeprefix('cam')) - 1}")
        found = _camera_input(node, notes)
        found = replace(found, T_cam_cam0=frozen_array(np.eye(4))) if name == "cam0" else found
        cameras[name] = _chained(found, node, before, notes)
    return cameras


def _camera_input(node: Node, notes: list[str]) -> CameraInput:
    keys = {_OTHER_KEYS.get(child.key, child.key): child for child in node.entries()}
    known = (*_REQUIRED, *_OPTIONAL, *_SIGMAS, *_IGNORED)
    passed_over((child for key, child in keys.items() if key not in known), notes)
    shift = keys["timeshift_cam_imu"].number() if "timeshift_cam_imu" in keys else None
    if shift is not None and abs(shift) > _LONGEST_SHIFT_S:
        raise keys["timeshift_cam_imu"].fail(f"found {shift:g} s, expected t_imu - t_cam in seconds.")
    camera = camera_of(node, keys, notes)
    return CameraInput(
        camera=camera,
        T_cam_imu=_extrinsics(keys),
        time_shift_cam_imu_s=shift,
        lens_covariance=_lens_covariance(node, keys, camera),
    )


def _lens_covariance(node: Node, keys: dict[str, Node], camera: Camera) -> Floats | None:
    """Return the covariance that follows from standard deviations, where they are stated."""
    if not any(name in keys for name in _SIGMAS):
        return None
    sigmas: list[float] = []
    for name, values in zip(_SIGMAS, (camera.intrinsics, camera.distortion_coeffs), strict=True):
        if name not in keys and not len(values):
            continue
        stated = required_value(keys, name, node, f"{len(values)} standard deviations, as there are beside it")
        found = [item.number() for item in unwrap_rows(stated).items()]
        if len(found) != len(values) or any(value <= 0 for value in found):
            raise stated.fail(f"found {found}, expected {len(values)} standard deviations greater than zero.")
        sigmas += found
    return frozen_array(np.diag(np.square(sigmas)))


def camera_of(node: Node, keys: dict[str, Node], notes: list[str]) -> Camera:
    """Return lens and intrinsics of one camera.

    Parameters
    ----------
    node : the camera's entry, for messages
    keys : its values by Kalibr's names
    notes : where sentences on what was passed over are appended

    Raises
    ------
    FormatError
        If a key is missing, or the values make no camera.
    """
    projection, also = _projection(required_value(keys, "camera_model", node, f"one of {', '.join(_INTRINSICS)}"))
    expected = _INTRINSICS[projection]
    intrinsics = unwrap_rows(required_value(keys, "intrinsics", node, f"{expected} of {projection}"))
    values = _numbers(intrinsics, expected, projection)
    if (values[-4:-2] <= 0).any():
        raise intrinsics.fail(f"found focal lengths {values[-4]:g} and {values[-3]:g}, expected numbers above zero.")
    size = list(unwrap_rows(required_value(keys, "resolution", node, "[width, height]")).items())
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
    coeffs = unwrap_rows(required_value(keys, "distortion_coeffs", node, f"{_COEFFS[name]} of {name}"))
    return name, _numbers(_without_zero_tail(coeffs, name, notes), _COEFFS[name], name)


def _refuse_coeffs(keys: dict[str, Node]) -> None:
    coeffs = keys.get("distortion_coeffs")
    if coeffs is None or coeffs.value is None:
        return
    if any(item.number() != 0 for item in unwrap_rows(coeffs).items()):
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
    found = [read_transform(keys["T_cam_imu"])] if "T_cam_imu" in keys else []
    if "T_imu_cam" in keys:
        found.append(frozen_array(np.linalg.inv(read_transform(keys["T_imu_cam"]))))
    if len(found) == 2 and _apart(found[0], found[1]) > _CONTRADICTION:
        raise keys["T_imu_cam"].fail("this is not the inverse of T_cam_imu beside it. Keep the one that is right.")
    return found[0] if found else None


def _apart(first: Floats, second: Floats) -> float:
    """Return how far two transformations differ, the larger one of angle [rad] and distance [m]."""
    angle = np.linalg.norm(first[:3, :3] - second[:3, :3]) / np.sqrt(2)
    return max(float(angle), float(np.linalg.norm(first[:3, 3] - second[:3, 3])))


def _chained(camera: CameraInput, node: Node, before: CameraInput | None, notes: list[str]) -> CameraInput:
    """Carry the extrinsics of the camera before over T_cn_cnm1, where this camera has none of its own."""
    if "T_cn_cnm1" not in node.value:
        return camera
    link = read_transform(node.child("T_cn_cnm1"))
    if before is None:
        passed_over([node.child("T_cn_cnm1")], notes)
        return camera
    if before.T_cam_cam0 is not None:
        camera = replace(camera, T_cam_cam0=frozen_array(link @ before.T_cam_cam0))
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


CAMCHAIN_FILE, LENS_FILE = "camchain-imucam.yaml", "camchain.yaml"
_HEADER = """\
# Cameras and their poses in Kalibr's layout, made by gnomon; sigmas are in calibration.yaml.
# p_cam = T_cam_imu p_imu [m], t_imu = t_cam + timeshift_cam_imu [s], p_cn = T_cn_cnm1 p_cnm1.
"""
_HEADER_ALONE = """\
# Cameras in Kalibr's layout, made by gnomon; sigmas are in calibration.yaml. p_cn = T_cn_cnm1 p_cnm1 [m].
"""


def camchain_text(calibration: Calibration, remarks: str = "") -> str:
    """Return the text of `camchain-imucam.yaml` for a calibration with cameras, in Kalibr's body frame accel-x.

    Parameters
    ----------
    remarks : lines of comment
    """
    lost = "".join(f"# {loss}\n" for loss in k3_losses(calibration, "Kalibr"))
    return _HEADER + remarks + lost + kalibr_yaml(camera_chain(calibration.cameras))


def lens_chain_text(
    calibration: Calibration, remarks: str = "", overlaps: Mapping[str, list[int]] | None = None
) -> str:
    """Return the text of `camchain.yaml`: lenses and baselines, without an IMU.

    Parameters
    ----------
    remarks : lines of comment
    overlaps : "cam0", ... -> numbers of the cameras that see the same; those next to it where not given
    """
    lost = "".join(f"# {loss}\n" for loss in k3_losses(calibration, "Kalibr"))
    return _HEADER_ALONE + remarks + lost + kalibr_yaml(lens_chain(calibration.cameras, overlaps))


def lens_chain(
    cameras: Mapping[str, CameraCalibration], overlaps: Mapping[str, list[int]] | None = None
) -> dict[str, Any]:
    """Return cameras without an IMU by Kalibr's keys."""
    document = {name: _lens_entry(camera.camera) for name, camera in cameras_without_k3(cameras).items()}
    numbers = {name: int(name.removeprefix("cam")) for name in cameras}
    together: dict[str, list[int]] = {name: [] for name in cameras}
    for (first, before), (second, camera) in pairwise(cameras.items()):
        document[second]["T_cn_cnm1"] = camera_baseline(before, camera)
        together[first].append(numbers[second])
        together[second].append(numbers[first])
    for name, entry in document.items():
        entry["cam_overlaps"] = np.array(sorted((overlaps or together)[name]), dtype=np.int64)
    return document


def camera_chain(cameras: Mapping[str, CameraCalibration]) -> dict[str, Any]:
    """Return cameras by Kalibr's keys."""
    document = {name: _camera_entry(camera) for name, camera in cameras_without_k3(cameras).items()}
    for (_, before), (name, camera) in pairwise(cameras.items()):
        document[name]["T_cn_cnm1"] = camera_baseline(before, camera)
    return document


def camera_baseline(before: CameraCalibration, camera: CameraCalibration) -> Floats:
    """Return T_camera_before (4, 4) [m]."""
    rotation = camera.T_cam_body[:3, :3] @ before.T_cam_body[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = camera.T_cam_body[:3, 3] - rotation @ before.T_cam_body[:3, 3]
    return pose


def _camera_entry(calibrated: CameraCalibration) -> dict[str, Any]:
    return {
        "T_cam_imu": calibrated.T_cam_imu,
        "cam_overlaps": [],
        "timeshift_cam_imu": float(calibrated.time_shift_cam_imu),
        **_lens_entry(calibrated.camera),
    }


def _lens_entry(camera: Camera) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "camera_model": camera.projection,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_model": camera.distortion,
        "intrinsics": camera.intrinsics,
        "resolution": np.array(camera.resolution),
    }
    if camera.line_delay_s:  # no key of Kalibr's, which passes over it; gnomon reads it back
        entry["line_delay"] = float(camera.line_delay_s)
    if camera.topic:
        entry["rostopic"] = camera.topic
    return entry


def is_kalibr_cam_results(text: str) -> bool:
    """Return whether a text is what Kalibr prints after a calibration of cameras."""
    return text.lstrip().startswith("Calibration results") and "Camera-system parameters" in text
