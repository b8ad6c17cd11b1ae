"""The multi-position problem: derivatives, minimum, covariance, noise levels, outliers, hold-out, and the way back."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import InitialisationError
from gnomon.estimate.multiposition.bias_functions import walk_density, walk_precision, with_drift
from gnomon.estimate.multiposition.evidence import leave_one_out
from gnomon.estimate.multiposition.fit import fit_multiposition, start_state
from gnomon.estimate.multiposition.measurements import integrate_rates, propagate_directions
from gnomon.estimate.multiposition.model import (
    CG_,
    PARAMETERS,
    MultiPositionLinearization,
    MultiPositionState,
    Whitening,
    linearize_model,
    normal_equations,
)
from gnomon.estimate.multiposition.problem import Scaling, to_physical_units
from gnomon.geometry.rotations import frame_rotation, rotation_jacobian, tangent_basis
from gnomon.models.gravity import EARTH_RATE_RAD_S
from gnomon.results.calibration import ImuCalibration, calibration_parameters, rotate_imu
from gnomon.solve.least_squares import solve_arrow

SMALL = {"intervals": 16, "t_init_s": 5.0, "hold_s": (2.5, 3.5)}
QUIET = {"accelerometer_noise_density": 1e-6, "gyroscope_noise_density": 1e-6}
GRAVITY = 9.80665


@pytest.fixture(scope="module")
def noisy(multiposition):
    """A problem in whose noise no wandering of the bias is seen; one in four shows some by chance."""
    problems = (multiposition(k, g_sensitivity=2e-4, intervals=30, t_init_s=20.0)[0] for k in range(1, 20))
    return next(p for p in problems if not fit_multiposition(p.data, g_sensitivity=True).drift.any())


@pytest.fixture(scope="module")
def fitted(noisy):
    return fit_multiposition(noisy.data, g_sensitivity=True)


@pytest.fixture(scope="module")
def wandering(multiposition):
    """A problem whose gyroscope's bias wanders by several times what the means at rest are known to, and its fit."""
    problem, _ = multiposition(4, g_sensitivity=2e-4, intervals=30, t_init_s=20.0, gyroscope_bias_walk=3e-4)
    fit = fit_multiposition(problem.data, g_sensitivity=True)
    assert fit.drift.any()
    return replace(problem, data=with_drift(problem.data)), fit


@pytest.fixture(scope="module", params=["steady", "wandering"])
def either(request, noisy, fitted):
    """Problem and fit, without and with a bias that wanders."""
    return (noisy, fitted) if request.param == "steady" else request.getfixturevalue("wandering")


def matrices(imu: ImuCalibration):
    return [value for _, value in calibration_parameters({"": imu})]


def flat(values):
    return np.concatenate([np.ravel(value) for value in values])


def estimate_of(problem, fit, accelerometer=None, gravity=GRAVITY, gravity_sigma=0.0, latitude=None):
    return to_physical_units(
        fit,
        accelerometer or problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity,
        gravity_sigma_m_s2=gravity_sigma,
        latitude_deg=latitude,
    )


def values_of(estimate):
    return (
        estimate.accelerometer_sensitivity,
        estimate.accelerometer_bias,
        estimate.gyroscope_sensitivity,
        estimate.gyroscope_bias,
        estimate.g_sensitivity,
    )


# --- the model and its derivatives ---------------------------------------------------------------------------------


@pytest.mark.parametrize("units", ["si", "raw"])
def test_start_without_a_guess_is_near_the_truth(multiposition, units):
    problem, truth = multiposition(3, g_sensitivity=2e-4, units=units, **SMALL)
    start = start_state(problem.data)
    s, b, c_g, b_g, g = start.matrices
    imu = truth.imus["imu0"]
    np.testing.assert_array_equal(g, 0.0)
    sensitivity = problem.accelerometer.spread[:, None] * s / GRAVITY
    np.testing.assert_allclose(
        sensitivity, imu.accelerometer.sensitivity, atol=1e-3 * imu.accelerometer.sensitivity.max()
    )
    bias = problem.accelerometer.spread * b + problem.accelerometer.centre
    np.testing.assert_allclose(bias, imu.accelerometer.bias, atol=5e-3 * imu.accelerometer.sensitivity.max())
    gyro = problem.gyroscope.spread[:, None] * np.linalg.inv(c_g)
    # Accelerations of the hand bend the direction of gravity that this start takes from the accelerometer.
    np.testing.assert_allclose(gyro, imu.gyroscope.sensitivity, atol=0.25 * imu.gyroscope.sensitivity.max())
    still = problem.gyroscope.spread * b_g + problem.gyroscope.centre
    np.testing.assert_allclose(still, imu.gyroscope.bias, atol=4e-3 * imu.gyroscope.sensitivity.max())


