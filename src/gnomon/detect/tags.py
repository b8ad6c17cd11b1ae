"""AprilTags of the family 36h11: which tag is in a quadrilateral, and which way up.

The numbers of the tags are Kalibr's; their codes, 36 bits that differ in at least 11 places however they are turned,
are those of OpenCV's dictionary, whose pictures are upside down.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from ..images import Grey
from ..recording import Floats, Integers

BITS = 6
"""Bits of a code along a side."""

FAMILY = 587
"""Number of tags."""

_LEAST_LIKENESS = 0.72  # correlation with the code; other codes stay below 0.4
_LEAST_CONTRAST = 8.0  # grey levels between the code's black and white
_LIGHT_BORDER = 0.35  # how far from black to white the border may be


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tags:
    """Tags that were read.

    Attributes
    ----------
    number : (k,) of the tag
    corners : (k, 4, 2) counter-clockwise from the lower left, as the tag stands [px]
    likeness : (k,) correlation with the code, 0 to 1
    """

    number: Integers
    corners: Floats
    likeness: Floats

    def __len__(self) -> int:
        return len(self.number)


@cache
def codes() -> Floats:
    """Return the codes as pictures, (587, 6, 6), 1 white and 0 black; row 0 is the upper one of the upright tag."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    packed = dictionary.bytesList
    upside_down = [dictionary.getBitsFromByteList(packed[i : i + 1], BITS) for i in range(len(packed))]
    pictures = np.array(upside_down, dtype=np.float64)[:, ::-1, ::-1].copy()
    pictures.flags.writeable = False
    return pictures


@cache
def _turned_codes(first: int, last: int) -> Floats:
    """Return the codes first ... last - 1 in all four attitudes, zero mean and unit length, (36, 4 (last - first))."""
    pictures = codes()[first:last]
    turned = np.stack([np.rot90(pictures, k, axes=(1, 2)) for k in range(4)], axis=1)
    flat = turned.reshape(-1, BITS * BITS)
    flat = flat - flat.mean(axis=1, keepdims=True)
    return np.ascontiguousarray((flat / np.linalg.norm(flat, axis=1, keepdims=True)).T)


def read_tags(image: Grey, quads: Floats, *, border_bits: int = 2, first: int = 0, count: int = FAMILY) -> Tags:
    """Return the tags in some quadrilaterals.

    Parameters
    ----------
    image : (h, w)
    quads : (q, 4, 2) outlines of the tags' black borders, clockwise as one sees them [px]
    border_bits : width of the border in bits
    first, count : the tags that are looked for
    """
    last = min(first + count, FAMILY)
    if not len(quads) or last <= first:
        return Tags(number=np.empty(0, np.int64), corners=np.empty((0, 4, 2)), likeness=np.empty(0))
    code, framed = _sampled(image, quads, border_bits)
    scores = code @ _turned_codes(first, last)
    best = scores.argmax(axis=1)
    likeness = scores[np.arange(len(quads)), best]
    found = np.flatnonzero(framed & (likeness > _LEAST_LIKENESS))
    number, turn = np.divmod(best[found], 4)
    # A code that is turned by k quarters against the clock has its upper left corner at corner -k of the quadrilateral.
    order = (np.array([3, 2, 1, 0]) - turn[:, None]) % 4
    return Tags(
        number=number + first, corners=np.take_along_axis(quads[found], order[:, :, None], 1), likeness=likeness[found]
    )


def likeness_of(image: Grey, corners: Floats, number: Integers, border_bits: int = 2) -> Floats:
    """Return how much quadrilaterals look like given tags, (k,): the correlation with the code.

    Parameters
    ----------
    corners : (k, 4, 2) counter-clockwise from the lower left
    number : (k,) of the tags
    """
    if not len(number):
        return np.empty(0)
    code, framed = _sampled(image, corners[:, ::-1], border_bits)
    expected = _turned_codes(0, FAMILY)[:, 4 * number]
    return np.where(framed, np.einsum("qi,iq->q", code, expected), 0.0)


def _sampled(image: Grey, quads: Floats, border_bits: int) -> tuple[Floats, np.ndarray]:
    """Return the code's samples with zero mean and unit length, (q, 36), and whether there is a black border around."""
    side = BITS + 2 * border_bits
    at = (np.arange(side) + 0.5) / side
    place = _on_quads(quads, np.tile(at, side), np.repeat(at, side)).astype(np.float32)
    mapped = cv2.remap(image, place[:, 0], place[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cells = np.asarray(mapped, dtype=np.float64).reshape(-1, side, side)
    inner = slice(border_bits, border_bits + BITS)
    code = cells[:, inner, inner].reshape(len(quads), -1)
    border = np.ones((side, side), dtype=bool)
    border[inner, inner] = False
    ring = cells[:, border]
    centred = code - code.mean(axis=1, keepdims=True)
    length = np.linalg.norm(centred, axis=1)
    low, high = np.quantile(code, [0.1, 0.9], axis=1)
    contrast = high - low
    light = np.quantile(ring, 0.9, axis=1) - np.minimum(low, ring.mean(axis=1))
    framed = (contrast > _LEAST_CONTRAST) & (light < _LIGHT_BORDER * contrast + 2)
    return centred / np.maximum(length, 1e-9)[:, None], framed


def _on_quads(quads: Floats, s: Floats, t: Floats) -> Floats:
    """Return where points of the unit square are on quadrilaterals, (q, 2, n) [px]: s to the right, t downwards."""
    H = square_to_quads(quads)
    ones = np.ones_like(s)
    x, y, w = np.moveaxis(H @ np.stack([s, t, ones]), 1, 0)
    return np.stack([x / w, y / w], axis=1)


def square_to_quads(quads: Floats) -> Floats:
    """Return the homographies (q, 3, 3) that map the corners (0,0) (1,0) (1,1) (0,1) to those of quadrilaterals."""
    p0, p1, p2, p3 = np.moveaxis(quads, 1, 0)
    d1, d2, d3 = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    across = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    across = np.where(np.abs(across) < 1e-9, 1e-9, across)
    g = (d3[:, 0] * d2[:, 1] - d2[:, 0] * d3[:, 1]) / across
    h = (d1[:, 0] * d3[:, 1] - d3[:, 0] * d1[:, 1]) / across
    H = np.empty((len(quads), 3, 3))
    H[:, :2, 0] = p1 - p0 + g[:, None] * p1
    H[:, :2, 1] = p3 - p0 + h[:, None] * p3
    H[:, :2, 2] = p0
    H[:, 2, 0], H[:, 2, 1], H[:, 2, 2] = g, h, 1
    return H
