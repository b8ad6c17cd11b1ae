"""The doctor's look at each triad: values, timestamps, vibration."""

from collections.abc import Iterator

import numpy as np

from ...detect.samples.faults import dead_bands, held_samples, isolated_readings, repeated_stretches, saturated_samples
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples, kept_with_array
from ...recording.samples import distinct_values, median_of, quantile_of
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2

_GAP_PERIODS = 1.5
_LOST_SHARE = 0.01
_LONG_GAP_S = 0.1
_JITTER = 0.3  # of a period
_BURSTS = 1.3  # mean over median step
_BLOCK = 2048
_JITTER_SAMPLES = 100_000
_FINE = 100.0  # steps of the clock in a period


@value_class(eq=True)
class _Steps:
    """Differences of timestamps [ns] and what is usual among them."""

    dt: Integers
    period: float
    spread: float


def check_stamps(samples: TriadSamples, label: str) -> list[Finding]:
    """Return findings on the timestamps of one sensor, or of both where they share timestamps; linear time.

    Parameters
    ----------
    samples : at least two
    label : such as "imu0 accelerometer", for messages
    """
    dt = np.diff(samples.t_ns)
    period = 1e9 / samples.rate_hz
    if not np.isfinite(period) and (dt < 0).any():
        return _backward(samples, dt, label)
    if not np.isfinite(period):
        return [make_finding("time-constant", label=label, samples=len(samples))]
    spread = 1.4826 * float(median_of(np.abs(dt - period)))
    steps = _Steps(dt=dt, period=period, spread=spread)
    gaps = _gaps(samples, steps, label)
    irregular = [finding for finding in gaps if finding.code in {"jitter", "rate-changed"}]
    findings = [*_backward(samples, dt, label), *irregular, *_repeated(steps, label)]
    findings += [] if irregular else gaps
    if all(finding.code != "rate-changed" for finding in irregular):
        findings += _rounded(steps, label)
    if not any(finding.severity in {"warning", "problem"} for finding in findings):
        findings.insert(
            0,
            make_finding(
                "rate",
                label=label,
                samples=len(samples),
                duration_s=samples.duration_s,
                rate_hz=samples.rate_hz,
                jitter=_jitter(steps),
            ),
        )
    return findings


