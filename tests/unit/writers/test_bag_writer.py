"""Recordings written as bags: they read back to the last digit, by gnomon and by rosbags, or nothing is written."""

import weakref
from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from gnomon.errors import OutputError, RecordingError
from gnomon.readers.bags.bag import open_bag
from gnomon.readers.bags.salvage import Outcome, read_records
from gnomon.recording import ImuSamples, TriadSamples
from gnomon.recording.recording import Arrivals, Frame, ImageRecording, ImageStream
from gnomon.writers.bag_recording import save_bag

T0 = 1_403_636_579_758_555_393
FORMS = [("ros1", "a.bag"), ("ros2", "folder"), ("mcap", "folder"), ("mcap", "a.mcap")]
RNG = np.random.default_rng(7)


def pixels(i, shape=(10, 14)):
    return np.random.default_rng(i).integers(0, 256, shape, dtype=np.uint8)


def stream(*, count=4, start=0, broken=(), topic="", arrivals=None):
    def frames(notes):
        for i in range(start, start + count):

            def decode(i=i):
                if i in broken:
                    raise RecordingError(f"image {i}: the picture is damaged (9 bytes).")
                return pixels(i)

            yield Frame(t_ns=T0 + i * 50_000_001, where=f"image {i}", decode=decode)

    return ImageStream(frames=frames, count=count, topic=topic, arrivals=arrivals)


def triad(unit, *, count=30, offset=0, step=5_000_000):
    stamps = T0 - 20_000_000 + offset + np.arange(count) * step
    return TriadSamples(t_ns=stamps, values=RNG.normal(5, 3, (count, 3)) / 3, unit=unit)


def imu(**changes):
    return ImuSamples(**{"accelerometer": triad("m/s^2"), "gyroscope": triad("rad/s"), **changes})


def apart():
    return imu(accelerometer=triad("m/s^2", count=17, offset=123_457, step=8_000_003))


def recording(**changes):
    return ImageRecording(**{"imus": {"imu0": imu()}, "streams": {"cam0": stream()}, **changes})


def assert_same(found, expected):
    assert set(found.streams) == set(expected.streams)
    assert set(found.imus) == set(expected.imus)
    for name, mine in expected.streams.items():
        pairs = zip(found.streams[name].frames([]), mine.frames([]), strict=True)
        for frame, truth in pairs:
            assert frame.t_ns == truth.t_ns
            np.testing.assert_array_equal(frame.decode(), truth.decode())
    for name, mine in expected.imus.items():
        for sensor in ("accelerometer", "gyroscope"):
            theirs, true = getattr(found.imus[name], sensor), getattr(mine, sensor)
            np.testing.assert_array_equal(theirs.t_ns, true.t_ns)
            np.testing.assert_array_equal(theirs.values, true.values)  # to the last digit
            assert theirs.unit == true.unit


