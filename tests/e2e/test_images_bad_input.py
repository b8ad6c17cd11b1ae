"""Recordings of images with something wrong, by the command line: what, where, what to do, and nothing left over."""

import json
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode

import bag_maker
import gnomon
import recorded

USAGE, BAD_INPUT, UNUSABLE = 2, 3, 4
FEW = 10
"""Every so many images are kept where nothing is calibrated."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recording with something wrong.

    Attributes
    ----------
    words : in the message
    layout : of the recording; "" for the folder as it was simulated
    edit : what is done to the recording, and to the folder of Kalibr's files
    few : whether most of the images are taken away, where they are files
    arguments : of the command
    named : options that name Kalibr's files
    board : changes of the scenario
    said : among what was understood, before it failed
    code : of the exit
    """

    words: tuple[str, ...]
    layout: str = ""
    edit: Any = lambda recording, files: None
    few: bool = True
    arguments: tuple[str, ...] = ()
    named: tuple[str, ...] = recorded.INPUTS
    board: dict[str, Any] = field(default_factory=dict)
    said: str = ""
    code: int = BAD_INPUT


# ---- what is done to recordings ----


def removed(*patterns):
    def edit(recording, _):
        for path in [path for pattern in patterns for path in recording.glob(pattern)]:
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return edit


def every_image(change):
    def edit(recording, _):
        for number, path in enumerate(recorded.images_of(recording)):
            path.write_bytes(change(number, path.read_bytes()))

    return edit


def blank(_, __):
    return cv2.imencode(".png", np.full((240, 320), 90, np.uint8))[1].tobytes()


def clouds(number, _):
    noise = np.random.default_rng(number).integers(0, 255, (240, 320)).astype(np.uint8)
    return cv2.imencode(".png", cv2.GaussianBlur(noise, (0, 0), 4))[1].tobytes()


