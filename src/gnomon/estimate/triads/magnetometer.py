"""Hard and soft iron of a magnetometer from the constant strength of the field, robustly, with honest sigmas.

A triad like any other (triad.py), but for three things: it has thousands of samples, turned by hand (field_poses.py);
iron nearby disturbs some of them; and what remains is correlated in time (blocks.py).
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix
from ...recording import Floats, Integers
from ...results.result import Booleans
from .blocks import Stage, TimeBlocks, block_covariance, by_direction, leave_blocks_out, memory_s
from .field_poses import FieldPoses
from .triad import fit_triad
from .triad_poses import TriadPoses, TriadPrior
from .triad_start import Ellipsoid

MagnetometerModel = Literal["hard-iron", "full"]

_FAR = 6.0  # sigmas from the ellipsoid
_STEPS = 50
_MOST_WEIGHT = 8.0  # of a pose with many samples, in units of the usual one
_MAD = 1.4826


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
) -> MagnetometerFit:
    """Fit hard and soft iron.

    Parameters
    ----------
    poses : in the order of time
    shape, usual : rough ellipsoid of radius 1 and usual distance from it; poses far away from it are not used
    field : strength of the field [uT, or 1]
    model : offset and one scale, or every entry of the sensitivity
    prior : what is known of the magnetometer from elsewhere; of the full model

    Raises
    ------
    InitialisationError
        If the poses do not surround an ellipsoid.
    """
    near = np.abs(np.linalg.norm((poses.measured - shape.bias) @ shape.correction.T, axis=1) - 1)
    used = near <= _FAR * max(usual, 1e-6)
    iron = _ellipsoid(poses, used, field, prior) if model == "full" else _sphere(poses, used, field, shape)
    return _with_blocks(poses, iron, field, model)


def _ellipsoid(poses: FieldPoses, used: Booleans, field: float, prior: TriadPrior | None) -> HardSoftIron:
    data = TriadPoses.of(poses.measured[used], field * poses.length[used], variance=poses.variance[used])
    triad = fit_triad(data, prior=prior)
    typical = triad.extra_sigma
    extra = typical * _longer_stay(poses.samples)
    if typical > 0:
        triad = fit_triad(replace(data, magnitude_sigma=extra[used]), prior=prior)
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