def test_a_gyroscope_that_shows_no_turn_is_refused_in_words(noisy):
    silent = replace(noisy.data.segments, gyroscope=0.0 * noisy.data.segments.gyroscope)
    data = replace(noisy.data, segments=silent, gyroscope=0.0 * noisy.data.gyroscope)
    with pytest.raises(InitialisationError, match="shows nothing of the turns"):
        start_state(data)


def central_differences(data, state, move, h=1e-6):
    """Return the derivatives of the three groups of residuals, in the tangent planes of `state`."""
    basis = tangent_basis(state.u)

    def residuals(sign):
        state = move(sign * h)
        lines = linearize_model(data, state)
        gap = state.u[1:] - lines.propagated  # lines.rotation has tangent planes that turn with u
        return lines.accelerometer, lines.gyroscope, np.einsum("kij,ki->kj", basis[1:], gap)

    return [(plus - minus) / (2 * h) for plus, minus in zip(residuals(1), residuals(-1), strict=True)]


@pytest.fixture(scope="module")
def off_minimum(either):
    """Data and a state some way from the minimum, so that no term is small by chance."""
    problem, fit = either
    rng = np.random.default_rng(11)
    size = np.full(len(fit.state.theta), 0.01)
    size[CG_] = 0.02 * np.abs(fit.state.theta[CG_]).max()
    state = fit.state.moved(size * rng.normal(size=len(size)), 0.01 * rng.normal(size=(len(fit.state.u), 2)))
    return problem.data, state, linearize_model(problem.data, state)


def test_derivatives_by_parameters(off_minimum):
    data, state, lines = off_minimum
    for k, one in enumerate(np.eye(len(state.theta))):
        still, at_rest, turned = central_differences(
            data, state, lambda d, one=one: MultiPositionState(theta=state.theta + d * one, u=state.u)
        )
        np.testing.assert_allclose(lines.accelerometer_theta[:, :, k], still, atol=1e-8)
        np.testing.assert_allclose(lines.gyroscope_theta[:, :, k], at_rest, atol=1e-8)
        # The sensitivity of a rotation is integrated by the trapezoid rule; see test_rotations.
        size = max(np.abs(turned).max(), 1e-3)
        np.testing.assert_allclose(lines.rotation_theta[:, :, k], turned, atol=1e-3 * size, err_msg=str(k))


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("parity", [0, 1])
def test_derivatives_by_directions(off_minimum, direction, parity):
    # Every other direction is moved, so that a rotation's two directions are told apart.
    data, state, lines = off_minimum
    moving = np.arange(len(state.u)) % 2 == parity
    d_u = np.zeros((len(state.u), 2))
    d_u[moving, direction] = 1.0
    nothing = np.zeros(len(state.theta))
    still, at_rest, turned = central_differences(data, state, lambda d: state.moved(nothing, d * d_u))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", lines.accelerometer_u, d_u), still, atol=1e-8)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", lines.gyroscope_u, d_u), at_rest, atol=1e-8)
    by_first = np.einsum("kij,kj->ki", lines.rotation_u, d_u[:-1])
    np.testing.assert_allclose(by_first + d_u[1:], turned, atol=1e-8)


