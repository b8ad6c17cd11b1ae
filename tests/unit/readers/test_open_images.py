"""Recordings of images in folders: which layouts are read, what is fixed with a note, and what is refused."""

import hashlib

import cv2
import numpy as np
import pytest

from gnomon.errors import OptionError, RecordingError
from gnomon.readers.images.image_recording import holds_images, open_images
from image_folders import START, STEP, frames_of, picture, samples, stamps, write_images, write_samples, write_video

EUROC_CAMERA = """\
#Default camera sensor yaml file
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, 0.1,
         1.0, 0.0, 0.0, 0.2,
         0.0, 0.0, 1.0, 0.3,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [32, 24]
camera_model: pinhole
intrinsics: [40.0, 41.0, 15.5, 11.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.7e-05]
"""
EUROC_IMU = """\
sensor_type: imu
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 200
gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]
gyroscope_random_walk: 1.9393e-05
accelerometer_noise_density: 2.0000e-3
accelerometer_random_walk: 3.0000e-3
"""


def euroc(root, *, cameras=1, count=6, change=lambda image: image):
    for camera in range(cameras):
        place = root / "mav0" / f"cam{camera}"
        write_images(place / "data", stamps(count), change=change)
        rows = "".join(f"{t},{t}.png\r\n" for t in stamps(count))
        (place / "data.csv").write_text(f"#timestamp [ns],filename\r\n{rows}", newline="")
    write_samples(root / "mav0" / "imu0" / "data.csv")
    return root


def colour(image):
    return cv2.merge([image] * 3)


def check(recording, count=6, camera="cam0"):
    """The timestamps and the images are those that were written."""
    t_ns, images, notes = frames_of(recording, camera)
    assert t_ns == stamps(count)
    assert recording.streams[camera].count == count
    assert notes == []
    for number, image in enumerate(images):
        np.testing.assert_array_equal(image, picture(number))
    return recording


def said(recording):
    return " ".join(recording.assumptions)


def test_euroc(tmp_path):
    euroc(tmp_path, cameras=2)
    recording = open_images(tmp_path)
    assert holds_images(tmp_path)
    assert list(recording.streams) == ["cam0", "cam1"]
    for camera in recording.streams:
        check(recording, camera=camera)
    imu, (t_ns, values) = recording.imus["imu0"], samples()
    np.testing.assert_array_equal(imu.accelerometer.t_ns, t_ns)
    np.testing.assert_array_equal(imu.accelerometer.values, values[:, :3])
    np.testing.assert_array_equal(imu.gyroscope.values, values[:, 3:])
    assert recording.streams["cam0"].camera is None
    check(open_images(tmp_path / "mav0"))


def test_frames_can_be_read_as_often_as_one_likes(tmp_path):
    recording = open_images(euroc(tmp_path))
    check(check(recording))


def test_what_sensor_yaml_states(tmp_path):
    euroc(tmp_path)
    (tmp_path / "mav0/cam0/sensor.yaml").write_text(EUROC_CAMERA)
    (tmp_path / "mav0/imu0/sensor.yaml").write_text(EUROC_IMU)
    recording = open_images(tmp_path)
    stream = recording.streams["cam0"]
    assert (stream.camera.model, stream.camera.resolution) == ("pinhole-radtan", (32, 24))
    np.testing.assert_array_equal(stream.camera.parameters, [40, 41, 15.5, 11.5, -0.28, 0.07, 0.0002, 1.7e-5])
    # The camera stands at (0.1, 0.2, 0.3) of the body: the IMU's origin is seen from there against its axes.
    expected = [[0, 1, 0, -0.2], [-1, 0, 0, 0.1], [0, 0, 1, -0.3], [0, 0, 0, 1]]
    np.testing.assert_allclose(stream.T_cam_imu, expected, atol=1e-15)
    noise = recording.imus["imu0"].noise
    assert (noise.gyroscope_noise_density, noise.accelerometer_random_walk) == (1.6968e-4, 3e-3)


