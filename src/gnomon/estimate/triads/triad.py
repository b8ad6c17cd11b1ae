"""One triad from the magnitudes of what it measured: accelerometer, gyroscope on a turntable, magnetometer.

Angrisano, Eqs. (1)-(11), Tedaldi, section 3.2, as one maximum likelihood problem with covariance. The sensor
measures m_k = S (w_k u_k) + b + G f_k in pose k, with known magnitude w_k and an unknown unit vector u_k, which is
eliminated (triad_rows.py). Poses whose direction is known give three equations instead of one, Eqs. (4)-(7).
"""

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix
from ...recording import Floats, Integers
from ...results.result import Booleans
from .triad_poses import B_, G_, PARAMETERS, S_, TriadPoses, TriadPrior
from .triad_rows import TriadProblem, known_magnitudes, true_vectors
from .triad_solve import (
    Linear,
    Minimum,
    TriadScaling,
    covariance_at,
    equation_counts,
    extra_variance,
    fit_extra_variance,
    gate_outliers,
    irls,
    scaled_problem,
    weak_sigma,
    with_weak_prior,
)
from .triad_start import ENOUGH, START_VARIANCE, Ellipsoid, check_determined, first_fit, start_at

_GATINGS = 5
_HELD = 0.3  # posterior sigma over that of the weak prior beyond which a parameter is the prior's

__all__ = ["TriadFit", "TriadPoses", "TriadPrior", "fit_triad"]


@value_class
class TriadLines:
    """Residuals and derivatives at a solution, by the f free parameters in scaled units.

    Attributes
    ----------
    pose : (r,) pose of each residual
    residual, jacobian : (r,), (r, f) in units of the residuals' sigma; zero where a pose was not used
    prior_pull, prior_information : (f,), (f, f) of what was known beforehand
    unscaled : (21, f) derivatives of the parameters by the free scaled ones
    """

    pose: Integers
    residual: Floats
    jacobian: Floats
    prior_pull: Floats
    prior_information: Floats
    unscaled: Floats


@value_class
class TriadFit:
    """A triad's parameters in the unit of the sensor, their covariance, and how well each pose agrees.

    Attributes
    ----------
    sensitivity : (3, 3) [unit/SI]; lower triangular (frame of the triad's own x axis) where only magnitudes are known
    bias : (3,) [unit]
    g_sensitivity : (3, 3) [unit per m/s^2]; zero where it was not estimated
    covariance : (21, 21) of sensitivity (row order), bias, g-sensitivity (row order), with the errors of the
        magnitudes; zero where a parameter was held fixed
    direction : (n, 3) estimated unit vectors along what was measured; nan where the magnitude is zero
    group_factor : (g,) estimated factor of each group's magnitudes, near 1
    group_sigma : (g,) its sigma after the fit
    scale_known : whether the magnitudes fix the common scale; False with unknown_scale, when the sensitivity is known
        up to one factor
    in_own_frame : whether the body frame is the triad's own, which says nothing of the directions of its axes to others
    residual : (n, 3) residuals in units of their sigma: the first alone for a pose of which only the magnitude is known
    equations : (n,) how many residuals a pose has, 1 or 3
    magnitude_error : (n,) |x| - magnitude [SI]
    magnitude_holdout : (n,) |x| - magnitude as the other poses predict it [SI]
    magnitude_sigma : (n,) predicted sigma of magnitude_error: noise, extra variance, the magnitude's own error [SI]
    leverage : (n,) share of its own residuals that each pose determines itself, 0 to 1; 0 where it was not used
    extra_sigma : sigma of a component beyond the noise at rest, found from the residuals [SI]; 0 where noise suffices
    used : (n,) bool, not left out as an outlier
    free : (21,) bool, estimated
    held_by_prior : (21,) bool, free, but determined by a weak assumption instead of the poses
    degrees_of_freedom : residuals less parameters
    cost : half the sum of squared residuals in units of their sigma
    converged : whether the last step was negligible
    iterations : steps of all stages
    lines : the fit linearised where it stands, for covariances by clusters
    """

    sensitivity: Floats
    bias: Floats
    g_sensitivity: Floats
    covariance: Floats
    direction: Floats
    group_factor: Floats
    group_sigma: Floats
    scale_known: bool
    in_own_frame: bool
    residual: Floats
    equations: Integers
    magnitude_error: Floats
    magnitude_holdout: Floats
    magnitude_sigma: Floats
    leverage: Floats
    extra_sigma: float
    used: Booleans
    free: Booleans
    held_by_prior: Booleans
    degrees_of_freedom: float
    cost: float
    converged: bool
    iterations: int
    lines: TriadLines

    @property
    def sigma(self) -> Floats:
        """(21,) sigma of each parameter."""
        return np.sqrt(np.diag(self.covariance))

    def physical(self, measured: Floats, force: Floats | None = None) -> Floats:
        """Return the measured vectors (n, 3) [SI] of measurements (n, 3) [unit], with the specific force for G."""
        unbiased = measured - self.bias
        if force is not None:
            unbiased = unbiased - force @ self.g_sensitivity.T
        return unbiased @ invert_matrix(self.sensitivity).T


