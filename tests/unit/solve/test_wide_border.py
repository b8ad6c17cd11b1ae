"""A border whose wide part is made where it is needed, against the same border in columns."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from test_bordered_band import SHAPES, equations

from gnomon.solve.bordered_band import BorderedBand, Workspace
from gnomon.solve.factorisation import Factor


class Stored:
    """A wide border that is stored nevertheless."""

    def __init__(self, border):
        self.border = border  # (n, d, w)

    @property
    def size(self):
        return self.border.shape[2]

    def release(self):
        self.border = self.border[:, :, :0]

    def times(self, parameters):
        return self.border @ parameters

    def blocks(self, first, count):
        return self.border[first : first + count]


def widened(shape, wide):
    """Return equations whose last parameters are wide, and the same with all of them narrow."""
    shape = {"parameters": 4, "sides": 2, **shape}
    full, _, _ = equations(**shape)
    p = shape["parameters"] - wide
    system = BorderedBand(
        controls=shape["controls"], order=shape["order"], groups=shape["groups"], parameters=p, sides=shape["sides"],
        wide=Stored(full.border[:, :, p:].copy()),
    )  # fmt: skip
    for row, same in zip(system.band, full.band, strict=True):
        for band, values in zip(row, same, strict=True):
            band[:] = values
    system.border[:], system.rhs[:] = full.border[:, :, :p], full.rhs
    system.corner += full.corner
    system.corner_rhs += full.corner_rhs
    return system, full


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_wide_border_is_the_border(shape):
    count = shape.get("parameters", 4)
    for wide in sorted({min(1, count), count // 2, count}):
        system, full = widened(shape, wide)
        found, expected = Factor.of(system), Factor.of(full)
        p, q = count - wide, full.rhs.shape[2]
        assert found.narrow == p
        scale = np.abs(expected.schur).max() if count else 1.0
        np.testing.assert_allclose(found.schur, expected.schur, rtol=0, atol=1e-11 * scale)
        np.testing.assert_allclose(found.schur_sides, expected.schur_sides, rtol=0, atol=1e-11 * scale)
        free = np.arange(count)
        covariance = np.linalg.inv(expected.schur)
        for side in range(q):
            parameters = covariance @ expected.schur_sides[:, side]
            np.testing.assert_allclose(
                found.substituted(side, parameters), expected.substituted(side, parameters), rtol=1e-8, atol=1e-10
            )
            assert found.quadratic(0, side, free, covariance) == pytest.approx(
                expected.quadratic(0, side, free, covariance), rel=1e-9
            )
        np.testing.assert_allclose(found.inner(np.arange(q)), expected.inner(np.arange(q)), rtol=1e-12)
        later = [one.quadratics(full.rhs, free, covariance) for one in (found, expected)]
        np.testing.assert_allclose(*later, rtol=1e-8, atol=1e-12)
        if wide:
            added = np.random.default_rng(1).normal(size=(wide, p + q))
            followed = expected.chain_solutions(np.r_[:p, count : count + q])
            followed += expected.chain_solutions(np.arange(p, count)) @ added
            np.testing.assert_allclose(
                found.chain_solutions(np.arange(p + q), added), followed, rtol=1e-8, atol=1e-9 * np.abs(followed).max()
            )
        for got, wanted in zip(found.marginals(free, covariance), expected.marginals(free, covariance), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-8, atol=1e-12)


def test_the_blocks_are_released_with_the_next_equations_in_the_same_memory():
    workspace = Workspace()
    sizes = {"controls": 4, "order": 2, "groups": (2,), "parameters": 0, "sides": 1, "workspace": workspace}
    first, second = (Stored(np.ones((4, 2, 3))) for _ in range(2))
    BorderedBand(**sizes, wide=first)
    BorderedBand(**{**sizes, "workspace": workspace.beside_a_factor()}, wide=second)
    assert first.size == 3  # the factor beside is still needed
    BorderedBand(**sizes, wide=second)
    assert first.size == 0
    assert second.size == 3
