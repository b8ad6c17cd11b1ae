"""What is told of progress, and where: lines, a log, nothing."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import field_logs
from gnomon.cli import main
from gnomon.cli.command import SIMULATED
from gnomon.cli.results import finding_lines
from gnomon.cli.terminal import Terminal
from gnomon.errors import OutputError
from gnomon.findings import Finding
from gnomon.progress import Step, as_step


@pytest.fixture
def seconds(monkeypatch):
    """Let a second pass whenever it is asked for the time."""
    clock = itertools.count(10.0)
    monkeypatch.setattr("gnomon.cli.terminal.time.monotonic", lambda: next(clock))


def told(capsys):
    return capsys.readouterr().err.splitlines()


@pytest.mark.usefixtures("seconds")
def test_long_counts_are_told_now_and_then_with_the_time_left(capsys):
    terminal = Terminal()
    for done in range(100, 201):
        terminal.progress(Step("draw", done, 200))
    lines = told(capsys)
    assert lines[0] == "draw: 100 of 200"
    assert lines[-1] == "draw: 200 of 200"
    assert 5 < len(lines) < 60
    assert lines[5].endswith(" left")


def test_details_are_for_who_asks(capsys):
    for verbose in (False, True):
        terminal = Terminal(verbose=verbose)
        terminal.progress("estimating")
        terminal.progress(Step("iteration 1", detail=True))
    assert told(capsys) == ["estimating", "estimating", "iteration 1"]


@pytest.mark.usefixtures("seconds")
def test_a_detail_does_not_begin_a_stage_anew(capsys):
    terminal = Terminal()
    for done in range(0, 100, 10):
        terminal.progress(Step(f"iteration {done}", detail=True))
        terminal.progress(Step("estimating", done, 100))
    lines = told(capsys)
    assert lines[0] == "estimating: 0 %"
    assert lines[1].startswith("estimating: ")
    assert lines[1].endswith("s left")


def test_a_long_file_tells_how_far_it_is_read(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("gnomon.progress._LONG_BYTES", 1 << 20)
    table = tmp_path / "long.csv"
    with table.open("w") as file:
        file.write("t_ns,ax [m/s^2],ay [m/s^2],az [m/s^2]\n")
        file.writelines(f"{k * 10_000_000},0.0123456789,9.80665,0.0\n" for k in range(60_000))
    main(["check", str(table)])
    lines = [line for line in told(capsys) if line.startswith("reading long.csv: ")]
    assert len(lines) > 1
    assert lines[-1] == "reading long.csv: 100 %"


@pytest.fixture
def all_long(monkeypatch):
    """Let every file and every piece of work count as one that takes long."""
    monkeypatch.setattr("gnomon.progress._LONG_BYTES", 1 << 12)
    monkeypatch.setattr("gnomon.progress._SOON_S", -1.0)


def stages(monkeypatch, *words):
    """Run a command, and return its stages, each with what was done of how much."""
    found = {}
    monkeypatch.setattr(Terminal, "progress", lambda _, step: found.setdefault(as_step(step).stage, []).append(step))
    main([str(word) for word in words])
    return {name: [(step.done, step.of) for step in map(as_step, steps)] for name, steps in found.items()}


@pytest.mark.usefixtures("all_long")
def test_a_long_npz_and_its_check_tell_how_far_they_are(tmp_path, monkeypatch):
    values = np.random.default_rng(0).normal((0.0, 0.0, 9.8), 1e-3, (200_000, 3))
    rates = np.random.default_rng(1).normal(0.0, 1e-3, (200_000, 3))
    np.savez(tmp_path / "long.npz", t_s=np.arange(200_000) * 0.005, accelerometer=values, gyroscope=rates)
    seen = stages(monkeypatch, "check", tmp_path / "long.npz")
    shares = [done for done, of in seen["reading long.npz"] if of == 100]
    assert shares == sorted(shares)
    assert shares[-1] == 100
    assert len(set(shares)) > 5
    assert seen["checking the recording"] == [(k, 7) for k in range(7)]
    assert [of for _, of in seen["finding static intervals"]] == [5] * 5


@pytest.mark.usefixtures("all_long")
def test_logs_of_devices_tell_how_far_they_are_read(tmp_path, monkeypatch):
    samples = field_logs.samples()
    printed = tmp_path / "printed.txt"
    printed.write_text("".join(f"ax={x:.3f} ay={y:.3f} az={z:.3f}\n" for x, y, z in samples.force))
    log = field_logs.ulog(tmp_path / "log.ulg", samples)
    for words, stage in (
        ((printed, "--rate", "50"), "reading the lines of printed.txt"),
        ((log,), "reading log.ulg"),
    ):
        assert {of for _, of in stages(monkeypatch, "check", *words)[stage]} == {100}


def test_quiet_tells_errors_alone(capsys, tmp_path):
    assert main(["imu", str(tmp_path / "none.csv"), "-q"]) == 3
    (line,) = told(capsys)
    assert line.startswith("gnomon: ")


def test_a_log_keeps_everything_with_its_time(capsys, tmp_path):
    log = tmp_path / "gnomon.log"
    for _ in range(2):
        assert main(["imu", str(tmp_path / "none.csv"), "-q", "--log", str(log)]) == 3
    capsys.readouterr()
    head, *lines = log.read_text().splitlines()
    assert head == "# log of gnomon"
    assert len(lines) == 2
    assert all(line[4] == "-" and line[10] == "T" for line in lines)
    assert "there is no such file" in lines[1]


def test_a_log_never_takes_the_place_of_another_file(tmp_path):
    other = tmp_path / "recording.csv"
    other.write_text("t,ax\n")
    with pytest.raises(OutputError, match="not a log"):
        Terminal(log=other)
    assert other.read_text() == "t,ax\n"
    with pytest.raises(OutputError, match="cannot be written"):
        Terminal(log=tmp_path / "nowhere" / "gnomon.log")


def test_a_part_keeps_its_count():
    step = Step("reading", 3, 9).within("recording 1 of 2")
    assert (step.done, step.of, str(step)) == (3, 9, "recording 1 of 2: reading: 3 of 9")


def test_what_follows_from_a_finding_is_named_with_it() -> None:
    cause = Finding(severity="warning", code="cause", message="A cause.", consequence="So.", cure="Do.")
    effects = [replace(cause, code=code, severity="info", message="Told?", follows_from="cause") for code in "ab"]
    lines = list(finding_lines([cause, *effects]))
    assert [line.strip() for line in lines] == ["[! ] A cause. (cause)", "So.", "From it follow: a, b.", "-> Do."]
    assert list(finding_lines([cause, *effects], severity="warning")) == lines
    assert not list(finding_lines([cause, *effects], severity="info"))


@pytest.mark.parametrize("words", [["simulate", "--help"], ["simulate", "-h"], ["help", "simulate"]])
def test_the_help_of_simulate_lists_its_kinds(words, capsys):
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    kinds, examples = lines[: lines.index("examples:")], lines[lines.index("examples:") + 1 :]
    assert {line.split()[0] for line in kinds if line.startswith("  ")} == set(SIMULATED)
    assert [line for line in examples if line.startswith("  gnomon simulate ")]