def _jitter(steps: _Steps) -> float:
    """Return the root mean square of the deviations of steps from the usual one, gaps left out, in periods."""
    stride = max(1, len(steps.dt) // _JITTER_SAMPLES)
    off = steps.dt[::stride] / steps.period - 1
    return float(np.sqrt(np.mean(np.square(off[np.abs(off) < 0.5])))) if len(off) else 0.0


def _at(samples: TriadSamples, index: int) -> str:
    return f"sample {index} ({(samples.t_ns[index] - samples.t_ns[0]) * 1e-9:.3f} s after the start)"


def _backward(samples: TriadSamples, dt: Integers, label: str) -> list[Finding]:
    back = np.flatnonzero(dt < 0)
    if not len(back):
        return []
    first = int(back[0])
    return [
        make_finding(
            "time-backward",
            label=label,
            count=len(back),
            plural="s" * (len(back) > 1),
            step_s=-dt[first] * 1e-9,
            at=_at(samples, first),
        )
    ]


def _repeated(steps: _Steps, label: str) -> Iterator[Finding]:
    count = int(np.count_nonzero(steps.dt == 0))
    if not count:
        return
    share = count / len(steps.dt)
    rare = share <= _LOST_SHARE
    yield make_finding(
        "time-repeated",
        severity="info" if rare else "warning",
        case="rare" if rare else "",
        label=label,
        count=count,
        share=share,
    )


def _gaps(samples: TriadSamples, steps: _Steps, label: str) -> list[Finding]:
    if (changed := _rate_change(steps)) is not None:
        first, rates = changed
        return [make_finding("rate-changed", label=label, at=_at(samples, first), before=rates[0], after=rates[1])]
    mean = (samples.t_ns[-1] - samples.t_ns[0]) / (len(samples) - 1)
    limit = _GAP_PERIODS * steps.period + 3 * steps.spread
    gaps = np.flatnonzero(steps.dt > limit)
    irregular = steps.spread > _JITTER * steps.period or (
        mean > _BURSTS * steps.period and len(gaps) > _LOST_SHARE * len(samples)
    )
    if irregular:
        return [
            make_finding(
                "jitter",
                label=label,
                period_ms=steps.period * 1e-6,
                mean_ms=mean * 1e-6,
                longest_ms=steps.dt.max() * 1e-6,
            )
        ]
    if not len(gaps):
        return []
    longest = int(gaps[np.argmax(steps.dt[gaps])])
    lost = int(np.rint(steps.dt[gaps] / steps.period - 1).sum())
    length_s = float(steps.dt[longest]) * 1e-9
    severe = length_s > _LONG_GAP_S or lost > _LOST_SHARE * len(samples)
    return [
        make_finding(
            "gaps",
            severity="warning" if severe else "info",
            case="severe" if severe else "",
            label=label,
            count=len(gaps),
            plural="s" * (len(gaps) > 1),
            lost=lost,
            length_s=length_s,
            at=_at(samples, longest),
        )
    ]


def _rate_change(steps: _Steps) -> tuple[int, tuple[float, float]] | None:
    """Return the sample from which on another rate holds, and both rates [Hz]; None where it is not one change."""
    away = np.cumsum(steps.dt - steps.dt.mean())
    k = int(np.argmax(np.abs(away))) + 1
    sides = steps.dt[:k], steps.dt[k:]
    if min(len(side) for side in sides) < _BLOCK:
        return None
    before, after = (float(median_of(side)) for side in sides)
    for side, period in zip(sides, (before, after), strict=True):
        if np.mean(np.abs(side - period) > _JITTER * period) > _LOST_SHARE:
            return None
    return (k, (1e9 / before, 1e9 / after)) if abs(before - after) > _JITTER * min(before, after) else None


def _rounded(steps: _Steps, label: str) -> list[Finding]:
    """Find the step of the clock; text often keeps few digits of late timestamps, so blocks are looked at apart."""
    starts = np.linspace(0, max(0, len(steps.dt) - _BLOCK), 8).astype(np.int64)
    blocks = [distinct_values(steps.dt[a : a + _BLOCK]) for a in starts]
    # Steps that are all equal say nothing about the clock.
    quantum = max((int(np.gcd.reduce(block)) for block in blocks if len(block) > 1), default=0)
    steps_of_clock = steps.period / max(quantum, 1)
    if quantum == 0 or steps_of_clock > _FINE:
        return []
    return [make_finding("time-rounded", label=label, quantum_ms=quantum * 1e-6, percent=100 / steps_of_clock)]


_SLOWEST_HZ = 30.0  # hands tremble at up to 12 Hz, and shake at up to 20
_PART_S = 2.0
_AROUND = 12  # bins on each side in which a line is compared
_ABOVE = 30.0  # times the power of what surrounds it
_LOUD = 3.0  # times the white noise, rms
_LEAST_M_S2, _LEAST_RAD_S = 0.1, 5e-3


def check_vibration(accelerometer: TriadSamples, gyroscope: TriadSamples, name: str) -> list[Finding]:
    """Return a finding on vibration (code vibration), where there is much of it.

    Parameters
    ----------
    accelerometer, gyroscope : of one IMU, timestamps not falling
    name : of the IMU
    """
    found = (
        _line(accelerometer, ACCELEROMETER_UNITS_M_S2, _LEAST_M_S2),
        _line(gyroscope, GYROSCOPE_UNITS_RAD_S, _LEAST_RAD_S),
    )
    known = [line for line in found if line is not None]
    if not known:
        return []
    hz = known[0][0]
    sizes = [
        f"{line[1]:.2g} {unit} (rms) in the {triad}"
        for line, unit, triad in zip(found, ("m/s^2", "rad/s"), ("accelerometer", "gyroscope"), strict=True)
        if line is not None
    ]
    return [make_finding("vibration", name=name, hz=hz, sizes=" and ".join(sizes))]


def _line(samples: TriadSamples, units: dict[str, float | None], least: float) -> tuple[float, float] | None:
    """Return frequency [Hz] and rms [SI] of the strongest line over all axes; None where there is none."""
    rate, factor = samples.rate_hz, units.get(samples.unit)
    if not (np.isfinite(rate) and rate > 2.5 * _SLOWEST_HZ) or factor is None:
        return None
    spectrum = _spectrum(samples.values * factor, rate)
    if spectrum is None:
        return None
    hz, density = spectrum  # one-sided, summed over the axes
    fast = np.flatnonzero((hz > _SLOWEST_HZ) & (hz < 0.49 * rate))
    if len(fast) < 3 * _AROUND:
        return None
    top = int(fast[np.argmax(density[fast])])
    around = density[np.r_[max(top - _AROUND, fast[0]) : top - 2, top + 3 : min(top + _AROUND, fast[-1])]]
    power = float(density[max(top - 2, 0) : top + 3].sum() * (hz[1] - hz[0]))
    usual = float(median_of(density[fast]))
    white = np.sqrt(usual * rate / 2)
    loud = np.sqrt(power) > max(least, _LOUD * white)
    if not loud or density[top] < _ABOVE * float(median_of(around)):
        return None
    return float(hz[top]), float(np.sqrt(power))


def _spectrum(values: Floats, rate_hz: float) -> tuple[Floats, Floats] | None:
    """Return frequencies and the power density summed over the axes, by Welch's method: medians over parts."""
    size = round(_PART_S * rate_hz)
    parts = len(values) // size
    if parts < 4 or size < 64:
        return None
    cut = values[: parts * size].reshape(parts, size, 3)
    window = np.hanning(size)[:, None]
    power = np.abs(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    density = 2 * median_of(power, axis=0).sum(axis=1) / (rate_hz * float((window**2).sum()))
    return np.asarray(np.fft.rfftfreq(size, 1 / rate_hz), dtype=np.float64), np.asarray(density, dtype=np.float64)


_PIECES, _FEWEST_PIECES, _IN_PIECE = 1000, 20, 20  # of samples
_EVEN, _UNEVEN, _TURNED = 0.7, 0.9, 0.02  # scatter of lengths, of the median; of directions, of all of them
_MORE = 1.5  # kurtosis of gravity over that of rates: 0.02 to 0.2 with rests, 1 to 1.2 where there are none
_STUCK_S = 0.25
_STUCK_AXIS_S, _OTHERS_MOVE, _MUCH_STUCK = 1.0, 0.3, 0.05
"""One axis alone: how long, the others' share of their range meanwhile, and from which share it is a problem."""
_NORMALISED = 0.1
_ZEROED = 3  # rests in which the same reading stands: no link hangs like that
_SILENT = 8.0  # noise levels; white noise alone stays below 6 in 10 million samples
_NOISE_SAMPLES = 10_000
_TURN_SAMPLES = 3000  # tell whether sensors take turns, as they do all the time
_MUCH_REPEATED = 0.02  # of all samples
_MAD, _TURNS, _FEWEST_TURNS = 1.4826, 2.0, 50  # standard deviations between the means by turns; turns
_LISTED, _MANY_ISOLATED = 6, 1e-3  # isolated readings; the share from which on others may hide among them


@kept_with_array
def axis_extremes(values: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and the largest value of each axis, (3,) each; column by column, which is fast."""
    columns = np.ascontiguousarray(values.T)
    return columns.min(axis=1), columns.max(axis=1)


def check_signal(samples: TriadSamples, label: str, beside: TriadSamples | None = None) -> list[Finding]:
    """Return findings on the values of one sensor, which another one beside it may contradict; linear time."""
    low, high = axis_extremes(samples.values)
    still = low == high
    if still.all():
        return [
            make_finding(
                "signal-constant",
                label=label,
                samples=len(samples),
                value=samples.values[0].tolist(),
                unit=samples.unit,
            )
        ]
    findings: list[Finding] = []
    copied = [
        k for k in range(3) if high[k] == high[k - 1] and np.array_equal(samples.values[:, k], samples.values[:, k - 1])
    ]
    if still.any() or copied:
        which = np.flatnonzero(still) if still.any() else sorted({axis % 3 for k in copied for axis in (k, k - 1)})
        axes = " and ".join("xyz"[axis] for axis in which)
        findings.append(make_finding("axis-constant", label=label, axes=axes, case="" if still.any() else "copied"))
    turns = look_or_postpone(lambda: check_turns(samples, label))
    findings += turns
    if not turns and ACCELEROMETER_UNITS_M_S2.get(samples.unit):
        values = samples.values[:_NOISE_SAMPLES]
        findings += check_magnitude(values, float(_noise(values).min()), label)
    findings += _isolated(samples, label)
    findings += _saturation(samples, label)
    stuck = _stuck(samples, label, beside) or _stuck_axis(samples, label)
    if all(finding.code != "dead-band" for finding in stuck):
        findings += dead_band_finding(*dead_bands(samples.values), label, samples.unit)
    findings += stuck
    findings += look_or_postpone(lambda: check_repeats(samples, label))
    return findings


def check_turns(samples: TriadSamples, label: str) -> list[Finding]:
    """Return a finding where every second, third or fourth sample is off from the others all the time."""
    values = samples.values[:_TURN_SAMPLES]
    for period in range(2, 5):
        count = len(values) // period - 1
        if count < _FEWEST_TURNS:
            break
        n = period * count
        off = values[:n] - sum(values[k : k + n] for k in range(period)) / period
        each = np.ascontiguousarray(off.reshape(count, period, 3).transpose(1, 2, 0))
        usual = median_of(each, axis=2)
        spread = _MAD * median_of(np.abs(each - usual[:, :, None]), axis=2).max(axis=0)
        size = np.ptp(usual, axis=0)
        if (size > _TURNS * spread).any():
            size_of_worst = float(size[np.argmax(size - _TURNS * spread)])
            return [make_finding("samples-by-turns", label=label, period=period, size=size_of_worst, unit=samples.unit)]
    return []


def check_magnitude(values: Floats, sigma: float, label: str) -> list[Finding]:
    """Return a finding where an accelerometer's magnitudes scatter far less than its noise: it was normalised."""
    sizes = np.linalg.norm(values, axis=1)
    if not sizes.std() < _NORMALISED * sigma:
        return []
    return [make_finding("magnitude-constant", label=label, size=sizes.mean())]


def dead_band_finding(values: Floats, places: Integers, label: str, unit: str) -> list[Finding]:
    """Return a finding on the axes (3,) in which a value stands for all near it, in as many places; else nothing."""
    worst = int(np.argmax(places))
    if not places[worst]:
        return []
    axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(places))
    return [make_finding("dead-band", label=label, axes=axes, value=values[worst], unit=unit, count=int(places[worst]))]


def check_repeats(samples: TriadSamples, label: str) -> list[Finding]:
    """Return a finding where stretches of samples occur twice; nothing where none does."""
    repeats = repeated_stretches(samples.values)
    copies = np.zeros(len(samples), dtype=bool)
    for repeat in repeats:
        copies[repeat.second : repeat.second_stop] = True
    share = float(copies.mean()) if repeats else 0.0
    if not repeats:
        return []
    t_s, longest = samples.t_s, max(repeats, key=lambda repeat: repeat.second_stop - repeat.second)
    begin, end = t_s[longest.second], t_s[longest.second_stop - 1]
    places = "" if len(repeats) == 1 else f", the longest of {len(repeats)} stretches"
    return [
        make_finding(
            "data-repeated",
            severity="problem" if share > _MUCH_REPEATED else "warning",
            label=label,
            begin=begin,
            end=end,
            at_s=t_s[longest.first],
            share=share,
            places=places,
        )
    ]


def copied_stretches(copies: Floats, share: float, label: str) -> list[Finding]:
    """Return a finding where stretches (k, 2) that begin at a time did so before [s], of samples that were streamed."""
    if not len(copies):
        return []
    return [
        make_finding(
            "data-repeated",
            severity="problem" if share > _MUCH_REPEATED else "warning",
            label=label,
            begin=copies[:, 0].min(),
            end=copies[:, 0].max(),
            at_s=copies[:, 1].min(),
            share=share,
            places="",
        )
    ]


def _isolated(samples: TriadSamples, label: str) -> list[Finding]:
    at = isolated_readings(samples.values)
    return [isolated_finding(samples.t_s[at], len(at) / len(samples), label)] if len(at) else []


def isolated_finding(at_s: Floats, share: float, label: str) -> Finding:
    """Return that single readings were left out.

    Parameters
    ----------
    at_s : (k,) when they were read [s from the start]
    share : of all samples
    """
    many = share > _MANY_ISOLATED
    return make_finding(
        "isolated-readings",
        severity="warning" if many else "info",
        case="many" if many else "",
        label=label,
        count=len(at_s),
        plural="s" * (len(at_s) > 1),
        share=share,
        times=", ".join(f"{t_s:.2f}" for t_s in at_s[:_LISTED]) + " ..." * (len(at_s) > _LISTED),
    )


def _saturation(samples: TriadSamples, label: str) -> Iterator[Finding]:
    marked = saturated_samples(samples)
    count = int(np.count_nonzero(marked))
    if not count:
        yield make_finding("saturation/none", label=label)
        return
    first = int(np.argmax(marked))
    end = float(np.abs(samples.values[marked]).max())
    yield make_finding(
        "saturation/clipped",
        label=label,
        end=_end_of_range(end, samples.unit),
        count=count,
        percent=100 * count / len(samples),
        at=_seconds(samples, first),
    )


def _end_of_range(value: float, unit: str) -> str:
    """Return an end of the range as data sheets state it, in deg/s or g, and in the unit of the recording."""
    turn, push = GYROSCOPE_UNITS_RAD_S.get(unit), ACCELEROMETER_UNITS_M_S2.get(unit)
    own = f"{value:.5g} {unit}"
    if turn:
        return own if unit == "deg/s" else f"{np.degrees(value * turn):.4g} deg/s ({own})"
    if push:
        return own if unit == "g" else f"{value * push / STANDARD_GRAVITY_M_S2:.3g} g ({own})"
    return own


def _seconds(samples: TriadSamples, index: int) -> float:
    return float(samples.t_ns[index] - samples.t_ns[0]) * 1e-9


def check_exchanged(accelerometer: TriadSamples, gyroscope: TriadSamples, label: str) -> list[Finding]:
    """Return a problem where the gyroscope reads one length in many directions, as of gravity, not the accelerometer.

    Units do not matter. A platter makes rates of one length, too, but leaves those that the accelerometer reads alike.
    Raw counts with large offsets may have any lengths, but are at rest most often, as a gyroscope's readings are.
    """
    uneven, turned, peaked = zip(*(_unevenness(triad.values) for triad in (accelerometer, gyroscope)), strict=True)
    if not (uneven[1] < _EVEN < _UNEVEN < uneven[0] and turned[1] > _TURNED and peaked[1] < _MORE * peaked[0]):
        return []
    return [make_finding("triads-exchanged", label=label)]


def _unevenness(values: Floats) -> tuple[float, float, float]:
    """Return by how much lengths of readings scatter, of their median, directions, from 0 to 1, and the kurtosis."""
    count = min(len(values) // _IN_PIECE, _PIECES)
    if count < _FEWEST_PIECES:
        return 0.0, 0.0, 0.0
    size = len(values) // count
    means = values[: size * count].reshape(count, size, 3).mean(axis=1)
    lengths = np.linalg.norm(means, axis=1, keepdims=True)
    low, middle, high = quantile_of(lengths, [0.1, 0.5, 0.9])
    direction = means / np.maximum(lengths, 1e-300)
    off, spread = means - means.mean(axis=0), means.std(axis=0)
    kurtosis = float(np.mean((off / np.where(spread > 0, spread, np.inf)) ** 4))
    return float(high - low) / max(float(middle), 1e-300), 1 - float(np.linalg.norm(direction.mean(axis=0))), kurtosis


def _stuck(samples: TriadSamples, label: str, beside: TriadSamples | None) -> list[Finding]:
    """Look for samples that repeat all three axes of the one before: held by the driver, or by a link that hung."""
    same = [samples.values[1:, axis] == samples.values[:-1, axis] for axis in range(3)]
    shares = [np.count_nonzero(axis) / len(axis) for axis in same]
    by_chance = float(np.prod(shares))
    repeats = same[0] & same[1] & same[2]
    count, held = int(np.count_nonzero(repeats)), float(held_samples(samples.values).mean())
    if not count:
        return [make_finding("samples-repeated", severity="info", case="held", label=label, share=held)] if held else []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], repeats, [False]])))
    runs = edges[1::2] - edges[::2]
    longest, first = int(runs.max()), int(edges[::2][np.argmax(runs)])
    least = max(5.0, _STUCK_S * samples.rate_hz)
    # Coarse steps repeat by chance; a run that chance would make less than once in a thousand recordings is none.
    chance = len(samples) * max(by_chance, 1e-300) ** min(longest, 300)
    share = count / len(repeats)
    if longest >= least and chance < 1e-3:
        again = (runs >= least) & (samples.values[edges[::2]] == samples.values[first]).all(axis=1)
        if again.sum() >= _ZEROED:
            return dead_band_finding(samples.values[first], np.full(3, again.sum()), label, samples.unit)
        much = longest > _MUCH_STUCK * len(samples) and _moves(beside, *samples.t_ns[[first, first + longest]])
        return [
            make_finding(
                "samples-stuck",
                severity="problem" if much else "warning",
                label=label,
                count=longest + 1,
                at=_seconds(samples, first),
            )
        ]
    # 1 where the axes repeat only together, 0 where each repeats on its own because its steps are coarse.
    together = (share - by_chance) / max(min(shares) - by_chance, 1e-3)
    slower = share > 0.2 and together > 0.5
    if not (slower or held):
        return []
    return [
        make_finding(
            "samples-repeated",
            severity="warning" if slower else "info",
            case="" if slower else "held",
            label=label,
            share=share if slower else held,
        )
    ]


