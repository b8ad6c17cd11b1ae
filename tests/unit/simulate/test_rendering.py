"""Rendered images: corners exactly where they are projected, light and noise as asked for."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RectBivariateSpline

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern, tag_codes
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.board_outlines import MotionSegment, pixel_coverage
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board, render_moving
from rendered import FACING, Ranges, euroc_camera, rendered_views

SIZE, GAP = 0.088, 0.0264
APRILGRID = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=SIZE, tag_spacing=GAP / SIZE)
PATTERN = board_pattern(APRILGRID)
CAMERA = euroc_camera()
STRAIGHT = np.array([-0.3, 0.3, 0.8])


def askew(*rotvec):
    return rotation_from_rotvec(np.array(rotvec)) @ FACING


def whiteness(x, y):
    """What is printed at points of the board, from OpenCV's drawing of the tags."""
    cells = np.array([np.pad(np.rot90(code, 2), 2)[::-1] for code in tag_codes()[:36]])
    white = np.ones(x.shape)
    col, row = (np.floor(v / (SIZE + GAP)).astype(int) for v in (x, y))
    inside_x, inside_y = x - col * (SIZE + GAP), y - row * (SIZE + GAP)
    on_tag = (col >= 0) & (col < 6) & (row >= 0) & (row < 6) & (inside_x < SIZE) & (inside_y < SIZE)
    i, j = ((v / (SIZE / 10)).astype(int).clip(0, 9) for v in (inside_y, inside_x))
    white[on_tag] = cells[(row.clip(0, 5) * 6 + col.clip(0, 5)), i, j][on_tag]
    col, row = (np.floor((v + GAP) / (SIZE + GAP)).astype(int) for v in (x, y))
    inside_x, inside_y = x + GAP - col * (SIZE + GAP), y + GAP - row * (SIZE + GAP)
    square = (col >= 0) & (col <= 6) & (row >= 0) & (row <= 6) & (inside_x < GAP) & (inside_y < GAP)
    white[square] = 0
    return white


def reference(R, p, pixel, blur_px, rng, half=7, rays=16):
    """What the pixels around a point see, from many rays each; and the middle pixel."""
    middle = np.rint(pixel).astype(int)
    wide = half + 1 + int(np.ceil(4 * blur_px))
    coarse = np.arange(-wide - 2.0, wide + 3.0)  # rays change smoothly from pixel to pixel
    u, v = np.meshgrid(middle[0] + coarse, middle[1] + coarse)
    found = CAMERA.unproject(np.column_stack([u.ravel(), v.ravel()]))[0]
    met = found @ np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], p])).T
    plane = [(met[:, k] / met[:, 2]).reshape(u.shape) for k in (0, 1)]
    grid = (np.arange((2 * wide + 1) * rays) + 0.5) / rays - 0.5 - wide
    at_v, at_u = (w + rng.uniform(-0.5, 0.5, w.shape) / rays for w in np.meshgrid(grid, grid, indexing="ij"))
    x, y = (RectBivariateSpline(coarse, coarse, side).ev(at_v, at_u) for side in plane)
    seen = whiteness(x, y)
    if blur_px:
        seen = cv2.GaussianBlur(seen, (0, 0), blur_px * rays)
    means = seen.reshape(2 * wide + 1, rays, 2 * wide + 1, rays).mean(axis=(1, 3))
    return means[wide - half : wide + half + 1, wide - half : wide + half + 1], middle


def displacement(image, expected, middle):
    """By how much a patch of the image is displaced, by least squares, [px]; light and blur are free."""
    half = len(expected) // 2
    x, y = middle
    seen = image[y - half : y + half + 1, x - half : x + half + 1].astype(float)
    by_y, by_x = np.gradient(expected)
    more_blur = np.gradient(by_x, axis=1) + np.gradient(by_y, axis=0)
    inner = slice(2, -2), slice(2, -2)
    columns = [by_x, by_y, expected, np.ones_like(expected), more_blur]
    design = np.column_stack([column[inner].ravel() for column in columns])
    found = np.linalg.lstsq(design, seen[inner].ravel(), rcond=None)[0]
    return -found[:2] / found[2]


