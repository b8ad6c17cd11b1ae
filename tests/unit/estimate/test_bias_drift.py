"""Polynomials of the temperature against simulated warm-ups whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.estimate.temperature.bias_drift import (
    DriftProblem,
    DriftVariances,
    WarmUp,
    choose_order,
    left_out_deviations,
)
from gnomon.simulate.scenarios.recorded import TemperatureScenario
from gnomon.simulate.temperature import simulate_temperature


def errors_in_sigmas(result, truth, at_degc):
    """Return how far the change between temperatures of each axis lies off the truth, in sigmas."""
    calibration = result.calibration
    found = calibration.imus["imu0"].temperature
    z = []
    for triad in ("gyroscope", "accelerometer"):
        part = f"{triad}_bias"
        if getattr(found, part) is None:
            continue
        order = len(getattr(found, part))
        off = found.change(part, at_degc) - truth.change(part, at_degc)
        off += truth.change(part, np.array([found.reference_degc]))
        powers = np.vander(at_degc - found.reference_degc, order + 1, increasing=True)[:, 1:]
        covariance = calibration.covariance(f"imu0.temperature.{part}")
        for axis in range(3):
            mine = covariance[axis::3, axis::3]
            z.append(off[:, axis] / np.sqrt(np.einsum("ij,jk,ik->i", powers, mine, powers)))
    return np.array(z)


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("order", "lag_s", "step_k", "seed"), [(2, 20.0, 0.1, 2), (1, 0.0, 0.1, 1), (3, 0.0, 0.5, 3), (2, 40.0, 0.01, 4)]
)
def test_order_lag_and_polynomials_are_found_within_their_sigmas(order, lag_s, step_k, seed):
    scenario = TemperatureScenario(recordings=3, order=order, lag_s=lag_s, step_k=step_k, rate_hz=20.0)
    made = simulate_temperature(scenario, seed)
    result = gnomon.calibrate_temperature(made.recordings)
    assert {triad.order for triad in result.triads.values()} == {order}
    assert abs(result.lag_s - lag_s) < 4 * max(result.lag_sigma_s, 1.0)
    z = errors_in_sigmas(result, made.truth, np.array([5.0, 35.0]))
    assert np.sqrt(np.mean(z**2)) < 2.0
    assert np.abs(z).max() < 4.5
    assert result.calibration.verdict == "pass"


def test_where_nothing_changes_nothing_is_found():
    made = simulate_temperature(TemperatureScenario(recordings=2, order=0, rate_hz=10.0, duration_s=600.0), 5)
    result = gnomon.calibrate_temperature(made.recordings)
    assert {triad.order for triad in result.triads.values()} == {0}
    assert result.lag_s == 0.0
    assert not dict(result.calibration.imus["imu0"].temperature.parts())


def test_a_narrow_range_is_told_and_taken_for_nothing():
    scenario = TemperatureScenario(recordings=1, start_degc=24.5, end_degc=25.0, rate_hz=10.0, duration_s=600.0)
    result = gnomon.calibrate_temperature(simulate_temperature(scenario, 7).recordings)
    codes = {finding.code for finding in result.calibration.assessment.findings}
    assert {"temperature-range", "turn-on-unknown", "sensor-nominal"} <= codes
    assert result.calibration.verdict == "warn"


@pytest.mark.long
def test_rising_and_falling_that_differ_are_named():
    scenario = TemperatureScenario(recordings=2, back=True, rate_hz=20.0, order=1, branches=4e-3, duration_s=1800.0)
    made = simulate_temperature(scenario, 8)
    result = gnomon.calibrate_temperature(made.recordings)
    assert "temperature-branches" in {finding.code for finding in result.calibration.assessment.findings}
    plain = TemperatureScenario(recordings=2, back=True, rate_hz=20.0, order=1, duration_s=1800.0)
    healthy = gnomon.calibrate_temperature(simulate_temperature(plain, 8).recordings)
    assert "temperature-branches" not in {finding.code for finding in healthy.calibration.assessment.findings}


@pytest.mark.long
def test_the_range_is_that_of_the_sensor_not_of_a_thermometer_that_lags():
    scenario = TemperatureScenario(
        recordings=2, order=1, lag_s=60.0, start_degc=0.0, rate_hz=10.0, duration_s=900.0, back=True,
        time_constant_s=120.0,
    )  # fmt: skip
    made = simulate_temperature(scenario, 9)
    result = gnomon.calibrate_temperature(made.recordings)
    true = float(max(one.max() for one in made.degc))
    read = max(float(one.imus["imu0"].temperature.values.max()) for one in made.recordings)
    assert read < true - 0.4
    assert abs(result.high_degc - true) < 0.25


@pytest.mark.parametrize(
    ("start_degc", "end_degc", "sign", "severity"),
    [(0.0, 60.0, -1, "warning"), (0.0, 60.0, 1, None), (60.0, 22.0, 1, "info"), (22.0, -20.0, 1, "info")],
    ids=["backwards", "warm-up", "oven to room", "room to freezer"],
)
def test_a_thermometer_that_counts_backwards_is_told_from_a_sensor_that_cools(start_degc, end_degc, sign, severity):
    scenario = TemperatureScenario(
        recordings=2, order=0, rate_hz=10.0, duration_s=600.0, start_degc=start_degc, end_degc=end_degc
    )
    recordings = []
    for one in simulate_temperature(scenario, 10).recordings:
        imu = one.imus["imu0"]
        read = replace(imu.temperature, values=sign * imu.temperature.values)
        recordings.append(gnomon.Recording(imus={"imu0": replace(imu, temperature=read)}))
    findings = gnomon.calibrate_temperature(recordings).calibration.assessment.findings
    assert next((one.severity for one in findings if one.code == "temperature-falls"), None) == severity


def test_a_temperature_that_changes_by_rounding_alone_has_no_trend():
    values = np.random.default_rng(0).normal(size=(40, 1))
    variances = DriftVariances(white=50.0, walk=1e-6, turn_on=0.1, reading=0.0)
    found = []
    for other in (25.02, np.nextafter(25.02, 26)):
        degc = np.where(np.arange(40) % 2, 25.02, other)
        one = WarmUp(t_s=np.arange(40) * 5.0, degc=degc, step_k=0.0, samples=np.full(40, 50.0), values=values)
        found.append(left_out_deviations(DriftProblem(warm_ups=[one, one], reference_degc=25.0), 0, 0, variances))
    assert np.allclose(found[0], found[1], rtol=1e-6)


@pytest.mark.long
def test_a_lag_is_found_beside_a_line_without_a_cubic_that_hides_it():
    scenario = TemperatureScenario(
        recordings=3, order=1, lag_s=60.0, step_k=0.5, rate_hz=10.0, duration_s=900.0, time_constant_s=133.0
    )
    result = gnomon.calibrate_temperature(simulate_temperature(scenario, 12).recordings)
    assert abs(result.lag_s - 60.0) < 6.0


def lagging(truth, seed=0):
    """Warm-ups of three axes whose `truth` is of the temperature and of that by a longer lag."""
    rng = np.random.default_rng(seed)
    t_s = np.linspace(0.0, 900.0, 40)
    degc = 25 - 25 * np.cos(np.pi * t_s / 900)
    longer = degc + 6.0 * np.gradient(degc, t_s)
    parts = [truth(degc, longer) + rng.normal(0.0, 1e-6, (40, 3)) for _ in range(3)]
    warm_ups, nearby = (
        [WarmUp(t_s=t_s, degc=at, step_k=0.01, samples=np.full(40, 100.0), values=values) for values in parts]
        for at in (degc, longer)
    )
    return DriftProblem(warm_ups=warm_ups, reference_degc=25.0, nearby=nearby)


@pytest.mark.parametrize(
    ("truth", "order"),
    [
        (lambda degc, longer: np.stack([1e-4 * degc, 1e-3 * degc + 1e-6 * degc**2, 1e-3 * degc], axis=1), 2),
        (lambda degc, longer: np.stack([1e-4 * longer, 1e-3 * longer, 1e-3 * longer], axis=1), 1),
    ],
    ids=["one axis alone is bent", "a wrong lag bends all"],
)
def test_a_curve_is_put_down_to_the_lag_only_where_it_would_bend_all_axes(truth, order):
    variances = [DriftVariances(white=1e-10, walk=1e-14, turn_on=1e-12, reading=0.0)] * 3
    assert choose_order(lagging(truth), (0, 1, 2), 2, variances) == order
