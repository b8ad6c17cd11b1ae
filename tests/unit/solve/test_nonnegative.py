"""Least squares with unknowns that are not below zero, beside SciPy's."""

import numpy as np
import pytest
from scipy.optimize import nnls

from gnomon.solve.least_squares import solve_nonnegative


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("seed", range(12))
def test_it_is_what_scipy_finds(seed, noise):
    rng = np.random.default_rng(seed)
    columns = int(rng.integers(1, 8))
    tau = np.geomspace(1, 1e6, 20)[:, None]
    powers = tau ** np.array([-2, -1, 0, 1, -0.5, 0.5, -1.5])[:columns]  # as of an Allan variance
    for A in (powers / powers.sum(axis=1, keepdims=True), rng.normal(size=(20, columns))):
        b = A @ np.maximum(rng.normal(size=columns), 0) + noise * rng.normal(size=20)
        expected = nnls(A, b)[0]
        tolerance = 1e-9 * max(expected.max(), 1e-3)
        np.testing.assert_allclose(solve_nonnegative(A, b), expected, atol=tolerance)
        for near in (expected, np.ones(columns), rng.normal(size=columns)):
            np.testing.assert_allclose(solve_nonnegative(A, b, near), expected, atol=tolerance)


def test_what_only_negative_numbers_would_explain_is_zero():
    np.testing.assert_array_equal(solve_nonnegative(np.eye(3), np.array([-1.0, -2.0, 0.0])), np.zeros(3))
