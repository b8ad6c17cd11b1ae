"""Verdict and advice on the noise of an IMU: which coefficients a recording shows, and what a longer one would."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import isfinite, pi

import numpy as np

from ...detect.samples.rest_watch import RestTable, Stir, find_stir
from ...errors import RecordingError
from ...estimate.allan.fit import AxisFit
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.sensor_noise import TriadNoise
from ..verdict import grade_by_limits

SHORTEST_S = 60.0
_NEARLY = 0.999  # a rate is not known more exactly
_FEWEST = 1000
_STEP = 12.0  # usual differences of neighbouring means
_SPANS = (1, 10, 60)  # windows in a mean
_SHARE, _NOTABLE = 0.05, 0.005  # of the squares that disturbances may add
_LOST_SHARE, _LOST_MOST = 1e-3, 0.1
_REPEATED = (0.2, 0.02)  # of the samples; and more than by chance, which moves the white noise by a few percent
_COARSE = 0.5  # steps of the converter in a standard deviation


def check_length(table: RestTable, sensor: str) -> None:
    """Stop where a recording is too short for any noise to be told, or its samples are no measurement.

    Raises
    ------
    RecordingError
        If it is too short, its timestamps do not tell a rate, or an axis never changes.
    """
    if not np.isfinite(table.rate_hz):
        raise RecordingError(
            f"{sensor}: all {table.samples} timestamps are the same, so that the sample rate is not known. Read the "
            "recording without its timestamps and state the rate (--rate)."
        )
    lasts_s = table.duration_s + 1 / table.rate_hz
    if lasts_s < _NEARLY * SHORTEST_S or table.samples < _FEWEST:
        raise RecordingError(
            f"{sensor}: {table.samples} samples in {lasts_s:.4g} s are too few. At least {SHORTEST_S:.0f} s "
            f"and {_FEWEST} samples at rest are needed for the white noise; record for 1 h or more for the bias "
            "instability, and for 3 h or more, better 12 h, for the random walk."
        )
    if table.lost > _LOST_MOST * (table.samples + table.lost):
        raise RecordingError(
            f"{sensor}: about {table.lost} samples are missing beside {table.samples}; the longest gap lasts "
            f"{table.longest_gap_s:.4g} s from {table.longest_gap_at_s:.4g} s on. Cut the recording there "
            "(--start-s, --stop-s), or record with a faster link."
        )
    still = table.low.min(axis=0) == table.high.max(axis=0)
    if still.any():
        axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(still))
        raise RecordingError(
            f"{sensor}: axis {axes} never changes ({table.low[0, int(np.argmax(still))]:g}), so that there is no noise "
            "to be seen. Check that the right columns are read (--columns), and that the sensor's resolution is finer "
            "than its noise."
        )


@value_class
class StillSpans:
    """When a recording rests, (n,) [s], and what the check of a recording says of that."""

    start_s: Floats
    stop_s: Floats
    words: str

    def hold(self, t_s: Floats) -> Booleans:
        """Return which instants (k,) lie within one of them."""
        k = np.searchsorted(self.start_s, t_s, side="right") - 1
        return (k >= 0) & (t_s <= np.append(self.stop_s, -np.inf)[k])


def check_still(
    table: RestTable, sensor: str, frozen: Booleans, find_rests: Callable[[], StillSpans | None]
) -> list[Finding]:
    """Look for shocks, touches and turns.

    Parameters
    ----------
    frozen : (k,) windows in which the sensor shows nothing, which are not what to keep
    find_rests : asked where it moved; None where nothing tells its rests

    Raises
    ------
    RecordingError
        If the sensor was moved so that the noise cannot be told from the motion.
    """
    kept = np.flatnonzero(~frozen)
    stir, turned = _stirred_and_turned(table, kept)
    if not turned.any() and not stir.windows.any():
        return [make_finding("noise-still", sensor=sensor)]
    marked = stir.windows | turned
    first, last = _span(table, marked)
    rests = find_rests()
    outside = np.zeros(len(marked), dtype=bool) if rests is None else ~rests.hold(table.t_s)
    start, stop = _longest_still(table, marked | frozen | outside)
    where = f"at {first:.0f} s" if last - first < 3 else f"between {first:.0f} s and {last:.0f} s"
    if stir.share > _SHARE or turned.any():
        what = "was moved, or its bias stepped," if turned.any() else "was shaken"
        advice = (
            f"Leave it out: it was still from {start:.0f} s to {stop:.0f} s (--start-s {start:.0f} --stop-s {stop:.0f})"
        )
        enough = stop - start >= SHORTEST_S
        raise RecordingError(
            f"the {sensor} {what} {where} after the start, in {int(marked.sum())} of {len(marked)} windows of "
            f"{table.duration_s / max(len(marked), 1):.1f} s; its noise cannot be told from that. "
            + (f"{rests.words} " if rests is not None and rests.words else "")
            + (f"{advice}, or record again where nothing can move it." if enough else "Record again, with it at rest.")
        )
    return [
        make_finding(
            "noise-stirred",
            severity="warning" if stir.share > _NOTABLE else "info",
            case="notable" if stir.share > _NOTABLE else "",
            sensor=sensor,
            where=where,
            windows=int(stir.windows.sum()),
            share=stir.share,
            start=start,
            stop=stop,
        )
    ]


def _turns(table: RestTable) -> Booleans:
    """Mark the windows at which a mean changes for good, (k,)."""
    marked = np.zeros(len(table.t_s), dtype=bool)
    for span in _SPANS:
        count = len(marked) // span
        if count < 20:
            break
        means = table.mean[: count * span].reshape(count, span, 3).mean(axis=1)
        steps = np.abs(np.diff(means, axis=0))
        usual = 1.4826 * np.median(steps, axis=0) + np.sqrt(np.median(table.variance, axis=0)) * 1e-3
        at = np.flatnonzero((steps > _STEP * usual).any(axis=1))
        if span > 1 and len(at) > 2 and np.all(np.diff(at) == 1):
            continue  # a drift that fades, as of a sensor that warms up
        for k in at.tolist():
            both = slice(k * span, (k + 2) * span)
            if not marked[both].any():  # else it is known better when that was
                marked[both] = True
    return marked


def _stirred_and_turned(table: RestTable, kept: Integers) -> tuple[Stir, Booleans]:
    """Return what moved it in some of the windows: that a sensor died is no motion."""
    windows = {name: getattr(table, name)[kept] for name in ("t_s", "mean", "variance", "low", "high")}
    part = replace(table, **windows, at_low=table.at_low[kept], at_high=table.at_high[kept])
    stir, turned = find_stir(part), _turns(part)
    marked = np.zeros((2, len(table.t_s)), dtype=bool)
    marked[:, kept] = stir.windows, turned
    return Stir(windows=marked[0], share=stir.share), marked[1]


def _span(table: RestTable, marked: Booleans) -> tuple[float, float]:
    at = table.t_s[marked]
    return float(at[0]), float(at[-1])


def _longest_still(table: RestTable, marked: Booleans) -> tuple[float, float]:
    """Return begin and end of the longest stretch in which nothing is marked [s], a little within it."""
    edges = np.concatenate([[-1], np.flatnonzero(marked), [len(marked)]])
    k = int(np.argmax(np.diff(edges)))
    first, last = int(edges[k]) + 1, int(edges[k + 1]) - 1
    if last < first:
        return 0.0, 0.0
    margin = 2.0
    start = float(np.floor(table.t_s[0]) if first == 0 else np.ceil(table.t_s[first] + margin))
    return start, float(np.floor(table.t_s[last] - (margin if last < len(marked) - 1 else 0)))


def check_samples(table: RestTable, step: Floats, sensor: str) -> list[Finding]:
    """Look for what makes noise look other than it is: lost and repeated samples, a coarse converter.

    Parameters
    ----------
    step : (3,) smallest change of each axis [unit]; nan where not known
    """
    findings: list[Finding] = []
    if table.lost:
        some = table.lost > _LOST_SHARE * table.samples
        findings.append(
            make_finding(
                "noise-gaps",
                severity="warning" if some else "info",
                case="some" if some else "",
                sensor=sensor,
                gaps=table.gaps,
                plural="s" * (table.gaps > 1),
                lost=table.lost,
                longest_gap_s=table.longest_gap_s,
                longest_gap_at_s=table.longest_gap_at_s,
            )
        )
    if any(share > limit for share, limit in zip(table.repeats, _REPEATED, strict=True)):
        findings.append(make_finding("noise-repeated", sensor=sensor, repeats=table.repeats[0]))
    sigma = np.sqrt(np.median(table.variance, axis=0))
    coarse = sigma < _COARSE * np.where(np.isfinite(step), step, 0.0)
    if coarse.any():
        axes = " and ".join("xyz"[axis] for axis in np.flatnonzero(coarse))
        worst = int(np.argmax(np.where(coarse, step / np.maximum(sigma, 1e-300), 0)))
        findings.append(make_finding("noise-coarse", sensor=sensor, axes=axes, sigma=sigma[worst], step=step[worst]))
    return findings


_DIFFERENT = 2.0
_LONG_S = 3 * 3600.0
_SHORT_S = 900.0  # nine times the 100 s over which a bias is taken to stay: shorter recordings bound nothing of use
_OTHER_SLOPE_INFO, _OTHER_SLOPE_WARN = 0.01, 0.1  # of the white noise
_USUAL = {"accelerometer": (1e-6, 0.1), "gyroscope": (1e-8, 5e-3)}
"""White noise densities of sensors that exist, in SI."""


def assess_noise(
    noise: Mapping[str, TriadNoise], fits: Mapping[str, tuple[AxisFit, ...]], t_init_s: float
) -> list[Finding]:
    """Judge the coefficients of both sensors; `t_init_s` is the advice for calibrations by hand."""
    findings: list[Finding] = []
    for name, triad in noise.items():
        findings += [*_length(name, triad), *_walk(name, triad), *_misfit(name, triad)]
        findings += [*_filtered(name, triad, fits[name]), *_falling(name, triad, fits[name])]
        findings += _other_slope(name, fits[name])
        findings += [*_axes(name, triad), *_ramp(name, triad), *_usual(name, triad)]
    if isfinite(t_init_s):
        findings.append(make_finding("noise-t-init/found", t_init_s=t_init_s))
    elif "gyroscope" in noise:
        longest = min(noise["gyroscope"].duration_s / 9, 225.0)
        findings.append(make_finding("noise-t-init/longer", longest=longest))
    return findings


def time_span_text(seconds: float) -> str:
    """Return a time as a person says it.

    Examples
    --------
    >>> time_span_text(42), time_span_text(600), time_span_text(9000), time_span_text(259200)
    ('42 s', '10 min', '2.5 h', '72 h')
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.3g} h"


