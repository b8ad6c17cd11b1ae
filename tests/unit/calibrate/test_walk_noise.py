"""How strongly biases wander: found from a recording, and believed within bounds."""

from dataclasses import replace

import pytest

from gnomon.calibrate.camera_imu import calibrate_camera_imu
from gnomon.estimate.camera_imu.batch import next_walk
from gnomon.options import CameraImuOptions
from gnomon.simulate.camera_imu import simulate_camera_imu
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario


@pytest.mark.parametrize("found", [0.5, 1.0, 1.7, 400.0])
def test_a_walk_is_neither_less_than_stated_nor_far_more(found):
    following = next_walk(found * 2e-4, 2e-4, 1e-4)
    assert 1e-4 <= following <= 3e-3
    if found == 1.7:  # a step beyond what was found, since a stronger walk will show more
        assert 1.7 * 2e-4 < following < 1.7**2 * 2e-4


@pytest.fixture(scope="module")
def wandering():
    """A recording whose biases wander ten times as strongly as stated."""
    scenario = CameraImuScenario(duration_s=20.0, accelerometer_random_walk=3e-3, gyroscope_random_walk=2e-4)
    simulation = simulate_camera_imu(scenario, 3)
    imu = simulation.recording.imus["imu0"]
    noise = replace(imu.noise, accelerometer_random_walk=3e-4, gyroscope_random_walk=2e-5)
    recording = replace(simulation.recording, imus={"imu0": replace(imu, noise=noise)})
    return replace(simulation, recording=recording)


def calibrated(simulation, noise):
    options = CameraImuOptions(model="full", noise=noise, covariance="ordinary")
    result = calibrate_camera_imu(simulation.recording, simulation.target, options)
    walks = {level.name: level for level in result.diagnostics.noise if level.name.endswith(".walk")}
    assert list(walks) == ["imu0.gyroscope.walk", "imu0.accelerometer.walk"]
    return result.calibration, walks


def test_walks_are_found_where_the_biases_may_follow(wandering):
    _, walks = calibrated(wandering, "coloured")
    for level, true in zip(walks.values(), (2e-4, 3e-3), strict=True):
        assert level.nominal == pytest.approx(true / 10)
        assert true / 1.6 < level.used < 1.6 * true
        assert level.estimated == pytest.approx(level.used, rel=0.25)


def test_a_walk_that_is_stated_too_weak_is_told(wandering):
    calibration, walks = calibrated(wandering, "estimated")
    said = [finding for finding in calibration.assessment.findings if finding.code == "walk-differs"]
    assert all(level.used == level.nominal for level in walks.values())
    assert [finding.severity for finding in said] == ["info"] * len(said)
    assert said, [level.estimated / level.used for level in walks.values()]
    assert "imu0.accelerometer wanders" in said[-1].message


def test_a_walk_that_is_as_stated_stays():
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=20.0), 4)
    calibration, walks = calibrated(simulation, "coloured")
    for level in walks.values():
        assert level.nominal <= level.used < 2 * level.nominal
    assert not any(finding.code == "walk-differs" for finding in calibration.assessment.findings)