def test_an_imu_that_is_not_the_body(tmp_path):
    euroc(tmp_path)
    (tmp_path / "mav0/cam0/sensor.yaml").write_text(EUROC_CAMERA)
    moved = EUROC_IMU.replace("[1.0, 0.0, 0.0, 0.0, 0.0, 1.0,", "[1.0, 0.0, 0.0, 0.5, 0.0, 1.0,")
    (tmp_path / "mav0/imu0/sensor.yaml").write_text(moved)
    T = open_images(tmp_path).streams["cam0"].T_cam_imu
    np.testing.assert_allclose(T @ [-0.4, 0.2, 0.3, 1], [0, 0, 0, 1], atol=1e-15)  # the camera, seen from the IMU


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda text: text.replace("radial-tangential", "equidistant"), "pinhole-equidistant"),
        (lambda text: "%YAML:1.0\n---\n" + text, "pinhole-radtan"),
        (lambda text: text.replace("[32, 24]", "{width: 32, height: 24}"), "pinhole-radtan"),
        (lambda text: text.replace("radial-tangential", "rational"), None),
        (lambda text: text.replace("pinhole", "[pinhole"), None),
    ],
)
def test_a_lens_is_read_leniently_or_passed_over(tmp_path, change, expected):
    euroc(tmp_path)
    (tmp_path / "mav0/cam0/sensor.yaml").write_text(change(EUROC_CAMERA))
    recording = check(open_images(tmp_path))
    camera = recording.streams["cam0"].camera
    assert (None if camera is None else camera.model) == expected
    assert ("cam0/sensor.yaml" in said(recording)) == (expected is None)


def test_tum_vi_has_images_of_16_bits(tmp_path):
    euroc(tmp_path, change=lambda image: image.astype(np.uint16) << 8)
    check(open_images(tmp_path))


def test_12_bits_in_16_have_one_scale_for_all_images(tmp_path):
    euroc(tmp_path, change=lambda image: image.astype(np.uint16) << 4)
    dark = (picture(2) // 8).astype(np.uint16) << 4
    cv2.imwrite(str(tmp_path / "mav0/cam0/data" / f"{stamps(3)[2]}.png"), dark)
    _, images, _ = frames_of(recording := open_images(tmp_path))
    np.testing.assert_array_equal(images[2], picture(2) // 8)
    np.testing.assert_array_equal(images[3], picture(3))
    assert "16 bits, of which 12 are used" in said(recording)


def test_kalibrs_folder(tmp_path):
    write_images(tmp_path / "cam0", stamps(6))
    write_images(tmp_path / "cam1", stamps(5))
    write_samples(tmp_path / "imu0.csv", header="timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z")
    recording = open_images(tmp_path)
    check(recording, 6, "cam0")
    check(recording, 5, "cam1")
    assert [source.name for source in recording.sources] == ["cam0 (6 images)", "cam1 (5 images)", "imu0.csv"]


@pytest.mark.parametrize("place", ["images", "frames", "rgb", "."])
def test_a_plain_folder(tmp_path, place):
    write_images(tmp_path / place, stamps(6))
    write_samples(tmp_path / "imu.csv")
    assert holds_images(tmp_path)
    recording = check(open_images(tmp_path))
    assert ("rgb/ are those of cam0" in said(recording)) == (place == "rgb")


def test_several_cameras_in_one_folder(tmp_path):
    for camera in ("cam0", "cam1"):
        write_images(tmp_path, [f"{camera}_{t}" for t in stamps(4)])
    write_samples(tmp_path / "imu0.csv")
    recording = open_images(tmp_path)
    assert list(recording.streams) == ["cam0", "cam1"]
    check(recording, 4, "cam0")
    check(recording, 4, "cam1")


@pytest.mark.parametrize("suffix", [".jpg", ".bmp", ".tif", ".pgm", ".PNG"])
def test_other_kinds_of_images_in_colour(tmp_path, suffix):
    write_images(tmp_path / "cam0", stamps(3), suffix=suffix, change=colour if suffix != ".pgm" else np.array)
    write_samples(tmp_path / "imu0.csv")
    t_ns, images, _ = frames_of(open_images(tmp_path))
    assert t_ns == stamps(3)
    for number, image in enumerate(images):
        assert image.dtype == np.uint8
        assert np.abs(image.astype(int) - picture(number)).mean() < (25 if suffix == ".jpg" else 0.1)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (lambda t: f"{t}", "ns"),
        (lambda t: f"{t // 1000}", "us"),
        (lambda t: f"{t // 10**6}", "ms"),
        (lambda t: f"{t // 10**9}.{t % 10**9:09d}", "s"),
        (lambda t: f"frame_{t // 10**9}-{t % 10**9:09d}", "s"),
        (lambda t: f"left-{t // 10**9}_{t % 10**9 // 1000:06d}", "s"),
        (lambda t: f"{t - START + 7 * STEP}", "ns"),
    ],
)
def test_stamps_in_names(tmp_path, names, unit):
    write_images(tmp_path / "cam0", [names(t) for t in stamps(5)])
    write_samples(tmp_path / "imu0.csv")
    recording = open_images(tmp_path)
    t_ns, _, _ = frames_of(recording)
    grain = {"ns": 1, "us": 1000, "ms": 10**6, "s": 1000}[unit]
    assert np.abs(np.diff(t_ns) - STEP).max() <= grain
    assert abs(t_ns[0] - stamps(1)[0]) <= grain or t_ns[0] == 7 * STEP
    assert f"timestamps in {unit} " in said(recording)


