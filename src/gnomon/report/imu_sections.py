"""The sections of an IMU report that show how the calibration came about."""

from collections.abc import Iterator, Mapping
from math import asin, degrees, isfinite

import numpy as np

from ..diagnostics import DetectorTrace, ImuDiagnostics, IntervalTable, ModelTrial, RotationTable
from ..recording import Floats
from ..triad_diagnostics import PoseTable
from ..units import STANDARD_GRAVITY_M_S2
from . import imu_figures, magnitude_figures
from .numbers import MISSING, finite, fixed, largest, number, quantity, rms
from .page import Figure, Legend, Section, Table

_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
SERIES = (
    Legend("dot", "before", "before"),
    Legend("dot", "after", "after"),
    Legend("ring", "heldout", "held out of the fit"),
)
MOST_ROWS = 60
"""Rows of a table beyond this are counted instead of shown."""


def recording_section(diagnostics: ImuDiagnostics) -> Section:
    """Return the signals with the static detector, and what it left out."""
    intervals = diagnostics.intervals
    used = np.asarray(intervals.used, dtype=bool)
    still = float(np.sum(finite(intervals.stop_s[used] - intervals.start_s[used])))
    waves = [Legend("square-wave", "ink", "static, used")]
    if not used.all():
        waves.append(Legend("square-wave", "accent", "static, left out"))
    threshold = Legend("line", "accent", f"threshold {number(diagnostics.detector.multiplier, 3)}")
    figure = Figure(
        "Signals and static detector",
        imu_figures.signals(diagnostics),
        (*_AXES, *waves, threshold),
        "The signals as recorded, reduced to the minimum and maximum of short stretches. The square wave is "
        f"high where the sensor rests: {int(used.sum())} intervals were used, {number(still, 4)} s in all. Below, the "
        "variance in a sliding window relative to its level at rest: where it stays under the threshold, the sensor is "
        "static.",
    )
    return Section("recording", "Recording", blocks=(figure, *_left_out(intervals)))


def _left_out(intervals: IntervalTable) -> tuple[Table, ...]:
    rejected = np.flatnonzero(~np.asarray(intervals.used, dtype=bool))
    if not len(rejected):
        return ()
    rows = tuple(
        (
            str(i + 1),
            f"{number(float(intervals.start_s[i]), 5)} to {number(float(intervals.stop_s[i]), 5)}",
            intervals.reason[i] or MISSING,
        )
        for i in rejected[:MOST_ROWS]
    )
    more = len(rejected) - len(rows)
    return (
        Table(
            "Static intervals that were left out",
            ("interval", "time [s]", "reason"),
            rows,
            f"And {more} more." if more else "",
            prose=True,
        ),
    )


def rest_section(diagnostics: ImuDiagnostics) -> Section | None:
    """Return the Allan plot with advice on the initial rest; None without a gyroscope at rest."""
    curve = diagnostics.allan
    if curve is None or not finite(curve.deviation).size:
        return None
    legend = [*_AXES]
    static = f"The recording starts with {number(curve.static_s, 3)} s at rest"
    if isfinite(curve.t_init_s):
        legend.append(Legend("dash", "accent", f"advised T_init {number(curve.t_init_s, 3)} s"))
        enough = curve.static_s >= curve.t_init_s
        advice = f"The curves flatten at an averaging time of {number(curve.t_init_s, 3)} s. {static}: " + (
            "long enough." if enough else "rest longer before the first movement next time."
        )
    else:
        advice = (
            f"{static}, too short to see where the curves flatten. "
            "A longer rest before the first movement, such as 50 s, would tell."
        )
    figure = Figure("Gyroscope at rest", imu_figures.allan(curve), legend, advice)
    return Section(
        "rest",
        "Rest at the start",
        "The Allan deviation shows how the mean of the gyroscope settles as it is averaged for longer. Where the "
        "three curves flatten, a longer initial rest would not make the bias any better known.",
        (figure,),
    )


