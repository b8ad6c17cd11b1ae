"""One jump of the clock, by a second to fifty years: memory follows the samples, not the span of their timestamps.

And what else is odd in a recording ends without a warning of NumPy's and without 'a bug'.
"""

import sys
import warnings

import numpy as np
import pytest

import gnomon
from gnomon.recording import close_gaps
from gnomon.simulate import FieldScenario
from gnomon.writers.recording_file import save_recording

JUMPS_S = (1, 3600, 86_400, 30 * 86_400, 365 * 86_400, 50 * 365 * 86_400)
FLOOR_BYTES, PER_BYTE = 128 << 20, 60
"""What a command may take, with the libraries that it loads: as docs/validation.md states it."""


@pytest.fixture(scope="module")
def recordings(run, tmp_path_factory):
    """A recording with rests, one of a magnetometer and one on a turntable, whose clock jumps by nothing."""
    folder = tmp_path_factory.mktemp("jumps")
    scenario = gnomon.Scenario(intervals=14, t_init_s=20.0, hold_s=(3.0, 3.5), rate_hz=50.0)
    save_recording(gnomon.simulate(scenario, seed=1)[0], folder / "imu.npz")
    save_recording(gnomon.simulate_magnetometer(FieldScenario(duration_s=60.0), seed=1)[0], folder / "field.npz")
    assert run("simulate", "turntable", "--rpm", 16, "--steady-s", 5, "-o", folder / "turns")[0] == 0
    (folder / "turns" / "recording.npz").rename(folder / "turns.npz")
    return folder


def with_jump(path, to, jump_s):
    """Let the clock jump after six tenths of the samples."""
    with np.load(path) as file:
        arrays = dict(file)
    for name in (name for name in arrays if name.endswith("_ns")):
        arrays[name][int(0.6 * len(arrays[name])) :] += jump_s * 1_000_000_000
    np.savez(to, **arrays)
    return to


@pytest.mark.parametrize(
    "words",
    [
        ("check", "imu"),
        ("imu", "imu", "-o", "out", "--no-report"),
        ("noise", "imu", "-o", "out", "--no-report"),
        ("apply", "imu", "-o", "out.csv"),
        ("magnetometer", "field", "-o", "out", "--no-report"),
        ("turntable", "turns", "--rate", "16rpm", "-o", "out", "--no-report"),
        ("verify", "imu", "-o", "out"),
    ],
    ids=lambda words: words[0],
)
def test_memory_follows_the_samples(words, run, recordings, tmp_path):
    name, kind, *rest = words
    rest = [tmp_path / word if word.startswith("out") else word for word in rest]
    if name in {"apply", "verify"}:
        truth = gnomon.simulate(gnomon.Scenario(intervals=14, rate_hz=50.0), seed=1)[1]
        gnomon.save(truth, tmp_path / "cal.yaml")
    resource = pytest.importorskip("resource")
    for jump_s in JUMPS_S if name in {"check", "noise", "apply"} else JUMPS_S[3:6:2]:  # the others take a second each
        path = with_jump(recordings / f"{kind}.npz", tmp_path / "jump.npz", jump_s)
        command = (name, *([tmp_path / "cal.yaml"] if name in {"apply", "verify"} else []), path, *rest)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        code, _, err = run(*command)
        most = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * (1 if sys.platform == "darwin" else 1024)
        assert code in {0, 3, 4}, err
        assert "memory" not in err
        assert most < FLOOR_BYTES + PER_BYTE * path.stat().st_size, (jump_s, most)


def test_closed_gaps_keep_order_and_what_lies_between():
    first, second = np.array([0, 10, 10**15, 10**15 + 10]), np.array([5, 10**15 + 5])
    closed = close_gaps([first, second], 100)
    assert closed[0].tolist() == [0, 10, 110, 120]
    assert closed[1].tolist() == [5, 115]
    assert np.array_equal(close_gaps([first[:2]], 100)[0], first[:2])


@pytest.mark.parametrize("rate", [0.0, -1.0, 1e-300, 1e300, np.nan, np.inf])
def test_a_rate_of_no_sensor_in_a_file_is_one_line(rate, run, recordings, tmp_path):
    with np.load(recordings / "imu.npz") as file:
        arrays = {name: file[name] for name in file if name != "t_ns"}
    np.savez(tmp_path / "r.npz", rate_hz=rate, **arrays)
    for words in (("check",), ("noise", "-o", tmp_path / "o")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            code, _, err = run(words[0], tmp_path / "r.npz", *words[1:])
        assert code == 3
        assert "bug" not in err


@pytest.mark.parametrize("scale", [1e-200, 1e40, 1e90, 0.0])
def test_absurd_sizes_warn_nobody(scale, run, recordings, tmp_path):
    with np.load(recordings / "imu.npz") as file:
        arrays = dict(file)
    for name in ("accelerometer", "gyroscope"):
        arrays[name] = arrays[name] * scale
    np.savez(tmp_path / "r.npz", **arrays)
    for words in (("check",), ("noise", "-o", tmp_path / "o", "--no-report")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            code, _, err = run(words[0], tmp_path / "r.npz", *words[1:])
        assert code in {0, 3, 4}
        assert "bug" not in err
