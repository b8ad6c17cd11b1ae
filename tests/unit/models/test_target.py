"""Boards against Kalibr's own points and the corners of real recordings."""

import numpy as np
import pytest

from gnomon.errors import OptionError, RecordingError
from gnomon.models.target import Target


def aprilgrid(**changed):
    return Target.aprilgrid(**{"tag_cols": 6, "tag_rows": 6, "tag_size_m": 0.088, "tag_spacing": 0.3} | changed)


def checkerboard(**changed):
    return Target.checkerboard(**{"cols": 7, "rows": 6, "row_spacing_m": 0.08, "col_spacing_m": 0.08} | changed)


def circlegrid(**changed):
    return Target.circlegrid(**{"cols": 3, "rows": 4, "spacing_m": 0.05} | changed)


@pytest.mark.parametrize(
    ("folder", "board"),
    [
        ("a-aprilgrid-full", aprilgrid()),
        ("b-aprilgrid-ideal-imu", aprilgrid()),
        ("d-checkerboard-ideal-imu", checkerboard()),
    ],
)
def test_points_are_those_of_kalibr(real_data, folder, board):
    table = np.loadtxt(real_data(f"rendered-camimu/{folder}/target_points.csv"), delimiter=",", skiprows=1)
    assert table[:, 0].tolist() == list(range(len(board)))
    np.testing.assert_allclose(board.points, table[:, 1:], rtol=0, atol=1e-12)


def test_tag_corners_run_counter_clockwise_from_the_lower_left():
    # 4 x 3 tags, so that columns and rows cannot be mistaken for each other
    board = aprilgrid(tag_cols=4, tag_rows=3, tag_size_m=0.1, tag_spacing=0.25)
    tag, corner = np.divmod(np.arange(4 * board.tags), 4)
    point = board.point_of_tag_corner(tag, corner)
    assert sorted(point) == list(range(len(board)))
    corner_x, corner_y = np.array([0, 0.1, 0.1, 0])[corner], np.array([0, 0, 0.1, 0.1])[corner]
    expected = np.stack([tag % 4 * 0.125 + corner_x, tag // 4 * 0.125 + corner_y, np.zeros(len(tag))], axis=1)
    np.testing.assert_allclose(board.points[point], expected, atol=1e-15)


def test_tag_corners_of_any_shape():
    board = aprilgrid()
    assert board.point_of_tag_corner(7, 2) == 2 * 6 * 3 + 3
    assert board.point_of_tag_corner([[0], [35]], [[0, 1, 2, 3]]).tolist() == [[0, 1, 13, 12], [130, 131, 143, 142]]
    assert board.point_of_tag_corner([], []).shape == (0,)


@pytest.mark.parametrize(("tag", "corner"), [(36, 0), (-1, 0), (0, 4), (0, -1)])
def test_tag_corners_that_are_not_on_the_board_are_named(tag, corner):
    with pytest.raises(RecordingError, match=f"corner {corner} of tag {tag} is not on the board: it has tags 0 to 35"):
        aprilgrid().point_of_tag_corner([3, tag], [1, corner])


def test_only_an_aprilgrid_has_tags():
    assert checkerboard().tags == 0
    with pytest.raises(OptionError, match="a checkerboard has no tags"):
        checkerboard().point_of_tag_corner(0, 0)


def test_checkerboard_counts_along_y_first():
    board = checkerboard(cols=3, rows=2, row_spacing_m=0.1, col_spacing_m=0.01)
    expected = [[0, 0, 0], [0, 0.01, 0], [0, 0.02, 0], [0.1, 0, 0], [0.1, 0.01, 0], [0.1, 0.02, 0]]
    np.testing.assert_allclose(board.points, expected, atol=1e-15)
    assert board.size_m == pytest.approx((0.1, 0.02))


def test_circle_grids():
    plain, shifted = circlegrid(cols=2, rows=3), circlegrid(cols=2, rows=3, asymmetric=True)
    expected = np.array([[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1]]) * 0.05
    np.testing.assert_allclose(plain.points[:, :2], expected, atol=1e-15)
    expected = np.array([[0, 0], [2, 0], [1, 1], [3, 1], [0, 2], [2, 2]]) * 0.05
    np.testing.assert_allclose(shifted.points[:, :2], expected, atol=1e-15)
    assert not shifted.points[:, 2].any()


def test_boards_describe_themselves():
    assert aprilgrid().describe() == "AprilGrid 6 x 6, tags of 88 mm, gap 26.4 mm"
    assert checkerboard().describe() == "Checkerboard 7 x 6 inner corners, squares of 80 mm"
    uneven = checkerboard(row_spacing_m=0.0625, col_spacing_m=0.07)
    assert uneven.describe() == "Checkerboard 7 x 6 inner corners, rows 62.5 mm, columns 70 mm apart"
    assert circlegrid().describe() == "Circle grid 3 x 4, spacing 50 mm"
    assert circlegrid(asymmetric=True).describe() == "Asymmetric circle grid 3 x 4, spacing 50 mm"


@pytest.mark.parametrize(
    ("make", "changed", "message"),
    [
        (aprilgrid, {"tag_cols": 0}, "cols 0 of the aprilgrid must be a whole number of at least 1"),
        (aprilgrid, {"tag_rows": 2.5}, "rows 2.5 of the aprilgrid must be a whole number of at least 1"),
        (aprilgrid, {"tag_rows": float("nan")}, "rows nan of the aprilgrid must be a whole number"),
        (aprilgrid, {"tag_size_m": -0.1}, "tag_size_m -0.1 of the aprilgrid must be a finite number greater than zero"),
        (aprilgrid, {"tag_spacing": 0}, "tag_spacing 0 of the aprilgrid must be"),
        (checkerboard, {"cols": 1}, "cols 1 of the checkerboard must be a whole number of at least 2"),
        (checkerboard, {"col_spacing_m": float("inf")}, "col_spacing_m inf of the checkerboard must be a finite"),
        (aprilgrid, {"border_bits": 3}, "border_bits 3 of the aprilgrid must be 1 or 2"),
        (aprilgrid, {"first_tag": -1}, "first_tag -1 of the aprilgrid must be a whole number from 0"),
        (aprilgrid, {"first_tag": 0.5}, r"first_tag 0\.5 of the aprilgrid must be a whole number from 0"),
        (circlegrid, {"spacing_m": float("nan")}, "spacing_m nan of the circlegrid must be a finite number"),
    ],
)
def test_boards_that_make_no_sense_are_refused(make, changed, message):
    with pytest.raises(OptionError, match=message):
        make(**changed)


def test_plain_tags_with_other_ids():
    board = aprilgrid(border_bits=1, first_tag=12)
    assert board.describe() == (
        "AprilGrid 6 x 6, tags of 88 mm, gap 26.4 mm, plain tags with a border of 1 bit, ids from 12"
    )
    # Points and tags are numbered from 0 whatever is printed on them.
    assert np.array_equal(board.points, aprilgrid().points)
    assert board.point_of_tag_corner(0, 0) == 0
    with pytest.raises(RecordingError, match="it has tags 0 to 35"):
        board.point_of_tag_corner(36, 0)


def test_unknown_boards_are_refused():
    known = "aprilgrid, checkerboard, circlegrid, charuco"
    with pytest.raises(OptionError, match=f"no target 'radon'; it must be one of {known}"):
        Target(kind="radon", cols=3, rows=3)  # pyright: ignore[reportArgumentType]


def test_points_are_not_changed_by_mistake():
    with pytest.raises(ValueError, match="read-only"):
        aprilgrid().points[0, 0] = 1
