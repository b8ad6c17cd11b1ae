"""Recordings at rest -> means over bins, and the temperature of the chip in each."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...detect.samples.rest_watch import RestTable, RestWatch, find_stir
from ...errors import OptionError, RecordingError
from ...estimate.temperature.bias_drift import WarmUp
from ...frozen import value_class
from ...recording import Floats, ImuSamples, Integers, Recording
from ...recording.thermometer import known_readings, temperature_course
from ...results.calibration import (
    UNSTATED_GRAVITY,
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ...results.result import Booleans
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

TRIADS = ("gyroscope", "accelerometer")
_BIN_S, _BINS = 5.0, (20, 90)
_STILL_RAD = np.radians(5.0)
_MOST_STIRRED = 0.5
_TURNED_RAD, _TURNED = np.radians(30.0), 0.2
"""Angle from the usual attitude, and share of the time, from which on a sensor was turned from rest to rest."""


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


def sensor_with_thermometer(name: str, recording: Recording) -> ImuSamples:
    """Return the IMU of a recording, which has to have a thermometer.

    Raises
    ------
    RecordingError
        If it has none, or nobody knows its unit.
    """
    if not recording.imus:
        raise RecordingError(f"{name}: there is no IMU in it. Give a recording of its samples and its temperature.")
    imu = next(iter(recording.imus.values()))
    if imu.temperature is None or known_readings(imu.temperature) is None:
        raise RecordingError(
            f"{name}: it tells no temperature. Record the chip's thermometer in a column such as temp_degC; `gnomon "
            "check` says what is read."
        )
    if not any(len(getattr(imu, triad)) for triad in TRIADS):
        raise RecordingError(f"{name}: there are no samples of a gyroscope or an accelerometer in it.")
    return imu


def is_turned(imu: ImuSamples) -> bool:
    """Return whether a sensor was turned from rest to rest, so that its sensitivity shows."""
    if not len(imu.accelerometer):
        return False
    return float(np.mean(_angles(_table(imu, "accelerometer").mean) > _TURNED_RAD)) > _TURNED


def average_at_rest(name: str, imu: ImuSamples) -> RestBins:
    """Return means over bins of some seconds; those in which something moved are left out.

    Raises
    ------
    RecordingError
        If the sensor was not at rest.
    """
    triads = tuple(triad for triad in TRIADS if len(getattr(imu, triad)))
    begin = max(int(getattr(imu, triad).t_ns[0]) for triad in triads)
    duration = (min(int(getattr(imu, triad).t_ns[-1]) for triad in triads) - begin) * 1e-9
    if duration < _BINS[0] * _BIN_S:
        raise RecordingError(
            f"{name}: {max(duration, 0):.0f} s are too short for the temperature to tell. Record a whole warm-up, "
            "of ten minutes or more."
        )
    tables = [_table(imu, triad) for triad in triads]
    stirs = [find_stir(table).windows for table in tables]
    stirred = max(float(stir.mean()) for stir in stirs)
    if stirred > _MOST_STIRRED:
        raise RecordingError(f"{name}: the sensor was not at rest. Let it lie where nothing moves it.")
    # A slow sensor's windows of some samples are longer than a bin would be.
    bins = min(int(np.clip(duration / _BIN_S, *_BINS)), *(len(table.t_s) // 2 for table in tables))
    edges = np.linspace(0.0, duration, bins + 1)
    parts = [
        _averaged(table, stir, edges - (int(getattr(imu, triad).t_ns[0]) - begin) * 1e-9)
        for triad, table, stir in zip(triads, tables, stirs, strict=True)
    ]
    kept = np.logical_and.reduce([part.samples > 0 for part in parts])
    at_s = parts[0].t_s[kept] + (int(getattr(imu, triads[0]).t_ns[0]) - begin) * 1e-9
    if "accelerometer" in triads:
        _require_one_attitude(name, parts[triads.index("accelerometer")].mean[kept], at_s)
    return RestBins(
        triads=triads,
        t_s=at_s,
        t_ns=begin + np.rint(1e9 * at_s).astype(np.int64),
        samples=parts[0].samples[kept],
        values=np.column_stack([part.mean[kept] for part in parts]),
        stirred=stirred,
    )


def _table(imu: ImuSamples, triad: str) -> RestTable:
    watch = RestWatch()
    watch.add(getattr(imu, triad))
    return watch.table()


@value_class
class _Averaged:
    """Of bins: mean times of what is averaged [s], numbers of samples (n,), 0 where nothing is left, means (n, 3)."""

    t_s: Floats
    samples: Floats
    mean: Floats


def _averaged(table: RestTable, stirred: Booleans, edges_s: Floats) -> _Averaged:
    """Return means over the windows between edges (n + 1,) [s] in which nothing moved."""
    n = len(edges_s) - 1
    of = np.searchsorted(edges_s, table.t_s, side="right") - 1
    inside = (of >= 0) & (of < n) & ~stirred
    windows = np.bincount(of[inside], minlength=n)
    divisor = np.maximum(windows, 1)

    def mean(values: Floats) -> Floats:
        return np.bincount(of[inside], values[inside], minlength=n) / divisor

    return _Averaged(
        t_s=mean(table.t_s),
        samples=np.asarray(windows * (table.samples / max(len(table.t_s), 1)), dtype=np.float64),
        mean=np.column_stack([mean(column) for column in table.mean.T]),
    )


def _require_one_attitude(name: str, means: Floats, since_s: Floats) -> None:
    angles = _angles(means)
    if (turned := np.flatnonzero(angles > _STILL_RAD)).size:
        raise RecordingError(
            f"{name}: the sensor is turned by {np.degrees(angles.max()):.0f} deg, such as "
            f"{since_s[turned[0]]:.0f} s after the start. A warm-up is recorded at rest in one attitude; cut "
            "the rest away (--start-s, --stop-s). Recordings in which it is turned have to be three or more, each at a "
            "temperature of its own."
        )


def _angles(means: Floats) -> Floats:
    """Return how far means (n, 3) of an accelerometer point away from the usual direction (n,) [rad]."""
    directions = means / np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-300)
    middle = np.median(directions, axis=0)
    return np.asarray(np.arccos(np.clip(directions @ middle / max(float(np.linalg.norm(middle)), 1e-300), -1, 1)))


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


_NOMINAL_SCALE, _NOMINAL_BIAS_M_S2 = 0.03, 1.0
"""Standard deviations of a sensor as its data sheet has it, that nobody calibrated."""


def base_calibration(calibration: Calibration | None, imu: ImuSamples, name: str) -> tuple[Calibration, bool]:
    """Return the calibration whose sensor changes with the temperature, and whether it is the data sheet's.

    Raises
    ------
    OptionError
        If it is of other sensors, or in other units, or there is none for a sensor in counts; or it knows how its
        magnetometer changes, which would hold in another range.
    """
    triads = [triad for triad in TRIADS if len(getattr(imu, triad))]
    if calibration is None:
        return _ideal(imu, triads, name), True
    if len(calibration.imus) != 1:
        raise OptionError(
            f"the calibration holds {len(calibration.imus)} IMUs; a temperature is found of one. Give that of one IMU."
        )
    name_of, sensor = next(iter(calibration.imus.items()))
    if sensor.temperature is not None and sensor.temperature.of("magnetometer"):
        raise OptionError(
            f"the calibration knows what its magnetometer does from {sensor.temperature.low_degc:.0f} to "
            f"{sensor.temperature.high_degc:.0f} degC, which the recordings do not tell anew. Keep it as it is, and "
            "give the result of gnomon imu here."
        )
    for triad in triads:
        known, unit = getattr(sensor, triad), getattr(imu, triad).unit
        if known is not None and known.unit != unit:
            raise OptionError(
                f"the calibration's {triad} is in {known.unit}, that of {name} in {unit}. State the units (--units)."
            )
    return _without_temperature(calibration, name_of), False


def _without_temperature(calibration: Calibration, name: str) -> Calibration:
    """Return a calibration without what it knows of the temperature, which is found anew."""
    kept = [
        i for i, scalar in enumerate(calibration.uncertainty.names) if not scalar.startswith(f"{name}.temperature.")
    ]
    known = calibration.uncertainty
    return replace(
        calibration,
        imus={name: replace(calibration.imus[name], temperature=None)},
        uncertainty=Covariance(names=tuple(known.names[i] for i in kept), matrix=known.matrix[np.ix_(kept, kept)]),
    )


def _ideal(imu: ImuSamples, triads: Sequence[str], name: str) -> Calibration:
    """Return a sensor as its data sheet has it, with standard deviations to match."""
    accelerometer = gyroscope = None
    sigma: list[Floats] = []
    if "accelerometer" in triads:
        unit = imu.accelerometer.unit
        scale = _per_si(unit, ACCELEROMETER_UNITS_M_S2[unit], name)
        accelerometer = AccelerometerCalibration(sensitivity=scale * np.eye(3), bias=np.zeros(3), unit=unit)
        sigma += [_NOMINAL_SCALE * scale * np.tri(3).ravel(), np.full(3, _NOMINAL_BIAS_M_S2 * scale)]
    if "gyroscope" in triads:
        unit = imu.gyroscope.unit
        scale = _per_si(unit, GYROSCOPE_UNITS_RAD_S[unit], name)
        gyroscope = GyroscopeCalibration(
            sensitivity=scale * np.eye(3), bias=np.zeros(3), g_sensitivity=np.zeros((3, 3)), unit=unit
        )
        lower = np.ones((3, 3)) if accelerometer is not None else np.tri(3)
        sigma += [_NOMINAL_SCALE * scale * lower.ravel(), np.zeros(3), np.zeros(9)]
    imus = {"imu0": ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)}
    return Calibration(
        imus=imus,
        frame="accel-x" if accelerometer is not None else "gyro-x",
        gravity=UNSTATED_GRAVITY,
        uncertainty=Covariance(names=covariance_names(imus), matrix=np.diag(np.concatenate(sigma) ** 2)),
        assessment=Assessment(verdict="pass", findings=(), model="temperature"),
        provenance=Provenance(method="temperature"),
    )


def _per_si(unit: str, si: float | None, name: str) -> float:
    if si is None:
        raise OptionError(
            f"{name} is in {unit}, and nothing tells what one is. Give a calibration of the sensor (--calibration), or "
            "state the units (--units)."
        )
    return 1 / si
