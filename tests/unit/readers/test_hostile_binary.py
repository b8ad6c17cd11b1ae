"""Files made to hurt: bombs, sizes that are lies, lines without end, paths out of the folder; refused in words."""

import bz2
import gzip
import io
import json
import os
import pickle
import struct
import zipfile
import zlib

import cv2
import numpy as np
import pytest

import gnomon
from bag_maker import make_bag, usual
from gnomon.errors import GnomonError, RecordingError
from gnomon.readers import files
from gnomon.readers.bags.messages import TooLargeError, unpack_bytes
from gnomon.readers.images.image_files import read_grey
from gnomon.readers.images.image_pixels import stated_pixels
from gnomon.readers.images.image_recording import open_images
from gpmf_files import box, entry
from hostile.promise import Target, address_space, keep
from hostile.sample_targets import npz, phone, streamed, table

MANY = 60_000


def tried(read, path, data: bytes, **limits) -> GnomonError | None:
    """Read a file as the fuzzers do, with little memory to spare, and return what it was refused with."""
    target = Target(name="attack", file=path.name, seeds=list, read=lambda folder: read(folder / path.name), **limits)
    with address_space():
        return keep(target, path.parent, data)


def refused(read, path, data: bytes, *words: str) -> None:
    error = tried(read, path, data)
    assert isinstance(error, GnomonError)
    for word in words:
        assert word in str(error), str(error)


# ---- packed files ----


@pytest.fixture
def little(monkeypatch):
    """Lower the bound for what is unpacked, so that bombs are small: a megabyte, or ten times the file."""
    monkeypatch.setattr(files, "MUCH_BYTES", 1 << 20)
    monkeypatch.setattr(files, "MOST_TIMES", 10)


@pytest.mark.usefixtures("little")
@pytest.mark.parametrize("read", [gnomon.read, streamed])
def test_gzip_bombs(tmp_path, read):
    rows = table() + b"\n" * (4 << 20)
    refused(read, tmp_path / "rec.csv.gz", gzip.compress(rows), "would be unpacked to more than 1 MiB")


@pytest.mark.usefixtures("little")
@pytest.mark.parametrize("read", [gnomon.read, streamed])
def test_npz_bombs(tmp_path, read):
    zeros = np.zeros((500_000, 3))
    data = npz(compressed=True, accelerometer=zeros, gyroscope=zeros, t_ns=np.arange(500_000))
    refused(read, tmp_path / "rec.npz", data, "would be unpacked to more than")


@pytest.mark.usefixtures("little")
def test_zip_bombs(tmp_path):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Accelerometer.csv", b"time,seconds_elapsed,z,y,x\n" + b"0,0,0,0,0\n" * 3_000_000)
    refused(gnomon.read, tmp_path / "log.zip", made.getvalue(), "would be unpacked to more than")


def test_a_zip_of_very_many_files(tmp_path):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for number in range(10_001):
            archive.writestr(f"{number}.csv", b"")
    refused(gnomon.read, tmp_path / "log.zip", made.getvalue(), "10001 files in one zip")


@pytest.mark.parametrize("prefix", ["../../", "/tmp/", "C:\\", "\\\\server\\", ""])
def test_zips_with_paths_and_links_write_nothing(tmp_path, prefix):
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(phone("sensor-logger")["packed.zip"])) as whole, zipfile.ZipFile(made, "w") as evil:
        for member in whole.infolist():
            evil.writestr(prefix + member.filename, whole.read(member))
        link = zipfile.ZipInfo("Link.csv")
        link.external_attr = 0o120777 << 16  # a symbolic link
        evil.writestr(link, "/etc/passwd")
    before = sorted(tmp_path.rglob("*"))
    tried(gnomon.read, tmp_path / "log.zip", made.getvalue())
    assert sorted(tmp_path.rglob("*")) == [*before, tmp_path / "log.zip"]


@pytest.mark.usefixtures("little")
@pytest.mark.parametrize("name", ["bz2", "lz4", "zstd"])
def test_chunks_of_bags_are_unpacked_up_to_a_bound(name):
    if name == "bz2":
        pack = bz2.compress
    elif name == "lz4":
        pack = pytest.importorskip("lz4.frame").compress
    else:
        pack = pytest.importorskip("backports.zstd").compress
    text = os.urandom(5000) * 9
    assert unpack_bytes(name, pack(text)) == text
    assert unpack_bytes(name, pack(text) + pack(b"more")) == text + b"more"
    with pytest.raises(TooLargeError, match="would be unpacked to more than"):
        unpack_bytes(name, pack(bytes(8 << 20)))
    with pytest.raises(Exception, match=r".+"):
        unpack_bytes(name, pack(text)[:-9])


