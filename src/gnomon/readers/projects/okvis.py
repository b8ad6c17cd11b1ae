"""OKVIS2's and OKVIS' configuration: cameras with T_SC, the delay of images, biases and noise of the IMU.

T_SC maps camera to IMU coordinates, T_BS those of the IMU to a body's, from which all else is counted; the corrected
stamp of an image is its stamp minus image_delay, so that t_imu - t_cam is minus image_delay.
"""

from dataclasses import replace

import numpy as np

from ...calibration import CameraCalibration, ImuCalibration
from ...errors import OptionError
from ...models.lens_names import DistortionName
from ...models.noise import ImuNoise
from ..rig.kalibr_yaml import required
from ..structured import Node
from .camera_places_in_body import lens, placed
from .foreign import ForeignCalibration, ForeignImu
from .foreign_yaml import rigid
from .kalibr_imu import ideal_imu

_NOISE = {
    "sigma_a_c": "accelerometer_noise_density",
    "sigma_aw_c": "accelerometer_random_walk",
    "sigma_g_c": "gyroscope_noise_density",
    "sigma_gw_c": "gyroscope_random_walk",
}
_DISTORTIONS: dict[str, DistortionName] = {
    "radialtangential": "radtan",
    "plumb_bob": "radtan",
    "radialtangential8": "radtan",
    "equidistant": "equidistant",
}


def is_okvis(root: Node) -> bool:
    """Return whether a file is laid out as OKVIS' configuration."""
    cameras = root.value.get("cameras") if isinstance(root.value, dict) else None
    return isinstance(cameras, list) and bool(cameras) and isinstance(cameras[0], dict) and "T_SC" in cameras[0]


def okvis_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the rig of OKVIS' configuration.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in OKVIS' layout, or its cameras are of a kind that gnomon does not know.
    """
    keys = {node.key: node for node in root.entries()}
    delay = _delay(keys)
    if delay is None:
        notes.append("The delay of images is not stated; taken: zero.")
    cameras = {f"cam{i}": _camera(node, -(delay or 0.0)) for i, node in enumerate(keys["cameras"].items())}
    entry = next((keys[name] for name in ("imu_parameters", "imu_params") if name in keys), None)
    imus: dict[str, ImuCalibration] = {}
    data: dict[str, ForeignImu] = {}
    if entry is not None:
        values = {node.key: node for node in entry.entries()}
        imus["imu0"] = _imu(values)
        data["imu0"] = _data(values, notes)
        notes.append("OKVIS' file holds no scales and axes of the IMU; taken: ideal but for its bias.")
    return ForeignCalibration(
        imus=imus, frame="accel-x", notes=tuple(notes), cameras=cameras, imu_data=data, format="OKVIS"
    )


def _delay(keys: dict[str, Node]) -> float | None:
    if "imageDelay" in keys:  # the first OKVIS
        return keys["imageDelay"].number()
    for name in ("camera_parameters", "camera_params"):
        if name in keys:
            for node in keys[name].entries():
                if node.key == "image_delay":
                    return node.number()
    return None


def _camera(node: Node, shift_s: float) -> CameraCalibration:
    keys = {child.key: child for child in node.entries()}

    def needed(name: str, count: int) -> np.ndarray:
        return required(keys, name, node, f"{count} numbers").floats(count)

    kind = required(keys, "distortion_type", node, "a distortion").text(tuple(_DISTORTIONS))
    coeffs = required(keys, "distortion_coefficients", node, "a list of numbers")
    width, height = needed("image_dimension", 2).tolist()
    camera = lens(
        node,
        intrinsics=np.concatenate([needed("focal_length", 2), needed("principal_point", 2)]),
        resolution=(int(width), int(height)),
        coeffs=np.array([item.number() for item in coeffs.items()]),
        distortion=_DISTORTIONS[kind],
    )
    return placed(rigid(required(keys, "T_SC", node, "16 numbers")), shift_s, camera)


def _imu(values: dict[str, Node]) -> ImuCalibration:
    ideal = ideal_imu()
    assert ideal.accelerometer is not None
    assert ideal.gyroscope is not None
    biases = {name: values[name].floats(3) if name in values else np.zeros(3) for name in ("a0", "g0")}
    return ImuCalibration(
        accelerometer=replace(ideal.accelerometer, bias=biases["a0"]),
        gyroscope=replace(ideal.gyroscope, bias=biases["g0"]),
    )


def _data(values: dict[str, Node], notes: list[str]) -> ForeignImu:
    found = {ours: values[name].number() for name, ours in _NOISE.items() if name in values}
    noise = None
    try:
        noise = ImuNoise(**found) if len(found) == len(_NOISE) else None
    except OptionError as error:
        notes.append(f"The noise was left out: {error}")
    T = rigid(values["T_BS"]) if "T_BS" in values else np.eye(4)
    if not np.array_equal(T, np.eye(4)):
        notes.append("T_BS, from the IMU to another body frame, was passed over: poses here are those to the IMU.")
    rate = values["imu_rate"].number() if "imu_rate" in values else None
    return ForeignImu(noise=noise, update_rate_hz=rate)
