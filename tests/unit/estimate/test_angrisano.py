"""Angrisano's method, equation by equation."""

import numpy as np
import pytest

from gnomon.errors import InitialisationError, OptionError
from gnomon.estimate.triads.angrisano import (
    TOLERANCE,
    canonical_parameters,
    datasheet_start,
    design_matrix,
    fit_components,
    fit_magnitudes,
    predict_magnitudes,
    sensor_jacobian,
)
from gnomon.models.angrisano import AngrisanoTriad, alignment_derivatives, alignment_matrix, angles_and_scales
from gnomon.models.forms import AngrisanoAccelerometer
from gnomon.simulate import PoseScenario, simulate_poses
from gnomon.simulate.imu import TABLE_1, rest_directions

GRAVITY = 9.80665
X = TABLE_1.parameters
START = datasheet_start(16, 50.0)
GEOMETRIES = ("small-angle", "exact")


def forces(count=18, error=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = rest_directions(PoseScenario()) + error * rng.standard_normal((18, 3))
    return GRAVITY * (u / np.linalg.norm(u, axis=1, keepdims=True))[:count]


def readings(geometry="small-angle", parameters=X, **kwargs):
    return AngrisanoTriad.from_parameters(parameters, geometry).predict(forces(**kwargs))


def numerical(function, x, step):
    columns = [
        (function(x + h) - function(x - h)) / (2 * s)
        for h, s in zip(np.diag(step * np.ones(len(x))), np.broadcast_to(step, len(x)), strict=True)
    ]
    return np.stack(columns, axis=-1)


STEP = np.repeat([1e-5, 1.0, 1e-8], 3)


def test_design_is_equation_6_with_its_sign_of_the_x_bias_corrected():
    (ax, ay, az), (bx, by, bz), (kx, ky, kz) = X.reshape(3, 3)
    for (x, y, z), A in zip(readings(), design_matrix(X, readings()), strict=True):
        printed = np.array([
            [0, -kz * (z - bz), 0],
            [-kz * (z - bz), 0, 0],
            [-ky * (y - by), 0, 0],
            [+kx, 0, 0],  # the document prints a minus
            [az * ky, ky, 0],
            [ay * kz, ax * kz, kz],
            [-(x - bx), 0, 0],
            [-az * (y - by), -(y - by), 0],
            [-ay * (z - bz), -ax * (z - bz), -(z - bz)],
        ])  # fmt: skip
        np.testing.assert_allclose(A.T, printed, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_design_is_the_derivative_of_equation_5(geometry):
    there = X + np.repeat([0.2, 30.0, 1e-4], 3)
    measured = readings()
    by_hand = -numerical(lambda x: predict_magnitudes(x, measured, geometry), there, STEP)
    A = design_matrix(there, measured, geometry)
    np.testing.assert_allclose(A * STEP, by_hand * STEP, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_sensor_jacobian_is_that_of_the_conversion(geometry):
    def sensor(x):
        sensitivity, bias = AngrisanoTriad.from_parameters(x, geometry).to_sensor()
        return np.concatenate([sensitivity.ravel(), bias])

    there = X + np.repeat([0.1, 0.0, 0.0], 3)
    np.testing.assert_allclose(
        sensor_jacobian(there, geometry) * STEP, numerical(sensor, there, STEP) * STEP, rtol=2e-4, atol=1e-6
    )


def test_alignment_is_equation_14_or_15():
    x, y, z = angles = np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(alignment_matrix(angles, "small-angle"), [[1, z, y], [0, 1, x], [0, 0, 1]])
    s, c = np.sin, np.cos
    exact = [[1, s(z), c(x) * s(y)], [0, c(z), c(y) * s(x)], [0, 0, c(x) * c(y)]]
    np.testing.assert_allclose(alignment_matrix(angles, "exact"), exact)
    for geometry in GEOMETRIES:
        by_hand = numerical(lambda a, g=geometry: alignment_matrix(a, g), angles, 1e-6 * np.ones(3))
        np.testing.assert_allclose(np.moveaxis(alignment_derivatives(angles, geometry), 0, -1), by_hand, atol=1e-9)


def test_both_geometries_agree_to_second_order():
    for size in (1e-2, 1e-3):
        angles = size * np.array([1.0, -0.7, 0.4])
        gap = np.abs(alignment_matrix(angles, "exact") - alignment_matrix(angles, "small-angle")).max()
        assert 0.1 * size**2 < gap < size**2


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_forms_hold_the_same_sensor(geometry):
    truth = AngrisanoTriad(angles=np.array([0.2, -0.15, 0.1]), b=X[3:6], K=X[6:], geometry=geometry)
    sensitivity, bias = truth.to_sensor()
    for other in GEOMETRIES:
        form = AngrisanoTriad.from_sensor(sensitivity, bias, other)
        np.testing.assert_allclose(form.to_sensor()[0], sensitivity, rtol=1e-13, atol=1e-10)
        np.testing.assert_allclose(form.predict(forces()), truth.predict(forces()), rtol=1e-13)
    np.testing.assert_allclose(AngrisanoTriad.from_sensor(sensitivity, bias, geometry).parameters, truth.parameters)
    older = AngrisanoAccelerometer.from_sensor(sensitivity, bias)
    np.testing.assert_allclose(older.T * older.K, truth.correction, rtol=1e-13, atol=1e-18)


def test_a_triad_without_an_axis_has_no_angles():
    with pytest.raises(OptionError, match="z axis"):
        angles_and_scales(np.diag([1.0, 1.0, 0.0]), "exact")


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_noiseless_components_are_recovered(geometry):
    fit = fit_components(readings(geometry), forces(), START, geometry=geometry)
    assert fit.status == "converged"
    np.testing.assert_allclose(fit.parameters, X, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_noiseless_magnitudes_are_recovered(geometry):
    fit = fit_magnitudes(readings(geometry), GRAVITY, START, geometry=geometry)
    assert fit.converged
    np.testing.assert_allclose(fit.parameters, X, rtol=1e-9, atol=1e-10)


def test_four_known_attitudes_and_nine_magnitudes_are_enough():
    four = fit_components(readings(count=4), forces(count=4), START)
    nine = fit_magnitudes(readings(count=9, error=0.2), GRAVITY, START)
    for fit in (four, nine):
        assert fit.converged
        np.testing.assert_allclose(fit.parameters, X, rtol=1e-6, atol=1e-6)
    assert np.isnan(nine.sigma).all()
    for fit, poses in ((fit_components, 3), (fit_magnitudes, 8)):
        reference = forces(count=poses) if fit is fit_components else GRAVITY
        with pytest.raises(InitialisationError, match=f"{poses} poses"):
            fit(readings(count=poses), reference, START)


def test_exact_and_small_angles_are_the_same_sensor():
    simulation = simulate_poses(PoseScenario(attitude_error_deg=10), seed=3)
    small, exact = (fit_magnitudes(simulation.accelerometer, GRAVITY, START, geometry=g, tolerance=1e-9)
                    for g in GEOMETRIES)  # fmt: skip
    sigma = np.sqrt(np.diag(small.sensor_covariance))
    assert np.abs(small.sensitivity - exact.sensitivity).max() < 1e-3 * sigma[:9].max()
    np.testing.assert_allclose(exact.sensor_covariance, small.sensor_covariance, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_four_to_five_iterations_from_the_datasheet_and_the_stop_rule(seed):
    simulation = simulate_poses(PoseScenario(attitude_error_deg=(1.0, 10.0)[seed % 2]), seed=seed)
    fit = fit_magnitudes(simulation.accelerometer, GRAVITY, START)
    assert fit.converged
    assert fit.iterations in (4, 5)
    assert fit.visited.shape == (fit.iterations + 1, 9)
    np.testing.assert_array_equal(fit.visited[0], START)
    fall = -np.diff(fit.q) / fit.q[1:]
    assert (fall[:-1] > TOLERANCE).all()
    assert fall[-1] <= TOLERANCE


def test_sigmas_are_those_of_ordinary_least_squares():
    simulation = simulate_poses(seed=1)
    fit = fit_magnitudes(simulation.accelerometer, GRAVITY, START)
    before = fit.visited[-2]
    N, A = predict_magnitudes(before, simulation.accelerometer), design_matrix(before, simulation.accelerometer)
    H = np.einsum("ni,nij->nj", N, A) / STEP**-1
    covariance = fit.q[-1] / 9 * np.linalg.inv(H.T @ H) * np.outer(STEP, STEP)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-6)
    assert fit.residual_rms == pytest.approx(np.sqrt(fit.q[-1] / 9) / GRAVITY)
    assert fit.group_sigma.shape == (3,)


def moved(group, by):
    start = START.copy()
    start[3 * group : 3 * group + 3] += by
    return start


@pytest.mark.parametrize(
    ("start", "right"),
    [
        (moved(0, np.radians(-18)), True),
        (moved(0, np.radians(19)), True),
        (moved(0, np.radians(80)), False),
        (moved(1, -1200), True),
        (moved(1, 1800), True),
        (moved(1, -4000), False),
        (moved(1, 6000), False),
        (moved(2, -0.0004), True),
        (moved(2, 0.03), True),
        (moved(2, -0.0010), False),
        (moved(2, 0.06), False),
    ],
)
def test_table_2(start, right):
    measured = simulate_poses(PoseScenario(), seed=2).accelerometer
    fit = fit_magnitudes(measured, GRAVITY, start)
    assert fit.converged == right
    if right:
        nearby = fit_magnitudes(measured, GRAVITY, START)
        assert np.abs((fit.parameters - nearby.parameters) / nearby.sigma).max() < 0.1
    else:
        assert fit.status in ("wrong", "diverged", "not finished")


def test_growth_of_q_meets_the_rule_as_printed():
    measured = simulate_poses(PoseScenario(), seed=2).accelerometer
    start = moved(0, np.radians(-30))
    assert fit_magnitudes(measured, GRAVITY, start).converged
    printed = fit_magnitudes(measured, GRAVITY, start, growth_stops=True)
    assert printed.status == "wrong"
    assert printed.q[-1] > printed.q[-2]


def test_a_reversed_axis_is_a_mirrored_minimum_and_its_canonical_form_is_the_right_one():
    measured = simulate_poses(PoseScenario(), seed=2).accelerometer
    right = fit_magnitudes(measured, GRAVITY, START)
    start = START.copy()
    start[7] = -start[7]
    mirrored = fit_magnitudes(measured, GRAVITY, start)
    assert mirrored.status == "mirrored"
    assert mirrored.parameters[7] < 0
    np.testing.assert_allclose(canonical_parameters(mirrored.parameters), right.parameters, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(canonical_parameters(right.parameters), right.parameters, rtol=1e-12, atol=1e-15)


def test_poses_that_determine_nothing_end_without_an_exception():
    flat = np.tile(readings(count=1), (12, 1))
    fit = fit_magnitudes(flat, GRAVITY, START)
    assert fit.status == "diverged"
    np.testing.assert_array_equal(fit.parameters, START)


def test_the_number_of_iterations_is_bounded():
    assert fit_magnitudes(readings(), GRAVITY, START, most_iterations=2).status == "not finished"


def test_magnitudes_may_differ_from_pose_to_pose():
    factor = np.linspace(0.5, 2.0, 18)
    measured = TABLE_1.predict(forces() * factor[:, None])
    fit = fit_magnitudes(measured, GRAVITY * factor, START)
    np.testing.assert_allclose(fit.parameters, X, rtol=1e-8, atol=1e-9)
