"""Rotations: equations as Tedaldi prints them, limits near zero in high precision, corner cases."""

import mpmath
import numpy as np
import pytest

from gnomon.geometry.rotations import (
    nearest_rotation,
    normalise_quaternion,
    quaternion_product,
    rk4n_steps,
    rotation_from_quaternion,
    running_products,
    skew,
    tangent_basis,
)

ONE, *UNITS = np.eye(4)


def omega_matrix(w):
    """Eq. (3.11)."""
    return np.array([[0, -w[0], -w[1], -w[2]], [w[0], 0, w[2], -w[1]], [w[1], -w[2], 0, w[0]], [w[2], w[1], -w[0], 0]])


def rk4n_literally(q, rates, dt_s):
    """Eqs. (3.10)-(3.16), one step after the other, with a rate that is linear in time within a step."""
    for k, dt in enumerate(dt_s):

        def f(q, c, k=k):
            return 0.5 * omega_matrix((1 - c) * rates[k] + c * rates[k + 1]) @ q

        k1 = f(q, 0.0)
        k2 = f(q + 0.5 * dt * k1, 0.5)
        k3 = f(q + 0.5 * dt * k2, 0.5)
        k4 = f(q + dt * k3, 1.0)
        q = q + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        q = q / np.linalg.norm(q)
    return q


def test_hamilton_units():
    i, j, k = UNITS
    for unit in UNITS:
        np.testing.assert_array_equal(quaternion_product(unit, unit), -ONE)
    np.testing.assert_array_equal(quaternion_product(quaternion_product(i, j), k), -ONE)
    np.testing.assert_array_equal(quaternion_product(i, j), k)
    np.testing.assert_array_equal(quaternion_product(j, i), -k)


@pytest.mark.parametrize("axis", range(3))
def test_quarter_turn_takes_the_next_axis_to_the_one_after(axis):
    q = np.sqrt(0.5) * (ONE + np.eye(4)[1 + axis])
    own, following, last = np.roll(np.eye(3), -axis, axis=0)
    rotation = rotation_from_quaternion(q)  # R_world_body
    np.testing.assert_allclose(rotation @ own, own, atol=1e-15)
    np.testing.assert_allclose(rotation @ following, last, atol=1e-15)


