"""Wild cases of an IMU alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gnomon.geometry.rotations import right_jacobian, rotation_from_rotvec
from gnomon.models.gravity import EARTH_RATE_RAD_S, normal_gravity_m_s2
from gnomon.options import ImuOptions
from gnomon.recording import Floats, ImuSamples, Recording, TriadSamples
from gnomon.results.sensors import ImuCalibration
from gnomon.simulate.imu import simulate_imu
from gnomon.simulate.scenarios.recorded import Scenario
from gnomon.simulate.sensor import Converter, sensor_converters

from .fault_recordings import seconds, some, warming
from .wild import (
    WildCase,
    in_body_frame,
    in_units_of,
    log_uniform,
    on_a_turning_earth,
    reread,
    seen_in_a_mirror,
    signed_permutation,
)
from .wild_scenario import wild_scenario

Edit = Callable[[WildCase, np.random.Generator], WildCase]

_LOST = ("jitter", "time-base-stated", "holdout-rotation")
_UNSTILL = ("rests-unsteady", "interval-touched", "never-static", "few-attitudes", "attitudes")


def wild_imu(seed: int) -> WildCase:
    """Draw a wild case of an IMU alone."""
    rng = np.random.default_rng([seed, 11])
    scenario = wild_scenario(rng)
    readings, truth = simulate_imu(scenario, seed, digitised=False)
    case = WildCase(
        kind="imu",
        seed=seed,
        recording=readings,
        target=None,
        options=ImuOptions(),
        imus=dict(truth.imus),
        cameras={},
        oddities=(),
        wandering={},
    )
    case = replace(_said(_digitised(case, scenario, truth.imus["imu0"]), scenario), recording=readings)
    case = _edited(case, _OF_READINGS, rng)
    case = _digitised(case, scenario, truth.imus["imu0"])
    case = _edited(case, _OF_NUMBERS, rng)
    return _settled(_with_options(case, scenario, rng))


def _edited(case: WildCase, edits: tuple[tuple[Edit, float], ...], rng: np.random.Generator) -> WildCase:
    for edit, share in edits:
        if rng.random() < share:
            case = edit(case, rng)
    return case


def _said(case: WildCase, scenario: Scenario) -> WildCase:
    """Name what is odd about a scenario."""
    case = case.with_oddity(
        f"{scenario.intervals} rests of {scenario.hold_s[0]:.2g} s at {scenario.rate_hz:.3g} Hz in {scenario.units}, "
        f"bits {scenario.bits}, scales {scenario.accelerometer_scale} {scenario.gyroscope_scale}, "
        f"misaligned {scenario.accelerometer_misalignment:.2g} {scenario.gyroscope_misalignment:.2g}, biases "
        f"{scenario.accelerometer_bias:.2g} {scenario.gyroscope_bias:.2g}, noise "
        f"{scenario.accelerometer_noise_density:.1g} {scenario.gyroscope_noise_density:.1g}, moves "
        f"{scenario.motion_s[0]:.2g} s, first {scenario.t_init_s:.2g} s, g-sensitivity {scenario.g_sensitivity:.1g}",
        "few-attitudes",
        "attitudes",
        "attitudes-alike",
    )
    if scenario.style == "thesis":
        case = case.with_oddity("style thesis", *_UNSTILL)
    if scenario.dropped:
        case = case.with_oddity(f"lost {scenario.dropped:.2g}", *_LOST)
    if scenario.stamp_jitter_s:
        case = case.with_oddity(f"jitter {scenario.stamp_jitter_s:.2g} s", *_LOST)
    if scenario.stamp_resolution_s:
        case = case.with_oddity(f"timestamps rounded to {scenario.stamp_resolution_s:.2g} s", "time-repeated", *_LOST)
    if scenario.gyroscope_bias_walk:
        t_s = case.recording.imus["imu0"].gyroscope.duration_s
        walk = scenario.gyroscope_bias_walk * np.sqrt(t_s)
        sensitivity = case.imus["imu0"].gyroscope
        assert sensitivity is not None
        unit = float(np.mean(np.linalg.norm(sensitivity.sensitivity, axis=1))) if scenario.units != "si" else 1.0
        case = case.with_oddity(f"walk {walk:.2g} rad/s", "gyroscope-drift", "parts-disagree")
        case = replace(case, wandering={"imu0.gyroscope.bias": np.full(3, walk * unit)})
    samples = case.recording.imus["imu0"]
    for name in ("accelerometer", "gyroscope"):
        values = getattr(samples, name).values
        ends = (values == values.max(axis=0)) | (values == values.min(axis=0))
        if ends.sum() > 12:
            case = case.with_oddity(f"{name} clips or is coarse", "axis-constant", "signal-constant")
    return case


def _samples(case: WildCase) -> ImuSamples:
    return case.recording.imus["imu0"]


def _with(case: WildCase, samples: ImuSamples, imu: ImuCalibration | None = None) -> WildCase:
    recording = Recording(imus={"imu0": samples})
    return replace(case, recording=recording, imus=case.imus if imu is None else {"imu0": imu})


def _both(case: WildCase, change: Callable[[TriadSamples], TriadSamples]) -> WildCase:
    samples = _samples(case)
    force, rate = samples.accelerometer, samples.gyroscope
    return _with(case, replace(samples, accelerometer=change(force), gyroscope=change(rate)))


def _multiplied(case: WildCase, force: Floats | float = 1.0, rate: Floats | float = 1.0) -> WildCase:
    samples = _samples(case)

    def by(samples: TriadSamples, factor: Floats | float) -> TriadSamples:
        return replace(samples, values=samples.values @ (np.eye(3) * factor if np.isscalar(factor) else factor).T)  # pyright: ignore

    changed = replace(samples, accelerometer=by(samples.accelerometer, force), gyroscope=by(samples.gyroscope, rate))
    return _with(case, changed, reread(case.imus["imu0"], accelerometer=force, gyroscope=rate))


def _digitised(case: WildCase, scenario: Scenario, drawn: ImuCalibration) -> WildCase:
    """Return the case with its readings as the converters make numbers of them.

    What moves the sensor, or its bias, does so before the converter, which it carries from step to step.
    """
    samples, imu = _samples(case), case.imus["imu0"]
    to_force, to_rate = sensor_converters(scenario)
    force, rate = imu.required_accelerometer, imu.gyroscope
    assert rate is not None
    assert drawn.gyroscope is not None
    by_force = force.sensitivity @ np.linalg.inv(drawn.required_accelerometer.sensitivity)
    by_rate = rate.sensitivity @ np.linalg.inv(drawn.gyroscope.sensitivity)
    changed = replace(
        samples,
        accelerometer=_read_by(to_force, samples.accelerometer, by_force),
        gyroscope=_read_by(to_rate, samples.gyroscope, by_rate),
    )
    return _with(case, changed)


def _read_by(converter: Converter, samples: TriadSamples, matrix: Floats) -> TriadSamples:
    """Return what a converter reads, by which axes are exchanged and multiplied (3, 3) only afterwards."""
    factor = float(np.abs(matrix).max())
    axes = np.rint(matrix / factor)
    return replace(samples, values=factor * (converter.digitise(samples.values @ axes / factor) @ axes.T))


def _in_steps(values: Floats, before: Floats) -> Floats:
    """Round values (n, 3) to the steps in which those before were recorded."""
    changes = np.abs(np.diff(before, axis=0))
    step = np.array([axis[axis > 0].min(initial=np.inf) for axis in changes.T])
    coarse = np.isfinite(step) & (step > 1e-9 * np.ptp(before, axis=0))
    step = np.where(coarse, step, 1.0)
    return np.where(coarse, np.rint((values - before[0]) / step) * step + before[0], values)


def _mounted(case: WildCase, rng: np.random.Generator) -> WildCase:
    axes = signed_permutation(rng)
    return _multiplied(case, axes, axes).with_oddity(f"axes {axes.tolist()}")


def _unlike(case: WildCase, rng: np.random.Generator) -> WildCase:
    axes = signed_permutation(rng)
    one = rng.random() < 0.5
    changed = _multiplied(case, axes) if one else _multiplied(case, rate=axes)
    return changed.with_oddity(f"axes of {'accelerometer' if one else 'gyroscope'} {axes.tolist()}")


def _mislabelled(case: WildCase, rng: np.random.Generator) -> WildCase:
    force = float(rng.choice([1.0, 9.80665, 1 / 9.80665, 1000.0, 1e-3]))
    rate = float(rng.choice([1.0, 57.29578, 1 / 57.29578, 1000.0, 60.0]))
    return _multiplied(case, force, rate).with_oddity(f"units misstated {force:g} {rate:g}")


def _warming(case: WildCase, rng: np.random.Generator) -> WildCase:
    samples = _samples(case)
    force = rng.random() < 0.5
    triad = samples.accelerometer if force else samples.gyroscope
    name = "accelerometer" if force else "gyroscope"
    sensor = case.imus["imu0"].required_accelerometer if force else case.imus["imu0"].gyroscope
    assert sensor is not None
    t_s = seconds(triad.t_ns)
    size = log_uniform(rng, 1e-3, 3.0) if force else log_uniform(rng, 1e-4, 0.3)
    size *= float(np.mean(np.abs(np.diag(sensor.sensitivity))))
    drift = size * warming(t_s, log_uniform(rng, 5.0, 3 * t_s[-1])) * rng.uniform(-1, 1, 3)
    changed = replace(triad, values=triad.values + drift - drift.mean(axis=0))
    path = f"imu0.{name}.bias"
    wandering = case.wandering | {path: case.wandering.get(path, 0.0) + np.ptp(drift, axis=0)}
    case = replace(case, wandering=wandering)
    changed = replace(samples, **{name: changed})  # pyright: ignore
    codes = (f"{name}-drift", "parts-disagree", "holdout-accelerometer", "holdout-rotation")
    return _with(case, changed).with_oddity(f"{name} drifts by {np.ptp(drift):.2g}", *codes)


def _outliers(case: WildCase, rng: np.random.Generator) -> WildCase:
    share, size = log_uniform(rng, 1e-4, 0.02), log_uniform(rng, 2.0, 50.0)

    def spiked(samples: TriadSamples) -> TriadSamples:
        values = np.array(samples.values)
        rows = np.flatnonzero(rng.random(len(values)) < share)
        values[rows, rng.integers(0, 3, len(rows))] += size * values.std() * rng.standard_normal(len(rows))
        values[rows] = _in_steps(values[rows], samples.values)
        return replace(samples, values=values)

    return _both(case, spiked).with_oddity(f"{share:.2g} outliers of {size:.2g}", "outliers", *_UNSTILL)


def _gaps(case: WildCase, rng: np.random.Generator) -> WildCase:
    length_s, count = log_uniform(rng, 0.05, 10.0), int(rng.integers(1, 30))
    starts = rng.random(count)

    def cut(samples: TriadSamples) -> TriadSamples:
        t_s = seconds(samples.t_ns)
        kept = np.ones(len(t_s), dtype=bool)
        for start in starts * t_s[-1]:
            kept &= (t_s < start) | (t_s > start + length_s)
        return some(samples, kept)

    return _both(case, cut).with_oddity(f"{count} gaps of {length_s:.2g} s", *_LOST)


def _doubled(case: WildCase, rng: np.random.Generator) -> WildCase:
    share, swapped = log_uniform(rng, 1e-4, 0.3), rng.random() < 0.5

    def muddled(samples: TriadSamples) -> TriadSamples:
        t_ns = np.array(samples.t_ns)
        rows = np.flatnonzero(rng.random(len(t_ns) - 1) < share)
        t_ns[rows], t_ns[rows + 1] = t_ns[rows + 1], (t_ns[rows] if swapped else t_ns[rows + 1])
        return replace(samples, t_ns=t_ns)

    names = ("time-backward", "time-repeated", "time-base-stated", "jitter")
    return _both(case, muddled).with_oddity(f"{share:.2g} {'swapped' if swapped else 'repeated'} timestamps", *names)


def _stretched(case: WildCase, rng: np.random.Generator) -> WildCase:
    factor = float(rng.choice([1e-3, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3]))

    def slow(samples: TriadSamples) -> TriadSamples:
        return replace(samples, t_ns=samples.t_ns[0] + np.rint((samples.t_ns - samples.t_ns[0]) * factor).astype(int))

    # A rate is told in radians per stamped second.
    imus = {"imu0": in_units_of(case.imus["imu0"], rate=1 / factor)}
    return replace(_both(case, slow), imus=imus).with_oddity(f"time times {factor:g}")


def _stuck(case: WildCase, rng: np.random.Generator) -> WildCase:
    where, length_s = rng.random(), log_uniform(rng, 0.1, 5.0)

    def held(samples: TriadSamples) -> TriadSamples:
        values = np.array(samples.values)
        first = int(where * len(values))
        values[first : first + round(length_s * samples.rate_hz)] = values[first]
        return replace(samples, values=values)

    return _both(case, held).with_oddity(f"stuck for {length_s:.2g} s", "samples-stuck", *_UNSTILL)


def _apart(case: WildCase, rng: np.random.Generator) -> WildCase:
    samples, by_s = _samples(case), log_uniform(rng, 1e-3, 2.0) * float(rng.choice([-1, 1]))
    late = replace(samples.gyroscope, t_ns=samples.gyroscope.t_ns + round(by_s * 1e9))
    names = ("triads-apart", "clocks-apart", "holdout-rotation")
    return _with(case, replace(samples, gyroscope=late)).with_oddity(f"triads {by_s:.2g} s apart", *names)


def _shaking(case: WildCase, rng: np.random.Generator) -> WildCase:
    """Let the hand tremble all the time, rests included: the sensor is turned by a small, changing rotation."""
    samples, imu = _samples(case), case.imus["imu0"]
    rate = imu.gyroscope
    assert rate is not None
    size, hz, phase = log_uniform(rng, 1e-4, 0.05), rng.uniform(0.3, 9.0, 3), rng.uniform(0, 6, 3)
    axes = size * rng.uniform(-1, 1, 3)

    def trembled(samples: TriadSamples, sensitivity: Floats, bias: Floats, *, turns: bool) -> TriadSamples:
        angle = 2 * np.pi * hz * seconds(samples.t_ns)[:, None] + phase
        true = (samples.values - bias) @ np.linalg.inv(sensitivity).T
        phi = axes * np.sin(angle)
        felt = np.einsum("nji,nj->ni", rotation_from_rotvec(phi), true)
        if turns:
            felt += np.einsum("nij,nj->ni", right_jacobian(phi), axes * 2 * np.pi * hz * np.cos(angle))
        return replace(samples, values=felt @ sensitivity.T + bias)

    force = imu.required_accelerometer
    changed = replace(
        samples,
        accelerometer=trembled(samples.accelerometer, force.sensitivity, force.bias, turns=False),
        gyroscope=trembled(samples.gyroscope, rate.sensitivity, rate.bias, turns=True),
    )
    return _with(case, changed).with_oddity(f"trembling by {size:.2g} rad", "vibration", *_UNSTILL)


_OF_READINGS: tuple[tuple[Edit, float], ...] = (
    (_shaking, 0.12),
    (_mounted, 0.4),
    (_unlike, 0.2),
    (_mislabelled, 0.1),
    (_warming, 0.2),
)
_OF_NUMBERS: tuple[tuple[Edit, float], ...] = (
    (_outliers, 0.12),
    (_stuck, 0.06),
    (_gaps, 0.1),
    (_apart, 0.08),
    (_doubled, 0.05),
    (_stretched, 0.1),
)


def _stated_at_least(case: WildCase, name: str) -> float:
    """Return a g-sensitivity that nobody can tell from less, since the bias wanders from rest to rest."""
    gyroscope = case.imus["imu0"].gyroscope
    if gyroscope is None or name != "gyroscope.g_sensitivity" or "imu0.gyroscope.bias" not in case.wandering:
        return 0.0
    return float(np.abs(gyroscope.g_sensitivity).max())


def _with_options(case: WildCase, scenario: Scenario, rng: np.random.Generator) -> WildCase:
    chosen: dict[str, object] = {}
    imus = case.imus
    if rng.random() < 0.35:
        gravity = scenario.gravity if rng.random() < 0.6 else float(rng.uniform(9.3, 10.3))
        chosen["gravity"] = gravity
        imus = {"imu0": in_units_of(case.imus["imu0"], force=gravity / scenario.gravity)}
        case = case.with_oddity(f"gravity {gravity:.4g} stated for {scenario.gravity:.4g}")
    elif rng.random() < 0.1:
        latitude = float(rng.uniform(-90, 90))
        chosen["latitude"] = latitude
        stated = normal_gravity_m_s2(latitude)
        vertical = EARTH_RATE_RAD_S * float(np.sin(np.radians(latitude)))
        imus = {
            "imu0": on_a_turning_earth(
                in_units_of(case.imus["imu0"], force=stated / scenario.gravity), vertical, stated
            )
        }
        case = case.with_oddity(f"latitude {latitude:.3g}, gravity {stated:.4g} for {scenario.gravity:.4g}")
    if rng.random() < 0.3:
        chosen["model"] = str(rng.choice(["basic", "g-sensitivity", "static"]))
    if rng.random() < 0.12:
        chosen["preset"] = str(rng.choice(["tedaldi2014", "tedaldi2014-text", "imu_tk", "angrisano"]))
    if rng.random() < 0.1:
        chosen["t_init_s"] = log_uniform(rng, 0.3, 60.0)
    if rng.random() < 0.2:
        chosen["window_s"] = log_uniform(rng, 0.2, 3.0)
    if rng.random() < 0.1:
        chosen["multiplier"] = log_uniform(rng, 0.3, 1e3)
    if rng.random() < 0.15:
        chosen["time_base"] = str(rng.choice(["stamps", "uniform"]))
    if rng.random() < 0.1:
        chosen["frame"] = "accel-z"
    if rng.random() < 0.15:
        name = rng.choice(["accelerometer.bias", "gyroscope.bias", "gyroscope.g_sensitivity", "accelerometer"])
        chosen["prior"] = (f"imu0.{name}={max(log_uniform(rng, 1e-4, 1.0), _stated_at_least(case, name)):.3g}",)
    elif rng.random() < 0.05:
        chosen["fix"] = ("imu0.gyroscope.g_sensitivity",)
    case = replace(case, options=ImuOptions(**chosen), imus=imus)  # pyright: ignore[reportArgumentType]
    codes = ("prior-disagrees",) if "prior" in chosen else ()
    return case.with_oddity(f"options {chosen}", *codes) if chosen else case


def _settled(case: WildCase) -> WildCase:
    """Return the case with its truth in body frame accel-x."""
    imu = case.imus["imu0"]
    if np.linalg.det(imu.required_accelerometer.sensitivity) < 0:
        imu = seen_in_a_mirror(imu)
    return replace(case, imus=in_body_frame(imu, {})[0])
