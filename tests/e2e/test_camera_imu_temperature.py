"""A camera and an IMU whose temperature rose and fell: what `calibrate_camera_imu` makes of it."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon import CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.recording import TemperatureSamples

SLOPES = {"gyroscope": np.array([4e-4, -6e-4, 2e-4]), "accelerometer": np.array([5e-3, 2e-3, -6e-3])}


def calibrated(seed, course, slopes):
    """Return the calibration of a rig whose biases follow the temperature, or the time."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=40.0), seed)
    imu = simulation.recording.imus["imu0"]
    share = (imu.gyroscope.t_ns - imu.gyroscope.t_ns[0]) / np.ptp(imu.gyroscope.t_ns)
    degc = np.where(share < 0.5, 1 - np.exp(-8 * share), (1 - np.exp(-4)) * np.exp(-8 * (share - 0.5)))
    follows = 12.0 * (degc if course == "temperature" else share)
    triads = {}
    for name, slope in slopes.items():
        triad = getattr(imu, name)
        moved = np.interp(triad.t_ns, imu.gyroscope.t_ns, follows - follows.mean())
        triads[name] = replace(triad, values=triad.values + moved[:, None] * slope)
    read = np.round((30 + 12 * degc[::20]) / 0.05) * 0.05
    thermometer = TemperatureSamples(t_ns=imu.gyroscope.t_ns[::20], values=read, unit="degC")
    warm = replace(imu, temperature=thermometer, **triads)
    recording = replace(simulation.recording, imus={**simulation.recording.imus, "imu0": warm})
    return simulation, calibrate_camera_imu(recording, simulation.target)


@pytest.mark.long
def test_biases_follow_the_temperature_that_rose_and_fell(tmp_path):
    simulation, result = calibrated(600, "temperature", SLOPES)
    calibration = result.calibration
    found = calibration.imus["imu0"].temperature
    assert found is not None
    for name, true in SLOPES.items():
        slopes, sigma = getattr(found, f"{name}_bias")[0], calibration.sigma(f"imu0.temperature.{name}_bias")[0]
        assert np.abs((slopes - true) / sigma).max() < 3.5
        assert sigma.max() < 0.2 * np.abs(true).max()  # what it follows is no error of the others, or of its own mean
    assert [one.code for one in calibration.assessment.findings].count("temperature-slope") == 2
    gnomon.write_report(result, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("bias over the temperature") >= 2
    # What is beside it is as it was, and a file keeps all of it.
    assert calibration.uncertainty.names[-1].startswith("cam0.")
    off = calibration.cameras["cam0"].T_cam_imu[:3, 3] - simulation.truth.cameras["cam0"].T_cam_imu[:3, 3]
    assert np.abs(off / calibration.sigma("cam0.T_cam_imu.translation")).max() < 4
    gnomon.save(calibration, tmp_path / "calibration.yaml")
    read = gnomon.load(tmp_path / "calibration.yaml")
    assert np.allclose(read.uncertainty.matrix, calibration.uncertainty.matrix, rtol=1e-12, atol=0)


@pytest.mark.slow
def test_a_drift_with_the_time_before_a_camera_is_no_slope():
    assert calibrated(601, "time", SLOPES)[1].calibration.imus["imu0"].temperature is None
