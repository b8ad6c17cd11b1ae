"""`gnomon convert` with a recording of images, and which of its arguments do not go together."""

import contextlib
import filecmp
import io
import json

import pytest

import gnomon
from gnomon.cli import main
from gnomon.cli.command import topics_of
from gnomon.errors import OptionError
from image_folders import START, stamps, write_images, write_samples, write_video


def run(*arguments):
    """Run a command in this process: exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture
def rig(tmp_path):
    write_images(tmp_path / "rig/cam0", stamps(12))
    write_images(tmp_path / "rig/cam1", stamps(11))
    write_samples(tmp_path / "rig/imu0.csv", 120)
    return tmp_path / "rig"


def files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def same():
    """Return a function that holds two folders in EuRoC's layout against each other, file by file."""

    def check(first, second):
        names = files(first)
        assert len(names) == 12 + 11 + 4
        assert files(second) == names
        assert filecmp.cmpfiles(first, second, names, shallow=False) == (names, [], [])

    return check


@pytest.mark.parametrize(("form", "made"), [("ros1", "rig-ros1.bag"), ("ros2", "rig-ros2"), ("mcap", "rig-mcap.mcap")])
def test_every_form_holds_the_same(rig, tmp_path, form, made, same):
    code, out, err = run("convert", rig, "--to", "euroc")
    assert (code, "cam0: 1 of 12" in err) == (0, True), err
    assert "rig-euroc (cam0 12 images, cam1 11 images, imu0 120 samples)" in out
    code, out, err = run("convert", rig, "--to", form, "--json")
    assert code == 0, err
    document = json.loads(out)
    assert document["files"] == [str(tmp_path / made)]
    assert document["notes"] == []
    assert any("the names of the images are their timestamps in ns" in text for text in document["assumptions"])
    code, _, err = run("convert", tmp_path / made, "--to", "euroc", "-o", tmp_path / "back")
    assert code == 0, err
    same(tmp_path / "rig-euroc", tmp_path / "back")


def test_topics_choose_the_camera(rig, tmp_path):
    assert run("convert", rig, "--to", "mcap", "-o", tmp_path / "rig.mcap")[0] == 0
    topics = ("--topics", "cam0=/cam1/image_raw", "imu0=/imu0")
    code, out, err = run("convert", tmp_path / "rig.mcap", "--to", "euroc", "-o", tmp_path / "one", *topics)
    assert code == 0, err
    assert "cam0 11 images" in out
    assert sorted(path.name for path in (tmp_path / "one/mav0").iterdir()) == ["cam0", "imu0"]


def test_a_video_and_its_table_of_samples(tmp_path):
    write_video(tmp_path / "ride.mkv", count=6)
    write_samples(tmp_path / "phone.csv")
    code, out, err = run("convert", tmp_path / "ride.mkv", "--to", "euroc", "--imu-table", tmp_path / "phone.csv")
    assert code == 0, err
    assert "cam0 6 images, imu0 40 samples" in out
    assert len(files(tmp_path / "ride-euroc")) == 6 + 3


def test_images_without_imu_are_written_and_that_is_said(tmp_path):
    write_images(tmp_path / "rig/cam0", stamps(3))
    code, out, err = run("convert", tmp_path / "rig", "--to", "euroc")
    assert code == 0, err
    assert "detected: there are no samples of an IMU in this folder." in out


def test_a_damaged_image_is_left_out_and_that_is_said(rig, tmp_path):
    (rig / "cam0" / f"{START}.png").write_bytes(b"")
    code, out, err = run("convert", rig, "--to", "euroc")
    assert code == 0, err
    assert f"cam0: 1 images cannot be read and were left out; the first: cam0/{START}.png: the file is empty" in out


@pytest.fixture
def calibration(tmp_path, random_calibration):
    gnomon.save(random_calibration(), tmp_path / "calibration.yaml")
    return tmp_path / "calibration.yaml"


@pytest.mark.parametrize("to", ["euroc", "ros1", "mcap"])
def test_a_calibration_is_no_recording(calibration, to):
    code, _, err = run("convert", calibration, "--to", to)
    assert code == 2
    assert f"this is a calibration, and {to} is a format of recordings. Calibrations are written --to imu_tk," in err


@pytest.mark.parametrize("to", ["kalibr", "csv"])
def test_a_recording_is_no_calibration(rig, tmp_path, to):
    write_video(tmp_path / "ride.mkv", count=3)
    for path in (rig, tmp_path / "ride.mkv"):
        code, _, err = run("convert", path, "--to", to)
        assert code == 2
        assert f"{to} is a format of calibrations. Recordings are written --to euroc, ros1, ros2 or mcap" in err


def test_options_of_recordings_are_not_of_calibrations(calibration):
    code, _, err = run("convert", calibration, "--to", "kalibr", "--units", "g deg/s")
    assert code == 2
    assert "of recordings" in err


BAD = {
    "no such place": (lambda root: root / "nothing", 3, "there is no such file or folder"),
    "samples alone": (lambda root: write_samples(root / "x/imu0.csv") or root / "x", 3, "calibrating it alone"),
    "a table": (lambda root: write_samples(root / "x.csv") or root / "x.csv", 3, "text file, which holds no images"),
}


@pytest.mark.parametrize(("make", "expected", "message"), BAD.values(), ids=BAD)
def test_bad_recordings(tmp_path, make, expected, message):
    path = make(tmp_path)
    before = files(tmp_path)
    code, _, err = run("convert", path, "--to", "euroc")
    assert code == expected
    assert message in err
    assert "bug" not in err
    assert files(tmp_path) == before


@pytest.mark.parametrize("to", ["euroc", "ros1", "ros2", "mcap"])
def test_what_is_there_is_not_replaced(rig, tmp_path, to):
    (tmp_path / "there").mkdir()
    (tmp_path / "there/mine.txt").write_text("precious")
    for place in ("there", "there/mine.txt"):
        code, _, err = run("convert", rig, "--to", to, "-o", tmp_path / place)
        assert code == 3
        assert "there is something of this name already" in err
    assert (tmp_path / "there/mine.txt").read_text() == "precious"


def test_topics():
    assert topics_of(("cam1=/a=b", "imu0=/x,/y")) == {"cam1": "/a=b", "imu0": "/x,/y"}


@pytest.mark.parametrize("words", [("cam0",), ("cam0=",), ("=/a",), ("camera=/a",), ("cam0=/a", "cam0=/b"), ("rig",)])
def test_malformed_topics(words):
    with pytest.raises(OptionError, match=f"--topics {words[-1]}"):
        topics_of(words)
    code, out, err = run("convert", "x", "--to", "euroc", "--topics", *words)
    assert (code, out) == (2, "")
    assert f"--topics {words[-1]}: " in err
