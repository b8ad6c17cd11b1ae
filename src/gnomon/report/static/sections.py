"""The sections of a report on one sensor that show how the calibration came about."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import asin, degrees, isfinite, pi

import numpy as np

from ...recording import Floats
from ...results.calibration import Calibration
from ...results.imu_diagnostics import ImuDiagnostics, IntervalTable, RotationTable
from ...results.triad_diagnostics import PoseTable, TriadDiagnostics, TriadRecord
from ...units import STANDARD_GRAVITY_M_S2
from ..numbers import (
    MISSING,
    estimate_text,
    finite_rms,
    finite_values,
    fixed_text,
    largest_magnitude,
    magnitude_text,
    magnitude_unit,
    number_text,
    positive_or,
    quantity_text,
    readable_unit,
)
from ..page import Figure, Legend, ReportTable, Section
from . import figures

COUNTED = {
    "imu": ("static interval", "static intervals"),
    "poses": ("pose", "poses"),
    "turntable": ("steady part", "steady parts"),
    "magnetometer": ("stretch", "stretches"),
}
"""What one row of a table of vectors is; of the magnetometer, samples close together."""
_QUANTITIES = {
    "specific force": ("|f| − g", "gravity", "a {} with this direction up would help most"),
    "angular rate": ("|ω| − rate", "the axis of rotation", "mounting the sensor with this direction upwards would "
                     "help most"),
    "magnetic field": ("|h| − field", "the magnetic field", "turning the sensor until the field points there would "
                       "help most"),
}  # fmt: skip
"""Symbol of the error, what pointed, and where it should point."""
_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
_SERIES = (
    Legend("dot", "before", "before"),
    Legend("dot", "after", "after"),
    Legend("ring", "heldout", "held out of the fit"),
)
_MOST_ROWS = 60
"""Rows of a table beyond this are counted instead of shown."""


@dataclass(frozen=True, slots=True)
class Vectors:
    """A vector of known magnitude that one triad measured many times."""

    name: str
    table: IntervalTable | PoseTable
    quantity: str
    si_unit: str
    record: TriadRecord | None = None


def static_sections(
    calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics
) -> tuple[Section | None, ...]:
    """Return the sections on how the calibration came about, in their order; None where there is nothing to say."""
    imu = diagnostics if isinstance(diagnostics, ImuDiagnostics) else None
    triads = diagnostics if isinstance(diagnostics, TriadDiagnostics) else None
    vectors = vectors_of(diagnostics)
    return (
        _recording_section(imu) if imu else None,
        _rest_section(imu) if imu else None,
        _rates_section(triads) if triads else None,
        _directions_section(vectors, kind_of(diagnostics)),
        *(_magnitude_section(one, kind_of(diagnostics), calibration) for one in vectors),
        _rotations_section(imu.rotations, calibration.gravity.value) if imu else None,
        _at_rest_section(triads) if triads else None,
        _dip_section(triads) if triads else None,
        _choices_section(diagnostics),
        _noise_section(diagnostics),
    )


def kind_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> str:
    """Return what was done: "imu", "poses", "turntable" or "magnetometer"."""
    return "imu" if isinstance(diagnostics, ImuDiagnostics) else diagnostics.kind


def vectors_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> list[Vectors]:
    """Return what each triad measured."""
    if isinstance(diagnostics, ImuDiagnostics):
        return [Vectors("accelerometer", diagnostics.intervals, "specific force", "m/s^2")]
    return [Vectors(name, r.poses, r.quantity, r.si_unit, r) for name, r in diagnostics.triads.items()]


def _mask(table: IntervalTable | PoseTable | RotationTable) -> np.ndarray:
    return np.asarray(table.used, dtype=bool)


def _recording_section(diagnostics: ImuDiagnostics) -> Section:
    """Return the signals with the static detector, and what it left out."""
    intervals = diagnostics.intervals
    used = _mask(intervals)
    still = float(np.sum(finite_values(intervals.stop_s[used] - intervals.start_s[used])))
    waves = [Legend("square-wave", "ink", "static, used")]
    if not used.all():
        waves.append(Legend("square-wave", "accent", "static, left out"))
    figure = Figure(
        "Signals and static detector",
        figures.draw_raw_signals(diagnostics),
        (*_AXES, *waves, Legend("line", "accent", f"threshold {number_text(diagnostics.detector.multiplier, 3)}")),
        "The signals as recorded, reduced to the minimum and maximum of short stretches. The square wave is "
        f"high where the sensor rests: {int(used.sum())} intervals were used, {number_text(still, 4)} s in all. "
        "Below, the "
        "variance in a sliding window relative to its level at rest: where it stays under the threshold, the sensor is "
        "static.",
    )
    rejected = np.flatnonzero(~used)
    rows = [
        (str(i + 1), _span(intervals, i, 5), intervals.reason[i] or MISSING) for i in rejected[:_MOST_ROWS].tolist()
    ]
    head, more = ("interval", "time [s]", "reason"), len(rejected) - len(rows)
    caption = f"And {more} more." if more else ""
    left_out = [ReportTable("Static intervals that were left out", head, rows, caption, prose=True)] if rows else []
    return Section("recording", "Recording", blocks=(figure, *left_out))


def _span(table: IntervalTable | PoseTable, i: int, digits: int) -> str:
    """Return when a pose was, or at which instant."""
    start, stop = float(table.start_s[i]), float(table.stop_s[i])
    if not isfinite(start):
        return MISSING
    return (
        f"{number_text(start, digits)} to {number_text(stop, digits)}" if stop > start else number_text(start, digits)
    )


def _rest_section(diagnostics: ImuDiagnostics) -> Section | None:
    """Return the Allan plot with advice on the initial rest; None without a gyroscope at rest."""
    curve = diagnostics.allan
    if curve is None or not finite_values(curve.deviation).size:
        return None
    legend = [*_AXES]
    static = f"The recording starts with {number_text(curve.static_s, 3)} s at rest"
    if isfinite(curve.t_init_s):
        legend.append(Legend("dash", "accent", f"advised T_init {number_text(curve.t_init_s, 3)} s"))
        advice = f"The curves flatten at an averaging time of {number_text(curve.t_init_s, 3)} s. {static}: " + (
            "long enough." if curve.static_s >= curve.t_init_s else "rest longer before the first movement next time."
        )
    else:
        advice = (
            f"{static}, too short to see where the curves flatten. "
            "A longer rest before the first movement, such as 50 s, would tell."
        )
    return Section(
        "rest",
        "Rest at the start",
        "The Allan deviation shows how the mean of the gyroscope settles as it is averaged for longer. Where the "
        "three curves flatten, a longer initial rest would not make the bias any better known.",
        (Figure("Gyroscope at rest", figures.draw_allan(curve), legend, advice),),
    )


def _rotations_section(rotations: RotationTable, gravity: float) -> Section | None:
    """Return the errors of the gyroscope over the rotations; None if no rotation was used."""
    used = _mask(rotations)
    if not used.any():
        return None
    figure = Figure(
        "Gravity carried along by the gyroscope",
        figures.rotation_errors(rotations),
        _SERIES,
        "For each rotation, gravity before it is carried along by integrating the gyroscope, and compared with "
        "gravity measured after it. Before: one scale for all axes and the bias of the first interval. An error that "
        "grows with the angle speaks of scale or misalignment, one that does not of bias or noise.",
    )
    rows: list[tuple[str, ...]] = []
    for name, values in _in_numbers(rotations):
        # |u_a - u_g| is the chord of the angle between the two unit vectors.
        angle = degrees(2 * asin(min(values[2] / 2, 1.0))) if isfinite(values[2]) else float("nan")
        shown = f"{number_text(angle, 3)}°" if isfinite(angle) else MISSING
        rows.append(
            (name, *(quantity_text(v, "rad") for v in values), shown, quantity_text(values[0] * gravity, "m/s²"))
        )
    head = ("measured against propagated", "rms", "mean", "worst", "worst angle", "rms as magnitude")
    reasons = [reason for reason, one in zip(rotations.reason, used, strict=True) if not one]
    most = sorted(dict.fromkeys(reasons), key=lambda reason: -reasons.count(reason))[:5]
    listed = "; ".join(f"{reason or 'no reason given'} ({reasons.count(reason)})" for reason in most)
    lead = f"{len(reasons)} of {len(used)} rotations were left out: {listed}." if reasons else ""
    return Section("gyroscope", "Gyroscope", lead, (figure, ReportTable("In numbers", head, rows)))


def known_directions(table: IntervalTable | PoseTable) -> Floats:
    """Return the directions (n, 3) of the vectors that were used."""
    there = table.direction[_mask(table)]
    return there[np.isfinite(there).all(axis=1)]


def _directions_section(vectors: list[Vectors], kind: str) -> Section | None:
    """Return where each vector pointed in the body frame; None without any direction."""
    blocks: list[Figure] = []
    counted, plural = COUNTED[kind]
    for one in vectors:
        used, there = _mask(one.table), known_directions(one.table)
        if not len(there):
            continue
        _, pointed, advice = _QUANTITIES[one.quantity]
        gap, towards = largest_gap(there)
        legend = [Legend("dot", "after", "used")] + [Legend("ring", "accent", "left out")] * (not used.all())
        alt = f"Directions of {pointed} in the body frame in {len(there)} {plural} that were used."
        blocks.append(
            Figure(
                f"Directions of {pointed} in the body frame",
                figures.draw_directions(f"directions-{one.name}", one.table.direction, used, alt),
                legend,
                "Both halves of the sphere in equal-area projection, seen from outside; circles every 30°. The "
                f"emptiest spot is ({towards}), {fixed_text(gap, 0)}° from the nearest {counted}: "
                f"{advice.format(counted)}.",
            )
        )
    lead = (
        "Scales, misalignments and biases come apart only if the known vector was measured from many sides. The more "
        "evenly the points are spread, the better."
    )
    return Section("directions", "Directions", lead, blocks) if blocks else None


def largest_gap(directions: Floats) -> tuple[float, str]:
    """Return the largest angle [deg] from any direction to the nearest of (n, 3) unit vectors, and that direction."""
    spots = np.unique(np.round(directions / 0.05) * 0.05, axis=0) if len(directions) > 500 else directions
    k = np.arange(1000) + 0.5  # a Fibonacci lattice: even cover of the sphere
    z, azimuth = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    lattice = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    nearest = (lattice @ spots.T).max(axis=1)
    worst = int(np.argmin(nearest))
    angle = degrees(float(np.arccos(np.clip(nearest[worst], -1, 1))))
    return angle, ", ".join(fixed_text(float(c), 1) for c in lattice[worst] + 0.0)


def _magnitude_section(vectors: Vectors, kind: str, calibration: Calibration) -> Section | None:
    """Return the errors of one triad's magnitude; None if nothing was used."""
    table, (counted, plural) = vectors.table, COUNTED[kind]
    symbol, used = _QUANTITIES[vectors.quantity][0], _mask(vectors.table)
    if not used.any():
        return None
    found = calibration.assessment.intervals_found  # of many, the table holds only some
    some = f" Of {found} {plural} {len(used)} at equal distances are shown here." if len(used) < found else ""
    scale = "one best scale" if kind == "imu" else "one nominal scale"
    figure = Figure(
        f"Error of the magnitude of {vectors.quantity}",
        figures.magnitude_errors(
            f"errors-{vectors.name}",
            table,
            vectors.si_unit,
            counted,
            f"Error of the magnitude of {vectors.quantity} in {int(used.sum())} {plural} before and after the fit.",
        ),
        (*_SERIES, Legend("band", "before", "±2σ predicted")),
        f"{symbol} in each {counted}. Before: {scale} and no bias, as an uncalibrated sensor reads. "
        f"Held out: the calibration was made without the {counted} that it is tested on.{some}",
    )
    in_mg = vectors.si_unit == "m/s^2"
    rows: list[tuple[str, ...]] = []
    for name, values in _in_numbers(table):
        milli_g = number_text(1e3 * values[0] / STANDARD_GRAVITY_M_S2, 3, trim=False)
        rows.append((name, *(magnitude_text(v, vectors.si_unit) for v in values), *([milli_g] if in_mg else [])))
    head = (symbol, "rms", "mean size", "worst", *(["rms [mg]"] if in_mg else []))
    tables = _pose_tables(vectors.record, counted, plural) if vectors.record else ()
    lead = _noise_words(vectors.record, counted) if vectors.record else ""
    return Section(
        vectors.name, vectors.name.capitalize(), lead, (figure, ReportTable("In numbers", head, rows), *tables)
    )


