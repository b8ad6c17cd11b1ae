"""The doctor's look at values: saturation, stuck axes and samples, a silent gyroscope."""

import numpy as np

from ..detect.samples.repeats import repeated_stretches
from ..detect.samples.saturation import saturated
from ..findings import Finding, make_finding
from ..recording import Floats, TriadSamples
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2

_STUCK_S = 0.25
_SILENT = 8.0  # noise levels; white noise alone stays below 6 in 10 million samples
_NOISE_SAMPLES = 10_000
_MUCH_REPEATED = 0.02  # of all samples


def extremes(values: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and the largest value of each axis, (3,) each; column by column, which is fast."""
    columns = [values[:, axis] for axis in range(3)]
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def check_signal(samples: TriadSamples, label: str) -> list[Finding]:
    """Return findings on the values of one sensor; linear time."""
    low, high = extremes(samples.values)
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
    if still.any():
        axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(still))
        findings.append(make_finding("axis-constant", label=label, axes=axes))
    findings += _saturation(samples, label)
    findings += _stuck(samples, label)
    findings += check_repeats(samples, label)
    return findings


def check_repeats(samples: TriadSamples, label: str) -> list[Finding]:
    """Return a finding where stretches of samples occur twice, bit by bit; nothing where none does."""
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


def _saturation(samples: TriadSamples, label: str) -> list[Finding]:
    marked = saturated(samples)
    count = int(np.count_nonzero(marked))
    if not count:
        return [make_finding("saturation/none", label=label)]
    first = int(np.argmax(marked))
    end = float(np.abs(samples.values[marked]).max())
    return [
        make_finding(
            "saturation/clipped",
            label=label,
            end=_end_of_range(end, samples.unit),
            count=count,
            percent=100 * count / len(samples),
            at=_seconds(samples, first),
        )
    ]


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


def _stuck(samples: TriadSamples, label: str) -> list[Finding]:
    """Look for samples that repeat all three axes of the one before: held by the driver, or by a link that hung."""
    same = [samples.values[1:, axis] == samples.values[:-1, axis] for axis in range(3)]
    shares = [np.count_nonzero(axis) / len(axis) for axis in same]
    by_chance = float(np.prod(shares))
    repeats = same[0] & same[1] & same[2]
    count = int(np.count_nonzero(repeats))
    if not count:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], repeats, [False]])))
    runs = edges[1::2] - edges[::2]
    longest, first = int(runs.max()), int(edges[::2][np.argmax(runs)])
    least = max(5.0, _STUCK_S * samples.rate_hz)
    # Coarse steps repeat by chance; a run that chance would make less than once in a thousand recordings is none.
    chance = len(samples) * max(by_chance, 1e-300) ** min(longest, 300)
    share = count / len(repeats)
    if longest >= least and chance < 1e-3:
        return [make_finding("samples-stuck", label=label, count=longest + 1, at=_seconds(samples, first))]
    # 1 where the axes repeat only together, 0 where each repeats on its own because its steps are coarse.
    together = (share - by_chance) / max(min(shares) - by_chance, 1e-3)
    if share > 0.2 and together > 0.5:
        return [make_finding("samples-repeated", label=label, share=share)]
    return []


def is_silent(samples: TriadSamples) -> bool:
    """Tell whether a gyroscope shows nothing but noise."""
    noise = _noise(samples.values)
    middle = np.median(samples.values[:: max(1, len(samples) // _NOISE_SAMPLES)], axis=0)
    low, high = extremes(samples.values)
    peak = np.maximum(high - middle, middle - low)
    return bool((peak <= _SILENT * noise).all())


def _noise(values: Floats) -> Floats:
    """Return the standard deviation (3,) of white noise with the same changes from sample to sample."""
    stride = max(1, len(values) // _NOISE_SAMPLES)
    steps = values[1::stride] - values[:-1:stride]
    return np.sqrt((steps**2).mean(axis=0) / 2)
