"""Bags of ROS 1 and ROS 2 that are whole: what is in them is read as it was written."""

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from bag_maker import FORMS, T0, compressed, image, imu, make_bag, other, picture, usual
from gnomon.errors import RecordingError
from gnomon.readers.bags.bag import is_bag_path, open_bag
from gnomon.readers.bags.messages import imu_block
from gnomon.readers.files import file_source
from gnomon.units import Units

LOSSLESS = Writer1.CompressionFormat
ZSTD = CompressionFormat.ZSTD


def all_frames(stream):
    notes = []
    frames = list(stream.frames(notes))
    assert notes == []
    return frames


def check_usual(recording, messages):
    """Compare a recording of one camera and one IMU with the messages that were written."""
    images = [message for message in messages if message.kind == "Image"]
    samples = [message for message in messages if message.kind == "Imu"]
    stream, found = recording.streams["cam0"], recording.imus["imu0"]
    assert (stream.count, stream.topic, found.topic) == (len(images), images[0].topic, samples[0].topic)
    for _ in range(2):  # frames are there as often as they are asked for
        frames = all_frames(stream)
        assert [frame.t_ns for frame in frames] == [message.t_ns for message in images]
        for frame, message in zip(frames, images, strict=True):
            np.testing.assert_array_equal(frame.decode().ravel(), message.fields["data"])
    for triad, name in (("gyroscope", "gyro"), ("accelerometer", "accel")):
        np.testing.assert_array_equal(
            getattr(found, triad).values, [message.fields[name] for message in samples]
        )  # to the last digit
        np.testing.assert_array_equal(getattr(found, triad).t_ns, [message.t_ns for message in samples])
    assert (found.accelerometer.unit, found.gyroscope.unit) == ("m/s^2", "rad/s")
    for arrivals, sent in ((stream.arrivals, images), (recording.imu_arrivals["imu0"], samples)):
        np.testing.assert_array_equal(arrivals.t_ns, [message.t_ns for message in sent])
        np.testing.assert_array_equal(arrivals.received_ns - arrivals.t_ns, 2_000_000)


@pytest.mark.parametrize(
    ("form", "compression"),
    [
        ("ros1", None),
        ("ros1", (LOSSLESS.BZ2,)),
        ("ros1", (LOSSLESS.LZ4,)),
        ("ros2", None),
        ("ros2", (CompressionMode.MESSAGE, ZSTD)),
        ("ros2", (CompressionMode.FILE, ZSTD)),
        ("mcap", None),
        ("mcap", (CompressionMode.STORAGE, ZSTD)),
    ],
)
def test_what_was_written_is_read(form, compression, tmp_path):
    messages = usual()
    path = make_bag(tmp_path, form, [*messages, other("/temperature", T0)], compression=compression)
    assert is_bag_path(path)
    recording = open_bag(path)
    check_usual(recording, messages)
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.name != "metadata.yaml"]
    assert recording.sources == tuple(map(file_source, files))


@pytest.mark.parametrize("form", ["ros2", "mcap"])
def test_the_file_of_a_ros2_bag_alone_is_read(form, tmp_path):
    messages = usual()
    folder = make_bag(tmp_path, form, messages)
    (file,) = (file for file in folder.iterdir() if file.name != "metadata.yaml")
    assert is_bag_path(file)
    check_usual(open_bag(file), messages)


@pytest.mark.parametrize("form", FORMS)
def test_the_content_counts_not_the_name(form, tmp_path):
    messages = usual()
    path = make_bag(tmp_path, form, messages)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.name != "metadata.yaml")
    renamed = file.rename(tmp_path / "a file # with 100 % of odd names")
    assert is_bag_path(renamed)
    recording = open_bag(renamed)
    check_usual(recording, messages)
    assert not any("early" in note for note in recording.assumptions)


@pytest.mark.parametrize("form", ["ros2", "mcap"])
def test_a_folder_without_metadata_is_read_with_a_note(form, tmp_path):
    messages = usual()
    folder = make_bag(tmp_path, form, messages)
    (folder / "metadata.yaml").unlink()
    assert is_bag_path(folder)
    recording = open_bag(folder)
    check_usual(recording, messages)
    assert any("there is no metadata.yaml" in note for note in recording.assumptions)


