"""Corners that are kept beside the result: the second run finds them, and nothing but what fits."""

import os
import shutil
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest

import recorded
from gnomon.calibrate.steps import board_corners
from gnomon.cli.files import CAMERA_IMU_FILES

KEPT = "the corners are those that an earlier run found in the same images"
LOOKED = "finding the board in the images of cam0: 0 of 80"


@pytest.fixture(scope="module")
def first(run, walks, tmp_path_factory):
    """A recording with the folder of its result, which the first run wrote: (recording, folder)."""
    recording, out = walks.written("mcap"), tmp_path_factory.mktemp("first") / "out"
    code, text, err = run("camera-imu", recording, *recorded.inputs(walks.rendered()), "-o", out, "--no-report")
    assert code == 0, err
    assert LOOKED in err
    assert KEPT not in text
    return recording, out


@pytest.fixture
def again(first, run, walks, tmp_path):
    """Return a function that calibrates once more, in a copy of the first result's folder."""
    recording, out = first
    copy = tmp_path / "out"
    shutil.copytree(out, copy)

    def calibrate(*arguments, recording=recording, inputs=None):
        words = inputs or recorded.inputs(walks.rendered())
        code, text, err = run("camera-imu", recording, *words, "-o", copy, "--no-report", *arguments)
        return code, text, err, copy

    return calibrate


def corners_in(folder):
    return sorted(path.name for path in folder.glob("corners-*"))


def calibration(folder):
    """Return a result without the sentence that tells of the corners that were kept."""
    found = recorded.content(folder / "calibration.yaml")
    findings = found["assessment"]["findings"]
    found["assessment"]["findings"] = [finding for finding in findings if KEPT not in finding["message"]]
    return found


def test_the_second_run_looks_at_no_image(first, again, monkeypatch):
    def never(*_):
        raise AssertionError("an image was looked at")

    monkeypatch.setattr(board_corners, "BoardFinder", never)
    monkeypatch.setattr(cv2, "imdecode", never)
    code, text, err, out = again()
    assert code == 0, err
    assert f"cam0: {KEPT} ({corners_in(out)[0]})." in " ".join(text.split())
    assert calibration(out) == calibration(first[1])
    for name in ("camchain-imucam.yaml", "imu.yaml", "trajectory.txt"):
        assert (out / name).read_bytes() == (first[1] / name).read_bytes()
    assert corners_in(out) == corners_in(first[1])


def test_without_cache_nothing_is_read_nor_written(first, again, tmp_path):
    file = tmp_path / "out" / corners_in(first[1])[0]
    written = file.stat().st_mtime_ns
    code, text, err, _ = again("--no-cache")
    assert code == 0, err
    assert LOOKED in err
    assert KEPT not in text
    assert file.stat().st_mtime_ns == written


@pytest.mark.long
def test_other_images_or_another_board_are_looked_at(first, walks, again, tmp_path):
    """Of one camera only the last corners are kept; a lens or a noise that changes does not matter."""
    (before,) = corners_in(first[1])
    files = tmp_path / "files"
    files.mkdir()
    for name in recorded.FILES.values():
        shutil.copy(walks.rendered() / name, files)
    inputs = recorded.inputs(files)
    recorded.edited(files / "imu.yaml", {"gyroscope_noise_density": 2e-4})
    _, text, err, out = again(inputs=inputs)
    assert LOOKED not in err
    recorded.edited(files / "target.yaml", {"tagSize": 0.1301})
    _, text, err, out = again(inputs=inputs)
    assert LOOKED in err
    assert KEPT not in text
    (of_another_board,) = corners_in(out)
    changed = tmp_path / "walk.mcap"
    data = bytearray(first[0].read_bytes())
    image = cv2.imread(str(recorded.images_of(walks.rendered())[40]), cv2.IMREAD_GRAYSCALE)
    data[data.index(image.tobytes()) + 1000] ^= 1
    changed.write_bytes(data)
    _, text, err, out = again(recording=changed, inputs=inputs)
    assert LOOKED in err
    assert len({before, of_another_board, *corners_in(out)}) == 3
    assert len(corners_in(out)) == 1


def test_a_damaged_file_is_passed_over_and_replaced(first, again, tmp_path):
    file = tmp_path / "out" / corners_in(first[1])[0]
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    code, text, err, out = again()
    assert code == 0, err
    assert LOOKED in err
    assert KEPT not in text
    assert calibration(out) == calibration(first[1])
    with np.load(file) as kept, np.load(first[1] / file.name) as before:
        assert all(np.array_equal(kept[name], before[name], equal_nan=kept[name].dtype.kind == "f") for name in kept)


def _heeds_interrupts() -> None:
    """Undo what a shell sets for its background jobs, which ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
@pytest.mark.parametrize("stop", ["SIGINT", "SIGKILL"])
def test_a_run_that_is_stopped_midway_leaves_nothing_half_written(walks, tmp_path, stop):
    """While it looks at the images: without a result, without corners, and what was there before stays."""
    out = tmp_path / "out"
    out.mkdir()
    before = "# of an earlier run\nprovenance:\n  method: camera-imu\n"
    (out / "calibration.yaml").write_text(before)
    words = map(str, ["camera-imu", walks.rendered(), *recorded.inputs(walks.rendered()), "-o", out, "--workers", 1])
    with subprocess.Popen(
        [sys.executable, "-m", "gnomon", *words],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_heeds_interrupts,  # noqa: PLW1509 - there is one thread
    ) as process:
        for line in process.stderr:
            if line.startswith("finding the board in the images of cam0:"):
                break  # at the first of them: the sooner, the longer it still has to go
        process.send_signal(getattr(signal, stop))
        rest = process.stderr.read()
    assert process.returncode == (-signal.SIGKILL if stop == "SIGKILL" else 130)
    visible = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    assert visible == ["calibration.yaml"]
    assert (out / "calibration.yaml").read_text() == before
    if stop == "SIGINT":
        assert rest.endswith("gnomon: interrupted; no file is half-written.\n")
        assert "Traceback" not in rest
        assert sorted(path.name for path in out.iterdir()) == ["calibration.yaml"]


def test_what_is_kept_is_small_and_only_gnomons_own(first):
    _, out = first
    (kept,) = corners_in(out)
    assert (out / kept).stat().st_size < 1_000_000
    assert sorted(path.name for path in out.iterdir()) == sorted({*CAMERA_IMU_FILES, kept} - {"report.html"})
