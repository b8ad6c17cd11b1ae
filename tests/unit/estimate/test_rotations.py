"""Rotations between static intervals: cutting, integrating, their derivatives, and the start without a guess."""

import numpy as np
import pytest

from gnomon.estimate.multiposition.measurements import (
    MotionSegments,
    cut_segments,
    integrate_rates,
    linear_start,
    propagate_directions,
    segments_between,
)
from gnomon.estimate.multiposition.tedaldi import fit_gyroscope, leave_group_out
from gnomon.geometry.rotations import (
    normalise_quaternion,
    quaternion_product,
    rk4n_steps,
    rotation_from_quaternion,
    running_products,
)


def bump(t, duration):
    """A rate's profile that begins and ends at rest with its first three derivatives; its integral is 1."""
    x = np.clip(t / duration, 0, 1)
    return 630 * (x * (1 - x)) ** 4 / duration


def motions(rate_hz, count=6, duration=2.0, seed=1, axes=None, spread=True):
    """Return true rates, dt and lengths of smooth motions, and the direction of gravity along them."""
    rng = np.random.default_rng(seed)
    n = round(duration * rate_hz) + 1
    t = np.arange(n) / rate_hz
    omega, dt, path = [], [], []
    for k in range(count):
        axis = axes[k % len(axes)] if axes is not None else rng.normal(size=3)
        axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        early, late = bump(t, 0.7 * duration), bump(t - 0.3 * duration, 0.7 * duration)
        second = rng.normal(size=3) * spread
        omega.append(rng.uniform(0.7, 2.0) * (early[:, None] * axis + late[:, None] * second))
        dt.append(np.append(np.full(n - 1, 1 / rate_hz), 0.0))
        u = rng.normal(size=3)
        attitude = running_products(rk4n_steps(omega[-1][:-1], omega[-1][1:], dt[-1][:-1]), np.array([n - 1]))
        turned = np.einsum("kij,i->kj", rotation_from_quaternion(attitude), u / np.linalg.norm(u))
        path.append(np.concatenate([[u / np.linalg.norm(u)], turned]))
    return np.concatenate(omega), np.concatenate(dt), np.full(count, n), np.concatenate(path)


def as_segments(gyroscope, dt, lengths, accelerometer=None):
    force = np.zeros_like(gyroscope) if accelerometer is None else accelerometer
    return MotionSegments(gyroscope=gyroscope, accelerometer=force, dt_s=dt, lengths=lengths)


def test_segments_reach_from_the_last_static_sample_to_the_next():
    t = np.arange(20) * 0.1
    first, lengths = segments_between(t, np.array([0.2, 0.95]), np.array([0.5, 1.25]))
    np.testing.assert_array_equal(
        first, [2, 9]
    )  # timestamps between those of the accelerometer: one more on either side
    np.testing.assert_array_equal(first + lengths - 1, [5, 13])


def test_segments_stay_within_the_recording():
    t = np.arange(5) * 0.1
    first, lengths = segments_between(t, np.array([-1.0, 0.35]), np.array([0.05, 9.0]))
    np.testing.assert_array_equal(first, [0, 3])
    np.testing.assert_array_equal(first + lengths - 1, [1, 4])


def test_cut_segments_keeps_samples_and_steps():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.005, 0.015, 50))
    gyroscope, accelerometer = rng.normal(size=(2, 50, 3))
    cut = cut_segments(t, gyroscope, accelerometer, np.array([3, 30, 44]), np.array([5, 1, 6]))
    index = np.array([3, 4, 5, 6, 7, 30, 44, 45, 46, 47, 48, 49])
    np.testing.assert_array_equal(cut.gyroscope, gyroscope[index])
    np.testing.assert_array_equal(cut.accelerometer, accelerometer[index])
    np.testing.assert_array_equal(cut.first, [0, 5, 6])
    np.testing.assert_allclose(cut.dt_s, [*np.diff(t[3:8]), 0, 0, *np.diff(t[44:50]), 0])
    np.testing.assert_allclose(cut.duration_s, [t[7] - t[3], 0, t[49] - t[44]], atol=1e-15)


def test_integrated_rotation_is_the_product_of_its_steps():
    omega, dt, lengths, _ = motions(50.0)
    turns = integrate_rates(as_segments(omega, dt, lengths), omega)
    for k, (a, n) in enumerate(zip(np.cumsum(lengths) - lengths, lengths, strict=True)):
        q = np.array([1.0, 0, 0, 0])
        for i in range(a, a + n - 1):
            q = normalise_quaternion(quaternion_product(q, rk4n_steps(omega[i], omega[i + 1], dt[i])))
        np.testing.assert_allclose(turns.rotation[k], rotation_from_quaternion(q), atol=1e-13)


