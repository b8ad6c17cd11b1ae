"""The data doctor: what is good and bad about a recording before anything is estimated from it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ...detect.samples.rests import RestDetection
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...progress import tell_parts
from ...recording import Floats, ImuSamples, Integers, Recording, TriadSamples, close_gaps
from ...recording.order_statistics import median_of, quantile_of
from ..verdict import merge_by_cause
from .protocol import check_protocol, find_imu_rests
from .signals import axis_extremes, check_exchanged, check_signal, check_stamps, check_vibration
from .temperature_checks import check_temperature

_SIDE = 4  # samples on either side that tell how fast a signal changes
_STEEP = 7.0  # that change from sample to sample, in units of the noise
_ASIDE, _NEAR = 0.35, 0.3  # of that change
_FEWEST_STEEP, _FEWEST, _TIMES = 200, 6, 4.0
_QUIET, _PIECE = 0.1, 50
_SHARE_WARN = 1e-3


def check_lost_samples(samples: TriadSamples, label: str) -> list[Finding]:
    """Look for samples that were lost where timestamps are a mere count of samples.

    In smooth motion a value is as far from the next one as its neighbours are from theirs; over a sample that was lost
    it is twice as far. Motion that is not smooth makes steps of half and of no length as often as of twice, and tells
    nothing.
    """
    steps = np.diff(samples.t_ns)
    if len(steps) < _FEWEST_STEEP or np.ptp(steps) > max(2, 1e-6 * float(median_of(steps))):
        return []
    extra = _extra_steps(samples.values)
    doubled, none = (int(np.count_nonzero(np.abs(extra - size) < _NEAR)) for size in (1.0, -1.0))
    share = (doubled - none) / max(len(extra), 1)
    if len(extra) < _FEWEST_STEEP or doubled < _FEWEST + _TIMES * none or share < _SHARE_WARN:
        return []
    return [make_finding("samples-skipped", label=label, share=share, doubled=doubled, count=len(extra))]


def _extra_steps(values: Floats) -> Floats:
    """Return by how much steps differ from those beside them, in units of these, where they are steep and straight."""
    n = len(values)
    k = np.arange(_SIDE, n - 1 - _SIDE)
    usual = ((values[k] - values[k - _SIDE]) + (values[k + 1 + _SIDE] - values[k + 1])) / (2 * _SIDE)
    size = np.linalg.norm(usual, axis=1)
    steep = size > max(_STEEP * _noise(values), 1e-300)
    usual, size, step = usual[steep], size[steep], (values[k + 1] - values[k])[steep]
    extra = np.einsum("ni,ni->n", step - usual, usual) / size**2
    aside = np.linalg.norm(step - usual * (1 + extra)[:, None], axis=1) / size
    return np.asarray(extra[aside < _ASIDE], dtype=np.float64)


def _noise(values: Floats) -> float:
    """Return the standard deviation of a sample's component where the signal is quietest [unit]."""
    third = np.diff(values, n=3, axis=0)  # of white noise, 20 times its variance
    count = len(third) // _PIECE
    power = np.square(third[: count * _PIECE]).reshape(count, _PIECE * 3).mean(axis=1)
    return float(np.sqrt(quantile_of(power, _QUIET) / 20)) if count else 0.0


_GRID_S, _WIDTH_S = 0.02, 0.2
_HALF = round(_WIDTH_S / 2 / _GRID_S)
_LONGEST_S = 10.0
_APART_S, _FAR_S = 0.1, 0.3
_ALIKE, _GAINED = 0.5, 0.1
_LONG_S = 20.0
_FEWEST_IN_WIDTH = (
    2  # samples, about: fewer show nothing stirred, and timestamps far too slow would need an endless grid
)
_LONGEST_GAP_NS = 1_000_000_000  # nothing is stirred in it


def check_triad_clocks(imu: ImuSamples, name: str) -> list[Finding]:
    """Return a finding where both triads are stirred alike, but one of them later (code triads-apart).

    Parameters
    ----------
    imu : samples of both, timestamps not falling
    name : of the IMU
    """
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    first = max(int(accelerometer.t_ns[0]), int(gyroscope.t_ns[0]))
    last = min(int(accelerometer.t_ns[-1]), int(gyroscope.t_ns[-1]))
    slower_hz = min(accelerometer.rate_hz, gyroscope.rate_hz)
    if (last - first) * 1e-9 < _LONG_S or not slower_hz * _WIDTH_S >= _FEWEST_IN_WIDTH:
        return []
    if any(_coarseness_s(samples.t_ns) > _WIDTH_S for samples in (accelerometer, gyroscope)):
        return []
    both = [np.clip(samples.t_ns, first, last) for samples in (accelerometer, gyroscope)]
    stamps = close_gaps(both, _LONGEST_GAP_NS)
    times = [np.asarray((t_ns - first) * 1e-9, dtype=np.float64) for t_ns in stamps]
    count = int(np.ceil(max(t_s[-1] for t_s in times) / _GRID_S))
    edges = (np.arange(count + 2 * _HALF) - _HALF) * _GRID_S
    ends = [np.searchsorted(t_s, edges) for t_s in (times[:1] if np.array_equal(times[0], times[1]) else times)]
    pushed, turned = _stirred(accelerometer.values, ends[0]), _stirred(gyroscope.values, ends[-1])
    lag, best, now = _lag(pushed, turned)
    if abs(lag) < _APART_S or best < _ALIKE or best - now < _GAINED:
        return []
    later, earlier = ("gyroscope", "accelerometer") if lag > 0 else ("accelerometer", "gyroscope")
    return [
        make_finding(
            "triads-apart/imu",
            severity="problem" if abs(lag) > _FAR_S else "warning",
            name=name,
            later=later,
            lag=abs(lag),
            earlier=earlier,
        )
    ]


