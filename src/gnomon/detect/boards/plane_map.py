"""The map from a board to one image, through any lens that is nearly the same all around its axis.

A pixel (x, y) at the distance r from the axis at c sees along (x - c_x, y - c_y, g(r)), g a polynomial of r^2 with
g(0) = 1, which pinholes with distortion, fisheyes and mirrors follow; the board's points are seen along
(h_1 - c_x h_3, h_2 - c_y h_3, h_3), h = H (X, Y, 1), so that c does not matter where the lens does not bend. The first
guess is linear: the angle around the axis tells two rows of H whatever the lens is, and these tell the third row and g;
or the lens is taken from another image. Then all of it, and c, is fitted to the pixels. One view does not tell lens
from pose: the numbers mean nothing by themselves, but the map is smooth, and right between and around the points.

The fit of a corner takes its edges for straight ones. A lens bends them, by l^2 / 2 times their curvature at the
distance l from the corner, and the fit lays a straight line through what it sees: with a usual lens it is 0.001 to
0.005 px beside the corner, towards the axis, and so all images together tell another distortion. What is straight on
the board is straight where (x, y) is drawn along (x - c_x, y - c_y) / g(r^2); so g alone tells how an edge with the
normal n bends at d = (x - c_x, y - c_y), by (n d) (2 g' + 4 g'' b^2) / (g - 2 r^2 g') with b^2 = r^2 - (n d)^2, and
each fit tells what it makes of that (`CornerFits.bow`). Light that falls off towards the
border (vignetting) displaces corners, too, by 0.0005 px outwards and by more with black wedges one way or the other;
its slope is that of a paraboloid through the grey levels of all corners.
"""

import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...recording import Floats
from .board import middle_of
from .corner_windows import CornerFits
from .tag_places import fit_homography, map_points

_TERMS = ((36, 5), (20, 4), (0, 3))  # of g, for so many points; more of them go astray beyond the points
_ITERATIONS = 12
_SETTLED_PX = 0.002
_AS_GOOD = 2.0  # mean square of residuals over that of the image whose lens is taken
_NEWTON = 3
_FIRST_DAMPING = 1e-4  # far from the best map, where an undamped step leads astray
_DAMPING, _AXIS = 1e-7, 1e-4  # of all parameters, and of the axis, which is near the middle of the image
_LEAST_G = 0.05  # where the lens is a first guess
_FEWEST_CORNERS = 16  # corners that tell how the lens bends the board
_BEYOND = 1.1  # over how far from the axis a lens is known
_ASTRAY_PX = 1.0  # a map that is so far from half of the corners tells nothing
_MOST_CORRECTED_PX = 0.1  # that a corner is moved
_NEAR_AXIS = 0.05  # weights of equations do not grow further there


@value_class
class PlaneMap:
    """A map from a board to an image.

    Attributes
    ----------
    parameters : (m,) H row by row, the coefficients of g from r^2 on, and the axis, in the units below
    origin, scale : (2,) and of the points on the board
    middle_px, scale_px : (2,) and of the pixels
    radius : (n,) of the points' pixels from the axis, in these units
    residual_px : (n, 2) pixels less where the map has them
    """

    parameters: Floats
    origin: Floats
    scale: float
    middle_px: Floats
    scale_px: float
    radius: Floats
    residual_px: Floats

    @property
    def mean_square_px(self) -> float:
        """Mean square of the residuals [px^2]."""
        return float(np.square(self.residual_px).mean())

    def curvature(self, pixels: Floats, normals: Floats) -> Floats:
        """Return how edges at pixels (m, 2) bend towards their normals (m, k, 2), (m, k) [1/px]."""
        away = (pixels - self.middle_px) / self.scale_px - self.parameters[-2:]
        s = np.square(away).sum(axis=1)[:, None]
        coefficients = self.parameters[9:-2]
        g, slope = _polynomial(coefficients, s)
        second = np.zeros_like(s)
        for k in range(len(coefficients), 1, -1):
            second = second * s + k * (k - 1) * coefficients[k - 1]
        across = np.matmul(normals, away[:, :, None])[:, :, 0]
        bottom = g - 2 * s * slope
        bottom = np.where(bottom < _LEAST_G, np.inf, bottom)  # beyond the edge of what such a lens sees
        return across * (2 * slope + 4 * second * (s - across * across)) / bottom / self.scale_px

    def pixels(self, points: Floats, beside: int) -> Floats:
        """Return where points (n, k, 2) of the board are in the image, (n, k, 2) [px], k beside each one fitted to."""
        plane = (points.reshape(-1, 2) - self.origin) / self.scale
        seen = _seen(self.parameters, plane, _radius(self.parameters, plane, np.repeat(self.radius, beside)))
        return self.middle_px + self.scale_px * seen.reshape(points.shape)

    def seen(self, points: Floats, near: Floats) -> Floats:
        """Return where points (n, 2) of the board are in the image, (n, 2), sought from pixels near there [px]."""
        radius = self.from_axis(near)
        plane = (points - self.origin) / self.scale
        return self.middle_px + self.scale_px * _seen(self.parameters, plane, _radius(self.parameters, plane, radius))

    def from_axis(self, pixels: Floats) -> Floats:
        """Return how far pixels (n, 2) are from the axis, (n,), in the units of the radius."""
        return np.hypot(*((pixels - self.middle_px) / self.scale_px - self.parameters[-2:]).T)

    def away_px(self, points: Floats, pixels: Floats) -> Floats:
        """Return how far pixels (m, 2) are from where points (m, 2) are seen, (m,) [px]."""
        return np.linalg.norm(self.seen(points, pixels) - pixels, axis=1)


