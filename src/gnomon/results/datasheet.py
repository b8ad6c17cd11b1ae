"""Noise that was found against what a data sheet states.

Data sheets state the density of a one-sided spectrum, so that white noise of the density n has the standard deviation
n sqrt(bandwidth). The Allan deviation of the same noise is N / sqrt(tau) with N = n / sqrt(2), where N is the angle or
velocity random walk (IEEE 952). The data sheet of the ADIS16470 has both: 0.008 deg/s/sqrt(Hz) and 0.34 deg/sqrt(h).
"""

from collections.abc import Mapping
from math import isfinite, nan, pi, sqrt

from ..frozen import FrozenMapping, value_class
from .sensor_noise import DATASHEET_UNITS, FLOOR, SensorNoise, TriadNoise

QUANTITIES = {
    "noise_density": "noise density sqrt(2) N",
    "random_walk": "random walk N",
    "bias_stability": "bias stability 0.664 B",
}
"""What is compared, in the order of tables, and what it is called there."""


def sheet_units(sensor: str) -> Mapping[str, tuple[str, float]]:
    """Return the unit of each quantity of a sensor in data sheets, and how many of it are one in SI."""
    (density, walk), (floor,) = (DATASHEET_UNITS[sensor][name] for name in ("white_noise", "bias_instability"))
    return dict(zip(QUANTITIES, (density, walk, floor), strict=True))


@value_class
class StatedNoise:
    """What a data sheet states of a sensor, in SI units; nan where it does not.

    Attributes
    ----------
    noise_density : of the one-sided spectrum
    random_walk : angle or velocity random walk, N
    bias_stability : lowest Allan deviation
    bandwidth_hz : -3 dB bandwidth of the sensor [Hz]
    """

    noise_density: float = nan
    random_walk: float = nan
    bias_stability: float = nan
    bandwidth_hz: float = nan

    @property
    def white_noise(self) -> float:
        """N: the random walk where it is stated, else what follows from the density."""
        return self.random_walk if isfinite(self.random_walk) else self.noise_density / sqrt(2)


@value_class
class Datasheet:
    """The noise that a data sheet states.

    Attributes
    ----------
    name : of the sensor
    source : of the values
    sensors : "accelerometer", "gyroscope" -> what is stated, of those that there are
    """

    name: str
    source: str
    sensors: Mapping[str, StatedNoise]


@value_class
class DatasheetQuantity:
    """One quantity, in the unit of data sheets.

    Attributes
    ----------
    sensor, quantity, unit : what is compared
    found : root mean square of the axes; where no axis shows it, of their upper bounds
    bound : whether no axis shows it
    stated : by the data sheet
    expected : stated, with what aliases from a wider band
    """

    sensor: str
    quantity: str
    unit: str
    found: float
    bound: bool
    stated: float
    expected: float

    @property
    def label(self) -> str:
        """What it is called in tables."""
        return QUANTITIES[self.quantity]

    @property
    def ratio(self) -> float:
        """What was found over what was to be expected."""
        return self.found / self.expected


def aliasing_factor(bandwidth_hz: float, rate_hz: float) -> float:
    """Return by what factor sampling at a rate raises the density of white noise behind a filter of first order.

    What lies above half the rate is folded down; the noise bandwidth of the filter is pi / 2 times its -3 dB bandwidth.
    It is one where the filter ends below half the rate, or is not known (nan).
    """
    share = bandwidth_hz * pi / rate_hz  # of half the rate
    return sqrt(share) if share > 1 else 1.0


@value_class
class DatasheetComparison:
    """What was found against what a data sheet states.

    Attributes
    ----------
    sheet : the data sheet
    quantities : one by one
    aliased : sensor -> by what factor white noise is expected to be above what is stated
    unfiltered : sensor -> the same, had the whole bandwidth of the data sheet been sampled
    """

    sheet: Datasheet
    quantities: tuple[DatasheetQuantity, ...]
    aliased: Mapping[str, float]
    unfiltered: Mapping[str, float]

    def words(self) -> tuple[str, ...]:
        """Return in sentences what the bandwidth does to the densities."""
        said = [
            f"{sensor}: {factor:.2f} times the stated white noise is expected, as the band above half the rate aliases."
            for sensor, factor in self.aliased.items()
            if factor > _SHOWN
        ]
        return (*said, *(
            f"{sensor}: sampled without a decimation filter, its band of {self.sheet.sensors[sensor].bandwidth_hz:g} "
            f"Hz gives {factor:.2f} times the stated white noise; state --bandwidth-hz if so."
            for sensor, factor in self.unfiltered.items()
            if factor > _SHOWN and self.aliased[sensor] == 1
        ))  # fmt: skip


_SHOWN = 1.05


def compare_datasheet(noise: SensorNoise, sheet: Datasheet, bandwidth_hz: float = nan) -> DatasheetComparison:
    """Return what was found against what a data sheet states.

    Parameters
    ----------
    bandwidth_hz : of the low-pass filter before the samples were taken; nan where it ends below half their rate
    """
    rows: list[DatasheetQuantity] = []
    triads = {sensor: triad for sensor, triad in noise.triads.items() if sensor in sheet.sensors}
    aliased = {sensor: aliasing_factor(bandwidth_hz, triad.rate_hz) for sensor, triad in triads.items()}
    for sensor, triad in triads.items():
        stated, found = sheet.sensors[sensor], _found(triad)
        for quantity, (unit, factor) in sheet_units(sensor).items():
            value = factor * float(getattr(stated, quantity))
            if isfinite(value):
                measured, bound = found[quantity]
                rows.append(
                    DatasheetQuantity(
                        sensor=sensor,
                        quantity=quantity,
                        unit=unit,
                        found=factor * measured,
                        bound=bound,
                        stated=value,
                        expected=value * (1.0 if quantity == "bias_stability" else aliased[sensor]),
                    )
                )
    return DatasheetComparison(
        sheet=sheet,
        quantities=tuple(rows),
        aliased=FrozenMapping(aliased),
        unfiltered=FrozenMapping(
            {name: aliasing_factor(sheet.sensors[name].bandwidth_hz, triad.rate_hz) for name, triad in triads.items()}
        ),
    )


def _found(triad: TriadNoise) -> dict[str, tuple[float, bool]]:
    """Return each quantity of a sensor in SI units, and whether it is an upper bound."""
    biases = [axis.bias_instability for axis in triad.axes]
    shown = [one.value for one in biases if one.found]
    floor = FLOOR * sqrt(sum(b**2 for b in shown or (one.bound for one in biases)) / len(shown or biases))
    hidden = not any(axis.white_noise.found for axis in triad.axes)
    white = triad.noise_density
    return {
        "noise_density": (sqrt(2) * white, hidden),
        "random_walk": (white, hidden),
        "bias_stability": (floor, not shown),
    }
