"""EuRoC's sensor.yaml, one for each camera and each IMU: lens, place on the body, and noise.

T_BS maps coordinates of the sensor to those of the body, p_body = T_BS @ p_sensor. What such a file states is of help
only: whatever cannot be used is passed over with a note.
"""

from dataclasses import replace
from pathlib import Path

from ...errors import FormatError, OptionError
from ...formats.kalibr.camchain import camera_of
from ...formats.kalibr.imu import ImuInput
from ...formats.shared.baselines import inverse_pose
from ...formats.shared.foreign_yaml import read_foreign_yaml, read_transform
from ...formats.shared.structured import Node
from ...frozen import value_class
from ...models.camera import Camera
from ...models.noise import ImuNoise
from ...recording import Floats, frozen_array

_KALIBR_NAMES = {"distortion_coefficients": "distortion_coeffs", "projection_model": "camera_model"}
_NOISE = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
)


@value_class
class SensorInput:
    """What the sensor.yaml of one sensor says.

    Attributes
    ----------
    T_body_sensor : (4, 4) p_body = T_body_sensor @ p_sensor [m], or None
    camera : lens and intrinsics of a camera, or None
    imu : noise and rate of an IMU, or None
    """

    T_body_sensor: Floats | None = None
    camera: Camera | None = None
    imu: ImuInput | None = None


def read_sensor(path: Path, where: str, notes: list[str]) -> SensorInput:
    """Read a sensor.yaml.

    Parameters
    ----------
    path : the file
    where : its name for notes, such as "cam0/sensor.yaml"
    notes : where sentences on what was passed over are appended
    """
    try:
        node = replace(read_foreign_yaml(path, notes), file=where)
        keys = {_KALIBR_NAMES.get(child.key, child.key): child for child in node.entries()}
    except FormatError as error:
        notes.append(f"{where} was passed over: {error}")
        return SensorInput()
    camera = imu = None
    if "intrinsics" in keys:
        try:
            camera = camera_of(node, {key: _sides(child) for key, child in keys.items()}, notes)
        except FormatError as error:
            notes.append(f"The lens was not taken from {error}")
    if _NOISE[0] in keys:
        try:
            imu = _imu_input(keys)
        except (FormatError, OptionError) as error:
            notes.append(f"The noise of the IMU was not taken from {error}")
    return SensorInput(T_body_sensor=_pose(keys, notes), camera=camera, imu=imu)


def T_sensor_imu(sensor: SensorInput, imu: SensorInput) -> Floats | None:
    """Return p_sensor = T @ p_imu from the places of both on the body; an IMU without place is the body itself."""
    if sensor.T_body_sensor is None:
        return None
    T_sensor_body = inverse_pose(sensor.T_body_sensor)
    return frozen_array(T_sensor_body if imu.T_body_sensor is None else T_sensor_body @ imu.T_body_sensor)


def _pose(keys: dict[str, Node], notes: list[str]) -> Floats | None:
    node = keys.get("T_BS")
    if node is None:
        return None
    try:
        return read_transform(node)
    except FormatError as error:
        notes.append(f"The place on the body was not taken from {error}")
        return None


def _sides(node: Node) -> Node:
    """Return the resolution as a list, where it is written as width and height."""
    if node.key == "resolution" and isinstance(node.value, dict) and {"width", "height"} == set(node.value):
        return replace(node, value=[node.value["width"], node.value["height"]])
    return node


def _imu_input(keys: dict[str, Node]) -> ImuInput:
    missing = [name for name in _NOISE if name not in keys]
    if missing:
        raise keys[_NOISE[0]].fail(f"{missing[0]} is missing beside it.")
    noise = ImuNoise(**{name: keys[name].number() for name in _NOISE})
    rate = keys["rate_hz"].number() if "rate_hz" in keys else None
    return ImuInput(noise=noise, update_rate_hz=rate if rate is not None and rate > 0 else None, topic="")
