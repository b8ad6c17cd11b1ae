"""One simulated experiment of Angrisano, calibrated by its method and by gnomon's, and the starts that lead there."""

from collections.abc import Iterable

import numpy as np

from ..errors import GnomonError
from ..estimate.triads.angrisano import (
    AngrisanoFit,
    Status,
    canonical_parameters,
    datasheet_start,
    fit_components,
    fit_magnitudes,
    sensor_jacobian,
)
from ..estimate.triads.triad import TriadFit, TriadPoses, fit_triad
from ..frozen import value_class
from ..geometry.rotations import fixed_entries, frame_rotation, rotation_jacobian
from ..models.angrisano import AngrisanoTriad
from ..recording import Floats
from ..results.result import Booleans
from ..simulate.imu import TABLE_1, PoseSimulation, simulate_poses
from ..simulate.scenarios.recorded import PoseScenario

BITS, FULL_SCALE_M_S2 = 16, 50.0
DATASHEET = datasheet_start(BITS, FULL_SCALE_M_S2)
TRUTH = TABLE_1.parameters

TABLE_2 = np.array([[np.radians(-18), np.radians(19)], [-1500.0, 2500.0], [-0.0006, 0.03]])
"""Convergence intervals of Angrisano about its datasheet start: angles [rad], biases [count], scale factors."""

GROUPS = ("angles", "biases", "scale factors")
STEPS, OURS_EVERY = 30, 5
"""Starts on either side of the datasheet's, up to Table 2's limits widened; gnomon is slower and tries some of them."""

SAME = 1e-3
"""Two solutions are the same minimum if no parameter differs by more than this part of its sigma."""


@value_class(eq=True)
class AngrisanoTrial:
    """What to simulate, and how much wider than in Table 2 the start is drawn."""

    scenario: PoseScenario
    seed: int
    widened: float = 3.0


@value_class
class AngrisanoOutcome:
    """What became of one experiment; parameters are X of Angrisano, Eq. (3), (9,).

    Attributes
    ----------
    paper, paper_sigma : magnitudes by Angrisano's iteration from the datasheet start
    iterations, status : how it got there
    ours, ours_sigma : gnomon's maximum likelihood, which needs no start
    components : known attitudes by Angrisano's iteration, with the attitudes as they were meant
    start : the start that was drawn, with positive scale factors
    paper_from_start : how Angrisano's iteration ended from there
    ours_from_start : largest difference of gnomon's solution from there, in sigmas
    """

    paper: Floats
    paper_sigma: Floats
    iterations: int
    status: Status
    ours: Floats
    ours_sigma: Floats
    components: Floats
    start: Floats
    paper_from_start: Status
    ours_from_start: float

    @property
    def same_minimum(self) -> bool:
        """Whether gnomon's solver ended in the same minimum from the start that was drawn."""
        return self.ours_from_start < SAME


def run_angrisano_trial(trial: AngrisanoTrial) -> AngrisanoOutcome:
    """Simulate one experiment and calibrate it."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    start = drawn_start(np.random.default_rng([trial.seed, 1]), trial.widened)
    paper = paper_fit(simulation, DATASHEET)
    poses = pose_means(simulation)
    ours, covariance = as_angrisano(fit_triad(poses))
    sigma = np.sqrt(np.diag(covariance))
    return AngrisanoOutcome(
        paper=paper.parameters,
        paper_sigma=paper.sigma,
        iterations=paper.iterations,
        status=paper.status,
        ours=ours,
        ours_sigma=sigma,
        components=fit_components(simulation.accelerometer, simulation.meant, DATASHEET).parameters,
        start=start,
        paper_from_start=paper_fit(simulation, start).status,
        ours_from_start=end_distance(poses, start, ours, sigma),
    )


def paper_fit(simulation: PoseSimulation, start: Floats, *, growth_stops: bool = False) -> AngrisanoFit:
    """Carry out Angrisano's iteration (8)-(11) from a start (9,)."""
    gravity = simulation.scenario.gravity
    return fit_magnitudes(simulation.accelerometer, gravity, start, growth_stops=growth_stops)


def pose_means(simulation: PoseSimulation) -> TriadPoses:
    """Return the means with the noise that the samples themselves show."""
    values = np.stack([pose.accelerometer.values for pose in simulation.poses])
    variance = values.var(axis=1, ddof=1).mean(axis=0) / values.shape[1]
    return TriadPoses.of(simulation.accelerometer, simulation.scenario.gravity, variance=variance)


