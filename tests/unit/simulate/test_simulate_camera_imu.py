"""The camera-IMU simulator: exact derivatives, the model of Table 4.1, stated motions and faults, repeatable."""

import inspect
import re
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, OptionError, simulate_camera_imu
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.simulate.camera_imu_streams import START_NS

SHORT = CameraImuScenario(duration_s=6.0)
EXACT = replace(SHORT, noise_factor=0.0, pixel_noise_px=0.0)
MOTIONS = ("gentle", "normal", "tremor", "shaky", "static", "one-axis", "translation", "rolling")
LIVELY = MOTIONS[:4]


def slope(function, t_s, step_s):
    """Return the derivative of a function of time by differences of sixth order."""
    weights = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    return sum(w * (function(t_s + k * step_s) - function(t_s - k * step_s)) for k, w in weights) / step_s


@pytest.mark.parametrize("motion", MOTIONS)
def test_rates_and_accelerations_are_the_derivatives_of_the_path(motion):
    trajectory = simulate_camera_imu(replace(SHORT, motion=motion, random_extrinsics=True), seed=1).trajectory
    t_s = np.random.default_rng(1).uniform(0.1, 5.9, 200)
    at, step_s = trajectory.at, 1e-3
    motion_then = at(t_s)
    R = motion_then.R_target_body
    np.testing.assert_allclose(R @ np.moveaxis(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    assert (np.linalg.det(R) > 0).all()
    spin = np.moveaxis(R, 1, 2) @ slope(lambda t: at(t).R_target_body, t_s, step_s)
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    scale = np.linalg.norm(motion_then.alpha, axis=1).mean() + 1e-3
    np.testing.assert_allclose(motion_then.omega, omega, atol=1e-8 * scale)
    np.testing.assert_allclose(motion_then.alpha, slope(lambda t: at(t).omega, t_s, step_s), atol=1e-7 * scale)
    velocity = slope(lambda t: at(t).p_target_body, t_s, step_s)
    np.testing.assert_allclose(motion_then.velocity, velocity, atol=1e-8)
    acceleration = slope(lambda t: at(t).velocity, t_s, step_s)
    np.testing.assert_allclose(motion_then.acceleration, acceleration, atol=1e-6)


def test_a_path_is_the_same_however_many_instants_are_asked_for():
    path = simulate_camera_imu(SHORT, seed=1).trajectory.path
    t_s = np.linspace(0, 6, 9001)
    R, p = path.pose(t_s)
    motion = path.at(t_s)
    np.testing.assert_allclose(motion.R_target_body, R, atol=1e-15)
    np.testing.assert_allclose(motion.p_target_body, p, atol=1e-15)
    np.testing.assert_allclose(path.at(t_s[7000:7001]).acceleration, motion.acceleration[7000:7001], atol=1e-12)


@pytest.mark.first(1)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_motions_are_as_lively_as_stated(seed):
    found = {
        motion: simulate_camera_imu(CameraImuScenario(motion=motion), seed).statistics
        for motion in (*LIVELY, "rolling")
    }
    stated = {"gentle": (0.366, 3.12), "normal": (0.75, 3.9), "tremor": (0.75, 3.9), "shaky": (1.5, 10.0)}
    for motion, (rate, acceleration) in stated.items():
        assert found[motion].mean_rate_rad_s == pytest.approx(rate, rel=0.03)
        assert found[motion].mean_acceleration_m_s2 == pytest.approx(acceleration, rel=0.03)
        assert found[motion].visible["cam0"] > 0.85
    assert found["rolling"].visible["cam0"] > 0.7


def spectrum_above(simulation, hz):
    """Return the share of the angular rate's power above a frequency."""
    rate = simulation.trajectory.omega_imu * np.hanning(len(simulation.trajectory.t_s))[:, None]
    power = (np.abs(np.fft.rfft(rate, axis=0)) ** 2).sum(axis=1)
    return power[np.fft.rfftfreq(len(rate), 1 / 200.0) > hz].sum() / power.sum()


def test_motions_reach_the_frequencies_stated():
    scenario = CameraImuScenario(duration_s=30.0)
    of = {motion: simulate_camera_imu(replace(scenario, motion=motion), seed=2) for motion in LIVELY}
    assert spectrum_above(of["gentle"], 3.0) < 1e-3
    assert spectrum_above(of["normal"], 4.0) < 1e-4
    assert spectrum_above(of["tremor"], 6.0) > 0.01
    assert spectrum_above(of["tremor"], 13.0) < 1e-4
    assert spectrum_above(of["shaky"], 12.0) > 0.01
    assert spectrum_above(of["shaky"], 21.0) < 1e-4


def test_motions_that_leave_parameters_undetermined():
    of = {m: simulate_camera_imu(replace(SHORT, motion=m), seed=1).trajectory for m in MOTIONS}
    assert np.abs(of["static"].omega_imu).max() == 0
    assert np.ptp(of["static"].p_target_imu, axis=0).max() < 1e-15
    assert np.abs(of["translation"].omega_imu).max() == 0
    assert np.ptp(of["translation"].p_target_imu, axis=0).min() > 0.1
    spread = np.linalg.svd(of["one-axis"].omega_imu, compute_uv=False)
    assert spread[0] > 1
    assert spread[1] < 1e-12 * spread[0]
    rolled = of["rolling"].path.coordinates(of["rolling"].t_s)[0][3]
    assert np.ptp(rolled) > 3 * 2 * np.pi * 0.95  # three turns, also in a short recording


def lower(elements):
    yz, zy, zx = elements
    return np.array([[1, 0, 0], [yz, 1, 0], [zy, zx, 1]])


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    "changes",
    [
        {"imu": "thesis"},
        {"imu": "ideal"},
        {
            "random_extrinsics": True, "scale_range": 0.05, "misalignment_range": 0.02, "g_sensitivity_range": 2e-3,
            "gyroscope_rotation_range": 0.2, "accelerometer_bias_range": 2.0, "gyroscope_bias_range": 0.5,
        },
    ],
)  # fmt: skip
def test_samples_follow_table_4_1_exactly(changes, seed):
    simulation = simulate_camera_imu(replace(EXACT, **changes), seed)
    true, samples = simulation.truth_parameters, simulation.recording.imus["imu0"]
    t_s = (samples.gyroscope.t_ns - START_NS) * 1e-9
    motion = simulation.trajectory.at(t_s)
    f = np.einsum("nji,nj->ni", motion.R_target_body, motion.acceleration - simulation.gravity_target)
    S_a, M_a = np.diag(true["imu0.S_a"]), lower(true["imu0.M_a"])
    S_g, M_g = np.diag(true["imu0.S_g"]), lower(true["imu0.M_g"])
    C_bg = rotation_from_rotvec(true["imu0.q_bg"])
    force = f @ (S_a @ M_a).T + simulation.b_a
    rate = motion.omega @ (S_g @ M_g @ C_bg.T).T + f @ true["imu0.B_g"].T + simulation.b_g
    np.testing.assert_allclose(samples.accelerometer.values, force, atol=1e-6)  # timestamps are whole nanoseconds
    np.testing.assert_allclose(samples.gyroscope.values, rate, atol=1e-7)
    # and gnomon's own form of the same truth
    body = simulation.truth.imus["imu0"].apply(samples)
    np.testing.assert_allclose(body.accelerometer.values, f, atol=1e-6)
    np.testing.assert_allclose(body.gyroscope.values, motion.omega, atol=1e-6)
    assert simulation.truth.frame == "accel-x"


def test_presets_are_those_of_the_documents():
    thesis = simulate_camera_imu(replace(SHORT, imu="thesis"), seed=1)
    np.testing.assert_array_equal(thesis.truth_parameters["imu0.M_a"], [0.0052, -0.0017, 0.0026])
    np.testing.assert_allclose(np.degrees(thesis.truth_parameters["imu0.q_bg"]), [0, 0, 1], atol=1e-12)
    assert thesis.recording.imus["imu0"].noise.gyroscope_random_walk == 0.0087
    ideal = simulate_camera_imu(replace(SHORT, imu="ideal"), seed=1)
    np.testing.assert_array_equal(ideal.truth.imus["imu0"].gyroscope.sensitivity, np.eye(3))
    np.testing.assert_array_equal(ideal.b_a[0], 0.0)


def test_drawn_errors_fill_their_ranges():
    scenario = replace(SHORT, duration_s=0.5, scale_range=0.05, gyroscope_bias_range=0.5, time_shift_range_s=5.0)
    truths = [simulate_camera_imu(scenario, seed).truth_parameters for seed in range(30)]
    scales = np.array([truth["imu0.S_g"] for truth in truths])
    assert 0.045 < np.abs(scales - 1).max() <= 0.05
    shifts = np.array([truth["cam0.time_shift_cam_imu"] for truth in truths])
    assert 4 < np.abs(shifts).max() <= 5
    assert np.sign(shifts).min() < 0 < np.sign(shifts).max()
    np.testing.assert_array_equal(truths[0]["imu0.M_g"], [0.0035, -0.0026, -0.0044])  # not drawn


def predicted(simulation, name):
    """Return the exact corners by the truth that a calibration states, from the frames' timestamps."""
    frames, camera = simulation.recording.cameras[name], simulation.truth.cameras[name]
    shift_ns = round(camera.time_shift_cam_imu * 1e9)
    top_s = (frames.t_ns + shift_ns - START_NS)[frames.frame] * 1e-9
    instant_s = top_s + camera.camera.line_delay_s * simulation.frames[name].pixels[:, 1]
    motion = simulation.trajectory.at(instant_s)
    points = simulation.truth_parameters["target.scale"] * simulation.target.points[frames.point]
    p_imu = np.einsum("nji,nj->ni", motion.R_target_body, points - motion.p_target_body)
    p_cam = p_imu @ camera.T_cam_imu[:3, :3].T + camera.T_cam_imu[:3, 3]
    return camera.camera.project(p_cam).pixels


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"cameras": 2, "time_shift_s": -0.3},
        {"line_delay_s": 4e-5, "motion": "shaky"},
        {"line_delay_s": 4e-5, "cameras": 2, "time_shift_range_s": 5.0, "random_extrinsics": True},
        {"clock_offset_s": 1234.5, "target_scale": 1.02, "distance_m": 1.1},
        {"target_type": "checkerboard", "target_cols": 7, "target_size_m": 0.07, "distance_m": 1.1},
        {"target_type": "circlegrid", "target_cols": 4, "target_rows": 9, "target_size_m": 0.04,
         "target_asymmetric": True},
        {"projection": "ds", "intrinsics": (-0.2, 0.55, 290.0, 291.0, 319.0, 241.0), "distortion": "none",
         "distortion_coeffs": (), "distance_m": 0.6},
    ],
)  # fmt: skip
def test_corners_are_where_the_truth_says_at_the_shifted_stamp(changes):
    # t_imu = t_cam + shift; in a rolling shutter the corner's own row says when
    simulation = simulate_camera_imu(replace(EXACT, **changes), seed=3)
    for name, frames in simulation.recording.cameras.items():
        assert len(frames.point) > 1000
        np.testing.assert_allclose(frames.pixels, simulation.frames[name].pixels, atol=1e-12)
        np.testing.assert_allclose(frames.pixels, predicted(simulation, name), atol=2e-6)  # timestamps are whole ns
        assert set(simulation.truth.cameras) == set(simulation.recording.cameras)


