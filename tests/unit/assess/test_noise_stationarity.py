"""Noise of a resting sensor that is not the same all the time, that is cut off, filtered, or no noise at all."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from gnomon.calibrate.noise import identify_noise
from gnomon.errors import RecordingError
from gnomon.estimate.allan.patterns import find_high_pass, find_pattern, find_steps
from gnomon.recording import ImuSamples, Recording, TriadSamples
from gnomon.simulate.scenarios.recorded import NoiseScenario
from gnomon.simulate.sensor import noise_blocks

SCENARIO = NoiseScenario(duration_s=1500.0, rate_hz=50.0)
N, K = SCENARIO.gyroscope_white_noise, SCENARIO.gyroscope_random_walk


def at_rest(seed=1):
    return np.concatenate(list(noise_blocks(SCENARIO, "gyroscope", seed)))


def recorded(values):
    t_ns = np.rint(np.arange(len(values)) * 1e9 / SCENARIO.rate_hz).astype(np.int64)
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="m/s^2")
    gyroscope = TriadSamples(t_ns=t_ns, values=values, unit="rad/s")
    return Recording(imus={"imu0": ImuSamples(accelerometer=nothing, gyroscope=gyroscope)})


def identified(values):
    noise = identify_noise(recorded(values)).noise
    return noise, {f.code: f.severity for f in noise.findings if f.severity != "good"}


def test_noise_that_stays_is_not_warned_of() -> None:
    noise, codes = identified(at_rest())
    assert not codes.keys() & {
        "noise-frozen", "noise-clipped", "noise-uneven", "noise-pattern", "noise-falls", "noise-other-slope"
    }  # fmt: skip
    assert noise.verdict == "pass"
    for axis in noise.gyroscope.axes:
        assert abs(axis.white_noise.value - N) < 4 * axis.white_noise.sigma < 0.05 * N


@pytest.mark.parametrize("bands", [(-1.0, 1.0), (-0.5, 0.5), (0.0, 1.0)])
def test_a_dead_band_and_two_sensors_by_turns_are_named_as_the_data_doctor_names_them(bands) -> None:
    """A band of one standard deviation halves the white noise, or doubles it where it has one side."""
    values = at_rest()
    low, high = np.array(bands) * values.std()
    assert not identified(values)[1].keys() & {"dead-band", "samples-by-turns"}
    noise, codes = identified(np.where((values > low) & (values < high), 0.0, values))
    assert noise.verdict != "pass"
    assert codes["dead-band"] == "warning"
    other = values + 3 * values.std() * (np.arange(len(values)) % 2)[:, None]
    assert identified(other)[1]["samples-by-turns"] == "problem"


def test_samples_that_fill_in_for_lost_ones_are_named() -> None:
    """Five at a time repeat the last one: 6 % of all, which makes the white noise 15 % larger; coarse steps do not."""
    values, rng = at_rest(), np.random.default_rng(1)
    coarse = np.rint(values / values.std()) * values.std()
    assert "noise-repeated" not in identified(coarse)[1]
    for first in np.flatnonzero(rng.random(len(values) - 5) < 0.012) + 1:
        values[first : first + 5] = values[first - 1]
    noise, codes = identified(values)
    assert codes["noise-repeated"] == "warning"
    assert noise.gyroscope.axes[0].white_noise.value > 1.1 * N


def test_samples_on_lines_between_others_are_named() -> None:
    """Runs of ten make 5 % of all, which makes the white noise 10 % larger at the averaging times that show it."""
    values = at_rest()
    every, lost = np.arange(len(values)), np.arange(len(values)) % 200 >= 190
    filled = np.column_stack([np.interp(every, every[~lost], column[~lost]) for column in values.T])
    assert identified(filled)[1]["noise-repeated"] == "warning"


@pytest.mark.parametrize("factor", [1.3, 2.0])
def test_a_level_that_grows_widens_its_sigma(factor) -> None:
    values = at_rest()
    noise, codes = identified(values * np.linspace(1, factor, len(values))[:, None])
    assert codes["noise-uneven"] == "warning"
    white = noise.gyroscope.axes[0].white_noise
    assert abs(white.value - N) < 3 * white.sigma


def test_an_axis_that_freezes_is_named_with_its_times() -> None:
    values = at_rest()
    values[int(0.9 * len(values)) :, 1] = values[-1, 1]
    noise, codes = identified(values)
    assert codes["noise-frozen"] == "warning"
    (finding,) = [f for f in noise.findings if f.code == "noise-frozen"]
    assert "--stop-s 13" in finding.cure
    white = noise.gyroscope.axes[1].white_noise
    assert abs(white.value - N) < 3 * white.sigma


def test_the_advice_never_points_at_the_dead_part() -> None:
    values = at_rest()
    half = len(values) // 2
    values[half:] = 0.3
    _, codes = identified(values)
    assert codes["noise-frozen"] == "problem"
    values[:half] += np.where(np.arange(half) > half // 4, 0.05, 0.0)[:, None]
    with pytest.raises(RecordingError, match="--stop-s 7") as caught:
        identify_noise(recorded(values))
    assert "--stop-s 14" not in str(caught.value)


@pytest.mark.parametrize(("sigmas", "severity"), [(1.0, "problem"), (2.5, "warning"), (10.0, None)])
def test_samples_that_are_cut_off_are_counted(sigmas, severity) -> None:
    end = sigmas * N * np.sqrt(SCENARIO.rate_hz)
    _, codes = identified(np.clip(at_rest(), -end, end))
    assert codes.get("noise-clipped") == severity


@pytest.mark.parametrize("step", [0.2, 1.0])
def test_a_coarse_converter_does_not_clip(step) -> None:
    """The highest step is reached by chance, and often where steps are coarse."""
    size = step * N * np.sqrt(SCENARIO.rate_hz)
    _, codes = identified(np.round(at_rest() / size) * size)
    assert "noise-clipped" not in codes
    assert "noise-frozen" not in codes


@pytest.mark.parametrize(("hz", "order"), [(5.0, 1), (3.0, 2)])
def test_behind_a_low_pass_the_density_is_that_of_low_frequencies(hz, order) -> None:
    b, a = butter(order, hz, fs=SCENARIO.rate_hz)
    noise, codes = identified(lfilter(b, a, at_rest(), axis=0))
    assert codes["noise-filtered"] == "info"
    for axis in noise.gyroscope.axes:
        assert axis.fitted_from_s > 0.02
        assert abs(axis.white_noise.value - N) < 4 * axis.white_noise.sigma < 0.3 * N


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_noise_between_the_usual_kinds_is_said_and_widens_their_sigmas(size) -> None:
    """Noise of spectrum 1/f^0.5 is not taken for a filter: white noise comes out right, with a sigma that holds."""
    values = at_rest(2)
    f = np.fft.rfftfreq(len(values), 1 / SCENARIO.rate_hz)
    white = np.fft.rfft(N * np.sqrt(SCENARIO.rate_hz) * np.random.default_rng(2).standard_normal(values.shape), axis=0)
    shape = np.where(f > 0, np.maximum(f, 1e-9), np.inf) ** -0.25
    noise, codes = identified(values + size * np.fft.irfft(white * shape[:, None], len(values), axis=0))
    assert "noise-filtered" not in codes
    assert codes["noise-other-slope"] == ("info" if size < 1 else "warning")
    truth = SCENARIO.of("gyroscope")
    for axis in noise.gyroscope.axes:
        assert abs(axis.white_noise.value - N) < 4 * axis.white_noise.sigma
        for kind in ("bias_instability", "random_walk"):
            found = axis.coefficients()[kind]
            assert not found.found or abs(found.value - truth[kind]) < 4 * found.sigma
            assert found.found or truth[kind] < 1.5 * found.bound


def test_behind_an_auto_zero_no_bound_hides_a_random_walk() -> None:
    values = at_rest()
    parts = values.reshape(-1, 500, 3)
    noise, codes = identified((parts - parts.mean(axis=1, keepdims=True)).reshape(-1, 3))
    assert codes["noise-falls"] == "warning"
    assert all(axis.random_walk.most > 0.5 * K for axis in noise.gyroscope.axes)
    assert not any(axis.random_walk.found or axis.bias_instability.found for axis in noise.gyroscope.axes)


def drifting_means(seed: int, walk: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((5400, 3)) + walk * np.cumsum(rng.standard_normal((5400, 3)), axis=0)


@pytest.mark.parametrize("corner_hz", [0.002, 0.006])
def test_a_slow_high_pass_is_seen_in_the_spectrum(corner_hz) -> None:
    keep = np.exp(-2 * np.pi * corner_hz)
    found = find_high_pass(lfilter([1.0, -1.0], [1.0, -keep], drifting_means(4, 0.1), axis=0), 1.0)
    assert found is not None
    assert found.axes.all()
    assert 0.3 < found.corner_hz / corner_hz < 3


def test_a_slow_auto_zero_of_one_axis_is_seen() -> None:
    means = drifting_means(5, 0.1)
    parts = means[:, 1].reshape(-1, 300)
    means[:, 1] = (parts - parts.mean(axis=1, keepdims=True)).ravel()
    found = find_high_pass(means, 1.0)
    assert found is not None
    assert found.axes.tolist() == [False, True, False]


@pytest.mark.parametrize("walk", [0.0, 0.005, 0.3])
def test_noise_alone_is_behind_no_high_pass(walk) -> None:
    for seed in range(5):
        found = find_high_pass(drifting_means(100 + seed, walk), 1.0)
        assert found is None or not found.sure
    assert find_high_pass(drifting_means(1, walk)[:60], 1.0) is None


def test_a_high_pass_of_half_of_a_recording_is_seen() -> None:
    means = drifting_means(6, 0.1)
    keep = np.exp(-2 * np.pi * 0.006)
    means[2700:] = lfilter([1.0, -1.0], [1.0, -keep], means[2700:] - means[2700], axis=0)
    found = find_high_pass(means, 1.0)
    assert found is not None
    assert found.sure
    assert found.axes.all()


def zeroed(values: np.ndarray, every: int, shown: int) -> np.ndarray:
    """Subtract what the last values before showed."""
    changed = values.copy()
    for start in range(every, len(values), every):
        changed[start : start + every] -= values[start - shown : start].mean(axis=0)
    return changed


@pytest.mark.parametrize("walk", [0.005, 0.1])
def test_steps_of_a_sensor_that_is_zeroed_now_and_then_are_seen(walk) -> None:
    """Whether what was taken off is mostly noise or mostly a walk; where one axis alone steps, it is that one."""
    means = drifting_means(7, walk)
    after = zeroed(means, 300, 1)
    found = find_steps(after, 5400.0)
    assert all(one is not None and one.sure and one.kind == "steps" for one in found)
    assert all(min(one.time_s % 300, 300 - one.time_s % 300) < 30 for one in found)
    only_y = find_steps(np.where(np.arange(3) == 1, after, means), 5400.0)
    assert [one is not None and one.sure for one in only_y] == [False, True, False]


@pytest.mark.parametrize("walk", [0.0, 0.005, 0.3])
def test_noise_alone_and_lone_readings_are_no_steps(walk) -> None:
    for seed in range(5):
        means = drifting_means(200 + seed, walk)
        means[[700, 2000, 4100]] += 20.0
        assert not any(one is not None and one.sure for one in find_steps(means, 5400.0))
    assert find_steps(drifting_means(1, walk)[:60], 60.0) == (None, None, None)


def test_zeroing_is_warned_of_and_widens_what_it_adds_to_the_random_walk() -> None:
    """Four to eight times the sensor's own random walk passed, up to ten sigma from it."""
    noise, codes = identified(zeroed(at_rest(), 50 * 150, 25))
    assert codes["noise-pattern"] == "warning"
    for axis in noise.gyroscope.axes:
        assert axis.random_walk.value > 2 * K
        for kind in ("bias_instability", "random_walk"):
            found = axis.coefficients()[kind]
            assert not found.found or found.sigma >= found.value


