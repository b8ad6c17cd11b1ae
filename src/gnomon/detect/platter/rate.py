"""The rate of a turning platter from a video of it, by the periodicity of the picture (Angrisano's gyroscope test)."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np

from ...errors import DetectionError, OptionError
from ...findings import Finding
from ...frozen import value_class
from ...progress import Progress
from ...recording import Floats, frozen_array
from ...recording.recording import ImageStream
from .period import PictureSeries, RoughPeriod, read_pictures, rough_periods
from .phase import COARSE_HARMONICS, Followed, agreeing_share, follow_repetition, learn_template, refine_phases
from .steady import PhaseLine, blocks_of, even_rate
from .turn import (
    MEASURED_CLOCK,
    NOMINAL_CLOCK,
    UNCHECKED_CLOCK,
    PatternTurn,
    missing_frames,
    pattern_turn,
    rate_by_jitter,
    rate_findings,
    stamps_are_nominal,
)

FEWEST_TURNS = 3.0
FASTEST_RAD_S = 2000 * np.pi / 180
"""Full scale of most gyroscopes: no platter is taken to turn faster, unless its nominal rate says so."""
NOMINAL_TOLERANCE = 0.1
"""By so much a platter may differ from its nominal rate."""

_AGREEMENT = 0.6
_REPAIRS = 4
_SCARCELY, _CLEARLY = 3.5, 9.0  # sigma
_LITTLE_GREY, _MUCH_GREY, _MORE_THAN_NOISE = 0.3, 6.0, 2.0
_MOST_PER_TURN = 24
_FEWEST_CELLS = 64
_JITTER_AGREES, _JITTER_DIFFERS = 4.0, 6.0
_FIGURE_POINTS = 1500


@value_class
class PlatterRate:
    """The rate of a platter in a video.

    Attributes
    ----------
    rate_rad_s : its magnitude over the steady part [rad/s]
    sigma_rad_s : standard deviation of one rate, with that of the clock [rad/s]
    clock : relative standard deviation of the time that the timestamps tell, which is part of it
    turns : of the platter in the steady part
    steady_s : from when to when it turned evenly, from the first frame [s]
    duration_s : of the video [s]
    frames, frames_used : in the video, and in the steady part with the platter in sight
    frame_rate_hz : usual one
    per_turn : how often the picture repeats itself in a turn
    drift_rad_s : by how much the rate rises over the steady part, and the standard deviation of that
    periods_s, scores : (m,) for a figure: how strongly the picture repeats itself after each period
    phase_t_s, phase_turns : (k,) for a figure: phase of the platter less that of an even rate [s, turns]
    findings : what was noticed
    """

    rate_rad_s: float
    sigma_rad_s: float
    clock: float
    turns: float
    steady_s: tuple[float, float]
    duration_s: float
    frames: int
    frames_used: int
    frame_rate_hz: float
    per_turn: Fraction
    drift_rad_s: tuple[float, float]
    periods_s: Floats
    scores: Floats
    phase_t_s: Floats
    phase_turns: Floats
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        for name in ("periods_s", "scores", "phase_t_s", "phase_turns"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


def platter_rate(
    stream: ImageStream, nominal_rad_s: float | None = None, progress: Progress | None = None
) -> PlatterRate:
    """Measure the rate of a turning platter that a camera at rest looks at.

    The picture repeats itself with every turn, with or without a mark. It is learned as a function of the phase of
    that repetition, which then gives each frame its phase; the rate is the slope of the phases over many turns. How
    often the picture repeats itself in a turn follows from the motion of the pattern in the image.

    Parameters
    ----------
    stream : the video
    nominal_rad_s : what the rate should be, within 10 %; it decides where the picture leaves several rates open
    progress : called with a sentence from time to time

    Raises
    ------
    RecordingError
        If the video cannot be read.
    DetectionError
        If nothing moves in it, or nothing repeats itself, or the rate is not clear; the message says what to do.
    OptionError
        If the nominal rate is not positive.
    """
    if nominal_rad_s is not None and not (np.isfinite(nominal_rad_s) and nominal_rad_s > 0):
        raise OptionError(f"the nominal rate {nominal_rad_s!r} rad/s must be positive.")
    tell = progress or (lambda _: None)
    series = read_pictures(stream, progress)
    tell("looking for what repeats itself")
    if not _moves(series):
        raise DetectionError(
            f"nothing moves in this video ({_size(series)}). Does the platter turn, and is it in view? A platter that "
            "looks the same all around needs a mark: stick a piece of tape on it, away from the centre."
        )
    rough, followed, pattern = _best(series)
    series, followed, clock, missing = _with_missing_frames(series, followed)
    chosen = _resolved(series, followed, pattern, nominal_rad_s)
    followed = _with_missed_periods(series, followed, chosen.missed)
    found = _result(series, rough, followed, chosen.per_turn, clock)
    if found.turns < FEWEST_TURNS:
        raise DetectionError(
            f"the platter turns {found.turns:.1f} times at an even rate in this video, from {followed.start_s:.1f} to "
            f"{followed.stop_s:.1f} s; at least {FEWEST_TURNS:g} turns are needed. Record for a minute or more."
        )
    return replace(found, findings=rate_findings(found, missing, series.notes))


def _with_missing_frames(series: PictureSeries, followed: Followed) -> tuple[PictureSeries, Followed, float, int]:
    """Return video and phases with better times where timestamps merely count frames; also what the clock is worth.

    Returns
    -------
    series, followed : the same where nothing is missing
    clock : relative standard deviation of the time
    missing : number of missing frames
    """
    if not stamps_are_nominal(series.t_s):
        return series, followed, MEASURED_CLOCK, 0
    step, total = float(np.median(np.diff(series.t_s))), 0
    for _ in range(_REPAIRS):  # the picture is learned better when the times are
        index = np.flatnonzero(followed.used)
        t, line = series.t_s[index], followed.even.line
        template = learn_template(series.cells[index], line.rate * t + line.phase, COARSE_HARMONICS)
        phases = refine_phases(series.cells[index], template, line.rate * t + line.phase)
        missing, clearness = missing_frames(step, index, t, phases.phase)
        if clearness < _SCARCELY:
            return series, followed, UNCHECKED_CLOCK, total
        if not missing.any():
            return series, followed, NOMINAL_CLOCK if clearness > _CLEARLY else UNCHECKED_CLOCK, total
        before = missing[np.clip(np.searchsorted(index, np.arange(len(series.t_s)), side="right") - 1, 0, None)]
        moved = np.maximum.accumulate(series.t_s + step * before)
        moved += 1e-6 * step * np.arange(len(moved))  # repeated frames keep their order
        rate = line.rate * float(np.ptp(t) / np.ptp(moved[index]))
        rough = RoughPeriod(
            frequency_hz=rate / (2 * np.pi), start_s=float(moved[index[0]]), stop_s=float(moved[index[-1]])
        )
        again = follow_repetition(replace(series, t_s=moved), rough)
        if again is None:
            break
        series, followed = replace(series, t_s=moved), again
        total += int(np.abs(np.diff(missing)).sum())
    return series, followed, UNCHECKED_CLOCK, total


def _best(series: PictureSeries) -> tuple[RoughPeriod, Followed, PatternTurn]:
    """Return the first of the repetitions that is that of a turning platter, or else the first that holds."""
    second: tuple[RoughPeriod, Followed, PatternTurn] | None = None
    for rough in _candidates(series):
        followed = follow_repetition(series, rough)
        if followed is None or agreeing_share(series, followed) < _AGREEMENT:
            continue
        pattern = pattern_turn(followed.template, series.shape)
        if pattern.per_turn is not None and followed.periods >= FEWEST_TURNS * pattern.per_turn:
            return rough, followed, pattern
        second = second or (rough, followed, pattern)
    if second is None:
        raise DetectionError(
            f"nothing in this video ({_size(series)}) repeats itself evenly for {FEWEST_TURNS:g} turns. Record a "
            "minute at an even rate, with a camera at rest and most of the platter in view; put a mark on it if it "
            "looks the same all around."
        )
    return second


def _candidates(series: PictureSeries) -> Iterator[RoughPeriod]:
    """Yield what may repeat itself in the whole image, then in parts of it, where nothing else may move."""
    yield from rough_periods(series)
    rows, cols = series.shape
    places = np.arange(series.cells.shape[1]).reshape(rows, cols)
    for top, left in ((1, 1), (2, 2), (2, 0), (0, 2), (0, 0)):
        part = places[top * rows // 4 :, left * cols // 4 :][: rows // 2, : cols // 2]
        if part.size >= _FEWEST_CELLS:
            tile = PictureSeries(t_s=series.t_s, cells=series.cells[:, part.ravel()], shape=part.shape)
            yield from rough_periods(tile)[:1]


def _size(series: PictureSeries) -> str:
    return f"{len(series.t_s)} frames, {series.t_s[-1]:.1f} s"


def _moves(series: PictureSeries) -> bool:
    """Tell whether some cells change by more than their noise, which is much the same everywhere."""
    usual, most = np.percentile(series.cells.std(axis=0), [20, 99])
    return bool(most > _MUCH_GREY or most > max(_MORE_THAN_NOISE * usual, _LITTLE_GREY))


# ---- which rate it is ----


@value_class(eq=True)
class _Candidate:
    """A rate that the video may show.

    Attributes
    ----------
    rate : of the platter [rad/s]
    missed : whole periods of the picture that pass unseen from frame to frame; negative where it seems reversed
    per_turn : periods in a turn
    """

    rate: float
    missed: int
    per_turn: Fraction


def _resolved(series: PictureSeries, followed: Followed, pattern: PatternTurn, nominal: float | None) -> _Candidate:
    """Return the rate that the video shows; a DetectionError if none, or more than one, fits what is known."""
    seen = followed.even.line.rate
    frames = 2 * np.pi / float(np.median(np.diff(series.t_s)))
    folds = [Fraction(n) for n in range(1, _MOST_PER_TURN + 1)] if pattern.per_turn is None else [pattern.per_turn]
    fastest = max(FASTEST_RAD_S, (nominal or 0.0) * (1 + NOMINAL_TOLERANCE))
    possible: list[_Candidate] = []
    for fold in folds:
        most = int((float(fold) * fastest + seen) / frames)
        for missed in range(-most, most + 1):
            rate = abs(seen + missed * frames) / float(fold)
            fits = rate <= fastest if nominal is None else abs(rate / nominal - 1) <= NOMINAL_TOLERANCE
            if fits:
                possible.append(_Candidate(rate=rate, missed=missed, per_turn=fold))
    if len(possible) > 1:
        missed = _missed_by_jitter(series, followed, frames)
        possible = [one for one in possible if missed is None or one.missed == missed]
    if len(possible) != 1:
        raise DetectionError(_unclear(series, followed, pattern, possible, nominal))
    return possible[0]


def _with_missed_periods(series: PictureSeries, followed: Followed, missed: int) -> Followed:
    """Return the phases with whole periods added that passed unseen from frame to frame."""
    if missed == 0:
        return followed
    t = series.t_s[followed.used]
    number = np.rint((t - t[0]) / float(np.median(np.diff(series.t_s))))
    phase = followed.off + followed.even.line.rate * t + 2 * np.pi * missed * number
    slope, start = np.polyfit(t, phase, 1).tolist()
    line = PhaseLine(rate=slope, phase=start)
    off = phase - start - slope * t
    length, all_of = followed.blocks.length_s, np.ones(len(t), dtype=bool)
    sigma = np.full(len(t), float(np.std(off)))
    blocks = blocks_of(t, off, sigma, all_of, length_s=length, start_s=float(t[0]))
    even = even_rate(line, blocks)
    more = even.line.rate - slope
    return replace(followed, even=even, off=off - more * (t - t.mean()), blocks=blocks)


def _missed_by_jitter(series: PictureSeries, followed: Followed, frames: float) -> int | None:
    """Return how many periods pass unseen from frame to frame, as irregular timestamps tell; None where they do not."""
    more, sigma = rate_by_jitter(series.t_s[followed.used], followed.off)
    missed = round(more / frames)
    seen = followed.even.line.rate
    honest = abs(more + seen) > _JITTER_DIFFERS * sigma  # timestamps that err instead of the frames have no influence
    agrees = abs(more - missed * frames) < _JITTER_AGREES * sigma
    return missed if honest and agrees and frames > 2 * _JITTER_DIFFERS * sigma else None


def _unclear(
    series: PictureSeries, followed: Followed, pattern: PatternTurn, possible: list[_Candidate], nominal: float | None
) -> str:
    """Say why the rate is not clear, and what to do."""
    seen = followed.even.line.rate
    period = 2 * np.pi / seen
    fps = 1 / float(np.median(np.diff(series.t_s)))
    fact = f"the picture repeats itself every {period:.4g} s"
    if nominal is not None and not possible:
        fold = pattern.per_turn
        known = "" if fold is None else f", {_times(fold)} in a turn of the platter, at {_rpm(seen / float(fold))}"
        return (
            f"{fact}{known}; that does not agree with the nominal rate of {_rpm(nominal)} to "
            f"{100 * NOMINAL_TOLERANCE:.0f} %. Check the nominal rate, or leave it out."
        )
    if pattern.per_turn is None and nominal is None:
        return (
            f"{fact}, but its motion is not seen to be that of a turning platter, so that the number of periods in a "
            "turn is not clear. Give the nominal rate (--nominal), put one mark on the platter, or bring more of it "
            "into view."
        )
    rates = sorted({_rpm(one.rate) for one in possible})
    does = (
        f"which the platter does at {', '.join(rates[:6])}{', ...' if len(rates) > 6 else ''}"
        if rates
        else "which fits no rate of a platter"
    )
    return (
        f"{fact} as seen at {fps:.4g} frames per second, {does}. Give the nominal rate (--nominal), record at more "
        "frames per second, or put one mark on the platter."
    )


def _rpm(rate: float) -> str:
    return f"{rate * 30 / np.pi:.5g} rpm"


def _times(per_turn: Fraction) -> str:
    return "once" if per_turn == 1 else f"{per_turn} times"


# ---- the result ----


def _result(
    series: PictureSeries, rough: RoughPeriod, followed: Followed, per_turn: Fraction, clock: float
) -> PlatterRate:
    even = followed.even
    scale = 1 / float(per_turn)
    rate = abs(even.line.rate) * scale
    thin = slice(None, None, max(1, len(followed.off) // _FIGURE_POINTS))
    return PlatterRate(
        rate_rad_s=rate,
        sigma_rad_s=float(np.hypot(even.sigma * scale, clock * rate)),
        clock=clock,
        turns=rate * (followed.stop_s - followed.start_s) / (2 * np.pi),
        steady_s=(followed.start_s, followed.stop_s),
        duration_s=float(series.t_s[-1]),
        frames=len(series.t_s),
        frames_used=len(followed.off),
        frame_rate_hz=1 / float(np.median(np.diff(series.t_s))),
        per_turn=per_turn,
        drift_rad_s=(even.drift * scale, even.drift_sigma * scale),
        periods_s=rough.periods_s,
        scores=rough.scores,
        phase_t_s=series.t_s[followed.used][thin],
        phase_turns=followed.off[thin] * scale / (2 * np.pi),
    )
