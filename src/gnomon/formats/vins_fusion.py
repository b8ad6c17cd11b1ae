"""VINS-Fusion's and VINS-Mono's config.yaml, and the files of its lenses (camodocal's).

body_T_cam0 maps camera to IMU coordinates, td is t_imu - t_cam. The noise is that of a sample, so that its density
needs the rate, which gnomon writes as update_rate and VINS' own files do not state.
"""

import re
from math import sqrt
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..geometry.rotations import inverse_pose
from ..models.camera import Camera
from ..recording.samples import ImuNoise
from ..results.calibration import Calibration, CameraCalibration
from .foreign import ForeignCalibration, ForeignImu
from .shared.foreign_yaml import (
    noise_by_key,
    place_camera,
    read_foreign_yaml,
    read_lens,
    read_numbers,
    read_transform,
    required_value,
    stated_noise,
    text_of,
    whole_number,
)
from .shared.losses import Context, Export, StatedImu, cameras_without_k3, unknown_lens
from .shared.sensor_losses import Holds, not_representable, require_cameras
from .shared.si_units import si_conversions
from .shared.structured import Node
from .shared.yaml_text import FIRST_LINE, opencv_matrix, opencv_text

_NOISE_KEYS = {
    "acc_n": "accelerometer_noise_density",
    "gyr_n": "gyroscope_noise_density",
    "acc_w": "accelerometer_random_walk",
    "gyr_w": "gyroscope_random_walk",
}
_PINHOLE = ("fx", "fy", "cx", "cy")
_RADTAN = ("k1", "k2", "p1", "p2")


def is_vins(root: Node) -> bool:
    """Return whether a file is laid out as VINS' config.yaml."""
    return isinstance(root.value, dict) and "body_T_cam0" in root.value


def is_vins_lens(root: Node) -> bool:
    """Return whether a file is laid out as camodocal's of a lens."""
    return isinstance(root.value, dict) and "model_type" in root.value and "projection_parameters" in root.value


def vins_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the rig of config.yaml, whose lenses are read from the files beside it that it names.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in VINS' layout, or the file of a lens is missing.
    """
    keys = {node.key: node for node in root.entries()}
    shift = keys["td"].number() if "td" in keys else 0.0
    if "td" not in keys:
        notes.append("The time shift (td) is not stated; taken: zero.")
    cameras = {}
    for i in range(2):
        if f"body_T_cam{i}" not in keys:
            continue
        calib = required_value(keys, f"cam{i}_calib", root, "the name of the file of the lens")
        camera = _lens_beside(root, calib, text_of(keys, f"image{i}_topic"), notes)
        cameras[f"cam{i}"] = place_camera(read_transform(keys[f"body_T_cam{i}"]), shift, camera)
    rate = keys["update_rate"].number() if "update_rate" in keys else None
    imu = ForeignImu(noise=_read_noise(keys, rate, notes), update_rate_hz=rate, topic=text_of(keys, "imu_topic"))
    return ForeignCalibration(
        imus={}, frame="accel-x", notes=tuple(notes), cameras=cameras, imu_data={"imu0": imu}, format="VINS-Fusion"
    )


def lens_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return a lens by itself.

    Raises
    ------
    FormatError
        If it is not in camodocal's layout.
    """
    keys = {node.key: node for node in root.entries()}
    stated = f"{text_of(keys, 'camera_name')} {Path(root.file).name}"
    name = re.search(r"cam\d+", stated)
    camera = vins_lens(root, "")
    return ForeignCalibration(
        imus={},
        frame="accel-x",
        notes=tuple(notes),
        lenses={name[0] if name else "cam0": camera},
        format="VINS-Fusion, lens",
    )


def _lens_beside(root: Node, calib: Node, topic: str, notes: list[str]) -> Camera:
    path = Path(root.file).parent / calib.text()
    if Path(calib.text()).is_absolute() or ".." in Path(calib.text()).parts:
        raise calib.fail(f"found {path}, expected a file beside this one. Copy the file of the lens there.")
    if not _is_file(path):
        raise calib.fail(f"there is no file {path}, in which the lens should be. Put it beside this file.")
    return vins_lens(_read(path, notes), topic)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that the system does not take
        return False


