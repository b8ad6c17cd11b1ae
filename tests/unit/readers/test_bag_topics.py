"""Which topics of a bag are cameras and IMUs: stated, suggested, guessed; and what is said where it is not clear."""

import pytest

from bag_maker import T0, compressed, image, imu, make_bag, other, picture, usual
from gnomon.errors import OptionError, RecordingError
from gnomon.readers.bags.bag import open_bag


@pytest.fixture
def opened(tmp_path):
    """Write a bag with the topics given, and open it."""

    def make(cameras=("/cam",), imus=("/imu",), packed=(), more=(), **options):
        messages = usual(images=2, samples=3, cameras=cameras, imus=imus)
        messages += [compressed(topic, T0, b"\xff\xd8\xff\xd9") for topic in packed]
        recording = open_bag(make_bag(tmp_path, "mcap", [*messages, *more, other("/temperature", T0)]), **options)
        chosen = {name: stream.topic for name, stream in recording.streams.items()}
        return chosen | {name: samples.topic for name, samples in recording.imus.items()}, recording.assumptions

    return make


def test_one_camera_and_one_imu_need_no_words(opened):
    assert opened()[0] == {"cam0": "/cam", "imu0": "/imu"}


def test_what_is_stated_counts(opened):
    topics = {"cam0": "/b", "cam1": "a", "imu0": "/y"}
    chosen, _ = opened(("/a", "/b", "/c"), ("/x", "/y"), topics=topics, suggested={"cam0": "/c", "imu0": "/x"})
    assert chosen == {"cam0": "/b", "cam1": "/a", "imu0": "/y"}


def test_what_is_suggested_counts_where_it_is_there(opened):
    chosen, notes = opened(
        ("/a", "/b"), ("/x", "/y"), suggested={"cam0": "/b", "cam1": "/gone", "imu0": "/y", "imu1": "/gone"}
    )
    assert chosen == {"cam0": "/b", "imu0": "/y"}
    for note in ("cam1: /gone is not in this bag.", "imu1: /gone is not in this bag.", "images of /a were left out"):
        assert any(note in said for said in notes)


def test_what_is_suggested_in_vain_gives_its_name_to_the_only_one(opened):
    chosen, notes = opened(suggested={"cam0": "/gone", "imu0": "/gone/too"})
    assert chosen == {"cam0": "/cam", "imu0": "/imu"}
    assert any("(/gone is not in this bag)" in note for note in notes)
    assert "imu0: /gone/too is not in this bag." in notes


@pytest.mark.parametrize("name", ["camera", "cam", "gps0", "0"])
def test_a_name_that_is_no_sensor_is_refused(opened, name):
    with pytest.raises(OptionError, match=f'"{name}" is neither a camera nor an IMU.*--topics cam0='):
        opened(topics={name: "/cam"})


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"cam0": "/gone"}, "/gone, which is stated to be cam0, is not in this bag"),
        ({"cam0": "/imu"}, "/imu, which is stated to be cam0, is of type sensor_msgs/Imu, not sensor_msgs/Image or"),
        ({"imu0": "/cam"}, "/cam, which is stated to be imu0, is of type sensor_msgs/Image, not sensor_msgs/Imu"),
        ({"imu0": "/gone"}, "/gone, which is stated to be imu0, is not in this bag"),
    ],
)
def test_a_stated_topic_that_cannot_be_used_is_refused(opened, topics, words):
    with pytest.raises(RecordingError, match=words) as caught:
        opened(topics=topics)
    assert "\n  /cam  sensor_msgs/Image  2 messages" in str(caught.value)
    assert "\n  /temperature  sensor_msgs/Temperature  1 messages" in str(caught.value)


def test_raw_and_compressed_images_are_one_camera(opened):
    chosen, notes = opened(("/cam/image_raw",), packed=("/cam/image_raw/compressed",))
    assert chosen["cam0"] == "/cam/image_raw"
    assert any("/cam/image_raw/compressed was left out: it shows the same" in note for note in notes)


def test_a_suggested_topic_is_found_in_its_compressed_form(opened):
    chosen, notes = opened(("/a", "/b"), packed=("/c/compressed",), suggested={"cam0": "/c"})
    assert chosen["cam0"] == "/c/compressed"
    assert any("cam0: /c has no images in this bag; /c/compressed was read." in note for note in notes)


def test_of_processed_images_the_raw_one_is_taken(opened):
    assert opened(("/cam/image_rect", "/cam/image_raw", "/cam/image_color"))[0]["cam0"] == "/cam/image_raw"


def test_depth_is_no_camera_beside_others(opened):
    chosen, notes = opened(("/color/image_raw", "/depth/image_raw"))
    assert chosen["cam0"] == "/color/image_raw"
    assert any("/depth/image_raw was left out as depth" in note for note in notes)


