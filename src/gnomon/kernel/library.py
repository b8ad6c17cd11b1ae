"""The compiled loops of images and of cameras with an IMU, called through ctypes: only where `load_kernel` found them.

Those of samples stand with the one module that calls each.
"""

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from . import array_in, array_out, c_long, load_kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

Singles = NDArray[np.float32]

MOST_PIXELS = 512
"""Of the window of a corner (PIXELS in kernel.c)."""
MOST_COLUMNS = 64
"""Of a corner (WIDTH in kernel.c)."""
MOST_INERTIAL = 168
"""Of a reading (INERTIAL in kernel.c)."""

BLOCKS = (
    *("S_g", "M_g", "q_bg", "B_g", "S_a", "M_a", "lever_arms", "T_imu_body.rotation", "T_imu_body.translation"),
    *("time_shift", "accelerometer_shift", "gravity.direction", "gravity.magnitude", "side"),
)
"""The fields of Blocks in kernel.c, in their order."""


class Readings(ctypes.Structure):
    """The struct of this name in kernel.c, of arrays that live as long as this."""

    _fields_ = (
        ("order", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("first", "u", "segment", "references", "bases", "controls")),
        *((name, ctypes.c_int64) for name in ("scalars", "bias_at", "offset")),
        ("spacing", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("imu", "blocks", "read_g", "weight_g", "read_a", "weight_a", "sign")),
    )

    def __init__(
        self,
        *,
        places: tuple[Integers, Floats, Integers],
        references: Floats,
        bases: Floats,
        controls: Floats,
        bias_at: int,
        bias_offset: int,
        spacing_s: float,
        imu: Floats,
        blocks: Sequence[int],
        gyroscope: tuple[Floats, Floats] | None,
        accelerometer: tuple[Floats, Floats] | None,
        signs: Floats | None,
    ) -> None:
        """Take what the rows of readings need; see `InertialTerms`.

        Parameters
        ----------
        places : first control point, u and segment (n,) of the readings on the grid
        references : (s, 3, 3) of the segments
        bases : (4, k, k) basis functions and three derivatives by time, by powers of u
        controls : (c, d), bias_at, bias_offset, spacing_s : of the trajectory; first bias of this IMU, and of a span
        imu : the fields of Imu in kernel.c, one behind the other
        blocks : first columns of `BLOCKS` in the rows, or -1
        gyroscope, accelerometer : readings (n, 3) and weights (n,), or None
        signs : (n, 6 or 3) of the probes
        """
        (read_g, weight_g), (read_a, weight_a) = gyroscope or (None, None), accelerometer or (None, None)
        before = map(array_in, (*places, references, bases, controls))
        behind = map(array_in, (imu, np.array(blocks, dtype=np.int64), read_g, weight_g, read_a, weight_a, signs))
        self._kept = [*before], [*behind]
        super().__init__(
            *(bases.shape[1], *self._kept[0], controls.shape[1], bias_at, bias_offset, spacing_s, *self._kept[1])
        )
        self.count = len(places[1])
        self.height = 3 * ((gyroscope is not None) + (accelerometer is not None))


