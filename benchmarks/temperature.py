"""Biases over the temperature: gnomon beside the methods of PX4 and ArduPilot, on warm-ups that none of them saw.

    python benchmarks/temperature.py --seeds 100 --first 90000 --write

Each seed is a sensor of `gnomon study temperature`, with these numbers as seeds. Healthy: sensors that do not change,
or a steady temperature.
Faults: thermometers that are none, and what names them. Turned: scales from three temperatures, against the truth.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import gnomon
from gnomon.results.temperature_dependence import TemperatureDependence
from gnomon.simulate.scenarios.recorded import TemperatureScenario
from gnomon.simulate.temperature import simulate_temperature
from gnomon.study.temperature import METHODS, TemperatureTask, draw_scenario, run_temperature

HERE = Path(__file__).parent
TRIADS = ("accelerometer", "gyroscope")
FAULTS = {
    "none": (lambda one: None, "RecordingError"),
    "one temperature": (lambda one: replace(one, values=25 + 0.02 * np.sin(np.arange(len(one)))), "temperature-range"),
    "stuck": (lambda one: replace(one, values=np.full(len(one), one.values[0])), "temperature"),
    "minus": (lambda one: replace(one, values=-one.values), "temperature-falls"),
    "Fahrenheit, read as Celsius": (lambda one: replace(one, values=32 + 1.8 * one.values), "temperature-hot"),
}
"""What happens to a thermometer -> the finding that has to name it."""


def named(seed: int) -> dict[str, bool]:
    """Return of each fault whether it is named, and where nothing can be told nothing is found."""
    scenario = replace(draw_scenario(np.random.default_rng(seed), 1), recordings=2)
    recordings = simulate_temperature(scenario, seed).recordings
    found = {}
    for name, (change, code) in FAULTS.items():
        imus = [one.imus["imu0"] for one in recordings]
        wrong = [gnomon.Recording(imus={"imu0": replace(imu, temperature=change(imu.temperature))}) for imu in imus]
        try:
            result = gnomon.calibrate_temperature(wrong)
        except gnomon.GnomonError as error:
            found[name] = type(error).__name__ == code
            continue
        told = {one.code for one in result.calibration.assessment.findings if one.severity != "good"}
        changed = any(triad.order for triad in result.triads.values())
        found[name] = code in told and not (changed and code in {"temperature", "temperature-range"})
    return found


def turned_errors(seed: int, recordings: int, scatter: float) -> dict[str, list[float]]:
    """Return how far the free entries of each part's slopes lie off the truth, in sigmas; none where none is found.

    Switchings-on scatter as `BETWEEN_RECORDINGS` says, but for what it owes to the temperature, by half to double.
    """
    spread = scatter * float(2 ** np.random.default_rng([seed, 1]).uniform(-1, 1))
    scenario = TemperatureScenario(
        turned=True, order=1, rate_hz=100.0, recordings=recordings, sensitivity_scatter=1.5e-4 * spread,
        gyroscope_turn_on=8.7e-4 * spread, accelerometer_turn_on=1e-2 * spread,
    )  # fmt: skip
    made = simulate_temperature(scenario, seed)
    calibration = gnomon.calibrate_temperature(made.recordings).calibration
    parts: dict[str, list[float]] = {}
    for part, _ in made.truth.parts():
        triad, kind = part.split("_", 1)
        found = getattr(calibration.imus["imu0"].temperature, part)
        if found is None:
            parts[f"{triad} {kind}"] = []
            continue
        sigma = calibration.sigma(f"imu0.temperature.{part}")[0]
        z = np.divide(found[0] - getattr(made.truth, part)[0], sigma, out=np.full(sigma.shape, np.nan), where=sigma > 0)
        if kind == "bias":
            parts[f"{triad} {kind}"] = z.tolist()
        else:
            diagonal = np.eye(3, dtype=bool)
            parts[f"{triad} scales"] = z[diagonal].tolist()
            parts[f"{triad} axes"] = z[~diagonal & np.isfinite(z)].tolist()
    return parts


def turned(options: argparse.Namespace) -> list[str]:
    """Return the table of what is found of sensors that are turned at several temperatures."""
    seeds = range(options.first, options.first + options.turned)
    each = [turned_errors(seed, options.temperatures, options.scatter) for seed in seeds]
    lines = [
        "",
        f"slopes from {options.temperatures} temperatures, {options.turned} sensors (seeds {seeds[0]} to {seeds[-1]}), "
        f"scatter {options.scatter:g} times the usual",
        "",
        "| | not found in | NEES per entry | within 2 sigma | worst [sigma] |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in dict.fromkeys(name for one in each for name in one):
        z = np.concatenate([one.get(name, []) for one in each])
        if len(z):
            missed = sum(not one.get(name) for one in each)
            near = np.mean(abs(z) < 2)
            lines.append(f"| {name} | {missed} | {np.mean(z**2):.2f} | {near:.1%} | {abs(z).max():.1f} |")
    return lines


def turned_once(options: argparse.Namespace) -> list[str]:
    """Return the table of slopes that `gnomon imu` finds while the temperature rises and falls once.

    Beside the sensors themselves: the same temperature, but biases that drift with the time and not with it (8 mrad/s
    and 50 mm/s^2 over the recording; a line, a decay, a random walk), and sensors whose temperature only rises.
    """
    scenario = TemperatureScenario(
        turned=True, order=options.order, sensitivity_order=0, sensitivity_scatter=0.0, recordings=1, intervals=36,
        rate_hz=100.0, self_heating_k=options.heating, time_constant_s=60.0, start_degc=20.0, end_degc=40.0, back=True,
        lag_s=options.lag,
    )  # fmt: skip
    z: dict[str, list[float]] = {f"{triad}, {what}": [] for triad in TRIADS for what in ("slope", "curve")}
    missed, wrong = dict.fromkeys(TRIADS, 0), dict.fromkeys(("line", "decay", "walk", "one way"), 0)
    for seed in range(options.first, options.first + options.imu):
        made = simulate_temperature(scenario, seed)
        found = slopes_of(made.recordings[0], made.truth)
        for triad in TRIADS:
            missed[triad] += triad not in found
            for what, each in found.get(triad, {}).items():
                z[f"{triad}, {what}"] += each.tolist()
        if not options.drifts:
            continue
        one_way = simulate_temperature(replace(scenario, back=False), seed)
        wrong["one way"] += bool(slopes_of(one_way.recordings[0], one_way.truth))
        imu = simulate_temperature(replace(scenario, order=0), seed).recordings[0].imus["imu0"]
        rng, t = np.random.default_rng([seed, 2]), np.linspace(0, 1, len(imu.gyroscope))
        walk = np.cumsum(rng.standard_normal(len(t))) / np.sqrt(len(t))
        for name, drift in {"line": t, "decay": np.exp(-4 * t), "walk": walk}.items():
            gyroscope, accelerometer = (
                replace(triad, values=triad.values + size * drift[:, None] * rng.standard_normal(3))
                for triad, size in ((imu.gyroscope, 8e-3), (imu.accelerometer, 5e-2))
            )
            drifting = replace(imu, gyroscope=gyroscope, accelerometer=accelerometer)
            wrong[name] += bool(slopes_of(gnomon.Recording(imus={"imu0": drifting}), made.truth))
    lines = [
        "",
        f"biases of order {options.order} by gnomon imu, {options.heating:g} K up and down once, "
        f"lag {options.lag:g} s, {options.imu} sensors (seeds {options.first} to {options.first + options.imu - 1})",
        "",
        "| | not found in | mean square over variance | within 2 sigma | worst [sigma] |",
        "| --- | --- | --- | --- | --- |",
    ]
    for part, each in z.items():
        one = np.array(each or [np.nan])
        lines.append(
            f"| {part} | {missed[part.split(',')[0]]} | {np.mean(one**2):.2f} | {np.mean(abs(one) < 2):.1%} | "
            f"{abs(one).max():.1f} |"
        )
    told = ", ".join(f"{name} {count}" for name, count in wrong.items())
    return [*lines, *(["", f"slopes where there is none, of {options.imu} each: {told}"] if options.drifts else [])]


def slopes_of(recording: gnomon.Recording, truth: TemperatureDependence) -> dict[str, dict[str, np.ndarray]]:
    """Return how far off `gnomon imu` is in each triad, in sigmas (3,); nothing of a recording that it refuses.

    Of the slope at its reference, and of the change over the range that it saw, as rms.
    """
    try:
        calibration = gnomon.calibrate_imu(recording).calibration
    except gnomon.GnomonError as error:
        print(error)
        return {}
    found = calibration.imus["imu0"].temperature
    off: dict[str, dict[str, np.ndarray]] = {}
    for part, value in () if found is None else found.parts():
        d = np.linspace(found.low_degc, found.high_degc, 50) - found.reference_degc
        true = getattr(truth, part)
        true = np.zeros((1, 3)) if true is None else true
        beyond = found.reference_degc - truth.reference_degc
        slope = sum(power * one * beyond ** (power - 1) for power, one in enumerate(true, 1))
        change = truth.change(part, d + found.reference_degc) - truth.change(part, np.array([found.reference_degc]))
        powers = np.vander(d, len(value) + 1, increasing=True)[:, 1:]
        covariance = calibration.covariance(f"imu0.temperature.{part}")
        variance = np.column_stack(
            [np.einsum("ij,jk,ik->i", powers, covariance[axis::3, axis::3], powers) for axis in range(3)]
        )
        off[part.split("_")[0]] = {
            "slope": (value[0] - slope) / calibration.sigma(f"imu0.temperature.{part}")[0],
            "curve": np.sqrt(np.mean((powers @ value - change) ** 2, axis=0) / np.mean(variance, axis=0)),
        }
    return off


def compared(options: argparse.Namespace) -> list[str]:
    """Return the table of the methods."""
    rows, zs, right = [], [], 0
    for seed in range(options.first, options.first + options.seeds):
        one = run_temperature(TemperatureTask(seed=seed))
        rows.append(one.errors)
        zs.append(one.z)
        right += one.found == one.order
        told = " ".join(f"{name} {1e6 * value:.1f}" for name, value in zip(METHODS, one.errors, strict=True))
        print(seed, told, f"z {one.z:.2f} order {one.found} of {one.order}", flush=True)
    table = np.array(rows)
    ratio = np.sqrt(np.mean(table**2, axis=0))
    z_rms = float(np.sqrt(np.nanmean(np.square(zs))))
    return [
        f"seeds {options.first} to {options.first + options.seeds - 1}: order right in {right} of "
        f"{options.seeds}, errors of ours {z_rms:.2f} sigma rms",
        "",
        "| | rms error of the left-out warm-up [µrad/s] | median | of gnomon's, rms |",
        "| --- | --- | --- | --- |",
        *(
            f"| {name} | {1e6 * one:.1f} | {1e6 * np.median(table[:, i]):.1f} | {one / ratio[0]:.1f} |"
            for i, (name, one) in enumerate(zip(METHODS, ratio, strict=True))
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare biases over the temperature with PX4 and ArduPilot.")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--healthy", type=int, default=0, help="sensors that do not change")
    parser.add_argument("--faults", type=int, default=0, help="sensors with each of the faults of a thermometer")
    parser.add_argument("--turned", type=int, default=0, help="sensors that are turned at three temperatures")
    parser.add_argument("--temperatures", type=int, default=3, help="of each of these")
    parser.add_argument("--scatter", type=float, default=1.0, help="their scatter between recordings over the usual")
    parser.add_argument("--imu", type=int, default=0, help="sensors that are turned once while it rises and falls")
    parser.add_argument("--order", type=int, default=1, help="of their biases")
    parser.add_argument("--lag", type=float, default=0.0, help="of their thermometers [s]")
    parser.add_argument("--heating", type=float, default=15.0, help="of their chips [K]")
    parser.add_argument("--drifts", action="store_true", help="with them, those that drift with the time alone")
    parser.add_argument("--write", action="store_true", help="keep the table in benchmarks/results-temperature.md")
    options = parser.parse_args()
    lines = compared(options) if options.seeds else []
    kept = 0
    for seed in range(options.first, options.first + options.healthy):
        rng = np.random.default_rng(seed)
        scenario = replace(draw_scenario(rng, 0), recordings=2)
        if seed % 2:
            scenario = replace(scenario, start_degc=25.0, end_degc=25.4)
        result = gnomon.calibrate_temperature(simulate_temperature(scenario, seed).recordings)
        kept += not any(triad.order for triad in result.triads.values())
    if options.healthy:
        lines += ["", f"healthy: order 0 kept in {kept} of {options.healthy}"]
    every = [named(seed) for seed in range(options.first, options.first + options.faults)]
    for name in FAULTS if every else ():
        lines += ["", f"thermometer, {name}: named in {sum(one[name] for one in every)} of {len(every)}"]
    if options.turned:
        lines += turned(options)
    if options.imu:
        lines += turned_once(options)
    print("\n".join(lines))
    if options.write:
        text = "# Biases over the temperature\n\nWritten by `python benchmarks/temperature.py --write`.\n\n"
        (HERE / "results-temperature.md").write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
