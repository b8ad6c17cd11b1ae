"""`gnomon check` on recordings of images: what it says before anything is calibrated."""

import json
import shutil

import cv2
import numpy as np
import pytest

import recorded

LAYOUTS = ("euroc", "ros1", "ros2", "mcap", "kalibr", "video")


@pytest.fixture
def checked(run, walks):
    """Return a function that checks a recording: exit code, document, findings by code."""

    def check(recording, *arguments):
        code, text, err = run("check", recording, "--json", *arguments)
        assert "Traceback" not in err
        found = json.loads(text)
        return code, found, {finding["code"]: finding for finding in found.get("findings", ())}

    return check


def grave(findings):
    return {code for code, finding in findings.items() if finding["severity"] in {"warning", "problem"}}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_good_images_are_called_good_in_every_layout(checked, walks, layout):
    """Without lens or board, and without a word on the clock of a video."""
    code, document, findings = checked(walks.written(layout))
    assert code == 0
    assert grave(findings) == set()
    assert document["cameras"]["cam0"]["images"] == recorded.FRAMES
    assert document["cameras"]["cam0"]["rate_hz"] == pytest.approx(10.0, abs=0.01)


def test_the_board_is_looked_for_where_it_is_stated(checked, walks):
    code, document, findings = checked(walks.rendered())
    assert code == 0
    assert grave(findings) == set()
    camera = document["cameras"]["cam0"]
    assert camera["board_seen"] == camera["looked_at"]


def test_another_board_is_named(checked, walks, tmp_path):
    walk, other = walks.rendered(), walks.rendered(**recorded.CHECKERBOARD)
    for recording, target, seen in (
        (walk, other, "They show an AprilGrid: tags 0 to 11"),
        (other, walk, "They show a checkerboard of 7 x 6 inner corners"),
    ):
        _, _, findings = checked(recording, "--target", target / "target.yaml")
        (finding,) = (finding for finding in findings.values() if seen in finding["message"])
        assert finding["severity"] in {"warning", "problem"}


@pytest.fixture
def changed(walks, tmp_path):
    """Return a function that changes every image of a copy of the recording."""

    def change(how):
        folder = tmp_path / "walk"
        shutil.copytree(walks.rendered(), folder)
        recorded.thin_out(folder, 2)
        for path in recorded.images_of(folder):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            cv2.imwrite(str(path), np.clip(how(image.astype(float)), 0, 255).astype(np.uint8))
        return folder

    return change


@pytest.mark.parametrize(
    ("how", "code"),
    [
        (lambda image: cv2.GaussianBlur(image, (0, 0), 2.5), "out-of-focus"),
        (lambda image: 3 * image, "images-bright"),
        (lambda image: 0.12 * image, "images-dark"),
    ],
    ids=["out of focus", "too bright", "too dark"],
)
def test_bad_light_and_blur_are_noticed(checked, changed, how, code):
    _, _, findings = checked(changed(how))
    assert code in {name for name, finding in findings.items() if finding["severity"] != "good"}


def test_a_bag_that_ends_early_and_images_that_are_damaged(run, walks, tmp_path):
    bag = tmp_path / "walk.bag"
    data = walks.written("ros1").read_bytes()
    bag.write_bytes(data[: len(data) // 2])
    folder = tmp_path / "walk"
    shutil.copytree(walks.rendered(), folder)
    for path in recorded.images_of(folder):
        path.write_bytes(path.read_bytes()[:20_000])
    for recording, said in ((bag, "walk.bag ends early"), (folder, "the picture is cut off")):
        _, text, err = run("check", recording)
        assert said in " ".join((text + err).split())
        assert "Traceback" not in err