def test_attitude_grows_on_the_right_with_the_rate_in_the_body():
    # A body that first tips about its x axis and then turns about its own z axis.
    t = np.linspace(0, 1, 2001)
    first, second = np.array([np.pi / 2, 0, 0]), np.array([0, 0, np.pi / 3])
    q = ONE
    for rate in (first, second):
        steps = rk4n_steps(np.tile(rate, (2000, 1)), np.tile(rate, (2000, 1)), np.diff(t))
        q = quaternion_product(q, running_products(steps, np.array([2000]))[-1])
    by_x = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    np.testing.assert_allclose(rotation_from_quaternion(q), by_x @ [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize("steps", [1, 2, 40])
def test_rk4n_is_the_printed_one(steps):
    rng = np.random.default_rng(steps)
    rates = rng.normal(0, 5.0, (steps + 1, 3))  # coarse steps, so that nothing but the same formula agrees
    dt = rng.uniform(0.01, 0.3, steps)
    found = running_products(rk4n_steps(rates[:-1], rates[1:], dt), np.array([steps]))[-1]
    np.testing.assert_allclose(found, rk4n_literally(ONE, rates, dt), atol=1e-14)


def test_order_of_the_integrator():
    # The rate is linear between nine knots, as RK4n takes it between samples.
    knots = np.random.default_rng(5).normal(0, 2.0, (9, 3))

    def rate(t):
        return np.column_stack([np.interp(8 * t, np.arange(9), knots[:, axis]) for axis in range(3)])

    def attitude(n):
        t = np.linspace(0, 1, n + 1)
        steps = rk4n_steps(rate(t[:-1]), rate(t[1:]), np.diff(t))
        return running_products(steps, np.array([n]))[-1]

    truth = attitude(8192)
    errors = np.array([np.linalg.norm(attitude(n) - truth) for n in (16, 32, 64)])
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 4, atol=0.25)
    assert errors[-1] > 1e-11


@pytest.mark.parametrize("exponent", range(-20, 2))
def test_steps_in_high_precision(exponent):
    mpmath.mp.dps = 50
    direction = np.array([0.48, -0.6, 0.64])
    for mantissa in (1.0, 2.7, 3.1):
        angle = mantissa * 10.0**exponent
        omega, dt = direction * angle / 0.01, 0.01
        half = [mpmath.mpf(w) * mpmath.mpf(dt) / 2 for w in omega]
        size = mpmath.sqrt(sum(h * h for h in half))
        # Runge and Kutta's polynomial for a constant rate: the exponential cut after the fourth power
        series = [1 - size**2 / 2 + size**4 / 24, *(h * (1 - size**2 / 6) for h in half)]
        norm = mpmath.sqrt(sum(x * x for x in series))
        found = rk4n_steps(omega, omega, np.array(dt))
        truth = np.array([float(x / norm) for x in series])
        np.testing.assert_allclose(found[0], truth[0], rtol=0, atol=4e-16)
        np.testing.assert_allclose(found[1:], truth[1:], rtol=1e-13, atol=4e-16 * min(1, angle))


def test_steps_of_a_resting_sensor():
    np.testing.assert_array_equal(rk4n_steps(np.zeros(3), np.zeros(3), np.array(0.01)), ONE)
    np.testing.assert_array_equal(rk4n_steps(np.ones(3), np.ones(3), np.array(0.0)), ONE)


def test_running_products_of_nothing():
    assert running_products(np.empty((0, 4)), np.empty(0, dtype=np.int64)).shape == (0, 4)


@pytest.mark.parametrize(
    ("a", "b"), [((4,), (5, 4)), ((5, 4), (4,)), ((3, 1, 4), (5, 4)), ((2, 1, 4), (1, 3, 4)), ((4,), (4,))]
)
def test_products_broadcast(a, b):
    rng = np.random.default_rng(6)
    left, right = rng.normal(size=a), rng.normal(size=b)
    shape = np.broadcast_shapes(a, b)
    found = quaternion_product(left, right)
    assert found.shape == shape
    pairs = zip(np.broadcast_to(left, shape).reshape(-1, 4), np.broadcast_to(right, shape).reshape(-1, 4), strict=True)
    one_by_one = [quaternion_product(p, q) for p, q in pairs]
    np.testing.assert_allclose(found.reshape(-1, 4), one_by_one, rtol=1e-15)


def test_normalised():
    q = np.random.default_rng(1).normal(size=(5, 2, 4)) * 1e3
    np.testing.assert_allclose(np.linalg.norm(normalise_quaternion(q), axis=-1), 1.0, rtol=1e-15)


def test_skew_is_the_cross_product():
    rng = np.random.default_rng(2)
    v, w = rng.normal(size=(2, 4, 3))
    np.testing.assert_allclose(np.einsum("kij,kj->ki", skew(v), w), np.cross(v, w), atol=1e-15)
    np.testing.assert_array_equal(skew(v), -np.swapaxes(skew(v), 1, 2))


@pytest.mark.parametrize("nearly", [0.0, 1e-300, 1e-17, 1e-9, 1e-3])
def test_tangent_basis_at_the_axes(nearly):
    for axis in range(3):
        for sign in (1.0, -1.0):
            u = np.full(3, nearly)
            u[axis] = sign
            u /= np.linalg.norm(u)
            basis = tangent_basis(u)
            np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-15)
            np.testing.assert_allclose(u @ basis, 0.0, atol=1e-15)
            np.testing.assert_allclose(np.cross(basis[:, 0], basis[:, 1]), u, atol=1e-15)


def test_nearest_rotation_to_mirror_and_to_noise():
    rng = np.random.default_rng(3)
    true = rotation_from_quaternion(normalise_quaternion(rng.normal(size=4)))
    np.testing.assert_allclose(nearest_rotation(true), true, atol=1e-15)
    np.testing.assert_allclose(nearest_rotation(7.0 * true), true, atol=1e-15)
    found = nearest_rotation(true @ np.diag([1.0, 0.9, -0.1]))  # a mirror; the weakest axis gives way
    np.testing.assert_allclose(found, true, atol=1e-15)
    flat = nearest_rotation(np.outer(true[:, 0], [1.0, 0, 0]) + 0.5 * np.outer(true[:, 1], [0, 1.0, 0]))
    np.testing.assert_allclose(flat, true, atol=1e-15)  # two axes determine the third