@pytest.mark.parametrize("kind", ["step", "wave", "warm-up"])
def test_patterns_in_the_means_are_no_random_walk(kind) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(1500.0)
    shapes = {"step": (t > 600) * 1.0, "wave": np.sin(t / 60), "warm-up": 2 * np.exp(-t / 150)}
    noise = rng.standard_normal(len(t))
    found = find_pattern(noise + 1.5 * shapes[kind], 1500.0)
    assert found.kind == kind
    assert abs(found.size) == pytest.approx(3.0 if kind == "warm-up" else 1.5, rel=0.25)
    expected = {"step": 600, "wave": 2 * np.pi * 60, "warm-up": 150}[kind]
    assert found.time_s == pytest.approx(expected, rel=0.1)
    assert find_pattern(noise, 1500.0) is None
    walk = noise + np.cumsum(0.3 * rng.standard_normal(len(t)))
    assert find_pattern(walk, 1500.0) is None


def test_a_step_is_named_and_what_it_spoils_is_widened() -> None:
    values = at_rest()
    values[len(values) // 3 :, 2] += 8e-4
    noise, codes = identified(values)
    assert codes["noise-pattern"] == "warning"
    walk = noise.gyroscope.axes[2].random_walk
    assert not walk.found or walk.sigma >= walk.value


@pytest.mark.parametrize("count", [3000, 2999])
def test_a_minute_is_a_minute_whether_the_last_period_counts(count) -> None:
    values = at_rest()[:count]
    if count == 3000:
        identify_noise(recorded(values))
    else:
        assert identify_noise(recorded(values)).noise.gyroscope.samples == count
    with pytest.raises(RecordingError, match="too few"):
        identify_noise(recorded(at_rest()[:2900]))
