"""From where document C's iteration finds its way (Table 2, Figs. 4-6), beside gnomon's solver."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..estimate.triads.angrisano import AngrisanoFit, canonical
from ..estimate.triads.triad import fit_triad
from ..intervals import Booleans
from ..recording import Floats
from ..simulate.poses import PoseSimulation, simulate_poses
from .angrisano_trial import DATASHEET, SAME, TABLE_2, Trial, distance, in_document_c, paper_fit, pose_means

GROUPS = ("angles", "biases", "scale factors")
STEPS, OURS_EVERY = 30, 5
"""Starts on either side of the datasheet's, up to Table 2's limits widened; gnomon is slower and tries some of them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Basin:
    """Starts that differ from the datasheet's in one group of parameters, all three of it by the same offset.

    Attributes
    ----------
    group : "angles" [rad], "biases" [count] or "scale factors" [m/s^2 per count]
    offset : (m,) ascending, zero among them
    paper : (m,) whether document C's iteration ended in the right minimum
    printed : (m,) the same where growth of q meets the stop rule, as it is printed
    ours : (k,) the same of gnomon's solver, at each OURS_EVERY-th offset
    """

    group: str
    offset: Floats
    paper: Booleans
    printed: Booleans
    ours: Booleans

    @property
    def ours_offset(self) -> Floats:
        """The offsets that gnomon tried, (k,)."""
        return self.offset[::OURS_EVERY]

    def interval(self, found: Booleans) -> tuple[float, float]:
        """Return the ends of the offsets about zero from which all were `found`, by one of the methods."""
        offset = self.offset if len(found) == len(self.offset) else self.ours_offset
        middle = int(np.searchsorted(offset, 0.0))
        below = np.flatnonzero(~found[:middle])
        above = np.flatnonzero(~found[middle:])
        first = below[-1] + 1 if below.size else 0
        last = middle + above[0] - 1 if above.size else len(found) - 1
        return float(offset[first]), float(offset[last])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Journey:
    """Document C's iteration from one start, and where gnomon ends.

    Attributes
    ----------
    name : what is special about the start
    fit : the iteration
    ours : (9,) gnomon's solution from the same start
    """

    name: str
    fit: AngrisanoFit
    ours: Floats


def scan(trial: Trial) -> tuple[Basin, ...]:
    """Return the basins of the three groups in one experiment."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    poses = pose_means(simulation)
    solution, covariance = in_document_c(fit_triad(poses))
    sigma = np.sqrt(np.diag(covariance))
    basins: list[Basin] = []
    for group, name in enumerate(GROUPS):
        offset = offsets(group, trial.widened)
        starts = [shifted(group, by) for by in offset]
        basins.append(
            Basin(
                group=name,
                offset=offset,
                paper=_truths(paper_fit(simulation, start).converged for start in starts),
                printed=_truths(paper_fit(simulation, start, growth_stops=True).converged for start in starts),
                ours=_truths(
                    distance(poses, canonical(start), solution, sigma) < SAME for start in starts[::OURS_EVERY]
                ),
            )
        )
    return tuple(basins)


def journeys(trial: Trial) -> tuple[Journey, ...]:
    """Return the iterations of Figs. 4 to 6: from the datasheet, from inside Table 2's intervals, and from outside."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    poses = pose_means(simulation)
    starts = {
        "from the datasheet": DATASHEET,
        "from inside the intervals": shifted(0, 0.8 * TABLE_2[0, 0]) + shifted(1, 0.5 * TABLE_2[1, 1]) - DATASHEET,
        "from outside, angles": _outside(simulation),
    }
    return tuple(
        Journey(name=name, fit=paper_fit(simulation, start), ours=in_document_c(fit_triad(poses, start=start))[0])
        for name, start in starts.items()
    )


def _outside(simulation: PoseSimulation) -> Floats:
    """Return the start with poor angles from which the iteration gets lost most slowly, which shows most."""
    starts = [shifted(0, factor * end) for factor in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0) for end in TABLE_2[0]]
    lost = [start for start in starts if not paper_fit(simulation, start).converged]
    return max(lost or starts[-1:], key=lambda start: paper_fit(simulation, start).iterations)


def offsets(group: int, widened: float) -> Floats:
    """Return offsets of the start, ascending through zero: equal steps on either side, which differ in size."""
    low, high = widened * TABLE_2[group]
    return np.concatenate([np.linspace(low, 0, STEPS, endpoint=False), np.linspace(0, high, STEPS + 1)])


def shifted(group: int, by: float) -> Floats:
    """Return the datasheet start (9,) with all three parameters of a group moved."""
    start = DATASHEET.copy()
    start[3 * group : 3 * group + 3] += by
    return start


def _truths(values: Iterable[bool]) -> Booleans:
    return np.fromiter(values, dtype=np.bool_)
