"""Videos with a table of IMU samples: timestamps, tables of timestamps, damage, and what is refused."""

import av
import numpy as np
import pytest

from gnomon.errors import RecordingError
from gnomon.readers.images.image_files import is_video
from gnomon.readers.images.image_recording import holds_images, open_images
from image_folders import START, frames_of, picture, stamps, write_samples, write_video


def image(number):
    return picture(number, height=48, width=64)


def opened(path, **options):
    return open_images(path, need_imu=False, **options)


def test_a_video_without_loss(tmp_path):
    write_video(tmp_path / "ride.mkv", count=8)
    write_samples(tmp_path / "ride_imu.csv")
    assert holds_images(tmp_path / "ride.mkv")
    recording = open_images(tmp_path / "ride.mkv")
    assert len(recording.imus["imu0"].gyroscope) == 40
    assert recording.streams["cam0"].count == 8
    for _ in range(2):
        t_ns, images, notes = frames_of(recording)
        assert notes == []
        np.testing.assert_allclose(t_ns, 50_000_000 * np.arange(8), atol=1)
        for number, found in enumerate(images):
            np.testing.assert_array_equal(found, image(number))
    assert "the shift to the clock of the IMU is searched for" in " ".join(recording.assumptions)
    assert [source.name for source in recording.sources] == ["ride.mkv", "ride_imu.csv"]


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.mp4", "mpeg4", "yuv420p"),
        ("a.avi", "mjpeg", "yuvj420p"),
        ("a.mov", "mpeg4", "yuv420p"),
        ("a.avi", "rawvideo", "bgr24"),
        ("a.mkv", "ffv1", "yuv420p10le"),
    ],
)
def test_other_kinds(tmp_path, name, codec, pixels):
    write_video(tmp_path / name, count=6, codec=codec, pixels=pixels)
    t_ns, images, notes = frames_of(opened(tmp_path / name))
    assert notes == []
    np.testing.assert_allclose(t_ns, 50_000_000 * np.arange(6), atol=1_000_000)
    for number, found in enumerate(images):
        assert (found.shape, found.dtype) == ((48, 64), np.uint8)
        contrast = np.corrcoef(found.ravel().astype(float), image(number).ravel().astype(float))[0, 1]
        assert contrast > 0.97  # limited range and compression change the levels, not the picture


def test_a_variable_frame_rate(tmp_path):
    times = np.cumsum(np.random.default_rng(1).integers(20, 70, 30))
    write_video(tmp_path / "phone.mkv", times_ms=times)
    t_ns, _, notes = frames_of(opened(tmp_path / "phone.mkv"))
    assert t_ns == (times * 1_000_000).tolist()
    assert notes == []


@pytest.mark.parametrize("name", ["ride.csv", "ride_timestamps.txt", "cam0_frames.csv"])
def test_a_table_of_stamps(tmp_path, name):
    write_video(tmp_path / "ride.mkv", count=5)
    write_samples(tmp_path / "imu0.csv")
    (tmp_path / name).write_text("frame,timestamp [ns]\n" + "".join(f"{k},{t}\n" for k, t in enumerate(stamps(5))))
    recording = open_images(tmp_path / "ride.mkv")
    assert frames_of(recording)[0] == stamps(5)
    assert "clock" not in " ".join(recording.assumptions)
    assert f"cam0/{name}" in [source.name for source in recording.sources]


def test_a_table_with_another_number_of_rows(tmp_path):
    write_video(tmp_path / "ride.mkv", count=5)
    (tmp_path / "ride.csv").write_text("timestamp [ns]\n" + "".join(f"{t}\n" for t in stamps(4)))
    with pytest.raises(RecordingError, match=r"4 timestamps for the 5 frames of ride\.mkv"):
        opened(tmp_path / "ride.mkv")


def test_the_right_stamps_behind_a_damaged_frame(tmp_path):
    path = tmp_path / "ride.avi"
    write_video(path, count=12, codec="mjpeg", pixels="yuvj420p")
    (tmp_path / "ride.csv").write_text("timestamp [ns]\n" + "".join(f"{t}\n" for t in stamps(12)))
    whole = dict(zip(*frames_of(opened(path))[:2], strict=True))
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux() if packet.size]
    path.write_bytes(path.read_bytes().replace(packets[5], bytes(len(packets[5]))))
    t_ns, images, notes = frames_of(opened(path))
    assert stamps(12)[5] not in t_ns or images[t_ns.index(stamps(12)[5])] is None
    assert len(t_ns) >= 11
    assert any("damaged" in note for note in notes)
    for stamp, found in zip(t_ns, images, strict=True):
        if stamp != stamps(12)[5]:
            np.testing.assert_array_equal(found, whole[stamp])


