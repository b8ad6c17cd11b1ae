"""Three MPU-9150 with published calibrations (Mikov, Reginya, Moschevikin, ICINS 2020).

Their model: measured = M true + b with an upper triangular M (frame accel-z), and for the gyroscope M R(eps).
"""

import numpy as np
import pytest

import gnomon
from gnomon.estimate.multiposition.measurements import (
    cut_segments,
    integrate_rates,
    propagate_directions,
    segments_between,
)

SCALE_PERCENT = np.array([[0.363, 0.315, 0.647], [0.471, 0.482, 0.932], [0.382, 0.355, 0.780]])
BIAS_M_S2 = np.array([[0.103, 0.097, 0.344], [0.090, 0.070, 0.338], [0.096, 0.008, -0.045]])
MISALIGNMENT_DEG = np.array([[0.123, 0.020, 0.317], [-0.284, -0.010, 0.145], [0.260, -0.012, 0.282]])  # yz, xy, xz
GYRO_SCALE_PERCENT = np.array([[0.041, 0.457, 0.826], [0.007, 0.260, -0.179], [-0.058, 0.277, 0.242]])
GYRO_MISALIGNMENT_DEG = np.array([[-0.034, -0.120, 0.806], [-0.639, 0.210, 0.262], [0.150, -0.072, 0.876]])
GYRO_TURN_DEG = np.array([[0.030, -0.364, -0.074], [-0.565, 0.013, 0.069], [0.142, -0.482, -0.079]])
GYRO_BIAS_DEG_S = np.array([[1.146, -0.401, 1.261], [-0.573, 1.089, 0.286], [0.573, -0.344, 1.261]])

SENSORS = pytest.mark.parametrize("k", [0, 1, 2], ids=["sensor 1", "sensor 2", "sensor 3"])


@pytest.fixture(scope="module")
def results(real_data):
    folder = real_data("mikov-mpu9150-multipos")
    recordings = [gnomon.read(folder / f"imu{k}.log", rate_hz=100.0, units="si") for k in range(3)]
    options = gnomon.ImuOptions(gravity=9.81, frame="accel-z")
    return [(recording, gnomon.calibrate_imu(recording, options)) for recording in recordings]


def triangular(scale_percent, misalignment_deg):
    yz, xy, xz = np.radians(misalignment_deg)
    return np.array([[0, xy, xz], [0, 0, yz], [0, 0, 0]]) + np.diag(1 + scale_percent / 100)


def published_gyroscope(k):
    x, y, z = np.radians(GYRO_TURN_DEG[k])
    turn = np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])  # of half a degree: the next order is 5e-5
    return triangular(GYRO_SCALE_PERCENT[k], GYRO_MISALIGNMENT_DEG[k]) @ turn


@SENSORS
def test_accelerometer(results, k):
    imu = results[k][1].calibration.imus["imu0"]
    published = triangular(SCALE_PERCENT[k], MISALIGNMENT_DEG[k])
    np.testing.assert_allclose(np.diag(imu.accelerometer.sensitivity), np.diag(published), atol=5e-4)
    np.testing.assert_allclose(imu.accelerometer.sensitivity, published, atol=5e-4)  # 0.03 degrees
    np.testing.assert_allclose(imu.accelerometer.bias, BIAS_M_S2[k], atol=0.01)


@SENSORS
def test_gyroscope(results, k):
    imu = results[k][1].calibration.imus["imu0"]
    difference = np.diag(imu.gyroscope.sensitivity - published_gyroscope(k))
    np.testing.assert_allclose(np.degrees(imu.gyroscope.bias), GYRO_BIAS_DEG_S[k], atol=0.05)
    if k != 1:
        np.testing.assert_allclose(difference, 0.0, atol=3e-3)
        return
    # Sensor 2 is the exception: z differs by 0.4 % (ours +0.2 %, published -0.18 %), six of our sigmas. The printed
    # sign may be a slip, but turning it alone does not mend the rest of what is printed for this gyroscope: see below.
    np.testing.assert_allclose(difference[:2], 0.0, atol=3e-3)
    assert 2.5e-3 < difference[2] < 4.9e-3
    assert imu.gyroscope.sensitivity[2, 2] - 1 == pytest.approx(0.2e-2, abs=0.1e-2)


def rotation_rms(recording, result, sensitivity):
    """Return the rms of |u_a - u_g| [rad] of all rotations by a given gyroscope matrix and our bias."""
    calibration, table = result.calibration, result.diagnostics.rotations
    imu, samples = calibration.imus["imu0"], recording.imus["imu0"]
    u = imu.accelerometer.specific_force(result.diagnostics.intervals.accelerometer)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    t_s = samples.gyroscope.t_s
    cut = segments_between(t_s, table.start_s, table.stop_s)
    segments = cut_segments(t_s, samples.gyroscope.values, samples.accelerometer.values, *cut)
    rate = (segments.gyroscope - imu.gyroscope.bias) @ np.linalg.inv(sensitivity).T
    error = u[1:] - propagate_directions(integrate_rates(segments, rate).rotation, u[:-1])
    return np.sqrt(np.mean(np.sum(error**2, axis=1)))


def test_published_gyroscope_of_sensor_2_does_not_explain_its_rotations(results):
    # Ours is 1.0, 2.2 and 1.2 times better: where the two agree both explain the rotations, elsewhere ours does.
    ratio = []
    for k, (recording, result) in enumerate(results):
        assert result.diagnostics.intervals.used.all()
        ours = rotation_rms(recording, result, result.calibration.imus["imu0"].gyroscope.sensitivity)
        ratio.append(rotation_rms(recording, result, published_gyroscope(k)) / ours)
        assert ours < 2.5e-3
    assert ratio[0] < 1.3
    assert ratio[1] > 1.8
    assert ratio[2] < 1.3
    flipped = published_gyroscope(1)
    flipped[2] *= (1 + 0.179e-2) / (1 - 0.179e-2)
    ours = rotation_rms(*results[1], results[1][1].calibration.imus["imu0"].gyroscope.sensitivity)
    assert rotation_rms(*results[1], flipped) > 1.8 * ours


@SENSORS
def test_all_rests_and_rotations_are_used(results, k):
    calibration = results[k][1].calibration
    assert 20 <= calibration.assessment.intervals_used == calibration.assessment.intervals_found
    assert calibration.assessment.rotations_used == calibration.assessment.intervals_used - 1
    assert calibration.assessment.holdout.accelerometer_rms < 5e-3
    assert calibration.assessment.holdout.rotation_rms < 4e-3
    assert calibration.verdict == "pass"
