"""Targets: images, videos, timestamps of frames, tables of corners, folders of a rig, and bags."""

import shutil
import sqlite3
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

import gnomon
from bag_maker import T0, compressed, imu, make_bag, usual
from bag_maker import image as image_message
from gnomon.readers.images.frame_stamps import is_frame_table, read_frame_table
from gnomon.readers.images.image_files import read_grey, used_bits
from gnomon.readers.images.image_pixels import (
    ENCODINGS,
    RawImage,
    compressed_image,
    grey_image,
    largest_value,
    sixteen_bits,
)
from gnomon.readers.images.image_recording import open_images
from gnomon.readers.rig.folder import read_corner_stamps
from image_folders import picture, stamps, write_samples, write_video

from .promise import Target
from .sample_targets import several_ways
from .structured_targets import CAM, CHECKERBOARD, EUROC, EUROC_IMU, IMU, as_yaml

PICTURES = 128 << 20
"""Memory that one image may take, however small its file is."""


def images_of(path: Path, **options: Any) -> None:
    """Open a recording of images and decode them all; what is wrong with one image becomes a note."""
    recording = open_images(path, **options)
    notes: list[str] = []
    for stream in recording.streams.values():
        for frame in stream.frames(notes):
            try:
                assert frame.decode().ndim == 2
            except gnomon.RecordingError as error:
                notes.append(str(error))


CHUNKS = 320 << 20
"""Memory that a chunk of a bag may take."""


# ---- images ----


def pictures() -> list[bytes]:
    grey = picture(3)
    deep = grey.astype(np.uint16) * 16
    made = [cv2.imencode(suffix, grey)[1].tobytes() for suffix in (".png", ".jpg", ".bmp", ".tif", ".pgm", ".webp")]
    return [*made, cv2.imencode(".png", deep)[1].tobytes(), cv2.imencode(".png", np.dstack([grey] * 3))[1].tobytes()]


def _image(folder: Path) -> None:
    path = folder / "frame.png"
    used_bits([(path, "frame.png")])
    read_grey(path, "frame.png")


def _message(folder: Path) -> None:
    """Read the file as the fields of a sensor_msgs/Image: encoding, height, width, step, then pixels."""
    data = (folder / "message.bin").read_bytes()
    encoding = ENCODINGS[data[0] % len(ENCODINGS)] if data else ""
    height, width, step = (int.from_bytes(data[i : i + 4], "little") for i in (1, 5, 9))
    big = len(data) > 13 and bool(data[13])
    image = RawImage(height=height, width=width, encoding=encoding, big_endian=big, step=step, data=data[14:])
    if sixteen_bits(encoding):
        largest_value(image, "here")
    grey_image(image, "here")


def _messages() -> list[bytes]:
    shape = b"".join(n.to_bytes(4, "little") for n in (6, 8))
    return [bytes([k]) + shape + bytes(4) + b"\0" + bytes(range(192)) for k in range(len(ENCODINGS))]


def _compressed(folder: Path) -> None:
    data = (folder / "message.bin").read_bytes()
    form, _, picture_ = data.partition(b"\0")
    compressed_image(picture_, form.decode("utf-8", errors="replace"), "here")


def _folder(folder: Path, names: list[str] | None = None) -> None:
    """Write a folder in the layout of EuRoC."""
    data = folder / "mav0/cam0/data"
    data.mkdir(parents=True, exist_ok=True)
    listed = names or [str(t) for t in stamps(3)]
    for number, name in enumerate(listed):
        (data / f"{name}.png").write_bytes(cv2.imencode(".png", picture(number))[1].tobytes())
    (folder / "mav0/cam0/data.csv").write_bytes(_frame_table())
    write_samples(folder / "mav0/imu0/data.csv")
    (folder / "mav0/cam0/sensor.yaml").write_bytes(as_yaml(EUROC)[0])
    (folder / "mav0/imu0/sensor.yaml").write_bytes(as_yaml(EUROC_IMU)[0])


def _frame_table() -> bytes:
    return "\n".join(["#timestamp [ns],filename", *(f"{t},{t}.png" for t in stamps(3)), ""]).encode()


