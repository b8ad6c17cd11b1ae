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

from ...models.target import Target
from ...recording import Floats
from ...recording.frames import Grey
from ..corners.corner_fit import fit_corners
from .board import SECOND_BOARD, BoardView, comes_first, middle_of, nothing_seen
from .checkerboard_grid import CheckerboardGrid, board_at, boards_in, fill_grid, grid_steps, reaches_outside
from .lattice import Lattice, carry_corners, find_lattices, find_saddles, squared_distances
from .marker_boards import BORDER_PX, COVERED, NEAR_BORDER, view_of
from .plane_map import LensGuess

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