def test_a_rolling_shutter_moves_corners():
    still, rolling = (simulate_camera_imu(replace(EXACT, line_delay_s=delay), seed=3) for delay in (0.0, 4e-5))
    first = [s.recording.cameras["cam0"] for s in (still, rolling)]
    both = [{(f, p): uv for f, p, uv in zip(c.frame, c.point, c.pixels, strict=True)} for c in first]
    moved = [np.linalg.norm(both[0][key] - both[1][key]) for key in both[0].keys() & both[1].keys()]
    assert np.max(moved) > 2.0


def test_unknown_line_delay_and_wrong_intrinsics_are_not_told():
    scenario = replace(SHORT, line_delay_s=3e-5, known_line_delay=False, focal_error=0.01, principal_point_error_px=2.0)
    simulation = simulate_camera_imu(scenario, seed=1)
    stated, true = simulation.recording.cameras["cam0"].camera, simulation.truth.cameras["cam0"].camera
    assert (stated.line_delay_s, true.line_delay_s) == (0.0, 3e-5)
    np.testing.assert_allclose(stated.intrinsics - true.intrinsics, [4.6, 4.585, 2, 2])


def test_no_guess_is_given_away():
    simulation = simulate_camera_imu(replace(SHORT, random_extrinsics=True), seed=1)
    frames = simulation.recording.cameras["cam0"]
    assert frames.T_cam_imu is None
    assert frames.time_shift_cam_imu_s is None