def attitudes_section(intervals: IntervalTable) -> Section | None:
    """Return the directions of gravity on the sphere; None without any."""
    used = np.asarray(intervals.used, dtype=bool)
    directions = intervals.direction[used]
    directions = directions[np.isfinite(directions).all(axis=1)]
    if not len(directions):
        return None
    legend = [Legend("dot", "after", "used")]
    if not used.all():
        legend.append(Legend("ring", "accent", "left out"))
    gap, towards = largest_gap(directions)
    figure = Figure(
        "Directions of gravity in the body frame",
        magnitude_figures.directions(
            "attitudes",
            intervals.direction,
            intervals.used,
            f"Directions of gravity in the body frame in {len(directions)} static intervals that were used.",
        ),
        legend,
        "Both halves of the sphere in equal-area projection, seen from outside; circles every 30°. The "
        f"emptiest spot, {fixed(gap, 0)}° from the nearest attitude, is where up is ({towards}) in the body frame.",
    )
    return Section(
        "attitudes",
        "Attitudes",
        "Scales, misalignments and biases come apart only if gravity was measured from many sides. The more "
        "evenly the points are spread, the better.",
        (figure,),
    )


def largest_gap(directions: Floats) -> tuple[float, str]:
    """Return the largest angle [deg] from any direction to the nearest of (n, 3) unit vectors, and that direction."""
    spots = np.unique(np.round(directions / 0.05) * 0.05, axis=0) if len(directions) > 500 else directions
    k = np.arange(1000) + 0.5  # a Fibonacci lattice: even cover of the sphere
    z, azimuth = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    lattice = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    nearest = (lattice @ spots.T).max(axis=1)
    worst = int(np.argmin(nearest))
    angle = degrees(float(np.arccos(np.clip(nearest[worst], -1, 1))))
    return angle, ", ".join(fixed(float(c), 1) for c in lattice[worst] + 0.0)


def accelerometer_section(intervals: IntervalTable) -> Section | None:
    """Return the errors of the accelerometer; None if no interval was used."""
    used = np.asarray(intervals.used, dtype=bool)
    if not used.any():
        return None
    figure = Figure(
        "Error of the magnitude of specific force",
        magnitude_figures.magnitude_errors(
            "accelerometer",
            intervals,
            "m/s^2",
            "static interval",
            f"Error of the magnitude of specific force in {int(used.sum())} static intervals before and after the fit.",
        ),
        (*SERIES, Legend("band", "before", "±2σ expected of noise alone")),
        "|f| − g in each static interval. Before: one best scale and no bias, as an uncalibrated sensor reads. "
        "Held out: the calibration was made without the interval that it is tested on.",
    )
    rows: list[tuple[str, ...]] = []
    for name, (spread, mean, worst) in in_numbers(intervals):
        milli_g = number(1e3 * spread / STANDARD_GRAVITY_M_S2, 3, trim=False)
        rows.append((name, *(quantity(v, "m/s²") for v in (spread, mean, worst)), milli_g))
    table = Table("In numbers", ("|f| − g", "rms", "mean size", "worst", "rms in mg"), rows)
    return Section("accelerometer", "Accelerometer", blocks=(figure, table))


