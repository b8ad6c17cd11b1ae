"""How the triads of an IMU change with the temperature of its chip."""

from collections.abc import Iterator

import numpy as np

from ..frozen import FrozenMapping, value_class
from ..recording import Floats, frozen_array


@value_class
class TemperatureDependence:
    """How the triads of an IMU change with the temperature of its chip.

    With d = T - reference_degc, and in sensor axes, a triad that reads y at the reference reads

        y(T) = bias + sum_j bias_j d^j + (1 + sum_j sensitivity_j d^j) (y - bias),    j = 1 to the order:

    the sensitivities are relative changes, which also the g-sensitivity of a gyroscope takes part in. Where that
    changes by itself, y of the gyroscope has sum_j g_sensitivity_j d^j (a - bias of a) in addition, with the reading a
    that the accelerometer would have at the reference. A part that does not change is None. Of the six numbers by which
    an accelerometer alone tells its sensitivity those of body frame accel-x change, at each temperature, and the
    gyroscope's are against that frame.

    Attributes
    ----------
    reference_degc : temperature at which the sensitivities and biases beside this hold [degC]
    low_degc, high_degc : range in which the polynomials hold [degC]; beyond it they are taken at the nearer end
    lag_s : by which the thermometer follows the sensor, x' = (T - x) / lag_s of its reading x [s]
    accelerometer_bias, gyroscope_bias : (order, 3) [unit/K^j]
    accelerometer_sensitivity, gyroscope_sensitivity : (order, 3, 3) [1/K^j]
    gyroscope_g_sensitivity : (order, 3, 3) [unit of the gyroscope per unit of the accelerometer and K^j]
    magnetometer_bias, magnetometer_sensitivity : (order, 3) [unit/K^j] and (order, 3, 3) [1/K^j]
    """

    reference_degc: float
    low_degc: float
    high_degc: float
    lag_s: float = 0.0
    accelerometer_bias: Floats | None = None
    gyroscope_bias: Floats | None = None
    accelerometer_sensitivity: Floats | None = None
    gyroscope_sensitivity: Floats | None = None
    gyroscope_g_sensitivity: Floats | None = None
    magnetometer_bias: Floats | None = None
    magnetometer_sensitivity: Floats | None = None

    def __post_init__(self) -> None:
        for name in TEMPERATURE_PARTS:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value))

    def parts(self) -> Iterator[tuple[str, Floats]]:
        """Yield the names and coefficients of what changes."""
        for name in TEMPERATURE_PARTS:
            if (value := getattr(self, name)) is not None:
                yield name, value

    def of(self, triad: str) -> bool:
        """Return whether anything of a triad changes."""
        return any(part.startswith(triad) for part, _ in self.parts())

    @property
    def changes(self) -> bool:
        """Whether anything changes at all."""
        return any(True for _ in self.parts())

    def change(self, part: str, degc: Floats) -> Floats:
        """Return by how much a part differs from that at the reference at temperatures (k,).

        Beyond the range it is that at the nearer end: polynomials run away there.

        Returns
        -------
        (k, 3) of a bias [its unit], (k, 3, 3) of a sensitivity, relative to it, or of the g-sensitivity
        """
        coefficients: Floats | None = getattr(self, part)
        if coefficients is None:
            return np.zeros((len(degc), *TEMPERATURE_PARTS[part]))
        known = np.clip(degc, self.low_degc, self.high_degc)
        powers = np.vander(known - self.reference_degc, len(coefficients) + 1, increasing=True)[:, 1:]
        return np.tensordot(powers, coefficients, axes=1)

    def to_reference(self, name: str, values: Floats, degc: Floats, bias: Floats) -> Floats:
        """Return what samples (n, 3) of a triad with such a bias (3,) would be at the reference temperature."""
        values = values - self.change(f"{name}_bias", degc)
        if getattr(self, f"{name}_sensitivity") is None:
            return values
        larger = np.eye(3) + self.change(f"{name}_sensitivity", degc)
        return bias + np.linalg.solve(larger, (values - bias)[:, :, None])[:, :, 0]

    def from_reference(self, name: str, values: Floats, degc: Floats, bias: Floats) -> Floats:
        """Return what samples (n, 3) that are right at the reference temperature would be at others (n,)."""
        relative = self.change(f"{name}_sensitivity", degc)
        more = np.einsum("nij,nj->ni", relative, values - bias)
        return values + more + self.change(f"{name}_bias", degc)


TEMPERATURE_PARTS = FrozenMapping(
    {
        "accelerometer_bias": (3,),
        "gyroscope_bias": (3,),
        "accelerometer_sensitivity": (3, 3),
        "gyroscope_sensitivity": (3, 3),
        "gyroscope_g_sensitivity": (3, 3),
        "magnetometer_bias": (3,),
        "magnetometer_sensitivity": (3, 3),
    }
)
"""What a temperature may change, in the order of the covariance, and the shape of one coefficient."""


HIGHEST_ORDER = 3
"""Of polynomials of the temperature."""
