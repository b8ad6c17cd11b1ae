"""Make the drawings of the boards that docs/boards.md shows, or measure how small a board may be seen.

    python docs/make_boards.py            the drawings, docs/boards/*.svg
    python docs/make_boards.py --sizes    the table of sizes: share of a board's points that are found, over their size

A drawing shows what is printed in grey, the points with their numbers, the ids of tags and markers, and the axes.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gnomon.models.board_pattern import black_square, board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.writers.board_sheet import board_paths, sheet_rotation

Floats = NDArray[np.float64]

FOLDER = Path(__file__).parent / "boards"
BOARDS = {
    "aprilgrid": Target.aprilgrid(tag_cols=3, tag_rows=2, tag_size_m=0.04, tag_spacing=0.3),
    "aprilgrid-plain": Target.aprilgrid(
        tag_cols=3, tag_rows=2, tag_size_m=0.04, tag_spacing=0.3, border_bits=1, first_tag=36
    ),
    "checkerboard": Target.checkerboard(cols=6, rows=3, row_spacing_m=0.024, col_spacing_m=0.024),
    "circlegrid": Target.circlegrid(cols=6, rows=4, spacing_m=0.026),
    "circlegrid-asymmetric": Target.circlegrid(cols=4, rows=5, spacing_m=0.022, asymmetric=True),
    "charuco": Target.charuco(cols=6, rows=4, square_size_m=0.028, marker_size_m=0.02),
    "charuco-legacy": Target.charuco(cols=6, rows=4, square_size_m=0.028, marker_size_m=0.02, legacy=True),
}
_WIDTH_PX, _ROOM, _ARROW, _FONT = 560, 9.0, 12.0, 4.2
_POINT, _ID = "#0b57d0", "#b3261e"


def drawing(target: Target) -> str:
    """Return a drawing as SVG, in millimetres."""
    pattern = board_pattern(target)
    turn = sheet_rotation(target)
    corners = 1000 * pattern.sheet.reshape(2, 2) @ turn.T
    low, high = corners.min(axis=0) - _ROOM, corners.max(axis=0) + _ROOM
    width, height = high - low

    def placed(points: Floats) -> Floats:
        return (1000 * points[..., :2] @ turn.T - low) * [1, -1] + [0, height]

    outlines = "".join(_path(placed(path)[:: 4 if target.kind == "circlegrid" else 1]) for path in board_paths(pattern))
    x0, y0 = placed(pattern.sheet.reshape(2, 2)).min(axis=0)
    sheet_width, sheet_height = (high - low) - 2 * _ROOM
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH_PX}" height="{_WIDTH_PX * height / width:.0f}" '
        f'viewBox="0 0 {width:.2f} {height:.2f}" font-family="Helvetica, Arial, sans-serif">',
        f'<rect width="{width:.2f}" height="{height:.2f}" fill="#fff"/>',
        f'<rect x="{x0:.2f}" y="{y0:.2f}" width="{sheet_width:.2f}" height="{sheet_height:.2f}" fill="none" '
        'stroke="#999" stroke-width="0.25"/>',
        f'<path d="{outlines}" fill="#c9c9c9"/>',
    ]
    for name, place in ids(target):
        lines.append(_text(placed(place), name, _ID, 1.6 * _FONT, "middle"))
    lines += _axes(placed, target)
    for number, place in enumerate(placed(target.points)):
        lines.append(f'<circle cx="{place[0]:.2f}" cy="{place[1]:.2f}" r="0.8" fill="{_POINT}"/>')
        lines.append(_text(place + np.array([1.1, -1.2]), str(number), _POINT, _FONT))
    return "\n".join([*lines, "</svg>"]) + "\n"


def ids(target: Target) -> Iterator[tuple[str, Floats]]:
    """Yield the id and the middle of each tag or marker."""
    if target.kind == "aprilgrid":
        for tag in range(target.tags):
            corners = target.points[target.point_of_tag_corner(tag, np.arange(4))]
            yield str(target.first_tag + tag), corners.mean(axis=0)
    if target.kind == "charuco":
        white = [place for place in np.ndindex(target.rows, target.cols) if not black_square(target, *place)]
        for marker, (row, col) in enumerate(white):
            middle = np.array([col - 0.5, target.rows - 1.5 - row, 0.0])
            yield str(target.first_tag + marker), target.square_size_m * middle


def _axes(placed, target: Target) -> Iterator[str]:  # noqa: ANN001
    origin = np.zeros(3)
    for name, axis, colour in (("x", [1.0, 0, 0], "#c5221f"), ("y", [0, 1.0, 0], "#188038")):
        start, tip = placed(origin), placed(_ARROW / 1000 * np.array(axis))
        along = (tip - start) / _ARROW
        side = np.array([-along[1], along[0]])
        head = [tip + 3 * along, tip + 1.2 * side, tip - 1.2 * side]
        line = " ".join(f"{v:.2f}" for v in (*start, *tip))
        yield f'<path d="M{line}" stroke="{colour}" stroke-width="0.9"/>'
        yield f'<path d="{_path(np.array(head))}" fill="{colour}"/>'
        yield _text(tip + 5.2 * along, name, colour, 1.2 * _FONT, "middle")
    x, y = placed(origin)
    yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="1.9" fill="#fff" stroke="#333" stroke-width="0.5"/>'


def _path(points: Floats) -> str:
    return "M" + "L".join(f"{x:.2f},{y:.2f}" for x, y in points) + "z"


def _text(place: Floats, text: str, colour: str, height: float, anchor: str = "start") -> str:
    x, y = place + ([0, 0.36 * height] if anchor == "middle" else [0, 0])
    style = f'font-size="{height:.1f}" text-anchor="{anchor}" fill="{colour}"'
    return f'<text x="{x:.2f}" y="{y:.2f}" {style} stroke="#fff" stroke-width="0.9" paint-order="stroke">{text}</text>'


SIZES_PX = (8, 10, 12, 14, 16, 20, 24, 32)
_SMALL = {
    "aprilgrid": lambda s: Target.aprilgrid(tag_cols=5, tag_rows=4, tag_size_m=s, tag_spacing=0.3),
    "checkerboard": lambda s: Target.checkerboard(cols=8, rows=5, row_spacing_m=s, col_spacing_m=s),
    "circlegrid": lambda s: Target.circlegrid(cols=7, rows=5, spacing_m=s),
    "charuco 4X4": lambda s: Target.charuco(cols=7, rows=5, square_size_m=s, marker_size_m=0.75 * s),
    "charuco 6X6": lambda s: Target.charuco(
        cols=7, rows=5, square_size_m=s, marker_size_m=0.75 * s, dictionary="6X6_50"
    ),
}


def sizes(views: int = 12) -> None:
    """Print which share of the points is found in images of 752 x 480 px, tilted by up to 40 degrees."""
    from gnomon.detect.boards.worker import make_detector
    from gnomon.geometry.rotations import rotation_from_rotvec
    from gnomon.simulate.images.rendering import Optics, render_board

    focal = 460.0
    camera = Camera(
        projection="pinhole",
        intrinsics=np.array([focal, focal, 375.5, 239.5]),
        distortion="none",
        distortion_coeffs=np.zeros(0),
        resolution=(752, 480),
    )
    sys.stdout.write(f"{'px':<14}" + "".join(f"{size:>6}" for size in SIZES_PX) + "\n")
    for name, board in _SMALL.items():
        target = board(0.05)
        pattern, middle = board_pattern(target), (target.points.min(axis=0) + target.points.max(axis=0)) / 2
        found: list[float] = []
        for size in SIZES_PX:
            rng = np.random.default_rng(size)
            share = 0.0
            for _ in range(views):
                tilt, way, roll = rng.uniform(0, np.radians(40)), rng.uniform(0, 2 * np.pi), rng.uniform(-0.4, 0.4)
                R = rotation_from_rotvec(tilt * np.array([np.cos(way), np.sin(way), 0.0])) @ np.diag([1.0, -1, -1])
                R = rotation_from_rotvec(np.array([0, 0, roll])) @ R
                p = np.array([*rng.uniform(-0.02, 0.02, 2), focal * 0.05 / size]) - R @ middle
                image = render_board(pattern, camera, R, p, options=Optics(blur_px=0.7, noise=2.0), rng=rng)
                share += len(make_detector(target)(image)) / len(target) / views
            found.append(share)
        sys.stdout.write(f"{name:<14}" + "".join(f"{100 * share:>5.0f}%" for share in found) + "\n")


def main() -> None:
    """Write the drawings, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", action="store_true", help="print the table of sizes")
    if parser.parse_args().sizes:
        sizes()
        return
    FOLDER.mkdir(exist_ok=True)
    for name, target in BOARDS.items():
        (FOLDER / f"{name}.svg").write_text(drawing(target), encoding="utf-8")


if __name__ == "__main__":
    main()
