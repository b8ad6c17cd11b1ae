"""Make the figure of docs/validation.md: how much the detectors find, and how exactly, against blur and size.

    python docs/make_detector_figure.py             both boards, 24 images at each point; some minutes
    python docs/make_detector_figure.py --images 6  a quick look

Each point is the mean over rendered images (tests/rendered.py) of one blur and one size: random poses up to 45 degrees
askew, parts of the AprilGrid outside the image, noise of 2 grey levels, vignetting, foreign tags around the board.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
from detector import DETECTORS, judged, truths
from matplotlib.figure import Figure

from detection import Score
from rendered import Ranges

HERE = Path(__file__).resolve().parent
BLURS_PX = (0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.2, 2.6)
SIZES_PX = (12, 16, 24, 40, 64)
COLOURS = ("#b2182b", "#ef8a62", "#8c8c8c", "#67a9cf", "#2166ac")
WHAT = {"AprilGrid": "AprilGrid 6 x 6: side of a tag", "checkerboard": "Checkerboard 7 x 6: side of a square"}


def scores(name: str, size_px: float, images: int) -> list[Score]:
    """Return the score at each blur."""
    target, detect = DETECTORS[name]
    found = []
    for k, blur_px in enumerate(BLURS_PX):
        ranges = Ranges(
            tag_px=(size_px, size_px * 1.001),
            blur_px=(blur_px, blur_px),
            motion_px=(0.0, 0.0),
            noise=(2.0, 2.0),
            tilt_deg=(0.0, 45.0),
            covers=0,
        )
        found.append(judged(detect, truths(target, images, seed=1000 + k, ranges=ranges))[0])
    return found


def draw(images: int, path: Path) -> None:
    """Draw the figure."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, name in enumerate(DETECTORS):
        recall, error = axes[:, column]
        for size_px, colour in zip(SIZES_PX, COLOURS, strict=True):
            if name == "checkerboard" and size_px * 9 > 480:
                continue  # the board would not fit into the image
            row = scores(name, size_px, images)
            sys.stderr.write(
                f"{name}, {size_px} px: recall {' '.join(f'{100 * score.recall:.1f}' for score in row)} %\n"
            )
            enough = [k for k, score in enumerate(row) if len(score.error) >= 100]
            style = {"color": colour, "marker": "o", "markersize": 3.5, "linewidth": 1.4}
            recall.plot(BLURS_PX, [100 * score.recall for score in row], label=f"{size_px} px", **style)
            blurs = [BLURS_PX[k] for k in enough]
            error.plot(blurs, [np.sqrt(np.mean(row[k].error ** 2)) for k in enough], **style)
            stated = [np.sqrt(np.mean(np.concatenate(row[k].sigmas) ** 2)) for k in enough]
            error.plot(blurs, stated, color=colour, linewidth=1.0, linestyle=":")
        recall.set_title(WHAT[name], fontsize=10)
        recall.legend(fontsize=8, frameon=False, loc="lower left")
        error.set_xlabel("standard deviation of the blur [px]")
    axes[0, 0].set_ylabel("recall [%]")
    axes[0, 0].set_ylim(-3, 103)
    axes[1, 0].set_ylabel("error of a corner, rms per axis [px]\ndotted: as the detector states it")
    axes[1, 0].set_yscale("log")
    for axis in axes.ravel():
        axis.grid(color="#dddddd", linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=100)
    sys.stderr.write(f"{path}: {path.stat().st_size / 1024:.0f} kB\n")


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=24, help="images at each point")
    parser.add_argument("--output", type=Path, default=HERE / "detectors.png", help="PNG file to write")
    options = parser.parse_args()
    draw(options.images, options.output)


if __name__ == "__main__":
    main()
