"""Short simulated recordings of cameras and an IMU, calibrated and compared with their truth."""

import sys
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import gnomon
from camera_imu_truth import cramer_rao_sigma, errors, turned
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.calibrate.steps.camera_imu_preparation import prepare_camera_imu
from gnomon.geometry.rotations import rotation_from_quaternion, rotation_from_rotvec, rotvec_from_rotation

SCENARIO = CameraImuScenario(
    duration_s=12.0, imu_rate_hz=100.0, camera_rate_hz=10.0, target_cols=4, target_rows=4, random_extrinsics=True
)
EXACT = replace(SCENARIO, noise_factor=0.0, pixel_noise_px=0.0)
OPTIONS = CameraImuOptions(gravity=9.80665)
WIDEST = 4.5
"""Sigmas within which all of some thirty errors lie but once in a few thousand recordings."""


@cache
def simulated(seed=0, **changes):
    return simulate_camera_imu(replace(SCENARIO, **changes), seed)


def calibrated(simulation, recording=None, **options):
    """Return the result, and its errors."""
    result = calibrate_camera_imu(recording or simulation.recording, simulation.target, replace(OPTIONS, **options))
    return result, errors(result, simulation)


@cache
def usual():
    """Return a simulation without faults, its result and its errors."""
    return simulated(), *calibrated(simulated())


def assert_right(result, found, names=None):
    """Errors are what their sigmas say, and the estimation came to rest."""
    assert result.calibration.assessment.camera_imu.converged
    worst = int(np.argmax(np.abs(found.z)))
    assert abs(found.z[worst]) < WIDEST, f"{found.names[worst]} is off by {found.z[worst]:.1f} sigma"
    assert found.nees < 2.5 * len(found.names)
    assert set(names or ()) <= set(found.names)


def parameter(result, name):
    return next(p for p in result.diagnostics.parameters if p.name == name)


def codes(result):
    return {f.code for f in result.calibration.assessment.findings if f.severity in ("warning", "problem")}


def tracked(result, simulation):
    """Return the estimated trajectory, and the true motion at its timestamps."""
    track = result.diagnostics.trajectory
    return track, simulation.trajectory.at((track.t_ns - simulation.trajectory.start_ns) * 1e-9)


@pytest.mark.parametrize("options", [{}, {"noise": "nominal", "pixel_sigma": 0.3}], ids=["estimated", "nominal"])
def test_without_noise_the_truth_is_found(options):
    simulation = simulate_camera_imu(EXACT, seed=1)
    result, found = calibrated(simulation, **options)
    assert result.calibration.assessment.camera_imu.converged
    limits = {
        "rotation": 2e-6,
        "translation": 2e-6,
        "time_shift": 1e-7,
        "gravity": 1e-6,
        "imu0.B_g": 1e-6,
        "imu0": 1e-5,
    }
    for name, error in zip(found.names, found.error, strict=True):
        limit = next(value for key, value in limits.items() if key in name)
        assert abs(error) < limit, name
    imu, true = result.calibration.imus["imu0"], simulation.truth.imus["imu0"]
    for a, b in ((imu.accelerometer, true.accelerometer), (imu.gyroscope, true.gyroscope)):
        np.testing.assert_allclose(a.sensitivity, b.sensitivity, atol=1e-5)
        np.testing.assert_allclose(a.bias, b.bias, atol=1e-4)
    track, motion = tracked(result, simulation)
    np.testing.assert_allclose(track.p_target_imu[50:-50], motion.p_target_body[50:-50], atol=1e-5)
    np.testing.assert_allclose(track.omega_imu[50:-50], motion.omega[50:-50], atol=1e-4)
    np.testing.assert_allclose(result.diagnostics.gravity_target, simulation.gravity_target, atol=1e-5)


