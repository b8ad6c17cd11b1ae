"""The map from a board to one image, through any lens that is nearly the same all around its axis.

A pixel (x, y) at the distance r from the axis at c sees along (x - c_x, y - c_y, g(r)), g a polynomial of r^2 with
g(0) = 1, which pinholes with distortion, fisheyes and mirrors follow; the board's points are seen along
(h_1 - c_x h_3, h_2 - c_y h_3, h_3), h = H (X, Y, 1), so that c does not matter where the lens does not bend. The first
guess is linear: the angle around the axis tells two rows of H whatever the lens is, and these tell the third row and g;
or the lens is taken from another image. Then all of it, and c, is fitted to the pixels. One view does not tell lens
from pose: the numbers mean nothing by themselves, but the map is smooth, and right between and around the points.

The fit of a corner takes its edges for straight ones. A lens bends them, by l^2 / 2 times their curvature at the
distance l from the corner, and the fit lays a straight line through what it sees: with a usual lens it is 0.001 to
0.005 px beside the corner, towards the axis, and so all images together tell another distortion. The board as a whole
tells how the lens bends it; each fit tells what it makes of that (`CornerFits.bow`). Light that falls off towards the
border (vignetting) displaces corners, too, by 0.0005 px outwards and by more with black wedges one way or the other;
its slope is that of a paraboloid through the grey levels of all corners.
"""

from dataclasses import dataclass

import numpy as np

from ...recording import Floats
from ..corners.fitted_corners import CornerFits
from .tag_places import homography

_TERMS = ((36, 5), (20, 4), (0, 3))  # of g, for so many points; more of them go astray beyond the points
_ITERATIONS = 12
_SETTLED_PX = 0.002
_AS_GOOD = 2.0  # mean square of residuals over that of the image whose lens is taken
_NEWTON = 3
_FIRST_DAMPING = 1e-4  # far from the best map, where an undamped step leads astray
_DAMPING, _AXIS = 1e-7, 1e-4  # of all parameters, and of the axis, which is near the middle of the image
_LEAST_G = 0.05  # where the lens is a first guess
_FEWEST_CORNERS = 16  # corners that tell how the lens bends the board
_BEND_STEP = 0.08  # along the board, over its size, to both sides of a corner
_ASTRAY_PX = 1.0  # a map that is so far from half of the corners tells nothing
_MOST_CORRECTED_PX = 0.1  # that a corner is moved
_NEAR_AXIS = 0.05  # weights of equations do not grow further there


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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

    def has_lens_of(self, other: "PlaneMap") -> bool:
        """Return whether both have the same lens."""
        return np.array_equal(self.parameters[9:], other.parameters[9:])

    def pixels(self, points: Floats, beside: int) -> Floats:
        """Return where points (n, k, 2) of the board are in the image, (n, k, 2) [px], k beside each one fitted to."""
        plane = (points.reshape(-1, 2) - self.origin) / self.scale
        seen = _seen(self.parameters, plane, _radius(self.parameters, plane, np.repeat(self.radius, beside)))
        return self.middle_px + self.scale_px * seen.reshape(points.shape)

    def away_px(self, points: Floats, pixels: Floats) -> Floats:
        """Return how far pixels (m, 2) are from where points (m, 2) are seen, (m,) [px]."""
        radius = np.hypot(*((pixels - self.middle_px) / self.scale_px - self.parameters[-2:]).T)
        plane = (points - self.origin) / self.scale
        seen = _seen(self.parameters, plane, _radius(self.parameters, plane, radius))
        return np.linalg.norm(self.middle_px + self.scale_px * seen - pixels, axis=1)