def test_extrapolation_is_linear(off_minimum):
    data, state, lines = off_minimum
    rng = np.random.default_rng(12)
    d_theta, d_u = 1e-5 * rng.normal(size=len(state.theta)), 1e-5 * rng.normal(size=(len(state.u), 2))
    again, foretold = linearize_model(data, state.moved(d_theta, d_u)), lines.extrapolated(d_theta, d_u)
    np.testing.assert_allclose(foretold.accelerometer, again.accelerometer, atol=1e-9)
    np.testing.assert_allclose(foretold.gyroscope, again.gyroscope, atol=1e-9)
    # Lengths, as the tangent plane's two axes turn with u; the trapezoid rule's share is 1e-7.
    np.testing.assert_allclose(
        np.linalg.norm(foretold.rotation, axis=1), np.linalg.norm(again.rotation, axis=1), atol=2e-7
    )


def dense(lines: MultiPositionLinearization, whitening: Whitening, free):
    """Return Jacobian and residual of the whole problem without its structure: directions first, then parameters."""
    n, p = len(lines.accelerometer), int(free.sum())
    rows, residuals = [np.zeros((p, 2 * n + p))], [np.zeros(p)]
    rows[0][:, 2 * n :] = np.linalg.cholesky(whitening.prior[np.ix_(free, free)]).T
    for k in range(n):
        for name in ("accelerometer", "gyroscope"):
            root = getattr(whitening, name)[k]
            block = np.zeros((3, 2 * n + p))
            block[:, 2 * k : 2 * k + 2] = root @ getattr(lines, f"{name}_u")[k]
            block[:, 2 * n :] = root @ getattr(lines, f"{name}_theta")[k][:, free]
            rows.append(block)
            residuals.append(root @ getattr(lines, name)[k])
    for k in range(n - 1):
        block = np.zeros((2, 2 * n + p))
        block[:, 2 * k : 2 * k + 2] = lines.rotation_u[k]
        block[:, 2 * k + 2 : 2 * k + 4] = np.eye(2)
        block[:, 2 * n :] = lines.rotation_theta[k][:, free]
        rows.append(whitening.rotation[k] * block)
        residuals.append(whitening.rotation[k] * lines.rotation[k])
    return np.concatenate(rows), np.concatenate(residuals)


def assert_as_dense(fit):
    jacobian, residual = dense(fit.lines, fit.whitening, fit.free)
    n, p = len(fit.state.u), len(fit.state.theta)
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv(jacobian / scale, rcond=1e-14) / scale[:, None]
    covariance = inverse @ inverse.T
    sigma = np.sqrt(np.diag(covariance))
    arrow = solve_arrow(normal_equations(fit.lines, fit.whitening, np.zeros(p), fit.free))
    step = -inverse @ residual / sigma
    np.testing.assert_allclose(arrow.corner / sigma[2 * n :], step[2 * n :], atol=1e-5)
    np.testing.assert_allclose(arrow.states.ravel() / sigma[: 2 * n], step[: 2 * n], atol=1e-5)
    kept = fit.free[:PARAMETERS]
    part = slice(2 * n, 2 * n + kept.sum())
    weights = np.outer(sigma[part], sigma[part])
    np.testing.assert_allclose(
        fit.covariance[np.ix_(kept, kept)] / weights, covariance[part, part] / weights, atol=1e-4
    )
    assert (fit.covariance[~kept] == 0).all()


def test_step_and_covariance_are_those_of_the_dense_problem(either):
    assert_as_dense(either[1])


def test_step_and_covariance_without_g_sensitivity(noisy):
    assert_as_dense(fit_multiposition(noisy.data, g_sensitivity=False))


# --- the minimum ---------------------------------------------------------------------------------------------------


def test_noiseless_recording_gives_the_truth(multiposition):
    # What is left is the integrator's straight line between samples of the rate, which shrinks with the sample period.
    worst = {}
    for rate_hz in (100.0, 200.0):
        problem, truth = multiposition(5, g_sensitivity=3e-4, rate_hz=rate_hz, **QUIET, **SMALL)
        fit = fit_multiposition(problem.data, g_sensitivity=True)
        assert fit.converged
        assert fit.interval_used.all()
        errors = [
            a - b for a, b in zip(values_of(estimate_of(problem, fit)), matrices(truth.imus["imu0"]), strict=True)
        ]
        worst[rate_hz] = np.array([np.abs(error).max() for error in errors])
    assert (worst[100.0] < [2e-6, 1e-5, 3e-5, 5e-7, 5e-7]).all()
    assert worst[200.0][2] < 0.5 * worst[100.0][2]