def _named(axes: list[int]) -> str:
    return " and ".join("xyz"[axis] for axis in axes)


def _length(name: str, triad: TriadNoise) -> Iterator[Finding]:
    """Say which averaging times the length supports, and whether they show the floor of the curve."""
    known = [axis.white_noise.sigma / axis.white_noise.value for axis in triad.axes if axis.white_noise.found]
    worst = max(known, default=float("inf"))
    message = (
        f"{name}: {time_span_text(triad.duration_s)} at {triad.rate_hz:.6g} Hz show averaging times up to "
        f"{time_span_text(triad.tau_s[1])}; the white noise is known to {100 * worst:.2g} % (worst axis)."
    )
    hidden = [i for i, axis in enumerate(triad.axes) if not axis.bias_instability.found]
    # The floor is reached where white noise has fallen to it; its bound says what it is at most.
    if not hidden:
        yield make_finding("noise-length/good", message=message)
        return
    short = triad.duration_s < _LONG_S
    yield make_finding(
        "noise-length/bound",
        severity="warning" if triad.duration_s < _SHORT_S else "info",
        case="short" if short else "",
        message=message,
        hidden=_named(hidden),
        longer=time_span_text(max(4 * triad.duration_s, 3600)),
    )


def _walk(name: str, triad: TriadNoise) -> Iterator[Finding]:
    hidden = [i for i, axis in enumerate(triad.axes) if not axis.random_walk.found]
    if not hidden:
        return
    none = len(hidden) == 3
    yield make_finding(
        "noise-walk-bound",
        severity="warning" if none and triad.duration_s < _SHORT_S else "info",
        case="none" if none else "",
        name=name,
        hidden=_named(hidden),
        duration=time_span_text(triad.duration_s),
        longer=time_span_text(max(4 * triad.duration_s, 4 * 3600)),
    )


