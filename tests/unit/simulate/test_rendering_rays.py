"""Rendered images against brute force: 16 x 16 rays a pixel, each to the board at its own instant."""

import cv2
import numpy as np
import pytest

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern, marker_cells
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.simulate.images.board_outlines import TrueBoard
from gnomon.simulate.images.rendering import Optics, render_moving
from rendered import FACING

RAYS, INSTANTS = 16, 24
WIDTH, HEIGHT = 64, 48
SQUARE, MARKER = 0.04, 0.03
CHARUCO = Target.charuco(cols=6, rows=5, square_size_m=SQUARE, marker_size_m=MARKER)
MIDDLE = (CHARUCO.points.min(axis=0) + CHARUCO.points.max(axis=0)) / 2
WHITE, BLACK, BEHIND = 210.0, 30.0, 95.0
LENSES = {
    "pinhole-radtan": ([46.0, 45.5, 32.0, 23.5], [-0.28, 0.07, 2e-4, 1e-5]),
    "pinhole-equidistant": ([29.0, 28.5, 31.0, 24.5], [-0.012, 0.019, -0.015, 0.004]),
    "ds-none": ([-0.18, 0.59, 27.0, 26.5, 31.5, 23.5], []),
}


def lens(name, line_delay_s=0.0):
    projection, distortion = name.split("-")
    intrinsics, coeffs = LENSES[name]
    return Camera(
        projection=projection,
        intrinsics=intrinsics,
        distortion=distortion,
        distortion_coeffs=coeffs,
        resolution=(WIDTH, HEIGHT),
        line_delay_s=line_delay_s,
    )


def moving(t_s):
    """A board that turns and moves, also with an acceleration."""
    turn = np.outer(t_s, [0.6, -1.1, 0.8]) + np.outer(t_s**2, [5.0, 4.0, -9.0])
    R = rotation_from_rotvec(turn) @ rotation_from_rotvec(np.array([0.35, -0.25, 0.2])) @ FACING
    p = np.array([0.01, 0.0, 0.22]) - R @ MIDDLE + np.outer(t_s, [0.5, -0.3, 0.4]) + np.outer(t_s**2, [3.0, 6.0, 2.0])
    return R, p


def resting(t_s):
    return moving(np.zeros_like(t_s))


def bowed(points, bow_m=0.004):
    x, y = ((points[:, :2] - MIDDLE[:2]) / (np.ptp(CHARUCO.points[:, :2], axis=0) / 2)).T
    return points * [1.0, 1.01, 1.0] + np.outer(bow_m * (1 - x * x - 0.5 * y * y), [0, 0, 1.0])


def printed(x, y):
    """Grey level of points of the board, by OpenCV's drawing of the markers."""
    col, row = np.floor(x / SQUARE).astype(int) + 1, 3 - np.floor(y / SQUARE).astype(int)
    u, v = x / SQUARE - np.floor(x / SQUARE), 1 - (y / SQUARE - np.floor(y / SQUARE))  # from the upper left of a square
    low, high = board_pattern(CHARUCO).sheet.reshape(2, 2)
    grey = np.where((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]), WHITE, BEHIND)
    number = 0
    for r, c in np.ndindex(CHARUCO.rows, CHARUCO.cols):
        inside = (row == r) & (col == c)
        if (r + c) % 2 == 0:
            grey[inside] = BLACK
            continue
        cells = marker_cells("4X4_50", number)
        number += 1
        rim = (1 - MARKER / SQUARE) / 2
        i, j = (np.floor((w[inside] - rim) / (MARKER / SQUARE) * len(cells)).astype(int) for w in (v, u))
        on = (i >= 0) & (i < len(cells)) & (j >= 0) & (j < len(cells))
        grey[inside] = np.where(on & ~cells[i.clip(0, len(cells) - 1), j.clip(0, len(cells) - 1)], BLACK, WHITE)
    return grey