@value_class
class _Units:
    """Points of a board and their pixels, so moved and scaled that they are about one."""

    origin: Floats
    scale: float
    middle_px: Floats
    scale_px: float

    @classmethod
    def of(cls, points: Floats, size: tuple[int, int]) -> "_Units":
        """Return those of points (n, 2) of the board, in an image of this width and height [px]."""
        origin = points.mean(axis=0)
        scale = float(np.abs(points - origin).max())
        return cls(origin=origin, scale=scale, middle_px=(np.array(size) - 1) / 2, scale_px=max(size) / 2)

    def both(self, points: Floats, pixels: Floats) -> tuple[Floats, Floats]:
        """Return points (n, 2) of the board and their pixels (n, 2) in these units."""
        return (points - self.origin) / self.scale, (pixels - self.middle_px) / self.scale_px

    def plane_map(self, parameters: Floats, radius: Floats, residual: Floats) -> PlaneMap:
        """Return the map with parameters (p,); pixels of its points are at radii (n,), off by residuals (n, 2)."""
        return PlaneMap(
            parameters=parameters,
            origin=self.origin,
            scale=self.scale,
            middle_px=self.middle_px,
            scale_px=self.scale_px,
            radius=radius,
            residual_px=self.scale_px * residual,
        )


def through_lens(points: Floats, pixels: Floats, size: tuple[int, int], lens: PlaneMap) -> PlaneMap:
    """Return the map with the lens of another one that goes through points; see `plane_map`."""
    units = _Units.of(points, size)
    plane, seen = units.both(points, pixels)
    known = lens.parameters
    axis = known[-2:]
    away = seen - axis
    s = np.square(away).sum(axis=1)
    g, slope = _polynomial(known[9:-2], s)
    g = np.maximum(g, _LEAST_G)
    straight = axis + away / g[:, None]
    H = fit_homography(plane, straight)
    apart = straight - map_points(H[None], plane)[0]
    # to first order: by the inverse of the derivatives of away / g
    stretch = 2 * slope / np.maximum(g - 2 * s * slope, _LEAST_G)
    residual = g[:, None] * (apart + (stretch * (away * apart).sum(axis=1))[:, None] * away)
    parameters = np.concatenate([(H / np.linalg.norm(H) * np.sign(H[2, 2])).ravel(), known[9:]])
    return units.plane_map(parameters, np.sqrt(s), residual)