def true_cost(data, fit, theta, u):
    lines = linearize_model(data, MultiPositionState(theta=theta, u=u))
    parts = [
        np.einsum("kij,kj->ki", fit.whitening.accelerometer, lines.accelerometer),
        np.einsum("kij,kj->ki", fit.whitening.gyroscope, lines.gyroscope),
        fit.whitening.rotation[:, None] * lines.rotation,
    ]
    knots = theta[PARAMETERS:]  # the weak prior of the others counts for nothing
    walk = fit.whitening.prior[PARAMETERS:, PARAMETERS:]
    return sum(np.sum(part**2) for part in parts) + knots @ walk @ knots


def test_fit_is_a_minimum(either):
    # A twentieth of a sigma in any direction costs; a gradient that is left over would make one side cheaper.
    problem, fit = either
    jacobian, _ = dense(fit.lines, fit.whitening, fit.free)
    n, p = len(fit.state.u), len(fit.state.theta)
    sigma = 1 / np.linalg.norm(jacobian, axis=0)  # of each number, the others being known
    here = true_cost(problem.data, fit, fit.state.theta, fit.state.u)
    for k in [*range(PARAMETERS), *range(PARAMETERS, p, 7)]:
        for sign in (-0.05, 0.05):
            theta = fit.state.theta.copy()
            theta[k] += sign * sigma[2 * n + k]
            assert true_cost(problem.data, fit, theta, fit.state.u) > here
    for k in range(0, 2 * n, 3):
        for sign in (-0.05, 0.05):
            d_u = np.zeros(2 * n)
            d_u[k] = sign * sigma[k]
            moved = fit.state.moved(np.zeros(p), d_u.reshape(n, 2))
            assert true_cost(problem.data, fit, moved.theta, moved.u) > here


def test_residuals_have_the_size_of_the_noise(noisy, fitted):
    assert fitted.converged
    assert fitted.interval_used.all()
    assert fitted.rotation_used.all()
    assert not fitted.held_by_prior.any()
    assert fitted.extra.accelerometer == fitted.extra.gyroscope == fitted.extra.rotation == 0.0
    n = len(fitted.state.u)
    degrees = 3 * n + 3 * n + 2 * (n - 1) - 2 * n - PARAMETERS
    square = true_cost(noisy.data, fitted, fitted.state.theta, fitted.state.u)
    assert square == pytest.approx(degrees, abs=4 * np.sqrt(2 * degrees))


def test_scaling_does_not_matter(multiposition):
    # The same recording in counts of odd sizes about odd offsets.
    problem, _ = multiposition(6, **SMALL)
    fit = fit_multiposition(problem.data, g_sensitivity=True)
    values = problem.accelerometer_means
    unit, offset = np.array([1e3, 1e-4, 30.0]), np.array([4e4, 5.0, -7e3])
    other = Scaling(centre=problem.accelerometer.centre * unit + offset, spread=problem.accelerometer.spread * unit)
    np.testing.assert_allclose(other.scaled(values * unit + offset), problem.data.accelerometer, atol=1e-8)
    plain = estimate_of(problem, fit)
    moved = estimate_of(problem, fit, accelerometer=other)
    np.testing.assert_allclose(moved.accelerometer_sensitivity, unit[:, None] * plain.accelerometer_sensitivity)
    np.testing.assert_allclose(moved.accelerometer_bias, unit * plain.accelerometer_bias + offset)


def test_attitudes_all_alike_are_refused(noisy):
    same = np.tile(noisy.data.accelerometer[:1], (len(noisy.data.accelerometer), 1))
    with pytest.raises(InitialisationError):
        fit_multiposition(replace(noisy.data, accelerometer=same), g_sensitivity=True)


# --- noise levels and outliers -------------------------------------------------------------------------------------