@pytest.mark.parametrize("blur_px", [0.0, 0.4, 1.0])
def test_corners_are_where_they_are_projected(blur_px):
    rng = np.random.default_rng(4)
    shifts = []
    for R, p in ((FACING, STRAIGHT), (askew(0.5, -0.3, 0.7), np.array([-0.05, 0.35, 0.9]))):
        pixels = CAMERA.project(APRILGRID.points @ R.T + p).pixels
        inside = ((pixels > 15) & (pixels < np.array(CAMERA.resolution) - 15)).all(axis=1)
        image = render_board(PATTERN, CAMERA, R, p, options=Optics(white=250.0, black=5.0, blur_px=blur_px))
        chosen = rng.permutation(np.flatnonzero(inside))[:10]
        shifts += [displacement(image, *reference(R, p, pixels[point], blur_px, rng)) for point in chosen]
    assert np.sqrt(np.mean(np.square(shifts))) < 0.003  # of which the grey levels' rounding is 0.002
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.0015


@given(
    st.lists(st.tuples(st.floats(-3, 9), st.floats(-3, 8)), min_size=3, max_size=6),
    st.booleans(),
)
def test_coverage_is_the_area_inside(corners, clockwise):
    outline = np.array(corners[:: -1 if clockwise else 1])
    parts = np.linspace(0, 1, 41)[:, None]
    ends = np.roll(outline, -1, axis=0)
    pieces = [a + parts * (b - a) for a, b in zip(outline, ends, strict=True)]
    start, end = (np.concatenate([piece[k] for piece in pieces]) for k in (slice(None, -1), slice(1, None)))
    found = pixel_coverage(start, end, (5, 6))
    # signed area of the outline clipped to each half plane and strip, by the shoelace formula on a finer grid
    n = 60
    x, y = ((np.arange(side * n) + 0.5) / n for side in (6, 5))
    winding = np.zeros((5 * n, 6 * n))
    for a, b in zip(outline, ends, strict=True):
        rows = (y >= min(a[1], b[1])) & (y < max(a[1], b[1]))
        if rows.any():
            crossing = a[0] + (y[rows] - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
            winding[rows] += np.sign(b[1] - a[1]) * (x > crossing[:, None])
    expected = winding.reshape(5, n, 6, n).mean(axis=(1, 3))
    np.testing.assert_allclose(found, expected, atol=0.06)  # of the finer grid
    assert np.abs(found - expected).mean() < 0.01


def test_a_moving_board_is_the_mean_over_the_exposure():
    p = STRAIGHT + np.outer(np.linspace(-1, 1, 5), [0.004, 0.001, 0.002])
    R = np.array([askew(0.0, angle, 0.1) for angle in np.linspace(0, 0.004, 5)])
    optics = Optics(blur_px=0.6)
    mean = np.mean([render_board(PATTERN, CAMERA, R[k], p[k], options=optics) for k in range(5)], axis=0)
    moving = render_board(PATTERN, CAMERA, R, p, options=optics)
    assert np.abs(moving - mean).max() < 1.1
    assert np.abs(moving.astype(float) - render_board(PATTERN, CAMERA, R[2], p[2], options=optics)).max() > 20


def passing(R, p, velocity):
    """The pose of a board that moves evenly, its attitude kept."""
    return lambda t_s: (np.repeat(R[None], len(t_s), axis=0), p + t_s[:, None] * np.array(velocity))


def test_what_passes_far_outside_of_the_image_asks_for_no_more_instants():
    """There a lens throws points anywhere; a view of a near board took 48 instants, and a hundred times as long."""
    pose = passing(askew(0.3, 0.4, 0.1), np.array([-0.2, 0.2, 0.35]), [0.05, 0.0, 0.0])
    x, y = (value.ravel() for value in np.meshgrid(np.linspace(-0.05, 0.7, 5), np.linspace(-0.05, 0.7, 5)))
    points = np.stack([x, y, 0 * x], axis=1)
    near = np.hypot(x - 0.2, y - 0.2) < 0.15
    few, all_of_it = (MotionSegment.during(0.004, CAMERA, pose, part, 1.0) for part in (points[near], points))
    assert 1 <= few.instants <= all_of_it.instants < few.instants + 3


def test_rows_are_exposed_one_after_the_other():
    R, velocity, optics = askew(0.1, 0.2, 0.3), np.array([3.0, 1.0, 0.0]), Optics(blur_px=0.5)
    rolling = replace(CAMERA, line_delay_s=3e-5)
    still = render_board(PATTERN, CAMERA, R, STRAIGHT, options=optics)
    np.testing.assert_allclose(
        render_moving(PATTERN, rolling, passing(R, STRAIGHT, [0, 0, 0]), options=optics).astype(float), still, atol=1
    )
    rolled = render_moving(PATTERN, rolling, passing(R, STRAIGHT, velocity), options=optics).astype(float)
    for row in (150, 250, 350):
        frozen = render_board(PATTERN, CAMERA, R, STRAIGHT + 3e-5 * row * velocity, options=optics)
        assert np.abs(rolled[row] - frozen[row]).max() < 12  # the rows above and below blur into it
        assert np.abs(rolled[row] - frozen[row]).mean() < 0.5
        assert np.abs(rolled[row - 100] - frozen[row - 100]).max() > 60


def test_light_and_noise():
    away = np.array([0.0, 0.0, -1.0])  # behind the camera: nothing but the background
    flat = Optics(background=100.0, noise=3.0)
    image = render_board(PATTERN, CAMERA, FACING, away, options=flat, rng=np.random.default_rng(1))
    assert abs(image.mean() - 100) < 0.05
    assert abs(image.std() - np.hypot(3, 1 / np.sqrt(12))) < 0.05
    assert (render_board(PATTERN, CAMERA, FACING, away, options=flat) == 100).all()
    shot = Optics(background=100.0, noise=0.0, shot_noise=0.16)
    image = render_board(PATTERN, CAMERA, FACING, away, options=shot, rng=np.random.default_rng(1))
    assert abs(image.std() - 4) < 0.1
    dim = render_board(
        PATTERN, CAMERA, FACING, away, options=Optics(background=100.0, vignetting=0.4, gradient=(0.2, 0.1))
    )
    assert abs(int(dim[240, 376]) - 100) <= 1
    np.testing.assert_allclose(
        [dim[0, 0], dim[0, -1], dim[-1, -1]], [60 * 0.7, 60 * 1.1, 60 * 1.3], atol=1
    )  # fmt: skip


def test_what_is_not_seen_is_not_drawn():
    optics = Optics(background=100.0)
    from_behind = np.diag([1.0, 1.0, 1.0])
    for R, p in ((from_behind, STRAIGHT), (FACING, np.array([30.0, 0.0, 1.0])), (FACING, np.array([0.0, 0.0, -1.0]))):
        assert (render_board(PATTERN, CAMERA, R, p, options=optics) == 100).all()


def test_a_board_that_reaches_behind_the_camera_is_drawn_where_it_is_seen():
    wide = Camera(
        projection="pinhole",
        intrinsics=np.array([250.0, 250.0, 320.0, 240.0]),
        distortion="none",
        distortion_coeffs=np.zeros(0),
        resolution=(640, 480),
    )
    R, p = askew(0.0, -1.2, 0.0), np.array([-0.15, 0.3, -0.1])
    image = render_board(PATTERN, wide, R, p, options=Optics(background=100.0))
    seen = wide.project(APRILGRID.points @ R.T + p)
    assert not seen.valid.all()
    with np.errstate(invalid="ignore"):
        inside = seen.valid & ((seen.pixels > 5) & (seen.pixels < [250, 475])).all(axis=1)
    assert inside.sum() >= 6
    for x, y in np.rint(seen.pixels[inside]).astype(int):
        assert np.ptp(image[y - 4 : y + 5, x - 4 : x + 5].astype(int)) > 150
    assert (image[:, 420:] == 100).all()


def test_covers_and_walls():
    wall = cluttered_wall(3)
    square = np.array([[100.0, 100], [180, 100], [180, 180], [100, 180]])
    image = render_board(PATTERN, CAMERA, FACING, STRAIGHT, options=Optics(black=30.0), wall=wall, occluders=[square])
    assert (image[105:176, 105:176] == 30).all()
    parameters = cv2.aruco.DetectorParameters()
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found = set()
    for bits in (1, 2):
        parameters.markerBorderBits = bits
        ids = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(wall.texels[::-1])[1]
        found |= {(bits, int(tag) < 36) for tag in ids.ravel()}
    assert found >= {(1, True), (2, True), (2, False)}  # OpenCV may take a border of 2 bits for one, and misread


def test_views_are_true_and_the_same_again():
    ranges = Ranges(tag_px=(20.0, 50.0), motion_px=(0.0, 1.0))
    views = list(rendered_views(APRILGRID, 3, 5, ranges=ranges))
    again = next(rendered_views(APRILGRID, 1, 5, ranges=ranges, first=2))
    np.testing.assert_array_equal(views[2].image, again.image)
    for view in views:
        assert ((view.pixels >= 5) & (view.pixels <= np.array([746, 474]))).all()
        np.testing.assert_array_equal(view.pixels, view.projected[view.point])
        corners = APRILGRID.point_of_tag_corner(view.tags[:, None], np.arange(4))
        assert np.isin(corners, view.point).all()
        assert 15 < view.tag_px < 60