class Band(ctypes.Structure):
    """The struct of this name in kernel.c, of arrays that live as long as this."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("order", "offset", "scalars", "length", "bias_at")),
        *((name, ctypes.c_void_p) for name in ("pose_pose", "pose_bias", "bias_pose", "bias_bias", "tail", "columns")),
    )

    def __init__(
        self,
        *,
        order: int,
        bias_offset: int,
        band: Sequence[Floats | None],
        tail: Floats,
        bias_at: int,
        columns: Integers,
    ) -> None:
        """Take normal equations to which products of rows are added in place; see the assembly.

        Parameters
        ----------
        order : of the splines
        bias_offset : of a span's first bias knot from it
        band : pose by pose, pose by bias, bias by pose, bias by bias, (n, 6, k, 6) each; None without biases
        tail : (n, d, t), bias_at : first scalar of the biases, columns : (w - b,) in the tail
        """
        self._kept = [*map(array_out, (*band, tail)), array_in(columns)]
        super().__init__(order, bias_offset, tail.shape[1], tail.shape[2], bias_at, *self._kept)
        self.rest = len(columns)


def inertial_rows(readings: Readings, width: int) -> tuple[Floats, Floats]:
    """Return rows (n, 6 or 3, width) of readings, and the sums of squared residuals (2,)."""
    library = load_kernel()
    assert library is not None
    rows, chi2 = np.empty((readings.count, readings.height, width)), np.zeros(2)
    library.gnomon_inertial_rows(
        c_long(readings.count), ctypes.byref(readings), c_long(width), array_out(rows), array_out(chi2)
    )
    return rows, chi2


def add_inertial_sums(readings: Readings, width: int, band: Band) -> tuple[Floats, Floats]:
    """Add the products of the rows of readings; return those of the last columns, and the sums of squared residuals."""
    library = load_kernel()
    assert library is not None
    last = band.rest
    products, chi2 = np.zeros((last, last)), np.zeros(2)
    library.gnomon_inertial_sums(
        *(c_long(readings.count), ctypes.byref(readings), c_long(width), ctypes.byref(band)),
        array_out(products),
        array_out(chi2),
    )
    return products, chi2


def add_corner_sums(
    *,
    start: Integers,
    pose: tuple[Floats, Floats],
    points: Floats,
    pixels: Floats,
    lens: Floats,
    own: Integers,
    scale: float,
    scale_column: bool,
    shape: Floats | None,
    spread: Floats | None,
    sign: Floats | None,
    sigma_px: float,
    huber: float,
    sums: Floats,
    of_exposure: tuple[Floats, Floats, Integers],
    of_corner: tuple[Floats, Floats, Floats],
    offsets: tuple[Integers, NDArray[np.bool_], Floats, Floats, Floats] | None,
) -> None:
    """Sum up the corners of exposures, in place; see `corner_sums` of the estimation, and kernel.c.

    Parameters
    ----------
    start : (e + 1,) first corner of each exposure
    pose : R_cam_target (e, 3, 3), p_cam_target (e, 3)
    points, pixels : of the corners, (m, 3), (m, 2)
    lens : the fields of Lens in kernel.c
    own : which parameters have columns
    scale, scale_column, shape, spread, sign, sigma_px, huber : see there; None where not wanted
    sums : (e, w, w) or (e, 2, w)
    of_exposure : cost, mean square, number of valid corners (e,)
    of_corner : robust cost, robust weight (m,), residual (m, 2)
    offsets : number and whether it counts (m,); products with the twist (m, 6, 3), with the other columns
        (w - 6, k, 3) and with each other (k, 3, 3), to which they are added
    """
    library = load_kernel()
    assert library is not None
    number, counted, by_twist, rest, squares = offsets or (None,) * 5
    library.gnomon_corner_sums(
        *(c_long(len(start) - 1), c_long(len(points)), *map(array_in, (start, *pose, points, pixels, lens, own))),
        *(c_long(len(own)), ctypes.c_double(scale), c_long(scale_column), array_in(shape)),
        *(c_long(0 if shape is None else len(shape)), array_in(spread), array_in(sign), ctypes.c_double(sigma_px)),
        *(ctypes.c_double(huber), c_long(sums.shape[1] != sums.shape[2]), array_out(sums)),
        *(*map(array_out, of_exposure), *map(array_out, of_corner), *map(array_in, (number, counted))),
        *(c_long(0 if squares is None else len(squares)), *map(array_out, (by_twist, rest, squares))),
    )


def add_spans(sums: Floats, spans: Integers, band: Band) -> None:
    """Add the products (s, b, w) of the rows of spans (s,), their first control points."""
    library = load_kernel()
    assert library is not None
    library.gnomon_add_spans(
        c_long(len(spans)), c_long(sums.shape[2]), array_in(sums), array_in(spans), ctypes.byref(band)
    )


def gather_tied(
    *,
    per_block: int,
    offset: int,
    groups: Sequence[int],
    band: Sequence[Sequence[Floats]],
    tail: Floats,
    lower: Floats,
    chain: Floats,
) -> None:
    """Write tied equations, in place; see `TiedLayout.gather` and kernel.c.

    Parameters
    ----------
    per_block, offset, groups, band, lower, chain : see there
    tail : (n, d, t) what stands beside the band
    """
    library = load_kernel()
    assert library is not None
    pointers = [array_in(part) for row in band for part in row]
    library.gnomon_gather_tied(
        *map(c_long, (len(tail), per_block, band[0][0].shape[2], offset, len(groups))),
        *(
            array_in(np.array(groups, dtype=np.int64)),
            (ctypes.c_void_p * len(pointers))(*(one.value for one in pointers)),
        ),
        *(array_in(tail), c_long(tail.shape[2]), array_out(lower), array_out(chain)),
    )


def descend_corners(
    windows: tuple[Singles, Singles, Singles], *, tip: bool, rules: Floats, active: NDArray[np.bool_], states: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit corners to their windows; see `_descend` of the corner fit.

    Parameters
    ----------
    windows : values (m, n), places (m or 1, 3, n), and weights (m, n) of the pixels
    tip : whether one black wedge ends there, rather than two that meet
    rules : the fields of CornerRules in kernel.c, one behind the other
    active : (m,) which corners are fitted
    states : (m, 9), changed in place

    Returns
    -------
    tuple of numpy.ndarray
        Covariances of the offsets (m, 2, 2), variances of the residuals (m,), moves by what is left out (m, 2, 2) each.
    """
    library = load_kernel()
    assert library is not None
    values, places, weights = windows
    found = np.zeros((3, len(states), 2, 2))
    variance = np.full(len(states), np.inf)
    library.gnomon_descend_corners(
        *(
            c_long(len(values)),
            c_long(values.shape[1]),
            c_long(len(places) == 1),
            array_in(values),
            array_in(places),
            array_in(weights),
        ),
        *(
            c_long(tip),
            array_in(rules),
            array_in(active),
            array_out(states),
            array_out(found[0]),
            array_out(variance),
            array_out(found[1]),
        ),
        array_out(found[2]),
    )
    return found[0], variance, found[1], found[2]


def solve_homography(points: Floats, pixels: Floats) -> Floats:
    """Return the homography (3, 3) from points (m, 2) to pixels (m, 2); see there, in the places of tags."""
    library = load_kernel()
    assert library is not None
    found = np.empty((3, 3))
    points, pixels = np.ascontiguousarray(points), np.ascontiguousarray(pixels)
    library.gnomon_fit_homography(c_long(len(points)), array_in(points), array_in(pixels), array_out(found))
    return found


def undo_png_filters(rows: bytes, width: int, height: int) -> NDArray[np.uint8] | None:
    """Return the pixels (height, width) of a PNG of one byte each; None where a row has a filter that does not exist.

    Parameters
    ----------
    rows : each with the number of its filter before its bytes, `height * (width + 1)` in all
    """
    library = load_kernel()
    assert library is not None
    assert len(rows) == height * (width + 1)
    found = np.empty((height, width), dtype=np.uint8)
    strange = library.gnomon_undo_png_filters(c_long(height), c_long(width), ctypes.c_char_p(rows), array_out(found))
    return None if strange else found
