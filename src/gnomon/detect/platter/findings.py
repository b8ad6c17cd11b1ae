"""What is said about the rate of a platter: its clock, its steady part, its evenness, its pattern."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ...findings import Finding, make_finding
from .clock import NOMINAL_CLOCK, UNCHECKED_CLOCK

if TYPE_CHECKING:
    from .rate import PlatterRate

_LEFT_OUT_S = 2.0
_HIDDEN_SHARE = 0.05
_UNEVEN = 5e-4
_FEW_TURNS = 8.0
_SURELY = 3.0
_LITTLE_DRIFT = 1e-4


def rate_findings(found: "PlatterRate", missing: int, notes: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return what was noticed.

    Parameters
    ----------
    found : the result
    missing : frames that are missing in a video whose timestamps merely count them
    notes : on what could not be read
    """
    return (
        *_of_video(notes, missing),
        *_of_clock(found),
        *_of_part(found),
        *_of_evenness(found),
        *_of_pattern(found),
    )


def _of_video(notes: tuple[str, ...], missing: int) -> Iterator[Finding]:
    if notes:
        yield make_finding("video-damaged", notes=" ".join(notes))
    if missing:
        yield make_finding("video-frames-missing", missing=missing)


def _of_clock(found: "PlatterRate") -> Iterator[Finding]:
    if found.clock < NOMINAL_CLOCK:
        return
    unchecked = "; frames may be missing, unnoticed" if found.clock >= UNCHECKED_CLOCK else ""
    yield make_finding("video-nominal-times", frame_rate_hz=found.frame_rate_hz, unchecked=unchecked, clock=found.clock)


def _of_part(found: "PlatterRate") -> Iterator[Finding]:
    start, stop = found.steady_s
    step = 1 / found.frame_rate_hz
    if start + (found.duration_s - stop) > _LEFT_OUT_S:
        yield make_finding("platter-steady-part", start=start, stop=stop, duration_s=found.duration_s)
    hidden = 1 - found.frames_used * step / max(stop - start, step)
    if hidden > _HIDDEN_SHARE:
        yield make_finding("platter-hidden", hidden=hidden)
    if found.turns < _FEW_TURNS:
        yield make_finding("platter-few-turns", turns=found.turns)


def _of_evenness(found: "PlatterRate") -> Iterator[Finding]:
    rate = found.rate_rad_s
    drift, sigma = found.drift_rad_s
    drifts = abs(drift) > max(_SURELY * sigma, _LITTLE_DRIFT * rate)
    own = max(found.sigma_rad_s**2 - (found.clock * rate) ** 2, 0.0) ** 0.5 / rate
    if drifts:
        yield make_finding(
            "platter-drift", direction="rises" if drift > 0 else "falls", percent=100 * abs(drift) / rate
        )
    elif own > _UNEVEN:
        yield make_finding("platter-uneven", own=own)
    else:
        yield make_finding("platter-even", own=own)


def _of_pattern(found: "PlatterRate") -> Iterator[Finding]:
    if found.per_turn > 1:
        yield make_finding("platter-pattern", per_turn=found.per_turn)
