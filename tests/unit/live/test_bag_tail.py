"""A bag that another program is writing, followed record by record."""

import struct
import time
from itertools import pairwise
from threading import Event, Thread

import numpy as np
import pytest

import gnomon
from bag_maker import NAMES, T0, imu, make_bag, usual
from gnomon.errors import RecordingError
from gnomon.live.session import LiveSession
from gnomon.live.sources import open_source
from gnomon.options.requirements import GENERAL_IMU
from gnomon.readers.bags.salvage import MCAP_MAGIC

APART = [
    message
    for k in range(60)
    for message in (
        imu("/imu/accel", T0 + 5_000_000 * k, gyro=(0, 0, 0), accel=(0.1 * k, 0, 9.8)),
        imu("/imu/gyro", T0 + 5_000_000 * k + 1_000_000, gyro=(0, 0.1 * k, 0.2), accel=(0, 0, 0)),
        imu("/other", T0 + 5_000_000 * k, gyro=(9, 9, 9)),
    )
]


def bag_file(path):
    return path if path.is_file() else next(file for file in path.iterdir() if file.suffix in {".mcap", ".db3"})


def followed(grown, contents, until=lambda source, found: False, seconds=5.0):
    """Write a file piece by piece while it is followed; return what was told, what arrived, and what was wrong."""
    source, stop, found, wrong = open_source(f"tail:{grown}"), Event(), [], []
    grown.write_bytes(contents[0])

    def work():
        try:
            for arrival in source.arriving_lines(stop):
                found.append(arrival)  # noqa: PERF402 (seen meanwhile)
        except RecordingError as error:
            wrong.append(str(error))

    thread = Thread(target=work, daemon=True)
    thread.start()
    with grown.open("ab") as file:
        for piece in contents[1:]:
            time.sleep(0.12)
            file.write(piece)
            file.flush()
    end = time.monotonic() + seconds
    while not (wrong or source.ended or until(source, found)) and time.monotonic() < end:
        time.sleep(0.02)
    told = source.trouble
    stop.set()
    thread.join(2.0)
    return told, found, wrong


def pieces_of(data, count=5):
    places = np.linspace(0, len(data), count + 1).astype(int)
    return [data[a:b] for a, b in pairwise(places)]


@pytest.mark.parametrize("form", ["mcap", "ros1"])
@pytest.mark.parametrize("messages", [usual(samples=60), APART], ids=["one topic", "two topics"])
def test_what_is_followed_is_what_is_read_when_it_is_complete(tmp_path, form, messages):
    whole = make_bag(tmp_path, form, [one for one in messages if one.topic != "/other"])
    mixed = bag_file(make_bag(tmp_path, form, messages, name=f"mixed-{NAMES[form]}"))
    count = 2 * 60 + 2 if messages is APART else 60 + 1
    grown, pieces = tmp_path / "grown", pieces_of(mixed.read_bytes())
    told, found, _ = followed(grown, pieces, until=lambda _, found: form == "ros1" and len(found) == count)
    assert len(found) == count
    assert ("complete" in told) == (form == "mcap")
    session = LiveSession(open_source(f"tail:{grown}"), tmp_path / "rec", GENERAL_IMU)
    for line, stream in found:
        session.take_line(line, stream)
    session.end_recording()
    expected, kept = gnomon.read(whole).imus["imu0"], gnomon.read(tmp_path / "rec").imus["imu0"]
    for triad in ("accelerometer", "gyroscope"):
        assert np.array_equal(getattr(kept, triad).values, getattr(expected, triad).values)
        assert np.array_equal(np.diff(getattr(kept, triad).t_ns), np.diff(getattr(expected, triad).t_ns))


def unchunked(data):
    """Return an MCAP file without its chunk: its records stand for themselves."""
    at, found = len(MCAP_MAGIC), []
    while at < len(data) - len(MCAP_MAGIC):
        op, length = struct.unpack_from("<BQ", data, at)
        if op == 6:
            size = struct.unpack_from("<I", data, at + 9 + 28)[0]
            found.append(data[at + 9 + 28 + 4 + size + 8 : at + 9 + length])
        elif op < 3:
            found.append(data[at : at + 9 + length])
        at += 9 + length
    return MCAP_MAGIC + b"".join(found[:2])


def test_a_file_that_grows_by_seconds_at_once_is_told_how_to_grow(tmp_path):
    slow = [imu("/imu0", T0 + 100_000_000 * k, (0.1, 0.2, 0.3)) for k in range(120)]
    data = unchunked(bag_file(make_bag(tmp_path, "mcap", slow)).read_bytes())
    told, _, _ = followed(tmp_path / "grown", pieces_of(data, 3), until=lambda source, _: "chunks" in source.trouble)
    assert "pieces of 4 s" in told
    assert "fastwrite" in told


def test_a_bag_in_sqlite_and_a_folder_are_refused_in_words(tmp_path):
    bag = bag_file(make_bag(tmp_path, "ros2", usual()))
    _, found, wrong = followed(tmp_path / "grown", [bag.read_bytes()])
    assert not found
    assert "MCAP" in wrong[0]
    with pytest.raises(RecordingError, match="name the file"):
        next(open_source(f"tail:{tmp_path}").arriving_lines(Event()))
