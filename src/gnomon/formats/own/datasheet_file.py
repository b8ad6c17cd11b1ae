"""Data sheets of inertial sensors: those that gnomon knows, and files of the same form."""

from collections.abc import Mapping
from math import degrees
from pathlib import Path

from ...errors import OptionError
from ...results.datasheet import QUANTITIES, Datasheet, StatedNoise, sheet_units
from ...results.sensor_noise import SENSOR_UNITS
from ...units import STANDARD_GRAVITY_M_S2
from ..shared.structured import Node, read_yaml

_KNOWN = Path(__file__).with_name("datasheets.yaml")
_MG = 1e3 / STANDARD_GRAVITY_M_S2
_ALSO: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "accelerometer": {
        "noise_density": {"mg/sqrt(Hz)": _MG, "m/s^2/sqrt(Hz)": 1.0},
        "bias_stability": {"mg": _MG, "m/s^2": 1.0},
    },
    "gyroscope": {
        "noise_density": {"mdeg/s/sqrt(Hz)": degrees(1e3), "rad/s/sqrt(Hz)": 1.0},
        "bias_stability": {"deg/s": degrees(1.0), "rad/s": 1.0},
    },
}
"""Other units that data sheets use, and how many of them are one in SI."""


def load_datasheet(name: str) -> Datasheet:
    """Read what a data sheet states of the noise of a sensor.

    Parameters
    ----------
    name : of a sensor that gnomon knows, as "ADIS16470", or of a YAML file of the form of datasheets.yaml with one
        sensor

    Raises
    ------
    OptionError
        If there is neither such a sensor nor such a file, or the file has several sensors.
    FormatError
        If the file is not of that form; the message names the key.
    """
    known = list(read_yaml(_KNOWN).entries())
    entries = [node for node in known if _plain(node.key) == _plain(name)]
    if not entries:
        if not Path(name).is_file():
            raise OptionError(f"--datasheet {name}: neither a file nor one of {', '.join(n.key for n in known)}.")
        entries = list(read_yaml(name).entries())
    if len(entries) != 1:
        raise OptionError(f"--datasheet {name}: found {len(entries)} sensors, expected one.")
    return _read(entries[0])


def _plain(name: str) -> str:
    return name.replace("-", "").lower()


def _read(node: Node) -> Datasheet:
    keys = node.mapping(("source",), tuple(SENSOR_UNITS))
    sensors = {sensor: _stated(sensor, keys[sensor]) for sensor in SENSOR_UNITS if sensor in keys}
    return Datasheet(name=node.key, source=keys["source"].text(), sensors=sensors)


def _stated(sensor: str, node: Node) -> StatedNoise:
    keys = node.mapping(optional=(*QUANTITIES, "bandwidth"))
    values = {
        quantity: _quantity(keys[quantity], {unit: factor, **_ALSO[sensor].get(quantity, {})})
        for quantity, (unit, factor) in sheet_units(sensor).items()
        if quantity in keys
    }
    if "bandwidth" in keys:
        values["bandwidth_hz"] = _quantity(keys["bandwidth"], {"Hz": 1.0})
    return StatedNoise(**values)


def _quantity(node: Node, units: Mapping[str, float]) -> float:
    """Return a number with one of these units in SI."""
    number, _, unit = node.text().partition(" ")
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if unit.strip() not in units or not 0 < value < float("inf"):
        raise node.fail(f'found "{node.value}", expected a positive number with a unit: {" or ".join(units)}.')
    return value / units[unit.strip()]