def _in_numbers(table: IntervalTable | RotationTable | PoseTable) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Yield each kind of error with rms, mean magnitude and largest magnitude over the used rows; nan without any."""
    for name, errors in (
        ("before", table.error_before),
        ("after", table.error_after),
        ("held out", table.error_holdout),
        ("expected (σ)", table.sigma),
    ):
        values = np.abs(finite_values(errors[_mask(table)]))
        yield (
            name,
            (finite_rms(values), float(np.mean(values)) if values.size else float("nan"), largest_magnitude(values)),
        )


def _noise_words(record: TriadRecord, counted: str) -> str:
    noise = f"By noise alone one {counted} would be known to {magnitude_text(record.noise_sigma, record.si_unit)}."
    if not record.extra_sigma > 0:
        return f"{noise} What is left after the fit shows no more than that."
    extra = magnitude_text(record.extra_sigma, record.si_unit)
    return f"{noise} What is left after the fit shows {extra} more; every sigma of this report includes it."


def _pose_tables(record: TriadRecord, counted: str, plural: str) -> Iterator[ReportTable]:
    """Yield every pose where they are few, and why some were left out."""
    poses, used = record.poses, _mask(record.poses)
    names = [name or str(i + 1) for i, name in enumerate(poses.name)]
    if len(used) <= _MOST_ROWS:
        errors = np.stack([poses.error_after, poses.error_holdout, poses.sigma], axis=1)
        label, factor = magnitude_unit(largest_magnitude(errors[:, :2]), record.si_unit)
        unit = label.removesuffix(" of the field")
        timed = bool(np.isfinite(poses.start_s).any())
        head = [
            counted,
            *(["time [s]"] if timed else []),
            *(f"{axis} [{readable_unit(record.unit)}]" for axis in "xyz"),
        ]
        head += [f"after [{unit}]", f"held out [{unit}]", f"σ [{unit}]"]
        decimals = max(0, 5 - int(np.floor(np.log10(positive_or(largest_magnitude(poses.measured))))))
        rows = [
            (
                name,
                *([_span(poses, i, 5)] if timed else []),
                *(fixed_text(value, decimals) for value in poses.measured[i].tolist()),
                *(number_text(factor * value, 3, trim=False) for value in errors[i].tolist()),
            )
            for i, name in enumerate(names)
        ]
        faint = frozenset(np.flatnonzero(~used).tolist())
        caption = "Those that were left out are set faint." if faint else ""
        yield ReportTable(f"Every {counted}", tuple(head), rows, caption, faint=faint, dense=True)
    reasons: dict[str, list[str]] = {}
    for name, reason, one in zip(names, poses.reason, used, strict=True):
        if not one:
            reasons.setdefault(reason, []).append(name)
    if reasons:
        rows = [
            (reason or MISSING, str(len(which)), ", ".join(which[:5]) + " …" * (len(which) > 5))
            for reason, which in reasons.items()
        ]
        yield ReportTable("Why they were left out", ("reason", plural, "which"), rows, prose=True)


def _rates_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the speeds of a turntable, and what videos showed; None without any."""
    if not diagnostics.rates:
        return None
    rows: list[tuple[str, ...]] = []
    for rate in diagnostics.rates:
        if rate.stated == 0 and rate.stated_sigma == 0:
            rows.append((rate.name, str(rate.parts), "0", "0", MISSING, "0"))
            continue
        exact = "" if rate.stated_sigma > 0 else " (exact)"
        change = (rate.estimated - rate.stated) / rate.stated_sigma if rate.stated_sigma > 0 else float("nan")
        rows.append((
            rate.name,
            str(rate.parts),
            estimate_text(rate.stated, rate.stated_sigma) + exact,
            estimate_text(rate.estimated, rate.estimated_sigma),
            f"{fixed_text(change, 1, sign=True)} σ" if isfinite(change) else MISSING,
            estimate_text(rate.estimated * 30 / pi, rate.estimated_sigma * 30 / pi),
        ))  # fmt: skip
    head = ("speed", "steady parts", "beforehand [rad/s]", "after the fit [rad/s]", "change", "after the fit [rpm]")
    caption = "The change is counted in standard deviations of what was known beforehand."
    blocks: list[ReportTable | Figure] = [ReportTable("Speeds", head, rows, caption)]
    for i, curve in enumerate(diagnostics.videos):
        rate = next((rate for rate in diagnostics.rates if rate.name == curve.name), None)
        period = 2 * pi / abs(rate.stated) if rate is not None and rate.stated else float("nan")
        turns = f" over {number_text(rate.turns, 4)} turns" if rate is not None and isfinite(rate.turns) else ""
        legend = [Legend("line", "after", "likeness")]
        legend += [Legend("dash", "accent", f"one turn, {number_text(period, 6)} s")] * isfinite(period)
        blocks.append(
            Figure(
                f"Video {curve.name}",
                figures.draw_video_repeats(curve, f"video-{i}", period),
                legend,
                "Above: how well the picture repeats after a time; after whole turns it does best. Below: "
                f"where the platter was against one that turns at a constant rate{turns}. A slow wave is a speed that "
                "varies, steps are frames that were lost.",
            )
        )
    return Section(
        "speeds",
        "Speed of the turntable",
        "The rate of the turntable is the reference of every scale: a relative error of the rate is the same "
        "relative error of all three scales.",
        blocks,
    )


