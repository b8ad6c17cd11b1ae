"""The gap between the tags of a board, as the images themselves tell it."""

from collections.abc import Sequence

import numpy as np

from ...models.target import Target
from ...recording import Floats
from .board import BoardView

_FEWEST = 20


def tag_spacing(views: Sequence[BoardView], target: Target) -> float | None:
    """Return the gap between neighbouring tags over the side of a tag; None where too few neighbours are seen.

    The sides of two tags in a row lie on a line, at 0, 1, 1 + s and 2 + s. Whatever the perspective, the cross ratio
    of their four ends is (1 + s)^2 / (s^2 + 2 s); no lens and no pose is needed.

    Parameters
    ----------
    views : of the board, an aprilgrid
    target : the board, whose numbers of rows and columns count
    """
    found = np.concatenate([_spacings(view, target) for view in views]) if views else np.empty(0)
    return float(np.median(found)) if len(found) >= _FEWEST else None


def _spacings(view: BoardView, target: Target) -> Floats:
    width, height = 2 * target.cols, 2 * target.rows
    grid = np.full((height, width, 2), np.nan)
    grid[np.divmod(view.point, width)] = view.pixels
    along_rows = np.stack([grid[:, k : width - 3 + k : 2] for k in range(4)], axis=2).reshape(-1, 4, 2)
    along_cols = np.stack([grid[k : height - 3 + k : 2] for k in range(4)], axis=2).reshape(-1, 4, 2)
    four = np.concatenate([along_rows, along_cols])
    four = four[np.isfinite(four).all(axis=(1, 2))]
    direction = four[:, 3] - four[:, 0]
    length = np.linalg.norm(direction, axis=1)
    at = np.einsum("nkj,nj->nk", four - four[:, :1], direction / np.maximum(length, 1e-9)[:, None])
    ratio = (at[:, 2] - at[:, 0]) * (at[:, 3] - at[:, 1]) / ((at[:, 2] - at[:, 1]) * (at[:, 3] - at[:, 0]))
    ratio = ratio[np.isfinite(ratio) & (ratio > 1)]
    return np.sqrt(ratio / (ratio - 1)) - 1
