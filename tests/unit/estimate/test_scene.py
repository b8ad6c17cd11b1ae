"""Scenes without a board: path and points from rays and the IMU, and their adjustment."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from gnomon.estimate.camera_imu.gauss_newton import lasting_factor
from gnomon.estimate.camera_imu.start.board_poses import resection_poses
from gnomon.estimate.camera_imu.start.first_guess import ImuStream
from gnomon.estimate.camera_imu.terms.visual_terms import Exposures
from gnomon.estimate.scene import (
    SeenTurns,
    adjust_bundle,
    attitudes_of,
    find_scene_path,
    rates_by_camera,
    turns_between,
)
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.simulate import RoomScenario, simulate_camera_imu


@cache
def scene():
    """Return a rig's motion for eight seconds, at key frames 0.2 s apart, among 80 points, seen exactly."""
    simulation = simulate_camera_imu(RoomScenario(duration_s=8.0, imu="ideal").rig(), 4)
    rng = np.random.default_rng(1)
    key_s = np.arange(0.1, 7.8, 0.2)
    R_room_cam, p_room_cam = simulation.trajectory.path.pose(key_s)
    R = np.swapaxes(R_room_cam, 1, 2)
    p = -np.einsum("kij,kj->ki", R, p_room_cam)
    points = p_room_cam.mean(axis=0) + rng.uniform((-1, -0.8, -2.5), (1, 0.8, -1.0), (80, 3))
    camera = simulation.truth.cameras["cam0"].camera
    key, point, pixels = [], [], []
    for k in range(len(key_s)):
        seen = camera.project(points @ R[k].T + p[k]).pixels
        inside = np.flatnonzero(((seen > 0) & (seen < camera.resolution)).all(axis=1))
        key.append(np.full(len(inside), k))
        point.append(inside)
        pixels.append(seen[inside])
    sightings = np.concatenate(key), np.concatenate(point), np.concatenate(pixels)
    return simulation, key_s, (R, p), points, sightings


