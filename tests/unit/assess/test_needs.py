"""A calibration judged for a use: what it needs, what there is, and what to do next."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.assess.needs import achieved_quantities, needs_of_use, number_words
from gnomon.errors import OptionError
from gnomon.options.requirements import GENERAL_IMU, USES, Use
from gnomon.results.calibration import Covariance, Gravity


@pytest.fixture(scope="module")
def waved():
    return gnomon.plan(gnomon.CameraImuPlan(duration_s=20.0, camera_rate_hz=10.0), changes=False).calibration


@pytest.fixture(scope="module")
def turned():
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=20, t_init_s=20.0, units="raw"), seed=1)
    return gnomon.calibrate_imu(recording).calibration


def scaled(calibration, factor, *paths):
    """Return a calibration with the standard deviations of some parameters multiplied."""
    names = calibration.uncertainty.names
    size = np.array([factor if name.startswith(paths) else 1.0 for name in names])
    matrix = calibration.uncertainty.matrix * np.outer(size, size)
    return replace(calibration, uncertainty=Covariance(names=names, matrix=matrix))


def need_of(calibration, block):
    return next(need for need in calibration.assessment.trust.needs if need.block == block)


def codes(calibration):
    return [finding.code for finding in calibration.assessment.findings]


def test_every_quantity_of_a_use_is_judged(waved):
    found = gnomon.judge(waved, "vio")
    assert found.verdict == "pass"
    asked = {name for name in USES["vio"].needs if not name.startswith("imu_")}  # there is one IMU
    assert len(found.assessment.trust.needs) == len(asked) == 10
    assert {need.verdict for need in found.assessment.trust.needs} == {"pass"}
    shift = need_of(found, "time shift of cam0")
    assert shift.sigma == pytest.approx(1e3 * float(waved.sigma("cam0.time_shift_cam_imu")), rel=1e-4)
    assert (shift.needed, shift.unit, shift.cure) == (0.25, "ms", "")
    assert found.uncertainty is waved.uncertainty


def test_what_is_too_coarse_warns_and_far_beyond_fails(waved):
    rotation = "cam0.T_cam_imu.rotation"
    worst = float(waved.sigma(rotation).max())
    for factor, verdict in ((0.9, "pass"), (1.5, "warn"), (2.9, "warn"), (3.1, "fail")):
        coarse = scaled(waved, factor * USES["vio"].needs["camera_rotation"] / worst, rotation)
        found = gnomon.judge(coarse, "vio")
        assert found.verdict == verdict
        need = need_of(found, "rotation of cam0 against the IMU")
        assert need.verdict == verdict
        assert bool(need.cure) == (verdict != "pass")
        if verdict != "pass":
            (finding,) = [f for f in found.assessment.findings if f.code == "use-imprecise"]
            assert "vio needs the rotation of cam0 against the IMU to 0.08 deg, and has" in finding.message
            assert finding.cure == need.cure


GOLDEN = Path(__file__).parents[2] / "golden" / "calibration-gnomon-1.5.yaml"


@pytest.mark.parametrize(
    ("path", "quantity", "block"),
    [
        ("imu1.T_imu_body.rotation", "imu_rotation", "rotation of imu1 against imu0"),
        ("imu1.T_imu_body.translation", "imu_translation", "translation of imu1 against imu0"),
        ("imu1.time_shift_imu", "time_shift", "time shift of imu1"),
    ],
)
def test_where_and_when_a_further_imu_is_is_judged_too(path, quantity, block):
    calibration = gnomon.load(GOLDEN)
    worst = float(np.max(calibration.sigma(path)))
    for factor, verdict in ((0.9, "pass"), (2.0, "warn"), (4.0, "fail")):
        coarse = scaled(calibration, factor * USES["vio"].needs[quantity] / worst, path)
        need = need_of(gnomon.judge(coarse, "vio"), block)
        assert need.verdict == verdict
        assert need.sigma == pytest.approx(factor * need.needed, rel=1e-4)
        assert bool(need.cure) == (verdict != "pass")
    assert len({need.block for need in gnomon.judge(calibration, "vio").assessment.trust.needs}) == 23
    held = replace(calibration, assessment=replace(calibration.assessment, held_by_prior=(path,)))
    assert need_of(gnomon.judge(held, "vio"), block).verdict == "fail"
    # Judged for general use again, what is too coarse is said as it was in the first place.
    coarse = gnomon.judge(scaled(calibration, 6e-3 / worst, path), "vio")
    assert [f.message for f in gnomon.judge(coarse, "general").assessment.findings if block in f.message]


def test_one_sentence_says_why_the_verdict_is_not_the_general_one(waved):
    coarse = scaled(waved, 2 * 5e-3 / float(waved.sigma("cam0.T_cam_imu.translation").max()), "cam0.T_cam_imu.trans")
    found = gnomon.judge(coarse, "vio")
    (why,) = [f.message for f in found.assessment.findings if f.code == "use-verdict"]
    assert why.startswith("The verdict for vio is warn, that for general use pass: ")
    assert "use-verdict" not in codes(gnomon.judge(coarse, "phone"))  # 10 mm are enough there, as in general


def test_a_use_that_needs_less_forgives_what_general_use_does_not(turned):
    rough = scaled(turned, 1.0, "none")
    general = replace(
        rough.assessment,
        verdict="warn",
        findings=(
            gnomon.Finding(severity="warning", code="uncertainty-gyroscope", message="scales are known to 0.5 % only"),
        ),
    )
    found = gnomon.judge(replace(rough, assessment=general), "gimbal")
    assert found.verdict == "pass"
    (why,) = [f.message for f in found.assessment.findings if f.code == "use-verdict"]
    assert "is pass, that for general use warn: what general use asks beyond that is not needed for gimbal" in why


def test_what_priors_hold_fails_only_where_it_is_needed():
    plan = gnomon.CameraImuPlan(duration_s=20.0, camera_rate_hz=10.0, motion="one-axis")
    found = gnomon.plan(plan, use="vio", changes=False).calibration
    assert found.verdict == "fail"
    assert need_of(found, "translation of cam0 against the IMU").verdict == "fail"
    only_time = Use(name="stamps", words="stamps", needs={"time_shift": 1e-3})
    judged = gnomon.judge(found, only_time)
    assert judged.verdict == "pass"
    observable = [f for f in judged.assessment.findings if f.code == "not-observable"]
    assert {f.severity for f in observable} == {"info"}


def test_general_takes_back_what_it_was_judged_for(waved):
    for use in USES:
        back = gnomon.judge(gnomon.judge(waved, use), "general")
        assert back.verdict == waved.verdict
        assert not back.assessment.trust.use
        assert not back.assessment.trust.needs
        assert not any(code.startswith("use-") for code in codes(back))
    coarse = scaled(waved, 7e-3 / float(waved.sigma("cam0.T_cam_imu.translation").max()), "cam0.T_cam_imu.trans")
    assert "imprecise" in codes(gnomon.judge(gnomon.judge(coarse, "phone"), "general"))


def test_the_unit_of_the_recording_does_not_matter(turned):
    found = {offer.quantity: offer.sigma for offer in achieved_quantities(turned)}
    size = np.abs(np.linalg.det(turned.imus["imu0"].gyroscope.sensitivity)) ** (1 / 3)
    assert found["gyroscope_bias"] == pytest.approx(turned.sigma("imu0.gyroscope.bias").max() / size, rel=0.2)
    assert 1e-6 < found["gyroscope_bias"] < 1e-2
    assert 1e-5 < found["accelerometer_scale"] < 2e-3


def test_gravity_is_nobodys_fault(turned):
    sigma = {offer.quantity: offer.sigma for offer in achieved_quantities(turned)}["accelerometer_scale"]
    assert turned.gravity.sigma / turned.gravity.value > 1.5e-3
    assert sigma < 5e-4
    stated = replace(turned, gravity=Gravity(value=turned.gravity.value, sigma=0.0, source="as stated"))
    assert {offer.quantity: offer.sigma for offer in achieved_quantities(stated)}["accelerometer_scale"] > 1.5e-3


def test_an_imu_alone_is_told_how_many_attitudes_to_add(turned):
    strict = Use(name="strict", words="strict", needs={"accelerometer_misalignment": 1e-9, "gyroscope_bias": 1e-9})
    cures = [need.cure for need in needs_of_use(turned, strict)]
    assert all(cures)
    coarse = scaled(turned, 50.0, "imu0.accelerometer.sensitivity")  # so that what one recording cannot know is small
    scale = {offer.quantity: offer.sigma for offer in achieved_quantities(coarse)}["accelerometer_scale"]
    nearly = Use(name="nearly", words="nearly", needs={"accelerometer_scale": scale / 1.5})
    (need,) = needs_of_use(coarse, nearly)
    assert need.verdict == "warn"
    assert need.cure.startswith("Add 25 attitudes, spread over the sphere")


def test_what_was_not_estimated_is_not_called_known():
    plan = gnomon.CameraImuPlan(duration_s=10.0, camera_rate_hz=10.0, model="basic")
    found = gnomon.plan(plan, use="vio", changes=False).calibration
    blocks = {need.block for need in found.assessment.trust.needs}
    assert "gyroscope scale" not in blocks
    (finding,) = [f for f in found.assessment.findings if f.code == "use-not-estimated"]
    assert "gyroscope scale" in finding.message
    assert "gyroscope g-sensitivity" in finding.message


def test_a_magnetometer_tells_the_heading():
    # Sensors that are drawn from the covariance show the level field, 60 deg inclined, with the heading that is stated.
    _, truth = gnomon.simulate_magnetometer(gnomon.FieldScenario(duration_s=2.0), seed=1)
    names, rng = truth.uncertainty.names, np.random.default_rng(1)
    magnetic = [i for i, name in enumerate(names) if ".magnetometer." in name]
    matrix = np.zeros((len(names), len(names)))
    root = np.diag([0.004] * 9 + [0.2] * 3) @ (np.eye(12) + 0.2 * rng.normal(size=(12, 12)))
    matrix[np.ix_(magnetic, magnetic)] = root @ root.T
    calibration = replace(truth, uncertainty=Covariance(names=names, matrix=matrix))
    heading = need_of(gnomon.judge(calibration, "ahrs"), "heading by the magnetometer")
    magnetometer = truth.imus["imu0"].magnetometer
    spread = []
    for angle in np.radians(np.arange(0, 360, 15)):
        field = 48.0 * np.array([0.5 * np.cos(angle), -0.5 * np.sin(angle), -np.sqrt(0.75)])
        draws = (root @ rng.normal(size=(12, 4000))).T
        read = (magnetometer.sensitivity + draws[:, :9].reshape(-1, 3, 3)) @ field + magnetometer.bias + draws[:, 9:]
        seen = (read - magnetometer.bias) @ np.linalg.inv(magnetometer.sensitivity).T
        error = np.degrees(np.arctan2(-seen[:, 1], seen[:, 0]) - angle)
        spread.append(np.std((error + 180) % 360 - 180))
    assert heading.unit == "deg"
    assert heading.sigma == pytest.approx(max(spread), rel=0.05)


def test_general_thresholds_are_those_of_the_verdict(turned):
    assert {need.verdict for need in needs_of_use(turned, GENERAL_IMU)} == {"pass"}
    assert turned.verdict == "pass"


def test_an_unknown_use_is_refused(turned):
    with pytest.raises(OptionError, match="Did you mean gimbal"):
        gnomon.judge(turned, "gimball")


def test_numbers_are_short():
    assert [number_words(x) for x in (0.1234, 12.34, 168.2)] == ["0.12", "12", "168"]


def test_a_sensor_that_was_not_recorded_is_missed():
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=20, t_init_s=20.0), seed=1)
    imu = recording.imus["imu0"]
    nothing = replace(imu.gyroscope, t_ns=imu.gyroscope.t_ns[:0], values=imu.gyroscope.values[:0])
    alone = replace(recording, imus={"imu0": replace(imu, gyroscope=nothing)})
    calibration = gnomon.calibrate_imu(alone).calibration
    (found,) = (f for f in gnomon.judge(calibration, "vio").assessment.findings if f.code == "use-not-estimated")
    assert "the gyroscope scale, the gyroscope axes" in found.message
    assert found.severity == "warning"
    assert "use-not-estimated" not in codes(calibration)
