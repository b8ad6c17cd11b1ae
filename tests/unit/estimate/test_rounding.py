"""What a converter's steps do to means at rest; sensors that are quieter than their steps."""

import numpy as np
import pytest

import gnomon
from gnomon.estimate.multiposition.noise_levels import averaging_time, rounding_variance
from gnomon.recording import smallest_steps
from gnomon.results.calibration import calibration_parameters
from gnomon.results.result import StaticIntervals


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.25, 0.5, 1.0])
def test_rounding_of_means_scatters_as_predicted(noise):
    rng = np.random.default_rng(3)
    count, length = 400, 1000
    true = rng.uniform(-50, 50, (count, 1, 3))
    values = 0.25 * np.rint((true + noise * rng.standard_normal((count, length, 3))) / 1.0)
    error = values.mean(axis=1) - 0.25 * true[:, 0]
    still = StaticIntervals(start=np.arange(count) * length, stop=np.arange(1, count + 1) * length)
    flat = values.reshape(-1, 3)
    white = 0.25**2 * (noise**2 + 1 / 12 * (noise > 0)) / length
    predicted = rounding_variance(flat, still).mean(axis=0)
    assert smallest_steps(flat) == pytest.approx(0.25)
    measured = error.var(axis=0)
    assert np.all(measured < 1.5 * predicted + 1.5 * white)
    assert np.all(predicted < 2.0 * measured + white)


@pytest.mark.parametrize(
    ("white", "tremor"), [(0.0, 0.0), (0.12, 0.0), (0.2, 0.0), (0.03, 0.2), (0.05, 0.5), (0.05, 0.8)]
)
def test_a_bias_between_two_steps_is_off_as_predicted(white, tremor):
    # All rests read the same part of a step: more of them do not help.
    rng = np.random.default_rng(5)
    count, length, tries = 40, 200, 15
    still = StaticIntervals(start=np.arange(count) * length, stop=np.arange(1, count + 1) * length)
    t_s = np.arange(count * length)[:, None] / 100
    squares, predicted = [], []
    for _ in range(tries):
        bias, hz, phase = rng.uniform(-50, 50, 3), rng.uniform(0.3, 9, 3), rng.uniform(0, 6, 3)
        noise = white * rng.standard_normal((len(t_s), 3)) + tremor * np.sin(2 * np.pi * hz * t_s + phase)
        values = np.rint(bias + noise)
        turned = np.concatenate([values, values[:1] + np.arange(50)[:, None]])  # a rotation, which shows the step
        squares.append(np.square((values - noise).mean(axis=0) - bias))
        predicted.append(rounding_variance(turned, still).mean(axis=0))
    assert np.mean(squares) < 1.6 * np.mean(predicted)
    assert np.max(np.divide(squares, predicted)) < 4.0**2
    assert np.mean(predicted) < 0.09


def test_steps_are_seen_behind_the_arithmetic_of_a_conversion():
    counts = np.random.default_rng(0).integers(-5, 5, (500, 3)).astype(float)
    values = 0.061 * counts + 100.0
    values[7] = (counts[7] * 61.0 + 100_000.0) / 1000.0
    assert smallest_steps(values) == pytest.approx(0.061)


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_quieter_than_its_steps_is_no_better_known_than_a_step(seed):
    scenario = gnomon.Scenario(
        intervals=20,
        t_init_s=5.0,
        rate_hz=50.0,
        units="raw",
        bits=10,
        accelerometer_noise_density=1e-5,
        gyroscope_noise_density=1e-6,
        gyroscope_range=10.0,
        gyroscope_bias=1.0,
    )
    recording, truth = gnomon.simulate(scenario, seed)
    calibration = gnomon.calibrate_imu(recording, gnomon.ImuOptions(gravity=9.80665)).calibration
    found, true = dict(calibration_parameters(calibration.imus)), dict(calibration_parameters(truth.imus))
    sigma = dict(zip(calibration.uncertainty.names, np.sqrt(np.diag(calibration.uncertainty.matrix)), strict=True))
    for path in ("imu0.accelerometer.bias", "imu0.gyroscope.bias"):
        for axis in range(3):
            assert abs(found[path][axis] - true[path][axis]) < 5 * sigma[f"{path}[{axis}]"]
            assert sigma[f"{path}[{axis}]"] > 0.02  # of a count


def test_a_curve_that_falls_to_zero_has_an_averaging_time():
    tau = np.array([0.1, 0.2, 0.4, 0.8])
    assert averaging_time(tau, np.zeros((4, 3))) == 0.1
    assert np.isnan(averaging_time(tau, np.full((4, 3), [[1.0], [0.5], [0.2], [0.0]])))
