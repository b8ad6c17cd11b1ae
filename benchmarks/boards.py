"""Detectors of ChArUco boards and circle grids beside those of OpenCV, on the same rendered images.

Written by `python benchmarks/boards.py --write` into benchmarks/results-boards.md. The time of an AprilGrid of the same
run is the baseline: on a busy machine only ratios tell.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))

from peer_detectors import peers  # noqa: E402

from detection import Score, Truth  # noqa: E402
from gnomon.detect.boards.aprilgrid import detect_aprilgrid  # noqa: E402
from gnomon.detect.boards.board import BoardView  # noqa: E402
from gnomon.detect.boards.charuco import detect_charuco  # noqa: E402
from gnomon.detect.boards.checkerboard_order import ambiguous_turns, renumber_view  # noqa: E402
from gnomon.detect.boards.circlegrid import CircleGridDetector  # noqa: E402
from gnomon.models.target import Target  # noqa: E402
from gnomon.recording import Floats  # noqa: E402
from gnomon.recording.recording import Grey  # noqa: E402
from rendered import Ranges, rendered_views  # noqa: E402

Detector = Callable[[Grey, Target], BoardView]


def detect_circlegrid(image: Grey, target: Target) -> BoardView:
    """Find a grid in one image, as if it were the first."""
    return CircleGridDetector(target).detect(image)


BOARDS: dict[str, tuple[Target, Detector, tuple[float, float]]] = {
    "AprilGrid 6 x 6": (
        Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3),
        detect_aprilgrid,
        (14.0, 80.0),
    ),
    "ChArUco 8 x 6": (
        Target.charuco(cols=8, rows=6, square_size_m=0.06, marker_size_m=0.045),
        detect_charuco,
        (16.0, 80.0),
    ),
    "circles 8 x 6": (Target.circlegrid(cols=8, rows=6, spacing_m=0.06), detect_circlegrid, (16.0, 50.0)),
    "circles 4 x 11, shifted": (
        Target.circlegrid(cols=4, rows=11, spacing_m=0.03, asymmetric=True),
        detect_circlegrid,
        (12.0, 40.0),
    ),
}


def truths(target: Target, count: int, side_px: tuple[float, float]) -> Iterator[Truth]:
    """Yield images with a cluttered wall, blur, motion, noise and uneven light, and what is true of them."""
    for view in rendered_views(target, count, 7, ranges=Ranges(tag_px=side_px)):
        yield Truth(
            image=view.image,
            target=target,
            visible=view.point,
            projected=view.projected,
            tags=view.tags,
            tag_px=view.tag_px,
        )


def nearest_end(view: BoardView, true: Floats, target: Target) -> BoardView:
    """Return the view numbered from the true end, as far as the board itself does not tell it (any end of a peer)."""
    if target.kind != "circlegrid" or len(view) < len(target) / 2:
        return view
    turns = ambiguous_turns(target)
    return min(
        (renumber_view(view, target, turn) for turn in turns),
        key=lambda end: float(np.nanmean(np.abs(end.pixels - true[end.point]))),
    )


def _mirrored(view: BoardView, target: Target) -> BoardView:
    """Return the view of a peer whose order is another one: columns first, counted the other way round."""
    if target.kind != "circlegrid" or len(view) != len(target):
        return view
    grid = view.pixels.reshape(target.rows, target.cols, 2)
    across, along = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    turn = along[0] * across[1] - along[1] * across[0]
    wrong = turn > 0 if not target.asymmetric else turn < 0
    pixels = (grid[::-1] if wrong else grid).reshape(-1, 2)
    return BoardView(point=view.point, pixels=pixels, sigma_px=view.sigma_px)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=100)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    lines = ["| board | detector | found | wrong | rms per axis [px] | error over sigma | CPU over AprilGrid's |"]
    lines.append("|---|---|---|---|---|---|---|")
    baseline = None
    for name, (target, own, side_px) in BOARDS.items():
        images = list(truths(target, options.images, side_px))
        others = {} if target.kind == "aprilgrid" else peers(target.kind)
        for who, detect in {"gnomon": own, **others}.items():
            score, times = Score(), []
            for truth in images:
                start = time.process_time()
                view = detect(truth.image, target)
                times.append(time.process_time() - start)
                if who != "gnomon":
                    view = _mirrored(view, target)
                score.add(truth, nearest_end(view, truth.projected, target))
            middle = statistics.median(times)
            baseline = baseline or middle
            z = f"{score.z_rms:.2f}" if who == "gnomon" else ""
            rms = float(np.sqrt(np.mean(score.error**2))) if len(score.error) else float("nan")
            cells = (
                f"{100 * score.corner_recall:.1f} %",
                f"{score.wrong}",
                f"{rms:.3f}",
                z,
                f"{middle / baseline:.2f}",
            )
            lines.append(f"| {name} | {who} | {' | '.join(cells)} |")
            print(lines[-1], f"{1e3 * middle:.1f} ms", flush=True)
    if options.write:
        head = f"# Boards\n\nWritten by `python benchmarks/boards.py --write`, {options.images} images each.\n\n"
        (HERE / "results-boards.md").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
