"""The temperature of an IMU while it is turned from rest to rest: what its biases do with it, where that can be told.

A bias that drifts with time looks like one that follows the temperature while that only rises, or only falls. The
temperature is therefore a candidate for what a bias follows (`estimate.multiposition.bias_changes`) where it did both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...estimate.multiposition.bias_functions import temperature_columns
from ...estimate.multiposition.fit import MultiPositionFit
from ...estimate.multiposition.problem import MultiPositionProblem
from ...frozen import value_class
from ...recording import Floats, Integers, TemperatureSamples
from ...recording.thermometer import known_readings, temperature_course
from ...results.temperature_dependence import TemperatureDependence

_BOTH_WAYS_K, _BOTH_WAYS_STEPS, _BOTH_WAYS_SHARE = 4.0, 4.0, 0.3
"""How far the temperature has to rise, and to fall: in kelvins, steps of the thermometer, and of its range."""

_ORDER_FROM_K, _STEPS = (4.0, 10.0, 20.0), 4.0
"""Range of temperature that order 1, 2, 3 needs: in kelvins, and in steps of the thermometer for each order."""

_SIGMAS = 4.0
"""From which on a lag is no chance."""


@value_class
class BiasPolynomials:
    """Biases that follow the temperature.

    Attributes
    ----------
    found : the dependence
    jacobian : (3 k, p) of its k rows of coefficients by the scaled parameters of the fit
    """

    found: TemperatureDependence
    jacobian: Floats


def rose_and_fell(samples: TemperatureSamples | None) -> bool:
    """Return whether a temperature rose and fell, both by enough."""
    read = None if samples is None else known_readings(samples)
    if samples is None or read is None or np.ptp(read[1]) < _BOTH_WAYS_K:
        return False
    course = temperature_course(samples)
    assert course is not None
    rise = np.max(course.degc - np.minimum.accumulate(course.degc))
    fall = np.max(np.maximum.accumulate(course.degc) - course.degc)
    steps = _BOTH_WAYS_STEPS * float(np.nan_to_num(course.step_k))
    least = max(_BOTH_WAYS_K, steps, _BOTH_WAYS_SHARE * float(np.ptp(course.degc)))
    return bool(min(rise, fall) >= least)


def supported_order(range_k: float, step_k: float) -> int:
    """Return the highest order that a range of temperatures supports, with a thermometer of such steps."""
    return sum(range_k >= max(least, _STEPS * order * step_k) for order, least in enumerate(_ORDER_FROM_K, 1))


def temperature_powers(degc: Floats, at_rest: Floats, step_k: float) -> Floats:
    """Return what a bias may follow: temperature above the mean at rest [K], rate [K/s], higher powers, both together.

    One power more than the range at rest supports: what is left of a curve would be in the other coefficients, and is
    so in their sigmas. Temperature times rate is what an error of the lag makes of a curve.

    Parameters
    ----------
    degc : (n, 2) temperature at samples [degC] and its rate [K/s]
    at_rest : (m,) the same temperature in each rest [degC]
    step_k : of the thermometer
    """
    d = degc[:, 0] - at_rest.mean()
    order = max(supported_order(float(np.ptp(at_rest)), float(np.nan_to_num(step_k))), 1)
    return np.column_stack([d, degc[:, 1], *(d**power for power in range(2, order + 2)), d * degc[:, 1]])


def bias_polynomials(
    fit: MultiPositionFit, problem: MultiPositionProblem, reference_degc: float, lag_s: float
) -> BiasPolynomials | None:
    """Return how the biases follow the temperature in a fit; None where they do not.

    The highest power is not stated: see `temperature_powers`.

    Parameters
    ----------
    reference_degc : from which the fit counts the temperature [degC]
    lag_s : of the thermometer, which is undone already [s]
    """
    columns = temperature_columns(fit.data)
    if fit.data.degc is None or not columns:
        return None
    low, high = (reference_degc + float(pick(fit.data.degc[0][:, 0])) for pick in (np.min, np.max))
    values: dict[str, Floats] = {}
    rows = list[Floats]()
    for triad in ("accelerometer", "gyroscope"):  # as the covariance lists them
        if triad in columns:
            spread = getattr(problem, triad).spread
            slopes, _, *curves, _, _ = columns[triad]
            values[f"{triad}_bias"] = np.array([spread * fit.state.theta[at] for at in (slopes, *curves)])
            for at in (slopes, *curves):
                rows.append(np.zeros((3, len(fit.free))))
                rows[-1][np.arange(3), at] = spread
    known = TemperatureDependence(
        reference_degc=reference_degc,
        low_degc=low,
        high_degc=high,
        lag_s=max(lag_s + _lag(fit, list(columns.values())), 0.0),
    )
    return BiasPolynomials(found=replace(known, **values), jacobian=np.concatenate(rows))


def _lag(fit: MultiPositionFit, columns: Sequence[Integers]) -> float:
    """Return the lag that is left [s], the rate's coefficients over the temperature's; 0 where it is chance."""
    at_slopes, at_rates = (np.concatenate([own[row] for own in columns]) for row in (0, 1))
    place = np.cumsum(fit.free) - 1
    slopes, rates = fit.state.theta[at_slopes], fit.state.theta[at_rates]
    variance = np.diag(fit.arrow.corner_covariance)[place[at_rates]]
    information = float(np.sum(slopes**2 / variance))
    lag = float(np.sum(slopes * rates / variance)) / max(information, 1e-300)
    return lag if abs(lag) > _SIGMAS / np.sqrt(max(information, 1e-300)) else 0.0
