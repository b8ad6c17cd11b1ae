"""Overlapping Allan variance: its definition, the published curves, and what the fit makes of noise that is known."""

import csv
import warnings

import numpy as np
import pytest
from scipy.signal import fftconvolve

from gnomon.calibrate.noise import identify_noise
from gnomon.estimate.allan import deviation as allan
from gnomon.estimate.allan.deviation import (
    KINDS,
    AllanSums,
    allan_design,
    estimate_covariance,
    line_effect,
    overlapping_allan,
)
from gnomon.estimate.allan.fit import AllanFit
from gnomon.recording import Recording
from gnomon.simulate.scenarios.recorded import NoiseScenario
from gnomon.simulate.sensor import noise_blocks

Q, N, B, K = range(4)


def by_definition(values, m):
    """Return the mean of half the squared differences of neighbouring means over m samples, at every shift."""
    means = fftconvolve(values, np.full(m, 1 / m), "valid")
    return 0.5 * np.mean((means[m:] - means[:-m]) ** 2)


def spectral_flicker(rng, count, instability, paths):
    """Return 1/f noise of spectrum B^2 / (2 pi f), made in the frequency domain, (count, paths)."""
    size = 4 * count
    f = np.arange(1, size // 2 + 1) / size
    half = np.zeros((size // 2 + 1, paths), complex)
    half[1:] = rng.normal(size=(len(f), paths)) + 1j * rng.normal(size=(len(f), paths))
    half[1:] *= instability * np.sqrt(size / 2 / (2 * np.pi * f))[:, None]
    return np.fft.irfft(half, size, axis=0)[:count]


def noise(rng, count, *, q=0.0, n=0.0, b=0.0, k=0.0, r=0.0, paths=3):
    """Return noise of known coefficients for a sample period of one, (count, paths)."""
    values = n * rng.normal(size=(count, paths)) + r * np.arange(count)[:, None]
    values += q * np.diff(rng.normal(size=(count + 1, paths)), axis=0)
    values += np.cumsum(k * rng.normal(size=(count, paths)), axis=0)
    return values + (spectral_flicker(rng, count, b, paths) if b else 0)


@pytest.mark.parametrize("count", [4, 5, 17, 100, 4097, 20_011])
def test_it_is_its_definition(count):
    rng = np.random.default_rng(count)
    values = rng.normal(size=(count, 3)) * [1, 0.01, 100] + [0, 9.8, -1000] + 0.01 * np.arange(count)[:, None]
    found = overlapping_allan(values, 10.0)
    assert found.factors.tolist() == [2**k for k in range(int(np.log2(count / 3)) + 1)]
    np.testing.assert_allclose(found.tau_s, found.factors / 10)
    expected = [[by_definition(axis, m) for axis in values.T] for m in found.factors]
    np.testing.assert_allclose(found.variance, expected, rtol=2e-6)


def test_small_integers_have_an_exact_answer():
    found = overlapping_allan(np.array([[0, 0, 1], [1, 0, 1], [0, 0, 1], [3, 0, 1.0]]), 1.0)
    np.testing.assert_allclose(found.variance, [[0.5 * (1 + 1 + 9) / 3, 0, 0]], rtol=1e-6)


@pytest.mark.parametrize("pieces", [1, 7, 60_000, 300_001])
def test_blocks_of_any_length_give_the_same(pieces):
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.normal(size=(300_001, 3)), axis=0) * 1e-2 + rng.normal(size=(300_001, 3)) + 5
    values = values[:40_000] if pieces == 1 else values
    sums = AllanSums()
    for start in range(0, len(values), pieces * 1000 if pieces < 10 else pieces):
        sums.add(values[start : start + (pieces * 1000 if pieces < 10 else pieces)])
    whole, found = overlapping_allan(values, 50.0), sums.variance(50.0)
    np.testing.assert_allclose(found.variance, whole.variance, rtol=3e-6)
    np.testing.assert_allclose(found.straight, whole.straight, rtol=1e-5)
    np.testing.assert_allclose(found.slope, whole.slope, rtol=1e-9)


def test_of_long_recordings_fewer_shifts_are_taken_with_nearly_the_same_result(monkeypatch):
    values = np.random.default_rng(2).normal(size=(400_000, 3))
    whole = overlapping_allan(values, 1.0)
    monkeypatch.setattr(allan, "_KEPT", 1 << 14)
    thinned = overlapping_allan(values, 1.0)
    short = whole.factors < 4096
    np.testing.assert_allclose(thinned.variance[short], whole.variance[short], rtol=1e-6)
    np.testing.assert_allclose(thinned.variance[~short], whole.variance[~short], rtol=3e-3)
    assert (thinned.variance[~short] != whole.variance[~short]).all()


def test_noise_that_is_small_against_its_drift_keeps_its_digits():
    rng = np.random.default_rng(3)
    values = 1e4 * np.sin(np.arange(50_000) / 9000)[:, None] + rng.normal(size=(50_000, 3))
    found = overlapping_allan(values, 1.0)
    expected = [[by_definition(axis, m) for axis in values.T] for m in found.factors]
    np.testing.assert_allclose(found.variance, expected, rtol=1e-5)


def test_a_line_is_taken_out():
    rng = np.random.default_rng(4)
    values = rng.normal(size=(120_000, 3))
    line = 3e-5 * np.arange(120_000)[:, None] * [1, -1, 0]
    bent, straight = overlapping_allan(values + line, 100.0), overlapping_allan(values, 100.0)
    np.testing.assert_allclose(bent.slope - straight.slope, [3e-3, -3e-3, 0], atol=1e-9)
    np.testing.assert_allclose(bent.straight, straight.straight, rtol=0.03)
    assert bent.variance[-1, 0] > 100 * straight.variance[-1, 0]


def test_published_curves_of_a_real_sensor(real_data):
    counts = np.load(real_data("adis16405-static/adis16405_imu1.npz"))["counts"].astype(float)
    with real_data("avar-published-curves/adis_avar.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = list(dict.fromkeys(row["axis"] for row in rows))
    sensors = [overlapping_allan(counts[:, :3] * 0.05, 100.0), overlapping_allan(counts[:, 3:] * 0.00333, 100.0)]
    for i, name in enumerate(names):
        published = np.array([[float(row["tau_s"]), float(row["avar"])] for row in rows if row["axis"] == name])
        found = sensors[i // 3]
        np.testing.assert_allclose(found.tau_s[1:], published[:, 0], rtol=1e-9)
        np.testing.assert_allclose(found.variance[1:, i % 3], published[:, 1], rtol=1e-5)
    assert len(names) == 6
    assert len(rows) == 6 * 18


def test_estimates_scatter_together_as_predicted():
    rng = np.random.default_rng(5)
    count, paths = 1 << 11, 450
    factors = 1 << np.arange(10)
    covariance = estimate_covariance(factors, count)
    for kind, name in ((Q, "q"), (N, "n"), (B, "b"), (K, "k")):
        values = noise(rng, count, paths=paths, **{name: 1.0})
        found = np.concatenate([overlapping_allan(values[:, i : i + 3], 1.0).variance.T for i in range(0, paths, 3)])
        first = 0 if kind < B else 3  # at a few samples, sampled processes differ from those of continuous time
        mean = found.mean(axis=0) / allan_design(factors)[:, kind]
        np.testing.assert_allclose(mean[first:], 1, atol=0.12)
        ratio = found.var(axis=0) / np.diag(covariance[kind, kind])
        np.testing.assert_allclose(ratio[first:], 1, atol=0.4)
        predicted = covariance[kind, kind] / np.sqrt(np.outer(*[np.diag(covariance[kind, kind])] * 2))
        np.testing.assert_allclose(np.corrcoef(found.T)[first:, first:], predicted[first:, first:], atol=0.2)


def test_the_slope_scatters_as_predicted():
    rng = np.random.default_rng(6)
    count = 1024
    predicted = line_effect(1 << np.arange(9), count).slope_variance
    t = np.arange(count) - (count - 1) / 2
    for kind, name in ((N, "n"), (B, "b"), (K, "k")):
        slopes = t @ noise(rng, count, paths=1200, **{name: 1.0}) / (t @ t)
        assert slopes.var() / predicted[kind] == pytest.approx(1, abs=0.15)
    assert predicted[N] == pytest.approx(12 / count**3, rel=1e-3)
    assert predicted[K] == pytest.approx(6 / 5 / count, rel=1e-3)


def test_a_curve_without_scatter_gives_its_coefficients():
    factors = 1 << np.arange(16)
    fit = AllanFit.of(factors, 1 << 18)
    theta = np.array([4.0, 1.0, 2.5e-3, 4e-6])
    found = fit.fit(fit.straight[:, : len(theta)] @ theta, 0.0)
    np.testing.assert_allclose(found.theta, theta, rtol=1e-6)
    assert found.misfit == 0
    assert not found.ramp


def test_kinds_of_noise_that_are_not_there_are_not_invented():
    rng = np.random.default_rng(7)
    count = 1 << 16
    fit = AllanFit.of(1 << np.arange(15), count)
    invented, runs = np.zeros(4), 24
    for _ in range(runs // 3):
        found = overlapping_allan(noise(rng, count, n=1.0), 1.0)
        for i in range(3):
            one = fit.fit(found.straight[:, i], float(found.slope[i]))
            invented += one.theta > 0
            assert np.isnan(one.bound[N])
            assert (one.bound[[Q, B, K]] > 0).sum() >= 2
            assert one.theta[N] == pytest.approx(1, abs=6 * one.sigma[N])
    assert invented[N] == runs
    assert invented[[Q, B, K]].sum() <= 2


def test_a_ramp_is_told_from_a_random_walk():
    rng = np.random.default_rng(8)
    count = 1 << 16
    fit = AllanFit.of(1 << np.arange(15), count)
    ramps = {}
    for name, kinds in (("ramp", {"n": 1.0, "r": 1e-5}), ("walk", {"n": 1.0, "k": 3e-3})):
        curves = [overlapping_allan(noise(rng, count, **kinds), 1.0) for _ in range(4)]
        ramps[name] = [fit.fit(c.straight[:, i], float(c.slope[i])) for c in curves for i in range(3)]
    assert all(one.ramp and one.theta[K] == 0 for one in ramps["ramp"])
    slopes = np.array([(one.slope - 1e-5) / one.slope_sigma for one in ramps["ramp"]])
    assert np.abs(slopes).max() < 3
    assert not any(one.ramp for one in ramps["walk"])
    assert all(one.theta[K] > 0 for one in ramps["walk"])


def coverage(runs, count, seed=9, **truth):
    """Return the share of runs in which each coefficient lies within two of its sigmas, and was found."""
    rng = np.random.default_rng(seed)
    fit = AllanFit.of(1 << np.arange(int(np.log2(count / 3)) + 1), count)
    true = np.array([truth.get(name, 0.0) for name in "qnbk"])
    within, found = np.zeros(4), np.zeros(4)
    for _ in range(-(-runs // 3)):
        curve = overlapping_allan(noise(rng, count, **truth), 1.0)
        for i in range(3):
            one = fit.fit(curve.straight[:, i], float(curve.slope[i]))
            value = np.sqrt(one.theta)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                within += np.abs(value - true) < one.sigma / value
            found += one.theta > 0
    total = 3 * -(-runs // 3)
    print(f"\n{total} runs: within two sigma {dict(zip(KINDS, within / total, strict=True))}, found {found / total}")
    return within / total, found / total


def test_coefficients_lie_within_two_sigma():
    within, found = coverage(24, 1 << 16, n=1.0, b=0.12, k=1.2e-2)
    assert (found[[N, B, K]] >= 0.9).all()
    assert (within[[N, B, K]] >= 0.8).all()


@pytest.mark.slow
def test_coefficients_lie_within_two_sigma_in_200_runs():
    within, found = coverage(200, 1 << 18, n=1.0, b=0.05, k=2e-3)
    assert (found[[N, B, K]] >= 0.99).all()
    assert ((within[[N, B, K]] >= 0.91) & (within[[N, B, K]] <= 0.99)).all()


def test_simulated_recordings_have_the_noise_that_was_asked_for():
    scenario = NoiseScenario(duration_s=3000.0, rate_hz=50.0, gyroscope_quantisation=1e-5)
    values = {
        name: np.concatenate(list(noise_blocks(scenario, name, seed=3))) for name in ("accelerometer", "gyroscope")
    }
    t_s = np.arange(scenario.samples) / scenario.rate_hz
    result = identify_noise(Recording.from_arrays(t_s, values["gyroscope"], values["accelerometer"]))
    for name, triad in result.noise.triads.items():
        truth = scenario.of(name)
        for axis in triad.axes:
            for key, found in axis.coefficients().items():
                if found.found:
                    assert abs(found.value - truth[key]) < 4 * found.sigma, (name, key)
                else:
                    assert truth[key] < 3 * found.bound
            assert axis.white_noise.found
            assert axis.bias_instability.found
            assert axis.quantisation.found == (name == "gyroscope")
            assert axis.misfit == 0
    blocks = np.concatenate(list(noise_blocks(scenario, "gyroscope", seed=3, block=100_000)))
    assert blocks.shape == values["gyroscope"].shape
    assert not np.array_equal(values["gyroscope"], np.concatenate(list(noise_blocks(scenario, "gyroscope", seed=4))))


@pytest.mark.long
def test_a_real_sensor_against_its_published_numbers(real_data):
    """N at an averaging time of 1 s, and the floors, as the README of the recordings states them."""
    stated = {
        1: ([0.04090, 0.04302, 0.03867], [0.0052, 0.0084, 0.0081]),
        2: ([0.04044, 0.04299, 0.03822], [0.0088, 0.0094, 0.0092]),
    }
    for run, (at_1_s, floors) in stated.items():
        counts = np.load(real_data(f"adis16405-static/adis16405_imu{run}.npz"))["counts"].astype(float)
        recording = Recording.from_arrays(
            np.arange(len(counts)) / 100, counts[:, :3] * 0.05, counts[:, 3:] * 0.00333, units="g deg/s"
        )
        result = identify_noise(recording)
        gyroscope = result.noise.gyroscope
        curve = np.degrees(result.curves["gyroscope"].deviation)
        for i, axis in enumerate(gyroscope.axes):
            assert np.degrees(axis.deviation(np.array([1.0]))[0]) == pytest.approx(at_1_s[i], rel=0.02)
            assert curve[:, i].min() == pytest.approx(floors[i], rel=0.05)
            assert np.degrees(axis.white_noise.value) == pytest.approx(at_1_s[i], rel=0.05)
            assert axis.white_noise.sigma < 0.01 * axis.white_noise.value
            assert 0.4 * floors[i] < np.degrees(0.664 * axis.bias_instability.value) < 1.6 * floors[i]
            assert axis.misfit < 0.05
        assert result.noise.verdict != "fail"
        assert 10 < result.noise.t_init_s < 225