def test_scatter_beyond_the_noise_is_found_and_measured(multiposition):
    problem, _ = multiposition(7, intervals=60, t_init_s=10.0, hold_s=(2.5, 3.0))
    data, rng, n = problem.data, np.random.default_rng(13), 60
    s, _, c_g, _, _ = fit_multiposition(data, g_sensitivity=True).state.matrices
    s_g = np.linalg.inv(c_g)
    by_force, by_rate, by_turn = 2e-3, 2e-3, 0.02  # [g], [rad/s], [rad]: several times the noise of a mean, a rotation
    middle = data.segments.first + data.segments.lengths // 2
    found = []
    for _ in range(5):
        moved = replace(
            data,
            accelerometer=data.accelerometer + by_force * rng.normal(size=(n, 3)) @ s.T,
            gyroscope=data.gyroscope + by_rate * rng.normal(size=(n, 3)) @ s_g.T,
        )
        still = fit_multiposition(moved, g_sensitivity=True)
        kicked = data.segments.gyroscope.copy()  # a turn of its own for each rotation
        kicked[middle] += by_turn / data.segments.dt_s[middle, None] * rng.normal(size=(n - 1, 3)) @ s_g.T
        moved = replace(data, segments=replace(data.segments, gyroscope=kicked))
        turned = fit_multiposition(moved, g_sensitivity=True)
        assert still.interval_used.all()
        assert turned.rotation_used.all()
        found.append([still.extra.accelerometer, still.extra.gyroscope, turned.extra.rotation])
    # Of some 100 degrees of freedom five times: 3 %, and the square of it is what is averaged.
    np.testing.assert_allclose(np.sqrt(np.mean(found, axis=0)) / [by_force, by_rate, by_turn], 1.0, atol=0.1)


def test_touched_interval_and_broken_rotation_are_left_out(noisy, fitted):
    data = noisy.data
    accelerometer = data.accelerometer.copy()
    accelerometer[9] += [0.03, -0.02, 0.03]
    kicked = data.segments.gyroscope.copy()
    k = 20
    middle = data.segments.first[k] + data.segments.lengths[k] // 2
    inside = slice(middle - 30, middle + 30)
    kicked[inside] *= 0.7
    broken = replace(data, accelerometer=accelerometer, segments=replace(data.segments, gyroscope=kicked))
    fit = fit_multiposition(broken, g_sensitivity=True)
    np.testing.assert_array_equal(np.flatnonzero(~fit.interval_used), [9])
    np.testing.assert_array_equal(np.flatnonzero(~fit.rotation_used), [8, 9, 20])
    sigma = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_array_less(np.abs(fit.state.theta[:PARAMETERS] - fitted.state.theta), 2.5 * sigma)
    assert fit.extra.accelerometer == fit.extra.rotation == 0.0


def test_what_is_wrong_everywhere_is_not_called_an_outlier(noisy):
    # A gyroscope whose samples are all at wrong times has no good rotations to judge the others by.
    rolled = np.roll(noisy.data.segments.gyroscope, 400, axis=0)
    fit = fit_multiposition(
        replace(noisy.data, segments=replace(noisy.data.segments, gyroscope=rolled)), g_sensitivity=True
    )
    assert fit.rotation_used.sum() >= 0.6 * len(fit.rotation_used)
    assert np.sqrt(fit.extra.rotation) > 0.05


# --- a bias that wanders -------------------------------------------------------------------------------------------


def test_wandering_bias_is_followed(multiposition, wandering):
    problem, fit = wandering
    steady, truth = multiposition(4, g_sensitivity=2e-4, intervals=30, t_init_s=20.0)  # the same but for the walk
    walked = problem.gyroscope_means - steady.gyroscope_means
    found = fit.drift * problem.gyroscope.spread
    for axis in range(3):  # between the knots, of which there are two for three intervals, the walk goes its own way
        assert np.corrcoef(found[:, axis], walked[:, axis])[0, 1] > 0.7
    estimate, imu = estimate_of(problem, fit), truth.imus["imu0"]
    sigma = np.sqrt(np.diag(estimate.covariance))[12:21].reshape(3, 3)
    assert np.abs((estimate.gyroscope_sensitivity - imu.gyroscope.sensitivity) / sigma).max() < 4


