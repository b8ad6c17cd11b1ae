"""Distortions of a lens: the plane behind the projection -> the plane of the sensor, in units of the focal length.

With m = (mx, my), s = mx^2 + my^2 and r = sqrt(s), every distortion of Kalibr is d = c(s) m, but for a tangential part
of radtan:

    none         c = 1
    radtan       c = 1 + k1 s + k2 s^2, and (2 p1 mx my + p2 (s + 2 mx^2), 2 p2 mx my + p1 (s + 2 my^2)) is added to d
    radtan5      the same with k3 s^3 in c, as OpenCV has it; Kalibr does not
    equidistant  c = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) / r,  theta = atan(r)
    fov          c = atan(2 r tan(w/2)) / (w r)

after Brown 1966 (radtan, in Bouguet's letters), Kannala and Brandt 2006 (equidistant) and Devernay and Faugeras 2001
(fov). All Jacobians dd/dm are symmetric matrices. A distortion is used as far out as it is one-to-one: see
`Distortion.limit`.
"""

from collections.abc import Callable, Mapping
from math import inf, pi, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..frozen import value_class
from .lens_names import COEFFICIENTS, DistortionName

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Pair = tuple[Floats, Floats]

_FARTHEST = 1e25  # no point of the plane is used beyond it; powers of it stay in the range of floating point numbers
_SERIES_BELOW = 0.01  # of s: ten terms of a series are exact below, and no difference cancels above


class Bent(NamedTuple):
    """Distorted points and the derivatives; scalars where they do not depend on the point.

    Attributes
    ----------
    x, y : (k,) distorted coordinates
    xx, xy, yy : (k,) dx/dmx, dx/dmy = dy/dmx, dy/dmy
    by_coeffs : for each coefficient, its (dx, dy), two (k,); empty where not asked for
    """

    x: Floats
    y: Floats
    xx: Floats | float
    xy: Floats | float
    yy: Floats | float
    by_coeffs: tuple[Pair, ...]


@value_class(eq=True)
class Distortion:
    """One distortion.

    Attributes
    ----------
    names : names of the coefficients
    check : raises OptionError where the coefficients make no sense
    limit : coefficients -> radius r [focal lengths] below which the distortion is one-to-one
    bend : (coefficients, mx, my, s, whether derivatives by the coefficients are wanted) -> Bent
    straighten : (coefficients, limit, dx, dy) -> (mx, my, whether there is such a point)
    """

    names: tuple[str, ...]
    check: Callable[[Floats], None]
    limit: Callable[[Floats], float]
    bend: Callable[[Floats, Floats, Floats, Floats, bool], Bent]
    straighten: Callable[[Floats, float, Floats, Floats], tuple[Floats, Floats, Booleans]]


def _nothing(coeffs: Floats) -> None:
    del coeffs


def first_root(coefficients: Floats) -> float:
    """Return the smallest positive root of 1 + c[0] x + c[1] x^2 + ..., or infinity."""
    # In 1/x the polynomial is monic, however small its coefficients are.
    roots = np.roots([1.0, *coefficients])
    real = roots.real[(np.abs(roots.imag) <= 1e-7 * np.abs(roots)) & (roots.real > 0)]
    return 1 / float(real.max()) if len(real) else inf


def solve_rising(function: Callable[[Floats], Pair], target: Floats, limit: float) -> tuple[Floats, Booleans]:
    """Solve f(x) = target >= 0 for a function with f(0) = 0 that rises on [0, limit), by Newton within a bracket.

    Parameters
    ----------
    function : x (k,) -> f(x), f'(x)
    target : (k,)
    limit : end of the interval

    Returns
    -------
    x : (k,)
    found : (k,) whether there is a solution below the limit
    """
    low = np.zeros_like(target)
    high = np.minimum(np.maximum(target, 1.0), limit)
    for _ in range(100):  # the bracket grows where there is no limit
        short = (function(high)[0] < target) & (high < limit)
        if not short.any():
            break
        high[short] = np.minimum(2 * high[short], limit)
    found = (function(high)[0] >= target) & (target < inf)
    x = np.clip(target, low, high)
    for _ in range(100):
        value, slope = function(x)
        below = value < target
        low, high = _either(below, x, low), _either(below, high, x)
        following = x - (value - target) / slope
        escaped = ~((following >= low) & (following <= high))  # not a number, too
        following = _either(escaped, 0.5 * (low + high), following)
        still = np.abs(following - x) > 4 * np.finfo(float).eps * x
        x = following
        if not (still & found).any():
            break
    return x, found & (x < limit)