@pytest.mark.main
def test_errors_and_sigmas_of_a_noisy_recording():
    simulation, result, found = usual()
    assert_right(result, found)
    assert len(found.names) == 39
    assert codes(result) == {"stream-short"}
    # and the noise that was found
    nominal = simulation.recording.imus["imu0"].noise
    truth = [nominal.gyroscope_noise_density, nominal.accelerometer_noise_density, 0.3]
    white = [level for level in result.diagnostics.noise if not level.name.endswith(".walk")]
    for level, true in zip(white, truth, strict=True):
        assert level.estimated == pytest.approx(true, rel=0.05), level.name
        assert level.used == pytest.approx(level.estimated, rel=0.03)
    _, ordinary = calibrated(simulation, covariance="ordinary")
    origin = result.calibration.imus["imu0"].origin
    bound = cramer_rao_sigma(simulation, replace(OPTIONS, knots_per_s=50.0), result.diagnostics.gravity_plane, origin)
    ratios = np.array([sigma / bound[name] for name, sigma in zip(ordinary.names, ordinary.sigma, strict=True)])
    np.testing.assert_allclose(ratios, 1.0, atol=0.05)


def test_published_values_have_the_covariance_of_their_errors():
    simulation, result, _ = usual()
    found, true = result.calibration, simulation.truth
    truth = dict(gnomon.results.calibration.calibration_parameters(true.imus, true.cameras))
    truth["imu0.accelerometer.lever_arms_m"] = np.zeros((3, 3))
    error = []
    for name, a in gnomon.results.calibration.calibration_parameters(found.imus, found.cameras):
        b = truth[name]
        turn = "rotation" in name
        error.append(rotvec_from_rotation(rotation_from_rotvec(b).T @ rotation_from_rotvec(a)) if turn else a - b)
    error = np.concatenate([np.ravel(e) for e in error])
    sigma = np.sqrt(np.diag(found.uncertainty.matrix))
    free = sigma > 0
    assert free.sum() == 6 + 3 + 9 + 3 + 9 + 9 + 7
    np.testing.assert_allclose(error[~free], 0.0, atol=1e-12)
    assert np.abs(error[free] / sigma[free]).max() < WIDEST
    assert np.mean((error[free] / sigma[free]) ** 2) == pytest.approx(1.0, abs=0.8)


def test_two_runs_give_the_same_numbers():
    simulation, first, _ = usual()
    again, _ = calibrated(simulation)
    for a, b in zip(first.diagnostics.parameters, again.diagnostics.parameters, strict=True):
        assert (a.name, a.value, a.sigma, a.start) == (b.name, b.value, b.sigma, b.start)
    np.testing.assert_array_equal(first.calibration.uncertainty.matrix, again.calibration.uncertainty.matrix)
    np.testing.assert_array_equal(first.diagnostics.trajectory.p_target_imu, again.diagnostics.trajectory.p_target_imu)


def test_models_estimate_what_they_say():
    ideal = simulated(imu="ideal")
    result, found = calibrated(ideal, model="basic")
    assert_right(result, found)
    assert len(found.names) == 9
    np.testing.assert_array_equal(result.calibration.imus["imu0"].accelerometer.sensitivity, np.eye(3))
    no_influence = simulated(g_sensitivity_range=0.0)
    result, found = calibrated(no_influence, model="scale-misalignment")
    assert_right(result, found)
    assert len(found.names) == 24
    assert not result.calibration.imus["imu0"].gyroscope.g_sensitivity.any()


def test_the_basic_model_predicts_worse_and_is_biased():
    # Krebs, Figs. 5.4, 5.6 and 5.7
    simulation = simulated(scale_range=0.02)
    result, _ = calibrated(simulation, compare=True)
    for name in ("imu0.accelerometer", "imu0.gyroscope"):
        fit = result.diagnostics.signals[name]
        full, basic = (np.sqrt(np.mean((fit.measured - p)[fit.used] ** 2)) for p in (fit.predicted, fit.basic))
        assert 0.6 * fit.sigma < full < fit.sigma  # the trajectory follows a part of the noise
        assert basic > 1.5 * full, name
    result, neglected = calibrated(simulation, model="basic", covariance="ordinary")
    assert np.abs(neglected.z).max() > 10
    assert result.diagnostics.trust.clusters is None
    result, told = calibrated(simulation, model="basic")  # clusters of time show that something is missing
    assert np.abs(told.z).max() < 6
    assert "model-incomplete" in [f.code for f in result.calibration.assessment.findings]
    note = result.calibration.assessment.trust
    assert note.covariance == "cluster-robust"
    assert note.clusters == result.diagnostics.trust.clusters.count
    assert max(note.sigma_ratio.values()) > 2