TABLES = {
    "data.csv of EuRoC": ("cam0/data.csv", "#timestamp [ns],filename", lambda t, name: f"{t},{name}"),
    "no header, names first": ("cam0/frames.csv", None, lambda t, name: f"{name},{t}"),
    "of TUM, with folders": (
        "cam0/times.txt",
        "# timestamp filename",
        lambda t, name: f"{t // 10**9}.{t % 10**9:09d} cam0/{name}",
    ),
    "of DSO, with exposures": (
        "cam0/times.txt",
        None,
        lambda t, name: f"{name[:-4]} {t // 10**9}.{t % 10**9:09d} 0.25",
    ),
    "in microseconds": ("cam0_frames.csv", "t_us,file", lambda t, name: f"{t // 1000}.{t % 1000:03d},{name}"),
    "timestamps alone": ("cam0_timestamps.txt", None, lambda t, name: f"{t}"),
    "beside the folder": ("cam0.csv", "stamp_ns,image", lambda t, name: f"{t},{name}"),
}


@pytest.mark.parametrize(("path", "header", "row"), TABLES.values(), ids=TABLES)
def test_tables_of_stamps(tmp_path, path, header, row):
    own = path == "cam0/times.txt" and header is None  # the names are timestamps, too
    names = [str(t) for t in stamps(6)] if own else [f"{number:06d}" for number in range(6)]
    write_images(tmp_path / "cam0", names)
    write_samples(tmp_path / "imu0.csv")
    rows = [row(t, f"{name}.png") for t, name in zip(stamps(6), names, strict=True)]
    (tmp_path / path).write_text("\n".join(([header] if header else []) + rows) + "\n")
    t_ns, images, _ = frames_of(open_images(tmp_path))
    assert t_ns == stamps(6)
    np.testing.assert_array_equal(images[4], picture(4))


def test_a_table_that_lists_other_images_than_there_are(tmp_path):
    euroc(tmp_path, count=8)
    data = tmp_path / "mav0/cam0/data"
    (data / f"{stamps(8)[2]}.png").unlink()
    write_images(data, [START + 999 * STEP])
    recording = open_images(tmp_path)
    t_ns, _, _ = frames_of(recording)
    assert t_ns == [t for k, t in enumerate(stamps(8)) if k != 2]
    assert f"1 of 8 images that it lists are not in cam0/data/, such as {stamps(8)[2]}.png" in said(recording)
    assert "1 of 8 images in cam0/data/ are not listed" in said(recording)


def test_rows_out_of_order_and_stamps_twice(tmp_path):
    write_images(tmp_path / "cam0", list("abcde"))
    write_samples(tmp_path / "imu0.csv")
    t = stamps(4)
    rows = zip([t[1], t[0], t[2], t[2], t[3]], "abcde", strict=True)
    (tmp_path / "cam0/data.csv").write_text(
        "stamp,filename\n" + "".join(f"{stamp},{name}.png\n" for stamp, name in rows)
    )
    recording = open_images(tmp_path)
    t_ns, images, _ = frames_of(recording)
    assert t_ns == t
    np.testing.assert_array_equal(images[0], picture(1))
    np.testing.assert_array_equal(images[2], picture(2))
    assert "they were sorted" in said(recording)
    assert "1 of 5 images have the timestamp of another one" in said(recording)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda data: data[: len(data) // 2], "cut off"),
        (lambda data: b"", "empty (0 bytes)"),
        (lambda data: data[:60] + bytes(20) + data[80:], "damaged"),
        (lambda data: b"no image at all, but text", "damaged or of an unknown kind"),
    ],
)
def test_a_damaged_image_says_so_when_it_is_decoded(tmp_path, spoil, message):
    path = euroc(tmp_path) / "mav0/cam0/data" / f"{stamps(6)[3]}.png"
    path.write_bytes(spoil(path.read_bytes()))
    t_ns, images, notes = frames_of(open_images(tmp_path))
    assert t_ns == stamps(6)
    assert [image is None for image in images] == [False] * 3 + [True] + [False] * 2
    assert len(notes) == 1
    assert message in notes[0]
    assert notes[0].startswith(f"cam0/data/{stamps(6)[3]}.png: ")


