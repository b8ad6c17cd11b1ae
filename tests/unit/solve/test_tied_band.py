"""Equations whose slow scalars are tied against dense linear algebra."""

import numpy as np
import pytest

from gnomon.solve.bordered_band import BorderedBand
from gnomon.solve.factorisation import Factor


def tied_equations(*, controls, order, groups, offset, tied, parameters=4, sides=3, seed=0):
    """Return equations of terms that touch the tied groups of two neighbours each, and the same as a dense matrix."""
    rng = np.random.default_rng(seed)
    d, n = sum(groups), controls
    system = BorderedBand(
        controls=n, order=order, groups=groups, parameters=parameters, sides=sides, tied=offset if tied else None
    )
    starts, dense = system.starts(), np.zeros((n * d + parameters,) * 2)
    right = np.zeros((n * d + parameters, sides))

    def add(touched):  # pairs of control point and group, and the border
        of = [np.arange(i * d + starts[g], i * d + starts[g + 1]) for i, g in touched]
        of.append(n * d + np.arange(parameters))
        every = np.concatenate(of)
        rows = rng.normal(size=(len(every) + 5, len(every) + sides))
        gram = rows.T @ rows
        dense[np.ix_(every, every)] += gram[: len(every), : len(every)]
        right[every] += gram[: len(every), len(every) :]

    for first in range(n - order + 1):
        for group in range(1, len(groups)):
            pose = [(first + a, 0) for a in range(order)]
            add([*pose, (first + offset, group), (first + offset + 1, group)])
    for i in range(n - 1):
        for group in range(1, len(groups)):
            add([(i, group), (i + 1, group)])
    chain = dense[: n * d, : n * d].reshape(n, d, n, d)
    for i in range(n):
        for j in range(min(order, n - i)):
            for g, h in np.ndindex(len(groups), len(groups)):
                if i + j < n and not (j == 0 and g > h):
                    rows, columns = slice(starts[g], starts[g + 1]), slice(starts[h], starts[h + 1])
                    system.band[g][h][i, :, j] = chain[i, rows, i + j, columns]
    system.border[:] = dense[: n * d, n * d :].reshape(n, d, parameters)
    system.rhs[:] = right[: n * d].reshape(n, d, sides)
    system.corner[:], system.corner_rhs[:] = dense[n * d :, n * d :], right[n * d :]
    return system, dense, right


def weights(controls, order, groups, offset):
    """Return the matrix (n d, unknowns) by which all scalars follow, straight from what ties mean."""
    d, n, step = sum(groups), controls, order - 1
    blocks, slow = -(-n // step), d - groups[0]
    matrix = np.zeros((n * d, n * groups[0] + blocks * slow))
    for i in range(n):
        matrix[i * d + np.arange(groups[0]), i * groups[0] + np.arange(groups[0])] = 1.0
        place = np.clip((i - offset) / step, 0, blocks - 1)
        for k in range(blocks):
            share = max(0.0, 1 - abs(place - k))
            columns = n * groups[0] + k * slow + np.arange(slow)
            matrix[i * d + groups[0] + np.arange(slow), columns] = share
    return matrix


SHAPES = [
    {"controls": 30, "order": 6, "groups": (6, 6), "offset": 2},
    {"controls": 31, "order": 6, "groups": (6, 6), "offset": 2},
    {"controls": 33, "order": 6, "groups": (6, 3, 6), "offset": 2},
    {"controls": 34, "order": 6, "groups": (3, 2, 2), "offset": 2},
    {"controls": 16, "order": 4, "groups": (6, 6), "offset": 1},
    {"controls": 17, "order": 5, "groups": (6, 6), "offset": 1},
    {"controls": 6, "order": 6, "groups": (3, 2), "offset": 2},
]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_kernel_gives_what_numpy_gives(shape, monkeypatch):
    found = []
    for switch in ("1", "0"):
        monkeypatch.setenv("GNOMON_KERNEL", switch)
        factor = Factor.of(tied_equations(**shape, tied=True)[0])
        found.append((factor.lower, factor.eliminated, factor.schur, factor.schur_sides))
    for fast, plain in zip(*found, strict=True):
        np.testing.assert_allclose(fast, plain, rtol=1e-12, atol=1e-12 * np.abs(plain).max())


@pytest.mark.parametrize("switch", ["1", "0"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_solution_is_that_of_the_dense_equations_with_the_ties(shape, switch, monkeypatch):
    monkeypatch.setenv("GNOMON_KERNEL", switch)
    system, dense, right = tied_equations(**shape, tied=True)
    p, chain = len(system.corner), len(dense) - len(system.corner)
    follow = weights(**shape)
    whole = np.zeros((len(dense), follow.shape[1] + p))
    whole[:chain, : follow.shape[1]], whole[chain:, follow.shape[1] :] = follow, np.eye(p)
    reduced = whole.T @ dense @ whole
    expected = whole @ np.linalg.solve(reduced, whole.T @ right)
    factor = Factor.of(system)
    parameters = np.linalg.solve(factor.schur, factor.schur_sides)
    np.testing.assert_allclose(parameters, expected[chain:], rtol=1e-8, atol=1e-10)
    for side in range(right.shape[1]):
        found = factor.substituted(side, parameters[:, side])
        np.testing.assert_allclose(found.ravel(), expected[:chain, side], rtol=1e-7, atol=1e-9)
    inside = follow.T @ dense[:chain, :chain] @ follow
    columns = np.concatenate([dense[:chain, chain:], right[:chain]], axis=1)
    solutions = follow @ np.linalg.solve(inside, follow.T @ columns)
    found = factor.chain_solutions(np.arange(columns.shape[1]))
    np.testing.assert_allclose(found.reshape(chain, -1), solutions, rtol=1e-7, atol=1e-9)


def test_variances_are_those_of_the_dense_covariance():
    for shape in SHAPES[:4]:
        system, dense, _ = tied_equations(**shape, tied=True)
        p, chain = len(system.corner), len(dense) - len(system.corner)
        follow = weights(**shape)
        whole = np.zeros((len(dense), follow.shape[1] + p))
        whole[:chain, : follow.shape[1]], whole[chain:, follow.shape[1] :] = follow, np.eye(p)
        expected = np.diag(whole @ np.linalg.inv(whole.T @ dense @ whole) @ whole.T)[:chain]
        factor = Factor.of(system)
        found = factor.variances(factor.marginals(np.arange(p), np.linalg.inv(factor.schur)))
        np.testing.assert_allclose(found.ravel(), expected, rtol=1e-8)