def test_parameters_that_are_fixed_free_or_have_a_prior():
    simulation = simulated(target_scale=1.01, focal_error=0.004)
    result, found = calibrated(
        simulation,
        fix=("imu0.B_g[4]", "imu0.M_a[0]"),
        free=("target.scale", "cam0.intrinsics"),
        prior=("cam0.distortion_coeffs=0.01",),
    )
    statuses = {p.name: p.status for p in result.diagnostics.parameters}
    assert statuses["imu0.B_g[4]"] == statuses["imu0.M_a[0]"] == "fixed"
    assert parameter(result, "imu0.B_g[4]").value == parameter(result, "imu0.M_a[0]").value == 0.0
    assert parameter(result, "imu0.B_g[4]").sigma == 0.0
    assert statuses["cam0.distortion_coeffs[2]"] == "prior"
    assert len(found.names) == 39 - 2 + 1 + 4 + 4
    for name in ("target.scale", *(f"cam0.intrinsics[{k}]" for k in range(4))):
        p = parameter(result, name)
        assert p.status == "estimated"
        assert abs(found.z[found.names.index(name)]) < WIDEST, name
        assert abs(p.value - p.start) > 3 * p.sigma or "[2]" in name or "[3]" in name, name


def test_gravity_itself_can_be_found_where_the_scale_is_known():
    simulation = simulated(gravity=9.76, imu="ideal")
    result, found = calibrated(simulation, model="basic", free=("gravity.magnitude",))
    assert_right(result, found, ["gravity.magnitude"])
    assert parameter(result, "gravity.magnitude").value == pytest.approx(9.76, abs=0.01)


def stated(simulation, T=None, shift_s=0.0):
    """Return the recording with a camchain that states extrinsics and time shift, wrong by T and shift_s."""
    true = simulation.truth.cameras["cam0"]
    frames = replace(
        simulation.recording.cameras["cam0"],
        T_cam_imu=true.T_cam_imu if T is None else T,
        time_shift_cam_imu_s=true.time_shift_cam_imu + shift_s,
    )
    return replace(simulation.recording, cameras={"cam0": frames})


def test_stated_extrinsics_can_be_kept_or_trusted():
    simulation = simulated()
    true = simulation.truth.cameras["cam0"]
    kept, found = calibrated(simulation, stated(simulation), fix=("cam0",))
    np.testing.assert_array_equal(kept.calibration.cameras["cam0"].T_cam_imu, true.T_cam_imu)
    assert kept.calibration.cameras["cam0"].time_shift_cam_imu == true.time_shift_cam_imu
    assert_right(kept, found)
    trusted, found = calibrated(simulation, stated(simulation), prior=("cam0.T_cam_imu.translation=1e-5",))
    assert_right(trusted, found)
    np.testing.assert_allclose(trusted.calibration.cameras["cam0"].T_cam_imu[:3, 3], true.T_cam_imu[:3, 3], atol=3e-5)


def test_a_wrong_guess_does_no_harm():
    simulation, without, _ = usual()
    T = turned(simulation.truth.cameras["cam0"].T_cam_imu, [0.9, -0.7, 0.5], 0.3)
    wrong, found = calibrated(simulation, stated(simulation, T, shift_s=0.2))
    assert_right(wrong, found)
    assert "extrinsics-contradicted" in codes(wrong)
    for a, b in zip(without.diagnostics.parameters, wrong.diagnostics.parameters, strict=True):
        assert a.value == pytest.approx(b.value, abs=0.05 * a.sigma + 1e-12)


@pytest.mark.long
@pytest.mark.parametrize("exchanged", [False, True])
def test_images_of_two_cameras_that_were_exchanged_are_told(exchanged):
    """By what is stated of them; lens and noise are alike."""
    simulation = simulated(cameras=2)
    seen, names = simulation.recording.cameras, ("cam0", "cam1")
    frames = {
        name: replace(seen[other], T_cam_imu=simulation.truth.cameras[name].T_cam_imu)
        for name, other in zip(names, reversed(names) if exchanged else names, strict=True)
    }
    result = calibrate_camera_imu(replace(simulation.recording, cameras=frames), simulation.target, OPTIONS)
    assert ("extrinsics-contradicted" in codes(result)) == exchanged


