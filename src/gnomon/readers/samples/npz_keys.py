"""NPZ files of others: arrays are known by a sensor in their name, as the columns of a table are.

"acc_g", "gyro_dps" and "mag_gauss" are a sensor and its unit; the stamps of such an array are "t_" with its own name,
"t_" with that of the sensor, or one array for all ("t", "time", "timestamps", ...).
"""

from collections.abc import Collection
from dataclasses import dataclass

from .column_names import column_name

_STAMPS = ("t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "ts")
_PREFIXES = ("t", "time", "timestamp", "ts")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorArray:
    """One array of samples: its key, its unit where the name tells it, and the key of its stamps, or None."""

    key: str
    unit: str | None
    stamps: str | None


def sensor_arrays(keys: Collection[str]) -> dict[str, SensorArray]:
    """Return the sensors that the names of arrays tell, "accelerometer", "gyroscope", "magnetometer" -> array.

    A sensor that two arrays seem to be is none of them.

    Examples
    --------
    >>> sensor_arrays(["mag_gauss", "t_mag_gauss", "temp_c"])["magnetometer"]
    SensorArray(key='mag_gauss', unit='gauss', stamps='t_mag_gauss')
    """
    found: dict[str, list[SensorArray]] = {}
    for key in keys:
        if key.split("_", 1)[0].lower() in _STAMPS:
            continue
        head, _, tail = key.partition("_")
        name = column_name(f"{head}_x_{tail}")  # "acc_g" is named like its columns, "acc_x_g"
        if name.axis is not None and name.quantity in {"accelerometer", "gyroscope", "magnetometer"}:
            array = SensorArray(key=key, unit=name.unit, stamps=_stamps(key, head, keys))
            found.setdefault(name.quantity, []).append(array)
    return {quantity: arrays[0] for quantity, arrays in found.items() if len(arrays) == 1}


def _stamps(key: str, sensor: str, keys: Collection[str]) -> str | None:
    own = [f"{prefix}_{name}" for name in (key, sensor) for prefix in _PREFIXES]
    own += [f"{name}_{prefix}" for name in (key, sensor) for prefix in _PREFIXES]
    return next((name for name in (*own, *_STAMPS) if name in keys), None)
