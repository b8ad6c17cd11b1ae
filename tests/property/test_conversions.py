"""Random sensors through every pair of forms and of files, and back: the same numbers, and the same samples."""

import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gnomon
from gnomon.formats.foreign import as_calibration
from gnomon.formats.foreign_files import is_own, load_foreign
from gnomon.geometry.rotations import frame_rotation
from gnomon.models.forms import (
    AngrisanoAccelerometer,
    AngrisanoGyroscope,
    KalibrAccelerometer,
    KalibrGyroscope,
    KrebsAccelerometer,
    KrebsGyroscope,
    TedaldiAccelerometer,
    TedaldiGyroscope,
)
from gnomon.models.project_forms import (
    BasaltTriad,
    DiagonalTriad,
    ImucalAccelerometer,
    ImucalGyroscope,
    ImuTkTriad,
    OpenVinsAccelerometer,
    OpenVinsGyroscope,
)
from gnomon.results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
)
from gnomon.results.sensors import calibration_parameters, covariance_names

entry = st.floats(-0.2, 0.2)
matrices = st.lists(entry, min_size=9, max_size=9).map(lambda x: np.eye(3) + np.reshape(x, (3, 3)))
small = st.lists(st.floats(-0.01, 0.01), min_size=9, max_size=9).map(lambda x: np.reshape(x, (3, 3)))
offsets = st.lists(st.floats(-5, 5), min_size=3, max_size=3).map(np.array)


def close(found, expected, scale=0.0):
    assert np.abs(found - expected).max() <= 1e-12 * max(np.abs(expected).max(), scale)


# ---- forms of the model ----

ACCELEROMETERS = {
    "tedaldi": TedaldiAccelerometer,
    "krebs": KrebsAccelerometer,
    "angrisano": AngrisanoAccelerometer,
    "kalibr": KalibrAccelerometer,
    "imucal": ImucalAccelerometer,
    "imu_tk": ImuTkTriad,
    "openvins": OpenVinsAccelerometer,
    "basalt": BasaltTriad,
}
GYROSCOPES = {
    "tedaldi": TedaldiGyroscope,
    "krebs": KrebsGyroscope,
    "angrisano": AngrisanoGyroscope,
    "kalibr": KalibrGyroscope,
    "imucal": ImucalGyroscope,
    "openvins": OpenVinsGyroscope,
}


def turn_into(S, frame):
    """Return by what the body frame is turned for a form: f_new = Q f."""
    return np.eye(3) if frame is None else frame_rotation(S, frame)


@pytest.mark.parametrize(("one", "other"), list(product(ACCELEROMETERS, repeat=2)))
@settings(max_examples=6, deadline=None)
@given(S=matrices, b=offsets, seed=st.integers(0, 99))
def test_accelerometer_through_two_forms_and_back(one, other, S, b, seed):
    first, second = ACCELEROMETERS[one], ACCELEROMETERS[other]
    force = np.random.default_rng(seed).uniform(-15, 15, (20, 3))
    expected = force @ S.T + b
    S_now, b_now, turn = S, b, np.eye(3)
    for form in (first, second, first):
        Q = turn_into(S_now, form.frame)
        turn = Q @ turn
        made = form.from_sensor(S_now @ Q.T, b_now)
        close(made.predict(force @ turn.T), expected, 10)
        S_now, b_now = made.to_sensor()
    close(S_now @ turn, S)
    close(b_now, b, 10)


@pytest.mark.parametrize(("one", "other"), list(product(GYROSCOPES, repeat=2)))
@settings(max_examples=6, deadline=None)
@given(S_a=matrices, S=matrices, b=offsets, G=small, seed=st.integers(0, 99))
def test_gyroscope_through_two_forms_and_back(one, other, S_a, S, b, G, seed):
    first, second = GYROSCOPES[one], GYROSCOPES[other]
    rng = np.random.default_rng(seed)
    rate, force = rng.uniform(-5, 5, (20, 3)), rng.uniform(-15, 15, (20, 3))
    expected = rate @ S.T + b + force @ G.T
    S_a_now, now, turn = S_a, (S, b, G), np.eye(3)
    for form in (first, second, first):
        Q = turn_into(S_a_now, form.frame)  # the accelerometer defines the frame
        S_a_now, turn = S_a_now @ Q.T, Q @ turn
        made = form.from_sensor(now[0] @ Q.T, now[1], now[2] @ Q.T)
        close(made.predict(rate @ turn.T, force @ turn.T), expected, 10)
        now = made.to_sensor()
    close(now[0] @ turn, S)
    close(now[1], b, 10)
    close(now[2] @ turn, G, 1e-2)


