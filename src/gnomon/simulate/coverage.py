"""How much of each pixel is inside an outline: exact areas, without rays, for outlines made of straight pieces.

A piece inside one pixel that runs down by dy adds an area of dy (1 - x) to this pixel, x being its mean distance from
the pixel's left edge, and dy to every pixel to the right of it; one that runs up takes as much away. So each piece
concerns two pixels, and the sum along the row does the rest.
"""

import numpy as np
from numpy.typing import NDArray

from ..recording import Floats

Singles = NDArray[np.float32]

_BLOCK = 32768  # pieces at a time: the intermediate arrays of a block stay in the cache


def coverage(start: Floats, end: Floats, shape: tuple[int, int]) -> Singles:
    """Return the area of each pixel (rows, cols) that is inside closed outlines, times how often it is.

    Parameters
    ----------
    start, end : (n, 2) directed pieces of the outlines, x and y; pixel [0, 0] reaches from 0 to 1. What is to the right
        of a piece that runs down counts as inside
    shape : rows and columns
    """
    rows, cols = shape
    flat = np.zeros(rows * (cols + 1))
    start, end = _near(start, end, shape)
    for first in range(0, len(start), _BLOCK):
        _add(flat, start[first : first + _BLOCK], end[first : first + _BLOCK], shape)
    return np.cumsum(flat.reshape(rows, cols + 1)[:, :-1], axis=1, dtype=np.float32)


def _add(flat: Floats, start: Floats, end: Floats, shape: tuple[int, int]) -> None:
    """Add what pieces contribute to the differences between neighbours in a row, (rows (cols + 1),)."""
    rows, cols = shape
    piece, row = _runs(start[:, 1], end[:, 1], rows)
    (x0, y0), (x1, y1) = start[piece].T, end[piece].T
    top, bottom = np.clip(y0, row, row + 1), np.clip(y1, row, row + 1)
    slope = (x1 - x0) / (y1 - y0)
    left, right = x0 + (top - y0) * slope, x0 + (bottom - y0) * slope
    down = bottom - top
    piece, col = _runs(left, right, cols)
    whole = (right - left)[piece]
    from_x, to_x = np.clip(left[piece], col, col + 1), np.clip(right[piece], col, col + 1)
    share = np.divide(to_x - from_x, whole, out=np.ones_like(whole), where=np.abs(whole) > 1e-9)
    down = down[piece] * share
    beyond = down * ((from_x + to_x) / 2 - col)
    at = row[piece] * (cols + 1) + col
    np.add.at(flat, at, down - beyond)
    np.add.at(flat, at + 1, beyond)


def _near(start: Floats, end: Floats, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the pieces that matter; those to the left of the image are drawn upon its edge.

    A piece that crosses the left edge is drawn upon it as a whole: pieces are short.
    """
    low, high = np.minimum(start, end), np.maximum(start, end)
    matters = (high[:, 1] > 0) & (low[:, 1] < shape[0]) & (low[:, 0] < shape[1]) & (start[:, 1] != end[:, 1])
    start, end = start[matters].copy(), end[matters].copy()
    np.maximum(start[:, 0], 0.0, out=start[:, 0])
    np.maximum(end[:, 0], 0.0, out=end[:, 0])
    return start, end


def _runs(start: Floats, end: Floats, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which intervals meet which cells: cell k reaches from k to k + 1, and there are `count` of them."""
    first = np.floor(np.minimum(start, end)).astype(np.intp)
    last = np.maximum(np.ceil(np.maximum(start, end)).astype(np.intp), first + 1)
    np.clip(first, 0, count, out=first)
    np.clip(last, 0, count, out=last)
    number = last - first
    piece = np.repeat(np.arange(len(start)), number)
    offset = np.arange(len(piece)) - np.repeat(np.cumsum(number) - number, number)
    return piece, first[piece] + offset
