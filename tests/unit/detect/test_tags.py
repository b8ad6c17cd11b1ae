"""Codes of AprilTags, read from pictures of single tags."""

import cv2
import numpy as np
import pytest

from gnomon.detect.boards.marker_boards import black_quads
from gnomon.detect.boards.tags import BITS, FAMILY, likeness_of, read_tags, tag_pictures

WHITE, BLACK = 205, 25
SIZE = 240


def tag_picture(number, border_bits, side_px, *, turn=0.0, blur=0.7, noise=0.0, mirrored=False):
    """Return a picture of a tag, and its corners counter-clockwise from the lower left."""
    cells = np.pad(tag_pictures()[number], border_bits)
    fine = np.pad(np.kron(cells, np.ones((16, 16))), 32, constant_values=1).astype(np.float32)
    cells_across = len(cells)
    scale = side_px / (16 * cells_across)
    cos, sin = np.cos(turn), np.sin(turn)
    R = np.array([[cos, -sin], [sin, cos]]) @ (np.diag([-1, 1]) if mirrored else np.eye(2))
    middle = np.full(2, (len(fine) - 1) / 2)
    to_image = np.column_stack([scale * R, [SIZE / 2 + 0.3, SIZE / 2 - 0.2] - scale * R @ middle])
    soft = cv2.GaussianBlur(fine, (0, 0), np.hypot(blur, 0.29) / scale)
    image = cv2.warpAffine(soft, to_image, (SIZE, SIZE), flags=cv2.INTER_LINEAR, borderValue=1)
    levels = BLACK + (WHITE - BLACK) * image + np.random.default_rng(5).normal(0, noise, image.shape)
    half = 8 * cells_across
    outline = middle + half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])  # rows go down
    return np.clip(levels, 0, 255).astype(np.uint8), outline @ to_image[:, :2].T + to_image[:, 2]


def test_codes_differ_however_they_are_turned():
    assert tag_pictures().shape == (FAMILY, BITS, BITS)
    flat = np.stack([np.rot90(tag_pictures(), k, axes=(1, 2)) for k in range(4)]).reshape(4, FAMILY, -1)
    apart = (flat[0][:, None, None] != flat.transpose(1, 0, 2)[None]).sum(axis=3)  # tag, other tag, turn
    apart[np.arange(FAMILY), np.arange(FAMILY), 0] = 36
    assert apart.min() == 11


def test_codes_are_those_of_the_family_row_by_row_from_the_top():
    for number, code in enumerate((0xD5D628584, 0xD97F18B49, 0xDD280910E)):  # as the family was published
        assert "".join("01"[int(bit)] for bit in tag_pictures()[number].ravel()) == f"{code:036b}"


@pytest.mark.parametrize("border_bits", [1, 2])
@pytest.mark.parametrize("turn", np.arange(4) * np.pi / 2 + 0.2)
def test_a_tag_is_read_whichever_way_it_lies(border_bits, turn):
    image, corners = tag_picture(17, border_bits, 70, turn=turn, noise=3)
    tags = read_tags(image, black_quads(image), border_bits=border_bits)
    assert tags.number.tolist() == [17]
    np.testing.assert_allclose(tags.corners[0], corners, atol=1.7)
    assert tags.likeness[0] > 0.95
    np.testing.assert_allclose(likeness_of(image, corners[None], np.array([17]), border_bits), 1, atol=0.05)


def test_small_and_blurred_tags_are_read():
    for side_px, blur, search in ((15, 0.5, "usual"), (20, 1.0, "usual"), (24, 1.4, "usual"), (150, 4.0, "coarse")):
        image, corners = tag_picture(233, 2, side_px, turn=0.3, blur=blur, noise=2)
        tags = read_tags(image, black_quads(image, search))
        assert tags.number.tolist() == [233], side_px
        np.testing.assert_allclose(tags.corners[0], corners, atol=1.2 + blur)


def test_only_tags_that_are_asked_for_are_read():
    image, _ = tag_picture(40, 2, 60)
    quads = black_quads(image)
    assert read_tags(image, quads, first=36, count=36).number.tolist() == [40]
    assert len(read_tags(image, quads, first=0, count=36)) == 0
    assert len(read_tags(image, quads, first=600, count=5)) == 0
    blurred, _ = tag_picture(40, 2, 20, blur=1.1, noise=2)  # others are more alike, and none is taken for it
    for first in range(0, 36, 6):
        assert len(read_tags(blurred, black_quads(blurred), first=first, count=6)) == 0


def test_tags_in_the_mirror_and_with_another_border_are_none():
    mirrored, _ = tag_picture(3, 2, 80, mirrored=True)
    assert len(black_quads(mirrored)) > 0
    assert len(read_tags(mirrored, black_quads(mirrored))) == 0
    for printed, stated in ((1, 2), (2, 1)):
        image, _ = tag_picture(3, printed, 80)
        assert len(read_tags(image, black_quads(image), border_bits=stated)) == 0


def test_likeness_of_another_tag_and_of_one_that_is_partly_seen():
    image, corners = tag_picture(17, 2, 90)
    assert likeness_of(image, corners[None], np.array([18]))[0] < 0.5
    left = int(corners[:, 0].min())
    for cut, seen in ((20, True), (75, False)):  # px of the tag that are lost
        part = np.ascontiguousarray(image[:, left + cut :])
        likeness = likeness_of(part, corners[None] - [left + cut, 0], np.array([17]))[0]
        assert likeness > 0.9 if seen else np.isnan(likeness)


@pytest.mark.parametrize("search", ["usual", "coarse", "motion", "small"])
def test_nothing_is_found_where_there_is_nothing(search):
    noise = np.random.default_rng(0).normal(120, 25, (120, 160)).clip(0, 255).astype(np.uint8)
    for image in (np.zeros((60, 80), np.uint8), np.full((60, 80), 255, np.uint8), noise, np.zeros((3, 5), np.uint8)):
        assert len(read_tags(image, black_quads(image, search))) == 0


@pytest.mark.parametrize(("search", "px"), [("usual", 0.8), ("coarse", 1.5), ("motion", 0.8), ("small", 0.8)])
def test_quadrilaterals_are_where_the_tag_is(search, px):
    image, corners = tag_picture(5, 2, 64, turn=0.5, blur=0.8, noise=1)
    quads = black_quads(image, search)
    apart = [np.abs(np.roll(quads, k, axis=1)[:, ::-1] - corners).max(axis=(1, 2)) for k in range(4)]
    assert np.min(apart) < px


def test_squares_that_touch_are_two():
    image = np.full((120, 120), 220, np.uint8)
    image[20:60, 20:60] = image[60:100, 60:100] = 20
    for blur in (0.3, 1.0, 2.0):
        assert len(black_quads(cv2.GaussianBlur(image, (0, 0), blur))) == 2
