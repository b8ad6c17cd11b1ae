"""Saturated samples are found, and nothing else is."""

import numpy as np
import pytest

from gnomon.detect.samples.faults import drop_repeated_timestamps, saturated_samples
from gnomon.recording import TriadSamples


def triad(values, rate_hz: float = 100.0, unit: str = "count") -> TriadSamples:
    values = np.asarray(values, float)
    if values.ndim == 1:
        values = np.column_stack([values, np.zeros_like(values), np.zeros_like(values)])
    t_ns = np.rint(np.arange(len(values)) * 1e9 / rate_hz).astype(np.int64)
    return TriadSamples(t_ns=t_ns, values=values, unit=unit)


def motion(seed: int = 0, seconds: float = 60, rate_hz: float = 100, noise: float = 0.2):
    """Return a rate of the hand with rests [deg/s]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / rate_hz)
    envelope = np.clip(np.sin(2 * np.pi * t / 10), 0, None)
    signal = sum(200 * rng.normal() * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.5, 0.8, 1.1))
    return envelope * signal + rng.normal(0, noise, len(t))


@pytest.mark.parametrize("step", [0.0, 0.06, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_clipped_motion_is_marked_and_only_it(seed, step) -> None:
    true = motion(seed)
    if step:
        true = np.round(true / step) * step
    limit = 0.5 * np.abs(true).max()
    measured = np.clip(true, -limit, limit)
    np.testing.assert_array_equal(saturated_samples(triad(measured)), np.abs(true) >= limit)
    assert not saturated_samples(triad(true)).any()


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(10))
def test_quantised_noise_at_rest_is_not_saturated(seed, sigma) -> None:
    rng = np.random.default_rng(seed)
    assert not saturated_samples(triad(np.round(rng.normal(100.4, sigma, (20_000, 3))))).any()


def test_smooth_coarse_motion_with_flat_peaks_is_not_saturated() -> None:
    t = np.arange(0, 60, 0.005)
    assert not saturated_samples(triad(np.round(100 * np.sin(2 * np.pi * 0.3 * t)))).any()


@pytest.mark.parametrize("limit", [32767, -32768, 65535])
def test_one_sample_at_the_end_of_the_converter_is_enough(limit) -> None:
    values = np.round(motion(1) * 10) + (33000 if limit > 40_000 else 0)
    values[777] = limit
    assert np.flatnonzero(saturated_samples(triad(values))).tolist() == [777]


def test_stated_full_scale() -> None:
    values = motion(2)
    limit = 0.9 * np.abs(values).max()
    np.testing.assert_array_equal(saturated_samples(triad(values), full_scale=limit), np.abs(values) >= limit)


def test_constant_and_tiny_recordings_are_not_saturated() -> None:
    assert not saturated_samples(triad(np.full(100, 7.0))).any()
    assert saturated_samples(triad(np.zeros((0, 3)))).shape == (0,)
    assert not saturated_samples(triad([[1, 2, 3], [1, 2, 3]])).any()


def test_real_recordings(real_data) -> None:
    import gnomon

    imu = gnomon.read(real_data("xsens_mti")).imus["imu0"]
    assert not saturated_samples(imu.accelerometer).any()
    assert not saturated_samples(imu.gyroscope).any()
    with np.load(real_data("mimu4444-icosahedron/exp_1.npz")) as archive:
        counts = archive["counts"].astype(float)
    for imu_number in range(8):
        gyro = counts[:, imu_number, 3:]
        expected = ((gyro == 32767) | (gyro == -32768)).any(axis=1)
        assert expected.sum() > 900
        # Also where the converter's limits cannot be known, because the unit is another one.
        np.testing.assert_array_equal(saturated_samples(triad(gyro / 16.4, unit="deg/s")), expected)


# ---- repair ----


def test_samples_written_twice_are_dropped() -> None:
    samples = triad(np.random.default_rng(0).normal(size=(500, 3)))
    twice = TriadSamples(t_ns=np.repeat(samples.t_ns, 2), values=np.repeat(samples.values, 2, axis=0), unit="count")
    mended = drop_repeated_timestamps(twice)
    np.testing.assert_array_equal(mended.t_ns, samples.t_ns)
    np.testing.assert_array_equal(mended.values, samples.values)


def test_rare_repeated_stamps_are_dropped_many_are_not() -> None:
    samples = triad(np.random.default_rng(0).normal(size=(1000, 3)))
    t_ns = samples.t_ns.copy()
    t_ns[[10, 500]] = t_ns[[9, 499]]
    rare = TriadSamples(t_ns=t_ns, values=samples.values, unit="count")
    np.testing.assert_array_equal(drop_repeated_timestamps(rare).values, np.delete(samples.values, [10, 500], axis=0))
    coarse = TriadSamples(t_ns=samples.t_ns // 30_000_000 * 30_000_000, values=samples.values, unit="count")
    assert len(drop_repeated_timestamps(coarse)) == 1000


def test_a_stamp_that_is_wrong_costs_no_sample_where_they_are_counted() -> None:
    samples = triad(np.random.default_rng(0).normal(size=(1000, 3)))
    t_ns = samples.t_ns.copy()
    t_ns[[10, 500]] = t_ns[[9, 499]]
    rare = TriadSamples(t_ns=t_ns, values=samples.values, unit="count")
    assert drop_repeated_timestamps(rare, counted=True) is rare
    twice = TriadSamples(t_ns=np.repeat(samples.t_ns, 2), values=np.repeat(samples.values, 2, axis=0), unit="count")
    assert len(drop_repeated_timestamps(twice, counted=True)) == 1000


def test_a_coarse_converter_writes_nothing_twice() -> None:
    rng = np.random.default_rng(0)
    samples = triad(np.rint(0.3 * rng.normal(size=(2000, 3))))
    t_ns = samples.t_ns.copy()
    again = np.flatnonzero(rng.random(1999) < 0.2)
    t_ns[again] = t_ns[again + 1]
    assert len(drop_repeated_timestamps(TriadSamples(t_ns=t_ns, values=samples.values, unit="count"))) == 2000


def test_good_and_backward_stamps_are_left_alone() -> None:
    samples = triad(np.random.default_rng(0).normal(size=(100, 3)))
    assert drop_repeated_timestamps(samples) is samples
    backward = TriadSamples(t_ns=samples.t_ns[::-1], values=samples.values, unit="count")
    assert drop_repeated_timestamps(backward) is backward
