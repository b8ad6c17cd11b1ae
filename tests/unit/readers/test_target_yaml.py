"""target.yaml: what is written is read back as the same board, ChArUco boards as others write them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gnomon import FormatError
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.kalibr.target import DICTIONARIES, read_target, target_lines, target_text
from gnomon.models.target import Target

CHARUCO = {
    "target_type": "charuco",
    "squareCols": 8,
    "squareRows": 5,
    "squareSize": 0.03,
    "markerSize": 0.0225,
    "dictionary": "5X5_100",
}
lengths = st.floats(1e-3, 2.0)
counts = st.integers(3, 40)
boards = st.one_of(
    st.builds(
        Target.aprilgrid,
        tag_cols=counts,
        tag_rows=counts,
        tag_size_m=lengths,
        tag_spacing=st.floats(0.1, 1.0),
        border_bits=st.sampled_from([1, 2]),
        first_tag=st.integers(0, 500),
    ),
    st.builds(Target.checkerboard, cols=counts, rows=counts, row_spacing_m=lengths, col_spacing_m=lengths),
    st.builds(Target.circlegrid, cols=counts, rows=counts, spacing_m=lengths, asymmetric=st.booleans()),
    st.builds(
        lambda square, share, **others: Target.charuco(square_size_m=square, marker_size_m=share * square, **others),
        square=lengths,
        share=st.floats(0.3, 0.95),
        cols=counts,
        rows=counts,
        dictionary=st.sampled_from(DICTIONARIES),
        first_marker=st.integers(0, 900),
        legacy=st.booleans(),
    ),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("boards")


def stated(target):
    return {name: getattr(target, name) for name in Target.__slots__ if name != "points"}


def read(folder, keys, notes=None):
    (folder / "target.yaml").write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return read_target(folder / "target.yaml", notes)


@given(board=boards)
def test_what_is_written_is_read_back(board, folder):
    (folder / "written.yaml").write_text(target_text(board))
    notes = []
    found = read_target(folder / "written.yaml", notes)
    assert stated(found) == stated(board)
    np.testing.assert_array_equal(found.points, board.points)
    assert notes == []
    assert target_lines(board)[0] == f"target_type: {board.kind}"


@pytest.mark.parametrize("kind", ["charuco", "ChArUco", "charuco_board", "CharucoBoard"])
@pytest.mark.parametrize("name", ["5X5_100", "DICT_5X5_100", "5x5_100", '"5X5_100"'])
def test_names_of_charuco_boards_and_their_dictionaries(folder, kind, name):
    notes = []
    board = read(folder, CHARUCO | {"target_type": kind, "dictionary": name, "firstMarker": 4}, notes)
    expected = Target.charuco(
        cols=8, rows=5, square_size_m=0.03, marker_size_m=0.0225, dictionary="5X5_100", first_marker=4
    )
    assert stated(board) == stated(expected)
    assert notes == []


def test_opencvs_names_and_what_is_passed_over(folder):
    keys = {"target_type": "charuco", "squaresX": 8, "squaresY": 5, "squareLength": 0.03, "markerLength": 0.02}
    notes = []
    board = read(folder, keys | {"dictionary": "DICT_APRILTAG_36H11", "legacyPattern": "true", "colour": "red"}, notes)
    assert (board.cols, board.rows, board.dictionary, board.legacy) == (8, 5, "APRILTAG_36h11", True)
    assert notes == ["target.yaml: colour was passed over."]
    assert load_foreign(folder / "target.yaml").target.describe() == board.describe()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"squareCols": None}, "squareCols is missing. Expected a count of squares, which is one more than"),
        ({"squareCols": None, "targetCols": 7}, "squareCols is missing. Expected a count of squares"),
        ({"squareCols": 2}, "cols 2 of the charuco must be a whole number of at least 3"),
        ({"squareSize": 30}, "squareSize: found 30 m, which no board has. The unit is the metre"),
        ({"markerSize": 0.03}, "marker_size_m 0.03 of the charuco must be less than square_size_m 0.03"),
        ({"dictionary": None}, "dictionary is missing. Expected the name of OpenCV's dictionary"),
        ({"dictionary": "4X4"}, 'dictionary "4X4": expected one of 4X4_50, 4X4_100'),
        ({"dictionary": 5}, "dictionary: found 5, expected text"),
        ({"firstMarker": -1}, "firstMarker: found -1, expected an id from 0, at the upper left"),
        ({"firstMarker": 1.5}, "firstMarker: found 1.5, expected a whole number"),
        ({"legacyPattern": "maybe"}, "legacyPattern: found 'maybe', expected true or false"),
        ({"squaresX": 9}, "squareCols and squaresX mean the same and differ"),
    ],
)
def test_bad_charuco(folder, changes, message):
    keys = {key: value for key, value in (CHARUCO | changes).items() if value is not None}
    with pytest.raises(FormatError) as caught:
        read(folder, keys)
    assert message in str(caught.value)
    assert "target.yaml" in str(caught.value)


def test_the_dictionaries_are_those_of_opencv():
    known = {name.removeprefix("DICT_").upper() for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert known <= {name.upper() for name in DICTIONARIES}
    for name in DICTIONARIES[:-1]:  # the last is not in every version
        assert isinstance(getattr(cv2.aruco, f"DICT_{name}"), int)
