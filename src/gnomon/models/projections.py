"""Projections: a point in front of the camera -> the plane in which the lens distorts.

Every projection of Kalibr divides by one number, m = (x, y) / D(x, y, z), and is symmetric about the optical axis. So D
and its derivatives say all about it; with r^2 = x^2 + y^2 and dD/dx = x E, dD/dy = y E, they are

    pinhole   D = z
    omni      D = xi rho + z,                    rho = sqrt(r^2 + z^2)
    eucm      D = alpha d + (1 - alpha) z,       d = sqrt(beta r^2 + z^2)
    ds        D = alpha d_2 + (1 - alpha) z_2,   z_2 = xi rho + z,   d_2 = sqrt(r^2 + z_2^2)

after Mei and Rives 2007 (omni; Geyer and Daniilidis 2000), Khomutenko et al. 2016 (eucm) and Usenko et al. 2018 (ds; it
states the others in the same letters). The domain of each is the cone about the optical axis in which m is one-to-one:

    pinhole   z > 0
    omni      z > -w rho,   w = xi if xi <= 1, else 1 / xi
    eucm      z > -w d,     w = alpha / (1 - alpha) if alpha <= 0.5, else (1 - alpha) / alpha
    ds        z_2 > -w d_2, w as for eucm

Up to the first bound (xi <= 1, alpha <= 0.5) the image of the cone is the whole plane; beyond it, a disk.
"""

from collections.abc import Callable, Mapping
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..frozen import value_class
from .lens_names import SHAPES, ProjectionName

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Shape = tuple[float, ...]
"""The parameters of a projection beside focal lengths and principal point."""


class Divisor(NamedTuple):
    """D at some points, and its derivatives; scalars where it does not depend on the point.

    Attributes
    ----------
    value : (k,) D [m]
    inside : (k,) whether the point is in the domain
    by_radius : (k,) E = dD/dx / x = dD/dy / y [1/m]
    by_z : (k,) dD/dz
    by_shape : one (k,) for each parameter of the shape; empty where not asked for
    """

    value: Floats
    inside: Booleans
    by_radius: Floats | float
    by_z: Floats | float
    by_shape: tuple[Floats, ...]


@value_class(eq=True)
class Projection:
    """One projection.

    Attributes
    ----------
    names : names of the shape parameters, in the order of Kalibr's intrinsics
    check : raises OptionError where the shape parameters make no sense
    divide : (shape, x, y, z, whether derivatives by the shape are wanted) -> Divisor
    lift : (shape, mx^2 + my^2) -> (k, z, whether there is such a ray), of the ray (k mx, k my, z) of any length
    """

    names: tuple[str, ...]
    check: Callable[[Shape], None]
    divide: Callable[[Shape, Floats, Floats, Floats, bool], Divisor]
    lift: Callable[[Shape, Floats], tuple[Floats, Floats, Booleans]]


def _demand(name: str, value: float, fits: bool, demand: str) -> None:
    if not fits:
        raise OptionError(f"{name} {value:g} is out of range: it must be {demand}.")


# Pinhole.


def _check_pinhole(shape: Shape) -> None:
    del shape


