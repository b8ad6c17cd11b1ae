import subprocess
import sys

import numpy as np
import pytest

from gnomon.solve.factorisation import solve_banded

USED = """
import numpy as np
matrix = np.array([[4.0, 1.0], [1.0, 3.0]])
factor, failed = {routine}(matrix, lower=1)
assert not failed and np.allclose(np.tril(factor) @ np.tril(factor).T, matrix)
"""
OURS = "from gnomon.solve.factorisation import dpotrf\n" + USED.format(routine="dpotrf")
PUBLIC = "import scipy.linalg, scipy.optimize\n" + USED.format(routine="scipy.linalg.lapack.dpotrf")
FAILING = """
import importlib.util
def fails(spec):
    raise ImportError(spec.name)
importlib.util.module_from_spec = fails
"""


def banded(rows):
    rng = np.random.default_rng(3)
    lower = 0.1 * rng.standard_normal((rows, 40))
    lower[0] = 2.0
    dense = sum(np.diag(lower[k, : 40 - k], -k) for k in range(rows))
    return lower, dense + np.tril(dense, -1).T


@pytest.mark.parametrize("rows", [2, 5])
@pytest.mark.parametrize("shape", [(40,), (40, 3)])
def test_banded_equations_are_solved(rows, shape):
    lower, dense = banded(rows)
    right = np.random.default_rng(4).standard_normal(shape)
    kept = lower.copy(), right.copy()
    found = solve_banded(lower, right)
    assert found.shape == shape
    np.testing.assert_allclose(dense @ found, right, atol=1e-12)
    np.testing.assert_array_equal(lower, kept[0])
    np.testing.assert_array_equal(right, kept[1])


def test_equations_that_have_no_minimum_are_refused():
    lower, _ = banded(3)
    lower[0, 7] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match="row 8"):
        solve_banded(lower, np.ones(40))


@pytest.mark.parametrize("code", [OURS + PUBLIC, PUBLIC + OURS, FAILING + OURS])
def test_routines_are_there_before_and_after_those_of_scipy_and_without_their_modules(code):
    subprocess.run([sys.executable, "-c", code], check=True)
