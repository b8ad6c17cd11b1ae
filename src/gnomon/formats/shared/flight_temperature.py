"""What the temperature changes, as PX4 and ArduPilot state it: read back from their parameters.

PX4 takes X0 + X1 d + X2 d^2 + X3 d^3 off its samples, d = T - TREF; ArduPilot p(T) - p(CALTEMP), with
p(T) = 1e-6 (c1 e + c2 e^2 + c3 e^3) and e = T - 35 degC; both with T no farther than TMIN and TMAX.
"""

from collections.abc import Mapping

import numpy as np
from numpy.polynomial import Polynomial

from ...frozen import value_class
from ...recording import Floats
from ...results.temperature_dependence import TemperatureDependence

ARDUPILOT_REFERENCE_DEGC = 35.0
_TRIADS = {"accelerometer": ("A", "ACC"), "gyroscope": ("G", "GYR")}
_PX4_RANGE, _ARDUPILOT_RANGE = (0.0, 100.0), (0.0, 70.0)
"""Where the parameters state none: the programs' defaults [degC]."""


@value_class
class FlightTemperature:
    """What is taken off the samples of an IMU.

    Attributes
    ----------
    found : the biases over the temperature
    at_reference : triad -> what is taken off at the reference, (3,) [m/s^2, rad/s]
    """

    found: TemperatureDependence
    at_reference: Mapping[str, Floats]


def flight_temperature(parameters: Mapping[str, float], index: int) -> FlightTemperature | None:
    """Return what the temperature changes of one IMU; None where it is not stated, or not enabled.

    Parameters
    ----------
    parameters : of one of the programs
    index : of the IMU, from 0
    """
    taken: dict[str, tuple[float, list[Polynomial]]] = {}
    ranges: list[tuple[float, float]] = []
    for triad, (letter, word) in _TRIADS.items():
        px4, ardupilot = f"TC_{letter}{index}_", f"INS_TCAL{index + 1}_"
        if parameters.get(f"TC_{letter}_ENABLE") and f"{px4}X1_0" in parameters:
            reference = parameters.get(f"{px4}TREF", 25.0)
            rows = [[parameters.get(f"{px4}X{order}_{axis}", 0.0) for order in range(4)] for axis in range(3)]
            taken[triad] = reference, [Polynomial(row) for row in rows]
            ranges.append(_range(parameters, px4, _PX4_RANGE))
        elif parameters.get(f"{ardupilot}ENABLE") and f"{ardupilot}{word}1_X" in parameters:
            reference = parameters.get(f"INS_{word}{index + 1}_CALTEMP", ARDUPILOT_REFERENCE_DEGC)
            about = Polynomial([reference - ARDUPILOT_REFERENCE_DEGC, 1.0])
            polynomials = list[Polynomial]()
            for axis in "XYZ":
                row = [1e-6 * parameters.get(f"{ardupilot}{word}{order}_{axis}", 0.0) for order in (1, 2, 3)]
                moved = Polynomial([0.0, *row])(about)
                polynomials.append(moved - moved(0.0))
            taken[triad] = reference, polynomials
            ranges.append(_range(parameters, ardupilot, _ARDUPILOT_RANGE))
    if not taken:
        return None
    reference = next(iter(taken.values()))[0]
    at_reference: dict[str, Floats] = {}
    biases: dict[str, Floats] = {}
    for triad, (own, polynomials) in taken.items():
        rows = np.zeros((4, 3))
        for axis, polynomial in enumerate(polynomials):
            coefficients = np.asarray(polynomial(Polynomial([reference - own, 1.0])).coef)
            rows[: len(coefficients), axis] = coefficients
        at_reference[triad] = rows[0]
        if (order := int(np.flatnonzero(rows.any(axis=1)).max(initial=0))) > 0:
            biases[f"{triad}_bias"] = rows[1 : order + 1]
    low, high = max(one[0] for one in ranges), min(one[1] for one in ranges)
    return FlightTemperature(
        found=TemperatureDependence(reference_degc=reference, low_degc=low, high_degc=high, lag_s=0.0, **biases),
        at_reference=at_reference,
    )


def _range(parameters: Mapping[str, float], prefix: str, usual: tuple[float, float]) -> tuple[float, float]:
    return parameters.get(f"{prefix}TMIN", usual[0]), parameters.get(f"{prefix}TMAX", usual[1])
