"""What is written is whole, whatever moment the writer is killed at; signals tidy up; two writers do not mix."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

resource = pytest.importorskip("resource", reason="signals and limits as POSIX has them")

from gnomon import OutputError, output  # noqa: E402
from gnomon.output import (  # noqa: E402
    READY,
    atomic_file,
    files_together,
    put_in_place,
    write_together,
    write_whole,
)
from killing import Killer, contents, visible  # noqa: E402

NEW = {"calibration.yaml": b"new", "report.html": b"new", "cam0/1.png": b"new", "cam0/2.png": b"new"}
OLD = {"calibration.yaml": b"old", "report.html": b"old", "cam0/1.png": b"old", "trajectory.txt": b"old"}
WRITE = """
from pathlib import Path
from gnomon.output import files_together, write_whole
with files_together(Path("out"), ("trajectory.txt", "camchain.yaml")) as staging:
    (staging / "cam0").mkdir()
    for name in ("calibration.yaml", "report.html"):
        write_whole(staging / name, "new")
    for name in ("cam0/1.png", "cam0/2.png"):
        (staging / name).write_bytes(b"new")
"""


def fill(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
def test_a_set_of_files_is_old_or_new_wherever_its_writer_is_killed(every, tmp_path):
    killer = Killer(tmp_path / "killer")
    foreign = {"notes.txt": b"mine", "photos/1.jpg": b"mine"}

    def prepared(name: str) -> Path:
        place = tmp_path / name
        fill(place / "out", OLD | foreign)
        return place

    place = prepared("whole")
    steps = killer.steps(["-c", WRITE], place)
    assert contents(place / "out") == NEW | foreign
    assert steps > 20
    sets: list[str] = []
    for step in range(1, steps + 1, every):
        place = prepared(f"{step}")
        code, _ = killer.killed_at(step, ["-c", WRITE], place)
        assert code == -signal.SIGKILL
        found = visible(contents(place / "out"))
        for name, data in found.items():
            assert data in {OLD.get(name), NEW.get(name), foreign.get(name)}, (step, name)
        put_in_place(place / "out")
        found = visible(contents(place / "out"))
        assert found in (OLD | foreign, NEW | foreign), step
        sets.append("new" if found == NEW | foreign else "old")
        with files_together(place / "out") as staging:  # the next one that writes there
            (staging / "calibration.yaml").write_bytes(b"next")
        assert contents(place / "out") == {**found, "calibration.yaml": b"next"}, step
    assert sorted(sets, reverse=True) == sets  # from some step on it is the new one
    assert {"old", "new"} == set(sets)


def test_what_a_killed_writer_left_of_a_file_goes_with_the_next(tmp_path):
    killer = Killer(tmp_path / "killer")
    program = "from gnomon.output import write_whole; write_whole('a.csv', 'new')"
    for step in range(1, 3):
        (tmp_path / "a.csv").write_text("old")
        assert killer.killed_at(step, ["-c", program], tmp_path)[0] == -signal.SIGKILL
        assert (tmp_path / "a.csv").read_text() == "old"
    assert len(list(tmp_path.glob(".a.csv.*.part"))) == 1
    write_whole(tmp_path / "a.csv", "next")
    assert visible(contents(tmp_path))["a.csv"] == b"next"
    assert not list(tmp_path.glob(".*"))


def test_what_a_running_writer_has_is_left_alone(tmp_path):
    with atomic_file(tmp_path / "a.csv") as mine, files_together(tmp_path, ("b.csv",)) as staging:
        mine.write(b"half")
        (staging / "b.csv").write_text("half")
        program = "from gnomon.output import *\nwrite_whole('a.csv', 'other')\nwrite_together('.', {'b.csv': 'other'})"
        subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
        assert contents(tmp_path)["b.csv"] == b"other"
        mine.write(b" and whole")
    assert contents(tmp_path) == {"a.csv": b"half and whole", "b.csv": b"half"}


def test_two_writers_of_one_folder_do_not_mix(tmp_path):
    names = [f"{k}.txt" for k in range(8)]

    def write(word: str) -> None:
        for _ in range(15):
            write_together(tmp_path, dict.fromkeys(names, word))

    threads = [threading.Thread(target=write, args=(word,)) for word in ("one", "two", "three")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = contents(tmp_path)
    assert sorted(found) == names
    assert len(set(found.values())) == 1


WRITE_OFTEN = """
import sys
from gnomon.output import files_together, write_whole
for number in range(12):
    word = f"{sys.argv[1]} {number}"
    with files_together("out", ("odd.txt",)) as staging:
        (staging / "cam0").mkdir()
        for name in ("1.txt", "2.txt", "3.txt", "cam0/1.png", "cam0/2.png", *["odd.txt"][: number % 2]):
            write_whole(staging / name, word)
    write_whole("out/alone.csv", word * 10_000 + "end")
