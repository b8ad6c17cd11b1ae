"""Recordings at rest -> means over bins, and the temperature of the chip in each."""

from collections.abc import Sequence

import numpy as np

from ...errors import RecordingError
from ...estimate.temperature.bias_drift import WarmUp
from ...frozen import value_class
from ...recording import Floats, ImuSamples, Integers, Recording, TriadSamples
from ...recording.thermometer import temperature_course

TRIADS = ("gyroscope", "accelerometer")
_BIN_S, _BINS = 5.0, (20, 90)
_STILL_RAD = np.radians(5.0)
_STIRRED = 9.0
"""Variance of a bin over the usual one, above which something moved."""
_MOST_STIRRED = 0.5


@value_class
class RestBins:
    """Means of one recording over bins: times [s], [ns], samples in each (n,), values (n, m) of `triads`."""

    triads: tuple[str, ...]
    t_s: Floats
    t_ns: Integers
    samples: Floats
    values: Floats
    stirred: float


@value_class
class RestRecordings:
    """The recordings, and their bins."""

    samples: Sequence[ImuSamples]
    bins: Sequence[RestBins]

    def warm_ups(self, lag_s: float) -> list[WarmUp]:
        """Return the warm-ups with the temperatures that a lag of the thermometer leaves."""
        return [_warm_up(one, bins, lag_s) for one, bins in zip(self.samples, self.bins, strict=True)]


def sensor_at_rest(name: str, recording: Recording) -> ImuSamples:
    """Return the IMU of a recording, which has to have a thermometer.

    Raises
    ------
    RecordingError
        If it has none, or nobody knows its unit.
    """
    if not recording.imus:
        raise RecordingError(f"{name}: there is no IMU in it. Give a recording of its samples and its temperature.")
    imu = next(iter(recording.imus.values()))
    if imu.temperature is None or temperature_course(imu.temperature) is None:
        raise RecordingError(
            f"{name}: it tells no temperature. Record the chip's thermometer in a column such as temp_degC; `gnomon "
            "check` says what is read."
        )
    if not any(len(getattr(imu, triad)) for triad in TRIADS):
        raise RecordingError(f"{name}: there are no samples of a gyroscope or an accelerometer in it.")
    return imu


def average_at_rest(name: str, imu: ImuSamples) -> RestBins:
    """Return means over bins of some seconds; those in which something moved are left out.

    Raises
    ------
    RecordingError
        If the sensor was not at rest.
    """
    triads = tuple(triad for triad in TRIADS if len(getattr(imu, triad)))
    streams: list[TriadSamples] = [getattr(imu, triad) for triad in triads]
    begin, end = max(int(one.t_ns[0]) for one in streams), min(int(one.t_ns[-1]) for one in streams)
    duration = (end - begin) * 1e-9
    if duration < _BINS[0] * _BIN_S:
        raise RecordingError(
            f"{name}: {max(duration, 0):.0f} s are too short for the temperature to tell. Record a whole warm-up, "
            "of ten minutes or more."
        )
    edges = np.linspace(begin, end, int(np.clip(duration / _BIN_S, *_BINS)) + 1).astype(np.int64)
    means, variances, counts = zip(*(_averaged(one, edges) for one in streams), strict=True)
    quiet = np.logical_and.reduce([
        (count > 1) & (variance <= _STIRRED * np.median(variance, axis=0)).all(axis=1)
        for variance, count in zip(variances, counts, strict=True)
    ])  # fmt: skip
    if np.mean(~quiet) > _MOST_STIRRED:
        raise RecordingError(f"{name}: the sensor was not at rest. Let it lie where nothing moves it.")
    if "accelerometer" in triads:
        _require_one_attitude(name, means[triads.index("accelerometer")][quiet], edges[:-1][quiet] - begin)
    middles = (edges[:-1] + edges[1:])[quiet] // 2
    return RestBins(
        triads=triads,
        t_s=np.asarray((middles - begin) * 1e-9, dtype=np.float64),
        t_ns=middles,
        samples=counts[0][quiet].astype(np.float64),
        values=np.column_stack([mean[quiet] for mean in means]),
        stirred=float(np.mean(~quiet)),
    )


def _averaged(stream: TriadSamples, edges: Integers) -> tuple[Floats, Floats, Integers]:
    """Return means, variances about a trend (n, 3) and numbers of samples (n,) between edges (n + 1,) [ns]."""
    of = np.searchsorted(edges, stream.t_ns, side="right") - 1
    inside = (of >= 0) & (of < len(edges) - 1)
    of, values = of[inside], stream.values[inside]
    n = len(edges) - 1
    count = np.bincount(of, minlength=n).astype(np.int64)
    divisor = np.maximum(count, 1)[:, None]
    mean = np.column_stack([np.bincount(of, column, minlength=n) for column in values.T]) / divisor
    off = values - mean[of]
    variance = np.column_stack([np.bincount(of, column**2, minlength=n) for column in off.T]) / divisor
    return mean, variance, count


def _require_one_attitude(name: str, means: Floats, since_ns: Integers) -> None:
    directions = means / np.linalg.norm(means, axis=1, keepdims=True)
    middle = np.median(directions, axis=0)
    angles = np.arccos(np.clip(directions @ (middle / np.linalg.norm(middle)), -1, 1))
    if (turned := np.flatnonzero(angles > _STILL_RAD)).size:
        raise RecordingError(
            f"{name}: the sensor is turned by {np.degrees(angles.max()):.0f} deg, such as "
            f"{since_ns[turned[0]] * 1e-9:.0f} s after the start. A warm-up is recorded at rest in one attitude; cut "
            "the rest away (--start-s, --stop-s)."
        )


def _warm_up(imu: ImuSamples, bins: RestBins, lag_s: float) -> WarmUp:
    assert imu.temperature is not None
    course = temperature_course(imu.temperature, lag_s)
    assert course is not None
    return WarmUp(
        t_s=bins.t_s,
        degc=course.at(bins.t_ns),
        step_k=float(np.nan_to_num(course.step_k)),
        samples=bins.samples,
        values=bins.values,
    )
