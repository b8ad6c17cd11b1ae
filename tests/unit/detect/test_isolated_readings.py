"""Single readings that neither neighbour supports."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.detect.samples.faults import held_samples, isolated_readings, without_readings
from gnomon.recording import Floats


def moving(seed: int) -> Floats:
    """Return twenty seconds of rest, of a motion, and of rest with 100 Hz, (6000, 3) [rad/s]."""
    t_s = np.arange(6000) / 100
    inside = (t_s > 20) & (t_s < 40)
    waves = np.sin(2 * np.pi * np.array([0.4, 0.7, 1.1]) * t_s[:, None])
    envelope = np.where(inside, np.sin(np.pi * (t_s - 20) / 20), 0.0) ** 2
    return 3.0 * envelope[:, None] * waves + 2e-3 * np.random.default_rng(seed).normal(size=(6000, 3))


@pytest.mark.parametrize("seed", range(4))
def test_spikes_at_rest_and_in_motion_are_found_and_nothing_else(seed: int) -> None:
    values, rng = moving(seed), np.random.default_rng([seed, 1])
    at = np.sort(rng.choice(np.arange(0, 6000, 12), 20, replace=False))
    spoilt = values.copy()
    spoilt[at, rng.integers(0, 3, 20)] += rng.choice([-1, 1], 20) * rng.uniform(1.5, 30, 20)
    np.testing.assert_array_equal(isolated_readings(spoilt), at)
    assert not len(isolated_readings(values))


@pytest.mark.parametrize(("step", "least"), [(0.0, 1.0), (1e-4, 0.95), (2e-2, 0.6)])
def test_samples_that_stand_in_for_lost_ones_are_told_from_coarse_steps(step: float, least: float) -> None:
    """Coarse steps repeat by chance, at rest all the time: there nothing is told, and nothing is lost."""
    values, rng = moving(7)[1000:5000], np.random.default_rng(8)
    values = np.rint(values / step) * step if step else values
    assert not held_samples(values).any()
    spoilt, lost = values.copy(), np.zeros(len(values), dtype=bool)
    for first in 100 + np.flatnonzero(rng.random(3890) < 0.02):
        spoilt[first : first + 4], lost[first : first + 4] = spoilt[first - 1], True
    held = held_samples(spoilt)
    assert held[1500:2500][lost[1500:2500]].mean() >= least
    assert held[~lost].mean() < 2e-3


def test_a_sensor_that_is_slower_than_its_recording_holds_none() -> None:
    assert not held_samples(np.repeat(moving(7)[::2], 2, axis=0)).any()


@pytest.mark.parametrize(("step", "least"), [(0.0, 0.95), (1e-5, 0.8)])
def test_samples_on_straight_lines_between_others_stand_in_for_lost_ones(step: float, least: float) -> None:
    values, lost = moving(9), np.arange(6000) % 250 >= 230
    every = np.arange(6000)
    filled = np.column_stack([np.interp(every, every[~lost], column[~lost]) for column in values.T])
    filled = np.rint(filled / step) * step if step else filled
    held = held_samples(filled)
    assert held[lost].mean() > least
    assert not held[~lost].any()


def test_where_there_are_some_two_may_be_neighbours() -> None:
    values = moving(5)
    values[[500, 1000, 1001, 2500, 2502], [0, 1, 0, 2, 2]] = [20.0, -20.0, 15.0, 12.0, -9.0]
    np.testing.assert_array_equal(isolated_readings(values), [500, 1000, 1001, 2500, 2502])


@pytest.mark.parametrize("samples", [2, 3, 5, 12])
def test_a_knock_is_none(samples: int) -> None:
    values = moving(6)
    ringing = 20 * np.exp(-np.arange(3 * samples) / samples) * np.cos(1.9 * np.arange(3 * samples))
    values[700 : 700 + 3 * samples] += ringing[:, None] * [1.0, -0.3, 0.2]
    assert not len(isolated_readings(values))


def test_what_stands_in_their_place_is_between_the_neighbours_in_whole_steps() -> None:
    values = np.round(moving(7) / 1e-3) * 1e-3
    mended = without_readings(values, np.array([0, 3000, 3001, 5999]))
    assert np.all((mended >= values.min()) & (mended <= values.max()))
    steps = mended / 1e-3
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    between = values[2999] + (values[3002] - values[2999]) / 3
    np.testing.assert_allclose(mended[3000], between, atol=0.6e-3)


@pytest.mark.parametrize(
    ("triad", "reading"), [("accelerometer", 0.0), ("accelerometer", 80.0), ("gyroscope", -3.0), ("gyroscope", 34.0)]
)
def test_they_are_named_and_cost_nothing(triad: str, reading: float) -> None:
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=16), seed=33)
    imu = recording.imus["imu0"]
    samples = getattr(imu, triad)
    values = samples.values.copy()
    at = np.random.default_rng(1).choice(len(values), 12, replace=False)
    values[at] = reading
    spoilt = replace(recording, imus={"imu0": replace(imu, **{triad: replace(samples, values=values)})})
    found = gnomon.calibrate_imu(spoilt).calibration
    right = gnomon.calibrate_imu(recording).calibration
    codes = {one.code: one for one in found.assessment.findings}
    assert (found.verdict, found.assessment.intervals_used) == (right.verdict, right.assessment.intervals_used)
    assert f"imu0 {triad}: " in codes["isolated-readings"].message
    for name in ("accelerometer.bias", "accelerometer.sensitivity", "gyroscope.bias", "gyroscope.sensitivity"):
        off = found.parameter(f"imu0.{name}") - right.parameter(f"imu0.{name}")
        assert np.all(np.abs(off) <= 0.5 * right.sigma(f"imu0.{name}"))


def test_many_of_them_are_a_warning() -> None:
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=16), seed=33)
    imu = recording.imus["imu0"]
    values = imu.gyroscope.values.copy()
    values[10::400] = -35.0
    spoilt = replace(recording, imus={"imu0": replace(imu, gyroscope=replace(imu.gyroscope, values=values))})
    (told,) = (one for one in gnomon.check(spoilt) if one.code == "isolated-readings")
    assert told.severity == "warning"