def plane_map(points: Floats, pixels: Floats, size: tuple[int, int], near: PlaneMap | None = None) -> PlaneMap:
    """Return the map that goes best through points.

    Parameters
    ----------
    points : (n, 2) on the board, 12 or more
    pixels : (n, 2) in the image [px]
    size : width and height of the image [px]
    near : of another image of the same camera and size, whose lens is taken, or else the first guess
    """
    units = _Units.of(points, size)
    plane, seen = units.both(points, pixels)
    if near is None:
        parameters, damping = _first(plane, seen), _FIRST_DAMPING
    else:
        found = through_lens(points, pixels, size, near)
        if found.mean_square_px < _AS_GOOD * near.mean_square_px:
            return found
        parameters, damping = found.parameters, _DAMPING
    radius = _radius(parameters, plane, np.hypot(*(seen - parameters[-2:]).T))
    fitted = _seen(parameters, plane, radius)

    def damped_step(parameters: Floats, radius: Floats, fitted: Floats, damping: float) -> Floats:
        J = _jacobian(parameters, plane, radius)
        normal, slope = J @ J.T, J @ (seen - fitted).ravel()
        normal[-2:, -2:] += _AXIS * np.eye(2)
        slope[-2:] -= _AXIS * parameters[-2:]
        return np.asarray(np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), slope), np.float64)

    for _ in range(_ITERATIONS):
        step = damped_step(parameters, radius, fitted, damping)
        at = _radius(parameters + step, plane, radius)
        moved = _seen(parameters + step, plane, at)
        settled = np.abs(moved - fitted).max() < _SETTLED_PX / units.scale_px
        if np.square(seen - moved).sum() < np.square(seen - fitted).sum():
            parameters, fitted, radius, damping = parameters + step, moved, at, max(damping / 10, _DAMPING)
        else:
            damping = max(10 * damping, _FIRST_DAMPING)
        if settled:
            break
    return units.plane_map(parameters, radius, seen - fitted)


def _first(plane: Floats, seen: Floats) -> Floats:
    """Return parameters by two sets of linear equations, with the axis in the middle of the image."""
    X, (x, y) = np.column_stack([plane, np.ones(len(plane))]), seen.T
    radius = np.maximum(np.hypot(x, y), _NEAR_AXIS)
    around = np.hstack([-y[:, None] * X, x[:, None] * X]) / np.sqrt(radius)[:, None]
    rows = _null(around).reshape(2, 3)
    outwards = x * (X @ rows[0]) + y * (X @ rows[1])
    if outwards.sum() < 0:
        rows, outwards = -rows, -outwards
    squares = x * x + y * y
    terms = next(terms for fewest, terms in _TERMS if len(plane) >= fewest)
    powers = np.stack([squares**k for k in range(terms)], axis=1)
    along = np.hstack([powers * outwards[:, None], -squares[:, None] * X]) / radius[:, None]
    size = np.linalg.norm(along, axis=0)
    found = _null(along / size) / size
    if (powers @ found[:terms]).sum() < 0:
        found = -found
    found /= np.linalg.norm(found[terms:])
    rows /= np.linalg.norm(rows)
    # of any common size are the third row and g, which is 1 on the axis
    on_axis = found[0] if abs(found[0]) > _LEAST_G else _LEAST_G
    return np.concatenate([rows.ravel(), found[terms:] / on_axis, found[1:terms] / on_axis, [0.0, 0.0]])


def _null(equations: Floats) -> Floats:
    return np.linalg.svd(equations, full_matrices=False)[2][-1]


def _rays(parameters: Floats, plane: Floats) -> tuple[Floats, Floats]:
    """Return rays to points (n, 2), (3, n), and how far across the axis these reach, (n,)."""
    H, axis = parameters[:9].reshape(3, 3), parameters[-2:, None]
    rays = H[:, :2] @ plane.T + H[:, 2:]
    rays[:2] -= axis * rays[2]
    return rays, np.maximum(np.hypot(rays[0], rays[1]), 1e-12)