@pytest.mark.parametrize("at", [6, 8, 10])
@pytest.mark.parametrize("value", [1, 9, 12, 14, 95, 99])
def test_zips_that_are_locked_or_packed_in_ways_of_their_own(tmp_path, at, value):
    """Bytes of each entry are changed: the version, the flags (a password), the method of packing."""
    for name, data in (("rec.npz", npz(compressed=True)), ("log.zip", phone("sensor-logger")["packed.zip"])):
        changed = bytearray(data)
        for mark, behind in ((b"PK\x03\x04", at - 2), (b"PK\x01\x02", at)):
            place = changed.find(mark)
            while place >= 0:
                changed[place + behind] = value
                place = changed.find(mark, place + 4)
        for read in (gnomon.read, streamed) if name == "rec.npz" else (gnomon.read,):
            tried(read, tmp_path / name, bytes(changed))


# ---- arrays ----


def header(text: str, body: bytes = b"") -> bytes:
    """Return an NPY file with a header made by hand."""
    data = text.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(data)) + data + body


def archive_of(**arrays: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return made.getvalue()


@pytest.mark.parametrize("read", [gnomon.read, streamed])
@pytest.mark.parametrize(
    "shape",
    ["(1000000000000, 3)", "(-1, 3)", "(4611686018427387904, 3)", "(9, 3000000000)", "(2, 3, 1000000000)", "'x'"],
)
def test_headers_of_arrays_that_are_lies(tmp_path, read, shape):
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}"
    data = archive_of(accelerometer=header(text, bytes(240)), t_s=header(text, bytes(240)))
    refused(read, tmp_path / "rec.npz", data)


@pytest.mark.parametrize("read", [gnomon.read, streamed])
@pytest.mark.parametrize(
    "text", ["(" * 9000, "-" * 5000 + "1", "{'descr': 'O', 'fortran_order': False, 'shape': (3,)}"]
)
def test_headers_of_arrays_that_are_no_headers(tmp_path, read, text):
    refused(read, tmp_path / "rec.npz", archive_of(accelerometer=header(text)))


class Bad:
    def __reduce__(self):
        return os.mkdir, ("made-by-a-pickle",)