def test_a_bag_in_several_files_is_one_recording(tmp_path):
    messages = usual(images=6)
    folder = tmp_path / "split"
    folder.mkdir()
    for part, (first, last) in enumerate(((0, 20), (20, 30), (30, None))):
        make_bag(folder, "ros1", messages[first:last], name=f"rec_{2 * part}.bag")
    recording = open_bag(folder)
    check_usual(recording, messages)
    assert [source.name for source in recording.sources] == ["rec_0.bag", "rec_2.bag", "rec_4.bag"]
    make_bag(folder, "ros1", messages, name="another.bag")
    with pytest.raises(RecordingError, match=r"4 bags in this folder \(.*another.bag"):
        open_bag(folder)


def test_an_old_bag_of_ros2_without_definitions_is_read(tmp_path):
    messages = usual()
    folder = make_bag(tmp_path, "ros2", messages)
    with closing(sqlite3.connect(folder / "rec.db3")) as base, base:
        for table in ("schema", "metadata", "message_definitions"):
            base.execute(f"DROP TABLE {table}")
        for column in ("type_description_hash", "offered_qos_profiles"):
            base.execute(f"ALTER TABLE topics DROP COLUMN {column}")
    check_usual(open_bag(folder / "rec.db3"), messages)


def test_an_mcap_file_with_messages_of_ros1_is_read(tmp_path):
    """Such files come out of `mcap convert`; rosbags does not read them."""
    messages = usual()
    channels = {"sensor_msgs/Image": 1, "sensor_msgs/Imu": 2}

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    def record(op, content):
        return struct.pack("<BQ", op, len(content)) + content

    with Reader1(make_bag(tmp_path, "ros1", messages)) as reader:
        body = record(1, text("ros1") + text("test"))
        for kind, number in channels.items():
            topic = "/imu0" if number == 2 else "/cam0/image_raw"
            body += record(3, struct.pack("<H", number) + text(kind) + text("ros1msg") + text(""))
            body += record(4, struct.pack("<HH", number, number) + text(topic) + text("ros1") + bytes(4))
        for link, received, data in reader.messages():
            number = channels[link.msgtype.replace("/msg/", "/")]
            body += record(5, struct.pack("<HIQQ", number, 0, received, received) + data)
    body += record(15, bytes(4)) + record(2, bytes(20))
    path = tmp_path / "ros1.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + body + b"\x89MCAP0\r\n")
    recording = open_bag(path)
    check_usual(recording, messages)
    assert not any("early" in note for note in recording.assumptions)


def test_what_is_no_bag(tmp_path):
    (tmp_path / "mav0").mkdir()
    (tmp_path / "samples.csv").write_text("t,ax,ay,az\n")
    (tmp_path / "metadata.yaml").write_text("camera: cam0\n")
    assert not any(map(is_bag_path, (tmp_path, tmp_path / "mav0", tmp_path / "samples.csv", tmp_path / "nothing")))


@pytest.mark.parametrize("form", FORMS)
def test_compressed_images_are_read(form, tmp_path):
    pixels = picture(shape=(24, 32))
    files = [cv2.imencode(suffix, pixels)[1].tobytes() for suffix in (".png", ".png", ".jpg")]
    messages = [compressed("/cam/compressed", T0 + i, file, f"mono8; {i}") for i, file in enumerate(files)]
    for message, kind in zip(messages, ("png", "png", "jpeg"), strict=True):
        message.fields["format"] = f"mono8; {kind} compressed "
    path = make_bag(tmp_path, form, [*messages, imu("/imu", T0)])
    frames = all_frames(open_bag(path).streams["cam0"])
    np.testing.assert_array_equal(frames[0].decode(), pixels)
    assert np.abs(frames[2].decode().astype(int) - pixels).mean() < 10