@cache
def video(codec: str, pixels: str, name: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        write_video(path, count=6, codec=codec, pixels=pixels)
        return path.read_bytes()


def _videos() -> list[bytes]:
    return [
        video("mpeg4", "yuv420p", "a.mp4"), video("ffv1", "gray", "a.mkv"), video("mjpeg", "yuvj420p", "a.avi"),
    ]  # fmt: skip


def euroc(name: str, file: str, seeds: Any, form: str) -> Target:
    return Target(
        name=name, file=file, form=form, beside=_folder, seeds=seeds, floor_bytes=PICTURES,
        read=images_of,
    )  # fmt: skip


# ---- corners ----


def _corner_rows(header: str = "ts_ns,corner_id,u_px,v_px") -> bytes:
    places = [(f, t, k) for f, t in enumerate(stamps(3)) for k in range(24)]
    rows = [f"{t},{k},{100 + 3 * k + 0.25 * f},{50 + 7 * k + 0.5 * f}" for f, t, k in places]
    return "\n".join([*([header] if header else []), *rows, ""]).encode()


def _tag_rows() -> bytes:
    rows = [f"{t},{g},{c},{90 + 9 * g + c}.5,{50 + 7 * c}.25" for t in stamps(3) for g in range(4) for c in range(4)]
    return "\n".join(["ts_ns,tag_id,corner_idx,u_px,v_px", *rows, ""]).encode()


def _rig(folder: Path) -> None:
    for name, document in (("camchain", {"cam0": CAM}), ("imu", {"imu0": IMU}), ("target", CHECKERBOARD)):
        (folder / f"{name}.yaml").write_bytes(as_yaml(document)[0])
    (folder / "cam0_corners.csv").write_bytes(_corner_rows())
    (folder / "cam0_frames.csv").write_bytes(_frame_table())
    write_samples(folder / "imu0.csv", 60)


def _read_rig(folder: Path) -> None:
    files = {"cam": folder / "camchain.yaml", "imu": folder / "imu.yaml", "target": folder / "target.yaml"}
    gnomon.read_camera_imu(folder, **files)


def rig(name: str, file: str, seeds: Any) -> Target:
    return Target(
        name=name, file=file, form="text", beside=_rig, seeds=seeds,
        read=several_ways(_read_rig, read_corner_stamps),
    )  # fmt: skip


# ---- bags ----


@cache
def bag(form: str, compression: Any = None) -> dict[str, bytes]:
    """Return the files of a small bag, by name."""
    jpeg = cv2.imencode(".jpg", picture(1))[1].tobytes()
    messages = [*usual(images=2, samples=12), compressed("/cam1/compressed", T0, jpeg, "jpeg")]
    messages += [image_message("/cam2", T0 + k, np.full((4, 4), 900 + k, np.uint16), "mono16") for k in range(2)]
    messages += [imu("/imu1", T0 + k * 10_000_000, missing=("gyro",)) for k in range(3)]
    with TemporaryDirectory() as folder:
        path = make_bag(Path(folder), form, messages, compression=compression)
        files = [path] if path.is_file() else sorted(path.iterdir())
        return {file.name: file.read_bytes() for file in files}


def _read_bag(path: Path) -> None:
    """Read a bag as a user does: all cameras, some of them, and without an IMU."""
    several_ways(
        lambda place: images_of(place, topics={"cam0": "/cam0/image_raw", "imu0": "/imu0"}),
        lambda place: images_of(place, cameras_alone=True),
    )(path)


def packed() -> dict[str, list[tuple[str, Any]]]:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode

    form = Writer1.CompressionFormat
    return {
        "ros1": [("ros1", None), ("ros1", (form.BZ2,)), ("ros1", (form.LZ4,))],
        "mcap": [("mcap", None), ("mcap", (CompressionMode.STORAGE, CompressionFormat.ZSTD))],
        "ros2": [("ros2", None), ("ros2", (CompressionMode.MESSAGE, CompressionFormat.ZSTD))],
    }  # fmt: skip


def _bag_file(form: str, suffix: str, *, whole: bool = True) -> list[bytes]:
    found = [bag(*kind) for kind in packed()[form]]
    return [next(data for name, data in files.items() if name.endswith(suffix)) for files in found if whole or files]


def single(name: str, form: str, file: str, suffix: str) -> Target:
    return Target(
        name=name, file=file, seeds=lambda: _bag_file(form, suffix), read=lambda folder: _read_bag(folder / file),
        floor_bytes=CHUNKS,
    )  # fmt: skip


def _db3_name() -> str:
    return next(name for name in bag("ros2") if name.endswith(".db3"))


def _write_ros2(folder: Path) -> None:
    for name, data in bag("ros2").items():
        (folder / "rec").mkdir(parents=True, exist_ok=True)
        (folder / "rec" / name).write_bytes(data)


def _foreign_sqlite() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.db3")
        base = sqlite3.connect(path)
        base.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        base.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.execute("INSERT INTO topics VALUES(1, '/imu0', 'sensor_msgs/msg/Imu', 'cdr')")
        base.execute("INSERT INTO messages VALUES(1, 1, 5, x'00010000')")
        base.commit()
        base.close()
        return path.read_bytes()


def clear(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


CAMERAS: tuple[Target, ...] = (
    Target(name="image", file="frame.png", seeds=pictures, read=_image, floor_bytes=PICTURES),
    Target(name="raw-image-message", file="message.bin", seeds=_messages, read=_message, floor_bytes=PICTURES),
    Target(
        name="compressed-image-message", file="message.bin", read=_compressed, floor_bytes=PICTURES,
        seeds=lambda: [
            *(b"jpeg\0" + data for data in pictures()), b"bayer_rggb8; jpeg compressed\0" + pictures()[0],
        ],
    ),
    euroc("euroc-frame-table", "mav0/cam0/data.csv", lambda: [_frame_table()], "text"),
    euroc("euroc-camera-yaml", "mav0/cam0/sensor.yaml", lambda: as_yaml(EUROC), "yaml"),
    euroc("euroc-imu-yaml", "mav0/imu0/sensor.yaml", lambda: as_yaml(EUROC_IMU), "yaml"),
    Target(
        name="frame-stamps", file="frames.csv", form="text",
        seeds=lambda: [
            _frame_table(), b"".join(b"%d.%09d\n" % divmod(t, 10**9) for t in stamps(4)), b"1,a.png\n2,b.png\n",
        ],
        read=lambda folder: several_ways(is_frame_table, lambda path: read_frame_table(path, ["a.png"]))(
            folder / "frames.csv"
        ),
    ),
    Target(
        name="video", file="clip.mkv", seeds=_videos, floor_bytes=PICTURES,
        read=lambda folder: images_of(folder / "clip.mkv", need_imu=False),
    ),
    Target(
        name="video-stamps", file="clip.csv", form="text", seeds=lambda: [b"".join(b"%d\n" % t for t in stamps(6))],
        beside=lambda folder: (folder / "clip.mkv").write_bytes(video("ffv1", "gray", "a.mkv")), floor_bytes=PICTURES,
        read=lambda folder: images_of(folder / "clip.mkv", need_imu=False),
    ),
    rig("corner-table", "cam0_corners.csv", lambda: [_corner_rows(), _tag_rows(), _corner_rows("")]),
    rig("corner-frame-stamps", "cam0_frames.csv", lambda: [_frame_table()]),
    rig("rig-imu-table", "imu0.csv", lambda: [_imu_csv()]),
    single("ros1-bag", "ros1", "rec.bag", ".bag"),
    single("mcap", "mcap", "rec.mcap", ".mcap"),
    Target(
        name="ros2-sqlite", file="rec.db3", floor_bytes=CHUNKS, read=lambda folder: _read_bag(folder / "rec.db3"),
        seeds=lambda: [*_bag_file("ros2", ".db3"), _foreign_sqlite()],
    ),
    Target(
        name="ros2-metadata", file="rec/metadata.yaml", form="yaml", beside=_write_ros2, floor_bytes=CHUNKS,
        seeds=lambda: [bag("ros2")["metadata.yaml"]], read=lambda folder: _read_bag(folder / "rec"),
    ),
)  # fmt: skip


def _imu_csv() -> bytes:
    with TemporaryDirectory() as folder:
        write_samples(Path(folder, "imu0.csv"), 60)
        return Path(folder, "imu0.csv").read_bytes()
