"""What is printed on boards: the same as on boards that others made, and as OpenCV reads it."""

import cv2
import numpy as np
import pytest

from gnomon import OptionError
from gnomon.models.board_pattern import board_pattern, tag_cells
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING, euroc_camera

APRILGRID = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
CHECKERBOARD = Target.checkerboard(cols=7, rows=6, row_spacing_m=0.08, col_spacing_m=0.08)
LENS = Camera(
    projection="pinhole",
    intrinsics=np.array([500.0, 500.0, 375.5, 239.5]),
    distortion="none",
    distortion_coeffs=np.zeros(0),
    resolution=(752, 480),
)
PLAIN = Optics(white=220.0, black=20.0, blur_px=0.5)


def straight_on(target, camera=LENS, distance=1.0, optics=PLAIN):
    """Image and pixels of the points, the board's x to the right and its y up."""
    middle = (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    p = np.array([0.0, 0.0, distance]) - FACING @ middle
    image = render_board(board_pattern(target), camera, FACING, p, options=optics)
    return image, camera.project(target.points @ FACING.T + p).pixels


def aruco(image, border_bits):
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    return {int(tag): corner[0] for tag, corner in zip(ids.ravel(), corners, strict=True)}


@pytest.mark.parametrize(("border_bits", "first_tag"), [(2, 0), (1, 0), (1, 40)])
def test_opencv_reads_the_tags_turned_by_half_a_turn(border_bits, first_tag):
    target = Target.aprilgrid(
        tag_cols=4, tag_rows=3, tag_size_m=0.1, tag_spacing=0.4, border_bits=border_bits, first_tag=first_tag
    )
    image, pixels = straight_on(target)
    found = aruco(image, border_bits)
    assert set(found) <= set(range(first_tag, first_tag + 12))
    assert len(found) >= (12 if border_bits == 1 else 8)  # OpenCV loses some tags where squares touch them
    for tag, corners in found.items():
        mine = pixels[target.point_of_tag_corner(tag - first_tag, [1, 0, 3, 2])]
        np.testing.assert_allclose(corners, mine, atol=4)  # of 50; the order is what matters


def test_squares_stand_in_the_corners_of_kalibrs_boards_only():
    for border_bits, grey in ((2, 20), (1, 220)):
        target = Target.aprilgrid(
            tag_cols=2, tag_rows=2, tag_size_m=0.1, tag_spacing=0.3, border_bits=border_bits
        )  # fmt: skip
        image, pixels = straight_on(target)
        for tag in range(4):
            corners = pixels[target.point_of_tag_corner(tag, np.arange(4))]
            outward = (corners - corners.mean(axis=0)) / 100
            for x, y in np.rint(corners + 15 * outward).astype(int):  # 7 px beyond a corner, in the gap of 15 px
                assert abs(int(image[y, x]) - grey) <= 2


def test_a_family_ends():
    assert tag_cells(586, 2).shape == (10, 10)
    with pytest.raises(OptionError, match="tag 587"):
        tag_cells(587, 1)


@pytest.mark.parametrize("asymmetric", [False, True])
def test_opencv_finds_the_circles_where_the_points_are(asymmetric):
    target = Target.circlegrid(cols=4, rows=7, spacing_m=0.06, asymmetric=asymmetric)
    image, pixels = straight_on(target, distance=0.8)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    found, centres = cv2.findCirclesGrid(image, (4, 7), flags=kind)
    assert found
    apart = np.linalg.norm(centres.reshape(-1, 1, 2) - pixels, axis=2)
    assert apart.min(axis=1).max() < 0.1
    assert len(set(apart.argmin(axis=1))) == len(target)


def test_a_checkerboard_begins_with_a_black_square():
    target = Target.checkerboard(cols=5, rows=4, row_spacing_m=0.09, col_spacing_m=0.06)
    image, pixels = straight_on(target)
    grid = pixels.reshape(4, 5, 2)
    for r in range(3):
        for c in range(4):
            x, y = np.rint(grid[r : r + 2, c : c + 2].mean(axis=(0, 1))).astype(int)
            assert abs(int(image[y, x]) - (20 if (r + c) % 2 == 0 else 220)) <= 1


def pose_of(camera, points, pixels):
    """R_cam_target and p_cam_target from the exact or detected pixels of the points."""
    rays, _ = camera.unproject(pixels)
    plane = rays[:, :2] / rays[:, 2:]
    _, turn, p = cv2.solvePnP(np.ascontiguousarray(points), plane, np.eye(3), None)
    return cv2.Rodrigues(turn)[0], p.ravel()


def likeness(mine, theirs, pixels):
    """Correlation of two images where the board is."""
    (x0, y0), (x1, y1) = pixels.min(axis=0).astype(int).clip(0), pixels.max(axis=0).astype(int).clip(0)
    part = slice(y0, y1), slice(x0, x1)
    return np.corrcoef(mine[part].ravel(), theirs[part].ravel())[0, 1]


@pytest.mark.parametrize(
    ("name", "target"), [("a-aprilgrid-full", APRILGRID), ("d-checkerboard-ideal-imu", CHECKERBOARD)]
)
def test_boards_look_as_another_renderer_made_them(name, target, real_data):
    folder = real_data("rendered-camimu") / name / "images"
    camera = Camera(
        projection="pinhole",
        intrinsics=np.array([460.0, 458.5, 322.4, 237.1]),
        distortion="radtan",
        distortion_coeffs=np.array([-0.28, 0.075, 0.0002, -0.00015]),
        resolution=(640, 480),
    )
    table = np.loadtxt(folder / "true_corners.csv", delimiter=",", usecols=range(1, 7))
    stamps = np.loadtxt(folder / "true_corners.csv", delimiter=",", usecols=0, dtype=np.int64)
    for stamp in np.unique(stamps):
        theirs = cv2.imread(str(folder / f"{stamp}.png"), cv2.IMREAD_GRAYSCALE)
        rows = table[stamps == stamp]
        R, p = pose_of(camera, rows[:, 3:], rows[:, 1:3])
        mine = render_board(board_pattern(target), camera, R, p, options=Optics(blur_px=0.6))
        assert likeness(mine, theirs, rows[:, 1:3]) > 0.97  # light and noise differ


def test_the_board_of_euroc_looks_like_its_photograph(real_data):
    from gnomon.detect.boards.aprilgrid import detect_aprilgrid

    path = real_data("euroc-cam-april") / "cam0_1403709395937837056.png"
    theirs = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    view = detect_aprilgrid(theirs, APRILGRID)
    assert len(view) > 100
    camera = euroc_camera()
    R, p = pose_of(camera, APRILGRID.points[view.point], view.pixels)
    mine = render_board(board_pattern(APRILGRID), camera, R, p, options=Optics(blur_px=0.6))
    assert likeness(mine, theirs, view.pixels) > 0.95