def test_a_jpeg_that_is_cut_off(tmp_path):
    write_images(tmp_path / "cam0", stamps(3), suffix=".jpg")
    write_samples(tmp_path / "imu0.csv")
    path = tmp_path / "cam0" / f"{stamps(3)[1]}.jpg"
    path.write_bytes(path.read_bytes()[:-150])
    _, images, notes = frames_of(open_images(tmp_path))
    assert [image is None for image in images] == [False, True, False]
    assert "cut off" in notes[0]


def test_sources_change_with_any_image_and_with_nothing_else(tmp_path):
    euroc(tmp_path)
    before = open_images(tmp_path).sources
    assert before == open_images(tmp_path).sources
    assert [source.name for source in before] == ["cam0/data.csv", "cam0 (6 images)", "imu0/data.csv"]
    assert before[0].sha256 == hashlib.sha256((tmp_path / "mav0/cam0/data.csv").read_bytes()).hexdigest()
    path = tmp_path / "mav0/cam0/data" / f"{stamps(6)[3]}.png"
    data = bytearray(path.read_bytes())
    data[50] ^= 1
    path.write_bytes(data)
    after = open_images(tmp_path).sources
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True]


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["acc.csv", "gyro.csv"], 40),
        (["trajectory_of_the_imu.csv"], 40),
        (["imu1.csv", "imu0.csv"], 40),
    ],
)
def test_tables_of_samples(tmp_path, files, expected):
    write_images(tmp_path / "cam0", stamps(3))
    write_samples(tmp_path / "all.csv")
    rows = [line.split(",") for line in (tmp_path / "all.csv").read_text().splitlines()]
    (tmp_path / "all.csv").unlink()
    (tmp_path / "target_points.csv").write_text("corner_id,x,y\n0,0,0\n1,0.1,0\n")
    for file in files:
        columns = {"acc.csv": [0, 4, 5, 6], "gyro.csv": [0, 1, 2, 3]}.get(file, range(7))
        (tmp_path / file).write_text("".join(",".join(row[i] for i in columns) + "\n" for row in rows))
    recording = open_images(tmp_path)
    assert list(recording.imus) == (["imu0", "imu1"] if "imu1.csv" in files else ["imu0"])
    for imu in recording.imus.values():
        assert len(imu.accelerometer) == expected
        np.testing.assert_array_equal(imu.gyroscope.values, samples()[1][:, 3:])


def test_a_table_of_samples_elsewhere(tmp_path):
    write_images(tmp_path / "rig/cam0", stamps(3))
    write_samples(tmp_path / "elsewhere.csv")
    assert len(open_images(tmp_path / "rig", imu_table=tmp_path / "elsewhere.csv").imus["imu0"].gyroscope) == 40


def test_without_imu(tmp_path):
    write_images(tmp_path / "cam0", stamps(3))
    with pytest.raises(RecordingError, match=r"images, but no samples of an IMU in this folder\. Expected imu0\.csv"):
        open_images(tmp_path)
    recording = check(open_images(tmp_path, need_imu=False), 3)
    assert recording.imus == {}


def two_folders(root):
    write_images(root / "day", stamps(3))
    write_images(root / "night", stamps(3))


def stamps_of(values):
    def make(root):
        write_images(root / "cam0", list("abcd"))
        rows = "".join(f"{value},{name}.png\n" for value, name in zip(values, "abcd", strict=True))
        (root / "cam0/data.csv").write_text("timestamp [ns],filename\n" + rows)

    return make


def a_file(name, content):
    return lambda root: (root / name).write_bytes(content)


def too_few_stamps(root):
    write_images(root / "cam0", list("abcd"))
    (root / "cam0/times.txt").write_text("1.0\n1.1\n1.2\n")


