"""`gnomon target`: drawings of every board, and what is said where one cannot be drawn."""

import json

import pytest

from gnomon.formats.kalibr.target import read_target, target_text
from gnomon.models.target import Target
from printed import pdf_boxes, pdf_caption, svg_size

USAGE, BAD_INPUT = 2, 3
KINDS = ("aprilgrid", "checkerboard", "circlegrid", "charuco")


def said(text):
    """What a message says, without the frame around it."""
    return " ".join(text.replace("│", " ").split())


@pytest.mark.parametrize("kind", KINDS)
def test_every_board_fits_on_a4_without_an_option(kind, run, names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("target", kind)
    assert (code, err) == (0, "")
    stem = {"aprilgrid": "aprilgrid-6x6", "checkerboard": "checkerboard-9x6", "circlegrid": "circlegrid-7x6"}.get(
        kind, "charuco-7x9"
    )
    assert names(tmp_path) == [f"{stem}.pdf", f"{stem}.svg", f"{stem}.yaml"]
    assert sorted(svg_size((tmp_path / f"{stem}.svg").read_text())) == [210, 297]
    board = read_target(f"{stem}.yaml")
    assert board.describe() in out
    for name in names(tmp_path):
        assert name in out
    assert pdf_caption((tmp_path / f"{stem}.pdf").read_bytes()) == (tmp_path / f"{stem}.yaml").read_text()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert run("target", kind)[0] == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        (
            "aprilgrid --size 88mm",
            Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3),
        ),
        (
            "aprilgrid --cols 4 --rows 3 --size 0.05 --spacing 0.25 --border-bits 1 --first 8",
            Target.aprilgrid(
                tag_cols=4, tag_rows=3, tag_size_m=0.05, tag_spacing=0.25, border_bits=1, first_tag=8
            ),
        ),
        (
            "checkerboard --cols 7 --size 3.5cm",
            Target.checkerboard(cols=7, rows=6, row_spacing_m=0.035, col_spacing_m=0.035),
        ),
        ("circlegrid --asymmetric --size 20mm", Target.circlegrid(cols=4, rows=11, spacing_m=0.02, asymmetric=True)),
        (
            "charuco --rows 6 --size 40mm --dictionary DICT_6X6_250 --marker 29.5mm --legacy --first 9",
            Target.charuco(
                cols=7,
                rows=6,
                square_size_m=0.04,
                marker_size_m=0.0295,
                dictionary="6X6_250",
                first_marker=9,
                legacy=True,
            ),
        ),
        ("charuco --size 40mm", Target.charuco(cols=7, rows=9, square_size_m=0.04, marker_size_m=0.03)),
    ],
)  # fmt: skip
def test_boards_as_they_are_asked_for(arguments, target, run, tmp_path):
    code, out, _ = run("target", *arguments.split(), "-o", tmp_path / "board", "--json")
    assert code == 0
    assert (tmp_path / "board.yaml").read_text() == target_text(target)
    document = json.loads(out)
    assert document["board"] == target.describe()
    assert document["files"] == [str(tmp_path / f"board.{kind}") for kind in ("pdf", "svg", "yaml")]
    assert svg_size((tmp_path / "board.svg").read_text()) == pytest.approx(document["sheet_mm"])
    assert document["pages"] == 1


def test_the_board_of_a_file(run, names, tmp_path):
    file = tmp_path / "target.yaml"
    text = "# measured: 100.2 mm\n" + target_text(Target.circlegrid(cols=5, rows=5, spacing_m=0.0301))
    file.write_text(text)
    code, out, _ = run("target", file, "--paper", "A3")
    assert code == 0
    assert "297 x 420 mm" in out or "420 x 297 mm" in out
    assert names(tmp_path) == ["target.pdf", "target.svg", "target.yaml"]
    assert file.read_text() == text
    assert run("target", file, "-o", tmp_path / "other.svg")[0] == 0
    assert (tmp_path / "other.yaml").read_text() == text.split("\n", 1)[1]
    assert not (tmp_path / "other.pdf").exists()
    (tmp_path / "folder").mkdir()
    assert run("target", file, "-o", tmp_path / "folder")[0] == 0
    assert names(tmp_path / "folder") == ["target.pdf", "target.svg", "target.yaml"]


