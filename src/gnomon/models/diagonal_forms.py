"""The sensor models of PX4 and ArduPilot: an offset and a scale for each axis, or an offset alone.

Definitions as stated in those projects' code. They cannot hold misalignment; the diagonal is chosen so that the error
that remains is least.
"""

from typing import Self

import numpy as np

from ..frozen import value_class
from .frames import Floats


@value_class
class DiagonalTriad:
    """PX4 and ArduPilot, the accelerometer: x = scale (s - offset), element by element.

    Attributes
    ----------
    scale : (3,) [SI per SI]
    offset : (3,) [SI], subtracted from the measurement before it is scaled
    """

    scale: Floats
    offset: Floats

    @classmethod
    def nearest(cls, sensitivity: Floats, bias: Floats) -> Self:
        """Return the triad whose error, rms over all directions of the true vector, is least.

        With s = S x + b and offset = b the error is (diag(scale) S - I) x. Row by row its squared norm is least at
        scale_i = S_ii / |S_i|^2, S_i the i-th row.

        Parameters
        ----------
        sensitivity : (3, 3) [SI per SI]
        bias : (3,) [SI]
        """
        return cls(scale=np.diag(sensitivity) / np.square(sensitivity).sum(axis=1), offset=bias)

    @classmethod
    def offset_alone(cls, bias: Floats) -> Self:
        """Return the triad of a gyroscope, for which these projects know no scale."""
        return cls(scale=np.ones(3), offset=bias)

    def to_sensor(self) -> tuple[Floats, Floats]:
        """Return the sensitivity (3, 3) and the bias (3,)."""
        return np.diag(1 / self.scale), self.offset

    def rest(self, sensitivity: Floats) -> Floats:
        """Return what is left uncorrected of a sensor of this sensitivity, (3, 3): result = (I + rest) x."""
        return self.scale[:, None] * sensitivity - np.eye(3)

    def predict(self, truth: Floats) -> Floats:
        """Return measurements (n, 3) [SI] of specific force [m/s^2] or angular rate [rad/s], (n, 3)."""
        return truth / self.scale + self.offset
