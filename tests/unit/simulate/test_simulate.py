"""The simulator: its motion is physically consistent, its noise is as stated, and it repeats itself."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import OptionError, Scenario, simulate
from gnomon.geometry.rotations import rk4n_steps, rotation_from_quaternion, running_products

QUIET = Scenario(
    intervals=12,
    t_init_s=5.0,
    accelerometer_noise_density=0.0,
    gyroscope_noise_density=0.0,
    g_sensitivity=3e-4,
)


def true_signals(scenario, seed):
    recording, truth = simulate(scenario, seed)
    samples = truth.imus["imu0"].apply(recording.imus["imu0"])
    return samples.accelerometer.t_s, samples.accelerometer.values, samples.gyroscope.values


def resting(rate):
    return np.linalg.norm(rate, axis=1) < 1e-12


@pytest.mark.parametrize("style", ["hand", "thesis"])
@pytest.mark.parametrize("seed", [1, 2])
def test_gyroscope_turns_gravity_as_the_accelerometer_shows(style, seed):
    # What is left is the integrator's straight line between samples of the rate, and grows with the step squared.
    scenario = replace(QUIET, style=style, rate_hz=1000.0)
    t_s, force, rate = true_signals(scenario, seed)
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(t_s))
    attitude = rotation_from_quaternion(running_products(steps, np.array([len(steps)])))
    predicted = np.einsum("nji,j->ni", attitude, force[0])
    still = resting(rate[1:])
    np.testing.assert_allclose(predicted[still], force[1:][still], atol=2e-5 * 9.81)
    assert np.ptp(force[1:][still], axis=0).min() > 9.81  # it did turn over


@pytest.mark.parametrize("style", ["hand", "thesis"])
def test_specific_force_at_rest_is_gravity(style):
    _, force, rate = true_signals(replace(QUIET, style=style, gravity=9.79), 3)
    still = resting(rate)
    assert 0.5 < still.mean() < 0.9
    np.testing.assert_allclose(np.linalg.norm(force[still], axis=1), 9.79, atol=1e-9)
    assert np.abs(np.linalg.norm(force[~still], axis=1) - 9.79).max() > 0.2


def test_translation_of_a_hand_motion_ends_at_rest():
    scenario = replace(QUIET, rate_hz=500.0, intervals=6)
    t_s, force, rate = true_signals(scenario, 4)
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(t_s))
    attitude = rotation_from_quaternion(running_products(steps, np.array([len(steps)])))
    acceleration = np.einsum("nij,nj->ni", attitude, force[1:]) - force[0]  # in the first attitude's axes
    assert np.linalg.norm(acceleration, axis=1).max() > 0.2
    np.testing.assert_allclose(acceleration.sum(axis=0) / 500.0, 0.0, atol=1e-3)  # velocity at the end


def test_attitudes_cover_the_sphere():
    _, force, rate = true_signals(replace(QUIET, intervals=30), 5)
    still = resting(rate)
    starts = np.flatnonzero(np.diff(still.astype(int), prepend=0) == 1)
    up = force[starts] / np.linalg.norm(force[starts], axis=1)[:, None]
    assert len(up) == 30
    nearest = np.sort(np.degrees(np.arccos(np.clip(up @ up.T, -1, 1))), axis=1)[:, 1]
    assert nearest.min() > 15
    assert np.linalg.norm(up.mean(axis=0)) < 0.05


def test_noise_has_the_stated_density():
    scenario = Scenario(intervals=2, t_init_s=200.0, rate_hz=50.0, gyroscope_rate_hz=200.0)
    recording, _ = simulate(scenario, 6)
    for triad, density in (
        (recording.imus["imu0"].accelerometer, scenario.accelerometer_noise_density),
        (recording.imus["imu0"].gyroscope, scenario.gyroscope_noise_density),
    ):
        rest = triad.values[triad.t_s < 200.0]
        expected = density * np.sqrt(triad.rate_hz)
        np.testing.assert_allclose(rest.std(axis=0), expected, rtol=4 / np.sqrt(2 * len(rest)))
        lag_one = np.mean((rest[1:] - rest.mean(axis=0)) * (rest[:-1] - rest.mean(axis=0)), axis=0) / expected**2
        np.testing.assert_allclose(lag_one, 0.0, atol=4 / np.sqrt(len(rest)))


def test_bias_walk_grows_as_stated_and_has_no_mean():
    scenario = replace(QUIET, intervals=2, t_init_s=4000.0, rate_hz=10.0)
    still, _ = simulate(scenario, 7)
    walking, _ = simulate(replace(scenario, gyroscope_bias_walk=1e-4), 7)
    walk = walking.imus["imu0"].gyroscope.values - still.imus["imu0"].gyroscope.values
    np.testing.assert_allclose(walk.mean(axis=0), 0.0, atol=1e-12)
    increments = walk[100::100] - walk[:-100:100]  # over 10 s
    np.testing.assert_allclose(increments.std(), 1e-4 * np.sqrt(10), rtol=4 / np.sqrt(2 * increments.size))


def test_counts_are_whole_unsigned_and_saturate():
    scenario = Scenario(intervals=8, t_init_s=5.0, units="raw", bits=12, accelerometer_range=9.0)
    samples = simulate(scenario, 8)[0].imus["imu0"]
    for triad in (samples.accelerometer, samples.gyroscope):
        assert triad.unit == "count"
        np.testing.assert_array_equal(triad.values, np.rint(triad.values))
        assert triad.values.min() >= 0
        assert triad.values.max() <= 4095
    assert (samples.accelerometer.values == 4095).any()  # one g is beyond 9 m/s^2
    assert (samples.gyroscope.values < 4095).all()


def test_units_only_relabel_the_readings():
    si = simulate(QUIET, 9)[0].imus["imu0"]
    other = simulate(replace(QUIET, units="g deg/s"), 9)[0].imus["imu0"]
    np.testing.assert_allclose(other.accelerometer.values * 9.80665, si.accelerometer.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.radians(other.gyroscope.values), si.gyroscope.values, rtol=1e-12, atol=1e-12)


def test_quantised_readings_are_within_half_a_step():
    exact = simulate(QUIET, 10)[0].imus["imu0"].gyroscope.values
    quantised = simulate(replace(QUIET, bits=10), 10)[0].imus["imu0"].gyroscope.values
    step = 2 * QUIET.gyroscope_range / (2**10 - 1)
    assert np.abs(quantised - exact).max() <= step / 2 * (1 + 1e-9)
    assert len(np.unique(quantised)) < 1024


def test_earth_rate_is_what_a_resting_gyroscope_feels():
    scenario = replace(QUIET, earth_rate_latitude=45.0)
    _, force, rate = true_signals(scenario, 11)
    still = resting(true_signals(QUIET, 11)[2])
    np.testing.assert_allclose(np.linalg.norm(rate[still], axis=1), 7.292115e-5, atol=1e-7)
    vertical = np.einsum("ni,ni->n", rate[still], force[still]) / np.linalg.norm(force[still], axis=1)
    np.testing.assert_allclose(vertical, 7.292115e-5 * np.sqrt(0.5), atol=1e-7)


def test_touches_disturb_only_static_intervals_after_the_first():
    calm = true_signals(QUIET, 12)
    touched = true_signals(replace(QUIET, touched=3), 12)
    changed = np.linalg.norm(touched[1] - calm[1], axis=1) > 1e-6
    assert not changed[calm[0] < QUIET.t_init_s].any()
    assert resting(calm[2])[changed].all()
    assert np.count_nonzero(np.diff(changed.astype(int)) == 1) == 3
    assert np.abs(touched[1] - calm[1]).max() == pytest.approx(0.05, rel=0.7)


def test_stamps_jitter_round_and_get_lost_as_stated():
    scenario = replace(QUIET, t_init_s=200.0, stamp_jitter_s=2e-4, stamp_resolution_s=1e-3, dropped=0.05)
    samples = simulate(scenario, 13)[0].imus["imu0"]
    ideal = simulate(replace(QUIET, t_init_s=200.0), 13)[0].imus["imu0"]
    stamps = samples.gyroscope.t_ns
    np.testing.assert_array_equal(stamps, samples.accelerometer.t_ns)  # one packet
    np.testing.assert_array_equal(stamps % 1_000_000, 0)
    assert len(stamps) / len(ideal.gyroscope) == pytest.approx(0.95, abs=0.01)
    offset_ns = stamps - np.rint(stamps / 10_000_000) * 10_000_000
    assert 0 < np.abs(offset_ns).max() <= 2_000_000


def test_the_same_seed_gives_the_same_recording_and_another_a_different_one():
    first, again, other = (simulate(Scenario(intervals=5, t_init_s=3.0), seed) for seed in (1, 1, 2))
    values = [recording.imus["imu0"].gyroscope.values for recording, _ in (first, again, other)]
    np.testing.assert_array_equal(values[0], values[1])
    assert values[0].shape != values[2].shape or not np.array_equal(values[0], values[2])
    bias = "imu0.gyroscope.bias"
    np.testing.assert_array_equal(first[1].parameter(bias), again[1].parameter(bias))
    assert not np.array_equal(first[1].parameter(bias), other[1].parameter(bias))


def test_sensor_seed_keeps_the_sensor():
    scenario = Scenario(intervals=3, t_init_s=3.0, sensor_seed=5)
    (one, truth_one), (two, truth_two) = (simulate(scenario, seed) for seed in (1, 2))
    path = "imu0.gyroscope.sensitivity"
    np.testing.assert_array_equal(truth_one.parameter(path), truth_two.parameter(path))
    assert len(one.imus["imu0"].gyroscope) != len(two.imus["imu0"].gyroscope)


def test_truth_is_in_frame_accel_x_and_says_where_it_comes_from():
    _, truth = simulate(replace(QUIET, g_sensitivity=0.0), 14)
    assert truth.frame == "accel-x"
    assert truth.verdict == "pass"
    assert truth.assessment.model == "basic"
    assert truth.provenance.seed == 14
    assert truth.provenance.options == {
        "intervals": "12",
        "t_init_s": "5.0",
        "accelerometer_noise_density": "0.0",
        "gyroscope_noise_density": "0.0",
    }
    sensitivity = truth.parameter("imu0.accelerometer.sensitivity")
    np.testing.assert_array_equal(np.triu(sensitivity, k=1), 0.0)
    np.testing.assert_array_equal(truth.uncertainty.matrix, 0.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"intervals": 1},
        {"hold_s": (3.0, 2.0)},
        {"rate_hz": 0.0},
        {"dropped": 1.0},
        {"bits": 1},
        {"touched": 40},
        {"touched": 1, "style": "thesis"},
        {"units": "furlong"},
        {"accelerometer_noise_density": -1.0},
        {"earth_rate_latitude": 91.0},
    ],
)
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        Scenario(**wrong)
