"""Vibration is found where it is, and the motion of a hand is none."""

import numpy as np
import pytest

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.assess.checks.imu_checks import check_triad_clocks
from gnomon.assess.checks.signals import check_vibration
from gnomon.recording import ImuSamples, TriadSamples


def samples(values, unit, rate_hz=200.0):
    t_ns = np.rint(np.arange(len(values)) / rate_hz * 1e9).astype(np.int64)
    return TriadSamples(t_ns=t_ns, values=values, unit=unit)


def shaken(hz, rate_hz=200.0, amplitude=0.5):
    t = np.arange(int(20 * rate_hz)) / rate_hz
    rng = np.random.default_rng(1)
    force = rng.normal(0, 0.02, (len(t), 3)) + amplitude * np.sin(2 * np.pi * hz * t)[:, None] * [1, 0.3, 0]
    return samples(force, "m/s^2", rate_hz), samples(rng.normal(0, 0.002, (len(t), 3)), "rad/s", rate_hz)


@pytest.mark.parametrize("hz", [33.0, 50.0, 88.0])
def test_a_line_is_found(hz):
    (found,) = check_vibration(*shaken(hz), "imu0")
    assert found.code == "vibration"
    assert f"{hz:.3g} Hz" in found.message
    assert "gyroscope" not in found.message


@pytest.mark.parametrize("change", [{"amplitude": 0.0}, {"amplitude": 0.02}, {"hz": 10.0}, {"rate_hz": 40.0}])
def test_none_is_found_where_there_is_none(change):
    assert check_vibration(*shaken(**{"hz": 15.0, **change}), "imu0") == []


@pytest.mark.parametrize("motion", ["normal", "tremor", "shaky"])
def test_a_hand_does_not_vibrate(motion):
    imu = simulate_camera_imu(CameraImuScenario(motion=motion, duration_s=20.0), seed=3).recording.imus["imu0"]
    assert check_vibration(imu.accelerometer, imu.gyroscope, "imu0") == []


@pytest.mark.parametrize("late_s", [0.0, 0.4, -2.0])
def test_triads_of_two_clocks(late_s):
    rng = np.random.default_rng(2)
    t = np.arange(12000) / 200.0
    moving = (np.floor(t / 2.7) % 2 == 1) & (t % 2.7 > 0.3)
    values = [rng.normal(0, 0.01, (len(t), 3)) + moving[:, None] * rng.normal(0, 1, (len(t), 3)) for _ in range(2)]
    gyroscope = samples(values[1], "rad/s")
    later = TriadSamples(t_ns=gyroscope.t_ns + round(late_s * 1e9), values=gyroscope.values, unit="rad/s")
    found = check_triad_clocks(ImuSamples(accelerometer=samples(values[0], "m/s^2"), gyroscope=later), "imu0")
    assert [one.code for one in found] == ([] if late_s == 0 else ["triads-apart"])
    if found:
        assert f"{abs(late_s):.2f} s" in found[0].message
        assert ("the gyroscope is stirred" in found[0].message) == (late_s > 0)


def test_a_clock_of_whole_seconds_does_not_tell_the_clocks_apart():
    rng = np.random.default_rng(3)
    t = np.arange(21000) / 100.0
    moving = np.floor(t / 3.5) % 2 == 1
    values = [rng.normal(0, 0.01, (len(t), 3)) + moving[:, None] * rng.normal(0, 1, (len(t), 3)) for _ in range(2)]
    t_ns = (np.floor(t + 0.37) * 1e9).astype(np.int64)
    first, second = (TriadSamples(t_ns=t_ns, values=v, unit=u) for v, u in zip(values, ("m/s^2", "rad/s"), strict=True))
    assert check_triad_clocks(ImuSamples(accelerometer=first, gyroscope=second), "imu0") == []
