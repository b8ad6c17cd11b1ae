"""Chunks and messages of bags, unpacked up to a bound: a kilobyte may stand for gigabytes."""

import bz2
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

from ..files import largest_unpacked


class TooLargeError(Exception):
    """What is packed would become absurdly large."""


def unpack_bytes(name: str, data: bytes) -> bytes:
    """Return what was packed with "bz2", "lz4" or "zstd".

    Raises
    ------
    TooLargeError
        If it would be more than `largest_unpacked`.
    Exception
        Of the library, if it is damaged.
    """
    most, made = largest_unpacked(len(data)), b""
    while data:
        one = _decompressor(name)
        piece = one.decompress(data, most + 1 - len(made))
        made = made + piece if made else piece
        if len(made) > most:
            raise TooLargeError(f"{len(data)} bytes would be unpacked to more than {most >> 20} MiB")
        if not one.eof:
            raise EOFError("what is packed ends too early")
        data = one.unused_data
    return made


def _decompressor(name: str) -> Any:
    if name == "bz2":
        return bz2.BZ2Decompressor()
    if name == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd  # comes with rosbags
    return zstd.ZstdDecompressor()


@cache
def bound_rosbags() -> None:
    """Put these functions in the place of those of rosbags, which unpack without a bound."""
    places = (
        ("rosbags.rosbag1.reader", "decompressors", lambda name: lambda data: unpack_bytes(name, data)),
        ("rosbags.rosbag2.storage_mcap", "DECOMPRESSORS", lambda name: lambda data, _: unpack_bytes(name, data)),
    )
    for module, table, made in places:
        known: dict[str, Callable[..., bytes]] = getattr(import_module(module), table, {})
        known.update({name: made(name) for name in known if name in {"bz2", "lz4", "zstd"}})