def fit_triad(
    poses: TriadPoses,
    *,
    g_sensitivity: bool = False,
    unknown_scale: bool = False,
    prior: TriadPrior | None = None,
    robust: bool = True,
    start: Floats | Ellipsoid | None = None,
) -> TriadFit:
    """Fit one triad to the magnitudes, and the directions where they are known, of what it measured.

    Parameters
    ----------
    poses : means and magnitudes
    g_sensitivity : whether the bias may depend on the specific force; needs `poses.force`
    unknown_scale : whether all magnitudes share one unknown factor; the sensitivity is then known up to that factor
    prior : what is known from elsewhere
    robust : leave out poses that lie far outside what the others show
    start : (9,) angles [rad], bias [unit] and scale [SI/unit] of Angrisano, Eq. (3), from which to start instead of
        the closed form (a study of convergence wants it); or an ellipsoid that is certainly near, of the magnitudes

    Raises
    ------
    InitialisationError
        If the poses determine no triad; the message says what is missing.
    OptionError
        If the g-sensitivity is wanted without specific force.
    """
    if g_sensitivity and poses.force is None:
        raise OptionError("a g-sensitivity needs the specific force in every pose: record the accelerometer too.")
    scaling = TriadScaling.of(poses)
    problem = scaled_problem(poses, scaling, prior, g_sensitivity=g_sensitivity, unknown_scale=unknown_scale)
    check_determined(problem, prior)
    near = isinstance(start, Ellipsoid)
    if near:
        around, iterations = start_at(start, scaling, len(problem.free)), 0
    else:
        first = first_fit(problem, scaling, prior, start, robust=robust)
        around, iterations = first.theta, first.iterations
    problem = with_weak_prior(problem, around)
    point, extra, used = _fitted(problem, around, robust=robust, rough=near)
    linear = covariance_at(problem, point.theta, point.noise, used)
    covariance = np.zeros((len(problem.free),) * 2)
    covariance[np.ix_(problem.free, problem.free)] = linear.covariance
    theta, turn = point.theta, scaling.turn
    parameters = turn * theta[:PARAMETERS] + scaling.shift
    by_group = _group_levels(poses, problem)
    free = problem.free[:PARAMETERS]
    error = np.linalg.norm(true_vectors(problem, theta), axis=1) - known_magnitudes(problem, theta)
    shares = np.where(used[linear.rows.pose], linear.leverage, 0.0)
    return TriadFit(
        sensitivity=parameters[S_].reshape(3, 3),
        bias=parameters[B_],
        g_sensitivity=parameters[G_].reshape(3, 3),
        covariance=covariance[:PARAMETERS, :PARAMETERS] * np.outer(turn, turn),
        direction=np.where(poses.magnitude[:, None] > 0, linear.rows.u, np.nan),
        group_factor=1 + by_group @ theta[PARAMETERS:],
        group_sigma=np.sqrt(np.einsum("ij,jk,ik->i", by_group, covariance[PARAMETERS:, PARAMETERS:], by_group)),
        scale_known=not unknown_scale,
        in_own_frame=not free[[1, 2, 5]].any(),
        residual=_by_pose(problem, linear),
        equations=equation_counts(problem),
        magnitude_error=error * scaling.size,
        magnitude_holdout=_held_out(problem, theta, linear, used) * scaling.size,
        magnitude_sigma=_predicted(problem, linear) * scaling.size,
        leverage=np.bincount(linear.rows.pose, shares, minlength=len(poses)) / equation_counts(problem),
        extra_sigma=float(np.sqrt(extra)) * scaling.size,
        used=used,
        free=free,
        held_by_prior=free & (np.sqrt(np.diag(covariance)[:PARAMETERS]) > _HELD * weak_sigma(around)),
        degrees_of_freedom=linear.redundancy,
        cost=point.cost,
        converged=point.converged,
        iterations=iterations + point.iterations,
        lines=_lines(problem, theta, linear, used, turn),
    )


