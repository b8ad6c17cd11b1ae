"""Points of a board that were fitted, and how well."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...frozen import field_names, value_class
from ...models.camera import Booleans
from ...recording import Floats

DAMPING = 1e-4


@value_class
class PointFits:
    """Points as they were fitted, m of them.

    Attributes
    ----------
    pixels : (m, 2) [px]
    sigma_px : (m,) standard deviation per axis, from the residuals [px]
    blur_px : (m,) standard deviation of the blur, of corners the root mean square across both edges [px]
    misfit : (m,) rms of the residuals over the contrast
    good : (m,) whether the picture is that of such a point, near the guess
    """

    pixels: Floats
    sigma_px: Floats
    blur_px: Floats
    misfit: Floats
    good: Booleans

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, chosen: NDArray[np.integer] | Booleans) -> Self:
        """Return some of the points."""
        return type(self)(**{name: getattr(self, name)[chosen] for name in field_names(type(self))})


@value_class
class CornerFits(PointFits):
    """Corners as they were fitted.

    Attributes
    ----------
    black, white : (m,) grey levels
    normals : (m, 2, 2) unit normals of both edges
    bow, slope : (m, 2, 2) by how much the corner is found beside its place, as columns: for an edge that bends towards
        its normal with a curvature of one, the first or the second [px^2]; for light that grows by the whole of it in a
        pixel, to the right or downwards [px^2]
    """

    black: Floats
    white: Floats
    normals: Floats
    bow: Floats
    slope: Floats


def join_corner_fits(first: CornerFits, second: CornerFits) -> CornerFits:
    """Return the corners of both."""
    both = {name: (getattr(first, name), getattr(second, name)) for name in field_names(CornerFits)}
    return CornerFits(**{name: np.concatenate(values) for name, values in both.items()})


def damp_diagonals(matrix: Floats) -> None:
    """Make the diagonals of normal matrices (m, n, n) a little larger, in place."""
    diagonal = np.einsum("mii->mi", matrix)
    diagonal *= 1 + DAMPING
    diagonal += 1e-6
