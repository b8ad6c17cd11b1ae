"""The sample rate is found once for timestamps that cannot change."""

import numpy as np
import pytest

from gnomon.recording import TriadSamples, arrays


def test_the_rate_is_kept_as_long_as_the_timestamps_live(monkeypatch) -> None:
    asked: list[int] = []
    found = arrays.usual_step
    monkeypatch.setattr(arrays, "usual_step", lambda steps: asked.append(1) or found(steps))
    samples = TriadSamples(t_ns=np.arange(50) * 5_000_000, values=np.zeros((50, 3)), unit="m/s^2")
    kept = len(arrays._RATES)
    assert samples.rate_hz == samples.rate_hz == 200.0
    assert len(asked) == 1
    assert len(arrays._RATES) == kept + 1
    del samples
    assert len(arrays._RATES) == kept


def test_timestamps_that_can_change_are_looked_at_anew() -> None:
    t_ns = np.arange(50) * 5_000_000
    assert arrays.usual_rate(t_ns) == 200.0
    t_ns *= 2
    assert arrays.usual_rate(t_ns) == pytest.approx(100.0)
    assert np.isnan(arrays.usual_rate(t_ns[:1]))
