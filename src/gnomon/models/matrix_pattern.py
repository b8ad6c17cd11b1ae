"""Matrices of which some entries are unknowns: Krebs, section 4.3 and Fig. 4.1.

A pattern names the unknown entries of a 3 x 3 matrix X. The product X v then depends on each of them through one
component of v: for the unknown X_ij the derivative of X v is e_i v_j. (The Jacobians that the document prints, page 16
and 17, have the wrong component and the wrong order of factors.)
"""

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class

Floats = NDArray[np.float64]


@value_class(eq=True)
class MatrixPattern:
    """The unknown entries (row, column) of a 3 x 3 matrix, in the order of its parameters; the others are of I."""

    entries: tuple[tuple[int, int], ...]

    def matrix(self, parameters: Floats) -> Floats:
        """Return the matrix (3, 3) with these parameters."""
        matrix = np.zeros((3, 3)) if len(self.entries) == 9 else np.eye(3)
        for entry, value in zip(self.entries, parameters, strict=True):
            matrix[entry] = value
        return matrix

    def parameters(self, matrix: Floats) -> Floats:
        """Return the parameters of a matrix (3, 3) of this pattern."""
        return np.array([matrix[entry] for entry in self.entries])

    def product_jacobian(self, v: Floats) -> Floats:
        """Return the derivative of X v by the parameters, (n, 3, number of parameters), of vectors (n, 3)."""
        jacobian = np.zeros((len(v), 3, len(self.entries)))
        for k, (i, j) in enumerate(self.entries):
            jacobian[:, i, k] = v[:, j]
        return jacobian


DIAGONAL = MatrixPattern(entries=((0, 0), (1, 1), (2, 2)))
"""Scale factors S (section 3.2.3)."""

LOWER = MatrixPattern(entries=((1, 0), (2, 0), (2, 1)))
"""Misalignment M (section 3.2.1): M_yz, M_zy, M_zx below a diagonal of ones."""

FULL = MatrixPattern(entries=tuple((i, j) for i in range(3) for j in range(3)))
"""Influence B_g of the specific force on the gyroscope (section 3.2.4), row by row."""
