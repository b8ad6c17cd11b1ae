"""How an IMU changes with its temperature, and how that was found."""

from typing import Self

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from .calibration import Calibration
from .result import Plotted

_CURVE = 60


@value_class
class AxisOverTemperature:
    """One axis over the temperature.

    Attributes
    ----------
    degc : (n,) temperature of each bin [degC]
    values : (n,) its mean, the bias of its switching-on taken off [SI]
    warm_up : (n,) number of its recording
    at_degc : (k,) evenly over the range [degC]
    change, sigma : (k,) of the bias from that at the reference, and its standard deviation [SI]
    """

    degc: Floats
    values: Floats
    warm_up: Floats
    at_degc: Floats
    change: Floats
    sigma: Floats

    @classmethod
    def from_polynomial(
        cls, coefficients: Floats, covariance: Floats, *, reference_degc: float, span_degc: tuple[float, float],
        degc: Floats, values: Floats, warm_up: Floats,
    ) -> Self:  # fmt: skip
        """Return what was seen, and the curve of a polynomial over a range.

        Parameters
        ----------
        coefficients, covariance : of the powers 1 to order of the temperature above the reference [SI per K^j]
        """
        at = np.linspace(*span_degc, _CURVE)
        powers = np.vander(at - reference_degc, len(coefficients) + 1, increasing=True)[:, 1:]
        return cls(
            degc=degc,
            values=values,
            warm_up=warm_up,
            at_degc=at,
            change=powers @ coefficients,
            sigma=np.sqrt(np.einsum("ij,jk,ik->i", powers, covariance, powers)),
        )


@value_class
class TriadOverTemperature:
    """One triad over the temperature.

    Attributes
    ----------
    order : of its polynomials; 0 where it does not change
    axes : x, y, z
    turn_on : (3,) standard deviation of the bias from one switching-on to the next [SI]; nan of a single recording
    walk : (3,) random walk beside the temperature [SI/sqrt(s)]
    branches : (3,) by how much more it reads while the temperature rises than while it falls [SI]; nan where only one
        was seen
    branches_sigma : (3,)
    left_out_z : (w, 3) how far each recording lies off what the others foretell, in sigmas; nan of a single one
    """

    order: int
    axes: tuple[AxisOverTemperature, ...]
    turn_on: Floats
    walk: Floats
    branches: Floats
    branches_sigma: Floats
    left_out_z: Floats


@value_class
class TemperatureResult(Plotted):
    """A calibration that knows the temperature, and how it came about.

    Attributes
    ----------
    calibration : with the temperature dependence of its IMU
    triads : biases of "gyroscope" and "accelerometer", as recorded
    sensitivities : their scales, relative; empty where the sensor was not turned
    lag_s, lag_sigma_s : of the thermometer
    step_k : of its readings [K]
    low_degc, high_degc : temperatures that were seen, the lag undone [degC]
    supported_order : highest order that this range supports
    stirred : share of the time that was left out, as something moved
    names : of the recordings
    nominal : whether sensitivities and biases are those of an ideal sensor, as no calibration was given
    """

    calibration: Calibration
    triads: dict[str, TriadOverTemperature]
    sensitivities: dict[str, TriadOverTemperature]
    lag_s: float
    lag_sigma_s: float
    step_k: float
    low_degc: float
    high_degc: float
    supported_order: int
    stirred: float
    names: tuple[str, ...]
    nominal: bool
