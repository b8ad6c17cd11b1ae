"""Options of simulated warm-ups of an IMU at rest."""

from dataclasses import dataclass

from ..errors import OptionError
from ..options import check_ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureScenario:
    """Warm-ups of one IMU at rest, each from one switching-on, with its thermometer."""

    recordings: int = 3
    """Number of warm-ups."""

    duration_s: float = 1200.0
    """Length of each in seconds."""

    rate_hz: float = 50.0
    """Sample rate."""

    start_degc: float = 0.0
    """Temperature at the start, as from a freezer; another by about 1 degC each time."""

    end_degc: float = 45.0
    """Temperature that it approaches."""

    time_constant_s: float = 250.0
    """Of the approach, in seconds."""

    back: bool = False
    """Cool down to the start again in the second half."""

    order: int = 2
    """Order of the polynomials of the biases, 0 to 3; their coefficients are drawn."""

    lag_s: float = 0.0
    """By which the thermometer follows the sensor, in seconds."""

    step_k: float = 0.1
    """Steps of the thermometer."""

    thermometer_noise: float = 0.02
    """Of each reading, in K."""

    thermometer_rate_hz: float = 50.0
    """Readings of the thermometer a second."""

    gyroscope_turn_on: float = 1e-3
    """Scatter of the bias from one switching-on to the next, in rad/s."""

    accelerometer_turn_on: float = 5e-3
    """The same in m/s^2."""

    branches: float = 0.0
    """By how much more the gyroscope reads while the temperature rises than while it falls, in rad/s."""

    def __post_init__(self) -> None:
        positive = "recordings duration_s rate_hz time_constant_s thermometer_rate_hz"
        check_ranges(
            self,
            positive=positive,
            not_negative="order lag_s step_k thermometer_noise gyroscope_turn_on accelerometer_turn_on",
        )
        if self.order > 3:
            raise OptionError(f"order {self.order}: polynomials of order 0 to 3 are drawn.")
