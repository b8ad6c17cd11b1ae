"""One simulated experiment of document C, calibrated by its method and by gnomon's."""

from dataclasses import dataclass

import numpy as np

from ..errors import GnomonError
from ..estimate.triads.angrisano import (
    AngrisanoFit,
    Status,
    canonical,
    datasheet_start,
    fit_components,
    fit_magnitudes,
    sensor_jacobian,
)
from ..estimate.triads.triad import TriadFit, TriadPoses, fit_triad
from ..models.angrisano import AngrisanoTriad
from ..models.frames import fixed_entries, frame_rotation, rotation_jacobian
from ..recording import Floats
from ..simulate.poses import TABLE_1, PoseSimulation, simulate_poses
from ..simulate.scenarios import PoseScenario

BITS, FULL_SCALE_M_S2 = 16, 50.0
DATASHEET = datasheet_start(BITS, FULL_SCALE_M_S2)
TRUTH = TABLE_1.parameters

TABLE_2 = np.array([[np.radians(-18), np.radians(19)], [-1500.0, 2500.0], [-0.0006, 0.03]])
"""Convergence intervals of document C about its datasheet start: angles [rad], biases [count], scale factors."""

SAME = 1e-3
"""Two solutions are the same minimum if no parameter differs by more than this part of its sigma."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What to simulate, and how much wider than in Table 2 the start is drawn."""

    scenario: PoseScenario
    seed: int
    widened: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialOutcome:
    """What became of one experiment; parameters are X of document C, Eq. (3), (9,).

    Attributes
    ----------
    paper, paper_sigma : magnitudes by document C's iteration from the datasheet start
    iterations, status : how it got there
    ours, ours_sigma : gnomon's maximum likelihood, which needs no start
    components : known attitudes by document C's iteration, with the attitudes as they were meant
    start : the start that was drawn, with positive scale factors
    paper_from_start : how document C's iteration ended from there
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


def run_trial(trial: Trial) -> TrialOutcome:
    """Simulate one experiment and calibrate it."""
    simulation = simulate_poses(trial.scenario, trial.seed)
    start = drawn_start(np.random.default_rng([trial.seed, 1]), trial.widened)
    paper = paper_fit(simulation, DATASHEET)
    poses = pose_means(simulation)
    ours, covariance = in_document_c(fit_triad(poses))
    sigma = np.sqrt(np.diag(covariance))
    return TrialOutcome(
        paper=paper.parameters,
        paper_sigma=paper.sigma,
        iterations=paper.iterations,
        status=paper.status,
        ours=ours,
        ours_sigma=sigma,
        components=fit_components(simulation.accelerometer, simulation.meant, DATASHEET).parameters,
        start=start,
        paper_from_start=paper_fit(simulation, start).status,
        ours_from_start=distance(poses, start, ours, sigma),
    )


def paper_fit(simulation: PoseSimulation, start: Floats, *, growth_stops: bool = False) -> AngrisanoFit:
    """Carry out document C's iteration (8)-(11) from a start (9,)."""
    gravity = simulation.scenario.gravity
    return fit_magnitudes(simulation.accelerometer, gravity, start, growth_stops=growth_stops)


def pose_means(simulation: PoseSimulation) -> TriadPoses:
    """Return the means with the noise that the samples themselves show."""
    values = np.stack([pose.accelerometer.values for pose in simulation.poses])
    variance = values.var(axis=1, ddof=1).mean(axis=0) / values.shape[1]
    return TriadPoses.of(simulation.accelerometer, simulation.scenario.gravity, variance=variance)


def in_document_c(fit: TriadFit) -> tuple[Floats, Floats]:
    """Return X (9,) and its covariance (9, 9) of a triad in any frame."""
    rotation = frame_rotation(fit.sensitivity, "accel-z")
    sensitivity = fit.sensitivity @ rotation.T
    X = AngrisanoTriad.from_sensor(sensitivity, fit.bias).parameters
    turn = rotation_jacobian([fit.sensitivity, fit.bias], rotation, "accel-z")
    free = np.setdiff1d(np.arange(12), [3 * i + j for i, j in fixed_entries("accel-z")])
    by_sensor = np.linalg.inv(sensor_jacobian(X, "small-angle")[free]) @ turn[free]
    return X, by_sensor @ fit.covariance[:12, :12] @ by_sensor.T


def distance(poses: TriadPoses, start: Floats, solution: Floats, sigma: Floats) -> float:
    """Return how far from a solution gnomon's solver ends when it starts at X (9,), in sigmas; infinite if nowhere."""
    try:
        there, _ = in_document_c(fit_triad(poses, start=start))
    except GnomonError:
        return float("inf")
    return float(np.max(np.abs(there - solution) / sigma))


def drawn_start(rng: np.random.Generator, widened: float) -> Floats:
    """Draw X (9,) about the datasheet start in Table 2's intervals times a factor; scale factors made positive."""
    low, high = widened * np.repeat(TABLE_2, 3, axis=0).T
    return canonical(DATASHEET + rng.uniform(low, high))
