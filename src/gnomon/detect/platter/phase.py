"""Where in its period each picture is: all pictures against one that depends on the phase."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from .period import Pictures, PictureSeries, RoughPeriod
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

MOST_HARMONICS, COARSE_HARMONICS = 32, 4
"""Of the picture over the phase; few where the phases that it is learned from are not yet right: its sharp features,
learned in several places, would hold the pictures there."""
_RIDGE = 1e-3
_PHASES = 240
_CHUNK = 2048
_FOR_SPREAD = 250  # pictures
_LARGEST_STEP = 0.3  # rad
_OUTLYING = 4.0  # sigma of a cell
_MISMATCH = 0.08  # of what a cell changes by at most, which the series may be wrong by
_SLACK_RAD = (0.1, 0.05, 0.02, 0.02)
"""Errors of the phase, pass by pass, that do not make a cell an outlier."""
_MOST_CELLS = 300
_WORST_CONDITION = 30.0
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
class PhaseTemplate:
    """The picture as a harmonic series of the phase.

    Attributes
    ----------
    coefficients : (2 h + 1, cells) constant, then cosine and sine of each harmonic, in turn
    sigma : (cells,) by which pictures differ from it [grey]
    sampled : how many of the harmonics the phases of the pictures tell apart
    """

    coefficients: Pictures
    sigma: NDArray[np.float32]
    sampled: int

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.coefficients) // 2

    def maps(self) -> NDArray[np.complex64]:
        """Return the complex amplitude of each harmonic in each cell, (h, cells): their real part at phase 0."""
        return (self.coefficients[1::2] - 1j * self.coefficients[2::2]).astype(np.complex64)


@value_class
class Phases:
    """Phase of each picture, each by itself.

    Attributes
    ----------
    phase : (n,) [rad]
    sigma : (n,) of it, as the noise of the cells has it [rad]
    seen : (n,) share of what changes with the phase that is as it should be; low where something is in the way
    """

    phase: Floats
    sigma: Floats
    seen: Floats


def harmonic_basis(phase: Floats, harmonics: int) -> NDArray[np.float32]:
    """Return 1, cos, sin, cos 2, sin 2, ... of phases, (n, 2 h + 1)."""
    angle = phase[:, None] * np.arange(1, harmonics + 1)
    basis = np.ones((len(phase), 2 * harmonics + 1), np.float32)
    basis[:, 1::2], basis[:, 2::2] = np.cos(angle), np.sin(angle)
    return basis


def _derivative(basis: NDArray[np.float32]) -> NDArray[np.float32]:
    order = np.arange(1, basis.shape[1] // 2 + 1, dtype=np.float32)
    slope = np.zeros_like(basis)
    slope[:, 1::2], slope[:, 2::2] = -order * basis[:, 2::2], order * basis[:, 1::2]
    return slope


def learn_template(cells: Pictures, phase: Floats, most: int = MOST_HARMONICS) -> PhaseTemplate:
    """Fit a harmonic series of the phase to each cell; what is seldom in the way is left out.

    Parameters
    ----------
    cells : (n, cells) pictures
    phase : (n,) assumed [rad]
    most : harmonics; few where the phases are not yet well known
    """
    harmonics = max(1, min(most, len(phase) // 8))
    basis = harmonic_basis(phase, harmonics)
    ridge = _RIDGE * len(phase) * np.repeat(np.arange(harmonics + 1), 2)[1:] ** 2 / 16
    normal = basis.T @ basis + np.diag(ridge).astype(np.float32)
    inverse: Any = np.linalg.inv(normal.astype(np.float64)).astype(np.float32)
    coefficients: Any = inverse @ (basis.T @ cells)
    residual: Any = cells - basis @ coefficients
    limit = 2 * _spread(residual)
    np.clip(residual, -limit, limit, out=residual)
    coefficients += inverse @ (basis.T @ residual)
    some = slice(None, None, _stride(cells))
    rest: Any = cells[some] - basis[some] @ coefficients
    sigma = _spread(rest)
    return PhaseTemplate(coefficients=coefficients, sigma=sigma, sampled=_sampled_harmonics(basis, harmonics))


def _stride(cells: Pictures) -> int:
    return max(1, len(cells) // _FOR_SPREAD)


def _spread(residual: Pictures) -> NDArray[np.float32]:
    """Return a robust standard deviation of each cell, at least half of the usual one."""
    some = np.ascontiguousarray(np.abs(residual[:: _stride(residual)]).T)
    sigma = 1.4826 * np.median(some, axis=1)
    return np.maximum(sigma, 0.5 * np.median(sigma) + 0.05).astype(np.float32)


def _sampled_harmonics(basis: NDArray[np.float32], harmonics: int) -> int:
    """Return how many harmonics can be told apart where the platter stands at few phases only."""
    whole = basis.T @ basis
    for count in range(harmonics, 0, -1):
        if np.linalg.cond(whole[: 2 * count + 1, : 2 * count + 1]) < _WORST_CONDITION:
            return count
    return 0


def place_phases(cells: Pictures, template: PhaseTemplate) -> Floats:
    """Return the likeliest phase of each picture, (n,) [rad], of all phases there are."""
    trial = np.arange(_PHASES) * (2 * np.pi / _PHASES)
    weight = 1 / template.sigma**2
    models = _over_a_period(template)
    cost = 0.5 * (models**2) @ weight
    found = np.empty(len(cells))
    for first in range(0, len(cells), _CHUNK):
        part = cells[first : first + _CHUNK] - template.coefficients[0]
        limit = 6 * template.sigma + np.abs(models).max(axis=0)
        score = (np.clip(part, -limit, limit) * weight) @ models.T - cost
        found[first : first + _CHUNK] = trial[np.argmax(score, axis=1)]
    return found


def refine_phases(cells: Pictures, template: PhaseTemplate, phase: Floats) -> Phases:
    """Return the phase of each picture to a part of a cell, with gain and offset of the picture, robustly.

    Parameters
    ----------
    cells : (n, cells) pictures
    template : what they look like
    phase : (n,) where to start [rad]
    """
    telling = _telling_cells(template)
    part_of = PhaseTemplate(
        coefficients=template.coefficients[:, telling], sigma=template.sigma[telling], sampled=template.sampled
    )
    parts = [
        _refined(cells[first : first + _CHUNK, telling], part_of, phase[first : first + _CHUNK])
        for first in range(0, len(cells), _CHUNK)
    ]
    return Phases(
        phase=np.concatenate([part.phase for part in parts]),
        sigma=np.concatenate([part.sigma for part in parts]),
        seen=np.concatenate([part.seen for part in parts]),
    )


def _telling_cells(template: PhaseTemplate) -> NDArray[np.int64]:
    """Return the cells that tell most of the phase."""
    order = np.repeat(np.arange(1, template.harmonics + 1), 2)[:, None]
    information = (np.square(order * template.coefficients[1:])).sum(axis=0) / np.square(template.sigma)
    return np.argsort(-information)[:_MOST_CELLS]


def _refined(cells: Pictures, template: PhaseTemplate, phase: Floats) -> Phases:
    phase = phase.astype(np.float64)
    count = len(phase)
    gain, offset = np.ones(count), np.zeros(count)
    constant = np.ones_like(cells)
    wrong = np.square(_MISMATCH * np.ptp(_over_a_period(template), axis=0))
    variance, seen = np.full(count, np.inf), np.zeros(count)
    for slack in _SLACK_RAD:
        basis = harmonic_basis(phase, template.harmonics)
        model = basis @ template.coefficients
        slope = _derivative(basis) @ template.coefficients
        residual = cells - gain[:, None].astype(np.float32) * model - offset[:, None].astype(np.float32)
        expected = np.square(template.sigma) + wrong + np.square(np.float32(slack) * slope)
        trust = np.square(np.clip(1 - np.square(residual) / (_OUTLYING**2 * expected), 0, None))
        weight = trust / (np.square(template.sigma) + wrong)
        columns = (model, constant, slope)
        normal = np.empty((count, 3, 3))
        right = np.empty((count, 3))
        for i, one in enumerate(columns):
            weighted = weight * one
            right[:, i] = np.einsum("np,np->n", weighted, residual)
            for j in range(i, 3):
                normal[:, i, j] = normal[:, j, i] = np.einsum("np,np->n", weighted, columns[j])
        normal += np.eye(3) * (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        gain = np.clip(gain + step[:, 0], 0.2, 5.0)
        offset = offset + step[:, 1]
        phase = phase + np.clip(step[:, 2] / gain, -_LARGEST_STEP, _LARGEST_STEP)
        variance = np.linalg.inv(normal)[:, 2, 2] / gain**2
        information = np.square(slope) / (np.square(template.sigma) + wrong)
        seen = np.einsum("np,np->n", trust, information) / np.maximum(information.sum(axis=1), 1e-12)
    return Phases(phase=phase, sigma=np.sqrt(np.maximum(variance, 1e-12)), seen=seen)


def _over_a_period(template: PhaseTemplate) -> Pictures:
    """Return what changes with the phase, at phases all around."""
    trial = np.arange(_PHASES, dtype=np.float64) * (2 * np.pi / _PHASES)
    return harmonic_basis(trial, template.harmonics)[:, 1:] @ template.coefficients[1:]


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
            found = _refined_phase(series, line, learn, (start, stop))
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


def _refined_phase(
    series: PictureSeries, line: PhaseLine, learn: Booleans, part: tuple[float, float]
) -> Followed | None:
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