def test_damage_spreads_to_the_next_whole_frame(tmp_path):
    path = tmp_path / "ride.mkv"
    write_video(path, count=40, codec="mpeg4", pixels="yuv420p")
    _, good, _ = frames_of(opened(path))
    data = bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    middle = data.index(packets[19]) + len(packets[19]) // 2  # inside one frame: what is around frames stays whole
    data[middle : middle + 40] = np.random.default_rng(0).integers(0, 256, 40, dtype=np.uint8).tobytes()
    path.write_bytes(data)
    _, images, notes = frames_of(opened(path))
    missing = [number for number, found in enumerate(images) if found is None]
    assert missing
    assert "damaged" in notes[0]
    assert missing == list(range(missing[0], missing[-1] + 1))
    for found, expected in zip(images[missing[-1] + 1 :], good[missing[-1] + 1 :], strict=False):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("name", "codec", "pixels"), [("a.mkv", "ffv1", "gray"), ("a.avi", "mjpeg", "yuvj420p")])
def test_a_video_that_is_cut_off(tmp_path, name, codec, pixels):
    path = tmp_path / name
    write_video(path, count=60, codec=codec, pixels=pixels)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    t_ns, images, notes = frames_of(opened(path))
    assert 20 < len(t_ns) < 40
    assert all(found is not None for found in images)
    assert "cut off" in notes[-1]


def test_a_table_still_fits_a_video_that_is_cut_off(tmp_path):
    path = tmp_path / "ride.avi"
    write_video(path, count=60, codec="mjpeg", pixels="yuvj420p")
    (tmp_path / "ride.csv").write_text("timestamp [ns]\n" + "".join(f"{t}\n" for t in stamps(60)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    t_ns, _, _ = frames_of(opened(path))
    assert t_ns == stamps(60)[: len(t_ns)]


def test_an_mp4_without_its_index(tmp_path):
    path = tmp_path / "ride.mp4"
    write_video(path, codec="mpeg4", pixels="yuv420p")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert holds_images(path)
    with pytest.raises(RecordingError, match=r"ride\.mp4: the video is cut off or damaged: its index"):
        opened(path)


def test_a_mark_of_rotation_is_not_followed(tmp_path):
    write_video(tmp_path / "plain.mp4", count=4, codec="mpeg4", pixels="yuv420p")
    data = (tmp_path / "plain.mp4").read_bytes()
    straight = b"".join(n.to_bytes(4, "big", signed=True) for n in (65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30))
    turned = b"".join(n.to_bytes(4, "big", signed=True) for n in (0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30))
    track = data.index(b"tkhd")
    place = data.index(straight, track)
    (tmp_path / "turned.mp4").write_bytes(data[:place] + turned + data[place + len(turned) :])
    recording = opened(tmp_path / "turned.mp4")
    expected, found = (frames_of(opened(tmp_path / name))[1] for name in ("plain.mp4", "turned.mp4"))
    np.testing.assert_array_equal(found, expected)
    assert "shown turned by" in " ".join(recording.assumptions)
    assert "64 x 48 px" in " ".join(recording.assumptions)


def test_sound_alone_is_no_video(tmp_path):
    path = tmp_path / "sound.wav"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), layout="mono")
        frame.rate = 8000
        container.mux(stream.encode(frame))
    assert not is_video(path)


def test_the_imu_of_a_video_in_a_folder_of_many_things(tmp_path):
    write_video(tmp_path / "ride.mkv", count=4)
    write_samples(tmp_path / "other.csv")
    with pytest.raises(RecordingError, match="no samples of an IMU beside this video"):
        open_images(tmp_path / "ride.mkv")
    assert len(open_images(tmp_path / "ride.mkv", imu_table=tmp_path / "other.csv").imus["imu0"].gyroscope) == 40


def test_memory_stays_bounded(tmp_path):
    import tracemalloc

    write_video(tmp_path / "long.mkv", count=400)
    stream = opened(tmp_path / "long.mkv").streams["cam0"]
    tracemalloc.start()
    for frame in stream.frames([]):
        frame.decode()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100 * 48 * 64
    assert START > 0
