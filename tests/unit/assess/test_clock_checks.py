"""The clocks of several streams: every fault is named by its code, good clocks have none."""

import numpy as np
import pytest

from gnomon.assess.checks.clock_checks import check_epochs
from gnomon.assess.checks.recorder_clocks import check_clocks, fit_clock
from gnomon.recording.recording import Arrivals

EPOCH = 1_600_000_000_000_000_000
BAD = {"warning", "problem"}


def arrivals(seconds=60.0, rate_hz=20.0, *, ppm=0.0, seed=1, delay_s=3e-3, spread_s=4e-3, offset_s=0.0, late=0.02):
    """Return messages of a clock that the recorder's gains `ppm` on; most come soon, some much later."""
    rng = np.random.default_rng(seed)
    count = round(seconds * rate_hz)
    true = np.arange(count) / rate_hz + rng.uniform(0, 1e-4, count)
    delay = delay_s + rng.gamma(0.7, spread_s, count) + (rng.random(count) < late) * rng.uniform(0, 0.4, count)
    stamped = true * (1 - 1e-6 * ppm) - offset_s
    received = np.maximum.accumulate(true + delay)  # one after the other
    return Arrivals(
        t_ns=EPOCH + np.rint(stamped * 1e9).astype(np.int64),
        received_ns=EPOCH + np.rint(received * 1e9).astype(np.int64),
    )


def shifted(stream, after_s, by_s, *, stamps=True):
    """Let the sensor's clock, or the recorder's, jump."""
    later = (stream.received_ns - stream.received_ns[0]) * 1e-9 > after_s
    step = np.where(later, round(by_s * 1e9), 0)
    if stamps:
        return Arrivals(t_ns=stream.t_ns + step, received_ns=stream.received_ns)
    return Arrivals(t_ns=stream.t_ns, received_ns=stream.received_ns + step)


def bad(streams):
    found = [finding for finding in check_clocks(streams) if finding.severity in BAD]
    assert all(finding.consequence and finding.cure for finding in found)
    return {finding.code: finding for finding in found}


def test_good_clocks() -> None:
    found = check_clocks({"cam0": arrivals(), "imu0": arrivals(rate_hz=200, seed=2)})
    assert [(finding.severity, finding.code) for finding in found] == [("good", "clock")] * 2
    assert "the latest after" in found[0].message


def test_drift_is_found_through_one_sided_delays() -> None:
    errors = []
    for seed in range(20):
        fit = fit_clock(arrivals(ppm=80, seed=seed))
        errors.append((fit.slope * 1e6 - 80) / (fit.sigma * 1e6))
        assert abs(fit.slope * 1e6 - 80) < 4
    assert np.std(errors) < 1.6  # the sigma is honest


@pytest.mark.parametrize("ppm", [60.0, -60.0])
def test_drift_between_camera_and_imu(ppm) -> None:
    found = bad({"cam0": arrivals(ppm=ppm), "imu0": arrivals(rate_hz=200, ppm=3, seed=2)})
    assert list(found) == ["clock-drift"]
    assert f"drift apart by {ppm - 3:+.0f} +-" in found["clock-drift"].message
    assert f"the time shift changes by {(ppm - 3) * 60e-3:+.1f}"[:-2] in found["clock-drift"].message


def test_both_clocks_may_differ_from_the_recorders() -> None:
    assert bad({"cam0": arrivals(ppm=120), "imu0": arrivals(rate_hz=200, ppm=118, seed=2)}) == {}


def test_small_drift_is_no_matter() -> None:
    assert bad({"cam0": arrivals(ppm=12), "imu0": arrivals(rate_hz=200, seed=2)}) == {}


def test_uncertain_drift_is_not_told() -> None:
    short = {"cam0": arrivals(6, ppm=40, spread_s=0.2), "imu0": arrivals(6, rate_hz=200, seed=2, spread_s=0.2)}
    assert bad(short) == {}


@pytest.mark.parametrize("by_s", [0.5, -0.2])
def test_clock_jump_of_one_stream(by_s) -> None:
    found = bad({"cam0": shifted(arrivals(), 31, by_s), "imu0": arrivals(rate_hz=200, seed=2)})
    assert list(found) == ["clock-jump"]
    assert f"cam0: its clock jumped by {by_s:+.1g} s" in found["clock-jump"].message
    at_s = float(found["clock-jump"].message.split(" s after the start")[0].rsplit(" ", 1)[1])
    assert at_s == pytest.approx(31, abs=2.5)
    assert found["clock-jump"].severity == "problem"


