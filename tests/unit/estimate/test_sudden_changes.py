"""A triad that turned in its housing, or whose scales changed, at one instant of a recording of few rests."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.estimate.multiposition.sudden_changes import triad_causes
from gnomon.geometry.rotation_vector import rotation_from_rotvec

GYROSCOPE, ACCELEROMETER = "gyroscope", "accelerometer"
TURN, GAIN = np.radians([0.3, -0.4, 0.2]), np.array([0.0, 4e-3, 0.0])


def changed(triad, later, seed, share=0.55):
    """Return what is told to change where the triad's sensitivity is another from a share of the time on."""
    recording, truth = gnomon.simulate(gnomon.Scenario(intervals=18, hold_s=(1.5, 3.0), t_init_s=15.0), seed)
    imu, sensor = recording.imus["imu0"], getattr(truth.imus["imu0"], triad)
    samples = getattr(imu, triad)
    values = (samples.values - sensor.bias) @ np.linalg.inv(sensor.sensitivity).T @ later(sensor.sensitivity).T
    late = samples.t_s > share * samples.t_s[-1]
    edited = replace(samples, values=np.where(late[:, None], values + sensor.bias, samples.values))
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
