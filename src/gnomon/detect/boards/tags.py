"""AprilTags of the family 36h11: which tag is in a quadrilateral, and which way up.

The numbers of the tags are Kalibr's; their codes, 36 bits that differ in at least 11 places however they are turned,
are those of OpenCV's dictionary, whose pictures are upside down.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from ...images import Grey
from ...recording import Floats, Integers

BITS = 6
"""Bits of a code along a side."""

FAMILY = 587
"""Number of tags."""

_LEAST_CONTRAST = 8.0  # grey levels between the code's black and white
_LIGHT_BORDER = 0.4  # how far from black to white the border may be
_BLURS = (0.3, 0.6)  # of a code, in its cells
_LEAST_LIKENESS = (0.72, 0.88)  # correlation with the code; others stay below 0.54 and 0.83
_MARGIN = 0.06  # by which others of the family are less alike where the codes are blurred
_FINE = 16  # pixels along a cell in which codes are blurred
_MANY_CELLS = 12  # that tell one code from others


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
def _blurred_codes(blur: float, border_bits: int) -> Floats:
    """Return all codes as pictures of tags that are blurred, in cells, (587, 6, 6); the light around takes part."""
    edge = border_bits + 1
    pictures = np.pad(
        np.pad(codes(), ((0, 0), (border_bits,) * 2, (border_bits,) * 2)), ((0, 0), (1, 1), (1, 1)), constant_values=1
    )
    side = pictures.shape[1]
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    kernel = np.exp(-0.5 * np.square((fine[:, None] - np.arange(side)) / blur))
    kernel = kernel.reshape(side, _FINE, side).sum(axis=1)  # cell by cell that is looked at
    kernel /= kernel.sum(axis=0)
    blurred = np.einsum("ij,nik,kl->njl", kernel, pictures, kernel)
    return blurred[:, edge : edge + BITS, edge : edge + BITS]


@cache
def _turned_codes(first: int, last: int, blur: float, border_bits: int) -> Floats:
    """Return the codes first ... last - 1 in all four attitudes, zero mean and unit length, (36, 4 (last - first))."""
    pictures = _blurred_codes(blur, border_bits)[first:last]
    turned = np.stack([np.rot90(pictures, k, axes=(1, 2)) for k in range(4)], axis=1)
    return np.ascontiguousarray(_of_unit_length(turned.reshape(-1, BITS * BITS)).T)


def _of_unit_length(cells: Floats) -> Floats:
    centred = cells - cells.mean(axis=-1, keepdims=True)
    return centred / np.maximum(np.linalg.norm(centred, axis=-1, keepdims=True), 1e-9)


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
    cells = _cells(image, quads, border_bits)
    framed = np.flatnonzero(_framed(cells, border_bits))
    code = _of_unit_length(_code(cells[framed], border_bits))
    best, likeness = np.zeros(len(code), np.int64), np.zeros(len(code))
    for blur, least in zip(_BLURS, _LEAST_LIKENESS, strict=True):
        open_ = np.flatnonzero(likeness == 0)
        scores = code[open_] @ _turned_codes(first, last, blur, border_bits)
        leading, score = scores.argmax(axis=1), scores.max(axis=1)
        sure = np.flatnonzero(score > least)
        if blur > _BLURS[0]:  # sharp codes are not alike
            sure = sure[
                _surest(code[open_[sure]], first + leading[sure] // 4, score[sure], _MARGIN, (blur, border_bits))
            ]
        best[open_[sure]], likeness[open_[sure]] = leading[sure], score[sure]
    read = np.flatnonzero(likeness)
    number, turn = np.divmod(best[read], 4)
    # A code that is turned by k quarters against the clock has its upper left corner at corner -k of the quadrilateral.
    order = (np.array([3, 2, 1, 0]) - turn[:, None]) % 4
    corners = np.take_along_axis(quads[framed[read]], order[:, :, None], 1)
    return Tags(number=number + first, corners=corners, likeness=likeness[read])


def _surest(code: Floats, number: Integers, score: Floats, margin: float, blurred: tuple[float, int]) -> np.ndarray:
    """Return which codes are clearly less like all other tags of the family."""
    scores = (code @ _turned_codes(0, FAMILY, *blurred)).reshape(-1, FAMILY, 4)
    scores[np.arange(len(code)), number] = -1
    return score > scores.max(axis=(1, 2)) + margin


def likeness_of(image: Grey, corners: Floats, number: Integers, border_bits: int = 2) -> Floats:
    """Return how much quadrilaterals look like given tags, (k,): the correlation with the code, blurred or not.

    Of a tag that is partly outside the image the rest is looked at; nan where that is too little.

    Parameters
    ----------
    corners : (k, 4, 2) counter-clockwise from the lower left
    number : (k,) of the tags
    """
    if not len(number):
        return np.empty(0)
    cells, seen = _cells_and_seen(image, corners[:, ::-1], border_bits)
    code, within = _code(cells, border_bits), _code(seen, border_bits)
    count = within.sum(axis=1)
    best = np.full(len(number), -1.0)
    for blur in _BLURS:
        expected = _turned_codes(0, FAMILY, blur, border_bits)[:, 4 * number].T
        best = np.maximum(best, _correlation(code, expected, within, count))
    return np.where(count >= _MANY_CELLS, best, np.nan)


def _correlation(a: Floats, b: Floats, weight: Floats, count: Floats) -> Floats:
    count = np.maximum(count, 1)
    a, b = (x - ((x * weight).sum(axis=1) / count)[:, None] for x in (a, b))
    product, square = (a * b * weight).sum(axis=1), (a * a * weight).sum(axis=1) * (b * b * weight).sum(axis=1)
    return product / np.sqrt(np.maximum(square, 1e-9))


def _cells(image: Grey, quads: Floats, border_bits: int) -> Floats:
    """Return the grey levels in the middle of the cells of tags, (q, side, side)."""
    return _cells_and_seen(image, quads, border_bits)[0]


def _cells_and_seen(image: Grey, quads: Floats, border_bits: int) -> tuple[Floats, Floats]:
    """Return the grey levels in the middle of the cells of tags, (q, side, side), 1 where these are in the image."""
    side = BITS + 2 * border_bits
    at = (np.arange(side) + 0.5) / side
    place = _on_quads(quads, np.tile(at, side), np.repeat(at, side)).astype(np.float32)
    mapped = cv2.remap(image, place[:, 0], place[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = image.shape
    x, y = place[:, 0], place[:, 1]
    seen = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    shape = (-1, side, side)
    return np.asarray(mapped, dtype=np.float64).reshape(shape), seen.astype(np.float64).reshape(shape)


def _code(cells: Floats, border_bits: int) -> Floats:
    inner = slice(border_bits, border_bits + BITS)
    return cells[:, inner, inner].reshape(len(cells), BITS * BITS)


def _framed(cells: Floats, border_bits: int) -> np.ndarray:
    """Return whether there is something in cells with a black border around."""
    border = np.ones(cells.shape[1:], dtype=bool)
    border[border_bits : border_bits + BITS, border_bits : border_bits + BITS] = False
    code, ring = np.sort(_code(cells, border_bits), axis=1), np.sort(cells[:, border], axis=1)
    low, high, light = code[:, 3], code[:, -4], ring[:, (3 * ring.shape[1]) // 4]
    contrast = high - low
    return (contrast > _LEAST_CONTRAST) & (light < low + _LIGHT_BORDER * contrast + 2)


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
