"""The static detector, the choice of its threshold, noise at rest, and the time base."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.preparation import disturbed_intervals
from gnomon.detect.samples import stillness
from gnomon.detect.samples.rests import RestStatistics, choose_threshold, detect_rests, find_rests, trim_intervals
from gnomon.detect.samples.stillness import (
    RateMarks,
    mark_rates,
    quantisation_step,
    resting_variances,
    static_statistic,
    variance_magnitude_squared,
    window_samples,
    window_variances,
)
from gnomon.estimate.multiposition.noise_levels import allan_deviation, averaging_time, resting_noise
from gnomon.recording import TriadSamples
from gnomon.recording.samples import time_base
from gnomon.results.result import StaticIntervals, interval_means, runs_below


def triad(values, rate_hz=100.0, unit="m/s^2"):
    t_ns = np.rint(np.arange(len(values)) * 1e9 / rate_hz).astype(np.int64)
    return TriadSamples(t_ns=t_ns, values=np.asarray(values, dtype=float), unit=unit)


# --- variances -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chunk", [1, 5, 64, 10_000])
@pytest.mark.parametrize(("n", "window"), [(3, 3), (9, 9), (60, 5), (200, 21), (131, 101)])
def test_variances_are_those_of_every_window(monkeypatch, chunk, n, window):
    monkeypatch.setattr(stillness, "_CHUNK", chunk)
    rng = np.random.default_rng(n)
    values = 32768 + rng.normal(0, [1.0, 30.0, 1000.0], (n, 3))
    half = window // 2
    expected = np.empty((n, 3))
    for k in range(n):
        centre = min(max(k, half), n - half - 1)  # the ends take the nearest full window
        expected[k] = np.var(values[centre - half : centre + half + 1], axis=0, ddof=1)
    np.testing.assert_allclose(window_variances(values, window), expected, rtol=1e-8)


def test_variances_keep_their_digits_in_a_long_recording():
    # Rest far from zero beside motion that is ten thousand times the noise.
    rng = np.random.default_rng(1)
    values = 6e4 + 3.0 * rng.normal(size=(100_000, 3))
    values[40_000:60_000] += 3e4 * np.sin(np.arange(20_000) / 30)[:, None]
    found = window_variances(values, 101)
    for k in (50, 39_900, 60_100, 99_900):
        np.testing.assert_allclose(found[k], np.var(values[k - 50 : k + 51], axis=0, ddof=1), rtol=3e-5)


def test_variance_magnitude_is_eq_3_9():
    variances = np.array([[1.0, 2.0, 3.0], [0.1, 0.0, 0.0]])
    np.testing.assert_allclose(variance_magnitude_squared(variances), [14.0, 0.01])
    np.testing.assert_allclose(variance_magnitude_squared(variances, np.array([1.0, 2.0, 3.0])), [3.0, 0.01])


@pytest.mark.parametrize("window", [25, 101])
def test_resting_level_is_found_amid_motion(window):
    rng = np.random.default_rng(2)
    sigma = np.array([0.005, 0.008, 0.03])
    still = (np.arange(20_000) // 500) % 2 == 0
    values = sigma * rng.normal(size=(20_000, 3)) + np.where(still, 0, np.sin(np.arange(20_000) / 20))[:, None]
    level = resting_variances(window_variances(values, window), values, window)
    np.testing.assert_allclose(np.sqrt(level), sigma, rtol=0.25)
    assert (level < sigma**2).all()  # the tenth percentile of what is quiet


def test_resting_level_of_a_coarse_or_silent_sensor():
    rng = np.random.default_rng(3)
    values = np.round(0.02 * rng.normal(size=(5000, 3)))  # steps fifty times the noise: it shows zeros
    values[2000:2500] += np.round(20 * rng.normal(size=(500, 3)))
    values[:, 2] = 7.0
    level = resting_variances(window_variances(values, 101), values, 101)
    np.testing.assert_allclose(level[:2], 1 / 12)
    assert 0 < level[2] < 1e-300
    assert np.isfinite(static_statistic(values, 101)).all()


def test_quantisation_step():
    rng = np.random.default_rng(4)
    values = rng.normal(size=(500, 3))
    values[:, 0] = np.round(values[:, 0] * 8) / 8
    values[:, 1] = 3.0
    step = quantisation_step(values)
    assert step[0] == 0.125
    assert step[1] == 0.0
    assert 0 < step[2] < 0.01


# --- runs ----------------------------------------------------------------------------------------------------------


def test_runs():
    statistic = np.array([0, 0, 9, 0, 0, 0, 0, 9, 9, 0, 0, 0.0])
    runs = runs_below(statistic, 1.0, shortest=3)
    np.testing.assert_array_equal([runs.start, runs.stop], [[3, 9], [7, 12]])
    runs = runs_below(statistic, 1.0, shortest=1, margin=1)
    np.testing.assert_array_equal([runs.start, runs.stop], [[4, 10], [6, 11]])
    assert len(runs_below(statistic + 5, 1.0, shortest=1)) == 0
    whole = runs_below(0 * statistic, 1.0, shortest=3)
    np.testing.assert_array_equal([whole.start, whole.stop], [[0], [12]])


def test_interval_means_up_to_the_last_sample():
    values = np.random.default_rng(5).normal(size=(50, 3))
    for last in (49, 50):
        intervals = StaticIntervals(start=np.array([0, 11, 40]), stop=np.array([10, 30, last]))
        expected = [values[a:b].mean(axis=0) for a, b in zip(intervals.start, intervals.stop, strict=True)]
        np.testing.assert_allclose(interval_means(values, intervals), expected)
    none = StaticIntervals(start=np.empty(0, np.int64), stop=np.empty(0, np.int64))
    assert interval_means(values, none).shape == (0, 3)


def simulated(**options):
    scenario = gnomon.Scenario(**{"intervals": 15, "t_init_s": 10.0, "hold_s": (3.0, 3.0), **options})
    return gnomon.simulate(scenario, 1)[0].imus["imu0"]


@pytest.mark.parametrize("rate_hz", [25.0, 100.0, 400.0])
@pytest.mark.parametrize("units", ["si", "raw", "g deg/s"])
def test_every_rest_is_found_once_in_any_unit(rate_hz, units):
    imu = simulated(rate_hz=rate_hz, units=units)
    rests = find_rests(motion_of(imu.accelerometer), 30.0, round(0.5 * rate_hz)).intervals
    assert len(rests) == 15
    length = (rests.stop - rests.start) / rate_hz
    assert length[0] == pytest.approx(10 - 0.5, abs=0.3)  # half a window before the motion it is noticed
    np.testing.assert_allclose(length[1:-1], 3.0 - 0.6, atol=0.5)  # motions begin and end slowly


def test_too_short_a_recording_has_no_rests():
    samples, nothing = triad(np.zeros((50, 3))), np.zeros(50, dtype=bool)
    assert detect_rests(samples, samples, nothing, t_s=(samples.t_s, samples.t_s)) is None


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 50.0, 99.3, 1000.0])
def test_window_is_odd(rate_hz):
    window = window_samples(triad(np.zeros((10, 3)), rate_hz), 1.0)
    assert window % 2 == 1
    assert window >= 3
    assert abs(window - rate_hz) <= max(2.0, 3 - rate_hz)


def test_pieces_of_one_rest_count_once():
    up, side = np.array([0.0, 0, 9.8]), np.array([9.8, 0, 0.0])
    values = np.concatenate([np.tile(up, (100, 1)), np.tile(side, (100, 1)), np.tile(up, (100, 1))])
    pieces = [(0, 15), (20, 55), (60, 95), (110, 140), (150, 160), (210, 290)]
    statistic = np.full(300, 20.0)
    for first, last in pieces:
        statistic[first:last] = 1.0
    nothing = np.zeros(300, dtype=bool)
    motion = RestStatistics(samples=triad(values), statistic=statistic, saturated=nothing, marks=RateMarks.none(300))
    rests = find_rests(motion, 10.0, 5)
    np.testing.assert_array_equal(rests.kept.start, [20, 110, 210])  # the longest; the same attitude later counts again
    np.testing.assert_array_equal(rests.kept.stop, [55, 140, 290])
    np.testing.assert_array_equal(rests.found.start, [0, 110, 210])
    assert rests.reason == ("", "", "")
    # With a turn between them they are rests of their own, such as before and after a full turn.
    moved = np.array(statistic)
    moved[15:20] = 1e6
    turned = (np.abs(np.arange(300) - 17) < 3).astype(float)
    assert len(find_rests(replace(motion, statistic=moved, turned=turned), 10.0, 5)) == 4
    assert len(find_rests(replace(motion, statistic=moved, turned=0.01 * turned), 10.0, 5)) == 3


def motion_of(samples, saturated=None):
    nothing = np.zeros(len(samples), dtype=bool)
    statistic = static_statistic(samples.values, window_samples(samples, 1.0))
    clipped = nothing if saturated is None else saturated
    return RestStatistics(samples=samples, statistic=statistic, saturated=clipped, marks=RateMarks.none(len(samples)))


def test_threshold_takes_the_rests_and_not_the_motion():
    motion = motion_of(simulated(intervals=20).accelerometer)
    best, trials = choose_threshold(motion, 9.80665)
    assert best.fit is not None
    assert len(best.intervals) == 20
    assert best.criterion == min(trial.criterion for trial in trials)
    assert best.heldout_rms < 5e-3
    assert not disturbed_intervals(best, motion.samples).any()
    # A threshold at which nothing moves leaves one interval, and one at which everything does leaves none.
    for multiplier, found in ((1e30, 1), (1e-6, 0)):
        none, _ = choose_threshold(motion, 9.80665, (multiplier,))
        assert none.fit is None
        assert len(none.intervals) == found


def test_intervals_with_clipped_samples_are_not_taken():
    samples = simulated(intervals=20).accelerometer
    best, _ = choose_threshold(motion_of(samples), 9.80665)
    clipped = np.zeros(len(samples), dtype=bool)
    clipped[best.intervals.start[4] + 10] = True
    without, _ = choose_threshold(motion_of(samples, clipped), 9.80665, (best.multiplier,))
    np.testing.assert_array_equal(without.intervals.start, np.delete(best.intervals.start, 4))
    assert [k for k, why in enumerate(without.rests.reason) if "saturated" in why] == [4]  # found, and not used
    assert len(without.rests) == len(best.rests)


@pytest.mark.parametrize("pressed", [(7,), (7, 15), (2, 9, 16)], ids=str)
def test_touched_intervals_are_noticed(pressed):
    samples = simulated(intervals=24).accelerometer
    best, _ = choose_threshold(motion_of(samples), 9.80665)
    values = samples.values.copy()
    for k in pressed:
        up = best.means[k] / np.linalg.norm(best.means[k])
        # Pressed steadily, and for a second longer on either side: the detector is blind to it.
        values[best.intervals.start[k] - 100 : best.intervals.stop[k] + 100] += 0.05 * up
    touched = TriadSamples(t_ns=samples.t_ns, values=values, unit=samples.unit)
    best, _ = choose_threshold(motion_of(touched), 9.80665)
    np.testing.assert_array_equal(np.flatnonzero(disturbed_intervals(best, touched)), pressed)


# --- turning about the vertical ------------------------------------------------------------------------------------


def rates(n=6000, seed=6, sigma=0.005):
    return np.array([0.02, -0.01, 0.03]) + sigma * np.random.default_rng(seed).normal(size=(n, 3))


def test_turning_about_the_vertical_is_found():
    values = rates()
    values[2000:2300, 2] += 0.5 * np.sin(np.linspace(0, np.pi, 300)) ** 2  # gravity does not move
    marks = mark_rates(triad(values), np.ones(6000, dtype=bool))
    assert marks.turns[2050:2250].all()
    assert not marks.turns[:1950].any()
    assert not marks.turns[2350:].any()
    assert marks.stirs[marks.turns].all()


def test_a_resting_gyroscope_does_not_turn():
    still = np.ones(6000, dtype=bool)
    warming = 0.05 * np.exp(-np.arange(6000) / 2000)[:, None]
    for values in (rates(), np.zeros((6000, 3)), rates() + warming):
        assert mark_rates(triad(values), still).turns.mean() < 0.01  # of 480 eighths hardly one
    assert not mark_rates(triad(rates()), ~still).turns.any()
    marks = mark_rates(triad(rates(5)), still[:5])
    assert marks.turns.shape == marks.stirs.shape == (5,)


def test_motion_beside_rest_does_not_raise_the_level():
    values = rates()
    moving = (np.arange(6000) // 300) % 2 == 1
    values[moving] += np.random.default_rng(7).normal(0, 1.0, 3)
    values[4900:5000] += [0, 0.1, 0]  # within a rest
    turns = mark_rates(triad(values), ~moving).turns
    assert turns[4920:4980].all()
    assert not turns[4840:4860].any()


MOVING = (np.arange(12000) // 300) % 2 == 1
"""Rests of three seconds with motions of three seconds between."""
WITHIN = np.arange(12000) % 600
WITHIN = (WITHIN >= 30) & (WITHIN < 270)
"""Rests without their ends."""


def moving_rates(seed=8):
    values = rates(12000, seed)
    values[MOVING] += np.random.default_rng(seed).normal(0, 1.0, (MOVING.sum(), 3))
    return values


@pytest.mark.parametrize("size", [3e-3, 0.03, 0.1])
@pytest.mark.parametrize("at", [5900, 6100, 6150])
def test_a_bias_that_steps_is_no_turn(size, at):
    values = moving_rates()
    values[at:] += size * np.array([1.0, -1.0, 0.5])
    marks = mark_rates(triad(values), ~MOVING)
    away = np.abs(np.arange(12000) - at) > 40
    assert (marks.turns & WITHIN & away).mean() < 0.003
    assert not marks.apart.any()
    if at == 6150 and size > 0.01:
        assert marks.jumps[at - 13 : at + 13].any()


def test_a_rest_in_the_hand_has_a_tremor_of_its_own():
    values = moving_rates()
    t_s = np.arange(12000) / 100
    for k in (4, 10, 11, 12, 26):
        part = slice(600 * k, 600 * k + 300)
        values[part] += 0.006 * np.sin(2 * np.pi * (2.3 * t_s[part, None] + [0, 0.3, 0.6]))
    assert (mark_rates(triad(values), ~MOVING).turns_beyond_tremor & WITHIN).mean() < 0.005


def test_who_turns_steadily_does_not_rest():
    values = moving_rates()
    values[6000:6300] += [0.0, 0.0, 0.08]
    marks = mark_rates(triad(values), ~MOVING)
    assert marks.apart[6013:6287].all()
    assert not marks.apart[:5990].any()
    assert not marks.apart[6310:].any()


def test_ends_that_stir_are_trimmed_off():
    stirs = np.zeros(100, dtype=bool)
    stirs[[10, 11, 12, 25, 28, 29, 49, 60]] = True  # what stirs in the middle may stay
    stirs[70:90] = True
    intervals = StaticIntervals(start=np.array([10, 40, 60, 72]), stop=np.array([30, 50, 65, 88]))
    kept = trim_intervals(intervals, stirs, shortest=5)
    np.testing.assert_array_equal([kept.start, kept.stop], [[13, 40], [28, 49]])
    assert len(trim_intervals(intervals, np.ones(100, dtype=bool), shortest=1)) == 0
    np.testing.assert_array_equal(
        trim_intervals(intervals, np.zeros(100, dtype=bool), shortest=1).start, intervals.start
    )


# --- noise at rest -------------------------------------------------------------------------------------------------


def resting(rate_hz=100.0, count=40, length_s=4.0):
    n = round(length_s * rate_hz)
    start = np.arange(count) * (n + 50)
    return StaticIntervals(start=start, stop=start + n), count * (n + 50)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 800.0])
def test_density_of_white_noise(rate_hz):
    still, n = resting(rate_hz)
    rng = np.random.default_rng(8)
    sigma = np.array([0.003, 0.005, 0.5])
    values = 9.8 + sigma * rng.normal(size=(n, 3))
    of_means, of_increments = resting_noise(values, still, rate_hz)
    np.testing.assert_allclose(np.sqrt(of_means), sigma / np.sqrt(rate_hz), rtol=0.08)  # 600 differences: 3.5 %
    np.testing.assert_allclose(np.sqrt(of_increments), sigma / np.sqrt(rate_hz), rtol=0.08)


def test_attitudes_motion_and_drift_are_not_noise():
    still, n = resting()
    rng = np.random.default_rng(9)
    noise = 0.004 * rng.normal(size=(n, 3))
    attitude = np.repeat(rng.normal(0, 5, (40, 3)), 450, axis=0)
    motion = np.ones(n, dtype=bool)
    for a, b in zip(still.start, still.stop, strict=True):
        motion[a:b] = False
    values = noise + attitude + 20 * motion[:, None] * rng.normal(size=(n, 3)) + np.linspace(0, 0.02, n)[:, None]
    of_means, _ = resting_noise(values, still, 100.0)
    np.testing.assert_allclose(np.sqrt(of_means), 0.004 / 10, rtol=0.12)  # 600 differences: 3.5 %


def test_filtered_noise_counts_as_it_acts_on_means():
    # Neighbours share their noise: single samples look three times quieter than means of them are.
    still, n = resting(400.0)
    white = np.random.default_rng(10).normal(size=(n + 8, 3))
    values = 0.01 * np.stack([np.convolve(white[:, axis], np.full(9, 1 / 9), "valid") for axis in range(3)], axis=1)
    of_means, _ = resting_noise(values, still, 400.0)
    np.testing.assert_allclose(np.sqrt(of_means), 0.01 / 20, rtol=0.12)


def test_slow_sway_counts_for_means_and_tremor_does_not_for_increments():
    still, n = resting()
    rng = np.random.default_rng(11)
    noise = 0.002 * rng.normal(size=(n, 3))
    white, _ = resting_noise(noise, still, 100.0)
    walk = noise + np.cumsum(0.0005 * rng.normal(size=(n, 3)), axis=0)  # wanders over seconds
    swaying, _ = resting_noise(walk, still, 100.0)
    assert (swaying > 3 * white).all()
    # A hand's tremor of 2 Hz shows in blocks of a quarter of a second, which are the rule, and hardly in 50 ms.
    tremor = noise + 0.004 * np.sin(2 * np.pi * 2.1 * np.arange(n) / 100)[:, None]
    blocks = [tremor[a:b].reshape(-1, 25, 3).mean(axis=1) for a, b in zip(still.start, still.stop, strict=True)]
    rule = 0.25 * 0.5 * np.mean([np.mean(np.diff(block, axis=0) ** 2, axis=0) for block in blocks], axis=0)
    _, of_increments = resting_noise(tremor, still, 100.0)
    assert (rule > 20 * white).all()
    assert (of_increments < 5 * white).all()


def test_noise_of_no_intervals_is_zero():
    none = StaticIntervals(start=np.empty(0, np.int64), stop=np.empty(0, np.int64))
    for level in resting_noise(np.ones((100, 3)), none, 100.0):
        np.testing.assert_array_equal(level, 0.0)


def test_allan_deviation_is_eq_3_17():
    rng = np.random.default_rng(12)
    values = rng.normal(size=(1234, 3)) + np.cumsum(0.05 * rng.normal(size=(1234, 3)), axis=0)
    tau = np.array([0.004, 0.01, 0.13, 1.0, 6.17, 6.18, 20.0])
    found = allan_deviation(values, 100.0, tau)
    for row, n in enumerate([1, 1, 13, 100, 617]):
        means = [values[k * n : (k + 1) * n].mean(axis=0) for k in range(1234 // n)]
        squares = [(b - a) ** 2 for a, b in pairwise(means)]
        np.testing.assert_allclose(found[row], np.sqrt(0.5 * np.mean(squares, axis=0)), rtol=1e-12)
    assert np.isnan(found[5:]).all()


def test_averaging_time():
    tau = np.geomspace(1, 200, 30)
    white = np.stack([a / np.sqrt(tau) for a in (1, 2, 3)], axis=1)
    assert np.isnan(averaging_time(tau, white))
    with_floor = np.sqrt(white**2 + np.array([0.15, 0.3, 0.3]) ** 2)
    found = averaging_time(tau, with_floor)
    slopes = np.gradient(np.log(with_floor), np.log(tau), axis=0)
    assert (slopes[tau >= found][0] > np.log2(0.85)).all()  # all three axes are flat, not just one
    assert not (slopes[tau < found] > np.log2(0.85)).all(axis=1).any()
    assert np.isnan(averaging_time(tau[:2], white[:2]))


# --- the time base -------------------------------------------------------------------------------------------------

N = 5000
TRUE_S = 3.0 + 0.0099990 * np.arange(N)


def clock(t_s, **options):
    samples = TriadSamples(
        t_ns=np.rint(np.asarray(t_s) * 1e9).astype(np.int64), values=np.zeros((len(t_s), 3)), unit="g"
    )
    return time_base(samples, 1_000_000_000, **options)


def test_rounded_stamps_give_way_to_the_line():
    base = clock(np.round(TRUE_S, 3))
    assert base.uniform
    np.testing.assert_allclose(base.t_s, TRUE_S - 1.0, atol=1e-4)  # 1 ms in the timestamps
    assert base.jitter_s == pytest.approx(1e-3 / np.sqrt(12), rel=0.05)


def test_a_line_that_was_asked_for_counts_what_it_leaves_out():
    kept = np.random.default_rng(13).random(N) > 0.002
    lost = int(N - kept.sum())
    assert clock(TRUE_S[kept], choice="uniform").missing == pytest.approx(lost, abs=2)
    assert clock(TRUE_S[kept]).missing == 0
    assert clock(TRUE_S, choice="uniform").missing == 0
    packets = np.repeat(TRUE_S[9::10], 10)  # stamped as they came, ten by ten: nothing is missing
    assert clock(packets, choice="uniform").missing == 0
    delayed = TRUE_S + np.random.default_rng(1).exponential(0.004, N)
    assert clock(np.maximum.accumulate(delayed), choice="uniform").missing == 0


def test_lost_samples_leave_gaps_in_the_line():
    rng = np.random.default_rng(13)
    kept = rng.random(N) > 0.05
    kept[1000:1300] = False
    stamps = (TRUE_S + 2e-4 * rng.normal(size=N))[kept]
    base = clock(stamps)
    assert base.uniform
    np.testing.assert_allclose(base.t_s, TRUE_S[kept] - 1.0, atol=3e-5)


@pytest.mark.parametrize("apart_s", [0.0, 1e-5, 1e-3])
def test_packets_lie_on_a_line_over_all_samples(apart_s):
    # All ten samples of a packet are stamped when it arrives.
    arrival = np.repeat(TRUE_S[9::10], 10) + np.tile(apart_s * np.arange(10), len(TRUE_S) // 10)
    base = clock(arrival)
    assert base.uniform
    np.testing.assert_allclose(np.diff(base.t_s), np.diff(TRUE_S)[: len(arrival) - 1], rtol=1e-4)
    halted = arrival + 2.0 * (np.arange(len(arrival)) >= 2000)  # two seconds are missing: the line does not hold
    assert not clock(halted).uniform


@pytest.mark.parametrize("kind", ["wander", "two rates", "duplicate"])
def test_stamps_that_no_line_explains_stay(kind):
    t = TRUE_S.copy()
    if kind == "wander":  # the sensor's clock is slow to warm up: 80 ms in all
        t = TRUE_S + 0.08 * np.sin(np.linspace(0, 3, N))
    elif kind == "two rates":
        t = 3.0 + np.cumsum(np.where(np.arange(N) < N // 2, 0.010, 0.0145))
    else:
        t[2000] = t[1999]
    base = clock(t)
    assert not base.uniform
    np.testing.assert_allclose(base.t_s, t - 1.0, atol=1e-9)


def test_time_base_can_be_forced():
    rounded = np.round(TRUE_S, 3)
    forced = clock(rounded, choice="stamps")
    assert not forced.uniform
    np.testing.assert_allclose(forced.t_s, rounded - 1.0, atol=1e-9)
    bursts = np.repeat(TRUE_S[9::10], 10)
    forced = clock(bursts, choice="uniform")
    assert forced.uniform
    np.testing.assert_allclose(np.diff(forced.t_s), 0.009999, rtol=1e-4)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_stamps_for_a_line(n):
    base = clock(TRUE_S[:n])
    assert not base.uniform
    assert len(base.t_s) == n
