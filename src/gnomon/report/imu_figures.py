"""The figures of an IMU report; what they show is drawn from ImuDiagnostics alone."""

import numpy as np

from ..diagnostics import AllanCurve, DetectorTrace, ImuDiagnostics, IntervalTable, RotationTable, SignalEnvelope
from ..recording import Floats
from .figures import Sheet, coarser, dots, limits, log_limits, thinned, zigzag
from .imu_parameters import readable_unit
from .magnitude_figures import count_along
from .numbers import finite, largest, prefixed
from .panel import Panel

AXES = ("x", "y", "z")


def signals(diagnostics: ImuDiagnostics) -> str:
    """Raw signals with the static detector over them (document A, Fig. 3.1), and its statistic (Eq. 3.9)."""
    gyroscope = diagnostics.gyroscope
    ends = finite(np.concatenate([diagnostics.accelerometer.t_s, diagnostics.intervals.stop_s]))
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
        top += 262
    axes = sheet.panel("Variance over resting variance", top=top, height=170, x_label="time [s]")
    _statistic(axes, diagnostics.detector)
    axes.x.span(0, duration)
    alt = (
        f"Raw signals over {duration:.0f} s; a square wave is high where the recording is static: "
        f"{len(diagnostics.intervals.start_s)} intervals. Below, the detector's statistic against its threshold."
    )
    return sheet.draw("signals", height + 270 - 36, alt)


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
    sheet = Sheet()
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
    return sheet.draw("allan", 386, alt)


def rotation_errors(rotations: RotationTable) -> str:
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
            dots(axes, *thinned(x, positive), color, size=size, ring=ring)
        log_limits(axes, *(values * 1e3 for values, _, _, _ in series))
    count_along(panels[0][0], len(used))
    panels[1][0].x.span(0, max(largest(degrees) * 1.04, 1.0) if finite(degrees).size else 180.0)
    alt = f"Difference of measured and gyro-propagated gravity over {int(used.sum())} rotations, before and after."
    return sheet.draw("rotations", 644, alt)
