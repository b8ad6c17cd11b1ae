"""Corners of ChArUco boards, in rendered images of which the truth is known."""

import cv2
import numpy as np
import pytest

import gnomon.detect.boards.charuco as module
from detection import Score, Truth
from gnomon.detect.boards.charuco import detect_charuco
from gnomon.errors import OptionError
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING, Ranges, euroc_camera, rendered_views

BOARD = Target.charuco(cols=8, rows=6, square_size_m=0.06, marker_size_m=0.045)
OTHER = Target.charuco(
    cols=9, rows=6, square_size_m=0.05, marker_size_m=0.036, dictionary="5X5_100", first_marker=10, legacy=True
)
FISHEYE = Camera(
    projection="pinhole",
    intrinsics=np.array([260.0, 260.0, 372.0, 243.0]),
    distortion="equidistant",
    distortion_coeffs=np.array([0.02, -0.01, 0.003, -0.001]),
    resolution=(752, 480),
)


def picture(target, rotvec=(0.0, 0.0, 0.0), place=(0.0, 0.0, 0.5), *, camera=None, wall=True, **optics):
    """Return an image of a board about the middle of the image, and where its corners are."""
    camera = camera or euroc_camera()
    R = FACING @ rotation_from_rotvec(np.array(rotvec))
    p = np.array(place) - R @ target.points.mean(axis=0)
    image = render_board(
        board_pattern(target),
        camera,
        R,
        p,
        options=Optics(**({"blur_px": 0.6, "noise": 2.0} | optics)),
        wall=cluttered_wall(1) if wall else None,
        rng=np.random.default_rng(0),
    )
    return image, camera.project(target.points @ R.T + p).pixels


@pytest.mark.parametrize(
    ("target", "camera", "tilt_deg"),
    [(BOARD, euroc_camera(), 55.0), (OTHER, euroc_camera(), 55.0), (BOARD, FISHEYE, 68.0)],
    ids=["4X4_50", "5X5_100, from 10, legacy", "fisheye"],
)
def test_corners_are_where_they_are_and_their_sigma_says_how_well(target, camera, tilt_deg):
    """Clutter, covered parts, blur to 1.5 px, motion of 3 px, noise to 5 grey levels."""
    score = Score()
    ranges = Ranges(tag_px=(18.0, 70.0), tilt_deg=(0.0, tilt_deg))
    for view in rendered_views(target, 14, 5, camera=camera, ranges=ranges):
        score.add(
            Truth(
                image=view.image,
                target=target,
                visible=view.point,
                projected=view.projected,
                tags=view.tags,
                tag_px=view.tag_px,
            ),
            detect_charuco(view.image, target),
        )
    assert score.wrong == 0
    assert score.corner_recall > (0.96 if tilt_deg < 60 else 0.93)
    assert np.sqrt(np.mean(score.error**2)) < 0.06
    assert score.z_rms == pytest.approx(1.0, abs=0.2)
    assert score.z_beyond_3 < 0.01


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("rows", [5, 6])
def test_boards_are_numbered_as_opencv_numbers_them(rows, legacy):
    target = Target.charuco(cols=7, rows=rows, square_size_m=0.06, marker_size_m=0.045, legacy=legacy)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, rows), 0.06, 0.045, dictionary)
    board.setLegacyPattern(legacy)
    image = np.pad(board.generateImage((560, 80 * rows), marginSize=0), 40, constant_values=255)
    image = np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 0.8))
    view = detect_charuco(image, target)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    assert np.array_equal(view.point, np.sort(ids.ravel()))
    assert np.array_equal(view.point, np.arange(len(target)))
    theirs = corners.reshape(-1, 2)[np.argsort(ids.ravel())]
    if int(cv2.__version__.split(".")[0]) < 5:
        theirs = theirs - 0.5  # OpenCV 4 counts from the edge of the first pixel here
    np.testing.assert_allclose(view.pixels, theirs, atol=0.25)


@pytest.mark.parametrize("roll", [0.4, 1.8, -2.6])
def test_all_corners_of_a_sharp_image(roll):
    image, true = picture(BOARD, (0.4, -0.5, roll))
    view = detect_charuco(image, BOARD)
    assert np.array_equal(view.point, np.arange(len(BOARD)))
    assert np.abs(view.pixels - true).max() < 0.2
    assert view.blur_px == pytest.approx(0.66, abs=0.1)
    assert (view.black, view.white) == (pytest.approx(30, abs=15), pytest.approx(200, abs=30))


