"""A triad that turned in its housing, or whose scales changed at once or steadily, in a recording of few rests."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.estimate.multiposition.triad_changes import triad_causes
from gnomon.geometry.rotations import rotation_from_rotvec

GYROSCOPE, ACCELEROMETER = "gyroscope", "accelerometer"
TURN, GAIN = np.radians([0.3, -0.4, 0.2]), np.array([0.0, 4e-3, 0.0])


def at_once(share):
    return lambda t_s: t_s > share * t_s[-1]


def steadily(t_s):
    return t_s / t_s[-1]


def changed(triad, later, seed, course=None):
    """Return what is told to change where the triad's sensitivity becomes another in the course of the time."""
    recording, truth = gnomon.simulate(gnomon.Scenario(intervals=18, hold_s=(1.5, 3.0), t_init_s=15.0), seed)
    imu, sensor = recording.imus["imu0"], getattr(truth.imus["imu0"], triad)
    samples = getattr(imu, triad)
    values = (samples.values - sensor.bias) @ np.linalg.inv(sensor.sensitivity).T @ later(sensor.sensitivity).T
    late = (course or at_once(0.55))(samples.t_s)[:, None]
    edited = replace(samples, values=samples.values + late * (values + sensor.bias - samples.values))
    recording = replace(recording, imus={"imu0": replace(imu, **{triad: edited})})
    return gnomon.calibrate_imu(recording).calibration.assessment


@pytest.mark.parametrize(
    ("triad", "later", "quantity", "size"),
    [
        pytest.param(
            GYROSCOPE, lambda s: s @ rotation_from_rotvec(TURN), "gyroscope_misalignment", 6e-3, marks=pytest.mark.long
        ),
        (ACCELEROMETER, lambda s: s @ rotation_from_rotvec(TURN), "gyroscope_misalignment", 6e-3),
        (GYROSCOPE, lambda s: np.diag(1 + GAIN) @ s, "gyroscope_scale", 4e-3),
        pytest.param(
            ACCELEROMETER, lambda s: np.diag(1 + GAIN) @ s, "accelerometer_scale", 4e-3, marks=pytest.mark.long
        ),
    ],
)
def test_what_changes_at_once_is_named_with_its_size(triad, later, quantity, size):
    found = changed(triad, later, seed=40)
    (change,) = [one for one in found.trust.changes if one.quantity == quantity]
    assert size / 2 < change.size < 1.5 * size + 4 * change.sigma
    assert found.verdict == "warn"
    assert "parameter-changed" in {finding.code for finding in found.findings}


@pytest.mark.long
def test_a_scale_that_drifts_is_judged_by_its_ends():
    """As a step it would be half as large."""
    for seed, size in ((44, 8e-3), (45, 4e-3), (46, 8e-3)):
        found = changed(GYROSCOPE, lambda s, size=size: np.diag([1, 1 + size, 1]) @ s, seed, steadily)
        (change,) = [one for one in found.trust.changes if one.quantity == "gyroscope_scale"]
        assert change.where.startswith("steadily, from the first to the last")
        assert abs(change.size - size) < 4 * change.sigma < size
        assert found.verdict == "warn"


def test_rotations_before_a_change_are_no_outliers():
    found = changed(GYROSCOPE, lambda s: s @ rotation_from_rotvec(4 * TURN), 47, at_once(0.28))
    (change,) = [one for one in found.trust.changes if one.quantity == "gyroscope_misalignment"]
    assert change.size > 0.01
    assert "after 32" in change.where
    assert found.verdict == "fail"


def test_where_nothing_changes_nothing_is_named():
    for seed in (41, 42, 43):
        assert not changed(GYROSCOPE, lambda s: s, seed).trust.changes


def test_causes_are_what_a_turn_of_the_triad_and_its_scales_do_to_its_sensitivity():
    sensitivity = np.array([[0.1, 0.02, 0.9], [1.1, 0.0, 0.03], [0.05, -0.8, 0.01]])
    turn, gain = triad_causes(sensitivity)
    small = np.array([1e-6, -2e-6, 3e-6])
    scaled, turned = np.diag(1 + small) @ sensitivity, sensitivity @ rotation_from_rotvec(small)
    np.testing.assert_allclose((gain @ small).reshape(3, 3), scaled - sensitivity, atol=1e-12)
    np.testing.assert_allclose((turn @ small).reshape(3, 3), turned - sensitivity, atol=1e-11)
