"""The equations of a triad's poses: derivatives against differences, and what noise does to a length."""

import numpy as np
import pytest

from gnomon.estimate.triads.triad_problem import (
    TriadNoiseLevels,
    TriadPoses,
    eliminate_directions,
    noise_at,
    triad_residuals,
)
from gnomon.estimate.triads.triad_solve import TriadScaling, scaled_problem


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def poses_of_all_kinds(seed):
    """Poses at rest, of known length, and of known direction, with all errors that there are."""
    rng = np.random.default_rng(seed)
    n = 30
    magnitude = np.repeat([0.0, 2.0, 5.0], n // 3)
    direction, force = unit(rng.normal(size=(n, 3))), 9.8 * unit(rng.normal(size=(n, 3)))
    sensitivity = 100 * (np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)))
    measured = (magnitude[:, None] * direction) @ sensitivity.T + 700 + force @ rng.normal(0, 0.1, (3, 3)).T
    direction[::2] = np.nan
    return TriadPoses(
        measured=measured + rng.normal(0, 0.5, (n, 3)),
        variance=rng.uniform(0.05, 0.5, (n, 3)),
        magnitude=magnitude,
        magnitude_sigma=np.full(n, 1e-3),
        group=np.repeat([0, 0, 1], n // 3),
        group_sigma=np.array([1e-3, 2e-3]),
        direction=direction,
        direction_sigma=np.full(n, 5e-3),
        force=force,
    )


def point_near(problem, scaling, seed):
    rng = np.random.default_rng(seed)
    theta = np.zeros(len(problem.free))
    theta[:9] = (scaling.size * 100 * np.eye(3) / scaling.spread[:, None]).ravel()
    theta[9:12] = (700 - scaling.centre) / scaling.spread
    return theta + rng.normal(0, 2e-3, len(theta))


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_are_those_of_the_cost(seed):
    # A direction that is eliminated has no first-order part in the derivative of the cost.
    poses = poses_of_all_kinds(seed)
    scaling = TriadScaling.of(poses)
    problem = scaled_problem(poses, scaling, None, g_sensitivity=True, unknown_scale=True)
    assert problem.free.all()
    theta = point_near(problem, scaling, seed)
    noise = noise_at(problem, theta, 1e-4)

    def cost(x):
        return 0.5 * np.sum(triad_residuals(problem, x, noise).residual ** 2)

    at = triad_residuals(problem, theta, noise)
    steps = 1e-5 * np.eye(len(theta))
    expected = np.array([(cost(theta + step) - cost(theta - step)) / 2e-5 for step in steps])
    size = np.linalg.norm(at.jacobian, axis=0) * np.linalg.norm(at.residual)
    assert np.abs(at.jacobian.T @ at.residual - expected).max() < 2e-3 * size.max()
    assert len(at.residual) == 3 * 10 + 10 + 3 * 10  # rest; half of the others has three equations


def test_length_by_noise_is_taken_off():
    # |m| of a sphere's noisy points is too long by sigma^2 / w on the average.
    rng = np.random.default_rng(1)
    n, sigma = 200_000, 0.05
    u = unit(rng.normal(size=(n, 3)))
    poses = TriadPoses.of(u + rng.normal(0, sigma, (n, 3)), 1.0, variance=sigma**2)
    problem = scaled_problem(poses, TriadScaling.of(poses), None, g_sensitivity=False, unknown_scale=False)
    scaling = TriadScaling.of(poses)
    theta = np.zeros(len(problem.free))
    theta[:9], theta[9:12] = np.diag(1 / scaling.spread).ravel(), -scaling.centre / scaling.spread
    noise = noise_at(problem, theta, 0.0)
    np.testing.assert_allclose(noise.excess, sigma**2, rtol=0.01)
    plain = TriadNoiseLevels(covariance=noise.covariance, excess=np.zeros(n))
    assert abs(eliminate_directions(problem, theta, noise).error.mean()) < 3 * sigma / np.sqrt(n)
    assert eliminate_directions(problem, theta, plain).error.mean() > 15 * sigma / np.sqrt(n)
