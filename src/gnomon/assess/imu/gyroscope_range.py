"""A gyroscope whose range or unit changed half-way, told by the rotations between rests."""

import numpy as np

from ...detect.samples.range_change import find_range_change
from ...estimate.multiposition.problem import MultiPositionProblem
from ...estimate.multiposition.turning_factors import turning_factors
from ...findings import Finding, make_finding
from ...results.intervals import StaticIntervals

_MOSTLY = 0.9  # of the rotations must show some of the turn, whatever the scale
_FACTOR = 1.6  # ranges differ by two; what a rotation shows is a fifth off, so that few of them differ by 1.3 by chance


def gyroscope_range_findings(problem: MultiPositionProblem) -> list[Finding]:
    """Return that from one instant on the gyroscope shows several times as much of a rotation, where it does."""
    factors = turning_factors(problem)
    told = np.flatnonzero(np.isfinite(factors))
    shown = told[factors[told] > 0]
    if len(shown) < _MOSTLY * len(told):
        return []
    rotations = StaticIntervals(start=shown, stop=shown + 1)
    change = find_range_change(factors[shown], rotations, len(factors))
    if change is None or max(change.factor, 1 / change.factor) < _FACTOR:
        return []
    return [
        make_finding(
            "gyroscope-range-changed",
            label="imu0",
            factor=change.factor,
            t_from_s=problem.start_s[change.last],
            t_to_s=problem.stop_s[change.first],
        )
    ]
