"""Printed boards: as large as stated, with a caption that is their target.yaml, and as the detectors read them."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import KDTree

from gnomon import OptionError, OutputError
from gnomon.formats.kalibr.target import read_target, target_text
from gnomon.models.board_pattern import BoardPattern, _outline, board_pattern
from gnomon.models.target import Target
from gnomon.writers.board_sheet import (
    PAPERS,
    board_drawing,
    board_paths,
    largest_on,
    paper_size,
    save_target,
    tile_board,
)
from gnomon.writers.drawing import pdf_bytes, svg_text
from headless import CHROMIUM, WHY_NOT, Browser
from printed import (
    PX_PER_MM,
    drawn,
    ends,
    on_sheet,
    pdf_boxes,
    pdf_caption,
    pdf_paths,
    pdf_streams,
    photographed,
    pose_before,
    rigidly,
    svg_caption,
    svg_paths,
    svg_size,
)
from rendered import euroc_camera

BOARDS = {
    "aprilgrid": Target.aprilgrid(tag_cols=4, tag_rows=5, tag_size_m=0.025, tag_spacing=0.3),
    "plain-tags": Target.aprilgrid(
        tag_cols=4, tag_rows=3, tag_size_m=0.03, tag_spacing=0.4, border_bits=1, first_tag=40
    ),
    "checkerboard": Target.checkerboard(cols=8, rows=5, row_spacing_m=0.025, col_spacing_m=0.024),
    "circlegrid": Target.circlegrid(cols=6, rows=5, spacing_m=0.03),
    "asymmetric": Target.circlegrid(cols=4, rows=9, spacing_m=0.02, asymmetric=True),
    "charuco": Target.charuco(cols=6, rows=5, square_size_m=0.03, marker_size_m=0.022, first_marker=7),
    "legacy": Target.charuco(cols=5, rows=6, square_size_m=0.03, marker_size_m=0.02, dictionary="6X6_250", legacy=True),
}
each_board = pytest.mark.parametrize("target", BOARDS.values(), ids=BOARDS)


def as_printed(target):
    """Rotation from the board's frame to the sheet: x of what people call rows and columns runs down."""
    return [[1, 0], [0, 1]] if target.kind in {"aprilgrid", "charuco"} or target.asymmetric else [[0, 1], [-1, 0]]


def signed_area(start, end):
    return float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum() / 2)


def both(target, paper=""):
    drawing = board_drawing(target, paper)
    return svg_text(drawing, "a board"), pdf_bytes(drawing, "a board")


@each_board
def test_what_is_printed_is_the_board_to_a_micrometre(target):
    pattern = board_pattern(target)
    svg, pdf = both(target)
    for paths in (svg_paths(svg)[:-1], pdf_paths(pdf)[:-1]):  # the last is the arrow beside the title
        start, end = ends(paths)
        expected = signed_area(pattern.edges[:, :2], pattern.edges[:, 2:])
        assert signed_area(start, end) / 1e6 == pytest.approx(expected, rel=1e-6)
        corners = pattern.edges[:, :2]
        turned = corners @ np.array(as_printed(target), float).T
        turned = 1000 * (turned - turned.min(axis=0)) + start.min(axis=0)
        assert KDTree(turned).query(start)[0].max() < 1e-3  # mm: every corner of a path is one of the pattern


@given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))))
def test_paths_go_round_any_cells(black):
    edges = _outline(black, np.array([0.01, 0.02]), np.array([0.003, 0.0021]))
    pattern = BoardPattern(edges=edges, area=np.zeros(len(edges)), sheet=np.zeros(4))
    paths = board_paths(pattern)
    if not black.any():
        assert paths == []
        return
    start, end = ends(paths)
    assert signed_area(start, end) == pytest.approx(black.sum() * 0.003 * 0.0021, rel=1e-9)
    for row, col in np.ndindex(black.shape):  # winding number of the middle of each cell
        x, y = 0.01 + 0.003 * (col + 0.5), 0.02 + 0.0021 * (row + 0.5)
        crossing = (start[:, 1] < y) != (end[:, 1] < y)
        beyond = crossing & (start[:, 0] > x)
        assert np.sign(end[:, 1] - start[:, 1])[beyond].sum() == black[row, col]
    for path in paths:  # straight pieces are not divided
        along = np.roll(path, -1, axis=0) - path
        after = np.roll(along, -1, axis=0)
        assert (along[:, 0] * after[:, 1] != along[:, 1] * after[:, 0]).all()


