"""The point of an IMU at which calibrations of it are compared: translations of different points are no disagreement.

Who knows where each accelerometer sits is moved to any point, with its covariance. Who takes all three to be at one
point cannot be moved: that stands for the p* of its own recording (`models.origin`), to which the others go.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..calibration import Covariance
from ..findings import Finding, make_finding
from ..models.origin import Origin
from ..parameters import element_names, moved_to_origin
from ..recording import Floats
from .candidates import Candidate
from .comparison_words import listed

_SIGNIFICANT = 3.0  # sigmas
_CHIP_M = 0.01
_MATTERS_M = 1e-4
_OFF_P_STAR = 0.3
"""Share of a lever arm by which a model with one place was seen to be off p*."""


def at_common_origins(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates, all in one body frame, with the origin of each IMU at one point as far as that is known.

    It is the p* of one with one place for all accelerometers, which cannot be moved; else of the first whose motion is
    known; else that of a motion alike about all axes.
    """
    origins = {name: _common(candidates, name) for one in candidates for name in one.imus}
    return [_at(one, origins) for one in candidates]


def _common(candidates: Sequence[Candidate], imu: str) -> Origin:
    held = [one for one in candidates if imu in one.imus]
    weighed = sorted(
        (arms_of(one, imu) is not None, number)
        for number, one in enumerate(held)
        if (origin := one.imus[imu].origin) is not None and origin.weights is not None
    )
    if not weighed:
        return Origin(point="optimal")
    known = held[weighed[0][1]].imus[imu].origin
    assert known is not None
    return Origin(point="optimal", weights=known.weights)


def arms_of(one: Candidate, imu: str) -> Floats | None:
    """Return where the accelerometers of an IMU sit, (3, 3) [m]; None where they are at one point."""
    sensor = one.imus[imu].accelerometer if imu in one.imus else None
    return None if sensor is None else sensor.lever_arms_m


def _at(one: Candidate, origins: Mapping[str, Origin]) -> Candidate:
    if all(arms_of(one, imu) is None for imu in one.imus):
        return one
    moved = moved_to_origin(one.imus, one.cameras, origins)
    covariance = one.covariance
    if covariance is not None:
        matrix = moved.jacobian @ covariance.matrix @ moved.jacobian.T
        covariance = Covariance(names=covariance.names, matrix=matrix)
    return replace(one, imus=moved.imus, cameras=moved.cameras, covariance=covariance)


def origin_findings(candidates: Sequence[Candidate]) -> Iterator[Finding]:
    """Say whose translations are of points that are not quite the same, and by how much."""
    for imu in dict.fromkeys(name for one in candidates for name in one.imus):
        held = [one for one in candidates if imu in one.imus and (one.cameras or len(one.imus) > 1)]
        rest = [one for one in held if arms_of(one, imu) is None and not one.exact]
        having = {one.name: longest for one in held if (longest := _longest(one, imu)) > 0}
        if having and rest:
            most = max(having.values())
            yield make_finding(
                "lever-arms-in-some",
                having=listed(list(having)),
                imu=imu,
                rest=listed([one.name for one in rest]),
                off_mm=1e3 * _OFF_P_STAR * most,
            )
        for first, second in combinations(rest, 2):
            apart = _points_apart(first, second, imu)
            if apart > _MATTERS_M:
                yield make_finding("origins-differ", first=first.name, second=second.name, imu=imu, apart=apart)


def _longest(one: Candidate, imu: str) -> float:
    """Return the longest lever arm that is there beyond its uncertainty [m]; zero where none is."""
    arms = arms_of(one, imu)
    if arms is None:
        return 0.0
    sigma = np.zeros(9)
    if one.covariance is not None:
        at = [one.covariance.names.index(name) for name in element_names(f"{imu}.accelerometer.lever_arms_m", (3, 3))]
        sigma = np.sqrt(np.diag(one.covariance.matrix)[at])
    proved = (np.abs(arms.ravel()) > _SIGNIFICANT * np.nan_to_num(sigma)).reshape(3, 3)
    return float(np.linalg.norm(arms * proved, axis=1).max())


def _points_apart(first: Candidate, second: Candidate, imu: str) -> float:
    """Return how far the points of two motions are apart, of accelerometers at random 10 mm from each other [m]."""
    origins = [one.imus[imu].origin for one in (first, second)]
    weights = [None if origin is None else origin.weights for origin in origins]
    if weights[0] is None or weights[1] is None:
        return 0.0
    return float(_CHIP_M * np.linalg.norm(weights[0] - weights[1]) / np.sqrt(3))
