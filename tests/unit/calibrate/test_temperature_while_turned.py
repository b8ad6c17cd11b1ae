"""An IMU whose temperature rose and fell while it was turned: what `gnomon imu` and the others make of it."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.temperature_while_turned import rose_and_fell
from gnomon.recording import ImuSamples, Recording, TemperatureSamples
from gnomon.simulate.scenarios.recorded import TemperatureScenario
from gnomon.simulate.temperature import simulate_temperature

SCENARIO = TemperatureScenario(
    turned=True, order=1, sensitivity_order=0, sensitivity_scatter=0.0, recordings=1, intervals=30, rate_hz=50.0,
    self_heating_k=15.0, time_constant_s=60.0, start_degc=20.0, end_degc=40.0, back=True,
)  # fmt: skip


def slopes_of(calibration):
    found = calibration.imus["imu0"].temperature
    return {} if found is None else dict(found.parts())


@pytest.fixture(scope="module")
def both_ways():
    made = simulate_temperature(SCENARIO, 7300)
    return made, gnomon.calibrate_imu(made.recordings[0]).calibration


def drifting(imu: ImuSamples, drift: np.ndarray) -> Recording:
    """Return the recording with biases that drift with time, whatever the temperature does."""
    gyroscope = replace(imu.gyroscope, values=imu.gyroscope.values + 8e-3 * drift[:, None])
    accelerometer = replace(imu.accelerometer, values=imu.accelerometer.values + 5e-2 * drift[:, None])
    return Recording(imus={"imu0": replace(imu, gyroscope=gyroscope, accelerometer=accelerometer)})


def test_slopes_are_those_of_the_sensor(both_ways):
    made, calibration = both_ways
    found = slopes_of(calibration)
    assert set(found) == {"accelerometer_bias", "gyroscope_bias"}
    for part, slopes in found.items():
        sigma = calibration.sigma(f"imu0.temperature.{part}")
        off = slopes - getattr(made.truth, part)
        assert np.abs(off / sigma).max() < 4
        assert sigma.max() < 0.2 * np.abs(slopes).max()


def test_biases_hold_at_the_reference(both_ways):
    made, calibration = both_ways
    reference = calibration.imus["imu0"].temperature.reference_degc
    assert abs(reference - float(calibration.provenance.options["chip_degc"])) < 1
    low, high = map(float, calibration.provenance.options["chip_range_degc"].split(" to "))
    assert low <= reference <= high
    for triad in ("accelerometer", "gyroscope"):
        turn_on = getattr(SCENARIO, f"{triad}_turn_on")
        there = getattr(made.sensor, triad).bias + made.truth.change(f"{triad}_bias", np.array([reference]))[0]
        assert np.abs(getattr(calibration.imus["imu0"], triad).bias - there).max() < 5 * turn_on


def test_the_file_keeps_them(both_ways, tmp_path):
    _, calibration = both_ways
    gnomon.save(calibration, tmp_path / "calibration.yaml")
    read = gnomon.load(tmp_path / "calibration.yaml")
    assert np.allclose(read.uncertainty.matrix, calibration.uncertainty.matrix, rtol=1e-12, atol=0)
    assert read.in_frame("accel-z").imus["imu0"].temperature is not None


def test_a_lagging_thermometer_leaves_the_slopes_right():
    """It reads x with lag x' = T - x: the slopes are those by T, and the lag is found beside them."""
    made = simulate_temperature(replace(SCENARIO, lag_s=20.0), 7304)
    calibration = gnomon.calibrate_imu(made.recordings[0]).calibration
    for part, slopes in slopes_of(calibration).items():
        sigma = calibration.sigma(f"imu0.temperature.{part}")
        assert np.abs((slopes - getattr(made.truth, part)) / sigma).max() < 4
    assert calibration.imus["imu0"].temperature.lag_s == pytest.approx(20.0, abs=4.0)


@pytest.mark.parametrize("course", ["line", "decay", "walk"])
def test_a_drift_with_time_is_no_slope(course):
    imu = simulate_temperature(replace(SCENARIO, order=0), 7301).recordings[0].imus["imu0"]
    t = np.linspace(0, 1, len(imu.gyroscope))
    walk = np.cumsum(np.random.default_rng(1).standard_normal(len(t))) / np.sqrt(len(t))
    drift = {"line": t, "decay": np.exp(-4 * t), "walk": walk}[course]
    assert not slopes_of(gnomon.calibrate_imu(drifting(imu, drift)).calibration)


def test_one_way_tells_no_slope():
    recording = simulate_temperature(replace(SCENARIO, back=False), 7302).recordings[0]
    calibration = gnomon.calibrate_imu(recording).calibration
    assert not slopes_of(calibration)
    assert "chip_degc" in calibration.provenance.options


def test_several_are_joined_at_the_reference(both_ways):
    _, alone = both_ways
    made = simulate_temperature(replace(SCENARIO, recordings=2, end_degc=20.0), 7303)
    joined = gnomon.calibrate_imu(list(made.recordings)).calibration
    assert not slopes_of(joined)
    assert joined.uncertainty.names == alone.at_temperature(25.0).uncertainty.names


@pytest.mark.parametrize(
    ("degc", "known"),
    [
        (np.r_[np.linspace(20, 32, 50), np.linspace(32, 22, 50)], True),
        (np.linspace(20, 32, 100), False),
        (np.r_[np.linspace(20, 32, 90), np.linspace(32, 31, 10)], False),
        (np.full(100, 25.0), False),
        (np.round(np.r_[np.linspace(20, 26, 50), np.linspace(26, 20, 50)] / 2) * 2, False),
    ],
)
def test_only_a_temperature_that_rose_and_fell_counts(degc, known):
    t_ns = np.arange(len(degc)) * 3_000_000_000
    assert rose_and_fell(TemperatureSamples(t_ns=t_ns, values=degc, unit="degC")) == known
