"""show, apply and convert of calibrations of any of the three triads, through the command line."""

import json

import numpy as np
import pytest
import yaml

import gnomon
from triad_subsets import SUBSETS, TRIADS, recorded, subset_calibration

COLUMNS = {"accelerometer": "ax ay az", "gyroscope": "gx gy gz", "magnetometer": "mx my mz"}


@pytest.fixture
def saved(tmp_path):
    """Return a function that writes a calibration and a recording of some triads."""

    def make(triads, **changes):
        changes = {"g_sensitivity": "accelerometer" in triads, **changes}
        gnomon.save(subset_calibration(triads, **changes), tmp_path / "c.yaml")
        samples = recorded(triads, count=60)
        rows = np.hstack([getattr(samples, name).values for name in triads]).astype(int)
        header = ",".join(["t [ms]", *" ".join(COLUMNS[name] for name in triads).split()])
        lines = [",".join(map(str, [10 * i, *row])) for i, row in enumerate(rows.tolist())]
        (tmp_path / "r.csv").write_text("\n".join([header, *lines]) + "\n")
        return tmp_path / "c.yaml", tmp_path / "r.csv"

    return make


@pytest.mark.parametrize("triads", SUBSETS)
def test_show(run, saved, triads):
    calibration, _ = saved(triads)
    for form in ("sensitivity", "tedaldi", "krebs", "angrisano", "kalibr"):
        code, out, err = run("show", calibration, "--form", form)
        assert (code, err) == (0, "")
        for name in TRIADS:
            assert (f"imu0 {name}, body frame" in out) == (name in triads)
    code, out, _ = run("show", calibration, "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document["imus"]["imu0"]) == list(triads)
    assert document == json.loads(json.dumps(yaml.safe_load(calibration.read_text())))


@pytest.mark.parametrize("triads", SUBSETS)
def test_apply(run, saved, tmp_path, triads):
    calibration, recording = saved(triads)
    code, out, err = run("apply", calibration, recording, "-o", tmp_path / "out.csv")
    assert code == 0, err
    assert "60 rows" in out
    done = gnomon.load(calibration).imus["imu0"].apply(recorded(triads, count=60))
    table = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)
    order = [name for name in ("gyroscope", "accelerometer", "magnetometer") if name in triads]
    assert np.array_equal(table[:, 1:], np.hstack([getattr(done, name).values for name in order]))


@pytest.mark.parametrize("triads", SUBSETS)
def test_convert_to_what_knows_all_triads(run, saved, tmp_path, triads):
    calibration, _ = saved(triads)
    for to in ("c-header", "csv"):
        code, out, err = run("convert", calibration, "--to", to, "-o", tmp_path / to)
        assert (code, err) == (0, ""), out
        assert "magnetometer of imu0" not in out
    code, out, _ = run("show", tmp_path / "csv" / "calibration.csv")
    assert code == 0
    assert all(f"imu0 {name}, body frame" in out for name in triads)


@pytest.mark.parametrize(
    ("triads", "to", "words"),
    [
        (
            ("magnetometer",),
            "kalibr",
            "kalibr needs accelerometer, and this calibration holds no accelerometer of imu0",
        ),
        (("gyroscope",), "openvins", "openvins needs accelerometer"),
        (("gyroscope",), "basalt", "basalt needs accelerometer"),
        (("accelerometer",), "imucal", "imucal needs accelerometer and gyroscope, and this calibration holds no gyro"),
        (("magnetometer",), "imu_tk", "imu_tk knows accelerometers and gyroscopes, and this calibration holds neither"),
    ],
)
def test_convert_to_what_needs_more_is_refused_in_a_sentence(run, saved, tmp_path, triads, to, words):
    calibration, _ = saved(triads)
    code, out, err = run("convert", calibration, "--to", to, "-o", tmp_path / "out")
    assert code == 2
    assert out == ""
    assert words in " ".join(err.split())
    assert "c-header or csv" in " ".join(err.split())
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_apply_says_which_force_is_missing(run, saved, tmp_path):
    calibration, recording = saved(("gyroscope",), g_sensitivity=True)
    code, _, err = run("apply", calibration, recording, "-o", tmp_path / "out.csv")
    assert code not in {0, 1}
    assert "this calibration holds no accelerometer" in " ".join(err.split())
    assert not (tmp_path / "out.csv").exists()