def plane_map(points: Floats, pixels: Floats, size: tuple[int, int], near: PlaneMap | None = None) -> PlaneMap:
    """Return the map that goes best through points.

    Parameters
    ----------
    points : (n, 2) on the board, 12 or more
    pixels : (n, 2) in the image [px]
    size : width and height of the image [px]
    near : of another image of the same camera and size, whose lens is taken, or else the first guess
    """
    origin, middle = points.mean(axis=0), (np.array(size) - 1) / 2
    scale, scale_px = float(np.abs(points - origin).max()), max(size) / 2
    plane, seen = (points - origin) / scale, (pixels - middle) / scale_px
    if near is None:
        parameters, damping = _first(plane, seen), _FIRST_DAMPING
    else:
        parameters, damping = _through_lens(near.parameters, plane, seen), _DAMPING
    radius = _radius(parameters, plane, np.hypot(*(seen - parameters[-2:]).T))
    fitted = _seen(parameters, plane, radius)
    good_enough = near is not None and np.square(scale_px * (seen - fitted)).mean() < _AS_GOOD * near.mean_square_px
    for _ in range(0 if good_enough else _ITERATIONS):
        J = _jacobian(parameters, plane, radius)
        normal, slope = J @ J.T, J @ (seen - fitted).ravel()
        normal[-2:, -2:] += _AXIS * np.eye(2)
        slope[-2:] -= _AXIS * parameters[-2:]
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), slope)
        at = _radius(parameters + step, plane, radius)
        moved = _seen(parameters + step, plane, at)
        settled = np.abs(moved - fitted).max() < _SETTLED_PX / scale_px
        if np.square(seen - moved).sum() < np.square(seen - fitted).sum():
            parameters, fitted, radius, damping = parameters + step, moved, at, max(damping / 10, _DAMPING)
        else:
            damping = max(10 * damping, _FIRST_DAMPING)
        if settled:
            break
    return PlaneMap(
        parameters=parameters,
        origin=origin,
        scale=scale,
        middle_px=middle,
        scale_px=scale_px,
        radius=radius,
        residual_px=scale_px * (seen - fitted),
    )


def _through_lens(known: Floats, plane: Floats, seen: Floats) -> Floats:
    """Return parameters with the lens of others, and the H that maps points to where they are seen through it."""
    axis = known[-2:]
    g, _ = _polynomial(known[9:-2], np.square(seen - axis).sum(axis=1))
    g = np.maximum(g, _LEAST_G)[:, None]
    H = homography(plane, axis + (seen - axis) / g)
    return np.concatenate([(H / np.linalg.norm(H) * np.sign(H[2, 2])).ravel(), known[9:]])


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

    def plane_map(self, points: Floats, pixels: Floats, size: tuple[int, int]) -> PlaneMap | None:
        """Return the map through points as `plane_map` does; None where it goes astray."""
        for near in dict.fromkeys((self._last, None)):
            found = plane_map(points, pixels, size, near)
            if np.median(np.abs(found.residual_px)) < _ASTRAY_PX:
                if near is None or not found.has_lens_of(near):
                    self._last = found
                return found
        return None


def corrected(points: Floats, fits: CornerFits, size: tuple[int, int], lens: LensGuess | None = None) -> Floats:
    """Return where the corners are, (m, 2) [px], without what bent edges and uneven light did to their fits.

    Parameters
    ----------
    points : (m, 2) on the board, whose edges are along both axes
    fits : of the corners, all of them good
    size : width and height of the image [px]
    lens : from the image before
    """
    spans = np.ptp(points, axis=0) if len(points) else np.zeros(2)
    if len(points) < _FEWEST_CORNERS or spans.min() <= 0:
        return fits.pixels
    seen = (lens or LensGuess()).plane_map(points, fits.pixels, size)
    if seen is None:
        return fits.pixels
    step = _BEND_STEP * float(spans.max())
    offsets = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    pixels = seen.pixels(points[:, None] + offsets, len(offsets))
    ahead, behind = pixels[:, 1::2] - pixels[:, :1], pixels[:, 2::2] - pixels[:, :1]
    along, bent = (ahead - behind) / 2, ahead + behind  # (m, axis of the board, 2)
    bent /= np.square(along).sum(axis=2, keepdims=True)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    # the axis of the board along which each edge runs
    axis = np.abs(np.einsum("mei,mai->mea", fits.normals, along)).argmin(axis=2)
    curvature = np.einsum("mei,mei->me", fits.normals, np.take_along_axis(bent, axis[:, :, None], axis=1))
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
