"""Calibration boards as Kalibr's target.yaml describes them: which points they carry, in which order.

The board's frame is the world of a camera calibration; z = 0 on the board.

    aprilgrid     tags of 4 corners, ids row by row from the lower left; x right, y up, z to the viewer. The points are
                  numbered along rows of 2 cols corners, from the lowest row up, from left to right. A tag's number on
                  the board counts from 0; the id that is printed is that number plus first_tag.
    checkerboard  inner corners; point r cols + c is at (r row_spacing, c col_spacing, 0).
    circlegrid    centres; point r cols + c is at (r spacing, c spacing, 0), and on the asymmetric grid at
                  ((2 c + r mod 2) spacing, r spacing, 0).
    charuco       inner corners of a chessboard whose white squares carry ArUco markers, as OpenCV has it: numbered
                  along rows of cols - 1 corners, from the uppermost row down, from left to right (OpenCV's ids); x
                  right, y up, z to the viewer, from the lower left inner corner. The markers are numbered along the
                  rows of squares from the upper left, from first_tag.
    landmarks     no board, but points of a scene that were mapped from images; axes and origin are any.
"""

from dataclasses import field
from math import isfinite
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, RecordingError
from ..frozen import value_class

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
TargetKind = Literal["aprilgrid", "checkerboard", "circlegrid", "charuco", "landmarks"]

_FEWEST = {"aprilgrid": 1, "checkerboard": 2, "circlegrid": 2, "charuco": 3, "landmarks": 1}
_LENGTHS = {
    "aprilgrid": ("tag_size_m", "tag_spacing"),
    "checkerboard": ("row_spacing_m", "col_spacing_m"),
    "circlegrid": ("spacing_m",),
    "charuco": ("square_size_m", "marker_size_m"),
    "landmarks": (),
}