def cut(_, data):
    return data[: len(data) // 2]


def target(**changes):
    return lambda _, files: recorded.edited(files / "target.yaml", changes)


def board(text):
    return lambda _, files: (files / "target.yaml").write_text(text)


def camera(**changes):
    def edit(_, files):
        chain = yaml.safe_load((files / "camchain.yaml").read_text())
        entry = {key: value for key, value in (chain["cam0"] | changes).items() if value is not None}
        recorded.edited(files / "camchain.yaml", {"cam0": entry})

    return edit


def file_of(recording):
    """Return the file of a bag."""
    if recording.is_file():
        return recording
    return next(path for path in recording.iterdir() if path.suffix in {".db3", ".mcap"})


def cut_off(part):
    def edit(recording, _):
        file = file_of(recording)
        data = file.read_bytes()
        file.write_bytes(data[: round(part * len(data))])

    return edit


def stamps(change):
    """Change the timestamps of the images in their table."""

    def edit(recording, _):
        table = recording / "cam0" / "data.csv"
        head, *rows = table.read_text().splitlines()
        changed = [f"{change(int(row.partition(',')[0]))},{row.partition(',')[2]}" for row in rows]
        table.write_text("\n".join([head, *changed]) + "\n")

    return edit


def sample_stamps(change):
    def edit(recording, _):
        recorded.write_samples(recording / "imu0.csv", recorded.samples_of(recording), change)
        (recording / "imu0.csv.gz").unlink()

    return edit


def bag(*messages, form="ros1", **more):
    """Put a bag with other messages in place of the recording."""

    def edit(recording, _):
        recording.unlink()
        bag_maker.make_bag(recording.parent, form, [*messages], name=recording.name, **more)

    return edit


def pictures(topic, encoding="mono8", count=10):
    step = 50_000_000
    return [
        bag_maker.image(topic, bag_maker.T0 + k * step, bag_maker.picture(k, (240, 320)), encoding)
        for k in range(count)
    ]


def movements(topic, count=100):
    return [bag_maker.imu(topic, bag_maker.T0 + k * 5_000_000) for k in range(count)]


def compression_of_mcap(recording, _):
    """Name a compression that nobody knows, in the chunks and in their index."""
    messages = [*pictures("/cam0/image_raw"), *movements("/imu0")]
    packing = (CompressionMode.STORAGE, CompressionFormat.ZSTD)
    packed = bag_maker.make_bag(recording.parent, "mcap", messages, name="packed", compression=packing)
    data = file_of(packed).read_bytes()
    assert data.count(b"zstd") >= 2
    recording.write_bytes(data.replace(b"zstd", b"snpy"))
    shutil.rmtree(packed)


CIRCLES = "target_type: circlegrid\ntargetCols: 7\ntargetRows: 6\nspacingMeters: 0.08\n"
SQUARES = "target_type: checkerboard\ntargetCols: {}\ntargetRows: {}\nrowSpacingMeters: 0.08\ncolSpacingMeters: 0.08\n"
SEES_TAGS = "They show an AprilGrid: tags 0 to 11 of the family 36h11, with a border of 2 bits, 4 in a row"
SEES_SQUARES = "They show a checkerboard of 7 x 6 inner corners."
LAYOUTS = "Expected a ROS bag (.bag, .db3, .mcap); a folder with mav0/cam0/data/*.png"
SHORT = ("too short to find the time shift", "Record for a minute")

REFUSED = {
    "empty folder": Case(edit=removed("*"), words=("found nothing at all", LAYOUTS)),
    "no images": Case(edit=removed("cam0/data/*"), words=("no images of a camera in this folder", LAYOUTS)),
    "no camera": Case(
        edit=removed("cam0"), words=("no images of a camera", "There are samples of an IMU", "another command")
    ),
    "one image": Case(edit=lambda r, _: None, layout="image", words=("this is one image", "the folder of them")),
    "no IMU": Case(edit=removed("imu0*"), words=("no samples of an IMU in this folder", "Expected imu0.csv")),
    "no IMU in a bag": Case(
        layout="ros1",
        edit=bag(*pictures("/cam0/image_raw")),
        words=(
            "no topic holds samples of an IMU (sensor_msgs/Imu)",
            "or give a table",
            "/cam0/image_raw",
            "10 messages",
        ),
    ),
    "no camera in a bag": Case(
        layout="ros1", edit=bag(*movements("/imu0")), words=("no topic holds images", "/imu0  sensor_msgs/Imu")
    ),
    "three cameras, none of them clear": Case(
        layout="ros1",
        edit=bag(*pictures("/a/image"), *pictures("/b/image"), *pictures("/c/image"), *movements("/imu")),
        arguments=("--topics", "imu0=/imu"),
        words=("/a/image", "/c/image", "--topics cam0="),
    ),
    "two IMUs, neither of them clear": Case(
        layout="ros1",
        edit=bag(*pictures("/cam0/image_raw"), *movements("/first"), *movements("/second")),
        words=("/first", "/second", "--topics", "imu0="),
    ),
    "a topic that is not there": Case(
        layout="ros1",
        arguments=("--topics", "cam0=/camera"),
        words=(
            "/camera, which is stated to be cam0, is not in this bag",
            "/cam0/image_raw  sensor_msgs/Image  80 mess",
        ),
    ),
    "a topic of another type": Case(
        layout="mcap",
        arguments=("--topics", "cam0=/imu0"),
        words=("/imu0, which is stated to be cam0, is of type sensor_msgs/Imu, not sensor_msgs/Image",),
    ),
    "topics of a folder": Case(
        arguments=("--topics", "cam0=/camera"), words=("topics were stated (cam0), but this is no bag",), code=USAGE
    ),
    "the board is nowhere": Case(
        edit=every_image(clouds), words=("is in none of 8 images", "They show no board", "in view, sharp, well lit")
    ),
    "images of one grey": Case(edit=every_image(blank), words=("of one grey level", "Check exposure, lens cap")),
    "a checkerboard stated": Case(edit=board(SQUARES.format(7, 6)), words=(SEES_TAGS, "State that board instead")),
    "an AprilGrid stated": Case(
        board=recorded.CHECKERBOARD,
        edit=board("target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"),
        words=("AprilGrid 6 x 6", "is in none of", SEES_SQUARES, "State that board instead"),
    ),
    "columns and rows exchanged": Case(
        edit=target(tagCols=3, tagRows=4),
        words=("AprilGrid 3 x 4", SEES_TAGS, "it has 3 columns (are tagCols and tagRows exchanged?)", "Correct"),
    ),
    "too many columns": Case(edit=target(tagCols=6), words=(SEES_TAGS, "it has 6 columns", "Correct")),
    "another first tag": Case(edit=target(firstTag=20), words=(SEES_TAGS, "its tags are 20 to 31")),
    "a first tag that is one too large": Case(edit=target(firstTag=1), words=(SEES_TAGS, "its tags are 1 to 12")),
    "gaps twice as wide": Case(edit=target(tagSpacing=0.6), words=(SEES_TAGS, "its tagSpacing is 0.6")),
    "gaps a third too narrow": Case(
        edit=target(tagSpacing=0.2), words=("is 0.30 of the side of a tag", "tagSpacing: 0.2", "Measure")
    ),
    "squares counted": Case(
        board=recorded.CHECKERBOARD,
        edit=board(SQUARES.format(8, 7)),
        words=(SEES_SQUARES, "8 x 7 seem to count squares"),
    ),
    "another checkerboard": Case(
        board=recorded.CHECKERBOARD,
        edit=board(SQUARES.format(9, 6)),
        words=(SEES_SQUARES, "The stated one has 9 x 6: correct targetCols and targetRows"),
    ),
    "circles": Case(edit=board(CIRCLES), words=(SEES_TAGS, "State that board instead of a circlegrid")),
    "an unknown board": Case(
        edit=board("target_type: apriltag\n"), words=("target.yaml: target_type", "expected one of aprilgrid")
    ),
    "every image cut off": Case(
        edit=every_image(cut), words=("none of the 8 images can be read", ".png: the picture is cut off", "Copy")
    ),
    "another encoding": Case(
        layout="ros1",
        edit=bag(*pictures("/cam0/image_raw", "yuv422_nv21x"), *movements("/imu0")),
        words=("yuv422_nv21x", "/cam0/image_raw"),
    ),
    "a bag that is packed in an unknown way": Case(
        layout="mcap", edit=compression_of_mcap, words=('compressed with "snpy"', "does not know", "mcap convert")
    ),
    "no timestamps": Case(edit=stamps(lambda t: 0), words=("images have the same timestamp", "in nanoseconds")),
    "no timestamps of the samples": Case(
        edit=sample_stamps(lambda t: 0), words=("imu0: all 801 timestamps are the same", "in nanoseconds")
    ),
    "a bag without any timestamp": Case(
        layout="ros1",
        edit=bag(
            *[bag_maker.image("/cam0", 0, bag_maker.picture(k), received_ns=1) for k in range(5)],
            *[bag_maker.imu("/imu0", 0, received_ns=1) for k in range(5)],
        ),
        words=("have no timestamps, neither their own nor the recorder's",),
    ),
    "a bag cut off early": Case(layout="ros1", edit=cut_off(0.4), words=SHORT, said="walk.bag ends early"),
    "an MCAP cut off early": Case(layout="mcap", edit=cut_off(0.4), words=SHORT, said="walk.mcap ends early"),
    "an SQLite cut off early": Case(layout="ros2", edit=cut_off(0.4), words=SHORT, said="walk-ros2.db3 ends early"),
    "a video cut off early": Case(layout="video", edit=cut_off(0.4), words=SHORT, said="it was cut off"),
    "nothing left of an SQLite": Case(layout="ros2", edit=cut_off(0.005), words=("no message can be read", "Copy")),
    "nothing left of a video": Case(layout="video", edit=cut_off(0.005), words=("not one image", "copied completely")),
    "intrinsics of another size": Case(
        edit=camera(resolution=[640, 480]), words=("images are of 320 x 240 px", "intrinsics are for 640 x 480 px")
    ),
    "no lens": Case(layout="euroc", named=("imu", "target"), words=("--cam is missing", "gnomon camera"), code=USAGE),
    "no board": Case(layout="euroc", named=("imu", "cam"), words=("--target is missing", "target.yaml"), code=USAGE),
    "camera without intrinsics": Case(
        edit=camera(intrinsics=None), words=("camchain.yaml: cam0: the key intrinsics is missing", "fu fv pu pv")
    ),
    "another camera": Case(
        edit=lambda _, files: (files / "camchain.yaml").write_text(
            (files / "camchain.yaml").read_text().replace("cam0:", "cam1:")
        ),
        words=("there are images of cam0, but camchain.yaml describes cam1", "Rename"),
    ),
}
"""Nothing is calibrated; the words are in the one message."""

CAM_FILES = {
    "a target": ("target.yaml", "This seems to be a target, which belongs to --target"),
    "noise": ("imu.yaml", "This seems to be the noise of an IMU, which belongs to --imu"),
    "an image": ("cam0/data.png", "this is no text file"),
    "a table": ("imu0.csv.gz", "this is no text file"),
    "nothing": ("nowhere.yaml", "there is no such file or folder. Check the path."),
    "a folder": ("cam0", "this is a folder"),
}


@pytest.fixture
def prepared(walks, tmp_path):
    """Return a function that prepares a case in a folder of its own: the recording, and the options that name files."""

    def make(case):
        simulated = walks.rendered(**case.board)
        source = walks.written(case.layout) if case.layout in recorded.NAMES else simulated
        place, files = tmp_path / "place", tmp_path / "files"
        place.mkdir()
        files.mkdir()
        recording = place / source.name
        if case.layout == "image":
            recording = Path(shutil.copy(recorded.images_of(source)[0], place))
        elif source.is_dir():
            shutil.copytree(source, recording)
        else:
            shutil.copy(source, recording)
        if case.layout == "video":
            shutil.copy(source.parent / "imu0.csv", place)
        for name in recorded.FILES.values():
            shutil.copy(simulated / name, files)
            if not case.layout:
                (recording / name).unlink()
        if case.few and not case.layout:
            recorded.thin_out(recording, FEW)
        case.edit(recording, files)
        return recording, [word for name in case.named for word in (f"--{name}", files / recorded.FILES[name])]

    return make


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_calibrated_is_named_and_leaves_nothing(run, prepared, names, tmp_path, case):
    recording, words = prepared(case)
    before = names(recording.parent)
    code, text, err = run("camera-imu", recording, *words, "-o", tmp_path / "out", "--json", *case.arguments)
    message = json.loads(text)["error"]["message"]
    assert [word for word in case.words if word not in message] == [], message
    assert code == case.code
    assert err.count(message) == 1
    assert "Traceback" not in err
    assert "bug" not in err
    assert 40 < len(message) < 900
    assert message[-1] in ".?" or "sensor_msgs/" in message.splitlines()[-1]  # a sentence, or the list of topics
    assert names(recording.parent) == before
    kept = tmp_path / "out"
    assert not kept.exists() or [path.name[:7] for path in kept.iterdir()] == ["corners"]


@pytest.mark.parametrize("case", [case for case in REFUSED.values() if case.said], ids=lambda case: case.said[:20])
def test_what_was_understood_explains_why(run, prepared, tmp_path, case):
    recording, words = prepared(case)
    _, text, _ = run("camera-imu", recording, *words, "-o", tmp_path / "out")
    assert case.said in " ".join(text.split())


@pytest.mark.parametrize(("file", "words"), CAM_FILES.values(), ids=CAM_FILES)
def test_a_file_of_another_kind_is_no_camera(run, walks, tmp_path, file, words):
    folder = tmp_path / "walk"
    shutil.copytree(walks.rendered(), folder, ignore=shutil.ignore_patterns("data"))
    shutil.copy(recorded.images_of(walks.rendered())[0], folder / "cam0" / "data.png")
    code, _, err = run("camera-imu", walks.rendered(), "--cam", folder / file, "-o", tmp_path / "out")
    assert code == BAD_INPUT
    assert str(folder / file) in err
    assert words in err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_may_not_be_read(run, walks, monkeypatch, tmp_path):
    """As a user without permissions; the tests may run as one who has all of them."""
    recording, words = walks.written("euroc"), recorded.inputs(walks.rendered())
    whole = os.scandir

    def denied(path="."):
        if not isinstance(path, int) and Path(path).name == "data":
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(os, "scandir", denied)
    code, _, err = run("camera-imu", recording, *words, "-o", tmp_path / "out")
    assert code == BAD_INPUT, err
    assert f"{recording / 'mav0/cam0/data'}: cannot be read (Permission denied). Check its permissions." in err
    assert not (tmp_path / "out").exists()


# ---- what is used all the same ----


def spoilt_images(recording, _):
    """Three of them in the middle: cut off, empty, and something else."""
    for path, data in zip(recorded.images_of(recording)[40:43], (None, b"", b"<html>not found</html>"), strict=True):
        path.write_bytes(path.read_bytes()[:20_000] if data is None else data)


HOURS_NS = 7 * 3600 * 10**9 + 123_456_789

USED = {
    "three images spoilt": Case(
        few=False,
        edit=spoilt_images,
        words=("cam0: 3 of 80 images cannot be read and were left out.", "the picture is cut off (20000 bytes)."),
    ),
    "a bag that ends early": Case(
        layout="ros1", edit=cut_off(0.9), words=("walk.bag ends early", "messages were read")
    ),
    "a video that ends early": Case(
        layout="video", edit=cut_off(0.9), words=("walk.mkv: the video ends after", "What is there was used.")
    ),
    "clocks that are hours apart": Case(
        few=False,
        edit=sample_stamps(lambda t: t - HOURS_NS),
        words=("have no time in common by their timestamps", "Their clocks are taken for unrelated"),
    ),
    "a border of one bit stated": Case(few=False, edit=target(tagBorderBits=1), words=()),
}
"""There is a result, the truth is in it, and the words are said."""


@pytest.mark.parametrize("case", USED.values(), ids=USED)
def test_what_is_sound_is_used_and_the_rest_said(run, walks, prepared, tmp_path, case):
    recording, words = prepared(case)
    out = tmp_path / "out"
    code, text, err = run("camera-imu", recording, *words, "-o", out, "--no-report", "--gravity", 9.80665)
    assert code == 0, err
    said = " ".join(text.split())
    assert [word for word in case.words if word not in said] == []
    result, truth = gnomon.load(out / "calibration.yaml"), recorded.truth_of(walks.rendered())
    apart = case.layout == "video" or "clocks" in text
    assert recorded.most_sigmas(result, truth, shift=not apart) < 4.5
    if case is USED["clocks that are hours apart"]:
        shift = result.cameras["cam0"].time_shift_cam_imu + HOURS_NS * 1e-9
        assert abs(shift - truth.cameras["cam0"].time_shift_cam_imu) < 50e-6
