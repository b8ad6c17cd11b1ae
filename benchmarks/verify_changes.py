"""Calibrations in which one number is changed, verified by short fresh recordings; the right block must be named.

    python benchmarks/verify_changes.py                     24 changes, 5 recordings each, and 100 that hold
    python benchmarks/verify_changes.py --seeds 2 --healthy 10 --only gyroscope
    python benchmarks/verify_changes.py --of cameras field --healthy 40    two cameras alone, a magnetometer

A calibration is made from one simulated recording; a number of it is changed; a fresh recording of 30 to 40 s of the
same sensor verifies it. Named: the block that was changed is among those that moved. z: of its size. The time to verify
is told over that of the calibration that is verified.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np

import gnomon
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.simulate import (
    CameraImuScenario,
    CamerasScenario,
    FieldScenario,
    Scenario,
    simulate,
    simulate_camera_imu,
    simulate_cameras,
    simulate_magnetometer,
)

SHORT = {"intervals": 12, "t_init_s": 6.0, "hold_s": (1.9, 2.1), "motion_s": (0.8, 1.2)}
Change = Callable[[Any], Any]
CALIBRATING_S: dict[int, float] = {}
"""CPU time of each calibration, by its identity."""


def timed(calibrate: Callable[[], Any]) -> Any:
    began = time.process_time()
    calibration = calibrate().calibration
    CALIBRATING_S[id(calibration)] = time.process_time() - began
    return calibration


@cache
def of_imu(seed: int):
    drawn = {"g_sensitivity": 3e-4, "sensor_seed": seed}
    first = simulate(Scenario(**drawn), seed)[0]
    calibration = timed(lambda: gnomon.calibrate_imu(first))
    return calibration, simulate(Scenario(**drawn, **SHORT), seed + 5000)[0], None


@cache
def of_rig(seed: int):
    scenario = CameraImuScenario(duration_s=60.0, sensor_seed=seed)
    first = simulate_camera_imu(scenario, seed)
    second = simulate_camera_imu(replace(scenario, duration_s=30.0), seed + 5000)
    calibration = timed(lambda: gnomon.calibrate_camera_imu(first.recording, first.target))
    return calibration, second.recording, second.target


@cache
def of_cameras(seed: int):
    scenario = CamerasScenario(cameras=2)
    first = simulate_cameras(scenario, seed)
    second = simulate_cameras(replace(scenario, views=25), seed + 5000)
    calibration = timed(lambda: gnomon.calibrate_cameras(first.recording, first.target))
    return calibration, second.recording, second.target


@cache
def of_field(seed: int):
    scenario = FieldScenario(sensor_seed=seed)
    first = simulate_magnetometer(scenario, seed)[0]
    calibration = timed(lambda: gnomon.calibrate_magnetometer(first))
    return calibration, simulate_magnetometer(replace(scenario, duration_s=40.0), seed + 5000)[0], None


def triad(name: str, **change: Change) -> Change:
    def changed(calibration: Any) -> Any:
        imu = calibration.imus["imu0"]
        sensor = getattr(imu, name)
        moved = {field: how(getattr(sensor, field)) for field, how in change.items()}
        return replace(calibration, imus={"imu0": replace(imu, **{name: replace(sensor, **moved)})})

    return changed


def camera(of: str = "cam0", **change: Change) -> Change:
    def changed(calibration: Any) -> Any:
        one = calibration.cameras[of]
        moved = {field: how(getattr(one, field)) for field, how in change.items()}
        return replace(calibration, cameras={**calibration.cameras, of: replace(one, **moved)})

    return changed


def refocused(*by: float) -> Change:
    """Return a change of fu, fv [relative], pu, pv [px]."""

    def change(lens: Any) -> Any:
        values = lens.parameters.copy()
        values[:4] += np.array([values[0] * by[0], values[1] * by[1], by[2], by[3]])
        return lens.with_parameters(values)

    return change


def exchanged(calibration: Any) -> Any:
    """Return the calibration of two cameras as it is where their plugs are exchanged."""
    zero, one = calibration.cameras["cam0"], calibration.cameras["cam1"]
    turned_back = replace(one, camera=zero.camera, T_cam_body=np.linalg.inv(one.T_cam_body))
    return replace(calibration, cameras={"cam0": replace(zero, camera=one.camera), "cam1": turned_back})


def scaled(*factors: float) -> Change:
    return lambda matrix: np.array(factors)[:, None] * matrix


def skewed(row: int, column: int) -> Change:
    def change(matrix: Any) -> Any:
        moved = matrix.copy()
        moved[row, column] += np.radians(0.2) * np.linalg.norm(matrix[row])
        return moved

    return change


def turned(axis: tuple[float, float, float], degrees: float) -> Change:
    return lambda matrix: matrix @ rotation_from_rotvec(np.radians(degrees) * np.array(axis))


def shifted(*by: float) -> Change:
    return lambda values: values + np.array(by)


def posed(
    rotation_deg: tuple[float, float, float] = (0, 0, 0), way_m: tuple[float, float, float] = (0, 0, 0)
) -> Change:
    def change(T: Any) -> Any:
        moved = T.copy()
        moved[:3, :3] = T[:3, :3] @ rotation_from_rotvec(np.radians(rotation_deg))
        moved[:3, 3] += way_m
        return moved

    return change


IMU: dict[str, tuple[str | tuple[str, ...], Change]] = {
    "gyroscope scale x 0.2 %": ("gyroscope.scale", triad("gyroscope", sensitivity=scaled(1.002, 1, 1))),
    "gyroscope scale z -0.2 %": ("gyroscope.scale", triad("gyroscope", sensitivity=scaled(1, 1, 0.998))),
    "gyroscope scale, all 0.2 %": ("gyroscope.scale", triad("gyroscope", sensitivity=scaled(1.002, 1.002, 1.002))),
    "accelerometer scale y 0.2 %": ("accelerometer.scale", triad("accelerometer", sensitivity=scaled(1, 1.002, 1))),
    "gravity 0.2 % (all scales)": ("accelerometer.scale", triad("accelerometer", sensitivity=scaled(*[1.002] * 3))),
    "accelerometer axis 0.2 deg": ("accelerometer.misalignment", triad("accelerometer", sensitivity=skewed(2, 1))),
    "accelerometer axis y 0.2 deg": ("accelerometer.misalignment", triad("accelerometer", sensitivity=skewed(1, 0))),
    "gyroscope axis 0.2 deg": ("gyroscope.misalignment", triad("gyroscope", sensitivity=skewed(1, 0))),
    "gyroscope turned 0.2 deg": ("gyroscope.rotation", triad("gyroscope", sensitivity=turned((0.6, -0.64, 0.48), 0.2))),
    "gyroscope turned about z": ("gyroscope.rotation", triad("gyroscope", sensitivity=turned((0, 0, 1), 0.2))),
    "gyroscope bias 1.7 deg/s": ("gyroscope.bias", triad("gyroscope", bias=shifted(0, 0.03, 0))),
    "accelerometer bias 0.5 m/s^2": ("accelerometer.bias", triad("accelerometer", bias=shifted(0, 0, 0.5))),
    "g-sensitivity": ("gyroscope.g_sensitivity", triad("gyroscope", g_sensitivity=lambda g: g + 1e-3 * np.eye(3))),
    "sign of a gyroscope axis": ("gyroscope.scale", triad("gyroscope", sensitivity=scaled(1, -1, 1))),
    "sign of an accelerometer axis": ("accelerometer.scale", triad("accelerometer", sensitivity=scaled(1, 1, -1))),
}
RIG: dict[str, tuple[str | tuple[str, ...], Change]] = {
    "R_cb 0.1 deg": ("cam0.rotation", camera(T_cam_body=posed((0, 0.1, 0)))),
    "R_cb 0.1 deg about z": ("cam0.rotation", camera(T_cam_body=posed((0, 0, 0.1)))),
    "t 2 mm along x": ("cam0.translation", camera(T_cam_body=posed(way_m=(0.002, 0, 0)))),
    "t 2 mm along z": ("cam0.translation", camera(T_cam_body=posed(way_m=(0, 0, -0.002)))),
    "shift 1 ms": ("cam0.time_shift", camera(time_shift_cam_imu=lambda shift: shift + 1e-3)),
    "rig: gyroscope scale 0.2 %": ("gyroscope.scale", triad("gyroscope", sensitivity=scaled(1.002, 1, 1))),
    "rig: accelerometer scale 0.2 %": ("accelerometer.scale", triad("accelerometer", sensitivity=scaled(1, 1.002, 1))),
    "rig: gyroscope turned 0.2 deg": ("gyroscope.rotation", triad("gyroscope", sensitivity=turned((0, 1, 0), 0.2))),
    "rig: gyroscope bias 1.7 deg/s": ("gyroscope.bias", triad("gyroscope", bias=shifted(0.03, 0, 0))),
}


CAMERAS: dict[str, tuple[str | tuple[str, ...], Change]] = {
    "cam0: focal length 0.2 %": ("cam0.lens", camera(camera=refocused(0.002, 0.002, 0, 0))),
    "cam1: focal length -0.2 %": ("cam1.lens", camera("cam1", camera=refocused(-0.002, -0.002, 0, 0))),
    "cam0: principal point 2 px": ("cam0.lens", camera(camera=refocused(0, 0, 2, 0))),
    "cam1: principal point -2 px": ("cam1.lens", camera("cam1", camera=refocused(0, 0, 0, -2))),
    "baseline 2 %": ("cam0.translation", camera("cam1", T_cam_body=posed(way_m=(0.0022, 0, 0)))),
    "cam1 moved 2 mm along z": ("cam0.translation", camera("cam1", T_cam_body=posed(way_m=(0, 0, 0.002)))),
    "cam1 turned 0.1 deg about y": ("cam0.rotation", camera("cam1", T_cam_body=posed((0, 0.1, 0)))),
    "cam1 turned 0.1 deg about z": ("cam0.rotation", camera("cam1", T_cam_body=posed((0, 0, 0.1)))),
    "cameras exchanged": ("cam0.translation", exchanged),
}
SHAPE = ("magnetometer.scale", "magnetometer.misalignment", "magnetometer.rotation")
FIELD: dict[str, tuple[str | tuple[str, ...], Change]] = {
    "hard iron 1.5 uT along x": ("magnetometer.bias", triad("magnetometer", bias=shifted(1.5, 0, 0))),
    "hard iron 1.5 uT along z": ("magnetometer.bias", triad("magnetometer", bias=shifted(0, 0, -1.5))),
    "soft iron, z 3 %": (SHAPE[:1], triad("magnetometer", sensitivity=scaled(1, 1, 1.03))),
    "soft iron, xy 3 %": (SHAPE, triad("magnetometer", sensitivity=lambda m: m @ (np.eye(3) + 0.03 * MIXED))),
    "sign of a magnetometer axis": (SHAPE[:1], triad("magnetometer", sensitivity=scaled(1, -1, 1))),
}
MIXED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
SENSORS = {"imu": (of_imu, IMU), "rig": (of_rig, RIG), "cameras": (of_cameras, CAMERAS), "field": (of_field, FIELD)}


def verified(make: Callable[[int], Any], seed: int, change: Change = lambda same: same):
    """Return what is said of a changed calibration, how the change looks in its block, and the CPU time [s]."""
    calibration, recording, target = make(seed)
    wrong = change(calibration)
    began = time.process_time()
    found = gnomon.verify(wrong, recording, target)
    return found, calibration, wrong, time.process_time() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--healthy", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default="")
    parser.add_argument("--of", nargs="+", choices=SENSORS, default=["imu", "rig"])
    stated = parser.parse_args()
    named, total, every = 0, 0, []
    for make, changes in (SENSORS[of] for of in stated.of):
        for name, (path, change) in changes.items():
            if stated.only not in name:
                continue
            said, zs, shares = [], [], []
            for seed in range(stated.first, stated.first + stated.seeds):
                found, calibration, wrong, spent = verified(make, seed, change)
                moved = [block for block in found.moved if block.path.endswith(path)]
                said.append(bool(moved))
                shares.append(spent / CALIBRATING_S[id(calibration)])
                if said[-1]:
                    true = gnomon.compare(calibration, wrong, names=("a", "b")).difference("a", "b", moved[0].path)
                    zs += ((moved[0].values - true.values) / moved[0].sigma).tolist()
            named, total = named + sum(said), total + len(said)
            every += zs
            z = f"z rms {np.sqrt(np.mean(np.square(zs))):.2f}, largest {np.abs(zs).max():.1f}" if zs else ""
            print(
                f"{name:32s} named {sum(said)} of {len(said)}  {z}  {np.median(shares):.2f} of calibrating", flush=True
            )
    rms = f", z rms of all {len(every)} numbers {np.sqrt(np.mean(np.square(every))):.2f}" if every else ""
    print(f"named {named} of {total}{rms}")
    states: dict[str, int] = {}
    taken: dict[str, list[float]] = {}
    kinds = ["rig", "imu", "imu", "imu"] if stated.of == ["imu", "rig"] else stated.of
    for seed in range(stated.first, stated.first + stated.healthy):
        of = kinds[seed % len(kinds)]
        found, calibration, _, spent = verified(SENSORS[of][0], seed)
        taken.setdefault(of, []).append(spent / CALIBRATING_S[id(calibration)])
        states[found.state] = states.get(found.state, 0) + 1
        if found.state == "moved":
            print(f"seed {seed} of {of}: {[block.path for block in found.moved]}")
    print(f"that hold: {states}")
    for of, shares in taken.items():
        print(f"time to verify one that holds, {of}: {np.median(shares):.2f} of calibrating")


if __name__ == "__main__":
    main()
