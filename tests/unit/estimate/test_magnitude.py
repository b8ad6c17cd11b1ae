"""A triad from a known magnitude: the closed-form start, the fit, its derivatives and its covariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gnomon import InitialisationError
from gnomon.estimate.multiposition import measurements
from gnomon.estimate.multiposition.measurements import UPPER, ellipsoid_start, fit_magnitude

GRAVITY = 9.79


def lattice(n):
    """Directions (n, 3) that cover the sphere."""
    z = 1 - (2 * np.arange(n) + 1) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(longitude), np.sqrt(1 - z * z) * np.sin(longitude), z])


def sensor(seed, scale=415.0, offset=32768.0, skewness=0.05):
    """A triangular correction C (3, 3), f = C (m - b), and a bias (3,)."""
    rng = np.random.default_rng(seed)
    correction = np.triu(np.eye(3) + rng.uniform(-skewness, skewness, (3, 3))) / scale
    return correction, offset + rng.normal(0, 100, 3)


def readings(correction, bias, forces):
    return forces @ np.linalg.inv(correction).T + bias


def close(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1000),
    logarithm=st.lists(st.floats(-8, 8), min_size=3, max_size=3),
    offset=st.floats(-1e3, 1e3),  # in units of gravity's reading
    skewness=st.floats(0, 0.5),
    n=st.integers(12, 40),
)
def test_start_is_exact_whatever_the_unit_and_the_offset(seed, logarithm, offset, skewness, n):
    # Every axis in a unit of its own, sixteen decades apart at most.
    correction, _ = sensor(seed, scale=1.0, skewness=skewness)
    unit = 10.0 ** np.array(logarithm)
    bias = offset * np.array([1.0, -0.7, 0.4])
    found, found_bias = ellipsoid_start((readings(correction, bias, lattice(n))) * unit)
    rounding = 1e-10 * max(1.0, abs(offset))  # the data themselves are rounded to so much of gravity's reading
    close(found * unit, correction, rounding)
    assert np.abs(found_bias / unit - bias).max() < rounding


@pytest.mark.parametrize("residual", ["magnitude", "square"])
@pytest.mark.parametrize("scale", [1e-4, 415.0, 1e7])
def test_fit_of_noiseless_data_is_exact(scale, residual):
    correction, bias = sensor(3, scale=scale, offset=20 * scale)
    fit = fit_magnitude(readings(correction, bias, GRAVITY * lattice(15)), GRAVITY, residual=residual)
    close(fit.correction, correction, 1e-11)
    close(fit.bias, bias, 1e-12)
    assert np.abs(fit.residual).max() < 1e-9
    assert fit.converged
    np.testing.assert_array_equal(fit.correction[np.tril_indices(3, -1)], 0.0)


def test_nine_attitudes_are_enough_and_eight_are_not():
    correction, bias = sensor(4)
    measured = readings(correction, bias, GRAVITY * lattice(9))
    close(fit_magnitude(measured, GRAVITY).correction, correction, 1e-9)
    with pytest.raises(InitialisationError, match="8 attitudes"):
        fit_magnitude(measured[:8], GRAVITY)


def around_a_cone():
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    return np.column_stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(30, 0.8)])


def on_a_hyperboloid():
    x, y = np.random.default_rng(1).uniform(-2, 2, (2, 30))
    return np.column_stack([x, y, np.sqrt(1 + x * x + y * y) * np.sign(np.arange(30) % 2 - 0.5)])


@pytest.mark.parametrize("points", [around_a_cone(), on_a_hyperboloid(), np.zeros((30, 3)), lattice(30) * [1, 1, 0]])
def test_points_that_determine_no_ellipsoid_are_refused(points):
    with pytest.raises(InitialisationError):
        ellipsoid_start(1000.0 + 50.0 * points)


def spied_problem(monkeypatch, *args, **options):
    """Return the problem, the minimum and the fit that `fit_magnitude` works with."""
    seen = []

    def spy(problem, *rest):
        solution = plain(problem, *rest)
        seen.append((problem, solution))
        return solution

    plain = measurements.levenberg_marquardt
    monkeypatch.setattr(measurements, "levenberg_marquardt", spy)
    fit = fit_magnitude(*args, **options)
    return *seen[0], fit


@pytest.mark.parametrize("residual", ["magnitude", "square"])
def test_jacobian_is_the_derivative(monkeypatch, residual):
    rng = np.random.default_rng(5)
    correction, bias = sensor(5)
    measured = readings(correction, bias, GRAVITY * lattice(12)) + rng.normal(0, 40.0, (12, 3))
    weight = rng.uniform(0.5, 2, 12)
    problem, solution, _ = spied_problem(monkeypatch, measured, GRAVITY, weight, residual)
    for x in (solution.x, solution.x + rng.normal(0, 0.2, 9)):  # at the minimum and away from it
        jacobian = problem(x)[1]
        for k, h in enumerate(1e-5 * np.eye(9)):
            difference = (problem(x + h)[0] - problem(x - h)[0]) / 2e-5
            np.testing.assert_allclose(jacobian[:, k], difference, rtol=1e-6, atol=1e-7 * np.abs(jacobian).max())


def noisy(rng, n=25, sigma=3.2):
    correction, bias = sensor(6)
    forces = GRAVITY * lattice(n)
    return correction, bias, readings(correction, bias, forces) + rng.normal(0, sigma, (n, 3))


def test_fit_is_a_minimum_and_uses_its_weights():
    rng = np.random.default_rng(7)
    *_, measured = noisy(rng)
    weight = rng.uniform(0.5, 2, len(measured))
    fit = fit_magnitude(measured, GRAVITY, weight)

    def cost(correction, bias):
        return 0.5 * np.sum((weight * (GRAVITY - np.linalg.norm((measured - bias) @ correction.T, axis=1))) ** 2)

    assert fit.cost == pytest.approx(cost(fit.correction, fit.bias))
    sigma = np.sqrt(np.diag(fit.covariance)) * np.sqrt(2 * fit.cost / (len(measured) - 9))
    for k in range(9):
        for step in (-0.05 * sigma[k], 0.05 * sigma[k]):
            correction, bias = fit.correction.copy(), fit.bias.copy()
            if k < 6:
                correction[UPPER[0][k], UPPER[1][k]] += step
            else:
                bias[k - 6] += step
            assert cost(correction, bias) > fit.cost
    twice = np.concatenate([measured, measured[:3]])  # a weight of sqrt(2) is the attitude seen twice
    by_weight = fit_magnitude(measured, GRAVITY, np.where(np.arange(len(measured)) < 3, np.sqrt(2), 1.0))
    close(fit_magnitude(twice, GRAVITY).correction, by_weight.correction, 1e-9)


def test_fit_follows_the_unit():
    *_, measured = noisy(np.random.default_rng(8))
    fit = fit_magnitude(measured, GRAVITY)
    unit, offset = np.array([1e-5, 20.0, 3e4]), np.array([7.0, -1e3, 0.0])
    other = fit_magnitude((measured + offset) * unit, GRAVITY)
    close(other.correction * unit, fit.correction, 1e-10)
    close(other.bias / unit - offset, fit.bias, 1e-10)
    close(other.residual, fit.residual, 1e-9)
    scale = np.concatenate([1 / np.broadcast_to(unit, (3, 3))[UPPER], unit])
    close(other.covariance / np.outer(scale, scale), fit.covariance, 1e-8)


def test_leverage_foretells_the_error_of_an_attitude_that_is_left_out():
    *_, measured = noisy(np.random.default_rng(9), n=30)
    fit = fit_magnitude(measured, GRAVITY)
    foretold = fit.residual / (1 - fit.leverage)
    assert fit.leverage.sum() == pytest.approx(9)
    refitted = np.empty(30)
    for k in range(30):
        other = fit_magnitude(np.delete(measured, k, axis=0), GRAVITY)
        refitted[k] = GRAVITY - np.linalg.norm(other.correction @ (measured[k] - other.bias))
    np.testing.assert_allclose(foretold, refitted, atol=2e-3 * np.abs(refitted).max())  # one step of a nonlinear fit


def test_covariance_is_what_repeated_measurements_scatter_by():
    rng = np.random.default_rng(10)
    correction, bias = sensor(6)
    force_sigma = 0.004  # noise of an interval's mean [m/s^2], the same in all directions
    forces = GRAVITY * lattice(25)
    truth = np.concatenate([correction[UPPER], bias])
    errors = []
    for _ in range(300):
        fit = fit_magnitude(readings(correction, bias, forces + rng.normal(0, force_sigma, forces.shape)), GRAVITY)
        errors.append(np.concatenate([fit.correction[UPPER], fit.bias]) - truth)
    errors = np.array(errors)
    covariance = force_sigma**2 * fit.covariance
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.diag(covariance))
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)  # 3.6 sigma of a standard deviation from 300
    nees = np.einsum("ki,ij,kj->k", errors, np.linalg.inv(covariance), errors)
    assert nees.mean() == pytest.approx(9, abs=3.3 * np.sqrt(18 / 300))
