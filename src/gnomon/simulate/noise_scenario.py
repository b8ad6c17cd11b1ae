"""What noise to simulate; `gnomon simulate-noise` is made from this class."""

from dataclasses import dataclass

from ..errors import OptionError
from ..ranges import check_ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseScenario:
    """A long recording of an IMU at rest, with noise of known coefficients, the same in all axes."""

    duration_s: float = 10_800.0
    """Length in seconds."""

    rate_hz: float = 100.0
    """Sample rate."""

    accelerometer_white_noise: float = 2e-3
    """N in m/s^2/sqrt(Hz)."""

    accelerometer_bias_instability: float = 7e-4
    """B in m/s^2; the floor of the Allan deviation is 0.664 B."""

    accelerometer_random_walk: float = 8e-5
    """K in m/s^3/sqrt(Hz)."""

    accelerometer_quantisation: float = 0.0
    """Q in m/s."""

    accelerometer_rate_ramp: float = 0.0
    """R in m/s^3."""

    gyroscope_white_noise: float = 2e-4
    """N in rad/s/sqrt(Hz)."""

    gyroscope_bias_instability: float = 7e-5
    """B in rad/s; the floor of the Allan deviation is 0.664 B."""

    gyroscope_random_walk: float = 8e-6
    """K in rad/s^2/sqrt(Hz)."""

    gyroscope_quantisation: float = 0.0
    """Q in rad."""

    gyroscope_rate_ramp: float = 0.0
    """R in rad/s^2."""

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in self.__slots__:
            value = getattr(self, name)
            if name in {"duration_s", "rate_hz"} and not 0 < value < float("inf"):
                raise OptionError(f"{name} {value:g} must be greater than zero.")
            if not 0 <= value < float("inf"):
                raise OptionError(f"{name} {value:g} must not be below zero.")
        if self.samples < 2:
            raise OptionError(f"duration_s {self.duration_s:g} at {self.rate_hz:g} Hz makes no two samples.")

    @property
    def samples(self) -> int:
        """Length in samples."""
        return round(self.duration_s * self.rate_hz)

    def of(self, sensor: str) -> dict[str, float]:
        """Return the coefficients of the "accelerometer" or the "gyroscope" by name."""
        names = ("white_noise", "bias_instability", "random_walk", "quantisation", "rate_ramp")
        return {name: getattr(self, f"{sensor}_{name}") for name in names}
