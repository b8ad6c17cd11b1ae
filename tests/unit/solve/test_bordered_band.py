"""Banded normal equations with a border against dense linear algebra."""

import numpy as np
import pytest

from gnomon.solve.bordered_band import BorderedBand
from gnomon.solve.factorisation import Factor


def equations(*, controls, order, groups, parameters=4, sides=2, seed=0, triangles="upper"):
    """Return random normal equations, and the same as a dense matrix and its right-hand sides.

    Each term touches `order` neighbouring control points and the whole border. What two groups of the same control
    point have in common may be entered on either side, or shared out between both.
    """
    rng = np.random.default_rng(seed)
    d, n = sum(groups), controls
    system = BorderedBand(controls=n, order=order, groups=groups, parameters=parameters, sides=sides)
    starts = system.starts()
    dense, right = np.zeros((n * d + parameters,) * 2), np.zeros((n * d + parameters, sides))
    for first in range(n - order + 1):
        rows = rng.normal(size=(order * d + 5, order * d + parameters + sides))
        gram = rows.T @ rows
        of = np.r_[first * d : (first + order) * d, n * d : n * d + parameters]
        dense[np.ix_(of, of)] += gram[: len(of), : len(of)]
        right[of] += gram[: len(of), len(of) :]
        for a in range(order):
            for b in range(a, order):
                for g, h in np.ndindex(len(groups), len(groups)):
                    twice = {"upper": g < h, "lower": g > h, "shared": 0.5}[triangles]
                    share = twice if a == b and g != h else 1
                    rows_of = slice(a * d + starts[g], a * d + starts[g + 1])
                    columns = slice(b * d + starts[h], b * d + starts[h + 1])
                    system.band[g][h][first + a, :, b - a] += share * gram[rows_of, columns]
            own = slice(a * d, (a + 1) * d)
            system.border[first + a] += gram[own, order * d : order * d + parameters]
            system.rhs[first + a] += gram[own, order * d + parameters :]
        border = slice(order * d, order * d + parameters)
        system.corner += gram[border, border]
        system.corner_rhs += gram[border, order * d + parameters :]
    return system, dense, right


