"""A gyroscope from the rotations between fewer than nine attitudes, full turns as of Ferraris among them."""

import numpy as np
import pytest

import gnomon
from gnomon.geometry.rotations import rotation_from_rotvec

RATE_HZ, GRAVITY = 100.0, 9.80665
X, Y, Z = np.eye(3)
FULL, QUARTER, HALF = 2 * np.pi, np.pi / 2, np.pi
LEVEL = (
    *((X, FULL), (Y, FULL), (X, QUARTER), (Z, FULL), (X, QUARTER)),
    *((X, QUARTER), (Z, QUARTER), (Z, HALF)),
)
"""Turns between rests; the axis of each is level, and three are full turns."""


def motion(turns, rest_s=4.0):
    """Return rates (n, 3) and the upward vertical (n, 3), both as the sensor has them."""
    R, rates, ups = np.eye(3), [], []

    def rest():
        n = round(rest_s * RATE_HZ)
        rates.append(np.zeros((n, 3)))
        ups.append(np.tile(R.T @ Z, (n, 1)))

    rest()
    for axis, angle in turns:
        n = round((2 + angle) * RATE_HZ)
        speed = angle * RATE_HZ / n * (1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n))
        turned = np.cumsum(speed) / RATE_HZ - 0.5 * speed / RATE_HZ
        ups.append(np.array([(R @ rotation_from_rotvec(axis * a)).T @ Z for a in turned]))
        rates.append(speed[:, None] * axis)
        R = R @ rotation_from_rotvec(axis * angle)
        rest()
    return np.concatenate(rates), np.concatenate(ups)


def recorded(seed, turns=LEVEL):
    """Return a recording, and the gyroscope's true sensitivity."""
    rng = np.random.default_rng(seed)
    rates, ups = motion(turns)
    sensitivity = np.diag(1 + 0.02 * rng.normal(size=3)) + 0.005 * rng.normal(size=(3, 3))
    moving = np.linalg.norm(rates, axis=1) > 0.02
    force = GRAVITY * ups * (1 + 0.01 * rng.normal(size=3)) + 0.1 * rng.normal(size=3)
    force = force + (0.007 + 0.1 * moving[:, None]) * rng.normal(size=ups.shape)
    rate = rates @ sensitivity.T + 0.02 * rng.normal(size=3) + 0.004 * rng.normal(size=ups.shape)
    return gnomon.Recording.from_arrays(np.arange(len(ups)) / RATE_HZ, rate, force), sensitivity


def codes(result):
    return {finding.code for finding in result.calibration.assessment.findings}


@pytest.mark.long
def test_full_turns_in_six_attitudes_give_the_scales():
    z = []
    for seed in range(6):
        recording, sensitivity = recorded(seed)
        calibration = gnomon.calibrate_imu(recording).calibration
        error = np.diag(calibration.parameter("imu0.gyroscope.sensitivity") - sensitivity)
        sigma = np.diag(calibration.sigma("imu0.gyroscope.sensitivity"))
        assert (sigma < 0.003).all()  # 0.03 by the unit alone
        z.append(error / sigma)
    assert np.abs(z).max() < 3.5
    assert "rotations-few-attitudes" in codes(gnomon.calibrate_imu(recording))


def test_an_attitude_to_which_the_sensor_comes_back_again_and_again_makes_no_others_wild():
    recording, sensitivity = recorded(3, (*LEVEL, (Y, QUARTER), *((X, FULL), (Y, FULL)) * 5))
    result = gnomon.calibrate_imu(recording)
    off = result.calibration.parameter("imu0.gyroscope.sensitivity") - sensitivity
    assert np.abs(np.diag(off))[:2].max() < 2e-3
    assert "unit" not in codes(result)


def test_nothing_asks_for_rotations_where_there_are_some():
    for turns in (LEVEL, ((X, QUARTER), (X, QUARTER), (X, QUARTER), (Z, QUARTER), (Z, HALF))):
        result = gnomon.calibrate_imu(recorded(3, turns)[0])
        assert not any("record rotations" in f.cure for f in result.calibration.assessment.findings)


def test_turns_about_the_vertical_are_named_and_say_nothing():
    turns = ((Z, FULL), (X, QUARTER), (Y, FULL), (X, QUARTER), (X, QUARTER), (Z, QUARTER), (Z, HALF))
    recording, sensitivity = recorded(4, turns)
    result = gnomon.calibrate_imu(recording)
    assert "turns-about-vertical" in codes(result)
    error = np.diag(result.calibration.parameter("imu0.gyroscope.sensitivity") - sensitivity)
    sigma = np.diag(result.calibration.sigma("imu0.gyroscope.sensitivity"))
    assert (np.abs(error) < 4 * sigma).all()
    assert sigma[1] > 0.01  # the full turn about y was about the vertical


def test_a_saturated_gyroscope_leaves_the_scales_to_the_unit():
    recording, _ = recorded(5)
    options = gnomon.ImuOptions(gyroscope_range=0.3)
    result = gnomon.calibrate_imu(recording, options)
    assert "rotations-unused" in codes(result)
    assert np.diag(result.calibration.sigma("imu0.gyroscope.sensitivity")) == pytest.approx(0.03, rel=0.1)