"""


@pytest.mark.slow
def test_writers_of_one_folder_of_which_some_are_killed(tmp_path):
    """Four processes at a time, any three of which may be killed: one set in the end, and nothing left."""
    chance = random.Random(8)
    for turn in range(20):
        place = tmp_path / f"{turn}"
        place.mkdir()
        writers = [
            subprocess.Popen([sys.executable, "-c", WRITE_OFTEN, word], cwd=place, stderr=subprocess.PIPE, text=True)
            for word in ("one", "two", "three", "four")
        ]
        for writer in writers[: turn % 4]:
            time.sleep(chance.uniform(0.0, 0.4))
            writer.kill()
        for writer in writers:
            _, err = writer.communicate()
            assert writer.returncode == 0 or (writer in writers[: turn % 4] and not err), err
        put_in_place(place / "out")
        found = visible(contents(place / "out"))
        assert found.pop("alone.csv").endswith(b"end")
        (word,) = set(found.values())
        assert len(found) == 5 + int(word.split()[1]) % 2, turn
        write_together(place / "out", {"1.txt": "next"})
        write_whole(place / "out/alone.csv", "next")
        assert contents(place / "out").keys() == {*found, "alone.csv"}, turn


def test_files_on_the_way_are_moved_and_names_that_are_paths_are_not_removed(tmp_path):
    out = tmp_path / "out"
    fill(out, {"a.yaml": b"old", f"{READY}/a.yaml": b"new"})
    (out / READY / ".dropped").write_text('["../mine.txt", "..", "", "b.yaml"]')
    fill(tmp_path, {"mine.txt": b"mine", "out/b.yaml": b"old"})
    put_in_place(out)
    assert contents(tmp_path) == {"mine.txt": b"mine", "out/a.yaml": b"new"}


def test_a_folder_is_not_replaced_by_a_file(tmp_path):
    fill(tmp_path, {"report.html/mine.txt": b"mine", "calibration.yaml": b"old"})
    with pytest.raises(OutputError, match=r"this is a folder. Nothing was changed"):
        write_together(tmp_path, {"calibration.yaml": "new", "report.html": "new"})
    assert contents(tmp_path) == {"report.html/mine.txt": b"mine", "calibration.yaml": b"old"}


def test_a_folder_that_is_there_when_a_file_is_moved_stays(tmp_path):
    """Somebody made it after the file was complete, and before it was moved: the file waits."""
    fill(tmp_path, {f"{READY}/report.html": b"new", "report.html/mine.txt": b"mine"})
    with pytest.raises(OutputError, match=r"report.html: this file cannot be replaced .* The new one waits"):
        put_in_place(tmp_path)
    assert contents(tmp_path) == {f"{READY}/report.html": b"new", "report.html/mine.txt": b"mine"}
    (tmp_path / "report.html").rename(tmp_path / "mine")
    put_in_place(tmp_path)
    assert contents(tmp_path) == {"report.html": b"new", "mine/mine.txt": b"mine"}


def test_a_file_that_waits_does_not_replace_a_newer_one(tmp_path):
    fill(tmp_path, {f"{READY}/a.yaml": b"waited", f"{READY}/b.yaml": b"waited", "a.yaml": b"old"})
    write_whole(tmp_path / "a.yaml", "new")
    put_in_place(tmp_path)
    assert contents(tmp_path) == {"a.yaml": b"new", "b.yaml": b"waited"}


def test_a_folder_that_another_writer_removes_is_made_again(tmp_path, monkeypatch):
    """One that failed removes the folder that it had made, empty as it is, just when this one begins in it."""
    out, alone = tmp_path / "out", []

    def removed_once(folder: Path):
        alone.append(folder)
        if len(alone) == 1:
            folder.rmdir()
        return true_alone(folder)

    true_alone = output._alone
    monkeypatch.setattr(output, "_alone", removed_once)
    write_together(out, {"a.txt": "new"})
    assert contents(out) == {"a.txt": b"new"}


@pytest.mark.parametrize("at", ["_all_on_disk", "_declare_valid", "put_in_place"])
def test_an_interrupt_between_two_steps_leaves_old_or_new(at, tmp_path, monkeypatch):
    """Wherever it comes, nothing else is left, and nothing is held any more."""
    fill(tmp_path, {"a.txt": b"old"})
    calls = []
    true_one = getattr(output, at)

    def interrupted(*arguments):
        calls.append(at)
        if len(calls) == (2 if at == "put_in_place" else 1):  # its first call is before the work
            raise KeyboardInterrupt
        return true_one(*arguments)

    monkeypatch.setattr(output, at, interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_together(tmp_path, {"a.txt": "new"})
    assert contents(tmp_path) == {"a.txt": b"new" if at == "put_in_place" else b"old"}


def test_a_folder_that_goes_or_closes_meanwhile(tmp_path):
    out = tmp_path / "out"

    def gone() -> None:
        with files_together(out) as staging:
            write_whole(staging / "a.txt", "new")
            staging.rename(tmp_path / "elsewhere")

    with pytest.raises(OutputError, match=r"cannot be written .*Nothing was changed"):
        gone()
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_that_becomes_read_only(tmp_path):
    fill(tmp_path, {"a.txt": b"old"})

    def closed() -> None:
        with files_together(tmp_path) as staging:
            write_whole(staging / "a.txt", "new")
            tmp_path.chmod(0o500)

    try:
        with pytest.raises(OutputError, match=r"Permission denied.*Nothing was changed"):
            closed()
    finally:
        tmp_path.chmod(0o700)
    assert visible(contents(tmp_path)) == {"a.txt": b"old"}
    write_together(tmp_path, {"a.txt": "next"})
    assert contents(tmp_path) == {"a.txt": b"next"}


def test_a_full_disk_changes_nothing(tmp_path):
    """A limit to the size of files stands for the disk: the write fails halfway."""
    fill(tmp_path, {"a.txt": b"old", "b.txt": b"old"})
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
        with pytest.raises(OutputError, match="too large"):
            write_together(tmp_path, {"a.txt": "new", "b.txt": "x" * 20_000})
        with pytest.raises(OutputError, match="too large"):
            write_whole(tmp_path / "b.txt", "x" * 20_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert contents(tmp_path) == {"a.txt": b"old", "b.txt": b"old"}