@each_board
def test_the_caption_is_the_boards_own_target_yaml(target, tmp_path):
    printed = save_target(target, tmp_path / "board")
    assert [file.name for file in printed.files] == ["board.pdf", "board.svg", "board.yaml"]
    pdf, svg, described = printed.files
    for caption in (pdf_caption(pdf.read_bytes()), svg_caption(svg.read_text()), described.read_text()):
        (tmp_path / "caption.yaml").write_text(caption)
        notes = []
        assert target_text(read_target(tmp_path / "caption.yaml", notes)) == target_text(target)
        assert notes == []


@each_board
@pytest.mark.parametrize("paper", ["", "A3", "500x410mm"])
def test_sheet_and_rulers_are_true_to_scale(target, paper):
    drawing = board_drawing(target, paper)
    svg, pdf = both(target, paper)
    assert svg_size(svg) == pytest.approx(drawing.size, abs=1e-6)
    assert pdf_boxes(pdf) == [pytest.approx(drawing.size, abs=1e-4)]
    scale = float(pdf_streams(pdf)[1].split()[0])
    assert scale * 100 == pytest.approx(100 / 25.4 * 72, abs=1e-6)  # the ruler's 100 mm in points
    ruler = drawing.lines[:2].reshape(2, 2, 2)
    np.testing.assert_allclose(ruler[:, 1] - ruler[:, 0], [[100, 0], [0, 100]])
    for axis, piece in enumerate(ruler):
        ticks = drawing.lines[
            (drawing.lines[:, 1 - axis] == piece[0, 1 - axis]) & (drawing.lines[:, axis] > piece[0, axis])
        ]
        np.testing.assert_allclose(sorted(ticks[:, axis] - piece[0, axis]), range(1, 101))


@each_board
def test_nothing_lies_on_another_thing(target):
    drawing = board_drawing(largest_on(target, "A4"), "A4")
    points = np.concatenate(drawing.areas)
    board = np.concatenate(drawing.areas[:-1])
    assert (points >= 5).all()
    assert (points <= np.array(drawing.size) - 5).all()
    for words in drawing.words:
        wide = (0.6 if words.font == "Courier" else 0.56) * words.height * len(words.text)
        assert words.x + wide < drawing.size[0] - 3, words
        over_board = words.x + wide > board[:, 0].min() and words.y + words.height > board[:, 1].min()
        assert not over_board, words


def test_a_board_takes_the_sheet_that_it_needs():
    kalibr = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
    assert board_drawing(kalibr).size == PAPERS["A0"]
    with pytest.raises(OptionError, match=r"765\.6 x 765\.6 mm .* does not fit on A4 .* Choose paper A0"):
        board_drawing(kalibr, "A4")
    huge = Target.checkerboard(cols=9, rows=6, row_spacing_m=0.15, col_spacing_m=0.15)
    width, height = board_drawing(huge).size
    assert width == pytest.approx(11 * 150 + 22)
    assert height == pytest.approx(8 * 150 + 38)
    with pytest.raises(OptionError, match=r"Choose paper 1672x1238mm"):
        board_drawing(huge, "a0")
    assert paper_size("500 x 700 mm") == (500, 700)
    for paper, found in (
        ("A9", "expected one of A5, A4"),
        ("100x100mm", "120 x 125 mm at least"),
        ("9000x500mm", "5000"),
    ):
        with pytest.raises(OptionError, match=found):
            paper_size(paper)


@each_board
@pytest.mark.parametrize("paper", ["A4", "letter", "A3"])
def test_the_largest_that_fits_fits_and_no_larger_one(target, paper):
    found = largest_on(target, paper)
    board_drawing(found, paper)
    name = {"aprilgrid": "tag_size_m", "circlegrid": "spacing_m", "charuco": "square_size_m"}.get(
        found.kind, "row_spacing_m"
    )
    side = getattr(found, name)
    assert side * 2000 == pytest.approx(round(side * 2000), abs=1e-6)
    ratio = (side + 0.0005) / getattr(target, name)
    larger = {each: getattr(target, each) * ratio for each in _lengths(target)}
    with pytest.raises(OptionError, match="does not fit"):
        board_drawing(Target(**_stated(target) | larger), paper)