@settings(max_examples=50, deadline=None)
@given(S=matrices, b=offsets, seed=st.integers(0, 99))
def test_the_diagonal_that_leaves_least(S, b, seed):
    """No other diagonal has a smaller rms error over directions; one that is diagonal already comes back."""
    made = DiagonalTriad.nearest(S, b)
    least = np.linalg.norm(made.rest(S))
    for change in np.random.default_rng(seed).normal(0, 0.01, (20, 3)):
        assert np.linalg.norm(replace(made, scale=made.scale + change).rest(S)) >= least
    force = np.random.default_rng(seed).uniform(-15, 15, (20, 3))
    corrected = made.scale * (force @ S.T + b - made.offset)
    close(corrected - force, force @ made.rest(S).T, 10)
    diagonal = np.diag(np.diag(S))
    exact = DiagonalTriad.nearest(diagonal, b)
    close(exact.to_sensor()[0], diagonal)
    assert np.array_equal(exact.to_sensor()[1], b)
    close(exact.predict(force), force @ diagonal.T + b, 10)


# ---- files ----

HOLDS = {
    "imu_tk": {"bias"},
    "kalibr": {"g-sensitivity"},
    "openvins": {"g-sensitivity"},
    "basalt": {"bias"},
    "imucal": {"bias", "g-sensitivity"},
    "csv": {"bias", "g-sensitivity"},
    "json": {"bias", "g-sensitivity"},
}
"""Formats that hold scales and axes of both triads -> what else they hold."""


def calibration_of(S_a, b_a, S_g, b_g, G):
    imus = {
        "imu0": ImuCalibration(
            accelerometer=AccelerometerCalibration(sensitivity=S_a, bias=b_a, unit="m/s^2"),
            gyroscope=GyroscopeCalibration(sensitivity=S_g, bias=b_g, g_sensitivity=G, unit="rad/s"),
        )
    }
    names = covariance_names(imus)
    return Calibration(
        imus=imus, frame="user", gravity=Gravity(value=9.81, sigma=0.0, source="given"),
        uncertainty=Covariance(names=names, matrix=np.eye(len(names)) * 1e-8),
        assessment=Assessment(verdict="pass", findings=(), model="g-sensitivity"),
        provenance=Provenance(gnomon_version="0", method="imu"),
    )  # fmt: skip


def through(calibration, form):
    """Write a calibration and read it back."""
    with tempfile.TemporaryDirectory() as folder:
        gnomon.convert(calibration, form, folder)
        files = sorted(Path(folder).iterdir())
        return gnomon.load(files[0]) if is_own(files[0]) else as_calibration(load_foreign(*files))


def check_pair(one, other, S_a, b_a, S_g, b_g, G, seed):
    both = HOLDS[one] & HOLDS[other]
    b_a, b_g = (b * ("bias" in both) for b in (b_a, b_g))
    G = G * ("g-sensitivity" in both)
    rng = np.random.default_rng(seed)
    rate, force = rng.uniform(-5, 5, (10, 3)), rng.uniform(-15, 15, (10, 3))
    measured = force @ S_a.T + b_a, rate @ S_g.T + b_g + force @ G.T
    first = calibration_of(S_a, b_a, S_g, b_g, G)
    now = first
    for form in (one, other, one):
        now = through(now, form)
        imu = now.imus["imu0"]
        turn = _turn(S_a, imu.accelerometer.sensitivity)
        close(force @ turn.T @ imu.accelerometer.sensitivity.T + imu.accelerometer.bias, measured[0], 10)
        response = rate @ turn.T @ imu.gyroscope.sensitivity.T + force @ turn.T @ imu.gyroscope.g_sensitivity.T
        close(response + imu.gyroscope.bias, measured[1], 10)
    begin, end = (dict(calibration_parameters(c.in_frame("accel-x").imus)) for c in (first, now))
    for path, value in begin.items():
        close(end[path], value, 1.0)


def _turn(S, S_new):
    """Return Q with S = S_new Q, exactly a rotation."""
    u, _, v = np.linalg.svd(np.linalg.solve(S_new, S))
    return u @ v


@pytest.mark.parametrize(("one", "other"), list(product(HOLDS, repeat=2)))
def test_through_every_pair_of_files_and_back(one, other):
    rng = np.random.default_rng([sum(map(ord, one)), sum(map(ord, other))])
    S_a, S_g = np.eye(3) + rng.uniform(-0.1, 0.1, (2, 3, 3))
    check_pair(one, other, S_a, rng.normal(size=3), S_g, rng.normal(size=3), rng.normal(0, 1e-3, (3, 3)), 0)


@settings(max_examples=60, deadline=None)
@given(
    one=st.sampled_from(sorted(HOLDS)), other=st.sampled_from(sorted(HOLDS)), S_a=matrices, b_a=offsets, S_g=matrices,
    b_g=offsets, G=small, seed=st.integers(0, 99),
)  # fmt: skip
def test_any_sensor_through_files(one, other, S_a, b_a, S_g, b_g, G, seed):
    check_pair(one, other, S_a, b_a, S_g, b_g, G, seed)