def _divide_pinhole(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    del shape, x, y, derive
    return Divisor(value=z, inside=z > 0, by_radius=0.0, by_z=1.0, by_shape=())


def _lift_pinhole(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    del shape
    one = np.ones_like(square)
    return one, one, np.isfinite(square)


# Omni: the unified model of Mei and Rives 2007.


def _check_omni(shape: Shape) -> None:
    _demand("xi", shape[0], shape[0] > -1, "greater than -1")


def _divide_omni(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    (xi,) = shape
    rho = np.sqrt(x * x + y * y + z * z)
    value = xi * rho + z
    slope = xi / rho
    inside = z > -(xi if xi <= 1 else 1 / xi) * rho
    return Divisor(value=value, inside=inside, by_radius=slope, by_z=1 + slope * z, by_shape=(rho,) if derive else ())


def _lift_omni(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    (xi,) = shape
    under = 1 + (1 - xi * xi) * square
    scale = (xi + np.sqrt(np.maximum(under, 0.0))) / (1 + square)
    return scale, scale - xi, under >= 0


# Extended unified camera model of Khomutenko, Garcia and Martinet 2016.


def _check_eucm(shape: Shape) -> None:
    _demand("alpha", shape[0], 0 <= shape[0] <= 1, "from 0 to 1")
    _demand("beta", shape[1], shape[1] > 0, "greater than zero")


def _reach(alpha: float) -> float:
    """Return w, where z > -w d is the domain of a projection with D = alpha d + (1 - alpha) z (Usenko et al.)."""
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha


def _excess(length: Floats, z: Floats, square: Floats) -> Floats:
    """Return length - z for length^2 = square + z^2, without cancellation near the optical axis."""
    size = np.abs(z)
    return square / (length + size) + (size - z)


def _divide_eucm(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    alpha, beta = shape
    square = x * x + y * y
    d = np.sqrt(beta * square + z * z)
    value = alpha * d + (1 - alpha) * z
    slope = alpha / d
    return Divisor(
        value=value,
        inside=z > -_reach(alpha) * d,
        by_radius=slope * beta,
        by_z=slope * z + (1 - alpha),
        by_shape=(_excess(d, z, beta * square), (0.5 * slope) * square) if derive else (),
    )


def _lift_eucm(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    alpha, beta = shape
    under = 1 - (2 * alpha - 1) * beta * square
    z = (1 - alpha * alpha * beta * square) / (alpha * np.sqrt(np.maximum(under, 0.0)) + (1 - alpha))
    return np.ones_like(square), z, under >= 0


# Double sphere camera model of Usenko, Demmel and Cremers 2018.


def _check_ds(shape: Shape) -> None:
    _demand("xi", shape[0], -1 < shape[0] <= 1, "greater than -1 and not greater than 1")
    _demand("alpha", shape[1], 0 <= shape[1] <= 1, "from 0 to 1")


def _least_cosine_ds(xi: float, alpha: float) -> float:
    """Return the cosine of the widest angle from the optical axis.

    It is where z_2 = -w d_2, solved for z / rho. Usenko et al. print -w_2 = -(w + xi) / sqrt(2 w xi + xi^2 + 1), which
    is the same for xi = 0 or alpha = 0.5 only, and lets points with D < 0 in for xi < 0 and small w.
    """
    w = _reach(alpha)
    rest = 1 - w * w
    return -xi * rest - w * sqrt(1 - xi * xi * rest)


def _divide_ds(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    xi, alpha = shape
    square = x * x + y * y
    d_1 = np.sqrt(square + z * z)
    z_2 = xi * d_1 + z
    d_2 = np.sqrt(square + z_2 * z_2)
    value = alpha * d_2 + (1 - alpha) * z_2
    by_z_2 = alpha * z_2 / d_2 + (1 - alpha)
    slope = xi / d_1
    return Divisor(
        value=value,
        inside=z > _least_cosine_ds(xi, alpha) * d_1,
        by_radius=alpha / d_2 + by_z_2 * slope,
        by_z=by_z_2 * (1 + slope * z),
        by_shape=(by_z_2 * d_1, _excess(d_2, z_2, square)) if derive else (),
    )


def _lift_ds(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    xi, alpha = shape
    under = 1 - (2 * alpha - 1) * square
    z_2 = (1 - alpha * alpha * square) / (alpha * np.sqrt(np.maximum(under, 0.0)) + (1 - alpha))
    length = z_2 * z_2 + square
    on_first = z_2 * z_2 + (1 - xi * xi) * square
    scale = (z_2 * xi + np.sqrt(on_first)) / length
    return scale, scale * z_2 - xi, under >= 0


PROJECTIONS: Mapping[ProjectionName, Projection] = {
    "pinhole": Projection(names=SHAPES["pinhole"], check=_check_pinhole, divide=_divide_pinhole, lift=_lift_pinhole),
    "omni": Projection(names=SHAPES["omni"], check=_check_omni, divide=_divide_omni, lift=_lift_omni),
    "eucm": Projection(names=SHAPES["eucm"], check=_check_eucm, divide=_divide_eucm, lift=_lift_eucm),
    "ds": Projection(names=SHAPES["ds"], check=_check_ds, divide=_divide_ds, lift=_lift_ds),
}