@pytest.mark.parametrize("form", FORMS)
def test_sixteen_bits_have_one_scale_for_the_whole_stream(form, tmp_path):
    bright = np.full((4, 6), 4000, np.uint16)
    messages = [image("/cam", T0 + i, pixels, "mono16") for i, pixels in enumerate((bright // 40, bright, bright // 2))]
    recording = open_bag(make_bag(tmp_path, form, [*messages, imu("/imu", T0)]))
    assert [int(frame.decode()[0, 0]) for frame in all_frames(recording.streams["cam0"])] == [100 >> 4, 250, 125]
    assert any("12 bits" in note for note in recording.assumptions)


def test_one_damaged_image_leaves_the_others(tmp_path):
    messages = [image("/cam", T0 + i, picture(i)) for i in range(3)]
    messages[0].fields["data"] = messages[0].fields["data"][:100]
    recording = open_bag(make_bag(tmp_path, "mcap", [*messages, imu("/imu", T0)]))
    first, *rest = all_frames(recording.streams["cam0"])
    with pytest.raises(RecordingError, match=r"rec_mcap: /cam at 1403636579\.758555392 s: the image is damaged"):
        first.decode()
    np.testing.assert_array_equal([frame.decode() for frame in rest], [picture(1), picture(2)])


@pytest.mark.parametrize("form", FORMS)
def test_samples_whose_frame_id_changes_are_read(form, tmp_path):
    names = ["", "a", "imu", "imu_link", "a_frame_with_a_long_name", "imu"]
    messages = [imu("/imu", T0 + i, (i, 2 * i, 3.5), (9, i, 1), frame_id=name) for i, name in enumerate(names)]
    samples = open_bag(make_bag(tmp_path, form, [*messages, image("/cam", T0, picture())])).imus["imu0"]
    np.testing.assert_array_equal(samples.gyroscope.values, [message.fields["gyro"] for message in messages])
    np.testing.assert_array_equal(samples.accelerometer.values, [message.fields["accel"] for message in messages])


def test_big_endian_messages_are_read():
    header = (1).to_bytes(4, "big") + (2).to_bytes(4, "big") + (4).to_bytes(4, "big") + b"imu\0"
    numbers = np.arange(37.0)
    block = imu_block([b"\0\0\0\0" + header + numbers.astype(">f8").tobytes()], "cdr")
    assert block.t_ns.tolist() == [1_000_000_002]
    np.testing.assert_array_equal(block.gyroscope, [[13, 14, 15]])
    np.testing.assert_array_equal(block.accelerometer, [[25, 26, 27]])


@pytest.mark.parametrize("data", [b"", bytes(20), b"\0\1\0\0" + bytes(200), b"\0\7\0\0" + bytes(400)])
def test_samples_that_are_none_are_left_out(data):
    header = bytes([0, 1, 0, 0, 5, 0, 0, 0, 6, 0, 0, 0, 1, 0, 0, 0, 0]) + bytes(3)
    block = imu_block([data, header + np.arange(37.0).tobytes(), data], "cdr")
    assert (block.place.tolist(), block.t_ns.tolist()) == ([1], [5_000_000_006])
    np.testing.assert_array_equal(block.gyroscope, [[13, 14, 15]])


def test_samples_out_of_order_are_sorted_with_a_note(tmp_path):
    messages = usual()
    stamps = [T0 + i * 5_000_000 for i in range(40)]
    stamps[10], stamps[11] = stamps[11], stamps[10]
    for stamp, message in zip(stamps, (m for m in messages if m.kind == "Imu"), strict=True):
        message.received_ns, message.t_ns = message.t_ns, stamp
    recording = open_bag(make_bag(tmp_path, "ros1", messages))
    np.testing.assert_array_equal(recording.imus["imu0"].gyroscope.t_ns, sorted(stamps))
    assert sum("imu0: the timestamps go back at 1 of 40 samples" in note for note in recording.assumptions) == 1


@pytest.mark.parametrize("form", FORMS)
def test_zero_stamps_give_way_to_the_times_of_receipt(form, tmp_path):
    messages = usual()
    for message in messages:
        message.received_ns = message.t_ns + 1_234_567
        if message.kind == "Image":
            message.t_ns = 0
    recording = open_bag(make_bag(tmp_path, form, messages))
    stamps = [message.received_ns for message in messages if message.kind == "Image"]
    assert [frame.t_ns for frame in all_frames(recording.streams["cam0"])] == stamps
    assert recording.streams["cam0"].arrivals is None
    assert recording.imus["imu0"].gyroscope.t_ns[0] == T0  # timestamps that are in the same clock stay
    assert any("/cam0/image_raw: all timestamps are zero" in note for note in recording.assumptions)


def test_without_stamps_of_the_images_another_clock_of_the_imu_is_left_aside(tmp_path):
    messages = usual()
    for message in messages:
        message.received_ns = message.t_ns
        message.t_ns = (
            0 if message.kind == "Image" else message.t_ns - T0 + 10**9
        )  # counts from when it was switched on
    recording = open_bag(make_bag(tmp_path, "ros2", messages))
    assert recording.imus["imu0"].gyroscope.t_ns[0] == T0
    assert any("/imu0: its timestamps are not in the recorder's clock" in note for note in recording.assumptions)


def test_a_single_stamp_of_zero_among_others(tmp_path):
    messages = usual()
    messages[-1].received_ns, messages[-1].t_ns = messages[-1].t_ns, 0
    recording = open_bag(make_bag(tmp_path, "ros2", messages))
    assert len(recording.imus["imu0"].gyroscope) == 39
    assert any("/imu0: 1 of 40 messages have no timestamp" in note for note in recording.assumptions)
    simulated = [message for message in usual() if message.t_ns - T0 < 10**9]
    for message in simulated:
        message.t_ns -= T0  # a clock that starts at zero
    (tmp_path / "simulated").mkdir()
    recording = open_bag(make_bag(tmp_path / "simulated", "ros2", simulated))
    assert recording.imus["imu0"].gyroscope.t_ns[0] == all_frames(recording.streams["cam0"])[0].t_ns == 0


def test_images_without_any_time_are_refused(tmp_path):
    messages = usual()
    for message in messages:
        message.received_ns = message.t_ns = 0
    with pytest.raises(RecordingError, match="the images have no timestamps, neither their own nor the recorder's"):
        open_bag(make_bag(tmp_path, "ros2", messages))


@pytest.mark.parametrize("form", FORMS)
def test_triads_in_topics_of_their_own_are_put_together(form, tmp_path):
    gyro = [
        imu("/camera/gyro/sample", T0 + i * 5_000_000, (i + 1, 0.5, 2), (0, 0, 0), missing=("accel",)) for i in range(9)
    ]
    accel = [imu("/camera/accel/sample", T0 + 77 + i * 16_000_000, (0, 0, 0), (i, 0.5, 9.8)) for i in range(3)]
    recording = open_bag(make_bag(tmp_path, form, [*gyro, *accel, image("/cam", T0, picture())]))
    samples = recording.imus["imu0"]
    assert samples.gyroscope.t_ns.tolist() == [message.t_ns for message in gyro]
    assert samples.accelerometer.t_ns.tolist() == [message.t_ns for message in accel]
    np.testing.assert_array_equal(samples.accelerometer.values, [message.fields["accel"] for message in accel])
    np.testing.assert_array_equal(samples.gyroscope.values, [message.fields["gyro"] for message in gyro])
    assert any("/camera/accel/sample (accelerometer)" in note for note in recording.assumptions)


def test_units_are_those_of_the_definition_unless_stated(tmp_path):
    messages = usual()
    for message in messages:
        if message.kind == "Imu":
            message.fields["accel"] = tuple(np.asarray(message.fields["accel"]) / 50 + [0, 0, 0.9])
    path = make_bag(tmp_path, "mcap", messages)
    recording = open_bag(path)
    assert any("but the accelerometer looks like g" in note for note in recording.assumptions)
    stated = open_bag(path, units=Units.parse("g rad/s"))
    values = recording.imus["imu0"].accelerometer.values
    np.testing.assert_allclose(stated.imus["imu0"].accelerometer.values, 9.80665 * values, rtol=1e-15)
    np.testing.assert_array_equal(stated.imus["imu0"].gyroscope.values, recording.imus["imu0"].gyroscope.values)
    assert not any("looks like" in note for note in stated.assumptions)
    with pytest.raises(RecordingError, match="imu0: the accelerometer is stated to be in raw counts"):
        open_bag(path, units=Units.parse("raw"))


def test_an_unsupported_encoding_is_named_with_its_topic(tmp_path):
    depth = image("/depth/image", T0, np.zeros((4, 4), np.float32), "32FC1")
    path = make_bag(tmp_path, "ros1", [depth, imu("/imu", T0)])
    with pytest.raises(RecordingError, match=r'rec\.bag: /depth/image: images are encoded as "32FC1".*mono8'):
        open_bag(path)


def test_paths_are_given_as_text_too(tmp_path):
    path = make_bag(tmp_path, "ros1", usual())
    assert Path(str(path)) == path
    assert is_bag_path(str(path))
    assert open_bag(str(path)).streams["cam0"].count == 3
