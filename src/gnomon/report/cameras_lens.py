"""What a lens does with angles, and how well that is known: numbers for the figures of a camera report.

Standard deviations follow from the covariance of the lens's parameters by the derivatives of its image. Where a lens
and the attitude of its camera trade against each other, as a shift of the principal point does with a small turn, the
turn is taken off: whoever uses the lens estimates an attitude with it.
"""

from dataclasses import dataclass

import numpy as np

from ..assess.cameras_tables import CELLS
from ..calibration import Calibration
from ..geometry.so3 import skew
from ..models.camera import Camera
from ..recording import Floats
from .numbers import finite

SPREAD_COLUMNS = 30
"""Cells across the image in which the standard deviation of a projection is found."""
_AZIMUTHS = 12
_WIDEST = np.radians(68)
"""Angle from the axis beyond which a straightened image is not drawn: it would be endless at 90 degrees."""
_GRID_LINES = 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProjectionSpread:
    """How well the image of a ray is known, cell by cell of the image.

    Attributes
    ----------
    corner : (n, 2) upper left corners of the cells [px]
    size : width and height of a cell [px]
    shape : rows and columns of cells
    sigma : (n,) standard deviation per axis of the image of a ray in the middle of the cell, after the turn that fits
        best where corners were seen [px]; nan where the lens has no ray
    fixed : (n,) the same with the camera's axes held fast [px]
    seen : (n,) whether corners were used in the cell or all around it
    """

    corner: Floats
    size: tuple[float, float]
    shape: tuple[int, int]
    sigma: Floats
    fixed: Floats
    seen: np.ndarray


def lens_covariance(calibration: Calibration, name: str) -> Floats:
    """Return the covariance (q, q) of the parameters of a lens, intrinsics first."""
    return calibration.covariance(f"{name}.intrinsics", f"{name}.distortion_coeffs")


def projection_spread(camera: Camera, covariance: Floats, pixels: Floats) -> ProjectionSpread:
    """Return how well the images of rays are known.

    With q(ray; p) the image, d p a change of the lens and r a small turn of the camera, d q = J_p d p + J_r r; the
    turn r is the one for which the sum of |d q|^2 over the cells in which corners were used is least.

    Parameters
    ----------
    camera : the lens
    covariance : (q, q) of its parameters
    pixels : (m, 2) of the corners used [px]
    """
    width, height = camera.resolution
    columns, rows = SPREAD_COLUMNS, max(1, round(SPREAD_COLUMNS * height / width))
    size = (width / columns, height / rows)
    y, x = np.divmod(np.arange(rows * columns), columns)
    corner = np.stack([x * size[0], y * size[1]], axis=1) - 0.5
    middle = corner + np.array(size) / 2
    seen = _with_corners(pixels, middle, camera.resolution)
    by_lens, by_turn, valid = _derivatives(camera, middle)
    fixed = _per_axis(by_lens, covariance)
    used = valid & (seen if (seen & valid).sum() > 2 else True)
    normal = np.einsum("nki,nkj->ij", by_turn[used], by_turn[used])
    pull = np.einsum("nki,nkj->ij", by_turn[used], by_lens[used])
    turned = by_lens - by_turn @ (np.linalg.pinv(normal) @ pull)
    sigma = _per_axis(turned, covariance)
    sigma[~valid] = fixed[~valid] = np.nan
    return ProjectionSpread(corner=corner, size=size, shape=(rows, columns), sigma=sigma, fixed=fixed, seen=seen)


def _with_corners(pixels: Floats, places: Floats, resolution: tuple[int, int]) -> np.ndarray:
    """Tell of places (n, 2) whether there are corners (m, 2) in their cells of the image, by which coverage is told."""
    scale = np.array(CELLS[::-1]) / np.array(resolution)
    last = np.array(CELLS[::-1]) - 1

    def cell(points: Floats) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.clip(np.floor((points + 0.5) * scale), 0, last).astype(np.int64).T
        return y, x

    occupied = np.zeros(CELLS, dtype=np.bool_)
    occupied[cell(pixels)] = True
    return occupied[cell(places)]


def _derivatives(camera: Camera, pixels: Floats) -> tuple[Floats, Floats, np.ndarray]:
    """Return the derivatives of images of rays, by the lens's parameters (n, 2, q) and by a turn of the rays (n, 2, 3).

    The third array (n,) tells where there are any. The rays are those seen at pixels (n, 2) [px].
    """
    rays, valid = camera.unproject(pixels)
    image = camera.project(np.where(valid[:, None], rays, (0.0, 0.0, 1.0)), parameters_jacobian=True)
    assert image.by_parameters is not None
    assert image.by_point is not None
    return image.by_parameters, -image.by_point @ skew(np.nan_to_num(rays)), valid & image.valid


