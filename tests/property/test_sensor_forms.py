"""Whatever form predicts them, the samples of a sensor are the same, and no form loses a digit on the way back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
    ImucalAccelerometer,
    ImucalGyroscope,
    ImuTkTriad,
    OpenVinsAccelerometer,
    OpenVinsGyroscope,
)

ACCELEROMETERS = [
    TedaldiAccelerometer,
    KrebsAccelerometer,
    AngrisanoAccelerometer,
    KalibrAccelerometer,
    ImucalAccelerometer,
    ImuTkTriad,
    OpenVinsAccelerometer,
]
GYROSCOPES = {
    "tedaldi": TedaldiGyroscope.from_sensor,
    "krebs, chapter 3": KrebsGyroscope.from_sensor,
    "krebs, chapter 4": lambda S, b, G: KrebsGyroscope.from_sensor(S, b, G, reading="chapter 4"),
    "angrisano": AngrisanoGyroscope.from_sensor,
    "kalibr": KalibrGyroscope.from_sensor,
    "imucal": ImucalGyroscope.from_sensor,
    "openvins": OpenVinsGyroscope.from_sensor,
}

entry = st.floats(-0.2, 0.2)
matrices = st.lists(entry, min_size=9, max_size=9).map(lambda x: np.eye(3) + np.reshape(x, (3, 3)))
scales = st.floats(-3, 5).map(lambda x: 10.0**x)
offsets = st.lists(st.floats(-50, 50), min_size=3, max_size=3).map(np.array)


def samples(seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-5, 5, (20, 3)), rng.uniform(-15, 15, (20, 3))


def close(found, expected):
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("form", ACCELEROMETERS)
@settings(max_examples=50, deadline=None)
@given(skewed=matrices, scale=scales, offset=offsets, seed=st.integers(0, 99))
def test_accelerometer(form, skewed, scale, offset, seed):
    S, b = skewed * scale, offset * scale
    turn = np.eye(3) if form.frame is None else frame_rotation(S, form.frame)
    if form.frame is not None:
        S = S @ turn.T
    made = form.from_sensor(S, b)
    back_S, back_b = made.to_sensor()
    close(back_S, S)
    assert np.array_equal(back_b, b)
    _, force = samples(seed)
    close(made.predict(force), force @ S.T + b)


@pytest.mark.parametrize("name", GYROSCOPES)
@settings(max_examples=50, deadline=None)
@given(skewed=matrices, response=matrices, scale=scales, offset=offsets, seed=st.integers(0, 99))
def test_gyroscope(name, skewed, response, scale, offset, seed):
    S, b, G = skewed * scale, offset * scale, response * scale * 1e-2
    made = GYROSCOPES[name](S, b, G)
    back_S, back_b, back_G = made.to_sensor()
    close(back_S, S)
    assert np.array_equal(back_b, b)
    close(back_G, G)
    rate, force = samples(seed)
    close(made.predict(rate, force), rate @ S.T + b + force @ G.T)


@settings(max_examples=50, deadline=None)
@given(skewed=matrices, turned=matrices, response=matrices)
def test_through_both_frames(skewed, turned, response):
    """Samples of a motion, stated in either body frame, are the same: the frames only relabel the truth."""
    S_a, S_g, G = 400 * skewed, 5000 * turned, response
    rate, force = samples(1)
    expected = force @ S_a.T, rate @ S_g.T + force @ G.T
    for accelerometer, gyroscope in (
        (TedaldiAccelerometer, TedaldiGyroscope),
        (KrebsAccelerometer, KrebsGyroscope),
        (AngrisanoAccelerometer, AngrisanoGyroscope),
        (KalibrAccelerometer, KalibrGyroscope),
        (OpenVinsAccelerometer, OpenVinsGyroscope),
    ):
        Q = frame_rotation(S_a, accelerometer.frame)
        zero = np.zeros(3)
        close(accelerometer.from_sensor(S_a @ Q.T, zero).predict(force @ Q.T), expected[0])
        close(gyroscope.from_sensor(S_g @ Q.T, zero, G @ Q.T).predict(rate @ Q.T, force @ Q.T), expected[1])


@settings(max_examples=50, deadline=None)
@given(skewed=matrices, offset=offsets, seed=st.integers(0, 99))
def test_basalt(skewed, offset, seed):
    """Basalt corrects: its bias is behind the scale, and is no small number where the scale is none."""
    truth = samples(seed)[1]
    made = BasaltTriad.from_sensor(skewed, offset)
    back_S, back_b = made.to_sensor()
    close(back_S, skewed)
    assert np.abs(back_b - offset).max() <= 1e-12 * max(np.abs(made.b).max(), 1)
    measured = truth @ skewed.T + offset
    assert np.abs(made.predict(truth) - measured).max() <= 1e-11 * max(np.abs(measured).max(), np.abs(made.b).max())
    corrected = measured @ (np.eye(3) + made.S).T - made.b
    assert np.abs(corrected - truth).max() <= 1e-11 * max(np.abs(measured).max(), np.abs(made.b).max(), 1)
    lower = skewed @ frame_rotation(skewed, "accel-x").T
    form = BasaltTriad.of_accelerometer(lower, offset)
    assert not np.triu(form.S, 1).any()
    close(form.to_sensor()[0], lower)


@settings(max_examples=50, deadline=None)
@given(skewed=matrices, response=matrices, offset=offsets)
def test_openvins_tg_is_a_c_of_kalibr(skewed, response, offset):
    kalibr = KalibrGyroscope.from_sensor(skewed, offset, response)
    openvins = OpenVinsGyroscope.from_sensor(skewed, offset, response)
    assert np.array_equal(openvins.T, kalibr.M)
    assert np.array_equal(openvins.R, kalibr.C_gyro_i)
    close(openvins.Tg, kalibr.A @ kalibr.C_gyro_i)
