"""Rendered views of boards from random poses, with where their points truly are."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import Floats, Integers
from gnomon.recording.recording import Grey
from gnomon.simulate.images.clutter import cluttered_wall
from gnomon.simulate.images.rendering import Optics, render_board

Range = tuple[float, float]

BORDER_PX = 5.0
"""Points nearer to the image's border do not count as visible."""

FACING = np.diag([1.0, -1.0, -1.0])
"""R_cam_target of a camera that looks straight at the board."""


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """From where to where the views are drawn."""

    tag_px: Range = (12.0, 80.0)
    """Side of a tag, of a square, or distance of circles, in the middle of the view; drawn evenly in its logarithm."""
    blur_px: Range = (0.3, 1.5)
    motion_px: Range = (0.0, 3.0)
    """Path of the board's middle during the exposure."""
    noise: Range = (0.5, 5.0)
    tilt_deg: Range = (0.0, 55.0)
    vignetting: Range = (0.0, 0.5)
    gradient: float = 0.2
    clutter: bool = True
    covers: int = 1
    """Patches in front of the board at most; only boards with tags bear them."""
    partial: bool | None = None
    """Whether parts of the board may be outside the image; None: those with tags."""
    fewest: int = 8
    """Points that are visible at least, where parts are outside."""


class RenderedView(NamedTuple):
    image: Grey
    point: Integers
    """(m,) numbers of the points that are visible"""
    pixels: Floats
    """(m, 2) where they are, mean over the exposure"""
    blur_px: float
    """standard deviation of the blur of lens and motion, root mean square over both axes"""
    tag_px: float
    """side of the tags (squares, distances) that are visible, as the root of their median area"""
    noise: float
    tags: Integers
    """numbers of the tags, counted from 0, that are visible as a whole"""
    projected: Floats
    """(n, 2) where all points of the board are, also those outside the image or covered; nan where the lens has none"""


