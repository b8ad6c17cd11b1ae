"""Which static intervals were touched: a hand on the table, a sensor let go too late."""

import numpy as np

from ..findings import Finding, make_finding
from .imu_tables import ImuEvidence, interval_numbers

_TOUCHED, _WHOLE = 0.6, 0.85  # share of a rest that is still: where it was touched, and as a rule
_REST_S = 2.0
_MOST_TOUCHED = 0.3  # of the intervals: more are unsteady throughout


def touched_findings(evidence: ImuEvidence) -> list[Finding]:
    """Name intervals that are a small part of their rest, as the most generous threshold sees it (interval-touched)."""
    chosen = evidence.chosen.intervals
    generous = max(evidence.trials, key=lambda trial: trial.multiplier).intervals
    t_s = evidence.accelerometer.t_s
    start, stop = t_s[chosen.start], t_s[chosen.stop - 1]
    rest_start, rest_stop = t_s[generous.start], t_s[generous.stop - 1]
    share = np.ones(len(chosen))
    length = np.zeros(len(chosen))
    for k in range(len(chosen)):
        around = np.flatnonzero((rest_start < stop[k]) & (rest_stop > start[k]))
        if len(around) == 1:
            rest = int(around[0])
            length[k] = rest_stop[rest] - rest_start[rest]
            share[k] = (stop[k] - start[k]) / max(length[k], 1e-9)
    touched = (share < _TOUCHED) & (length > _REST_S)
    if not touched.any() or np.median(share) < _WHOLE or touched.mean() > _MOST_TOUCHED:
        return []
    worst = int(np.argmin(np.where(touched, share, np.inf)))
    several = int(touched.sum()) > 1
    numbers = f"{interval_numbers(evidence.marked(touched))} of {len(evidence.chosen.rests)}"
    return [
        make_finding(
            "interval-touched",
            plural="s" if several else "",
            numbers=numbers,
            verb="were" if several else "was",
            length_s=length[worst],
            t_s=t_s[generous.start][(rest_start < stop[worst]) & (rest_stop > start[worst])][0],
            share=share[worst],
        )
    ]