def _coarseness_s(t_ns: Integers) -> float:
    """Return the usual step of a clock between the timestamps that differ [s]."""
    steps = np.diff(t_ns)
    return float(median_of(steps[steps > 0])) * 1e-9 if (steps > 0).any() else np.inf


def _stirred(values: Floats, ends: Integers) -> Floats:
    """Return how much a sensor's readings vary about instants, as a logarithm without mean and of variance one.

    Parameters
    ----------
    values : (n, 3)
    ends : numbers of the first samples from each instant of a grid on, half a width before the first instant asked for
        to half a width behind the last
    """
    rows = np.zeros((4, len(values) + 1))
    rows[:3, 1:] = values.T
    rows[:3, 1:] -= rows[:3, 1:].mean(axis=1, keepdims=True)
    np.einsum("in,in->n", rows[:3], rows[:3], out=rows[3])
    sums = np.cumsum(rows, axis=1, out=rows)[:, ends]
    means = (sums[:, 2 * _HALF :] - sums[:, : -2 * _HALF]) / np.maximum(ends[2 * _HALF :] - ends[: -2 * _HALF], 1)
    variance = np.maximum(means[3] - np.einsum("in,in->n", means[:3], means[:3]), 0.0)
    level = np.log(variance + quantile_of(variance, 0.2) + 1e-30)
    level = level - level.mean()
    return level / max(float(level.std()), 1e-12)


