"""Accelerometers that are late: how often the default model finds the delay, how well, and what it does to the rest.

    python benchmarks/accelerometer_delays.py                         six delays, 20 seeds each, 30 s
    python benchmarks/accelerometer_delays.py --seeds 5 --seconds 60

One row a delay: how many recordings had the delay added to the model, its largest and its rms error in sigmas, and the
rms of the other blocks, the biases left out. Everything is drawn from the seeds.
"""

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from camera_imu_truth import errors
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu

DELAYS_MS = (0.0, 0.5, 0.8, 1.5, 3.0, 5.0)


def one(delay_s: float, seed: int, seconds: float) -> tuple[bool, float, dict[str, list[float]]]:
    """Return whether the delay was added, its error in sigmas, and the errors of the others in sigmas, by block."""
    scenario = CameraImuScenario(
        duration_s=seconds, random_extrinsics=True, lever_arm_m=0.15, accelerometer_delay_s=delay_s
    )
    simulation = simulate_camera_imu(scenario, seed)
    result = calibrate_camera_imu(simulation.recording, simulation.target, CameraImuOptions(gravity=scenario.gravity))
    blocks: dict[str, list[float]] = {}
    found = errors(result, simulation)
    for name, error, variance in zip(found.names, found.error, np.diag(found.covariance), strict=True):
        blocks.setdefault(name.partition("[")[0], []).append(float(error / np.sqrt(variance)))
    added = "accelerometer delay" in result.calibration.assessment.trust.added
    shift, calibration = result.calibration.imus["imu0"].accelerometer.time_shift_s, result.calibration
    z = float("nan")
    if shift is not None:
        z = (shift + delay_s) / float(calibration.sigma("imu0.accelerometer.time_shift"))
    blocks.pop("imu0.accelerometer_shift", None)
    return added, z, blocks


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--delays-ms", type=float, nargs="*", default=DELAYS_MS)
    options = parser.parse_args()
    print(f"{options.seeds} recordings of {options.seconds:g} s each")
    print("delay ms   added   largest z   z rms   others: z rms, worst block   CPU s each")
    for delay_ms in options.delays_ms:
        began, added, z = process_time(), 0, list[float]()
        rest: dict[str, list[float]] = {}
        for seed in range(options.first, options.first + options.seeds):
            was, own, blocks = one(1e-3 * delay_ms, seed, options.seconds)
            added += was
            z += [own] if was else []
            for block, found in blocks.items():
                rest.setdefault(block, []).extend(found)
        every = np.concatenate(list(rest.values()))
        rms = {block: float(np.sqrt(np.mean(np.square(found)))) for block, found in rest.items()}
        worst = max(rms, key=lambda block: rms[block])
        own = f"{np.abs(z).max():9.2f} {np.sqrt(np.mean(np.square(z))):9.2f}" if z else f"{'-':>9} {'-':>9}"
        each = (process_time() - began) / options.seeds
        print(
            f"{delay_ms:8.1f} {added:4d}/{options.seeds:<3d} {own}   {np.sqrt(np.mean(every**2)):10.2f}   "
            f"{worst} {rms[worst]:.2f}   {each:10.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
