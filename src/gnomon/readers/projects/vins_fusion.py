"""VINS-Fusion's and VINS-Mono's config.yaml, and the files of its lenses (camodocal's).

body_T_cam0 maps camera to IMU coordinates, td is t_imu - t_cam. The noise is that of a sample, so that its density
needs the rate, which gnomon writes as update_rate and VINS' own files do not state.
"""

import re
from math import sqrt
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import FormatError, OptionError
from ...models.camera import Camera
from ...models.noise import ImuNoise
from ..rig.kalibr_yaml import required, whole_number
from ..structured import Node
from .camera_places_in_body import lens, numbers, placed, text_of
from .foreign import ForeignCalibration, ForeignImu
from .foreign_yaml import read_foreign_yaml, rigid

_NOISE = {
    "acc_n": "accelerometer_noise_density",
    "acc_w": "accelerometer_random_walk",
    "gyr_n": "gyroscope_noise_density",
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
        calib = required(keys, f"cam{i}_calib", root, "the name of the file of the lens")
        camera = _lens_beside(root, calib, text_of(keys, f"image{i}_topic"), notes)
        cameras[f"cam{i}"] = placed(rigid(keys[f"body_T_cam{i}"]), shift, camera)
    rate = keys["update_rate"].number() if "update_rate" in keys else None
    imu = ForeignImu(noise=_noise(keys, rate, notes), update_rate_hz=rate, topic=text_of(keys, "imu_topic"))
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
    width, height = (whole_number(required(keys, key, root, "a number")) for key in ("image_width", "image_height"))
    projection = keys["projection_parameters"]
    model = keys["model_type"].text(("PINHOLE", "KANNALA_BRANDT", "MEI"))
    if model == "KANNALA_BRANDT":
        return lens(
            root,
            intrinsics=numbers(projection, ("mu", "mv", "u0", "v0")),
            resolution=(width, height),
            coeffs=numbers(projection, ("k2", "k3", "k4", "k5")),
            distortion="equidistant",
            topic=topic,
        )
    bent = numbers(required(keys, "distortion_parameters", root, "k1 k2 p1 p2"), _RADTAN)
    if model == "PINHOLE":
        return lens(
            root,
            intrinsics=numbers(projection, _PINHOLE),
            resolution=(width, height),
            coeffs=bent,
            distortion="radtan",
            topic=topic,
        )
    xi = numbers(required(keys, "mirror_parameters", root, "xi"), ("xi",))
    return lens(
        root,
        intrinsics=np.concatenate([xi, numbers(projection, ("gamma1", "gamma2", "u0", "v0"))]),
        resolution=(width, height),
        coeffs=bent,
        distortion="radtan",
        projection="omni",
        topic=topic,
    )


def _noise(keys: dict[str, Node], rate_hz: float | None, notes: list[str]) -> ImuNoise | None:
    found = {ours: keys[name].number() for name, ours in _NOISE.items() if name in keys}
    if len(found) < len(_NOISE):
        return None
    if rate_hz is None or rate_hz <= 0:
        notes.append("The noise is that of a sample, and the rate is not stated: it was left out.")
        return None
    try:
        return ImuNoise(**{name: value / sqrt(rate_hz) for name, value in found.items()})
    except OptionError as error:
        notes.append(f"The noise was left out: {error}")
        return None
