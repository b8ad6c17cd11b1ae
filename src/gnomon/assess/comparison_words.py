"""How the blocks of a comparison are called, and in which units people read them."""

from collections.abc import Sequence
from math import degrees

import numpy as np

from ..recording import Floats
from .comparison import Difference, Repeatability

_DEG = degrees(1.0)
_NAMES = {
    "scale": "scale",
    "misalignment": "misalignment",
    "bias": "bias",
    "g_sensitivity": "g-sensitivity",
    "translation": "translation",
    "rotation": "rotation",
    "time_shift": "time shift",
    "line_delay": "line delay",
    "lens": "lens",
    "lever_arms": "lever arms",
}
_SHOWN = {
    "rotation": (_DEG, "deg"),
    "translation": (1e3, "mm"),
    "lever arms": (1e3, "mm"),
    "time shift": (1e3, "ms"),
    "line delay": (1e6, "us"),
    "misalignment": (1e3, "mrad"),
}
_PIXELS = frozenset({"fu", "fv", "pu", "pv"})
_TRIADS = ("accelerometer", "gyroscope", "magnetometer")
_VECTORS = ("rotation", "translation")


def block_words(path: str) -> str:
    """Return what a block is called in a sentence.

    Examples
    --------
    >>> block_words("cam0.time_shift"), block_words("imu0.gyroscope.rotation"), block_words("imu1.gyroscope.bias")
    ('time shift of cam0', 'rotation from body to gyroscope', 'bias of the gyroscope of imu1')
    >>> block_words("cam1.cam0.rotation")
    'rotation of cam1 against cam0'
    """
    sensor, *middle, name = path.split(".")
    if middle and middle[0] not in _TRIADS:
        return f"{_NAMES.get(name, name)} of {sensor} against {middle[0]}"
    of_imu = "" if sensor == "imu0" else f" of {sensor}"
    if not middle:
        return f"{_NAMES.get(name, name)} of {sensor}"
    if name == "rotation":
        return f"rotation from body to {middle[0]}{of_imu}"
    return f"{_NAMES.get(name, name)} of the {middle[0]}{of_imu}"


def shown_unit(kind: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a block is shown."""
    if kind in _SHOWN:
        return _SHOWN[kind]
    if kind == "scale":
        return (100.0, "%") if unit == "1" else (1.0, unit)
    if kind == "g-sensitivity" and unit.startswith("(rad/s)"):
        return 1e3, "mrad/s/(m/s^2)"
    if kind == "bias" and unit == "rad/s":
        return _DEG, "deg/s"
    return 1.0, unit


def typical_size(block: Repeatability, values: Floats) -> tuple[float, str]:
    """Return the root mean square of a block's scalars, nan where none is known, and its unit; of a lens those in px.

    Parameters
    ----------
    values : (k,) in the block's unit
    """
    factor, unit = shown_unit(block.kind, block.unit)
    if block.kind == "lens":
        values, unit = values[[element in _PIXELS for element in block.elements]], "px"
    known = values[np.isfinite(values)]
    return (factor * float(np.sqrt(np.mean(known**2))) if known.size else np.nan), unit


def size_text(block: Repeatability, values: Floats, z: Floats) -> str:
    """Return how large a difference is: of a vector its length, else that of the scalar that differs most.

    Parameters
    ----------
    values : (k,) difference in the block's unit
    z : (k,) in sigmas; nan where not known
    """
    factor, unit = shown_unit(block.kind, block.unit)
    if block.kind in _VECTORS:
        return f"{np.linalg.norm(values) * factor:.2g} {unit}"
    size = np.where(np.isfinite(z), np.abs(z), 0.0) if np.isfinite(z).any() else np.abs(values)
    k = int(np.argmax(size))
    element = block.elements[k]
    where = f" ({element})" if element else ""
    if block.kind == "lens" and element in _PIXELS:
        unit = "px"
    return f"{abs(float(values[k])) * factor:.2g} {unit}".rstrip() + where


def sigma_text(difference: Difference) -> str:
    """Return how many sigmas a difference is at most, and whose; "" where none are known."""
    if not np.isfinite(difference.largest):
        return ""
    whose = "" if difference.mutual else f" of {listed(difference.basis)} alone"
    return f"{difference.largest:.1f} sigma{whose}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a list in a sentence.

    Examples
    --------
    >>> listed(["A", "B", "C"])
    'A, B and C'
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"
