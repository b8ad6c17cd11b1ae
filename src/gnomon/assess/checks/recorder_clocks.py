"""The clocks of streams against the recorder's: drift, jumps, and timestamps that are those of arrival.

A recorder that notes when each message arrived lends all streams one clock to be compared with. A message arrives after
it was stamped, by a delay that never falls below some least one: the lower envelope of arrival less timestamp is a
straight line whose slope is the drift between both clocks, however late single messages are.
"""

import itertools
from collections.abc import Mapping

import numpy as np

from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats
from ...recording.recording import Arrivals
from .clock_checks import drift_finding, unit_factor, zero_stamps

_FEWEST = 20
_SHORTEST_S = 5.0
_BINS = 40
_LEAST_SIGMA_S = 1e-6  # timestamps are no better
_JUMP_S = 0.02
_JUMP_SIGMAS = 10.0
_JUMP_REACH_S = 2.0  # a queue that held messages is empty again after this time
_TOGETHER_S = 3.0
_SAME_JUMP = 0.2


@value_class(eq=True)
class ClockFit:
    """One stream's clock against the recorder's.

    Attributes
    ----------
    slope : seconds by which the recorder's clock gains on the stream's, in a second
    sigma : its standard deviation
    spread_s : half of the messages came later than the earliest ones by this or more
    latest_s : by which the latest came later
    """

    slope: float
    sigma: float
    spread_s: float
    latest_s: float


@value_class(eq=True)
class _Jump:
    """A step of arrival less timestamp: when on the recorder's clock [s from `origin`], and by how much [s]."""

    at_s: float
    size_s: float


def check_clocks(arrivals: Mapping[str, Arrivals]) -> tuple[Finding, ...]:
    """Look at the clocks of streams that one recorder recorded.

    Codes: clock, clock-copied, clock-jump, clock-drift, stamps-zero, stamps-unit.

    Parameters
    ----------
    arrivals : "cam0", "imu0", ... -> timestamps and arrivals
    """
    findings: list[Finding] = []
    fits: dict[str, ClockFit] = {}
    jumps: dict[str, tuple[_Jump, ...]] = {}
    for name, stream in arrivals.items():
        wrong = _wrong_stamps(name, stream)
        if wrong is not None:
            findings.append(wrong)
        elif _usable(stream):
            jumps[name] = _jumps(stream)
            if not jumps[name]:
                fits[name] = fit_clock(stream)
    findings += _copied([name for name, stream in arrivals.items() if _is_copied(stream)])
    findings += _jump_findings(jumps, arrivals)
    for name, fit in fits.items():
        findings += [
            make_finding(
                "clock/recorder",
                name=name,
                slope=fit.slope,
                sigma=fit.sigma,
                spread=_time(fit.spread_s),
                latest=_time(fit.latest_s),
            )
        ]
    return (*findings, *_drifts(fits, arrivals))


def _usable(stream: Arrivals) -> bool:
    """Tell whether a stream is long enough, and its timestamps are not the arrivals themselves."""
    if len(stream.t_ns) < _FEWEST or _is_copied(stream):
        return False
    return float(np.ptp(stream.received_ns)) * 1e-9 >= _SHORTEST_S and float(np.ptp(stream.t_ns)) > 0


def _is_copied(stream: Arrivals) -> bool:
    return len(stream.t_ns) >= _FEWEST and np.array_equal(stream.t_ns, stream.received_ns)


def _copied(names: list[str]) -> list[Finding]:
    """Say whose timestamps are those of arrival."""
    if not names:
        return []
    return [make_finding("clock-copied", names=", ".join(names))]


def _wrong_stamps(name: str, stream: Arrivals) -> Finding | None:
    """Return what is wrong with timestamps as such."""
    count = len(stream.t_ns)
    zero = zero_stamps(name, stream.t_ns)
    if zero is not None or count < _FEWEST or _is_copied(stream):
        return zero
    stamped, received = (float(np.ptp(t)) * 1e-9 for t in (stream.t_ns, stream.received_ns))
    factor = unit_factor(stamped / received) if received > 0 and stamped > 0 else None
    if factor is None:
        return None
    return make_finding("stamps-unit/received", name=name, stamped=stamped, received=received, factor=factor)


def fit_clock(stream: Arrivals) -> ClockFit:
    """Return the drift of a stream's clock against the recorder's, by the lower envelope of the delays."""
    t, delay = _delays(stream)
    at, least = _envelope(t, delay)
    slope = _median_slope(at, least)
    rest = least - slope * at
    rest = rest - np.median(rest)
    scatter = 1.4826 * float(np.median(np.abs(rest)))
    # Slow changes of the least delay make neighbours alike: fewer of them are independent.
    together = float(np.clip(rest[1:] @ rest[:-1] / max(float(rest @ rest), 1e-300), 0.0, 0.9))
    scatter = max(scatter, _LEAST_SIGMA_S) * np.sqrt((1 + together) / (1 - together))
    spread = at - at.mean()
    above = delay - slope * t
    above = above - np.quantile(above, 0.01)
    return ClockFit(
        slope=slope,
        sigma=1.25 * scatter / float(np.sqrt(spread @ spread)),  # a median is less certain than a mean
        spread_s=float(np.median(above)),
        latest_s=float(above.max()),
    )