def test_random_extrinsics_cover_all_rotations_within_the_lever_arm():
    scenario = replace(SHORT, duration_s=0.5, random_extrinsics=True, lever_arm_m=0.4)
    poses = [simulate_camera_imu(scenario, seed).truth.cameras["cam0"].T_cam_imu for seed in range(40)]
    arms = np.array([np.linalg.norm(T[:3, 3]) for T in poses])
    angles = np.array([np.linalg.norm(rotvec_from_rotation(T[:3, :3])) for T in poses])
    assert 0.35 < arms.max() <= 0.4
    assert angles.max() > 3.0
    assert angles.min() < 1.5


def test_second_camera_has_its_baseline_and_its_own_shift():
    simulation = simulate_camera_imu(replace(SHORT, cameras=2, random_extrinsics=True), seed=2)
    cam0, cam1 = (simulation.truth.cameras[name] for name in ("cam0", "cam1"))
    T_cam1_cam0 = cam1.T_cam_imu @ np.linalg.inv(cam0.T_cam_imu)
    assert np.linalg.norm(T_cam1_cam0[:3, 3]) == pytest.approx(0.11)
    assert cam1.time_shift_cam_imu - cam0.time_shift_cam_imu == pytest.approx(0.002)
    stamps = [simulation.recording.cameras[name].t_ns for name in ("cam0", "cam1")]
    np.testing.assert_allclose(stamps[0] - stamps[1], 2_000_000, atol=1)


