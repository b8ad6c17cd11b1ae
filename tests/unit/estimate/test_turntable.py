"""The gyroscope on a turntable: steady parts, their speeds, the platter's axis, the drift, and what is said."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import ImuNoise
from gnomon.calibrate.turntable import calibrate_turntable
from gnomon.detect.samples.faults import saturated_samples
from gnomon.detect.samples.steady import find_steady, largest_rate
from gnomon.errors import DetectionError, OptionError, SolveError
from gnomon.estimate.turntable.parts import NO_SPEED, ForceBlocks, assign_speeds, axis_in_sensor, drift_at
from gnomon.options import StatedRate, TurntableOptions
from gnomon.simulate import TurntableScenario, simulate_turntable

RPM = np.pi / 30
QUICK = {"steady_s": 12.0, "rest_s": 4.0}


def stated(rpm, sigma=1e-3):
    return StatedRate(name=f"{rpm:g}rpm", rate_rad_s=rpm * RPM, sigma_rad_s=sigma * rpm * RPM)


def calibrated(scenario, *rates, seed=0, recordings=slice(None), **options):
    simulation = simulate_turntable(scenario, seed)
    rates = rates or [stated(rpm) for rpm in scenario.rpm]
    result = calibrate_turntable(simulation.recordings[recordings], rates, TurntableOptions(**options))
    return result, simulation


def codes(result):
    return {finding.code: finding for finding in result.calibration.assessment.findings}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"units": "raw"},
        {"wow": 0.005, "units": "raw"},
        {"files": "each"},
        {"rpm": (16.0, 33.333), "gyroscope_range": 5.0},
        {"steady_s": 8.0, "rest_s": 3.0, "handling_s": 2.0},
    ],
)
def test_steady_parts_are_those_that_were_steady(changes):
    simulation = simulate_turntable(TurntableScenario(**{**QUICK, **changes}), seed=1)
    streams = [recording.imus["imu0"].gyroscope for recording in simulation.recordings]
    size = largest_rate(streams)
    found = []
    for k, samples in enumerate(streams):
        steady = find_steady(samples, saturated_samples(samples), size)
        assert not steady.clipped.any()
        found += [(k, a, b) for a, b in zip(steady.intervals.start / 100, steady.intervals.stop / 100, strict=True)]
    assert len(found) == len(simulation.parts)
    for (k, start, stop), true in zip(found, simulation.parts, strict=True):
        # a speed that is approached exponentially counts as kept when nothing is left to see of the change
        assert k == true.recording
        assert true.start_s - 7.0 < start < stop < true.stop_s + 8.5
        assert min(stop, true.stop_s) - max(start, true.start_s) > 0.4 * (true.stop_s - true.start_s)


def test_parts_at_the_end_of_the_range_are_marked():
    simulation = simulate_turntable(TurntableScenario(rpm=(33.333,), **QUICK), seed=1)
    samples = simulation.recordings[0].imus["imu0"].gyroscope  # 200 deg/s, of 150
    steady = find_steady(samples, saturated_samples(samples), largest_rate([samples]))
    assert 10 <= steady.clipped.sum() < 18  # where no axis is along the platter's it is not reached


@pytest.mark.parametrize("unit_rad_s", [1.0, None])
@pytest.mark.parametrize("rests", [0, 12])
def test_speeds_are_told_by_magnitude_whatever_the_unit(unit_rad_s, rests):
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((40, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    speeds = np.array([33.333, 45.0, 0.0]) * RPM
    true = np.concatenate([np.tile([0, 1], 20), np.full(rests, 2)])
    rate = np.concatenate([speeds[true[:40], None] * axes, np.zeros((rests, 3))])
    size, zero = (1.0, 0.01) if unit_rad_s else (4200.0, 32768.0)
    means = size * rate * [0.94, 1.0, 1.06] + zero
    found = assign_speeds(means, speeds, np.ones((len(means), 3), bool), unit_rad_s)
    assert np.array_equal(found.index, true)


def test_a_part_of_another_speed_has_none():
    speeds = np.array([16.0, 0.0]) * RPM
    means = np.array([[1.7, 0, 0], [0, 1.65, 0], [0, 0, 3.5], [0, 0, 0.0]])
    found = assign_speeds(means, speeds, np.ones((4, 2), bool), 1.0)
    assert found.index.tolist() == [0, 0, NO_SPEED, 1]


@pytest.mark.parametrize("gyroscope_scale", [1.0, 1.013])
def test_the_platters_axis_is_free_of_tilt_and_centripetal_acceleration(gyroscope_scale):
    rate, block_s = 3.5, 0.125
    turning = np.arange(0, 40.0, block_s)
    t = np.concatenate([np.arange(-5.0, 0, block_s), turning, np.arange(40.0, 45.0, block_s)]) + block_s / 2
    omega = np.where((t > 0) & (t < 40), rate, 0.0)
    angle = np.clip(t, 0, 40) * rate
    up, pull, tilt = np.array([1.0, 2.0, 9.5]), np.array([-1.2, 0.4, 0.0]), 9.8 * np.radians(1.0)
    wave = np.sinc(omega * block_s / (2 * np.pi))
    force = up + np.outer((omega / rate) ** 2, pull)
    force += tilt * wave[:, None] * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    noise = 0.005 * np.random.default_rng(0).standard_normal(force.shape)
    found = axis_in_sensor(ForceBlocks(force=force + noise, angle=gyroscope_scale * angle, rate=omega, block_s=block_s))
    assert found.separated
    error = np.abs(found.upright - up)
    assert np.all(error < 4 * np.sqrt(found.variance))
    assert error.max() < 4e-3  # tilt 0.17, centripetal acceleration 1.2
    assert np.allclose(np.linalg.norm(found.tilt), tilt * np.sqrt(2), rtol=0.02)


def test_drift_is_followed_where_the_rests_show_it_and_nowhere_else():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 1500, 54))
    at_rest = np.arange(54) % 3 != 1
    noise = np.full((54, 3), 3e-4**2)
    white = 3e-4 * rng.standard_normal((54, 3))
    assert drift_at(t, white, noise, at_rest) is None
    stayed = drift_at(t, white, noise, at_rest, stated=1e-16)  # a walk of 4e-7 over the session: no drift to speak of
    assert stayed is not None
    assert np.abs(stayed[0]).max() < 1e-5
    ramp = 0.01 * (t / 1500 - 0.5)[:, None]
    drift, variance = drift_at(t, white + ramp, noise, at_rest)
    expected = ramp - ramp[at_rest].mean()
    assert np.sqrt(np.mean((drift - expected) ** 2)) < 4e-4
    assert np.sqrt(np.mean((drift - expected) ** 2 / variance)) < 1.5


def test_with_the_accelerometer_the_frames_relate():
    result, simulation = calibrated(TurntableScenario(**QUICK, units="raw", counter_clockwise=True), gravity=9.80665)
    calibration, truth = result.calibration, simulation.truth
    assert calibration.verdict == "pass"
    assert calibration.frame == truth.frame == "accel-x"
    for path in ("imu0.gyroscope.sensitivity", "imu0.gyroscope.bias", "imu0.accelerometer.sensitivity"):
        error, sigma = calibration.parameter(path) - truth.parameter(path), calibration.sigma(path)
        assert np.all(np.abs(error) <= 4.5 * sigma)
    assert "counterclockwise" in codes(result)["frames"].message


def test_alone_the_result_says_that_nothing_relates_its_frame():
    result, simulation = calibrated(TurntableScenario(**QUICK, accelerometer=False))
    calibration = result.calibration
    assert calibration.frame == "gyro-x"
    assert calibration.imus["imu0"].accelerometer is None
    assert "do not relate" in codes(result)["frames-unrelated"].message
    error = calibration.parameter("imu0.gyroscope.sensitivity") - simulation.truth.parameter(
        "imu0.gyroscope.sensitivity"
    )
    assert np.all(np.abs(error) <= 4.5 * calibration.sigma("imu0.gyroscope.sensitivity"))


def test_with_the_speed_unknown_what_is_lost_is_said():
    scenario = TurntableScenario(**QUICK, rate_error=0.03, accelerometer=False)
    result, simulation = calibrated(scenario, stated(16), free=("rate.scale",))
    calibration = result.calibration
    assert calibration.verdict == "warn"
    assert "common factor" in codes(result)["rate-unknown"].message
    found = calibration.parameter("imu0.gyroscope.sensitivity")
    true = simulation.truth.parameter("imu0.gyroscope.sensitivity")
    assert np.allclose(found / np.linalg.det(found) ** (1 / 3), true / np.linalg.det(true) ** (1 / 3), atol=2e-3)
    assert np.isclose(
        np.linalg.det(found / true.max()) ** (1 / 3) / np.linalg.det(true / true.max()) ** (1 / 3), 1.03, 2e-3
    )
    assert calibration.sigma("imu0.gyroscope.sensitivity")[0, 0] > 0.03  # no measurement of the common scale


def test_speeds_that_contradict_each_other_are_named():
    scenario = TurntableScenario(**QUICK, rpm=(33.333, 45.0), gyroscope_range=8.0, accelerometer=False)
    result, _ = calibrated(scenario, stated(33.333), stated(43.0))
    assert result.calibration.verdict == "fail"
    assert "ratio" in codes(result)["rates-contradict"].message


@pytest.mark.parametrize(
    "platter", [{}, {"wow": 0.01}, {"speed_scatter": 0.003}, {"tilt_deg": 3.0}, {"rpm": (33.5, 45.2)}], ids=str
)
def test_a_platter_that_is_not_ideal_moves_nothing_beyond_its_sigmas(platter):
    scenario = TurntableScenario(**{**QUICK, "rpm": (33.33, 45.0), "gyroscope_range": 17.0, **platter})
    result, simulation = calibrated(scenario, stated(33.33, 1e-2), stated(45.0, 1e-2), gravity=9.80665, seed=31)
    for path in ("imu0.gyroscope.sensitivity", "imu0.gyroscope.bias"):
        error = result.calibration.parameter(path) - simulation.truth.parameter(path)
        assert np.all(np.abs(error) < 4 * result.calibration.sigma(path))


def test_without_a_part_that_turned_nothing_is_calibrated():
    """Beyond its full scale of 2.6 rad/s the gyroscope shows no speed; what seems steady contradicts itself."""
    scenario = TurntableScenario(rpm=(33.33, 45.0), wow=0.01)
    with pytest.raises(SolveError, match="Check the stated speeds, the full scale of the gyroscope"):
        calibrated(scenario, stated(33.33, 1e-2), stated(45.0, 1e-2), seed=31)


def test_a_rate_that_belongs_to_one_file():
    scenario = TurntableScenario(**QUICK, files="each", rpm=(16.0,), accelerometer=False)
    simulation = simulate_turntable(scenario, 3)
    rate_of = [stated(16)] * 17 + [stated(33.333)]
    result = calibrate_turntable(simulation.recordings, [], rate_of=rate_of)
    out = codes(result)["parts-left-out"].message
    assert "recording 18" in out
    assert "no stated speed" in out
    assert result.calibration.assessment.intervals_used == 53


def test_a_g_sensitivity_is_found_and_one_that_is_not_there_is_not():
    there = TurntableScenario(**QUICK, rpm=(16.0, 33.333), gyroscope_range=5.0, g_sensitivity=5e-4)
    result, simulation = calibrated(there, gravity=9.80665)
    assert result.calibration.assessment.model == "g-sensitivity"
    path = "imu0.gyroscope.g_sensitivity"
    error = result.calibration.parameter(path) - simulation.truth.parameter(path)
    assert np.all(np.abs(error) < 4.5 * result.calibration.sigma(path))
    assert calibrated(TurntableScenario(**QUICK))[0].calibration.assessment.model == "basic"


def test_a_prior_calibration_counts():
    first, _ = calibrated(TurntableScenario(**QUICK, sensor_seed=1), stated(16, 1e-4), seed=1, gravity=9.80665)
    simulation = simulate_turntable(TurntableScenario(**QUICK, sensor_seed=1), 2)
    options = TurntableOptions(gravity=9.80665)
    alone = calibrate_turntable(simulation.recordings, [stated(16)], options).calibration
    both = calibrate_turntable(simulation.recordings, [stated(16)], options, prior=first.calibration).calibration
    path = "imu0.gyroscope.sensitivity"
    assert np.all(both.sigma(path).diagonal() < 0.3 * alone.sigma(path).diagonal())
    assert np.all(np.abs(both.parameter(path) - simulation.truth.parameter(path)) < 4.5 * both.sigma(path))


def test_what_is_stated_by_name_counts_and_a_contradiction_is_named():
    scenario = TurntableScenario(**QUICK, sensor_seed=1)
    simulation = simulate_turntable(scenario, 2)
    bias = simulation.truth.parameter("imu0.gyroscope.bias")

    def told(**options):
        options = TurntableOptions(gravity=9.80665, **options)
        return calibrate_turntable(simulation.recordings, [stated(16)], options)

    loose = told(prior=("imu0.gyroscope.bias=0.02",))
    assert {"prior-used"} == codes(loose).keys() & {"prior-used", "prior-disagrees"}
    held = told(fix=("imu0.gyroscope.bias",))
    assert not held.calibration.parameter("imu0.gyroscope.bias").any()
    assert not held.calibration.sigma("imu0.gyroscope.bias").any()
    tight = told(prior=("imu0.gyroscope.bias=1e-6",))
    assert np.abs(bias).max() > 1e-3
    assert "imu0.gyroscope.bias" in codes(tight)["prior-disagrees"].message


def test_a_stated_random_walk_is_reckoned_with():
    scenario = TurntableScenario(**QUICK, sensor_seed=1)
    simulation = simulate_turntable(scenario, 2)
    noise = ImuNoise(
        accelerometer_noise_density=1e-3,
        accelerometer_random_walk=1e-4,
        gyroscope_noise_density=1e-3,
        gyroscope_random_walk=1e-4,
    )
    samples = simulation.recordings[0].imus["imu0"]
    noted = replace(simulation.recordings[0], imus={"imu0": replace(samples, noise=noise)})
    options = TurntableOptions(gravity=9.80665)
    with_walk = calibrate_turntable([noted], [stated(16)], options).calibration
    without = calibrate_turntable(simulation.recordings, [stated(16)], options).calibration
    assert np.all(with_walk.sigma("imu0.gyroscope.bias") > 1.2 * without.sigma("imu0.gyroscope.bias"))
    difference = with_walk.parameter("imu0.gyroscope.bias") - without.parameter("imu0.gyroscope.bias")
    assert np.all(np.abs(difference) < 3 * with_walk.sigma("imu0.gyroscope.bias"))


BAD = [
    ({}, [stated(0)], OptionError, "bias"),
    ({"rpm": (0.0,)}, [stated(16)], DetectionError, "never turned"),
    ({"rpm": (0.0,), "units": "raw"}, [stated(16)], DetectionError, "never turned"),
    ({"poses": 1}, [stated(16)], DetectionError, "one orientation"),
    ({"poses": 1, "units": "raw"}, [stated(16)], DetectionError, "one orientation"),
    ({"rpm": (78.0,), "gyroscope_range": np.radians(250)}, [stated(78)], DetectionError, "468 deg/s"),
    ({"rpm": (33.333,), "gyroscope_range": 5.0}, [stated(16)], DetectionError, "no steady part turns at 16rpm"),
    ({"steady_s": 0.4, "rest_s": 0.2, "spin_up_s": 0.05}, [stated(16)], DetectionError, "no steady part found"),
]


@pytest.mark.parametrize(("changes", "rates", "kind", "words"), BAD)
def test_what_cannot_be_calibrated_is_refused_in_words(changes, rates, kind, words):
    scenario = TurntableScenario(**{**QUICK, **changes})
    with pytest.raises(kind, match=words):
        calibrated(scenario, *rates)


def scaled(simulation, factor):
    """Return the recordings of a sensor that shows so many times what it should, axis by axis."""
    found = []
    for recording in simulation.recordings:
        imu = recording.imus["imu0"]
        values = imu.gyroscope.values * factor
        found.append(replace(recording, imus={"imu0": replace(imu, gyroscope=replace(imu.gyroscope, values=values))}))
    return found


@pytest.mark.parametrize("factor", [0.72, 0.9, 1.35])
def test_a_scale_that_is_far_off_is_found_by_the_ratio_of_the_speeds(factor):
    scenario = TurntableScenario(rpm=(33.3333, 45.0), steady_s=8.0, poses=12, gyroscope_range=10.0)
    simulation = simulate_turntable(scenario, 3)
    by_axis = factor * np.array([0.97, 1.0, 1.05])
    result = calibrate_turntable(scaled(simulation, by_axis), [stated(33.3333), stated(45.0)])
    assessment = result.calibration.assessment
    assert assessment.intervals_used == assessment.intervals_found
    name = "imu0.gyroscope.sensitivity"
    ratio = result.calibration.parameter(name) / (by_axis[:, None] * simulation.truth.parameter(name))
    np.testing.assert_allclose(np.diag(ratio), 1, atol=0.01)


@pytest.mark.parametrize(("rpm", "sigma"), [(33.33, 0.01), (33.5, 0.01), (45.0, 0.01), (78.0, 0.01), (33.42, 1e-3)])
def test_a_label_is_known_to_a_percent(rpm, sigma):
    rate = StatedRate(name="label", rate_rad_s=rpm * RPM)
    assert rate.sigma_rad_s == pytest.approx(sigma * rpm * RPM)
    assert StatedRate(name="exact", rate_rad_s=rpm * RPM, sigma_rad_s=0.0).sigma_rad_s == 0


def test_the_sigma_of_a_label_is_that_of_the_scales():
    simulation = simulate_turntable(TurntableScenario(**QUICK, rate_error=0.012), 0)
    result = calibrate_turntable(simulation.recordings, [StatedRate(name="16rpm", rate_rad_s=16 * RPM)])
    name = "imu0.gyroscope.sensitivity"
    error = np.diag(result.calibration.parameter(name) - simulation.truth.parameter(name))
    assert np.all(np.abs(error) < 2 * np.diag(result.calibration.sigma(name)))
    assert np.all(np.abs(error) > 0.5 * np.diag(result.calibration.sigma(name)))
