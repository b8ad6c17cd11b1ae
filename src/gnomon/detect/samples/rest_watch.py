"""What a long recording at rest looks like, window by window, read once and in little memory."""

from dataclasses import dataclass, field

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples
from ...results.result import Booleans
from .faults import on_lines

_WINDOW_S = 1.0
_FEWEST = 16
_GAP_PERIODS = 1.5
_PACKETS = 3.0
_PACKET_S = 0.5
_LOUD = 12.0  # sigmas of the variance of a window
_LOUDER = 3.0  # times the usual variance
_MOST_KEPT = 1 << 19  # samples: more than an hour at 100 Hz, 16 MiB


@value_class
class RestTable:
    """A recording in windows of about a second.

    Attributes
    ----------
    t_s : (k,) middle of the window [s from the origin]
    mean, variance, low, high : (k, 3) of the samples in it [unit]
    at_low, at_high : (k, 3) number of samples in it that are as low, as high as its lowest, its highest
    samples : number of samples in all
    rate_hz : mean sample rate, gaps left out [Hz]
    duration_s : from the first to the last sample [s]
    gaps : number of gaps
    lost : samples that are missing in them, about
    longest_gap_s, longest_gap_at_s : how long the longest one is, and where it begins [s from the origin]
    repeats : share of the samples that repeat the one before in all axes or lie on lines between others, and by how
        much it is more than by chance
    """

    t_s: Floats
    mean: Floats
    variance: Floats
    low: Floats
    high: Floats
    at_low: Floats
    at_high: Floats
    samples: int
    rate_hz: float
    duration_s: float
    gaps: int
    lost: int
    longest_gap_s: float
    longest_gap_at_s: float
    repeats: tuple[float, float]