def test_small_markers_that_touch_the_squares_are_read_by_the_lattice(monkeypatch):
    image, true = picture(BOARD, (0.2, 0.1, 0.3), (0.0, 0.0, 1.75), blur_px=1.2)
    view = detect_charuco(image, BOARD)
    assert len(view) > 0.6 * len(BOARD)
    assert np.abs(view.pixels - true[view.point]).max() < 0.5
    monkeypatch.setattr(module, "corners_by_lattice", lambda *_: None)
    assert len(detect_charuco(image, BOARD)) < len(view)


def test_covered_parts_are_left_out_and_the_others_stay():
    image, true = picture(BOARD, (0.2, 0.1, 0.2))
    cv2.circle(image, tuple(int(v) for v in np.rint(true[10])), 30, 120, -1)
    view = detect_charuco(image, BOARD)
    near = np.linalg.norm(true - true[10], axis=1) < 30
    assert not near[view.point].any()
    assert len(view) >= len(BOARD) - np.count_nonzero(near) - 2
    assert np.abs(view.pixels - true[view.point]).max() < 0.2


def test_part_of_a_board_is_enough():
    image, true = picture(BOARD, (0.1, 0.0, 0.2), (0.24, 0.14, 0.35), wall=False)
    inside = ((true > 5) & (true < [746, 474])).all(axis=1)
    assert 8 < np.count_nonzero(inside) < 0.8 * len(BOARD)
    view = detect_charuco(image, BOARD)
    assert len(view) >= 0.9 * np.count_nonzero(inside)
    assert np.abs(view.pixels - true[view.point]).max() < 0.3


def test_two_boards_in_view_are_told_apart():
    left, true = picture(BOARD, (0.0, 0.2, 0.0), (-0.24, 0.0, 0.8), wall=False)
    right, _ = picture(OTHER, (0.0, -0.2, 0.1), (0.28, 0.0, 0.8), wall=False)
    both = np.where(np.arange(752) < 376, left, right).astype(np.uint8)
    view = detect_charuco(both, BOARD)
    assert len(view) > 0.9 * np.count_nonzero(true[:, 0] < 370)
    assert np.abs(view.pixels - true[view.point]).max() < 0.2


def test_what_is_not_the_board_is_not_found():
    image, _ = picture(BOARD, (0.2, 0.1, 0.3))
    others = (
        OTHER,
        Target.charuco(cols=8, rows=6, square_size_m=0.06, marker_size_m=0.045, dictionary="6X6_50"),
        Target.charuco(cols=8, rows=6, square_size_m=0.06, marker_size_m=0.045, first_marker=26),
    )
    for other in others:
        assert not len(detect_charuco(image, other))
    wall, _ = picture(BOARD, place=(0.0, 0.0, -1.0))
    noise = np.random.default_rng(0).integers(0, 256, (360, 480), dtype=np.uint8)
    for blank in (wall, noise, np.zeros((360, 480), np.uint8), np.zeros((5, 7), np.uint8)):
        assert not len(detect_charuco(blank, BOARD))


def test_large_images():
    camera = Camera(
        projection="pinhole",
        intrinsics=np.array([2300.0, 2300.0, 1919.5, 1079.5]),
        distortion="none",
        distortion_coeffs=np.zeros(0),
        resolution=(3840, 2160),
    )
    image, true = picture(BOARD, (0.3, 0.3, 0.4), (0.0, 0.0, 0.6), camera=camera, blur_px=1.2, wall=False)
    view = detect_charuco(image, BOARD)
    assert len(view) == len(BOARD)
    assert np.abs(view.pixels - true).max() < 0.25


def test_dictionaries_that_do_not_exist_are_named():
    wrong = Target.charuco(cols=8, rows=6, square_size_m=0.06, marker_size_m=0.045, dictionary="4X4_51")
    with pytest.raises(OptionError, match="4X4_51"):
        detect_charuco(picture(BOARD)[0], wrong)