def test_gravity_and_the_board_s_attitude():
    leaning = simulate_camera_imu(replace(EXACT, board_lean_deg=90.0, motion="static", gravity=9.79), seed=1)
    np.testing.assert_allclose(leaning.gravity_target, [0, 0, -9.79], atol=1e-12)
    force = leaning.trajectory.f_imu
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 9.79)
    turned = simulate_camera_imu(replace(EXACT, board_lean_deg=0.0, board_turn_deg=90.0), seed=1)
    np.testing.assert_allclose(turned.gravity_target, [9.80665, 0, 0], atol=1e-12)


def test_the_earth_turns_below_the_board():
    earth_rad_s = 2 * np.pi / 86164.1  # one turn in a sidereal day
    scenario = replace(EXACT, imu="ideal", motion="static", board_lean_deg=0.0, board_turn_deg=0.0)
    north, equator = (replace(scenario, earth_rate_latitude=latitude) for latitude in (90.0, 0.0))
    for place, axis in ((north, [0.0, 1.0, 0.0]), (equator, [0.0, 0.0, -1.0])):  # up; and ahead, where north is
        simulation = simulate_camera_imu(place, seed=1)
        R = simulation.trajectory.R_target_imu
        rate = np.einsum("nij,nj->ni", R, simulation.recording.imus["imu0"].gyroscope.values)
        np.testing.assert_allclose(rate / earth_rad_s, np.broadcast_to(axis, rate.shape), atol=1e-5)
    # Coriolis: what moves to the right, above the north pole, is pushed ahead by the board's turning under it
    upright = replace(EXACT, board_lean_deg=0.0, board_turn_deg=0.0)
    fixed, turning = (
        simulate_camera_imu(replace(upright, earth_rate_latitude=lat), 1).trajectory for lat in (None, 90.0)
    )
    push = np.einsum("nij,nj->ni", fixed.R_target_imu, turning.f_imu - fixed.f_imu)
    v_x, _, v_z = fixed.velocity.T
    expected = 2 * earth_rad_s * np.stack([v_z, 0 * v_x, -v_x], axis=1)
    np.testing.assert_allclose(push, expected, atol=1e-9)
    assert np.abs(push).max() > 1e-5