def _either(chosen: Booleans, one: Floats, other: Floats) -> Floats:
    """Return the one where it is chosen, and the other elsewhere; of these types, which tools need not search for."""
    return np.where(chosen, one, other)


def arctan_over_x(square: Floats) -> Pair:
    """Return A = atan(r) / r and dA/ds, of s = r^2; exact at the axis, where s = 0."""
    r = np.sqrt(square)
    with np.errstate(invalid="ignore"):  # 0 / 0 on the axis
        ratio = np.arctan(r) / r
        slope = (1 / (1 + square) - ratio) / (2 * square)
    near = square < _SERIES_BELOW
    if near.any():
        s = square[near]
        a, b = np.zeros_like(s), np.zeros_like(s)  # A = sum of (-s)^n / (2n + 1), and its derivative, by Horner
        for n in range(9, -1, -1):
            b = b * s + a
            a = a * s + (-1.0) ** n / (2 * n + 1)
        ratio[near], slope[near] = a, b
    return ratio, slope


# No distortion.


def _unlimited(coeffs: Floats) -> float:
    del coeffs
    return _FARTHEST


def _bend_none(coeffs: Floats, mx: Floats, my: Floats, s: Floats, derive: bool) -> Bent:
    del coeffs, s, derive
    return Bent(x=mx, y=my, xx=1.0, xy=0.0, yy=1.0, by_coeffs=())


def _straighten_none(coeffs: Floats, limit: float, dx: Floats, dy: Floats) -> tuple[Floats, Floats, Booleans]:
    del coeffs
    return dx, dy, dx * dx + dy * dy < limit * limit


# Radial and tangential polynomials.


def _limit_radtan(coeffs: Floats) -> float:
    # dd/dm is the symmetric matrix c I + 2 c' m m^T + T; the eigenvalues of its radial part are c and d(c r)/dr, and
    # those of T are not less than -6 |p| r. Where the sum is positive in a whole disk, d is the gradient of a strictly
    # convex function there, hence one-to-one.
    k1, k2, p1, p2 = coeffs[:4]
    tangential = -6 * float(np.hypot(p1, p2))
    third = [0, coeffs[4]] if len(coeffs) > 4 else []
    along = first_root(np.array([tangential, 3 * k1, 0, 5 * k2, *(7 * k for k in third)]))
    across = first_root(np.array([tangential, k1, 0, k2, *third]))
    return min(along, across, _FARTHEST)


def _bend_radtan(coeffs: Floats, mx: Floats, my: Floats, s: Floats, derive: bool) -> Bent:
    k1, k2, p1, p2 = (float(k) for k in coeffs[:4])
    c = 1 + s * (k1 + k2 * s)
    twice_slope = 2 * k1 + 4 * k2 * s
    if len(coeffs) > 4:
        square = float(coeffs[4]) * s * s
        c = c + square * s
        twice_slope = twice_slope + 6 * square
    xx, xy, yy = mx * mx, mx * my, my * my
    px, py = 2 * p2 * mx, 2 * p1 * my
    cross = 2 * xy
    square_x, square_y = s + 2 * xx, s + 2 * yy
    by_coeffs: list[Pair] = []
    if derive:
        by_coeffs = [(s * mx, s * my), (s * s * mx, s * s * my), (cross, square_y), (square_x, cross)]
        if len(coeffs) > 4:
            cube = s * s * s
            by_coeffs.append((cube * mx, cube * my))
    return Bent(
        x=mx * c + p1 * cross + p2 * square_x,
        y=my * c + p2 * cross + p1 * square_y,
        xx=c + twice_slope * xx + (3 * px + py),
        xy=twice_slope * xy + 2 * p1 * mx + 2 * p2 * my,
        yy=c + twice_slope * yy + (3 * py + px),
        by_coeffs=tuple(by_coeffs),
    )