def _at_rest_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the gyroscope at rest in several attitudes; None where g-sensitivity did not come from it."""
    rest = diagnostics.at_rest
    if rest is None or not len(rest.t_s):
        return None
    unit = readable_unit(rest.unit)
    figure = Figure(
        "Mean rate at rest in each attitude",
        figures.at_rest(rest),
        (*(Legend("dot", axis, f"{axis} measured, ±2σ") for axis in "xyz"), Legend("ring", "ink", "predicted")),
        "Each axis less its mean over all attitudes, so that what depends on the attitude shows. Predicted are "
        "constant bias, drift, g-sensitivity and, where the latitude was stated, the earth's rate. Below, the drift "
        "that was estimated jointly with them.",
    )
    left, centred = rest.measured - rest.predicted, rest.measured - figures.mean_rate(rest)
    rows: list[tuple[str, ...]] = []
    for i, axis in enumerate("xyz"):
        values = (
            finite_rms(centred[:, i]),
            finite_rms(left[:, i]),
            largest_magnitude(left[:, i]),
            finite_rms(rest.sigma[:, i]),
        )
        rows.append((axis, *(f"{number_text(value, 3, trim=False)}\u00a0{unit}" for value in values)))
    head = ("axis", "constant bias, rms", "with g-sensitivity, rms", "worst", "expected (σ)")
    return Section(
        "at-rest",
        "Gyroscope at rest",
        "At rest a gyroscope reads its bias, which depends on the specific force: the static experiment of Krebs. Six "
        "attitudes or more give the whole g-sensitivity.",
        (figure, ReportTable("Measured against predicted", head, rows)),
    )


def _dip_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the dip of the field in each attitude; None where the magnetometer was not aligned by it."""
    dip = diagnostics.dip
    if dip is None or not len(dip.dip_rad):
        return None
    left = np.degrees(dip.dip_rad - dip.estimated_rad)
    figure = Figure(
        "Dip in each attitude",
        figures.draw_field_dip(dip),
        (Legend("dot", "before", "measured"), Legend("line", "after", "estimated"), Legend("band", "after", "±2σ")),
        f"Estimated {estimate_text(degrees(dip.estimated_rad), degrees(dip.sigma_rad))}°; attitudes differ from it by "
        f"{number_text(finite_rms(left), 3)}° rms, {number_text(largest_magnitude(left), 3)}° at worst.",
    )
    return Section(
        "dip",
        "Alignment to the accelerometer",
        "Magnitudes cannot tell how the magnetometer lies to the accelerometer. The angle between field and "
        "gravity can: it is the same in every attitude when the two are aligned.",
        (figure,),
    )