def _read(path: str | PathLike[str], notes: list[str]) -> Node:
    root = read_foreign_yaml(path, notes)
    if not is_vins_lens(root):
        raise FormatError(f"{path}: this is no file of a lens: model_type or projection_parameters is missing.")
    return root


def vins_lens(root: Node, topic: str) -> Camera:
    """Return a lens in camodocal's layout.

    Raises
    ------
    FormatError
        If it is not, or gnomon does not know the model.
    """
    keys = {node.key: node for node in root.entries()}
    width, height = (
        whole_number(required_value(keys, key, root, "a number")) for key in ("image_width", "image_height")
    )
    projection = keys["projection_parameters"]
    model = keys["model_type"].text(("PINHOLE", "KANNALA_BRANDT", "MEI"))
    if model == "KANNALA_BRANDT":
        coeffs = read_numbers(projection, ("k2", "k3", "k4", "k5"))
        intrinsics = read_numbers(projection, ("mu", "mv", "u0", "v0"))
    else:
        coeffs = read_numbers(required_value(keys, "distortion_parameters", root, "k1 k2 p1 p2"), _RADTAN)
        intrinsics = read_numbers(projection, _PINHOLE if model == "PINHOLE" else ("gamma1", "gamma2", "u0", "v0"))
    if model == "MEI":
        xi = read_numbers(required_value(keys, "mirror_parameters", root, "xi"), ("xi",))
        intrinsics = np.concatenate([xi, intrinsics])
    return read_lens(
        root,
        intrinsics=intrinsics,
        resolution=(width, height),
        coeffs=coeffs,
        distortion="equidistant" if model == "KANNALA_BRANDT" else "radtan",
        projection="omni" if model == "MEI" else "pinhole",
        topic=topic,
    )


def _read_noise(keys: dict[str, Node], rate_hz: float | None, notes: list[str]) -> ImuNoise | None:
    if not set(_NOISE_KEYS) <= set(keys):
        return None
    if rate_hz is None or rate_hz <= 0:
        notes.append("The noise is that of a sample, and the rate is not stated: it was left out.")
        return None
    return stated_noise(keys, _NOISE_KEYS, notes, sqrt(rate_hz))


FILE = "config.yaml"

_WHOSE = "VINS-Fusion"
_CAMERAS = 2
_HEAD = """\
# The rig for VINS-Fusion, made by gnomon; sigmas are in calibration.yaml. It is not the whole of a configuration: take
# the settings of the tracker and the optimiser from one of VINS' own.
# p_imu = body_T_cam0 p_cam0 [m]; t_imu = t_cam + td [s].
# VINS takes an ideal IMU: the poses hold for samples in m/s^2 and rad/s that were corrected (gnomon apply).
"""
_NOISE_COMMENT = """\
# Noise of a sample: acc_n [m/s^2] and gyr_n [rad/s] = density * sqrt(update_rate), acc_w [m/s^3] and gyr_w [rad/s^2] =
# random walk * sqrt(update_rate); update_rate [Hz] is gnomon's own key, which VINS passes over.
"""
_SETTINGS = "max_cnt, min_dist, freq, F_threshold, max_solver_time, max_num_iterations, keyframe_parallax and others"