def _misfit(name: str, triad: TriadNoise) -> Iterator[Finding]:
    worst = int(np.argmax([axis.misfit for axis in triad.axes]))
    misfit = triad.axes[worst].misfit
    if misfit == 0:
        return
    severity = grade_by_limits("noise misfit", misfit)
    yield make_finding(
        "noise-misfit",
        severity="info" if severity == "good" else severity,
        name=name,
        axis="xyz"[worst],
        misfit=misfit,
    )


def _filtered(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    first = max(axis.fitted_from_s for axis in triad.axes)
    if first <= triad.tau_s[0] * 1.01:
        return []
    delay_s = max(fit.delay for fit in fits) / triad.rate_hz
    like = f" like those behind a low-pass filter of about {1 / (2 * pi * delay_s):.2g} Hz" if delay_s > 0 else ""
    return [make_finding("noise-filtered", name=name, first=first, like=like)]


def _falling(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    axes = [i for i, fit in enumerate(fits) if fit.falls]
    if not axes:
        return []
    longest = triad.tau_s[0] * 2.0 ** (min(fits[i].stop for i in axes) - 1)
    return [make_finding("noise-falls", name=name, axes=_named(axes), longest=time_span_text(longest))]


def _other_slope(name: str, fits: tuple[AxisFit, ...]) -> Iterator[Finding]:
    worst = max(fit.other_slope for fit in fits) / 2
    if worst < _OTHER_SLOPE_INFO:
        return
    yield make_finding(
        "noise-other-slope", severity="warning" if worst > _OTHER_SLOPE_WARN else "info", name=name, worst=worst
    )


def _axes(name: str, triad: TriadNoise) -> Iterator[Finding]:
    values = [axis.white_noise.most for axis in triad.axes]
    if max(values) < _DIFFERENT * min(values):
        return
    low, high = int(np.argmin(values)), int(np.argmax(values))
    yield make_finding(
        "noise-axes-differ", name=name, axis="xyz"[high], ratio=values[high] / values[low], lowest="xyz"[low]
    )


def _ramp(name: str, triad: TriadNoise) -> Iterator[Finding]:
    drifting = [i for i, axis in enumerate(triad.axes) if axis.rate_ramp.found]
    if not drifting:
        return
    worst = max(drifting, key=lambda i: triad.axes[i].rate_ramp.value)
    total = triad.axes[worst].rate_ramp.value * triad.duration_s
    unit = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}[name]
    yield make_finding("noise-drift", name=name, drifting=_named(drifting), total=total, unit=unit, axis="xyz"[worst])


def _usual(name: str, triad: TriadNoise) -> Iterator[Finding]:
    low, high = _USUAL[name]
    if low < triad.noise_density < high:
        return
    unit = {"accelerometer": "m/s^2/sqrt(Hz)", "gyroscope": "rad/s/sqrt(Hz)"}[name]
    yield make_finding("noise-implausible", name=name, noise_density=triad.noise_density, unit=unit, low=low, high=high)