def _choices_section(diagnostics: ImuDiagnostics | TriadDiagnostics) -> Section | None:
    """Return the thresholds and models that were tried, and Angrisano's iteration; None without any."""
    blocks: list[ReportTable | Figure] = []
    if isinstance(diagnostics, ImuDiagnostics):
        detector = diagnostics.detector
        if detector.candidates.size:
            candidates = np.atleast_2d(detector.candidates)[:_MOST_ROWS]
            chosen = np.flatnonzero(np.isclose(candidates[:, 0], detector.multiplier))
            blocks.append(
                ReportTable(
                    "Threshold of the static detector",
                    ("multiplier", "static intervals", "held-out rms", "criterion"),
                    [
                        (number_text(a), number_text(b, 6), quantity_text(c, "m/s²"), number_text(d, 5))
                        for a, b, c, d in candidates.tolist()
                    ],
                    "The threshold is a multiple of the resting variance. The chosen one is marked; a smaller "
                    "criterion is better, and it does not favour a threshold that keeps less data.",
                    marked=int(chosen[0]) if len(chosen) else None,
                )
            )
        errors = ("accelerometer, held out", "rotations, held out")
        rows = [
            (
                t.model,
                str(t.parameters),
                quantity_text(t.accelerometer_rms, "m/s²"),
                quantity_text(t.rotation_rms, "rad"),
            )
            for t in diagnostics.trials
        ]
    else:
        first = vectors_of(diagnostics)[0]
        errors = (f"{_QUANTITIES[first.quantity][0]}, held out",)
        rows = [(t.model, str(t.parameters), magnitude_text(t.holdout_rms, first.si_unit)) for t in diagnostics.trials]
    if rows:
        caption = "Each model was fitted and tested on data left out of its fit. The model in use is marked."
        marked = next((i for i, trial in enumerate(diagnostics.trials) if trial.chosen), None)
        blocks.append(ReportTable("Models", ("model", "parameters", *errors), rows, caption, marked=marked))
    if isinstance(diagnostics, TriadDiagnostics):
        for name, found in diagnostics.triads.items():
            if found.history is not None and finite_values(found.history.q).size:
                blocks += _history(name, found)
    return Section("choices", "What was tried", blocks=blocks) if blocks else None


