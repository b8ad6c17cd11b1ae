"""The catalogue of faults, each named; and recordings with nothing wrong with them, left alone.

`pytest tests/e2e/test_faults.py -m slow -s` calibrates all of them, with three seeds, and prints a table.
"""

import os

import pytest

from gnomon.study.runs import Workers
from support.diagnosis import (
    diagnosed,
    doctors_findings,
    healthy,
    names_cause,
    study_faults,
    study_healthy,
    table,
)
from support.fault_recordings import faulty_recording, sound_recording
from support.faults import fault_named, faults
from support.healthy import healthy_imu, healthy_rig

IMU = [fault.name for fault in faults() if fault.kind == "imu"]
RIG = [fault.name for fault in faults() if fault.kind == "camera-imu"]

NOTICED = (
    "rig-gyroscope-flipped",
    "rig-accelerometer-swapped",
    "images-mirrored",
    "accelerometer-late",
    "rig-gyroscope-clips",
    "clock-jumps",
    "clocks-offset",
    "frames-late",
    "frames-stale",
    "board-moved",
    "tag-spacing-wrong",
    "distortion-missing",
    "rolling-shutter-unstated",
    "vibration",
    "moved-too-slowly",
    "never-turned",
)
"""Faults of a rig that the doctor names within a second or two, before anything is estimated."""


def loud(findings):
    return [finding for finding in findings if finding.severity in {"warning", "problem"}]


def test_the_catalogue_is_complete_and_distinct():
    names = [fault.name for fault in faults()]
    assert len(set(names)) == len(names) >= 30
    assert len(IMU) >= 12
    assert len(RIG) >= 18
    for fault in faults():
        assert fault.title
        assert fault.symptom.endswith(".")
        assert fault.codes


@pytest.mark.parametrize("name", IMU)
def test_faults_of_an_imu_are_named_first(name):
    found = diagnosed((name, 1))
    assert found.named, table([found])
    assert found.first, table([found])


@pytest.mark.parametrize("name", NOTICED)
def test_faults_of_a_rig_are_noticed_before_anything_is_estimated(name):
    fault = fault_named(name)
    findings = doctors_findings(faulty_recording(fault, 1))
    assert names_cause(fault, findings), [str(finding) for finding in findings]


@pytest.mark.long
@pytest.mark.parametrize("name", ["board-smaller", "noise-understated"])
def test_faults_of_a_rig_are_named_by_its_calibration(name):
    found = diagnosed((name, 1))
    assert found.named, table([found])
    assert found.first, table([found])


@pytest.mark.first(4)
@pytest.mark.parametrize("seed", range(6))
def test_a_healthy_recording_of_an_imu_passes(seed):
    found = healthy(("imu", seed))
    assert found.verdict == "pass", [str(finding) for finding in found.loud]


@pytest.mark.first(2)
@pytest.mark.parametrize("seed", range(4))
def test_the_doctor_leaves_a_healthy_rig_alone(seed):
    assert not loud(doctors_findings(sound_recording(healthy_rig(seed), seed)))


@pytest.mark.parametrize("seed", [0, 5005, 5006])
def test_a_healthy_recording_of_a_rig_passes(seed):
    """Gravity that is stated 0.15 % off, and few samples of a shaken rig, are neither an exposure nor a filter."""
    found = healthy(("camera-imu", seed))
    assert found.verdict == "pass", [str(finding) for finding in found.loud]
    assert not {"exposure-found", "triad-filtered"} & {finding.code for finding in found.findings}


def test_healthy_recordings_are_varied():
    rigs = [healthy_rig(seed) for seed in range(50)]
    assert len({rig.motion for rig in rigs}) == 5
    assert {rig.target_type for rig in rigs} == {"aprilgrid", "checkerboard"}
    assert {rig.distortion for rig in rigs} == {"radtan", "equidistant"}
    assert {rig.cameras for rig in rigs} == {1, 2}
    assert len({healthy_imu(seed).units for seed in range(50)}) == 4


@pytest.mark.slow
def test_the_whole_catalogue():
    found = study_faults([*IMU, *RIG], [1, 2, 3], workers=Workers(jobs=os.cpu_count() or 1), progress=print)
    print(table(found))
    for seed in (1, 2, 3):
        own = [one for one in found if one.seed == seed]
        named = sum(one.named for one in own)
        print(f"seed {seed}: {named} of {len(own)} named, {sum(one.first for one in own)} first")
        assert named >= 0.9 * len(own)
        assert all(one.named for one in own if fault_named(one.fault).kind == "imu")


@pytest.mark.slow
def test_a_hundred_healthy_recordings():
    found = study_healthy(["imu", "camera-imu"], range(50), workers=Workers(jobs=os.cpu_count() or 1), progress=print)
    warned = [one for one in found if one.verdict == "warn"]
    for one in found:
        if one.verdict != "pass":
            print(one.fault, one.seed, one.verdict, one.error, *(f"\n    {finding}" for finding in one.loud))
    assert not [one for one in found if one.verdict == "fail"]
    assert len(warned) <= 5
