"""GoPro's GPMF, read from its public documentation (gopro/gpmf-parser, README): keys, types, lengths and values.

An entry is a key of four characters, a type, the size of one value, how many there are, and the values, big-endian,
filled up to four bytes. Type zero holds entries: a device (DEVC) holds streams (STRM), a stream its values and what is
said of them.
"""

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext, suppress

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
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


@value_class(eq=True)
class GpmfEntry:
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


def gpmf_entries(data: bytes) -> tuple[list[GpmfEntry], bool]:
    """Return the entries of one level, and whether they are all there; what one of them holds is again such bytes.

    They end before the first one that is longer than what is there, or whose key is none.
    """
    found: list[GpmfEntry] = []
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
        found.append(GpmfEntry(key=key.decode("ascii"), kind=chr(data[at + 4]), size=size, count=count, data=values))
        at = first + (length + 3) // 4 * 4
    return found, not data[at:].strip(b"\0")


_AXES = re.compile(r"[XYZxyz]{3}")
_BY_NAME = {"(z,x,y)": "ZXY", "(up/down, right/left, forward/back)": "ZXY"}
"""What names of streams say of the order: HERO5, the first camera with GPMF, has z (up), x, y."""
_BY_MODEL = {"fusion": "yXZ"}
"""Order by the documentation, where it differs from the name of the stream."""
_NEEDED = {"ACCL", "GYRO"}
_WANTED = _NEEDED | {"MAGN", "IORI", "CORI", "SHUT", "SROT"}


@value_class
class PayloadBlock:
    """Values of one stream in one payload, which is about a second.

    Attributes
    ----------
    key : "ACCL", "GYRO", ...
    payload : which one of its device, from 0
    values : (n, k), scaled, in the order of the file
    stamp_us : of the first value, in the clock of the camera; None where it is not stated
    total : how many values came so far, with these; None where it is not stated
    orientation : axis of each component as ORIN says it, lower case where it is turned round; or ""
    unit : as it is written, or ""
    temperature : of the sensor [degree Celsius], or nan
    """

    key: str
    payload: int
    values: Floats
    stamp_us: int | None
    total: int | None
    orientation: str
    unit: str
    temperature: float


@value_class(eq=True)
class Device:
    """One device that wrote telemetry: the camera, or what was connected to it.

    Attributes
    ----------
    name : as it calls itself
    blocks : its streams that gnomon uses, in the order of the file
    """

    name: str
    blocks: tuple[PayloadBlock, ...]

    def of(self, key: str) -> tuple[PayloadBlock, ...]:
        """Return the blocks of one stream that hold values."""
        return tuple(block for block in self.blocks if block.key == key and len(block.values))


class Telemetry:
    """Devices and their streams, payload by payload, in the order of the file."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        self._blocks: dict[int, list[PayloadBlock]] = {}
        self._payloads = Counter[int]()
        self.cut = False
        """Whether something was cut off or damaged."""

    def add(self, data: bytes, payload: int | None = None) -> None:
        """Add what is in a payload; where its number is None, each device counts its own."""
        for entry in self._entries(data):
            if entry.key == "DEVC" and entry.kind == NESTED:
                self._add_device(self._entries(entry.data), payload)

    def _entries(self, data: bytes) -> list[GpmfEntry]:
        found, whole = gpmf_entries(data)
        self.cut |= not whole
        return found

    def _add_device(self, inside: list[GpmfEntry], payload: int | None) -> None:
        said = {entry.key: entry for entry in inside}
        identity = int.from_bytes(said["DVID"].data[:4], "big") if "DVID" in said else 0
        name = said["DVNM"].text if "DVNM" in said else ""
        self._names.setdefault(identity, name)
        number = self._payloads[identity] if payload is None else payload
        self._payloads[identity] += 1
        blocks = self._blocks.setdefault(identity, [])
        for stream in inside:
            if stream.key == "STRM" and stream.kind == NESTED:
                blocks.extend(_blocks_of(self._entries(stream.data), number, name))

    def devices(self) -> tuple[Device, ...]:
        """Return the devices, in the order in which they come first."""
        return tuple(
            Device(name=name, blocks=tuple(self._blocks.get(identity, ()))) for identity, name in self._names.items()
        )


def _blocks_of(stream: list[GpmfEntry], payload: int, device: str) -> Iterator[PayloadBlock]:
    """Yield the values of a stream; what is said of them stands before them."""
    said: dict[str, GpmfEntry] = {}
    for entry in stream:
        if entry.key not in _WANTED or entry.kind == NESTED or not entry.count:
            said[entry.key] = entry
            continue
        with nullcontext() if entry.key in _NEEDED else suppress(RecordingError):
            yield _block(entry, said, payload, device)


def _block(entry: GpmfEntry, said: dict[str, GpmfEntry], payload: int, device: str) -> PayloadBlock:
    if entry.kind == "#":
        raise RecordingError(f"{entry.key}: its values are compressed, which gnomon does not read.")
    values = entry.numbers()
    scale = said["SCAL"].numbers().ravel() if "SCAL" in said else np.ones(1)
    if len(scale) not in {1, values.shape[1]} or not (np.isfinite(scale) & (scale != 0)).all():
        raise RecordingError(f"{entry.key}: its scale {scale.tolist()} is none for {values.shape[1]} components.")
    temperature = said["TMPC"].numbers().ravel() if "TMPC" in said and said["TMPC"].count else np.full(1, np.nan)
    unit = next((said[key].text for key in ("SIUN", "UNIT") if key in said), "")
    with np.errstate(all="ignore"):
        values /= scale
    return PayloadBlock(
        key=entry.key,
        payload=payload,
        values=values,
        stamp_us=said["STMP"].whole() if "STMP" in said else None,
        total=said["TSMP"].whole() if "TSMP" in said else None,
        orientation=_orientation(said, device),
        unit=unit,
        temperature=float(temperature[0]),
    )


def _orientation(said: dict[str, GpmfEntry], device: str) -> str:
    """Return the axis of each component: stated, else documented for the model, else as the stream is called."""
    if "ORIN" in said and _is_orientation(said["ORIN"].text):
        return said["ORIN"].text
    if device.lower() in _BY_MODEL:
        return _BY_MODEL[device.lower()]
    name = said["STNM"].text.lower() if "STNM" in said else ""
    return next((axes for words, axes in _BY_NAME.items() if words in name), "")


def _is_orientation(text: str) -> bool:
    return _AXES.fullmatch(text) is not None and len(set(text.upper())) == 3


def in_camera_axes(values: Floats, orientation: str) -> Floats:
    """Return values (n, 3) along x, y, z of GoPro's frame of the camera, from components in the stated order.

    Examples
    --------
    >>> in_camera_axes(np.array([[1.0, 2.0, 3.0]]), "YxZ").tolist()
    [[-2.0, 1.0, 3.0]]
    """
    turned = np.empty_like(values)
    for component, axis in enumerate(orientation):
        turned[:, "XYZ".index(axis.upper())] = values[:, component] * (1.0 if axis.isupper() else -1.0)
    return turned
