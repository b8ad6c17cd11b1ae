"""Recordings whose biases step or warm up, with another sensor appended, or with a long tremor: none passes falsely.

    python benchmarks/bias_changes.py --faulty 300 --healthy 200

A recording that passes must name every rest that it does not use, and its biases must be within 4 sigma of what they
state to be: of the last part where a bias stepped; else the mean over the recording, or of the rests if none is seen.
"""

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

import gnomon
from gnomon.recording import Floats, ImuSamples, Recording
from gnomon.results.result import Result
from gnomon.results.sensor_diagnostics import ImuDiagnostics

KINDS = ("gyroscope step", "accelerometer step", "gyroscope warm-up", "accelerometer warm-up", "appended", "tremor")
NEW = frozenset({"bias-step", "warm-up", "sensor-changed", "rates-left-out", "intervals-left-out"})
INTERVALS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A recording and its truth.

    Attributes
    ----------
    what : in words
    t_s : (n,) instants [s]
    gyroscope, accelerometer : (n, 3) true biases [rad/s], [m/s^2]; None where there is no one truth
    """

    what: str
    recording: Recording
    t_s: Floats
    gyroscope: Floats | None
    accelerometer: Floats | None


def make_case(kind: str, seed: int) -> Case:
    """Return a recording of a kind of `KINDS`, or "healthy"."""
    rng = np.random.default_rng([77, seed])
    scenario = gnomon.Scenario(
        intervals=INTERVALS, t_init_s=float(rng.uniform(10, 50)), g_sensitivity=float(rng.choice([0.0, 2e-4]))
    )
    recording, truth = gnomon.simulate(scenario, 40_000 + seed)
    imu, known = recording.imus["imu0"], truth.imus["imu0"]
    t_s = imu.gyroscope.t_s
    zero = np.zeros((len(t_s), 3))
    assert known.gyroscope is not None
    gyroscope, accelerometer = known.gyroscope.bias + zero, known.accelerometer.bias + zero
    if kind == "appended":
        other, _ = gnomon.simulate(replace(scenario), 80_000 + seed)
        share = rng.uniform(0.08, 0.92)
        imu = with_another(imu, other.imus["imu0"], share)
        return Case(
            what=f"{kind} at {share:.2f}",
            recording=replace(recording, imus={"imu0": imu}),
            t_s=imu.gyroscope.t_s,
            gyroscope=None,
            accelerometer=None,
        )
    size, course = 0.0, np.zeros(len(t_s))
    if kind.endswith("step"):
        at = rng.uniform(0.02, 0.98)
        course, what = (t_s > at * t_s[-1]).astype(float), f"at {at:.3f}"
    elif kind.endswith("warm-up"):
        tau = np.exp(rng.uniform(np.log(10), np.log(300)))
        course, what = np.exp(-t_s / tau), f"in {tau:.0f} s"
    else:
        what = ""
    low, high = (1e-4, 3e-2) if kind.startswith("gyroscope") else (1e-3, 1e-1)
    direction = rng.normal(size=3)
    size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    change = size * course[:, None] * direction / np.linalg.norm(direction)
    if kind.startswith("gyroscope"):
        gyroscope = gyroscope + change
        imu = _with(imu, gyroscope=change)
    elif kind.startswith("accelerometer"):
        accelerometer = accelerometer + change
        imu = _with(imu, accelerometer=change)
    elif kind == "tremor":
        size = float(rng.uniform(2e-3, 1.5e-2))
        begin, length = rng.uniform(0, 0.7), rng.uniform(0.1, 0.5)
        inside = (t_s > begin * t_s[-1]) & (t_s < (begin + length) * t_s[-1])
        phase = 2 * np.pi * (rng.uniform(2, 9, 3) * t_s[:, None] + rng.uniform(size=3))
        imu = _with(imu, gyroscope=size * inside[:, None] * np.sin(phase))
        what = f"from {begin:.2f} for {length:.2f}"
    return Case(
        what=f"{kind} {size:.2g} {what}",
        recording=replace(recording, imus={"imu0": imu}),
        t_s=t_s,
        gyroscope=gyroscope,
        accelerometer=accelerometer,
    )


def _with(imu: ImuSamples, **changes: Floats) -> ImuSamples:
    for name, change in changes.items():
        triad = getattr(imu, name)
        imu = replace(imu, **{name: replace(triad, values=triad.values + change)})
    return imu


def with_another(first: ImuSamples, second: ImuSamples, share: float) -> ImuSamples:
    """Return the beginning of one recording with the end of another one behind it."""
    edge = share * first.accelerometer.t_s[-1]
    triads = {}
    for name in ("accelerometer", "gyroscope"):
        a, b = getattr(first, name), getattr(second, name)
        k, j = np.searchsorted(a.t_s, edge), np.searchsorted(b.t_s, edge)
        shift = a.t_ns[k - 1] + round(1e9 / a.rate_hz) - b.t_ns[j]
        triads[name] = replace(
            a,
            t_ns=np.concatenate([a.t_ns[:k], b.t_ns[j:] + shift]),
            values=np.concatenate([a.values[:k], b.values[j:]]),
        )
    return ImuSamples(**triads)


def z_of_biases(case: Case, result: Result) -> dict[str, float]:
    """Return the largest error of each bias over its sigma, by what the bias is stated to be."""
    diagnostics = result.diagnostics
    assert isinstance(diagnostics, ImuDiagnostics)
    found: dict[str, float] = {}
    for triad, truth in (("gyroscope", case.gyroscope), ("accelerometer", case.accelerometer)):
        if truth is None:
            continue
        path = f"imu0.{triad}.bias"
        error = result.calibration.parameter(path) - _stated(case, truth, triad, diagnostics, result)
        found[triad] = float(np.max(np.abs(error) / result.calibration.sigma(path)))
    return found


def _stated(case: Case, truth: Floats, triad: str, diagnostics: ImuDiagnostics, result: Result) -> Floats:
    """Return the true value of what a bias is stated to be."""
    rests = diagnostics.intervals
    start, stop = rests.start_s[rests.used][0], rests.stop_s[rests.used][-1]
    stepped = False
    for segments in diagnostics.bias_segments:
        if segments.triad == triad:
            start, stop = segments.start_s[segments.published], segments.stop_s[segments.published]
            stepped = True
    added = result.calibration.assessment.trust.added
    if {"gyroscope": "drift", "accelerometer": "accelerometer drift"}[triad] in added:
        inside = (case.t_s >= start) & (case.t_s <= stop)  # the mean over time
        return truth[inside].mean(axis=0)
    parts = [
        truth[(case.t_s >= rests.start_s[k]) & (case.t_s <= rests.stop_s[k])]
        for k in np.flatnonzero(rests.used)
        if start <= rests.start_s[k] and rests.stop_s[k] <= stop
    ]
    if stepped:  # gravity may leave open on which side of the step a rest beside it lies
        return np.median(np.concatenate(parts), axis=0)
    return np.mean([part.mean(axis=0) for part in parts], axis=0)  # a rest counts by its mean, not by its length


def judge(case: Case) -> tuple[str, str]:
    """Return the outcome: "right", "warned", "refused", "rests lost", or "wrong"; and more of it."""
    try:
        result = gnomon.calibrate_imu(case.recording)
    except gnomon.GnomonError as error:
        return "refused", str(error)[:100]
    assessment = result.calibration.assessment
    codes = ",".join(f.code for f in assessment.findings if f.severity in ("problem", "warning") or f.code in NEW)
    z = z_of_biases(case, result)
    detail = f"{assessment.intervals_used}/{assessment.intervals_found} {codes} z " + " ".join(
        f"{triad[:5]} {value:.1f}" for triad, value in z.items()
    )
    if assessment.verdict != "pass":
        return "warned", detail
    diagnostics = result.diagnostics
    assert isinstance(diagnostics, ImuDiagnostics)
    unsaid = any(
        not why for why, used in zip(diagnostics.intervals.reason, diagnostics.intervals.used, strict=True) if not used
    )
    listed = assessment.intervals_found == assessment.intervals_used or "intervals-left-out" in codes
    if unsaid or not listed or assessment.intervals_found < INTERVALS - 1:
        return "rests lost", detail
    if case.gyroscope is None and assessment.intervals_found == assessment.intervals_used and not codes:
        return "wrong", detail
    return ("wrong" if max(z.values(), default=0.0) > 4 else "right"), detail


def main() -> None:
    """Print the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faulty", type=int, default=60)
    parser.add_argument("--healthy", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    outcomes: dict[str, Counter[str]] = {}
    for count, kinds in ((options.faulty, KINDS), (options.healthy, ("healthy",))):
        for k in range(count):
            kind = kinds[k % len(kinds)]
            case = make_case(kind, options.first_seed + k)
            outcome, detail = judge(case)
            outcomes.setdefault(kind, Counter())[outcome] += 1
            if options.verbose or outcome in ("wrong", "rests lost") or (kind == "healthy" and outcome != "right"):
                print(f"{options.first_seed + k:5} {case.what:45} {outcome:10} {detail}", flush=True)
    for kind, counts in outcomes.items():
        print(f"{kind:25} " + ", ".join(f"{name} {number}" for name, number in counts.most_common()))
    faulty = sum((counts for kind, counts in outcomes.items() if kind != "healthy"), Counter[str]())
    passed = faulty["right"] + faulty["wrong"] + faulty["rests lost"]
    print(
        f"faulty: {passed} of {faulty.total()} pass, {faulty['right']} of these within 4 sigma "
        f"({100 * faulty['right'] / max(passed, 1):.1f} %), {faulty['rests lost']} with an unsaid loss of rests"
    )
    healthy = outcomes.get("healthy", Counter())
    print(f"healthy: {healthy.total() - healthy['right']} of {healthy.total()} warned, lost or wrong")


if __name__ == "__main__":
    main()
