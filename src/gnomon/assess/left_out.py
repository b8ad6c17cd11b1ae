"""Rests that were found and not used: when, and why."""

from collections.abc import Sequence

from ..findings import Finding
from ..recording import Floats

_LISTED = 5
_MANY = 0.1  # of the rests


def left_out_findings(start_s: Floats, stop_s: Floats, reason: Sequence[str], label: str = "") -> list[Finding]:
    """Name the rests that are not used, with time and reason.

    Parameters
    ----------
    start_s, stop_s : (n,) of all rests that were found [s from the start of the recording]
    reason : (n,) why a rest is not used, or ""
    label : begins the message
    """
    out = [k for k, why in enumerate(reason) if why]
    if not out:
        return []
    listed = [f"{k + 1} ({start_s[k]:.1f} to {stop_s[k]:.1f} s): {reason[k]}" for k in out[:_LISTED]]
    more = f"; and {len(out) - _LISTED} more, which the report lists" if len(out) > _LISTED else ""
    return [
        Finding(
            severity="warning" if len(out) > _MANY * len(reason) else "info",
            code="intervals-left-out",
            message=f"{label}{len(out)} of {len(reason)} static intervals left out: {'; '.join(listed)}{more}.",
            consequence="What they measured is not in the result; the rest of the recording is used.",
            cure="Let go of the sensor before an interval counts, and power it throughout.",
        )
    ]
