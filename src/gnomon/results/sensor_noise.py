"""The noise of an inertial sensor, as a long recording at rest shows it: coefficients with their uncertainty, curves.

The Allan variance of the noise of one axis, over the averaging time tau (IEEE 952, Tedaldi, section 3.4.3):

    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2

so that the floor of the Allan deviation is 0.664 B. N is the density of the white noise, by the convention that white
noise sampled at a rate f has a standard deviation of N sqrt(f) a sample.
"""

from collections.abc import Mapping
from dataclasses import field
from math import degrees, log, nan, pi, sqrt
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..errors import OptionError
from ..findings import Finding
from ..frozen import FrozenMapping, value_class
from ..recording import Floats
from ..recording.dataframes import make_dataframe
from ..recording.samples import ImuNoise
from ..units import STANDARD_GRAVITY_M_S2
from .calibration import Provenance, Verdict
from .result import Plotted

if TYPE_CHECKING:
    from .sensor_diagnostics import SignalEnvelope

COEFFICIENTS = ("white_noise", "bias_instability", "random_walk", "quantisation", "rate_ramp")
"""Kinds of noise, in the order of files and tables."""

SYMBOLS = dict(zip(COEFFICIENTS, "NBKQR", strict=True))

UNITS: Mapping[str, Mapping[str, str]] = {
    "accelerometer": {
        "white_noise": "m/s^2/sqrt(Hz)",
        "bias_instability": "m/s^2",
        "random_walk": "m/s^3/sqrt(Hz)",
        "quantisation": "m/s",
        "rate_ramp": "m/s^3",
    },
    "gyroscope": {
        "white_noise": "rad/s/sqrt(Hz)",
        "bias_instability": "rad/s",
        "random_walk": "rad/s^2/sqrt(Hz)",
        "quantisation": "rad",
        "rate_ramp": "rad/s^2",
    },
}
"""Sensor -> coefficient -> unit."""

_DEG_PER_H, _SQRT_H = degrees(3600.0), 60.0
_UG_PER_M_S2 = 1e6 / STANDARD_GRAVITY_M_S2
DATASHEET_UNITS: Mapping[str, Mapping[str, tuple[tuple[str, float], ...]]] = {
    "accelerometer": {
        "white_noise": (("ug/sqrt(Hz)", _UG_PER_M_S2), ("m/s/sqrt(h)", _SQRT_H)),
        "bias_instability": (("ug", _UG_PER_M_S2),),
        "random_walk": (("ug/sqrt(h)", _UG_PER_M_S2 * _SQRT_H),),
    },
    "gyroscope": {
        "white_noise": (("deg/s/sqrt(Hz)", degrees(1.0)), ("deg/sqrt(h)", degrees(_SQRT_H))),
        "bias_instability": (("deg/h", _DEG_PER_H),),
        "random_walk": (("deg/h/sqrt(h)", _DEG_PER_H * _SQRT_H),),
    },
}
"""Sensor -> coefficient -> the units of data sheets, each with how many of it are one of `UNITS`.

deg/sqrt(h) is the angle random walk, m/s/sqrt(h) the velocity random walk: what white noise adds up to (IEEE 952). The
bias instability of data sheets is the floor of the Allan deviation, 0.664 B, or B; few say which.
"""

SENSOR_UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}

FLOOR = sqrt(2 * log(2) / pi)
"""Floor of the Allan deviation of 1/f noise, in units of B: 0.664."""


@value_class(eq=True)
class Coefficient:
    """A coefficient of the noise: an estimate, or an upper bound where the recording does not show this kind of noise.

    Attributes
    ----------
    value : the estimate; 0 where none was found
    sigma : its standard deviation; nan where none was found
    bound : what it is below (about 97 %) where none was found; nan else
    """

    value: float
    sigma: float = nan
    bound: float = nan

    @property
    def found(self) -> bool:
        """Whether the recording shows this kind of noise."""
        return self.value > 0

    @property
    def most(self) -> float:
        """The estimate, or the upper bound where there is none."""
        return self.value if self.found else self.bound

    def scaled(self, factor: float) -> Self:
        """Return it in another unit, of which so many are one."""
        return type(self)(value=factor * self.value, sigma=factor * self.sigma, bound=factor * self.bound)


@value_class(eq=True)
class AxisNoise:
    """The noise of one axis; the names are those of COEFFICIENTS.

    Attributes
    ----------
    fitted_from_s : shortest averaging time of the fit; shorter ones show a filter or vibration [s]
    misfit : by how much the Allan deviation of these kinds of noise misses the observed one, relative (1 sigma)
    """

    white_noise: Coefficient
    bias_instability: Coefficient
    random_walk: Coefficient
    quantisation: Coefficient
    rate_ramp: Coefficient
    fitted_from_s: float = 0.0
    misfit: float = 0.0

    def coefficients(self) -> dict[str, Coefficient]:
        """Return the coefficients by name."""
        return {name: getattr(self, name) for name in COEFFICIENTS}

    def parts(self, tau_s: Floats) -> dict[str, Floats]:
        """Return the Allan deviation (k,) that each kind of noise found makes alone, by name."""
        shapes = {
            "white_noise": 1 / np.sqrt(tau_s),
            "bias_instability": np.full(len(tau_s), FLOOR),
            "random_walk": np.sqrt(tau_s / 3),
            "quantisation": sqrt(3) / tau_s,
            "rate_ramp": tau_s / sqrt(2),
        }
        return {name: found.value * shapes[name] for name, found in self.coefficients().items() if found.found}

    def deviation(self, tau_s: Floats) -> Floats:
        """Return the Allan deviation (k,) of all kinds of noise found together."""
        squares = [part**2 for part in self.parts(tau_s).values()]
        return np.sqrt(np.sum(squares, axis=0)) if squares else np.zeros(len(tau_s))


