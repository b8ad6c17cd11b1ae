"""Two boards alike in an image: the same one is taken in each image, and it is said that there is another."""

import numpy as np
import pytest

from gnomon.assess.checks.image_checks import check_quality
from gnomon.detect.boards.aprilgrid import detect_aprilgrid
from gnomon.detect.boards.board import SECOND_BOARD
from gnomon.detect.boards.charuco import detect_charuco
from gnomon.detect.boards.checkerboard import detect_checkerboard
from gnomon.detect.boards.circlegrid import CircleGridDetector
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import FrameQuality
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING

KINDS = {
    "aprilgrid": (Target.aprilgrid(tag_cols=4, tag_rows=4, tag_size_m=0.06, tag_spacing=0.3), detect_aprilgrid),
    "checkerboard": (Target.checkerboard(cols=5, rows=6, row_spacing_m=0.05, col_spacing_m=0.05), detect_checkerboard),
    "circlegrid": (
        Target.circlegrid(cols=5, rows=6, spacing_m=0.05),
        lambda image, target: CircleGridDetector(target).detect(image),
    ),
    "charuco": (Target.charuco(cols=6, rows=7, square_size_m=0.05, marker_size_m=0.037), detect_charuco),
}
CAMERA = Camera(
    projection="pinhole",
    intrinsics=np.array([420.0, 420.0, 319.5, 199.5]),
    distortion="none",
    distortion_coeffs=np.empty(0),
    resolution=(640, 400),
)


def half(target, place_m, distance_m, roll):
    """Return an image of a board at a place (x, y) of the image's plane, and where its points are."""
    R = rotation_from_rotvec(np.array([0.0, 0.0, roll])) @ rotation_from_rotvec(np.array([0.2, 0.1, 0.0])) @ FACING
    p = np.array([*place_m, distance_m]) - R @ target.points.mean(axis=0)
    options = Optics(blur_px=0.6, noise=0.5)
    image = render_board(board_pattern(target), CAMERA, R, p, options=options, rng=np.random.default_rng(1))
    return image, CAMERA.project(target.points @ R.T + p, point_jacobian=False).pixels


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("nearer", ["left", "right", "above"])
def test_of_two_boards_alike_the_same_one_is_taken_whichever_looks_larger(kind, nearer):
    target, detect = KINDS[kind]
    distances = (0.75, 0.9) if nearer == "left" else (0.9, 0.75)
    (left, first), (right, _) = (
        half(target, (x * distance, 0.0), distance, 0.1) for x, distance in zip((-0.38, 0.38), distances, strict=True)
    )
    image = np.hstack([left[:, :320], right[:, 320:]])
    if nearer == "above":  # the camera held on its side: what was to the left is below
        image, first = np.rot90(image), np.column_stack([first[:, 1], 639 - first[:, 0]])
    view = detect(np.ascontiguousarray(image), target)
    away = np.linalg.norm(view.pixels[:, None] - first, axis=2).min(axis=1)
    assert len(view) > 0.8 * len(target)
    assert away.max() < 1.0
    assert view.dropped[SECOND_BOARD] > 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_board_alone_is_not_two(kind):
    target, detect = KINDS[kind]
    image, _ = half(target, (0.0, 0.0), 0.6, 0.3)
    view = detect(image, target)
    assert len(view) > 0.9 * len(target)
    assert SECOND_BOARD not in view.dropped


@pytest.mark.parametrize(("dropped", "codes"), [({SECOND_BOARD: 500}, ["board-twice"]), ({"near the border": 1}, [])])
def test_a_second_board_is_said_once_and_is_no_loss_of_corners(dropped, codes):
    none = np.empty(0)
    quality = FrameQuality(blur_px=none, black=none, white=none, dropped=dropped)
    assert [finding.code for finding in check_quality("cam0", quality, 300, None)] == codes
