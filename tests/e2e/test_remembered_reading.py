"""A calibration remembers how its log was read, and `apply` reads others of that kind alike."""

import numpy as np
import pytest

import gnomon
from gnomon.cli import main

COLUMNS = "gx gy gz ax ay az"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log without header and time, its calibration, and what it holds."""
    place = tmp_path_factory.mktemp("log")
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=20, t_init_s=20.0), seed=3)
    samples = recording.imus["imu0"]
    rows = np.hstack([np.degrees(samples.gyroscope.values), samples.accelerometer.values / 9.80665])
    np.savetxt(place / "log.txt", rows, fmt="%.9g")
    stated = ["--columns", COLUMNS, "--rate", "100", "--units", "g deg/s"]
    assert main(["imu", str(place / "log.txt"), "-o", str(place / "out"), "--no-report", *stated]) == 0
    np.savetxt(
        place / "headed.csv",
        rows[:500, [3, 4, 5, 0, 1, 2]],
        delimiter=",",
        comments="",
        header="ax [g],ay [g],az [g],gx [deg/s],gy [deg/s],gz [deg/s]",
    )
    return place


def applied(folder, name, *options):
    output = folder / "applied.csv"
    code = main(["apply", str(folder / "out" / "calibration.yaml"), str(folder / name), "-o", str(output), *options])
    return code, np.genfromtxt(output, delimiter=",", names=True) if code == 0 else None


def test_apply_needs_no_options_again(folder, capsys):
    code, kept = applied(folder, "log.txt")
    assert code == 0
    assert "--columns gx gy gz ax ay az, --rate 100.0, --units g deg/s" in capsys.readouterr().err
    _, stated = applied(folder, "log.txt", "--columns", COLUMNS, "--rate", "100", "--units", "g deg/s")
    assert all(np.array_equal(kept[name], stated[name]) for name in stated.dtype.names)
    force = np.stack([kept[name] for name in kept.dtype.names if name.startswith("a") or "force" in name], axis=1)
    assert np.median(np.linalg.norm(force, axis=1)) == pytest.approx(9.80665, rel=1e-3)


def test_what_is_stated_counts(folder, capsys):
    code, faster = applied(folder, "log.txt", "--rate", "200")
    assert code == 0
    assert "rate_hz" not in capsys.readouterr().err
    assert np.diff(faster["t_ns"])[0] == 5_000_000


def test_a_header_tells_more_than_a_memory(folder, capsys):
    code, headed = applied(folder, "headed.csv", "--rate", "100")
    assert code == 0
    assert "read as the recording" not in capsys.readouterr().err
    assert len(headed) == 500


def test_the_file_says_how(folder):
    options = gnomon.load(folder / "out" / "calibration.yaml").provenance.options
    assert (options["columns"], options["rate_hz"], options["units"]) == (COLUMNS, "100.0", "g deg/s")
