"""Power cycles, warm-ups, joined files and tremors in a multi-position recording: calibrated, or named."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import gnomon

SPEC = importlib.util.spec_from_file_location("bias_changes", Path(__file__).parents[2] / "benchmarks/bias_changes.py")
study = sys.modules["bias_changes"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(study)


def test_a_power_cycle_costs_no_rest_and_no_sigma():
    """The reproducer: a step of [.02, -.02, .01] rad/s in the middle of simulation 9021."""
    recording, truth = gnomon.simulate(gnomon.Scenario(), 9021)
    imu = recording.imus["imu0"]
    values = imu.gyroscope.values.copy()
    values[len(values) // 2 :] += [0.02, -0.02, 0.01]
    cut = replace(recording, imus={"imu0": replace(imu, gyroscope=replace(imu.gyroscope, values=values))})
    result = gnomon.calibrate_imu(cut)
    found = result.calibration.assessment
    assert (found.intervals_used, found.intervals_found) == (40, 40)
    bias = result.calibration.parameter("imu0.gyroscope.bias")
    error = bias - truth.parameter("imu0.gyroscope.bias") - [0.02, -0.02, 0.01]
    assert (abs(error) < 4 * result.calibration.sigma("imu0.gyroscope.bias")).all()
    [step] = [f for f in found.findings if f.code == "bias-step"]
    [segments] = result.diagnostics.bias_segments
    assert segments.triad == "gyroscope"
    assert segments.published == 1
    assert abs(segments.bias[1] - segments.bias[0] - [0.02, -0.02, 0.01]).max() < 1e-3
    assert step.severity == "info"
    assert not any(f.code == "rotations-left-out" for f in found.findings)  # the one across the step, of which it tells
    rests = [f.message for f in gnomon.check(cut) if f.code == "attitudes"]
    assert "40 rests" in rests[0]  # as many as the calibration counts


@pytest.mark.parametrize("seed", range(12, 18))
def test_faulty_recordings_do_not_pass_falsely(seed):
    case = study.make_case(study.KINDS[seed % len(study.KINDS)], seed)
    outcome, detail = study.judge(case)
    assert outcome in ("right", "warned"), f"{case.what}: {detail}"


@pytest.mark.parametrize(("seed", "where"), [(6, "last"), (10, "first")])
def test_few_rests_of_another_sensor_do_not_pass(seed, where):
    """Four or five of forty: too few to tell the other sensor's scales by."""
    first, _ = gnomon.simulate(gnomon.Scenario(intervals=study.INTERVALS), 40_000 + seed)
    other, _ = gnomon.simulate(gnomon.Scenario(intervals=study.INTERVALS), 80_000 + seed)
    a, b = first.imus["imu0"], other.imus["imu0"]
    imu = study.with_another(a, b, 0.91) if where == "last" else study.with_another(b, a, 0.26)
    result = gnomon.calibrate_imu(replace(first, imus={"imu0": imu}))
    [finding] = [f for f in result.calibration.assessment.findings if f.code == "sensor-changed"]
    assert finding.severity in ("warning", "problem")
    assert result.calibration.assessment.verdict != "pass"


@pytest.mark.slow
def test_number_a():
    """A tenth of the study of docs/validation.md: 60 faulty recordings, of which one may be wrong, and 40 healthy."""
    outcomes = [study.judge(study.make_case(study.KINDS[k % 6], 30_000 + k))[0] for k in range(60)]
    assert "rests lost" not in outcomes
    assert outcomes.count("right") >= 40
    assert outcomes.count("wrong") <= 1
    healthy = [study.judge(study.make_case("healthy", 30_000 + k))[0] for k in range(40)]
    assert healthy.count("right") >= 39
