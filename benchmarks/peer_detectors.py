"""Other detectors, as far as they are installed, so that they can be compared: image, target -> BoardView.

They state no standard deviation; one is assumed for all of their corners. Ordinary AprilTag libraries are not among
them: of boards as Kalibr prints them, with a border of 2 bits, they find nothing.
"""

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np

from gnomon.detect.boards.board import BoardView, nothing_seen
from gnomon.models.target import Target
from gnomon.recording import Floats
from gnomon.recording.recording import Grey

Detector = Callable[[Grey, Target], BoardView]

SIGMA_PX = 0.05


@cache
def peers(kind: str) -> dict[str, Detector]:
    """Return the detectors for a kind of board, by name."""
    if kind == "checkerboard":
        return {"OpenCV findChessboardCornersSB": _chessboard_sb, "OpenCV findChessboardCorners": _chessboard}
    if kind == "charuco":
        return {"OpenCV CharucoDetector": _charuco}
    if kind == "circlegrid":
        return {"OpenCV findCirclesGrid": _circles}
    found: dict[str, Detector] = {"OpenCV aruco": _aruco}
    try:
        from aprilgrid import Detector as Aprilgrid
    except ImportError:
        pass
    else:
        reader = Aprilgrid("t36h11")
        found["aprilgrid"] = lambda image, target: _view(
            target, {int(tag.tag_id): np.reshape(tag.corners, (4, 2)) for tag in reader.detect(image)}, turn=None
        )
    return found


def _view(target: Target, tags: dict[int, Floats], *, turn: int | None) -> BoardView:
    """Return tags by id as a view; `turn` is the first of our corners among theirs, which run the other way round.

    None finds it by the upright majority: only for detectors whose order was not looked up.
    """
    tags = {tag: corners for tag, corners in tags.items() if 0 <= tag < target.tags}
    if not tags:
        return nothing_seen()
    order = _order(target, tags) if turn is None else [(turn - k) % 4 for k in range(4)]
    ids = np.array(sorted(tags))
    point = target.point_of_tag_corner(ids[:, None], np.arange(4)).ravel()
    pixels = np.array([tags[int(tag)][order] for tag in ids]).reshape(-1, 2)
    ranked = np.argsort(point)
    return BoardView(point=point[ranked], pixels=pixels[ranked], sigma_px=np.full(len(point), SIGMA_PX))


def _order(target: Target, tags: dict[int, Floats]) -> list[int]:
    """Return the order of a detector's corners that maps the board best into the image, by a homography."""
    ids = np.array(sorted(tags))
    point = target.point_of_tag_corner(ids[:, None], np.arange(4))
    best, chosen = np.inf, [0, 1, 2, 3]
    for way in (1, -1):
        for first in range(4):
            order = [(first + way * k) % 4 for k in range(4)]
            pixels = np.array([tags[int(tag)][order] for tag in ids]).reshape(-1, 2)
            plane = target.points[point.ravel(), :2]
            mapped, _ = cv2.findHomography(plane, pixels, cv2.RANSAC, 5.0)
            if mapped is None:
                continue
            miss = cv2.perspectiveTransform(plane[None], mapped)[0] - pixels
            if np.median(np.abs(miss)) < best:
                best, chosen = float(np.median(np.abs(miss))), order
    return chosen


def _aruco(image: Grey, target: Target) -> BoardView:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = target.border_bits
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    if ids is None:
        return nothing_seen()
    outlines = {int(tag) - target.first_tag: outline[0] for tag, outline in zip(ids.ravel(), corners, strict=True)}
    for tag, outline in outlines.items():
        side = float(np.linalg.norm(outline[0] - outline[1]))
        window = int(np.clip(side * target.tag_spacing / 2, 1, 3))
        refined = outline.reshape(-1, 1, 2).astype(np.float32)
        cv2.cornerSubPix(image, refined, (window, window), (-1, -1), _UNTIL)
        outlines[tag] = refined.reshape(4, 2)
    return _view(target, outlines, turn=None)


def _chessboard(image: Grey, target: Target) -> BoardView:
    found, corners = cv2.findChessboardCorners(image, (target.cols, target.rows))
    if not found:
        return nothing_seen()
    cv2.cornerSubPix(image, corners, (3, 3), (-1, -1), _UNTIL)
    return _grid(image, corners, target)


def _chessboard_sb(image: Grey, target: Target) -> BoardView:
    found, corners = cv2.findChessboardCornersSB(image, (target.cols, target.rows), flags=cv2.CALIB_CB_ACCURACY)
    return _grid(image, corners, target) if found else nothing_seen()


def _charuco(image: Grey, target: Target) -> BoardView:
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{target.dictionary}"))
    ids = np.arange(target.first_tag, target.first_tag + (target.cols * target.rows + 1) // 2)
    size = (target.cols, target.rows)
    board = cv2.aruco.CharucoBoard(size, target.square_size_m, target.marker_size_m, family, ids[: _white(target)])
    board.setLegacyPattern(target.legacy)
    corners, found, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if found is None or not len(found):
        return nothing_seen()
    order = np.argsort(np.ravel(found))
    pixels = np.reshape(corners, (-1, 2))[order].astype(float)
    return BoardView(point=np.ravel(found)[order], pixels=pixels, sigma_px=np.full(len(order), SIGMA_PX))


def _white(target: Target) -> int:
    from gnomon.models.board_pattern import black_square

    return sum(not black_square(target, row, col) for row, col in np.ndindex(target.rows, target.cols))


def _circles(image: Grey, target: Target) -> BoardView:
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if target.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    found, centres = cv2.findCirclesGrid(image, (target.cols, target.rows), flags=kind)
    if not found:
        return nothing_seen()
    pixels = np.reshape(centres, (-1, 2)).astype(float)
    return BoardView(point=np.arange(len(target)), pixels=pixels, sigma_px=np.full(len(target), SIGMA_PX))


def _grid(image: Grey, corners: Floats, target: Target) -> BoardView:
    """Return corners that are in rows of columns, turned so that the square before the first one is black."""
    grid = np.reshape(corners, (target.rows, target.cols, 2)).astype(float)
    across, up = grid[1, 0] - grid[0, 0], grid[0, 1] - grid[0, 0]
    if across[0] * up[1] - across[1] * up[0] > 0:  # the image's y runs down: the board would be seen from behind
        grid = grid[:, ::-1]
        across, up = grid[1, 0] - grid[0, 0], grid[0, 1] - grid[0, 0]

    def grey(place: Floats) -> float:
        return float(cv2.getRectSubPix(image, (1, 1), (float(place[0]), float(place[1])))[0, 0])

    if grey(grid[0, 0] + (across + up) / 2) > grey(grid[0, 0] + (across - up) / 2):  # that square is black, too
        grid = grid[::-1, ::-1]
    pixels = grid.reshape(-1, 2)
    return BoardView(point=np.arange(len(target)), pixels=pixels, sigma_px=np.full(len(target), SIGMA_PX))


_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)
