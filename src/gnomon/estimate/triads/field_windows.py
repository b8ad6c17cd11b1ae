"""Offsets and scales of a magnetometer in windows of time, as they differ from those of the whole recording."""

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from .blocks import TimeBlocks, memory_s
from .field_poses import FieldPoses
from .magnetometer import MagnetometerFit

_MOST, _SHORTEST_S = 32, 10.0
_OFFSET, _SCALE = 0.2, 0.1
"""Prior sigma of offsets [fields] and scales: without it a window in few attitudes tells nothing of the others."""


@value_class
class FieldWindows:
    """Windows of time.

    Attributes
    ----------
    t_s : (w,) their middles [s]
    degc : (w, k) means of what was given of each pose
    offset, scale : (w, 3) by which they differ [unit], relative, in sensor axes
    offset_variance, scale_variance : (w, 3)
    """

    t_s: Floats
    degc: Floats
    offset: Floats
    offset_variance: Floats
    scale: Floats
    scale_variance: Floats


def drift_rows(poses: FieldPoses, fit: MagnetometerFit) -> Floats:
    """Return the derivatives (n, 6) of the errors by an offset and by relative changes of the scales, in sigmas.

    A measurement m = (1 + D) S x + b of a field x, D diagonal, has the length |x| = |S^-1 ((1 + D)^-1 (m - b))|, whose
    derivatives by b_k and D_k are -p_k and -p_k (m - b)_k with p = S^-T x / |x|.
    """
    pull = fit.direction @ np.linalg.inv(fit.iron.sensitivity)
    weight = fit.used / fit.sigma
    return -np.column_stack([pull, pull * (poses.measured - fit.iron.bias)]) * weight[:, None]


def drift_over(poses: FieldPoses, fit: MagnetometerFit, functions: Floats) -> Floats:
    """Return what offsets and scales do with functions (n, k) of the pose, (k, 6), by least squares beside the fit."""
    rows, error = drift_rows(poses, fit), fit.error * fit.used / fit.sigma
    design = np.hstack([fit.stage.jacobian, *(rows * one[:, None] for one in functions.T)])
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    found = -np.linalg.lstsq(design / size, error, rcond=1e-9)[0] / size
    return found[fit.stage.jacobian.shape[1] :].reshape(-1, 6)


def field_windows(poses: FieldPoses, fit: MagnetometerFit, degc: Floats) -> FieldWindows | None:
    """Return what offsets and scales are in windows of time, each for itself, linearised at the fit of all.

    Their covariance is that of errors as large, and as much alike in time, as those left in the windows.

    Parameters
    ----------
    degc : (n, k) functions of the temperature at each pose
    """
    rows, error = drift_rows(poses, fit), fit.error * fit.used / fit.sigma
    span = float(np.ptp(poses.t_s)) * (1 + 1e-9)
    count = int(min(_MOST, span // _SHORTEST_S))
    if not count:
        return None
    number = np.floor((poses.t_s - poses.t_s[0]) / span * count).astype(np.int64)
    windows = [own for k in range(count) if len(own := np.flatnonzero(fit.used & (number == k)))]
    size = float(np.mean(np.linalg.norm(fit.iron.sensitivity, axis=1))) * fit.field
    known = np.diag(np.repeat([1 / (_OFFSET * size) ** 2, 1 / _SCALE**2], 3))

    def covariance(own: Floats, factor: float) -> Floats:
        return np.asarray(np.linalg.inv(own.T @ own / factor + known), dtype=np.float64)

    left = error.copy()
    for own in windows:
        left[own] -= rows[own] @ (covariance(rows[own], 1.0) @ (rows[own].T @ error[own]))
    t_s, left = poses.t_s[fit.used], left[fit.used]
    together = np.bincount(TimeBlocks.of(t_s, memory_s(t_s, left)).block, left)
    factor = max(float(left @ left), float(together @ together)) / len(left)
    each = [covariance(rows[own], factor) for own in windows]
    moved = np.array([-one @ (rows[own].T @ error[own]) / factor for own, one in zip(windows, each, strict=True)])
    variance = np.array([np.diag(one) for one in each])
    return FieldWindows(
        t_s=np.array([poses.t_s[own].mean() for own in windows]),
        degc=np.array([degc[own].mean(axis=0) for own in windows]),
        offset=moved[:, :3],
        offset_variance=variance[:, :3],
        scale=moved[:, 3:],
        scale_variance=variance[:, 3:],
    )
