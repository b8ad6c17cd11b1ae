"""A triad whose axes, range or unit changed half-way, told by the rotations between rests."""

import numpy as np

from ...estimate.multiposition.problem import MultiPositionProblem
from ...estimate.multiposition.triad_changes import find_axes_change
from ...findings import Finding, make_finding


def axes_changed_findings(problem: MultiPositionProblem) -> list[Finding]:
    """Return that from one instant on the axes of a triad, or the gyroscope's scale, are others.

    Parameters
    ----------
    problem : with all rests, also those at which gravity is read as no other rest has it
    """
    change = find_axes_change(problem)
    if change is None:
        return []
    t_from_s, t_to_s = problem.start_s[change.row], problem.stop_s[change.row]
    if change.factor != 1:
        return [
            make_finding(
                "gyroscope-range-changed", label="imu0", factor=change.factor, t_from_s=t_from_s, t_to_s=t_to_s
            )
        ]
    read = [
        f"{axis} reads what would have been {'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}"
        for axis, row, same in zip("xyz", change.after, np.eye(3), strict=True)
        if (row != same).any()
    ]
    return [
        make_finding(
            "axes-changed",
            label="imu0",
            triad=change.triad,
            read=", ".join(read),
            t_from_s=t_from_s,
            t_to_s=t_to_s,
        )
    ]