def test_walk_density_of_walks_and_of_noise():
    rng = np.random.default_rng(14)
    used = np.ones(40, dtype=bool)
    t_s = np.cumsum(rng.uniform(4, 8, 40))
    found, seen = [], 0
    for _ in range(200):
        walk = np.cumsum(1e-3 * np.sqrt(np.diff(t_s, prepend=0))[:, None] * rng.normal(size=(40, 3)), axis=0)
        found.append(walk_density(t_s, walk + 1e-4 * rng.normal(size=(40, 3)), used))
        seen += walk_density(t_s, rng.normal(size=(40, 3)), used) is not None
    assert np.median(np.array(found)) == pytest.approx(1e-6, rel=0.4)
    assert seen < 0.4 * 200  # asked liberally: a walk that is not there comes out small
    assert walk_density(t_s, np.zeros((40, 3)), used) is None
    assert walk_density(t_s[:11], walk[:11], used[:11]) is None


def test_walk_precision_is_that_of_steps_about_a_mean_of_zero(noisy):
    data = with_drift(noisy.data)
    knots = data.drift[0].shape[1]
    density = np.array([1.0, 4.0, 0.25])
    covariance = np.linalg.inv(walk_precision(data, density)).reshape(knots, 3, knots, 3)
    spacing = (data.span_s[1] - data.span_s[0]) / (knots - 1)
    step = np.diff(np.eye(knots), axis=0)
    for axis in range(3):
        steps = step @ covariance[:, axis, :, axis] @ step.T
        # A mean that is zero ties the steps together by one part in their number, no more.
        np.testing.assert_allclose(np.diag(steps), density[axis] * spacing, rtol=2e-3)
        weights = np.full(knots, 1.0)
        weights[[0, -1]] = 0.5
        mean = weights @ covariance[:, axis, :, axis] @ weights / weights.sum() ** 2
        assert mean < 1e-4 * density[axis] * spacing
    assert np.abs(data.drift[0].sum(axis=1) - 1).max() < 1e-12  # hats add up to one everywhere
    assert np.abs(data.drift[1].sum(axis=1) - 1).max() < 1e-12


# --- hold-out ------------------------------------------------------------------------------------------------------


def test_interval_left_out_is_what_refitting_without_it_gives(noisy, fitted):
    held = leave_one_out(fitted)
    scale = np.sqrt(np.mean(held.magnitude**2))
    for k in (0, 7, 18, 29):
        blind = noisy.data.accelerometer_variance.copy()
        blind[k] *= 1e12
        other = fit_multiposition(replace(noisy.data, accelerometer_variance=blind), g_sensitivity=True)
        s, b, *_ = other.state.matrices
        refitted = np.linalg.norm(np.linalg.solve(s, noisy.data.accelerometer[k] - b)) - 1
        assert held.magnitude[k] == pytest.approx(refitted, abs=0.02 * scale)
    assert np.mean(held.magnitude**2) > np.mean(held.magnitude_fit**2)


def test_rotation_left_out_is_what_refitting_without_it_gives(noisy, fitted):
    data = noisy.data
    held = leave_one_out(fitted)
    scale = np.sqrt(np.mean(held.rotation**2))
    for k in (0, 5, 17, 28):
        linked = data.linked.copy()
        linked[k] = False
        other = fit_multiposition(replace(data, linked=linked), g_sensitivity=True)
        s, b, c_g, b_g, g = other.state.matrices
        force = np.linalg.solve(s, (data.segments.accelerometer - b).T).T
        rate = (data.segments.gyroscope - b_g - force @ g.T) @ c_g.T
        u = np.linalg.solve(s, (data.accelerometer - b).T).T
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        error = u[1:] - propagate_directions(integrate_rates(data.segments, rate).rotation, u[:-1])
        refitted = tangent_basis(fitted.state.u)[k + 1].T @ error[k]
        np.testing.assert_allclose(held.rotation[k], refitted, atol=0.05 * scale)
    assert np.mean(held.rotation**2) > np.mean(held.rotation_fit**2)


