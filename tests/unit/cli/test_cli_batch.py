"""Many devices: which recordings they are, one after another, on after an interrupt, and the library that is filled."""

import contextlib
import io
import json
import shutil

import pytest

from gnomon.cli import main
from gnomon.cli.command import CertificateFacts
from gnomon.cli.commands.batch import device_facts, find_recordings, read_device_table, serial_and_date
from gnomon.errors import FormatError, RecordingError
from gnomon.fleet.library import Library

SHORT = ("--intervals", 12, "--t-init-s", 20, "--hold-s", 2, 2, "--rate-hz", 50)


def run(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """Two devices and a file that is none."""
    folder = tmp_path_factory.mktemp("line") / "monday"
    folder.mkdir()
    for seed, name in enumerate(("SN1_2026-03-30.csv", "SN2.csv")):
        run("simulate", "imu", "-o", folder / name, "--seed", seed, *SHORT)
    for truth in folder.glob("*.yaml"):
        truth.unlink()
    (folder / "SN3.csv").write_text("no numbers here\n")
    return folder


@pytest.mark.main
def test_a_broken_recording_does_not_stop_the_others_and_nothing_is_done_twice(line, tmp_path):
    table = tmp_path / "devices.csv"
    table.write_text("recording,station,operator,temperature_c\nSN2,B,Eve,23.5\n")
    library = tmp_path / "line.db"
    words = ("batch", line, "--kind", "imu", "--for", "phone", "-o", tmp_path / "out", "--library", library)
    words += ("--devices", table, "--json")
    code, out, _ = run(*words)
    found = json.loads(out)
    assert code == found["exit_code"] == 4
    assert found["counts"]["broken"] == 1
    assert [bool(one["problem"]) for one in found["devices"]] == [False, False, True]
    with Library(str(library)) as opened:
        entries = {entry.serial: entry for entry in opened.entries(details=True)}
    assert set(entries) == {"SN1", "SN2"}
    assert entries["SN1"].measured == "2026-03-30"
    assert (entries["SN2"].station, entries["SN2"].operator, entries["SN2"].temperature_c) == ("B", "Eve", 23.5)
    assert entries["SN2"].needs
    assert entries["SN1"].sigmas[0] < 3e-4 < 2e-3 < entries["SN1"].covariance[0, 0] ** 0.5  # gravity's part is shared
    assert entries["SN2"].inputs[0][0] == "SN2.csv"
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.yaml")}
    assert len(before) == 2
    again, out, err = run(*words)
    assert (again, json.loads(out)["devices"]) == (4, found["devices"])
    assert "3 of 3 were done before" in err
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.yaml")} == before
    shutil.rmtree(tmp_path / "out" / "SN2")
    _, _, err = run(*words)
    assert "2 of 3 were done before" in err
    assert set((tmp_path / "out").rglob("*.yaml")) == set(before)
    _looked_into(library, tmp_path)


def _looked_into(library, tmp_path):
    at = ("--library", library)
    assert run("library", "list", *at)[1].count("imu") == 2
    code, out, _ = run("library", "show", "SN2", "--json", *at)
    shown = json.loads(out)
    assert (code, shown["station"], len(shown["values"])) == (0, "B", len(shown["names"]))
    assert "SN1" not in run("library", "history", "SN2", *at)[1]
    code, out, _ = run("library", "export", tmp_path / "line.csv", *at)
    rows = (tmp_path / "line.csv").read_text().splitlines()
    assert (code, {row.split(",")[0] for row in rows}) == (0, {"serial", "SN1", "SN2"})
    code, out, _ = run("library", "import", tmp_path / "out", "--json", "--library", tmp_path / "second.db")
    assert (code, json.loads(out)["added"]) == (0, 2)
    assert run("library", "import", tmp_path / "out", *at)[1].startswith("0 calibrations added, 2 were there")
    code, out, _ = run("library", "report", tmp_path / "line.html", "--json", *at)
    assert (code, json.loads(out)["devices"], (tmp_path / "line.html").stat().st_size > 5000) == (0, 2, True)
    code, out, _ = run("library", "chart", "imu0.gyroscope.bias[1]", "--json", *at)
    assert (code, json.loads(out)["charts"][0]["devices"]) == (0, 2)
    assert run("library", "chart", "bias", *at)[0] == 2
    assert run("library", "show", "SN9", *at)[0] == 2
    assert run("library", "list", "SN9", *at)[0] == 2


def test_wrong_options_are_said_once_before_the_work(line, tmp_path):
    code, _, err = run("batch", line, "--kind", "imu", "-o", tmp_path / "out", "--options", "--no-such-option 3")
    assert code == 2
    assert "--no-such-option" in err
    assert not (tmp_path / "out").exists()


def test_recordings_are_files_and_folders_but_results_and_settings(tmp_path):
    for name in ("b.csv", "a.bag", "target.yaml", ".hidden", "devices.csv", "line.db"):
        (tmp_path / name).touch()
    (tmp_path / "rig").mkdir()
    (tmp_path / "a-imu").mkdir()
    (tmp_path / "a-imu" / "calibration.yaml").touch()
    found = find_recordings([tmp_path], tmp_path / "devices.csv")
    assert [path.name for path in found] == ["a.bag", "b.csv", "rig"]
    with pytest.raises(RecordingError, match="no such folder"):
        find_recordings([tmp_path / "none"], None)
    with pytest.raises(RecordingError, match="no recording"):
        find_recordings([tmp_path / "a-imu"], None)


def test_the_table_goes_before_device_yaml_and_that_before_the_name(tmp_path):
    rig = tmp_path / "A7_2026-03-31"
    rig.mkdir()
    assert device_facts(rig, {}) == CertificateFacts(serial="A7", date="2026-03-31")
    (rig / "device.yaml").write_text("serial: B8\nplace: bench 2\n")
    assert device_facts(rig, {}) == CertificateFacts(serial="B8", date="2026-03-31", place="bench 2")
    assert device_facts(rig, {rig.name: CertificateFacts(serial="C9")}).serial == "C9"
    assert serial_and_date("2026-13-31_A") == ("2026-13-31_A", None)
    table = tmp_path / "devices.csv"
    for text, why in (("recording,colour\nx,red\n", "colour"), ("recording,date\nx\n", "line 2"),
                      ("recording,date\nx,tomorrow\n", "tomorrow"), ("serial\nx\n", "recording")):  # fmt: skip
        table.write_text(text)
        with pytest.raises(FormatError, match=why):
            read_device_table(table)
