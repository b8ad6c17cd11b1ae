"""The geometry of Angrisano (Eqs. 13-15): three angles between a triad's axes and an orthogonal frame.

The x axis of the orthogonal frame is that of the triad, and the triad's y axis lies in its x-y plane. The alignment
matrix T turns components along the triad's axes into orthogonal ones, s = T K (s_out - b), Eq. (1). Angrisano states T
twice: by direction cosines (14) and for small angles (15); the angles are [x, y, z] in both.

The third column of (14) is not exactly a unit vector, 1 - sin^2(x) sin^2(y) is its squared norm; the scale factor of z
takes that up, so that the sensor is the same.
"""

from typing import ClassVar, Literal, Self

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import Floats, invert_matrix
from .forms import AccelerometerForm, in_frame, unit_diagonal

Geometry = Literal["small-angle", "exact"]
"""Eq. (15) or Eq. (14) of Angrisano."""


def alignment_matrix(angles: Floats, geometry: Geometry) -> Floats:
    """Return T (3, 3), upper triangular, of angles (3,) [rad]: Eq. (15), or Eq. (14) where it is exact."""
    x, y, z = angles
    if geometry == "small-angle":
        return np.array([[1.0, z, y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    return np.array([[1.0, sz, cx * sy], [0.0, cz, cy * sx], [0.0, 0.0, cx * cy]])


def alignment_derivatives(angles: Floats, geometry: Geometry) -> Floats:
    """Return the derivatives of T (3, 3) by the three angles, (3, 3, 3); the first index is the angle."""
    by = np.zeros((3, 3, 3))
    if geometry == "small-angle":
        by[0, 1, 2] = by[1, 0, 2] = by[2, 0, 1] = 1.0
        return by
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    by[0, :, 2] = -sx * sy, cy * cx, -sx * cy
    by[1, :, 2] = cx * cy, -sy * sx, -cx * sy
    by[2, :, 1] = cz, -sz, 0.0
    return by


def angles_and_scales(correction: Floats, geometry: Geometry) -> tuple[Floats, Floats]:
    """Return angles (3,) [rad] and scale factors K (3,) with alignment(angles) K = correction, for either geometry.

    Parameters
    ----------
    correction : (3, 3), upper triangular [SI per unit]

    Raises
    ------
    OptionError
        If a diagonal entry vanishes, so that there are no such angles.
    """
    T, K = unit_diagonal(correction, "Angrisano's")
    small = np.array([T[1, 2], T[0, 2], T[0, 1]])
    if geometry == "small-angle":
        return small, K
    angles = np.arctan(small)
    cx, cy, cz = np.cos(angles)
    return angles, K / np.array([1.0, cz, cx * cy])


@value_class
class AngrisanoTriad(AccelerometerForm):
    """Angrisano, Eqs. (1) and (3), in its own nine parameters: s = T(angles) K (s_out - b).

    Attributes
    ----------
    angles : (3,) [rad], x y z
    b : (3,) [unit], subtracted from the measurement
    K : (3,) [SI per unit], the diagonal
    geometry : which T, Eq. (15) "small-angle" or Eq. (14) "exact"
    """

    frame: ClassVar[str] = "accel-z"
    angles: Floats
    b: Floats
    K: Floats
    geometry: Geometry = "small-angle"

    @classmethod
    def from_sensor(cls, sensitivity: Floats, bias: Floats, geometry: Geometry = "small-angle") -> Self:
        """Convert from S (3, 3) [unit per SI] in frame accel-z and b (3,) [unit], for either geometry."""
        return cls(**cls._split(in_frame(sensitivity, cls.frame), bias, geometry), geometry=geometry)

    @classmethod
    def from_parameters(cls, X: Floats, geometry: Geometry = "small-angle") -> Self:
        """Take apart the vector X (9,) of Eq. (3): angles, biases, scale factors."""
        return cls(angles=X[:3], b=X[3:6], K=X[6:], geometry=geometry)

    @property
    def parameters(self) -> Floats:
        """X (9,) of Eq. (3)."""
        return np.concatenate([self.angles, self.b, self.K])

    @property
    def correction(self) -> Floats:
        """T K, (3, 3) [SI per unit]."""
        return alignment_matrix(self.angles, self.geometry) * self.K

    @classmethod
    def _split(cls, sensitivity: Floats, bias: Floats, geometry: Geometry = "small-angle") -> dict[str, Floats]:
        angles, K = angles_and_scales(invert_matrix(sensitivity), geometry)
        return {"angles": angles, "b": bias, "K": K}

    def _joined(self) -> tuple[Floats, Floats]:
        return invert_matrix(self.correction), self.b

    def _measured(self, truth: Floats) -> Floats:
        return truth @ invert_matrix(self.correction).T + self.b