def test_tiles(run, tmp_path):
    code, out, _ = run("target", "aprilgrid", "--size", "88mm", "--tiles", "-o", tmp_path / "board.pdf")
    assert code == 0
    boxes = pdf_boxes((tmp_path / "board.pdf").read_bytes())
    assert f"{len(boxes)} sheets of 210 x 297 mm" in out
    assert len(boxes) == 15
    assert set(map(tuple, [tuple(round(side) for side in box) for box in boxes])) == {(210, 297)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("aprilgird", "aprilgird: there is neither such a board nor such a file. Boards are aprilgrid, checkerboard,"),
        ("aprilgrid --size 88", 'size "88" is 88 m, which no board has. Was 88mm meant?'),
        ("aprilgrid --size wide", 'size "wide": expected a length such as 88mm'),
        ("aprilgrid --size 0mm", 'size "0mm": expected a length'),
        ("aprilgrid --size 88mm --paper A4", "does not fit on A4 with its rulers and words. Choose paper A0"),
        ("aprilgrid --paper A9", 'paper "A9": expected one of A5, A4'),
        ("aprilgrid --marker 3mm", "--marker is of a board of kind charuco, and this is one of kind aprilgrid"),
        ("aprilgrid --asymmetric", "--asymmetric is of a board of kind circlegrid"),
        ("checkerboard --first 3", "--first is of a board of kind aprilgrid or charuco"),
        ("charuco --marker 3mm", "--marker is a length, which needs --size"),
        ("charuco --size 3mm --marker 3mm", "must be less than square_size_m"),
        ("charuco --dictionary 4X4", 'dictionary "4X4": expected one of 4X4_50'),
        ("charuco --cols 20", "there is no marker 50 in 4X4_50; it has markers 0 to 49"),
        ("aprilgrid --cols 30 --rows 20", "there is no tag 587 in the family 36h11"),
        ("aprilgrid --cols 0", "cols 0 is out of range. Give a number from 1 to 1000."),
        ("aprilgrid --spacing 0", "tag_spacing 0 of the aprilgrid must be a finite number greater than zero"),
        ("checkerboard --cols 700 --rows 3", "a checkerboard of 700 x 3 does not fit on A4"),
        ("aprilgrid --tiles", "--tiles needs --size"),
        ("aprilgrid -o board.png", "boards are drawn as .pdf or .svg"),
        ("there.yaml --cols 3", "--cols cannot be stated besides the file there.yaml, which describes the board"),
    ],
)
def test_what_cannot_be_drawn(arguments, message, run, names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("target", *arguments.split())
    assert code == USAGE
    assert out == ""
    assert message in said(err)
    assert names(tmp_path) == []


def test_places_that_cannot_be_written(run, names, tmp_path):
    (tmp_path / "board.yaml").write_text("")
    code, _, err = run("target", "charuco", "-o", tmp_path / "board.yaml" / "board.pdf")
    assert code == BAD_INPUT
    assert "cannot be written" in err
    assert names(tmp_path) == ["board.yaml"]
    (tmp_path / "board.yaml").write_text("target_type: aprilgrid\ntagCols: 3\n")
    code, _, err = run("target", "charuco", "-o", tmp_path / "board.pdf")
    assert code == BAD_INPUT
    assert "this file exists and describes no board" in err
    assert names(tmp_path) == ["board.yaml"]
    (tmp_path / "bad.yaml").write_text("target_type: aprilgrid\ntagCols: 3\n")
    code, _, err = run("target", tmp_path / "bad.yaml", "-o", tmp_path / "new.pdf")
    assert code == BAD_INPUT
    assert "the key tagRows is missing" in err


def test_a_folder_that_is_not_there_is_made(run, names, tmp_path):
    code, _, _ = run("target", "charuco", "-o", tmp_path / "new" / "boards" / "board.pdf")
    assert code == 0
    assert names(tmp_path / "new" / "boards") == ["board.pdf", "board.yaml"]