def test_noise_and_walks_have_the_stated_densities():
    scenario = CameraImuScenario(duration_s=100.0, imu="thesis", motion="static", imu_rate_hz=250.0, noise_factor=0.5)
    simulation = simulate_camera_imu(scenario, seed=1)
    samples, true = simulation.recording.imus["imu0"], simulation.truth.imus["imu0"]
    quiet = simulation.trajectory.f_imu @ true.accelerometer.sensitivity.T + simulation.b_a
    noise = samples.accelerometer.values - quiet
    assert noise.std() == pytest.approx(0.5 * 0.0039 * np.sqrt(250.0), rel=0.02)
    lag_one = (noise[1:] * noise[:-1]).mean() / noise.var()
    assert abs(lag_one) < 0.02
    steps = np.diff(simulation.b_g, axis=0)
    assert steps.std() == pytest.approx(0.5 * 0.0087 / np.sqrt(250.0), rel=0.02)
    assert samples.noise.gyroscope_random_walk == pytest.approx(0.5 * 0.0087)
    np.testing.assert_allclose(true.gyroscope.bias, simulation.b_g.mean(axis=0))
    pixels = simulation.recording.cameras["cam0"].pixels - simulation.frames["cam0"].pixels
    np.testing.assert_allclose(pixels.std(axis=0), 0.3, rtol=0.02)


def test_without_noise_the_nominal_noise_is_the_preset_s():
    samples = simulate_camera_imu(replace(EXACT, imu="thesis"), seed=1).recording.imus["imu0"]
    assert samples.noise.accelerometer_noise_density == 0.0039


def test_faults_come_as_often_and_as_large_as_stated():
    scenario = CameraImuScenario(
        outliers=0.05, outlier_px=8.0, dropped_frames=0.3, late_frames=0.05, shifted_frames=0.04, shift_px=6.0
    )
    simulation = simulate_camera_imu(scenario, seed=4)
    frames, true = simulation.recording.cameras["cam0"], simulation.frames["cam0"]
    assert len(frames.t_ns) == pytest.approx(0.7 * 1200, abs=60)
    assert (np.diff(frames.t_ns) > 0).all()
    assert true.late.mean() == pytest.approx(0.05, abs=0.025)
    assert true.shifted.mean() == pytest.approx(0.04, abs=0.02)
    assert true.outlier.mean() == pytest.approx(0.05, abs=0.002)
    error = np.linalg.norm(frames.pixels - true.pixels, axis=1)
    usual = ~true.outlier & ~true.shifted[frames.frame]
    assert error[usual].max() < 0.3 * 6
    inside = ((true.pixels > 15) & (true.pixels < np.array([624, 464]))).all(axis=1)
    assert error[true.outlier & ~true.shifted[frames.frame] & inside].mean() == pytest.approx(8.0, abs=0.2)
    assert np.median(error[true.shifted[frames.frame] & inside]) == pytest.approx(6.0, abs=0.1)
    stamp_s = (frames.t_ns - START_NS) * 1e-9 + 0.007 - true.exposure_s
    assert np.abs(stamp_s[~true.late]).max() < 2e-9
    assert 0.005 <= stamp_s[true.late].min() < 0.008 < 0.017 < stamp_s[true.late].max() <= 0.02
    assert ((frames.pixels >= 0) & (frames.pixels <= [639, 479])).all()


