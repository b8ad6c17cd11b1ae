"""Least squares: the arrow against dense algebra, Levenberg-Marquardt on problems whose minima are known."""

import numpy as np
import pytest

from gnomon.solve.least_squares import ArrowSystem, levenberg_marquardt, reduced_normal_equations, solve_arrow


def random_system(n, d, p, seed):
    """Return normal equations of random neighbours' equations and the same as one dense matrix."""
    rng = np.random.default_rng(seed)
    size = n * d + p
    rows = [np.zeros((2 * p, size))]
    rows[0][:, n * d :] = rng.normal(size=(2 * p, p))
    for k in range(n):
        block = np.zeros((2 * d + 1, size))
        touched = slice(k * d, min(k + 2, n) * d)
        block[:, touched] = rng.normal(size=block[:, touched].shape)
        block[:, n * d :] = rng.normal(size=(2 * d + 1, p))
        rows.append(block)
    jacobian = np.concatenate(rows)
    residual = rng.normal(size=len(jacobian))
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    chain = normal[: n * d, : n * d].reshape(n, d, n, d)
    k = np.arange(n)
    system = ArrowSystem(
        diagonal=chain[k, :, k, :],
        coupling=chain[k[:-1], :, k[1:], :],
        border=normal[: n * d, n * d :].reshape(n, d, p),
        corner=normal[n * d :, n * d :],
        gradient=gradient[: n * d].reshape(n, d),
        corner_gradient=gradient[n * d :],
    )
    return system, normal, gradient


@pytest.mark.parametrize("d", [1, 2, 3, 60])
@pytest.mark.parametrize("n", [1, 2, 3, 16, 17, 23, 24, 25, 48, 49, 75])
def test_arrow_is_the_dense_inverse(n, d):
    if n * d > 300:
        n = 300 // d
    system, normal, gradient = random_system(n, d, 7, seed=100 * n + d)
    solution = solve_arrow(system)
    covariance = np.linalg.inv(normal)
    step = -covariance @ gradient
    close = {"rtol": 1e-8, "atol": 1e-9 * np.abs(covariance).max()}
    np.testing.assert_allclose(solution.states.ravel(), step[: n * d], **close)
    np.testing.assert_allclose(solution.corner, step[n * d :], **close)
    np.testing.assert_allclose(solution.corner_covariance, covariance[n * d :, n * d :], **close)
    np.testing.assert_allclose(solution.cross_covariance, covariance[: n * d, n * d :].reshape(n, d, 7), **close)
    chain = covariance[: n * d, : n * d].reshape(n, d, n, d)
    k = np.arange(n)
    np.testing.assert_allclose(solution.state_covariance, chain[k, :, k, :], **close)
    np.testing.assert_allclose(solution.next_covariance, chain[k[:-1], :, k[1:], :], **close)


def test_threes_that_are_tried_alone_lose_only_their_products_with_each_other():
    system, *_ = random_system(30, 2, 10, seed=4)
    whole, right, lowered = reduced_normal_equations(system)
    apart, same_right, same_lowered = reduced_normal_equations(system, 6)
    three = np.array([0, 0, 0, 0, 1, 2, 1, 2, 1, 2])
    told = (three[:, None] == three) | (three == 0) | (three[:, None] == 0)
    np.testing.assert_allclose(apart[told], whole[told], rtol=1e-12, atol=1e-12 * np.abs(whole).max())
    np.testing.assert_array_equal(same_right, right)
    assert same_lowered == lowered


def test_arrow_refuses_what_is_not_positive_definite():
    system, *_ = random_system(5, 2, 3, seed=1)
    for name in ("diagonal", "corner"):
        parts = {part: getattr(system, part) for part in ArrowSystem.__slots__}
        parts[name] = -parts[name]
        with pytest.raises(np.linalg.LinAlgError):
            solve_arrow(ArrowSystem(**parts))


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def freudenstein_roth(x):
    r = np.array([-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1]])
    return r, np.array([[1, 10 * x[1] - 3 * x[1] ** 2 - 2], [1, 3 * x[1] ** 2 + 2 * x[1] - 14]])


def beale(x):
    power = np.arange(1, 4)
    r = np.array([1.5, 2.25, 2.625]) - x[0] * (1 - x[1] ** power)
    return r, np.stack([x[1] ** power - 1, x[0] * power * x[1] ** (power - 1)], axis=1)


