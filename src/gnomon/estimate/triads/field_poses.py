"""A magnetometer's samples as poses: means over stretches in which the field, seen from the sensor, hardly turned.

A rest becomes a few poses with little noise, a fast turn one pose a sample: what counts is where on the sphere the
sensor was, not how long it stayed there.
"""

from dataclasses import fields

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats, Integers
from ...results.result import Booleans
from .triad_start import Ellipsoid, constrained_ellipsoid, general_ellipsoid

_ANGLES_RAD = np.radians(2.0), np.radians(8.0)  # least and most in one mean
_MOST = 3_000
_LONGEST_S = 5.0
_WINDOW_S = 0.1  # in which the angle is told from noise
_TRIALS, _DRAWN = 600, 10
_SCORED = 600
_SAMPLE = 2_000
_CELLS, _VISITED = 14, 0.3  # cells along each axis; share of the usual visits that counts as hardly any
_CONCENTRATIONS, _GATINGS = 10, 5
_GATE = 5.0
_MAD = 1.4826


@value_class
class FieldPoses:
    """Means of a magnetometer.

    Attributes
    ----------
    start, stop : (n,) first sample of each stretch, and that behind its last
    t_s : (n,) middle of it
    samples : (n,) samples in the mean; masked ones do not count
    measured : (n, 3) mean [unit]
    length : (n,) of such a mean in units of the field: the chord's less than 1 where the field turned meanwhile
    noise : (3,) standard deviation of a sample's noise [unit]
    """

    start: Integers
    stop: Integers
    t_s: Floats
    samples: Integers
    measured: Floats
    length: Floats
    noise: Floats

    def __len__(self) -> int:
        return len(self.start)

    def of(self, kept: Booleans) -> "FieldPoses":
        """Return some of the poses."""
        parts = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name != "noise"}
        return FieldPoses(**parts, noise=self.noise)

    @property
    def variance(self) -> Floats:
        """(n, 3) of the means by the noise [unit^2]."""
        return self.noise**2 / self.samples[:, None]


def sample_noise(values: Floats) -> Floats:
    """Return the standard deviation of white noise (3,) from second differences, at least that of rounding."""
    part = values[:200_000]
    bend = part[2:] - 2 * part[1:-1] + part[:-2]
    steps = np.abs(np.diff(part, axis=0))
    step = np.array([s[s > 0].min() if (s > 0).any() else 0.0 for s in steps.T])
    return np.maximum(_MAD * np.median(np.abs(bend), axis=0) / np.sqrt(6), step / np.sqrt(12))


def field_poses(t_s: Floats, values: Floats, usable: Booleans, shape: Ellipsoid) -> FieldPoses:
    """Gather samples into poses.

    Parameters
    ----------
    t_s : (n,) not falling [s]
    values : (n, 3) [unit]
    usable : (n,) samples that are not masked
    shape : of the magnetometer, roughly; it tells how far the field turned
    """
    t_s, values, where = t_s[usable], values[usable], np.flatnonzero(usable)
    noise = sample_noise(values)
    arc = _turned(t_s, values, noise, shape)
    angle = float(np.clip(arc[-1] / _MOST, *_ANGLES_RAD))
    slow = np.floor((t_s - t_s[0]) / _LONGEST_S)
    new = (np.diff(np.floor(arc / angle)) > 0) | (np.diff(slow) > 0)
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    stop = np.append(first[1:], len(t_s))
    count = stop - first
    turned = np.minimum(arc[stop - 1] - arc[first], 2 * angle)
    poses = FieldPoses(
        start=where[first],
        stop=where[stop - 1] + 1,
        t_s=np.add.reduceat(t_s, first) / count,
        samples=count,
        measured=np.add.reduceat(values, first, axis=0) / count[:, None],
        length=1 - turned**2 / 24,
        noise=noise,
    )
    return poses.of(np.arange(len(poses)) % max(1, round(len(poses) / _MOST)) == 0)


