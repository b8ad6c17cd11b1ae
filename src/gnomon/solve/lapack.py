"""Routines of BLAS and LAPACK from SciPy, without what `import scipy.linalg` loads beside them.

That is all of NumPy, with f2py and the tests: 0.2 s of CPU time, as much as a short calibration takes. So the two
modules of routines are loaded alone where SciPy has them; elsewhere the public ones, which have the same routines.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def _routines(module: str) -> Any:
    spec = None
    if "scipy.linalg" not in sys.modules:
        spec = PathFinder.find_spec(f"scipy.linalg._f{module}", [f"{place}/linalg" for place in scipy.__path__])
    if spec is not None and spec.loader is not None:
        try:
            found = module_from_spec(spec)
            spec.loader.exec_module(found)
        except ImportError:
            pass
        else:
            return found
    return import_module(f"scipy.linalg.{module}")


_blas, _lapack = _routines("blas"), _routines("lapack")
dsyrk: Callable[..., Any] = _blas.dsyrk
dtrsm: Callable[..., Any] = _blas.dtrsm
dtrsv: Callable[..., Any] = _blas.dtrsv
dpotrf: Callable[..., Any] = _lapack.dpotrf
dpotrs: Callable[..., Any] = _lapack.dpotrs
dtrtri: Callable[..., Any] = _lapack.dtrtri


def solve_banded(lower: Floats, right: Floats) -> Floats:
    """Solve symmetric equations, of which entry [k, i] is that of row i + k and column i, (b, n), for (n, q) or (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    _, found, failed = _lapack.dpbsv(lower, right, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"row {failed} of the banded equations is not positive definite")
    return np.asarray(found, dtype=np.float64).reshape(right.shape)


def solve_positive(matrix: Floats, right: Floats) -> Floats:
    """Solve symmetric equations (n, n) for right-hand sides (n, q).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    _, found, failed = _lapack.dposv(matrix.T, right, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"row {failed} of the equations is not positive definite")
    return np.asarray(found, dtype=np.float64)
