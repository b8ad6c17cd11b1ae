"""Poses of the board, and where a camera's clock and axes lie to the IMU's, without any guess."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, InitialisationError, simulate_camera_imu
from gnomon.assess.checks.rig_checks import check_recording_rig
from gnomon.estimate.camera_imu.start.alignment import align_camera, gyroscope_integral
from gnomon.estimate.camera_imu.start.board_poses import board_poses, gather_exposures
from gnomon.estimate.camera_imu.start.first_guess import ImuStream, align_cameras, first_place
from gnomon.estimate.camera_imu.terms.visual_terms import CornerSums, frame_scatter
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.target import Target
from gnomon.recording import CameraFrames
from gnomon.simulate.camera_imu_streams import START_NS

SCENARIO = CameraImuScenario(duration_s=12.0, target_cols=4, target_rows=4)


def simulated(seed=0, **changes):
    return simulate_camera_imu(replace(SCENARIO, **changes), seed)


def poses_of(simulation, name="cam0", frames=None):
    frames = frames or simulation.recording.cameras[name]
    return board_poses(frames, simulation.target, (frames.t_ns - START_NS) * 1e-9)


def stream_of(simulation, factor=1.0, kept=slice(None)):
    imu = simulation.recording.imus["imu0"]
    t_s = (imu.gyroscope.t_ns - START_NS) * 1e-9
    return ImuStream(t_s=t_s[kept], rate=factor * imu.gyroscope.values[kept], force=imu.accelerometer.values[kept])


def integral_of(simulation, **changes):
    stream = stream_of(simulation, **changes)
    return gyroscope_integral(stream.t_s, stream.rate)


def angle_between(a, b):
    return float(np.linalg.norm(rotvec_from_rotation(np.swapaxes(a, -1, -2) @ b)))


def assert_aligned(found, simulation, name="cam0", *, shift=2e-3, angle=0.05):
    true = simulation.truth.cameras[name]
    assert found.time_shift_s == pytest.approx(true.time_shift_cam_imu, abs=shift)
    assert angle_between(found.R_cam_imu, true.T_cam_imu[:3, :3]) < angle


LENSES = [
    {},
    {"projection": "ds", "intrinsics": (-0.2, 0.55, 290.0, 291.0, 319.0, 241.0), "distortion": "none",
     "distortion_coeffs": (), "distance_m": 0.6},
    {"projection": "omni", "intrinsics": (0.9, 540.0, 536.0, 321.0, 239.0), "distortion": "radtan",
     "distortion_coeffs": (-0.1, 0.05, 1e-3, -1e-3), "distance_m": 0.6},
    {"target_type": "checkerboard", "target_cols": 7, "target_rows": 5, "target_size_m": 0.07, "distance_m": 1.1},
    {"intrinsics": (300.0, 300.0, 320.0, 240.0), "distortion_coeffs": (-0.35, 0.02, 0.0, 0.0), "distance_m": 0.5},
]  # fmt: skip


@pytest.mark.parametrize("changes", LENSES, ids=str)
def test_poses_of_exact_corners_are_exact(changes):
    simulation = simulated(pixel_noise_px=0.0, **changes)
    poses = poses_of(simulation)
    assert len(poses) > 0.8 * len(simulation.frames["cam0"].exposure_s)
    truth = simulation.trajectory.at(simulation.frames["cam0"].exposure_s[poses.exposures.frame])
    T = simulation.truth.cameras["cam0"].T_cam_imu
    R = T[:3, :3] @ np.swapaxes(truth.R_target_body, 1, 2)
    p = T[:3, 3] - np.einsum("nij,nj->ni", R, truth.p_target_body)
    assert max(map(angle_between, poses.R_cam_target, R)) < 1e-6
    np.testing.assert_allclose(poses.p_cam_target, p, atol=1e-6)
    assert poses.sigma_px <= 1e-3


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_scatter_about_the_poses_is_the_noise_of_the_corners(outliers):
    poses = poses_of(simulated(pixel_noise_px=0.4, outliers=outliers, outlier_px=30.0))
    assert poses.sigma_px == pytest.approx(0.4, rel=0.05 + 2 * outliers)
    assert np.isfinite(poses.p_cam_target).all()


def test_scatter_of_a_frame_counts_no_wrong_corners():
    simulation = simulated(pixel_noise_px=0.4, outliers=0.1, outlier_px=30.0, target_cols=6, target_rows=6)
    exposures, frames = poses_of(simulation).exposures, simulation.recording.cameras["cam0"]
    truth = simulation.frames["cam0"].pixels
    chosen = np.isin(frames.frame, exposures.frame)
    residual = (truth - frames.pixels)[chosen]
    residual[::7] = np.nan  # not imaged
    lengths = np.diff(exposures.start)
    sums = CornerSums(
        sums=np.empty((0, 0, 0)), cost=np.empty(0), mean_square=np.empty(0), valid=lengths, lengths=lengths,
        residual=residual, weight=np.ones(len(residual)), corner_cost=np.empty(0),
    )  # fmt: skip
    known = np.ones(len(exposures), dtype=bool)
    known[3] = False
    found = frame_scatter(exposures, sums, known)
    assert len(found) == exposures.frame.max() + 1
    assert np.isnan(found[exposures.frame[3]])
    rest = found[np.isfinite(found)]
    assert len(rest) == len(exposures) - 1
    assert np.median(rest) == pytest.approx(0.4**2, rel=0.2)
    assert rest.max() < 3 * 0.4**2


def test_frames_that_tell_no_pose_are_left_out():
    target = Target.aprilgrid(tag_cols=4, tag_rows=4, tag_size_m=0.088, tag_spacing=0.3)
    simulation = simulated()
    frames = simulation.recording.cameras["cam0"]
    lined_up = [0, 1, 2, 3, 4, 5, 6, 7]  # all on the lowest row
    kept = np.ones(len(frames.frame), dtype=bool)
    kept[frames.frame == 5] = False
    kept[frames.frame == 6] &= np.isin(frames.point[frames.frame == 6], lined_up)
    kept[np.flatnonzero(frames.frame == 7)[5:]] = False  # five corners
    fewer = replace(frames, frame=frames.frame[kept], point=frames.point[kept], pixels=frames.pixels[kept])
    found = gather_exposures(fewer, target)
    assert not set(found.frame) & {5, 6, 7}
    assert len(found) == len(set(frames.frame)) - 3
    assert len(found.points) == found.start[-1] == len(found.pixels)
    poses = poses_of(simulation, frames=fewer)
    np.testing.assert_allclose(poses.t_s, (frames.t_ns[found.frame] - START_NS) * 1e-9)


def test_without_any_pose_there_is_none():
    simulation = simulated()
    frames = simulation.recording.cameras["cam0"]
    nothing = replace(frames, frame=frames.frame[:0], point=frames.point[:0], pixels=frames.pixels[:0])
    poses = poses_of(simulation, frames=nothing)
    assert len(poses) == 0
    with pytest.raises(InitialisationError, match="seen in 0 frames"):
        align_camera(poses, integral_of(simulation), "cam0")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("clock_offset_s", [0.0, 3.7, -86_400.25, 1e6])
def test_clocks_of_unrelated_origin_and_any_rotation(seed, clock_offset_s):
    simulation = simulated(
        seed, clock_offset_s=clock_offset_s, random_extrinsics=True, time_shift_range_s=5.0, gyroscope_bias_range=0.5,
        accelerometer_bias_range=2.0, scale_range=0.05,
    )  # fmt: skip
    found = align_camera(poses_of(simulation), integral_of(simulation), "cam0")
    assert_aligned(found, simulation)
    np.testing.assert_allclose(found.gyroscope_bias, simulation.b_g.mean(axis=0), atol=0.05)
    assert found.score > 0.95
    assert found.consistent.mean() > 0.9
    assert found.rate_scale == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("motion", ["gentle", "tremor", "shaky", "rolling"])
def test_every_motion(motion):
    simulation = simulated(motion=motion, random_extrinsics=True, time_shift_range_s=2.0, duration_s=32.0)
    found = align_camera(poses_of(simulation), integral_of(simulation), "cam0")
    assert_aligned(found, simulation, shift=6e-3)


@pytest.mark.parametrize("camera_rate_hz", [4.0, 7.0, 60.0])
def test_every_frame_rate(camera_rate_hz):
    simulation = simulated(camera_rate_hz=camera_rate_hz, time_shift_s=1.234)
    assert_aligned(
        align_camera(poses_of(simulation), integral_of(simulation), "cam0"), simulation, shift=8e-3, angle=0.1
    )


@pytest.mark.parametrize(("first", "last"), [(0.0, 5.0), (7.0, 12.0), (4.0, 9.0)])
def test_an_imu_that_ran_for_a_part_of_the_time_only(first, last):
    simulation = simulated(clock_offset_s=50.0)
    t_s = stream_of(simulation).t_s
    integral = integral_of(simulation, kept=(t_s >= first) & (t_s < last))
    assert_aligned(align_camera(poses_of(simulation), integral, "cam0"), simulation, shift=4e-3)


@pytest.mark.parametrize(("first", "last"), [(0, 80), (160, 240)])
def test_a_camera_that_ran_for_a_part_of_the_time_only(first, last):
    simulation = simulated(clock_offset_s=-200.0)
    frames = simulation.recording.cameras["cam0"]
    kept = (frames.frame >= first) & (frames.frame < last)
    part = CameraFrames(
        t_ns=frames.t_ns[first:last], frame=frames.frame[kept] - first, point=frames.point[kept],
        pixels=frames.pixels[kept], camera=frames.camera,
    )  # fmt: skip
    assert_aligned(
        align_camera(poses_of(simulation, frames=part), integral_of(simulation), "cam0"),
        simulation,
        shift=6e-3,
        angle=0.1,
    )


def test_late_frames_stand_out():
    simulation = simulated(motion="shaky", late_frames=0.04, pixel_noise_px=0.05, target_cols=6, target_rows=6)
    poses = poses_of(simulation)
    found = align_camera(poses, integral_of(simulation), "cam0")
    assert_aligned(found, simulation)
    late = simulation.frames["cam0"].late[poses.exposures.frame]
    assert late.sum() > 5
    assert found.consistent[~late].mean() > 0.95
    assert found.consistent[late].mean() < 0.8  # the rest of them shows once the trajectory is known


def test_lost_frames_and_samples_do_not_matter():
    simulation = simulated(dropped_frames=0.4, dropped_samples=0.1, imu_gaps_s=((5.0, 0.5),), time_shift_s=-0.8)
    assert_aligned(align_camera(poses_of(simulation), integral_of(simulation), "cam0"), simulation, shift=4e-3)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (180 / np.pi, r"the gyroscope reads 5\d\.?\d* times the rotation that cam0 sees.*in deg/s, not in rad/s"),
        (np.pi / 180, r"the gyroscope reads 0\.017\d times the rotation that cam0 sees"),
    ],
)
def test_a_gyroscope_in_another_unit_is_named(factor, message):
    simulation = simulated(gyroscope_bias_range=0.01)
    with pytest.raises(InitialisationError, match=message):
        align_camera(poses_of(simulation), integral_of(simulation, factor=factor), "cam0")


@pytest.mark.parametrize("motion", ["static", "translation"])
def test_without_rotation_there_is_nothing_to_align(motion):
    simulation = simulated(motion=motion, pixel_noise_px=0.05)
    with pytest.raises(
        InitialisationError, match=r"cam0: the camera turned by .* deg/s \(rms\) only; without rotation"
    ):
        align_camera(poses_of(simulation), integral_of(simulation), "cam0")


def test_too_few_frames_near_each_other():
    simulation = simulated(camera_rate_hz=2.0)
    with pytest.raises(InitialisationError, match=r"seen in 2\d frames, and in fewer than ten pairs .* 4 Hz or more"):
        align_camera(poses_of(simulation), integral_of(simulation), "cam0")


def test_streams_that_are_too_short_to_overlap():
    simulation = simulated()
    t_s = stream_of(simulation).t_s
    with pytest.raises(InitialisationError, match=r"camera \(\d+\.\d s\) and IMU \(2\.0 s\) are too short to overlap"):
        align_camera(poses_of(simulation), integral_of(simulation, kept=t_s < 2.0), "cam0")


@pytest.mark.parametrize(("camera", "imu"), [(0, 1), (1, 2), (1, 3), (3, 0)])
def test_streams_of_different_recordings_are_refused_or_doubted(camera, imu):
    score = 0.0
    with suppress(InitialisationError):
        score = align_camera(poses_of(simulated(camera)), integral_of(simulated(imu)), "cam0").score
    assert score < 0.6


def test_hardly_any_common_rotation_is_refused():
    with pytest.raises(InitialisationError, match="do not show the same rotation at any time shift"):
        align_camera(poses_of(simulated(0)), integral_of(simulated(3)), "cam0")


@pytest.mark.parametrize("seed", range(3))
def test_a_few_poses_far_off_do_not_hide_the_time_shift(seed):
    simulation = simulated(seed, time_shift_s=1.7)
    poses = poses_of(simulation)
    rng = np.random.default_rng(seed)
    bad = rng.choice(len(poses), len(poses) // 20, replace=False)
    turned = poses.R_cam_target.copy()
    turned[bad] = rotation_from_rotvec(rng.normal(0, 0.6, (len(bad), 3))) @ turned[bad]
    found = align_camera(replace(poses, R_cam_target=turned), integral_of(simulation), "cam0")
    assert_aligned(found, simulation, shift=5e-3)
    assert found.score > 0.9
    assert found.consistent[bad].mean() < 0.2


@pytest.mark.parametrize("motion", ["normal", "shaky"])
@pytest.mark.parametrize("camera_rate_hz", [8.0, 20.0])
def test_the_imu_is_found_where_it_is(motion, camera_rate_hz):
    simulation = simulated(
        motion=motion, camera_rate_hz=camera_rate_hz, lever_arm_m=1.5, random_extrinsics=True, duration_s=16.0,
        time_shift_s=0.2,
    )  # fmt: skip
    (look,) = align_cameras(simulation.recording.cameras, simulation.target, START_NS, stream_of(simulation))
    place = first_place(look.alignment, look.poses, stream_of(simulation))
    true = simulation.truth.cameras["cam0"].T_cam_imu[:3, 3]
    assert np.linalg.norm(true) > 0.3
    assert np.linalg.norm(place - true) < 0.15 * np.linalg.norm(true)


def test_two_cameras_have_clocks_of_their_own():
    simulation = simulated(cameras=2, time_shift_s=0.3, time_shift_difference_s=0.2, random_extrinsics=True)
    found = align_cameras(simulation.recording.cameras, simulation.target, START_NS, stream_of(simulation))
    assert [look.name for look in found] == ["cam0", "cam1"]
    for look in found:
        assert_aligned(look.alignment, simulation, look.name)


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_about_one_axis_is_set_upright_by_gravity_and_acceleration(seed):
    # Rotations about one axis leave the turn about that axis open; the specific force tells it.
    simulation = simulated(seed, motion="one-axis", random_extrinsics=True, target_cols=6, target_rows=6)
    (look,) = align_cameras(simulation.recording.cameras, simulation.target, START_NS, stream_of(simulation))
    assert look.alignment.axes[1] < 0.1 * look.alignment.axes[0]
    assert_aligned(look.alignment, simulation, shift=5e-3, angle=0.15)


def test_noise_of_the_poses_is_no_rotation():
    found = align_camera(poses_of(simulation := simulated(motion="one-axis")), integral_of(simulation), "cam0")
    assert found.axes[1] < 0.1 * found.axes[0]


def test_many_frames_a_second_are_no_reason_for_doubt():
    found = align_camera(poses_of(simulation := simulated(camera_rate_hz=60.0)), integral_of(simulation), "cam0")
    assert found.score > 0.95


def test_a_stated_guess_is_used_where_nothing_turns():
    simulation = simulated(motion="translation", pixel_noise_px=0.05)
    frames = simulation.recording.cameras["cam0"]
    guess = np.eye(4)
    guess[:3, :3] = rotation_from_rotvec(np.array([0.1, 0.2, 0.3]))
    stated = replace(frames, T_cam_imu=guess, time_shift_cam_imu_s=0.02)
    stream = stream_of(simulation)
    (look,) = align_cameras({"cam0": stated}, simulation.target, START_NS, stream)
    np.testing.assert_array_equal(look.alignment.R_cam_imu, guess[:3, :3])
    assert look.alignment.time_shift_s == 0.02
    assert look.alignment.score == 0.0
    with pytest.raises(InitialisationError):
        align_cameras({"cam0": frames}, simulation.target, START_NS, stream)


@pytest.mark.parametrize("axes", [[1, 0, 2], [0, 2, 1]])
def test_an_imu_whose_triads_are_left_handed_alike_is_told(axes):
    # Gyroscope and accelerometer agree with each other, and no rotation makes either agree with the camera.
    simulation = simulated(1)
    imu = simulation.recording.imus["imu0"]
    exchanged = replace(
        imu,
        gyroscope=replace(imu.gyroscope, values=imu.gyroscope.values[:, axes]),
        accelerometer=replace(imu.accelerometer, values=imu.accelerometer.values[:, axes]),
    )
    recording = replace(simulation.recording, imus={"imu0": exchanged})
    found = {finding.code: finding for finding in check_recording_rig(recording, simulation.target)}
    assert "mirror image" in found["axes-mirrored"].message
    sound = {finding.code for finding in check_recording_rig(simulation.recording, simulation.target)}
    assert "axes-mirrored" not in sound
