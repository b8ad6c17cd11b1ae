"""What is said about the rate of a platter: its clock, its steady part, its evenness, its pattern."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ...findings import Finding
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
    missing : frames that are missing in a video whose stamps merely count them
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
        yield Finding(
            severity="warning",
            code="video-damaged",
            message=" ".join(notes),
            consequence="The rate rests on what could be read.",
            cure="Copy the video again, if it was whole.",
        )
    if missing:
        yield Finding(
            severity="warning",
            code="video-frames-missing",
            message=f"The video states a frame rate and no times, and {missing} frames are missing or repeated, where "
            "the platter jumps or waits.",
            consequence="The times were put right by these jumps.",
            cure="Record with the time of each frame (Matroska or MP4 with a variable frame rate), in more light.",
        )


def _of_clock(found: "PlatterRate") -> Iterator[Finding]:
    if found.clock < NOMINAL_CLOCK:
        return
    unchecked = "; frames may be missing, unnoticed" if found.clock >= UNCHECKED_CLOCK else ""
    yield Finding(
        severity="warning",
        code="video-nominal-times",
        message=f"The frames stand at even times, {found.frame_rate_hz:.6g} per second: the video states a frame rate, "
        f"and not when its frames were taken{unchecked}.",
        consequence=f"The camera's own frame rate is taken to agree to {found.clock:.1g}, which is in the sigma.",
        cure="Record with the time of each frame, or put a table of stamps beside the video.",
    )


def _of_part(found: "PlatterRate") -> Iterator[Finding]:
    start, stop = found.steady_s
    step = 1 / found.frame_rate_hz
    if start + (found.duration_s - stop) > _LEFT_OUT_S:
        yield Finding(
            severity="info",
            code="platter-steady-part",
            message=f"The platter turns evenly from {start:.1f} to {stop:.1f} s of {found.duration_s:.1f} s.",
            consequence="The rest was left out.",
        )
    hidden = 1 - found.frames_used * step / max(stop - start, step)
    if hidden > _HIDDEN_SHARE:
        yield Finding(
            severity="info",
            code="platter-hidden",
            message=f"In {100 * hidden:.0f} % of this time frames are missing, or something is before the platter.",
            consequence="What was seen before and after has the same phase, so that no turn was lost.",
        )
    if found.turns < _FEW_TURNS:
        yield Finding(
            severity="warning",
            code="platter-few-turns",
            message=f"Only {found.turns:.1f} turns tell the rate.",
            consequence="Its sigma is large, and how even the rate is can hardly be told.",
            cure="Record for a minute or more.",
        )


def _of_evenness(found: "PlatterRate") -> Iterator[Finding]:
    rate = found.rate_rad_s
    drift, sigma = found.drift_rad_s
    drifts = abs(drift) > max(_SURELY * sigma, _LITTLE_DRIFT * rate)
    own = max(found.sigma_rad_s**2 - (found.clock * rate) ** 2, 0.0) ** 0.5 / rate
    if drifts:
        yield Finding(
            severity="warning",
            code="platter-drift",
            message=f"The rate {'rises' if drift > 0 else 'falls'} by {100 * abs(drift) / rate:.2g} % over the steady "
            "part.",
            consequence="The sigma is that of the rate at any one moment of it.",
            cure="Let the platter warm up, and record the sensor and the video at the same time.",
        )
    elif own > _UNEVEN:
        yield Finding(
            severity="warning",
            code="platter-uneven",
            message=f"The platter turns unevenly: its rate is known to {100 * own:.2g} %, by the scatter of its turns.",
            consequence="The scale of a gyroscope will not be better than that.",
            cure="Record more turns; clean the platter's drive.",
        )
    else:
        yield Finding(severity="good", code="platter-even", message=f"The platter turns evenly, to {100 * own:.2g} %.")


def _of_pattern(found: "PlatterRate") -> Iterator[Finding]:
    if found.per_turn > 1:
        yield Finding(
            severity="info",
            code="platter-pattern",
            message=f"The picture repeats itself {found.per_turn} times in a turn, by the motion of its pattern.",
            cure="One mark on the platter makes it clear to the eye, too.",
        )
