"""Corners that were fitted, and how well."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ...recording import Floats
from .corner_windows import Booleans


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """Corners as they were fitted, m of them.

    Attributes
    ----------
    pixels : (m, 2) [px]
    sigma_px : (m,) standard deviation per axis, from the residuals [px]
    blur_px : (m,) standard deviation of the blur, root mean square across both edges [px]
    black, white : (m,) grey levels
    misfit : (m,) rms of the residuals over the contrast
    normals : (m, 2, 2) unit normals of both edges
    bow, slope : (m, 2, 2) by how much the corner is found beside its place, as columns: for an edge that bends towards
        its normal with a curvature of one, the first or the second [px^2]; for light that grows by the whole of it in a
        pixel, to the right or downwards [px^2]
    good : (m,) whether the picture is that of such a corner, near the guess
    """

    pixels: Floats
    sigma_px: Floats
    blur_px: Floats
    black: Floats
    white: Floats
    misfit: Floats
    normals: Floats
    bow: Floats
    slope: Floats
    good: Booleans

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, chosen: NDArray[np.integer] | Booleans) -> "CornerFits":
        """Return some of the corners."""
        return CornerFits(**{item.name: getattr(self, item.name)[chosen] for item in fields(self)})


def joined(first: CornerFits, second: CornerFits) -> CornerFits:
    """Return the corners of both."""
    return CornerFits(
        **{
            item.name: np.concatenate([getattr(first, item.name), getattr(second, item.name)])
            for item in fields(CornerFits)
        }
    )
