"""How long a calibration of cameras alone takes, beside OpenCV's calibrateCamera on the same corners.

    python benchmarks/cameras.py [--runs 3]

60 views of an AprilGrid, simulated, one camera; CPU time (user and system), medians over several runs. OpenCV estimates
one lens by least squares; gnomon's time holds the choice among six lens models, the choice of views, the board's shape,
five hold-out folds, the covariance from the scatter between views, and the verdict.
"""

import argparse
import os
import statistics
import time
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import cv2
import numpy as np

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.options import CameraOptions
from gnomon.simulate.cameras import CamerasSimulation, simulate_cameras
from gnomon.simulate.scenarios.cameras import USUAL_LENSES, CamerasScenario

VIEWS, ALLOWED_S = 60, 3.0


def cpu_s(work, runs):
    """Return the median CPU time of some work [s]."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def with_opencv(simulation: CamerasSimulation) -> float:
    """Return the rms of the distances that OpenCV is left with [px]."""
    frames = simulation.recording.cameras["cam0"]
    edges = np.searchsorted(frames.frame, np.arange(len(frames.t_ns) + 1))
    seen = [slice(a, b) for a, b in pairwise(edges) if b > a]
    points = [simulation.target.points[frames.point[one]].astype(np.float32) for one in seen]
    pixels = [frames.pixels[one].astype(np.float32)[:, None] for one in seen]
    return cv2.calibrateCamera(points, pixels, frames.camera.resolution, None, None)[0]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    runs = parser.parse_args().runs
    cv2.setNumThreads(1)
    print("| lens | chosen | auto [s] | of 3 s allowed | stated model [s] | OpenCV [s] | auto over OpenCV |")
    print("|---|---|---|---|---|---|---|")
    for model in USUAL_LENSES:
        simulation = simulate_cameras(CamerasScenario.with_lens(model, views=VIEWS), 1)
        arguments = simulation.recording, simulation.target
        chosen = calibrate_cameras(*arguments).calibration.assessment.model
        auto = cpu_s(lambda arguments=arguments: calibrate_cameras(*arguments), runs)
        options = CameraOptions(model=(model,), board="stated")
        stated = cpu_s(lambda arguments=arguments, options=options: calibrate_cameras(*arguments, options), runs)
        opencv = "", ""
        if model.startswith("pinhole-radtan"):
            other = cpu_s(lambda simulation=simulation: with_opencv(simulation), runs)
            opencv = f"{other:.2f}", f"{auto / other:.2f}"
        print(f"| {model} | {chosen} | {auto:.2f} | {auto / ALLOWED_S:.2f} | {stated:.2f} | {' | '.join(opencv)} |")


if __name__ == "__main__":
    main()
