"""Pixels as cameras send them (sensor_msgs/Image and CompressedImage) -> 8 bits of grey.

Images of 16 bits hold 10 or 12 of them with most cameras. The smallest of 8, 10, 12, 14 and 16 bits that holds every
value of a stream is taken for its depth, and the lowest bits are dropped: one scale for all images of the stream.
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...kernel import load_kernel
from ...kernel.library import undo_png_filters
from ...recording.recording import Grey

Buffer = bytes | memoryview
_ISAL_ERROR: type[Exception] = isal_zlib.error  # pyright: ignore[reportAssignmentType]  # its stub says Exception


@value_class(eq=True)
class _Layout:
    """How one encoding lies in memory, and which conversion of OpenCV makes it grey."""

    channels: int = 1
    depth_bytes: int = 1
    conversion: str = ""
    brightness: int = 0  # channel that is brightness already, where there is no conversion


_BAYER = ("rggb", "bggr", "gbrg", "grbg")
_LAYOUTS = {
    "mono8": _Layout(),
    "8UC1": _Layout(),
    "mono16": _Layout(depth_bytes=2),
    "16UC1": _Layout(depth_bytes=2),
    "bgr8": _Layout(channels=3, conversion="COLOR_BGR2GRAY"),
    "8UC3": _Layout(channels=3, conversion="COLOR_BGR2GRAY"),
    "rgb8": _Layout(channels=3, conversion="COLOR_RGB2GRAY"),
    "bgra8": _Layout(channels=4, conversion="COLOR_BGRA2GRAY"),
    "rgba8": _Layout(channels=4, conversion="COLOR_RGBA2GRAY"),
    **{f"bayer_{name}8": _Layout(conversion=f"COLOR_Bayer{name.upper()}2GRAY") for name in _BAYER},
    **{f"bayer_{name}16": _Layout(depth_bytes=2, conversion=f"COLOR_Bayer{name.upper()}2GRAY") for name in _BAYER},
    "yuv422": _Layout(channels=2, brightness=1),  # U Y V Y
    "uyvy": _Layout(channels=2, brightness=1),
    "yuv422_yuy2": _Layout(channels=2),  # Y U Y V
    "yuyv": _Layout(channels=2),
}
ENCODINGS = tuple(_LAYOUTS)
"""The encodings of sensor_msgs/Image that are read."""

_DEPTHS = (8, 10, 12, 14, 16)
_COMPRESSED = ("jpeg", "jpg", "png", "webp", "tiff", "tif", "bmp")
_JPEG, _JPEG_END, _JPEG_TAIL = b"\xff\xd8\xff", b"\xff\xd9", 1024
_PNG, _PNG_BITS = b"\x89PNG\r\n\x1a\n", 24  # where a PNG says how many bits its numbers have
_PNG_PLAIN = {b"IHDR", b"IEND", b"tEXt", b"tIME", b"pHYs"}  # chunks beside which the pixels are what they are
_CURE = "Convert the topic with image_proc or image_transport, or record the camera as mono8."


@value_class(eq=True)
class RawImage:
    """The fields of sensor_msgs/Image.

    Attributes
    ----------
    step : bytes from the start of one row to the start of the next
    data : step * height bytes
    """

    height: int
    width: int
    encoding: str
    big_endian: bool
    step: int
    data: Buffer


def check_encoding(encoding: str, where: str) -> None:
    """Refuse an encoding of sensor_msgs/Image that is not read.

    Raises
    ------
    RecordingError
        With the encoding that was found, and those that are read.
    """
    if encoding not in _LAYOUTS:
        raise RecordingError(
            f'{where}: images are encoded as "{encoding}", which gnomon does not read; it reads '
            f"{', '.join(ENCODINGS)}. {_CURE}"
        )


def check_compression(form: str, where: str) -> None:
    """Refuse the `format` of a sensor_msgs/CompressedImage that holds no picture of its own, such as depth or video.

    Raises
    ------
    RecordingError
        With the format that was found, and those that are read.
    """
    words = form.lower().replace(";", " ").split()
    if words and ("compresseddepth" in words or not any(name in words for name in _COMPRESSED)):
        raise RecordingError(
            f'{where}: images are compressed as "{form}", which gnomon does not read; it reads '
            f"{', '.join(_COMPRESSED)}. {_CURE}"
        )


def sixteen_bits(encoding: str) -> bool:
    """Return whether the numbers of an image have 16 bits, so that their scale has to be found."""
    layout = _LAYOUTS.get(encoding)
    return layout is not None and layout.depth_bytes == 2


def largest_value(image: RawImage, where: str) -> int:
    """Return the largest number in an image; the largest of a stream goes to `bit_depth`.

    Raises
    ------
    RecordingError
        If the image is damaged.
    """
    return int(_numbers(image, _LAYOUTS[image.encoding], where).max())


def bit_depth(largest: int) -> int:
    """Return the bits of a camera whose largest number is this one: 8, 10, 12, 14 or 16."""
    return next(bits for bits in _DEPTHS if largest < 1 << bits or bits == _DEPTHS[-1])


def grey_image(image: RawImage, where: str, bits: int | None = None) -> Grey:
    """Return an image in 8 bits of grey, (height, width).

    Parameters
    ----------
    image : as the camera sent it; colour is weighted as ITU-R BT.601 says, a Bayer pattern is interpolated
    where : file, topic and timestamp, for messages
    bits : how many bits images of 16 bits really have; None to tell from this image alone. Larger numbers are white

    Raises
    ------
    RecordingError
        If its encoding is not read, or it holds fewer bytes than its size needs.
    """
    check_encoding(image.encoding, where)
    layout = _LAYOUTS[image.encoding]
    numbers = _numbers(image, layout, where)
    if layout.depth_bytes == 2:
        numbers = _eight_bits(numbers, bits)
    if not layout.conversion:
        return np.array(numbers[:, :, layout.brightness], dtype=np.uint8, order="C")
    import cv2

    try:
        grey = cv2.cvtColor(np.ascontiguousarray(numbers), getattr(cv2, layout.conversion))
    except cv2.error as error:  # a Bayer pattern needs some rows and columns
        raise RecordingError(
            f"{where}: an image of {image.width} x {image.height} pixels in {image.encoding} cannot be made grey "
            f"({error.err})."
        ) from None
    return np.asarray(grey, dtype=np.uint8)


def _numbers(image: RawImage, layout: _Layout, where: str) -> NDArray[Any]:
    """Return the numbers of an image, (height, width, channels), without the padding of its rows."""
    row = image.width * layout.channels * layout.depth_bytes
    step = image.step or row  # some drivers leave it at zero
    needed = step * image.height
    if not row or not image.height or step < row or len(image.data) < needed:
        raise RecordingError(
            f"{where}: the image is damaged: {image.width} x {image.height} pixels in {image.encoding} need rows of "
            f"{row} bytes, {needed} bytes in all with its step of {image.step}; found {len(image.data)} bytes."
        )
    rows = np.frombuffer(image.data, np.uint8, needed).reshape(image.height, step)[:, :row]
    if layout.depth_bytes == 2:
        rows = np.ascontiguousarray(rows).view(">u2" if image.big_endian else "<u2").astype(np.uint16, copy=False)
    return rows.reshape(image.height, image.width, layout.channels)


def _eight_bits(numbers: NDArray[Any], bits: int | None) -> NDArray[np.uint8]:
    depth = bit_depth(int(numbers.max())) if bits is None else bits
    return (np.minimum(numbers, (1 << depth) - 1) >> (depth - 8)).astype(np.uint8)


def compressed_image(data: Buffer, form: str, where: str, bits: int | None = None) -> Grey:
    """Return the image of a sensor_msgs/CompressedImage in 8 bits of grey, (height, width).

    Parameters
    ----------
    data : a whole JPEG, PNG or other picture file
    form : its `format`, such as "jpeg", "bgr8; jpeg compressed bgr8" or "bayer_rggb8; jpeg compressed"
    where : file, topic and timestamp, for messages
    bits : as for `grey_image`

    Raises
    ------
    RecordingError
        If the format is not read, or the picture is damaged.
    """
    check_compression(form, where)
    grey = decode_picture(data, where, bits)
    name = form.partition(";")[0].strip()
    if not name.startswith("bayer_") or "bgr8" in form or "rgb8" in form:
        return grey
    height, width = grey.shape
    eight = name.replace("16", "8")  # the pattern was compressed as if it were grey
    pattern = RawImage(height=height, width=width, encoding=eight, big_endian=False, step=width, data=grey.tobytes())
    return grey_image(pattern, where)


def decode_picture(data: Buffer, where: str, bits: int | None = None) -> Grey:
    """Return a picture file in memory (PNG, JPEG, ...) in 8 bits of grey, (height, width).

    Parameters
    ----------
    data : the whole file
    where : file, or file, topic and timestamp, for messages
    bits : as for `grey_image`

    Raises
    ------
    RecordingError
        If it is damaged or no picture.
    """
    found = _decoded(data, where)
    if found.dtype == np.uint16:
        return _eight_bits(found, bits)
    return np.ascontiguousarray(found, dtype=np.uint8)


def largest_in_picture(data: Buffer, where: str) -> int:
    """Return the largest number in a picture file of 16 bits, for `bit_depth`; zero where it has 8 bits.

    Raises
    ------
    RecordingError
        If it is damaged or no picture.
    """
    begin = bytes(memoryview(data)[: _PNG_BITS + 1])
    if begin.startswith(_PNG) and len(begin) > _PNG_BITS and begin[-1] <= 8 and not _fault(memoryview(data)):
        return 0  # known without decoding it
    found = _decoded(data, where)
    return int(found.max()) if found.dtype == np.uint16 else 0


def _decoded(data: Buffer, where: str) -> NDArray[Any]:
    import cv2

    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    fault = _fault(memoryview(data)) or too_many_pixels(memoryview(data))
    found = None
    if len(data) and not fault:
        _hush()
        with suppress(cv2.error, MemoryError, _ISAL_ERROR):
            found = _plain_png(memoryview(data))
        if found is None:
            with suppress(cv2.error, MemoryError):
                found = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if found is None or found.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise RecordingError(f"{where}: the picture is {fault or 'damaged or of an unknown kind'} ({len(data)} bytes).")
    return np.asarray(found)


def _plain_png(data: memoryview) -> Grey | None:
    """Return the picture of a PNG in 8 bits of grey, as most cameras' are, faster than OpenCV; None of any other."""
    if load_kernel() is None or bytes(data[:16]) != _PNG + b"\0\0\0\rIHDR" or bytes(data[24:29]) != b"\b\0\0\0\0":
        return None
    (width, height), packed = _png(data), list[memoryview]()
    for kind, content in _chunks(data):
        if kind == b"IDAT":
            packed.append(content)
        elif kind not in _PNG_PLAIN:
            return None
    size = height * (width + 1)
    rows = isal_zlib.decompressobj().decompress(b"".join(packed), size)
    return undo_png_filters(rows, width, height) if width and len(rows) == size else None


