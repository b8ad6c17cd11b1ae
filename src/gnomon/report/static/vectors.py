"""Vectors of known magnitude that one sensor measured: where they pointed, their errors, and what was tried."""

from collections.abc import Iterator, Sequence
from math import degrees, isfinite

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers
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
from ..drawing.figures import (
    SPHERE_HEIGHT,
    Plot,
    Sheet,
    coarsen_envelope,
    count_along,
    draw_dots,
    hemisphere_panel,
    lambert_projection,
    set_y_limits,
)
from ..drawing.panel import Panel, TextStyle
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

COUNTED = {
    "imu": ("static interval", "static intervals"),
    "poses": ("pose", "poses"),
    "turntable": ("steady part", "steady parts"),
    "magnetometer": ("stretch", "stretches"),
}
"""What one row of a table of vectors is; of the magnetometer, samples close together."""
VECTOR_QUANTITIES = {
    "specific force": ("|f| − g", "gravity", "a {} with this direction up would help most"),
    "angular rate": ("|ω| − rate", "the axis of rotation", "mounting the sensor with this direction upwards would "
                     "help most"),
    "magnetic field": ("|h| − field", "the magnetic field", "turning the sensor until the field points there would "
                       "help most"),
}  # fmt: skip
"""Symbol of the error, what pointed, and where it should point."""
MOST_ROWS = 60
"""Rows of a table beyond this are counted instead of shown."""


@value_class(eq=True, kw_only=False)
class Vectors:
    """A vector of known magnitude that one triad measured many times."""

    name: str
    table: IntervalTable | PoseTable
    quantity: str
    si_unit: str
    record: TriadRecord | None = None


def kind_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> str:
    """Return what was done: "imu", "poses", "turntable" or "magnetometer"."""
    return "imu" if isinstance(diagnostics, ImuDiagnostics) else diagnostics.kind


def vectors_of(diagnostics: ImuDiagnostics | TriadDiagnostics) -> list[Vectors]:
    """Return what each triad measured."""
    if isinstance(diagnostics, ImuDiagnostics):
        return [Vectors("accelerometer", diagnostics.intervals, "specific force", "m/s^2")]
    return [Vectors(name, r.poses, r.quantity, r.si_unit, r) for name, r in diagnostics.triads.items()]


SERIES = (
    Legend("dot", "before", "before"),
    Legend("dot", "after", "after"),
    Legend("ring", "heldout", "held out of the fit"),
)


def used_rows(table: IntervalTable | PoseTable | RotationTable) -> np.ndarray:
    """Return which rows were used (n,)."""
    return np.asarray(table.used, dtype=bool)


def span_text(table: IntervalTable | PoseTable, i: int, digits: int) -> str:
    """Return when a pose was, or at which instant."""
    start, stop = float(table.start_s[i]), float(table.stop_s[i])
    if not isfinite(start):
        return MISSING
    return (
        f"{number_text(start, digits)} to {number_text(stop, digits)}" if stop > start else number_text(start, digits)
    )


def known_directions(table: IntervalTable | PoseTable) -> Floats:
    """Return the directions (n, 3) of the vectors that were used."""
    there = table.direction[used_rows(table)]
    return there[np.isfinite(there).all(axis=1)]


