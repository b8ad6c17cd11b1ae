"""Several IMUs in the camera-IMU simulator: what each feels at its place, clocks, an accelerometer's own timestamps."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, OptionError, simulate_camera_imu
from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.simulate.camera_imu_streams import START_NS

ONE = CameraImuScenario(duration_s=3.0)
TWO = replace(
    ONE, imus=2, further_imu_rate_hz=160.0, imu_clock_offset_s=-321.5, accelerometer_rate_hz=125.0,
    accelerometer_delay_s=0.002, further_accelerometer_delay_s=-0.003,
)  # fmt: skip
EXACT = replace(TWO, noise_factor=0.0, pixel_noise_px=0.0)
STEP_S = 1e-3
"""Of the differences."""


def body_pose(simulation, t_s):
    """Return R_target_body and p_target_body of the body at instants (n,), from the path of cam0 alone."""
    R, p = simulation.trajectory.path.pose(t_s)
    T_cam_imu = simulation.truth.cameras["cam0"].T_cam_imu
    return R @ T_cam_imu[:3, :3], p + R @ T_cam_imu[:3, 3]


def felt(simulation, name, t_s, arm=(0.0, 0.0, 0.0)):
    """Return angular rate and specific force (n, 3) at a place in the frame of an IMU, by differences of its poses."""
    T = simulation.truth.imus[name].T_imu_body
    T = np.eye(4) if T is None else T
    place = T[:3, :3].T @ (np.array(arm) - T[:3, 3])  # in the body's frame

    def pose(instants):
        R, p = body_pose(simulation, instants)
        return R @ T[:3, :3].T, p + R @ place

    first = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    second = ((1, 3 / 2), (2, -3 / 20), (3, 1 / 90))
    R, p = pose(t_s)
    ahead, back = ([pose(t_s + sign * k * STEP_S) for k in (1, 2, 3)] for sign in (1, -1))
    R_dot = sum(w * (ahead[k - 1][0] - back[k - 1][0]) for k, w in first) / STEP_S
    curve = sum(w * (ahead[k - 1][1] + back[k - 1][1] - 2 * p) for k, w in second) / STEP_S**2
    spin = np.moveaxis(R, 1, 2) @ R_dot
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    return omega, np.einsum("nji,nj->ni", R, curve - simulation.gravity_target)


def body_time(simulation, name, samples):
    """Return the instants on the clock of imu0 [s] that go with the timestamps of a triad, as the truth has it."""
    calibration = simulation.truth.imus[name]
    shift_s = calibration.time_shift_s
    if samples is simulation.recording.imus[name].accelerometer:
        shift_s += calibration.accelerometer.time_shift_s or 0.0
    return (samples.t_ns - START_NS + round(shift_s * 1e9)) * 1e-9


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"imus": 3, "random_extrinsics": True, "imu_time_shift_range_s": 2.0},
        {"accelerometer_arms_m": (0.0, 0.03, 0.0, 0.01, 0.0, 0.02)},
    ],
)
def test_every_imu_feels_its_own_place_at_its_own_time(changes):
    simulation = simulate_camera_imu(replace(EXACT, **changes), seed=2)
    simulation = replace(simulation, truth=simulation.truth.with_origin("x"))  # where the g-sensitivity has its f
    assert len(simulation.recording.imus) == simulation.scenario.imus
    for name, samples in simulation.recording.imus.items():
        calibration, true = simulation.truth.imus[name], simulation.imus[name]
        omega, f = felt(simulation, name, body_time(simulation, name, samples.gyroscope))
        gyroscope, accelerometer = calibration.gyroscope, calibration.accelerometer
        rate = omega @ gyroscope.sensitivity.T + f @ gyroscope.g_sensitivity.T + true.b_g
        np.testing.assert_allclose(samples.gyroscope.values, rate, atol=1e-6)
        places = np.zeros((3, 3)) if accelerometer.lever_arms_m is None else accelerometer.lever_arms_m
        t_s = body_time(simulation, name, samples.accelerometer)
        f = np.stack([felt(simulation, name, t_s, places[k])[1][:, k] for k in range(3)], axis=1)
        force = f @ accelerometer.sensitivity.T + true.b_a
        np.testing.assert_allclose(samples.accelerometer.values, force, atol=2e-5)


def test_rates_clocks_and_delays_are_as_stated():
    simulation = simulate_camera_imu(TWO, seed=2)
    first, second = simulation.recording.imus.values()
    assert [round(s.gyroscope.rate_hz) for s in (first, second)] == [200, 160]
    assert [round(s.accelerometer.rate_hz) for s in (first, second)] == [125, 125]
    true = simulation.truth_parameters
    assert true["imu1.time_shift"] == pytest.approx(321.5 + 0.004, abs=1e-9)
    assert true["imu0.accelerometer_shift"] == -0.002
    assert true["imu1.accelerometer_shift"] == 0.003
    assert simulation.truth.imus["imu0"].time_shift_s == 0
    names = simulation.truth.uncertainty.names
    assert {"imu1.T_imu_body.rotation[2]", "imu1.time_shift_imu", "imu0.accelerometer.time_shift"} <= set(names)
    plain = simulate_camera_imu(replace(ONE, imus=2), seed=2)
    for imu in plain.recording.imus.values():
        np.testing.assert_array_equal(imu.accelerometer.t_ns, imu.gyroscope.t_ns)
    assert plain.truth.imus["imu1"].accelerometer.time_shift_s is None


def test_stated_places_and_rotations_stand_and_others_are_drawn():
    scenario = replace(ONE, imus=3, imu_places_m=((0.1, -0.02, 0.03),), imu_rotations_deg=((0, 90.0, 0),))
    first, second = (simulate_camera_imu(scenario, seed).truth.imus for seed in (1, 2))
    T = first["imu1"].T_imu_body
    np.testing.assert_allclose(T @ [0.1, -0.02, 0.03, 1], [0, 0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(rotvec_from_rotation(T[:3, :3]), [0, np.pi / 2, 0])
    np.testing.assert_array_equal(second["imu1"].T_imu_body, T)
    assert np.abs(first["imu2"].T_imu_body - second["imu2"].T_imu_body).max() > 0.1
    assert np.linalg.norm(first["imu2"].T_imu_body[:3, 3]) <= 0.15


def test_further_imus_and_cameras_leave_the_first_ones_as_they_were():
    alone, many = (simulate_camera_imu(scenario, seed=5) for scenario in (ONE, replace(
        ONE, imus=3, cameras=2, synchronous_cameras=False, clock_offset_difference_s=55.0, imu_clock_offset_s=9.0,
    )))  # fmt: skip
    for triad in ("accelerometer", "gyroscope"):
        before, after = (getattr(s.recording.imus["imu0"], triad) for s in (alone, many))
        np.testing.assert_array_equal(after.t_ns, before.t_ns)
        np.testing.assert_array_equal(after.values, before.values)
    np.testing.assert_array_equal(many.recording.cameras["cam0"].pixels, alone.recording.cameras["cam0"].pixels)
    rates = [many.recording.imus[name].gyroscope.values for name in ("imu1", "imu2")]
    assert np.abs(np.corrcoef(*(np.diff(rate[:500], axis=0)[:, 0] for rate in rates))[0, 1]) < 0.999


def test_each_imu_has_errors_and_noise_of_its_own_that_go_with_the_seeds():
    scenario = replace(ONE, imus=2, sensor_seed=7)
    first, second = (simulate_camera_imu(scenario, seed) for seed in (1, 2))
    for key in ("S_a", "M_g", "B_g", "q_bg", "T_imu_body.rotation"):
        np.testing.assert_array_equal(first.truth_parameters[f"imu1.{key}"], second.truth_parameters[f"imu1.{key}"])
    assert np.abs(first.truth_parameters["imu1.S_a"] - first.truth_parameters["imu0.S_a"]).max() > 1e-4
    walks = [s.imus["imu1"].b_g - s.imus["imu1"].b_g[0] for s in (first, second)]
    assert np.abs(walks[0] - walks[1])[1:].min(axis=0).max() > 0


def test_the_noise_of_each_triad_goes_with_its_own_rate():
    scenario = replace(ONE, duration_s=60.0, imus=2, imu="ideal", motion="static", accelerometer_rate_hz=100.0)
    for imu in simulate_camera_imu(scenario, seed=1).recording.imus.values():
        for triad, density, rate_hz in ((imu.accelerometer, 2e-3, 100.0), (imu.gyroscope, 1.7e-4, 200.0)):
            sigma = np.diff(triad.values, axis=0).std() / np.sqrt(2)
            assert sigma == pytest.approx(density * np.sqrt(rate_hz), rel=0.03)


def test_two_cameras_may_have_unrelated_clocks_and_instants():
    scenario = replace(
        EXACT, cameras=2, synchronous_cameras=False, clock_offset_s=12.0, clock_offset_difference_s=3600.0
    )
    simulation = simulate_camera_imu(scenario, seed=3)
    truth, frames = simulation.truth.cameras, simulation.recording.cameras
    apart_s = truth["cam0"].time_shift_cam_imu - truth["cam1"].time_shift_cam_imu
    assert apart_s == pytest.approx(3600.0 - 0.002, abs=1e-9)
    instants = [(frames[n].t_ns - START_NS) * 1e-9 + truth[n].time_shift_cam_imu for n in frames]
    step = 1 / scenario.camera_rate_hz
    assert abs((instants[1][0] - instants[0][0] + step / 2) % step - step / 2) > 0.001
    for name, seen in frames.items():
        R, p = body_pose(simulation, (seen.t_ns - START_NS)[seen.frame] * 1e-9 + truth[name].time_shift_cam_imu)
        points = simulation.target.points[seen.point]
        p_cam = np.einsum("nji,nj->ni", R, points - p) @ truth[name].T_cam_imu[:3, :3].T + truth[name].T_cam_imu[:3, 3]
        np.testing.assert_allclose(seen.pixels, truth[name].camera.project(p_cam).pixels, atol=1e-3)


def test_samples_are_lost_from_every_imu():
    simulation = simulate_camera_imu(replace(EXACT, dropped_samples=0.1, imu_gaps_s=((1.0, 0.5),)), seed=4)
    for name, imu in simulation.imus.items():
        for triad, biases in ((imu.samples.accelerometer, imu.b_a), (imu.samples.gyroscope, imu.b_g)):
            assert len(triad) == len(biases)
            t_s = body_time(simulation, name, triad)
            assert not ((t_s > 1.004) & (t_s < 1.496)).any()  # an accelerometer is up to 3 ms late
            assert len(triad) == pytest.approx(0.9 * 2.5 * triad.rate_hz, rel=0.1)
        np.testing.assert_allclose(imu.trajectory.t_s, body_time(simulation, name, imu.samples.gyroscope), atol=2e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"imus": 0}, "imus 0 is out of range. Give a number from 1"),
        ({"imu_places_m": ((0, 0, 0),)}, "imu_places_m: found 1 of them for 0 IMUs beside imu0"),
        ({"imus": 2, "imu_rotations_deg": ((0, float("nan"), 0),)}, "imu_rotations_deg nan is not a finite number"),
        ({"accelerometer_rate_hz": 0.0}, "accelerometer_rate_hz 0 is out of range"),
        ({"accelerometer_rate_hz": 0.5}, "too short for two samples"),
    ],
)
def test_impossible_imus_are_refused(changes, message):
    with pytest.raises(OptionError, match=message):
        replace(ONE, **changes)