def test_jump_of_the_recorders_clock_harms_nothing() -> None:
    streams = {"cam0": arrivals(), "imu0": arrivals(rate_hz=200, seed=2)}
    found = check_clocks({name: shifted(stream, 31, 1.5, stamps=False) for name, stream in streams.items()})
    assert [(finding.severity, finding.code) for finding in found] == [("info", "clock-jump")]
    assert "The recorder's clock jumped by +1.5 s" in found[0].message


def test_hold_up_is_no_jump() -> None:
    stream = arrivals()
    received = stream.received_ns.copy()
    held = (stream.t_ns > stream.t_ns[0] + 20e9) & (stream.t_ns < stream.t_ns[0] + 25e9)
    received[held] = received[held].max()  # five seconds come at once
    assert bad({"cam0": Arrivals(t_ns=stream.t_ns, received_ns=received), "imu0": arrivals(rate_hz=200)}) == {}


def test_stamps_copied_from_arrivals_tell_no_drift() -> None:
    stream = arrivals()
    found = check_clocks({"cam0": Arrivals(t_ns=stream.received_ns, received_ns=stream.received_ns)})
    assert [(finding.severity, finding.code) for finding in found] == [("info", "clock-copied")]


@pytest.mark.parametrize(("factor", "said"), [(1e-3, "1000"), (1e-6, "1e+06"), (1e3, "0.001")])
def test_stamps_in_another_unit(factor, said) -> None:
    stream = arrivals()
    t_ns = ((stream.t_ns - EPOCH) * factor).astype(np.int64)
    found = bad({"cam0": Arrivals(t_ns=t_ns, received_ns=stream.received_ns)})
    assert list(found) == ["stamps-unit"]
    assert f"a unit {said} times as large" in found["stamps-unit"].message


def test_zero_stamps() -> None:
    stream = arrivals()
    found = bad({"cam0": Arrivals(t_ns=np.zeros_like(stream.t_ns), received_ns=stream.received_ns)})
    assert list(found) == ["stamps-zero"]
    assert "1200 of 1200 messages are stamped zero" in found["stamps-zero"].message


def test_few_or_no_messages() -> None:
    empty = Arrivals(t_ns=np.empty(0, np.int64), received_ns=np.empty(0, np.int64))
    assert check_clocks({}) == ()
    assert check_clocks({"cam0": empty, "imu0": arrivals(0.5)}) == ()


def test_out_of_order_messages() -> None:
    stream = arrivals(rate_hz=200)
    order = np.random.default_rng(3).permutation(len(stream.t_ns))
    fit = fit_clock(Arrivals(t_ns=stream.t_ns[order], received_ns=stream.received_ns[order]))
    assert fit.slope == pytest.approx(fit_clock(stream).slope, abs=2e-7)


# ---- epochs and units without a recorder ----


def stamps(start_s=1.6e9, seconds=60.0, rate_hz=20.0):
    return np.rint((start_s + np.arange(round(seconds * rate_hz)) / rate_hz) * 1e9).astype(np.int64)


def test_same_epoch_and_unit() -> None:
    assert check_epochs({"cam0": stamps(), "imu0": stamps(rate_hz=200)}) == ()
    assert check_epochs({"cam0": stamps(12.0), "imu0": stamps(0.0, rate_hz=200)}) == ()
    assert check_epochs({"cam0": stamps(seconds=7), "imu0": stamps(rate_hz=200)}) == ()  # a short one


def test_another_epoch() -> None:
    (found,) = check_epochs({"cam0": stamps(350.0), "cam1": stamps(351.0), "imu0": stamps(rate_hz=200)})
    assert (found.severity, found.code) == ("info", "stamps-epoch")
    assert "The timestamps of imu0 count from 1970, those of cam0, cam1 from another moment" in found.message


def test_another_unit() -> None:
    (found,) = check_epochs({"cam0": stamps(0.0) // 1000, "imu0": stamps(0.0, rate_hz=200)})
    assert (found.severity, found.code) == ("problem", "stamps-unit")
    assert "by a factor of 1000" in found.message


def test_one_stream_without_stamps() -> None:
    (found,) = check_epochs({"cam0": np.zeros(100, np.int64), "imu0": stamps(rate_hz=200)})
    assert (found.severity, found.code) == ("problem", "stamps-zero")