def _moves(samples: TriadSamples | None, start_ns: int, stop_ns: int) -> bool:
    """Tell whether a sensor moves much between two instants."""
    if samples is None or not len(samples):
        return False
    part = samples.values[np.searchsorted(samples.t_ns, start_ns) : np.searchsorted(samples.t_ns, stop_ns)]
    return len(part) > 1 and bool((np.ptp(part, axis=0) > _OTHERS_MOVE * np.ptp(samples.values, axis=0)).any())


def _stuck_axis(samples: TriadSamples, label: str) -> list[Finding]:
    """Look for one axis that keeps its value while the others go on: not at rest, and not at the end of its range."""
    values = samples.values
    low, high = axis_extremes(values)
    spans = high - low
    least = max(5.0, _STUCK_AXIS_S * samples.rate_hz)
    for axis in range(3):
        same = values[1:, axis] == values[:-1, axis]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
        if not len(edges):
            continue
        k = int(np.argmax(edges[1::2] - edges[::2]))
        run = slice(int(edges[2 * k]), int(edges[2 * k + 1]) + 1)
        moved = np.ptp(values[run], axis=0) > _OTHERS_MOVE * spans
        inside = low[axis] < values[run.start, axis] < high[axis]
        if run.stop - run.start > least and inside and moved.sum() == 2:
            return [
                make_finding(
                    "axis-stuck",
                    severity="problem" if run.stop - run.start > _MUCH_STUCK * len(values) else "warning",
                    label=label,
                    axis="xyz"[axis],
                    t_from_s=_seconds(samples, run.start),
                    t_to_s=_seconds(samples, run.stop - 1),
                )
            ]
    return []


def is_silent(samples: TriadSamples) -> bool:
    """Tell whether a gyroscope shows nothing but noise."""
    noise = _noise(samples.values)
    middle = median_of(samples.values[:: max(1, len(samples) // _NOISE_SAMPLES)], axis=0)
    low, high = axis_extremes(samples.values)
    peak = np.maximum(high - middle, middle - low)
    return bool((peak <= _SILENT * noise).all())


def _noise(values: Floats) -> Floats:
    """Return the standard deviation (3,) of white noise with the same changes from sample to sample."""
    stride = max(1, len(values) // _NOISE_SAMPLES)
    steps = values[1::stride] - values[:-1:stride]
    return np.sqrt((steps**2).mean(axis=0) / 2)
