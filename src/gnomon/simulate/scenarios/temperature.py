"""Options of simulated recordings of an IMU over its temperature."""

from dataclasses import dataclass

from ...errors import OptionError
from ...options import check_ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureScenario:
    """Recordings of one IMU over its temperature, each from one switching-on, with its thermometer."""

    recordings: int = 3
    """How many."""

    turned: bool = False
    """Turn it from rest to rest, at one temperature in each recording, from start to end, instead of warm-ups."""

    intervals: int = 30
    """Rests of a recording in which it is turned."""

    self_heating_k: float = 2.0
    """By which it warms up while it is turned, in K."""

    duration_s: float = 1200.0
    """Length of each warm-up in seconds."""

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

    sensitivity_order: int = 1
    """The same of sensitivities, which show where it is turned."""

    sensitivity: float = 1e-4
    """Usual size of their first coefficients, relative, in 1/K."""

    g_sensitivity: float = 0.0
    """The same of the gyroscope's g-sensitivity, to first order, in rad/s per m/s^2 and K; it is 300 times as large."""

    sensitivity_scatter: float = 1.5e-4
    """Scatter of scales, and of misalignments in rad, from one switching-on to the next, as of eight MPU-9150."""

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

    gyroscope_white_noise: float = 2e-4
    """Of warm-ups, in rad/s/sqrt(Hz)."""

    accelerometer_white_noise: float = 2e-3
    """The same in m/s^2/sqrt(Hz)."""

    gyroscope_bias_instability: float = 7e-5
    """Of warm-ups, in rad/s."""

    branches: float = 0.0
    """By how much more the gyroscope reads while the temperature rises than while it falls, in rad/s."""

    def __post_init__(self) -> None:
        positive = "recordings intervals duration_s rate_hz time_constant_s thermometer_rate_hz"
        check_ranges(
            self,
            positive=positive,
            not_negative="order sensitivity_order sensitivity g_sensitivity sensitivity_scatter self_heating_k lag_s "
            "step_k thermometer_noise gyroscope_turn_on accelerometer_turn_on gyroscope_white_noise "
            "accelerometer_white_noise gyroscope_bias_instability",
        )
        if max(self.order, self.sensitivity_order) > 3:
            raise OptionError(
                f"order {max(self.order, self.sensitivity_order)}: polynomials of order 0 to 3 are drawn."
            )
