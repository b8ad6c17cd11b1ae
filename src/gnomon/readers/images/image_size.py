"""How many pixels a picture file says it has, before a decoder makes room for them."""

import struct

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