def _turned(t_s: Floats, values: Floats, noise: Floats, shape: Ellipsoid) -> Floats:
    """Return the angle through which the field turned until each sample, (n,) [rad], noise apart."""
    rate = (len(t_s) - 1) / max(float(t_s[-1] - t_s[0]), 1e-9)
    width = max(1, round(_WINDOW_S * rate))
    first = np.arange(0, max(len(t_s) - width, 0) + 1, width)
    means = np.add.reduceat(values, first, axis=0) / np.diff(np.append(first, len(t_s)))[:, None]
    direction = (means - shape.bias) @ shape.correction.T
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    step = np.linalg.norm(np.diff(direction, axis=0), axis=1)
    by_noise = 2 * float(np.sum((shape.correction * noise) ** 2)) / width
    turned = np.sqrt(np.maximum(step**2 - by_noise, 0.0))
    middle = t_s[np.minimum(first + width // 2, len(t_s) - 1)]
    return np.interp(t_s, middle, np.concatenate([[0.0], np.cumsum(turned)]))


def rough_ellipsoid(values: Floats) -> tuple[Ellipsoid, float] | None:
    """Return the ellipsoid near which most samples (n, 3) lie, and their usual distance |x| - 1; None if there is none.

    Least median of squares over small draws, then least squares over the nearer half, then over all that are near.
    """
    points = _spread_out(values)
    centre = np.median(points, axis=0)
    spread = np.maximum(np.quantile(np.abs(points - centre), 0.75, axis=0), 1e-300)
    m = (points - centre) / spread
    found = _of_least_median(m)
    found = found or _ellipsoid(m, certain=True)
    if found is None:
        return None
    for step in range(_CONCENTRATIONS + _GATINGS):
        size = np.abs(_distance(m, found))
        limit = float(np.median(size)) * (1.0 if step < _CONCENTRATIONS else _GATE * _MAD)
        found = _ellipsoid(m[size <= limit], certain=True) or found
    usual = usual_distance(m, found)
    return Ellipsoid(correction=found.correction / spread, bias=centre + spread * found.bias), usual


def usual_distance(m: Floats, shape: Ellipsoid) -> float:
    """Return the standard deviation of |x| - 1 of most samples (n, 3)."""
    return _MAD * float(np.median(np.abs(_distance(m, shape))))


def _of_least_median(m: Floats) -> Ellipsoid | None:
    """Return, of the ellipsoids through small draws of points (k, 3), that to which the middle point is nearest."""
    if len(m) < 2 * _DRAWN:
        return None
    draws = np.random.default_rng(0)
    x, y, z = np.moveaxis(m[draws.integers(len(m), size=(_TRIALS, _DRAWN))], -1, 0)
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=-1)
    a = (np.linalg.pinv(design) @ np.ones((_DRAWN, 1)))[..., 0]
    quadric = a[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
    sizes = np.linalg.eigvalsh(quadric)
    quadric, a = quadric[sizes[:, 0] > 1e-6 * sizes[:, 2]], a[sizes[:, 0] > 1e-6 * sizes[:, 2]]
    if not len(a):
        return None
    bias = -np.linalg.solve(quadric, a[:, 6:, None])[..., 0]
    quadric = quadric / (1 + np.einsum("ti,tij,tj->t", bias, quadric, bias))[:, None, None]
    away = m[:: max(1, len(m) // _SCORED)] - bias[:, None]
    along = away @ quadric
    square = np.einsum("tni,tni->tn", along, away)
    # Distances, not shares of the radius: those are small for any huge ellipsoid.
    distance = (square - np.sqrt(square)) / np.maximum(np.linalg.norm(along, axis=2), 1e-12)
    best = int(np.argmin(np.median(np.abs(distance), axis=1)))
    return Ellipsoid(correction=np.linalg.cholesky(quadric[best]).T, bias=bias[best])


def _spread_out(values: Floats) -> Floats:
    """Return some two thousand samples that cover what the sensor saw evenly, (k, 3), one of each cell of a grid.

    Cells that were hardly visited are left out: single wrong samples would fill many of them.
    """
    low, high = np.quantile(values[:: max(1, len(values) // 20_000)], (0.01, 0.99), axis=0)
    cells = np.floor((values - low) / np.maximum(high - low, 1e-300) * _CELLS).astype(np.int64)
    number = np.clip(cells, -1, _CELLS) @ np.array([1, 100, 10_000])
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    kept = np.sort(first[count >= _VISITED * np.quantile(count, 0.75)])
    return values[kept[:: max(1, len(kept) // _SAMPLE)]]


def _ellipsoid(m: Floats, *, certain: bool) -> Ellipsoid | None:
    ones = np.ones(len(m))
    found = general_ellipsoid(m, ones)
    return found if found is not None or not certain else constrained_ellipsoid(m, ones)


def _distance(m: Floats, shape: Ellipsoid) -> Floats:
    return np.linalg.norm((m - shape.bias) @ shape.correction.T, axis=1) - 1


def field_of(values: Floats, sensitivity: Floats, bias: Floats) -> Floats:
    """Return the field (n, 3) of measurements (n, 3)."""
    return (values - bias) @ invert_matrix(sensitivity).T
