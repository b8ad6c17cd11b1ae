"""Is the noise of a resting sensor the same all the time? Levels by segments, frozen and clipped samples, patterns."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import erf, sqrt

import numpy as np

from ...detect.samples.rest_watch import RestTable
from ...estimate.allan.patterns import HighPass, MeansPattern, find_high_pass, find_pattern, find_steps
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans

_SEGMENTS, _FEWEST_WINDOWS = 12, 5
_UNEVEN = 5.0  # sigmas of a segment's level
_UNEVEN_WARN = 0.05  # of the noise, standard deviation over time
_MAD = 1.4826
_MOST_FROZEN = 0.3
_COARSE = 0.5  # steps in a standard deviation: below, whole windows may show one value
_FEWEST_CLIPPED, _CLIPPED_WARN, _CLIPPED_FAIL = 20, 1e-4, 0.04
_CLIPPED = 4.0  # times as many samples at the end as a normal law has there
_WORDS = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}


@value_class
class Stationarity:
    """How the noise of a triad changes over the recording.

    Attributes
    ----------
    frozen : (k, 3) windows in which an axis shows one value throughout, though it does not elsewhere
    clipped : (3,) share of samples at an end of the range
    spread : (3,) relative standard deviation of the noise density over time, beyond chance
    level : (segments, 3) noise of each segment, relative to the mean one
    patterns : of each axis, or None; those that are not sure widen sigmas, too
    high_pass : what takes slow errors away, or None
    """

    frozen: Booleans
    clipped: Floats
    spread: Floats
    level: Floats
    patterns: tuple[MeansPattern | None, ...]
    high_pass: HighPass | None


def dead_windows(table: RestTable, step: Floats) -> Booleans:
    """Return the windows in which some axis is frozen, (k,)."""
    return np.asarray(frozen_windows(table, step).any(axis=1), dtype=bool)


def frozen_windows(table: RestTable, step: Floats) -> Booleans:
    """Return the windows in which an axis shows one value, though its noise is not hidden by its steps, (k, 3)."""
    usual = np.sqrt(np.median(table.variance, axis=0))
    if not len(table.t_s):
        return np.zeros((0, 3), dtype=bool)
    loud = np.sqrt(np.quantile(table.variance, 0.9, axis=0))
    fine = np.maximum(usual, loud) > _COARSE * np.where(np.isfinite(step), step, 0.0)
    return np.asarray((table.low == table.high) & fine, dtype=bool)


def judge_stationarity(table: RestTable, step: Floats) -> Stationarity:
    """Return how the noise changes over the recording.

    Parameters
    ----------
    step : (3,) smallest change of each axis [unit]; nan where not known
    """
    frozen = frozen_windows(table, step)
    spread, level = _levels(table)
    patterns = [find_pattern(table.mean[~frozen[:, axis], axis], table.duration_s) for axis in range(3)]
    if (spread <= _UNEVEN_WARN).all():
        steps = find_steps(table.mean[~frozen.any(axis=1)], table.duration_s)
        patterns = [
            other if other and not (one and one.sure) else one for one, other in zip(patterns, steps, strict=True)
        ]
    interval_s = table.samples / table.rate_hz / max(len(table.t_s), 1)
    waves = np.array([one is not None and one.sure and one.kind == "wave" for one in patterns])
    filtered = find_high_pass(table.mean[~frozen.any(axis=1)], interval_s)
    if filtered is not None and (filtered.axes & waves).any():  # below the wave there is less, too
        filtered = replace(filtered, axes=filtered.axes & ~waves) if (filtered.axes & ~waves).any() else None
    return Stationarity(
        frozen=frozen,
        clipped=np.array([_clipped(table, step, axis, ~frozen[:, axis]) for axis in range(3)]),
        spread=spread,
        level=level,
        patterns=tuple(patterns),
        high_pass=filtered,
    )


def _levels(table: RestTable) -> tuple[Floats, Floats]:
    """Return the spread of the noise over segments of time, (3,), and its level in each, (segments, 3)."""
    k = len(table.t_s)
    count = min(_SEGMENTS, k // _FEWEST_WINDOWS)
    if count < 2:
        return np.zeros(3), np.ones((1, 3))
    parts = np.array_split(table.variance, count)
    middle = np.stack([np.median(part, axis=0) for part in parts])
    chance = np.stack([
        1.2533 * _MAD * np.median(np.abs(part - one), axis=0) / np.sqrt(len(part))
        for part, one in zip(parts, middle, strict=True)
    ])  # fmt: skip
    usual = np.maximum(np.median(table.variance, axis=0), 1e-300)
    level = np.sqrt(middle / np.maximum(middle.mean(axis=0), 1e-300))
    sigma = np.median(chance, axis=0) / usual / 2
    away = np.abs(level - level.mean(axis=0)).max(axis=0)
    spread = np.sqrt(np.maximum(level.var(axis=0) - sigma**2, 0.0))
    return np.where(away > _UNEVEN * sigma, spread, 0.0), level


def _clipped(table: RestTable, step: Floats, axis: int, kept: Booleans) -> float:
    """Return the share of the samples of an axis at an end of its range, where a normal law has far fewer."""
    if not kept.any():
        return 0.0
    window = table.samples / max(len(table.t_s), 1)
    total = window * float(kept.sum())
    sigma = float(np.sqrt(np.median(table.variance[kept, axis]) + np.var(table.mean[kept, axis])))
    half = float(step[axis]) / 2 if np.isfinite(step[axis]) else 0.0
    share = 0.0
    for ends, counts, end in (
        (table.low[kept, axis], table.at_low[kept, axis], float(table.low[kept, axis].min())),
        (table.high[kept, axis], table.at_high[kept, axis], float(table.high[kept, axis].max())),
    ):
        found = float(counts[ends == end].sum())
        away = abs(end - float(np.median(table.mean[kept, axis]))) / max(sigma, 1e-300)
        wide = half / max(sigma, 1e-300)
        expected = total * (_below(away + wide) - _below(away - wide))
        if found > _FEWEST_CLIPPED + _CLIPPED * expected:
            share += found / total
    return share


def _below(sigmas: float) -> float:
    return 0.5 * (1 + erf(sigmas / sqrt(2)))


def stationarity_findings(table: RestTable, found: Stationarity, sensor: str) -> list[Finding]:
    """Say what is not the same all the time."""
    return [
        *_frozen_findings(table, found, sensor),
        *_clipped_findings(found, sensor),
        *_level_findings(table, found, sensor),
        *_pattern_findings(found, sensor),
    ]


def _frozen_findings(table: RestTable, found: Stationarity, sensor: str) -> Iterator[Finding]:
    axes = np.flatnonzero(found.frozen.any(axis=0))
    if not len(axes):
        return
    at = np.flatnonzero(found.frozen.any(axis=1))
    first, last = float(table.t_s[at[0]]), float(table.t_s[at[-1]])
    alive = np.flatnonzero(~found.frozen.any(axis=1))
    cure = "Check the sensor and its bus"
    if len(alive):
        start, stop = _longest(np.asarray(found.frozen.any(axis=1), dtype=bool))
        cure += f", or leave it out: --start-s {table.t_s[start]:.0f} --stop-s {table.t_s[stop]:.0f}"
    yield make_finding(
        "noise-frozen",
        severity="problem" if len(at) > _MOST_FROZEN * len(table.t_s) else "warning",
        sensor=sensor,
        axes=_named(axes.tolist()),
        windows=len(at),
        first=first,
        last=last,
        cure=cure,
    )


def _longest(marked: Booleans) -> tuple[int, int]:
    """Return first and last window of the longest stretch that is not marked."""
    edges = np.concatenate([[-1], np.flatnonzero(marked), [len(marked)]])
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]) + 1, int(edges[k + 1]) - 1


def _clipped_findings(found: Stationarity, sensor: str) -> Iterator[Finding]:
    axes = np.flatnonzero(found.clipped > _CLIPPED_WARN)
    if not len(axes):
        return
    worst = float(found.clipped.max())
    yield make_finding(
        "noise-clipped",
        severity="problem" if worst > _CLIPPED_FAIL else "warning",
        sensor=sensor,
        axes=_named(axes.tolist()),
        worst=worst,
    )


def _level_findings(table: RestTable, found: Stationarity, sensor: str) -> Iterator[Finding]:
    axes = [int(axis) for axis in np.flatnonzero(found.spread > _UNEVEN_WARN)]
    if not axes:
        return
    worst = max(axes, key=lambda axis: found.spread[axis])
    level = found.level[:, worst]
    low, high = int(np.argmin(level)), int(np.argmax(level))
    length = table.duration_s / len(level)
    yield make_finding(
        "noise-uneven",
        sensor=sensor,
        axes=_named(axes),
        axis="xyz"[worst],
        low_level=level[low],
        low_from_s=low * length,
        low_to_s=(low + 1) * length,
        high_level=level[high],
        high_from_s=high * length,
        high_to_s=(high + 1) * length,
    )


def _pattern_findings(found: Stationarity, sensor: str) -> list[Finding]:
    by_axis = [(axis, pattern) for axis, pattern in enumerate(found.patterns) if pattern is not None and pattern.sure]
    if not by_axis:
        return []
    words: Mapping[str, str] = {
        "step": "a step of {size:.2g} {unit} at {time:.0f} s",
        "steps": "steps now and then, the largest of {size:.2g} {unit} at {time:.0f} s",
        "wave": "a wave of {size:.2g} {unit} with a period of {time:.0f} s",
        "warm-up": "a warm-up of {size:.2g} {unit} with a time constant of {time:.0f} s",
    }
    seen = [
        f"{'xyz'[axis]} {words[one.kind].format(size=abs(one.size), time=one.time_s, unit=_WORDS[sensor])}"
        for axis, one in by_axis
    ]
    return [make_finding("noise-pattern", sensor=sensor, seen="; ".join(seen))]


def _named(axes: Sequence[int]) -> str:
    return " and ".join("xyz"[axis] for axis in axes)
