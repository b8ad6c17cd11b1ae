"""Polynomials through calibrations at several temperatures: order by evidence, sigmas that hold."""

import numpy as np
import pytest

from gnomon.estimate.trust.between_recordings import (
    Calibrations,
    RecordingBlock,
    join_estimates,
    proven_order,
    regress_estimates,
)

DEGC = np.array([-20.0, -10.0, 0.0, 5.0, 15.0, 25.0])


def drawn(seed, coefficients, scatter=1e-3, sigma=5e-4):
    """Calibrations of three scalars whose truth is known."""
    rng = np.random.default_rng(seed)
    values = np.vander(DEGC, len(coefficients), increasing=True) @ np.asarray(coefficients)[:, None] * np.ones(3)
    values = values + rng.normal(0, np.hypot(scatter, sigma), values.shape)
    blocks = {"accelerometer_scale": RecordingBlock(index=np.arange(3), usual=1e-3)}
    return Calibrations(degc=DEGC, values=values, covariances=np.array([sigma**2 * np.eye(3)] * 6), blocks=blocks)


@pytest.mark.parametrize("coefficients", [(1.0,), (1.0, 4e-4), (1.0, 1e-4, 3e-5)])
def test_the_order_is_the_true_one(coefficients):
    for seed in range(5):
        assert proven_order(drawn(seed, coefficients), 2) == len(coefficients) - 1


def test_sigmas_are_those_of_the_errors():
    z = []
    for seed in range(60):
        found = drawn(seed, (1.0, 4e-4)).fit({"accelerometer_scale": 1})
        places = found.start[:-1] + 1
        z.append((found.coefficients[places] - 4e-4) / np.sqrt(np.diag(found.covariance)[places]))
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_a_recording_that_is_another_sensor_lies_off():
    recorded = drawn(3, (1.0, 4e-4))
    recorded.values[2] += 0.05
    z, _ = recorded.foretold(1)
    assert np.abs(z).argmax() // 3 == 2


def test_the_mean_is_the_polynomial_of_order_zero():
    recorded = drawn(1, (1.0,))
    blocks = list(recorded.blocks.values())
    mean = join_estimates(recorded.values, recorded.covariances, blocks)
    found = regress_estimates(recorded.values, recorded.covariances, blocks, [np.ones((6, 1))])
    assert np.array_equal(mean.mean, found.coefficients)
    assert np.array_equal(mean.scatter, found.scatter)