def test_losses_gaps_jitter_and_saturation_of_the_imu():
    scenario = replace(
        SHORT, dropped_samples=0.1, imu_gaps_s=((2.0, 0.5), (4.0, 0.2)), imu_jitter_s=2e-4, camera_gaps_s=((1.0, 1.0),),
        accelerometer_range=12.0, gyroscope_range=0.8,
    )  # fmt: skip
    simulation = simulate_camera_imu(scenario, seed=1)
    samples, trajectory = simulation.recording.imus["imu0"], simulation.trajectory
    for start, length in scenario.imu_gaps_s:
        assert not ((trajectory.t_s >= start) & (trajectory.t_s < start + length)).any()
    assert len(samples.gyroscope) == len(trajectory.t_s) == len(simulation.b_a)
    assert len(samples.gyroscope) == pytest.approx(0.9 * 200 * 5.3, abs=35)
    jitter = (samples.gyroscope.t_ns - START_NS) * 1e-9 - trajectory.t_s
    assert jitter.std() == pytest.approx(2e-4, rel=0.1)
    assert np.abs(samples.accelerometer.values).max() == 12.0
    assert np.abs(samples.gyroscope.values).max() == 0.8
    exposure_s = simulation.frames["cam0"].exposure_s
    assert not ((exposure_s >= 1.0) & (exposure_s < 2.0)).any()


def test_a_board_without_tags_is_seen_whole_or_not_at_all():
    scenario = replace(SHORT, target_type="checkerboard", target_cols=9, target_size_m=0.08, motion="shaky")
    frames = simulate_camera_imu(scenario, seed=1).recording.cameras["cam0"]
    corners = np.bincount(frames.frame, minlength=len(frames.t_ns))
    assert set(corners) == {0, 54}


def test_corners_keep_off_the_border_and_frames_without_corners_keep_their_stamp():
    frames = simulate_camera_imu(replace(EXACT, distance_m=0.4, motion="shaky"), seed=1).recording.cameras["cam0"]
    assert frames.pixels.min() >= 4
    assert (frames.pixels.max(axis=0) <= [635, 475]).all()
    behind = simulate_camera_imu(replace(EXACT, distance_m=0.001, motion="shaky"), seed=1).recording.cameras["cam0"]
    assert len(behind.t_ns) == 120
    assert len(set(behind.frame)) < 120


def arrays(simulation):
    imu, frames = simulation.recording.imus["imu0"], simulation.recording.cameras["cam0"]
    return imu.accelerometer.t_ns, imu.accelerometer.values, imu.gyroscope.values, frames.t_ns, frames.pixels


