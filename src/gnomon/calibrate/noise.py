"""The noise of an IMU from a long recording at rest: Allan variance, fit, verdict.

samples, block by block -> Allan sums and windows -> was it still? -> fit of every axis -> assess -> NoiseResult
"""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import cache, partial
from math import nan, sqrt
from pathlib import Path

import numpy as np

from ..assess.checks.imu_checks import TELLS_RESTS, check_protocol, find_imu_rests
from ..assess.checks.signals import check_turns, copied_stretches, dead_band_finding, isolated_finding
from ..assess.imu.imu_tables import signal_envelope
from ..assess.imu.noise_stationarity import Stationarity, dead_windows, judge_stationarity, stationarity_findings
from ..assess.imu.noise_verdict import StillSpans, assess_noise, check_length, check_samples, check_still
from ..assess.imu.temperature import check_temperature
from ..assess.verdict import merge_by_cause, verdict_of
from ..detect.samples.faults import RepeatWatch, dead_bands, isolated_readings, without_readings
from ..detect.samples.rest_watch import RestTable, RestWatch
from ..errors import RecordingError
from ..estimate.allan.deviation import KINDS, AllanSums, AllanVariance
from ..estimate.allan.fit import AllanFit, AxisFit
from ..estimate.allan.patterns import HighPass, longest_unfiltered_s
from ..estimate.multiposition.noise_levels import averaging_time
from ..findings import Finding, make_finding
from ..kernel import one_blas_thread
from ..options import NoiseOptions
from ..progress import Progress
from ..readers.devices.device_log import is_device_log
from ..readers.files import file_source, recording_files
from ..readers.recordings import read
from ..readers.samples.recognise import gyroscope_unit
from ..readers.samples.stream import SampleStream, open_stream, read_thermometer, stream_of
from ..recording import Floats, ImuSamples, Recording, Source, TemperatureSamples, TriadSamples, smallest_steps
from ..results.calibration import Provenance
from ..results.sensor_noise import (
    SENSOR_UNITS,
    AllanTable,
    AxisNoise,
    Coefficient,
    NoiseResult,
    SensorNoise,
    TriadNoise,
)
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units

_FACTORS = {"accelerometer": ACCELEROMETER_UNITS_M_S2, "gyroscope": GYROSCOPE_UNITS_RAD_S}
_BLOCK_BYTES = 4 << 20
_LARGEST_WHOLE = 100 << 20
"""Of files that are read as a whole, for the sake of a thermometer's readings [bytes]."""
_FILTERED_S = 2.0  # shorter averaging times may show the sensor's filter or vibration instead of its noise
_T_INIT_S = (1.0, 225.0)  # averaging times of Fig. 3.2 of Tedaldi


