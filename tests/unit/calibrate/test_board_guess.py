"""What is said of images that do not show the stated board."""

from functools import cache

import numpy as np
import pytest

from gnomon.detect.boards.board_guess import guess_board
from gnomon.models.target import Target
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING, Ranges, euroc_camera, rendered_views


def april(cols: int, rows: int, spacing=0.3, **others) -> Target:
    return Target.aprilgrid(tag_cols=cols, tag_rows=rows, tag_size_m=0.08, tag_spacing=spacing, **others)


def checkerboard(cols: int, rows: int) -> Target:
    return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=0.05, col_spacing_m=0.05)


@cache
def images(name: str, partial: bool = False) -> list[np.ndarray]:
    target = BOARDS[name]
    ranges = Ranges(tag_px=(30.0, 40.0), blur_px=(0.3, 0.8), noise=(1.0, 3.0), tilt_deg=(0.0, 30.0), partial=partial)
    return [view.image for view in rendered_views(target, 3, 2, ranges=ranges)]


BOARDS = {
    "april": april(6, 5),
    "wide gaps": april(5, 4, 0.5),
    "plain": april(5, 4, border_bits=1),
    "late": april(4, 4, first_tag=100),
    "checkerboard": checkerboard(8, 5),
}


@pytest.mark.parametrize(
    ("shown", "stated", "told"),
    [
        ("april", checkerboard(7, 6), ["tags 0 to 29", "2 bits", "6 in a row", "instead of a checkerboard"]),
        ("april", april(6, 6), ["That is the stated one"]),
        ("april", april(5, 6), ["it has 5 columns (are tagCols and tagRows exchanged?)"]),
        ("april", april(6, 4), ["tags 0 to 29", "its tags are 0 to 23."]),
        ("april", april(6, 5, 0.2), ["gaps of 0.3", "its tagSpacing is 0.2"]),
        ("april", april(6, 5, border_bits=1), ["its tagBorderBits is 1."]),
        ("wide gaps", april(5, 4), ["gaps of 0.5", "its tagSpacing is 0.3"]),
        ("plain", april(5, 4), ["border of 1 bit", "its tagBorderBits is 2"]),
        ("late", april(4, 4), ["tags 100 to 115", "its tags are 0 to 15"]),
        ("checkerboard", april(6, 6), ["checkerboard of 8 x 5 inner corners", "instead of the aprilgrid"]),
        ("checkerboard", checkerboard(7, 6), ["checkerboard of 8 x 5", "The stated one has 7 x 6"]),
        ("checkerboard", checkerboard(6, 9), ["checkerboard of 8 x 5", "seem to count squares"]),
        ("checkerboard", checkerboard(5, 8), ["That is the stated one"]),
    ],
)
def test_the_board_in_the_images_is_described(shown, stated, told):
    text = guess_board(images(shown), stated)
    for part in told:
        assert part in text
    differs = any(part.startswith(("its ", "it has ")) for part in told)
    assert ("The stated board differs" in text) == differs


def test_tags_in_the_mirror():
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in images("april")]
    text = guess_board(mirrored, BOARDS["april"])
    assert "only be read in the mirror" in text
    assert "6 in a row" in text


def test_part_of_a_checkerboard():
    halves = [image[:, : image.shape[1] // 2] for image in images("checkerboard")]
    text = guess_board([np.ascontiguousarray(half) for half in halves], BOARDS["checkerboard"])
    assert "checkerboard" in text
    assert "as a whole" in text


def test_no_board():
    away = np.array([0.0, 0.0, -1.0])
    wall = render_board(
        _pattern(), euroc_camera(), FACING, away, options=Optics(noise=2.0), wall=cluttered_wall(0), rng=_random()
    )
    assert guess_board([wall], BOARDS["april"]).startswith("They show no board")
    assert "one grey level" in guess_board([np.full((480, 752), 3, np.uint8)], BOARDS["april"])
    assert "no image" in guess_board([], BOARDS["april"])


def _pattern():
    from gnomon.models.board_pattern import board_pattern

    return board_pattern(BOARDS["april"])


def _random():
    return np.random.default_rng(0)


def test_the_real_board(real_data):
    import cv2

    folder = real_data("euroc-cam-april")
    real = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("*.png"))]
    text = guess_board(real, checkerboard(7, 6))
    assert "tags 0 to 35" in text
    assert "6 in a row, gaps of 0.3" in text
