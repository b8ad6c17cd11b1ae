"""A triad whose axes, range or unit changed half-way."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.checks.imu_checks import find_imu_rests
from gnomon.recording import Floats
from gnomon.results.result import interval_means


def changed_rates(seed: int, factor: float, share: float) -> gnomon.Recording:
    """Return a recording of 24 rests in which the gyroscope's readings are multiplied from a share of it on."""
    recording = gnomon.simulate(gnomon.Scenario(intervals=24, gyroscope_range=1e4), seed=seed)[0]
    imu = recording.imus["imu0"]
    t_s = imu.gyroscope.t_s
    later = t_s > t_s[0] + share * (t_s[-1] - t_s[0])
    rates = replace(imu.gyroscope, values=imu.gyroscope.values * np.where(later, factor, 1.0)[:, None])
    return replace(recording, imus={"imu0": replace(imu, gyroscope=rates)})


@pytest.mark.parametrize(("factor", "share"), [(0.5, 0.6), (2.0, 0.6), (2.0, 0.8), (57.29578, 0.6)])
def test_named_and_failed(factor: float, share: float) -> None:
    calibration = gnomon.calibrate_imu(changed_rates(12, factor, share)).calibration
    assert calibration.verdict == "fail"
    (found,) = (one for one in calibration.assessment.findings if one.code == "gyroscope-range-changed")
    assert calibration.assessment.findings[0] == found  # before what follows from it


@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_no_change_of_range(factor: float) -> None:
    findings = gnomon.calibrate_imu(changed_rates(13, factor, 0.6)).calibration.assessment.findings
    assert "gyroscope-range-changed" not in {one.code for one in findings}


@pytest.mark.parametrize("seed", [34067, 34074])
def test_a_dozen_rests_are_no_change_of_range(seed: int) -> None:
    short = gnomon.Scenario(
        g_sensitivity=3e-4, sensor_seed=seed, intervals=12, t_init_s=6.0, hold_s=(1.9, 2.1), motion_s=(0.8, 1.2)
    )
    assert gnomon.calibrate_imu(gnomon.simulate(short, seed + 5000)[0]).calibration.verdict != "fail"


@pytest.mark.parametrize(("seed", "factor"), [(99003, 2.0), (99012, 0.5), (99015, 2.0)])
def test_a_dozen_rests_tell_a_change_of_range(seed: int, factor: float) -> None:
    recording = gnomon.simulate(gnomon.Scenario(intervals=12, gyroscope_range=1e4), seed)[0]
    changed = _changed(recording, "gyroscope", factor * np.eye(3), 0.6)
    found = gnomon.calibrate_imu(changed).calibration.assessment.findings
    (told,) = (one for one in found if one.code == "gyroscope-range-changed")
    shown = float(told.message.split("show ")[1].split(" times")[0])
    assert shown == pytest.approx(factor, rel=0.15)


FLIPPED, REVERSED, EXCHANGED = np.diag([1.0, 1.0, -1.0]), -np.eye(3), np.eye(3)[[1, 0, 2]]


@pytest.mark.parametrize(
    ("triad", "axes"),
    [
        ("accelerometer", FLIPPED),
        ("accelerometer", REVERSED),
        ("accelerometer", EXCHANGED),
        ("gyroscope", FLIPPED),
        ("gyroscope", REVERSED),
        ("gyroscope", EXCHANGED),
    ],
)
def test_axes_that_change_are_no_step_of_a_bias(triad: str, axes: Floats) -> None:
    recording = gnomon.simulate(gnomon.Scenario(intervals=24), seed=12)[0]
    t_s = recording.imus["imu0"].accelerometer.t_s
    calibration = gnomon.calibrate_imu(_changed(recording, triad, axes, 0.6)).calibration
    found = calibration.assessment.findings
    assert (calibration.verdict, found[0].code) == ("fail", "axes-changed")
    assert "bias-step" not in {one.code for one in found}
    assert f"axes of the {triad} changed" in found[0].message
    first, last = (float(word) for word in found[0].message.split("between ")[1].split(" s ")[0].split(" and "))
    assert first - 8 < 0.6 * t_s[-1] < last + 8
    read = {
        f"{'xyz'[i]} reads what would have been {'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}"
        for i, row in enumerate(axes)
        if row[i] != 1
    }
    assert all(one in found[0].message for one in read)


def _changed(recording: gnomon.Recording, triad: str, axes: Floats, share: float) -> gnomon.Recording:
    """Return a recording in which axes (3, 3) are applied to a triad's readings from a share of it on."""
    imu = recording.imus["imu0"]
    samples = getattr(imu, triad)
    later = samples.t_s > share * samples.t_s[-1]
    values = np.where(later[:, None], samples.values @ axes.T, samples.values)
    return replace(recording, imus={"imu0": replace(imu, **{triad: replace(samples, values=values)})})


def rests_of(imu: gnomon.ImuSamples):
    """Return the static intervals, and the direction of gravity in each, (n, 3)."""
    detection = find_imu_rests(imu)
    assert detection is not None
    rests = detection.chosen.intervals
    up = interval_means(imu.accelerometer.values, rests)
    return rests, up / np.linalg.norm(up, axis=1, keepdims=True)


def test_a_gyroscope_that_hangs_while_the_sensor_is_turned_over_is_no_reversed_accelerometer() -> None:
    recording = gnomon.simulate(gnomon.Scenario(intervals=24), 44)[0]
    imu = recording.imus["imu0"]
    rests, up = rests_of(imu)
    over = int(np.argmin(np.sum(up[1:] * up[:-1], axis=1)))
    assert up[over] @ up[over + 1] < -0.99
    rates = imu.gyroscope.values.copy()
    rates[rests.stop[over] : rests.start[over + 1]] = rates[rests.stop[over]]
    hung = replace(recording, imus={"imu0": replace(imu, gyroscope=replace(imu.gyroscope, values=rates))})
    codes = {one.code for one in gnomon.calibrate_imu(hung).calibration.assessment.findings}
    assert "axes-changed" not in codes


@pytest.mark.parametrize("seed", [45, 56, 63, 68])
def test_recordings_joined_between_opposite_attitudes_are_no_reversed_accelerometer(seed: int) -> None:
    """The one rotation that nobody recorded is left out; its residual across the directions would be none."""
    recording = gnomon.simulate(gnomon.Scenario(intervals=30), seed)[0]
    imu = recording.imus["imu0"]
    rests, up = rests_of(imu)
    ends = np.triu(up @ up.T, 1)
    one, other = np.unravel_index(np.argmin(ends), ends.shape)
    assert ends[one, other] < -0.99
    first, second = (int(rests.start[k] + rests.stop[k]) // 2 for k in (one, other))
    order = np.concatenate([np.arange(first), np.arange(second, len(imu.accelerometer))])
    parts = {
        triad: replace(samples, t_ns=samples.t_ns[: len(order)], values=samples.values[order])
        for triad, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
    }
    calibration = gnomon.calibrate_imu(replace(recording, imus={"imu0": replace(imu, **parts)})).calibration
    assert calibration.verdict == "pass"
    assert "axes-changed" not in {one.code for one in calibration.assessment.findings}