def identify_noise(
    recording: Recording | str | Path | Sequence[str | Path],
    options: NoiseOptions | None = None,
    progress: Progress | None = None,
    *,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> NoiseResult:
    """Identify the noise of an IMU from a recording of some hours in which it was not touched.

    Files are read block by block: the recording need not fit into memory.

    Parameters
    ----------
    recording : a recording, or the path of one, or two paths (accelerometer, gyroscope)
    options : see NoiseOptions
    progress : called with a sentence at each step
    columns, rate_hz, units : of files, as for `gnomon.read`

    Raises
    ------
    RecordingError
        If it cannot be read, is too short, was moved, or is in counts of unknown size.
    OptionError
        If an option does not fit the recording.
    """
    options = options or NoiseOptions()
    tell = progress or (lambda _: None)
    stream, sources, thermometer = _opened(
        recording, columns, rate_hz, Units.parse(units) if isinstance(units, str) else units
    )
    tell("reading the recording")
    with one_blas_thread():  # the axes are worked on side by side already
        triads = _summed(stream, options)
        curves = {name: triad.sums.variance(triad.table.rate_hz) for name, triad in triads.items()}
    findings: list[Finding] = [note for triad in triads.values() for note in triad.notes]
    findings += _warmth(thermometer, options)
    tables = {name: triad.table for name, triad in triads.items()}
    find_rests = cache(partial(_rests, triads))
    for name, triad in triads.items():
        check_length(tables[name], name)
        findings += check_still(tables[name], name, dead_windows(tables[name], triad.step), find_rests)
        findings += check_samples(tables[name], triad.step, name)
        findings += copied_stretches(*triad.repeats.copies(), name)
        findings += dead_band_finding(triad.band, triad.band_places, name, SENSOR_UNITS[name])
        if triad.isolated:
            at_s = np.concatenate(triad.isolated)
            findings.append(isolated_finding(at_s, len(at_s) / triad.watch.samples, name))
    tell("fitting the Allan variance")
    steady: dict[str, Stationarity] = {}
    with one_blas_thread():
        for name, triad in triads.items():
            steady[name] = judge_stationarity(tables[name], triad.step)
            findings += stationarity_findings(tables[name], steady[name], name)
        fits = _fitted(curves, steady)
    noise = {name: _triad_noise(curve, fits[name], steady[name]) for name, curve in curves.items()}
    t_init_s = _t_init(curves["gyroscope"]) if "gyroscope" in curves else nan
    findings += assess_noise(noise, fits, t_init_s)
    ordered = merge_by_cause(findings)
    stated = {f.name: str(getattr(options, f.name)) for f in fields(options) if getattr(options, f.name) != f.default}
    return NoiseResult(
        noise=SensorNoise(
            accelerometer=noise.get("accelerometer"),
            gyroscope=noise.get("gyroscope"),
            t_init_s=t_init_s,
            verdict=verdict_of(ordered),
            findings=ordered,
            provenance=Provenance(method="noise", inputs=sources, options=stated),
        ),
        curves={name: _table(curve, noise[name], fits[name]) for name, curve in curves.items()},
        signals={
            name: signal_envelope(triad.table.t_s, triad.table.mean, SENSOR_UNITS[name])
            for name, triad in triads.items()
        },
        topic=options.topic,
    )


def _rests(triads: dict[str, "_Triad"]) -> StillSpans | None:
    """Return the rests as `gnomon check` finds them; None without an accelerometer."""
    if "accelerometer" not in triads:
        return None
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit=SENSOR_UNITS["gyroscope"])
    gyroscope = triads["gyroscope"].watch.thinned() if "gyroscope" in triads else nothing
    imu = ImuSamples(accelerometer=triads["accelerometer"].watch.thinned(), gyroscope=gyroscope)
    detection = find_imu_rests(imu)
    if detection is None:
        return None
    found = detection.chosen.rests.found.where(detection.chosen.rests.used)
    t_s = np.asarray(imu.accelerometer.t_ns - (triads["accelerometer"].watch.origin_ns or 0), np.float64) * 1e-9
    told = check_protocol(imu, "imu0", detection)
    return StillSpans(
        start_s=t_s[found.start],
        stop_s=t_s[found.stop - 1],
        words=" ".join(one.message for one in told if one.code in TELLS_RESTS),
    )


def _warmth(thermometer: TemperatureSamples | None, options: NoiseOptions) -> list[Finding]:
    """Return findings on the thermometer between the start and the stop that were asked for."""
    if thermometer is None or not len(thermometer):
        return []
    t_s = (thermometer.t_ns - thermometer.t_ns[0]) * 1e-9
    kept = slice(*np.searchsorted(t_s, [options.start_s, np.inf if options.stop_s is None else options.stop_s]))
    part = TemperatureSamples(t_ns=thermometer.t_ns[kept], values=thermometer.values[kept], unit=thermometer.unit)
    return check_temperature(part, "thermometer") if len(part) > 1 else []


def _opened(
    recording: Recording | str | Path | Sequence[str | Path],
    columns: str | None,
    rate_hz: float | None,
    units: Units | None,
) -> tuple[SampleStream, tuple[Source, ...], TemperatureSamples | None]:
    """Return the samples, where they are from, and the thermometer's readings, of files that fit into memory."""
    paths = () if isinstance(recording, Recording) else (recording,) if isinstance(recording, str | Path) else recording
    if not isinstance(recording, Recording) and is_device_log(paths):
        recording = read(*paths, columns=columns, rate_hz=rate_hz, units=units)
    if isinstance(recording, Recording):
        imu = next(iter(recording.imus.values()))
        return stream_of(imu, 1 << 18), recording.sources, imu.temperature
    stream = open_stream(
        *paths,
        expected=Units(),
        units=units,
        columns=columns,
        rate_hz=rate_hz,
        triads=tuple(SENSOR_UNITS),
        block_bytes=_BLOCK_BYTES,
    )
    files = recording_files(paths)
    small = sum(file.stat().st_size for file in files) <= _LARGEST_WHOLE
    warm = stream.thermometer and small
    thermometer = read_thermometer(*paths, columns=columns, rate_hz=rate_hz, units=units) if warm else None
    return stream, tuple(map(file_source, files)), thermometer


