"""From a lattice of crossings to the corners of a stated checkerboard, and whether the image shows that board there."""

import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...recording import Floats
from ...recording.frames import Grey
from .board import middle_of
from .lattice import Lattice

_SLACK = 2  # lines of corners that may have been missed on one side
_FOUND = 0.7  # share of the corners that a lattice must have
_TRIALS = 4
_BREAK = 0.6  # change of the step from one corner to the next, over the step
_ASTRAY = 0.35  # distance from where the neighbours expect a corner, in squares
_INTO_SQUARE = 0.3  # where a square's level is read, from its corner, in squares
_CLEAR = 0.2  # difference of black and white of one corner, over the median difference of the board
_CLEAR_SHARE, _CLEAR_SHARE_OF_LINE = 0.85, 0.6
_GOES_ON = 0.7  # share of clear crossings beside the board that make it a larger one
_LEAST_CONTRAST = 8.0  # grey levels
_FEWEST = 4
_WAYS = _INTO_SQUARE * np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]])[:, :, None, None, None]


@value_class
class CheckerboardGrid:
    """A checkerboard in an image.

    Attributes
    ----------
    grid : (rows, cols, 2) its corners [px]
    clear : (rows, cols) whether the four squares at a corner are black and white in turn, as the board has them
    known : (rows, cols) whether all four are in the image
    dark : whether the square between corners (0, 0) and (1, 1) is black
    again : whether a search saw a second board like it
    """

    grid: Floats
    clear: Booleans
    known: Booleans
    dark: bool
    again: bool = False

    @property
    def middle(self) -> Floats:
        """Middle of its corners, (2,) [px]."""
        return self.grid.mean(axis=(0, 1))

    @property
    def complete(self) -> bool:
        """Whether nearly all corners are clear, and most of them on each side."""
        lines = (self.clear[0], self.clear[-1], self.clear[:, 0], self.clear[:, -1])
        return self.clear.mean() > _CLEAR_SHARE and all(line.mean() > _CLEAR_SHARE_OF_LINE for line in lines)

    def in_order(self) -> "CheckerboardGrid":
        """Return the board turned such that its first square between corners is black, where a turn can make it so."""
        rows, cols = self.grid.shape[:2]
        if self.dark or not ((rows + cols) % 2 or (rows == cols and rows % 2)):
            return self
        turns = 2 if (rows + cols) % 2 else 1
        return CheckerboardGrid(
            grid=np.rot90(self.grid, turns),
            clear=np.rot90(self.clear, turns),
            known=np.rot90(self.known, turns),
            dark=True,
        )


def boards_in(lattice: Lattice, rows: int, cols: int) -> list[Floats]:
    """Return the grids (rows, cols, 2) that a lattice may be, the fullest first; nan where a corner was not found."""
    found = lattice.grid()
    trials: list[tuple[int, int, Floats]] = []
    ways = [found] if rows == cols else [found, found.swapaxes(0, 1)]
    for way in ways:
        padded = np.full((way.shape[0] + 2 * _SLACK, way.shape[1] + 2 * _SLACK, 2), np.nan)
        padded[_SLACK:-_SLACK, _SLACK:-_SLACK] = way
        if padded.shape[0] < rows or padded.shape[1] < cols:
            continue
        taken = np.zeros((padded.shape[0] + 1, padded.shape[1] + 1), np.int64)
        taken[1:, 1:] = np.isfinite(padded[:, :, 0]).cumsum(axis=0).cumsum(axis=1)
        counts = taken[rows:, cols:] - taken[:-rows, cols:] - taken[rows:, :-cols] + taken[:-rows, :-cols]
        for i, j in np.argwhere(counts >= _FOUND * rows * cols):
            trials.append((-int(counts[i, j]), len(trials), padded[i : i + rows, j : j + cols]))
    return [grid for _, _, grid in sorted(trials, key=lambda trial: trial[:2])[:_TRIALS]]


def fill_grid(grid: Floats) -> Floats | None:
    """Return the grid with its gaps filled from the neighbours, (rows, cols, 2); None where that cannot be done.

    Corners that do not lie where their neighbours say are replaced, too.
    """
    guess = _guesses(grid)
    squares = np.concatenate(
        [np.square(step).sum(axis=2).ravel() for step in (grid[1:] - grid[:-1], grid[:, 1:] - grid[:, :-1])]
    )
    squares = squares[np.isfinite(squares)]
    if not len(squares):
        return None
    astray = _medians(np.square(guess - grid).sum(axis=3)) > _ASTRAY**2 * middle_of(squares)
    grid = np.where(astray[..., None], np.nan, grid)
    for _ in range(sum(grid.shape)):
        gaps = np.isnan(grid[:, :, 0])
        if not gaps.any():
            return grid
        fill = _medians(_guesses(grid))
        if np.isnan(fill[gaps]).all():
            return None
        grid = np.where(gaps[..., None], fill, grid)
    return None


_NEIGHBOURS = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)])


def _guesses(grid: Floats) -> Floats:
    """Return what the neighbours on eight sides say, (8, rows, cols, 2): lines of two, parallelograms of three."""
    rows, cols = grid.shape[:2]
    padded = np.full((rows + 4, cols + 4, 2), np.nan)
    padded[2:-2, 2:-2] = grid

    def beside(i: int, j: int) -> Floats:
        return padded[2 + i : 2 + i + rows, 2 + j : 2 + j + cols]

    lines = [2 * beside(i, j) - beside(2 * i, 2 * j) for i, j in _NEIGHBOURS[:4]]
    return np.stack(lines + [beside(i, 0) + beside(0, j) - beside(i, j) for i, j in _NEIGHBOURS[4:]])


