"""What the magnitude estimator is given: poses of one triad, and what is known of it from elsewhere."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ...errors import OptionError
from ...frozen import value_class
from ...recording import Floats, Integers, frozen_array
from ...results.result import Booleans

PARAMETERS = 21
S_, B_, G_ = slice(0, 9), slice(9, 12), slice(12, 21)
"""Where sensitivity (row order), bias and g-sensitivity (row order) stand among the 21 parameters."""


@value_class
class TriadPoses:
    """Means of one triad in n poses, and the magnitude of what it measured in them.

    The model is measured = sensitivity @ (magnitude * u) + bias + g_sensitivity @ force, with a unit vector u that is
    unknown unless a direction is given. `TriadPoses.of` fills in what is not stated.

    Attributes
    ----------
    measured : (n, 3) mean measurements [unit]
    variance : (n, 3) of these means by the noise of the sensor [unit^2]
    magnitude : (n,) length of the measured vector [SI]; zero for a turntable at rest, which shows the bias. State zero
        with a sigma where noise hides the direction, such as the earth's rate at rest
    magnitude_sigma : (n,) error of each magnitude on its own, sigma [SI]; of each component where the magnitude is zero
    group : (n,) int, poses whose magnitudes share one relative error, such as those of one speed of a turntable
    group_sigma : (g,) sigma of these relative errors; zero where the magnitude is exact
    direction : (n, 3) unit vectors along what is measured, in the frame in which the result is wanted; None where only
        magnitudes are known, and nan in the poses of which only the magnitude is known
    direction_sigma : (n,) of each direction, about each of the two axes across it [rad]
    force : (n, 3) specific force in the same frame [m/s^2], for the g-sensitivity of a gyroscope; None without
    """

    measured: Floats
    variance: Floats
    magnitude: Floats
    magnitude_sigma: Floats
    group: Integers
    group_sigma: Floats
    direction: Floats | None = None
    direction_sigma: Floats | None = None
    force: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("measured", "variance", "magnitude", "magnitude_sigma", "group_sigma"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "group", frozen_array(self.group, np.int64))
        for name in ("direction", "direction_sigma", "force"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name)))
        self._check()

    def _check(self) -> None:
        n = len(self.measured)
        vectors = {"measured": self.measured, "variance": self.variance, "direction": self.direction}
        numbers = {"magnitude": self.magnitude, "magnitude_sigma": self.magnitude_sigma, "group": self.group}
        for name, array in {**vectors, "force": self.force}.items():
            if array is not None and array.shape != (n, 3):
                raise OptionError(f"poses need {name} of shape {(n, 3)}; found {array.shape}.")
        for name, array in {**numbers, "direction_sigma": self.direction_sigma}.items():
            if array is not None and array.shape != (n,):
                raise OptionError(f"poses need {name} of shape {(n,)}; found {array.shape}.")
        if (self.direction is None) != (self.direction_sigma is None):
            raise OptionError("directions of poses need their sigmas, and sigmas need directions.")
        if n and not 0 <= int(self.group.min()) <= int(self.group.max()) < len(self.group_sigma):
            raise OptionError(f"groups of poses must be 0 to {len(self.group_sigma) - 1}, one for each group_sigma.")
        for name, array in {**numbers, "measured": self.measured, "variance": self.variance}.items():
            bad = ~np.isfinite(array) | ((array < 0) & (name != "measured"))
            if bad.any():
                raise OptionError(f"{name} of pose {int(np.argwhere(bad)[0, 0]) + 1} is not a usable number.")

    def __len__(self) -> int:
        return len(self.measured)

    @classmethod
    def of(
        cls,
        measured: ArrayLike,
        magnitude: ArrayLike,
        *,
        variance: ArrayLike = 0.0,
        magnitude_sigma: ArrayLike = 0.0,
        group: ArrayLike = 0,
        group_sigma: ArrayLike = 0.0,
        direction: ArrayLike | None = None,
        direction_sigma: ArrayLike = 0.0,
        force: ArrayLike | None = None,
    ) -> Self:
        """Return poses with everything that is one number for all of them spread over them; see the attributes.

        Directions need not be of unit length.
        """
        values = np.asarray(measured, dtype=np.float64)
        n = len(values)
        unit = None
        if direction is not None:
            unit = np.asarray(direction, dtype=np.float64)
            unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
        return cls(
            measured=values,
            variance=np.broadcast_to(variance, (n, 3)).astype(np.float64),
            magnitude=np.broadcast_to(magnitude, n).astype(np.float64),
            magnitude_sigma=np.broadcast_to(magnitude_sigma, n).astype(np.float64),
            group=np.broadcast_to(group, n).astype(np.int64),
            group_sigma=np.atleast_1d(np.asarray(group_sigma, dtype=np.float64)),
            direction=unit,
            direction_sigma=None if unit is None else np.broadcast_to(direction_sigma, n).astype(np.float64),
            force=None if force is None else np.asarray(force, dtype=np.float64),
        )


@value_class
class TriadPrior:
    """What is known of a triad from elsewhere, in sensor units: another calibration, stated values, held values.

    Parameters are the nine entries of the sensitivity in row order [unit/SI], the bias [unit] and the nine entries of
    the g-sensitivity in row order [unit per m/s^2]. Without directions the poses know the sensitivity only up to a
    rotation of the body frame: a prior that knows the three entries above the diagonal says which frame is meant.

    Attributes
    ----------
    mean : (21,); anything finite where nothing is known
    precision : (21, 21) inverse of the covariance; zero where nothing is known
    fixed : (21,) bool, held at the mean and not estimated
    """

    mean: Floats
    precision: Floats
    fixed: Booleans

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", frozen_array(self.mean))
        object.__setattr__(self, "precision", frozen_array(self.precision))
        object.__setattr__(self, "fixed", frozen_array(self.fixed, np.bool_))
        if self.mean.shape != (PARAMETERS,) or self.precision.shape != (PARAMETERS, PARAMETERS):
            raise OptionError(f"a prior of a triad has {PARAMETERS} parameters; found {self.mean.shape}.")

    @classmethod
    def of(cls, mean: ArrayLike, sigma: ArrayLike = np.inf, *, fixed: ArrayLike = False) -> Self:
        """Return a prior of independent parameters.

        Parameters
        ----------
        mean : (21,); nan where nothing is known
        sigma : (21,) or one for all; infinite where nothing is known, zero where the parameter is held fixed
        fixed : (21,) bool or one for all
        """
        values = np.broadcast_to(np.asarray(mean, dtype=np.float64), PARAMETERS)
        sigmas = np.broadcast_to(np.asarray(sigma, dtype=np.float64), PARAMETERS)
        held = np.broadcast_to(np.asarray(fixed, dtype=np.bool_), PARAMETERS) | (sigmas == 0)
        known = np.isfinite(values) & np.isfinite(sigmas) & ~held
        precision = np.where(known, 1 / np.where(known, sigmas, 1.0) ** 2, 0.0)
        return cls(mean=np.where(np.isfinite(values), values, 0.0), precision=np.diag(precision), fixed=held)
