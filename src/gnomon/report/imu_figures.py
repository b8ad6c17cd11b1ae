"""The figures of an IMU report; what they show is drawn from ImuDiagnostics alone."""

import numpy as np

from ..diagnostics import AllanCurve, DetectorTrace, ImuDiagnostics, IntervalTable, RotationTable, SignalEnvelope
from ..recording import Floats, Integers
from . import svg
from .figures import Sheet, coarser, dots, draw, limits, log_limits, thinned, zigzag
from .imu_parameters import readable_unit
from .numbers import finite, largest, prefixed
from .panel import Panel
from .sphere import SPHERE_HEIGHT, hemisphere, lambert

AXES = ("x", "y", "z")


def signals(diagnostics: ImuDiagnostics) -> str:
    """Raw signals with the static detector over them (document A, Fig. 3.1), and its statistic (Eq. 3.9)."""
    gyroscope = diagnostics.gyroscope
    ends = finite(np.concatenate([diagnostics.accelerometer.t_s, diagnostics.intervals.stop_s]))
    duration = float(ends.max()) if ends.size and ends.max() > 0 else 1.0
    height = 292.0 if gyroscope is None else 554.0

    def paint(sheet: Sheet) -> None:
        top = 36.0
        for name, signal in (("Accelerometer", diagnostics.accelerometer), ("Gyroscope", gyroscope)):
            if signal is None:
                continue
            axes = sheet.panel(f"{name} [{readable_unit(signal.unit)}]", top=top, height=210)
            _signal(axes, signal, diagnostics.intervals)
            axes.x.span(0, duration)
            axes.x.labelled = False
            top += 262
        axes = sheet.panel("Variance over resting variance", top=top, height=170, x_label="time [s]")
        _statistic(axes, diagnostics.detector)
        axes.x.span(0, duration)

    alt = (
        f"Raw signals over {duration:.0f} s; a square wave is high where the recording is static: "
        f"{len(diagnostics.intervals.start_s)} intervals. Below, the detector's statistic against its threshold."
    )
    return draw("signals", height + 270 - 36, alt, paint)


def _signal(panel: Panel, signal: SignalEnvelope, intervals: IntervalTable) -> None:
    t, low, high = coarser(signal.t_s, signal.low, signal.high)
    for i, name in enumerate(AXES):
        zigzag(panel, t, low[:, i], high[:, i], name)
    limits(panel, low, high)
    used = np.asarray(intervals.used, dtype=bool)
    _square_wave(panel, intervals.start_s[used], intervals.stop_s[used], "ink")
    _square_wave(panel, intervals.start_s[~used], intervals.stop_s[~used], "accent", closed=False)


def _square_wave(panel: Panel, start: Floats, stop: Floats, color: str, *, closed: bool = True) -> None:
    """Draw a wave that is high in the intervals; `closed` also draws it where it is low."""
    if not len(start):
        return
    gap = np.full(len(start), np.nan)
    t = np.stack([start, start, stop, stop] + ([] if closed else [gap]), axis=1).ravel()
    level = np.tile([0.03, 0.97, 0.97, 0.03] + ([] if closed else [np.nan]), len(start))
    if closed:
        t, level = np.concatenate([[0.0], t, [1e12]]), np.concatenate([[0.03], level, [0.03]])
    panel.wave(t, level, color, width=1.1, alpha=0.85)


def _statistic(panel: Panel, trace: DetectorTrace) -> None:
    statistic = np.where(trace.statistic > 0, trace.statistic, np.nan)
    t, low, high = coarser(trace.t_s, statistic, statistic)
    zigzag(panel, t, low, high, "before")
    log_limits(panel, statistic, np.array([trace.multiplier]))
    if trace.multiplier > 0:
        panel.across(trace.multiplier, "accent", width=1.6)


def allan(curve: AllanCurve) -> str:
    """Allan deviation of the three gyroscope axes (document A, Fig. 3.2), with the advised T_init."""

    def paint(sheet: Sheet) -> None:
        prefix, factor = prefixed(float(np.median(finite(curve.deviation))) if finite(curve.deviation).size else 1.0)
        title = f"Allan deviation [{prefix}rad/s]"
        axes = sheet.panel(title, top=36, height=290, x_label="averaging time [s]")
        axes.x.grid = True
        positive = np.where(curve.deviation > 0, curve.deviation * factor, np.nan)
        for i, name in enumerate(AXES):
            axes.line(curve.tau_s, positive[:, i], name, width=1.8)
        log_limits(axes, positive)
        axes.x.logarithmic = True
        taus = finite(curve.tau_s)
        taus = taus[taus > 0]
        bounds = (float(taus.min()), float(taus.max())) if taus.size else (1.0, 10.0)
        axes.x.span(bounds[0], max(bounds[1], 1.05 * bounds[0]))
        axes.x.ticks = [step * 10.0**k for k in range(-9, 9) for step in (1, 2, 5)]
        if np.isfinite(curve.t_init_s):
            axes.upright(curve.t_init_s, "accent", width=1.6, dash=(5.0, 3.0))

    alt = f"Allan deviation of the gyroscope axes x, y, z over averaging time, from {curve.static_s:.0f} s at rest."
    return draw("allan", 386, alt, paint)


