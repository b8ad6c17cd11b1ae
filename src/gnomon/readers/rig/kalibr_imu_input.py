"""Kalibr's imu.yaml as input: noise, rate and topic of each IMU; flat, or keyed imu0, imu1, ... as Kalibr writes it."""

from dataclasses import dataclass
from os import PathLike

from ...models.noise import ImuNoise
from ..projects.foreign_yaml import read_foreign_yaml
from ..structured import Node
from .kalibr_yaml import file_name, passed_over, required, sensors

_EXPECTED = "Kalibr's imu.yaml, with the noise densities and random walks at the top or under imu0"
_UNITS = {
    "accelerometer_noise_density": "m/s^2/sqrt(Hz)",
    "accelerometer_random_walk": "m/s^3/sqrt(Hz)",
    "gyroscope_noise_density": "rad/s/sqrt(Hz)",
    "gyroscope_random_walk": "rad/s^2/sqrt(Hz)",
}
_RATES = ("update_rate", "rate_hz")  # Kalibr, EuRoC's sensor.yaml
_MODEL = {"accelerometers", "gyroscopes", "Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC"}
_IGNORED = {"rostopic", "model", "T_i_b", "time_offset", *_UNITS, *_RATES, *_MODEL}


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuInput:
    """What Kalibr's imu.yaml says of one IMU.

    Attributes
    ----------
    noise : densities and random walks
    update_rate_hz : sample rate [Hz], or None where it is not stated
    topic : ROS topic, or ""
    """

    noise: ImuNoise
    update_rate_hz: float | None
    topic: str


def read_imu_input(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, ImuInput]:
    """Read the noise of IMUs from Kalibr's imu.yaml.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was passed over are appended

    Returns
    -------
    mapping from "imu0", "imu1", ... to ImuInput

    Raises
    ------
    FormatError
        If the file cannot be read, or a noise is missing or not above zero.
    """
    said: list[str] = [] if notes is None else notes
    root = read_foreign_yaml(path, said)
    imus = sensors(root, "imu", "accelerometer_noise_density", _EXPECTED)
    if root not in imus.values():
        passed_over((node for node in root.entries() if node.key not in imus), said)
    return {name: _imu(node, said) for name, node in imus.items()}


def _imu(node: Node, notes: list[str]) -> ImuInput:
    keys = {child.key: child for child in node.entries()}
    noise = {name: _positive(required(keys, name, node, f"a number in {unit}")) for name, unit in _UNITS.items()}
    model = [key for key in keys if key in _MODEL]
    if model:
        notes.append(
            f"{file_name(node)}: the sensor model in it ({', '.join(model)}) was passed over; it is estimated anew."
        )
    if "time_offset" in keys and keys["time_offset"].number() != 0:
        passed_over([keys["time_offset"]], notes)
    passed_over((child for key, child in keys.items() if key not in _IGNORED), notes)
    rate = next((_positive(keys[name]) for name in _RATES if name in keys), None)
    topic = keys["rostopic"].text() if "rostopic" in keys else ""
    return ImuInput(noise=ImuNoise(**noise), update_rate_hz=rate, topic=topic)


def _positive(node: Node) -> float:
    value = node.number()
    if value <= 0:
        raise node.fail(
            f"found {value:g}, expected a number greater than zero, from the data sheet or the Allan deviation."
        )
    return value
