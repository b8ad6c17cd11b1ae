"""From a rough period to the phase of every picture and its even rise: by turns learning what repeats, and when."""

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from .period import PictureSeries, RoughPeriod
from .phase import COARSE_HARMONICS, MOST_HARMONICS, PhaseTemplate, learn_template, place_phases, refine_phases
from .steady import (
    DeviationMeans,
    EvenRate,
    PhaseLine,
    block_length,
    blocks_of,
    coherent_line,
    even_rate,
    longest_run,
    steady_blocks,
)

_NEAR = 0.6  # rad
_SEEN, _CLEAR = 0.3, 0.75
"""Share of a picture that must be as expected for its phase, and for learning from it, as a part of the usual share."""
_PASSES = 8
_SETTLED = 0.05  # sigma
_FEWEST_PICTURES = 24
_FEWEST_PERIODS = 2.5
_FEWEST_BLOCKS = 4
_MARGIN, _LARGEST_MARGIN = 2.0, 0.1
"""Left out beside starts and stops: periods, or a part of the whole."""
_FEWEST_PER_BLOCK = 4
_COMB = 16  # a rough frequency is within 1 / (16 spans)


@value_class
class Followed:
    """A repetition that was followed through the video.

    Attributes
    ----------
    even : its rate over the steady part
    template : the picture over the phase
    start_s, stop_s : the steady part [s]
    used : (n,) which pictures of the video tell the rate
    off : (n,) phase less that of the line [rad]; of the used ones
    blocks : of the steady part
    """

    even: EvenRate
    template: PhaseTemplate
    start_s: float
    stop_s: float
    used: Booleans
    off: Floats
    blocks: DeviationMeans

    @property
    def periods(self) -> float:
        """Number of periods in the steady part."""
        return self.even.line.rate * (self.stop_s - self.start_s) / (2 * np.pi)


def follow_repetition(series: PictureSeries, rough: RoughPeriod) -> Followed | None:
    """Follow a repetition from the window where it was seen through the whole video; None where it is none."""
    t = series.t_s
    everywhere = np.ones(len(t), dtype=bool)
    learn = (t >= rough.start_s) & (t <= rough.stop_s)
    line = PhaseLine(rate=2 * np.pi * rough.frequency_hz, phase=0.0)
    found: Followed | None = None
    for where in (learn, everywhere, everywhere):
        if learn.sum() < _FEWEST_PICTURES:
            return None
        template = learn_template(series.cells[learn], line.rate * t[learn] + line.phase)
        phase = place_phases(series.cells, template)
        if found is None:
            width = 4 * np.pi / _COMB / max(float(np.ptp(t[learn])), 1e-9)
            line = coherent_line(t[where], phase[where], line.rate, width)
        start, stop = _longest_near(t, np.abs(line.off(t, phase)) < _NEAR, 2 * np.pi / line.rate)
        learn = (t >= start) & (t < stop) & (np.abs(line.off(t, phase)) < _NEAR)
        if where is everywhere:
            found = _refined(series, line, learn, (start, stop))
            if found is None:
                return None
            line, learn = found.even.line, found.used
    return found


def _longest_near(t: Floats, near: Booleans, period_s: float) -> tuple[float, float]:
    """Return from when to when most pictures are near the line."""
    length = max(period_s, _FEWEST_PER_BLOCK * float(np.median(np.diff(t))))
    number = np.floor((t - t[0]) / length).astype(np.int64)
    share = np.bincount(number, weights=near) / np.maximum(np.bincount(number), 1)
    run = longest_run(np.flatnonzero(share > 0.5))
    if not len(run):
        return 0.0, 0.0
    return float(t[0] + length * run[0]), float(t[0] + length * (run[-1] + 1))


def _refined(series: PictureSeries, line: PhaseLine, learn: Booleans, part: tuple[float, float]) -> Followed | None:
    """Learn the picture and find phases and line by turns, within a part of the video that shrinks to what is steady.

    Parameters
    ----------
    learn : (n,) which pictures to learn from
    part : from when to when [s]
    """
    found: Followed | None = None
    uneven = (np.zeros(1), np.zeros(1))
    trimmed = False
    for turn in range(_PASSES):
        inside = np.flatnonzero((series.t_s >= part[0]) & (series.t_s < part[1]))
        t, cells = series.t_s[inside], series.cells[inside]
        periods = line.rate * (part[1] - part[0]) / (2 * np.pi)
        if learn.sum() < _FEWEST_PICTURES or periods < _FEWEST_PERIODS:
            return None
        expected = line.rate * series.t_s + line.phase + np.interp(series.t_s, *uneven)
        template = learn_template(series.cells[learn], expected[learn], MOST_HARMONICS if turn else COARSE_HARMONICS)
        phases = refine_phases(cells, template, expected[inside])
        off = line.off(t, phases.phase)
        good = (phases.seen > _SEEN) & (np.abs(off) < _NEAR)
        length = block_length(periods, 2 * np.pi / line.rate)
        blocks = blocks_of(t, off, phases.sigma, good, length_s=length, start_s=part[0])
        blocks = blocks.chosen(steady_blocks(blocks))
        if len(blocks.off) < _FEWEST_BLOCKS:
            return None
        even = even_rate(line, blocks)
        uneven = blocks.t_s, even.line.off(blocks.t_s, blocks.off + line.rate * blocks.t_s + line.phase)
        settled = turn > 0 and np.abs(np.subtract(part, blocks.span)).max() < 0.5 * blocks.length_s
        settled = settled and abs(even.line.rate - line.rate) < _SETTLED * even.sigma
        part = max(part[0], blocks.span[0]), min(part[1], blocks.span[1])
        kept = good & (t >= part[0]) & (t < part[1])
        line = even.line
        used = np.zeros(len(series.t_s), dtype=bool)
        used[inside[kept]] = True
        learn = used.copy()
        learn[inside[phases.seen < _CLEAR * np.median(phases.seen)]] = False
        found = Followed(
            even=even,
            template=template,
            start_s=float(t[kept][0]),
            stop_s=float(t[kept][-1]),
            used=used,
            off=line.off(t[kept], phases.phase[kept]),
            blocks=blocks,
        )
        if settled:
            inner = part if trimmed else _off_the_ends(part, series.t_s, 2 * np.pi / line.rate)
            if inner == part:
                break
            part, trimmed = inner, True
    return found


def _off_the_ends(part: tuple[float, float], t_s: Floats, period_s: float) -> tuple[float, float]:
    """Return the part without some periods where the platter starts or stops: it comes to its speed by and by."""
    margin = min(_MARGIN * period_s, _LARGEST_MARGIN * (part[1] - part[0]))
    start, stop = part
    return (
        start + margin if start > t_s[0] + period_s else start,
        stop - margin if stop < t_s[-1] - period_s else stop,
    )


def agreeing_share(series: PictureSeries, followed: Followed) -> float:
    """Return the share of pictures that are near the line by what pictures of other periods look like."""
    line = followed.even.line
    t, cells = series.t_s[followed.used], series.cells[followed.used]
    phase = line.rate * t + line.phase
    odd = np.floor(phase / (2 * np.pi)) % 2 == 1
    near = 0
    for one in (odd, ~odd):
        if one.sum() < _FEWEST_PICTURES // 2 or (~one).sum() < _FEWEST_PICTURES // 2:
            return 0.0
        placed = place_phases(cells[one], learn_template(cells[~one], phase[~one]))
        near += int((np.abs(line.off(t[one], placed)) < _NEAR).sum())
    return near / len(t)