def _delays(stream: Arrivals) -> tuple[Floats, Floats]:
    """Return timestamps and arrival less timestamp, both from their first value, in the order of arrival [s]."""
    order = np.argsort(stream.received_ns, kind="stable")
    stamped, received = stream.t_ns[order], stream.received_ns[order]
    delay = received - stamped  # integers: unix nanoseconds do not fit into floats
    return (received - received[0]) * 1e-9, (delay - delay[0]) * 1e-9


def _envelope(t: Floats, delay: Floats) -> tuple[Floats, Floats]:
    """Return the earliest message of each of equal groups: when, and its delay."""
    count = min(_BINS, len(t) // 5)
    edges = np.linspace(0, len(t), count + 1).astype(np.int64)
    earliest = np.array([a + int(np.argmin(delay[a:b])) for a, b in itertools.pairwise(edges)])
    return t[earliest], delay[earliest]


def _median_slope(x: Floats, y: Floats) -> float:
    """Return the median slope between all pairs (Theil and Sen): a third of the points may be anywhere."""
    first, second = np.triu_indices(len(x), 1)
    step = x[second] - x[first]
    far = step > 0
    return float(np.median((y[second] - y[first])[far] / step[far])) if far.any() else 0.0


def _jumps(stream: Arrivals) -> tuple[_Jump, ...]:
    """Return where the delay steps to another level and stays there: late messages come back, clocks do not."""
    t, delay = _delays(stream)
    at, least = _windows(t, delay)
    if len(at) < 6:
        return ()
    steps = np.diff(least)
    usual = float(np.median(steps))
    scatter = 1.4826 * float(np.median(np.abs(steps - usual)))
    limit = max(_JUMP_S, _JUMP_SIGMAS * scatter)
    found: list[_Jump] = []
    for k in np.flatnonzero(np.abs(steps - usual) > limit).tolist():
        # Compare levels two windows before with two windows after: a hold-up has passed by then.
        before, after = least[max(k - 1, 0) : k + 1].min(), least[k + 1 : k + 3].min()
        size = float(after - before)
        again = found and at[k + 1] - found[-1].at_s <= 2 * _JUMP_REACH_S  # the same one, seen twice
        if abs(size) > limit and k + 2 < len(least) and not again:
            found.append(_Jump(at_s=float(at[k + 1]), size_s=size))
    return tuple(found)


def _windows(t: Floats, delay: Floats) -> tuple[Floats, Floats]:
    """Return the least delay in each stretch of two seconds, with the time where the stretch begins."""
    window = np.floor(t / _JUMP_REACH_S).astype(np.int64)
    first = np.flatnonzero(np.concatenate([[True], np.diff(window) > 0]))
    enough = np.diff(np.append(first, len(t))) >= 3
    return t[first][enough], np.minimum.reduceat(delay, first)[enough]


def _jump_findings(jumps: Mapping[str, tuple[_Jump, ...]], arrivals: Mapping[str, Arrivals]) -> list[Finding]:
    """Say which clocks jumped; a jump of all streams at once is the recorder's, and harms nothing."""
    findings: list[Finding] = []
    for name, found in jumps.items():
        for jump in found:
            shared = len(jumps) > 1 and all(_has(jump, name, jumps[other], other, arrivals) for other in jumps)
            if shared and name != next(iter(jumps)):
                continue
            findings.append(
                make_finding("clock-jump/recorder", size_s=jump.size_s, at_s=jump.at_s)
                if shared
                else make_finding("clock-jump/stream", name=name, size_s=-jump.size_s, at_s=jump.at_s)
            )
    return findings


def _has(jump: _Jump, name: str, others: tuple[_Jump, ...], other: str, arrivals: Mapping[str, Arrivals]) -> bool:
    origin = float(int(arrivals[name].received_ns.min()) - int(arrivals[other].received_ns.min())) * 1e-9
    return any(
        abs(one.at_s - origin - jump.at_s) < _TOGETHER_S
        and abs(one.size_s - jump.size_s) < _SAME_JUMP * abs(jump.size_s)
        for one in others
    )


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.2g} ms" if seconds < 1 else f"{seconds:.2g} s"


def _drifts(fits: Mapping[str, ClockFit], arrivals: Mapping[str, Arrivals]) -> list[Finding]:
    """Compare each camera with each IMU, or every two streams where there are no such names."""
    pairs = [(a, b) for a in fits for b in fits if a.startswith("cam") and b.startswith("imu")]
    findings: list[Finding] = []
    for camera, imu in pairs:
        drift = fits[camera].slope - fits[imu].slope
        sigma = float(np.hypot(fits[camera].sigma, fits[imu].sigma))
        length_s = float(np.ptp(arrivals[camera].received_ns)) * 1e-9
        finding = drift_finding(camera, imu, drift=drift, sigma=sigma, length_s=length_s, how="by when they arrived")
        findings += [] if finding is None else [finding]
    return findings
