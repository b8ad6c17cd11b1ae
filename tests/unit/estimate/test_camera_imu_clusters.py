"""Pulls and information of stretches of time: what they sum up to, and the covariance that comes from them."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from camera_imu_problem import problem
from gnomon.estimate.camera_imu.batch import linearize_batch
from gnomon.estimate.camera_imu.gauss_newton import gauss_newton_step
from gnomon.estimate.camera_imu.result.uncertainty import bias_sides, cluster_sums
from gnomon.estimate.camera_imu.solution import Solution
from gnomon.estimate.camera_imu.trajectory import POSE


def solution(of):
    """Return the linearisation of a problem as if it were its solution, no step taken."""
    lin = linearize_batch(of.measurements, of.state, of.layout, of.noise, probing=True)
    return Solution(
        state=of.state, measurements=of.measurements, noise=of.noise, noise_found=of.noise, layout=of.layout, lin=lin,
        step=gauss_newton_step(lin), iterations=(), converged=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"segments": 3, "imus": 2, "apart": True},
        {"rolling": True, "flat": False, "order": 4},
        {"board": 12, "segments": 2, "rolling": True},
        {"fixed": ("imu0.S_a[1]", "cam0.intrinsics[2]", "gravity.magnitude"), "huber": 1.0},
    ],
    ids=str,
)
def test_all_stretches_together_are_the_equations_with_the_trajectory_eliminated(changes):
    whole = solution(problem(**changes))
    factor, sides, p = whole.step.factor, bias_sides(whole), whole.layout.dense
    schur, right = factor.schur[:p, :p], factor.schur_sides[:p, 0]
    if len(factor.schur) > p:  # the corners of the board are eliminated, too
        gain = np.linalg.solve(factor.schur[p:, p:], factor.schur[p:, :p]).T
        schur = schur - gain @ factor.schur[p:, :p]
        right = right - gain @ factor.schur_sides[p:, 0]
    sums = cluster_sums(whole)
    total, pull = sums.total, sums.pull.sum(axis=0) + sums.prior_pull
    size = np.concatenate([np.sqrt(np.diag(schur)), 1 / np.sqrt(np.diag(factor.inner(sides)))])
    expected = np.zeros_like(total)
    expected[:p, :p] = schur
    expected[p:, p:] = np.linalg.inv(factor.inner(sides))
    np.testing.assert_allclose(total / np.outer(size, size), expected / np.outer(size, size), atol=1e-7)
    np.testing.assert_allclose(pull[:p] / size[:p], right / size[:p], rtol=1e-6, atol=1e-6)
    # The means of the biases, with everything in the border held, move by their share of the chain's step.
    moved = factor.substituted(0, np.zeros(len(whole.layout)))[:, POSE:].T @ _mean_weights(whole)
    np.testing.assert_allclose(np.linalg.solve(total[p:, p:], pull[p:]), moved, rtol=1e-5)


def _mean_weights(whole):
    grid = whole.state.trajectory.grid
    index, t_s = grid.knot_times()
    weights = np.zeros(grid.controls)
    for segment in grid.segments:
        own = (t_s >= segment.start_s - 1e-9) & (t_s < segment.start_s + (segment.spans + 0.5) * grid.spacing_s)
        weights[index[own]] = 1.0
        weights[index[own][[0, -1]]] = 0.5
    return weights / weights.sum()
