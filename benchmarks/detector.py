"""How much of a board the detectors find, how exactly, and in which time.

    python benchmarks/detector.py                 500 rendered images of each board, and the images in $GNOMON_DATA
    python benchmarks/detector.py --images 60     fewer
    python benchmarks/detector.py --write         keep the tables in benchmarks/results-detector.md

The rendered images (tests/rendered.py) are hard on purpose: blur to 1.5 px, smear to 3 px, noise to 5 grey levels, tags
of 12 to 80 px up to 55 degrees askew, vignetting, patches in front of the board, parts of it outside the image, and
foreign tags all around. Other detectors run on the same images: OpenCV's, and aprilgrid where it is installed.

CPU times are of one thread, median over the images; the gain of a second thread is wall time and depends on what else
runs.
"""

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import cv2
import numpy as np
from imu import DATA, HERE, Table, machine
from peer_detectors import peers

from detection import Score, Truth, with_truth
from gnomon.detect.boards.aprilgrid import detect_aprilgrid
from gnomon.detect.boards.board import BoardView
from gnomon.detect.boards.checkerboard import detect_checkerboard
from gnomon.models.target import Target
from gnomon.recording.recording import Grey
from rendered import Ranges, rendered_views

Detector = Callable[[Grey, Target], BoardView]

SEED = 11
APRILGRID = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
CHECKERBOARD = Target.checkerboard(cols=7, rows=6, row_spacing_m=0.08, col_spacing_m=0.08)
DETECTORS: dict[str, tuple[Target, Detector]] = {
    "AprilGrid": (APRILGRID, detect_aprilgrid),
    "checkerboard": (CHECKERBOARD, detect_checkerboard),
}
GIVEN = {"AprilGrid": "a-aprilgrid-full", "checkerboard": "d-checkerboard-ideal-imu"}
BLURS = (0.0, 0.6, 1.0, 1.3, 9.9)
SIZES = (0.0, 16.0, 24.0, 40.0, 999.0)
QUALITY = (
    *("images", "**recall** [%]", "corners [%]", "wrong corners", "rms u [px]", "rms v [px]"),
    *("bias u [px]", "bias v [px]", "rms of error/sigma"),
)


def truths(target: Target, count: int, *, seed: int = SEED, ranges: Ranges | None = None) -> Iterator[Truth]:
    """Yield rendered images with what is true of them."""
    for view in rendered_views(target, count, seed, ranges=ranges):
        yield Truth(
            image=view.image,
            target=target,
            visible=view.point,
            projected=view.projected,
            tags=view.tags,
            tag_px=view.tag_px,
            blur_px=view.blur_px,
            noise=view.noise,
        )


def judged(detect: Detector, images: Iterable[Truth]) -> tuple[Score, list[float], list[tuple[Truth, BoardView]]]:
    """Return the score, the CPU time of each image [s], and all views."""
    score, times, views = Score(), [], []
    for truth in images:
        start = time.process_time()
        view = detect(truth.image, truth.target)
        times.append(time.process_time() - start)
        score.add(truth, view)
        views.append((truth, view))
    return score, times, views


def cells(score: Score) -> tuple[str, ...]:
    (rms_u, rms_v), (bias_u, bias_v) = score.rms, score.bias
    return (
        str(score.images),
        f"**{100 * score.recall:.1f}**",
        f"{100 * score.corner_recall:.1f}",
        str(score.wrong),
        *(f"{value:.4f}" for value in (rms_u, rms_v)),
        *(f"{value:+.4f}" for value in (bias_u, bias_v)),
        f"{score.z_rms:.2f}",
    )


def breakdown(name: str, views: list[tuple[Truth, BoardView]]) -> Table:
    """Return recall and error by blur and by size."""
    table = Table(
        f"{name}: recall and rms error by blur and size",
        (
            "side of a tag or square [px]",
            *(f"blur {a:g} to {b:g} px" for a, b in pairwise(BLURS)),
        ),
        "Recall, rms error per axis. The blur is of lens and motion together.",
    )
    for low, high in pairwise(SIZES):
        row = [f"{low:g} to {high:g}"]
        for least, most in pairwise(BLURS):
            score = Score()
            for truth, view in views:
                if low <= truth.tag_px < high and least <= truth.blur_px < most:
                    score.add(truth, view)
            rms = float(np.sqrt(np.mean(score.error**2))) if len(score.error) else float("nan")
            row.append(f"{100 * score.recall:.1f} %, {rms:.3f} px" if score.images else "")
        table.add(*row)
    return table


