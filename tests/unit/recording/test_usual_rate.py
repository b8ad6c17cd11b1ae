"""The sample rate is found once for timestamps that cannot change."""

from weakref import ref

import numpy as np
import pytest

from gnomon.recording import TriadSamples
from gnomon.recording import samples as module


def test_the_rate_is_kept_as_long_as_the_timestamps_live(monkeypatch) -> None:
    asked: list[int] = []
    found = module.usual_step
    monkeypatch.setattr(module, "usual_step", lambda steps: asked.append(1) or found(steps))
    samples = TriadSamples(t_ns=np.arange(50) * 5_000_000, values=np.zeros((50, 3)), unit="m/s^2")
    assert samples.rate_hz == samples.rate_hz == 200.0
    assert len(asked) == 1
    timestamps = ref(samples.t_ns)
    del samples
    assert timestamps() is None
    again = TriadSamples(t_ns=np.arange(50) * 2_500_000, values=np.zeros((50, 3)), unit="m/s^2")  # maybe in its place
    assert again.rate_hz == 400.0
    assert len(asked) == 2


def test_timestamps_that_can_change_are_looked_at_anew() -> None:
    t_ns = np.arange(50) * 5_000_000
    assert module.usual_rate(t_ns) == 200.0
    t_ns *= 2
    assert module.usual_rate(t_ns) == pytest.approx(100.0)
    assert np.isnan(module.usual_rate(t_ns[:1]))
