"""Which AprilTag of the family 36h11, or which ArUco marker, is in a quadrilateral, and which way up.

The grey levels in the middle of the cells are compared with the codes as pictures, sharp and blurred. The numbers of
the AprilTags are Kalibr's; their codes, 36 bits that differ in at least 11 places however they are turned, are those of
OpenCV's dictionary, whose pictures are upside down. Small dictionaries of ArUco have codes that are much alike; there
a marker counts only where no other one of its dictionary is nearly as likely, and the board asks for several markers
that agree on where they are.

Where a ChArUco board is whose markers cannot be outlined: small, or blurred until they touch the black squares.

The corners of the chessboard still form a lattice. Of its squares the grey levels of the cells are read as if each bore
a marker, and the place of the lattice on the board is the one at which they are most like the codes that stand there.
"""

from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.board_pattern import black_square, marker_cells
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .lattice import Lattice, find_lattices, find_saddles

BITS = 6
"""Bits of a code along a side."""

FAMILY = 587
"""Number of tags."""

_LEAST_CONTRAST = 8.0  # grey levels between the code's black and white
_LIGHT_BORDER = 0.4  # how far from black to white the border may be
_BLURS = (0.3, 0.6)  # of a code, in its cells
_LEAST_LIKENESS = (0.72, 0.88)  # correlation with the code; others stay below 0.54 and 0.83
_MARGIN = 0.06  # by which others of the family are less alike where the codes are blurred
_MARKER_MARGIN = 0.08  # by which all other markers are less alike
_FINE = 16  # pixels along a cell in which codes are blurred
_MANY_CELLS = 12  # that tell one code from others
_BLUR = 0.6  # of the codes, in cells
_FEWEST_MARKERS = 3
_LIKE, _BEFORE_OTHERS = 0.5, 0.15  # mean correlation with the codes, and by how much the next best place is worse
_ON_BOARD = 0.7  # share of a lattice that is on the board
_LATTICES = 2


@value_class
class Tags:
    """Tags or markers that were read.

    Attributes
    ----------
    number : (k,) of the tag
    corners : (k, 4, 2) as the tag stands [px]: of AprilTags counter-clockwise from the lower left, of ArUco markers
        clockwise from the upper left
    likeness : (k,) correlation with the code, 0 to 1
    """

    number: Integers
    corners: Floats
    likeness: Floats

    def __len__(self) -> int:
        return len(self.number)

    def only(self, kept: NDArray[np.bool_]) -> "Tags":
        """Return some of the tags."""
        return Tags(number=self.number[kept], corners=self.corners[kept], likeness=self.likeness[kept])


