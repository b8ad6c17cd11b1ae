"""Accelerometer alone: whatever is wrong with the recording is said in words, and nothing is left half-written."""

import json

import numpy as np
import pytest

HEADER = "time [s],ax [m/s^2],ay,az"


def as_csv(table):
    return HEADER + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in table) + "\n"


def never_static(table):
    table[:, 1:] += 3 * np.sin(2 * np.pi * table[:, :1] * [1.1, 1.3, 1.7])
    return table


def always_static(table):
    table[:, 1:] = table[0, 1:] + np.random.default_rng(1).normal(scale=0.005, size=table[:, 1:].shape)
    return table


def backward(table):
    table[1000:, 0] -= 5.0
    return table


def one_axis_dead(table):
    table[:, 2] = 0.0
    return table


def in_another_unit(table):
    table[:, 1:] *= 3.0
    return table


def with_nan(table):
    table[500, 2] = np.nan
    return table


BAD = {
    "never static": never_static,
    "always static": always_static,
    "time going backwards": backward,
    "one axis dead": one_axis_dead,
    "three times gravity": in_another_unit,
    "nan": with_nan,
    "five attitudes": lambda table: table[table[:, 0] < 40.0],
    "one sample": lambda table: table[:1],
    "one second": lambda table: table[table[:, 0] < 1.0],
}


@pytest.mark.parametrize("what", BAD)
@pytest.mark.parametrize("preset", ["gnomon", "angrisano"])
def test_accelerometer_alone(what, preset, good_table, run, tmp_path, names):
    path = tmp_path / "recording.csv"
    path.write_text(as_csv(BAD[what](good_table[:, :4].copy())))
    code, out, err = run("imu", path, "--preset", preset, "--json", "--no-report", "-o", tmp_path / "result")
    assert code in {3, 4}, (code, err)
    assert "Traceback" not in err
    assert "bug" not in err
    if code == 4:
        assert json.loads(out)["verdict"] == "fail"
        return
    message = json.loads(out)["error"]["message"]
    assert len(message) > 30
    assert names(tmp_path) == ["recording.csv"]


def test_the_good_one_succeeds(good_table, run, tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text(as_csv(good_table[:, :4]))
    code, out, err = run("imu", path, "--gravity", 9.80665, "--json", "--no-report", "-o", tmp_path / "result")
    assert code == 0, err
    assert json.loads(out)["verdict"] == "pass"


@pytest.mark.parametrize("preset", ["tedaldi2014", "imu_tk"])
def test_presets_that_need_rotations_say_so(preset, good_table, run, tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text(as_csv(good_table[:, :4]))
    code, _, err = run("imu", path, "--preset", preset, "-o", tmp_path / "result")
    assert code == 2
    assert "rotations" in err


def test_an_empty_file_among_the_poses_is_named(good_table, run, tmp_path, names):
    for k in range(4):
        (tmp_path / f"{k}.csv").write_text(as_csv(good_table[:300, :4]))
    (tmp_path / "4.csv").write_text("")
    before = names(tmp_path)
    code, _, err = run("imu", tmp_path, "-o", tmp_path / "result")
    assert code == 3
    assert "4.csv" in err
    assert names(tmp_path) == before


def test_an_npz_file_among_the_poses_is_named(run, tmp_path, names):
    text = as_csv(np.column_stack([np.arange(50) / 50, np.full((50, 3), 5.6)]))
    for name in ("a.csv", "c.csv"):
        (tmp_path / name).write_text(text)
    np.savez(tmp_path / "b.npz", x=np.zeros(3))
    code, _, err = run("imu", *(tmp_path / name for name in ("a.csv", "b.npz", "c.csv")), "-o", tmp_path / "out")
    assert code == 3
    assert "b.npz: files of one pose each are read as tables of text" in err
    assert "out" not in names(tmp_path)
