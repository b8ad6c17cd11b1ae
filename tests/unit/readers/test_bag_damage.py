"""Bags that end early, are damaged, or are compressed in an unknown way: what there is is read, the rest is said."""

import re
import sqlite3
import struct
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from bag_maker import T0, Message, image, imu, make_bag, picture, usual
from gnomon.errors import GnomonError, RecordingError
from gnomon.readers.bags.bag import is_bag_path, open_bag

LZ4, BZ2 = (Writer1.CompressionFormat.LZ4,), (Writer1.CompressionFormat.BZ2,)
ZSTD = (CompressionMode.STORAGE, CompressionFormat.ZSTD)
KINDS = [("ros1", None), ("ros1", LZ4), ("ros1", BZ2), ("ros2", None), ("mcap", None), ("mcap", ZSTD)]
SHAPE, COUNT = (375, 400), 30  # the writers begin a new chunk after 1 MiB


def long(count=COUNT) -> list[Message]:
    """Make a recording that fills several chunks, images and samples in turn."""
    noise = [picture(i, SHAPE) for i in range(count)]
    messages = [image("/cam", T0 + i * 50_000_000, pixels) for i, pixels in enumerate(noise)]
    messages += [imu("/imu", T0 + i * 5_000_000, (i, 1, 2)) for i in range(10 * count)]
    return sorted(messages, key=lambda message: message.t_ns)


def file_of(path: Path) -> Path:
    return path if path.is_file() else next(file for file in path.iterdir() if file.suffix in {".db3", ".mcap"})


def read(path):
    """Return timestamps and images of a recording, timestamps of its samples, and all that was said."""
    recording, notes = open_bag(path), []
    frames = list(recording.streams["cam0"].frames(notes))
    assert notes == []  # all was said when the bag was opened
    assert recording.streams["cam0"].count == len(frames)
    pixels = {frame.t_ns: frame.decode() for frame in frames}
    return pixels, recording.imus["imu0"].gyroscope, recording.assumptions


@pytest.mark.parametrize("part", [0.45, 0.9])
@pytest.mark.parametrize(("form", "compression"), [kind for kind in KINDS if kind[1] != BZ2])  # it takes its time
def test_a_bag_that_is_cut_off_is_read_as_far_as_it_goes(form, compression, part, tmp_path):
    file = file_of(make_bag(tmp_path, form, long(), compression=compression))
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    pixels, samples, notes = read(file)
    assert (part - 0.25) * COUNT < len(pixels) <= part * COUNT + 1
    assert list(pixels) == [T0 + i * 50_000_000 for i in range(len(pixels))]
    for i, found in enumerate(pixels.values()):
        np.testing.assert_array_equal(found, picture(i, SHAPE))
    np.testing.assert_array_equal(samples.values[:, 0], np.arange(len(samples)))
    assert len(samples) >= 10 * (len(pixels) - 1)
    (said,) = [note for note in notes if "ends early" in note]
    assert re.search(rf"{file.name} ends early: .* \d+ messages were read from", said)


@pytest.mark.parametrize("form", ["ros2", "mcap"])
def test_a_ros2_folder_whose_file_is_cut_off_is_read_as_far_as_it_goes(form, tmp_path):
    folder = make_bag(tmp_path, form, long())
    file = file_of(folder)
    file.write_bytes(file.read_bytes()[:1_000_000])
    pixels, _, notes = read(folder)
    assert 3 <= len(pixels) < 8
    assert any("ends early" in note for note in notes)


def test_a_ros1_bag_without_index_is_read_to_its_end(tmp_path):
    path = make_bag(tmp_path, "ros1", long())
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack_from("<Q", data, at)
    data[at : at + 8] = bytes(8)  # a recorder that was stopped leaves it so
    path.write_bytes(data[:index])
    pixels, samples, notes = read(path)
    assert (len(pixels), len(samples)) == (COUNT, 10 * COUNT)
    assert any("330 messages were read from 100 %" in note for note in notes)