class _Triad:
    """Takes in the samples of one sensor, in SI units, between the start and the stop that were asked for."""

    def __init__(self, name: str, options: NoiseOptions) -> None:
        self.name = name
        self.sums, self.watch, self.repeats = AllanSums(), RestWatch(), RepeatWatch()
        self.isolated = list[Floats]()
        self.notes: list[Finding] = []
        self.step = np.full(3, np.nan)
        self.band, self.band_places = np.full(3, np.nan), np.zeros(3, np.int64)
        self._options = options
        self._origin: int | None = None
        self._factor = 1.0

    def add(self, block: TriadSamples) -> bool:
        """Take the next samples; return whether more are wanted."""
        if not len(block):
            return True
        if self._origin is None:
            self._origin = self.watch.origin_ns = int(block.t_ns[0])
            self._factor = self._unit(block)
            self.step = smallest_steps(block.values) * self._factor
            self.notes += check_turns(block, self.name)
        t_s: Floats = np.multiply(block.t_ns - self._origin, 1e-9, dtype=np.float64)
        stop_s = np.inf if self._options.stop_s is None else self._options.stop_s
        kept = slice(*np.searchsorted(t_s, [self._options.start_s, stop_s]).tolist())
        values = block.values[kept] * self._factor
        at = isolated_readings(values)
        if len(at):
            values = without_readings(values, at)
            self.isolated.append(t_s[kept][at])
        self.watch.add(TriadSamples(t_ns=block.t_ns[kept], values=values, unit=SENSOR_UNITS[self.name]))
        if self.watch.backward is not None:
            raise RecordingError(
                f"{self.name}: the timestamps go backwards at sample {self.watch.backward}, so that the order of the "
                "samples is not known. Sort them by their timestamps, or cut the recording where the clock was set "
                "anew."
            )
        self.sums.add(values)
        band, places = dead_bands(values)
        self.band, self.band_places = np.where(places > 0, band, self.band), self.band_places + places
        self.repeats.add(values, t_s[kept])
        return bool(t_s[-1] < stop_s)

    def _unit(self, block: TriadSamples) -> float:
        """Return what the unit of the samples is in SI."""
        unit, why = block.unit, ""
        if self.name == "gyroscope" and unit == "count":
            found = gyroscope_unit(block.values, block.t_ns, None)
            unit, why = found.unit, f" ({found.reason}); state --units if that is wrong"
        factor = _FACTORS[self.name][unit]
        if factor is None:
            raise RecordingError(
                f"the {self.name} is in raw counts, but its noise is wanted in {SENSOR_UNITS[self.name]}. If it is in "
                'another unit, state it, for example --units "g deg/s". If these are counts, calibrate the IMU first '
                "(gnomon imu) and convert the samples with that (gnomon apply)."
            )
        self.notes.append(make_finding("assumed/unit", name=self.name, unit=unit, why=why))
        return factor

    @property
    def table(self) -> RestTable:
        """What the recording looks like."""
        return self.watch.table()


def _summed(stream: SampleStream, options: NoiseOptions) -> dict[str, _Triad]:
    """Take in the blocks of all sensors by turns, so that none has to wait in memory for the other."""
    blocks = {name: found for name in SENSOR_UNITS if (found := getattr(stream, name)) is not None}
    triads = {name: _Triad(name, options) for name in blocks}
    waiting: dict[str, Iterator[TriadSamples]] = dict(blocks)
    while waiting:
        for name, iterator in tuple(waiting.items()):
            block = next(iterator, None)
            if block is None or not triads[name].add(block):
                del waiting[name]
    if not any(triad.watch.samples for triad in triads.values()):
        raise RecordingError(
            f"no samples are left from {options.start_s:g} s on. State a smaller --start-s."
            if options.start_s > 0
            else "there are no samples in this recording. Was it copied completely?"
        )
    return {name: triad for name, triad in triads.items() if triad.watch.samples}


def _fitted(curves: dict[str, AllanVariance], steady: dict[str, Stationarity]) -> dict[str, tuple[AxisFit, ...]]:
    """Fit every axis; sensors with as many samples share the covariance of the estimates."""
    known: dict[int, AllanFit] = {}
    fits: dict[str, tuple[AxisFit, ...]] = {}
    for name, curve in curves.items():
        if curve.samples not in known:
            known[curve.samples] = AllanFit.of(curve.factors, curve.samples)
        fits[name] = _fitted_triad(known[curve.samples], curve, steady[name].high_pass)
    return fits


def _fitted_triad(fit: AllanFit, curve: AllanVariance, high_pass: HighPass | None) -> tuple[AxisFit, ...]:
    slopes = (curve.slope / curve.rate_hz).tolist()
    optional = int(np.count_nonzero(curve.tau_s < _FILTERED_S))
    triad = np.sum([fit.other_slopes(curve.straight[:, i]) for i in range(3)], axis=0)

    def fitted(axis: int, *, filtered: bool) -> AxisFit:
        longest_s = longest_unfiltered_s(high_pass, axis) if filtered else np.inf
        unfiltered = int(np.count_nonzero(curve.tau_s <= longest_s)) if longest_s < np.inf else None
        sure = high_pass is None or high_pass.sure
        return fit.fit(curve.straight[:, axis], slopes[axis], optional, unfiltered, triad, sure=sure)

    found = [fitted(axis, filtered=True) for axis in range(3)]
    if high_pass is not None and not high_pass.sure:
        found = [_either(fitted(axis, filtered=False), one) for axis, one in enumerate(found)]
    return tuple(found)


