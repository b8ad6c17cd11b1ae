"""Zip and NPZ files of others: what goes wrong with them, and what they may not be."""

import struct
import warnings
import zipfile
import zlib
from math import prod
from tokenize import TokenError
from typing import Any

import numpy as np

from ..errors import RecordingError
from .files import bomb_error, largest_unpacked

try:
    from lzma import LZMAError
except ImportError:  # Python may be built without it
    LZMAError = zlib.error

ZIP_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, LZMAError, EOFError, OSError, ValueError, KeyError, TypeError, struct.error),
    *(RuntimeError, OverflowError, SyntaxError, IndexError, TokenError),
)
"""What a damaged zip, or an array in it, ends in; RuntimeError of passwords and of methods that are not known."""

Header = tuple[tuple[int, ...], bool, np.dtype[Any]]
"""Shape, whether in Fortran order, and type of an array."""


def refuse_zip_bomb(archive: zipfile.ZipFile, where: str) -> None:
    """Refuse a zip by the sizes that it states; no more than those is ever unpacked.

    Raises
    ------
    RecordingError
        If it is small and stands for much.
    """
    members = archive.infolist()
    packed, unpacked = sum(one.compress_size for one in members), sum(one.file_size for one in members)
    if unpacked > largest_unpacked(packed):
        raise bomb_error(where, packed)


def refuse_false_arrays(archive: zipfile.ZipFile, where: str) -> None:
    """Refuse an NPZ file that is a bomb, or has an array whose header states more numbers than follow it.

    Raises
    ------
    RecordingError
        If it is one.
    """
    refuse_zip_bomb(archive, where)
    for member in archive.infolist():
        if not member.filename.endswith(".npy"):
            continue
        with archive.open(member) as file:
            shape, _, dtype = array_header(file)
        if prod(shape) * max(dtype.itemsize, 1) > member.file_size or min(shape, default=0) < 0:
            raise RecordingError(
                f"{where}: the header of {member.filename[:80]} states the shape {str(shape)[:80]}, which is more than "
                f"its {member.file_size} bytes. Copy the file again."
            )


def array_header(member: Any) -> Header:
    """Return what stands in front of an array.

    Raises
    ------
    ValueError
        If it is no header of NumPy.
    """
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings():  # NumPy warns of headers in the spelling of Python 2
        warnings.simplefilter("ignore")
        shape, fortran, dtype = read(member)
    return shape, fortran, dtype