@cache
def tag_pictures() -> Floats:
    """Return the codes as pictures, (587, 6, 6), 1 white and 0 black; row 0 is the upper one of the upright tag."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    packed = dictionary.bytesList
    upside_down = [dictionary.getBitsFromByteList(packed[i : i + 1], BITS) for i in range(len(packed))]
    pictures = np.array(upside_down, dtype=np.float64)[:, ::-1, ::-1].copy()
    pictures.flags.writeable = False
    return pictures


def _blurred(pictures: Floats, blur: float, border_bits: int) -> Floats:
    """Return codes (n, bits, bits) of pictures with their borders that are blurred, in cells.

    The light around takes part.
    """
    edge = border_bits + 1
    pictures = np.pad(pictures, ((0, 0), (1, 1), (1, 1)), constant_values=1)
    side = pictures.shape[1]
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    kernel = np.exp(-0.5 * np.square((fine[:, None] - np.arange(side)) / blur))
    kernel = kernel.reshape(side, _FINE, side).sum(axis=1)  # cell by cell that is looked at
    kernel /= kernel.sum(axis=0)
    return (kernel.T @ pictures @ kernel)[:, edge:-edge, edge:-edge]


@cache
def _blurred_codes(blur: float, border_bits: int) -> Floats:
    return _blurred(np.pad(tag_pictures(), ((0, 0), (border_bits,) * 2, (border_bits,) * 2)), blur, border_bits)


@cache
def _turned_codes(first: int, last: int, blur: float, border_bits: int) -> Floats:
    """Return the codes first ... last - 1 in all four attitudes, zero mean and unit length, (36, 4 (last - first))."""
    pictures = _blurred_codes(blur, border_bits)[first:last]
    turned = np.stack([np.rot90(pictures, k, axes=(1, 2)) for k in range(4)], axis=1)
    return np.ascontiguousarray(of_unit_length(turned.reshape(-1, BITS * BITS)).T)


def of_unit_length(cells: Floats) -> Floats:
    """Return cells (k, n) less their mean, and of unit length: their products are correlations."""
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
    cells, _ = cells_in(image, quads, BITS + 2 * border_bits)
    framed = np.flatnonzero(_framed(cells, border_bits))
    code = of_unit_length(_code(cells[framed], border_bits))
    best, likeness = np.zeros(len(code), np.int64), np.zeros(len(code))
    for blur, least in zip(_BLURS, _LEAST_LIKENESS, strict=True):
        open_ = np.flatnonzero(likeness == 0)
        scores = code[open_] @ _turned_codes(first, last, blur, border_bits)
        leading, score = scores.argmax(axis=1), scores.max(axis=1)
        sure = np.flatnonzero(score > least)
        if blur > _BLURS[0]:  # sharp codes are not alike
            sure = sure[_surest(code[open_[sure]], first + leading[sure] // 4, score[sure], (blur, border_bits))]
        best[open_[sure]], likeness[open_[sure]] = leading[sure], score[sure]
    read = np.flatnonzero(likeness)
    number, turn = np.divmod(best[read], 4)
    corners = np.ascontiguousarray(_turned_back(quads[framed[read]], turn)[:, ::-1])
    return Tags(number=number + first, corners=corners, likeness=likeness[read])


def _turned_back(quads: Floats, turn: Integers) -> Floats:
    """Return the corners (k, 4, 2), clockwise from the upper left, of codes that are turned by quarters (k,)."""
    # A code that is turned by k quarters against the clock has its upper left corner at corner -k of the quadrilateral.
    order = (np.arange(4) - turn[:, None]) % 4
    return np.take_along_axis(quads, order[:, :, None], 1)


def _surest(code: Floats, number: Integers, score: Floats, blurred: tuple[float, int]) -> np.ndarray:
    """Return which codes are clearly less like all other tags of the family."""
    scores = (code @ _turned_codes(0, FAMILY, *blurred)).reshape(-1, FAMILY, 4)
    scores[np.arange(len(code)), number] = -1
    return score > scores.max(axis=(1, 2)) + _MARGIN


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
    cells, within = cells_in(image, corners[:, ::-1], BITS + 2 * border_bits, border_bits)
    code, within = cells.reshape(len(cells), -1), within.reshape(len(cells), -1)
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


def read_markers(image: Grey, quads: Floats, dictionary: str, *, first: int, count: int) -> Tags:
    """Return the markers in some quadrilaterals.

    Parameters
    ----------
    image : (h, w)
    quads : (q, 4, 2) outlines of the markers' black borders, clockwise as one sees them [px]
    dictionary : OpenCV's name without "DICT_"
    first, count : the markers that are looked for; others of the dictionary are left out
    """
    sharp = marker_pictures(dictionary, _BLURS[0])
    bits = sharp.shape[2]
    cells = cells_in(image, quads, bits + 2)[0] if len(quads) else np.empty((0, bits + 2, bits + 2))
    framed = np.flatnonzero(_framed(cells, 1))
    code = of_unit_length(_code(cells[framed], 1))
    best, likeness = np.zeros(len(code), np.int64), np.zeros(len(code))
    for blur in _BLURS:
        scores = (code @ of_unit_length(marker_pictures(dictionary, blur).reshape(-1, bits * bits)).T).reshape(
            len(code), len(sharp), 4
        )
        by_marker = scores.max(axis=2)
        leading = by_marker.argmax(axis=1)
        score = by_marker[np.arange(len(code)), leading]
        by_marker[np.arange(len(code)), leading] = -1
        surest = (score > _LEAST_LIKENESS[0]) & (score > by_marker.max(axis=1, initial=-1) + _MARKER_MARGIN)
        better = surest & (score > likeness)
        turn = scores[np.arange(len(code)), leading].argmax(axis=1)
        best[better], likeness[better] = (4 * leading + turn)[better], score[better]
    number, turn = np.divmod(best, 4)
    read = np.flatnonzero((likeness > 0) & (number >= first) & (number < first + count))
    corners = _turned_back(quads[framed[read]], turn[read])
    return Tags(number=number[read], corners=corners, likeness=likeness[read])


@lru_cache(maxsize=8)
def marker_pictures(dictionary: str, blur: float) -> Floats:
    """Return all codes of a dictionary in four attitudes as blurred pictures, (markers, 4, bits, bits)."""
    marker_cells(dictionary, 0)  # says what is wrong where there is no such dictionary
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    drawn = [cv2.aruco.generateImageMarker(family, k, family.markerSize + 2) for k in range(len(family.bytesList))]
    blurred = _blurred(np.asarray(drawn, dtype=np.float64) / 255, blur, 1)
    turned = np.stack([np.rot90(blurred, k, axes=(1, 2)) for k in range(4)], axis=1)
    turned.flags.writeable = False
    return turned


def cells_in(image: Grey, quads: Floats, side: int, border: int = 0) -> tuple[Floats, Floats]:
    """Return the grey levels in the middle of the cells of tags, (q, side, side), 1 where these are in the image.

    Those of a border are left out.
    """
    at = (np.arange(border, side - border) + 0.5) / side
    side = len(at)
    places = np.stack([np.tile(at, side), np.repeat(at, side), np.ones(side * side)])
    x, y, w = np.moveaxis(square_to_quads(quads) @ places, 1, 0)
    x, y = (x / w).astype(np.float32), (y / w).astype(np.float32)
    grey = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = image.shape
    seen = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    shape = (-1, side, side)
    return np.asarray(grey, dtype=np.float64).reshape(shape), seen.astype(np.float64).reshape(shape)


def _code(cells: Floats, border_bits: int) -> Floats:
    code = cells[:, border_bits:-border_bits, border_bits:-border_bits]
    return code.reshape(len(cells), code.shape[1] * code.shape[2])


def _framed(cells: Floats, border_bits: int) -> NDArray[np.bool_]:
    """Return whether there is something in cells with a black border around."""
    border = np.ones(cells.shape[1:], dtype=bool)
    border[border_bits:-border_bits, border_bits:-border_bits] = False
    code, ring = np.sort(_code(cells, border_bits), axis=1), np.sort(cells[:, border], axis=1)
    few = max(code.shape[1] // 12, 1)
    low, high, light = code[:, few], code[:, -1 - few], ring[:, (3 * ring.shape[1]) // 4]
    return (high - low > _LEAST_CONTRAST) & (light < low + _LIGHT_BORDER * (high - low) + 2)


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


def corners_by_lattice(image: Grey, target: Target) -> tuple[Integers, Floats] | None:
    """Return numbers (m,) and places (m, 2) of inner corners, to a pixel or two; None where they are not told.

    Parameters
    ----------
    image : (h, w)
    target : the board, a charuco
    """
    for lattice in find_lattices(image, find_saddles(image))[:_LATTICES]:
        found = _placed(image, target, lattice)
        if found is not None:
            return found
    return None


def _placed(image: Grey, target: Target, lattice: Lattice) -> tuple[Integers, Floats] | None:
    handed = lattice.handed()
    if not handed:
        return None
    grid = lattice.grid() if handed < 0 else lattice.grid()[::-1]  # rows down, columns to the right
    trials = [trial for turn in range(4) for trial in _trials(image, target, np.rot90(grid, turn))]
    trials.sort(key=lambda trial: -trial[0])
    if not trials or trials[0][0] < _LIKE or (len(trials) > 1 and trials[1][0] > trials[0][0] - _BEFORE_OTHERS):
        return None
    _, number, pixels = trials[0]
    return number, pixels


def _trials(image: Grey, target: Target, grid: Floats) -> list[tuple[float, Integers, Floats]]:
    """Return likeness, numbers and places for each shift of a grid (rows, cols, 2) of corners on the board."""
    outlines = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    whole = np.isfinite(outlines).all(axis=(2, 3))
    if np.count_nonzero(whole) < _FEWEST_MARKERS:
        return []
    likeness = np.full((*whole.shape, _count(target)), np.nan)
    likeness[whole] = _likeness(image, target, outlines[whole])
    marker = _markers(target)
    there = np.isfinite(grid[:, :, 0])
    rows, cols = target.rows - 1, target.cols - 1
    found: list[tuple[float, Integers, Floats]] = []
    for i in range(1 - grid.shape[0], rows):
        for j in range(1 - grid.shape[1], cols):
            row, col = np.nonzero(there)
            on_board = (row + i >= 0) & (row + i < rows) & (col + j >= 0) & (col + j < cols)
            if np.count_nonzero(on_board) < _ON_BOARD * len(row):
                continue
            row, col = row[on_board], col[on_board]
            bears = (row + 1 < grid.shape[0]) & (col + 1 < grid.shape[1])
            at = marker[row + i + 1, col + j + 1]  # square below and to the right of a corner
            bears &= (at >= 0) & (row + i + 1 < rows) & (col + j + 1 < cols)
            like = likeness[row[bears], col[bears], at[bears]]
            like = like[np.isfinite(like)]
            if len(like) >= _FEWEST_MARKERS:
                found.append((float(like.mean()), (row + i) * cols + col + j, grid[row, col]))
    return found


def _likeness(image: Grey, target: Target, outlines: Floats) -> Floats:
    """Return the correlation of squares (k, 4, 2) with the markers of the board, as they stand, (k, markers)."""
    side = target.marker_size_m / target.square_size_m
    inner = 0.5 + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    H = square_to_quads(outlines)
    u, v, w = np.moveaxis(H @ np.column_stack([inner, np.ones(4)]).T, 1, 0)
    pictures = marker_pictures(target.dictionary, _BLUR)[target.first_tag : target.first_tag + _count(target), 0]
    bits = pictures.shape[1]
    read = cells_in(image, np.stack([u / w, v / w], axis=2), bits + 2)[0][:, 1:-1, 1:-1]
    return of_unit_length(read.reshape(-1, bits * bits)) @ of_unit_length(pictures.reshape(-1, bits * bits)).T


def _markers(target: Target) -> Integers:
    """Return the marker on each square, (rows, cols), from 0; -1 on black ones."""
    white = np.array([[not black_square(target, i, j) for j in range(target.cols)] for i in range(target.rows)])
    return np.where(white, np.cumsum(white).reshape(white.shape) - 1, -1)


def _count(target: Target) -> int:
    return int(_markers(target).max()) + 1