def test_nothing_needs_to_be_estimated():
    simulation = simulated(imu="ideal")
    result, found = calibrated(simulation, stated(simulation), model="basic", fix=("gravity.direction[0]", "cam0"))
    assert found.names == ("gravity.direction[1]",)
    result, found = calibrated(simulation, stated(simulation), model="basic", fix=("gravity", "cam0"))
    assert found.names == ()
    found_px = next(level for level in result.diagnostics.noise if level.name == "cam0.corners")
    assert found_px.estimated == pytest.approx(0.3, rel=0.05)
    # gravity stays at its first guess, which is a few degrees off: the trajectory alone cannot make up for it
    track, motion = tracked(result, simulation)
    np.testing.assert_allclose(track.p_target_imu[50:-50], motion.p_target_body[50:-50], atol=0.02)


def test_a_rolling_shutter_whose_line_delay_is_unknown():
    simulation = simulated(line_delay_s=3e-5, known_line_delay=False, target_cols=3, target_rows=3, duration_s=8.0)
    result, found = calibrated(simulation, free=("cam0.line_delay",))
    assert_right(result, found, ["cam0.line_delay"])
    delay = parameter(result, "cam0.line_delay")
    assert delay.value == pytest.approx(3e-5, abs=5 * delay.sigma)
    assert delay.sigma < 1e-6


def test_a_rolling_shutter_whose_line_delay_is_stated_or_ignored():
    simulation = simulated(line_delay_s=3e-5, known_line_delay=False, target_cols=3, target_rows=3, duration_s=8.0)
    result, found = calibrated(simulation, line_delay=3e-5)
    assert_right(result, found)
    assert result.calibration.cameras["cam0"].camera.line_delay_s == 3e-5
    _, ignored = calibrated(simulation, fix=("cam0.line_delay",))
    assert np.abs(ignored.z).max() > 10  # half an image is exposed 7 ms later than thought


def test_two_cameras_each_with_its_clock():
    simulation = simulated(cameras=2, time_shift_s=0.31, time_shift_difference_s=-0.12, clock_offset_s=-77.7)
    result, found = calibrated(simulation)
    assert_right(result, found, ["cam1.time_shift_cam_imu"])
    assert len(found.names) == 46
    first, second = (simulation.truth.cameras[name].T_cam_imu for name in ("cam0", "cam1"))
    baseline = result.diagnostics.baselines["cam1_cam0"]
    true = second @ np.linalg.inv(first)
    np.testing.assert_allclose(baseline[:3, 3], true[:3, 3], atol=1e-3)
    np.testing.assert_allclose(baseline[:3, :3], true[:3, :3], atol=1e-3)
    assert np.linalg.norm(baseline[:3, 3]) == pytest.approx(0.11, abs=1e-3)


def test_one_camera_of_two_keeps_its_name():
    simulation = simulated(cameras=2)
    recording = replace(simulation.recording, cameras={"cam1": simulation.recording.cameras["cam1"]})
    result, found = calibrated(simulation, recording, prior=("cam1.intrinsics=2",))
    assert_right(result, found, ["cam1.intrinsics[0]", "cam1.time_shift_cam_imu"])
    assert set(result.calibration.cameras) == {"cam1"}


