"""The compiled loops, called through ctypes: only where `load_kernel` found them."""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import load_kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

Singles = NDArray[np.float32]

MOST_PIXELS = 512
"""Of the window of a corner (PIXELS in kernel.c)."""
ALLAN_SHORT = 12
"""Of averaging times that are summed up as the samples come (SHORT in kernel.c)."""
MOST_COLUMNS = 64
"""Of a corner (WIDTH in kernel.c)."""
MOST_INERTIAL = 168
"""Of a reading (INERTIAL in kernel.c)."""

_NEAR = 16_384  # numbers that the processor keeps near

BLOCKS = (
    *("S_g", "M_g", "q_bg", "B_g", "S_a", "M_a", "lever_arms", "T_imu_body.rotation", "T_imu_body.translation"),
    *("time_shift", "accelerometer_shift", "gravity.direction", "gravity.magnitude", "side"),
)
"""The fields of Blocks in kernel.c, in their order."""


class _Pointer(ctypes.c_void_p):
    """Where an array begins, which lives as long as this."""

    def __init__(self, array: NDArray[np.generic]) -> None:
        super().__init__(array.__array_interface__["data"][0])
        self.array = array


def _at(array: NDArray[np.generic] | None) -> ctypes.c_void_p:
    """Return where what is only read begins: an array, or a contiguous copy that lives as long as this."""
    return ctypes.c_void_p() if array is None else _out(np.ascontiguousarray(array))


def _out(array: NDArray[np.generic] | None) -> ctypes.c_void_p:
    """Return where an array begins that is written to; `data_as` of NumPy's takes ten times as long."""
    assert array is None or array.flags.c_contiguous
    return ctypes.c_void_p() if array is None else _Pointer(array)


def _long(value: int) -> ctypes.c_int64:
    return ctypes.c_int64(value)


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
        before = map(_at, (*places, references, bases, controls))
        behind = map(_at, (imu, np.array(blocks, dtype=np.int64), read_g, weight_g, read_a, weight_a, signs))
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
        self._kept = [*map(_out, (*band, tail)), _at(columns)]
        super().__init__(order, bias_offset, tail.shape[1], tail.shape[2], bias_at, *self._kept)
        self.rest = len(columns)


def inertial_rows(readings: Readings, width: int) -> tuple[Floats, Floats]:
    """Return rows (n, 6 or 3, width) of readings, and the sums of squared residuals (2,)."""
    library = load_kernel()
    assert library is not None
    rows, chi2 = np.empty((readings.count, readings.height, width)), np.zeros(2)
    library.gnomon_inertial_rows(_long(readings.count), ctypes.byref(readings), _long(width), _out(rows), _out(chi2))
    return rows, chi2


def add_inertial_sums(readings: Readings, width: int, band: Band) -> tuple[Floats, Floats]:
    """Add the products of the rows of readings; return those of the last columns, and the sums of squared residuals."""
    library = load_kernel()
    assert library is not None
    last = band.rest
    products, chi2 = np.zeros((last, last)), np.zeros(2)
    library.gnomon_inertial_sums(
        *(_long(readings.count), ctypes.byref(readings), _long(width), ctypes.byref(band)), _out(products), _out(chi2)
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
        *(_long(len(start) - 1), _long(len(points)), *map(_at, (start, *pose, points, pixels, lens, own))),
        *(_long(len(own)), ctypes.c_double(scale), _long(scale_column), _at(shape)),
        *(_long(0 if shape is None else len(shape)), _at(spread), _at(sign), ctypes.c_double(sigma_px)),
        *(ctypes.c_double(huber), _long(sums.shape[1] != sums.shape[2]), _out(sums)),
        *(*map(_out, of_exposure), *map(_out, of_corner), *map(_at, (number, counted))),
        *(_long(0 if squares is None else len(squares)), *map(_out, (by_twist, rest, squares))),
    )


def add_spans(sums: Floats, spans: Integers, band: Band) -> None:
    """Add the products (s, b, w) of the rows of spans (s,), their first control points."""
    library = load_kernel()
    assert library is not None
    library.gnomon_add_spans(_long(len(spans)), _long(sums.shape[2]), _at(sums), _at(spans), ctypes.byref(band))


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
    pointers = [_at(part) for row in band for part in row]
    library.gnomon_gather_tied(
        *map(_long, (len(tail), per_block, band[0][0].shape[2], offset, len(groups))),
        *(_at(np.array(groups, dtype=np.int64)), (ctypes.c_void_p * len(pointers))(*(one.value for one in pointers))),
        *(_at(tail), _long(tail.shape[2]), _out(lower), _out(chain)),
    )


