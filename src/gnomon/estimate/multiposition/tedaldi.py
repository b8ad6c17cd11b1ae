"""The two least-squares problems of Tedaldi as their authors solve them: first accelerometer, then gyroscope.

Three published forms differ in details that matter (see docs/theory): the thesis as printed (Algorithm 1), the authors'
MATLAB script behind Table 4.8, and the C++ program imu_tk.
"""

from typing import Literal

import numpy as np

from ...errors import SolveError
from ...frozen import value_class
from ...geometry.rotations import skew
from ...recording import Floats
from ...results.result import StaticIntervals, interval_means
from ...solve.least_squares import levenberg_marquardt
from .measurements import (
    MagnitudeFit,
    MotionSegments,
    fit_magnitude,
    integrate_rates,
    linear_start,
    propagate_directions,
)

SAMPLES_PER_INTERVAL = 100


@value_class(eq=True)
class TedaldiRules:
    """What distinguishes the published forms of the method.

    Attributes
    ----------
    gravity : magnitude of gravity [m/s^2], and where it comes from
    t_init_s : length of the initial static part [s]
    multipliers : thresholds that are tried
    statistic : compare the variance magnitude or its square
    samples : which samples of a static interval enter the accelerometer's cost: "strided" (99 evenly spaced ones and
        the last), "first" (the first hundred), "mean" (the mean of the middle second)
    residual : g^2 - |f|^2, Eq. (3.4), or g - |f|
    gyroscope_bias : mean over T_init, or over the first static interval
    uniform_dt : integrate with the nominal period instead of the timestamps
    normalise_by_second : divide both directions of a rotation by the norm of the second
    leading_sample_static : the script leaves the statistic before the first full window at zero
    stop_early : the program stops one sample before the next static interval
    t_init_extra : samples beyond T_init that the program takes in
    fewest_intervals : a threshold with fewer static intervals is skipped
    """

    gravity: float
    gravity_source: str
    t_init_s: float
    multipliers: tuple[int, ...]
    statistic: Literal["magnitude", "square"]
    samples: Literal["strided", "first", "mean"]
    residual: Literal["magnitude", "square"]
    gyroscope_bias: Literal["t_init", "first interval"]
    uniform_dt: bool = False
    normalise_by_second: bool = False
    leading_sample_static: bool = False
    stop_early: bool = False
    t_init_extra: int = 0
    fewest_intervals: int = 9


RULES = {
    "tedaldi2014": TedaldiRules(
        gravity=9.81744,
        gravity_source="the authors' script",
        t_init_s=30.0,
        multipliers=tuple(range(1, 11)),
        statistic="square",
        samples="strided",
        residual="square",
        gyroscope_bias="first interval",
        uniform_dt=True,
        normalise_by_second=True,
        leading_sample_static=True,
    ),
    "tedaldi2014-text": TedaldiRules(
        gravity=9.8066,
        gravity_source="normal gravity at Padova",
        t_init_s=50.0,
        multipliers=tuple(range(1, 11)),
        statistic="square",
        samples="mean",
        residual="square",
        gyroscope_bias="t_init",
    ),
    "imu_tk": TedaldiRules(
        gravity=9.81744,
        gravity_source="the program's demonstration",
        t_init_s=50.0,
        multipliers=tuple(range(2, 11)),
        statistic="magnitude",
        samples="first",
        residual="magnitude",
        gyroscope_bias="t_init",
        stop_early=True,
        t_init_extra=1,
        fewest_intervals=12,
    ),
}
"""The published forms; each sets its own gravity and T_init."""


def select_samples(values: Floats, intervals: StaticIntervals, rules: TedaldiRules, rate_hz: float) -> Floats:
    """Return the samples of all static intervals that enter the accelerometer's cost, (k, 3), k equal per interval."""
    chosen: list[Floats] = []
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        if rules.samples == "first":
            chosen.append(values[start : start + SAMPLES_PER_INTERVAL])
        elif rules.samples == "strided":
            stride = (stop - start) // SAMPLES_PER_INTERVAL
            chosen.append(values[start + stride * np.arange(SAMPLES_PER_INTERVAL - 1)])
            chosen.append(values[stop - 1 : stop])
        else:
            middle, half = (start + stop) // 2, max(1, round(0.5 * rate_hz))
            window = values[max(start, middle - half) : min(stop, middle + half + 1)]
            chosen.append(window.mean(axis=0, keepdims=True))
    return np.concatenate(chosen) if chosen else np.empty((0, 3))


