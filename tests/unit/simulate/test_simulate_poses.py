"""Simulated poses are what their truth says."""

import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.simulate import PoseScenario, simulate_poses
from gnomon.simulate.imu import TABLE_1, rest_directions

QUIET = {"accelerometer_noise_density": 0.0, "gyroscope_noise_density": 0.0, "samples": 4}
EXACT = {**QUIET, "sensor": "drawn", "units": "si"}
B_G = (-1.4e-5, -0.1e-5, 1.8e-5, -2.6e-5, 1.3e-4, 1.2e-4, 3.5e-5, -1.5e-4, -1.5e-4)


@pytest.mark.parametrize(("attitudes", "count"), [("angrisano18", 18), ("six", 6), ("seven", 7), ("sphere", 24)])
def test_sets_of_attitudes(attitudes, count):
    u = rest_directions(PoseScenario(attitudes=attitudes))
    assert u.shape == (count, 3)
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1.0)
    assert len(np.unique(u.round(9), axis=0)) == min(count, 24 if attitudes != "seven" else 6)
    assert np.linalg.matrix_rank(u) == 3


def test_document_b_goes_from_minus_z_over_all_faces_back_to_it():
    order = [(0, 0, -1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, -1)]
    np.testing.assert_array_equal(rest_directions(PoseScenario(attitudes="seven")), order)


def test_readings_follow_the_truth():
    simulation = simulate_poses(PoseScenario(**EXACT, attitude_error_deg=5.0, g_sensitivity=B_G), seed=4)
    imu = simulation.truth.imus["imu0"]
    np.testing.assert_allclose(imu.accelerometer.specific_force(simulation.accelerometer), simulation.force, atol=1e-12)
    rate = imu.gyroscope.angular_rate(simulation.gyroscope, simulation.force)
    np.testing.assert_allclose(rate, 0.0, atol=1e-15)
    np.testing.assert_allclose(imu.gyroscope.g_sensitivity.ravel(), B_G)
    np.testing.assert_allclose(np.linalg.norm(simulation.force, axis=1), 9.80665)
    means = [pose.accelerometer.values.mean(axis=0) for pose in simulation.poses]
    np.testing.assert_allclose(simulation.accelerometer, means)


def test_tilts_have_the_accuracy_that_was_asked_for():
    scenario = PoseScenario(**EXACT, attitudes="sphere", poses=2000, attitude_error_deg=2.0)
    simulation = simulate_poses(scenario, seed=1)
    sine = np.linalg.norm(np.cross(simulation.force, simulation.meant), axis=1) / 9.80665**2
    assert np.degrees(np.sqrt(np.mean(np.arcsin(sine) ** 2))) == pytest.approx(2.0 * np.sqrt(2), rel=0.05)


def test_the_jig_is_turned_against_the_sensor():
    simulation = simulate_poses(
        PoseScenario(**EXACT, attitude_error_deg=0.0, jig_rotation_deg=(0.0, 0.0, 90.0)), seed=1
    )
    x, y, z = simulation.meant.T
    np.testing.assert_allclose(simulation.force, np.column_stack([-y, x, z]), atol=1e-14)


def test_noise_of_the_means_and_steps_of_the_converter():
    scenario = PoseScenario(attitudes="sphere", poses=400, samples=50, rate_hz=200.0, accelerometer_noise_density=4e-3)
    simulation = simulate_poses(scenario, seed=1)
    ideal = TABLE_1.predict(simulation.force)
    spread = np.std((simulation.accelerometer - ideal) / np.diag(TABLE_1.to_sensor()[0]))
    assert spread == pytest.approx(4e-3 / np.sqrt(50 / 200), rel=0.1)
    values = simulation.poses[0].accelerometer.values
    np.testing.assert_array_equal(values, np.rint(values))
    assert values.dtype == np.float64


def test_the_gyroscope_drifts_and_the_truth_is_its_mean():
    simulation = simulate_poses(PoseScenario(**EXACT, attitudes="seven", gyroscope_drift=1e-4), seed=1)
    bias = simulation.gyroscope - simulation.truth.imus["imu0"].gyroscope.bias
    np.testing.assert_allclose(bias[-1] - bias[0], 1e-4, rtol=0.01)
    np.testing.assert_allclose(bias.mean(axis=0), 0.0, atol=1e-12)
    slope = np.polyfit(simulation.t_s, bias[:, 0], 1)
    np.testing.assert_allclose(bias[:, 0], np.polyval(slope, simulation.t_s), atol=1e-12)


def test_the_earth_turns():
    scenario = PoseScenario(**EXACT, earth_rate_latitude=45.4)
    simulation = simulate_poses(scenario, seed=1)
    gyroscope = simulation.truth.imus["imu0"].gyroscope
    rate = gyroscope.angular_rate(simulation.gyroscope, simulation.force)
    np.testing.assert_allclose(np.linalg.norm(rate, axis=1), 7.292115e-5, rtol=1e-9)
    vertical = np.sum(rate * simulation.force, axis=1) / 9.80665
    np.testing.assert_allclose(vertical, 7.292115e-5 * np.sin(np.radians(45.4)), rtol=1e-9)


def test_poses_follow_each_other_on_one_clock():
    simulation = simulate_poses(PoseScenario(samples=10, rate_hz=50.0, wait_s=7.0), seed=1)
    starts = [pose.accelerometer.t_ns[0] for pose in simulation.poses]
    np.testing.assert_array_equal(np.diff(starts), 7_200_000_000)
    assert simulation.t_s[0] == pytest.approx(0.09)


def test_the_same_seed_gives_the_same_experiment_and_the_sensor_has_a_seed_of_its_own():
    scenario = PoseScenario(sensor="drawn", sensor_seed=5)
    first, again, other = (simulate_poses(scenario, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.accelerometer, again.accelerometer)
    assert np.abs(first.accelerometer - other.accelerometer).max() > 0
    np.testing.assert_array_equal(
        first.truth.imus["imu0"].accelerometer.sensitivity, other.truth.imus["imu0"].accelerometer.sensitivity
    )


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"poses": 0}, "poses"),
        ({"samples": 0}, "samples"),
        ({"gravity": -1.0}, "gravity"),
        ({"attitude_error_deg": -1.0}, "attitude_error_deg"),
        ({"bits": 1, "sensor": "drawn"}, "bits"),
        ({"earth_rate_latitude": 100.0}, "earth_rate_latitude"),
        ({"units": "si"}, "angrisano"),
        ({"units": "miles", "sensor": "drawn"}, "miles"),
    ],
)
def test_impossible_scenarios_are_refused(options, word):
    with pytest.raises(OptionError, match=word):
        PoseScenario(**options)
