"""Samples of an IMU or of one triad, as recorded, with their timestamps, their unit and what is known of their noise.

Mean readings at rest stand for samples where only these were recorded.

Their arrays are read-only and finite, on clocks with gaps; the instants of sampling follow from the timestamps.

Medians, quantiles and distinct values of few numbers are found here: NumPy's own take ten times as long, and load
masked arrays.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import wraps
from itertools import compress
from math import isfinite
from typing import Any, Literal, TypeVar
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, RecordingError
from ..frozen import value_class
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT, TEMPERATURE_UNITS_DEGC
from .dataframes import make_dataframe


def median_of(values: ArrayLike, axis: int | None = None) -> Any:
    """Return the median of all values, or along an axis; nan where one of them is.

    Examples
    --------
    >>> float(median_of([3.0, 1.0, 2.0, 10.0]))
    2.5
    """
    ordered = np.sort(values, axis)  # nan comes last
    axis = axis or 0
    count = ordered.shape[axis]
    middle = 0.5 * ordered.take((count - 1) // 2, axis) + 0.5 * ordered.take(count // 2, axis)  # integers are large
    last = ordered.take(-1, axis)
    unknown = np.isnan(last)
    return np.where(unknown, last, middle) if np.ndim(last) else last if unknown else middle


def quantile_of(values: ArrayLike, levels: float | Sequence[float] | NDArray[Any], axis: int | None = None) -> Any:
    """Return quantiles of all values, or along the first axis, on the line between the two values beside them.

    Examples
    --------
    >>> quantile_of([3.0, 1.0, 2.0], [0.5, 0.75]).tolist()
    [2.0, 2.5]
    """
    assert axis in (None, 0)
    ordered = np.sort(values, axis)
    at = np.asarray(levels, dtype=np.float64) * (len(ordered) - 1)
    low = at.astype(np.int64)
    below, above = ordered[low], ordered[np.minimum(low + 1, len(ordered) - 1)]
    share = (at - low).reshape(at.shape + (1,) * (ordered.ndim - 1))
    step = above - below
    found = np.where(share < 0.5, below + step * share, above - step * (1 - share))  # as exact from either side
    return np.where(np.isnan(ordered[-1]), np.nan, found)


def distinct_values(values: ArrayLike) -> NDArray[Any]:
    """Return the different ones among some values, in order.

    Examples
    --------
    >>> distinct_values([2, 1, 2]).tolist()
    [1, 2]
    """
    ordered = np.sort(values, None)
    new = np.ones(len(ordered), dtype=bool)
    new[1:] = ordered[1:] != ordered[:-1]
    return ordered[new]


def close_gaps(stamps: Sequence[NDArray[np.int64]], longest_ns: int) -> list[NDArray[np.int64]]:
    """Return timestamps of one clock, which stands still wherever none of them came for longer than `longest_ns`.

    An even grid over what is returned has at most `longest_ns` over its step points for each timestamp. Where there is
    no such gap the timestamps are returned as they are.

    Parameters
    ----------
    stamps : of several sensors, each (n,) and not falling [ns]
    longest_ns : what remains of a gap [ns]

    Examples
    --------
    >>> close_gaps([np.array([0, 10, 9000, 9010])], 100)
    [array([  0,  10, 110, 120])]
    """
    alike = all(np.array_equal(stamps[0], others) for others in stamps[1:])
    every = stamps[0] if alike else np.sort(np.concatenate(stamps), kind="stable")  # np.unique of integers is slow
    surplus = np.maximum(np.diff(every) - longest_ns, 0)
    if not surplus.any():
        return list(stamps)
    taken = np.concatenate([[0], np.cumsum(surplus)])
    return [np.asarray(t_ns - taken[np.searchsorted(every, t_ns)], dtype=np.int64) for t_ns in stamps]


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_LONGEST_PAUSE_NS = 2_000_000_000  # between packets
_PACKET_FACTOR = 3.0  # a mean step this much longer than the median comes from packets, not from gaps


def frozen_array(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only C-ordered array; values are copied unless they already are one."""
    if isinstance(values, np.ndarray) and values.dtype == dtype and values.flags.c_contiguous:
        if not values.flags.writeable:
            return values
        array = values.copy()
    else:
        array = np.array(values, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def usual_step(steps: NDArray[Any], unit_ns: float = 1.0) -> float:
    """Return the usual one of steps between timestamps (n,): the median, or the mean where samples came in packets.

    Parameters
    ----------
    steps : [`unit_ns`]
    """
    step = float(median_of(steps))
    together = steps[steps < max(_LONGEST_PAUSE_NS / unit_ns, step)]  # what was cut out between poses is no pause
    mean = float(np.mean(together)) if len(together) else step
    return mean if mean > _PACKET_FACTOR * step else step


Known = TypeVar("Known")


def kept_with_array(function: Callable[[NDArray[Any]], Known]) -> Callable[[NDArray[Any]], Known]:
    """Keep what a function tells of an array that nobody can change for as long as that lives: many ask for it."""
    kept: dict[int, tuple[ref[NDArray[Any]], Known]] = {}

    @wraps(function)
    def once(array: NDArray[Any]) -> Known:
        key = id(array)
        if (known := kept.get(key)) is not None and known[0]() is array:
            return known[1]
        found = function(array)
        if not array.flags.writeable:
            kept[key] = (ref(array, lambda _: kept.pop(key, None)), found)
        return found

    return once


@kept_with_array
def usual_rate(t_ns: Integers) -> float:
    """Return the sample rate of timestamps (n,) [Hz], from `usual_step`; nan if unknown."""
    step = usual_step(np.diff(t_ns)) if len(t_ns) > 1 else 0.0
    return 1e9 / step if step > 0 else float("nan")


_LARGEST = 1e100  # squares and sums of samples stay finite; no sensor reads a number like that


def measurable_numbers(values: Floats) -> NDArray[np.bool_]:
    """Return which numbers a sensor can have read: not NaN, not infinite, not beyond all measure."""
    return np.abs(values) < _LARGEST


def ns_from_s(t_s: ArrayLike) -> Integers:
    """Return seconds (n,) as whole nanoseconds; a RecordingError where they are not finite or too large."""
    t = np.asarray(t_s, dtype=np.float64)
    if not np.isfinite(t).all():
        raise RecordingError(f"timestamp {int(np.argmin(np.isfinite(t)))} is not a finite number of seconds.")
    return np.rint(t * 1e9).astype(np.int64)


_STEP_SAMPLES = 65_536
_ARITHMETIC = 1e-13  # of the largest value; what a conversion of units leaves


@kept_with_array
def smallest_steps(values: Floats) -> Floats:
    """Return the smallest change from sample to sample of each axis of values (n, k); nan where it never changes."""
    columns = np.ascontiguousarray(values[:_STEP_SAMPLES].T)  # along which all is fast
    steps = np.abs(np.diff(columns))
    least = _ARITHMETIC * np.abs(columns).max(axis=1, initial=0.0)  # what a conversion of units may differ by
    found = np.where(steps > least[:, None], steps, np.inf).min(axis=1, initial=np.inf)
    return np.where(found < np.inf, found, np.nan)


def _freeze(samples: "TriadSamples | TemperatureSamples", expected: str, row: tuple[int, ...]) -> None:
    """Make timestamps (n,) and values (n, *row) read-only arrays, if they fit together."""
    t_ns, values = frozen_array(samples.t_ns, np.int64), frozen_array(samples.values)
    object.__setattr__(samples, "t_ns", t_ns)
    object.__setattr__(samples, "values", values)
    if t_ns.ndim != 1 or values.shape != t_ns.shape + row:
        raise RecordingError(f"{expected} with n timestamps; found values {values.shape} and timestamps {t_ns.shape}.")


@value_class
class TriadSamples:
    """Samples of one three-axis sensor.

    Attributes
    ----------
    t_ns : (n,) int64 [ns]
        Timestamps in any clock; not necessarily uniform.
    values : (n, 3) float64 [unit]
        x, y, z as recorded.
    unit : str
        "count", or a key of the tables in `gnomon.units`.

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    t_ns: Integers
    values: Floats
    unit: str

    def __post_init__(self) -> None:
        _freeze(self, "samples must be (n, 3)", (3,))

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def t_s(self) -> Floats:
        """Seconds since the first timestamp, (n,)."""
        return (self.t_ns - self.t_ns[0]) * 1e-9 if len(self) else np.empty(0)

    @property
    def rate_hz(self) -> float:
        """Sample rate [Hz]: by the median step, or the mean where samples were stamped in packets; nan if unknown."""
        return usual_rate(self.t_ns)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last timestamp [s]."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9 if len(self) else 0.0

    def to_dataframe(self) -> Any:
        """Return the samples as a DataFrame of pandas or polars: t_s, and x, y, z with their unit in the name.

        Raises
        ------
        OptionError
            If neither is installed.
        """
        axes = {f"{axis} [{self.unit}]": self.values[:, i] for i, axis in enumerate("xyz")}
        return make_dataframe({"t [s]": self.t_s, **axes})


@value_class
class TemperatureSamples:
    """Readings of the thermometer of an IMU.

    Attributes
    ----------
    t_ns : (n,) int64 [ns]
        In the clock of the triads.
    values : (n,) float64 [unit]
        As recorded.
    unit : str
        "degC", "K", "degF", "count", or the counts of a chip that is known, such as "MPU-6050 count".

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    t_ns: Integers
    values: Floats
    unit: str

    def __post_init__(self) -> None:
        _freeze(self, "temperatures must be (n,)", ())

    def __len__(self) -> int:
        return len(self.t_ns)

    def celsius(self) -> Floats | None:
        """Return the temperatures (n,) [degC]; None for counts, whose meaning the recording does not tell."""
        conversion = TEMPERATURE_UNITS_DEGC[self.unit]
        return None if conversion is None else conversion[0] * self.values + conversion[1]


_UNITS = {
    "accelerometer": ACCELEROMETER_UNITS_M_S2,
    "gyroscope": GYROSCOPE_UNITS_RAD_S,
    "magnetometer": (*MAGNETOMETER_UNITS_UT, "local field"),  # what is calibrated without its strength has that
}


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


@value_class
class ImuSamples:
    """The triads of one IMU; they may differ in rate and timestamps, but share one clock.

    Attributes
    ----------
    accelerometer, gyroscope : without samples where the recording has none
    magnetometer : None where the recording has none
    noise : what its data sheet or its Allan deviation says, where that was stated
    topic : ROS topic that Kalibr's files name, or ""
    temperature : of its thermometer; None where the recording has none
    T_imu_body : (4, 4) how it lies to the first IMU, p_imu = T_imu_body @ p_body, where stated; it is not needed
    time_shift_s : t_body = t_imu + time_shift_s, between timestamps [s], where stated; it is not needed

    Raises
    ------
    RecordingError
        If the unit of a triad is none of those in `gnomon.units`.
    """

    accelerometer: TriadSamples
    gyroscope: TriadSamples
    noise: ImuNoise | None = None
    topic: str = ""
    magnetometer: TriadSamples | None = None
    temperature: TemperatureSamples | None = None
    T_imu_body: Floats | None = None
    time_shift_s: float | None = None

    def __post_init__(self) -> None:
        for name, units in _UNITS.items():
            triad = getattr(self, name)
            if triad is not None and len(triad) and triad.unit not in units:
                raise RecordingError(f'the {name} has no unit "{triad.unit}"; known are {", ".join(units)}.')
        if self.T_imu_body is not None:
            object.__setattr__(self, "T_imu_body", frozen_array(self.T_imu_body))


Booleans = NDArray[np.bool_]


@value_class
class Poses:
    """Averages of an IMU at rest in several attitudes, one row a pose: a table that somebody made, or a file per pose.

    Attributes
    ----------
    name : (n,) what a person knows each pose by: a file, or the row of a table
    accelerometer : (n, 3) mean [accelerometer_unit]
    gyroscope : (n, 3) mean [gyroscope_unit], or None
    accelerometer_sigma, gyroscope_sigma : (n, 3) standard deviation of each mean [unit], or None where it is not known
    samples : (n,) samples in each mean; 0 where that is not known
    t_s : (n,) when [s], or None where it is not known
    specific_force : (n, 3) known specific force in the frame of the jig [m/s^2], or None (Angrisano, Eqs. 4 to 7)

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    name: tuple[str, ...]
    accelerometer: Floats
    accelerometer_unit: str
    gyroscope: Floats | None = None
    gyroscope_unit: str = "rad/s"
    accelerometer_sigma: Floats | None = None
    gyroscope_sigma: Floats | None = None
    samples: Integers | None = None
    t_s: Floats | None = None
    specific_force: Floats | None = None

    def __post_init__(self) -> None:
        n = len(self.name)
        for field_name in ("accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma", "specific_force"):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values))
                if np.shape(values) != (n, 3):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n}, 3); found {np.shape(values)}.")
        for field_name, dtype in (("samples", np.int64), ("t_s", np.float64)):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values, dtype))
                if np.shape(values) != (n,):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n},); found {np.shape(values)}.")

    def __len__(self) -> int:
        return len(self.name)

    def where(self, kept: Booleans) -> "Poses":
        """Return some of the poses."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        chosen = {name: value[kept] for name, value in values.items() if isinstance(value, np.ndarray)}
        return replace(self, name=tuple(compress(self.name, kept)), **chosen)


_PACKETS = 0.3  # share of samples that are stamped together with the one before
_PACKET_S = 0.5
_FAR_BETTER = 0.7


@value_class
class TimeBase:
    """Instants at which the samples were taken.

    Attributes
    ----------
    t_s : (n,) [s since `origin_ns`]
    uniform : whether they lie on a straight line through the timestamps
    jitter_s : rms distance of the timestamps from that line [s]; nan where there is none
    missing : samples that the timestamps leave room for, and a line that was asked for does not
    """

    t_s: Floats
    uniform: bool
    jitter_s: float
    missing: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array(self.t_s))


