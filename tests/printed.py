"""Printed boards taken apart again: the paths of an SVG or a PDF, an image of them, and a photograph of that."""

import re
from functools import cache
from xml.etree import ElementTree

import numpy as np

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.simulate.images.board_outlines import pixel_coverage
from rendered import FACING

SVG = "{http://www.w3.org/2000/svg}"
PX_PER_MM = 8.0
_WHITE, _BLACK = 215.0, 25.0


def svg_size(text):
    """Width and height [mm]; the drawing's units are those."""
    root = ElementTree.fromstring(text)
    width, height = (float(root.get(side).removesuffix("mm")) for side in ("width", "height"))
    assert root.get("viewBox") == f"0 0 {root.get('width')[:-2]} {root.get('height')[:-2]}"
    return width, height


def svg_paths(text):
    """Closed paths of what is black [mm], y up from the lower edge."""
    height = svg_size(text)[1]
    data = ElementTree.fromstring(text).find(f"{SVG}path[@id='board']").get("d")
    paths = [np.array(re.findall(r"[-\d.]+", piece), float).reshape(-1, 2) for piece in data.split("z")[:-1]]
    return [path * [1, -1] + [0, height] for path in paths]


def svg_caption(text):
    """What is written in the typewriter's font."""
    words = ElementTree.fromstring(text).iter(f"{SVG}text")
    return "\n".join(word.text for word in words if "Courier" in word.get("font-family")) + "\n"


def pdf_streams(data):
    """The contents of a PDF's streams."""
    return [found.decode("cp1252") for found in re.findall(rb"stream\n(.*?)\nendstream", data, re.DOTALL)]


def pdf_paths(data):
    """Closed paths of what is black [mm]: those of the sheet, which pages show under their matrix."""
    paths = re.findall(r"^([-\d. ]+) m ([-\d. l]*)h$", pdf_streams(data)[0], re.MULTILINE)
    return [np.array(f"{first} {others}".replace("l", "").split(), float).reshape(-1, 2) for first, others in paths]


def pdf_caption(data):
    lines = re.findall(r"^BT /F2 .* \((.*)\) Tj ET$", pdf_streams(data)[0], re.MULTILINE)
    return "\n".join(re.sub(r"\\(.)", r"\1", line) for line in lines) + "\n"


def pdf_boxes(data):
    """Width and height of the pages [mm]."""
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data)
    return [(float(width) * 25.4 / 72, float(height) * 25.4 / 72) for width, height in boxes]


def ends(paths):
    """Starts and ends of all pieces of closed paths."""
    return np.concatenate(paths), np.concatenate([np.roll(path, -1, axis=0) for path in paths])


def drawn(paths, size, px_per_mm=PX_PER_MM):
    """Share of black of each pixel of the sheet, exact; row 0 is its upper edge."""
    start, end = (px_per_mm * (side * [1, -1] + [0, size[1]]) for side in ends(paths))
    shape = tuple(round(px_per_mm * side) for side in size[::-1])
    return np.abs(pixel_coverage(start, end, shape))


def photographed(sheet, px_per_mm, camera, R_cam_sheet, p_cam_sheet, finer=4):
    """What a camera sees of an image of a sheet, whose frame is at its lower left, x right and y up [m]."""
    import cv2

    width, height = camera.resolution
    at = 1000 * px_per_mm * _met(_rays(camera), R_cam_sheet, p_cam_sheet)
    column, row = (at * [1, -1] + [0, sheet.shape[0]] - 0.5).T.reshape(2, height, width)
    changes = [np.gradient(where) for where in (column, row)]
    steps = (np.arange(finer) + 0.5) / finer - 0.5
    seen = np.zeros((height, width))
    for du in steps:
        for dv in steps:
            places = (
                (where + dv * by_v + du * by_u).astype(np.float32)
                for where, (by_v, by_u) in zip((column, row), changes, strict=True)
            )
            seen += cv2.remap(sheet, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.4)
    seen /= finer**2
    grey = _WHITE - (_WHITE - _BLACK) * cv2.GaussianBlur(seen, (0, 0), 0.5)
    return np.rint(grey).astype(np.uint8)


def pose_before(size_mm, camera, share, rotvec):
    """Pose of a sheet of paper whose longer side takes a share of the image's width, tilted."""
    R = rotation_from_rotvec(np.array(rotvec)) @ FACING
    distance = max(size_mm) / 1000 * camera.intrinsics[-4] / (share * camera.resolution[0])
    middle = np.array([size_mm[0], size_mm[1], 0]) / 2000
    return R, np.array([0.0, 0.0, distance]) - R @ middle


def on_sheet(pixels, camera, R, p):
    """Where on the sheet pixels are [m]."""
    return _met(camera.unproject(pixels)[0], R, p)


@cache
def _rays(camera):
    """Rays of all pixels, row after row."""
    width, height = camera.resolution
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    return camera.unproject(np.column_stack([u.ravel(), v.ravel()]))[0]


def _met(rays, R, p):
    x, y, w = np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], p])) @ rays.T
    return np.column_stack([x / w, y / w])


def rigidly(points, onto):
    """Points (n, 2) moved by the rotation and translation that bring them nearest to others; no scale, no mirror."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    R = u @ np.diag([1, np.sign(np.linalg.det(u @ v))]) @ v
    return a @ R + onto.mean(axis=0), R
