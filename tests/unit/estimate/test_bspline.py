"""Uniform B-splines against scipy's, and what their basis functions must obey."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from gnomon.estimate.camera_imu.trajectory import basis_matrix, bspline_basis

ORDERS = range(1, 8)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_values_and_derivatives_are_those_of_scipy(order, derivative):
    rng = np.random.default_rng(order)
    spans, count = 7, 7 + order - 1
    controls = rng.normal(size=(count, 3))
    spline = BSpline(np.arange(count + order) - (order - 1.0), controls, order - 1)
    place = np.sort(rng.uniform(0, spans, 50))
    first = place.astype(np.int64)
    weights = bspline_basis(order, place - first, derivative)
    found = np.einsum("nk,nkj->nj", weights, controls[first[:, None] + np.arange(order)])
    expected = spline(place, nu=derivative) if derivative < order else np.zeros_like(found)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_basis_functions_sum_to_one_and_are_not_negative(order):
    u = np.linspace(0, 1, 101)
    values = bspline_basis(order, u)
    assert values.shape == (101, order)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, rtol=0, atol=1e-15)
    assert values.min() > -1e-16
    for derivative in range(1, order):
        np.testing.assert_allclose(bspline_basis(order, u, derivative).sum(axis=1), 0.0, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [4, 5, 6])
def test_pieces_join_with_all_derivatives_but_the_last(order):
    start, end = np.zeros(1), np.ones(1)
    for derivative in range(order - 1):
        before, after = bspline_basis(order, end, derivative)[0], bspline_basis(order, start, derivative)[0]
        # control point i + 1 of the span before is control point i of the span after
        np.testing.assert_allclose(before[1:], after[:-1], rtol=0, atol=1e-12)
        assert abs(before[0]) < 1e-12
        assert abs(after[-1]) < 1e-12
    assert abs(bspline_basis(order, end, order - 1)[0, 1:] - bspline_basis(order, start, order - 1)[0, :-1]).max() > 0.5


def test_cubic_as_printed():
    np.testing.assert_allclose(
        6 * basis_matrix(4), [[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], rtol=0, atol=1e-15
    )


def test_the_shared_matrix_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        basis_matrix(4)[0, 0] = 1.0
