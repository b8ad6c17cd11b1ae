"""What one image shows of a calibration board."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from ...frozen import FrozenMapping, value_class
from ...models.target import Target
from ...recording import Floats, Integers, frozen_array

NOT_WITH_NEIGHBOURS = "not where its neighbours say"
"""Reason for which corners of tags are left out."""

SECOND_BOARD = "on a second board like the stated one"
"""Reason for which all corners of the other board are left out where an image shows two of them."""

DIFFERS = "The stated board differs"
"""Where this is said of images, they show an AprilGrid that is not the stated one."""

_AT_ONCE = 256  # views
_FEWEST_GAPS = 20
_ABOVE = 0.37  # of the way to the right: boards in a column have an order, too
_UPRIGHT = 0.5
_IMAGE_RIGHT, _IMAGE_UP = np.array([[1.0, 0.0]]), np.array([[0.0, -1.0]])


@value_class
class BoardView:
    """The corners of a board that were found in one image.

    Attributes
    ----------
    point : (m,) number on the target, as `Target.points` counts; ascending, each once
    pixels : (m, 2) [px]; (0, 0) is the centre of the top left pixel
    sigma_px : (m,) standard deviation per axis [px]
    blur_px : standard deviation of the blur at the corners, their median [px]; nan where none was found
    black, white : grey levels of the board, medians; nan where it was not found
    dropped : reason -> number of corners that were found and left out
    """

    point: Integers
    pixels: Floats
    sigma_px: Floats
    blur_px: float = float("nan")
    black: float = float("nan")
    white: float = float("nan")
    dropped: Mapping[str, int] = field(default_factory=Counter[str])

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, np.int64))
        object.__setattr__(self, "pixels", frozen_array(self.pixels))
        object.__setattr__(self, "sigma_px", frozen_array(self.sigma_px))
        object.__setattr__(self, "dropped", FrozenMapping(self.dropped))

    def __len__(self) -> int:
        return len(self.point)


def nothing_seen(dropped: Mapping[str, int] | None = None) -> BoardView:
    """Return the view of an image in which the board was not found."""
    none = np.empty(0)
    return BoardView(point=np.empty(0, np.int64), pixels=none.reshape(0, 2), sigma_px=none, dropped=dropped or {})


def comes_first(middle: Floats, other: Floats, right: Floats = _IMAGE_RIGHT, up: Floats = _IMAGE_UP) -> bool:
    """Return whether of two boards alike one is that which has the other to its right: the same one in each image.

    Parameters
    ----------
    middle, other : (2,) of the board, and of the one like it [px]
    right, up : (k, 2) ways in the image by what is printed on both, of equal lengths or nearly; those of the image are
        taken where nothing is given, and where one board hangs upside down
    """
    way = (right + _ABOVE * up).mean(axis=0)
    if np.linalg.norm(way) < _UPRIGHT * np.linalg.norm(right, axis=1).mean():
        way = _IMAGE_RIGHT[0] + _ABOVE * _IMAGE_UP[0]
    return float((other - middle) @ way) > 0


def middle_of(values: Floats) -> float:
    """Return the median, of an even number of values the upper one; nan of none."""
    place = values.size // 2
    return float(np.partition(values, place, axis=None)[place]) if values.size else float("nan")


def tag_spacing(views: Sequence[BoardView], target: Target) -> float | None:
    """Return the gap between neighbouring tags over the side of a tag; None where too few neighbours are seen.

    The sides of two tags in a row lie on a line, at 0, 1, 1 + s and 2 + s. Whatever the perspective, the cross ratio
    of their four ends is (1 + s)^2 / (s^2 + 2 s); no lens and no pose is needed.

    Parameters
    ----------
    views : of the board, an aprilgrid
    target : the board, whose numbers of rows and columns count
    """
    parts = (views[first : first + _AT_ONCE] for first in range(0, len(views), _AT_ONCE))
    found = np.concatenate([np.empty(0), *(_spacings(part, target) for part in parts)])
    return float(np.median(found)) if len(found) >= _FEWEST_GAPS else None


def _spacings(views: Sequence[BoardView], target: Target) -> Floats:
    width, height = 2 * target.cols, 2 * target.rows
    grid = np.full((len(views), height, width, 2), np.nan)
    for own, view in zip(grid, views, strict=True):
        own[np.divmod(view.point, width)] = view.pixels
    along_rows = np.stack([grid[:, :, k : width - 3 + k : 2] for k in range(4)], axis=3).reshape(-1, 4, 2)
    along_cols = np.stack([grid[:, k : height - 3 + k : 2] for k in range(4)], axis=3).reshape(-1, 4, 2)
    four = np.concatenate([along_rows, along_cols])
    four = four[np.isfinite(four).all(axis=(1, 2))]
    direction = four[:, 3] - four[:, 0]
    length = np.linalg.norm(direction, axis=1)
    at = np.einsum("nkj,nj->nk", four - four[:, :1], direction / np.maximum(length, 1e-9)[:, None])
    ratio = (at[:, 2] - at[:, 0]) * (at[:, 3] - at[:, 1]) / ((at[:, 2] - at[:, 1]) * (at[:, 3] - at[:, 0]))
    ratio = ratio[np.isfinite(ratio) & (ratio > 1)]
    return np.sqrt(ratio / (ratio - 1)) - 1