def test_gravity_is_propagated_into_the_turned_body():
    # Eq. (3.7): a body that turns by +90 degrees about x sees a vector that stood along y stand along -z.
    rate = np.tile([np.pi / 2, 0, 0], (101, 1))
    segments = as_segments(rate, np.append(np.full(100, 0.01), 0.0), np.array([101]))
    found = propagate_directions(integrate_rates(segments, rate).rotation, np.array([[0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(found, [[0, 0, -1]], atol=1e-9)


def small_turn(before, after):
    """Rotation vectors by which attitudes (m, 3, 3) differ, seen from the frame of the start."""
    change = after @ np.swapaxes(before, 1, 2)
    return 0.5 * np.stack(
        [
            change[:, 2, 1] - change[:, 1, 2],
            change[:, 0, 2] - change[:, 2, 0],
            change[:, 1, 0] - change[:, 0, 1],
        ],
        axis=1,
    )


@pytest.mark.parametrize(("rate_hz", "tolerance"), [(25.0, 4e-3), (50.0, 1e-3), (100.0, 2.5e-4), (200.0, 6e-5)])
def test_sensitivities_are_derivatives_up_to_the_trapezoid_rule(rate_hz, tolerance):
    # The sensitivity integrates R(t) dC z(t) by the trapezoid rule and not through RK4n; the difference falls with the
    # square of the step. At 100 Hz it is 2e-4 of the largest sensitivity, which changes the path to the minimum, not
    # the minimum.
    omega, dt, lengths, path = motions(rate_hz)
    regressors = np.column_stack([omega, np.ones(len(omega)), path])
    segments = as_segments(omega, dt, lengths)
    coefficients = np.concatenate([np.eye(3), np.zeros((3, 4))], axis=1)
    turns = integrate_rates(segments, omega, regressors)
    expected = np.empty_like(turns.sensitivity)
    for a, c in np.ndindex(3, 7):
        step = np.zeros((3, 7))
        step[a, c] = 1e-5
        plus, minus = (integrate_rates(segments, regressors @ (coefficients + s * step).T).rotation for s in (1, -1))
        expected[:, :, a, c] = small_turn(minus, plus) / 2e-5
    size = np.abs(expected).max(axis=(0, 1, 2))  # of the columns: rate, bias, force
    assert (np.abs(turns.sensitivity - expected) / size).max() < tolerance


def test_linear_start_finds_any_sensor_without_a_guess():
    rng = np.random.default_rng(3)
    omega, dt, lengths, path = motions(100.0, count=12)
    for scale in (1.0, 1e-5, 1e4):
        true = scale * (np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)))[rng.permutation(3)]  # axes swapped at will
        found, singular = linear_start(as_segments(omega @ np.linalg.inv(true).T, dt, lengths), path)
        np.testing.assert_allclose(found, true, atol=2e-3 * scale)
        assert singular[-1] > 0.05 * singular[0]


def test_linear_start_shows_what_rotations_leave_open():
    omega, dt, lengths, path = motions(100.0, count=12, axes=[[0, 0, 1]], spread=False)
    _, singular = linear_start(as_segments(omega, dt, lengths), path)
    assert singular[-1] < 1e-9 * singular[0]


def gyroscope_problem(rng, sigma_u=0.0, sigma_y=0.0):
    omega, dt, lengths, path = motions(100.0, count=15, seed=4)
    true = 2e-4 * (np.eye(3) + rng.uniform(-0.05, 0.05, (3, 3)))
    first = np.cumsum(lengths) - lengths
    u_start, u_end = path[first], path[first + lengths - 1]
    if sigma_u:
        u_end = u_end + sigma_u * rng.normal(size=u_end.shape)
        u_end /= np.linalg.norm(u_end, axis=1, keepdims=True)
    readings = omega @ np.linalg.inv(true).T
    return as_segments(readings + sigma_y * rng.normal(size=readings.shape), dt, lengths), path, u_start, u_end, true


def test_gyroscope_fit_of_noiseless_rotations_is_exact():
    segments, path, u_start, u_end, true = gyroscope_problem(np.random.default_rng(5))
    fit = fit_gyroscope(segments, 9.81 * path, u_start, u_end)
    assert fit.converged
    np.testing.assert_allclose(fit.correction, true, atol=1e-10 * np.abs(true).max())
    np.testing.assert_allclose(fit.residual, 0.0, atol=1e-10)
    np.testing.assert_allclose(fit.propagated, u_end, atol=1e-10)


def test_gyroscope_jacobian_and_the_minimum():
    segments, path, u_start, u_end, _ = gyroscope_problem(np.random.default_rng(6), sigma_u=3e-3)
    fit = fit_gyroscope(segments, 9.81 * path, u_start, u_end)

    def residual(correction):
        return u_end - propagate_directions(
            integrate_rates(segments, segments.gyroscope @ correction.T).rotation, u_start
        )

    np.testing.assert_allclose(fit.residual, residual(fit.correction), atol=1e-12)
    gradient = np.empty(9)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-9
        plus, minus = (residual(fit.correction + s * step.reshape(3, 3)) for s in (1, -1))
        difference = (plus - minus) / 2e-9
        gradient[k] = np.sum(difference * fit.residual)
        np.testing.assert_allclose(fit.jacobian[:, :, k], difference, atol=3e-4 * np.abs(fit.jacobian).max())
    # The true gradient vanishes to the trapezoid rule's accuracy: a step of far less than a sigma.
    sigma = np.sqrt(np.mean(fit.residual**2) * np.diag(fit.covariance))
    assert (np.abs(fit.covariance @ gradient) < 1e-2 * sigma).all()


def test_leaving_a_rotation_out_is_what_refitting_without_it_gives():
    segments, path, u_start, u_end, _ = gyroscope_problem(np.random.default_rng(7), sigma_u=3e-3)
    fit = fit_gyroscope(segments, 9.81 * path, u_start, u_end)
    foretold = leave_group_out(fit.jacobian, fit.residual, fit.covariance)
    for k in (0, 6, 14):
        keep = np.arange(15) != k
        samples = np.repeat(keep, segments.lengths)
        others = as_segments(segments.gyroscope[samples], segments.dt_s[samples], segments.lengths[keep])
        fit_without = fit_gyroscope(others, 9.81 * path[samples], u_start[keep], u_end[keep])
        rotation = integrate_rates(segments, segments.gyroscope @ fit_without.correction.T).rotation
        refitted = u_end[k] - propagate_directions(rotation, u_start)[k]
        np.testing.assert_allclose(foretold[k], refitted, atol=0.02 * np.abs(foretold).max())
