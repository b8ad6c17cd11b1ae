"""The sections of a report on one sensor that show how the calibration came about."""

from collections.abc import Iterator
from math import asin, degrees, isfinite

import numpy as np

from ...recording import Floats
from ...results.calibration import Calibration
from ...results.sensor_diagnostics import (
    ImuDiagnostics,
    IntervalTable,
    PoseTable,
    RotationTable,
    TriadDiagnostics,
    TriadRecord,
)
from ...units import STANDARD_GRAVITY_M_S2
from ..numbers import (
    MISSING,
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
from .choices import choices_section, noise_section
from .triad_sections import at_rest_section, dip_section, rates_section
from .vectors import COUNTED, MOST_ROWS, VECTOR_QUANTITIES, Vectors, kind_of, vectors_of

_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
_SERIES = (
    Legend("dot", "before", "before"),
    Legend("dot", "after", "after"),
    Legend("ring", "heldout", "held out of the fit"),
)


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
        rates_section(triads) if triads else None,
        _directions_section(vectors, kind_of(diagnostics)),
        *(_magnitude_section(one, kind_of(diagnostics), calibration) for one in vectors),
        _rotations_section(imu.rotations, calibration.gravity.value) if imu else None,
        at_rest_section(triads) if triads else None,
        dip_section(triads) if triads else None,
        choices_section(diagnostics),
        noise_section(diagnostics),
    )


def _mask(table: IntervalTable | PoseTable | RotationTable) -> np.ndarray:
    return np.asarray(table.used, dtype=bool)


def _recording_section(diagnostics: ImuDiagnostics) -> Section:
    """Return the signals with the static detector, and what it left out."""
    intervals = diagnostics.intervals
    used = _mask(intervals)
    still = float(np.sum(finite_values(intervals.stop_s[used] - intervals.start_s[used])))
    waves = [Legend("band", "before", "static, used")]
    if not used.all():
        waves.append(Legend("band", "accent", "static, left out"))
    figure = Figure(
        "Signals and static detector",
        figures.draw_raw_signals(diagnostics),
        (*_AXES, *waves, Legend("line", "accent", f"threshold {number_text(diagnostics.detector.multiplier, 3)}")),
        "The signals as recorded, reduced to the minimum and maximum of short stretches; shaded where the sensor "
        f"rests: {int(used.sum())} intervals were used, {number_text(still, 4)} s in all. Below, the variance in a "
        "sliding window relative to its level at rest: where it stays under the threshold, the sensor is static.",
    )
    rejected = np.flatnonzero(~used)
    rows = [(str(i + 1), _span(intervals, i, 5), intervals.reason[i] or MISSING) for i in rejected[:MOST_ROWS].tolist()]
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
        _, pointed, advice = VECTOR_QUANTITIES[one.quantity]
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
    symbol, used = VECTOR_QUANTITIES[vectors.quantity][0], _mask(vectors.table)
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
    if len(used) <= MOST_ROWS:
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
