"""What single frames show of the board: how many corners, how large, and whether they tell a pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..models.target import Target
from ..recording import CameraFrames, Floats, Integers

Booleans = NDArray[np.bool_]

FEWEST_CORNERS = 6  # fewer tell no wrong detection from a right one; as the estimation asks
_ON_A_LINE = 1e-6  # smaller over larger variance of the points


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Views:
    """The frames in which something of the board was detected.

    Attributes
    ----------
    frame : (k,) index into the stamps of the camera
    corners : (k,) number of corners
    extent_px : (k,) diagonal of the rectangle around the corners [px]
    usable : (k,) whether they tell a pose: at least four corners, not all on a line of the board
    """

    frame: Integers
    corners: Integers
    extent_px: Floats
    usable: Booleans


def views(frames: CameraFrames, target: Target) -> Views:
    """Return what each frame shows; linear time. All points must be on the target."""
    if not len(frames.frame):
        return Views(
            frame=np.empty(0, np.int64), corners=np.empty(0, np.int64), extent_px=np.empty(0), usable=np.empty(0, bool)
        )
    first = np.flatnonzero(np.concatenate([[True], np.diff(frames.frame) > 0]))
    corners = np.diff(np.append(first, len(frames.frame)))
    extent = np.maximum.reduceat(frames.pixels, first) - np.minimum.reduceat(frames.pixels, first)
    plane = (target.points[:, :2] - target.points[:, :2].mean(axis=0))[frames.point]
    x, y = plane[:, 0], plane[:, 1]
    sums = np.add.reduceat(np.stack([x, y, x * x, x * y, y * y], axis=1), first) / corners[:, None]
    xx, xy, yy = sums[:, 2] - sums[:, 0] ** 2, sums[:, 3] - sums[:, 0] * sums[:, 1], sums[:, 4] - sums[:, 1] ** 2
    half, root = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return Views(
        frame=frames.frame[first],
        corners=corners,
        extent_px=np.hypot(extent[:, 0], extent[:, 1]),
        usable=(corners >= FEWEST_CORNERS) & (half - root > _ON_A_LINE * (half + root)),
    )


def image_coverage(pixels: Floats, resolution: tuple[int, int], cells: tuple[int, int] = (10, 8)) -> float:
    """Return the share of the cells of a grid over the image in which there is at least one corner.

    Parameters
    ----------
    pixels : (m, 2) [px]
    resolution : (width, height) [px]
    cells : number of cells along the width and along the height
    """
    index = np.floor((pixels + 0.5) * (np.array(cells) / np.array(resolution))).astype(np.int64)
    column, row = index[:, 0], index[:, 1]
    inside = (column >= 0) & (column < cells[0]) & (row >= 0) & (row < cells[1])
    return len(np.unique(column[inside] * cells[1] + row[inside])) / (cells[0] * cells[1])
