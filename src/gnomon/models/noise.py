"""Noise of an inertial sensor, in the units and names of Kalibr's imu.yaml."""

from dataclasses import fields
from math import isfinite

from ..errors import OptionError
from ..frozen import value_class


@value_class(eq=True)
class ImuNoise:
    """Nominal noise of an IMU: white noise densities, and the random walks of both biases.

    A sample at `update_rate` Hz has a standard deviation of density * sqrt(update_rate); in a time t the bias walks by
    random_walk * sqrt(t).

    Attributes
    ----------
    accelerometer_noise_density : [m/s^2/sqrt(Hz)]
    accelerometer_random_walk : [m/s^3/sqrt(Hz)]
    gyroscope_noise_density : [rad/s/sqrt(Hz)]
    gyroscope_random_walk : [rad/s^2/sqrt(Hz)]

    Raises
    ------
    OptionError
        If a value is not a finite number above zero.
    """

    accelerometer_noise_density: float
    accelerometer_random_walk: float
    gyroscope_noise_density: float
    gyroscope_random_walk: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value > 0):
                raise OptionError(f"{field.name} {value:g} must be a finite number greater than zero.")


def consumer_mems() -> ImuNoise:
    """Return what is taken where no noise is stated; of the white noise only until the residuals tell it."""
    return ImuNoise(
        accelerometer_noise_density=4e-3,
        accelerometer_random_walk=1e-3,
        gyroscope_noise_density=2e-4,
        gyroscope_random_walk=4e-5,
    )