@pytest.mark.parametrize("read", [gnomon.read, streamed])
def test_arrays_of_objects_run_nothing(tmp_path, read, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "{'descr': '|O', 'fortran_order': False, 'shape': (10, 3)}"
    body = pickle.dumps(Bad()) + bytes(1000)
    data = archive_of(accelerometer=header(text, body), gyroscope=header(text, body), t_s=header(text, body))
    refused(read, tmp_path / "rec.npz", data)
    assert not (tmp_path / "made-by-a-pickle").exists()


# ---- tables ----


@pytest.mark.parametrize("read", [gnomon.read, streamed])
@pytest.mark.parametrize(
    "text",
    [
        b"1," * 5_000_000, b"1" * 20_000_000, b"(" * 70_000, b" " * 70_000 + b"x",
        b"a " * 40_000 + b"\n" + b"1 " * 40_000,
        b"\0" * 100, b"\xff\xfe" + b"\xd8\x00" * 50, b"\xef\xbb\xbf\xef\xbb\xbf1,2,3\n",
        b"\n" * 1_000_000, b"#" * 70_000, b"fs " + b"1." * 30_000 + b"\n1,2,3\n2,3,4\n", b"1,2,3\n" + b"1" * 3_000_000,
        b'"' * 70_000, b"1e999,1,2,3\n" * 9, b"9999999999999999999999,1,2,3\n" * 9, b"-1,0,0,0\n" * 9,
    ],
    ids=lambda text: repr(text[:9]),
)  # fmt: skip
def test_tables_without_end(tmp_path, read, text):
    assert tried(read, tmp_path / "rec.csv", text, per_byte=60) is not None


# ---- pictures, videos, telemetry ----


def png(width: int, height: int, rows: int = 1) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    content = zlib.compress(bytes(width + 1) * rows)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", content) + chunk(b"IEND", b"")


def test_pictures_that_claim_to_be_huge(tmp_path):
    grey = np.zeros((8, 16), np.uint8)
    jpeg, bmp, tiff = (bytearray(cv2.imencode(suffix, grey)[1].tobytes()) for suffix in (".jpg", ".bmp", ".tif"))
    at = next(i for i in range(len(jpeg)) if jpeg[i] == 0xFF and jpeg[i + 1] in {0xC0, 0xC2})
    jpeg[at + 5 : at + 9] = struct.pack(">HH", MANY, MANY)
    bmp[18:26] = struct.pack("<ii", MANY, -MANY)
    place = struct.unpack_from("<I", tiff, 4)[0] + 2
    for tag in range(struct.unpack_from("<H", tiff, place - 2)[0]):
        if struct.unpack_from("<H", tiff, place + 12 * tag)[0] in {256, 257}:
            tiff[place + 12 * tag + 2 : place + 12 * tag + 12] = struct.pack("<HII", 4, 1, MANY)
    pnm = b"P5 60000 60000 255\n" + bytes(99)
    webp = b"RIFF\x30\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(4) + struct.pack("<I", MANY - 1)[:3] * 2 + bytes(32)
    for data in (png(MANY, MANY), bytes(jpeg), bytes(bmp), bytes(tiff), pnm, webp):
        assert stated_pixels(memoryview(data)) == MANY**2
        refused(lambda path: read_grey(path, path.name), tmp_path / "a.png", data, "3600 megapixels")


def test_pictures_that_are_large_and_honest_are_read(tmp_path):
    """A lens cap is on: a picture of 40 megapixels shrinks to a thousandth."""
    (tmp_path / "a.png").write_bytes(png(8000, 5000, 5000))
    assert read_grey(tmp_path / "a.png", "a.png").shape == (5000, 8000)


@pytest.mark.parametrize("size", [0, 1, 7, 8, 0x7FFFFFFF, 0xFFFFFFFF])
@pytest.mark.parametrize("kind", ["moov", "mdat", "trak", "stsz"])
def test_boxes_of_mp4_with_false_sizes(tmp_path, kind, size):
    head = box("ftyp", b"mp41", bytes(4), b"mp41")
    inner = struct.pack(">I", size) + kind.encode() + bytes(64)
    for data in (
        head + inner,
        head + box("moov", inner),
        head + box("moov", box("trak", box("mdia", inner))) + bytes(9),
    ):
        refused(gnomon.read, tmp_path / "a.mp4", data)
        refused(lambda path: open_images(path, need_imu=False), tmp_path / "a.mp4", data)


def test_boxes_in_boxes(tmp_path):
    data = b"".join(struct.pack(">I", 8 * (5000 - i)) + b"moov" for i in range(5000))
    refused(gnomon.read, tmp_path / "a.mp4", box("ftyp", b"mp41", bytes(4), b"mp41") + data)


def test_telemetry_that_ends_behind_the_file(tmp_path):
    far = entry("DEVC", None, b"STRM" + b"\0\x01\xff\xff" + b"ACCLs\xff\xff\xff")
    nested = b""
    for _ in range(3000):
        nested = entry("STRM", None, nested)
        if len(nested) > 60_000:
            break
    for data in (far, b"DEVC\0\xff\xff\xff", entry("DEVC", None, nested), b"DEVC" + b"\xff" * 400):
        refused(gnomon.read, tmp_path / "a.bin", data)


# ---- bags ----


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "..", "", "\0", "x" * 5000, "metadata.yaml"])
def test_paths_in_the_description_of_a_bag(tmp_path, name):
    """Files of a bag are those in its folder, whatever path is written."""
    path = make_bag(tmp_path, "ros2", usual(images=1, samples=3))
    text = (path / "metadata.yaml").read_text()
    held = next(path.glob("*.db3")).name
    assert held in text
    changed = text.replace(held, json.dumps(name)).encode()
    target = Target(
        name="bag", file="metadata.yaml", seeds=list, read=lambda folder: open_images(folder, need_imu=False)
    )
    assert isinstance(keep(target, path, changed), GnomonError)


@pytest.mark.parametrize("size", [0, -1, 2**31, 2**63 - 1, -(2**63)])
def test_records_of_bags_with_false_sizes(tmp_path, size):
    """A size is put at every place of a bag's first records in turn."""
    for form, step in (("ros1", 97), ("mcap", 41)):
        path = make_bag(tmp_path, form, usual(images=1, samples=2), name=f"{form}{abs(size)}")
        data = path.read_bytes() if path.is_file() else next(path.glob("*.mcap")).read_bytes()
        wide = struct.pack("<q", size)
        for at in range(13, len(data) - 8, max(len(data) // 12, step)):
            tried(open_images, tmp_path / f"a.{form}.bag", data[:at] + wide + data[at + 8 :],
                  floor_bytes=320 << 20)  # fmt: skip


def test_a_database_that_is_no_bag(tmp_path):
    import sqlite3

    base = sqlite3.connect(tmp_path / "made.db3")
    base.execute("CREATE TABLE messages(a)")
    base.commit()
    base.close()
    refused(open_images, tmp_path / "a.db3", (tmp_path / "made.db3").read_bytes(), "SQLite file without ROS 2's tables")


def test_topics_with_names_of_all_kinds(tmp_path):
    names = ("/../../x", "/a b", "/<b>", "/\x1b[2J", "/" + "x" * 300)
    for number, name in enumerate(names):
        path = make_bag(tmp_path, "ros1", usual(images=2, samples=9, cameras=(name,)), name=f"{number}.bag")
        assert list(open_images(path).streams) == ["cam0"]


def test_a_gap_in_a_file_costs_nothing(tmp_path):
    """A file of a terabyte without content is refused by its first bytes, or by its size."""
    path = tmp_path / "a.csv"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(RecordingError, match=r"binary file|fit into memory"):
        gnomon.read(path)
    path.unlink()
