"""Hard and soft iron of a magnetometer from the constant strength of the field, robustly, with honest sigmas.

A triad like any other (triad.py), but for three things: it has thousands of samples, turned by hand (field_poses.py);
iron nearby disturbs some of them; and what remains is correlated in time (triad_trust.py).
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.sensors import element_names
from ...results.trust import Clusters, SigmaRatio, Trust
from ..trust.changes import parameter_changes
from ..trust.clusters import ClusterSums, Robust
from ..trust.parts import PartComparison, RobustCovariance
from .field_poses import FieldPoses
from .triad import fit_triad
from .triad_problem import TriadPoses, TriadPrior
from .triad_start import Ellipsoid
from .triad_trust import Stage, TimeBlocks, block_covariance, by_direction, leave_blocks_out, memory_s

MagnetometerModel = Literal["hard-iron", "full"]

_FAR = 6.0  # sigmas from the ellipsoid
_STEPS = 50
_MOST_WEIGHT = 8.0  # of a pose with many samples, in units of the usual one
_MAD = 1.4826
_MOST, _SHORTEST_S = 32, 10.0
_OFFSET, _SCALE = 0.2, 0.1
"""Prior sigma of offsets [fields] and scales: without it a window in few attitudes tells nothing of the others."""

_PATHS = ("imu0.magnetometer.sensitivity", "imu0.magnetometer.bias")
_NAMES = (*element_names(_PATHS[0], (3, 3)), *element_names(_PATHS[1], (3,)))
_OPEN = 1e-9  # of the information: what a part leaves open stays finite


@value_class
class HardSoftIron:
    """A magnetometer's parameters as their estimator leaves them; of p free numbers theta the twelve are basis @ theta.

    Attributes
    ----------
    sensitivity : (3, 3) [unit/field], lower triangular unless a prior says otherwise
    bias : (3,) [unit]
    basis : (12, p) of sensitivity (row order) and bias by what is free
    covariance : (p, p) for independent errors
    precision : (p, p) of what was known beforehand, or None
    extra_sigma : typical sigma beyond the noise [field]
    extra : (n,) the same of each pose: less where the sensor stayed longer
    used : (n,) bool, of all poses
    held_by_prior : (12,) bool, determined by a weak assumption instead of the poses
    in_own_frame : whether the body frame is the magnetometer's own
    converged, iterations : of the solver
    """

    sensitivity: Floats
    bias: Floats
    basis: Floats
    covariance: Floats
    precision: Floats | None
    extra_sigma: float
    extra: Floats
    used: Booleans
    held_by_prior: Booleans
    in_own_frame: bool
    converged: bool
    iterations: int


@value_class
class MagnetometerFit:
    """A magnetometer's parameters, their covariance, and how each pose agrees.

    Attributes
    ----------
    model : "hard-iron" or "full"
    iron : the parameters
    field : strength of the field [uT, or 1]
    error : (n,) |x| - field of every pose [field]
    sigma : (n,) predicted sigma of it [field]
    error_holdout : (n,) the same when the block of time around it was left out
    stage : linearised, rows for all poses
    blocks : of time
    covariance : (p, p) of what is free, from the blocks
    direction : (n, 3) unit vectors of the field
    by_parameters : (n, 3, p) their derivatives by what is free
    left_out : (p, k) by how much what is free may err beside that, in the covariance already: what was left out of the
        model, or taken off before it
    sigma_factor : how much larger the sigmas are than for independent errors
    """

    model: MagnetometerModel
    iron: HardSoftIron
    field: float
    error: Floats
    sigma: Floats
    error_holdout: Floats
    stage: Stage
    blocks: TimeBlocks
    covariance: Floats
    direction: Floats
    by_parameters: Floats
    left_out: Floats
    sigma_factor: float

    @property
    def used(self) -> Booleans:
        """(n,) bool, poses that are not left out."""
        return self.iron.used

    @property
    def holdout_rms(self) -> float:
        """Of the poses used, each by the other blocks [field]."""
        return float(np.sqrt(np.mean(self.error_holdout[self.used] ** 2)))

    def with_left_out(self, shifts: Floats) -> "MagnetometerFit":
        """Return the fit with what else (p, k) its parameters may err by."""
        covariance = self.covariance + shifts @ shifts.T
        return replace(self, covariance=covariance, left_out=np.hstack([self.left_out, shifts]))


def fit_magnetometer(
    poses: FieldPoses,
    shape: Ellipsoid,
    usual: float,
    *,
    field: float = 1.0,
    model: MagnetometerModel = "full",
    prior: TriadPrior | None = None,
    near: bool = False,
) -> MagnetometerFit:
    """Fit hard and soft iron.

    Parameters
    ----------
    poses : in the order of time
    shape, usual : rough ellipsoid of radius 1 and usual distance from it; poses far away from it are not used
    field : strength of the field [uT, or 1]
    model : offset and one scale, or every entry of the sensitivity
    prior : what is known of the magnetometer from elsewhere; of the full model
    near : whether iterations start from the rough ellipsoid

    Raises
    ------
    InitialisationError
        If the poses do not surround an ellipsoid.
    """
    distance = np.abs(np.linalg.norm((poses.measured - shape.bias) @ shape.correction.T, axis=1) - 1)
    used = distance <= _FAR * max(usual, 1e-6)
    start = Ellipsoid(correction=field * shape.correction, bias=shape.bias) if near and prior is None else None
    iron = _ellipsoid(poses, used, field, prior, start) if model == "full" else _sphere(poses, used, field, shape)
    return _with_blocks(poses, iron, field, model)


def _ellipsoid(
    poses: FieldPoses, used: Booleans, field: float, prior: TriadPrior | None, start: Ellipsoid | None
) -> HardSoftIron:
    data = TriadPoses.of(poses.measured[used], field * poses.length[used], variance=poses.variance[used])
    triad = fit_triad(data, prior=prior, start=start)
    typical = triad.extra_sigma
    extra = typical * _longer_stay(poses.samples)
    if typical > 0:
        triad = fit_triad(replace(data, magnitude_sigma=extra[used]), prior=prior, start=start)
        extra = np.hypot(extra, triad.extra_sigma)
    used = used.copy()
    used[used] = triad.used
    free = np.flatnonzero(triad.free[:12])
    known = None if prior is None else prior.precision[np.ix_(free, free)]
    return HardSoftIron(
        sensitivity=triad.sensitivity,
        bias=triad.bias,
        basis=np.eye(12)[:, free],
        covariance=triad.covariance[np.ix_(free, free)],
        precision=known,
        extra_sigma=float(np.sqrt(np.mean(extra**2))),
        extra=extra,
        used=used,
        held_by_prior=triad.held_by_prior[:12],
        in_own_frame=triad.in_own_frame,
        converged=triad.converged,
        iterations=triad.iterations,
    )


def _longer_stay(samples: Integers) -> Floats:
    """Return by what the field's error in poses (n,) differs from the usual: it is less where the sensor was longer.

    A sample counts like any other where the sensor moves, a rest like a few poses.
    """
    count = np.minimum(samples, _MOST_WEIGHT * float(np.median(samples)))
    return np.sqrt(count.mean() / count)


def _sphere(poses: FieldPoses, used: Booleans, field: float, shape: Ellipsoid) -> HardSoftIron:
    """Fit the sphere of least squared distances in the sensor's unit.

    Relative to the radius they would be least for a sphere without end, which is why the triad's estimator, made for
    shapes that fit, is of no use to a shape that does not.
    """
    m, length = poses.measured[used], poses.length[used]
    bias, radius = shape.bias, float(np.abs(np.linalg.det(shape.correction))) ** (-1 / 3)
    converged, iterations = False, 0
    weight, jacobian, error = np.ones(len(m)), np.empty((0, 4)), np.zeros(len(m))
    while not converged and iterations < _STEPS:
        iterations += 1
        away = m - bias
        distance = np.linalg.norm(away, axis=1)
        error = distance - radius * length
        spread = _MAD * float(np.median(np.abs(error)))
        weight = (np.abs(error) <= _FAR * spread).astype(np.float64)
        jacobian = np.column_stack([-away / distance[:, None], -length])
        step = np.linalg.lstsq(jacobian * weight[:, None], -error * weight, rcond=None)[0]
        bias, radius = bias + step[:3], radius + float(step[3])
        if not radius > 0:
            raise InitialisationError("what the magnetometer measured surrounds no sphere. Take --model full.")
        converged = float(np.abs(step).max()) < 1e-9 * radius
    kept = used.copy()
    kept[used] = weight > 0
    basis = np.zeros((12, 4))
    basis[[0, 4, 8], 0] = 1 / field
    basis[9:, 1:] = np.eye(3)
    rows = jacobian[weight > 0][:, [3, 0, 1, 2]]
    variance = float(np.mean(error[weight > 0] ** 2))
    noise = float(np.mean(poses.variance[kept]))
    extra = float(np.sqrt(max(variance - noise, 0.0))) / radius * field
    return HardSoftIron(
        sensitivity=radius / field * np.eye(3),
        bias=bias,
        basis=basis,
        covariance=variance * np.asarray(np.linalg.pinv(rows.T @ rows, hermitian=True), dtype=np.float64),
        precision=None,
        extra_sigma=extra,
        extra=np.full(len(used), extra),
        used=kept,
        held_by_prior=np.zeros(12, dtype=bool),
        in_own_frame=True,
        converged=converged,
        iterations=iterations,
    )


def _with_blocks(poses: FieldPoses, iron: HardSoftIron, field: float, model: MagnetometerModel) -> MagnetometerFit:
    correction = invert_matrix(iron.sensitivity)
    x = (poses.measured - iron.bias) @ correction.T
    length = np.linalg.norm(x, axis=1)
    pull = (x / length[:, None]) @ correction
    extra = iron.extra**2
    along = np.sum(pull**2 * poses.variance, axis=1)
    across = poses.variance @ np.sum(correction**2, axis=0) - along
    if model == "hard-iron":  # what remains is the shape, not noise that would lengthen a vector
        across = np.zeros(len(x))
    sigma = np.sqrt(along + extra)
    error = length - field * poses.length - across / (2 * field)
    jacobian = -np.concatenate([(pull[:, :, None] * x[:, None, :]).reshape(-1, 9), pull], axis=1) @ iron.basis
    weight = iron.used / sigma
    stage = Stage(
        residual=error * weight,
        jacobian=jacobian * weight[:, None],
        covariance=iron.covariance,
        precision=iron.precision,
    )
    used = iron.used
    blocks = TimeBlocks.of(poses.t_s, memory_s(poses.t_s[used], (error / sigma)[used]))
    moves = leave_blocks_out([stage], blocks.block)
    covariance = block_covariance([stage], blocks, moves)
    return MagnetometerFit(
        model=model,
        iron=iron,
        field=field,
        error=error,
        sigma=sigma,
        error_holdout=error + np.einsum("np,np->n", jacobian, moves[blocks.block]),
        stage=stage,
        blocks=blocks,
        covariance=covariance,
        direction=x / length[:, None],
        by_parameters=by_direction(x, correction) @ iron.basis,
        left_out=np.zeros((iron.basis.shape[1], 0)),
        sigma_factor=float(np.sqrt(np.mean(np.diag(covariance) / np.maximum(np.diag(iron.covariance), 1e-300)))),
    )


def with_soft_iron_unknown(sphere: MagnetometerFit, full: MagnetometerFit) -> MagnetometerFit:
    """Return a hard-iron fit whose sigmas count the soft iron that it leaves out.

    What the sphere sets to zero errs by what the full model finds there and by how well that is known: the covariance
    is that of the full model with the square of the difference.
    """
    basis = full.iron.basis
    left_out = basis.T @ np.concatenate([
        (sphere.iron.sensitivity - full.iron.sensitivity).ravel(), sphere.iron.bias - full.iron.bias
    ])  # fmt: skip
    square = np.outer(left_out, left_out)
    correction = invert_matrix(sphere.iron.sensitivity)
    x = sphere.direction * (sphere.field + sphere.error)[:, None]
    unknown = replace(
        sphere,
        iron=replace(
            sphere.iron,
            basis=basis,
            covariance=full.iron.covariance + square,
            held_by_prior=full.iron.held_by_prior,
        ),
        stage=full.stage,
        blocks=full.blocks,
        covariance=full.covariance,
        by_parameters=by_direction(x, correction) @ basis,
        left_out=full.left_out,
        sigma_factor=full.sigma_factor,
    )
    return unknown.with_left_out(left_out[:, None])


def stray_samples(values: Floats, noise: Floats, fit: MagnetometerFit) -> Booleans:
    """Return which single samples (n,) lie far off the ellipsoid of the fit, by more than noise explains."""
    correction = invert_matrix(fit.iron.sensitivity)
    x = (values - fit.iron.bias) @ correction.T
    length = np.linalg.norm(x, axis=1)
    pull = (x / length[:, None]) @ correction
    sigma = np.sqrt(pull**2 @ noise**2 + fit.iron.extra_sigma**2)
    return np.abs(length - fit.field) > _FAR * sigma


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


def field_trust(fit: MagnetometerFit, t_s: Floats) -> RobustCovariance:
    """Return what blocks of time say of a magnetometer, in its own frame.

    Parameters
    ----------
    t_s : (n,) when each pose was measured [s]
    """
    basis, stage = fit.iron.basis, fit.stage
    known = np.zeros_like(stage.covariance) if stage.precision is None else stage.precision
    by_prior = basis @ stage.covariance @ known @ stage.covariance @ basis.T
    ordinary, covariance = basis @ stage.covariance @ basis.T, basis @ fit.covariance @ basis.T
    from_errors = ordinary - by_prior
    own = np.diag(from_errors)
    factor = np.where(own > 0, (np.diag(covariance) - np.diag(by_prior)) / np.where(own > 0, own, 1.0), 1.0)
    sums = _sums(fit, t_s, known)
    found = Robust(
        factor=np.maximum(factor, 1.0),
        from_errors=from_errors,
        from_prior=by_prior,
        correlation=np.eye(len(own)),
        clusters=len(sums),
    )
    paths = np.array([name.split("[")[0] for name in _NAMES], dtype=object)
    estimated = np.diag(ordinary) > 0
    comparison = PartComparison(sums=sums, jacobian=basis, found=found, names=_NAMES, paths=paths)
    return RobustCovariance(
        covariance=covariance,
        trust=Trust(
            clusters=Clusters(count=len(sums), length_s=fit.blocks.length_s, memory_s=fit.blocks.memory_s),
            names=tuple(np.array(_NAMES, dtype=object)[estimated]),
            ordinary_sigma=np.sqrt(np.diag(ordinary)[estimated]),
            sigma=np.sqrt(np.diag(covariance)[estimated]),
            ratios=tuple(
                SigmaRatio(block=path, ratio=float(np.sqrt(np.mean(found.factor[(paths == path) & estimated]))))
                for path in dict.fromkeys(paths[estimated])
            ),
            splits=comparison.splits(estimated, paths == _PATHS[1], 1),
            changes=parameter_changes(sums, basis, _NAMES, judged=estimated),
        ),
        instabilities=(comparison.instability(_PATHS[1], estimated),),
    )


def _sums(fit: MagnetometerFit, t_s: Floats, known: Floats) -> ClusterSums:
    block = np.unique(fit.blocks.block, return_inverse=True)[1]
    _, first = np.unique(block, return_index=True)
    jacobian, residual = fit.stage.jacobian, fit.stage.residual
    pull = -np.add.reduceat(jacobian * residual[:, None], first)
    information = np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first)
    return ClusterSums(
        t_s=np.bincount(block, t_s) / np.bincount(block),
        pull=pull,
        information=information,
        prior_pull=-pull.sum(axis=0) if known.any() else np.zeros(len(known)),
        prior_information=known + _OPEN * np.diag(np.diag(information.sum(axis=0))),
    )