def _chunks(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Yield the names and contents of a PNG's chunks, whose ends `_fault` has looked at."""
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        kind = bytes(data[at + 4 : at + 8])
        yield kind, data[at + 8 : end]
        at = end + 4


@cache
def _hush() -> None:
    """Keep OpenCV from saying on the terminal, in its own words, what is wrong with a picture."""
    import cv2

    silence = getattr(cv2, "setLogLevel", None)  # OpenCV 4; 5 has it elsewhere
    if silence is None:
        from cv2.utils import logging

        silence = logging.setLogLevel
    silence(0)


def _fault(data: memoryview) -> str:
    """Return what is wrong with a picture file by its own ends and sums, before a decoder sees it; "" if nothing is.

    Of a JPEG that is cut off some decoders make up the rest, and of a damaged PNG they complain on the terminal.
    """
    if bytes(data[:3]) == _JPEG:
        return "" if _JPEG_END in bytes(data[-_JPEG_TAIL:]) else "cut off"
    if bytes(data[:8]) != _PNG:
        return ""
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        kind = bytes(data[at + 4 : at + 8])
        if end + 4 > len(data):
            return "cut off"
        needed = kind[:1].isupper()  # else it is text, time, or whatever a program put there
        if needed and zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return "damaged"
        at = end + 4
    return ""


_JPEG_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = {0x01, *range(0xD0, 0xD9)}  # markers without a length
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_SHORT = 3
USUAL_PIXELS = 1 << 26
"""A picture of so many pixels is decoded however small its file is: 67 megapixels."""
PIXELS_PER_BYTE = 200
"""Beyond that many for each byte of the file, a picture holds nothing: noise does not shrink to less."""
MOST_PIXELS = 1 << 28
"""No camera has more: 268 megapixels."""


def stated_pixels(data: memoryview) -> int:
    """Return width times height as the header of a PNG, JPEG, BMP, TIFF, WebP or PNM says; 0 where it does not."""
    try:
        width, height = _size(data)
    except (struct.error, IndexError, ValueError):
        return 0
    return abs(width) * abs(height)


def too_many_pixels(data: memoryview) -> str:
    """Return what is wrong with a picture that says it has far more pixels than its file can hold; "" if nothing is."""
    pixels = stated_pixels(data)
    if pixels <= most_pixels(len(data)):
        return ""
    return f"said to have {pixels / 1e6:.0f} megapixels, which are not in its file"


def most_pixels(size: int) -> int:
    """Return how many pixels a picture, or a frame of a video, in a file of so many bytes may have."""
    return min(max(USUAL_PIXELS, PIXELS_PER_BYTE * size), MOST_PIXELS)


def _size(data: memoryview) -> tuple[int, int]:
    head = bytes(data[:32])
    return next((size(data) for magic, size in _SIZES.items() if head.startswith(magic)), (0, 0))


def _png(data: memoryview) -> tuple[int, int]:
    return struct.unpack_from(">II", data, 16)


def _bmp(data: memoryview) -> tuple[int, int]:
    return struct.unpack_from("<HH" if data[14] == 12 else "<ii", data, 18)


def _pnm(data: memoryview) -> tuple[int, int]:
    words = bytes(data[2:256]).split()
    return int(words[0][:12]), int(words[1][:12])


def _jpeg(data: memoryview) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            at += 1
            continue
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 1 if marker == 0xFF else 2 if marker in _JPEG_ALONE else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return 0, 0


def _tiff(data: memoryview) -> tuple[int, int]:
    order = "<" if data[0] == 0x49 else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    found = {_TIFF_WIDTH: 0, _TIFF_HEIGHT: 0}
    for i in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * i)
        if tag in found:
            (found[tag],) = struct.unpack_from(f"{order}{'H' if kind == _TIFF_SHORT else 'I'}", data, at + 10 + 12 * i)
    return found[_TIFF_WIDTH], found[_TIFF_HEIGHT]


def _webp(data: memoryview) -> tuple[int, int]:
    chunk = bytes(data[12:40])
    if chunk[:4] == b"VP8X":
        return 1 + int.from_bytes(chunk[12:15], "little"), 1 + int.from_bytes(chunk[15:18], "little")
    if chunk[:4] == b"VP8L":
        bits = int.from_bytes(chunk[9:13], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", chunk, 14)
    return width & 0x3FFF, height & 0x3FFF


_SIZES = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8": _jpeg,
    b"BM": _bmp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"RIFF": _webp,
    **{f"P{kind}".encode(): _pnm for kind in range(1, 7)},
}
"""First bytes of a picture file -> width and height in it."""
