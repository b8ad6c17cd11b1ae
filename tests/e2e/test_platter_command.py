"""`gnomon rate` and `gnomon simulate-platter-video`: a video made, measured, and what is said about bad ones."""

import json
from math import pi

import numpy as np
import pytest

from gnomon.cli import main
from gnomon.recording.recording import Grey
from gnomon.writers.image_folders import save_video

USAGE, BAD_INPUT = 2, 3
SMALL = ["--width", "160", "--height", "120", "--duration-s", "20", "--rate-rad-s", "4.7"]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Return a video of 20 s, 45 rpm, as the command makes it."""
    path = tmp_path_factory.mktemp("platter") / "platter.mkv"
    assert main(["simulate", "platter-video", "-o", str(path), "--seed", "3", *SMALL]) == 0
    return path


def failed(capfd, *arguments):
    """Return exit code and message of a command that fails, and nothing but one message may come of it."""
    code = main(["rate", *map(str, arguments)])
    said = capfd.readouterr()
    assert "Traceback" not in said.err
    assert said.out == ""
    return code, said.err


@pytest.mark.main
def test_a_video(video, capfd):
    assert main(["rate", str(video), "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert abs(found["rate_rad_s"] - 4.7) < 5e-4 * 4.7
    assert found["sigma_rad_s"] < 5e-4 * 4.7
    assert found["rate_rpm"] == pytest.approx(30 / pi * found["rate_rad_s"])
    assert found["turns"] == pytest.approx(14.9, abs=0.2)
    assert found["frames_used"] == 300
    assert main(["rate", str(video), "--nominal", "45rpm"]) == 0
    said = capfd.readouterr().out
    assert "44.8" in said
    assert "rad/s" in said
    assert "turns" in said


def test_another_nominal_rate(video, capfd):
    code, message = failed(capfd, video, "--nominal", "33.33rpm")
    assert code == BAD_INPUT
    assert "once in a turn of the platter, at 44.8" in message
    assert "Check the nominal rate" in message


@pytest.mark.parametrize(("text", "words"), [("45", "unit is missing"), ("fast", "no number"), ("0rpm", "not turn")])
def test_a_nominal_rate_that_is_none(video, capfd, text, words):
    code, message = failed(capfd, video, "--nominal", text)
    assert code == USAGE
    assert words in " ".join(message.replace("│", " ").split())


def noise(frames, *, mean=90) -> list[Grey]:
    rng = np.random.default_rng(1)
    return [np.clip(rng.normal(mean, 3, (90, 120)), 0, 255).astype(np.uint8) for _ in range(frames)]


def test_a_video_without_motion(tmp_path, capfd):
    t_ns = 66_000_000 * np.arange(300)
    save_video(tmp_path / "still.mkv", noise(300), t_ns, codec="ffv1")
    code, message = failed(capfd, tmp_path / "still.mkv")
    assert code == BAD_INPUT
    assert "still.mkv: nothing moves in this video (300 frames, 19.7 s)" in message
    assert "mark" in message


def test_a_video_that_is_too_short(tmp_path, capfd):
    short = [*SMALL, "--duration-s", "2.2"]
    assert main(["simulate", "platter-video", "-o", str(tmp_path / "short.mp4"), *short]) == 0
    capfd.readouterr()
    code, message = failed(capfd, tmp_path / "short.mp4")
    assert code == BAD_INPUT
    assert "Record" in message


def test_one_frame(tmp_path, capfd):
    save_video(tmp_path / "one.mkv", noise(1), np.zeros(1, np.int64), codec="ffv1")
    code, message = failed(capfd, tmp_path / "one.mkv")
    assert code == BAD_INPUT
    assert "1 images of the video can be read" in message


def test_files_that_cannot_be_decoded(video, tmp_path, capfd):
    (tmp_path / "junk.mkv").write_bytes(np.random.default_rng(2).bytes(20_000))
    whole = tmp_path / "whole.mp4"
    assert main(["simulate", "platter-video", "-o", str(whole), *SMALL, "--duration-s", "3"]) == 0
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (tmp_path / "empty.avi").write_bytes(b"")
    capfd.readouterr()
    for name, words in (("junk.mkv", "no video"), ("cut.mp4", "cut off"), ("empty.avi", "no video"), ("no", "no such")):
        code, message = failed(capfd, tmp_path / name)
        assert code == BAD_INPUT
        assert words in message
        assert len(message.strip().splitlines()) <= 2


def test_a_truncated_video_is_used_with_a_warning(video, tmp_path, capfd):
    (tmp_path / "cut.mkv").write_bytes(video.read_bytes()[: video.stat().st_size * 3 // 5])
    assert main(["rate", str(tmp_path / "cut.mkv"), "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert abs(found["rate_rad_s"] - 4.7) < 3 * found["sigma_rad_s"] + 1e-4
    assert "video-damaged" in [finding["code"] for finding in found["findings"]]


def test_places_that_cannot_be_written(tmp_path, capfd):
    (tmp_path / "file").write_text("")
    for name, code, words in (("a.gif", USAGE, "found .gif"), ("file/a.mkv", BAD_INPUT, "file")):
        assert main(["simulate", "platter-video", "-o", str(tmp_path / name), *SMALL, "--duration-s", "1"]) == code
        assert words in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]