def attitudes(intervals: IntervalTable) -> str:
    """Directions of gravity in the body frame on two hemispheres in Lambert's equal-area projection."""
    known = np.isfinite(intervals.direction).all(axis=1)
    used = np.asarray(intervals.used, dtype=bool) & known
    labelled = len(used) <= 60

    def paint(sheet: Sheet) -> None:
        for side in (1.0, -1.0):
            axes = hemisphere(sheet, side)
            here = known & ((intervals.direction[:, 2] >= 0) == (side > 0))
            flat = lambert(intervals.direction, side)
            for chosen, color, ring in ((here & ~used, "accent", True), (here & used, "after", False)):
                # Directions closer than a dot is wide add nothing to see.
                spots = np.unique(np.round(flat[chosen] / 0.02) * 0.02, axis=0) if not labelled else flat[chosen]
                dots(axes, spots[:, 0], spots[:, 1], color, size=9, ring=ring)
            if labelled:
                for x, y, names in _labels(flat, np.flatnonzero(here)):
                    axes.text(names, x + 0.06, y + 0.03, svg.text_style("muted", 9.5, "left"), fine=True)

    alt = f"Directions of gravity in the body frame in {int(used.sum())} static intervals that were used."
    return draw("attitudes", SPHERE_HEIGHT, alt, paint)


def _labels(flat: Floats, indices: Integers) -> list[tuple[float, float, str]]:
    """Return places and numbers of points; points that nearly coincide share one label, such as "3, 9, 17"."""
    groups: list[list[int]] = []
    for i in indices.tolist():
        near = next((g for g in groups if np.hypot(*(flat[g[0]] - flat[i])) < 0.11), None)
        if near is None:
            groups.append([i])
        else:
            near.append(i)
    labels: list[tuple[float, float, str]] = []
    for group in groups:
        names = ", ".join(str(i + 1) for i in group[:3]) + (" …" if len(group) > 3 else "")
        x, y = flat[max(group, key=lambda i: float(flat[i, 0]))]
        labels.append((float(x), float(y), names))
    return labels


def accelerometer_errors(intervals: IntervalTable) -> str:
    """|f| - g per static interval: before, after, and when the interval was held out."""
    used = np.asarray(intervals.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)

    def paint(sheet: Sheet) -> None:
        before, after = intervals.error_before[used], intervals.error_after[used]
        heldout, sigma = intervals.error_holdout[used], intervals.sigma[used]
        prefix, factor = prefixed(largest(np.concatenate([before, after])))
        axes = sheet.panel(f"Before and after [{prefix}m/s²]", top=36, height=180)
        for values, color, ring in ((before, "before", False), (after, "after", False)):
            dots(axes, *thinned(number_of, values * factor), color, ring=ring)
        limits(axes, before * factor, after * factor, symmetric=True)
        prefix, factor = prefixed(largest(np.concatenate([after, heldout])))
        close = sheet.panel(f"After, magnified [{prefix}m/s²]", top=270, height=220, x_label="static interval")
        _band(close, number_of, 2 * sigma * factor)
        dots(close, *thinned(number_of, heldout * factor), "heldout", ring=True)
        dots(close, *thinned(number_of, after * factor), "after", size=5)
        limits(close, after * factor, heldout * factor, symmetric=True)
        for panel in (axes, close):
            _over_index(panel, len(used))
        axes.x.labelled = False

    alt = f"Error of the magnitude of specific force in {int(used.sum())} static intervals, before and after the fit."
    return draw("accelerometer", 550, alt, paint)


def _band(panel: Panel, x: Floats, reach: Floats) -> None:
    """Shade ±reach around zero."""
    t, _, high = coarser(x, reach, reach, bins=300)
    between = (t[1:] + t[:-1]) / 2
    edges = np.sort(np.concatenate([t[:1], between, between, t[-1:]]))
    panel.band(edges, -np.repeat(high, 2), np.repeat(high, 2), "before", alpha=0.22)


def _over_index(panel: Panel, count: int) -> None:
    _count(panel, count)
    panel.across(0, "muted")


def _count(panel: Panel, count: int) -> None:
    """Let the x scale count from one."""
    panel.x.span(0.4, max(count, 1) + 0.6)
    panel.x.most, panel.x.whole = 8, True


def rotation_errors(rotations: RotationTable) -> str:
    """|u_a - u_g| per rotation and over the angle turned: before, after, held out."""
    used = np.asarray(rotations.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)
    degrees = np.asarray(np.degrees(rotations.angle_rad[used]), dtype=np.float64)

    def paint(sheet: Sheet) -> None:
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
                dots(axes, *thinned(x, positive), color, size=size, ring=ring)
            log_limits(axes, *(values * 1e3 for values, _, _, _ in series))
        _count(panels[0][0], len(used))
        panels[1][0].x.span(0, max(largest(degrees) * 1.04, 1.0) if finite(degrees).size else 180.0)

    alt = f"Difference of measured and gyro-propagated gravity over {int(used.sum())} rotations, before and after."
    return draw("rotations", 644, alt, paint)
