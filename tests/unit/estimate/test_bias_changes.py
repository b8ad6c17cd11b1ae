"""Steps and warm-ups of biases, told from noise and from wander by the rests alone."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.estimate.multiposition.bias_changes import (
    BiasChanges,
    RestMeans,
    _products_before,
    _squares_before,
    accelerometer_changes,
    gyroscope_changes,
    shares_before,
)
from gnomon.estimate.multiposition.bias_functions import with_bias_steps
from gnomon.estimate.multiposition.evidence import unseen_changes
from gnomon.estimate.multiposition.fit import fit_multiposition
from gnomon.results.result import StaticIntervals, split_long

N = 40
T_S = np.concatenate([[25.0], 50 + 6.0 * np.arange(N - 1)])
HALF_S = np.concatenate([[25.0], np.full(N - 1, 2.0)])
SIGMA = 4e-4 / np.sqrt(2 * HALF_S)[:, None] * np.ones(3)


def test_products_before_each_row_are_those_of_the_rows_before_it():
    rng = np.random.default_rng(8)
    root, columns = rng.normal(size=(2, 9, 9)), rng.normal(size=(9, 3))
    matrices = root @ np.swapaxes(root, 1, 2)
    found = _products_before(matrices, columns)
    for row in range(9):
        before = columns[: row + 1]
        expected = before.T @ matrices[:, : row + 1, : row + 1] @ before
        np.testing.assert_allclose(found[:, row], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        _squares_before(matrices, columns), np.einsum("knii->kni", found), rtol=1e-12, atol=1e-12
    )


def directions(rng):
    u = rng.normal(size=(N, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def gyroscope(rng, bias):
    u = directions(rng)
    means = bias + 1e-4 * u @ rng.normal(size=(3, 3)) + SIGMA * rng.normal(size=(N, 3))
    return gyroscope_changes(RestMeans(rest=np.arange(N), t_s=T_S, half_s=HALF_S, means=means, variance=SIGMA**2), u)


def accelerometer(rng, bias):
    shape = np.eye(3) + 0.02 * rng.normal(size=(3, 3))
    means = directions(rng) @ shape.T + bias + SIGMA * rng.normal(size=(N, 3))
    return accelerometer_changes(RestMeans(rest=np.arange(N), t_s=T_S, half_s=HALF_S, means=means, variance=SIGMA**2))


@pytest.mark.parametrize("size", [0.0, 1e-5, 1e-4])
def test_noise_and_wander_are_no_steps(size):
    rng = np.random.default_rng(1)
    root = np.sqrt(np.diff(T_S, prepend=0) / 6)[:, None]
    found = [
        find(rng, np.cumsum(size * root * rng.normal(size=(N, 3)), axis=0)) for find in (gyroscope, accelerometer) * 8
    ]
    assert sum(map(bool, found)) <= 1  # one or two in a hundred by chance where it wanders


@pytest.mark.parametrize("find", [gyroscope, accelerometer])
def test_a_step_is_found_where_it_is(find):
    rng = np.random.default_rng(2)
    for size, at in ((3e-2, 20), (3e-3, 9), (2e-3, 33)):
        found = find(rng, size * np.array([0.6, -0.6, 0.5]) * (np.arange(N) >= at)[:, None])
        assert found.steps == (at,)
        assert not found.warm_up_s
        np.testing.assert_array_equal(shares_before(found.steps[0], N), np.arange(N) < at)


@pytest.mark.parametrize("find", [gyroscope, accelerometer])
def test_a_warm_up_is_no_step(find):
    rng = np.random.default_rng(3)
    for tau in (30.0, 90.0):
        ratio = HALF_S / tau
        course = 2e-2 * np.exp(-T_S / tau) * np.sinh(ratio) / ratio
        found = find(rng, course[:, None] * np.array([0.5, 0.6, -0.6]))
        assert 0.5 * tau < found.warm_up_s < 2 * tau
        assert not found.steps


@pytest.mark.parametrize("count", range(17, 24))
def test_recordings_of_about_twenty_rests_are_searched_for_another_sensor(count):
    rng = np.random.default_rng(7)
    means = (9.8 * directions(rng) + SIGMA * rng.normal(size=(N, 3)))[:count]
    rests = RestMeans(
        rest=np.arange(count), t_s=T_S[:count], half_s=HALF_S[:count], means=means, variance=SIGMA[:count] ** 2
    )
    assert not accelerometer_changes(rests)


def test_a_rest_that_stands_out_is_no_step():
    rng = np.random.default_rng(4)
    bias = np.zeros((N, 3))
    bias[17] = 5e-3
    found = gyroscope(rng, bias)
    assert found.outlying == (17,)
    assert not found


def test_parts_of_a_long_rest_show_when_a_bias_stepped_within_it():
    """The initial rest in eight parts: one place among them, and 2.3 of them are 2.3 / 8 of the rest."""
    rng = np.random.default_rng(5)
    rest = np.repeat(np.arange(N), [8, *[1] * (N - 1)])
    t_s = np.concatenate([3.0 + 6.0 * np.arange(8), T_S[1:]])
    sigma = 4e-4 / np.sqrt(6.0) * np.ones((len(rest), 3))
    u = directions(rng)
    means = u[rest] + shares_before(2.3, len(rest))[:, None] * 8e-3 * u[0] + sigma * rng.normal(size=sigma.shape)
    rests = RestMeans(rest=rest, t_s=t_s, half_s=np.full(len(rest), 2.0), means=means, variance=sigma**2)
    [place] = accelerometer_changes(rests).steps
    assert abs(place - 2.3 / 8) < 0.02
    assert rests.place(8.0) == 1.0


def test_long_intervals_are_split():
    parts, whole = split_long(StaticIntervals(start=np.array([0, 100, 130]), stop=np.array([95, 110, 140])), 8)
    np.testing.assert_array_equal(whole, [0] * 8 + [1, 2])
    assert (parts.start[0], parts.stop[7]) == (0, 95)
    np.testing.assert_array_equal(parts.stop[:7], parts.start[1:8])


def test_each_part_has_a_bias_of_its_own(multiposition):
    problem, _ = multiposition(5, intervals=30, t_init_s=20.0, gyroscope_noise_density=1e-4)
    data, step = problem.data, np.array([0.02, -0.01, 0.015]) / problem.gyroscope.spread
    moved = data.gyroscope + (np.arange(30) >= 12)[:, None] * step
    before_it = fit_multiposition(data, g_sensitivity=False).state.matrices[3]
    rate = np.array(data.segments.gyroscope)
    rate[int(data.segments.first[12]) :] += step
    data = replace(data, gyroscope=moved, segments=replace(data.segments, gyroscope=rate))
    fit = fit_multiposition(with_bias_steps(data, gyroscope=(12.0,)), g_sensitivity=False)
    np.testing.assert_allclose(fit.state.matrices[3], before_it + step, atol=0.03 * np.abs(step).min())
    np.testing.assert_allclose(np.ptp(fit.drift, axis=0), np.abs(step), rtol=0.03)
    assert not fit.data.linked[11]
    assert fit.converged


def test_a_step_that_is_not_in_the_model_widens_the_sigma_of_the_bias(multiposition):
    """Nothing is added where nothing changed; where a step was not taken, as much as the bias is off by it."""
    problem, _ = multiposition(6, intervals=30, t_init_s=20.0)
    nothing = (BiasChanges(), BiasChanges())
    for size, low, high in ((0.0, 0.0, 0.7), (1e-2, 1.0, np.inf)):
        step = (np.arange(30) >= 20)[:, None] * (size * np.array([0.6, -0.6, 0.5]) / problem.accelerometer.spread)
        data = replace(problem.data, accelerometer=problem.data.accelerometer + step)
        fit = fit_multiposition(data, g_sensitivity=False, changes=nothing)
        ratio = np.sqrt(np.diag(unseen_changes(fit))[6:9] / np.diag(fit.covariance)[6:9])
        assert low <= ratio.max() <= high