def test_rival_without_g_sensitivity_is_judged_as_if_it_had_been_fitted(multiposition):
    problem, _ = multiposition(8, intervals=25, t_init_s=15.0)
    full = fit_multiposition(problem.data, g_sensitivity=True)
    basic = fit_multiposition(problem.data, g_sensitivity=False)
    foretold = leave_one_out(full, g_sensitivity=False)
    fitted = leave_one_out(basic)
    # Each in its own tangent axes: lengths are compared.
    found, expected = (np.linalg.norm(held.rotation, axis=1) for held in (foretold, fitted))
    np.testing.assert_allclose(found, expected, atol=0.02 * np.sqrt(np.mean(expected**2)))
    np.testing.assert_allclose(foretold.magnitude, fitted.magnitude, atol=0.02 * np.std(fitted.magnitude))


def test_hold_out_tells_whether_there_is_g_sensitivity(multiposition):
    for level, better in ((3e-4, True), (0.0, False)):
        problem, _ = multiposition(9, g_sensitivity=level, intervals=25, t_init_s=15.0)
        fit = fit_multiposition(problem.data, g_sensitivity=True)
        full = np.mean(leave_one_out(fit).rotation ** 2)
        basic = np.mean(leave_one_out(fit, g_sensitivity=False).rotation ** 2)
        assert (full < basic) == better


# --- the way back to the sensors' units, and to other frames -------------------------------------------------------


@pytest.mark.parametrize("latitude", [None, 45.0, -60.0])
def test_covariance_in_the_sensors_units_against_differences(noisy, fitted, latitude):
    gravity_sigma = 0.01

    def values(theta, gravity=GRAVITY, earth=0.0):
        moved = replace(fitted, state=MultiPositionState(theta=theta, u=fitted.state.u))
        estimate = estimate_of(noisy, moved, gravity=gravity, latitude=latitude)
        found = list(values_of(estimate))
        found[4] = found[4] - found[2] * earth / gravity
        return flat(found)

    theta = fitted.state.theta
    steps = 1e-6 * np.maximum(np.abs(theta), 1e-2)
    jacobian = np.stack([(values(theta + h) - values(theta - h)) / (2 * h.max()) for h in np.diag(steps)], axis=1)
    covariance = jacobian @ fitted.covariance @ jacobian.T
    by_gravity = (values(theta, GRAVITY + 1e-4) - values(theta, GRAVITY - 1e-4)) / 2e-4
    covariance += gravity_sigma**2 * np.outer(by_gravity, by_gravity)
    if latitude is None:  # the vertical part of the earth's rate is then anything, once over the sphere
        by_earth = values(theta, earth=1e-5) - values(theta)
        covariance += EARTH_RATE_RAD_S**2 / 3 * np.outer(by_earth, by_earth) / 1e-10
    found = estimate_of(noisy, fitted, gravity_sigma=gravity_sigma, latitude=latitude).covariance
    sigma = np.sqrt(np.diag(covariance))
    sigma[sigma == 0] = 1.0
    # That the earth's share is known only as well as the gyroscope's scale is left out: correlations of 1e-3.
    np.testing.assert_allclose(found / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=2e-3)


@pytest.mark.parametrize("latitude", [40.0, -40.0, 90.0])
def test_earth_rate_is_taken_off_the_g_sensitivity(multiposition, latitude):
    problem, truth = multiposition(10, g_sensitivity=1e-4, earth_rate_latitude=latitude, **QUIET, **SMALL)
    fit = fit_multiposition(problem.data, g_sensitivity=True)
    imu = truth.imus["imu0"]
    known, unknown = estimate_of(problem, fit, latitude=latitude), estimate_of(problem, fit)
    off = known.gyroscope_sensitivity * EARTH_RATE_RAD_S * np.sin(np.radians(latitude)) / GRAVITY
    assert np.abs(off).max() > 4e-6
    # North's part turns with the attitude, too, but not with gravity: it is left over, and averages out only partly.
    rest = EARTH_RATE_RAD_S * np.cos(np.radians(latitude)) / GRAVITY + 1e-7
    np.testing.assert_allclose(known.g_sensitivity, imu.gyroscope.g_sensitivity, atol=rest)
    np.testing.assert_allclose(unknown.g_sensitivity - off, known.g_sensitivity, atol=1e-12)