@pytest.mark.parametrize(("form", "name"), FORMS)
@pytest.mark.parametrize("together", [True, False])
def test_a_bag_reads_back_to_the_last_digit(form, name, together, tmp_path):
    samples = imu() if together else apart()
    written = recording(
        imus={"imu0": samples, "imu1": imu()},
        streams={"cam0": stream(), "cam1": stream(start=2, topic="/cam1/grey")},
    )
    save_bag(written, tmp_path / name, form)
    found = open_bag(tmp_path / name)
    assert_same(found, written)
    assert [found.streams[cam].topic for cam in ("cam0", "cam1")] == ["/cam0/image_raw", "/cam1/grey"]
    assert [found.imus[name].topic for name in ("imu0", "imu1")] == ["/imu0", "/imu1"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_the_forms_hold_the_same(tmp_path):
    written, names = recording(imus={"imu0": apart()}), iter(range(9))
    places = [tmp_path / f"{next(names)}{name}" for _, name in FORMS]
    for place, (form, _) in zip(places, FORMS, strict=True):
        save_bag(written, place, form)
    for place in places:
        assert_same(open_bag(place), written)


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_rosbags_reads_what_gnomon_wrote(form, name, tmp_path):
    written = recording(imus={"imu0": apart()})
    save_bag(written, tmp_path / name, form)
    frames, samples = list(written.streams["cam0"].frames([])), written.imus["imu0"]
    found = {}
    with AnyReader([tmp_path / name]) as reader:
        for link, received, data in reader.messages():
            message = reader.deserialize(data, link.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert received == stamp
            found.setdefault(link.topic, []).append(message)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/cam0/image_raw": 4, "/imu0/accel": 17, "/imu0/gyro": 30,
    }  # fmt: skip
    image = found["/cam0/image_raw"][1]
    assert (image.encoding, image.step, image.height, image.width, image.is_bigendian) == ("mono8", 14, 10, 14, 0)
    np.testing.assert_array_equal(image.data.reshape(10, 14), frames[1].decode())
    force, rate = found["/imu0/accel"][5], found["/imu0/gyro"][5]
    vector = force.linear_acceleration
    assert [vector.x, vector.y, vector.z] == samples.accelerometer.values[5].tolist()
    assert (force.angular_velocity_covariance[0], force.linear_acceleration_covariance[0]) == (-1, 0)
    assert (rate.angular_velocity_covariance[0], rate.linear_acceleration_covariance[0]) == (0, -1)
    assert force.orientation_covariance[0] == rate.orientation_covariance[0] == -1


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_times_of_receipt_are_kept(form, name, tmp_path):
    stamps = T0 + np.arange(4) * 50_000_001
    arrivals = Arrivals(t_ns=stamps, received_ns=stamps + np.array([7, 900, 20, 1]))
    samples = imu()
    received = Arrivals(t_ns=samples.gyroscope.t_ns, received_ns=samples.gyroscope.t_ns + RNG.integers(0, 999, 30))
    written = recording(
        imus={"imu0": samples}, streams={"cam0": stream(arrivals=arrivals)}, imu_arrivals={"imu0": received}
    )
    save_bag(written, tmp_path / name, form)
    found = open_bag(tmp_path / name)
    assert_same(found, written)
    np.testing.assert_array_equal(found.streams["cam0"].arrivals.received_ns, arrivals.received_ns)
    np.testing.assert_array_equal(found.imu_arrivals["imu0"].received_ns, received.received_ns)


def test_messages_are_in_the_order_of_time(tmp_path):
    save_bag(recording(), tmp_path / "a.mcap", "mcap")
    times = [record.received_ns for record in read_records(tmp_path / "a.mcap", None, Outcome())]
    assert times == sorted(times)
    assert len(times) == 34


def test_units_become_those_of_the_message(tmp_path):
    degrees = triad("deg/s")
    save_bag(recording(imus={"imu0": imu(gyroscope=degrees)}), tmp_path / "a.bag", "ros1")
    values = open_bag(tmp_path / "a.bag").imus["imu0"].gyroscope.values
    np.testing.assert_allclose(values, np.deg2rad(degrees.values), rtol=1e-15)
    with pytest.raises(OutputError, match=r"imu0: its samples are raw counts.*gnomon apply"):
        save_bag(recording(imus={"imu0": imu(gyroscope=triad("count"))}), tmp_path / "b.bag", "ros1")
    assert not (tmp_path / "b.bag").exists()


def test_without_an_imu_only_the_images_are_written(tmp_path):
    save_bag(recording(imus={}), tmp_path / "a.bag", "ros1")
    assert open_bag(tmp_path / "a.bag", need_imu=False).streams["cam0"].count == 4


def test_topics_that_two_sensors_share_get_names_of_their_own(tmp_path):
    written = recording(
        imus={name: imu(topic="/imu") for name in ("imu0", "imu1")},
        streams={name: stream(topic="/image/compressed") for name in ("cam0", "cam1")},
    )
    save_bag(written, tmp_path / "a.bag", "ros1")
    topics = {"cam0": "/image", "cam1": "/cam1/image_raw", "imu0": "/imu", "imu1": "/imu1"}
    assert_same(open_bag(tmp_path / "a.bag", topics=topics), written)


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_an_image_that_cannot_be_read_stops_the_writing_unless_it_may_be_left_out(form, name, tmp_path):
    written = recording(streams={"cam0": stream(broken=(2,))})
    with pytest.raises(RecordingError, match="image 2: the picture is damaged"):
        save_bag(written, tmp_path / name, form)
    assert list(tmp_path.iterdir()) == []
    notes = []
    save_bag(written, tmp_path / name, form, notes=notes)
    assert notes == ["image 2: the picture is damaged (9 bytes). This image was left out."]
    frames = list(open_bag(tmp_path / name).streams["cam0"].frames([]))
    assert [frame.t_ns for frame in frames] == [T0 + i * 50_000_001 for i in (0, 1, 3)]


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_a_bag_takes_the_place_of_an_older_one_only_when_it_is_whole(form, name, tmp_path):
    path, older = tmp_path / name, recording(streams={"cam0": stream(count=1)})
    save_bag(older, path, form)
    with pytest.raises(RecordingError):
        save_bag(recording(streams={"cam0": stream(broken=(3,))}), path, form)
    assert_same(open_bag(path), older)
    save_bag(recording(streams={"cam0": stream(count=2)}), path, form)
    assert open_bag(path).streams["cam0"].count == 2
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("form", ["ros2", "mcap"])
def test_other_files_are_not_overwritten(form, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("...")
    (tmp_path / "file").write_text("...")
    with pytest.raises(OutputError, match="there are other files in this folder"):
        save_bag(recording(), tmp_path / "folder", form)
    with pytest.raises(OutputError, match="a ROS 2 bag is a folder, and there is a file of this name"):
        save_bag(recording(), tmp_path / "file", form)
    assert (tmp_path / "folder" / "thesis.tex").read_text() == (tmp_path / "file").read_text() == "..."
    (tmp_path / "empty").mkdir()
    written = recording()
    save_bag(written, tmp_path / "empty", form)
    assert_same(open_bag(tmp_path / "empty"), written)


def test_a_file_cannot_be_written_over_a_folder(tmp_path):
    for form, name in (("ros1", "a.bag"), ("mcap", "a.mcap")):
        (tmp_path / name).mkdir()
        with pytest.raises(OutputError, match=f"{name}: this is a folder"):
            save_bag(recording(), tmp_path / name, form)
    with pytest.raises(OutputError, match=r"a ROS 2 bag is a folder. Give a name without .db3"):
        save_bag(recording(), tmp_path / "a.db3", "ros2")


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_a_place_that_cannot_be_written(form, name, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"cannot be written .*Choose another place"):
        save_bag(recording(), tmp_path / "file" / name, form)


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_stamps_that_do_not_fit_are_refused(form, name, tmp_path):
    def shifted(t_ns):
        samples = replace(triad("m/s^2", count=2), t_ns=np.array([t_ns, t_ns]))
        return recording(imus={"imu0": imu(accelerometer=samples)})

    last = 2**31 * 10**9
    for t_ns in (-1, last):
        with pytest.raises(OutputError, match=rf"imu0: a timestamp of {t_ns} ns .*1970 to 2038"):
            save_bag(shifted(t_ns), tmp_path / name, form)
    assert list(tmp_path.iterdir()) == []
    save_bag(shifted(last - 1), tmp_path / name, form)
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(("form", "name"), FORMS)
def test_images_are_not_gathered_in_memory(form, name, tmp_path):
    alive, most = set(), []

    def frames(notes):
        for i in range(40):

            def decode(i=i):
                image = pixels(i, (240, 320))
                alive.add(i)
                weakref.finalize(image, alive.discard, i)
                most.append(len(alive))
                return image

            yield Frame(t_ns=T0 + i * 50_000_000, where=f"image {i}", decode=decode)

    save_bag(recording(streams={"cam0": ImageStream(frames=frames)}), tmp_path / name, form)
    assert len(most) == 40
    assert max(most) <= 3


def test_progress_is_told(tmp_path):
    said = []
    save_bag(recording(streams={"cam0": stream(count=250)}), tmp_path / "a.mcap", "mcap", said.append)
    assert said == ["writing images: 100 of 250", "writing images: 200 of 250"]