# The chain is cut into super-blocks of order - 1 control points: the last is full, or lacks some.
SHAPES = [
    {"controls": 15, "order": 4, "groups": (6, 3, 3)},
    {"controls": 16, "order": 4, "groups": (6, 3, 3)},
    {"controls": 17, "order": 4, "groups": (5,)},
    {"controls": 24, "order": 5, "groups": (2, 1)},
    {"controls": 25, "order": 5, "groups": (1, 2, 1)},
    {"controls": 21, "order": 6, "groups": (6, 3, 3, 3, 3)},
    {"controls": 6, "order": 6, "groups": (3,)},
    {"controls": 5, "order": 2, "groups": (2,)},
    {"controls": 4, "order": 4, "groups": (6, 3)},
    {"controls": 1, "order": 1, "groups": (2, 2), "parameters": 1},
    {"controls": 3, "order": 1, "groups": (3,)},
    {"controls": 13, "order": 4, "groups": (3,), "parameters": 0},
    {"controls": 13, "order": 4, "groups": (3,), "sides": 7, "parameters": 9},
]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("triangles", ["upper", "lower", "shared"])
def test_solution_is_that_of_the_dense_equations(shape, triangles):
    system, dense, right = equations(**shape, triangles=triangles)
    p, chain = len(system.corner), len(dense) - len(system.corner)
    factor = Factor.of(system)
    expected = np.linalg.solve(dense, right)
    scale = np.abs(expected).max() * np.linalg.cond(dense)
    schur = dense[chain:, chain:] - dense[chain:, :chain] @ np.linalg.solve(
        dense[:chain, :chain], dense[:chain, chain:]
    )
    np.testing.assert_allclose(factor.schur, schur, rtol=0, atol=1e-13 * (1 + np.abs(dense).max()))
    covariance = np.linalg.inv(factor.schur)
    np.testing.assert_allclose(covariance, np.linalg.inv(dense)[chain:, chain:], rtol=1e-9, atol=1e-13)
    for side in range(right.shape[1]):
        parameters = covariance @ factor.schur_sides[:, side]
        np.testing.assert_allclose(parameters, expected[chain:, side], rtol=0, atol=1e-14 * scale)
        found = factor.substituted(side, parameters)
        assert found.shape == (shape["controls"], sum(shape["groups"]))
        np.testing.assert_allclose(found.ravel(), expected[:chain, side], rtol=0, atol=1e-14 * scale)
    columns = np.concatenate([dense[:chain, chain:], right[:chain]], axis=1)
    chosen = np.arange(columns.shape[1])[::-1]
    found = factor.chain_solutions(chosen)
    assert found.shape == (shape["controls"], sum(shape["groups"]), len(chosen))
    expected_chain = np.linalg.solve(dense[:chain, :chain], columns[:, chosen])
    np.testing.assert_allclose(found.reshape(chain, -1), expected_chain, rtol=0, atol=1e-14 * scale)
    for a, b in np.ndindex(right.shape[1], right.shape[1]):
        found = factor.quadratic(a, b, np.arange(p), covariance)
        assert found == pytest.approx(right[:, a] @ expected[:, b], rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("shape", SHAPES[:8], ids=str)
def test_marginals_are_blocks_of_the_dense_covariance(shape):
    system, dense, _ = equations(**shape)
    chain, p = len(dense) - len(system.corner), len(system.corner)
    factor = Factor.of(system)
    inverse = np.linalg.inv(dense)
    marginals, following = factor.marginals(np.arange(p), np.linalg.inv(factor.schur))
    size = marginals.shape[1]
    assert size == max(shape["order"] - 1, 1) * sum(shape["groups"])
    for k, block in enumerate(marginals):
        of = slice(k * size, min((k + 1) * size, chain))
        count = of.stop - of.start
        np.testing.assert_allclose(block[:count, :count], inverse[of, of], rtol=1e-8, atol=1e-13)
    for k, block in enumerate(following):
        rows, columns = slice(k * size, (k + 1) * size), slice((k + 1) * size, min((k + 2) * size, chain))
        expected = inverse[rows, columns]
        np.testing.assert_allclose(block[:, : expected.shape[1]], expected, rtol=1e-8, atol=1e-13)


def test_held_parameters_of_the_border():
    system, dense, right = equations(controls=17, order=5, groups=(6, 3), parameters=6, sides=3)
    chain = 17 * 9
    free = np.array([0, 2, 3, 5])
    kept = np.r_[0:chain, chain + free]
    inverse = np.linalg.inv(dense[np.ix_(kept, kept)])
    expected = inverse @ right[kept]
    factor = Factor.of(system)
    covariance = np.linalg.inv(factor.schur[np.ix_(free, free)])
    np.testing.assert_allclose(covariance, inverse[chain:, chain:], rtol=1e-9, atol=1e-15)
    parameters = np.zeros(6)
    parameters[free] = covariance @ factor.schur_sides[free, 1]
    np.testing.assert_allclose(parameters[free], expected[chain:, 1], rtol=1e-9)
    np.testing.assert_allclose(factor.substituted(1, parameters).ravel(), expected[:chain, 1], rtol=0, atol=1e-12)
    assert factor.quadratic(2, 0, free, covariance) == pytest.approx(right[kept, 2] @ expected[:, 0], rel=1e-10)
    marginals, _ = factor.marginals(free, covariance)
    size = marginals.shape[1]
    np.testing.assert_allclose(marginals[1], inverse[size : 2 * size, size : 2 * size], rtol=1e-8, atol=1e-14)


def test_held_parameters_at_a_value_of_their_own():
    # With the border given, the chain's part is what is left.
    system, dense, right = equations(controls=12, order=4, groups=(4,), parameters=3, sides=1)
    given = np.array([0.3, -2.0, 1.5])
    expected = np.linalg.solve(dense[:48, :48], right[:48, 0] - dense[:48, 48:] @ given)
    np.testing.assert_allclose(Factor.of(system).substituted(0, given).ravel(), expected, rtol=0, atol=1e-12)


def test_inner_products_of_the_band_alone():
    system, dense, right = equations(controls=14, order=4, groups=(3, 3), parameters=5, sides=4)
    factor = Factor.of(system)
    sides = np.array([1, 3])
    expected = right[:84, sides].T @ np.linalg.solve(dense[:84, :84], right[:84, sides])
    np.testing.assert_allclose(factor.inner(sides), expected, rtol=1e-10)


def test_marquardt_damping_scales_the_diagonal():
    system, dense, right = equations(controls=11, order=4, groups=(2, 3), parameters=4, sides=1)
    system.damped(0.25)
    np.fill_diagonal(dense, 1.25 * np.diag(dense))
    factor = Factor.of(system)
    parameters = np.linalg.solve(factor.schur, factor.schur_sides[:, 0])
    expected = np.linalg.solve(dense, right[:, 0])
    np.testing.assert_allclose(parameters, expected[55:], rtol=1e-9)
    np.testing.assert_allclose(factor.substituted(0, parameters).ravel(), expected[:55], rtol=0, atol=1e-12)


def test_right_hand_sides_that_come_later():
    system, dense, _ = equations(controls=11, order=4, groups=(3, 2), parameters=3)
    factor = Factor.of(system)
    later = np.random.default_rng(5).normal(size=(11, 5, 4))
    there = np.concatenate([later.reshape(55, 4), np.zeros((3, 4))])
    held = np.arange(55 + 2)  # the last parameter of the border is not free
    for kept, free in ((np.arange(58), np.arange(3)), (held, np.arange(2))):
        found = factor.quadratics(later, free, np.linalg.inv(factor.schur[np.ix_(free, free)]))
        expected = there[kept].T @ np.linalg.solve(dense[np.ix_(kept, kept)], there[kept])
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_right_hand_sides_that_come_later_are_as_those_of_the_equations():
    system, _, right = equations(controls=11, order=4, groups=(3, 2), parameters=3)
    factor, sides = Factor.of(system), np.arange(right.shape[1])
    found = factor.further_sides(right[:55].reshape(11, 5, -1), right[55:], sides)
    for matrix, expected in zip(found, (factor.inner(sides), factor.inner(sides), factor.schur_sides), strict=True):
        np.testing.assert_allclose(matrix, expected, rtol=1e-9, atol=1e-12)


def test_badly_scaled_equations():
    # Units of radians, metres and seconds differ by many powers of ten.
    system, dense, right = equations(controls=20, order=5, groups=(3, 3), parameters=4, sides=1)
    units = 10.0 ** np.random.default_rng(1).uniform(-4, 4, 6)
    border_units = 10.0 ** np.arange(-6.0, 6.0, 3.0)
    for g, h in np.ndindex(2, 2):
        own, other = units[3 * g : 3 * g + 3], units[3 * h : 3 * h + 3]
        system.band[g][h] *= own[:, None, None] * other
    system.border *= units[:, None] * border_units
    system.rhs *= units[:, None]
    system.corner *= np.outer(border_units, border_units)
    system.corner_rhs *= border_units[:, None]
    factor = Factor.of(system)
    parameters = np.linalg.solve(factor.schur, factor.schur_sides[:, 0])
    expected = np.linalg.solve(dense, right[:, 0])
    np.testing.assert_allclose(parameters * border_units, expected[120:], rtol=1e-7)
    found = factor.substituted(0, parameters) * units
    np.testing.assert_allclose(found.ravel(), expected[:120], rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("control", "block"), [(0, 0), (5, 1), (19, 6)])
def test_what_nothing_determines_is_named(control, block):
    system, _, _ = equations(controls=20, order=4, groups=(2, 1))
    system.band[0][0][control, 1, 0, 1] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match=f"super-block {block} of 7 is not positive definite"):
        Factor.of(system)


def test_an_empty_control_point_is_named():
    system = BorderedBand(controls=9, order=4, groups=(2,), parameters=1, sides=1)
    system.band[0][0][:, np.arange(2), 0, np.arange(2)] = 1.0
    system.band[0][0][4] = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="super-block 1 of 3"):
        Factor.of(system)
