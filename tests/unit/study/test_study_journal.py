"""The journal of an interrupted study: whole lines only, of this gnomon only, data only."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gnomon.errors import OutputError
from gnomon.study import journal as module
from gnomon.study.journal import JOURNAL, study_journal
from gnomon.study.runs import Workers, carry_out
from study_work import Task, drawn

TESTS = Path(__file__).parents[2]


def keep(folder, records, study="test"):
    with study_journal(folder, study, print) as journal:
        for key, record in records.items():
            journal.keep(key, record)


def kept(folder, keys="abcd", study="test"):
    with study_journal(folder, study, print) as journal:
        return {key: journal.find(key) for key in keys if journal.find(key) is not None}


def test_what_is_kept_is_found_again(tmp_path):
    keep(tmp_path, {"a": "1", "b": '{"name": "ä ö"}'})
    keep(tmp_path, {"c": "3"})
    assert kept(tmp_path) == {"a": "1", "b": '{"name": "ä ö"}', "c": "3"}


def test_a_journal_of_nothing_goes(tmp_path):
    keep(tmp_path, {})
    assert list(tmp_path.iterdir()) == []


def test_whatever_is_cut_off_or_changed_at_the_end_is_dropped(tmp_path):
    keep(tmp_path, {"a": "1", "b": "22", "c": "333"})
    path = tmp_path / JOURNAL
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        there = sum(len(b"".join(lines[: k + 2])) <= length for k in range(3))
        assert list(kept(tmp_path)) == list("abc"[:there]), length
    path.write_bytes(whole[:-6] + b"\0" * 6)  # as after a loss of power
    assert list(kept(tmp_path)) == ["a", "b"]
    keep(tmp_path, {"d": "4"})
    assert list(kept(tmp_path)) == ["a", "b", "d"]
    path.write_bytes(whole.replace(b"b 22", b"b 23"))
    assert list(kept(tmp_path)) == ["a"]


def test_another_study_or_gnomon_begins_anew_and_says_so(tmp_path, capsys, monkeypatch):
    keep(tmp_path, {"a": "1"})
    assert capsys.readouterr().out == ""
    assert kept(tmp_path, study="other") == {}
    assert "kept as runs.old1.journal, and the study begins anew" in capsys.readouterr().out
    for name, value in (("__version__", "9.9"), ("version", lambda library: f"9.9 of {library}")):
        keep(tmp_path, {"a": "1"})
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert kept(tmp_path) == {}
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"runs.old{number}.journal" for number in (1, 2, 3)]
    (tmp_path / "runs.old2.journal").rename(tmp_path / JOURNAL)  # it is as it was, and can be taken up again
    assert kept(tmp_path) == {"a": "1"}


@pytest.mark.parametrize("content", [b"mine\n", b"mine", b"\x80\x04\x95 pickle\n", b"12345678 gnomon mine\n"])
def test_a_file_that_is_not_gnomons_stays(tmp_path, content):
    (tmp_path / JOURNAL).write_bytes(content)
    with pytest.raises(OutputError, match="no journal of gnomon"):
        keep(tmp_path, {"a": "1"})
    assert (tmp_path / JOURNAL).read_bytes() == content


def test_two_studies_do_not_write_one_journal(tmp_path):
    pytest.importorskip("fcntl", reason="Windows has no such lock")
    with (
        study_journal(tmp_path, "test", print) as journal,
        pytest.raises(OutputError, match="another process"),
        study_journal(tmp_path, "test", print),
    ):
        pytest.fail("there are two")
    assert len(journal) == 0


def test_a_place_that_cannot_be_written_is_an_error_in_words(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"), study_journal(tmp_path / "none", "test", print):
        pytest.fail("there is no such folder")


def study(folder, done, jobs):
    """Carry out thirty runs with a journal, as a process that can be killed does."""
    tasks = [Task(seed=seed, done=str(done), wait_s=0.02) for seed in range(30)]
    with study_journal(Path(folder), "test", print) as journal:
        return carry_out(drawn, tasks, workers=Workers(jobs=jobs, journal=journal))


PROGRAM = """
import sys
sys.path[:0] = {paths!r}
from test_study_journal import study
if __name__ == "__main__":
    study({folder!r}, {done!r}, {jobs})
"""


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_study_does_nothing_again_that_it_kept(tmp_path, jobs):
    done, journal, program = tmp_path / "done", tmp_path / JOURNAL, tmp_path / "program.py"
    paths = [str(TESTS), str(Path(__file__).parent)]
    program.write_text(PROGRAM.format(paths=paths, folder=str(tmp_path), done=str(done), jobs=jobs))
    running = subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE)
    until = time.monotonic() + 300
    while time.monotonic() < until and (not journal.exists() or journal.read_bytes().count(b"\n") < 6):
        time.sleep(0.005)
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()  # until the last of its own processes has ended, which have its standard output too
    had = journal.read_bytes().count(b"\n") - 1
    begun = len(done.read_text().split())
    assert 5 <= had <= begun <= 30
    found = study(tmp_path, done, 1)
    assert [outcome.seed for outcome in found] == list(range(30))
    lines = done.read_text().split()
    assert len(lines) == begun + 30 - had
    assert set(lines) == {str(seed) for seed in range(30)}
