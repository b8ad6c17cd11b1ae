"""Corners of checkerboards, in rendered images of which the truth is known."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gnomon.detect.boards.checkerboard as module
from gnomon.detect.boards.checkerboard import (
    CheckerboardGrid,
    CheckerboardTracker,
    board_at,
    detect_checkerboard,
    fill_grid,
    find_board,
)
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING, Ranges, rendered_views


def checkerboard(cols: int, rows: int) -> Target:
    return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=0.04, col_spacing_m=0.04)


ODD = checkerboard(8, 5)  # its colours tell one end from the other
EVEN = checkerboard(8, 6)
CAMERA = Camera(
    projection="pinhole",
    intrinsics=np.array([380.0, 380.0, 239.5, 179.5]),
    distortion="radtan",
    distortion_coeffs=np.array([-0.2, 0.05, 0.0, 0.0]),
    resolution=(480, 360),
)


def picture(target, rotvec=(0.0, 0.0, 0.0), place=(0.0, 0.0, 0.55), *, seed=0, wall=True, **optics):
    """Return an image of a board about the middle of the image, and where its corners are."""
    R = FACING @ rotation_from_rotvec(np.array(rotvec))
    p = np.array(place) - R @ target.points.mean(axis=0)
    image = render_board(
        board_pattern(target),
        CAMERA,
        R,
        p,
        options=Optics(blur_px=0.6, noise=2.0, **optics),
        wall=cluttered_wall(1) if wall else None,
        rng=np.random.default_rng(seed),
    )
    return image, CAMERA.project(target.points @ R.T + p).pixels


def errors(view, true, target):
    """Return the errors (m, 2) of a view, and whether it is numbered from the other end."""
    turned = len(target) - 1 - view.point
    both = [view.pixels - true[numbers] for numbers in (view.point, turned)]
    other = bool(np.abs(both[1]).mean() < np.abs(both[0]).mean())
    return both[other], other


def test_corners_are_where_they_are_and_their_sigma_says_how_well():
    error, normalised = [], []
    for view in rendered_views(ODD, 10, 5, ranges=Ranges(tag_px=(15.0, 45.0))):
        found = detect_checkerboard(view.image, ODD)
        assert set(found.point) <= set(view.point)
        assert len(found) >= 0.9 * len(view.point)
        assert found.blur_px == pytest.approx(view.blur_px, abs=0.4)
        assert found.black < 70
        assert found.white > 70
        error.append(found.pixels - view.pixels[np.searchsorted(view.point, found.point)])
        normalised.append(error[-1] / found.sigma_px[:, None])
    error, normalised = np.concatenate(error), np.concatenate(normalised)
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.abs(error).max() < 0.3
    assert np.abs(error.mean(axis=0)).max() < 0.003
    assert np.sqrt(np.mean(normalised**2)) == pytest.approx(1.0, abs=0.25)


def test_images_of_another_renderer(real_data):
    folder = real_data("rendered-camimu") / "d-checkerboard-ideal-imu" / "images"
    true = np.loadtxt(folder / "true_corners.csv", delimiter=",", comments="#", usecols=(1, 2, 3))
    stamps = np.loadtxt(folder / "true_corners.csv", delimiter=",", comments="#", usecols=0, dtype=np.int64)
    target = Target.checkerboard(cols=7, rows=6, row_spacing_m=0.08, col_spacing_m=0.08)
    error = []
    for stamp in np.unique(stamps):
        found = detect_checkerboard(cv2.imread(str(folder / f"{stamp}.png"), cv2.IMREAD_GRAYSCALE), target)
        corners = true[stamps == stamp]
        assert np.array_equal(found.point, corners[:, 0])
        error.append(found.pixels - corners[:, 1:])
    error = np.concatenate(error)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.abs(error.mean(axis=0)).max() < 0.005


@pytest.mark.parametrize(
    "target", [ODD, EVEN, checkerboard(5, 8), checkerboard(6, 6), checkerboard(5, 5), checkerboard(3, 4)]
)
@pytest.mark.parametrize("roll", [0.3, 1.9, -2.0])
def test_boards_are_never_mirrored(target, roll):
    image, true = picture(target, (0.2, -0.3, roll), wall=False)
    view = detect_checkerboard(image, target)
    assert len(view) == len(target)
    grid = view.pixels.reshape(target.rows, target.cols, 2)
    numbers = np.arange(len(target)).reshape(target.rows, target.cols)
    turns = [k for k in range(4) if np.rot90(numbers, k).shape == numbers.shape]
    away = [np.abs(grid - true[np.rot90(numbers, k)]).max() for k in turns]
    assert min(away) < 0.2
    if (target.rows + target.cols) % 2:  # the square between the first corners is black on the printed board
        assert away[0] == min(away)


@pytest.mark.parametrize("optics", [{"white": 60.0, "black": 20.0}, {"gradient": (0.6, -0.5), "vignetting": 0.5}])
def test_dim_and_uneven_light(optics):
    image, true = picture(ODD, (0.3, 0.2, 0.4), **optics)
    view = detect_checkerboard(image, ODD)
    assert len(view) == len(ODD)
    assert np.abs(view.pixels - true).max() < 0.35


def test_blur_and_motion():
    image, true = picture(ODD, (0.1, 0.2, 0.4))
    for kernel in (cv2.getGaussianKernel(13, 2.0) @ cv2.getGaussianKernel(13, 2.0).T, np.full((1, 7), 1 / 7)):
        view = detect_checkerboard(cv2.filter2D(image, -1, kernel), ODD)
        assert len(view) >= 0.9 * len(ODD)
        error, _ = errors(view, true, ODD)
        assert np.sqrt(np.mean(error**2)) < 0.06


def test_what_is_not_the_board_is_not_found():
    image, true = picture(EVEN, (0.2, 0.1, 0.3), (0.0, 0.0, 0.7))
    assert len(detect_checkerboard(image, EVEN)) == len(EVEN)
    for other in (checkerboard(8, 5), checkerboard(7, 6), checkerboard(9, 6), checkerboard(6, 6), checkerboard(4, 3)):
        assert not len(detect_checkerboard(image, other))
    part = image.copy()
    part[:, : int(np.median(true[:, 0]))] = 128
    assert not len(detect_checkerboard(part, EVEN))
    wall, _ = picture(EVEN, place=(0.0, 0.0, -1.0))
    assert not len(detect_checkerboard(wall, EVEN))
    for blank in (np.zeros((360, 480), np.uint8), np.zeros((5, 7), np.uint8), np.full((40, 2000), 255, np.uint8)):
        assert not len(detect_checkerboard(blank, EVEN))


def test_noise_alone_shows_no_board():
    noise = np.random.default_rng(0).integers(0, 256, (360, 480), dtype=np.uint8)
    assert not len(detect_checkerboard(noise, checkerboard(3, 3)))


def test_corners_near_the_border_are_dropped():
    image, true = picture(ODD, (0.0, 0.0, 0.5), (0.0, 0.0, 0.35), wall=False)
    top = int(true[:, 1].min()) - 3
    view = detect_checkerboard(np.ascontiguousarray(image[top:]), ODD)
    assert view.dropped["near the border"] == 1
    left_out = set(range(len(ODD))) - set(view.point.tolist())
    assert left_out == {int(np.argmin(true[:, 1]))}
    assert np.abs(view.pixels + np.array([0, top]) - true[view.point]).max() < 0.2


def test_covered_corners_are_dropped_and_the_others_stay():
    image, true = picture(ODD, (0.2, 0.1, 0.2))
    covered = ODD.cols + 3
    cv2.circle(image, tuple(int(v) for v in np.rint(true[covered])), 9, 120, -1)
    view = detect_checkerboard(image, ODD)
    assert covered not in view.point
    assert len(view) == len(ODD) - 1
    assert sum(view.dropped.values()) == 1
    assert np.abs(view.pixels - true[view.point]).max() < 0.2


def motion(count: int, target, speed=1.0):
    """Yield images of a board that is moved by hand, and its corners."""
    for k in range(count):
        t = 0.05 * k * speed
        rotvec = (0.3 * np.sin(3 * t), 0.3 * np.cos(2 * t), 0.4 * np.sin(2.5 * t))
        place = (0.06 * np.sin(4 * t), 0.04 * np.cos(3 * t), 0.62 + 0.05 * np.sin(t))
        yield picture(target, rotvec, place, seed=k)


@pytest.fixture
def searches(monkeypatch):
    """Count how often a board is searched."""
    count = SimpleNamespace(value=0)

    def counted(image, target):
        count.value += 1
        return find_board(image, target)

    monkeypatch.setattr(module, "find_board", counted)
    return count


def test_the_tracker_finds_what_the_search_finds(searches):
    tracker, differences, ends = CheckerboardTracker(EVEN), [], []
    for image, true in motion(12, EVEN):
        view = tracker.detect(image)
        board = find_board(image, EVEN)
        searched = module.measure_corners(image, board)
        assert len(view) == len(searched) == len(EVEN)
        error, other = errors(view, true, EVEN)
        assert np.abs(error).max() < 0.2
        ends.append(other)
        _, of_search = errors(searched, true, EVEN)
        differences.append(view.pixels - (searched.pixels if other == of_search else searched.pixels[::-1]))
    assert searches.value == 1
    assert len(set(ends)) == 1
    assert np.sqrt(np.mean(np.square(differences))) < 0.002


@pytest.mark.parametrize("squares", [(1, 0), (0, 1), (1, 1), (-1, 1), (2, 0), (-2, 0)])
def test_the_tracker_does_not_slip_by_squares(squares):
    first, _ = picture(EVEN, wall=False)
    step = 0.04 * np.array(squares)
    second, true = picture(EVEN, place=(step[0], step[1], 0.55), wall=False)
    tracker = CheckerboardTracker(EVEN)
    assert len(tracker.detect(first)) == len(EVEN)
    view = tracker.detect(second)
    assert len(view) == len(EVEN)
    error, _ = errors(view, true, EVEN)
    assert np.abs(error).max() < 0.2


def test_the_tracker_loses_the_board_and_finds_it_again(searches):
    tracker = CheckerboardTracker(ODD)
    images = list(motion(3, ODD))
    assert len(tracker.detect(images[0][0])) == len(ODD)
    wall, _ = picture(ODD, place=(0.0, 0.0, -1.0))
    assert not len(tracker.detect(wall))
    assert not len(tracker.detect(wall[:200]))
    image, true = images[2]
    view = tracker.detect(image)
    assert searches.value == 4
    assert np.abs(view.pixels - true[view.point]).max() < 0.2


def test_the_tracker_searches_now_and_then(searches, monkeypatch):
    monkeypatch.setattr(module, "_SEARCH_EVERY", 3)
    tracker = CheckerboardTracker(EVEN)
    image, _ = picture(EVEN)
    views = [tracker.detect(image) for _ in range(9)]
    assert searches.value == 3
    assert all(np.abs(view.pixels - views[0].pixels).max() < 0.005 for view in views)


def test_a_lattice_of_which_a_part_slipped_is_no_board():
    image, true = picture(EVEN, wall=False)
    grid = true.reshape(EVEN.rows, EVEN.cols, 2)
    assert isinstance(board_at(image, grid), CheckerboardGrid)
    slipped = grid.copy()
    slipped[:, :3] -= grid[:, 1:2] - grid[:, :1]
    assert board_at(image, slipped) is None
    for axis in (0, 1):
        assert board_at(image, grid + np.diff(grid, axis=axis).mean(axis=(0, 1))) is None
    assert board_at(image, grid[1:]) is None  # it goes on


def test_gaps_and_stray_corners_are_put_where_their_neighbours_say():
    _, true = picture(EVEN, (0.3, 0.2, 0.1))
    grid = true.reshape(EVEN.rows, EVEN.cols, 2)
    broken = grid.copy()
    broken[2, 3], broken[0, 0], broken[:, -1] = np.nan, np.nan, np.nan
    broken[4, 4] += 15
    mended = fill_grid(broken)
    assert mended is not None
    assert np.linalg.norm(mended - grid, axis=2).max() < 3
    assert fill_grid(np.full((3, 4, 2), np.nan)) is None