def _straighten_radtan(coeffs: Floats, limit: float, dx: Floats, dy: Floats) -> tuple[Floats, Floats, Booleans]:
    k1, k2 = coeffs[:2]
    k3 = float(coeffs[4]) if len(coeffs) > 4 else 0.0

    def radial(r: Floats) -> Pair:
        s = r * r
        return r * (1 + s * (k1 + s * (k2 + k3 * s))), 1 + s * (3 * k1 + s * (5 * k2 + 7 * k3 * s))

    length = np.hypot(dx, dy)
    r, _ = solve_rising(radial, length, limit)
    scale = np.divide(np.minimum(r, 0.999 * limit), length, out=np.ones_like(r), where=length > 0)
    return _newton_radtan(coeffs, limit, (dx, dy), (dx * scale, dy * scale))


def _newton_radtan(coeffs: Floats, limit: float, target: Pair, start: Pair) -> tuple[Floats, Floats, Booleans]:
    """Solve radtan for m by Newton; steps are halved until they stay inside the limit and lessen the error.

    The Jacobian is positive definite inside the limit (see `_limit_radtan`): if there is a solution, this finds it.
    """
    (dx, dy), (tx, ty) = target, start
    mx, my, nx, ny = tx, ty, np.zeros_like(tx), np.zeros_like(ty)
    error, step = np.full_like(tx, inf), np.ones_like(tx)
    precise = 4 * np.finfo(float).eps * (np.hypot(dx, dy) + np.hypot(tx, ty))
    for _ in range(100):
        sx, sy, size = _newton_step(coeffs, tx, ty, target)
        better = (size < error) & (tx * tx + ty * ty < limit * limit)
        mx, my, error = _either(better, tx, mx), _either(better, ty, my), _either(better, size, error)
        nx, ny = _either(better, sx, nx), _either(better, sy, ny)
        step = np.where(better, 1.0, 0.5 * step)
        if not ((error > precise) & (step > 1e-4)).any():
            break
        tx, ty = mx - step * nx, my - step * ny
    return mx, my, error <= 1e3 * precise


def _newton_step(coeffs: Floats, mx: Floats, my: Floats, target: Pair) -> tuple[Floats, Floats, Floats]:
    """Return what Newton takes off m, and the length of the error at m."""
    bent = _bend_radtan(coeffs, mx, my, mx * mx + my * my, False)
    ex, ey = bent.x - target[0], bent.y - target[1]
    determinant = bent.xx * bent.yy - bent.xy * bent.xy
    return (
        (bent.yy * ex - bent.xy * ey) / determinant,
        (bent.xx * ey - bent.xy * ex) / determinant,
        np.hypot(ex, ey),
    )


# Equidistant: an odd polynomial of the angle.


def _limit_equidistant(coeffs: Floats) -> float:
    k1, k2, k3, k4 = coeffs
    square = first_root(np.array([3 * k1, 5 * k2, 7 * k3, 9 * k4]))
    theta = square**0.5
    return tan(theta) if theta < pi / 2 else _FARTHEST


def _bend_equidistant(coeffs: Floats, mx: Floats, my: Floats, s: Floats, derive: bool) -> Bent:
    k1, k2, k3, k4 = (float(k) for k in coeffs)
    a, slope = arctan_over_x(s)
    t = s * a * a  # theta^2
    polynomial = 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))
    by_t = k1 + t * (2 * k2 + t * (3 * k3 + t * 4 * k4))
    c = a * polynomial
    twice_slope = 2 * (slope * polynomial + a * a * by_t / (1 + s))
    by_coeffs: list[Pair] = []
    power = a
    for _ in coeffs if derive else ():
        power = power * t
        by_coeffs.append((mx * power, my * power))
    return _radial(mx, my, c, twice_slope, tuple(by_coeffs))


