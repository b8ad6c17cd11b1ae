"""`gnomon magnetometer`, `gnomon simulate-magnetometer` and `gnomon check` on recordings of a magnetometer."""

import json

import numpy as np
import pytest

from gnomon.formats.own.calibration_file import load
from gnomon.simulate import FieldScenario, simulate_magnetometer


@pytest.fixture(scope="module")
def simulated(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("magnetometer")
    code, _, err = run("simulate", "magnetometer", "-o", folder / "rec.npz", "--seed", 3, "--rests", 8)
    assert code == 0, err
    return folder


@pytest.mark.main
def test_simulate_calibrate_and_compare(run, simulated, tmp_path) -> None:
    code, out, err = run("magnetometer", simulated / "rec.npz", "-o", tmp_path / "out", "--field", 48)
    assert code == 0, err
    for words in ("hard iron", "soft iron", "dip of the field", "mrad", "accel-x"):
        assert words in out
    found, truth = load(tmp_path / "out/calibration.yaml"), load(simulated / "truth.yaml")
    assert (tmp_path / "out/report.html").exists()
    assert (tmp_path / "out/diagnostics.npz").exists()
    for name in ("imu0.magnetometer.sensitivity", "imu0.magnetometer.bias"):
        assert np.all(np.abs(found.parameter(name) - truth.parameter(name)) < 4.5 * found.sigma(name))
    assert found.provenance.method == "magnetometer"


def test_one_document_for_programs(run, simulated, tmp_path) -> None:
    code, out, _ = run("magnetometer", simulated / "rec.npz", "-o", tmp_path / "out", "--no-report", "--json")
    document = json.loads(out)
    assert code == document["exit_code"] == 0
    assert document["verdict"] in {"pass", "warn"}
    assert document["calibration"]["assessment"]["model"] == "full"


def test_the_same_recording_gives_the_same_bytes(run, simulated, tmp_path) -> None:
    for name in ("a", "b"):
        run("magnetometer", simulated / "rec.npz", "-o", tmp_path / name, "--no-report")
    assert (tmp_path / "a/calibration.yaml").read_bytes() == (tmp_path / "b/calibration.yaml").read_bytes()


def test_check_says_what_is_there(run, simulated, tmp_path) -> None:
    code, out, _ = run("check", simulated / "rec.npz")
    assert "imu0 magnetometer" in out
    alone, _ = simulate_magnetometer(FieldScenario(accelerometer=False), 1)
    samples = alone.imus["imu0"].magnetometer
    rows = "\n".join(f"{t},{x:.6f},{y:.6f},{z:.6f}" for t, (x, y, z) in zip(samples.t_ns, samples.values, strict=True))
    (tmp_path / "mag.csv").write_text(f"t_ns,mx,my,mz\n{rows}\n")
    code, out, err = run("check", tmp_path / "mag.csv")
    assert code == 0, err
    assert "4500 samples" in out
    code, _, err = run("imu", tmp_path / "mag.csv", "-o", tmp_path / "imu")
    assert code == 3
    assert not (tmp_path / "imu").exists()
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--motion", "still"), 3, "one orientation"),
        (("--motion", "one-axis"), 3, "one axis only"),
        (("--duration-s", "1"), 3, "too short"),
    ],
)
def test_bad_recordings_are_refused_in_words(run, tmp_path, arguments, code, words) -> None:
    run("simulate", "magnetometer", "-o", tmp_path / "in/rec.npz", *arguments)
    found, _, err = run("magnetometer", tmp_path / "in/rec.npz", "-o", tmp_path / "out")
    assert found == code
    assert words in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"\x00\x01\x02" * 100, ""),
        (b"t,ax,ay,az\n" + b"".join(b"%d,0.1,0.2,9.8\n" % i for i in range(200)), "no magnetometer"),
        (b"t,mx,my,mz\n" + b"".join(b"%d,0.1,nan,9.8\n" % i for i in range(200)), "finite number"),
        (b"t_s,mx,my,mz\n" + b"".join(b"%d,1,2,3\n" % i for i in range(200)), "1.0, 2.0, 3.0"),
        (b"t,mx,my,mz\n0,1,2,3\n1,2,3,4\n", "too short"),
    ],
)
def test_bad_files_are_refused_in_words(run, tmp_path, content, words) -> None:
    (tmp_path / "mag.csv").write_bytes(content)
    code, _, err = run("magnetometer", tmp_path / "mag.csv", "-o", tmp_path / "out", "--rate", 50)
    assert code == 3
    assert words in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_bad_options_are_refused_in_words(run, simulated, tmp_path) -> None:
    for arguments, words, expected in (
        (("--field", "48000"), "nowhere on Earth", 2),
        (("--prior", "nothing.yaml"), "there is no such file", 3),
        (("--fix", "imu0.magnetometer.nothing"), "no such parameter", 2),
    ):
        code, _, err = run("magnetometer", simulated / "rec.npz", "-o", tmp_path / "out", *arguments)
        assert code == expected
        assert words in err
        assert not (tmp_path / "out").exists()
