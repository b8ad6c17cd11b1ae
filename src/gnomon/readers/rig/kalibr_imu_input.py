"""Kalibr's imu.yaml as input: noise, rate and topic of each IMU; flat, or keyed imu0, imu1, ... as Kalibr writes it."""

from dataclasses import dataclass
from os import PathLike

from ...models.noise import ImuNoise
from ...recording import Floats
from ..projects.foreign_yaml import read_foreign_yaml, rigid
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuInput:
    """What Kalibr's imu.yaml says of one IMU.

    Attributes
    ----------
    noise : densities and random walks
    update_rate_hz : sample rate [Hz], or None where it is not stated
    topic : ROS topic, or ""
    T_imu_body : (4, 4) of an IMU beside imu0, p_imu = T_imu_body @ p_imu0, where it is stated
    time_shift_s : t_imu0 = t_imu + time_shift_s, likewise [s]
    """

    noise: ImuNoise
    update_rate_hz: float | None
    topic: str
    T_imu_body: Floats | None = None
    time_shift_s: float | None = None


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
    return {name: _imu(node, said, is_body=number == 0) for number, (name, node) in enumerate(imus.items())}


def _imu(node: Node, notes: list[str], *, is_body: bool) -> ImuInput:
    keys = {child.key: child for child in node.entries()}
    noise = {name: _positive(required(keys, name, node, f"a number in {unit}")) for name, unit in _UNITS.items()}
    model = [key for key in keys if key in _MODEL]
    if model:
        notes.append(
            f"{file_name(node)}: the sensor model in it ({', '.join(model)}) was passed over; it is estimated anew."
        )
    if is_body and "time_offset" in keys and keys["time_offset"].number() != 0:
        passed_over([keys["time_offset"]], notes)
    placed = not is_body and "T_i_b" in keys
    passed_over((child for key, child in keys.items() if key not in _IGNORED), notes)
    rate = next((_positive(keys[name]) for name in _RATES if name in keys), None)
    topic = keys["rostopic"].text() if "rostopic" in keys else ""
    return ImuInput(
        noise=ImuNoise(**noise),
        update_rate_hz=rate,
        topic=topic,
        T_imu_body=rigid(keys["T_i_b"]) if placed else None,
        time_shift_s=keys["time_offset"].number() if placed and "time_offset" in keys else None,
    )


def _positive(node: Node) -> float:
    value = node.number()
    if value <= 0:
        raise node.fail(
            f"found {value:g}, expected a number greater than zero, from the data sheet or the Allan deviation."
        )
    return value