def _either(without: AxisFit, behind: AxisFit) -> AxisFit:
    """Return the fit without a filter with bounds and sigmas that hold with it, too, where it perhaps is there."""
    found, also = without.theta > 0, behind.theta > 0
    change = np.where(also, np.abs(without.theta - behind.theta), without.theta)  # what only the longest times show
    bound = np.where(also, behind.theta + 2 * behind.sigma, behind.bound)
    return replace(
        without,
        bound=np.where(found, np.nan, np.fmax(without.bound, bound)),
        sigma=np.where(found, np.hypot(np.fmax(without.sigma, behind.sigma), change), np.nan),
    )


def _triad_noise(curve: AllanVariance, fits: tuple[AxisFit, ...], steady: Stationarity) -> TriadNoise:
    x, y, z = (_widened(_axis_noise(fit, curve), steady, i) for i, fit in enumerate(fits))
    tau_s = curve.tau_s
    return TriadNoise(
        rate_hz=curve.rate_hz, samples=curve.samples, tau_s=(float(tau_s[0]), float(tau_s[-1])), axes=(x, y, z)
    )


_POWERS = dict(zip(KINDS, (-1.0, -0.5, 0.0, 0.5), strict=True))
"""A coefficient is the square root of theta, times this power of the rate."""


def _axis_noise(fit: AxisFit, curve: AllanVariance) -> AxisNoise:
    """Return the coefficients of one axis from a fit for a sample period of one."""
    rate_hz = curve.rate_hz
    found: dict[str, Coefficient] = {}
    for i, kind in enumerate(KINDS):
        scale = rate_hz ** _POWERS[kind]
        if fit.theta[i] > 0:
            value = sqrt(fit.theta[i])
            below = value - sqrt(max(fit.theta[i] - 2 * fit.sigma[i], 0.0))  # a root errs by more below than above
            sigma = max(float(fit.sigma[i]) / value, below) / 2
            found[kind] = Coefficient(value=scale * value, sigma=scale * sigma)
        else:
            found[kind] = Coefficient(value=0.0, bound=scale * sqrt(fit.bound[i]))
    slope, sigma = abs(fit.slope) * rate_hz, fit.slope_sigma * rate_hz
    ramp = Coefficient(value=slope, sigma=sigma) if fit.ramp else Coefficient(value=0.0, bound=slope + 2 * sigma)
    return AxisNoise(**found, rate_ramp=ramp, fitted_from_s=float(curve.tau_s[fit.first]), misfit=fit.misfit / 2)


def _widened(noise: AxisNoise, steady: Stationarity, axis: int) -> AxisNoise:
    """Return the noise of an axis with sigmas that hold where it is not the same all the time."""
    found = noise.coefficients()
    white = found["white_noise"]
    share = np.hypot(steady.spread[axis], steady.clipped[axis])
    found["white_noise"] = replace(white, sigma=float(np.hypot(white.sigma, share * white.value)))
    if steady.patterns[axis] is not None or steady.frozen[:, axis].any():
        for kind in ("bias_instability", "random_walk"):
            one = found[kind]
            found[kind] = replace(one, sigma=float(np.hypot(one.sigma, one.value))) if one.found else one
    return replace(noise, **found)


def _table(curve: AllanVariance, noise: TriadNoise, fits: tuple[AxisFit, ...]) -> AllanTable:
    """Return the curve with intervals from the chi-squared law of as many degrees of freedom as its estimates have."""
    from scipy.special import gammaincinv  # a part of what loading chi2 costs  # pyright: ignore[reportMissingTypeStubs]

    deviation = np.sqrt(curve.variance)
    freedom = 2 / np.stack([fit.scatter for fit in fits], axis=1) ** 2
    high, low = (2 * gammaincinv(freedom / 2, chance) for chance in (0.975, 0.025))
    return AllanTable(
        tau_s=curve.tau_s,
        deviation=deviation,
        lower=deviation * np.sqrt(freedom / high),
        upper=deviation * np.sqrt(freedom / low),
        fitted=np.stack([axis.deviation(curve.tau_s) for axis in noise.axes], axis=1),
    )


def _t_init(curve: AllanVariance) -> float:
    """Return how long a gyroscope should rest before a calibration by hand (Tedaldi 2014, Eq. 3.17, Fig. 3.2) [s]."""
    tau_s = curve.tau_s
    used = (tau_s >= _T_INIT_S[0]) & (tau_s <= min(_T_INIT_S[1], curve.samples / curve.rate_hz / 9))
    return averaging_time(tau_s[used], np.sqrt(curve.variance[used])) if used.any() else nan