def integrate_segments(
    lengths: Integers, omega: Floats, dt_s: Floats, regressors: Floats | None
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and sensitivities (m, 3, 3, 7) of segments; see `integrate_rates` of the estimation.

    Parameters
    ----------
    lengths : (m,) samples of the segments
    omega, dt_s, regressors : (n, 3) [rad/s], (n,) [s], (n, 7) or None: of the samples
    """
    library = load_kernel()
    assert library is not None
    rotation, sensitivity = np.empty((len(lengths), 3, 3)), np.empty((len(lengths), 3, 3, 7))
    library.gnomon_integrate_rates(
        *(_long(len(lengths)), *map(_at, (lengths, omega, dt_s, regressors)), _out(rotation), _out(sensitivity))
    )
    return rotation, sensitivity


def allan_short(values: Floats, zero: Floats, count: int, stride: int) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return sums of the first samples (n, 3) about a zero (3,); the first `count` begin a term.

    Returns
    -------
    the sums of the first 0, 2^12, 2 2^12, ... samples (k, 3) and of the first `count` (3,), those of z_m^2 (3, k) for
    1, 2, 4, ... samples averaged, those of the first `count` sums (3,), and those of `stride` samples each (k, 3)
    """
    library = load_kernel()
    assert library is not None
    row = 1 << ALLAN_SHORT
    marks, end, line = np.empty((count // row + 1, 3)), np.empty(3), np.zeros(3)
    squares, thinned = np.zeros((3, ALLAN_SHORT)), np.empty((count // stride if stride > 1 else 0, 3))
    step, across = (_long(stride // values.itemsize) for stride in values.strides)
    library.gnomon_allan_short(
        *(_long(len(values)), ctypes.c_void_p(values.ctypes.data), step, across, _at(zero), _long(count)),
        *(_long(stride), *map(_out, (marks, end, squares, line, thinned, np.empty(3 * (3 * row + 8) + 8)))),
    )
    return marks, end, squares, line, thinned


def allan_long(samples: Sequence[Floats], marks: Floats, zero: Floats, m: int, levels: int) -> tuple[Floats, Floats]:
    """Return sums of z_m^2 and of z_m (3, levels) for averaging times of m, 2 m, 4 m, ... samples.

    Parameters
    ----------
    samples : in parts (k, 3), all but the last of multiples of m
    marks : sums of what is before every m-th (rows, 3); they are changed
    zero : about which the samples are summed up (3,)
    """
    library = load_kernel()
    assert library is not None
    parts = [np.ascontiguousarray(part) for part in samples]
    starts = [part.ctypes.data + m * part.strides[0] * np.arange(-(-len(part) // m)) for part in parts]
    rows = np.concatenate([*starts, np.zeros(1, np.int64)])  # the last one may be a sum without a sample
    width = min(m, max(_NEAR // len(marks) // 8 * 8, 8))
    squares, totals, work = np.zeros((3, levels)), np.zeros((3, levels)), np.empty(3 * width * (len(marks) + 1) + 8)
    library.gnomon_allan_long(
        *(_long(sum(map(len, parts)) + 1), _at(rows), _out(marks), _at(zero), _long(m), _long(width), _long(levels)),
        *map(_out, (work, squares, totals)),
    )
    return squares, totals


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
        *(_long(len(values)), _long(values.shape[1]), _long(len(places) == 1), _at(values), _at(places), _at(weights)),
        *(_long(tip), _at(rules), _at(active), _out(states), _out(found[0]), _out(variance), _out(found[1])),
        _out(found[2]),
    )
    return found[0], variance, found[1], found[2]


def solve_homography(points: Floats, pixels: Floats) -> Floats:
    """Return the homography (3, 3) from points (m, 2) to pixels (m, 2); see there, in the places of tags."""
    library = load_kernel()
    assert library is not None
    found = np.empty((3, 3))
    points, pixels = np.ascontiguousarray(points), np.ascontiguousarray(pixels)
    library.gnomon_fit_homography(_long(len(points)), _at(points), _at(pixels), _out(found))
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
    strange = library.gnomon_undo_png_filters(_long(height), _long(width), ctypes.c_char_p(rows), _out(found))
    return None if strange else found


def join_columns(first: bytes, others: bytes) -> memoryview:
    """Return the lines of a table, of the JSON texts of its first column and of the rows of all others."""
    library = load_kernel()
    assert library is not None
    lines = np.empty(len(first) + len(others), dtype=np.uint8)
    return lines[: library.gnomon_join_columns(ctypes.c_char_p(first), ctypes.c_char_p(others), _out(lines))].data


def read_plain_numbers(text: bytes, delimiter: str | None, whole: Sequence[bool]) -> list[NDArray[Any]] | None:
    """Return the columns of a table of plain numbers; None where it is anything else, or needs more digits than 2^53.

    Parameters
    ----------
    delimiter : one character; None is any white space
    whole : of each column, whether its numbers are integers
    """
    library = load_kernel()
    assert library is not None
    if not text or b"\0" in text:
        return None
    values = np.empty((text.count(b"\n") + 1, len(whole)))
    count = library.gnomon_read_table(
        *(ctypes.c_char_p(text), _long(ord(delimiter or " ")), _long(len(whole))),
        *(_at(np.array(whole, dtype=np.uint8)), _out(values)),
    )
    if count < 1:
        return None
    columns = np.ascontiguousarray(values[:count].T)
    return [column.view(np.int64) if one else column for column, one in zip(columns, whole, strict=True)]
