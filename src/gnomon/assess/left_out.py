"""Rests that were found and not used: when, and why."""

from collections.abc import Sequence

import numpy as np

from ..findings import Finding, make_finding
from ..intervals import Booleans
from ..recording import Floats

_LISTED = 6  # runs of rests with one reason
_MANY = 0.1  # of the rests
_FEWEST = 3  # rests behind each other
_CHANCE = 0.05  # that rests left out independently of each other lie as close together


def left_out_findings(start_s: Floats, stop_s: Floats, reason: Sequence[str], label: str = "") -> list[Finding]:
    """Name the rests that are not used, with time, by reason; those behind each other as one run.

    Parameters
    ----------
    start_s, stop_s : (n,) of all rests that were found [s from the start of the recording]
    reason : (n,) why a rest is not used, or ""
    label : begins the message
    """
    out = [k for k, why in enumerate(reason) if why]
    if not out:
        return []
    listed: list[str] = []
    for why in dict.fromkeys(reason[k] for k in out):
        own = np.array([k for k in out if reason[k] == why])
        runs = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
        names = [f"{run[0] + 1} to {run[-1] + 1}" if len(run) > 1 else f"{run[0] + 1}" for run in runs[:_LISTED]]
        shown = [
            f"{name} ({start_s[run[0]]:.1f} to {stop_s[run[-1]]:.1f} s)" for name, run in zip(names, runs, strict=False)
        ]
        more = f" and {sum(map(len, runs[_LISTED:]))} more, which the report lists" if len(runs) > _LISTED else ""
        listed.append(f"{', '.join(shown)}{more}: {why}")
    return [
        make_finding(
            "intervals-left-out",
            severity="warning" if len(out) > _MANY * len(reason) else "info",
            label=label,
            count=len(out),
            total=len(reason),
            listed="; ".join(listed),
        )
    ]


def cluster(out: Booleans) -> tuple[int, int] | None:
    """Return the first rest and the last one of those left out behind each other; None where chance explains them.

    Of the stretches that hold three or more, and more left out than used, the one that is least likely where as many
    are left out independently: the hypergeometric probability, times the places where it may begin.

    Parameters
    ----------
    out : (n,) rests that do not agree with the others
    """
    at = np.flatnonzero(out)
    if len(at) < _FEWEST:
        return None
    from scipy.stats import hypergeom  # slow to load, and rarely needed

    least, found = _CHANCE, None
    for k, first in enumerate(at):
        for held, last in enumerate(at[k + _FEWEST - 1 :], start=_FEWEST):
            length = last - first + 1
            places = len(out) - length + 1
            chance = places * float(hypergeom.sf(held - 1, len(out), len(at), length))
            if 2 * held > length and chance < least:
                least, found = chance, (int(first), int(last))
    return found
