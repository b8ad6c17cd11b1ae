"""The example of a calibration as a phase of an OpenHTF test."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import gnomon
from gnomon.simulate import Scenario, simulate
from gnomon.writers.recording_file import save_recording

EXAMPLE = Path(__file__).parents[2] / "examples" / "openhtf_calibration.py"


pytest.importorskip("openhtf", reason="needs openhtf, which is not tested on this Python")


@pytest.mark.parametrize(("few", "outcome"), [({"intervals": 20}, "PASS"), ({"intervals": 3}, "ERROR")])
def test_a_phase_calibrates_and_records_measurements(tmp_path, few, outcome):
    save_recording(simulate(Scenario(t_init_s=6.0, **few), 3)[0], tmp_path / "recording.npz")
    ran = subprocess.run(
        [sys.executable, EXAMPLE, "recording.npz", "SN7"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    (record,) = tmp_path.glob("SN7.*.json")
    told = json.loads(record.read_text())
    assert (told["dut_id"], told["outcome"], ran.returncode) == ("SN7", outcome, outcome != "PASS")
    phase = told["phases"][-1]
    assert list(phase["attachments"]) == ["SN7.yaml"] * (outcome == "PASS")
    if outcome == "PASS":
        imu = gnomon.load(tmp_path / "SN7.yaml").imus["imu0"]
        found = dict(phase["measurements"]["gyroscope_bias"]["measured_value"])
        assert list(found.values()) == imu.gyroscope.bias.tolist()
        assert phase["measurements"]["verdict"]["measured_value"] in ("pass", "warn")
