"""The doctor's look at values: saturation, stuck axes and samples, a silent gyroscope."""

import numpy as np

from ..detect.samples.repeats import repeated_stretches
from ..detect.samples.saturation import saturated
from ..findings import Finding
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
            Finding(
                severity="problem",
                code="signal-constant",
                message=f"{label}: all {len(samples)} samples are {samples.values[0].tolist()} {samples.unit}.",
                consequence="The sensor measured nothing.",
                cure="Check that the sensor is switched on and that the right columns are read (--columns).",
            )
        ]
    findings: list[Finding] = []
    if still.any():
        axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(still))
        findings.append(
            Finding(
                severity="problem",
                code="axis-constant",
                message=f"{label}: axis {axes} never changes.",
                consequence="A three-axis calibration needs all three axes.",
                cure="Check that the right columns are read (--columns), and the sensor's configuration.",
            )
        )
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
        Finding(
            severity="problem" if share > _MUCH_REPEATED else "warning",
            code="data-repeated",
            message=f"{label}: the samples from {begin:.2f} to {end:.2f} s are those from {t_s[longest.first]:.2f} s "
            f"on once more, bit by bit ({100 * share:.2g} % of all samples are copies{places}).",
            consequence="Copies count as measurements of their own: sigmas are too small, and what was between them is "
            "not what the sensor did.",
            cure="Cut the copies out. A file may have been appended to itself, or a logger sent packets twice.",
        )
    ]


def _saturation(samples: TriadSamples, label: str) -> list[Finding]:
    marked = saturated(samples)
    count = int(np.count_nonzero(marked))
    if not count:
        return [Finding(severity="good", code="saturation", message=f"{label}: no sample is saturated.")]
    first = int(np.argmax(marked))
    end = float(np.abs(samples.values[marked]).max())
    return [
        Finding(
            severity="warning",
            code="saturation",
            message=f"{label} clips at {_end_of_range(end, samples.unit)}: {count} samples "
            f"({100 * count / len(samples):.2g} %) stand at the end of the range, "
            f"the first {_seconds(samples, first):.2f} s after the start.",
            consequence="They are masked; a rotation with masked samples in it is not used.",
            cure="Turn more slowly, or set a wider range.",
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
        return [
            Finding(
                severity="warning",
                code="samples-stuck",
                message=f"{label}: the same sample {longest + 1} times in a row from "
                f"{_seconds(samples, first):.2f} s after the start.",
                consequence="A stuck sensor looks like a perfect rest.",
                cure="Check the link to the sensor, and cut this part out of the recording.",
            )
        ]
    # 1 where the axes repeat only together, 0 where each repeats on its own because its steps are coarse.
    together = (share - by_chance) / max(min(shares) - by_chance, 1e-3)
    if share > 0.2 and together > 0.5:
        return [
            Finding(
                severity="warning",
                code="samples-repeated",
                message=f"{label}: {100 * share:.0f} % of the samples repeat the one before.",
                consequence="The sensor is slower than the recording; the noise and every sigma come out too small.",
                cure="Record at the rate of the sensor.",
            )
        ]
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