def test_path_and_scene_have_their_true_size():
    simulation, key_s, (R, _), points, (key, point, pixels) = scene()
    samples, motion = simulation.recording.imus["imu0"], simulation.trajectory
    rays = simulation.truth.cameras["cam0"].camera.unproject(pixels)[0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    stream = ImuStream(t_s=motion.t_s, rate=samples.gyroscope.values, force=samples.accelerometer.values)
    rays = np.einsum("mji,mj->mi", R[key], rays)
    found = find_scene_path(key_s, motion.at(key_s).R_target_body, stream, motion.R_target_imu, (key, point, rays))
    apart = np.linalg.norm(found.points[:40] - found.points[40:], axis=1)
    assert np.abs(apart / np.linalg.norm(points[:40] - points[40:], axis=1) - 1).max() < 0.05
    T = np.linalg.inv(simulation.truth.cameras["cam0"].T_cam_imu)
    assert np.abs(found.arm - T[:3, 3]).max() < 0.02


def test_an_adjustment_comes_back_from_a_start_that_is_off():
    simulation, _, (R, p), points, sightings = scene()
    rng = np.random.default_rng(2)
    off = rotation_from_rotvec(0.02 * rng.standard_normal((len(R), 3)))
    camera = simulation.truth.cameras["cam0"].camera
    moved = points + 0.05 * rng.standard_normal(points.shape)
    found = adjust_bundle(camera, sightings, off @ R, p + 0.02 * rng.standard_normal(p.shape), moved)
    assert np.abs(found.residual).max() < 0.05


def test_a_wrong_sighting_moves_nothing():
    simulation, _, (R, p), points, (key, point, pixels) = scene()
    wrong = pixels + 0.1 * np.random.default_rng(3).standard_normal(pixels.shape)
    wrong[::40] += 30.0
    found = adjust_bundle(simulation.truth.cameras["cam0"].camera, (key, point, wrong), R, p, points)
    kept = np.arange(len(pixels)) % 40 != 0
    assert np.abs(found.residual[kept]).max() < 1.0
    assert 0.06 < found.sigma_px < 0.15


def test_pairs_of_images_tell_how_the_camera_turned():
    simulation, _, (R, _), _, (key, point, pixels) = scene()
    rays = simulation.truth.cameras["cam0"].camera.unproject(pixels)[0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    shared, first, second = np.intersect1d(point[key == 3], point[key == 4], return_indices=True)
    assert len(shared) > 20
    rows = np.flatnonzero(key == 3)[first], np.flatnonzero(key == 4)[second]
    turn, moved, known = turns_between(rays, [rows], 2e-3)
    assert known[0]
    assert moved[0] > 0.01
    assert np.linalg.norm(rotvec_from_rotation(turn[0] @ R[3] @ R[4].T)) < 1e-3


def test_the_camera_corrects_the_gyroscope():
    simulation, key_s, _, _, _ = scene()
    motion = simulation.trajectory
    truth = motion.at(key_s).R_target_body
    wrong = 1.004 * motion.omega_imu + 0.02 + 1e-3 * motion.f_imu
    turns = SeenTurns(start_s=key_s[:-3], stop_s=key_s[3:], R=np.swapaxes(truth[:-3], 1, 2) @ truth[3:])
    rate = rates_by_camera(turns, ImuStream(t_s=motion.t_s, rate=wrong, force=motion.f_imu))

    def drift(rates):
        R = attitudes_of(rates, motion.t_s, key_s)
        return np.linalg.norm(rotvec_from_rotation(R[0].T @ R[-1] @ truth[-1].T @ truth[0]))

    assert drift(wrong) > 0.05
    assert drift(rate) < 0.005


def test_poses_before_points_that_lie_anywhere():
    simulation, _, (R, p), points, (key, point, pixels) = scene()
    exposures = Exposures(
        frame=np.arange(len(R)),
        start=np.searchsorted(key, np.arange(len(R) + 1)),
        points=points[point],
        pixels=pixels,
        delay_rows=np.zeros(len(R)),
    )
    found = resection_poses(exposures, simulation.truth.cameras["cam0"].camera)
    assert np.abs(found[0] - R).max() < 1e-6
    assert np.abs(found[1] - p).max() < 1e-6


def lasting(memory, share=1.0):
    """Return the factor of errors of which a share of the variance is remembered from image to image."""
    rng = np.random.default_rng(4)
    images, points = 400, 30
    errors = rng.standard_normal((images, points, 2))
    for k in range(1, images):
        errors[k] = memory * errors[k - 1] + np.sqrt(1 - memory**2) * errors[k]
    errors = np.sqrt(share) * errors + np.sqrt(1 - share) * rng.standard_normal(errors.shape)
    frame = np.repeat(np.arange(images), points)
    exposures = Exposures(
        frame=np.arange(images),
        start=np.arange(images + 1) * points,
        points=np.zeros((len(frame), 3)),
        pixels=np.zeros((len(frame), 2)),
        delay_rows=np.zeros(images),
        point=np.tile(np.arange(points), images),
    )
    residual = errors.reshape(-1, 2)
    sums = SimpleNamespace(residual=residual, comparable=residual, weight=np.ones(len(frame)))
    return lasting_factor(exposures, sums)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_images_count_less_where_errors_of_a_point_last(memory):
    expected = np.sqrt((1 + memory) / (1 - memory))  # of an autoregressive process of first order
    assert lasting(memory) == pytest.approx(expected, rel=0.1)


def test_a_little_more_that_lasts_makes_them_count_a_little_less():
    """Correlations that stopped counting below some size made the noise level alternate until iterations ended."""
    factors = [lasting(0.99, share) for share in np.linspace(0.03, 0.09, 13)]
    assert np.abs(np.diff(np.log(factors))).max() < 0.15
    assert 1.5 < factors[0] < factors[-1] < 4.0
