"""ArUco markers of any of OpenCV's dictionaries: which marker is in a black quadrilateral, and which way up.

As for AprilTags the grey levels in the middle of the cells are compared with the codes as pictures, sharp and blurred.
Small dictionaries have codes that are much alike; a marker counts only where no other one of its dictionary is nearly
as likely, and the board asks for several markers that agree on where they are.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ...images import Grey
from ...models.board_pattern import marker_cells
from ...recording import Floats, Integers
from .tags import square_to_quads

_LEAST_CONTRAST = 8.0  # grey levels between the code's black and white
_LIGHT_BORDER = 0.4  # how far from black to white the border may be
_BLURS = (0.3, 0.6)  # of a code, in its cells
_LEAST_LIKENESS = 0.72  # correlation with the code
_MARGIN = 0.08  # by which all other markers are less alike
_FINE = 16  # pixels along a cell in which codes are blurred


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """Markers that were read.

    Attributes
    ----------
    number : (k,) of the marker
    corners : (k, 4, 2) clockwise from the upper left, as the marker stands [px]
    likeness : (k,) correlation with the code, 0 to 1
    """

    number: Integers
    corners: Floats
    likeness: Floats

    def __len__(self) -> int:
        return len(self.number)


def read_markers(image: Grey, quads: Floats, dictionary: str, *, first: int, count: int) -> Markers:
    """Return the markers in some quadrilaterals.

    Parameters
    ----------
    image : (h, w)
    quads : (q, 4, 2) outlines of the markers' black borders, clockwise as one sees them [px]
    dictionary : OpenCV's name without "DICT_"
    first, count : the markers that are looked for; others of the dictionary are left out
    """
    sharp = codes(dictionary, _BLURS[0])
    bits = sharp.shape[2]
    cells = cells_in(image, quads, bits + 2) if len(quads) else np.empty((0, bits + 2, bits + 2))
    framed = np.flatnonzero(_framed(cells))
    code = of_unit_length(cells[framed, 1:-1, 1:-1].reshape(-1, bits * bits))
    best, likeness = np.zeros(len(code), np.int64), np.zeros(len(code))
    for blur in _BLURS:
        scores = (code @ of_unit_length(codes(dictionary, blur).reshape(-1, bits * bits)).T).reshape(
            len(code), len(sharp), 4
        )
        by_marker = scores.max(axis=2)
        leading = by_marker.argmax(axis=1)
        score = by_marker[np.arange(len(code)), leading]
        by_marker[np.arange(len(code)), leading] = -1
        surest = (score > _LEAST_LIKENESS) & (score > by_marker.max(axis=1, initial=-1) + _MARGIN)
        better = surest & (score > likeness)
        turn = scores[np.arange(len(code)), leading].argmax(axis=1)
        best[better], likeness[better] = (4 * leading + turn)[better], score[better]
    number, turn = np.divmod(best, 4)
    read = np.flatnonzero((likeness > 0) & (number >= first) & (number < first + count))
    # A code turned by k quarters against the clock has its upper left corner at corner -k of the quadrilateral.
    order = (np.arange(4) - turn[read, None]) % 4
    corners = np.take_along_axis(quads[framed[read]], order[:, :, None], 1)
    return Markers(number=number[read], corners=corners, likeness=likeness[read])


@lru_cache(maxsize=8)
def codes(dictionary: str, blur: float) -> Floats:
    """Return all codes in four attitudes as blurred pictures, (markers, 4, bits, bits); the light around takes part."""
    pictures = np.pad(_cells_of(dictionary), ((0, 0), (1, 1), (1, 1)), constant_values=1.0)
    side = pictures.shape[1]
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    kernel = np.exp(-0.5 * np.square((fine[:, None] - np.arange(side)) / blur))
    kernel = kernel.reshape(side, _FINE, side).sum(axis=1)  # cell by cell that is looked at
    kernel /= kernel.sum(axis=0)
    blurred = np.einsum("ij,nik,kl->njl", kernel, pictures, kernel)[:, 2:-2, 2:-2]
    turned = np.stack([np.rot90(blurred, k, axes=(1, 2)) for k in range(4)], axis=1)
    turned.flags.writeable = False
    return turned


def _cells_of(dictionary: str) -> Floats:
    """Return the cells of all markers of a dictionary, (markers, side, side), 1 white; their borders included."""
    marker_cells(dictionary, 0)  # says what is wrong where there is no such dictionary
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    side = family.markerSize + 2
    pictures = [cv2.aruco.generateImageMarker(family, k, side) for k in range(len(family.bytesList))]
    return np.asarray(pictures, dtype=np.float64) / 255


def cells_in(image: Grey, quads: Floats, side: int) -> Floats:
    """Return the grey levels in the middle of the cells of markers, (q, side, side)."""
    at = (np.arange(side) + 0.5) / side
    places = np.stack([np.tile(at, side), np.repeat(at, side), np.ones(side * side)])
    x, y, w = np.moveaxis(square_to_quads(quads) @ places, 1, 0)
    x, y = (x / w).astype(np.float32), (y / w).astype(np.float32)
    grey = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(grey, dtype=np.float64).reshape(-1, side, side)


def _framed(cells: Floats) -> np.ndarray:
    """Return whether there is something in cells with a black border around."""
    inside = np.zeros(cells.shape[1:], dtype=bool)
    inside[1:-1, 1:-1] = True
    code, ring = np.sort(cells[:, inside], axis=1), np.sort(cells[:, ~inside], axis=1)
    few = max(code.shape[1] // 12, 1)
    low, high, light = code[:, few], code[:, -1 - few], ring[:, (3 * ring.shape[1]) // 4]
    return (high - low > _LEAST_CONTRAST) & (light < low + _LIGHT_BORDER * (high - low) + 2)


def of_unit_length(cells: Floats) -> Floats:
    """Return cells (k, n) less their mean, and of unit length: their products are correlations."""
    centred = cells - cells.mean(axis=-1, keepdims=True)
    return centred / np.maximum(np.linalg.norm(centred, axis=-1, keepdims=True), 1e-9)
