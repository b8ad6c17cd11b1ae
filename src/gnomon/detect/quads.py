"""Black quadrilaterals in an image: where a tag might be."""

from typing import Any

import cv2
import numpy as np

from ..images import Grey
from ..recording import Floats

_BLOCK_PX = 15
_OFFSET = (4.0, 30.0)  # grey levels below the mean of the block: touching squares come apart, noise stays white
_OFFSET_OF_RANGE = 0.15
_SHORTEST_SIDE_PX = 7.0
_STRAIGHT = 0.06  # deviation of an outline from its polygon over the outline's length
_ROUNDED_PX = 0.45  # of a corner of an outline, along the diagonal
_FILLED = 0.8  # area of the outline over that of the quadrilateral
_CONTRAST_QUANTILES = (0.02, 0.98)


def black_quads(image: Grey, share: float = 1.0) -> Floats:
    """Return the black quadrilaterals of an image, (q, 4, 2) [px], corners clockwise as one sees them.

    The image is compared with its local mean. Black regions are those of which pixels share sides, so that squares that
    touch at a corner, as on Kalibr's boards, stay apart.

    Parameters
    ----------
    image : (h, w)
    share : of the usual distance from the local mean; less finds faint ones, and more that are none
    """
    levels = image[::7, ::7]
    low, high = np.quantile(levels, _CONTRAST_QUANTILES)
    offset = share * float(np.clip(_OFFSET_OF_RANGE * (high - low), *_OFFSET))
    white = cv2.adaptiveThreshold(image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, _BLOCK_PX, offset)
    white[:1], white[-1:], white[:, :1], white[:, -1:] = 255, 255, 255, 255
    outlines, tree = cv2.findContours(white, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if tree is None:
        return np.empty((0, 4, 2))
    longest = 2 * sum(image.shape)
    found = [
        quad
        for outline, parent in zip(outlines, tree[0, :, 3].tolist(), strict=True)
        if parent >= 0 and 4 * _SHORTEST_SIDE_PX <= len(outline) <= longest
        for quad in _quad(outline)
    ]
    if not found:
        return np.empty((0, 4, 2))
    quads = np.array(found, dtype=np.float64).reshape(-1, 4, 2)
    return _sharpened(_clockwise(quads))


def _quad(outline: Any) -> list[Any]:
    """Return the quadrilateral of an outline, or nothing."""
    polygon = cv2.approxPolyDP(outline, _STRAIGHT * len(outline), True)
    if len(polygon) != 4 or not cv2.isContourConvex(polygon):
        return []
    area = cv2.contourArea(polygon)
    if area < _SHORTEST_SIDE_PX**2 or cv2.contourArea(outline) < _FILLED * area:
        return []
    return [polygon]


def _clockwise(quads: Floats) -> Floats:
    following = np.roll(quads, -1, axis=1)
    area = (quads[:, :, 0] * following[:, :, 1] - following[:, :, 0] * quads[:, :, 1]).sum(axis=1)
    return np.where((area > 0)[:, None, None], quads, quads[:, ::-1])


def _sharpened(quads: Floats) -> Floats:
    """Return the quadrilaterals with their corners a little farther out: thresholds round them off."""
    outward = quads - quads.mean(axis=1, keepdims=True)
    distance = np.linalg.norm(outward, axis=2, keepdims=True)
    return quads + outward * (_ROUNDED_PX / np.maximum(distance, 1))
