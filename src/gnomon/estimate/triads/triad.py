"""One triad from the magnitudes of what it measured: accelerometer, gyroscope on a turntable, magnetometer.

Angrisano, Eqs. (1)-(11), Tedaldi, section 3.2, as one maximum likelihood problem with covariance. The sensor
measures m_k = S (w_k u_k) + b + G f_k in pose k, with known magnitude w_k and an unknown unit vector u_k, which is
eliminated (triad_problem.py). Poses whose direction is known give three equations instead of one, Eqs. (4)-(7).

An accelerometer whose bias drifts while poses are recorded, as of a sensor that warms up.

A straight line in time with a mean of zero over the poses is estimated jointly: measured = S g u + b + d tau. Where the
order of the attitudes resembles time, gravity's magnitude hardly tells it from scales and angles; there it is held to
what such sensors do, and counts in the sigmas of all other parameters. A bias that drifted need not have done so
evenly: beside the line it is taken to have walked at random, about as far (a Brownian bridge), and sigmas count that.

A step of an accelerometer's bias between two poses, as a rival of the poses that were left out.

A sensor that was switched off and on, knocked or exchanged reads differently from then on. Of few poses the robust fit
then finds some that do not fit, leaves them out, and the others agree: a wrong answer that looks right. So where poses
were left out, or scatter beyond their noise, a step is tried between all poses. What explains every pose is as likely
as what was found, and the distance between both is counted in the sigmas: the between-model part of the variance of
Bayesian model averaging (Hoeting et al. 1999, Eq. 3).
"""

from dataclasses import replace

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats, Integers
from ...results.result import Booleans
from .triad_problem import B_, G_, PARAMETERS, S_, TriadPoses, TriadPrior, TriadProblem, known_magnitudes, true_vectors
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

SIGNIFICANT = 4.0  # sigmas, for a drift to count as one
_USUAL_M_S2 = 0.015  # 1.5 mg from the first pose to the last: some kelvin of a consumer's sensor
_LARGE, _WIDER, _ROUNDS = 2.0, 2.0, 3  # usual drifts; what is found, that the next round allows
_BY_TIME = np.arange(PARAMETERS)[G_][::3]  # the first column of the g-sensitivity, whose force is time here

_LARGEST_M_S2 = 0.3  # 30 mg: more than the turn-on bias and a knock do
_FEWEST = 2  # poses on each side: a step beside a single pose is that this pose is off
_MOST_TRIED = 48
_WORSE = 1.2  # times the scatter of the fit, that a step may leave where poses were left out
_FEWEST_REDUNDANT = 2.0
_SAID = slice(S_.start, B_.stop)


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


@value_class
class PoseDrift:
    """How far the bias moved from the first pose to the last.

    Attributes
    ----------
    change, sigma : (3,) with what is usual taken into account [m/s^2]
    open : (3,) how much of what is usual the poses leave open, 0 to 1
    """

    change: Floats
    sigma: Floats
    open: Floats


def fit_with_drift(
    poses: TriadPoses, t_s: Floats | None, prior: TriadPrior | None
) -> tuple[TriadFit, PoseDrift | None]:
    """Fit a triad whose bias moves steadily; bias and covariance are of the mean of the poses.

    Parameters
    ----------
    poses : in the order in which they were recorded
    t_s : (n,) when [s]; None where only the order is known
    prior : what is known of the triad from elsewhere

    Raises
    ------
    InitialisationError
        If the poses determine no triad.
    """
    still = fit_triad(poses, prior=prior)
    time = np.arange(len(poses), dtype=np.float64) if t_s is None else t_s
    span = float(np.ptp(time))
    if not span > 0:
        return still, None
    tau = (time - time.mean()) / span
    timed = replace(poses, force=np.column_stack([tau, np.zeros((len(tau), 2))]))
    scale = np.linalg.norm(still.sensitivity, axis=1)
    usual = np.full(3, _USUAL_M_S2)
    fit, change = still, np.zeros(3)
    for _ in range(_ROUNDS):
        fit = fit_triad(timed, g_sensitivity=True, prior=prior_along_time(prior, scale * usual))
        change = fit.g_sensitivity[:, 0] / scale
        if not (np.abs(change) > _LARGE * usual).any():
            break
        usual = np.maximum(usual, _WIDER * float(np.abs(change).max()))
    sigma = fit.sigma[_BY_TIME] / scale
    if (np.abs(change) > SIGNIFICANT * sigma).any():
        fit = _with_wander(fit, tau, scale * float(np.sqrt(np.mean(change**2))))
    return fit, PoseDrift(change=change, sigma=sigma, open=sigma / usual)


