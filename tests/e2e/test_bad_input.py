"""Whatever a person gives to gnomon, it answers in words and leaves nothing half-written."""

import gzip
import json

import numpy as np
import pytest

RESULT = ["calibration.yaml", "diagnostics.npz"]


def as_csv(table):
    rows = "\n".join(",".join(f"{x:.9g}" for x in row) for row in table)
    return f"time [s],ax [m/s^2],ay,az,gx [rad/s],gy,gz\n{rows}\n"


def changed(change):
    return lambda table: as_csv(change(table.copy())).encode()


def with_value(value):
    def change(table):
        table[1000, 2] = value
        return table

    return changed(change)


def cut_gzip(table):
    whole = gzip.compress(as_csv(table).encode())
    return whole[: len(whole) // 2]


def word_in_a_number(table):
    lines = as_csv(table).splitlines()
    lines[500] = lines[500].replace(",", ",oops", 1)
    return "\n".join(lines).encode()


def missing_columns(table):
    return b"time,ax,ay\n" + "\n".join(",".join(f"{x:.9g}" for x in row[:3]) for row in table).encode()


def backward(table):
    table[1000:, 0] -= 5.0
    return table


def constant(table):
    table[:, 1:] = table[0, 1:]
    return table


def never_static(table):
    t = table[:, :1]
    table[:, 1:4] += 3 * np.sin(2 * np.pi * t * [1.1, 1.3, 1.7])
    table[:, 4:] += np.sin(2 * np.pi * t * [1.1, 1.3, 1.7])
    return table


def always_static(table):
    still = np.random.default_rng(1).normal(scale=0.005, size=table[:, 1:].shape)
    table[:, 1:] = table[0, 1:] + still
    return table


def few_attitudes(table):
    return table[table[:, 0] < 40.0]  # the first rest and four attitudes more


def silent_gyroscope(table):
    table[:, 4:] = 0.0
    return table


BAD = {
    "empty file": (lambda _: b"", {3}),
    "one row": (lambda _: b"0.0,0.1,0.2,9.8,0.0,0.0,0.0\n", {3}),
    "header only": (lambda _: b"time,ax,ay,az,gx,gy,gz\n", {3}),
    "word in a number column": (word_in_a_number, {3}),
    "nan": (with_value(np.nan), {3}),
    "inf": (with_value(np.inf), {3}),
    "columns missing": (missing_columns, {3}),
    "time going backwards": (changed(backward), {3}),
    "constant signal": (changed(constant), {3}),
    "never static": (changed(never_static), {3}),
    "always static": (changed(always_static), {3}),
    "fewer than nine attitudes": (changed(few_attitudes), {3}),
    "gyroscope silent": (changed(silent_gyroscope), {3, 4}),
    "truncated gzip": (cut_gzip, {3}),
    "binary file": (lambda _: np.random.default_rng(0).bytes(5000), {3}),
}
"""What is wrong -> the bytes of such a file, and the exit codes of `gnomon imu` that answer it."""


@pytest.fixture(params=[*BAD, "folder without recordings", "no such file"])
def bad(request, tmp_path, good_table):
    """A path with something wrong with it, alone in a folder, and the exit codes that answer it."""
    path = tmp_path / "recording.csv"
    if request.param in BAD:
        content, codes = BAD[request.param]
        path.write_bytes(content(good_table))
        return path, codes
    if request.param == "folder without recordings":
        path.mkdir()
        (path / "readme.txt").write_text("nothing here")
    return path, {3}


@pytest.fixture
def assert_clear(names):
    """Return a function that judges how `gnomon imu --json --no-report` ended."""

    def judge(code, out, err, folder, codes):
        assert code in codes, (code, err)
        assert "Traceback" not in err
        assert "bug" not in err
        if code == 4:  # finished: everything is there, and it says so
            assert json.loads(out)["verdict"] == "fail"
            assert names(folder) == RESULT
            return
        message = json.loads(out)["error"]["message"]
        assert message in err
        assert len(message) > 30
        assert not folder.exists()

    return judge


def test_bad_input_is_named_and_leaves_nothing(bad, run, names, assert_clear):
    path, codes = bad
    before = names(path.parent)
    code, out, err = run("imu", path, "--json", "--no-report", "-o", path.parent / "result")
    assert_clear(code, out, err, path.parent / "result", codes)
    if code == 3:
        assert names(path.parent) == before


def test_check_of_bad_input_ends_in_words(bad, run):
    path, _ = bad
    code, out, err = run("check", path, "--json")
    assert code in {3, 4}, err
    assert "Traceback" not in err
    assert "bug" not in err
    document = json.loads(out)
    if code == 4:
        assert any(finding["severity"] == "problem" for finding in document["findings"])
    else:
        assert document["error"]["message"]


@pytest.mark.parametrize("units", ["g deg/s", "mg rad/s"])
def test_wrong_units_are_noticed(recording, units, run, assert_clear):
    folder = recording.parent / "result"
    code, out, err = run("imu", recording, "--units", units, "--json", "--no-report", "-o", folder)
    assert_clear(code, out, err, folder, {3, 4})


def test_an_output_that_cannot_be_written_is_said_before_the_work(recording, run, names):
    (recording.parent / "file").write_text("")
    code, out, err = run("imu", recording, "-o", recording.parent / "file" / "result", "--json")
    assert code == 3
    assert json.loads(out)["error"]["kind"] == "OutputError"
    assert "-o" in err
    assert names(recording.parent) == ["file", "recording.csv"]


@pytest.mark.parametrize("text", ["", "a: [1, 2", "schema: gnomon/9\n", "just words", "\x00\x01"])
@pytest.mark.parametrize("command", ["show", "apply", "convert"])
def test_a_damaged_calibration_is_named(recording, text, command, run, names):
    path = recording.parent / "calibration.yaml"
    path.write_text(text)
    more = {
        "show": [],
        "apply": [recording, "-o", recording.parent / "out.csv"],
        "convert": ["--to", "csv", "-o", recording.parent / "out"],
    }
    before = names(recording.parent)
    code, _, err = run(command, path, *more[command])
    assert code == 3
    assert "calibration.yaml" in err
    assert "Traceback" not in err
    assert "bug" not in err
    assert names(recording.parent) == before