def _per_axis(slopes: Floats, covariance: Floats) -> Floats:
    """Return standard deviations (n,) of what has two components and the derivatives (n, 2, q), rms over the two."""
    variance = np.einsum("nki,ij,nkj->n", slopes, covariance, slopes) / 2
    return np.sqrt(np.fmax(variance, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RadialCurve:
    """Distance of an image from that of the optical axis, over the angle of the ray to it, mean over all directions.

    Attributes
    ----------
    angle : (n,) [rad]
    radius, sigma : (n,) [px], and its standard deviation
    focal, focal_sigma : slope of the radius at the axis, and its standard deviation [px per rad]
    reach : angle of the farthest corner used [rad]; zero without one
    edges : angle of the upper or lower edge of the image, of a side, and of a corner, the nearest of each [rad]
    """

    angle: Floats
    radius: Floats
    sigma: Floats
    focal: float
    focal_sigma: float
    reach: float
    edges: tuple[float, float, float]


def radial_curve(camera: Camera, covariance: Floats, pixels: Floats) -> RadialCurve:
    """Return radius over angle; `pixels` (m, 2) are those of the corners used [px]."""
    width, height = camera.resolution
    middle = camera.intrinsics[-2:]
    places = np.array([(middle[0], 0), (middle[0], height - 1), (0, middle[1]), (width - 1, middle[1])])
    ends = _angles(camera, np.concatenate([places, [(a, b) for a in (0, width - 1) for b in (0, height - 1)]]))
    edges = tuple(
        float(np.nanmin(part)) if np.isfinite(part).any() else np.nan for part in (ends[:2], ends[2:4], ends[4:])
    )
    seen = finite(_angles(camera, pixels[:: max(1, len(pixels) // 20_000)]))
    most = float(np.nanmax(ends)) if np.isfinite(ends).any() else 1.0
    angle = np.linspace(0.0, most, 121)
    around = np.linspace(0, 2 * np.pi, _AZIMUTHS, endpoint=False)
    across = np.stack([np.cos(around), np.sin(around), np.zeros(_AZIMUTHS)], axis=1)
    rays = np.sin(angle)[:, None, None] * across + np.cos(angle)[:, None, None] * (0.0, 0.0, 1.0)
    image = camera.project(rays.reshape(-1, 3), parameters_jacobian=True)
    assert image.by_parameters is not None
    pixel, slopes = image.pixels.reshape(121, -1, 2), image.by_parameters.reshape(121, _AZIMUTHS, 2, -1)
    away = pixel - pixel[0, 0]
    radius = np.linalg.norm(away, axis=2)
    outwards = away / np.where(radius > 0, radius, 1.0)[..., None]
    by_lens = np.einsum("nak,nakq->nq", outwards, slopes - slopes[0, 0]) / _AZIMUTHS
    spread = np.sqrt(np.fmax(np.einsum("ni,ij,nj->n", by_lens, covariance, by_lens), 0.0))
    mean = radius.mean(axis=1)
    return RadialCurve(
        angle=angle,
        radius=mean,
        sigma=np.where(np.isfinite(mean), spread, np.nan),
        focal=float(mean[1] / angle[1]),
        focal_sigma=float(spread[1] / angle[1]),
        reach=float(seen.max()) if seen.size else 0.0,
        edges=(edges[0], edges[1], edges[2]),
    )


def _angles(camera: Camera, pixels: Floats) -> Floats:
    """Return the angles (n,) of the rays seen at pixels (n, 2) to the optical axis [rad]; nan without a ray."""
    rays, _ = camera.unproject(pixels)
    return np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Return the angles from left to right and from top to bottom, through the principal point [rad].

    They are nan where the lens has no ray at the edge.
    """
    width, height = camera.resolution
    u, v = camera.intrinsics[-2:]
    left, right, top, bottom = _angles(camera, np.array([(0, v), (width - 1, v), (u, 0), (u, height - 1)])).tolist()
    return left + right, top + bottom


def focal_at_axis(camera: Camera) -> Floats:
    """Return how many pixels a radian at the optical axis is along u and along v, (2,) [px]; a pinhole's fu and fv."""
    by_point = camera.project(np.array([[0.0, 0.0, 1.0]])).by_point
    assert by_point is not None
    return np.diag(by_point[0])


def straightened(camera: Camera) -> list[Floats]:
    """Return columns and rows of pixels as a pinhole with the same middle would see them, (n, 2) [px].

    What lies more than 68 degrees off the axis is left out (nan).
    """
    width, height = camera.resolution
    focal = focal_at_axis(camera)
    step = max(width, height) / _GRID_LINES
    lines: list[Floats] = []
    for along, across in ((0, 1), (1, 0)):
        ends = (width - 1, height - 1)
        run = np.linspace(0, ends[across], 61)
        for at in np.linspace(0, ends[along], 1 + max(2, round(ends[along] / step))):
            line = np.empty((61, 2))
            line[:, along], line[:, across] = at, run
            rays, valid = camera.unproject(line)
            kept = valid & (rays[:, 2] > np.cos(_WIDEST))
            with np.errstate(invalid="ignore", divide="ignore"):
                flat = focal * rays[:, :2] / rays[:, 2:] + camera.intrinsics[-2:]
            lines.append(np.where(kept[:, None], flat, np.nan))
    return lines
