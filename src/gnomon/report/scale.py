"""One direction of a panel: which numbers it reaches over, where they are drawn, and which of them are marked."""

from collections.abc import Sequence
from math import ceil, floor, isfinite, log10

import numpy as np

from ..recording import Floats
from .numbers import number, power_of_ten

_STEPS = (1.0, 2.0, 2.5, 5.0)


class Scale:
    """Numbers along one direction of a panel.

    Attributes
    ----------
    low, high : numbers at its two ends; the second may be the smaller one
    logarithmic : whether equal lengths are equal ratios
    ticks : numbers that are marked; None for round ones
    most : how many intervals there are between round ticks at most
    whole : whether round ticks are integers
    labelled : whether ticks have labels
    grid : whether lines are drawn across the panel at the ticks
    """

    def __init__(self, start: float, length: float, most: int) -> None:
        self.low, self.high = 0.0, 1.0
        self.logarithmic = False
        self.ticks: Sequence[float] | None = None
        self.most = most
        self.whole = False
        self.labelled = True
        self.grid = False
        self._start, self._length = start, length

    def span(self, low: float, high: float) -> None:
        """Let the panel reach from one number to another."""
        self.low, self.high = float(low), float(high)

    def places(self, values: Floats) -> Floats:
        """Return where numbers (...,) are drawn [figure units]; nan where a logarithm has no place for them."""
        low, high = self.low, self.high
        if self.logarithmic:
            values, low, high = np.log10(np.where(values > 0, values, np.nan)), log10(low), log10(high)
        return self.shares((values - low) / ((high - low) or 1.0))

    def shares(self, values: Floats) -> Floats:
        """Return where shares (...,) of the panel's length are drawn [figure units]."""
        return self._start + values * self._length

    def marks(self) -> list[tuple[float, str]]:
        """Return the ticks within the panel: where they are drawn, and their labels."""
        low, high = sorted((self.low, self.high))
        ticks = self.ticks
        if ticks is None:
            ticks = decades(low, high) if self.logarithmic else round_numbers(low, high, self.most, whole=self.whole)
        margin = 1e-9 * (high - low)
        inside = np.array([tick for tick in ticks if low - margin <= tick <= high + margin])
        return list(zip(self.places(inside).tolist(), map(self._label, inside.tolist()), strict=True))

    def _label(self, tick: float) -> str:
        if not self.logarithmic:
            return number(tick, 6)
        return number(tick, 3) if 1e-4 < tick < 1e4 else power_of_ten(round(log10(tick)))


def round_numbers(low: float, high: float, most: int, *, whole: bool = False) -> Sequence[float]:
    """Return the round numbers of a span, in the smallest steps that make so many intervals at most.

    Steps are 1, 2, 2.5 and 5 times a power of ten; `whole` leaves out those that are no integers, and 2.5 times. Where
    there would not be two numbers, smaller steps are taken.
    """
    least = (high - low) / most
    if not (isfinite(least) and least > 0):
        return ()
    power = floor(log10(least))
    steps = [step * 10.0**k for k in (power - 1, power, power + 1) for step in _STEPS]
    if whole:
        steps = [step * 10.0**k for k in range(max(power, 0) + 2) for step in _STEPS if step != 2.5]
    wanted = next(i for i, step in enumerate(steps) if step >= least * (1 - 1e-9))
    ticks: list[float] = []
    for step in reversed(steps[: wanted + 1]):
        ticks = [k * step for k in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]
        if len(ticks) > 1:
            break
    return ticks


def decades(low: float, high: float, most: int = 6) -> Sequence[float]:
    """Return the powers of ten of a span, or so many of them at equal distances."""
    first, last = ceil(log10(low) - 1e-9), floor(log10(high) + 1e-9)
    return [10.0**k for k in range(first, last + 1, max(1, -(-(last - first) // (most - 1))))]
