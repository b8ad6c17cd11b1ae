"""Faults of magnetometers, resting IMUs, turntables and poses.

    python benchmarks/sensor_faults.py                        every case, 12 seeds each, some ten minutes
    python benchmarks/sensor_faults.py magnetometer --seeds 4

Does a wrong result ever pass, does a right one warn? One row a case: verdicts, the largest errors in sigmas (of those
beyond what is needed, where there are any), and `missed`: results that pass with an error beyond 4 sigma and beyond
what is needed. Rows of healthy recordings count warnings. The sensors and the faults are drawn from the seeds.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

import gnomon
from gnomon.errors import GnomonError
from gnomon.options import StatedRate
from gnomon.recording import ImuSamples, Poses, Recording, TriadSamples
from gnomon.results.sensor_noise import Coefficient
from gnomon.simulate import (
    FieldScenario,
    PoseScenario,
    TurntableScenario,
    simulate_magnetometer,
    simulate_poses,
    simulate_turntable,
)
from gnomon.simulate.scenarios.recorded import NoiseScenario
from gnomon.simulate.sensor import noise_blocks

Floats = NDArray[np.float64]
_BEYOND = 4.0  # sigmas


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Of one recording: verdict ("refused" where there is none), codes of warnings, error in sigmas, and in needs."""

    verdict: str
    codes: tuple[str, ...] = ()
    sigmas: float = 0.0
    needs: float = 0.0

    @property
    def missed(self) -> bool:
        """Whether a wrong result passed."""
        return self.verdict == "pass" and self.sigmas > _BEYOND and self.needs > 1


Case = Callable[[int], Outcome]


def tried(
    result: Callable[[], "gnomon.Result"],
    error: Callable[["gnomon.Calibration"], tuple[list[Floats], list[Floats], list[Floats]]],
):
    """Return the outcome of a calibration; `error` gives errors, sigmas and what is needed."""
    try:
        calibration = result().calibration
    except GnomonError:
        return Outcome(verdict="refused")
    off, sigma, need = (np.concatenate([np.ravel(part) for part in parts]) for parts in error(calibration))
    needs = np.abs(off) / need
    sigmas = np.where(sigma > 0, np.abs(off) / np.where(sigma > 0, sigma, 1.0), np.where(needs > 1, np.inf, 0.0))
    beyond = needs > 1 if (needs > 1).any() else needs >= 0
    return Outcome(
        verdict=calibration.verdict,
        codes=tuple(f.code for f in calibration.assessment.findings if f.severity in ("warning", "problem")),
        sigmas=float(np.max(sigmas[beyond])),
        needs=float(np.max(needs)),
    )


# ---- magnetometers

_FIELD_UT = 48.0
_STATED = gnomon.MagnetometerOptions(field=_FIELD_UT)


def _with_magnetometer(recording: Recording, values: Floats, unit: str | None = None) -> Recording:
    imu = recording.imus["imu0"]
    assert imu.magnetometer is not None
    changed = replace(imu.magnetometer, values=values, unit=unit or imu.magnetometer.unit)
    return replace(recording, imus={"imu0": replace(imu, magnetometer=changed)})


def _field_outcome(
    seed: int,
    scenario: FieldScenario,
    edit: Callable[[Floats, np.random.Generator], Floats],
    wanted: gnomon.MagnetometerOptions = _STATED,
) -> Outcome:
    recording, truth = simulate_magnetometer(scenario, seed)
    imu = recording.imus["imu0"]
    assert imu.magnetometer is not None
    edited = _with_magnetometer(recording, edit(imu.magnetometer.values, np.random.default_rng(seed)))
    names = "imu0.magnetometer.sensitivity", "imu0.magnetometer.bias"

    def error(found: gnomon.Calibration) -> tuple[list[Floats], list[Floats], list[Floats]]:
        off = [found.parameter(name) - truth.parameter(name) for name in names]
        if found.frame != truth.frame:  # only lengths compare
            off[0] = found.parameter(names[0]) @ found.parameter(names[0]).T
            off[0] = np.diag(off[0] - truth.parameter(names[0]) @ truth.parameter(names[0]).T) * np.eye(3) / 2
        return off, [found.sigma(name) for name in names], [np.full((3, 3), 0.02), np.full(3, 0.02 * _FIELD_UT)]

    return tried(lambda: gnomon.calibrate_magnetometer(edited, wanted), error)


