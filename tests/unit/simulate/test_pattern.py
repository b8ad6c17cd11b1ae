"""Pattern matrices of Krebs, section 4.3, whose printed Jacobians are wrong."""

import numpy as np
import pytest

from gnomon.models.forms import DIAGONAL, FULL, LOWER

PATTERNS = {"diagonal": DIAGONAL, "lower": LOWER, "full": FULL}


def test_matrices_are_those_of_figure_4_1():
    np.testing.assert_array_equal(DIAGONAL.matrix(np.array([2.0, 3, 4])), np.diag([2, 3, 4]))
    np.testing.assert_array_equal(LOWER.matrix(np.array([2.0, 3, 4])), [[1, 0, 0], [2, 1, 0], [3, 4, 1]])  # yz zy zx
    np.testing.assert_array_equal(FULL.matrix(np.arange(9.0)), [[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    np.testing.assert_array_equal(FULL.matrix(np.zeros(9)), np.zeros((3, 3)))  # not of the identity


@pytest.mark.parametrize("name", PATTERNS)
def test_parameters_are_what_the_matrix_was_made_of(name):
    pattern = PATTERNS[name]
    parameters = np.random.default_rng(1).normal(size=len(pattern.entries))
    np.testing.assert_array_equal(pattern.parameters(pattern.matrix(parameters)), parameters)


@pytest.mark.parametrize("name", PATTERNS)
def test_derivative_of_the_product(name):
    # The product is affine in the parameters: differences are exact.
    pattern = PATTERNS[name]
    rng = np.random.default_rng(2)
    parameters, v = rng.normal(size=len(pattern.entries)), rng.normal(size=(5, 3))
    jacobian = pattern.product_jacobian(v)
    assert jacobian.shape == (5, 3, len(parameters))
    for k, unit in enumerate(np.eye(len(parameters))):
        difference = v @ pattern.matrix(parameters + unit).T - v @ pattern.matrix(parameters).T
        np.testing.assert_allclose(jacobian[:, :, k], difference, rtol=0, atol=1e-14)


def test_a_wrong_number_of_parameters_is_refused():
    with pytest.raises(ValueError, match="zip"):
        LOWER.matrix(np.zeros(4))
