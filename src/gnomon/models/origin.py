"""The point of an IMU to which its poses refer, where its three accelerometers sit at different places.

A model with one place for all three, fitted to accelerometers at r_k, puts the IMU at a point between them, linear in
the r_k:

    p* = sum_k W_k r_k,    sum_k W_k = 1

It is the point whose place does not move with the lever arms a: with the covariance of the model that has them, the
regression of T_cam_imu on a vanishes there, Sigma_ta Sigma_aa^-1 = 0. So at p* a translation is as well known as by the
model with one place, whether or not the places differ, and whatever is known of the arms beforehand
(`estimate.camera_imu.result.publish`). The place of an accelerometer along its own axis acts through omega^2 alone: the
place of a single accelerometer is known far worse.
"""

from dataclasses import replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..frozen import value_class
from ..geometry.rotations import acceleration_by_place

Floats = NDArray[np.float64]
Axis = Literal["x", "y", "z"]
OriginPoint = Literal["optimal", "x", "y", "z", "place"]

AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
ORIGIN_POINTS: tuple[OriginPoint, ...] = ("optimal", *AXES, "place")
_TOLD = 1e-6
"""Share of the mean square of B below which a direction of p* is not told by the motion."""

_FARTHEST_M = 1.0

EVEN_WEIGHTS: Floats = (np.eye(3) - np.eye(3)[:, :, None] * np.eye(3)[:, None, :]) / 2
"""W_k (3, 3, 3) of a motion alike about all axes: p* then has, along each axis, the mean of the two other
accelerometers."""
EVEN_WEIGHTS.flags.writeable = False


@value_class
class Origin:
    """Which point of an IMU its origin is.

    Attributes
    ----------
    point : "optimal", p*, of which `weights` tells; "x", "y" or "z", that accelerometer; "place",
        `place_m` from the x accelerometer
    weights : (3, 3, 3) W_k of p* = sum_k W_k r_k, IMU's axes; None where they are not known
    place_m : (3,) from the x accelerometer to the point "place", IMU's axes [m]; zero for the others
    """

    point: OriginPoint = "x"
    weights: Floats | None = None
    place_m: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("weights", "place_m"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, _frozen(value))

    @classmethod
    def stated(cls, text: str) -> Self:
        """Return the origin of a text: "optimal", "x", "y", "z", or a place from the x accelerometer as 0.01,0,-0.005.

        Raises
        ------
        OptionError
            If it is none of these.
        """
        if text == "optimal":
            return cls(point="optimal")
        if text in AXES:
            return cls(point=text)
        try:
            place = np.array([float(part) for part in text.split(",")])
        except ValueError:
            place = np.full(1, np.nan)
        if len(place) != 3 or not np.isfinite(place).all() or np.linalg.norm(place) > _FARTHEST_M:
            raise OptionError(
                f'origin "{text}": there is no such point. Choose optimal (where the translation is known best), the '
                "x, y or z accelerometer, or state where it is from the x accelerometer in the IMU's axes: three "
                f"numbers in metres with commas between them, such as 0.010,0,-0.005, at most {_FARTHEST_M:g} m away."
            )
        return cls(point="place", place_m=place)

    @property
    def combination(self) -> tuple[Floats, Floats]:
        """The point as sum_k C_k r_k + c of the places r_k of the accelerometers: C (3, 3, 3) and c (3,) [m]."""
        if self.point == "optimal":
            return EVEN_WEIGHTS if self.weights is None else self.weights, np.zeros(3)
        chosen = np.zeros((3, 3, 3))
        chosen[AXES.index(self.point) if self.point in AXES else 0] = np.eye(3)
        return chosen, np.zeros(3) if self.place_m is None else self.place_m

    def of(self, places: Floats) -> Floats:
        """Return the point (3,) of accelerometers at places (3, 3), one row each, from any point."""
        weights, offset = self.combination
        return np.einsum("kij,kj->i", weights, places) + offset

    def turned(self, rotation: Floats) -> Self:
        """Return the same point for axes that are turned, v_new = rotation @ v, (3, 3)."""
        return replace(
            self,
            weights=None if self.weights is None else rotation @ self.weights @ rotation.T,
            place_m=None if self.place_m is None else rotation @ self.place_m,
        )

    @property
    def words(self) -> str:
        """The point in a few words."""
        if self.point == "place":
            assert self.place_m is not None
            return f"{' '.join(f'{1e3 * value:.4g}' for value in self.place_m)} mm from the x accelerometer"
        if self.point != "optimal":
            return f"the {self.point} accelerometer"
        return "the point of the IMU whose place is known best (p*)"


def single_point_weights(omega: Floats, alpha: Floats) -> Floats:
    """Return the W_k (3, 3, 3) of p* = sum_k W_k r_k as the motion alone tells them, without an estimate.

    With B = [alpha]x + [omega]x^2, accelerometer k at r_k feels row k of B r_k more than one at the origin. One place
    for all three that minimises sum_k E[(b_k' (r_k - p))^2], b_k the row k of B, all weighed alike, has W_k = (sum_k
    M_k)^-1 M_k, M_k = E[b_k b_k']. What is estimated beside the place moves p* by up to a third of the arms' length.
    Where the motion tells nothing of a direction, the weights are those of `EVEN_WEIGHTS`.

    Parameters
    ----------
    omega, alpha : (n, 3) angular rate [rad/s] and acceleration [rad/s^2], IMU's axes
    """
    B = acceleration_by_place(omega, alpha)
    moments = np.einsum("nki,nkj->kij", B, B) / max(len(B), 1)
    size = float(np.trace(moments.sum(axis=0)))
    if not size > 0:
        return EVEN_WEIGHTS
    moments = moments + _TOLD * size * EVEN_WEIGHTS
    return np.linalg.solve(moments.sum(axis=0), moments)


def _frozen(values: Floats) -> Floats:
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array