def _mirrored(values: Floats, rng: np.random.Generator) -> Floats:
    kind = int(rng.integers(0, 6))
    if kind < 3:
        return values * np.where(np.arange(3) == kind, -1.0, 1.0)
    order = [[1, 0, 2], [0, 2, 1], [2, 1, 0]][kind - 3]
    return values[:, order]


def _stepped(size_ut: float) -> Callable[[Floats, np.random.Generator], Floats]:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        later = np.arange(len(values)) > rng.uniform(0.3, 0.7) * len(values)
        return values + later[:, None] * size_ut * rng.standard_normal(3)

    return edit


def _same(values: Floats, rng: np.random.Generator) -> Floats:
    del rng
    return values


def magnetometer_cases() -> Iterator[tuple[str, Case]]:
    """Yield cases by name."""
    for soft in (0.005, 0.02, 0.05):
        scenario = FieldScenario(soft_iron=soft, inhomogeneity=0.3, rests=8, duration_s=60.0)
        yield f"soft iron {soft}, auto", lambda seed, s=scenario: _field_outcome(seed, s, _same)
        yield (
            f"soft iron {soft}, hard-iron",
            lambda seed, s=scenario: _field_outcome(seed, s, _same, replace(_STATED, model="hard-iron")),
        )
    north = FieldScenario(rests=8, inhomogeneity=0.2)
    yield (
        "axis mirrored, --latitude",
        lambda seed: _field_outcome(seed, north, _mirrored, replace(_STATED, latitude=48.0)),
    )
    south = replace(north, dip_deg=-50.0)
    yield (
        "axis mirrored, south, --dip",
        lambda seed: _field_outcome(seed, south, _mirrored, replace(_STATED, dip=-50.0)),
    )
    yield "axis mirrored, nothing stated", lambda seed: _field_outcome(seed, north, _mirrored)
    for size in (1.0, 5.0):
        yield f"hard iron changes by {size} uT", lambda seed, size=size: _field_outcome(seed, north, _stepped(size))
    yield "healthy: south, --dip", lambda seed: _field_outcome(seed, south, _same, replace(_STATED, dip=-50.0))
    yield "healthy: with accelerometer", lambda seed: _field_outcome(seed, north, _same)
    alone = FieldScenario(accelerometer=False, inhomogeneity=0.3)
    yield "healthy: alone", lambda seed: _field_outcome(seed, alone, _same)


# ---- noise

_NEEDED = {"white_noise": 0.05, "bias_instability": 0.5, "random_walk": 0.5}  # of the coefficient
_AT_REST = NoiseScenario(duration_s=3600.0, rate_hz=100.0)
_N, _B = _AT_REST.gyroscope_white_noise, _AT_REST.gyroscope_bias_instability
_K = _AT_REST.gyroscope_random_walk
NoiseEdit = Callable[[Floats, np.random.Generator], Floats]