def other_names(root):
    stamps_of(stamps(4))(root)
    for path in sorted((root / "cam0").glob("*.png")):
        path.rename(path.with_name(f"x{path.name}"))


BAD = {
    "nothing": (lambda root: None, "no images of a camera in this folder; found nothing at all"),
    "samples alone": (lambda root: write_samples(root / "imu0.csv"), "calibrating it alone is another command"),
    "other files": (a_file("notes.txt", b"hello"), "found notes.txt. Expected a ROS bag"),
    "counted images": (lambda root: write_images(root / "cam0", [f"{k:04d}" for k in range(9)]), "number the images"),
    "every tenth image": (
        lambda root: write_images(root / "cam0", [f"img{k:04d}" for k in range(0, 90, 10)]),
        "img0000.png to img0080.png, number the images",
    ),
    "names without timestamps": (lambda root: write_images(root / "cam0", list("abc")), "a.png holds no timestamp"),
    "two folders": (two_folders, r"2 of its folders may be the camera \(day/, night/\). Name those"),
    "zero timestamps": (
        stamps_of([0, 0, 0, 0]),
        "3 of 4 images have the same timestamp as another one; the first is 0 ns",
    ),
    "a stray timestamp": (
        stamps_of([START, START + STEP, 5, START + 2 * STEP]),
        "row 3: the timestamp 5 ns is more than half",
    ),
    "a timestamp in words": (stamps_of([START, "later", START + STEP, START + 2 * STEP]), "data.csv, line 3"),
    "too few timestamps": (too_few_stamps, "3 timestamps and 4 images in cam0/"),
    "other images": (other_names, "none of the 4 images that it lists, such as a.png, is in cam0/, which holds xa.png"),
}


@pytest.mark.parametrize(("make", "message"), BAD.values(), ids=BAD)
def test_bad_folders(tmp_path, make, message):
    make(tmp_path)
    with pytest.raises(RecordingError, match=message):
        open_images(tmp_path, need_imu=False)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.png", b"\x89PNG", "this is one image; a recording is the folder of them"),
        ("x.csv", b"1,2,3\n", "this is a text file, which holds no images. Expected a ROS bag"),
        ("x.mp4", b"this is text", "text file"),
        ("x.zip", b"PK\x03\x04 and more", "this is packed; unpack it first"),
        ("x.dat", b"\1\2\0\3" * 100, "a binary file of an unknown kind"),
        ("x.mkv", b"", "empty"),
    ],
)
def test_bad_files(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert not holds_images(tmp_path / name)
    with pytest.raises(RecordingError, match=message):
        open_images(tmp_path / name)


def test_what_is_not_there(tmp_path):
    assert not holds_images(tmp_path / "nothing")
    with pytest.raises(RecordingError, match="no such file or folder"):
        open_images(tmp_path / "nothing")


def test_topics_are_for_bags(tmp_path):
    with pytest.raises(OptionError, match="no bag"):
        open_images(euroc(tmp_path), topics={"cam0": "/camera"})


def test_a_folder_with_corners_holds_no_images(tmp_path):
    euroc(tmp_path)
    (tmp_path / "mav0/cam0_corners.csv").write_text("ts_ns,corner_id,u_px,v_px\n")
    assert not holds_images(tmp_path)


def test_videos_of_two_cameras_in_a_folder(tmp_path):
    write_video(tmp_path / "cam0.mkv", count=4)
    write_video(tmp_path / "cam1.mkv", count=3)
    write_samples(tmp_path / "imu0.csv")
    assert holds_images(tmp_path)
    recording = open_images(tmp_path)
    assert [stream.count for stream in recording.streams.values()] == [4, 3]
    assert len(frames_of(recording, "cam1")[0]) == 3


def test_a_folder_and_a_video_of_the_same_name(tmp_path):
    euroc(tmp_path)
    write_video(tmp_path / "mav0/cam0.mkv", count=4)
    assert "cam0.mkv was left out: cam0/data/ is cam0, too." in said(check(open_images(tmp_path)))


@pytest.mark.parametrize("name", ["1600000000500000000", "1600000000500", "1600000000.5"])
def test_a_single_image(tmp_path, name):
    write_images(tmp_path / "cam0", [name])
    assert frames_of(open_images(tmp_path, need_imu=False))[0] == [1_600_000_000_500_000_000]