def _medians(values: Floats) -> Floats:
    """Return medians over the first axis, of the finite values, the lower one of two; nan where there are none."""
    ordered = np.sort(values, axis=0)  # nan comes last
    place = np.maximum(np.isfinite(ordered).sum(axis=0, keepdims=True) - 1, 0) // 2
    return np.take_along_axis(ordered, place, axis=0)[0]


def grid_steps(grid: Floats) -> tuple[Floats, Floats]:
    """Return the steps to the next row and to the next column at each corner, (rows, cols, 2) each [px]."""
    return _steps(grid), _steps(grid.swapaxes(0, 1)).swapaxes(0, 1)


def _steps(grid: Floats) -> Floats:
    step = np.empty(grid.shape)
    step[1:-1] = 0.5 * (grid[2:] - grid[:-2])
    step[0], step[-1] = grid[1] - grid[0], grid[-1] - grid[-2]
    return step


def _right_handed(grid: Floats) -> Floats:
    """Return the grid, mirrored if need be, such that its z axis points toward the viewer."""
    along_rows, along_cols = (
        grid[-1].sum(axis=0) - grid[0].sum(axis=0),
        grid[:, -1].sum(axis=0) - grid[:, 0].sum(axis=0),
    )
    turn = along_rows[0] * along_cols[1] - along_rows[1] * along_cols[0]
    return grid if turn < 0 else grid[::-1]


def board_at(image: Grey, grid: Floats) -> CheckerboardGrid | None:
    """Return the board whose corners are a grid (rows, cols, 2), mirrored if need be; None where there is none.

    A board's squares alternate, its lines run without a break, and the crossings do not go on beside it.
    """
    if not _unbroken(grid):
        return None
    grid = _right_handed(grid)
    wide = np.empty((grid.shape[0] + 2, grid.shape[1] + 2, 2))
    wide[1:-1, 1:-1] = grid
    for lines in (wide[:, 1:-1], wide[::-1, 1:-1], wide.swapaxes(0, 1), wide[:, ::-1].swapaxes(0, 1)):
        lines[0] = 2 * lines[1] - lines[2] if len(grid) < 3 else 2.5 * lines[1] - 2 * lines[2] + 0.5 * lines[3]
    known, first, second = _levels(image, wide)
    inside = np.s_[1:-1, 1:-1]
    if known[inside].sum() < _FEWEST:
        return None
    swing = (second.sum(axis=0) - first.sum(axis=0))[inside][known[inside]]
    difference = 0.5 * middle_of(swing)
    black, white = (first, second) if difference > 0 else (second, first)
    contrast = abs(difference)
    clear = known & (white.min(axis=0) - black.max(axis=0) > max(_CLEAR * contrast, 1.0))
    goes_on = any(
        known[line].mean() > 0.5 and clear[line].sum() > _GOES_ON * known[line].sum()
        for line in (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1])
    )
    board = CheckerboardGrid(grid=grid, clear=clear[inside], known=known[inside], dark=difference > 0)
    return board if contrast > _LEAST_CONTRAST and board.complete and not goes_on else None


def reaches_outside(image: Grey, grid: Floats) -> bool:
    """Tell whether so many corners of a side are outside the image that no board there is complete."""
    limits = [image.shape[1], image.shape[0]]  # a pixel beyond, since squares are read at whole pixels
    inside = np.asarray(((grid >= -1) & (grid <= limits)).all(axis=2), dtype=np.bool_)
    return any(line.mean() <= _CLEAR_SHARE_OF_LINE for line in (inside[0], inside[-1], inside[:, 0], inside[:, -1]))


def _levels(image: Grey, grid: Floats) -> tuple[Booleans, Floats, Floats]:
    """Read the four squares at every corner of a grid.

    Returns whether all four are in the image (rows, cols), and the grey levels of two pairs of opposite squares
    (2, rows, cols) each: of one colour throughout the board, the first pair black where the square before corner
    (0, 0) is.
    """
    along_rows, along_cols = grid_steps(grid)
    rows, cols = grid.shape[:2]
    whole = np.rint(grid + _WAYS[:, 0] * along_rows + _WAYS[:, 1] * along_cols).astype(np.int64)
    limits = np.array([image.shape[1] - 1, image.shape[0] - 1])
    safe = np.minimum(np.maximum(whole, 0), limits)
    levels = image[safe[..., 1], safe[..., 0]].astype(np.float64)
    odd = np.add.outer(np.arange(rows), np.arange(cols)) % 2 == 1
    pairs = levels[:2], levels[2:]
    return (whole == safe).all(axis=(0, 3)), np.where(odd, pairs[1], pairs[0]), np.where(odd, pairs[0], pairs[1])


def _unbroken(grid: Floats) -> bool:
    """Tell whether the lines of a grid run without a break: none of its parts slipped by a square."""
    for lines in (grid, grid.swapaxes(0, 1)):
        step = lines[1:] - lines[:-1]
        limit = _BREAK**2 * np.square(step).sum(axis=2)
        bend = np.square(step[1:] - step[:-1]).sum(axis=2)
        shear = np.square(step[:, 1:] - step[:, :-1]).sum(axis=2)
        if (bend > np.maximum(limit[1:], limit[:-1])).any() or (shear > np.maximum(limit[:, 1:], limit[:, :-1])).any():
            return False
    return True