@value_class(eq=True)
class TriadNoise:
    """The noise of an accelerometer or a gyroscope.

    Attributes
    ----------
    rate_hz : sample rate [Hz]
    samples : length of the recording
    tau_s : shortest and longest averaging time [s]
    axes : x, y, z
    """

    rate_hz: float
    samples: int
    tau_s: tuple[float, float]
    axes: tuple[AxisNoise, AxisNoise, AxisNoise]

    @property
    def duration_s(self) -> float:
        """Length of the recording [s]."""
        return self.samples / self.rate_hz

    @property
    def noise_density(self) -> float:
        """One white noise density for all three axes: the root of their mean square."""
        return _rms([axis.white_noise.most for axis in self.axes])

    @property
    def random_walk(self) -> float:
        """One random walk for all three axes: of those that show one, else of their upper bounds, as above."""
        found = [axis.random_walk.value for axis in self.axes if axis.random_walk.found]
        return _rms(found or [axis.random_walk.bound for axis in self.axes])

    @property
    def random_walk_found(self) -> bool:
        """Whether an axis shows a random walk."""
        return any(axis.random_walk.found for axis in self.axes)


def _rms(values: list[float]) -> float:
    return sqrt(sum(value**2 for value in values) / len(values))


@value_class(eq=True)
class SensorNoise:
    """The noise of an IMU, identified from a recording at rest.

    Attributes
    ----------
    accelerometer, gyroscope : their noise; None where there was no such sensor
    t_init_s : how long the gyroscope should rest at the start of a calibration by hand [s]; nan where not known
    verdict : pass, warn or fail
    findings : what was noticed, the worst first
    provenance : where it comes from
    """

    accelerometer: TriadNoise | None
    gyroscope: TriadNoise | None
    t_init_s: float
    verdict: Verdict
    findings: tuple[Finding, ...]
    provenance: Provenance

    @property
    def triads(self) -> dict[str, TriadNoise]:
        """Sensor -> its noise, of those that there are."""
        both = {"accelerometer": self.accelerometer, "gyroscope": self.gyroscope}
        return {name: triad for name, triad in both.items() if triad is not None}

    def imu_noise(self) -> ImuNoise:
        """Return what Kalibr's imu.yaml holds: one density and one random walk of each sensor.

        Raises
        ------
        OptionError
            If one of the sensors is missing.
        """
        if self.gyroscope is None or self.accelerometer is None:
            (there,) = self.triads
            raise OptionError(f"this is the noise of the {there} alone; that of both sensors is needed here.")
        return ImuNoise(
            accelerometer_noise_density=self.accelerometer.noise_density,
            accelerometer_random_walk=self.accelerometer.random_walk,
            gyroscope_noise_density=self.gyroscope.noise_density,
            gyroscope_random_walk=self.gyroscope.random_walk,
        )


@value_class
class AllanTable:
    """The overlapping Allan deviation of a triad.

    Attributes
    ----------
    tau_s : (k,) averaging times [s]
    deviation : (k, 3) [unit]
    lower, upper : (k, 3) confidence interval of 95 % [unit]
    fitted : (k, 3) deviation of the noise that was found [unit]
    """

    tau_s: Floats
    deviation: Floats
    lower: Floats
    upper: Floats
    fitted: Floats


@value_class
class NoiseResult(Plotted):
    """The noise of an IMU, and how it came about.

    Attributes
    ----------
    noise : the coefficients
    curves : "accelerometer", "gyroscope" -> Allan deviation
    signals : the same -> means of the samples over time
    topic : ROS topic for imu.yaml
    """

    noise: SensorNoise
    curves: Mapping[str, AllanTable]
    signals: "Mapping[str, SignalEnvelope]" = field(default_factory=dict[str, "SignalEnvelope"])
    topic: str = "/imu0"

    def __post_init__(self) -> None:
        object.__setattr__(self, "curves", FrozenMapping(self.curves))
        object.__setattr__(self, "signals", FrozenMapping(self.signals))

    def to_dataframe(self, triad: str = "gyroscope") -> Any:
        """Return the Allan deviation of a triad as a DataFrame of pandas or polars, a row for each averaging time.

        Parameters
        ----------
        triad : "accelerometer" or "gyroscope"

        Raises
        ------
        OptionError
            If there is no such triad, or neither is installed.
        """
        if triad not in self.curves:
            raise OptionError(f"there is no noise of {triad!r}; it must be one of {', '.join(self.curves)}.")
        curve = self.curves[triad]
        parts = {"": curve.deviation, " lower": curve.lower, " upper": curve.upper, " fitted": curve.fitted}
        axes = {f"{axis}{part}": values[:, i] for i, axis in enumerate("xyz") for part, values in parts.items()}
        return make_dataframe({"tau [s]": curve.tau_s, **axes})
