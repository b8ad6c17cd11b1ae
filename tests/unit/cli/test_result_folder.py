"""The folder of a result is replaced as a whole, and nothing else in it is touched."""

from pathlib import Path

import pytest

from gnomon import OutputError
from gnomon.cli import main
from gnomon.cli.files import default_folder, result_folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_files_appear_together_and_replace_only_their_own(tmp_path):
    folder = tmp_path / "a" / "b"
    with result_folder(folder) as staging:
        (staging / "calibration.yaml").write_text("one")
        (staging / "report.html").write_text("one")
        assert not (folder / "calibration.yaml").exists()
    assert names(folder) == ["calibration.yaml", "report.html"]
    (folder / "notes.txt").write_text("mine")
    with result_folder(folder) as staging:
        (staging / "calibration.yaml").write_text("two")
    # the report of the first result would be a lie beside the second calibration
    assert names(folder) == ["calibration.yaml", "notes.txt"]
    assert (folder / "calibration.yaml").read_text() == "two"


def test_nothing_is_left_of_a_failure(tmp_path):
    def fail(folder):
        with result_folder(folder) as staging:
            (staging / "calibration.yaml").write_text("half")
            raise ValueError("no result")

    with pytest.raises(ValueError, match="no result"):
        fail(tmp_path / "new" / "folder")
    assert names(tmp_path) == []
    folder = tmp_path / "old"
    folder.mkdir()
    (folder / "calibration.yaml").write_text("good")
    with pytest.raises(ValueError, match="no result"):
        fail(folder)
    assert names(folder) == ["calibration.yaml"]
    assert (folder / "calibration.yaml").read_text() == "good"


def test_a_place_that_cannot_be_written_is_known_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="-o"), result_folder(tmp_path / "file" / "result"):
        pytest.fail("entered")
    with pytest.raises(OutputError, match=r"file: this is a file, .* need a folder"), result_folder(tmp_path / "file"):
        pytest.fail("entered")


def test_the_name_of_a_file_is_not_made_a_folder(tmp_path):
    with (
        pytest.raises(OutputError, match=r"name of a file. .* such as .*/result\."),
        result_folder(tmp_path / "result.txt"),
    ):
        pytest.fail("entered")
    assert names(tmp_path) == []
    (tmp_path / "odd.csv").mkdir()
    for name in ("odd.csv", "gnomon-1.2"):
        with result_folder(tmp_path / name) as staging:
            (staging / "calibration.yaml").write_text("one")
        assert names(tmp_path / name) == ["calibration.yaml"]


def test_a_recording_with_another_ending_is_refused_under_its_own_name(tmp_path, capsys):
    assert main(["simulate", "--intervals", "3", "-o", str(tmp_path / "rec")]) == 2
    assert capsys.readouterr().err.startswith(f"gnomon: {tmp_path / 'rec'}: a recording is written as .npz, .csv")
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("paths", "expected"),
    [
        (["a/flight.csv"], "a/flight-imu"),
        (["flight.csv.gz"], "flight-imu"),
        (["xsens_acc.mat.gz", "xsens_gyro.mat.gz"], "xsens-imu"),
        (["acc.csv", "gyro.csv"], "acc-imu"),
        (["noextension"], "noextension-imu"),
        ([".hidden"], ".hidden-imu"),
    ],
)
def test_default_folder_is_named_after_the_recording(paths, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert default_folder(tuple(map(Path, paths)), "imu") == tmp_path / expected


def test_default_folder_of_a_folder_keeps_its_whole_name(tmp_path, monkeypatch):
    (tmp_path / "run.2024").mkdir()
    monkeypatch.chdir(tmp_path / "run.2024")
    assert default_folder((Path(),), "imu") == tmp_path / "run.2024-imu"
    assert default_folder((tmp_path / "run.2024/",), "imu") == tmp_path / "run.2024-imu"