@pytest.mark.parametrize("frame", ["accel-x", "accel-z"])
@pytest.mark.parametrize("gyroscope", [True, False])
def test_jacobian_of_a_change_of_frame_against_differences(random_calibration, frame, gyroscope):
    for start in ("accel-x", "accel-z", "user"):
        imu = random_calibration(21, frame=start, gyroscope=gyroscope).imus["imu0"]
        values = matrices(imu)
        x, splits = flat(values), np.cumsum([v.size for v in values])[:-1]

        def moved(x, values=values, splits=splits):
            parts = [p.reshape(v.shape) for p, v in zip(np.split(x, splits), values, strict=True)]
            rotation = frame_rotation(parts[0], frame)
            return flat([p @ rotation.T if p.ndim == 2 else p for p in parts])

        size = np.concatenate([np.full(v.size, np.abs(v).max()) for v in values])
        steps = np.diag(1e-6 * size)
        expected = np.stack([(moved(x + h) - moved(x - h)) / (2 * h.max()) for h in steps], axis=1)
        found = rotation_jacobian(values, frame_rotation(values[0], frame), frame)
        np.testing.assert_allclose(found / size[:, None] * size, expected / size[:, None] * size, atol=2e-8)


def test_covariance_in_another_frame_is_what_a_sample_of_sensors_scatters_by(random_calibration):
    calibration = random_calibration(22)
    rng = np.random.default_rng(23)
    names, matrix = calibration.uncertainty.names, calibration.uncertainty.matrix
    root = np.linalg.cholesky(matrix + 1e-12 * np.diag(np.diag(matrix)) + 1e-300 * np.eye(len(names)))
    values = matrices(calibration.imus["imu0"])
    splits = np.cumsum([v.size for v in values])[:-1]
    sample = []
    for _ in range(600):
        parts = np.split(flat(values) + root @ rng.normal(size=len(names)), splits)
        parts = [p.reshape(v.shape) for p, v in zip(parts, values, strict=True)]
        rotation = frame_rotation(parts[0], "accel-z")
        sample.append(flat([p @ rotation.T if p.ndim == 2 else p for p in parts]))
    scatter = np.std(sample, axis=0)
    predicted = np.sqrt(np.diag(calibration.in_frame("accel-z").uncertainty.matrix))
    free = predicted > 0
    assert free.sum() == 30
    np.testing.assert_allclose(scatter[free] / predicted[free], 1.0, atol=0.12)  # 4 sigma of a deviation from 600
    np.testing.assert_allclose(scatter[~free], 0.0, atol=1e-9 * np.abs(values[0]).max())


def test_frames_there_and_back(random_calibration):
    calibration = random_calibration(24)
    back = calibration.in_frame("accel-z").in_frame("accel-x")
    for found, expected in zip(matrices(back.imus["imu0"]), matrices(calibration.imus["imu0"]), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    sigma = np.sqrt(np.maximum(np.diag(calibration.uncertainty.matrix), 1e-300))
    weights = 1 / np.outer(sigma, sigma)
    free = np.diag(calibration.uncertainty.matrix) > 0
    np.testing.assert_allclose(
        (back.uncertainty.matrix * weights)[np.ix_(free, free)],
        (calibration.uncertainty.matrix * weights)[np.ix_(free, free)],
        atol=1e-9,
    )


def test_left_handed_accelerometer_keeps_a_minus_in_either_frame(random_calibration):
    imu = random_calibration(25).imus["imu0"]
    mirrored = replace(imu.accelerometer, sensitivity=np.diag([1.0, -1.0, 1.0]) @ imu.accelerometer.sensitivity)
    for frame in ("accel-x", "accel-z"):
        rotation = frame_rotation(mirrored.sensitivity, frame)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        turned = rotate_imu(replace(imu, accelerometer=mirrored), rotation).accelerometer.sensitivity
        assert np.count_nonzero(np.diag(turned) < 0) == 1
