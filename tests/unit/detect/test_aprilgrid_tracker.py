"""A grid of AprilTags that is followed from image to image: as good as a search, and never another board's numbers."""

import numpy as np
import pytest

from gnomon.detect.boards import aprilgrid_tracker
from gnomon.detect.boards.aprilgrid import detect_aprilgrid
from gnomon.detect.boards.aprilgrid_tracker import AprilGridTracker
from gnomon.detect.boards.plane_map import plane_map
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING

BOARD = Target.aprilgrid(tag_cols=5, tag_rows=4, tag_size_m=0.08, tag_spacing=0.3)
LENS = Camera(
    projection="pinhole",
    intrinsics=np.array([330.0, 329.0, 238.0, 181.0]),
    distortion="radtan",
    distortion_coeffs=np.array([-0.28, 0.07, 0.0002, -0.0001]),
    resolution=(480, 360),
)


def picture(shift, roll, seed, *, away_m=0.62, covers=()):
    """Return an image of the board and where its points are in it."""
    cos, sin = np.cos(roll), np.sin(roll)
    R = FACING @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    middle = (BOARD.points.min(axis=0) + BOARD.points.max(axis=0)) / 2
    p = np.array([*shift, away_m]) - R @ middle
    optics = Optics(noise=1.5, blur_px=0.6)
    rng = np.random.default_rng(seed)
    image = render_board(board_pattern(BOARD), LENS, R, p, options=optics, occluders=covers, rng=rng)
    return image, LENS.project(BOARD.points @ R.T + p).pixels


@pytest.fixture
def searches(monkeypatch):
    """Count the searches."""
    counted, search = [], aprilgrid_tracker.search_tags

    def search_tags(image, target):
        counted.append(image)
        return search(image, target)

    monkeypatch.setattr(aprilgrid_tracker, "search_tags", search_tags)
    return counted


def test_a_board_that_moves_by_more_than_a_tag_is_followed_as_exactly_as_it_is_searched(searches):
    tracker, errors, z = AprilGridTracker(BOARD), [], []
    steps = np.cumsum([[0, 0], [0.03, 0], [0.06, 0.02], [-0.07, 0.01], [-0.02, -0.06], [0.01, 0.03]], axis=0)
    for k, shift in enumerate(steps):  # 0.1 m are 53 px and a tag
        image, pixels = picture(shift - [0.03, 0.0], 0.05 * k, k)
        view, searched = tracker.detect(image), detect_aprilgrid(image, BOARD)
        assert np.array_equal(view.point, searched.point)
        errors.append(view.pixels - pixels[view.point])
        z.append(errors[-1] / view.sigma_px[:, None])
        assert np.square(errors[-1]).mean() < 1.1 * np.square(searched.pixels - pixels[searched.point]).mean()
    assert len(searches) == 1
    assert np.abs(np.concatenate(errors)).max() < 0.15
    assert np.sqrt(np.square(np.concatenate(z)).mean()) < 1.3


def test_tags_that_come_into_the_image_are_found_while_the_board_is_followed(searches):
    tracker, counts = AprilGridTracker(BOARD), []
    for k, x in enumerate((0.42, 0.38, 0.34, 0.3, 0.26)):
        image, pixels = picture((x, 0.0), 0.1, k)
        view = tracker.detect(image)
        counts.append(len(view))
        assert np.abs(view.pixels - pixels[view.point]).max() < 0.2
        assert len(view) >= len(detect_aprilgrid(image, BOARD)) - 2
    assert counts[-1] > counts[0] + 10
    assert len(searches) <= 2


def test_a_board_that_is_gone_is_searched_and_another_one_is_not_taken_for_it(searches):
    tracker = AprilGridTracker(BOARD)
    first, _ = picture((0.0, 0.0), 0.0, 0)
    assert len(tracker.detect(first)) == len(BOARD)
    assert len(tracker.detect(np.full_like(first, 128))) == 0
    assert len(tracker.detect(first)) == len(BOARD)
    turned = np.ascontiguousarray(first[::-1, ::-1])  # half a turn in no time: the same tags elsewhere
    found = tracker.detect(turned)
    assert np.array_equal(found.point, detect_aprilgrid(turned, BOARD).point)
    assert len(searches) == 4


def test_images_of_other_sizes_are_searched(searches):
    tracker = AprilGridTracker(BOARD)
    image, _ = picture((0.0, 0.0), 0.0, 0)
    tracker.detect(image)
    assert len(tracker.detect(np.ascontiguousarray(image[:-40]))) > 0
    assert len(searches) == 2


@pytest.mark.parametrize("coeffs", [(0.0, 0.0), (-0.28, 0.07), (-0.4, 0.12), (0.2, -0.05)])
def test_the_map_of_a_board_is_found_whatever_the_lens_and_the_tilt(coeffs):
    lens = Camera(
        projection="pinhole",
        intrinsics=LENS.intrinsics,
        distortion="radtan",
        distortion_coeffs=np.array([*coeffs, 0.0, 0.0]),
        resolution=LENS.resolution,
    )
    rng, near = np.random.default_rng(3), None
    points = BOARD.points[:, :2]
    for _ in range(12):
        tilt = rng.uniform(-0.7, 0.7, 2)
        R = FACING @ np.array(
            [[1, 0, 0], [0, np.cos(tilt[0]), -np.sin(tilt[0])], [0, np.sin(tilt[0]), np.cos(tilt[0])]]
        )
        R = R @ np.array([[np.cos(tilt[1]), 0, np.sin(tilt[1])], [0, 1, 0], [-np.sin(tilt[1]), 0, np.cos(tilt[1])]])
        p = np.array([*rng.uniform(-0.05, 0.05, 2), 0.7]) - R @ BOARD.points.mean(axis=0)
        pixels = lens.project(BOARD.points @ R.T + p).pixels + 0.01 * rng.normal(size=points.shape)
        for lens_of in (None, near):
            found = plane_map(points, pixels, LENS.resolution, lens_of)
            assert np.sqrt(found.mean_square_px) < 0.025
        near = found if near is None else near


def test_edges_bend_as_the_lens_says():
    points = BOARD.points[:, :2]
    pixels = LENS.project(BOARD.points @ FACING.T + [-0.2, 0.2, 0.5]).pixels
    seen = plane_map(points, pixels, LENS.resolution)
    step = 0.004
    offsets = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    at = seen.pixels(points[:, None] + offsets, len(offsets))
    ahead, behind = at[:, 1::2] - at[:, :1], at[:, 2::2] - at[:, :1]
    along, bent = (ahead - behind) / 2, ahead + behind
    length = np.linalg.norm(along, axis=2, keepdims=True)
    normals = (along / length)[:, :, ::-1] * [-1, 1]
    expected = (normals * bent / length**2).sum(axis=2)
    assert np.abs(expected).max() > 2e-4
    np.testing.assert_allclose(seen.curvature(at[:, 0], normals), expected, atol=0.01 * np.abs(expected).max())
