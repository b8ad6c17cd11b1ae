"""Pixels as cameras send them, made grey: every encoding, padded rows, byte orders, depths, damaged images."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from gnomon.errors import RecordingError
from gnomon.readers.images.image_pixels import (
    ENCODINGS,
    RawImage,
    bit_depth,
    compressed_image,
    decode_picture,
    grey_image,
    largest_in_picture,
    largest_value,
)

RNG = np.random.default_rng(3)
GREY = RNG.integers(0, 256, (12, 16), dtype=np.uint8)
COLOUR = RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8)  # red, green, blue
WEIGHTS = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601


def raw(pixels, encoding, *, pad=0, big=False, size=None):
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    padded = np.pad(rows, ((0, 0), (0, pad)), constant_values=77)
    height, width = size or pixels.shape[:2]
    return RawImage(
        height=height, width=width, encoding=encoding, big_endian=big, step=padded.shape[1], data=padded.tobytes()
    )


def decoded(*args, bits=None, **changes):
    grey = grey_image(raw(*args, **changes), "here", bits)
    assert grey.dtype == np.uint8
    assert grey.flags.c_contiguous
    assert grey.flags.writeable
    return grey


@pytest.mark.parametrize("pad", [0, 5])
@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_stays_as_it_is(encoding, pad):
    np.testing.assert_array_equal(decoded(GREY, encoding, pad=pad), GREY)


@pytest.mark.parametrize("pad", [0, 7])
@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("8UC3", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_is_weighted(encoding, order, pad):
    expected = COLOUR @ WEIGHTS
    np.testing.assert_allclose(decoded(COLOUR[:, :, order], encoding, pad=pad), expected, atol=1)


@pytest.mark.parametrize(("encoding", "places"), [("yuv422", (1, 3)), ("uyvy", (1, 3)), ("yuyv", (0, 2))])
def test_of_yuv_the_brightness_is_taken(encoding, places):
    packed = RNG.integers(0, 256, (12, 16, 2), dtype=np.uint8)
    flat = packed.reshape(12, 8, 4)
    flat[:, :, places[0]], flat[:, :, places[1]] = GREY[:, 0::2], GREY[:, 1::2]
    np.testing.assert_array_equal(decoded(packed, encoding, pad=2), GREY)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("depth", [8, 16])
def test_bayer_patterns_are_interpolated(pattern, depth):
    # One even colour: behind any pattern of filters its brightness is the same everywhere.
    colour = {"r": 200, "g": 90, "b": 30}
    mosaic = np.tile(
        np.array([[colour[pattern[0]], colour[pattern[1]]], [colour[pattern[2]], colour[pattern[3]]]]), (6, 8)
    )
    pixels = mosaic.astype(np.uint8) if depth == 8 else (mosaic << 8).astype("<u2")
    grey = decoded(pixels, f"bayer_{pattern}{depth}", pad=4, bits=None if depth == 8 else 16)
    assert grey.shape == (12, 16)
    np.testing.assert_allclose(grey, WEIGHTS @ list(colour.values()), atol=1)


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_sixteen_bits_are_scaled_by_their_depth(encoding, big, bits):
    values = (GREY.astype(np.uint16) << (bits - 8)) | ((1 << (bits - 8)) - 1)
    image = raw(values.astype(">u2" if big else "<u2"), encoding, big=big, pad=6)
    assert bit_depth(largest_value(image, "here")) == bits
    np.testing.assert_array_equal(grey_image(image, "here", bits), GREY)


def test_depth_of_a_stream_holds_for_its_dark_images():
    values = np.full((4, 6), 100, "<u2")
    assert (decoded(values, "mono16", bits=12) == 100 >> 4).all()
    assert (decoded(values, "mono16") == 100).all()  # alone, it has eight bits
    assert (decoded(values * 50, "mono16", bits=12) == 255).all()  # beyond the depth is white, not dark


@pytest.mark.parametrize("largest", [0, 255, 256, 1023, 1024, 4095, 4096, 16383, 16384, 65535])
def test_depth_is_the_smallest_that_holds_the_largest_value(largest):
    bits = bit_depth(largest)
    assert largest < 2**bits
    assert bits == 8 or largest >= 2 ** (bits - 2)


def test_an_unknown_encoding_is_named_beside_the_known_ones():
    with pytest.raises(RecordingError, match=r'/cam0.*"32FC1".*mono8.*bayer_rggb8.*image_proc') as caught:
        grey_image(raw(np.zeros((4, 4), np.float32), "32FC1"), "/cam0 at 3 s")
    assert all(name in str(caught.value) for name in ENCODINGS)


@pytest.mark.parametrize("encoding", ["mono8", "mono16", "bgr8", "bayer_rggb8"])
def test_an_image_that_is_cut_off_is_damaged(encoding):
    whole = raw(np.zeros((4, 24), np.uint8), encoding, size=(4, 4))
    short = RawImage(height=4, width=4, encoding=encoding, big_endian=False, step=whole.step, data=whole.data[:-1])
    with pytest.raises(RecordingError, match=r"here: the image is damaged: 4 x 4 .* 96 bytes.*found 95 bytes"):
        grey_image(short, "here")


@pytest.mark.parametrize(("height", "width", "step"), [(0, 4, 4), (4, 0, 4), (4, 8, 4)])
def test_sizes_that_do_not_fit_are_damaged(height, width, step):
    image = RawImage(height=height, width=width, encoding="mono8", big_endian=False, step=step, data=bytes(64))
    with pytest.raises(RecordingError, match="damaged"):
        grey_image(image, "here")


def test_a_step_of_zero_means_rows_without_padding():
    image = RawImage(height=12, width=16, encoding="mono8", big_endian=False, step=0, data=GREY.tobytes())
    np.testing.assert_array_equal(grey_image(image, "here"), GREY)


def encoded(pixels, suffix):
    return cv2.imencode(suffix, pixels)[1].tobytes()


@pytest.mark.parametrize("form", ["png", "mono8; png compressed", "PNG"])
def test_a_png_is_read_without_loss(form):
    np.testing.assert_array_equal(compressed_image(encoded(GREY, ".png"), form, "here"), GREY)


@pytest.mark.parametrize("form", ["jpeg", "bgr8; jpeg compressed bgr8", "rgb8; jpeg compressed bgr8", ""])
def test_a_jpeg_is_read(form):
    smooth = np.add.outer(np.arange(48), 2 * np.arange(64)).astype(np.uint8)
    colour = cv2.cvtColor(smooth, cv2.COLOR_GRAY2BGR)
    np.testing.assert_allclose(compressed_image(encoded(colour, ".jpg"), form, "here").astype(int), smooth, atol=4)


def test_a_bayer_pattern_that_was_compressed_as_grey_is_interpolated():
    mosaic = np.tile(np.array([[200, 90], [90, 30]], np.uint8), (8, 8))
    grey = compressed_image(encoded(mosaic, ".png"), "bayer_rggb8; png compressed", "here")
    np.testing.assert_allclose(grey, WEIGHTS @ [200, 90, 30], atol=1)


def test_pictures_of_sixteen_bits_are_scaled_by_the_depth_of_their_stream():
    file = encoded(GREY.astype(np.uint16) << 4, ".png")
    assert bit_depth(largest_in_picture(file, "here")) == 12
    np.testing.assert_array_equal(decode_picture(file, "here", 12), GREY)
    assert largest_in_picture(encoded(GREY, ".png"), "here") == 0


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0, 3, 30, 0.5, 0.97])
def test_a_picture_that_is_cut_off_is_damaged(suffix, keep):
    file = encoded(RNG.integers(0, 256, (48, 64), dtype=np.uint8), suffix)
    part = file[: keep if isinstance(keep, int) else int(keep * len(file))]
    with pytest.raises(RecordingError, match=rf"here: the picture is (cut off|damaged).*{len(part)} bytes"):
        decode_picture(part, "here")


def test_a_png_with_a_flipped_byte_is_damaged():
    file = bytearray(encoded(RNG.integers(0, 256, (48, 64), dtype=np.uint8), ".png"))
    file[len(file) // 2] ^= 0xFF
    with pytest.raises(RecordingError, match="damaged"):
        decode_picture(bytes(file), "here")


@pytest.mark.parametrize("form", ["16UC1; compressedDepth png", "h264", "bgr8; theora"])
def test_formats_that_hold_no_picture_are_named(form):
    with pytest.raises(RecordingError, match=rf'/cam0: .*"{form}".*jpeg'):
        compressed_image(encoded(GREY, ".png"), form, "/cam0")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda png: png[:-20], "cut off"),
        (lambda png: png[:200], "cut off"),
        (lambda png: png[:8], "cut off"),
        (lambda png: png[:100] + bytes([png[100] ^ 1]) + png[101:], "damaged"),
        (lambda png: png[:20] + bytes([png[20] ^ 1]) + png[21:], "damaged"),
    ],
)
def test_a_damaged_png_is_refused_without_a_word_on_the_terminal(capfd, spoil, said):
    """The library that decodes it would write to the terminal for every image of a folder."""
    png = cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8))[1].tobytes()
    with pytest.raises(RecordingError, match=rf"^a\.png: the picture is {said} \(\d+ bytes\)\.$"):
        decode_picture(spoil(png), "a.png")
    assert capfd.readouterr() == ("", "")


def png(rows, kind=0):
    """Return a PNG of 8 bits, made of rows whose first byte is the number of a filter."""
    head = struct.pack(">IIBBBBB", rows.shape[1] - 1, len(rows), 8, kind, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
    packed = (
        struct.pack(">I", len(held)) + name + held + struct.pack(">I", zlib.crc32(name + held)) for name, held in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 9), (30, 2), (40, 61)])
def test_every_filter_of_a_png_is_undone_as_opencv_does(height, width):
    rows = RNG.integers(0, 256, (height, width + 1), dtype=np.uint8)
    rows[:, 0] = RNG.permutation(np.arange(height) % 5)
    whole = png(rows)
    expected = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(decode_picture(whole, "here"), expected)


def test_a_png_with_too_few_rows_or_a_strange_filter_is_left_to_opencv(monkeypatch):
    rows = np.zeros((8, 9), np.uint8)
    asked = []
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: asked.append(len(data)))
    few = png(rows[:4]).replace(struct.pack(">II", 8, 4), struct.pack(">II", 8, 8))
    few = few[:29] + struct.pack(">I", zlib.crc32(few[12:29])) + few[33:]
    for whole in (few, png(np.full_like(rows, 5)), png(rows, kind=3)):
        with pytest.raises(RecordingError, match="damaged or of an unknown kind"):
            decode_picture(whole, "here")
    assert len(asked) == 3


def test_what_a_program_wrote_into_a_png_may_be_damaged():
    """A text that nobody needs, with a wrong sum."""
    image = np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8)
    png = cv2.imencode(".png", image)[1].tobytes()
    text = (5).to_bytes(4, "big") + b"tEXt" + b"a\0bcd" + bytes(4)
    np.testing.assert_array_equal(decode_picture(png[:33] + text + png[33:], "a.png"), image)