def _lengths(target):
    names = ("tag_size_m", "row_spacing_m", "col_spacing_m", "spacing_m", "square_size_m", "marker_size_m")
    return [name for name in names if getattr(target, name)]


def _stated(target):
    return {name: getattr(target, name) for name in target.__slots__ if name != "points"}


def test_tiles_make_up_the_sheet():
    target = Target.aprilgrid(tag_cols=4, tag_rows=3, tag_size_m=0.08, tag_spacing=0.3)
    drawing, pages = tile_board(target, "A4")
    assert len(pages) == 6
    shown = np.zeros((int(drawing.size[1] * 2), int(drawing.size[0] * 2)), int)
    for page in pages:
        x0, y0, x1, y1 = page.window
        x, y = page.offset
        assert (x0, y0) == (10, 10)
        assert (page.size[0] - x1, page.size[1] - y1) == (10, 10)
        rows = slice(max(0, round(2 * (y0 - y))), max(0, round(2 * (y1 - y))))
        shown[rows, max(0, round(2 * (x0 - x))) : max(0, round(2 * (x1 - x)))] += 1
    assert shown.min() == 1
    pdf = pdf_bytes(drawing, "tiles", pages)
    assert (
        pdf_boxes(pdf) == [pytest.approx(PAPERS["A4"][::-1] if pages[0].size[0] > 250 else PAPERS["A4"], abs=1e-4)] * 6
    )
    # a mark of a page is where the window of the next one begins
    first, second = pages[0], pages[1]
    marks = [mark[0] for mark in first.marks if mark[0] == mark[2]]
    assert marks == pytest.approx([second.window[0] - second.offset[0] + first.offset[0]] * 2)


def test_a_board_that_cannot_be_printed(tmp_path):
    with pytest.raises(OptionError, match="tag 587"):
        board_drawing(Target.aprilgrid(tag_cols=30, tag_rows=20, tag_size_m=0.01, tag_spacing=0.3))
    with pytest.raises(OptionError, match="marker 50 in 4X4_50"):
        board_drawing(Target.charuco(cols=12, rows=9, square_size_m=0.02, marker_size_m=0.015))
    with pytest.raises(OptionError, match=r"\.pdf or \.svg"):
        save_target(BOARDS["charuco"], tmp_path / "board.png")
    (tmp_path / "board.yaml").write_text("mine: 1\n")
    with pytest.raises(OutputError, match="describes no board"):
        save_target(BOARDS["charuco"], tmp_path / "board.pdf")
    (tmp_path / "board.yaml").write_text("# measured\n" + target_text(BOARDS["legacy"]))
    with pytest.raises(OutputError, match="another board"):
        save_target(BOARDS["charuco"], tmp_path / "board.pdf")
    assert [path.name for path in tmp_path.iterdir()] == ["board.yaml"]
    save_target(BOARDS["legacy"], tmp_path / "board.PDF")
    assert (tmp_path / "board.yaml").read_text().startswith("# measured")
    assert (tmp_path / "board.PDF").read_bytes().startswith(b"%PDF")


def detect(image, target):
    if target.kind == "aprilgrid":
        from gnomon.detect.boards.aprilgrid import detect_aprilgrid as found
    elif target.kind == "checkerboard":
        from gnomon.detect.boards.checkerboard import detect_checkerboard as found
    elif target.kind == "charuco":
        from gnomon.detect.boards.charuco import detect_charuco as found
    else:
        from gnomon.detect.boards.circlegrid import CircleGridDetector

        return CircleGridDetector(target).detect(image)
    return found(image, target)


