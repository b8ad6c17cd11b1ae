"""What is known beforehand: by name, and from other calibrations, with and without cameras."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuOptions, ImuOptions, Recording, calibrate_camera_imu, calibrate_imu, simulate_camera_imu
from gnomon import simulate as simulated
from gnomon.assess.priors import NAMES, TRIADS, gather_prior, prior_findings
from gnomon.calibrate.steps.camera_imu_preparation import evidence_of_imu, known_imu
from gnomon.errors import OptionError
from gnomon.geometry.rotations import frame_rotation
from gnomon.results.calibration import Calibration, Covariance
from gnomon.results.moved import rotate_imu
from gnomon.results.sensors import ImuCalibration
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.scenarios.recorded import Scenario

SENSITIVITY, RATE = "imu0.accelerometer.sensitivity", "imu0.gyroscope.sensitivity"
UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
GRAVITY = ImuOptions(gravity=9.80665, model="g-sensitivity")


def recording(seed: int, **scenario: object) -> tuple[Recording, Calibration]:
    """Return a recording of one and the same sensor, and its truth."""
    return simulated(Scenario(g_sensitivity=3e-4, intervals=20, sensor_seed=7, **scenario), seed)  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def first() -> Calibration:
    return calibrate_imu(recording(1)[0], GRAVITY).calibration


@pytest.fixture(scope="module")
def second() -> tuple[Recording, Calibration]:
    return recording(2)


def test_two_recordings_are_as_good_as_one_of_twice_the_length(
    first: Calibration, second: tuple[Recording, Calibration]
) -> None:
    alone = calibrate_imu(second[0], GRAVITY).calibration
    both = calibrate_imu(second[0], GRAVITY, prior=first).calibration
    for path in (SENSITIVITY, RATE, "imu0.gyroscope.g_sensitivity"):
        known = alone.sigma(path) > 0
        expected = 1 / np.hypot(1 / alone.sigma(path)[known], 1 / first.sigma(path)[known])
        np.testing.assert_allclose(both.sigma(path)[known], expected, rtol=0.2)
        error = (both.parameter(path) - second[1].parameter(path))[known] / both.sigma(path)[known]
        assert np.abs(error).max() < 4
    said = {finding.code: finding.message for finding in both.assessment.findings}
    assert "accelerometer.sensitivity" in said["prior-used"]
    assert ".bias" not in said["prior-used"], "biases are others each time a sensor is switched on"
    assert "prior-disagrees" not in said


def test_a_prior_of_another_sensor_is_noticed(first: Calibration, second: tuple[Recording, Calibration]) -> None:
    imu = first.imus["imu0"]
    assert imu.accelerometer is not None
    wrong = replace(imu.accelerometer, sensitivity=imu.accelerometer.sensitivity * 1.002)
    other = replace(first, imus={"imu0": replace(imu, accelerometer=wrong)})
    result = calibrate_imu(second[0], GRAVITY, prior=other).calibration
    findings = {finding.code: finding.message for finding in result.assessment.findings}
    assert "accelerometer.sensitivity" in findings["prior-disagrees"]
    assert result.verdict == "warn"


def test_healthy_priors_disagree_rarely() -> None:
    rng = np.random.default_rng(5)
    known = gather_prior(None, ImuOptions(prior=("imu0.accelerometer.bias=0.1", "imu0.gyroscope.bias=0.02")), UNITS)
    warned = 0
    for _ in range(300):
        sigma = np.zeros(33)
        sigma[9:12], sigma[21:24] = 0.1, 0.02
        truth = sigma * rng.standard_normal(33)  # about the nominal zero
        measured = truth + 0.5 * sigma * rng.standard_normal(33)
        codes = [finding.code for finding in prior_findings(known, measured, np.diag(0.25 * sigma**2))]
        warned += "prior-disagrees" in codes
    assert warned <= 2


def test_what_is_fixed_stays_and_is_certain(first: Calibration, second: tuple[Recording, Calibration]) -> None:
    options = replace(
        GRAVITY, fix=("imu0.gyroscope.g_sensitivity", "imu0.gyroscope.sensitivity[1,0]", "accelerometer.bias")
    )
    result = calibrate_imu(second[0], options, prior=first).calibration
    for path in ("imu0.gyroscope.g_sensitivity", "imu0.accelerometer.bias"):
        np.testing.assert_array_equal(result.parameter(path), first.parameter(path))
        assert not result.sigma(path).any()
    assert result.parameter(RATE)[1, 0] == first.parameter(RATE)[1, 0]
    assert result.sigma(RATE)[1, 0] == 0 < result.sigma(RATE)[0, 1]


def test_g_sensitivity_fixed_at_its_nominal_zero_is_the_basic_model(second: tuple[Recording, Calibration]) -> None:
    fixed = calibrate_imu(second[0], ImuOptions(gravity=9.80665, fix=("imu0.gyroscope.g_sensitivity",))).calibration
    basic = calibrate_imu(second[0], ImuOptions(gravity=9.80665, model="basic")).calibration
    np.testing.assert_array_equal(fixed.parameter(RATE), basic.parameter(RATE))


def test_a_stated_sigma_pulls_towards_the_value(second: tuple[Recording, Calibration]) -> None:
    options = ImuOptions(gravity=9.80665, prior=("imu0.accelerometer.bias[1]=1e-6",))
    result = calibrate_imu(second[0], options).calibration
    assert abs(result.parameter("imu0.accelerometer.bias")[1]) < 1e-5
    assert result.sigma("imu0.accelerometer.bias")[1] == pytest.approx(1e-6, rel=0.01)
    assert abs(result.parameter("imu0.accelerometer.bias")[0]) > 1e-3


def test_free_asks_no_prior(first: Calibration) -> None:
    known = gather_prior(first, ImuOptions(), UNITS, free=("imu0.accelerometer",))
    assert not known.knows("imu0.accelerometer")
    assert known.knows("imu0.gyroscope.sensitivity")


def test_other_units_are_converted(first: Calibration) -> None:
    known = gather_prior(first, ImuOptions(), {"accelerometer": "g", "gyroscope": "deg/s"})
    at = TRIADS["gyroscope"].start
    np.testing.assert_allclose(known.value[at : at + 9], np.degrees(first.parameter(RATE)).ravel(), rtol=1e-14)
    prior = gather_prior(first, ImuOptions(), {"accelerometer": "mg"}).triad_prior("accelerometer")
    assert prior is not None
    np.testing.assert_allclose(prior.mean[:9] * 9.80665e-3, first.parameter(SENSITIVITY).ravel(), rtol=1e-12)


def test_a_gyroscope_known_in_its_own_frame_says_nothing_of_its_pose(first: Calibration) -> None:
    imu = first.imus["imu0"]
    assert imu.gyroscope is not None
    turn = frame_rotation(imu.gyroscope.sensitivity, "accel-x")
    own = rotate_imu(ImuCalibration(gyroscope=imu.gyroscope), turn)
    rows = [i for i, name in enumerate(first.uncertainty.names) if ".gyroscope." in name]
    variance = np.diag(first.uncertainty.matrix)[rows].copy()
    variance[[1, 2, 5]] = 0.0  # by the frame
    variance[12:] = 0.0  # not estimated
    names = tuple(first.uncertainty.names[i] for i in rows)
    alone = replace(
        first, imus={"imu0": own}, frame="gyro-x", uncertainty=Covariance(names=names, matrix=np.diag(variance))
    )
    known = gather_prior(alone, ImuOptions(), UNITS)
    x = np.concatenate([first.parameter(path).ravel() for path in _paths(first)] + [np.zeros(12)])
    precision, information = known.quadratic(x)
    assert np.linalg.matrix_rank(precision[12:21, 12:21], tol=1e-9 * np.abs(precision[12:21, 12:21]).max()) == 6
    np.testing.assert_allclose(precision @ x, information, atol=1e-6 * np.abs(information).max())
    in_letters = known_imu(evidence_of_imu(alone, first.gravity, "imu0", first=True))
    assert in_letters is not None
    assert in_letters.covariance is not None
    sigma = np.sqrt(np.diag(in_letters.covariance))
    assert (sigma[6:12] > 0).all()
    assert not sigma[12:15].any(), "the rotation from gyroscope to body is not known"


def _paths(calibration: Calibration) -> list[str]:
    return list(dict.fromkeys(name.partition("[")[0] for name in calibration.uncertainty.names))


def test_gravity_that_both_got_wrong_counts_once() -> None:
    made, _ = recording(3)
    one = calibrate_imu(made, ImuOptions(model="g-sensitivity")).calibration
    two = calibrate_imu(recording(4)[0], ImuOptions(model="g-sensitivity"), prior=one).calibration
    shared = one.gravity.sigma / one.gravity.value * one.parameter(SENSITIVITY)[0, 0]
    assert two.sigma(SENSITIVITY)[0, 0] > 0.99 * shared, "two recordings at one place know gravity no better than one"


def test_a_calibration_enters_the_camera_imu_estimation() -> None:
    made = simulate_camera_imu(CameraImuScenario(duration_s=15), 3)
    options = CameraImuOptions(gravity=made.scenario.gravity, covariance="ordinary")  # clusters tell sigmas to 10 %
    alone = calibrate_camera_imu(made.recording, made.target, options).calibration
    both = calibrate_camera_imu(made.recording, made.target, options, prior=alone).calibration
    for path in (SENSITIVITY, RATE, "imu0.gyroscope.g_sensitivity"):
        known = alone.sigma(path) > 0
        np.testing.assert_allclose(
            both.sigma(path)[known], alone.sigma(path)[known] / np.sqrt(2), rtol=0.02, err_msg=path
        )
        np.testing.assert_allclose(both.parameter(path), alone.parameter(path), atol=0.02 * alone.sigma(path).max())
    basic = calibrate_camera_imu(made.recording, made.target, replace(options, model="basic"), prior=alone).calibration
    np.testing.assert_allclose(basic.parameter(RATE), alone.parameter(RATE), rtol=1e-12)
    assert not basic.sigma(RATE).any(), "what the model leaves out keeps the prior's value"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"fix": ("imu0.acelerometer.bias",)}, "Did you mean imu0.accelerometer.bias"),
        ({"fix": ("imu0.accelerometer.sensitivity[0,1]",)}, "body frame makes it zero"),
        ({"fix": ("imu0.accelerometer.bias",), "prior": ("imu0.accelerometer=1",)}, "also in --fix"),
        ({"prior": ("calibration.yaml",)}, "in Python: prior=gnomon.load"),
    ],
)
def test_names_that_cannot_be_meant(options: dict[str, tuple[str, ...]], told: str) -> None:
    with pytest.raises(OptionError, match=told):
        gather_prior(None, ImuOptions(**options), UNITS)  # pyright: ignore[reportArgumentType]


def test_counts_have_no_nominal_value() -> None:
    with pytest.raises(OptionError, match="Give a calibration that knows it"):
        gather_prior(None, ImuOptions(fix=("imu0.accelerometer.bias",)), {"accelerometer": "count"})


def test_published_presets_take_no_evidence(first: Calibration, second: tuple[Recording, Calibration]) -> None:
    with pytest.raises(OptionError, match="tedaldi2014 knows neither"):
        calibrate_imu(second[0], ImuOptions(preset="tedaldi2014"), prior=first)


def test_names_are_those_of_a_calibration(first: Calibration) -> None:
    assert NAMES[:33] == first.uncertainty.names
