"""What a rolling shutter that nobody states does to a camera-IMU calibration: the table of docs/rolling-shutter.md.

    python docs/make_rolling_shutter.py            six line delays, two motions, three seeds; some minutes
    python docs/make_rolling_shutter.py --seeds 1  fewer

Corners are simulated with the scatter of good detections (0.1 px), so that what is seen is the model's error alone.
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.geometry.rotations import rotvec_from_rotation

HERE = Path(__file__).resolve().parent
DELAYS_US = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0)
MOTIONS = ("normal", "shaky")
HEAD = (
    *("rotation [deg]", "translation [mm]", "time shift [us]", "gravity's direction [deg]"),
    *("scale of accelerometer [%]", "scale of gyroscope [%]", "reprojection [px]", "delay found [us]"),
)


def errors(motion: str, delay_us: float, seed: int, *, ignored: bool) -> list[float]:
    """Return the errors of one calibration, in the order of HEAD."""
    scenario = CameraImuScenario(
        duration_s=30.0, motion=motion, pixel_noise_px=0.1, line_delay_s=1e-6 * delay_us, known_line_delay=False,
        resolution=(752, 480), intrinsics=(458.0, 457.0, 367.0, 248.0),
    )  # fmt: skip
    simulation = simulate_camera_imu(scenario, seed)
    options = CameraImuOptions(fix=("cam0.line_delay",)) if ignored else CameraImuOptions()
    result = calibrate_camera_imu(simulation.recording, simulation.target, options)
    found, true = result.calibration.cameras["cam0"], simulation.truth.cameras["cam0"]
    imu, real = result.calibration.imus["imu0"], simulation.truth.imus["imu0"]
    down, up = result.diagnostics.gravity_target, simulation.gravity_target
    cosine = float(down @ up / np.linalg.norm(down) / np.linalg.norm(up))

    def scale(name: str) -> float:
        pair = (np.diag(getattr(side, name).sensitivity) for side in (imu, real))
        return 100 * float(np.abs(np.subtract(*pair)).max())

    return [
        float(np.degrees(np.linalg.norm(rotvec_from_rotation(true.T_cam_imu[:3, :3].T @ found.T_cam_imu[:3, :3])))),
        1e3 * float(np.linalg.norm(found.T_cam_imu[:3, 3] - true.T_cam_imu[:3, 3])),
        1e6 * (found.time_shift_cam_imu - true.time_shift_cam_imu),
        float(np.degrees(np.arccos(min(cosine, 1.0)))),
        scale("accelerometer"),
        scale("gyroscope"),
        result.calibration.assessment.camera_imu.reprojection_rms_px["cam0"],
        1e6 * found.camera.line_delay_s,
    ]


def table(rows: dict[tuple[str, float, bool], list[float]]) -> str:
    """Return the rows, medians over the seeds, as a table."""
    lines = ["| motion | line delay [us] | shutter | " + " | ".join(HEAD) + " |", "| --- " * (3 + len(HEAD)) + "|"]
    for (motion, delay_us, ignored), values in rows.items():
        shutter = "ignored" if ignored else "found"
        numbers = " | ".join(f"{value:.3g}" for value in values)
        lines.append(f"| {motion} | {delay_us:g} | {shutter} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    rows: dict[tuple[str, float, bool], list[float]] = {}
    for motion in MOTIONS:
        for delay_us in DELAYS_US:
            for ignored in (True, False):
                every = [errors(motion, delay_us, seed, ignored=ignored) for seed in range(1, options.seeds + 1)]
                rows[motion, delay_us, ignored] = np.median(np.abs(every), axis=0).tolist()
                sys.stderr.write(f"{motion} {delay_us:g} us: {rows[motion, delay_us, ignored]}\n")
    sys.stdout.write(table(rows) + "\n")


if __name__ == "__main__":
    main()