def _near_a_line(stamps: Floats) -> bool:
    """Return whether timestamps of packets lie near a straight line over the sample's number: nothing is missing."""
    number = np.arange(len(stamps), dtype=np.float64)
    slope, start = np.polyfit(number, stamps, 1)
    return bool(np.abs(stamps - start - slope * number).max() < _PACKET_S)


def time_base(samples: TriadSamples, origin_ns: int, choice: Literal["auto", "stamps", "uniform"] = "auto") -> TimeBase:
    """Return the instants of sampling.

    A sensor samples by its own clock; timestamps are often rounded or delayed on their way. The hypothesis of a uniform
    clock is tested: every timestamp must lie within half a period of a straight line over the sample's number, counted
    with missing samples. If it holds the line is the better clock, otherwise the timestamps are all there is. Where
    samples were stamped in packets, as they came over a wire, the line over all of them is the clock while no packet is
    far from it.

    Parameters
    ----------
    samples : timestamps, not falling
    origin_ns : where the seconds start [ns]
    choice : force the timestamps or the line
    """
    stamps = np.asarray((samples.t_ns - origin_ns) * 1e-9, dtype=np.float64)
    if choice == "stamps" or len(stamps) < 3:
        return TimeBase(t_s=stamps, uniform=False, jitter_s=float("nan"))
    steps = np.diff(stamps)
    period = 1 / samples.rate_hz
    together = steps < 0.5 * period
    if choice == "auto" and np.mean(together) > _PACKETS:
        choice = "uniform" if _near_a_line(stamps) else "stamps"
        if choice == "stamps":
            return TimeBase(t_s=stamps, uniform=False, jitter_s=float("nan"))
    number = np.zeros(len(stamps))
    np.cumsum(np.rint(steps / period), out=number[1:])
    counted = number
    if choice == "uniform":
        number = np.arange(len(stamps), dtype=np.float64)
    slope, line = _line(number, stamps)
    jitter = float(np.sqrt(np.mean((stamps - line) ** 2)))
    holds = slope > 0 and bool(np.all(np.diff(number) >= 1)) and float(np.abs(stamps - line).max()) < 0.5 * slope
    if choice == "uniform":
        return TimeBase(t_s=line, uniform=True, jitter_s=jitter, missing=_missing(counted, stamps, jitter))
    if holds:
        return TimeBase(t_s=line, uniform=True, jitter_s=jitter)
    return TimeBase(t_s=stamps, uniform=False, jitter_s=jitter)


def _line(number: Floats, stamps: Floats) -> tuple[float, Floats]:
    """Return slope [s] and values (n,) [s] of the straight line through timestamps (n,) [s] over numbers (n,)."""
    mean_number, mean_stamp = number.mean(), stamps.mean()
    spread = float((number - mean_number) @ (number - mean_number))
    slope = float((number - mean_number) @ (stamps - mean_stamp)) / spread if spread > 0 else 0.0
    return slope, mean_stamp + slope * (number - mean_number)


def _missing(number: Floats, stamps: Floats, jitter_s: float) -> int:
    """Return how many samples are missing, where the numbers with missing ones explain the timestamps better."""
    missing = int(number[-1]) - (len(number) - 1)
    _, line = _line(number, stamps)
    better = float(np.sqrt(np.mean((stamps - line) ** 2))) < _FAR_BETTER * jitter_s
    return missing if missing > 0 and better else 0
