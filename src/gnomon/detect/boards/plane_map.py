"""The map from a board to one image, through any lens that is nearly the same all around its axis.

A pixel at the distance r from the axis sees along (x, y, g(r)), g a polynomial of r^2, which pinholes with
distortion, fisheyes and mirrors follow; the board's points are seen along H (X, Y, 1). The first guess is linear: the
angle around the axis tells two rows of H whatever the lens is, and these tell the third row and g. Then all of it, and
where the axis is, is fitted to the pixels. One view does not tell lens from pose: the numbers mean nothing by
themselves, but the map is smooth, and right between and around the points.
"""

from dataclasses import dataclass

import numpy as np

from ...recording import Floats

_TERMS, _MORE_TERMS, _MANY = 4, 5, 36  # of g, and of many points; more of them go astray beyond the points
_ITERATIONS = 8
_SETTLED_PX = 0.002
_NEWTON = 3
_STEP = 1e-6
_FIRST_DAMPING = 1e-4  # where an undamped step leads astray
_DAMPING, _AXIS = 1e-7, 1e-4  # of all parameters, and of the axis, which is near the middle of the image
_NEAR_AXIS = 0.05  # weights of equations do not grow further there


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneMap:
    """A map from a board to an image.

    Attributes
    ----------
    parameters : (m,) H row by row, the coefficients of g, and the axis, in the units below
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

    def pixels(self, points: Floats, beside: int) -> Floats:
        """Return where points (n, k, 2) of the board are in the image, (n, k, 2) [px], k beside each one fitted to."""
        plane = (points.reshape(-1, 2) - self.origin) / self.scale
        seen, _ = _projected(self.parameters[None], plane, np.repeat(self.radius, beside)[None])
        return self.middle_px + self.scale_px * seen.reshape(points.shape)

    def away_px(self, points: Floats, pixels: Floats) -> Floats:
        """Return how far pixels (m, 2) are from where points (m, 2) are seen, (m,) [px]."""
        radius = np.hypot(*((pixels - self.middle_px) / self.scale_px - self.parameters[-2:]).T)
        seen, _ = _projected(self.parameters[None], (points - self.origin) / self.scale, radius[None])
        return np.linalg.norm(self.middle_px + self.scale_px * seen[0] - pixels, axis=1)


def plane_map(points: Floats, pixels: Floats, size: tuple[int, int]) -> PlaneMap:
    """Return the map that goes best through points.

    Parameters
    ----------
    points : (n, 2) on the board, 12 or more
    pixels : (n, 2) in the image [px]
    size : width and height of the image [px]
    """
    origin, middle = points.mean(axis=0), (np.array(size) - 1) / 2
    scale, scale_px = float(np.abs(points - origin).max()), max(size) / 2
    plane, seen = (points - origin) / scale, (pixels - middle) / scale_px
    parameters, radius = _first(plane, seen), np.hypot(*seen.T)
    fitted, radius = _projected(parameters[None], plane, radius[None])
    fitted, radius = fitted[0], radius[0]
    damping = _DAMPING
    for _ in range(_ITERATIONS):
        trials = parameters + _STEP * np.eye(len(parameters))
        by_trial, _ = _projected(trials, plane, np.broadcast_to(radius, (len(trials), len(radius))))
        J = ((by_trial - fitted) / _STEP).reshape(len(trials), -1)
        normal, slope = J @ J.T, J @ (seen - fitted).ravel()
        normal[-2:, -2:] += _AXIS * np.eye(2)
        slope[-2:] -= _AXIS * parameters[-2:]
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), slope)
        moved, at = _projected((parameters + step)[None], plane, radius[None])
        if np.square(seen - moved[0]).sum() < np.square(seen - fitted).sum():
            small = np.abs(moved[0] - fitted).max() < _SETTLED_PX / scale_px
            parameters, fitted, radius, damping = parameters + step, moved[0], at[0], max(damping / 10, _DAMPING)
            if small:
                break
        else:
            damping = max(100 * damping, _FIRST_DAMPING)
    return PlaneMap(
        parameters=parameters,
        origin=origin,
        scale=scale,
        middle_px=middle,
        scale_px=scale_px,
        radius=radius,
        residual_px=scale_px * (seen - fitted),
    )


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
    terms = _TERMS if len(plane) < _MANY else _MORE_TERMS
    powers = np.stack([squares**k for k in range(terms)], axis=1)
    along = np.hstack([powers * outwards[:, None], -squares[:, None] * X]) / radius[:, None]
    size = np.linalg.norm(along, axis=0)
    found = _null(along / size) / size
    if (powers @ found[:terms]).sum() < 0:
        found = -found
    found /= np.linalg.norm(found[terms:])
    rows /= np.linalg.norm(rows)
    # the third row and g may be of any common size
    return np.concatenate([rows.ravel(), found[terms:], found[:terms], [0.0, 0.0]])


def _null(equations: Floats) -> Floats:
    return np.linalg.svd(equations, full_matrices=False)[2][-1]


def _projected(parameters: Floats, plane: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Return where points (n, 2) are seen by maps (k, m), (k, n, 2), and how far from the axis, (k, n).

    `radius` (k, n) is from where the latter is sought.
    """
    H, a, axis = parameters[:, :9].reshape(-1, 3, 3), parameters[:, 9:-2, None], parameters[:, None, -2:]
    rays = np.einsum("kij,nj->kin", H, np.column_stack([plane, np.ones(len(plane))]))
    across = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-12)
    r = radius
    for _ in range(_NEWTON):
        s = r * r
        g, slope = np.zeros_like(r), np.zeros_like(r)
        for k in range(a.shape[1] - 1, -1, -1):  # g and its derivative by s
            slope = slope * s + g
            g = g * s + a[:, k]
        bottom = 2 * r * slope * across - rays[:, 2]
        r = r - (g * across - r * rays[:, 2]) / np.where(np.abs(bottom) < 1e-9, 1e-9, bottom)
    return axis + (r / across)[..., None] * np.moveaxis(rays[:, :2], 1, 2), r