def fit_published_accelerometer(samples: Floats, rules: TedaldiRules, gravity: float) -> MagnitudeFit:
    """Minimise Eq. (3.4), or the program's form of it.

    Raises
    ------
    InitialisationError
        If the attitudes determine no start.
    """
    return fit_magnitude(samples, gravity, residual=rules.residual)


@value_class
class GyroscopeFit:
    """The minimum of Eq. (3.8).

    Attributes
    ----------
    correction : (3, 3), omega = correction @ (y - bias) [rad/s per unit] in the accelerometer's frame accel-z
    residual : (m, 3) u_a - u_g
    propagated : (m, 3) u_g
    jacobian : (m, 3, 9) derivative of the residual by the correction's entries in row order
    covariance : (9, 9) for residuals of unit variance
    converged : whether the minimum was reached
    """

    correction: Floats
    residual: Floats
    propagated: Floats
    jacobian: Floats
    covariance: Floats
    converged: bool


def fit_gyroscope(segments: MotionSegments, forces: Floats, u_start: Floats, u_end: Floats) -> GyroscopeFit:
    """Minimise Eq. (3.8) over all nine entries of T_g K_g.

    Parameters
    ----------
    segments : rotations, their gyroscope values with the bias removed [unit]
    forces : (n, 3) calibrated specific force at the samples of the segments, for the linear start
    u_start, u_end : (m, 3) direction of gravity before and after each rotation

    Raises
    ------
    SolveError
        If the rotations determine no gyroscope calibration.
    """
    norm = np.linalg.norm(forces, axis=1, keepdims=True)
    start, singular = linear_start(segments, forces / np.where(norm > 0, norm, 1.0))
    if singular[-1] < 1e-6 * singular[0]:
        raise SolveError(
            f"the {len(u_start)} rotations do not determine the nine parameters of the gyroscope. "
            "Turn the sensor about all three of its axes between the static intervals."
        )
    size = float(np.sqrt(np.mean(start**2)))
    regressors = np.zeros((len(segments.gyroscope), 7))
    regressors[:, :3] = size * segments.gyroscope

    def problem(x: Floats) -> tuple[Floats, Floats]:
        turns = integrate_rates(segments, regressors[:, :3] @ x.reshape(3, 3).T, regressors)
        by_turn = np.swapaxes(turns.rotation, 1, 2) @ skew(u_start)
        jacobian = -np.einsum("kil,klac->kiac", by_turn, turns.sensitivity[..., :3])
        return (u_end - propagate_directions(turns.rotation, u_start)).ravel(), jacobian.reshape(-1, 9)

    solution = levenberg_marquardt(problem, (start / size).ravel(), tolerance=1e-10)
    jacobian = solution.jacobian / size
    residual = solution.residual.reshape(-1, 3)
    return GyroscopeFit(
        correction=size * solution.x.reshape(3, 3),
        residual=residual,
        propagated=u_end - residual,
        jacobian=jacobian.reshape(-1, 3, 9),
        covariance=np.asarray(np.linalg.pinv(jacobian.T @ jacobian), dtype=np.float64),
        converged=solution.converged,
    )


def static_directions(
    values: Floats, intervals: StaticIntervals, fit: MagnitudeFit, rules: TedaldiRules, rate_hz: float
) -> tuple[Floats, Floats]:
    """Return the directions of gravity before and after each rotation, (m, 3) each, from calibrated means."""
    if rules.samples == "mean":
        means = select_samples(values, intervals, rules, rate_hz)
    else:
        means = interval_means(values, intervals)
    u = (means - fit.bias) @ fit.correction.T
    norm = np.linalg.norm(u, axis=1, keepdims=True)
    if rules.normalise_by_second:
        return u[:-1] / norm[1:], u[1:] / norm[1:]
    return u[:-1] / norm[:-1], u[1:] / norm[1:]


def leave_group_out(jacobian: Floats, residual: Floats, covariance: Floats) -> Floats:
    """Return the residuals (m, r) of each group of rows when the group was left out: inv(I - H_kk) r_k.

    Exact for linear problems; one Gauss-Newton step for these.

    Parameters
    ----------
    jacobian : (m, r, p)
    residual : (m, r)
    covariance : (p, p), inverse of the sum of J'J
    """
    hat = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    left_out = np.linalg.solve(np.eye(jacobian.shape[1]) - hat, residual[..., None])[..., 0]
    return np.asarray(left_out, dtype=np.float64)
