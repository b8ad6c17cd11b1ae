"""Vary one parameter of a rig at a time: only its own estimate moves (Krebs, section 5.1.1)."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from camera_imu_truth import turned
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.forms import FULL, LOWER
from gnomon.recording import ImuSamples, TriadSamples

SCENARIO = CameraImuScenario(
    duration_s=9.0, motion="gentle", imu="ideal", noise_factor=0.0, pixel_noise_px=0.0, imu_rate_hz=100.0,
    camera_rate_hz=10.0, target_cols=3, target_rows=3, random_extrinsics=True,
)  # fmt: skip
OPTIONS = CameraImuOptions(gravity=9.80665, noise="nominal", pixel_sigma=0.3, knots_per_s=25.0)


def with_sensor(simulation, *, S_a=None, S_g=None, B_g=None, b_a=None, b_g=None, T_cam_imu=None, shift_s=0.0):
    """Return the recording of an ideal simulation as another sensor or rig would have made it, exactly."""
    trajectory = simulation.trajectory
    motion = trajectory.path.at(trajectory.t_s).of(trajectory.T_cam0_imu if T_cam_imu is None else T_cam_imu)
    f = np.einsum("nji,nj->ni", motion.R_target_body, motion.acceleration - simulation.gravity_target)
    force = f @ (np.eye(3) if S_a is None else S_a).T + (0 if b_a is None else b_a)
    rate = motion.omega @ (np.eye(3) if S_g is None else S_g).T + (0 if B_g is None else f @ B_g.T)
    imu, frames = simulation.recording.imus["imu0"], simulation.recording.cameras["cam0"]
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=imu.accelerometer.t_ns, values=force, unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=imu.gyroscope.t_ns, values=rate + (0 if b_g is None else b_g), unit="rad/s"),
        noise=imu.noise,
    )
    moved = replace(frames, t_ns=frames.t_ns - round(shift_s * 1e9))
    return replace(simulation.recording, imus={"imu0": samples}, cameras={"cam0": moved})


def unit(i, j, size):
    matrix = np.zeros((3, 3))
    matrix[i, j] = size
    return matrix


ONE_AT_A_TIME = {
    "imu0.S_a[1]": (0.02, lambda T: {"S_a": np.eye(3) + unit(1, 1, 0.02)}),
    "imu0.M_a[2]": (-0.01, lambda T: {"S_a": LOWER.matrix(np.array([0, 0, -0.01]))}),
    "imu0.S_g[0]": (-0.03, lambda T: {"S_g": np.eye(3) + unit(0, 0, -0.03)}),
    "imu0.M_g[1]": (0.015, lambda T: {"S_g": LOWER.matrix(np.array([0, 0.015, 0]))}),
    "imu0.q_bg[2]": (0.02, lambda T: {"S_g": rotation_from_rotvec(np.array([0, 0, 0.02])).T}),
    "imu0.B_g[5]": (1e-3, lambda T: {"B_g": FULL.matrix(1e-3 * np.eye(9)[5])}),
    "imu0.accelerometer.bias": (0.0, lambda T: {"b_a": np.array([0.5, -1.0, 2.0])}),
    "imu0.gyroscope.bias": (0.0, lambda T: {"b_g": np.array([0.5, -0.2, 0.1])}),
    "cam0.T_cam_imu.translation[0]": (0.05, lambda T: {"T_cam_imu": turned(T, [0, 0, 0], [0.05, 0, 0])}),
    "cam0.T_cam_imu.rotation[1]": (0.4, lambda T: {"T_cam_imu": turned(T, [0, 0.4, 0], 0)}),
    "cam0.time_shift_cam_imu": (0.25, lambda T: {"shift_s": 0.25}),
}


def numbers(result, simulation):
    """Return every estimated number but biases, the rotation of the camera about the true one."""
    found = {p.name: p.value for p in result.diagnostics.parameters if p.status != "fixed"}
    R = simulation.truth.cameras["cam0"].T_cam_imu[:3, :3]
    turn = rotvec_from_rotation(R.T @ result.calibration.cameras["cam0"].T_cam_imu[:3, :3])
    found |= {f"cam0.T_cam_imu.rotation[{k}]": turn[k] for k in range(3)}
    found.pop("gravity.direction[0]")
    found.pop("gravity.direction[1]")
    return found | dict(zip("xyz", result.diagnostics.gravity_target, strict=True))


@cache
def ideal_without_noise():
    simulation = simulate_camera_imu(SCENARIO, seed=1)
    return simulation, calibrate_camera_imu(simulation.recording, simulation.target, OPTIONS)


@pytest.mark.parametrize("name", ONE_AT_A_TIME)
def test_one_parameter_at_a_time_moves_its_own_estimate_alone(name):
    simulation, before = ideal_without_noise()
    size, change = ONE_AT_A_TIME[name]
    recording = with_sensor(simulation, **change(simulation.truth.cameras["cam0"].T_cam_imu))
    after = calibrate_camera_imu(recording, simulation.target, OPTIONS)
    old, new = (numbers(result, simulation) for result in (before, after))
    sigma = {p.name: p.sigma for p in before.diagnostics.parameters} | dict.fromkeys("xyz", 2e-3)
    for key, value in new.items():
        expected = old[key] + (size if key == name else 0.0)
        assert abs(value - expected) < 0.05 * sigma[key], key
    biases = after.calibration.imus["imu0"]
    np.testing.assert_allclose(biases.accelerometer.bias, [0.5, -1, 2] if "accel" in name else 0.0, atol=1e-3)
    np.testing.assert_allclose(biases.gyroscope.bias, [0.5, -0.2, 0.1] if "gyro" in name else 0.0, atol=1e-4)