def prior_along_time(prior: TriadPrior | None, sigma: Floats) -> TriadPrior:
    """Return the prior with changes of zero, give or take (3,) [unit], in place of the g-sensitivity."""
    mean = np.zeros(PARAMETERS) if prior is None else prior.mean.copy()
    precision = np.zeros((PARAMETERS, PARAMETERS)) if prior is None else prior.precision.copy()
    fixed = np.zeros(PARAMETERS, dtype=bool) if prior is None else prior.fixed.copy()
    mean[G_], precision[G_], fixed[G_] = 0.0, 0.0, True
    precision[:, G_] = 0.0
    fixed[_BY_TIME] = False
    precision[_BY_TIME, _BY_TIME] = 1 / sigma**2
    return TriadPrior(mean=mean, precision=precision, fixed=fixed)


def _with_wander(fit: TriadFit, tau: Floats, size: Floats) -> TriadFit:
    """Return the fit with sigmas that count a wander beside the line, of a line's size (3,) [unit]."""
    lines, n = fit.lines, len(tau)
    since, until = tau - tau.min(), tau.max() - tau
    about_mean = np.eye(n) - 1 / n
    bridge = about_mean @ np.where(since[:, None] <= since, since[:, None] * until, since * until[:, None]) @ about_mean
    column = [int(np.flatnonzero(lines.unscaled[row])[0]) for row in range(B_.start, B_.stop)]
    by_bias = lines.jacobian[:, column] * size / np.diag(lines.unscaled[B_][:, column])
    pull = np.zeros((n, lines.jacobian.shape[1], 3))
    np.add.at(pull, lines.pose, lines.jacobian[:, :, None] * by_bias[:, None, :])
    normal = lines.jacobian.T @ lines.jacobian + lines.prior_information
    moves = lines.unscaled @ np.linalg.solve(normal, pull)  # (n, 21, 3)
    return replace(fit, covariance=fit.covariance + np.einsum("kl,kpi,lqi->pq", bridge, moves, moves, optimize=True))


@value_class
class PoseStep:
    """The likeliest step of those that explain all poses.

    Attributes
    ----------
    after : number of the last pose before it
    shorter : poses on the side that has fewer
    change : (3,) [m/s^2]
    """

    after: int
    shorter: int
    change: Floats


def count_rival_step(poses: TriadPoses, fit: TriadFit, prior: TriadPrior | None) -> tuple[TriadFit, PoseStep | None]:
    """Return the fit with sigmas that count a step which explains all poses, and that step; None where there is none.

    Parameters
    ----------
    poses : in the order in which they were recorded
    fit : of the same poses; its bias, and that of the rivals, is of the mean of the poses
    prior : what is known of the triad from elsewhere
    """
    if fit.used.all() and fit.extra_sigma == 0:
        return fit, None
    scale = np.linalg.norm(fit.sensitivity, axis=1)
    order, rivals = np.arange(len(poses)), list[tuple[int, TriadFit]]()
    splits = order[_FEWEST : len(order) - _FEWEST + 1]
    for first in splits[:: len(splits) // _MOST_TRIED + 1]:
        after = (order >= first).astype(np.float64)
        stepped = replace(poses, force=np.column_stack([after - after.mean(), np.zeros((len(order), 2))]))
        rival = fit_triad(
            stepped, g_sensitivity=True, prior=prior_along_time(prior, scale * _LARGEST_M_S2), robust=False
        )
        if _explains(rival, fit):
            rivals.append((int(first), rival))
    if not rivals:
        return fit, None
    cost = np.array([rival.cost for _, rival in rivals])
    weight = np.exp(cost.min() - cost)
    covariance = fit.covariance.copy()
    for share, (_, rival) in zip(weight / weight.sum(), rivals, strict=True):
        apart = np.concatenate([(rival.sensitivity - fit.sensitivity).ravel(), rival.bias - fit.bias])
        covariance[_SAID, _SAID] += share * np.outer(apart, apart)
    first, best = rivals[int(np.argmin(cost))]
    step = PoseStep(after=first - 1, shorter=min(first, len(order) - first), change=best.g_sensitivity[:, 0] / scale)
    return replace(fit, covariance=covariance), step


def _explains(rival: TriadFit, fit: TriadFit) -> bool:
    """Tell whether a step leaves all poses within their noise, or as well explained as those that were not left out."""
    if rival.degrees_of_freedom < _FEWEST_REDUNDANT:
        return False
    left, found = (float(np.median(one.magnitude_sigma[fit.used])) for one in (rival, fit))
    return rival.extra_sigma == 0 or (not fit.used.all() and left < _WORSE * found)
