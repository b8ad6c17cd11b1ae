"""The figures of a report on one sensor; what they show is drawn from the diagnostics alone."""

import numpy as np
from numpy.typing import NDArray

from ...recording import Floats, Integers
from ...results.sensor_diagnostics import (
    AllanCurve,
    DetectorTrace,
    DipTable,
    GyroscopeAtRest,
    ImuDiagnostics,
    IntervalTable,
    IterationHistory,
    PeriodCurve,
    PoseTable,
    RotationTable,
    SignalEnvelope,
)
from ..drawing import svg
from ..drawing.figures import (
    AXES,
    SPHERE_HEIGHT,
    Plot,
    Sheet,
    coarsen_envelope,
    count_along,
    draw_dots,
    draw_envelope,
    hemisphere_panel,
    lambert_projection,
    log_limits,
    set_y_limits,
    thin_points,
)
from ..drawing.panel import Panel
from ..numbers import finite_values, highest_finite, largest_magnitude, magnitude_unit, readable_unit, si_prefix


def draw_raw_signals(diagnostics: ImuDiagnostics) -> Plot:
    """Raw signals with the static detector over them (Tedaldi 2014, Fig. 3.1), and its statistic (Eq. 3.9)."""
    gyroscope = diagnostics.gyroscope
    ends = finite_values(np.concatenate([diagnostics.accelerometer.t_s, diagnostics.intervals.stop_s]))
    duration = float(ends.max()) if ends.size and ends.max() > 0 else 1.0
    height = 292.0 if gyroscope is None else 554.0

    sheet = Sheet()
    top = 36.0
    for name, signal in (("Accelerometer", diagnostics.accelerometer), ("Gyroscope", gyroscope)):
        if signal is None:
            continue
        axes = sheet.panel(f"{name} [{readable_unit(signal.unit)}]", top=top, height=210)
        _signal(axes, signal, diagnostics.intervals)
        axes.x.span(0, duration)
        axes.x.labelled = False
        axes.x.timed = True
        top += 262
    axes = sheet.panel("Variance over resting variance", top=top, height=170, x_label="time [s]")
    _statistic(axes, diagnostics.detector)
    axes.x.span(0, duration)
    axes.x.timed = True
    alt = (
        f"Raw signals over {duration:.0f} s; shaded where the recording is static: "
        f"{len(diagnostics.intervals.start_s)} intervals. Below, the detector's statistic against its threshold."
    )
    return sheet.draw("signals", height + 270 - 36, alt)


def _signal(panel: Panel, signal: SignalEnvelope, intervals: IntervalTable) -> None:
    t, low, high = coarsen_envelope(signal.t_s, signal.low, signal.high)
    for i, name in enumerate(AXES):
        draw_envelope(panel, t, low[:, i], high[:, i], name)
    set_y_limits(panel, low, high)
    used = np.asarray(intervals.used, dtype=bool)
    for chosen, color in ((used, "before"), (~used, "accent")):
        panel.shade(intervals.start_s[chosen], intervals.stop_s[chosen], color, alpha=0.3)


def _statistic(panel: Panel, trace: DetectorTrace) -> None:
    statistic = np.where(trace.statistic > 0, trace.statistic, np.nan)
    t, low, high = coarsen_envelope(trace.t_s, statistic, statistic)
    draw_envelope(panel, t, low, high, "before")
    log_limits(panel, statistic, np.array([trace.multiplier]))
    if trace.multiplier > 0:
        panel.across(trace.multiplier, "accent", width=1.6)


def draw_allan(curve: AllanCurve) -> Plot:
    """Allan deviation of the three gyroscope axes (Tedaldi 2014, Fig. 3.2), with the advised T_init."""
    sheet = Sheet()
    prefix, factor = si_prefix(
        float(np.median(finite_values(curve.deviation))) if finite_values(curve.deviation).size else 1.0
    )
    title = f"Allan deviation [{prefix}rad/s]"
    axes = sheet.panel(title, top=36, height=290, x_label="averaging time [s]")
    axes.x.grid = True
    positive = np.where(curve.deviation > 0, curve.deviation * factor, np.nan)
    for i, name in enumerate(AXES):
        axes.line(curve.tau_s, positive[:, i], name, width=1.8)
    log_limits(axes, positive)
    axes.x.logarithmic = True
    taus = finite_values(curve.tau_s)
    taus = taus[taus > 0]
    bounds = (float(taus.min()), float(taus.max())) if taus.size else (1.0, 10.0)
    axes.x.span(bounds[0], max(bounds[1], 1.05 * bounds[0]))
    axes.x.ticks = [step * 10.0**k for k in range(-9, 9) for step in (1, 2, 5)]
    if np.isfinite(curve.t_init_s):
        axes.upright(curve.t_init_s, "accent", width=1.6, dash=(5.0, 3.0))
    alt = f"Allan deviation of the gyroscope axes x, y, z over averaging time, from {curve.static_s:.0f} s at rest."
    return sheet.draw("allan", 386, alt)


