"""The innermost loops, compiled where a C compiler was there at installation (see `kernel.c`): found, and given arrays.

Everything works without it, more slowly. GNOMON_KERNEL=0 in the environment switches it off.
Besides: the one thread of BLAS.
"""

import ctypes
import os
import sys
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy import generic
    from numpy.typing import NDArray

_INTERFACE = 11  # of kernel.c, which those who call it are written for


_LOOPS = (
    *("inertial_rows", "inertial_sums", "corner_sums", "add_spans", "gather_tied", "integrate_rates"),
    *(
        "allan_short",
        "allan_long",
        "descend_corners",
        "fit_homography",
        "undo_png_filters",
        "join_columns",
        "read_table",
    ),
)


def kernel_file_name() -> str:
    """Return the name of the compiled file beside this one, in a folder where nobody looks for modules of Python."""
    return "compiled/kernel." + {"win32": "dll", "darwin": "dylib"}.get(sys.platform, "so")


@cache
def _library() -> ctypes.CDLL | None:
    path = Path(__file__).parent / kernel_file_name()
    if not path.is_file():
        return None
    try:
        found = ctypes.CDLL(str(path))
        found.gnomon_interface.restype = ctypes.c_int64
        if found.gnomon_interface() != _INTERFACE:
            return None
        for name in _LOOPS:
            found[f"gnomon_{name}"].restype = None
        for name in ("undo_png_filters", "join_columns", "read_table"):
            found[f"gnomon_{name}"].restype = ctypes.c_int64
    except (OSError, AttributeError):  # of another processor, damaged, of another version
        return None
    return found


def load_kernel() -> ctypes.CDLL | None:
    """Return the compiled loops, or None where there are none or they are switched off."""
    return None if os.environ.get("GNOMON_KERNEL") == "0" else _library()


def describe_kernel() -> str:
    """Return in words whether the compiled loops are used."""
    return "compiled kernel" if load_kernel() is not None else "NumPy only, no compiled kernel"


# ---- what a loop is given ----


class _Pointer(ctypes.c_void_p):
    """Where an array begins, which lives as long as this."""

    def __init__(self, array: "NDArray[generic]") -> None:
        super().__init__(array.__array_interface__["data"][0])
        self.array = array


def array_in(array: "NDArray[generic] | None") -> ctypes.c_void_p:
    """Return where what is only read begins: an array, or a contiguous copy that lives as long as this."""
    from numpy import ascontiguousarray  # not before there are arrays: `gnomon --version` does without

    return ctypes.c_void_p() if array is None else array_out(ascontiguousarray(array))


def array_out(array: "NDArray[generic] | None") -> ctypes.c_void_p:
    """Return where an array begins that is written to; `data_as` of NumPy's takes ten times as long."""
    assert array is None or array.flags.c_contiguous
    return ctypes.c_void_p() if array is None else _Pointer(array)


def c_long(value: int) -> ctypes.c_int64:
    """Return an integer as the kernel takes it."""
    return ctypes.c_int64(value)


# ---- BLAS ----

_OF_BLAS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_blas_thread() -> AbstractContextManager[object]:
    """Return the context in which BLAS works in one thread: of many small products more get in each other's way."""
    if all(os.environ.get(name) == "1" for name in _OF_BLAS):  # as the program `gnomon` has it
        return nullcontext()
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas")
