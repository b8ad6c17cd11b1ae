"""How long it takes from a webcam's video of a turning platter to its rate, and how near that is to the truth.

    python benchmarks/platter_rate.py            a rendered video of 60 s at 15 Hz, 640 x 480 px, in three codecs
    python benchmarks/platter_rate.py --quick    of 20 s
    python benchmarks/platter_rate.py --write    keep the table in benchmarks/results-platter-rate.md

CPU time of this process, medians over several runs; decoding alone is measured beside it, since nobody can be faster.
"""

import argparse
import os
import resource
import tempfile
from collections.abc import Iterable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import cv2
from imu import HERE, Table, machine, median_cpu

from gnomon.calibrate.platter_rate import rate_from_video
from gnomon.readers.images.image_files import video_place
from gnomon.readers.images.video import video_stream
from gnomon.readers.recordings import ReadLog
from gnomon.simulate.images.platter_video import simulate_platter_video
from gnomon.simulate.scenarios.turntable import PlatterScenario
from gnomon.units import Units
from gnomon.writers.image_folders import save_video

RUNS = 3
FILES = {"mpeg4": "platter.mp4", "mjpeg": "platter.mkv", "ffv1": "lossless.mkv"}


def decode(path: Path) -> None:
    for frame in video_stream("cam0", video_place(path), ReadLog(units=Units())).frames([]):
        frame.decode()


def measured(seconds: float, codecs: Iterable[str] = FILES) -> Table:
    table = Table(
        f"The rate of a platter, 16 rpm, from {seconds:g} s at 15 Hz, 640 x 480 px",
        ("", "decoding [s]", "all of it [s]", "**times decoding**", "times real time", "error", "sigma"),
        f"CPU time, medians of {RUNS} runs; error and sigma relative. The sigma holds 5e-5 for the camera's clock.",
    )
    video = simulate_platter_video(PlatterScenario(duration_s=seconds), seed=1)
    images = list(video.images())
    with tempfile.TemporaryDirectory() as scratch:
        for codec in codecs:
            path = Path(scratch) / FILES[codec]
            save_video(path, images, video.t_ns, codec=codec)
            alone = median_cpu(lambda path=path: decode(path), RUNS)
            whole = median_cpu(lambda path=path: rate_from_video(path), RUNS)
            found = rate_from_video(path)
            table.add(
                codec, f"{alone:.2f}", f"{whole:.2f}", f"**{whole / alone:.2f}**", f"{seconds / whole:.0f}",
                f"{found.rate_rad_s / video.rate_rad_s - 1:+.1e}", f"{found.sigma_rad_s / found.rate_rad_s:.1e}",
            )  # fmt: skip
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how long it takes from a video to the rate of a platter.")
    parser.add_argument("--quick", action="store_true", help="20 s")
    parser.add_argument("--write", action="store_true", help="keep the table in benchmarks/results-platter-rate.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    table = measured(20.0 if options.quick else 60.0)
    print(table)
    print(
        f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB, the rendered images included"
    )
    if options.write:
        head = (
            "# Speed from a video to the rate of a platter\n\nWritten by `python benchmarks/platter_rate.py --write`."
        )
        (HERE / "results-platter-rate.md").write_text(f"{head} {machine()}.\n\n{table}", encoding="utf-8")


if __name__ == "__main__":
    main()
