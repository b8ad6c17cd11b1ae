"""The corners of a checkerboard in an image, or in the images of a camera, one after the other.

saddles, where two edges cross -> lattice -> the stated board -> corners to sub-pixel accuracy, doubtful ones left out

The search runs on a reduced image and goes to a finer one only where a lattice of small squares asks for it; so its
time is bounded, whatever the image shows. An uncoded board must be seen as a whole: part of it could be any part.

While a board can be seen to move its lattice is not searched again: optical flow carries the corners to the next image.
There they are measured afresh, by the same fit as after a search, and the squares around all of them are read: a
lattice that slipped by a square has the colours exchanged, one that slipped by two lies partly beside the board.
"""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats
from ...recording.recording import Grey
from .board import SECOND_BOARD, BoardView, comes_first, middle_of, nothing_seen
from .corner_fit import fit_corners
from .lattice import Lattice, carry_corners, find_lattices, find_saddles, squared_distances
from .marker_boards import BORDER_PX, COVERED, NEAR_BORDER, view_of
from .plane_map import LensGuess

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
_FEWEST_INSIDE = 4
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
    if known[inside].sum() < _FEWEST_INSIDE:
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


_SEARCH_WIDTH = 480  # an image is reduced by halves until it is narrower
_EVIDENCE, _FINER_PX = 6, 12.0  # crossings in a lattice, and squares below which a finer image may help
_WINDOW, _SMALLEST, _LARGEST = 0.3, 2, 5  # half width of the window of the first refinement, in squares and pixels
_RADIUS = 0.65  # of the fit's window over the height of a square
_FARTHEST = 0.35  # that a corner may move in its refinement, in squares
_FEWEST = 6
_LATTICES = 3  # that are looked at

# Of the tracker: a search now and then.
_SEARCH_EVERY = 50
_FOLLOWED = 0.8  # share of the corners that the flow must carry
_SAME_PX = 1.0


def detect_checkerboard(image: Grey, target: Target) -> BoardView:
    """Find a checkerboard in one image.

    The corners are numbered as `Target.points` counts, z toward the viewer. A board that looks the same after half a
    turn (or a quarter) may be numbered from either end; where the colours of its squares tell the ends apart, the
    square between corners 0, 1, cols and cols + 1 is black. `consistent_order` does the rest.

    Parameters
    ----------
    image : (h, w) grey levels
    target : the checkerboard
    """
    board = find_board(image, target)
    return nothing_seen() if board is None else measure_corners(image, board)


def find_board(image: Grey, target: Target) -> CheckerboardGrid | None:
    """Return the board with its corners to about a tenth of a pixel; None where it was not found."""
    scale = checkerboard_search_scale(image)
    while scale >= 1:
        small = reduce_image(image, scale)
        lattices = find_lattices(small, find_saddles(small))
        boards = [board for one in lattices[:_LATTICES] if (board := _board_of(image, one, scale, target)) is not None]
        if boards:
            return _first_of(boards)
        if not any(len(lattice) >= _EVIDENCE and lattice.spacing_px < _FINER_PX for lattice in lattices[:3]):
            return None
        scale //= 2
    return None


def _first_of(boards: list[CheckerboardGrid]) -> CheckerboardGrid:
    """Return the board, or of two the one to the left, which says that there is another."""
    first, *others = boards
    apart = [
        one for one in others if np.linalg.norm(one.middle - first.middle) > 0.5 * np.ptp(first.grid, (0, 1)).min()
    ]
    if not apart:
        return first
    return replace(first if comes_first(first.middle, apart[0].middle) else apart[0], again=True)


def checkerboard_search_scale(image: Grey) -> int:
    """Return the factor by which an image is reduced for the search."""
    scale = 1
    while max(image.shape) > _SEARCH_WIDTH * scale and min(image.shape) > _SEARCH_WIDTH * scale // 2:
        scale *= 2
    return scale


def reduce_image(image: Grey, scale: int) -> Grey:
    """Return the image, its height and width over a whole number."""
    if scale == 1:
        return image
    size = (image.shape[1] // scale, image.shape[0] // scale)
    whole = image[: size[1] * scale, : size[0] * scale]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)


def _board_of(image: Grey, lattice: Lattice, scale: int, target: Target) -> CheckerboardGrid | None:
    for found in boards_in(lattice, target.rows, target.cols):
        board = board_near(image, fill_grid(found * scale + (scale - 1) / 2))
        if board is not None:
            return board.in_order()
    return None


def board_near(image: Grey, grid: Floats | None) -> CheckerboardGrid | None:
    """Return the board whose corners are near a grid."""
    grid = None if grid is None or reaches_outside(image, grid) else _refined(image, grid)
    return None if grid is None else board_at(image, grid)


def _refined(image: Grey, grid: Floats) -> Floats | None:
    """Return the corners to about a tenth of a pixel; None where they do not stay where they belong."""
    height = _square_heights(grid)
    half = int(np.clip(_WINDOW * middle_of(height), _SMALLEST, _LARGEST))
    points = grid.reshape(-1, 2).astype(np.float32)
    limits = [image.shape[1] - 2 * half - 3, image.shape[0] - 2 * half - 3]
    inside = ((points >= half + 1) & (points <= np.add(limits, half + 1))).all(axis=1)
    if inside.sum() < _FEWEST:
        return None
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
    corners = np.ascontiguousarray(points[inside]).reshape(-1, 1, 2)
    moved = points.astype(np.float64)
    moved[inside] = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), stop).reshape(-1, 2)
    far = np.linalg.norm(moved - points, axis=1) > _FARTHEST * height.ravel()
    moved[far] = points[far]
    return None if far.mean() > 0.2 else moved.reshape(grid.shape)