@pytest.mark.parametrize(
    ("form", "compression", "magic"),
    [("ros1", LZ4, b"\x04\x22\x4d\x18"), ("ros1", BZ2, b"BZh9"), ("mcap", ZSTD, b"\x28\xb5\x2f\xfd")],
)
def test_a_damaged_chunk_is_left_out(form, compression, magic, tmp_path):
    file = file_of(make_bag(tmp_path, form, long(18), compression=compression))
    data = bytearray(file.read_bytes())
    at = data.index(magic, len(data) // 3)
    data[at : at + 4] = bytes(4)
    file.write_bytes(data)
    pixels, samples, notes = read(file)
    assert 9 <= len(pixels) <= 11
    assert 90 <= len(samples) <= 120
    for stamp, found in pixels.items():
        np.testing.assert_array_equal(found, picture((stamp - T0) // 50_000_000, SHAPE))
    assert any("1 damaged chunk was left out" in note for note in notes)


def test_messages_that_vanish_without_a_word_are_missed(tmp_path):
    file = file_of(make_bag(tmp_path, "mcap", long()))
    data = bytearray(file.read_bytes())
    at = data.index(b"mono8", len(data) // 2) - 100  # no checksum guards what is not compressed
    data[at : at + 100] = bytes(100)
    file.write_bytes(data)
    pixels, _, notes = read(file)
    assert len(pixels) < COUNT
    assert any("damaged" in note for note in notes)


def swap(path: Path, old: bytes, new: bytes) -> None:
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))


@pytest.mark.parametrize(
    ("form", "compression", "old", "new"),
    [("ros1", LZ4, b"compression=lz4", b"compression=foo"), ("mcap", ZSTD, b"\4\0\0\0zstd", b"\4\0\0\0foo4")],
)
def test_chunks_that_are_compressed_in_an_unknown_way_are_named(form, compression, old, new, tmp_path):
    file = file_of(make_bag(tmp_path, form, usual(), compression=compression))
    swap(file, old, new)
    with pytest.raises(RecordingError, match=rf'{file.name}: its chunks are compressed with "foo4?".*bz2, lz4, zstd'):
        open_bag(file)


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_a_ros2_bag_that_is_compressed_in_an_unknown_way_is_named(mode, tmp_path):
    folder = make_bag(tmp_path, "ros2", usual(), compression=(mode, CompressionFormat.ZSTD))
    swap(folder / "metadata.yaml", b"compression_format: zstd", b"compression_format: foo")
    with pytest.raises(RecordingError, match=rf'each {mode.name.lower()} is compressed with "foo".*ros2 bag convert'):
        open_bag(folder)


def test_a_file_compressed_with_zstd_says_how_to_unpack_it(tmp_path):
    folder = make_bag(tmp_path, "ros2", usual(), compression=(CompressionMode.FILE, CompressionFormat.ZSTD))
    (file,) = (file for file in folder.iterdir() if file.name != "metadata.yaml")
    with pytest.raises(RecordingError, match=rf"zstd -d {re.escape(file.name)}"):
        open_bag(file)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"hello, this is no bag at all", "this is neither a ROS 1 bag"),
        (b"#ROSBAG V1.2\n", r"neither a ROS 1 bag \(version 2.0\).*ROSBAG V1.2"),
        (b"#ROSBAG V2.0\n", "no message can be read"),
        (b"\x89MCAP0\r\n", "no message can be read"),
        (b"SQLite format 3\0" + bytes(200), "no message can be read"),
    ],
)
def test_what_only_has_the_name_of_a_bag(name, content, words, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    assert is_bag_path(path)
    with pytest.raises(RecordingError, match=words):
        open_bag(path)


def test_an_sqlite_file_of_something_else(tmp_path):
    path = tmp_path / "history.db3"
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE visits (id INTEGER)")
    with pytest.raises(RecordingError, match=r"history.db3: an SQLite file without ROS 2's tables"):
        open_bag(path)


def test_folders_without_a_bag(tmp_path):
    with pytest.raises(RecordingError, match=r"no bag in this folder. Expected metadata.yaml"):
        open_bag(tmp_path)
    folder = make_bag(tmp_path, "ros2", usual())
    file_of(folder).unlink()
    with pytest.raises(RecordingError, match=r"metadata.yaml names rec.db3, which is not there"):
        open_bag(folder)


def test_a_metadata_file_that_was_not_finished_is_left_aside(tmp_path):
    folder = make_bag(tmp_path, "ros2", usual())
    (folder / "metadata.yaml").write_bytes(b"")
    pixels, _, notes = read(folder)
    assert len(pixels) == 3
    assert any("the recorder was probably stopped" in note for note in notes)


def test_a_bag_without_messages(tmp_path):
    path = make_bag(tmp_path, "ros1", [])
    with pytest.raises(RecordingError, match=r"rec.bag: no topic holds images.* It holds:\n  no topic at all"):
        open_bag(path)


@pytest.mark.parametrize(("form", "compression"), KINDS)
def test_no_damage_leads_to_anything_but_a_message_or_a_recording(form, compression, tmp_path):
    file = file_of(make_bag(tmp_path, form, usual(images=5), compression=compression))
    whole, rng = file.read_bytes(), np.random.default_rng(11)
    for _ in range(40):
        data = bytearray(whole)
        if rng.integers(2):
            data = data[: rng.integers(1, len(data))]
        for _ in range(rng.integers(1, 5)):
            start, length = rng.integers(len(data)), int(10 ** rng.uniform(0, 3))
            data[start : start + length] = rng.bytes(len(data[start : start + length]))
        file.write_bytes(data)
        with suppress(GnomonError):  # nothing else may come out of it
            for frame in open_bag(file).streams["cam0"].frames([]):
                frame.decode()


@pytest.mark.parametrize(("form", "compression"), [("ros1", None), ("mcap", None)])
@pytest.mark.parametrize("index", [True, False])
def test_a_bag_that_vanishes_while_it_is_read_is_said(form, compression, index, tmp_path):
    file = file_of(make_bag(tmp_path, form, usual(), compression=compression))
    if not index:
        file.write_bytes(file.read_bytes()[:-8])
    stream, notes = open_bag(file).streams["cam0"], []
    file.unlink()
    assert list(stream.frames(notes)) == []
    assert re.search(rf"{file.name}: /cam0/image_raw: the images end early", notes[0])