FAULTS = {
    "gaps of both streams": {"imu_gaps_s": ((4.0, 0.6), (8.0, 0.025)), "camera_gaps_s": ((1.5, 1.0), (9.0, 0.7))},
    "lost samples and frames": {"dropped_samples": 0.1, "dropped_frames": 0.3},
    "jitter of the timestamps": {"imu_jitter_s": 5e-5, "camera_jitter_s": 2e-5},
    "5 % scale and large biases": {
        "scale_range": 0.05, "misalignment_range": 0.03, "gyroscope_rotation_range": 0.1,
        "accelerometer_bias_range": 2.0, "gyroscope_bias_range": 0.5, "time_shift_range_s": 5.0,
    },
    "clocks of unrelated origin": {"clock_offset_s": 98_765.4321},
    "a tremor to 12 Hz": {"motion": "tremor", "imu_rate_hz": 200.0, "duration_s": 6.0},
    "biases that walk": {"imu": "thesis"},
    "a wide lens": {"projection": "ds", "intrinsics": (-0.2, 0.55, 290.0, 291.0, 319.0, 241.0), "distortion": "none",
                    "distortion_coeffs": (), "distance_m": 0.6},
    "a checkerboard": {"target_type": "checkerboard", "target_cols": 7, "target_rows": 5, "target_size_m": 0.07,
                       "distance_m": 1.1},
    "corners that the lens cannot image": {
        "intrinsics": (300.0, 300.0, 320.0, 240.0), "distortion_coeffs": (-0.35, 0.02, 0.0, 0.0), "distance_m": 0.5,
    },
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_recordings_are_like(fault):
    simulation = simulated(**FAULTS[fault])
    result, found = calibrated(simulation)
    assert_right(result, found)
    if fault.startswith("gaps"):
        assert result.diagnostics.segments == 2


def test_wrong_corners_and_frames_are_found_out():
    simulation = simulated(outliers=0.05, outlier_px=15.0, late_frames=0.04, shifted_frames=0.04)
    result, found = calibrated(simulation)
    assert_right(result, found)
    true, fit = simulation.frames["cam0"], result.diagnostics.corners["cam0"]
    assert not fit.frame_used[true.shifted].any()
    assert fit.frame_used[~true.late & ~true.shifted].mean() > 0.97
    used = fit.frame_used[fit.frame]
    assert fit.weight[true.outlier & used].mean() < 0.15
    assert fit.weight[~true.outlier & used].mean() > 0.9
    assert set(np.array(fit.frame_reason)[true.shifted]) == {"fits badly as a whole"}
    assert fit.sigma_px == pytest.approx(0.3, rel=0.12)
    _, trusting = calibrated(simulation, robust=False)
    assert np.abs(trusting.error[found.names.index("cam0.time_shift_cam_imu")]) > 2e-5
    assert trusting.nees > 2 * found.nees or trusting.sigma.mean() > 2 * found.sigma.mean()


def test_saturated_samples_are_masked():
    simulation = simulated(gyroscope_range=1.2, accelerometer_range=14.0)
    rate = simulation.recording.imus["imu0"].gyroscope.values
    assert 0.005 < np.mean(np.abs(rate) >= 1.2) < 0.2
    result, found = calibrated(simulation, gyroscope_range=1.2, accelerometer_range=14.0)
    assert_right(result, found)
    fit = result.diagnostics.signals["imu0.gyroscope"]
    assert not fit.used[(np.abs(rate) >= 1.2).any(axis=1)].any()


def test_samples_clipped_at_a_range_that_is_not_stated_are_masked_too():
    """With lever arms, which the default model has, those of the accelerometer that were taken meanwhile are masked."""
    simulation = simulated(gyroscope_range=1.2)
    clipped = (np.abs(simulation.recording.imus["imu0"].gyroscope.values) >= 1.2).any(axis=1)
    prepared = prepare_camera_imu(simulation.recording, simulation.target, CameraImuOptions())
    for triad in ("gyroscope", "accelerometer"):
        (used,) = (part.used for data in prepared.inertial if (part := getattr(data, triad)) is not None)
        assert not used[clipped].any()
        assert used[~clipped].all()


def test_turning_over_and_over():
    simulation = simulated(motion="rolling", duration_s=32.0, camera_rate_hz=5.0, target_cols=2, target_rows=2)
    result, found = calibrated(simulation, knots_per_s=25.0)
    assert_right(result, found)
    assert result.diagnostics.segments > 1
    assert "trajectory-cut" in {f.code for f in result.calibration.assessment.findings}


@pytest.mark.parametrize("options", [{"knots_per_s": 25.0}, {"knots_per_s": 49.0, "spline_order": 5}], ids=str)
def test_other_splines_find_the_same(options):
    simulation, before, _ = usual()
    result, found = calibrated(simulation, **options)
    assert_right(result, found)
    assert result.diagnostics.knots_per_s == pytest.approx(options["knots_per_s"])
    for a, b in zip(before.diagnostics.parameters, result.diagnostics.parameters, strict=True):
        assert abs(a.value - b.value) <= 0.7 * a.sigma, a.name
        assert b.sigma == pytest.approx(a.sigma, rel=0.1)


def test_too_few_knots_show_in_the_residuals():
    simulation = simulated()
    result, _ = calibrated(simulation, knots_per_s=6.0)
    levels = {level.name: level for level in result.diagnostics.noise}
    assert levels["imu0.accelerometer"].estimated > 3 * levels["imu0.accelerometer"].nominal
    assert "noise-differs" in {f.code for f in result.calibration.assessment.findings}


def test_accelerometer_and_gyroscope_with_stamps_of_their_own():
    simulation = simulated(imu_rate_hz=200.0)
    imu = simulation.recording.imus["imu0"]
    apart = replace(
        imu,
        accelerometer=replace(
            imu.accelerometer, t_ns=imu.accelerometer.t_ns[1::2], values=imu.accelerometer.values[1::2]
        ),
        gyroscope=replace(imu.gyroscope, t_ns=imu.gyroscope.t_ns[3:-5], values=imu.gyroscope.values[3:-5]),
    )
    result, found = calibrated(simulation, replace(simulation.recording, imus={"imu0": apart}))
    assert_right(result, found)
    # Its delay is estimated jointly: readings that might leave the trajectory are left out, a twentieth of a second
    # each.
    signal = result.diagnostics.signals["imu0.accelerometer"]
    inside = apart.accelerometer.t_ns[7:-7]
    assert len(signal.t_s) == len(inside)
    assert np.ptp(signal.t_s) == pytest.approx((inside[-1] - inside[0]) * 1e-9, abs=1e-6)
    assert len(result.diagnostics.signals["imu0.gyroscope"].t_s) == len(apart.gyroscope)
    for level, lost in zip(result.diagnostics.noise, (1.0, np.sqrt(2)), strict=False):  # samples lost, density up
        assert level.estimated == pytest.approx(lost * level.nominal, rel=0.06), level.name


def test_frames_before_and_after_the_imu_are_left_out():
    simulation = simulated()
    imu, start = simulation.recording.imus["imu0"], simulation.trajectory.start_ns
    kept = (imu.gyroscope.t_ns - start > 2.5e9) & (imu.gyroscope.t_ns - start < 10.0e9)
    part = replace(
        imu,
        accelerometer=replace(
            imu.accelerometer, t_ns=imu.accelerometer.t_ns[kept], values=imu.accelerometer.values[kept]
        ),
        gyroscope=replace(imu.gyroscope, t_ns=imu.gyroscope.t_ns[kept], values=imu.gyroscope.values[kept]),
    )
    result, found = calibrated(simulation, replace(simulation.recording, imus={"imu0": part}))
    assert_right(result, found)
    fit = result.diagnostics.corners["cam0"]
    exposure_s = simulation.frames["cam0"].exposure_s
    outside = (exposure_s < 2.5) | (exposure_s > 9.99)
    assert outside.sum() > 30
    np.testing.assert_array_equal(np.array(fit.frame_reason) == "outside of the trajectory", outside)
    assert not fit.frame_used[outside].any()


@pytest.mark.long
def test_streams_of_different_recordings_never_pass():
    a, b = simulated(1), simulated(2)
    verdict = "fail"
    with suppress(gnomon.GnomonError):
        verdict = calibrated(a, replace(a.recording, imus=b.recording.imus))[0].calibration.verdict
    assert verdict == "fail"


def test_the_trajectory_has_sigmas_on_request():
    simulation, plain, _ = usual()
    assert plain.diagnostics.trajectory.position_sigma is None
    result, _ = calibrated(simulation, marginals=True)
    track, motion = tracked(result, simulation)
    R = rotation_from_quaternion(track.q_target_imu_wxyz)
    turn = rotvec_from_rotation(np.swapaxes(motion.R_target_body, 1, 2) @ R)
    for error, sigma in (
        (track.p_target_imu - motion.p_target_body, track.position_sigma),
        (turn, track.attitude_sigma),
    ):
        assert sigma.shape == error.shape
        assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.25)
    bias = result.diagnostics.biases["imu0.gyroscope"]
    truth = np.stack([np.interp(bias.t_s, simulation.trajectory.t_s, column) for column in simulation.b_g.T], axis=1)
    assert np.abs((bias.value - truth) / bias.sigma).max() < WIDEST