def _lag(pushed: Floats, turned: Floats) -> tuple[float, float, float]:
    """Return by how much the second comes later [s], the correlation there, and without a lag."""
    count = len(pushed)
    most = min(round(_LONGEST_S / _GRID_S), count // 2)
    size = 1 << int(np.ceil(np.log2(count + most + 1)))  # so that no lag meets the other end
    cross = np.fft.irfft(np.conj(np.fft.rfft(pushed, size)) * np.fft.rfft(turned, size), size)
    lags = np.arange(-most, most + 1)
    score = cross[lags] / (count - np.abs(lags))
    best = int(np.argmax(score))
    return float(lags[best]) * _GRID_S, float(score[best]), float(score[most])


_OF_VALUES = {"isolated-readings", "saturation", "samples-stuck", "samples-repeated", "dead-band"}


def check_magnetometers(recording: Recording) -> list[Finding]:
    """Look at the magnetometers of a recording; a problem of theirs spoils nothing else, and is a warning."""
    findings: list[Finding] = []
    for name, imu in recording.imus.items():
        if imu.magnetometer is None or len(imu.magnetometer) < 2:
            continue
        alone = not len(imu.accelerometer)
        for finding in check_field_samples(imu.magnetometer, f"{name} magnetometer"):
            severe = finding.severity == "problem" and not alone
            findings.append(replace(finding, severity="warning") if severe else finding)
    return findings


def check_field_samples(samples: TriadSamples, label: str) -> list[Finding]:
    """Return findings on timestamps and values of a triad of which only the strength counts, which needs no time."""
    found: list[Finding] = []
    for finding in (*check_stamps(samples, label), *check_signal(samples, label)):
        if finding.severity == "warning" and finding.code == "saturation":
            found.append(replace(finding, consequence="They are masked.", cure="Set a wider range."))
        elif finding.severity == "warning" and finding.code not in _OF_VALUES:
            times = "Strengths do not depend on time; how the sensors stand to each other may suffer."
            found.append(replace(finding, severity="info", consequence=times))
        else:
            found.append(finding)
    return found


_POSES = 9
FindRests = Callable[[ImuSamples], RestDetection | None]


def check(recording: Recording, *, window_s: float = 1.0, multiplier: float | None = None) -> tuple[Finding, ...]:
    """Look at a recording and say what is good or bad about it for the calibration of an IMU.

    Parameters
    ----------
    window_s, multiplier : of the static detector, see `ImuOptions`

    Every finding states its consequence and its cure. Codes: time-backward, time-constant, time-repeated, time-rounded,
    rate, rate-changed, jitter, gaps; signal-constant, axis-constant, axis-stuck, isolated-readings, saturation,
    samples-stuck, samples-repeated, samples-skipped; samples-missing, gyroscope-missing, gyroscope-silent;
    gravity-magnitude, range-changed, never-static, rests-unsteady, always-static, attitudes, intervals-left-out,
    static-start, clocks-apart, triads-apart, vibration; poses; temperature, temperature-hot, temperature-implausible.

    Returns
    -------
    Findings, those of one IMU by severity, causes before what follows from them; otherwise in the order timestamps,
    values, motion, IMU by IMU. Severity "problem" means that it cannot be calibrated.
    """
    findings = check_by_rests(recording, partial(find_imu_rests, window_s=window_s, multiplier=multiplier))
    if any(imu.magnetometer is not None for imu in recording.imus.values()):
        alone = all(not len(imu.gyroscope) for imu in recording.imus.values())
        findings = tuple(_for_a_magnetometer(finding, alone=alone) for finding in findings)
    return merge_by_cause(list(findings)) if len(recording.imus) == 1 else findings


_OF_RESTS = {"never-static", "attitudes"}


def _for_a_magnetometer(finding: Finding, *, alone: bool) -> Finding:
    """Return a finding on rests as one for a recording that may be there for its magnetometer, which needs none."""
    if finding.code not in _OF_RESTS or finding.severity == "good":
        return finding
    return replace(
        finding,
        severity="info" if alone else "warning",
        consequence=f"gnomon magnetometer needs no rests; gnomon imu does. {finding.consequence}",
    )


def check_by_rests(recording: Recording, find_rests: FindRests) -> tuple[Finding, ...]:
    """Return the findings of `check`, by rests that another function finds, for a caller who uses them again."""
    if recording.pieces or recording.poses is not None:
        return tuple(_check_poses(recording))
    findings = [finding for name, imu in recording.imus.items() for finding in _check_imu(name, imu, find_rests)]
    for name, imu in recording.imus.items():
        if imu.temperature is not None:
            findings += check_temperature(imu.temperature, f"{name} thermometer")
    return tuple(findings)


def _check_poses(recording: Recording) -> list[Finding]:
    """Look at poses, which need neither rests between them nor one rate."""
    count, what = len(recording.pieces), "files"
    if recording.poses is not None:
        count, what = len(recording.poses), "averages"
    findings = [
        finding
        for name, imu in recording.imus.items()
        for quantity, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
        if len(samples) > 1
        for finding in check_signal(samples, f"{name} {quantity}")
    ]
    enough = count >= _POSES
    return [
        *findings,
        make_finding(
            "poses", severity="good" if enough else "warning", case="enough" if enough else "", count=count, what=what
        ),
    ]


def _check_imu(name: str, imu: ImuSamples, find_rests: FindRests) -> list[Finding]:
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    if len(accelerometer) < 2 or len(gyroscope) == 1:
        return [
            make_finding("samples-missing/imu", name=name, accelerometer=len(accelerometer), gyroscope=len(gyroscope))
        ]
    both = len(gyroscope) > 1
    if both and (exchanged := check_exchanged(accelerometer, gyroscope, name)):
        return exchanged
    labels = [f"{name} {quantity}" for quantity in ("accelerometer", "gyroscope")]
    looks: list[Callable[[], list[Finding]]] = []
    if not both:
        looks += [lambda: [make_finding("gyroscope-missing/imu", name=name)]]
    if both and np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        looks += [lambda: check_stamps(accelerometer, name)]
    else:
        looks += [lambda: check_stamps(accelerometer, labels[0])]
        looks += [lambda: check_stamps(gyroscope, labels[1]), lambda: _clocks(accelerometer, gyroscope, name)] * both
    looks += [lambda: check_signal(accelerometer, labels[0], gyroscope)]
    if both:
        looks += [
            lambda: check_signal(gyroscope, labels[1], accelerometer),
            lambda: look_or_postpone(lambda: check_vibration(accelerometer, gyroscope, name)),
            lambda: check_lost_samples(gyroscope, labels[1]),
        ]
    triads = [triad for triad in (accelerometer, gyroscope) if len(triad) > 1]
    timed = all(np.isfinite(triad.rate_hz) for triad in triads)
    if timed and not np.equal(*axis_extremes(accelerometer.values)).all():
        rising = all((np.diff(triad.t_ns) >= 0).all() for triad in triads)
        looks += [lambda: look_or_postpone(lambda: check_triad_clocks(imu, name))] * (both and rising)
        looks += [lambda: check_protocol(imu, name, find_rests(imu))]
    return [finding for look in tell_parts("checking the recording", looks, len(looks)) for finding in look()]


def _clocks(accelerometer: TriadSamples, gyroscope: TriadSamples, name: str) -> list[Finding]:
    first = max(accelerometer.t_ns[0], gyroscope.t_ns[0])
    last = min(accelerometer.t_ns[-1], gyroscope.t_ns[-1])
    longest = max(accelerometer.duration_s, gyroscope.duration_s)
    common = max(0.0, float(last - first) * 1e-9)
    if common > 0.9 * longest:
        return []
    return [
        make_finding(
            "clocks-apart", severity="problem" if common == 0 else "warning", name=name, common=common, longest=longest
        )
    ]