def _history(name: str, record: TriadRecord) -> tuple[Figure, ReportTable]:
    """Return the iteration of Angrisano's paper: q over the steps, and X after each of them."""
    assert record.history is not None
    q, X = record.history.q, record.history.parameters
    figure = Figure(
        f"Angrisano's iteration, {name}",
        figures.draw_fit_history(record.history, f"history-{name}"),
        caption="The quadratic form of the residuals after each step of Eqs. (9) to (11). The iteration stops where a "
        "step changes it no more.",
    )
    unit, si = readable_unit(record.unit), readable_unit(record.si_unit)
    head = ("step", "q", *(f"{letter} {axis}" for letter in "abk" for axis in "xyz"))
    scaled = X * np.array([1e3] * 3 + [1.0] * 6)
    rows = [
        (str(i), number_text(float(value), 4), *(number_text(x, 5) for x in scaled[i].tolist()))
        for i, value in enumerate(q[:_MOST_ROWS])
    ]
    scale = f"{si}/{unit}" if si != unit else "1"
    caption = f"Angles a in mrad, biases b in {unit}, scale factors k in {scale}."
    return figure, ReportTable("The nine parameters, step by step", head, rows, caption, dense=True)


_NOISE = {
    "density": ("{}, noise density", "{}/√Hz"),
    "between_intervals": ("{}, scatter between static intervals", "{}"),
    "mean": ("{}, noise of a mean", "{}"),
    "extra": ("{}, scatter of means beyond their noise", "{}"),
    "accelerometer.residual": ("accelerometer, residual of |f| − g", "m/s²"),
    "rotation.beyond_noise": ("rotations, error beyond the noise", "rad"),
    "platter.tilt": ("tilt of the platter's axis against the vertical", "rad"),
    "magnetometer.sample_sigma": ("magnetometer, noise of a sample", "recorded"),
    "magnetometer.error_std": ("magnetometer, error of the strength of the field over all samples", "%"),
    "magnetometer.error_spread": ("the same, robustly", "%"),
    "magnetometer.block_s": ("length of what was held out together", "s"),
    "magnetometer.sigma_factor": ("sigmas are larger by, since errors close together are alike", "×"),
}
"""Name of a noise, or its last part -> what it is, and its unit, of the triad that its first part names."""


def _noise_section(diagnostics: ImuDiagnostics | TriadDiagnostics) -> Section | None:
    """Return the noise that was found; None if none was."""
    rows: list[tuple[str, str]] = []
    for name, value in diagnostics.noise.items():
        triad, _, kind = name.partition(".")
        words, unit = _NOISE.get(name) or _NOISE.get(kind) or (name.replace(".", ", ").replace("_", " "), "")
        unit = unit.format({"accelerometer": "m/s²", "gyroscope": "rad/s"}.get(triad, ""))
        if unit == "recorded" and isinstance(diagnostics, TriadDiagnostics):
            text = f"{number_text(value, 3)} {readable_unit(diagnostics.triads['magnetometer'].unit)}"
        elif unit == "%":
            text = f"{number_text(100 * value, 3)} % of the field"
        elif unit == "×":
            text = f"× {number_text(value, 3)}"
        else:
            text = quantity_text(value, unit) if unit else number_text(value, 3)
        rows.append((words.format(triad), text))
    return Section("noise", "Noise", blocks=(ReportTable("What was found", ("", ""), rows),)) if rows else None