def in_numbers(table: IntervalTable | RotationTable | PoseTable) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Yield each kind of error with rms, mean magnitude and largest magnitude over the used rows; nan without any."""
    used = np.asarray(table.used, dtype=bool)
    for name, errors in (
        ("before", table.error_before),
        ("after", table.error_after),
        ("held out", table.error_holdout),
        ("expected (σ)", table.sigma),
    ):
        values = np.abs(finite(errors[used]))
        yield name, (rms(values), float(np.mean(values)) if values.size else float("nan"), largest(values))


def gyroscope_section(rotations: RotationTable, gravity: float) -> Section | None:
    """Return the errors of the gyroscope over the rotations; None if no rotation was used."""
    used = np.asarray(rotations.used, dtype=bool)
    if not used.any():
        return None
    figure = Figure(
        "Gravity carried along by the gyroscope",
        imu_figures.rotation_errors(rotations),
        SERIES,
        "For each rotation, gravity before it is carried along by integrating the gyroscope, and compared with "
        "gravity measured after it. Before: one scale for all axes and the bias of the first interval. An error that "
        "grows with the angle speaks of scale or misalignment, one that does not of bias or noise.",
    )
    rows: list[tuple[str, ...]] = []
    for name, (spread, mean, worst) in in_numbers(rotations):
        # |u_a - u_g| is the chord of the angle between the two unit vectors.
        angle = degrees(2 * asin(min(worst / 2, 1.0))) if isfinite(worst) else float("nan")
        rows.append(
            (
                name,
                *(quantity(v, "rad") for v in (spread, mean, worst)),
                f"{number(angle, 3)}°" if isfinite(angle) else MISSING,
                quantity(spread * gravity, "m/s²"),
            )
        )
    head = ("measured against propagated", "rms", "mean", "worst", "worst angle", "rms as magnitude")
    table = Table("In numbers", head, rows)
    lead = ""
    if not used.all():
        lead = f"{int((~used).sum())} of {len(used)} rotations were left out: {_reasons(rotations)}."
    return Section("gyroscope", "Gyroscope", lead, (figure, table))


def _reasons(rotations: RotationTable) -> str:
    reasons = [r for r, used in zip(rotations.reason, rotations.used, strict=True) if not used]
    counted = {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)}
    most = sorted(counted.items(), key=lambda item: -item[1])[:5]
    return "; ".join(f"{reason or 'no reason given'} ({count})" for reason, count in most)


def choices_section(diagnostics: ImuDiagnostics) -> Section | None:
    """Return the thresholds and models that were tried; None if none were."""
    tables: list[Table] = []
    if diagnostics.detector.candidates.size:
        tables.append(_thresholds(diagnostics.detector))
    if diagnostics.trials:
        tables.append(_models(diagnostics.trials))
    return Section("choices", "What was tried", blocks=tables) if tables else None


def _thresholds(detector: DetectorTrace) -> Table:
    candidates = np.atleast_2d(detector.candidates)[:MOST_ROWS]
    chosen = np.flatnonzero(np.isclose(candidates[:, 0], detector.multiplier))
    return Table(
        "Threshold of the static detector",
        ("multiplier", "static intervals", "held-out rms", "criterion"),
        tuple(
            (number(row[0]), number(row[1], 6), quantity(row[2], "m/s²"), number(row[3], 5))
            for row in candidates.tolist()
        ),
        marked=int(chosen[0]) if len(chosen) else None,
        caption="The threshold is a multiple of the resting variance. The chosen one is marked; a smaller criterion is "
        "better, and it does not favour a threshold that keeps less data.",
    )


def _models(trials: tuple[ModelTrial, ...]) -> Table:
    return Table(
        "Models",
        ("model", "parameters", "accelerometer, held out", "rotations, held out"),
        tuple(
            (t.model, str(t.parameters), quantity(t.accelerometer_rms, "m/s²"), quantity(t.rotation_rms, "rad"))
            for t in trials
        ),
        marked=next((i for i, trial in enumerate(trials) if trial.chosen), None),
        caption="Each model was fitted and tested on data left out of its fit. The model in use is marked.",
    )


_NOISE_UNITS = {
    ("accelerometer", "density"): "m/s²/√Hz",
    ("gyroscope", "density"): "rad/s/√Hz",
    ("accelerometer", "between_intervals"): "m/s²",
    ("gyroscope", "between_intervals"): "rad/s",
    ("rotation", "beyond_noise"): "rad",
}


def noise_section(noise: Mapping[str, float]) -> Section | None:
    """Return the noise that was found, as in `ImuDiagnostics`; None if none was."""
    if not noise:
        return None
    rows: list[tuple[str, ...]] = []
    for name, value in noise.items():
        sensor, _, kind = name.partition(".")
        unit = _NOISE_UNITS.get((sensor, kind), "")
        shown = f"{number(value, 4)} {unit}".strip()
        rows.append((f"{sensor} {kind}".replace("_", " ").strip(), shown, quantity(value, unit) if unit else ""))
    table = Table("From the parts at rest", ("noise", "value", "reads as"), rows)
    return Section("noise", "Noise", blocks=(table,))