@dataclass(slots=True, kw_only=True)
class RestWatch:
    """Looks at samples block by block; timestamps must not fall.

    Attributes
    ----------
    origin_ns : from which times are counted; the first sample where it is None
    samples : number of samples so far
    backward : index of the first sample whose timestamp lies before the one before it; None where there is none
    """

    origin_ns: int | None = None
    samples: int = 0
    backward: int | None = None
    _first: int = 0
    _unit: str = ""
    _kept: list[Floats] = field(default_factory=list[Floats])
    _kept_t: list[Integers] = field(default_factory=list[Integers])
    _width: int = 1
    _last: int | None = None
    _previous: Floats = field(default_factory=lambda: np.full((1, 3), np.nan))
    _period: float = 0.0
    _limit: float = 0.0
    _gaps: int = 0
    _gap_ns: float = 0.0
    _lost: float = 0.0
    _longest: tuple[float, int] = (0.0, 0)
    _repeats: Floats = field(default_factory=lambda: np.zeros(4))
    _on_lines: int = 0
    _window: int = 0
    _rest: Floats = field(default_factory=lambda: np.empty((0, 3)))
    _rest_t: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    _rows: list[Floats] = field(default_factory=list[Floats])

    def add(self, block: TriadSamples) -> None:
        """Take the next samples."""
        if not len(block):
            return
        if self._last is None:
            self._begin(block)
        self._stamps(block.t_ns)
        values = np.concatenate([self._previous, block.values])
        same = values[1:] == values[:-1]
        self._repeats += [*same.sum(axis=0), np.count_nonzero(same[:, 0] & same[:, 1] & same[:, 2])]
        self._on_lines += int(np.count_nonzero(on_lines(block.values)))
        self._previous = block.values[-1:]
        self._windows(block)
        self._keep(block)
        self.samples += len(block)

    def _keep(self, block: TriadSamples) -> None:
        whole = max(len(block) // self._width, 1) * self._width
        self._kept.append(_means_of(block.values[:whole], self._width))
        self._kept_t.append(block.t_ns[: whole : self._width][: len(self._kept[-1])])
        if sum(map(len, self._kept)) > _MOST_KEPT:
            self._width *= 2
            self._kept = [_means_of(np.concatenate(self._kept), 2)]
            self._kept_t = [np.concatenate(self._kept_t)[: 2 * len(self._kept[0]) : 2]]

    def thinned(self) -> TriadSamples:
        """Return all samples, or of a long recording means of as many as leave half a million."""
        return TriadSamples(
            t_ns=np.concatenate([np.empty(0, np.int64), *self._kept_t]),
            values=np.concatenate([np.empty((0, 3)), *self._kept]),
            unit=self._unit,
        )

    def _begin(self, block: TriadSamples) -> None:
        steps = np.diff(block.t_ns)
        self._first, self._unit = int(block.t_ns[0]), block.unit
        if self.origin_ns is None:
            self.origin_ns = self._first
        self._period = 1e9 / block.rate_hz if len(steps) else 0.0
        spread = 1.4826 * float(np.median(np.abs(steps - self._period))) if len(steps) else 0.0
        self._limit = _GAP_PERIODS * self._period + 3 * spread
        if len(steps) and np.median(steps) * _PACKETS < self._period:
            self._limit = max(self._limit, _PACKET_S * 1e9)  # samples that were stamped in packets
        self._window = max(_FEWEST, round(_WINDOW_S * 1e9 / self._period)) if self._period > 0 else _FEWEST

    def _stamps(self, t_ns: Integers) -> None:
        before = t_ns[:1] if self._last is None else np.array([self._last])
        steps = np.diff(t_ns, prepend=before)
        if self.backward is None and (steps < 0).any():
            self.backward = self.samples + int(np.argmax(steps < 0))
        gaps = np.flatnonzero(steps > self._limit) if self._limit > 0 else np.empty(0, np.int64)
        if len(gaps):
            self._gaps += len(gaps)
            self._gap_ns += float(steps[gaps].sum())
            self._lost += float(np.rint(steps[gaps] / self._period - 1).sum())
            longest = int(gaps[np.argmax(steps[gaps])])
            if steps[longest] > self._longest[0]:
                self._longest = float(steps[longest]), int(t_ns[longest] - steps[longest]) - (self.origin_ns or 0)
        self._last = int(t_ns[-1])

    def _windows(self, block: TriadSamples) -> None:
        t = np.concatenate([self._rest_t, block.t_ns - (self.origin_ns or 0)])
        values = np.concatenate([self._rest, block.values])
        count, width = len(t) // self._window, self._window
        whole = count * width
        if count:
            parts = values[:whole].reshape(count, width, 3)
            middle = parts[:, :1]
            centred = parts - middle
            mean = centred.mean(axis=1)
            variance = np.maximum(np.einsum("kwi,kwi->ki", centred, centred) / width - mean**2, 0)
            t_s = t[:whole].reshape(count, width).mean(axis=1, keepdims=True)[:, 0] * 1e-9
            low, high = parts.min(axis=1), parts.max(axis=1)
            variance *= width / (width - 1)
            ends = [np.count_nonzero(parts == end[:, None], axis=1) for end in (low, high)]
            self._rows.append(np.column_stack([t_s, mean + middle[:, 0], variance, low, high, *ends]))
        self._rest, self._rest_t = values[whole:], t[whole:]

    def table(self) -> RestTable:
        """Return what was seen."""
        rows = np.concatenate([np.empty((0, 19)), *self._rows])
        *axes, repeats = (self._repeats / max(self.samples - 1, 1)).tolist()
        filled = self._on_lines / max(self.samples, 1)
        span = 0.0 if self._last is None else float(self._last - self._first)
        steps = self.samples - 1 - self._gaps
        duration = span - self._gap_ns
        return RestTable(
            t_s=rows[:, 0],
            mean=rows[:, 1:4],
            variance=rows[:, 4:7],
            low=rows[:, 7:10],
            high=rows[:, 10:13],
            at_low=rows[:, 13:16],
            at_high=rows[:, 16:19],
            samples=self.samples,
            rate_hz=1e9 * steps / duration if duration > 0 and steps > 0 else float("nan"),
            duration_s=span * 1e-9,
            gaps=self._gaps,
            lost=round(self._lost),
            longest_gap_s=self._longest[0] * 1e-9,
            longest_gap_at_s=self._longest[1] * 1e-9,
            repeats=(repeats + filled, repeats + filled - float(np.prod(axes))),
        )


def _means_of(values: Floats, width: int) -> Floats:
    """Return the means of `width` neighbours each, (n // width, 3); an incomplete last one is left out."""
    count = len(values) // width
    return values[: count * width].reshape(count, width, 3).mean(axis=1)


@value_class
class Stir:
    """When something moved, (k,) windows, and the share of the squares that it added."""

    windows: Booleans
    share: float


def find_stir(table: RestTable) -> Stir:
    """Return the windows that are louder than the others.

    `detect_rests` does not tell that: its threshold is the one by which many attitudes calibrate an accelerometer best,
    and it holds all samples. Here is one attitude for hours, read once, also of a gyroscope alone.
    """
    usual = np.median(table.variance, axis=0)
    samples = max(table.samples / max(len(table.t_s), 1), 2.0)
    # The variances of filtered noise scatter more than those of white noise.
    spread = 1.4826 * np.median(np.abs(table.variance - usual), axis=0)
    limit = np.maximum(usual * max(_LOUDER, 1 + _LOUD * np.sqrt(2 / samples)), usual + _LOUD * spread)
    loud = (table.variance > limit) & (usual > 0)
    added = np.where(loud, table.variance - usual, 0.0).sum(axis=0) / np.maximum(table.variance.sum(axis=0), 1e-300)
    return Stir(windows=np.asarray(loud.any(axis=1), dtype=bool), share=float(added.max(initial=0.0)))