@pytest.mark.parametrize(
    "topics",
    [
        ("/cam1/image_raw", "/cam0/image_raw"),
        ("/camera_10/image", "/camera_2/image"),
        ("/rig/right/image_raw", "/rig/left/image_raw"),
    ],
)
def test_cameras_whose_names_say_so_are_in_their_order(opened, topics):
    chosen, notes = opened(topics)
    assert [chosen["cam0"], chosen["cam1"]] == list(topics[::-1])
    assert any(f"cam0 is {topics[1]}, by its name" in note for note in notes)


@pytest.mark.parametrize("topics", [("/front", "/rear"), ("/rig/cam1/a", "/rig/cam1/b"), ("/left", "/right", "/top")])
def test_cameras_whose_names_say_nothing_are_listed(opened, topics):
    with pytest.raises(RecordingError, match=r"do not tell which camera is cam0.*--topics cam0=") as caught:
        opened(topics)
    for topic in topics:
        assert f"\n  {topic}  sensor_msgs/Image  2 messages  " in str(caught.value)


def test_no_images(tmp_path):
    path = make_bag(tmp_path, "ros1", [imu("/imu", T0), other("/temperature", T0)])
    with pytest.raises(RecordingError, match=r"rec.bag: no topic holds images.*\n  /imu  sensor_msgs/Imu  1 messages"):
        open_bag(path)


def test_no_imu(opened):
    with pytest.raises(RecordingError, match=r"no topic holds samples of an IMU.*\n  /cam  sensor_msgs/Image"):
        opened(imus=())


def test_no_imu_is_no_error_where_none_is_needed(opened):
    assert opened(imus=(), need_imu=False)[0] == {"cam0": "/cam"}


def test_several_imus_that_are_not_needed(opened):
    chosen, notes = opened(imus=("/a", "/b"), need_imu=False)
    assert chosen == {"cam0": "/cam"}
    assert any("samples of its IMUs were left out" in note for note in notes)


def test_raw_samples_are_taken_rather_than_filtered_ones(opened):
    chosen, notes = opened(imus=("/imu/data", "/imu/data_raw"))
    assert chosen["imu0"] == "/imu/data_raw"
    assert any("/imu/data was left out: by its name it is the filtered form of /imu/data_raw" in note for note in notes)


def test_numbered_imus_are_in_their_order(opened):
    chosen, _ = opened(imus=("/imu1", "/imu0"))
    assert (chosen["imu0"], chosen["imu1"]) == ("/imu0", "/imu1")


def test_imus_whose_names_say_nothing_are_listed(opened):
    with pytest.raises(RecordingError, match=r"2 topics may be the IMU.*imu0=(.|\n)*\n  /front  sensor_msgs/Imu"):
        opened(imus=("/front", "/rear"))


def apart(gyro="/gyro", accel="/accel"):
    return [
        *(imu(gyro, T0 + i, (i, 1, 1), (0, 0, 0), missing=("accel",)) for i in range(4)),
        *(imu(accel, T0 + i, (0, 0, 0), (i, 1, 9), missing=("gyro",)) for i in range(3)),
    ]


@pytest.mark.parametrize("wish", ["/x,/y", "/y,/x"])
def test_triads_apart_can_be_stated(opened, wish, tmp_path):
    more = [*apart("/x", "/y"), *apart("/other/gyro", "/other/accel")]
    messages = [image("/cam", T0, picture()), *more]
    samples = open_bag(make_bag(tmp_path, "ros2", messages), topics={"imu0": wish}).imus["imu0"]
    assert (len(samples.gyroscope), len(samples.accelerometer)) == (4, 3)
    assert samples.accelerometer.values[2].tolist() == [2, 1, 9]


def test_an_imu_that_holds_both_is_taken_rather_than_its_parts(opened):
    chosen, notes = opened(imus=("/both",), more=apart("/cam/gyro/sample", "/cam/accel/sample"))
    assert chosen["imu0"] == "/both"
    assert any("/both holds both" in note for note in notes)


def test_parts_belong_together_by_their_names(opened):
    more = [*apart("/imu1/gyro", "/imu1/accel"), *apart("/imu0/gyro", "/imu0/accel")]
    assert opened(imus=(), more=more)[0] == {"cam0": "/cam", "imu0": "/imu0", "imu1": "/imu1"}


@pytest.mark.parametrize("topics", [{}, {"imu0": "/gyro"}])
def test_one_triad_alone_is_not_enough(opened, topics):
    with pytest.raises(RecordingError, match=r"/gyro: the messages hold no accelerometer.*imu0=/imu/accel,/imu/gyro"):
        opened(imus=(), more=apart()[:4], topics=topics)


def test_a_gyroscope_that_reads_zero_is_there_all_the_same(opened, tmp_path):
    messages = [imu("/imu", T0 + i, (0, 0, 0)) for i in range(3)]
    samples = open_bag(make_bag(tmp_path, "ros2", [*messages, image("/cam", T0, picture())])).imus["imu0"]
    assert len(samples.gyroscope) == 3