HOLDS = Holds(
    program=_WHOSE,
    imus=1,
    cameras=_CAMERAS,
    sensitivity=False,
    bias=False,
    g_sensitivity=False,
    time_shift="one",
    k3=False,
    without_noise="does not start without acc_n, gyr_n, acc_w and gyr_w: add them by hand",
    settings=_SETTINGS,
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `config.yaml`, and `cam0.yaml`, `cam1.yaml` for the lenses.

    Raises
    ------
    OptionError
        If there is no camera, or VINS does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    cameras = cameras_without_k3(dict(list(calibration.cameras.items())[:_CAMERAS]))
    files = {f"{camera}.yaml": _lens_text(camera, known.camera, context) for camera, known in cameras.items()}
    text = _text(calibration, cameras, context.of(next(iter(calibration.imus))), context)
    return Export(files={FILE: text, **files}, losses=tuple(not_representable(calibration, HOLDS, context)))


def _text(calibration: Calibration, cameras: dict[str, CameraCalibration], stated: StatedImu, context: Context) -> str:
    name, imu = next(iter(calibration.imus.items()))
    first = next(iter(cameras.values()))
    noise = _noise_entries(stated)
    lines = [line for conversion in si_conversions(imu) for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    comments += f"# g_norm [m/s^2]: {calibration.gravity.source}\n"
    rig: dict[str, Any] = {"imu": 1, "num_of_cam": len(cameras)}
    rig |= {"imu_topic": stated.topic} if stated.topic else {}
    rig |= {f"image{i}_topic": camera.camera.topic for i, camera in enumerate(cameras.values()) if camera.camera.topic}
    rig |= {f"cam{i}_calib": f"{camera}.yaml" for i, camera in enumerate(cameras)}
    rig |= {"image_width": first.camera.resolution[0], "image_height": first.camera.resolution[1]}
    rig["estimate_extrinsic"] = 0
    end: dict[str, Any] = {
        **noise,
        "g_norm": float(calibration.gravity.value),
        "estimate_td": 0,
        "td": float(first.time_shift_cam_imu),
    }
    parts = [FIRST_LINE, _HEAD, context.comment(), comments, opencv_text(rig)]
    for i, camera in enumerate(cameras.values()):
        parts.append(opencv_matrix(f"body_T_cam{i}", inverse_pose(camera.T_cam_body), "d"))
    parts.append(_NOISE_COMMENT if noise else "# VINS also needs acc_n, gyr_n, acc_w and gyr_w: add them.\n")
    return "".join([*parts, opencv_text(end)])


def _noise_entries(stated: StatedImu) -> dict[str, float]:
    """Return the noise of a sample, which needs the rate."""
    if stated.noise is None or stated.update_rate_hz is None:
        return {}
    noise = noise_by_key(stated.noise, _NOISE_KEYS, sqrt(stated.update_rate_hz))
    return noise | {"update_rate": float(stated.update_rate_hz)}


def _lens_text(name: str, camera: Camera, context: Context) -> str:
    width, height = camera.resolution
    document: dict[str, Any] = {"camera_name": name, "image_width": width, "image_height": height}
    lens = _lens_entry(name, camera)
    head = "# Lens for VINS' camera models, made by gnomon. Pixel (0, 0) is the centre of the top-left pixel.\n"
    return FIRST_LINE + head + context.comment() + opencv_text({"model_type": lens[0], **document, **lens[1]})


def _lens_entry(name: str, camera: Camera) -> tuple[str, dict[str, Any]]:
    """Return the name of a model and its parameters."""
    shape, (fx, fy, cx, cy) = camera.intrinsics[:-4].tolist(), camera.intrinsics[-4:].tolist()
    coeffs = camera.distortion_coeffs if camera.distortion != "none" else np.zeros(4)
    bent = dict(zip(("k1", "k2", "p1", "p2"), coeffs.tolist(), strict=False))
    match camera.projection, camera.distortion:
        case "pinhole", "none" | "radtan":
            linear = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
            return "PINHOLE", {"distortion_parameters": bent, "projection_parameters": linear}
        case "pinhole", "equidistant":
            theta = dict(zip(("k2", "k3", "k4", "k5"), coeffs.tolist(), strict=True))
            return "KANNALA_BRANDT", {"projection_parameters": {**theta, "mu": fx, "mv": fy, "u0": cx, "v0": cy}}
        case "omni", "none" | "radtan":
            linear = {"gamma1": fx, "gamma2": fy, "u0": cx, "v0": cy}
            mirror = {"xi": shape[0]}
            return "MEI", {
                "mirror_parameters": mirror, "distortion_parameters": bent, "projection_parameters": linear,
            }  # fmt: skip
        case _:
            knows = "pinhole with radtan, equidistant or no distortion, and omni with radtan or none"
            raise unknown_lens(name, camera, f"VINS-Fusion knows {knows}")
