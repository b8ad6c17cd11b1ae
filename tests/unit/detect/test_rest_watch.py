"""Samples of a stream that is looked at block by block."""

import numpy as np
import pytest

from gnomon.detect.samples import rest_watch
from gnomon.detect.samples.rest_watch import RestWatch
from gnomon.recording import TriadSamples


def watched(values: np.ndarray, block: int) -> RestWatch:
    watch = RestWatch()
    t_ns = np.arange(len(values)) * 10_000_000
    for k in range(0, len(values), block):
        watch.add(TriadSamples(t_ns=t_ns[k : k + block], values=values[k : k + block], unit="rad/s"))
    return watch


def test_a_short_recording_is_kept_as_it_is() -> None:
    values = np.random.default_rng(1).normal(size=(5000, 3))
    kept = watched(values, 700).thinned()
    np.testing.assert_array_equal(kept.values, values)
    assert (kept.unit, kept.duration_s) == ("rad/s", pytest.approx(49.99))


@pytest.mark.parametrize("block", [100, 777, 4096])
def test_of_a_long_one_means_are_kept(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rest_watch, "_MOST_KEPT", 1000)
    values = np.repeat(np.arange(20_000.0)[:, None], 3, axis=1)
    kept = watched(values, block).thinned()
    assert 400 < len(kept) <= 1000
    assert np.all(np.diff(kept.t_ns) > 0)
    lag = kept.values[:, 0] - kept.t_ns / 1e7  # the mean lies half a width after the first
    assert np.all((lag >= 0) & (lag < 40))
