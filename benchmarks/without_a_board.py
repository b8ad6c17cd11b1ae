"""How well a camera and an IMU are calibrated without a board: rendered rooms, with their truth.

    python benchmarks/without_a_board.py seeds 8 [--motion around] [--board | --both]
    python benchmarks/without_a_board.py hostile

`seeds` draws fresh rooms, paths and errors of an MPU-6000 (30 s, 20 Hz, gyroscope's walk 2e-4), and prints the error of
the translation, of the rotation and of the time shift over their sigmas, and the sigmas over the bound of Cramer and
Rao of the measurements that were used; with --board the same motion before an AprilGrid instead, whose corners are off
by 0.1 px, with --both one after the other. `hostile` prints what becomes of scenes that are hard, or hopeless.
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
    """Return errors, sigmas and their bounds (7,) each, of translation [mm], rotation [mdeg] and time shift [us].

    The bound is that of Cramer and Rao for the measurements that were used, at their noise as it was found: the inverse
    of the information of all that is estimated jointly.
    """
    found, true = (one.cameras["cam0"] for one in (result.calibration, truth))
    turn = np.degrees(rotvec_from_rotation(true.T_cam_imu[:3, :3].T @ found.T_cam_imu[:3, :3]))
    error = np.concatenate(
        [
            1e3 * (found.T_cam_imu[:3, 3] - true.T_cam_imu[:3, 3]),
            1e3 * turn,
            [1e6 * (found.time_shift_cam_imu - true.time_shift_cam_imu)],
        ]
    )
    trust = result.diagnostics.trust
    own = [k for name in Z_NAMES for k, of in enumerate(trust.names) if of.partition("[")[0] == f"cam0.{name}"]
    units = np.repeat([1e3, 1e3 * 180 / np.pi, 1e6], [3, 3, 1])
    return error, trust.sigma[own] * units, trust.ordinary_sigma[own] * units


def run_one(scenario, seed, label, *, board=False):
    """Print what became of one recording; return errors and sigmas, or None where there is no result."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            result, truth = calibrate_room(scenario, seed, Path(folder), board=board)
        except GnomonError as error:
            print(f"{label:26} refused: {error}", flush=True)
            return None
    error, sigma, bound = errors_of(result, truth)
    z = error / sigma
    calibration = result.calibration
    noted = sorted({finding.code for finding in calibration.assessment.findings if finding.severity != "info"})
    parts = {"t mm": slice(0, 3), "R mdeg": slice(3, 6), "shift us": slice(6, 7)}
    size = {
        name: (np.linalg.norm(error[k]), np.linalg.norm(sigma[k]), np.sqrt(np.mean(z[k] ** 2)), _over(sigma, bound, k))
        for name, k in parts.items()
    }
    told = "  ".join(
        f"{name} {off:.3g} ({by:.3g}) z {score:.2f} bound x {over:.2f}" for name, (off, by, score, over) in size.items()
    )
    spent_s = time.process_time() - begin
    print(f"{label:26} {calibration.verdict:4} {told}  {spent_s:.0f} s CPU  {' '.join(noted)}", flush=True)
    return error, sigma, bound


def _over(sigma, bound, part):
    return np.linalg.norm(sigma[part]) / np.linalg.norm(bound[part])


def print_summary(found, count):
    """Print what the results of some seeds come to."""
    error, sigma, bound = np.moveaxis(np.array(found), 1, 0)
    blocks = {"translation": slice(0, 3), "rotation": slice(3, 6), "time shift": slice(6, 7)}
    rms = {name: np.sqrt(np.mean((error / sigma)[:, k] ** 2)) for name, k in blocks.items()}
    print(f"{len(found)} of {count} converged; z rms " + ", ".join(f"{name} {z:.2f}" for name, z in rms.items()))
    means = np.sqrt([np.mean(sigma[:, k] ** 2) for k in blocks.values()])
    print("sigma, rms of an axis: t {:.3f} mm, R {:.1f} mdeg, shift {:.1f} us".format(*means))
    for name, k in blocks.items():
        over = np.array([_over(one, least, k) for one, least in zip(sigma, bound, strict=True)])
        print(f"{name}: sigma over bound, median {np.median(over):.2f}, most {over.max():.2f}")


def main():
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("seeds", "hostile"))
    parser.add_argument("count", nargs="?", type=int, default=8)
    parser.add_argument("--motion", default="normal")
    parser.add_argument("--first", type=int, default=100, help="the first seed")
    parser.add_argument("--board", action="store_true", help="before an AprilGrid")
    parser.add_argument("--both", action="store_true", help="without a board, and before an AprilGrid")
    given = parser.parse_args()
    if given.what == "hostile":
        for label, scenario in HOSTILE.items():
            run_one(scenario, given.first, label)
        return
    scenario = replace(USUAL, motion=given.motion)
    ways = [False, True] if given.both else [given.board]
    results = [
        [run_one(scenario, seed, f"seed {seed}{' board' * board}", board=board) for board in ways]
        for seed in range(given.first, given.first + given.count)
    ]
    for column, board in enumerate(ways):
        print("\nbefore an AprilGrid:" if board else "\nwithout a board:")
        print_summary([row[column] for row in results if row[column] is not None], given.count)
    if given.both:
        over = [_over(room[1], grid[1], slice(0, 3)) for room, grid in results if room is not None and grid is not None]
        within = sum(ratio <= 1.3 for ratio in over)
        print(f"\ntranslation: sigma over that before the board at the same motion, median {np.median(over):.2f}, ")
        print(f"at most 1.3 in {within} of {len(over)}")


if __name__ == "__main__":
    sys.exit(main())