@cache
def euroc_camera() -> Camera:
    return Camera(
        projection="pinhole",
        intrinsics=np.array([458.654, 457.296, 367.215, 248.375]),
        distortion="radtan",
        distortion_coeffs=np.array([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
        resolution=(752, 480),
    )


def rendered_views(
    target: Target, count: int, seed: int, *, camera: Camera | None = None, ranges: Ranges | None = None, first: int = 0
) -> Iterator[RenderedView]:
    """Yield views number `first` to `first + count`; each follows from seed and its number alone."""
    camera, ranges = camera or _CAMERA, ranges or Ranges()
    pattern = board_pattern(target)
    for number in range(first, first + count):
        rng = np.random.default_rng([seed, number])
        tag_px, blur_px, motion_px, noise, tilt, vignetting = (
            float(np.exp(rng.uniform(*np.log(ranges.tag_px)))),
            *(rng.uniform(*pair) for pair in (ranges.blur_px, ranges.motion_px, ranges.noise, ranges.tilt_deg)),
            rng.uniform(*ranges.vignetting),
        )
        R, p, pixels, seen = _posed(target, camera, ranges, (tag_px, np.radians(tilt), motion_px), rng)
        covers = _covers(target, pixels, seen, ranges.covers, rng)
        gradient = rng.uniform(-ranges.gradient, ranges.gradient, 2)
        optics = Optics(
            white=rng.uniform(130, 235),
            black=rng.uniform(10, 50),
            background=rng.uniform(40, 160),
            blur_px=blur_px,
            noise=noise,
            vignetting=vignetting,
            gradient=(float(gradient[0]), float(gradient[1])),
        )
        wall = cluttered_wall(int(rng.integers(6))) if ranges.clutter else None
        image = render_board(pattern, camera, R, p, options=optics, wall=wall, occluders=covers, rng=rng)
        far = _far_from(covers, pixels, BORDER_PX + 2 * blur_px)
        point = np.flatnonzero(seen & far)
        tags, side = _tags(target, pixels, seen & far, covers)
        smear = motion_px / np.sqrt(24)  # of a box along one axis, over both
        yield RenderedView(image, point, pixels[point], float(np.hypot(blur_px, smear)), side, noise, tags, pixels)


def _posed(
    target: Target, camera: Camera, ranges: Ranges, chosen: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return poses during the exposure, mean pixels of all points, and which are inside the image."""
    tag_px, tilt, motion_px = chosen
    unit = {
        "aprilgrid": target.tag_size_m,
        "checkerboard": min(target.row_spacing_m, target.col_spacing_m),
        "circlegrid": target.spacing_m,
        "charuco": target.square_size_m,
    }[target.kind]
    partial = target.kind in _PARTS if ranges.partial is None else ranges.partial
    focal, resolution = float(camera.intrinsics[-4]), np.array(camera.resolution)
    middle = (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    for attempt in range(2000):
        if attempt % 200 == 199 and not partial:  # so near, it does not fit into the image
            tag_px *= 0.9
        towards = rng.uniform(0, 2 * np.pi)
        R = FACING @ rotation_from_rotvec(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        R = rotation_from_rotvec(tilt * np.array([np.cos(towards), np.sin(towards), 0.0])) @ R
        rays, valid = camera.unproject(rng.uniform(0.1, 0.9, (1, 2)) * resolution)
        if not valid[0]:
            continue
        away = np.cross([0.0, 0.0, 1.0], rays[0])
        R = rotation_from_rotvec(away / np.linalg.norm(away) * np.arccos(rays[0, 2])) @ R  # as if looking along the ray
        distance = focal * unit / tag_px
        for _ in range(2):  # the tilt makes tags smaller
            pixels, seen = _seen(target, camera, R, (rays[0] * distance - R @ middle)[None])
            side = _tags(target, pixels, seen, [])[1]
            distance *= side / tag_px if side > 0 else 1.0
        velocity = rng.normal(size=3) * (1, 1, 0.3)
        velocity *= motion_px * distance / focal / np.linalg.norm(velocity[:2])
        count = int(np.ceil(motion_px / _STEP_PX)) or 1
        instants = (np.arange(count) + 0.5) / count - 0.5
        positions = rays[0] * distance - R @ middle + instants[:, None] * velocity
        pixels, seen = _seen(target, camera, R, positions)
        facing = (positions @ R[:, 2] < 0).all()
        if facing and (seen.sum() >= ranges.fewest if partial else seen.all()):
            return np.repeat(R[None], len(positions), axis=0), positions, pixels, seen
    raise AssertionError("no pose shows the board")


def _seen(target: Target, camera: Camera, R: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Return the mean pixels of all points, and which are inside the image."""
    seen_at = [camera.project(target.points @ R.T + p, point_jacobian=False).pixels for p in positions]
    pixels = np.mean(seen_at, axis=0)
    with np.errstate(invalid="ignore"):
        seen = ((pixels >= BORDER_PX) & (pixels <= np.array(camera.resolution) - 1 - BORDER_PX)).all(axis=1)
    return pixels, seen


def _covers(target: Target, pixels: Floats, seen: Floats, most: int, rng: np.random.Generator) -> list[Floats]:
    """Return patches (4, 2) over some of what is seen, as hands and cables are."""
    if target.kind not in _PARTS or not most:
        return []
    patches = []
    for _ in range(int(rng.integers(0, most + 1))):
        centre = pixels[rng.choice(np.flatnonzero(seen))] + rng.normal(0, 20, 2)
        angle = np.sort(rng.uniform(0, 2 * np.pi, 5))
        patches.append(centre + rng.uniform(8, 40) * np.column_stack([np.cos(angle), np.sin(angle)]))
    return patches


def _far_from(covers: list[Floats], pixels: Floats, distance: float) -> Floats:
    import cv2

    far = np.ones(len(pixels), bool)
    for patch in covers:
        contour = patch.astype(np.float32)[:, None]
        for k, pixel in enumerate(pixels):
            if far[k] and np.isfinite(pixel).all():
                far[k] = cv2.pointPolygonTest(contour, (float(pixel[0]), float(pixel[1])), True) < -distance
    return far


def _tags(target: Target, pixels: Floats, usable: Floats, covers: list[Floats]) -> tuple[Integers, float]:
    """Return the tags that are visible as a whole, and the root of the median area of tags, squares or meshes."""
    if target.kind == "aprilgrid":
        corners = target.point_of_tag_corner(np.arange(target.tags)[:, None], np.arange(4))
    else:
        less = 1 if target.kind == "charuco" else 0  # whose squares are counted, not its corners
        rows, cols = target.rows - less, target.cols - less
        row, col = np.divmod(np.arange((rows - 1) * (cols - 1)), cols - 1)
        at = row * cols + col
        corners = np.column_stack([at, at + 1, at + 1 + cols, at + cols])
    outline = pixels[corners]
    whole = usable[corners].all(axis=1)
    x, y = outline[..., 0], outline[..., 1]
    area = np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)) / 2
    side = float(np.sqrt(np.median(area[whole]))) if whole.any() else float("nan")
    if target.kind != "aprilgrid":
        return np.empty(0, np.int64), side
    for patch in covers:  # a small patch may be inside a tag
        whole &= _far_from([patch], outline.mean(axis=1), 0.75 * side)
    return np.flatnonzero(whole), side


_PARTS = ("aprilgrid", "charuco")  # boards of which a part is enough
_STEP_PX = 0.6  # between the instants at which a moving board is drawn
_CAMERA = euroc_camera()
