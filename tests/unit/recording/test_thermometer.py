"""The course of the temperature behind a thermometer's steps, noise and lag."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gnomon.recording import TemperatureSamples
from gnomon.recording.thermometer import temperature_course


def warm_up(step_k, noise_k=0.02, lag_s=0.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 1200.0, 0.02)
    truth = 55 - 35 * np.exp(-t / 200) + 0.3 * np.sin(2 * np.pi * t / 700)
    read = truth
    if lag_s:
        share = 0.02 / lag_s
        read = lfilter([share], [1.0, share - 1.0], truth - truth[0]) + truth[0]
    read = np.round((read + rng.normal(0, noise_k, len(t))) / step_k) * step_k
    return t, truth, TemperatureSamples(t_ns=np.round(1e9 * t).astype(np.int64), values=read, unit="degC")


@pytest.mark.parametrize(("step_k", "within_k"), [(0.01, 0.005), (0.1, 0.03), (0.5, 0.1), (1.0, 0.2)])
@pytest.mark.parametrize("lag_s", [0.0, 30.0])
def test_steps_are_smoothed_away_and_a_known_lag_is_undone(step_k, within_k, lag_s):
    t, truth, samples = warm_up(step_k, lag_s=lag_s)
    course = temperature_course(samples, lag_s)
    off = course.degc - np.interp(course.t_s, t, truth)
    assert np.sqrt(np.mean(off**2)) < within_k
    assert course.step_k == pytest.approx(step_k)


def test_a_lag_that_is_left_in_shows():
    t, truth, samples = warm_up(0.1, lag_s=30.0)
    course = temperature_course(samples)
    assert np.max(np.abs(course.degc - np.interp(course.t_s, t, truth))) > 2.0


def test_a_steady_temperature_stays_as_it_is():
    samples = TemperatureSamples(t_ns=np.array([0, 10**9]), values=np.array([25.0, 25.0]), unit="degC")
    course = temperature_course(samples)
    assert np.allclose(course.at(np.array([-(10**9), 5 * 10**8, 10**10])), 25.0)
    assert np.isnan(course.step_k)


def test_fahrenheit_is_converted_and_counts_tell_nothing():
    t_ns = np.arange(100) * 10**8
    fahrenheit = TemperatureSamples(t_ns=t_ns, values=np.linspace(68.0, 86.0, 100), unit="degF")
    assert temperature_course(fahrenheit).degc[[0, -1]] == pytest.approx([20.0, 30.0], abs=1.0)
    assert temperature_course(TemperatureSamples(t_ns=t_ns, values=np.arange(100.0), unit="count")) is None


def test_bins_with_one_reading_are_as_noisy_as_the_others():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 1200.0, 3.0)  # two or three readings in each bin of 8 s
    truth = 55 - 35 * np.exp(-t / 200)
    read = np.round(truth + rng.normal(0, 0.3, len(t)), 2)
    course = temperature_course(TemperatureSamples(t_ns=np.round(1e9 * t).astype(np.int64), values=read, unit="degC"))
    assert np.sqrt(np.mean((course.degc - np.interp(course.t_s, t, truth)) ** 2)) < 0.1


def test_readings_that_are_no_numbers_are_left_out():
    t, truth, samples = warm_up(0.1)
    values = samples.values.copy()
    values[::3], values[0], values[-1] = np.nan, np.inf, np.nan
    course = temperature_course(TemperatureSamples(t_ns=samples.t_ns, values=values, unit="degC"))
    assert np.sqrt(np.mean((course.degc - np.interp(course.t_s, t, truth)) ** 2)) < 0.03
    nothing = TemperatureSamples(t_ns=samples.t_ns, values=np.full(len(t), np.nan), unit="degC")
    assert temperature_course(nothing) is None
