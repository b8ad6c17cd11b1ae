"""The data doctor's look at an IMU that was held still and turned: clocks, lost samples, rests, attitudes, gravity."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...detect.samples.faults import RangeChange, repair_samples, saturated_samples
from ...detect.samples.rests import RestDetection, Rests, detect_rests
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...progress import tell_parts
from ...recording import Floats, ImuSamples, Integers, Recording, TriadSamples, close_gaps
from ...recording.samples import distinct_values, median_of, quantile_of
from ...results.result import StaticIntervals, interval_means
from ...units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2
from ..imu.temperature import check_temperature
from .signals import axis_extremes, check_exchanged, check_signal, check_stamps, check_vibration, is_silent

TELLS_RESTS = ("attitudes", "always-static", "intervals-left-out")
_LISTED = 6  # runs of rests with one reason
_MANY = 0.1  # of the rests


def left_out_rests_findings(start_s: Floats, stop_s: Floats, reason: Sequence[str], label: str = "") -> list[Finding]:
    """Name the rests that are not used, with time, by reason; those behind each other as one run.

    Parameters
    ----------
    start_s, stop_s : (n,) of all rests that were found [s from the start of the recording]
    reason : (n,) why a rest is not used, or ""
    label : begins the message
    """
    out = [k for k, why in enumerate(reason) if why]
    if not out:
        return []
    listed: list[str] = []
    for why in dict.fromkeys(reason[k] for k in out):
        own = np.array([k for k in out if reason[k] == why])
        runs = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
        names = [f"{run[0] + 1} to {run[-1] + 1}" if len(run) > 1 else f"{run[0] + 1}" for run in runs[:_LISTED]]
        shown = [
            f"{name} ({start_s[run[0]]:.1f} to {stop_s[run[-1]]:.1f} s)" for name, run in zip(names, runs, strict=False)
        ]
        more = f" and {sum(map(len, runs[_LISTED:]))} more, which the report lists" if len(runs) > _LISTED else ""
        listed.append(f"{', '.join(shown)}{more}: {why}")
    return [
        make_finding(
            "intervals-left-out",
            severity="warning" if len(out) > _MANY * len(reason) else "info",
            label=label,
            count=len(out),
            total=len(reason),
            listed="; ".join(listed),
        )
    ]


_APART_DEG = 10.0
_SOME, _NEEDED, _GOOD = 6, 9, 12  # attitudes: for scales and bias; for all nine parameters; to let errors show
_START_S = 20.0
_STILL = 0.9  # of the time at rest: the sensor was not turned between its rests either
_LAG_S = 0.05
_UNSTEADY, _MOVING = 1.35, 1.8  # wander within an interval; 0.9 to 1.1 where a sensor really rests
_PLAUSIBLE, _POSSIBLE = 0.15, 0.5  # relative error of gravity at rest, uncalibrated
_NONE = 0.1  # of gravity: less is none
_LOOKED_AT = 24  # intervals


def check_protocol(imu: ImuSamples, label: str, detection: RestDetection | None) -> list[Finding]:
    """Return findings on how the recording was made, by its rests; linear time."""
    accelerometer, found = imu.accelerometer, Rests.none()
    if detection is not None:
        accelerometer, found = detection.motion.samples, detection.chosen.rests
        imu = replace(imu, accelerometer=accelerometer, gyroscope=detection.gyroscope)
    rests = found.intervals
    unrest = _unrest(imu, rests) if len(rests) else float("inf")
    if unrest > _MOVING:
        return [make_finding("never-static", label=label, duration_s=accelerometer.duration_s)]
    means = interval_means(accelerometer.values, rests)
    attitudes, radius = distinct_attitudes(means, accelerometer)
    findings = _gravity(means, radius, accelerometer, label)
    if detection is not None and detection.range_change is not None:
        severity = "problem" if any(one.severity == "problem" for one in findings) else "warning"
        findings.insert(0, range_changed_finding(detection.range_change, accelerometer, label, severity))
    if unrest > _UNSTEADY:
        findings.append(make_finding("rests-unsteady", label=label, unrest=unrest))
    total = float((found.found.stop - found.found.start).sum()) / len(accelerometer)
    t_s = accelerometer.t_s
    left_out = left_out_rests_findings(t_s[found.kept.start], t_s[found.kept.stop - 1], found.reason, f"{label}: ")
    if attitudes < 2 and total > _STILL:
        return [*findings, make_finding("always-static", label=label, total=total), *left_out]
    findings += [_attitudes(attitudes, found, total, label), *left_out]
    findings.append(_static_start(accelerometer, found.found, label))
    if len(imu.gyroscope) > 1 and is_silent(imu.gyroscope):
        findings.append(make_finding("gyroscope-silent/rests", label=label, attitudes=attitudes))
    return findings


def find_imu_rests(
    imu: ImuSamples,
    *,
    window_s: float = 1.0,
    multiplier: float | None = None,
    accelerometer_range: float | None = None,
    gravity_m_s2: float = 9.81,
    counted: bool = False,
) -> RestDetection | None:
    """Find the rests of an IMU as every calibration does; None where it is shorter than two windows.

    Parameters
    ----------
    imu : as recorded
    window_s, multiplier, gravity_m_s2 : see `detect_rests`
    accelerometer_range : what the accelerometer can measure [unit], where it is known
    counted : whether the samples are on a uniform time base whatever their timestamps
    """
    accelerometer, gyroscope = (repair_samples(triad, counted=counted) for triad in (imu.accelerometer, imu.gyroscope))
    times = [
        np.asarray(1e-9 * (triad.t_ns - accelerometer.t_ns[0]), np.float64) for triad in (accelerometer, gyroscope)
    ]
    return detect_rests(
        accelerometer,
        gyroscope,
        saturated_samples(accelerometer, accelerometer_range),
        t_s=(times[0], times[1]),
        window_s=window_s,
        multiplier=multiplier,
        gravity_m_s2=gravity_m_s2,
    )


def _unrest(imu: ImuSamples, rests: StaticIntervals) -> float:
    """Return how much more a signal wanders within an interval than over 0.05 s; 1 for noise, median of the intervals.

    The detector looks for the quietest parts of a recording, and always finds some. Noise at rest changes as much in
    0.05 s as in a second; the slow sway of a motion does not. Both triads are looked at (geometric mean).
    """
    ratios: list[float] = []
    chosen = distinct_values(np.linspace(0, len(rests) - 1, min(len(rests), _LOOKED_AT)).astype(np.int64))
    edges = imu.accelerometer.t_ns[rests.start[chosen]], imu.accelerometer.t_ns[rests.stop[chosen] - 1]
    for samples in (imu.accelerometer, imu.gyroscope):
        if len(samples) < 2:
            continue
        lag = max(1, round(_LAG_S * samples.rate_hz))
        first, last = np.searchsorted(samples.t_ns, edges[0]), np.searchsorted(samples.t_ns, edges[1])
        found = [_wander(samples.values[a:b], lag) for a, b in zip(first, last, strict=True) if b - a > 4 * lag]
        if found:
            ratios.append(float(median_of(found)))
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def _wander(values: Floats, lag: int) -> float:
    length = 40 * lag  # two seconds are enough, and a slow drift of the bias is no motion
    values = values[:length]
    short = 0.5 * float(((values[lag:] - values[:-lag]) ** 2).mean(axis=0).sum())
    return max(float(np.sqrt(values.var(axis=0).sum() / short)), 1e-3) if short > 0 else 1.0


def distinct_attitudes(means: Floats, accelerometer: TriadSamples) -> tuple[int, float]:
    """Return how many attitudes are at least 10 degrees apart, and gravity in the unit (nan if unknown).

    A chord between two readings of gravity needs no bias, only the radius of the sphere on which they lie: gravity in
    the unit. Raw counts, whose axes may have any scale, are divided by the range of each axis first.

    Parameters
    ----------
    means : (n, 3) over the rests [unit]
    accelerometer : its unit and samples
    """
    factor = ACCELEROMETER_UNITS_M_S2[accelerometer.unit]
    if factor:
        radius = STANDARD_GRAVITY_M_S2 / factor
        return _count_apart(means, radius), radius
    spread = 0.5 * np.ptp(means, axis=0)
    turned = spread > 5 * _rest_noise(accelerometer)
    if not turned.any():
        return 1, float("nan")
    scaled = np.where(turned, means / np.where(turned, spread, 1.0), 0.0)
    radius = _sphere_radius(scaled)
    # Too few attitudes lie on no certain sphere; half their span is then the least radius.
    span = float(np.linalg.norm(np.ptp(scaled, axis=0)))
    alike = turned.all() and spread.max() < 2 * spread.min()
    return (
        _count_apart(scaled, radius if np.isfinite(radius) else 0.5 * span),
        _sphere_radius(means) if alike else float("nan"),
    )


def _count_apart(means: Floats, radius: float) -> int:
    limit = 2 * radius * np.sin(np.radians(_APART_DEG) / 2)
    kept = means[:1]
    for mean in means[1:]:
        if (((kept - mean) ** 2).sum(axis=1) > limit**2).all():
            kept = np.vstack([kept, mean])
    return len(kept)


def _rest_noise(samples: TriadSamples) -> Floats:
    """Return the sample-to-sample noise of each axis, (3,) [unit]."""
    steps = np.diff(samples.values[:5000], axis=0)
    return np.sqrt((steps**2).mean(axis=0) / 2)


def _sphere_radius(points: Floats) -> float:
    """Return the radius of the sphere through points (n, 3) by linear least squares; nan if they leave it open."""
    if len(points) < 5:
        return float("nan")
    centred = points - points.mean(axis=0)
    size = float(np.sqrt((centred**2).sum(axis=1).mean()))
    if size == 0:
        return float("nan")
    centred = centred / size
    design = np.column_stack([2 * centred, np.ones(len(centred))])
    solution, _, rank, singular = np.linalg.lstsq(design, (centred**2).sum(axis=1), rcond=None)
    if rank < 4 or singular[-1] < 0.05 * singular[0]:
        return float("nan")
    square = float(solution[3] + (solution[:3] ** 2).sum())
    return size * float(np.sqrt(square)) if square > 0 else float("nan")


def _gravity(means: Floats, radius: float, accelerometer: TriadSamples, label: str) -> list[Finding]:
    factor = ACCELEROMETER_UNITS_M_S2[accelerometer.unit]
    if factor is None:
        if not np.isfinite(radius):
            return []
        message = f"{label}: gravity is about {radius:.4g} counts."
        return [make_finding("gravity-magnitude/counts", message=message)]
    found = float(median_of(np.linalg.norm(means, axis=1))) * factor
    error = abs(found / STANDARD_GRAVITY_M_S2 - 1)
    message = f"{label}: the accelerometer reads {found:.3f} m/s^2 at rest, expected about 9.81." + looks_like(
        found / factor, accelerometer.unit
    )
    if error <= _PLAUSIBLE:
        return [make_finding("gravity-magnitude/good", message=message)]
    return [
        make_finding(
            "gravity-magnitude/rest",
            severity="problem" if error > _POSSIBLE else "warning",
            message=message,
            found=why_no_gravity(found, message),
        )
    ]


def range_changed_finding(
    change: RangeChange, accelerometer: TriadSamples, label: str, severity: Literal["warning", "problem"]
) -> Finding:
    """Return that the accelerometer reads gravity as another number from an instant on."""
    t_s = accelerometer.t_s
    return make_finding(
        "range-changed",
        severity=severity,
        label=label,
        factor=change.factor,
        t_from_s=t_s[change.last],
        t_to_s=t_s[change.first],
    )


def looks_like(gravity: float, unit: str) -> str:
    """Return " It looks like g." where gravity as it was read is that of another unit; else ""."""
    for name, size in ACCELEROMETER_UNITS_M_S2.items():
        if size and name != unit and abs(gravity * size / STANDARD_GRAVITY_M_S2 - 1) <= _PLAUSIBLE:
            return f" It is in {name}, not in {unit}." if name != "m/s^2" else " It is in m/s^2 already."
    return ""


def why_no_gravity(found_m_s2: float, message: str) -> str:
    """Return what makes an accelerometer read far from gravity: the unit where it is known, none at all, or either."""
    if "It is in" in message:
        return "The stated unit is wrong."
    if found_m_s2 < _NONE * STANDARD_GRAVITY_M_S2:
        return "Most likely gravity was removed, as phones do for their linear acceleration."
    return "The unit is wrong, gravity was removed, or bias or scale are far off."


def _attitudes(attitudes: int, rests: Rests, share: float, label: str) -> Finding:
    usable = int(rests.used.sum())
    number = "1 rest" if len(rests) == 1 else f"{len(rests)} rests"
    where = " in one attitude" if attitudes == 1 else f" in {attitudes} attitudes more than 10 deg apart"
    message = f"{label}: {number} ({100 * share:.0f} % of the time){where}" + (
        f", {usable} of them usable." if usable < len(rests) else "."
    )
    if attitudes >= _GOOD:
        return make_finding("attitudes/enough", message=message)
    return make_finding(
        "attitudes/few",
        severity="warning" if attitudes >= _NEEDED else "problem",
        case="enough" if attitudes >= _NEEDED else "some" if attitudes >= _SOME else "",
        message=message,
    )


def _static_start(samples: TriadSamples, rests: StaticIntervals, label: str) -> Finding:
    begins = (samples.t_ns[rests.start[0]] - samples.t_ns[0]) * 1e-9
    length = (samples.t_ns[rests.stop[0] - 1] - samples.t_ns[rests.start[0]]) * 1e-9 if begins < 1.0 else 0.0
    message = f"{label}: the recording starts with {length:.1f} s at rest."
    if length >= _START_S:
        return make_finding("static-start/good", message=message)
    return make_finding("static-start/short", severity="info" if length > 0 else "warning", message=message)


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


_POSES = 9
FindRests = Callable[[ImuSamples], RestDetection | None]


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