@each_board
@pytest.mark.parametrize("rotvec", [(0.35, -0.3, 0.2), pytest.param((0.05, 0.1, 0.1), marks=pytest.mark.slow)])
def test_what_is_printed_and_photographed_the_detectors_read(target, rotvec):
    camera = euroc_camera()
    svg, _ = both(target)
    size = svg_size(svg)
    sheet = drawn(svg_paths(svg), size)
    R, p = pose_before(size, camera, 0.55, rotvec)
    image = photographed(sheet, PX_PER_MM, camera, R, p)
    view = detect(image, target)
    assert len(view) >= 0.9 * len(target)
    found = on_sheet(view.pixels, camera, R, p)
    placed, turn = rigidly(target.points[view.point, :2], found)
    points = np.column_stack([placed, np.zeros(len(placed))]) @ R.T + p
    away = np.linalg.norm(camera.project(points).pixels - view.pixels, axis=1)
    assert np.sqrt((away**2).mean()) < 0.03
    assert away.max() < 0.1
    if target.kind == "circlegrid" and not target.asymmetric:  # which looks the same after half a turn
        turn = turn * np.sign(turn[0, 1] * as_printed(target)[1][0])
    np.testing.assert_allclose(turn, np.transpose(as_printed(target)), atol=0.01)


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="no pdftoppm on the PATH")
@pytest.mark.parametrize("name", ["aprilgrid", "charuco"])
def test_a_viewer_of_pdf_draws_the_board(name, tmp_path):
    target = BOARDS[name]
    files = save_target(target, tmp_path / "board").files
    dpi = 25.4 * PX_PER_MM
    subprocess.run(
        ["pdftoppm", "-gray", "-r", f"{dpi}", "-singlefile", str(files[0]), str(tmp_path / "page")],
        check=True,
        timeout=60,
    )
    compare_board(read_grey(tmp_path / "page.pgm"), files[1].read_text())


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)
@pytest.mark.parametrize("name", ["aprilgrid", "circlegrid"])
def test_a_browser_draws_the_board(name, tmp_path):
    import base64

    svg = save_target(BOARDS[name], tmp_path / "board.svg").files[0]
    width, height = (int(PX_PER_MM * side) for side in svg_size(svg.read_text()))
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(svg, width=width, height=height)
        # A browser rounds the size of an image to its pixels: one that is whole.
        browser.evaluate(f"document.documentElement.setAttribute('width', {width}), 0")
        browser.evaluate(f"document.documentElement.setAttribute('height', {height}), 0")
        shot = browser.call("Page.captureScreenshot")["data"]
    finally:
        browser.close()
    (tmp_path / "page.png").write_bytes(base64.b64decode(shot))
    compare_board(read_grey(tmp_path / "page.png"), svg.read_text())


def read_grey(path):
    import cv2

    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


def compare_board(image, svg):
    """A program's picture of a sheet agrees with exact areas where the board is: no seams, nothing displaced."""
    import cv2

    board = svg_paths(svg)[:-1]
    exact = 255 * (1 - drawn(board, svg_size(svg)))
    (x0, y0), (x1, y1) = (limit(np.concatenate(board), axis=0) for limit in (np.min, np.max))
    rows = slice(int(exact.shape[0] - PX_PER_MM * (y1 + 1)), int(exact.shape[0] - PX_PER_MM * (y0 - 1)))
    part = rows, slice(int(PX_PER_MM * (x0 - 1)), int(PX_PER_MM * (x1 + 1)))
    assert np.abs(np.subtract(image.shape, exact.shape)).max() <= 1
    difference = image[part].astype(float) - exact[part]
    by_y, by_x = np.gradient(exact[part])
    shift = [float((difference * by).sum() / (by * by).sum()) for by in (by_x, by_y)]
    assert np.abs(shift).max() < 0.1  # of a pixel of 0.125 mm
    around = np.ones((5, 5))
    plain = cv2.dilate(exact[part], around) == cv2.erode(exact[part], around)
    assert np.abs(difference[plain]).max() <= 1


def test_pages_ask_not_to_be_scaled():
    pdf = both(BOARDS["charuco"])[1]
    assert b"/PrintScaling /None" in pdf
    table = int(re.search(rb"startxref\n(\d+)", pdf)[1])
    assert pdf[table:].startswith(b"xref")
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n", pdf), start=1):
        assert pdf[int(place) :].startswith(b"%d 0 obj" % number)