def rotation_errors(rotations: RotationTable) -> Plot:
    """|u_a - u_g| per rotation and over the angle turned: before, after, held out."""
    used = np.asarray(rotations.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)
    degrees = np.asarray(np.degrees(rotations.angle_rad[used]), dtype=np.float64)

    sheet = Sheet()
    title = "Measured against propagated gravity [mrad]"
    panels = (
        (sheet.panel(title, top=36, height=220, x_label="rotation"), number_of),
        (sheet.panel(title, top=364, height=220, x_label="angle by which gravity turned [°]"), degrees),
    )
    series = (
        (rotations.error_before[used], "before", False, 7.0),
        (rotations.error_holdout[used], "heldout", True, 7.0),
        (rotations.error_after[used], "after", False, 5.0),
    )
    for axes, x in panels:
        for values, color, ring, size in series:
            positive = np.where(values > 0, values * 1e3, np.nan)
            draw_dots(axes, *thin_points(x, positive), color, size=size, ring=ring)
        log_limits(axes, *(values * 1e3 for values, _, _, _ in series))
    count_along(panels[0][0], len(used))
    panels[1][0].x.span(0, max(largest_magnitude(degrees) * 1.04, 1.0) if finite_values(degrees).size else 180.0)
    alt = f"Difference of measured and gyro-propagated gravity over {int(used.sum())} rotations, before and after."
    return sheet.draw("rotations", 644, alt)


_PREFIXED = ("rad/s", "deg/s")
_MOST = 300
"""Attitudes beyond this are drawn only in part."""