def _radial(mx: Floats, my: Floats, c: Floats, twice_slope: Floats, by_coeffs: tuple[Pair, ...]) -> Bent:
    """Return c(s) m with its derivatives, of c (k,) and 2 dc/ds (k,)."""
    outer = twice_slope * mx
    return Bent(
        x=c * mx,
        y=c * my,
        xx=c + outer * mx,
        xy=outer * my,
        yy=c + twice_slope * my * my,
        by_coeffs=by_coeffs,
    )


def _straighten_equidistant(coeffs: Floats, limit: float, dx: Floats, dy: Floats) -> tuple[Floats, Floats, Booleans]:
    k1, k2, k3, k4 = coeffs

    def bent(theta: Floats) -> Pair:
        t = theta * theta
        return (
            theta * (1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))),
            1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4))),
        )

    length = np.hypot(dx, dy)
    theta, found = solve_rising(bent, length, float(np.arctan(limit)))
    scale = np.divide(np.tan(theta), length, out=np.ones_like(length), where=length > 0)
    return dx * scale, dy * scale, found


# Field of view: one angle.


def _check_fov(coeffs: Floats) -> None:
    if not 0 < coeffs[0] < pi:
        raise OptionError(f"w {coeffs[0]:g} is out of range; the angle of the fov distortion must lie in (0, pi).")


def _bend_fov(coeffs: Floats, mx: Floats, my: Floats, s: Floats, derive: bool) -> Bent:
    w = float(coeffs[0])
    factor = 2 * tan(w / 2)
    square = factor * factor
    tau = square * s
    a, slope = arctan_over_x(tau)
    by_coeffs: tuple[Pair, ...] = ()
    if derive:
        # dc/dw = ((1 + factor^2/4) / (1 + tau) - factor a / w) / w, its large terms taken out of both parts
        widening = 1 + 0.25 * square
        rest = 2 * slope + 1 / (1 + tau)  # (1 - a) / tau
        by_w = (_fov_excess(w / 2) + tau * (factor / w * rest - widening / (1 + tau))) / w
        by_coeffs = ((mx * by_w, my * by_w),)
    return _radial(mx, my, factor / w * a, 2 * factor * square / w * slope, by_coeffs)


def _fov_excess(half: float) -> float:
    """Return 1 + tan(h)^2 - tan(h) / h, which is 2 h^2 / 3 + ... for a small angle h."""
    t = half * half
    if half < 0.1:  # the series of tan(h) / h - 1
        ratio = t * (
            1 / 3 + t * (2 / 15 + t * (17 / 315 + t * (62 / 2835 + t * (1382 / 155925 + t * 21844 / 6081075))))
        )
    else:
        ratio = tan(half) / half - 1
    return tan(half) ** 2 - ratio


def _straighten_fov(coeffs: Floats, limit: float, dx: Floats, dy: Floats) -> tuple[Floats, Floats, Booleans]:
    w = float(coeffs[0])
    length = np.hypot(dx, dy)
    found = w * length < pi / 2
    factor = 2 * tan(w / 2)
    r = np.tan(np.where(found, w * length, 0.0)) / factor
    scale = np.divide(r, length, out=np.full_like(length, w / factor), where=length > 0)
    return dx * scale, dy * scale, found & (r < limit)


DISTORTIONS: Mapping[DistortionName, Distortion] = {
    "none": Distortion(
        names=COEFFICIENTS["none"], check=_nothing, limit=_unlimited, bend=_bend_none, straighten=_straighten_none
    ),
    "radtan": Distortion(
        names=COEFFICIENTS["radtan"],
        check=_nothing,
        limit=_limit_radtan,
        bend=_bend_radtan,
        straighten=_straighten_radtan,
    ),
    "radtan5": Distortion(
        names=COEFFICIENTS["radtan5"],
        check=_nothing,
        limit=_limit_radtan,
        bend=_bend_radtan,
        straighten=_straighten_radtan,
    ),
    "equidistant": Distortion(
        names=COEFFICIENTS["equidistant"],
        check=_nothing,
        limit=_limit_equidistant,
        bend=_bend_equidistant,
        straighten=_straighten_equidistant,
    ),
    "fov": Distortion(
        names=COEFFICIENTS["fov"], check=_check_fov, limit=_unlimited, bend=_bend_fov, straighten=_straighten_fov
    ),
}