def rendered_tables(count: int) -> list[Table]:
    quality = Table("Rendered images, 752 x 480", ("", *QUALITY, "CPU [ms]"), _QUALITY_NOTE)
    tables = [quality]
    for name, (target, detect) in DETECTORS.items():
        score, times, views = judged(detect, truths(target, count))
        quality.add(f"gnomon, {name}", *cells(score), f"{1e3 * statistics.median(times):.1f}")
        tables.append(breakdown(name, views))
        for other, peer in peers(target.kind).items():
            score, times, _ = judged(peer, (truth for truth, _ in views))
            quality.add(f"{other}, {name}", *cells(score), f"{1e3 * statistics.median(times):.1f}")
    return tables


def given_table() -> Table | None:
    """Return the quality on the images in rendered-camimu, which gnomon did not render."""
    table = Table("Images of rendered-camimu, 640 x 480", ("", *QUALITY), _QUALITY_NOTE)
    for name, (target, detect) in DETECTORS.items():
        folder = DATA / "rendered-camimu" / GIVEN[name] / "images"
        if not folder.is_dir():
            print(f"{folder}: absent, left out", file=sys.stderr)
            continue
        images = with_truth(folder, target)
        for who, detector in {"gnomon": detect, **peers(target.kind)}.items():
            table.add(f"{who}, {name}", *cells(judged(detector, images)[0]))
    return table if table.rows else None


def real_table() -> Table | None:
    """Return how many tags are found in EuRoC's images."""
    table = Table("Images of euroc-cam-april, 752 x 480", ("", "tags found of 36", "corners of 144", "CPU [ms]"))
    for path in sorted((DATA / "euroc-cam-april").glob("cam?_*.png")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        for who, detector in {"gnomon": detect_aprilgrid, **peers("aprilgrid")}.items():
            times = []
            for _ in range(7):
                start = time.process_time()
                view = detector(image, APRILGRID)
                times.append(time.process_time() - start)
            corners = APRILGRID.point_of_tag_corner(np.arange(36)[:, None], np.arange(4))
            whole = int(np.count_nonzero(np.isin(corners, view.point).all(axis=1)))
            table.add(f"{who}, {path.name[:4]}", str(whole), str(len(view)), f"{1e3 * statistics.median(times):.1f}")
    return table if table.rows else None


def thread_table(count: int) -> Table:
    """Return how much faster two threads are."""
    table = Table(
        "Threads", ("", "one [images/s]", "two [images/s]", "ratio"), "Wall time, best of three rounds; easier images."
    )
    easy = Ranges(tag_px=(25.0, 60.0), blur_px=(0.4, 0.8), motion_px=(0.0, 1.0), noise=(1.0, 2.0), covers=0)
    for name, (target, detect) in DETECTORS.items():
        images = [truth.image for truth in truths(target, count, ranges=easy)]
        rates = []
        for workers in (1, 2):
            with ThreadPoolExecutor(workers) as pool:
                walls = []
                for _ in range(3):
                    start = time.perf_counter()
                    list(pool.map(lambda image: detect(image, target), images))  # noqa: B023 - used at once
                    walls.append(time.perf_counter() - start)
            rates.append(len(images) / min(walls))
        table.add(name, *(f"{rate:.0f}" for rate in rates), f"{rates[1] / rates[0]:.2f}")
    return table


_QUALITY_NOTE = (
    "Recall: of the tags that are visible as a whole, all four corners; of a checkerboard its inner corners. A corner "
    "is wrong if it is farther than 2 px and a quarter of a tag from where it truly is; those are not in the errors."
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=500, help="rendered images of each board")
    parser.add_argument("--write", action="store_true", help="keep the tables in benchmarks/results-detector.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    tables: list[Table] = []
    steps = (given_table, real_table, lambda: thread_table(min(40, options.images)))
    for step in steps:
        table = step()
        if table is not None:
            print(table, flush=True)
            tables.append(table)
    for table in rendered_tables(options.images):
        print(table, flush=True)
        tables.append(table)
    if options.write:
        head = "# Detectors of boards\n\nWritten by `python benchmarks/detector.py --write`."
        text = "\n".join([f"{head} {machine()}, OpenCV {cv2.__version__}.\n", *map(str, tables)])
        (HERE / "results-detector.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