def mean_rate(rest: GyroscopeAtRest) -> Floats:
    """Return the mean over all attitudes, (3,) [unit]; zero where nothing is known."""
    known = np.isfinite(rest.measured)
    return np.where(known, rest.measured, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def at_rest(rest: GyroscopeAtRest) -> Plot:
    """Gyroscope at rest in each attitude, measured and predicted, an axis a panel; the drift of its bias below."""
    count = len(rest.t_s)
    some = slice(None, None, -(-count // _MOST))
    number = np.arange(1.0, count + 1)[some]
    measured, predicted, sigma = rest.measured[some], rest.predicted[some], rest.sigma[some]
    centre = mean_rate(rest)
    measured, predicted = measured - centre, predicted - centre

    sheet = Sheet()
    unit, factor = _scaled(largest_magnitude(np.concatenate([measured, predicted])), rest.unit)
    for axis, name in enumerate("xyz"):
        top = 36.0 + 190 * axis
        label = "attitude" if axis == 2 else ""
        panel = sheet.panel(f"{name} axis, less its mean [{unit}]", top=top, height=136, x_label=label)
        _whiskers(panel, number, factor * measured[:, axis], 2 * factor * sigma[:, axis], name)
        draw_dots(panel, number, factor * predicted[:, axis], "ink", size=9, ring=True)
        draw_dots(panel, number, factor * measured[:, axis], name, size=6)
        reach = factor * (np.abs(measured[:, axis]) + 2 * sigma[:, axis])
        set_y_limits(panel, reach, factor * predicted[:, axis], symmetric=True)
        count_along(panel, count)
        panel.across(0, "muted")
        panel.x.labelled = axis == 2
    unit, factor = _scaled(largest_magnitude(rest.drift), rest.unit)
    panel = sheet.panel(f"Drift of the bias [{unit}]", top=662, height=136, x_label="time [s]")
    for axis, name in enumerate("xyz"):
        panel.line(rest.t_s[some], factor * rest.drift[some, axis], name, width=1.6)
    set_y_limits(panel, factor * rest.drift, symmetric=True)
    ends = finite_values(rest.t_s)
    panel.x.span(*(ends.min(), max(ends.max(), ends.min() + 1)) if ends.size else (0, 1))
    panel.across(0, "muted")
    alt = f"Mean rate of the gyroscope at rest in {count} attitudes, measured and predicted, and the drift of its bias."
    return sheet.draw("at-rest", 858, alt)


def _whiskers(panel: Panel, x: Floats, y: Floats, reach: Floats, color: str) -> None:
    gap = np.full(len(x), np.nan)
    ends = np.stack([y - reach, y + reach, gap], axis=1).ravel()
    panel.line(np.stack([x, x, gap], axis=1).ravel(), ends, color, width=1.4, alpha=0.7)


def _scaled(reach: float, unit: str) -> tuple[str, float]:
    """Return the unit of a recording with a prefix, where it takes one, and the factor to it."""
    prefix, factor = si_prefix(reach) if unit in _PREFIXED else ("", 1.0)
    return f"{prefix}{readable_unit(unit)}", factor


def draw_field_dip(table: DipTable) -> Plot:
    """Angle between magnetic field and horizontal in each attitude, with the estimated one."""
    count = len(table.dip_rad)
    found, estimated = np.degrees(table.dip_rad), float(np.degrees(table.estimated_rad))
    spread = 2 * float(np.degrees(table.sigma_rad))

    sheet = Sheet()
    panel = sheet.panel("Dip of the field below horizontal [°]", top=36, height=220, x_label="attitude")
    if spread > 0:
        panel.strip(estimated - spread, estimated + spread, "after", alpha=0.2)
    panel.across(estimated, "after", width=1.6)
    draw_dots(panel, np.arange(1.0, count + 1), np.asarray(found, dtype=np.float64), "before")
    set_y_limits(panel, np.asarray(found, dtype=np.float64), np.array([estimated - spread, estimated + spread]))
    count_along(panel, count)
    alt = f"Dip of the magnetic field in {count} attitudes; estimated {estimated:.2f} degrees."
    return sheet.draw("dip", 320, alt)


def draw_video_repeats(curve: PeriodCurve, name: str, period_s: float) -> Plot:
    """How well the picture repeats after each period, and by how much the platter ran ahead of a constant rate."""
    sheet = Sheet()
    panel = sheet.panel("Likeness of pictures one period apart", top=36, height=180, x_label="period [s]")
    panel.line(curve.period_s, curve.score, "after", width=1.4)
    set_y_limits(panel, curve.score)
    panel.x.span(*_ends(curve.period_s))
    panel.x.grid = True
    if np.isfinite(period_s):
        panel.upright(period_s, "accent", width=1.6, dash=(5.0, 3.0))
    degrees = 360 * curve.phase_error_turns
    panel = sheet.panel("Platter ahead of a constant rate [°]", top=320, height=180, x_label="time [s]")
    draw_dots(panel, curve.t_s, degrees, "after", size=4)
    set_y_limits(panel, degrees, symmetric=True)
    panel.x.span(*_ends(curve.t_s))
    panel.across(0, "muted")
    alt = f"Video {curve.name}: likeness of pictures over the period between them, and the phase error of the platter."
    return sheet.draw(name, 560, alt)


def _ends(values: Floats) -> tuple[float, float]:
    known = finite_values(values)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return low, high if high > low else low + 1


def draw_fit_history(found: IterationHistory, name: str) -> Plot:
    """Residual quadratic form after each step of the paper's iteration."""
    step = np.arange(len(found.q), dtype=np.float64)

    sheet = Sheet()
    panel = sheet.panel("Residual quadratic form q", top=36, height=200, x_label="iteration")
    positive = np.where(found.q > 0, found.q, np.nan)
    panel.line(step, positive, "after", width=1.6)
    draw_dots(panel, step, positive, "after")
    if highest_finite(positive) > 10 * -highest_finite(-positive):
        log_limits(panel, found.q)
    else:
        set_y_limits(panel, positive)
    panel.x.span(-0.4, highest_finite(step, 1.0) + 0.4)
    panel.x.most, panel.x.whole = 10, True
    return sheet.draw(name, 300, f"Residual quadratic form over {len(found.q)} steps of the paper's iteration.")


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
                axes.text(names, x, y, svg.TextStyle(color="muted", size=9.5, align="left"), fine=True)
    return sheet.draw(name, SPHERE_HEIGHT, alt)


_CHARACTER, _LINE, _DOT, _APART = 0.054, 0.075, 0.04, 0.06
"""Width and height of a character of a label, half a dot, and the distance of a label, in units of the projection."""
_AXIS_NAMES = ((0.0, 1.5), (0.0, -1.5), (1.55, 0.0), (-1.55, 0.0))


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


_Box = tuple[float, float, float, float]


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
