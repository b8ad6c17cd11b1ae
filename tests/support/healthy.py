"""Recordings with nothing wrong with them: sensors, rigs, boards and motions as varied as those of careful people."""

from math import radians

import numpy as np

from gnomon.simulate.scenarios.camera_imu import CameraImuScenario, MotionName
from gnomon.simulate.scenarios.cameras import USUAL_LENSES, BoardName, CamerasScenario
from gnomon.simulate.scenarios.recorded import Scenario

_MOTIONS: tuple[MotionName, ...] = ("gentle", "normal", "tremor", "shaky", "rolling")


def healthy_imu(seed: int) -> Scenario:
    """Draw a multi-position recording with nothing wrong with it."""
    rng = np.random.default_rng([seed, 2])
    hold = float(rng.uniform(2.0, 5.0))
    move = float(rng.uniform(1.0, 2.5))
    return Scenario(
        intervals=int(rng.integers(24, 60)),
        t_init_s=float(rng.uniform(20.0, 60.0)),
        hold_s=(hold, 1.5 * hold),
        motion_s=(move, 1.6 * move),
        rate_hz=float(rng.choice([50.0, 100.0, 200.0, 400.0])),
        gravity=float(rng.uniform(9.79, 9.825)),
        earth_rate_latitude=float(rng.uniform(-60, 60)),
        units=str(rng.choice(["si", "g deg/s", "mg mdeg/s", "raw"])),
        bits=16,
        accelerometer_range=float(rng.choice([39.2, 78.4, 156.9])),
        gyroscope_range=radians(float(rng.choice([500.0, 1000.0, 2000.0]))),
        accelerometer_scale=(0.97, 1.03),
        gyroscope_scale=(0.97, 1.03),
        accelerometer_misalignment=float(rng.uniform(0.0, 0.02)),
        gyroscope_misalignment=float(rng.uniform(0.0, 0.02)),
        accelerometer_bias=float(rng.uniform(0.0, 0.4)),
        gyroscope_bias=float(rng.uniform(0.0, 0.03)),
        g_sensitivity=float(rng.choice([0.0, 3e-4, 1e-3])),
        accelerometer_noise_density=float(np.exp(rng.uniform(np.log(5e-4), np.log(3e-3)))),
        gyroscope_noise_density=float(np.exp(rng.uniform(np.log(5e-5), np.log(5e-4)))),
        gyroscope_bias_walk=float(rng.choice([0.0, 1e-5, 3e-5])),
        dropped=float(rng.choice([0.0, 0.0, 1e-3])),
        stamp_jitter_s=float(rng.choice([0.0, 1e-4])),
    )


def healthy_rig(seed: int) -> CameraImuScenario:
    """Draw a recording of cameras and an IMU with nothing wrong with it."""
    rng = np.random.default_rng([seed, 3])
    fisheye = bool(rng.random() < 0.3)
    checkerboard = bool(rng.random() < 0.25)
    columns = int(rng.integers(7, 10)) if checkerboard else int(rng.integers(4, 7))
    size = float(rng.uniform(0.04, 0.06)) if checkerboard else float(rng.uniform(0.05, 0.09))
    width = columns * size * (1.0 if checkerboard else 1.3)
    focal = 300.0 if fisheye else 460.0
    return CameraImuScenario(
        duration_s=float(rng.uniform(40, 70)),
        motion=_MOTIONS[int(rng.integers(len(_MOTIONS)))],
        imu_rate_hz=float(rng.choice([100.0, 200.0, 250.0])),
        camera_rate_hz=float(rng.choice([10.0, 15.0, 20.0])),
        target_type="checkerboard" if checkerboard else "aprilgrid",
        target_cols=columns,
        target_rows=columns - 1,
        target_size_m=size,
        board_lean_deg=float(rng.uniform(-5, 20)),
        board_turn_deg=float(rng.uniform(-10, 10)),
        distance_m=float(width * (2.2 if checkerboard else 1.3) * focal / 460.0 * rng.uniform(0.9, 1.2)),
        intrinsics=(focal, focal * 0.998, 320.0 + float(rng.normal(0, 5)), 240.0 + float(rng.normal(0, 5))),
        distortion="equidistant" if fisheye else "radtan",
        distortion_coeffs=(-0.01, 0.02, -0.015, 0.003) if fisheye else (-0.28, 0.075, 0.0002, -0.00015),
        pixel_noise_px=float(rng.uniform(0.05, 0.5)),
        cameras=2 if rng.random() < 0.2 else 1,
        random_extrinsics=True,
        lever_arm_m=float(rng.uniform(0.02, 0.25)),
        time_shift_range_s=0.05,
        gravity=float(rng.uniform(9.79, 9.825)),
        earth_rate_latitude=float(rng.uniform(-60, 60)),
        noise_factor=float(np.exp(rng.uniform(np.log(0.4), np.log(1.6)))),
        scale_range=float(rng.uniform(0.0, 0.02)),
        misalignment_range=float(rng.uniform(0.0, 0.01)),
        gyroscope_rotation_range=float(rng.uniform(0.0, 0.02)),
        g_sensitivity_range=float(rng.uniform(0.0, 1.5e-3)),
        accelerometer_bias_range=float(rng.uniform(0.0, 0.4)),
        gyroscope_bias_range=float(rng.uniform(0.0, 0.03)),
        outliers=float(rng.choice([0.0, 0.002])),
        dropped_frames=float(rng.choice([0.0, 0.01])),
        dropped_samples=float(rng.choice([0.0, 5e-4])),
    )


def healthy_cameras(seed: int) -> CamerasScenario:
    """Draw views of a board with nothing wrong with them."""
    rng = np.random.default_rng([seed, 7])
    model = str(rng.choice(list(USUAL_LENSES)))
    kinds: tuple[BoardName, ...] = ("aprilgrid", "aprilgrid", "charuco", "checkerboard", "circlegrid")
    kind = kinds[int(rng.integers(len(kinds)))]
    tags = kind == "aprilgrid"
    whole = kind in ("checkerboard", "circlegrid")  # small enough to reach the corners of the image
    video = bool(rng.random() < 0.3)
    return CamerasScenario.with_lens(
        model,
        views=int(rng.integers(200, 400)) if video else int(rng.integers(30, 70)),
        between=int(rng.integers(5, 12)) if video else 1,
        rate_hz=15.0 if video else 1.0,
        cameras=2 if rng.random() < 0.3 else 1,
        baseline_m=float(rng.uniform(0.05, 0.15)),
        target_type=kind,
        target_cols=int(rng.integers(5, 8)) if tags else int(rng.integers(7, 10)),
        target_rows=int(rng.integers(4, 7)) if tags else int(rng.integers(5, 8)),
        target_size_m=float(rng.uniform(0.04, 0.09)),
        fill=(0.2, 0.55) if whole else (0.35, 0.85),
        spread=0.95,
        tilt_deg=float(rng.uniform(30, 45)),
        roll_deg=float(rng.uniform(15, 90)),
        pixel_noise_px=float(rng.uniform(0.05, 0.3)),
        view_bias_px=float(rng.choice([0.0, 0.03])),
        outliers=float(rng.choice([0.0, 0.002])),
        blurred_views=float(rng.choice([0.0, 0.03])),
    )
