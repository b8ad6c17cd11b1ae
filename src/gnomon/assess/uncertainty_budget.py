"""The uncertainty budget of a calibration: from which sources the standard uncertainty of each block comes.

After the Guide to the expression of uncertainty in measurement (JCGM 100:2008, sections 4.2, 4.3 and 5.1): a source is
of type A where it is found by the statistics of the recording, of type B where it was known otherwise; it contributes
u_i = |c_i| a_i / d_i, and the combined uncertainty is the root of the sum of the squares.
"""

from collections.abc import Iterator
from math import sqrt
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats
from ..results.calibration import Calibration
from ..results.sensors import element_units

COVERAGE_FACTOR = 2.0
"""Of the expanded uncertainty; about 95 %."""
_LEAST = 1e-12
"""Of the variance: a smaller share is the rounding of a difference."""
Kind = Literal["A", "B", "A, B"]


@value_class(eq=True)
class UncertaintySource:
    """One contribution to the uncertainty of a quantity.

    Attributes
    ----------
    name : such as "independent noise"
    kind : of its evaluation, by statistics of the recording (A) or not (B), or both together
    amount, unit : standard deviation of what is normal, half width of what is rectangular; and its unit
    distribution, divisor : by which the amount becomes a standard uncertainty
    sensitivity : change of the quantity by a unit of the source
    variance : that it contributes [unit of the quantity, squared]
    """

    name: str
    kind: Kind
    amount: float
    unit: str
    distribution: Literal["normal", "rectangular"]
    sensitivity: float
    variance: float

    @property
    def divisor(self) -> float:
        """Which turns the amount into a standard uncertainty."""
        return sqrt(3) if self.distribution == "rectangular" else 1.0


@value_class(eq=True)
class QuantityBudget:
    """The least certain scalar of a block of parameters, and the sources of its uncertainty.

    Attributes
    ----------
    name, unit : such as "imu0.accelerometer.sensitivity[2,2]"
    value, sigma : estimate, and its combined standard uncertainty
    sources : largest first
    """

    name: str
    unit: str
    value: float
    sigma: float
    sources: tuple[UncertaintySource, ...]

    @property
    def expanded(self) -> float:
        """The expanded uncertainty, U = 2 u."""
        return COVERAGE_FACTOR * self.sigma


def uncertainty_budget(calibration: Calibration) -> tuple[QuantityBudget, ...]:
    """Return the budget of each block that was estimated, by the scalar of it that is least certain.

    Of cameras with an IMU the uncertainties of gravity and of the detector are together with noise: its calibration
    does not keep them apart.
    """
    names, variance = calibration.uncertainty.names, np.diag(calibration.uncertainty.matrix)
    blocks: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        blocks.setdefault(name.partition("[")[0], []).append(index)
    found: list[QuantityBudget] = []
    for path, rows in blocks.items():
        place = int(np.argmax(variance[rows]))
        index = rows[place]
        if not variance[index] > 0:
            continue
        unit = element_units(calibration, path)[place]
        sources = sorted(_sources(calibration, index, unit), key=lambda source: -source.variance)
        value = float(np.ravel(calibration.parameter(path))[place])
        found.append(
            QuantityBudget(
                name=names[index], unit=unit, value=value, sigma=float(np.sqrt(variance[index])), sources=tuple(sources)
            )
        )
    return tuple(found)


def _sources(calibration: Calibration, index: int, unit: str) -> Iterator[UncertaintySource]:
    """Yield what contributes to the variance of a scalar."""
    rest = float(calibration.uncertainty.matrix[index, index])
    for source in () if calibration.cameras else _stated(calibration, index):
        if 0 < source.variance <= rest * (1 + _LEAST):
            rest = max(rest - source.variance, 0.0)
            yield source
    yield from (source for source in _of_the_recording(calibration, index, unit, rest) if source.variance > 0)


def _stated(calibration: Calibration, index: int) -> Iterator[UncertaintySource]:
    """Yield what was known beforehand, of an IMU alone: gravity; and the earth's rate where its direction was not."""
    gravity, name = calibration.gravity, calibration.uncertainty.names[index]
    variance = float(gravity_part(calibration)[index, index])
    path, _, element = name.partition("[")
    if variance > 0:
        yield UncertaintySource(
            name="gravity",
            kind="B",
            amount=gravity.sigma,
            unit="m/s^2",
            distribution="normal",
            sensitivity=-_scalar(calibration, path, element) / gravity.value,
            variance=variance,
        )
    if path.endswith(".g_sensitivity") and "latitude" not in calibration.provenance.options:
        # the vertical part of the earth's rate turns with the attitude as gravity does
        slope = _scalar(calibration, path.replace("g_sensitivity", "sensitivity"), element) / gravity.value
        yield UncertaintySource(
            name="rate of the earth",
            kind="B",
            amount=EARTH_RATE_RAD_S,
            unit="rad/s",
            distribution="rectangular",
            sensitivity=slope,
            variance=(slope * EARTH_RATE_RAD_S) ** 2 / 3,
        )


def _scalar(calibration: Calibration, path: str, element: str) -> float:
    entry = tuple(map(int, element.rstrip("]").split(",")))
    return float(calibration.parameter(path)[entry])


def _of_the_recording(calibration: Calibration, index: int, unit: str, rest: float) -> Iterator[UncertaintySource]:
    """Yield what is left of the variance: noise, errors that last, scatter between recordings, or a prior."""
    assessment, name = calibration.assessment, calibration.uncertainty.names[index]
    path, trust = name.partition("[")[0], assessment.trust

    def source(words: str, variance: float, kind: Kind = "A") -> UncertaintySource:
        sigma = sqrt(variance)
        return UncertaintySource(
            name=words, kind=kind, amount=sigma, unit=unit, distribution="normal", sensitivity=1.0, variance=variance
        )

    if {path, name} & set(assessment.held_by_prior):
        yield source("prior, not determined here", rest, "B")
    elif trust.covariance == "between-recordings":
        yield source(f"scatter between {trust.recordings} recordings", rest)
    else:
        ratio = trust.sigma_ratio.get(path, 1.0) if trust.covariance == "cluster-robust" else 1.0
        independent = rest / max(1.0, ratio) ** 2 if ratio > 0 else rest
        if calibration.imus and calibration.cameras:
            yield source("noise, gravity, detector", independent, "A, B")
        else:
            yield source("independent noise", independent)
        yield source("errors that last", rest - independent)


def gravity_part(calibration: Calibration) -> Floats:
    """Return the part of the covariance (n, n) that an error of gravity makes, of an IMU calibrated by it."""
    by_gravity = np.zeros(len(calibration.uncertainty.names))
    name = next(iter(calibration.imus))
    for i, scalar in enumerate(calibration.uncertainty.names):
        path, _, element = scalar.partition("[")
        if path in (f"{name}.accelerometer.sensitivity", f"{name}.gyroscope.g_sensitivity"):
            entry = tuple(map(int, element.rstrip("]").split(",")))
            by_gravity[i] = -calibration.parameter(path)[entry] / calibration.gravity.value
    return calibration.gravity.sigma**2 * np.outer(by_gravity, by_gravity)