@value_class
class Target:
    """A calibration board; made by `Target.aprilgrid`, `.checkerboard`, `.circlegrid` or `.charuco`.

    Attributes
    ----------
    kind : "aprilgrid", "checkerboard", "circlegrid", "charuco", or "landmarks" of a scene without a board
    cols, rows : number of tags, of inner corners, of circles or of the squares of a ChArUco board
    tag_size_m : side of a tag (aprilgrid) [m]
    tag_spacing : gap between two tags over the side of a tag (aprilgrid)
    border_bits : width of the black border of a tag in units of its code's cells (aprilgrid); Kalibr prints 2, with
        black squares between the corners of the tags, other tools 1, without
    first_tag : id printed on the tag at the lower left (aprilgrid), or on the first marker, at the upper left (charuco)
    row_spacing_m, col_spacing_m : distance between rows and between columns (checkerboard) [m]
    spacing_m : distance between circles (circlegrid) [m]; on the asymmetric grid that between rows, and half of that
        between neighbours in a row
    asymmetric : whether every other row of circles is shifted (circlegrid)
    square_size_m, marker_size_m : side of a square and of the marker in it (charuco) [m]
    dictionary : OpenCV's name of the markers without "DICT_", such as "4X4_50" (charuco)
    places : (n, 3) of landmarks, roughly [m]
    legacy : whether the square at the upper left is white where the number of rows is even, as OpenCV before 4.6 had
        it; otherwise it is always black (charuco)
    points : (n, 3) the points in the board's frame, in Kalibr's order [m]; follows from the rest

    Raises
    ------
    OptionError
        If a number of rows or columns is too small, a length is not greater than zero, or there are no such tags.

    Examples
    --------
    >>> board = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
    >>> print(board.describe())
    AprilGrid 6 x 6, tags of 88 mm, gap 26.4 mm
    >>> board.points[[0, 1, 12]].tolist()
    [[0.0, 0.0, 0.0], [0.088, 0.0, 0.0], [0.0, 0.088, 0.0]]
    >>> board.point_of_tag_corner([0, 1], [3, 0]).tolist()
    [12, 2]
    """

    kind: TargetKind
    cols: int
    rows: int
    tag_size_m: float = 0.0
    tag_spacing: float = 0.0
    border_bits: Literal[1, 2] = 2
    first_tag: int = 0
    row_spacing_m: float = 0.0
    col_spacing_m: float = 0.0
    spacing_m: float = 0.0
    asymmetric: bool = False
    square_size_m: float = 0.0
    marker_size_m: float = 0.0
    dictionary: str = ""
    legacy: bool = False
    places: Floats | None = field(default=None, repr=False)
    points: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.kind not in _FEWEST:
            raise OptionError(f"there is no target {self.kind!r}; it must be one of {', '.join(_FEWEST)}.")
        for name in ("cols", "rows"):
            count = getattr(self, name)
            if not (float(count).is_integer() and count >= _FEWEST[self.kind]):
                raise OptionError(
                    f"{name} {count:g} of the {self.kind} must be a whole number of at least {_FEWEST[self.kind]}."
                )
            object.__setattr__(self, name, int(count))
        for name in _LENGTHS[self.kind]:
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise OptionError(f"{name} {value:g} of the {self.kind} must be a finite number greater than zero.")
        if self.border_bits not in (1, 2):
            raise OptionError(f"border_bits {self.border_bits!r} of the {self.kind} must be 1 or 2.")
        if not (float(self.first_tag).is_integer() and self.first_tag >= 0):
            raise OptionError(f"first_tag {self.first_tag!r} of the {self.kind} must be a whole number from 0.")
        for name in ("border_bits", "first_tag"):
            object.__setattr__(self, name, int(getattr(self, name)))
        if self.kind == "charuco" and not self.marker_size_m < self.square_size_m:
            raise OptionError(
                f"marker_size_m {self.marker_size_m:g} of the charuco must be less than square_size_m "
                f"{self.square_size_m:g}, the side of the square around it."
            )
        object.__setattr__(self, "points", self._points())

    @classmethod
    def aprilgrid(
        cls,
        *,
        tag_cols: int,
        tag_rows: int,
        tag_size_m: float,
        tag_spacing: float,
        border_bits: Literal[1, 2] = 2,
        first_tag: int = 0,
    ) -> Self:
        """Return a grid of AprilTags; `tag_spacing` is the gap between two tags over the side of a tag.

        A board as Kalibr prints it has `border_bits` 2; a grid of plain AprilTags has 1. The id that is printed on the
        tag at the lower left is `first_tag`.
        """
        return cls(
            kind="aprilgrid",
            cols=tag_cols,
            rows=tag_rows,
            tag_size_m=tag_size_m,
            tag_spacing=tag_spacing,
            border_bits=border_bits,
            first_tag=first_tag,
        )

    @classmethod
    def checkerboard(cls, *, cols: int, rows: int, row_spacing_m: float, col_spacing_m: float) -> Self:
        """Return a checkerboard; `cols` and `rows` count its inner corners."""
        return cls(kind="checkerboard", cols=cols, rows=rows, row_spacing_m=row_spacing_m, col_spacing_m=col_spacing_m)

    @classmethod
    def circlegrid(cls, *, cols: int, rows: int, spacing_m: float, asymmetric: bool = False) -> Self:
        """Return a grid of circles."""
        return cls(kind="circlegrid", cols=cols, rows=rows, spacing_m=spacing_m, asymmetric=asymmetric)

    @classmethod
    def charuco(
        cls,
        *,
        cols: int,
        rows: int,
        square_size_m: float,
        marker_size_m: float,
        dictionary: str = "4X4_50",
        first_marker: int = 0,
        legacy: bool = False,
    ) -> Self:
        """Return a ChArUco board; `cols` and `rows` count its squares, as OpenCV's squaresX and squaresY do."""
        return cls(
            kind="charuco",
            cols=cols,
            rows=rows,
            square_size_m=square_size_m,
            marker_size_m=marker_size_m,
            dictionary=dictionary,
            first_tag=first_marker,
            legacy=legacy,
        )

    @classmethod
    def landmarks(cls, places: Floats) -> Self:
        """Return points (n, 3) of a scene [m]; where they truly are is to be estimated."""
        return cls(kind="landmarks", cols=len(places), rows=1, places=places)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent of the points along x and y [m]."""
        x, y, _ = np.ptp(self.points, axis=0)
        return float(x), float(y)

    @property
    def tags(self) -> int:
        """Number of tags; zero unless the board is an aprilgrid."""
        return self.cols * self.rows if self.kind == "aprilgrid" else 0

    def describe(self) -> str:
        """Return the board in a few words, such as "AprilGrid 6 x 6, tags of 88 mm, gap 26.4 mm"."""
        if self.kind == "landmarks":
            return f"{len(self)} landmarks of the scene"
        grid = f"{self.cols} x {self.rows}"
        if self.kind == "aprilgrid":
            gap = self.tag_spacing * self.tag_size_m
            plain = ", plain tags with a border of 1 bit" if self.border_bits == 1 else ""
            first = f", ids from {self.first_tag}" if self.first_tag else ""
            return f"AprilGrid {grid}, tags of {_millimetres(self.tag_size_m)}, gap {_millimetres(gap)}{plain}{first}"
        if self.kind == "checkerboard":
            row, col = _millimetres(self.row_spacing_m), _millimetres(self.col_spacing_m)
            squares = f"squares of {row}" if row == col else f"rows {row}, columns {col} apart"
            return f"Checkerboard {grid} inner corners, {squares}"
        if self.kind == "charuco":
            square, marker = _millimetres(self.square_size_m), _millimetres(self.marker_size_m)
            first = f", ids from {self.first_tag}" if self.first_tag else ""
            old = ", as OpenCV before 4.6 drew it" if self.legacy else ""
            return f"ChArUco {grid} squares of {square}, markers {self.dictionary} of {marker}{first}{old}"
        kind = "Asymmetric circle grid" if self.asymmetric else "Circle grid"
        return f"{kind} {grid}, spacing {_millimetres(self.spacing_m)}"

    def point_of_tag_corner(self, tag_id: ArrayLike, corner_idx: ArrayLike) -> Integers:
        """Return the numbers of the points at corners of tags.

        Parameters
        ----------
        tag_id : (m,) tag, from 0, also where other ids are printed (`first_tag`)
        corner_idx : (m,) its corner 0..3, counter-clockwise from the lower left

        Raises
        ------
        OptionError
            If the board has no tags.
        RecordingError
            If a tag or a corner is not on the board.
        """
        if self.kind != "aprilgrid":
            raise OptionError(f"a {self.kind} has no tags; its corners are numbered as points.")
        tag, corner = np.broadcast_arrays(np.asarray(tag_id, dtype=np.int64), np.asarray(corner_idx, dtype=np.int64))
        strange = (tag < 0) | (tag >= self.tags) | (corner < 0) | (corner > 3)
        if strange.any():
            k = int(np.argmax(strange.ravel()))
            raise RecordingError(
                f"corner {corner.ravel()[k]} of tag {tag.ravel()[k]} is not on the board: it has tags 0 to "
                f"{self.tags - 1}, with corners 0 to 3."
            )
        tag_row, tag_col = np.divmod(tag, self.cols)
        upper = corner >= 2
        right = (corner == 1) | (corner == 2)
        return (2 * tag_row + upper) * (2 * self.cols) + 2 * tag_col + right

    def _points(self) -> Floats:
        """Return the points (n, 3), read-only."""
        if self.kind == "landmarks":
            points = np.array(self.places, dtype=np.float64)
            points.flags.writeable = False
            return points
        if self.kind == "charuco":
            row, col = np.divmod(np.arange((self.rows - 1) * (self.cols - 1)), self.cols - 1)
            points = self.square_size_m * np.column_stack([col, self.rows - 2 - row, np.zeros_like(row)])
            points.flags.writeable = False
            return points
        per_tag = 2 if self.kind == "aprilgrid" else 1
        row, col = np.divmod(np.arange(per_tag * self.rows * per_tag * self.cols), per_tag * self.cols)
        points = np.zeros((len(row), 3))
        if self.kind == "aprilgrid":
            for axis, index in enumerate((col, row)):
                points[:, axis] = self.tag_size_m * ((1 + self.tag_spacing) * (index // 2) + index % 2)
        elif self.kind == "checkerboard":
            points[:, 0], points[:, 1] = self.row_spacing_m * row, self.col_spacing_m * col
        elif self.asymmetric:
            points[:, 0], points[:, 1] = self.spacing_m * (2 * col + row % 2), self.spacing_m * row
        else:
            points[:, 0], points[:, 1] = self.spacing_m * row, self.spacing_m * col
        points.flags.writeable = False
        return points


def _millimetres(length_m: float) -> str:
    return f"{1000 * length_m:.5g} mm"