def traced(camera, pose, exposure_s, place=None):
    """The light that falls on 16 x 16 places of each pixel, mean over the exposure, rows in turn."""
    v, u = np.indices((HEIGHT * RAYS, WIDTH * RAYS)).reshape(2, -1)
    pixels = (np.column_stack([u, v]) + 0.5) / RAYS - 0.5
    rays, valid = camera.unproject(pixels)
    light = np.zeros(len(rays))
    count = INSTANTS if exposure_s else 1
    for k in range(count):
        row_s = camera.line_delay_s * pixels[:, 1]
        # the shutter is exact here: each place of the image has its own instant
        at_s = exposure_s * ((k + 0.5) / count - 0.5) + row_s
        tables = np.linspace(at_s.min(), at_s.max() + 1e-9, 16 * HEIGHT)
        R, p = pose(tables)
        nearest = np.rint((at_s - tables[0]) / (tables[1] - tables[0])).astype(int)
        R, p = R[nearest], p[nearest]
        origin, way = -np.einsum("nji,nj->ni", R, p), np.einsum("nji,nj->ni", R, rays)
        x, y = (w.clip(-1.0, 1.0) for w in met(origin, way, 0.0))
        if place is not None:  # the bent board: the stated place whose true place is on the ray
            for _ in range(6):
                true = place(np.column_stack([x, y, np.zeros_like(x)]))
                hit_x, hit_y = met(origin, way, true[:, 2])
                x, y = (x + hit_x - true[:, 0]).clip(-1.0, 1.0), (y + hit_y - true[:, 1]).clip(-1.0, 1.0)
        seen = valid & (origin[:, 2] > 0) & (-origin[:, 2] / way[:, 2] > 0)
        light += np.where(seen, printed(np.nan_to_num(x), np.nan_to_num(y)), BEHIND) / count
    return light.reshape(HEIGHT * RAYS, WIDTH * RAYS).astype(np.float32)


def met(origin, way, z):
    along = (z - origin[:, 2]) / way[:, 2]
    return origin[:, 0] + along * way[:, 0], origin[:, 1] + along * way[:, 1]


def pixels_of(light):
    return light.reshape(HEIGHT, RAYS, WIDTH, RAYS).mean(axis=(1, 3))


def disc(radius):
    half = int(np.ceil(radius))
    at = np.arange(-half, half + 1)
    inside = (np.hypot(at[:, None], at) <= radius).astype(np.float32)
    return inside / inside.sum()


CASES = {
    "at rest": ("pinhole-radtan", resting, 0.0, 0.0, None),
    "fisheye, rolling shutter, exposure": ("pinhole-equidistant", moving, 0.015, 6e-4, None),
    "double sphere, rolling shutter from below, bent board": ("ds-none", moving, 0.0, -6e-4, bowed),
}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_images_are_those_of_many_rays(case):
    name, pose, exposure_s, line_delay_s, place = CASES[case]
    camera = lens(name, line_delay_s)
    board = None if place is None else TrueBoard(stated=CHARUCO.points, true=place(CHARUCO.points))
    optics = Optics(white=WHITE, black=BLACK, background=BEHIND, blur_px=0.0)
    image = render_moving(
        board_pattern(CHARUCO), camera, pose, exposure_s=exposure_s, board=board, options=optics
    ).astype(float)
    expected = pixels_of(traced(camera, pose, exposure_s, place))
    assert np.mean(np.abs(expected - BEHIND) > 20) > 0.2  # the board fills much of the image
    assert np.sqrt(np.mean((image - expected) ** 2)) < 0.5  # of which 0.3 are the rounding to whole levels
    if line_delay_s or exposure_s:
        still = render_moving(board_pattern(CHARUCO), lens(name), resting, board=board, options=optics)
        assert np.sqrt(np.mean((image - still) ** 2)) > 5


@pytest.mark.parametrize(("blur_px", "defocus_px"), [(0.6, 0.0), (0.4, 1.5), (0.0, 2.0)])
def test_blur_and_defocus_are_those_of_many_rays(blur_px, defocus_px):
    camera = lens("pinhole-radtan")
    optics = Optics(white=WHITE, black=BLACK, background=BEHIND, blur_px=blur_px, defocus_px=defocus_px)
    image = render_moving(board_pattern(CHARUCO), camera, resting, options=optics).astype(float)
    light = traced(camera, resting, 0.0)
    if defocus_px:
        light = cv2.filter2D(light, -1, disc(defocus_px * RAYS), borderType=cv2.BORDER_REPLICATE)
    if blur_px:
        light = cv2.GaussianBlur(light, (0, 0), blur_px * RAYS, borderType=cv2.BORDER_REPLICATE)
    inner = slice(6, -6), slice(6, -6)  # what is beyond the border is not known
    assert np.sqrt(np.mean((image - pixels_of(light))[inner] ** 2)) < 0.5


def test_the_disc_grows_with_the_distance_from_what_is_in_focus():
    camera = lens("pinhole-radtan")
    z = float(resting(np.zeros(1))[1][0, 2] + (resting(np.zeros(1))[0][0] @ MIDDLE)[2])

    def image(**changed):
        return render_moving(board_pattern(CHARUCO), camera, resting, options=Optics(blur_px=0.5, **changed)).astype(
            float
        )

    assert np.abs(image(defocus_px=4.0, focus_m=z) - image()).max() < 2
    np.testing.assert_allclose(image(defocus_px=4.0, focus_m=z / 2), image(defocus_px=2.0), atol=3)
    assert np.abs(image(defocus_px=4.0, focus_m=z / 2) - image()).max() > 20
