"""How well a camera and an IMU are calibrated without a board: rendered rooms, with their truth.

    python benchmarks/without_a_board.py seeds 8 [--motion around] [--board]
    python benchmarks/without_a_board.py hostile

`seeds` draws fresh rooms, paths and errors of an MPU-6000 (30 s, 20 Hz, gyroscope's walk 2e-4), and prints the error of
the translation, of the rotation and of the time shift over their sigmas; with --board the same motion before an
AprilGrid instead, whose corners are off by 0.1 px. `hostile` prints what becomes of scenes that are hard, or hopeless.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import gnomon
from gnomon.errors import GnomonError
from gnomon.geometry.rotation_vector import rotvec_from_rotation
from gnomon.simulate import RoomScenario, simulate_camera_imu
from gnomon.writers.camera_imu_recording import save_camera_imu_recording

USUAL = RoomScenario(imu="thesis", gyroscope_random_walk=2e-4, random_extrinsics=True)
HOSTILE = {
    "at rest": replace(USUAL, motion="static"),
    "hardly moved": replace(USUAL, motion="slow"),
    "never turned": replace(USUAL, motion="translation"),
    "turned about one axis": replace(USUAL, motion="one-axis"),
    "painted walls and boxes": replace(USUAL, surface="plain"),
    "painted walls alone": replace(USUAL, surface="plain", furniture=0),
    "one tile again and again": replace(USUAL, surface="repeated"),
    "12 of 22 boxes move": replace(USUAL, moving=12),
    "in the dark": replace(USUAL, light=0.06, image_noise=4.0),
    "blurred by motion": replace(USUAL, exposure_s=0.03, motion="shaky"),
    "unknown rolling shutter": replace(USUAL, line_delay_s=3e-5),
    "large empty hall": replace(USUAL, room_m=(14.0, 6.0, 14.0), furniture=0),
}
Z_NAMES = ("T_cam_imu.translation", "T_cam_imu.rotation", "time_shift_cam_imu")


def calibrate_room(scenario, seed, folder, *, board):
    """Return the result and the truth of one recording; the lens is known, as its file in the folder says."""
    rig = scenario.rig()
    if board:
        rig = replace(rig, images=False, pixel_noise_px=0.1)
    simulation = simulate_camera_imu(rig, seed)
    save_camera_imu_recording(simulation, folder, room=None if board else scenario)
    if scenario.line_delay_s:  # nobody said so
        chain = folder / "camchain.yaml"
        chain.write_text("".join(line for line in chain.read_text().splitlines(True) if "line_delay" not in line))
    files = {"cam": folder / "camchain.yaml", "imu": folder / "imu.yaml"}
    recording, target = gnomon.read_camera_imu(folder, target=folder / "target.yaml" if board else "none", **files)
    return gnomon.calibrate_camera_imu(recording, target), simulation.truth


def errors_of(result, truth):
    """Return errors and sigmas (7,) each, of translation [mm], rotation [mdeg] and time shift [us]."""
    found, true = (one.cameras["cam0"] for one in (result.calibration, truth))
    turn = np.degrees(rotvec_from_rotation(true.T_cam_imu[:3, :3].T @ found.T_cam_imu[:3, :3]))
    error = np.concatenate(
        [
            1e3 * (found.T_cam_imu[:3, 3] - true.T_cam_imu[:3, 3]),
            1e3 * turn,
            [1e6 * (found.time_shift_cam_imu - true.time_shift_cam_imu)],
        ]
    )
    uncertain = result.calibration.uncertainty
    sigma = [
        np.sqrt(uncertain.matrix[k, k])
        for name in Z_NAMES
        for k, scalar in enumerate(uncertain.names)
        if scalar.partition("[")[0] == f"cam0.{name}"
    ]
    return error, np.array(sigma) * np.repeat([1e3, 1e3 * 180 / np.pi, 1e6], [3, 3, 1])


def run_one(scenario, seed, label, *, board=False):
    """Print what became of one recording; return errors and sigmas, or None where there is no result."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            result, truth = calibrate_room(scenario, seed, Path(folder), board=board)
        except GnomonError as error:
            print(f"{label:26} refused: {error}", flush=True)
            return None
    error, sigma = errors_of(result, truth)
    z = error / sigma
    calibration = result.calibration
    noted = sorted({finding.code for finding in calibration.assessment.findings if finding.severity != "info"})
    parts = {"t mm": slice(0, 3), "R mdeg": slice(3, 6), "shift us": slice(6, 7)}
    size = {
        name: (np.linalg.norm(error[k]), np.linalg.norm(sigma[k]), np.sqrt(np.mean(z[k] ** 2)))
        for name, k in parts.items()
    }
    told = "  ".join(f"{name} {off:.3g} ({by:.3g}) z {score:.2f}" for name, (off, by, score) in size.items())
    spent_s = time.process_time() - begin
    print(f"{label:26} {calibration.verdict:4} {told}  {spent_s:.0f} s CPU  {' '.join(noted)}", flush=True)
    return error, sigma


def main():
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("seeds", "hostile"))
    parser.add_argument("count", nargs="?", type=int, default=8)
    parser.add_argument("--motion", default="normal")
    parser.add_argument("--first", type=int, default=100, help="the first seed")
    parser.add_argument("--board", action="store_true")
    given = parser.parse_args()
    if given.what == "hostile":
        for label, scenario in HOSTILE.items():
            run_one(scenario, given.first, label)
        return
    scenario = replace(USUAL, motion=given.motion)
    seeds = range(given.first, given.first + given.count)
    found = [one for seed in seeds if (one := run_one(scenario, seed, f"seed {seed}", board=given.board)) is not None]
    z = np.array([error / sigma for error, sigma in found])
    blocks = {"translation": z[:, :3], "rotation": z[:, 3:6], "time shift": z[:, 6:]}
    print(
        f"{len(found)} of {given.count} converged; z rms "
        + ", ".join(f"{k} {np.sqrt(np.mean(v**2)):.2f}" for k, v in blocks.items())
    )
    print("mean sigma: t {:.3f} mm, R {:.1f} mdeg, shift {:.1f} us".format(*_means(found)))


def _means(found):
    sigma = np.array([sigma for _, sigma in found])
    return np.sqrt(np.mean(sigma[:, :3] ** 2)), np.sqrt(np.mean(sigma[:, 3:6] ** 2)), sigma[:, 6].mean()


if __name__ == "__main__":
    sys.exit(main())