def _noise_outcome(seed: int, edit: NoiseEdit, scenario: NoiseScenario = _AT_REST) -> Outcome:
    values = np.concatenate(list(noise_blocks(scenario, "gyroscope", seed)))
    values = edit(values, np.random.default_rng(seed))
    t_ns = np.rint(np.arange(len(values)) * 1e9 / scenario.rate_hz).astype(np.int64)
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="m/s^2")
    gyroscope = TriadSamples(t_ns=t_ns, values=values, unit="rad/s")
    recording = Recording(imus={"imu0": ImuSamples(accelerometer=nothing, gyroscope=gyroscope)})
    try:
        noise = gnomon.identify_noise(recording).noise
    except GnomonError:
        return Outcome(verdict="refused")
    assert noise.gyroscope is not None
    truth = scenario.of("gyroscope")
    sigmas, needs = 0.0, 0.0
    for axis in noise.gyroscope.axes:
        for name, share in _NEEDED.items():
            found: Coefficient = axis.coefficients()[name]
            if found.found:
                error, sigma = abs(found.value - truth[name]), found.sigma
            else:  # two sigma
                error, sigma = max(truth[name] - 0.0, 0.0), found.bound / 2
            beyond = error / (share * max(truth[name], 1e-12))
            if beyond > 1:
                sigmas, needs = max(sigmas, error / sigma), max(needs, beyond)
    return Outcome(
        verdict=noise.verdict,
        codes=tuple(f.code for f in noise.findings if f.severity in ("warning", "problem")),
        sigmas=sigmas,
        needs=needs,
    )


def _filtered(values: Floats, b: list[float], a: list[float]) -> Floats:
    from scipy.signal import lfilter, lfilter_zi

    start = lfilter_zi(b, a)[:, None] * values.mean(axis=0)
    return np.asarray(lfilter(b, a, values, axis=0, zi=start)[0], dtype=np.float64)


def _low_pass(hz: float, order: int) -> NoiseEdit:
    from scipy.signal import butter

    b, a = cast("tuple[Floats, Floats]", butter(order, hz, fs=_AT_REST.rate_hz))
    return lambda values, _: _filtered(values, b.tolist(), a.tolist())


def _high_pass(hz: float) -> NoiseEdit:
    keep = float(np.exp(-2 * np.pi * hz / _AT_REST.rate_hz))
    return lambda values, _: _filtered(values, [1.0, -1.0], [1.0, -keep])


def _auto_zero(every_s: float) -> NoiseEdit:
    count = round(every_s * _AT_REST.rate_hz)

    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        del rng
        whole = len(values) // count * count
        parts = values[:whole].reshape(-1, count, 3)
        return (parts - parts.mean(axis=1, keepdims=True)).reshape(-1, 3)

    return edit


