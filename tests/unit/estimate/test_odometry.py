"""Odometry with a frozen calibration: increments against exact motion, the filter against the true path."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.estimate.invariant_filter import Beginning, Sightings, estimate_path, preintegrate_imu
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.simulate.camera_imu_rig import drawn_imu_truth, nominal_extrinsics
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.walk import WalkScenario, simulate_walk

SHIFT_S = 0.003
SHORT = WalkScenario(length_m=(15.0, 15.0), speed_m_s=(1.2, 1.2))
BEGINNING = np.repeat([1e-3, 1e-3, 1e-4, 1e-3, 1e-2], 3)
DENSITIES = (8.73e-5, 0.0039)
HERE = np.eye(3), np.zeros(3)


def walked(noise_factor=1.0, scenario=SHORT, seed=4):
    rig = CameraImuScenario(imu="ideal", noise_factor=noise_factor, accelerometer_noise_density=DENSITIES[1],
                            gyroscope_noise_density=DENSITIES[0])  # fmt: skip
    sensor = drawn_imu_truth(rig, np.random.default_rng(0))
    return simulate_walk(scenario, sensor, nominal_extrinsics(), SHIFT_S, seed)


def increments_of(walk, *, rate=0.0, force=0.0, shift_s=SHIFT_S):
    samples = walk.samples
    return preintegrate_imu(
        walk.imu_t_s, samples.gyroscope.values - walk.b_g - rate, samples.accelerometer.values - walk.b_a - force,
        walk.stamp_s + shift_s, DENSITIES,
    )  # fmt: skip


def follow_walk(walk, increments, turn=HERE[0], moved=HERE[1]):
    return estimate_path(
        increments,
        Sightings(last=walk.last, count=walk.count, rays=walk.rays, sigma=0.5 / 460),
        nominal_extrinsics(),
        Beginning(
            rotation=turn @ walk.R_world_imu[0],
            velocity=turn @ walk.velocity[0],
            position=turn @ walk.p_world_imu[0] + moved,
            sigma=BEGINNING,
            walks=(2e-5, 3e-4),
            gravity=walk.gravity,
        ),
    )


def test_increments_are_those_of_the_exact_motion():
    walk = walked(noise_factor=0.0)
    found = increments_of(walk)
    R, p, v, h = walk.R_world_imu, walk.p_world_imu, walk.velocity, found.length_s[:, None]
    turned = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    assert np.abs(rotvec_from_rotation(np.swapaxes(turned, 1, 2) @ found.rotation)).max() < 2e-5
    dv = np.einsum("nji,nj->ni", R[:-1], np.diff(v, axis=0) - walk.gravity * h)
    dp = np.einsum("nji,nj->ni", R[:-1], np.diff(p, axis=0) - v[:-1] * h - walk.gravity * h**2 / 2)
    assert np.abs(found.velocity - dv).max() < 1e-3
    assert np.abs(found.position - dp).max() < 1e-4


def test_increments_follow_the_biases():
    walk = walked()
    before = increments_of(walk)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4
        after = increments_of(walk, rate=step[:3], force=step[3:])
        turn = rotvec_from_rotation(np.swapaxes(before.rotation, 1, 2) @ after.rotation)
        changed = np.concatenate([turn, after.velocity - before.velocity, after.position - before.position], axis=1)
        np.testing.assert_allclose(changed / 1e-4, before.by_bias[:, :, k], atol=2e-5)


def test_the_covariance_of_increments_is_that_of_their_scatter():
    walks = [walked(seed=4), walked(noise_factor=0.0, seed=4)]
    noisy, exact = (increments_of(walk) for walk in walks)
    turn = rotvec_from_rotation(np.swapaxes(exact.rotation, 1, 2) @ noisy.rotation)
    off = np.concatenate([turn, noisy.velocity - exact.velocity, noisy.position - exact.position], axis=1)
    stated = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))
    ratio = np.sqrt(np.mean((off / stated) ** 2, axis=0))
    assert ((ratio > 0.75) & (ratio < 1.25)).all()


@pytest.mark.long
def test_without_noise_the_path_is_the_true_one():
    walk = walked(noise_factor=0.0, scenario=replace(SHORT, pixel_noise_px=0.0))
    R, p = follow_walk(walk, increments_of(walk))
    assert np.abs(p - walk.p_world_imu).max() < 5e-3
    assert np.abs(rotvec_from_rotation(np.swapaxes(R, 1, 2) @ walk.R_world_imu)).max() < 1e-3


@pytest.mark.long
def test_the_path_does_not_depend_on_where_it_begins_and_which_way_it_heads():
    walk = walked()
    increments = increments_of(walk)
    turn, moved = rotation_from_rotvec(np.array([0.0, 2.0, 0.0])), np.array([50.0, -3.0, 70.0])
    R, p = follow_walk(walk, increments)
    other_R, other_p = follow_walk(walk, increments, turn, moved)
    np.testing.assert_allclose(other_p, p @ turn.T + moved, atol=1e-3)
    np.testing.assert_allclose(other_R, turn @ R, atol=1e-4)


@pytest.mark.long
def test_noise_costs_decimetres_and_a_wrong_clock_more():
    walk = walked()
    off = {
        shift_s: np.linalg.norm(follow_walk(walk, increments_of(walk, shift_s=shift_s))[1][-1] - walk.p_world_imu[-1])
        for shift_s in (SHIFT_S, SHIFT_S + 0.008)
    }
    assert 1e-3 < off[SHIFT_S] < 0.1
    assert off[SHIFT_S + 0.008] > 2 * off[SHIFT_S]
