"""The samples in GPMF: which device and stream they are of, their scale, their axes and what else is said of them."""

import re
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass

import numpy as np

from ...errors import RecordingError
from ...recording import Floats
from .gpmf_klv import NESTED, Entry, entries

_AXES = re.compile(r"[XYZxyz]{3}")
_BY_NAME = {"(z,x,y)": "ZXY", "(up/down, right/left, forward/back)": "ZXY"}
"""What names of streams say of the order: HERO5, the first camera with GPMF, has z (up), x, y."""
_BY_MODEL = {"fusion": "yXZ"}
"""Order by the documentation, where it differs from the name of the stream."""
_NEEDED = {"ACCL", "GYRO"}
_WANTED = _NEEDED | {"MAGN", "IORI", "CORI", "SHUT", "SROT"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """One device that wrote telemetry: the camera, or what was connected to it.

    Attributes
    ----------
    name : as it calls itself
    blocks : its streams that gnomon uses, in the order of the file
    payloads : their number
    """

    name: str
    blocks: tuple[Block, ...]
    payloads: int

    def of(self, key: str) -> tuple[Block, ...]:
        """Return the blocks of one stream that hold values."""
        return tuple(block for block in self.blocks if block.key == key and len(block.values))


class Telemetry:
    """Devices and their streams, payload by payload, in the order of the file."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        self._blocks: dict[int, list[Block]] = {}
        self._payloads: dict[int, list[int]] = {}
        self.cut = False
        """Whether something was cut off or damaged."""

    def add(self, data: bytes, payload: int | None = None) -> None:
        """Add what is in a payload; where its number is None, each device counts its own."""
        for entry in self._entries(data):
            if entry.key == "DEVC" and entry.kind == NESTED:
                self._add_device(self._entries(entry.data), payload)

    def _entries(self, data: bytes) -> list[Entry]:
        found, whole = entries(data)
        self.cut |= not whole
        return found

    def _add_device(self, inside: list[Entry], payload: int | None) -> None:
        said = {entry.key: entry for entry in inside}
        identity = int.from_bytes(said["DVID"].data[:4], "big") if "DVID" in said else 0
        name = said["DVNM"].text if "DVNM" in said else ""
        self._names.setdefault(identity, name)
        seen = self._payloads.setdefault(identity, [])
        seen.append(len(seen) if payload is None else payload)
        blocks = self._blocks.setdefault(identity, [])
        for stream in inside:
            if stream.key == "STRM" and stream.kind == NESTED:
                blocks.extend(_blocks_of(self._entries(stream.data), seen[-1], name))

    def devices(self) -> tuple[Device, ...]:
        """Return the devices, in the order in which they come first."""
        return tuple(
            Device(name=name, blocks=tuple(self._blocks.get(identity, ())), payloads=len(set(self._payloads[identity])))
            for identity, name in self._names.items()
        )


def _blocks_of(stream: list[Entry], payload: int, device: str) -> Iterator[Block]:
    """Yield the values of a stream; what is said of them stands before them."""
    said: dict[str, Entry] = {}
    for entry in stream:
        if entry.key not in _WANTED or entry.kind == NESTED or not entry.count:
            said[entry.key] = entry
            continue
        with nullcontext() if entry.key in _NEEDED else suppress(RecordingError):
            yield _block(entry, said, payload, device)


def _block(entry: Entry, said: dict[str, Entry], payload: int, device: str) -> Block:
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
    return Block(
        key=entry.key,
        payload=payload,
        values=values,
        stamp_us=said["STMP"].whole() if "STMP" in said else None,
        total=said["TSMP"].whole() if "TSMP" in said else None,
        orientation=_orientation(said, device),
        unit=unit,
        temperature=float(temperature[0]),
    )


def _orientation(said: dict[str, Entry], device: str) -> str:
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