def kowalik_osborne(x):
    y = np.array([0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246])
    u = np.array([4.0, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
    top, bottom = u * u + u * x[1], u * u + u * x[2] + x[3]
    model = x[0] * top / bottom
    jacobian = np.stack([-top / bottom, -x[0] * u / bottom, model * u / bottom, model / bottom], axis=1)
    return y - model, jacobian


KNOWN = {  # start, minimum of the sum of squares (More, Garbow, Hillstrom 1981), where it lies
    "rosenbrock": (rosenbrock, [-1.2, 1.0], 0.0, [1.0, 1.0]),
    "rosenbrock from afar": (rosenbrock, [-12.0, 10.0], 0.0, [1.0, 1.0]),
    "freudenstein roth": (freudenstein_roth, [6.0, 5.0], 0.0, [5.0, 4.0]),
    "freudenstein roth, local": (freudenstein_roth, [0.5, -2.0], 48.98425, [11.41277, -0.896805]),
    "beale": (beale, [1.0, 1.0], 0.0, [3.0, 0.5]),
    "kowalik osborne": (
        kowalik_osborne,
        [0.25, 0.39, 0.415, 0.39],
        3.075056e-4,
        [0.192807, 0.191282, 0.123057, 0.136062],
    ),
}


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_known_minima_in_any_unit(name, unit):
    problem, start, least, where = KNOWN[name]
    units = unit ** np.arange(len(start))  # each parameter in a unit of its own

    def scaled(x):
        residual, jacobian = problem(x / units)
        return residual, jacobian / units

    solution = levenberg_marquardt(scaled, np.array(start) * units)
    assert solution.converged
    assert 2 * solution.cost == pytest.approx(least, rel=1e-6, abs=1e-20)
    np.testing.assert_allclose(solution.x / units, where, rtol=2e-5)


def test_linear_problem_takes_one_step():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(20, 6)), rng.normal(size=20)
    solution = levenberg_marquardt(lambda x: (a @ x - b, a), np.zeros(6))
    np.testing.assert_allclose(solution.x, np.linalg.lstsq(a, b, rcond=None)[0], rtol=1e-12)
    assert solution.converged
    assert solution.iterations <= 3  # the second sees that there is nothing left to do


@pytest.mark.parametrize("size", [1.0, 1e8])
def test_rank_deficient_problem_still_ends_at_a_minimum(size):
    rng = np.random.default_rng(5)
    a = size * rng.normal(size=(20, 4)) @ rng.normal(size=(4, 6))  # only four combinations of six are seen
    b = rng.normal(size=20)
    solution = levenberg_marquardt(lambda x: (a @ x - b, a), rng.normal(size=6))
    least = np.linalg.lstsq(a, b, rcond=None)[1]
    best = 0.5 * np.sum((a @ np.linalg.lstsq(a, b, rcond=1e-10)[0] - b) ** 2)
    assert least.size == 0  # it is rank deficient
    assert solution.converged
    assert solution.cost == pytest.approx(best, rel=1e-14 * size + 1e-9)  # a @ x cancels to that much


def test_parameter_that_nothing_depends_on_stays():
    def problem(x):
        r, j = rosenbrock(x[:2])
        return np.append(r, 0.0), np.pad(j, ((0, 1), (0, 1)))

    solution = levenberg_marquardt(problem, np.array([-1.2, 1.0, 7.0]))
    assert solution.converged
    np.testing.assert_allclose(solution.x, [1.0, 1.0, 7.0], rtol=1e-9)


def test_steps_out_of_the_domain_are_taken_back():
    # Newton's first step from 10 leaves the logarithm's domain.
    def problem(x):
        with np.errstate(invalid="ignore"):
            return np.log(x) - 1.0, np.array([1 / x])

    solution = levenberg_marquardt(problem, np.array([10.0]))
    assert solution.converged
    np.testing.assert_allclose(solution.x, np.e, rtol=1e-10)


def test_undamped_overshoot_is_damped():
    # For |x| > 1.39 Newton's steps on the arctangent grow without end.
    solution = levenberg_marquardt(lambda x: (np.arctan(x), np.array([1 / (1 + x * x)])), np.array([20.0]))
    assert solution.converged
    assert abs(solution.x[0]) < 1e-9


def test_says_when_it_did_not_settle():
    start = np.array([-1.2, 1.0])
    solution = levenberg_marquardt(rosenbrock, start, most_iterations=12)
    assert not solution.converged
    assert solution.iterations == 12
    assert solution.cost < 0.5 * np.sum(rosenbrock(start)[0] ** 2)  # what it has got is better than the start
