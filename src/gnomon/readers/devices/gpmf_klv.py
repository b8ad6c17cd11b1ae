"""GoPro's GPMF, read from its public documentation (gopro/gpmf-parser, README): keys, types, lengths and values.

An entry is a key of four characters, a type, the size of one value, how many there are, and the values, big-endian,
filled up to four bytes. Type zero holds entries: a device (DEVC) holds streams (STRM), a stream its values and what is
said of them.
"""

from dataclasses import dataclass

import numpy as np

from ...errors import RecordingError
from ...recording import Floats

_HEAD = 8
NESTED = "\0"
_NUMBERS = {
    "b": ">i1",
    "B": ">u1",
    "s": ">i2",
    "S": ">u2",
    "l": ">i4",
    "L": ">u4",
    "j": ">i8",
    "J": ">u8",
    "f": ">f4",
    "d": ">f8",
    "q": ">i4",
    "Q": ">i8",
}
_FRACTION = {"q": 2.0**-16, "Q": 2.0**-32}
"""Fixed-point types: Q15.16 and Q31.32."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One entry of GPMF.

    Attributes
    ----------
    key : four characters
    kind : its type; `NESTED` where it holds entries
    size, count : bytes of one value, and number of values
    data : the bytes of all values
    """

    key: str
    kind: str
    size: int
    count: int
    data: bytes

    @property
    def text(self) -> str:
        """The value as text without what fills it up; GoPro writes ISO 8859-1."""
        return self.data.split(b"\0", 1)[0].decode("latin-1").strip()

    def numbers(self) -> Floats:
        """Return the values, (count, components).

        Raises
        ------
        RecordingError
            If the type is not one of numbers, or the size is none of its multiples.
        """
        kind = _NUMBERS.get(self.kind)
        width = np.dtype(kind).itemsize if kind is not None else 0
        if kind is None or not self.size or self.size % width:
            raise RecordingError(
                f"{self.key}: {self.count} values of {self.size} bytes in type {self.kind!r} are no numbers that "
                "gnomon reads."
            )
        with np.errstate(invalid="ignore"):  # damaged numbers may be none
            values = np.frombuffer(self.data, kind, count=self.count * self.size // width).astype(np.float64)
        return (values * _FRACTION.get(self.kind, 1.0)).reshape(self.count, self.size // width)

    def whole(self) -> int:
        """Return the first value as a whole number, exactly.

        Raises
        ------
        RecordingError
            If there is none.
        """
        if self.kind not in {"b", "B", "s", "S", "l", "L", "j", "J"} or len(self.data) < (
            width := np.dtype(_NUMBERS[self.kind]).itemsize
        ):
            raise RecordingError(f"{self.key}: found no whole number in it.")
        return int(np.frombuffer(self.data[:width], _NUMBERS[self.kind])[0])


def entries(data: bytes) -> tuple[list[Entry], bool]:
    """Return the entries of one level, and whether they are all there; what one of them holds is again such bytes.

    They end before the first one that is longer than what is there, or whose key is none.
    """
    found: list[Entry] = []
    at, end = 0, len(data)
    while at + _HEAD <= end:
        key = data[at : at + 4]
        if key == bytes(4):  # nothing but filling from here on
            return found, True
        size, count = data[at + 5], int.from_bytes(data[at + 6 : at + 8], "big")
        first, length = at + _HEAD, size * count
        if first + length > end or not all(32 <= character < 127 for character in key):
            return found, False
        values = data[first : first + length]
        found.append(Entry(key=key.decode("ascii"), kind=chr(data[at + 4]), size=size, count=count, data=values))
        at = first + (length + 3) // 4 * 4
    return found, not data[at:].strip(b"\0")