def _lines(problem: TriadProblem, theta: Floats, linear: Linear, used: Booleans, turn: Floats) -> TriadLines:
    counted, root = used[linear.rows.pose], problem.prior_root[:, problem.free]
    unscaled = np.zeros((PARAMETERS, len(problem.free)))
    unscaled[:, :PARAMETERS] = np.diag(turn)
    return TriadLines(
        pose=linear.rows.pose,
        residual=counted * linear.rows.residual,
        jacobian=counted[:, None] * linear.rows.jacobian,
        prior_pull=-root.T @ (problem.prior_root @ theta - problem.prior_target),
        prior_information=root.T @ root,
        unscaled=unscaled[:, problem.free],
    )


def _fitted(problem: TriadProblem, theta: Floats, *, robust: bool, rough: bool) -> tuple[Minimum, float, Booleans]:
    """Return the minimum, the extra variance and the poses used.

    Robust noise levels show outliers; noise levels without them weigh the rest.
    """
    used, extra = np.ones(len(problem.measured), dtype=bool), 0.0
    if robust:
        extra = extra_variance(problem, theta, used, START_VARIANCE, robust=True)
        if len(used) <= ENOUGH and not rough:  # more are not bent by a few, nor is a start that is known from elsewhere
            theta = irls(problem, theta, extra).theta
            extra = extra_variance(problem, theta, used, extra, robust=True)
        used = gate_outliers(problem, theta, used, extra, known=extra == 0)
    point, extra = fit_extra_variance(problem, theta, used, extra, rough=rough)
    for _ in range(_GATINGS if robust else 0):  # what the settled level explains comes back
        again = gate_outliers(problem, point.theta, used, extra, known=extra == 0)
        if np.array_equal(again, used):
            break
        used = again
        point, extra = fit_extra_variance(problem, point.theta, used, extra, rough=rough)
    return point, extra, used


def _group_levels(poses: TriadPoses, problem: TriadProblem) -> Floats:
    """Return by which magnitude errors each group's factor moves, (g, p)."""
    groups = len(poses.group_sigma)
    by_group = np.ones((groups, problem.level.shape[1]))
    by_group[:, :groups] = np.eye(groups)
    return by_group


def _by_pose(problem: TriadProblem, linear: Linear) -> Floats:
    """Return the residuals (n, 3), zero where a pose has but one."""
    lines, three = linear.rows, ~problem.length_only
    residual = np.zeros_like(problem.measured)
    singles = int(problem.length_only.sum())
    residual[~three, 0] = lines.residual[:singles]
    residual[three] = lines.residual[singles:].reshape(-1, 3)
    return residual


def _predicted(problem: TriadProblem, linear: Linear) -> Floats:
    """Return the sigma of |x| - w of each pose, (n,)."""
    lines, three = linear.rows, ~problem.length_only
    singles = int(problem.length_only.sum())
    sigma = np.zeros(len(three))
    sigma[~three] = lines.sigma[:singles]
    sigma[three] = np.linalg.norm(lines.sigma[singles:].reshape(-1, 3), axis=1)
    return sigma


def _held_out(problem: TriadProblem, theta: Floats, linear: Linear, used: Booleans) -> Floats:
    """Return |x| - w (n,) of each pose by the parameters of the others, a step P A' inv(I - H) r away."""
    lines, free, n = linear.rows, problem.free, len(used)
    held = np.repeat(theta[None], n, axis=0)
    singles = int(problem.length_only.sum())
    for three, part in ((False, slice(0, singles)), (True, slice(singles, None))):
        size = 3 if three else 1
        pose = lines.pose[part][::size]
        a = lines.jacobian[part].reshape(-1, size, int(free.sum()))
        gain = linear.covariance @ np.swapaxes(a, 1, 2)
        kept = np.eye(size) * (1 + 1e-9) - a @ gain
        step = gain @ np.linalg.solve(kept, lines.residual[part].reshape(-1, size, 1))
        held[np.ix_(pose, np.flatnonzero(free))] += np.where(used[pose, None], step[..., 0], 0.0)
    s, b, g = held[:, S_].reshape(-1, 3, 3), held[:, B_], held[:, G_].reshape(-1, 3, 3)
    x = invert_matrix(s) @ (problem.measured - b - np.einsum("kij,kj->ki", g, problem.force))[..., None]
    factor = 1 + np.einsum("kp,kp->k", problem.level, held[:, PARAMETERS:])
    return np.linalg.norm(x[..., 0], axis=1) - problem.magnitude * factor