def as_angrisano(fit: TriadFit) -> tuple[Floats, Floats]:
    """Return X (9,) and its covariance (9, 9) of a triad in any frame."""
    rotation = frame_rotation(fit.sensitivity, "accel-z")
    sensitivity = fit.sensitivity @ rotation.T
    X = AngrisanoTriad.from_sensor(sensitivity, fit.bias).parameters
    turn = rotation_jacobian([fit.sensitivity, fit.bias], rotation, "accel-z")
    free = np.setdiff1d(np.arange(12), [3 * i + j for i, j in fixed_entries("accel-z")])
    by_sensor = np.linalg.inv(sensor_jacobian(X, "small-angle")[free]) @ turn[free]
    return X, by_sensor @ fit.covariance[:12, :12] @ by_sensor.T


def end_distance(poses: TriadPoses, start: Floats, solution: Floats, sigma: Floats) -> float:
    """Return how far from a solution gnomon's solver ends when it starts at X (9,), in sigmas; infinite if nowhere."""
    try:
        there, _ = as_angrisano(fit_triad(poses, start=start))
    except GnomonError:
        return float("inf")
    return float(np.max(np.abs(there - solution) / sigma))


def drawn_start(rng: np.random.Generator, widened: float) -> Floats:
    """Draw X (9,) about the datasheet start in Table 2's intervals times a factor; scale factors made positive."""
    low, high = widened * np.repeat(TABLE_2, 3, axis=0).T
    return canonical_parameters(DATASHEET + rng.uniform(low, high))


@value_class
class Basin:
    """Starts that differ from the datasheet's in one group of parameters, all three of it by the same offset.

    Attributes
    ----------
    group : "angles" [rad], "biases" [count] or "scale factors" [m/s^2 per count]
    offset : (m,) ascending, zero among them
    paper : (m,) whether Angrisano's iteration ended in the right minimum
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


@value_class
class Journey:
    """Angrisano's iteration from one start, and where gnomon ends.

    Attributes
    ----------
    name : what is special about the start
    fit : the iteration
    ours : (9,) gnomon's solution from the same start
    """

    name: str
    fit: AngrisanoFit
    ours: Floats


def scan_basins(trial: AngrisanoTrial) -> tuple[Basin, ...]:
    """Return the basins of the three groups in one experiment."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    poses = pose_means(simulation)
    solution, covariance = as_angrisano(fit_triad(poses))
    sigma = np.sqrt(np.diag(covariance))
    basins: list[Basin] = []
    for group, name in enumerate(GROUPS):
        offset = start_offsets(group, trial.widened)
        starts = [shift_start(group, by) for by in offset]
        basins.append(
            Basin(
                group=name,
                offset=offset,
                paper=_truths(paper_fit(simulation, start).converged for start in starts),
                printed=_truths(paper_fit(simulation, start, growth_stops=True).converged for start in starts),
                ours=_truths(
                    end_distance(poses, canonical_parameters(start), solution, sigma) < SAME
                    for start in starts[::OURS_EVERY]
                ),
            )
        )
    return tuple(basins)


def trace_journeys(trial: AngrisanoTrial) -> tuple[Journey, ...]:
    """Return the iterations of Figs. 4 to 6: from the datasheet, from inside Table 2's intervals, and from outside."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    poses = pose_means(simulation)
    starts = {
        "from the datasheet": DATASHEET,
        "from inside the intervals": shift_start(0, 0.8 * TABLE_2[0, 0])
        + shift_start(1, 0.5 * TABLE_2[1, 1])
        - DATASHEET,
        "from outside, angles": _outside(simulation),
    }
    return tuple(
        Journey(name=name, fit=paper_fit(simulation, start), ours=as_angrisano(fit_triad(poses, start=start))[0])
        for name, start in starts.items()
    )


def _outside(simulation: PoseSimulation) -> Floats:
    """Return the start with poor angles from which the iteration gets lost most slowly, which shows most."""
    starts = [shift_start(0, factor * end) for factor in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0) for end in TABLE_2[0]]
    lost = [start for start in starts if not paper_fit(simulation, start).converged]
    return max(lost or starts[-1:], key=lambda start: paper_fit(simulation, start).iterations)


def start_offsets(group: int, widened: float) -> Floats:
    """Return offsets of the start, ascending through zero: equal steps on either side, which differ in size."""
    low, high = widened * TABLE_2[group]
    return np.concatenate([np.linspace(low, 0, STEPS, endpoint=False), np.linspace(0, high, STEPS + 1)])


def shift_start(group: int, by: float) -> Floats:
    """Return the datasheet start (9,) with all three parameters of a group moved."""
    start = DATASHEET.copy()
    start[3 * group : 3 * group + 3] += by
    return start


def _truths(values: Iterable[bool]) -> Booleans:
    return np.fromiter(values, dtype=np.bool_)
