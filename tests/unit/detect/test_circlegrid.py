"""Centres of circle grids, in rendered images of which the truth is known."""

import cv2
import numpy as np
import pytest

import gnomon.detect.boards.circlegrid as module
from detection import Score, Truth
from gnomon.detect.boards.board import BoardView
from gnomon.detect.boards.checkerboard_order import ambiguous_turns, consistent_order, renumber_view
from gnomon.detect.boards.circlegrid import CircleGridDetector
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board
from rendered import FACING, Ranges, euroc_camera, rendered_views

GRID = Target.circlegrid(cols=8, rows=6, spacing_m=0.06)
SHIFTED = Target.circlegrid(cols=4, rows=11, spacing_m=0.03, asymmetric=True)
FISHEYE = Camera(
    projection="pinhole",
    intrinsics=np.array([260.0, 260.0, 372.0, 243.0]),
    distortion="equidistant",
    distortion_coeffs=np.array([0.02, -0.01, 0.003, -0.001]),
    resolution=(752, 480),
)


def detect_circlegrid(image, target):
    return CircleGridDetector(target).detect(image)


def picture(target, rotvec=(0.0, 0.0, 0.0), place=(0.0, 0.0, 0.6), *, wall=True, seed=0, **optics):
    """Return an image of a board about the middle of the image, and where its centres are."""
    camera = euroc_camera()
    R = FACING @ rotation_from_rotvec(np.array(rotvec))
    p = np.array(place) - R @ (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    image = render_board(
        board_pattern(target),
        camera,
        R,
        p,
        options=Optics(**({"blur_px": 0.6, "noise": 2.0} | optics)),
        wall=cluttered_wall(1) if wall else None,
        rng=np.random.default_rng(seed),
    )
    return image, camera.project(target.points @ R.T + p).pixels


def nearest_end(view, true, target) -> BoardView:
    """Return the view as it is numbered from the end that is the true one."""
    ends = [renumber_view(view, target, turn) for turn in ambiguous_turns(target)]
    return min(ends, key=lambda end: np.abs(end.pixels - true[end.point]).mean())


def score(target, camera, tilt_deg, tag_px, count=14) -> Score:
    found = Score()
    ranges = Ranges(tag_px=tag_px, tilt_deg=(0.0, tilt_deg))
    for view in rendered_views(target, count, 5, camera=camera, ranges=ranges):
        seen = detect_circlegrid(view.image, target)
        truth = Truth(
            image=view.image,
            target=target,
            visible=view.point,
            projected=view.projected,
            tags=view.tags,
            tag_px=view.tag_px,
        )
        found.add(truth, nearest_end(seen, view.projected, target) if len(seen) else seen)
    return found


@pytest.mark.parametrize(
    ("target", "camera", "tilt_deg", "tag_px"),
    [
        (GRID, euroc_camera(), 55.0, (16.0, 50.0)),
        (SHIFTED, euroc_camera(), 55.0, (12.0, 40.0)),
        (GRID, FISHEYE, 68.0, (16.0, 40.0)),
    ],
    ids=["symmetric", "asymmetric", "fisheye"],
)
def test_centres_are_where_they_are_and_their_sigma_says_how_well(target, camera, tilt_deg, tag_px):
    """Clutter, blur to 1.5 px, motion of 3 px, noise to 5 grey levels, uneven light."""
    found = score(target, camera, tilt_deg, tag_px)
    assert found.wrong == 0
    assert found.corner_recall > 0.97
    assert np.sqrt(np.mean(found.error**2)) < 0.04
    assert np.abs(found.error.mean(axis=0)).max() < 0.004
    assert 0.7 < found.z_rms < 1.2
    assert found.z_beyond_3 < 0.01


@pytest.mark.parametrize("target", [GRID, SHIFTED], ids=["symmetric", "asymmetric"])
def test_the_middles_of_ellipses_are_not_the_centres_of_discs(target, monkeypatch):
    image, true = picture(target, (0.7, 0.5, 0.3), (0.0, 0.0, 0.5), noise=0.5)
    view = nearest_end(detect_circlegrid(image, target), true, target)
    assert len(view) == len(target)
    corrected = np.sqrt(np.mean((view.pixels - true[view.point]) ** 2))
    monkeypatch.setattr(module, "_centres", lambda _points, fits, _seen, _size: fits.pixels)
    raw = nearest_end(detect_circlegrid(image, target), true, target)
    biased = np.sqrt(np.mean((raw.pixels - true[raw.point]) ** 2))
    assert corrected < 0.02
    assert biased > 10 * corrected


@pytest.mark.first(6)
@pytest.mark.parametrize("roll", [0.3, 1.9, -2.0])
@pytest.mark.parametrize(
    "target",
    [
        GRID,
        SHIFTED,
        Target.circlegrid(cols=6, rows=6, spacing_m=0.05),
        Target.circlegrid(cols=5, rows=8, spacing_m=0.03, asymmetric=True),
        Target.circlegrid(cols=3, rows=4, spacing_m=0.06),
    ],
)
def test_grids_are_never_mirrored_and_numbered_from_an_end_that_may_be(target, roll):
    image, true = picture(target, (0.2, -0.3, roll), (0.0, 0.0, 0.7))
    view = detect_circlegrid(image, target)
    assert len(view) == len(target)
    ends = [np.abs(renumber_view(view, target, k).pixels - true).max() for k in ambiguous_turns(target)]
    assert min(ends) < 0.2


def test_light_discs_on_dark_ground():
    image, true = picture(SHIFTED, (0.3, 0.2, 0.4))
    detector = CircleGridDetector(SHIFTED)
    for _ in range(2):
        view = detector.detect(255 - image)
        assert len(view) == len(SHIFTED)
        assert np.abs(view.pixels - true[view.point]).max() < 0.15
        assert view.black < 100 < view.white


def test_what_is_not_the_board_is_not_found():
    image, _ = picture(GRID, (0.2, 0.1, 0.3), (0.0, 0.0, 0.8))
    for cols, rows in ((8, 5), (7, 6), (9, 6), (6, 6), (4, 3)):
        assert not len(detect_circlegrid(image, Target.circlegrid(cols=cols, rows=rows, spacing_m=0.06)))
    shifted, _ = picture(SHIFTED, (0.2, 0.1, 0.3), (0.0, 0.0, 0.8))
    for cols, rows in ((4, 9), (3, 11), (5, 11)):
        other = Target.circlegrid(cols=cols, rows=rows, spacing_m=0.03, asymmetric=True)
        assert not len(detect_circlegrid(shifted, other))
    assert not len(detect_circlegrid(image[:, :376], GRID))
    wall, _ = picture(GRID, place=(0.0, 0.0, -1.0))
    noise = np.random.default_rng(0).integers(0, 256, (360, 480), dtype=np.uint8)
    for blank in (wall, noise, np.zeros((360, 480), np.uint8), np.zeros((5, 7), np.uint8)):
        assert not len(detect_circlegrid(blank, GRID))


def test_discs_that_are_covered_are_left_out():
    image, true = picture(GRID, (0.1, 0.1, 0.2))
    middle = 2 * GRID.cols + 4
    cv2.circle(image, tuple(int(v) for v in np.rint(true[middle])), 14, 215, -1)
    view = nearest_end(detect_circlegrid(image, GRID), true, GRID)
    assert sorted(set(range(len(GRID))) - set(view.point.tolist())) == [middle]
    assert view.dropped["blurred or covered"] == 1


def test_which_turns_are_ambiguous():
    """A turn is ambiguous where it brings the grid onto itself: asked of the points."""
    shapes = [(cols, rows, shifted) for cols in (2, 3, 4, 6) for rows in (2, 3, 4, 6, 7) for shifted in (False, True)]
    for cols, rows, shifted in shapes:
        target = Target.circlegrid(cols=cols, rows=rows, spacing_m=1.0, asymmetric=shifted)
        points = target.points[:, :2]
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        z = (points - middle) @ [1, 1j]
        alike = [turn for turn in range(4) if np.abs((z * 1j**turn)[:, None] - z).min(axis=1).max() < 1e-6]
        assert ambiguous_turns(target) == tuple(alike), (cols, rows, shifted)


def test_grids_are_numbered_alike_over_time():
    views, truth = [], []
    for k in range(12):
        image, true = picture(GRID, (0.3 * np.sin(0.4 * k), 0.3, 0.3 * k), (0.0, 0.0, 0.7), seed=k, wall=False)
        views.append(detect_circlegrid(image, GRID))
        truth.append(true)
    t_ns = 100_000_000 * np.arange(12)
    ordered = consistent_order(views, t_ns, GRID, camera=euroc_camera())
    assert ordered.certain
    ends = {
        min((0, 2), key=lambda turn: np.abs(renumber_view(view, GRID, turn).pixels - true).mean())
        for view, true in zip(ordered.views, truth, strict=True)
    }
    assert len(ends) == 1