def _polynomial(coefficients: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Return g, whose constant term is 1, and its derivative at squares of radii (n,)."""
    g, slope = np.zeros_like(s), np.zeros_like(s)
    for a in (*coefficients[::-1].tolist(), 1.0):
        slope = slope * s + g
        g = g * s + a
    return g, slope


def _radius(parameters: Floats, plane: Floats, radius: Floats) -> Floats:
    """Return how far from the axis points (n, 2) are seen, g(r^2) across = r z, sought from `radius` (n,)."""
    rays, across = _rays(parameters, plane)
    for _ in range(_NEWTON):
        g, slope = _polynomial(parameters[9:-2], radius * radius)
        radius = radius - (g * across - radius * rays[2]) / _bottom(rays, across, radius, slope)
    return radius


def _bottom(rays: Floats, across: Floats, radius: Floats, slope: Floats) -> Floats:
    """Return the derivative of g(r^2) across - r z by r, (n,)."""
    bottom = 2 * radius * slope * across - rays[2]
    return np.where(np.abs(bottom) < 1e-9, 1e-9, bottom)


def _seen(parameters: Floats, plane: Floats, radius: Floats) -> Floats:
    """Return where points (n, 2) are seen that are so far from the axis, (n, 2)."""
    rays, across = _rays(parameters, plane)
    return parameters[-2:] + ((radius / across) * rays[:2]).T


def _jacobian(parameters: Floats, plane: Floats, radius: Floats) -> Floats:
    """Return the derivatives of `_seen` by the parameters, (m, 2 n), those of r from g(r^2) across = r z."""
    rays, across = _rays(parameters, plane)
    coefficients = parameters[9:-2]
    s = radius * radius
    g, slope = _polynomial(coefficients, s)
    bottom = _bottom(rays, across, radius, slope)
    along = rays[:2] / across  # towards where the point is seen from the axis
    outwards, aside = -g / bottom, radius / across
    n = len(plane)
    J = np.zeros((len(parameters), n, 2))
    power = -across / bottom
    for k in range(len(coefficients)):
        power = power * s
        J[9 + k] = (power * along).T
    # by the ray: its first two entries move the pixel towards and around the axis, the third towards it
    by_first_two = (outwards - aside) * along[:, None] * along  # (ray, pixel, n)
    by_first_two[0, 0] += aside
    by_first_two[1, 1] += aside
    by_ray = np.concatenate([by_first_two, ((radius / bottom) * along)[None]])
    J[-2:] = -np.moveaxis(by_ray[:2] * rays[2], 2, 1)
    J[-2, :, 0] += 1
    J[-1, :, 1] += 1
    by_ray[2] -= np.tensordot(parameters[-2:], by_ray[:2], 1)
    points = np.stack([plane[:, 0], plane[:, 1], np.ones(n)])
    J[:9] = np.einsum("rpn,cn->rcnp", by_ray, points).reshape(9, n, 2)
    return J.reshape(len(parameters), -1)


class LensGuess:
    """What an image told of the lens: a first guess for the next image of the same camera."""

    def __init__(self) -> None:
        self._last: PlaneMap | None = None
        self._reach = 0.0  # how far from the axis this lens was seen to fit

    def plane_map(self, points: Floats, pixels: Floats, size: tuple[int, int]) -> PlaneMap | None:
        """Return the map through points (n, 2) as `plane_map` does; None where it goes astray, or they are too few."""
        if len(points) < _FEWEST_CORNERS or np.ptp(points, axis=0).min() <= 0:
            return None
        for near in dict.fromkeys((self._last, None)):
            found = plane_map(points, pixels, size, near)
            if middle_of(np.abs(found.residual_px)) < _ASTRAY_PX:
                if near is None or not np.array_equal(found.parameters[9:], near.parameters[9:]):
                    self._last, self._reach = found, 0.0
                self._reach = max(self._reach, float(found.radius.max()))
                return found
        return None

    def through_lens(self, points: Floats, pixels: Floats, size: tuple[int, int]) -> PlaneMap | None:
        """Return the map through points with the lens of the image before; None where that is not known."""
        return None if self._last is None else through_lens(points, pixels, size, self._last)

    def knows(self, seen: PlaneMap, pixels: Floats) -> Booleans:
        """Return which pixels (n, 2) are hardly farther from the axis of a map than where its lens was seen to fit."""
        return seen.from_axis(pixels) < _BEYOND * self._reach


def correct_corners(fits: CornerFits, size: tuple[int, int], seen: PlaneMap | None) -> Floats:
    """Return where the corners are, (m, 2) [px], without what bent edges and uneven light did to their fits.

    Parameters
    ----------
    fits : of the corners, all of them good
    size : width and height of the image [px]
    seen : the map through the corners; None where none is known
    """
    if seen is None:
        return fits.pixels
    curvature = seen.curvature(fits.pixels, fits.normals)
    moved = np.einsum("mie,me->mi", fits.bow, curvature) + np.einsum("mie,me->mi", fits.slope, _light_slope(fits, size))
    moved[~(np.abs(moved).max(axis=1) < _MOST_CORRECTED_PX)] = 0.0
    return fits.pixels - moved


def _light_slope(fits: CornerFits, size: tuple[int, int]) -> Floats:
    """Return by which share of it the light grows to the right and downwards, (m, 2) [1/px]."""
    scale = max(size) / 2
    x, y = ((fits.pixels - np.array(size) / 2) / scale).T
    one, none = np.ones_like(x), np.zeros_like(x)
    grey = np.maximum(fits.white + fits.black, 1.0)
    light, *_ = np.linalg.lstsq(np.stack([one, x, y, x * x, x * y, y * y], axis=1), np.log(grey), rcond=None)
    by_x = np.stack([none, one, none, 2 * x, y, none], axis=1)
    by_y = np.stack([none, none, one, none, x, 2 * y], axis=1)
    return np.stack([by_x @ light, by_y @ light], axis=1) / scale
