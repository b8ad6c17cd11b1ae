"""From timestamps to the instants of sampling."""

from typing import Literal

import numpy as np

from ...frozen import value_class
from ...recording import Floats, TriadSamples, frozen_array

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
