"""The forms of Tedaldi, Krebs, Angrisano and Kalibr against each other, by equations derived apart from the code."""

import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.geometry.rotations import frame_rotation
from gnomon.models.forms import (
    AngrisanoAccelerometer,
    KalibrAccelerometer,
    KalibrGyroscope,
    KrebsAccelerometer,
    KrebsGyroscope,
    TedaldiAccelerometer,
    TedaldiGyroscope,
)
from gnomon.models.project_forms import ImucalAccelerometer, ImuTkTriad

RNG = np.random.default_rng(5)
LOWER = np.array([[412.0, 0, 0], [3.1, 410.5, 0], [-7.2, 4.4, 415.0]])
UPPER = np.array([[412.0, -5.2, 8.8], [0, 410.5, 3.3], [0, 0, 415.0]])
RATE = np.array([[4778.0, -70.0, -104.0], [6.0, 4764.0, 207.0], [-24.0, 60.0, 4772.0]])
COUPLING = RNG.normal(size=(3, 3))
BIAS = np.array([33124.0, 33275.0, 32364.0])


def test_angles_of_documents_a_and_c():
    """T = [1 -yz zy; 0 1 -zx; 0 0 1] is [1 az ay; 0 1 ax; 0 0 1]: az = -yz, ay = zy, ax = -zx; b changes sign."""
    a, c = TedaldiAccelerometer.from_sensor(UPPER, BIAS), AngrisanoAccelerometer.from_sensor(UPPER, BIAS)
    assert np.array_equal(a.T, c.T)
    assert np.array_equal(a.K, c.K)
    assert np.array_equal(a.b, -BIAS)
    assert np.array_equal(c.b, BIAS)
    measured = RNG.normal(33000, 1000, (5, 3))
    assert np.allclose((measured + a.b) * a.K @ a.T.T, (measured - c.b) * c.K @ c.T.T, rtol=1e-14)


def test_triangular_forms_are_exactly_triangular():
    form = TedaldiAccelerometer.from_sensor(UPPER + 1e-12 * np.ones((3, 3)), BIAS)
    assert np.array_equal(np.tril(form.T, -1), np.zeros((3, 3)))
    assert np.array_equal(np.diag(form.T), np.ones(3))


def test_krebs_and_kalibr():
    """M_kalibr = S M, C = C_bg', A = B (chapter 3), A = B C' (chapter 4)."""
    kalibr = KalibrGyroscope.from_sensor(RATE, BIAS, COUPLING)
    third = KrebsGyroscope.from_sensor(RATE, BIAS, COUPLING)
    fourth = KrebsGyroscope.from_sensor(RATE, BIAS, COUPLING, reading="chapter 4")
    assert np.allclose(kalibr.M, np.diag(third.S) @ third.M, rtol=1e-14)
    assert np.allclose(kalibr.C_gyro_i, third.C_bg.T, atol=1e-15)
    assert np.allclose(kalibr.A, third.B, atol=1e-14)
    assert np.allclose(kalibr.A, fourth.B @ kalibr.C_gyro_i.T, atol=1e-14)
    accelerometer = KrebsAccelerometer.from_sensor(LOWER, BIAS)
    assert np.allclose(KalibrAccelerometer.from_sensor(LOWER, BIAS).M, np.diag(accelerometer.S) @ accelerometer.M)


def test_kalibr_to_tedaldi():
    """qr: M_a^-1 = Q U, R_Oi = Q', K = diag(U), T = U K^-1; G = R_Oi (M_g C)^-1, K_g = diag(G), B_O = A C R_Oi'."""
    kalibr = KalibrGyroscope.from_sensor(RATE, BIAS, COUPLING)
    q, u = np.linalg.qr(np.linalg.inv(LOWER))
    signs = np.diag(np.sign(np.diag(u)))
    R_Oi, U = (q @ signs).T, signs @ u
    assert np.allclose(frame_rotation(LOWER, "accel-z"), R_Oi, atol=1e-14)
    accelerometer = TedaldiAccelerometer.from_sensor(LOWER @ R_Oi.T, BIAS)
    assert np.allclose(accelerometer.K, np.diag(U), rtol=1e-13)
    assert np.allclose(accelerometer.T, U / np.diag(U), atol=1e-13)
    correction = R_Oi @ np.linalg.inv(kalibr.M @ kalibr.C_gyro_i)
    gyroscope = TedaldiGyroscope.from_sensor(RATE @ R_Oi.T, BIAS, COUPLING @ R_Oi.T)
    assert np.allclose(gyroscope.K, np.diag(correction), rtol=1e-13)
    assert np.allclose(gyroscope.T, correction / np.diag(correction), atol=1e-13)
    assert np.allclose(gyroscope.B, kalibr.A @ kalibr.C_gyro_i @ R_Oi.T, atol=1e-13)


def test_imu_tk_corrects_as_it_says():
    form = ImuTkTriad.from_sensor(RATE, BIAS)
    rate = RNG.normal(size=(4, 3))
    measured = rate @ RATE.T + BIAS
    assert np.allclose((measured - form.B) @ (form.T @ np.diag(form.K)).T, rate, atol=1e-12)


def test_imucal_rows_are_unit_vectors():
    form = ImucalAccelerometer.from_sensor(LOWER, BIAS)
    assert np.allclose(np.linalg.norm(form.R, axis=1), 1, atol=1e-15)


def test_left_handed_gyroscope_keeps_a_proper_rotation():
    """A flipped axis stays visible as a negative scale; the rotation to the gyroscope's frame is never a reflection."""
    flipped = RATE * np.array([1, 1, -1])
    form = KalibrGyroscope.from_sensor(flipped, BIAS, COUPLING)
    assert np.linalg.det(form.C_gyro_i) == pytest.approx(1)
    assert form.M[2, 2] < 0
    assert np.allclose(form.M @ form.C_gyro_i, flipped, rtol=1e-12)


def test_sensor_in_another_frame_is_refused():
    with pytest.raises(OptionError, match="in_frame"):
        TedaldiAccelerometer.from_sensor(LOWER, BIAS)
    with pytest.raises(OptionError, match="accel-x"):
        KalibrAccelerometer.from_sensor(UPPER, BIAS)


def test_permuted_axes_have_no_unit_diagonal():
    permuted = np.roll(np.diag([4778.0, 4764.0, 4772.0]), 1, axis=0)
    with pytest.raises(OptionError, match="same name"):
        TedaldiGyroscope.from_sensor(permuted, BIAS, COUPLING)
    rate, force = RNG.normal(size=(2, 4, 3))
    predicted = KalibrGyroscope.from_sensor(permuted, BIAS, COUPLING).predict(rate, force)
    assert np.allclose(predicted, rate @ permuted.T + BIAS + force @ COUPLING.T, rtol=1e-13)
