"""Steps and warm-ups of biases, told from noise and from wander by the rests alone."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.estimate.multiposition.bias_changes import accelerometer_changes, gyroscope_changes
from gnomon.estimate.multiposition.bias_segments import with_bias_segments
from gnomon.estimate.multiposition.fit import fit_multiposition

N = 40
T_S = np.concatenate([[25.0], 50 + 6.0 * np.arange(N - 1)])
HALF_S = np.concatenate([[25.0], np.full(N - 1, 2.0)])
SIGMA = 4e-4 / np.sqrt(2 * HALF_S)[:, None] * np.ones(3)


def directions(rng):
    u = rng.normal(size=(N, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def gyroscope(rng, bias):
    u = directions(rng)
    means = bias + 1e-4 * u @ rng.normal(size=(3, 3)) + SIGMA * rng.normal(size=(N, 3))
    return gyroscope_changes(T_S, HALF_S, means, SIGMA**2, u)


def accelerometer(rng, bias):
    shape = np.eye(3) + 0.02 * rng.normal(size=(3, 3))
    means = directions(rng) @ shape.T + bias + SIGMA * rng.normal(size=(N, 3))
    return accelerometer_changes(T_S, HALF_S, means, SIGMA**2)


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
        np.testing.assert_array_equal(found.segments(N), np.arange(N) >= at)


@pytest.mark.parametrize("find", [gyroscope, accelerometer])
def test_a_warm_up_is_no_step(find):
    rng = np.random.default_rng(3)
    for tau in (30.0, 90.0):
        ratio = HALF_S / tau
        course = 2e-2 * np.exp(-T_S / tau) * np.sinh(ratio) / ratio
        found = find(rng, course[:, None] * np.array([0.5, 0.6, -0.6]))
        assert 0.5 * tau < found.warm_up_s < 2 * tau
        assert not found.steps


def test_a_rest_that_stands_out_is_no_step():
    rng = np.random.default_rng(4)
    bias = np.zeros((N, 3))
    bias[17] = 5e-3
    found = gyroscope(rng, bias)
    assert found.outlying == (17,)
    assert not found


@pytest.mark.parametrize("reference", [-1, 0, None])
def test_segments_that_are_given_have_biases_of_their_own(multiposition, reference):
    """Turn-on biases of two joined parts: the bias of the model is that of the reference, or the mean of both."""
    problem, _ = multiposition(5, intervals=30, t_init_s=20.0, gyroscope_noise_density=1e-4)
    data, step = problem.data, np.array([0.02, -0.01, 0.015]) / problem.gyroscope.spread
    segment = (np.arange(30) >= 12).astype(np.int64)
    moved = data.gyroscope + segment[:, None] * step
    before = fit_multiposition(data, g_sensitivity=False).state.matrices[3]
    rate = np.array(data.segments.gyroscope)
    rate[int(data.segments.first[12]) :] += step

    data = replace(data, gyroscope=moved, segments=replace(data.segments, gyroscope=rate))
    sigma = None if reference is not None else np.abs(step)
    fit = fit_multiposition(
        with_bias_segments(data, gyroscope=segment, reference=reference, gyroscope_sigma=sigma), g_sensitivity=False
    )
    expected = before + {-1: 1.0, 0: 0.0, None: 0.5}[reference] * step
    np.testing.assert_allclose(fit.state.matrices[3], expected, atol=0.03 * np.abs(step).min())
    np.testing.assert_allclose(np.ptp(fit.drift, axis=0), np.abs(step), rtol=0.03)
    assert not fit.data.linked[11]
    assert fit.converged