def _square_heights(grid: Floats) -> Floats:
    """Return the least distance of opposite sides of the squares at each corner, (rows, cols) [px]."""
    along_rows, along_cols = grid_steps(grid)
    area = np.abs(along_rows[..., 0] * along_cols[..., 1] - along_rows[..., 1] * along_cols[..., 0])
    longest = np.maximum(np.linalg.norm(along_rows, axis=2), np.linalg.norm(along_cols, axis=2))
    return area / np.maximum(longest, 1e-9)


def measure_corners(image: Grey, board: CheckerboardGrid, lens: LensGuess | None = None) -> BoardView:
    """Measure the corners to sub-pixel accuracy, and leave out those that cannot be trusted.

    Parameters
    ----------
    image : (h, w)
    board : its corners to a pixel
    lens : from the image before
    """
    grid = board.grid
    along_rows, along_cols = grid_steps(grid)
    height = _square_heights(grid).ravel()
    guess = np.ascontiguousarray(grid.reshape(-1, 2))
    dropped: Counter[str] = Counter({SECOND_BOARD: len(guess)} if board.again else {})
    numbers = np.arange(len(guess))
    limits = np.array([image.shape[1] - 1, image.shape[0] - 1]) - BORDER_PX
    inside = ((guess >= BORDER_PX) & (guess <= limits)).all(axis=1)
    crossing = (board.clear | ~board.known).ravel()
    dropped[NEAR_BORDER] = int((~inside).sum())
    dropped["not black and white in turn"] = int((inside & ~crossing).sum())
    numbers = numbers[inside & crossing]
    rows, cols = np.divmod(numbers, grid.shape[1])
    # The wedge between the steps is black at even corners of a board whose first square is.
    sign = np.where(((rows + cols) % 2 == 0) == board.dark, 1.0, -1.0)
    edges = np.stack([along_rows.reshape(-1, 2)[numbers], sign[:, None] * along_cols.reshape(-1, 2)[numbers]], axis=1)
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    fits = fit_corners(image, guess[numbers], edges, _RADIUS * height[numbers])
    near = np.linalg.norm(fits.pixels - guess[numbers], axis=1) < _FARTHEST * height[numbers]
    good = fits.good & near
    dropped[COVERED] = int((~good).sum())
    chosen = fits.only(good)
    if len(chosen) < _FEWEST:
        return nothing_seen(+dropped)
    return view_of(image, numbers[good], np.stack([cols, rows], axis=1)[good], chosen, dropped, lens=lens)


class CheckerboardTracker:
    """Finds a checkerboard in the images of one camera, in the order in which they were taken.

    Corners keep their numbers while the board is followed. Once it was lost its numbers may start from the other end:
    `consistent_order` puts that right.

    Parameters
    ----------
    target : the checkerboard
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        self._small: Grey | None = None
        self._board: CheckerboardGrid | None = None
        self._lens = LensGuess()
        self._move: Floats | float = 0.0
        self._since_search = 0

    def detect(self, image: Grey) -> BoardView:
        """Return the corners in the next image, (h, w) grey levels."""
        small = reduce_image(image, checkerboard_search_scale(image))
        before, board = self._board, self._followed(image, small)
        self._since_search += 1
        if board is None or self._since_search > _SEARCH_EVERY:
            board = self._searched(image, board)
        self._move = 0.0 if board is None or before is None else board.grid - before.grid
        self._small, self._board = small, board
        return nothing_seen() if board is None else measure_corners(image, board, self._lens)

    def _searched(self, image: Grey, followed: CheckerboardGrid | None) -> CheckerboardGrid | None:
        """Return the board as a search finds it, numbered as the one that was followed where both agree."""
        self._since_search = 0
        found = find_board(image, self._target)
        if followed is None or (found is not None and not _same_places(found.grid, followed.grid)):
            return found
        return followed

    def _followed(self, image: Grey, small: Grey) -> CheckerboardGrid | None:
        """Return the board of the image before where it is now; None where that is not certain."""
        before = self._board
        if before is None or self._small is None or self._small.shape != small.shape:
            return None
        scale = checkerboard_search_scale(image)
        corners = before.grid.reshape(-1, 2)
        guess = (before.grid + self._move).reshape(-1, 2)
        now, carried = carry_corners(self._small, small, corners, guess, scale)
        if carried.mean() < _FOLLOWED:
            return None
        places = np.where(carried[:, None], now, np.nan)
        grid = fill_grid(places.reshape(before.grid.shape))
        board = board_near(image, grid)
        if grid is None or board is None or board.dark != before.dark:
            return None
        # A mirrored board would have been turned over.
        first, last = np.linalg.norm(board.grid[0, 0] - grid[[0, -1], 0], axis=1)
        return board if first < last else None


def _same_places(first: Floats, second: Floats) -> bool:
    """Tell whether two grids have their corners in the same places, whatever the order."""
    apart = squared_distances(first.reshape(-1, 2), second.reshape(-1, 2))
    return bool(apart.min(axis=0).max() < _SAME_PX**2)