def directions_section(vectors: list[Vectors], kind: str) -> Section | None:
    """Return where each vector pointed in the body frame; None without any direction."""
    blocks: list[Figure] = []
    counted, plural = COUNTED[kind]
    for one in vectors:
        used, there = used_rows(one.table), known_directions(one.table)
        if not len(there):
            continue
        _, pointed, advice = VECTOR_QUANTITIES[one.quantity]
        gap, towards = largest_gap(there)
        legend = [Legend("dot", "after", "used")] + [Legend("ring", "accent", "left out")] * (not used.all())
        alt = f"Directions of {pointed} in the body frame in {len(there)} {plural} that were used."
        blocks.append(
            Figure(
                f"Directions of {pointed} in the body frame",
                draw_directions(f"directions-{one.name}", one.table.direction, used, alt),
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


def magnitude_section(vectors: Vectors, kind: str, calibration: Calibration) -> Section | None:
    """Return the errors of one triad's magnitude; None if nothing was used."""
    table, (counted, plural) = vectors.table, COUNTED[kind]
    symbol, used = VECTOR_QUANTITIES[vectors.quantity][0], used_rows(vectors.table)
    if not used.any():
        return None
    found = calibration.assessment.intervals_found  # of many, the table holds only some
    some = f" Of {found} {plural} {len(used)} at equal distances are shown here." if len(used) < found else ""
    scale = "one best scale" if kind == "imu" else "one nominal scale"
    figure = Figure(
        f"Error of the magnitude of {vectors.quantity}",
        magnitude_errors(
            f"errors-{vectors.name}",
            table,
            vectors.si_unit,
            counted,
            f"Error of the magnitude of {vectors.quantity} in {int(used.sum())} {plural} before and after the fit.",
        ),
        (*SERIES, Legend("band", "before", "±2σ predicted")),
        f"{symbol} in each {counted}. Before: {scale} and no bias, as an uncalibrated sensor reads. "
        f"Held out: the calibration was made without the {counted} that it is tested on.{some}",
    )
    in_mg = vectors.si_unit == "m/s^2"
    rows: list[tuple[str, ...]] = []
    for name, values in error_rows(table):
        milli_g = number_text(1e3 * values[0] / STANDARD_GRAVITY_M_S2, 3, trim=False)
        rows.append((name, *(magnitude_text(v, vectors.si_unit) for v in values), *([milli_g] if in_mg else [])))
    head = (symbol, "rms", "mean size", "worst", *(["rms [mg]"] if in_mg else []))
    tables = _pose_tables(vectors.record, counted, plural) if vectors.record else ()
    lead = _noise_words(vectors.record, counted) if vectors.record else ""
    return Section(
        vectors.name, vectors.name.capitalize(), lead, (figure, ReportTable("In numbers", head, rows), *tables)
    )


def error_rows(table: IntervalTable | RotationTable | PoseTable) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Yield each kind of error with rms, mean magnitude and largest magnitude over the used rows; nan without any."""
    for name, errors in (
        ("before", table.error_before),
        ("after", table.error_after),
        ("held out", table.error_holdout),
        ("expected (σ)", table.sigma),
    ):
        values = np.abs(finite_values(errors[used_rows(table)]))
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
    poses, used = record.poses, used_rows(record.poses)
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
                *([span_text(poses, i, 5)] if timed else []),
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


_CHARACTER, _LINE, _DOT, _APART = 0.054, 0.075, 0.04, 0.06
"""Width and height of a character of a label, half a dot, and the distance of a label, in units of the projection."""
_AXIS_NAMES = ((0.0, 1.5), (0.0, -1.5), (1.55, 0.0), (-1.55, 0.0))
_Box = tuple[float, float, float, float]


def draw_directions(name: str, direction: Floats, used: NDArray[np.bool_], alt: str) -> Plot:
    """Directions (n, 3) in the body frame on two hemispheres in Lambert's equal-area projection.

    Parameters
    ----------
    name : of the figure, unique on the page
    used : (n,) bool
    alt : what a person who does not see the figure should know
    """
    known = np.isfinite(direction).all(axis=1)
    used = np.asarray(used, dtype=bool) & known
    labelled = len(used) <= 60

    sheet = Sheet()
    for side in (1.0, -1.0):
        axes = hemisphere_panel(sheet, side)
        here = known & ((direction[:, 2] >= 0) == (side > 0))
        flat = lambert_projection(direction, side)
        for chosen, color, ring in ((here & ~used, "accent", True), (here & used, "after", False)):
            # Directions closer than a dot is wide add nothing to see.
            spots = np.unique(np.round(flat[chosen] / 0.02) * 0.02, axis=0) if not labelled else flat[chosen]
            draw_dots(axes, spots[:, 0], spots[:, 1], color, size=9 if labelled else 5, ring=ring and labelled)
        if labelled:
            for x, y, names in _labels(flat, np.flatnonzero(here)):
                axes.text(names, x, y, TextStyle(color="muted", size=9.5, align="left"), fine=True)
    return sheet.draw(name, SPHERE_HEIGHT, alt)


def _labels(flat: Floats, indices: Integers) -> list[tuple[float, float, str]]:
    """Return where labels begin, and their texts; points that nearly coincide share one, such as "3, 9, 17"."""
    groups: list[list[int]] = []
    for i in indices.tolist():
        near = next((g for g in groups if np.hypot(*(flat[g[0]] - flat[i])) < 0.11), None)
        if near is None:
            groups.append([i])
        else:
            near.append(i)
    taken = [(x - 0.1, y - 0.08, x + 0.1, y + 0.08) for x, y in _AXIS_NAMES]
    taken += [(x - _DOT, y - _DOT, x + _DOT, y + _DOT) for x, y in flat[indices].tolist()]
    labels: list[tuple[float, float, str]] = []
    for group in groups:
        names = ", ".join(str(i + 1) for i in group[:3]) + (" …" if len(group) > 3 else "")
        x, y = flat[max(group, key=lambda i: float(flat[i, 0]))].tolist()
        box = min(_boxes(x, y, _CHARACTER * len(names)), key=lambda box: _covered(box, taken))
        taken.append(box)
        labels.append((box[0], box[1], names))
    return labels


def _boxes(x: float, y: float, width: float) -> list[_Box]:
    """Return where a label may stand about a point, left, bottom, right and top, the best place first."""
    half = _LINE / 2
    beside = [(x + _APART, y - half), (x - _APART - width, y - half)]
    over = [(x - width / 2, y + _APART), (x - width / 2, y - _APART - _LINE)]
    corners = [
        (x + side * _APART - (width if side < 0 else 0), y + up) for side in (0.6, -0.6) for up in (half, -2 * half)
    ]
    return [(left, low, left + width, low + _LINE) for left, low in (*beside, *over, *corners)]


def _covered(box: _Box, taken: list[_Box]) -> float:
    """Return how much of a box others cover."""
    return sum(
        max(0.0, min(box[2], other[2]) - max(box[0], other[0]))
        * max(0.0, min(box[3], other[3]) - max(box[1], other[1]))
        for other in taken
    )


def magnitude_errors(name: str, table: IntervalTable | PoseTable, si_unit: str, x_label: str, alt: str) -> Plot:
    """Error of a magnitude per pose or interval: before, after, and when it was held out.

    Parameters
    ----------
    name : of the figure, unique on the page
    si_unit : of the errors, as in `TriadRecord`
    x_label : what is counted along x
    alt : what a person who does not see the figure should know
    """
    used = np.asarray(table.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)
    few = len(number_of) <= 300

    sheet = Sheet()
    before, after = table.error_before[used], table.error_after[used]
    heldout, sigma = table.error_holdout[used], table.sigma[used]
    unit, factor = magnitude_unit(largest_magnitude(np.concatenate([before, after])), si_unit)
    axes = sheet.panel(f"Before and after [{unit}]", top=36, height=180)
    for values, color in ((before, "before"), (after, "after")):
        draw_dots(axes, *_some(number_of, values * factor), color, size=7 if few else 4)
    set_y_limits(axes, before * factor, after * factor, symmetric=True)
    unit, factor = magnitude_unit(largest_magnitude(np.concatenate([after, heldout])), si_unit)
    close = sheet.panel(f"After, magnified [{unit}]", top=270, height=220, x_label=x_label)
    _band(close, number_of, 2 * sigma * factor)
    draw_dots(close, *_some(number_of, heldout * factor), "heldout", size=7 if few else 5, ring=True)
    draw_dots(close, *_some(number_of, after * factor), "after", size=5 if few else 3)
    set_y_limits(close, after * factor, heldout * factor, symmetric=True)
    for panel in (axes, close):
        count_along(panel, len(used))
        panel.across(0, "muted")
    axes.x.labelled = False
    return sheet.draw(name, 550, alt)


def _some(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return points (n,), of many such only some at equal distances, and the farthest of all."""
    step = -(-len(x) // 600)
    if step <= 1:
        return x, y
    far = np.argsort(-np.nan_to_num(np.abs(y)), kind="stable")[:20]
    kept = np.union1d(np.arange(0, len(x), step), far)
    return x[kept], y[kept]


def _band(panel: Panel, x: Floats, reach: Floats) -> None:
    """Shade ±reach around zero."""
    t, _, high = coarsen_envelope(x, reach, reach, bins=300)
    between = (t[1:] + t[:-1]) / 2
    edges = np.sort(np.concatenate([t[:1], between, between, t[-1:]]))
    panel.band(edges, -np.repeat(high, 2), np.repeat(high, 2), "before", alpha=0.22)


def choices_section(
    diagnostics: ImuDiagnostics | TriadDiagnostics, iterations: Sequence[Figure | ReportTable] = ()
) -> Section | None:
    """Return the thresholds and models that were tried, and the iterations of a fit; None without any."""
    blocks: list[ReportTable | Figure] = []
    if isinstance(diagnostics, ImuDiagnostics):
        detector = diagnostics.detector
        if detector.candidates.size:
            candidates = np.atleast_2d(detector.candidates)[:MOST_ROWS]
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
        errors = (f"{VECTOR_QUANTITIES[first.quantity][0]}, held out",)
        rows = [(t.model, str(t.parameters), magnitude_text(t.holdout_rms, first.si_unit)) for t in diagnostics.trials]
    if rows:
        caption = "Each model was fitted and tested on data left out of its fit. The model in use is marked."
        marked = next((i for i, trial in enumerate(diagnostics.trials) if trial.chosen), None)
        blocks.append(ReportTable("Models", ("model", "parameters", *errors), rows, caption, marked=marked))
    blocks += iterations
    return Section("choices", "What was tried", blocks=blocks) if blocks else None


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


def noise_section(diagnostics: ImuDiagnostics | TriadDiagnostics) -> Section | None:
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
