"""Where a ChArUco board is whose markers cannot be outlined: small, or blurred until they touch the black squares.

The corners of the chessboard still form a lattice. Of its squares the grey levels of the cells are read as if each bore
a marker, and the place of the lattice on the board is the one at which they are most like the codes that stand there.
"""

import numpy as np

from ...models.board_pattern import black_square
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.frames import Grey
from .lattice import Lattice, find_lattices, find_saddles
from .tags import cells_in, marker_pictures, of_unit_length, square_to_quads

_BLUR = 0.6  # of the codes, in cells
_FEWEST_MARKERS = 3
_LIKE, _BEFORE_OTHERS = 0.5, 0.15  # mean correlation with the codes, and by how much the next best place is worse
_ON_BOARD = 0.7  # share of a lattice that is on the board
_LATTICES = 2


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
