"""What the thermometer shows is told: steady, settling with its time constant, stuck, in a wrong unit."""

import numpy as np
import pytest

from gnomon.assess.imu.temperature import check_temperature, warm_up
from gnomon.recording import TemperatureSamples

T = np.arange(0.0, 600.0, 0.5)


def codes(values, unit="degC") -> list[str]:
    samples = TemperatureSamples(t_ns=(T * 1e9).astype(np.int64), values=values, unit=unit)
    return [finding.code for finding in check_temperature(samples, "imu0 thermometer")]


@pytest.mark.parametrize("tau", [100.0, 250.0, 600.0])
@pytest.mark.parametrize("span", [20.0, -15.0])
@pytest.mark.parametrize("step", [0.01, 1.0])
def test_time_constant_and_what_is_left(tau, span, step) -> None:
    noise = 0.3 * step * np.random.default_rng(1).standard_normal(len(T))
    values = 25 + span * (1 - np.exp(-T / tau))
    found = warm_up(T, step * np.rint((values + noise) / step))
    assert found[0] == pytest.approx(tau, rel=0.15 if step > 0.5 else 0.02)
    assert found[1] == pytest.approx(span * np.exp(-T[-1] / tau), rel=0.3 if step > 0.5 else 0.03, abs=0.1)


def test_a_ramp_and_a_wave_approach_no_end() -> None:
    assert warm_up(T, 20 + 0.01 * T) is None
    assert warm_up(T, 20 + 5 * np.sin(T / 60)) is None


def test_the_wait_is_what_brings_it_within_half_a_kelvin() -> None:
    samples = TemperatureSamples(t_ns=(T * 1e9).astype(np.int64), values=25 - 20 * np.exp(-T / 300), unit="degC")
    (finding,) = check_temperature(samples, "imu0 thermometer")
    wait = 300 * np.log(20 * np.exp(-T[-1] / 300) / 0.5)
    assert float(finding.cure.split("wait ")[1].split()[0]) == pytest.approx(wait, abs=3)


def test_the_wait_for_a_use_is_what_its_biases_need() -> None:
    """Gimbals need 0.02 deg/s, which 0.4 K change, horizons 0.05 deg/s: 1 K. What is left is less than that already."""
    samples = TemperatureSamples(t_ns=(T * 1e9).astype(np.int64), values=25 - 6 * np.exp(-T / 300), unit="degC")
    (finding,) = check_temperature(samples, "imu0 thermometer")
    waits = dict(part.split(" ", 1) for part in finding.cure.rstrip(".").split("kelvin: ")[1].split("; "))
    assert waits["vio"] == "1.0 K, at once"
    near, wait = waits["gimbal"].split(" K, ")
    assert near == "0.4"
    assert float(wait.removesuffix(" s")) == pytest.approx(300 * np.log(6 * np.exp(-T[-1] / 300) / 0.4), abs=6)


@pytest.mark.parametrize(
    ("values", "unit", "found"),
    [
        (np.full(len(T), 25.0), "degC", ["temperature"]),
        (25 + 0.1 * (np.arange(len(T)) % 2), "degC", ["temperature"]),
        (75 + 0.1 * (np.arange(len(T)) % 2), "degC", ["temperature-hot", "temperature"]),
        (75 + 0.1 * (np.arange(len(T)) % 2), "degF", ["temperature"]),
        (297 + 0.1 * (np.arange(len(T)) % 2), "K", ["temperature"]),
        (297 + 0.1 * (np.arange(len(T)) % 2), "degC", ["temperature-implausible"]),
        (np.full(len(T), -4000.0), "count", ["temperature"]),
    ],
)
def test_units_and_stuck_thermometers(values, unit, found) -> None:
    assert codes(values, unit) == found


def test_readings_that_are_no_numbers_are_passed_over() -> None:
    values = 25 + 20 * (1 - np.exp(-T / 100))
    values[::7] = np.nan
    assert codes(values) == ["temperature"]
    assert codes(np.full(len(T), np.nan)) == []