def test_the_same_seed_gives_the_same_recording_and_another_another():
    first, again, other = (simulate_camera_imu(SHORT, seed) for seed in (5, 5, 6))
    for a, b in zip(arrays(first), arrays(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(
        first.recording.imus["imu0"].gyroscope.values, other.recording.imus["imu0"].gyroscope.values
    )


def test_an_option_for_one_thing_leaves_the_others_as_they_are():
    base = simulate_camera_imu(SHORT, seed=5)
    noise = base.recording.imus["imu0"].gyroscope.values
    for changes in (
        {"pixel_noise_px": 1.0}, {"outliers": 0.1}, {"dropped_frames": 0.3}, {"late_frames": 0.1},
        {"time_shift_range_s": 5.0}, {"cameras": 2}, {"accelerometer_noise_density": 0.1}, {"camera_jitter_s": 1e-3},
    ):  # fmt: skip
        changed = simulate_camera_imu(replace(SHORT, **changes), seed=5)
        np.testing.assert_array_equal(changed.recording.imus["imu0"].gyroscope.values, noise)
    errors = [
        s.recording.cameras["cam0"].pixels - s.frames["cam0"].pixels
        for s in (base, simulate_camera_imu(replace(SHORT, imu="thesis", time_shift_range_s=1.0), seed=5))
    ]
    np.testing.assert_array_equal(errors[0], errors[1])


def test_many_recordings_of_one_path_and_of_one_rig():
    one = replace(SHORT, trajectory_seed=7, time_shift_range_s=1.0, scale_range=0.05)
    a, b = (simulate_camera_imu(one, seed) for seed in (1, 2))
    exposures = [s.frames["cam0"].exposure_s for s in (a, b)]
    np.testing.assert_array_equal(exposures[0], exposures[1])
    np.testing.assert_array_equal(a.trajectory.p_target_imu, b.trajectory.p_target_imu)
    assert a.truth_parameters["imu0.S_g"][0] != b.truth_parameters["imu0.S_g"][0]
    rig = replace(one, trajectory_seed=None, sensor_seed=7)
    c, d = (simulate_camera_imu(rig, seed) for seed in (1, 2))
    for name in ("imu0.S_g", "cam0.time_shift_cam_imu"):
        np.testing.assert_array_equal(c.truth_parameters[name], d.truth_parameters[name])
    assert not np.array_equal(c.trajectory.p_target_imu, d.trajectory.p_target_imu)


def test_the_truth_names_every_scalar_and_every_parameter():
    simulation = simulate_camera_imu(replace(SHORT, cameras=2), seed=1)
    truth = simulation.truth
    assert truth.uncertainty.matrix.shape == (len(truth.uncertainty.names),) * 2
    assert not truth.uncertainty.matrix.any()
    for path in ("imu0.gyroscope.g_sensitivity", "cam1.T_cam_imu.rotation", "cam0.time_shift_cam_imu"):
        assert np.isfinite(truth.parameter(path)).all()
    assert truth.provenance.options == {"duration_s": "6.0", "cameras": "2"}
    for name in ("cam0.T_cam_imu.rotation", "cam1.T_cam_imu.translation", "cam0.intrinsics"):
        np.testing.assert_array_equal(truth.parameter(name), simulation.truth_parameters[name])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration_s": 0.0}, r"duration_s 0 is out of range. Give a number from 0.001"),
        ({"duration_s": float("nan")}, "duration_s nan"),
        ({"duration_s": 0.05}, "too short"),
        ({"noise_factor": -1.0}, "noise_factor -1 must not be below zero"),
        ({"outliers": 1.0}, "outliers 1: give a fraction"),
        ({"earth_rate_latitude": 91.0}, "earth_rate_latitude 91 is out of range. Give a number from -90 to 90"),
        ({"scale_range": 1.0}, "scale_range 1"),
        ({"intrinsics": (460.0, 460.0)}, "pinhole has 4 of them, found 2"),
        ({"distortion": "fov"}, "fov has 1 of them, found 4"),
        ({"distortion_coeffs": (0.0, 0.0, 0.0, float("inf"))}, "distortion_coeffs inf is not a finite number"),
        ({"imu_gaps_s": ((1.0, -1.0),)}, "imu_gaps_s 1 -1: give start and length"),
        ({"target_rows": 1}, "6 x 1 is too small"),
        ({"resolution": (640, 0)}, "resolution 0 is out of range"),
        ({"time_shift_s": float("inf")}, "time_shift_s inf is not a finite number"),
    ],
)
def test_scenarios_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(OptionError, match=message):
        replace(CameraImuScenario(), **changes)


def test_every_option_is_described():
    kinds = [kind for kind in CameraImuScenario.__mro__ if is_dataclass(kind)]
    text = "".join(inspect.getsource(kind) for kind in kinds)
    for field in fields(CameraImuScenario):
        assert re.search(rf'^    {field.name}: [^\n]*\n    """', text, re.MULTILINE), field.name
