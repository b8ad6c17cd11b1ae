"""Checkerboards whose ends were mixed up, put right by the motion and by the gyroscope."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.board_order import board_views, number_cameras_alike, with_views
from gnomon.calibrate.steps.camera_imu_preparation import prepare_camera_imu
from gnomon.detect.boards.checkerboard_order import consistent_order, renumber_view
from gnomon.estimate.camera_imu.start.first_guess import imu_stream
from gnomon.options import CameraImuOptions

SCENARIO = gnomon.CameraImuScenario(
    duration_s=45.0,
    target_type="checkerboard",
    target_cols=7,
    target_rows=5,
    target_size_m=0.05,
    pixel_noise_px=0.05,
    camera_gaps_s=((5.0, 14.0), (18.0, 25.0)),
)


@pytest.fixture(scope="module")
def simulation():
    return gnomon.simulate_camera_imu(SCENARIO, 7)


def flipped(frames, target, seed: int):
    """Return frames in which the board changes its ends at random now and then, and at the end of every gap."""
    rng = np.random.default_rng(seed)
    views, turn = [], 0
    gaps = np.diff(frames.t_ns, prepend=frames.t_ns[0]) > 1_000_000_000
    for view, gap in zip(board_views(frames), gaps, strict=True):
        turn = (turn + 2) % 4 if gap or rng.random() < 0.1 else turn
        views.append(renumber_view(view, target, turn))
    return with_views(frames, tuple(views))


def same(first, second) -> bool:
    return bool(np.array_equal(first.point, second.point) and np.array_equal(first.pixels, second.pixels))


def test_views_and_frames_are_the_same_thing(simulation):
    frames = simulation.recording.cameras["cam0"]
    assert same(with_views(frames, tuple(board_views(frames))), frames)
    own = replace(frames, sigma_px=np.linspace(0.1, 0.2, len(frames.frame)))
    assert np.array_equal(with_views(own, tuple(board_views(own))).sigma_px, own.sigma_px)


def test_the_gyroscope_joins_what_gaps_parted(simulation):
    target, recording = simulation.target, simulation.recording
    true = recording.cameras["cam0"]
    mixed = flipped(true, target, 0)
    assert not same(mixed, true)
    alone = consistent_order(board_views(mixed), mixed.t_ns, target, camera=mixed.camera)
    assert not alone.certain
    prepared = prepare_camera_imu(recording, target, CameraImuOptions())
    stream = imu_stream(prepared.inertial)
    found, said = number_cameras_alike({"cam0": mixed}, target, prepared.origin_ns, stream)
    assert not said
    other = with_views(true, tuple(renumber_view(view, target, 2) for view in board_views(true)))
    assert same(found["cam0"], true) or same(found["cam0"], other)


@pytest.mark.long
def test_mixed_ends_do_not_change_the_calibration(simulation):
    recording, target = simulation.recording, simulation.target
    mixed = flipped(recording.cameras["cam0"], target, 1)
    results = [
        gnomon.calibrate_camera_imu(replace(recording, cameras={"cam0": frames}), target).calibration
        for frames in (recording.cameras["cam0"], mixed)
    ]
    poses = [result.cameras["cam0"].T_cam_imu for result in results]
    assert np.abs(poses[0] - poses[1]).max() < 1e-4
    truth = simulation.truth.cameras["cam0"].T_cam_imu
    sigma = np.asarray(results[1].sigma("cam0.T_cam_imu.translation"))
    assert (np.abs(poses[1] - truth)[:3, 3] < 4 * sigma).all()


def test_what_stays_uncertain_is_left_out_and_said(simulation):
    """A gyroscope that does not belong to the camera foresees nothing."""
    target, recording = simulation.target, simulation.recording
    frames = recording.cameras["cam0"]
    prepared = prepare_camera_imu(recording, target, CameraImuOptions())
    stream = imu_stream(prepared.inertial)
    noise = replace(stream, rate=np.random.default_rng(0).standard_normal(stream.rate.shape))
    found, said = number_cameras_alike({"cam0": frames}, target, prepared.origin_ns, noise)
    (finding,) = said
    assert finding.code == "board-ends"
    kept = np.unique(found["cam0"].frame)
    assert 0 < len(kept) < len(np.unique(frames.frame))
    assert np.diff(frames.t_ns[kept]).max() < 1_000_000_000  # one piece, without a gap
    assert len(found["cam0"].t_ns) == len(frames.t_ns)


def test_boards_with_two_ends_are_passed_through(simulation):
    target = gnomon.Target.checkerboard(cols=7, rows=6, row_spacing_m=0.07, col_spacing_m=0.07)
    cameras = {"cam0": simulation.recording.cameras["cam0"]}
    stream = imu_stream(prepare_camera_imu(simulation.recording, simulation.target, CameraImuOptions()).inertial)
    assert number_cameras_alike(cameras, target, 0, stream) == (cameras, ())


def test_two_cameras_count_from_the_same_end():
    scenario = replace(SCENARIO, cameras=2, camera_gaps_s=(), duration_s=20.0)
    simulation = gnomon.simulate_camera_imu(scenario, 3)
    recording, target = simulation.recording, simulation.target
    second = recording.cameras["cam1"]
    turned = with_views(second, tuple(renumber_view(view, target, 2) for view in board_views(second)))
    stream = imu_stream(prepare_camera_imu(recording, target, CameraImuOptions()).inertial)
    for given in (second, turned):
        cameras = {"cam0": recording.cameras["cam0"], "cam1": given}
        origin = prepare_camera_imu(recording, target, CameraImuOptions()).origin_ns
        found, _ = number_cameras_alike(cameras, target, origin, stream)
        assert same(found["cam0"], recording.cameras["cam0"])
        assert same(found["cam1"], second)
