"""The doctor's look at stamps: rate, gaps, jitter, repeated, backward and rounded stamps."""

from dataclasses import dataclass

import numpy as np

from ..findings import Finding, make_finding
from ..recording import Integers, TriadSamples

_GAP_PERIODS = 1.5
_LOST_SHARE = 0.01
_LONG_GAP_S = 0.1
_JITTER = 0.3  # of a period
_BURSTS = 1.3  # mean over median step
_BLOCK = 2048
_JITTER_SAMPLES = 100_000
_FINE = 100.0  # steps of the clock in a period


@dataclass(frozen=True, slots=True, kw_only=True)
class _Steps:
    """Differences of stamps [ns] and what is usual among them."""

    dt: Integers
    period: float
    spread: float


def check_stamps(samples: TriadSamples, label: str) -> list[Finding]:
    """Return findings on the stamps of one sensor, or of both where they share stamps; linear time.

    Parameters
    ----------
    samples : at least two
    label : such as "imu0 accelerometer", for messages
    """
    dt = np.diff(samples.t_ns)
    period = 1e9 / samples.rate_hz
    if not np.isfinite(period):
        return [make_finding("time-constant", label=label, samples=len(samples))]
    spread = 1.4826 * float(np.median(np.abs(dt - period)))
    steps = _Steps(dt=dt, period=period, spread=spread)
    gaps = _gaps(samples, steps, label)
    irregular = [finding for finding in gaps if finding.code == "jitter"]
    findings = [*_backward(samples, steps, label), *irregular, *_repeated(steps, label)]
    findings += [] if irregular else gaps
    findings += _rounded(samples, steps, label)
    if not any(finding.severity in {"warning", "problem"} for finding in findings):
        findings.insert(
            0,
            make_finding(
                "rate",
                label=label,
                samples=len(samples),
                duration_s=samples.duration_s,
                rate_hz=samples.rate_hz,
                jitter=_jitter(steps),
            ),
        )
    return findings


def _jitter(steps: _Steps) -> float:
    """Return the root mean square of the deviations of steps from the usual one, gaps left out, in periods."""
    stride = max(1, len(steps.dt) // _JITTER_SAMPLES)
    off = steps.dt[::stride] / steps.period - 1
    return float(np.sqrt(np.mean(np.square(off[np.abs(off) < 0.5])))) if len(off) else 0.0


def _at(samples: TriadSamples, index: int) -> str:
    return f"sample {index} ({(samples.t_ns[index] - samples.t_ns[0]) * 1e-9:.3f} s after the start)"


def _backward(samples: TriadSamples, steps: _Steps, label: str) -> list[Finding]:
    back = np.flatnonzero(steps.dt < 0)
    if not len(back):
        return []
    first = int(back[0])
    return [
        make_finding(
            "time-backward",
            label=label,
            count=len(back),
            plural="s" * (len(back) > 1),
            step_s=-steps.dt[first] * 1e-9,
            at=_at(samples, first),
        )
    ]


def _repeated(steps: _Steps, label: str) -> list[Finding]:
    count = int(np.count_nonzero(steps.dt == 0))
    if not count:
        return []
    share = count / len(steps.dt)
    rare = share <= _LOST_SHARE
    return [
        make_finding(
            "time-repeated",
            severity="info" if rare else "warning",
            case="rare" if rare else "",
            label=label,
            count=count,
            share=share,
        )
    ]


def _gaps(samples: TriadSamples, steps: _Steps, label: str) -> list[Finding]:
    mean = (samples.t_ns[-1] - samples.t_ns[0]) / (len(samples) - 1)
    limit = _GAP_PERIODS * steps.period + 3 * steps.spread
    gaps = np.flatnonzero(steps.dt > limit)
    irregular = steps.spread > _JITTER * steps.period or (
        mean > _BURSTS * steps.period and len(gaps) > _LOST_SHARE * len(samples)
    )
    if irregular:
        return [
            make_finding(
                "jitter",
                label=label,
                period_ms=steps.period * 1e-6,
                mean_ms=mean * 1e-6,
                longest_ms=steps.dt.max() * 1e-6,
            )
        ]
    if not len(gaps):
        return []
    longest = int(gaps[np.argmax(steps.dt[gaps])])
    lost = int(np.rint(steps.dt[gaps] / steps.period - 1).sum())
    length_s = float(steps.dt[longest]) * 1e-9
    severe = length_s > _LONG_GAP_S or lost > _LOST_SHARE * len(samples)
    return [
        make_finding(
            "gaps",
            severity="warning" if severe else "info",
            case="severe" if severe else "",
            label=label,
            count=len(gaps),
            plural="s" * (len(gaps) > 1),
            lost=lost,
            length_s=length_s,
            at=_at(samples, longest),
        )
    ]


def _rounded(samples: TriadSamples, steps: _Steps, label: str) -> list[Finding]:
    """Find the step of the clock; text often keeps few digits of late stamps, so blocks are looked at apart."""
    starts = np.linspace(0, max(0, len(steps.dt) - _BLOCK), 8).astype(np.int64)
    blocks = [np.unique(steps.dt[a : a + _BLOCK]) for a in starts]
    # Steps that are all equal say nothing about the clock.
    quantum = max((int(np.gcd.reduce(block)) for block in blocks if len(block) > 1), default=0)
    steps_of_clock = steps.period / max(quantum, 1)
    if quantum == 0 or steps_of_clock > _FINE:
        return []
    return [make_finding("time-rounded", label=label, quantum_ms=quantum * 1e-6, percent=100 / steps_of_clock)]
