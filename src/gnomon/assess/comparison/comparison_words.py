"""How the blocks of a comparison are called, and in which units people read them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import degrees

import numpy as np

from ...findings import Finding, join_names, make_finding
from ...models.frames import Origin
from ...recording import Floats
from ...results.calibration import Covariance
from ...results.moved import moved_to_origin
from ...results.sensors import element_names
from .candidates import ComparisonCandidate
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
    whose = "" if difference.mutual else f" of {join_names(difference.basis)} alone"
    return f"{difference.largest:.1f} sigma{whose}"


_SIGNIFICANT = 3.0  # sigmas
_CHIP_M = 0.01
_MATTERS_M = 1e-4
_OFF_P_STAR = 0.3
"""Share of a lever arm by which a model with one place may be off the p* of another recording or program,"""
_OFF_OWN = 0.01
"""and off that which its own estimate tells."""


def at_common_origins(candidates: Sequence[ComparisonCandidate]) -> list[ComparisonCandidate]:
    """Return the candidates, all in one body frame, with the origin of each IMU at one point as far as that is known.

    It is the p* of one with one place for all accelerometers, which cannot be moved; else of the first that states
    its own; else that of a motion alike about all axes.
    """
    origins = {name: _common(candidates, name) for one in candidates for name in one.imus}
    return [_at(one, origins) for one in candidates]


def _common(candidates: Sequence[ComparisonCandidate], imu: str) -> Origin:
    held = [one for one in candidates if imu in one.imus]
    weighed = sorted(
        (accelerometer_positions(one, imu) is not None, number)
        for number, one in enumerate(held)
        if (origin := one.imus[imu].origin) is not None and origin.weights is not None
    )
    if not weighed:
        return Origin(point="optimal")
    known = held[weighed[0][1]].imus[imu].origin
    assert known is not None
    return Origin(point="optimal", weights=known.weights)


def accelerometer_positions(one: ComparisonCandidate, imu: str) -> Floats | None:
    """Return where the accelerometers of an IMU sit, (3, 3) [m]; None where they are at one point."""
    sensor = one.imus[imu].accelerometer if imu in one.imus else None
    return None if sensor is None else sensor.lever_arms_m


def _at(one: ComparisonCandidate, origins: Mapping[str, Origin]) -> ComparisonCandidate:
    if all(accelerometer_positions(one, imu) is None for imu in one.imus):
        return one
    moved = moved_to_origin(one.imus, one.cameras, origins)
    covariance = one.covariance
    if covariance is not None:
        matrix = moved.jacobian @ covariance.matrix @ moved.jacobian.T
        covariance = Covariance(names=covariance.names, matrix=matrix)
    return replace(one, imus=moved.imus, cameras=moved.cameras, covariance=covariance)


def origin_findings(candidates: Sequence[ComparisonCandidate]) -> Iterator[Finding]:
    """Say whose translations are of points that are not quite the same, and by how much."""
    for imu in dict.fromkeys(name for one in candidates for name in one.imus):
        held = [one for one in candidates if imu in one.imus and (one.cameras or len(one.imus) > 1)]
        rest = [one for one in held if accelerometer_positions(one, imu) is None and not one.exact]
        having = {one.name: longest for one in held if (longest := _longest(one, imu)) > 0}
        if having and rest:
            most = max(having.values())
            share = _OFF_P_STAR if any(_weights(one, imu) is None for one in rest) else _OFF_OWN
            yield make_finding(
                "lever-arms-in-some",
                having=join_names(list(having)),
                imu=imu,
                rest=join_names([one.name for one in rest]),
                off_mm=1e3 * share * most,
            )
        for first, second in combinations(rest, 2):
            apart = _points_apart(first, second, imu)
            if apart > _MATTERS_M:
                yield make_finding("origins-differ", first=first.name, second=second.name, imu=imu, apart=apart)


def _longest(one: ComparisonCandidate, imu: str) -> float:
    """Return the longest lever arm that is there beyond its uncertainty [m]; zero where none is."""
    arms = accelerometer_positions(one, imu)
    if arms is None:
        return 0.0
    sigma = np.zeros(9)
    if one.covariance is not None:
        at = [one.covariance.names.index(name) for name in element_names(f"{imu}.accelerometer.lever_arms_m", (3, 3))]
        sigma = np.sqrt(np.diag(one.covariance.matrix)[at])
    proved = (np.abs(arms.ravel()) > _SIGNIFICANT * np.nan_to_num(sigma)).reshape(3, 3)
    return float(np.linalg.norm(arms * proved, axis=1).max())


def _points_apart(first: ComparisonCandidate, second: ComparisonCandidate, imu: str) -> float:
    """Return how far the points of two motions are apart, of accelerometers at random 10 mm from each other [m]."""
    weights = [_weights(one, imu) for one in (first, second)]
    if weights[0] is None or weights[1] is None:
        return 0.0
    return float(_CHIP_M * np.linalg.norm(weights[0] - weights[1]) / np.sqrt(3))


def _weights(one: ComparisonCandidate, imu: str) -> Floats | None:
    """Return what p* of an IMU is made of, where that is known."""
    origin = one.imus[imu].origin
    return None if origin is None else origin.weights