def _zeroed_before(every_s: float) -> NoiseEdit:
    """Subtract what the last five seconds of the time before showed."""
    count, averaged = round(every_s * _AT_REST.rate_hz), round(5 * _AT_REST.rate_hz)

    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        del rng
        parts = values[: len(values) // count * count].reshape(-1, count, 3)
        return (parts[1:] - parts[:-1, -averaged:].mean(axis=1, keepdims=True)).reshape(-1, 3)

    return edit


def _zeroed_now_and_then(kind: str, where: str) -> Case:
    """Return the case of any sensor for 1 to 6 h whose slow errors are taken away every minute to half an hour."""

    def run(seed: int) -> Outcome:
        scenario = replace(_drawn_at_rest(seed), rate_hz=20.0, gyroscope_quantisation=0.0)
        rng = np.random.default_rng([seed, 2])
        scenario = replace(scenario, duration_s=float(np.exp(rng.uniform(*np.log([3600.0, 6 * 3600.0])))))
        shortest, longest = (50.0, 1000.0) if kind == "high-pass" else (60.0, min(1800.0, scenario.duration_s / 4))
        every = float(np.exp(rng.uniform(np.log(shortest), np.log(longest)))) * scenario.rate_hz

        def edit(values: Floats, _: np.random.Generator) -> Floats:
            if kind == "high-pass":
                keep = float(np.exp(-2 * np.pi / every))
                changed = _filtered(values, [1.0, -1.0], [1.0, -keep])
            else:
                changed = _zeroed_at(
                    values, _instants(len(values), every, even=kind != "at any time", rng=rng), kind, rng
                )
            if where == "half":  # goes on from where it is
                half = len(values) // 2
                later = np.arange(len(values))[:, None] >= half
                changed = np.where(later, changed - changed[half] + values[half], values)
            return np.where(np.arange(3) == rng.integers(3), changed, values) if where == "one axis" else changed

        return _noise_outcome(seed, edit, scenario)

    return run


def _instants(count: int, every: float, *, even: bool, rng: np.random.Generator) -> list[int]:
    """Return the samples at which a sensor is zeroed."""
    gaps = np.full(int(2 * count / every) + 2, every) * (
        1.0 if even else rng.uniform(0.5, 1.5, int(2 * count / every) + 2)
    )
    at = np.rint(np.cumsum(gaps)).astype(int)
    return [0, *at[at < count].tolist(), count]


def _zeroed_at(values: Floats, at: list[int], kind: str, rng: np.random.Generator) -> Floats:
    """Subtract the mean of each part ("to its mean"), or what the last 1 to 30 s before it showed."""
    shown = round(float(np.exp(rng.uniform(*np.log([1.0, 30.0])))) * 20.0)
    changed = values.copy()
    for start, stop in pairwise(at):
        seen = values[start:stop] if kind == "to its mean" else values[max(start - shown, 0) : max(start, shown)]
        changed[start:stop] -= seen.mean(axis=0)
    return changed


def _grows(factor: float) -> NoiseEdit:
    return lambda values, _: values * np.linspace(1.0, factor, len(values))[:, None]


def _freezes(share: float) -> NoiseEdit:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        axis, first = int(rng.integers(0, 3)), int((1 - share) * len(values))
        changed = values.copy()
        changed[first:, axis] = changed[first, axis]
        return changed

    return edit


def _clips(sigmas: float) -> NoiseEdit:
    end = sigmas * _N * np.sqrt(_AT_REST.rate_hz)
    return lambda values, _: np.clip(values, -end, end)


def _between(size: float) -> NoiseEdit:
    """Add noise of spectrum 1/f^0.5 with as much power at a second as `size` times the white noise."""

    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        f = np.fft.rfftfreq(len(values), 1 / _AT_REST.rate_hz)
        shape = np.where(f > 0, np.maximum(f, 1e-9), np.inf) ** -0.25
        white = np.fft.rfft(_N * np.sqrt(_AT_REST.rate_hz) * rng.standard_normal(values.shape), axis=0)
        return values + size * np.fft.irfft(white * shape[:, None], len(values), axis=0)

    return edit


def _step(size: float) -> NoiseEdit:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        later = np.arange(len(values)) > rng.uniform(0.15, 0.85) * len(values)
        return values + size * later[:, None] * rng.choice([-1.0, 1.0], 3)

    return edit


def _wave(size: float) -> NoiseEdit:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        t = np.arange(len(values)) / _AT_REST.rate_hz
        return values + size * np.sin(2 * np.pi * t / rng.uniform(200, 900) + rng.uniform(0, 6))[:, None]

    return edit


def _warm_up(size: float) -> NoiseEdit:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        t = np.arange(len(values)) / _AT_REST.rate_hz
        return values + size * np.exp(-t / rng.uniform(150, 900))[:, None]

    return edit


def _as_it_is(values: Floats, rng: np.random.Generator) -> Floats:
    del rng
    return values


def _drawn_at_rest(seed: int) -> NoiseScenario:
    """Return a sensor of any quality and a length, drawn."""
    rng = np.random.default_rng([seed, 1])
    white = _N * 10 ** rng.uniform(-1, 1)
    flicker = white * 10 ** rng.uniform(-1.2, -0.1)  # [1/sqrt(s)]: the floor is reached after 0.2 to 100 s
    return replace(
        _AT_REST,
        duration_s=float(np.exp(rng.uniform(np.log(1200.0), np.log(7200.0)))),
        rate_hz=float(rng.choice([50.0, 100.0, 200.0])),
        gyroscope_white_noise=white,
        gyroscope_bias_instability=flicker,
        gyroscope_random_walk=flicker * 10 ** rng.uniform(-1.6, -0.7),
        gyroscope_quantisation=white * float(rng.choice([0.0, 0.03])),
    )


def _rounded(values: Floats, rng: np.random.Generator) -> Floats:
    """Return readings of a converter with steps of a fiftieth to two thirds of the standard deviation, and a bias."""
    step = float(values.std(axis=0).min()) * 10 ** rng.uniform(-1.7, -0.2)
    return np.rint((values + 30 * step * rng.standard_normal(3)) / step) * step


def noise_cases() -> Iterator[tuple[str, Case]]:
    """Yield cases by name."""
    edits: dict[str, NoiseEdit] = {
        "healthy": _as_it_is,
        **{f"level grows {x} x": _grows(x) for x in (1.2, 2.0)},
        **{f"an axis frozen for {x} of the time": _freezes(x) for x in (0.1, 0.5)},
        **{f"clipped at {x} sigma": _clips(x) for x in (1.0, 2.0)},
        **{f"low-pass {hz} Hz, order {n}": _low_pass(hz, n) for hz, n in ((2.0, 1), (5.0, 1), (10.0, 2), (20.0, 4))},
        **{f"1/f^0.5 noise {x} x": _between(x) for x in (0.3, 1.0)},
        **{f"step of {x} B": _step(x * _B) for x in (2.0, 6.0, 20.0)},
        **{f"wave of {x} B": _wave(x * _B) for x in (2.0, 6.0)},
        **{f"warm-up of {x} B": _warm_up(x * _B) for x in (5.0, 20.0)},
        **{f"high-pass {hz} Hz": _high_pass(hz) for hz in (0.002, 0.01, 0.1)},
        **{f"auto-zero every {s} s": _auto_zero(s) for s in (10.0, 60.0)},
    }
    for name, edit in edits.items():
        yield name, lambda seed, edit=edit: _noise_outcome(seed, edit)
    long = replace(_AT_REST, duration_s=3 * 3600.0)
    for name, edit in {
        **{f"3 h, high-pass {hz} Hz": _high_pass(hz) for hz in (0.003, 0.01, 0.03)},
        **{f"3 h, auto-zero every {s} s": _auto_zero(s) for s in (60.0, 300.0)},
        "3 h, zeroed before each 300 s": _zeroed_before(300.0),
        "3 h, healthy": _as_it_is,
    }.items():
        yield name, lambda seed, edit=edit: _noise_outcome(seed, edit, long)
    for kind in ("by what it showed before", "at any time", "to its mean", "high-pass"):
        for where in ("throughout", "half", "one axis"):
            yield f"zeroed, {kind}, {where}", _zeroed_now_and_then(kind, where)
    yield "healthy: drawn sensors, 20 min to 2 h", lambda seed: _noise_outcome(seed, _rounded, _drawn_at_rest(seed))
    quiet = replace(_AT_REST, duration_s=1800.0, gyroscope_bias_instability=0.0, gyroscope_random_walk=0.0)
    yield "healthy: half an hour of white noise", lambda seed: _noise_outcome(seed, _as_it_is, quiet)
    walking = replace(_AT_REST, gyroscope_random_walk=4 * _K)
    yield "healthy: strong random walk", lambda seed: _noise_outcome(seed, _as_it_is, walking)


# ---- turntables

_RPM = np.pi / 30


def _turntable_outcome(
    seed: int, scenario: TurntableScenario, said: tuple[float, ...], factor: float | Floats = 1.0
) -> Outcome:
    simulation = simulate_turntable(scenario, seed)
    rng = np.random.default_rng(seed)
    name = "imu0.gyroscope.sensitivity"
    drawn = np.abs(np.linalg.det(simulation.truth.parameter(name))) ** (1 / 3)  # off by up to 16 %, and told of that
    by_axis = factor / drawn * rng.uniform(0.98, 1.02, 3)
    recordings: list[Recording] = []
    for recording in simulation.recordings:
        imu = recording.imus["imu0"]
        shown = replace(imu.gyroscope, values=imu.gyroscope.values * by_axis)
        recordings.append(replace(recording, imus={"imu0": replace(imu, gyroscope=shown)}))
    rates = [StatedRate(name=f"{rpm:g}rpm", rate_rad_s=rpm * _RPM) for rpm in said]

    def error(found: gnomon.Calibration) -> tuple[list[Floats], list[Floats], list[Floats]]:
        off = found.parameter(name) - by_axis[:, None] * simulation.truth.parameter(name)
        return [off], [found.sigma(name)], [np.full((3, 3), 5e-3)]

    return tried(lambda: gnomon.calibrate_turntable(recordings, rates), error)


def turntable_cases() -> Iterator[tuple[str, Case]]:
    """Yield cases by name."""
    usual = TurntableScenario(rpm=(100 / 3,), steady_s=12.0, gyroscope_range=10.0)
    both = replace(usual, rpm=(100 / 3, 45.0), steady_s=8.0)
    for off in (0.003, 0.01, -0.015):
        scenario = replace(usual, rate_error=off)
        yield f"label 33.33, platter {off:+.1%}", lambda seed, s=scenario: _turntable_outcome(seed, s, (33.33,))
    there = replace(usual, rpm=(33.5,))
    yield "label 33.33, platter 33.5", lambda seed: _turntable_outcome(seed, there, (33.33,))
    for factor in (0.72, 0.9, 1.3):
        yield (
            f"two speeds, scale {factor}",
            lambda seed, factor=factor: _turntable_outcome(seed, both, (33.33, 45.0), factor),
        )
    drifting = replace(usual, gyroscope_drift=0.02)
    yield "bias drifts by 0.02 rad/s", lambda seed: _turntable_outcome(seed, drifting, (33.33,))
    for name, scenario in {
        **{f"wow of {wow:.0%}": replace(usual, wow=wow) for wow in (0.01, 0.05)},
        **{f"platter tilted by {tilt:g} deg": replace(usual, tilt_deg=tilt) for tilt in (2.0, 10.0)},
        "speed scatters by 1 %": replace(usual, speed_scatter=0.01),
    }.items():
        yield name, lambda seed, s=scenario: _turntable_outcome(seed, s, (33.33,))
    for axis in range(3):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield (
            f"gyroscope axis {'xyz'[axis]} negated",
            lambda seed, sign=sign: _turntable_outcome(seed, usual, (33.33,), sign),
        )
    yield "healthy: 33.33", lambda seed: _turntable_outcome(seed, usual, (33.33,))
    alone = replace(usual, accelerometer=False)
    yield "healthy: without accelerometer", lambda seed: _turntable_outcome(seed, alone, (33.33,))


# ---- poses


def _pose_outcome(
    seed: int,
    scenario: PoseScenario,
    size: float,
    shape: Callable[[Floats], Floats],
    *,
    in_order: bool = False,
    first: int | None = None,
    centred: bool = True,
) -> Outcome:
    simulation = simulate_poses(scenario, seed)
    n, rng = len(simulation.poses), np.random.default_rng(seed)
    order = rng.permutation(n) if scenario.attitudes == "sphere" and not in_order else np.arange(n)
    way = shape(np.linspace(0, 1, n))
    direction = rng.standard_normal(3)
    drift = size * (way - centred * way.mean())[:, None] * direction / np.linalg.norm(direction)
    kept = slice(first)
    poses = Poses(
        name=tuple(map(str, range(n)))[kept],
        accelerometer=(simulation.accelerometer[order] + drift)[kept],
        accelerometer_unit="m/s^2",
        accelerometer_sigma=np.full((n, 3), 2e-3)[kept],
        t_s=None if simulation.t_s is None else simulation.t_s[kept],
    )
    names = "imu0.accelerometer.sensitivity", "imu0.accelerometer.bias"
    options = gnomon.ImuOptions(gravity=9.80665, frame="accel-z")

    def error(found: gnomon.Calibration) -> tuple[list[Floats], list[Floats], list[Floats]]:
        off = [found.parameter(name) - simulation.truth.parameter(name) for name in names]
        return off, [found.sigma(name) for name in names], [np.full((3, 3), 1e-3), np.full(3, 0.01)]

    return tried(lambda: gnomon.calibrate_imu(Recording(imus={}, poses=poses), options), error)


def pose_cases() -> Iterator[tuple[str, Case]]:
    """Yield cases by name."""
    shapes: dict[str, Callable[[Floats], Floats]] = {
        "line": lambda x: x,
        "warm-up": lambda x: np.exp(-4 * x),
        "step": lambda x: (x > 0.6).astype(np.float64),
    }
    for attitudes in ("angrisano18", "sphere"):
        scenario = PoseScenario(sensor="drawn", units="si", attitudes=attitudes, poses=24)
        for name, shape in shapes.items():
            for size in (0.02, 0.05, 0.2):
                yield (
                    f"{attitudes}, {name} of {size} m/s^2",
                    lambda seed, s=scenario, size=size, shape=shape: _pose_outcome(seed, s, size, shape),
                )
        for size in (0.05, 0.5):
            yield (
                f"{attitudes}, one pose off by {size} m/s^2",
                lambda seed, s=scenario, size=size: _pose_outcome(
                    seed, s, size, lambda x: (np.arange(len(x)) == len(x) // 2).astype(np.float64), centred=False
                ),
            )
        for count in (7, 9, 12):
            yield (
                f"{attitudes}, {count} poses",
                lambda seed, s=scenario, count=count: _pose_outcome(seed, s, 0.0, shapes["line"], first=count),
            )
        yield f"healthy: {attitudes}", lambda seed, s=scenario: _pose_outcome(seed, s, 0.0, shapes["line"])
    downwards = PoseScenario(sensor="drawn", units="si", attitudes="sphere", poses=24)  # from above to below
    for name, shape in shapes.items():
        for size in (0.05, 0.2):
            yield (
                f"order like time, {name} of {size} m/s^2",
                lambda seed, size=size, shape=shape: _pose_outcome(seed, downwards, size, shape, in_order=True),
            )


KINDS: dict[str, Callable[[], Iterator[tuple[str, Case]]]] = {
    "magnetometer": magnetometer_cases,
    "noise": noise_cases,
    "turntable": turntable_cases,
    "poses": pose_cases,
}


def main(kinds: dict[str, Callable[[], Iterator[tuple[str, Case]]]] = KINDS, about: str | None = __doc__) -> None:
    """Print one row a case."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", help=f"of {', '.join(kinds)}; all where none is named")
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default="", help="part of the name of a case")
    stated = parser.parse_args()
    for kind in stated.kinds or kinds:
        print(f"## {kind}\n")
        for name, case in kinds[kind]():
            if stated.only not in name:
                continue
            outcomes = {seed: case(seed) for seed in range(stated.first, stated.first + stated.seeds)}
            verdicts = Counter(outcome.verdict for outcome in outcomes.values())
            codes = Counter(code for outcome in outcomes.values() for code in outcome.codes)
            worst = sorted((o.sigmas for o in outcomes.values() if o.verdict == "pass"), reverse=True)[:3]
            missed = [seed for seed, outcome in outcomes.items() if outcome.missed]
            print(
                f"{name:38s} {dict(verdicts)}  missed {len(missed)} {missed or ''} "
                f"worst of a pass {', '.join(f'{z:.1f}' for z in worst)}  {dict(codes)}",
                flush=True,
            )
        print()


if __name__ == "__main__":
    main()
