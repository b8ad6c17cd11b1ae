"""The figures of a calibration from magnitudes that no other report has."""

import numpy as np

from ..recording import Floats
from ..triad_diagnostics import DipTable, GyroscopeAtRest, IterationHistory, PeriodCurve
from .figures import Sheet, dots, limits, log_limits
from .imu_parameters import readable_unit
from .magnitude_figures import count_along
from .numbers import finite, highest, largest, prefixed
from .panel import Panel

_PREFIXED = ("rad/s", "deg/s")
_MOST = 300
"""Attitudes beyond this are drawn only in part."""


def mean_rate(rest: GyroscopeAtRest) -> Floats:
    """Return the mean over all attitudes, (3,) [unit]; zero where nothing is known."""
    known = np.isfinite(rest.measured)
    return np.where(known, rest.measured, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def at_rest(rest: GyroscopeAtRest) -> str:
    """Gyroscope at rest in each attitude, measured and predicted, an axis a panel; the drift of its bias below."""
    count = len(rest.t_s)
    some = slice(None, None, -(-count // _MOST))
    number = np.arange(1.0, count + 1)[some]
    measured, predicted, sigma = rest.measured[some], rest.predicted[some], rest.sigma[some]
    centre = mean_rate(rest)
    measured, predicted = measured - centre, predicted - centre

    sheet = Sheet()
    unit, factor = _scaled(largest(np.concatenate([measured, predicted])), rest.unit)
    for axis, name in enumerate("xyz"):
        top = 36.0 + 190 * axis
        label = "attitude" if axis == 2 else ""
        panel = sheet.panel(f"{name} axis, less its mean [{unit}]", top=top, height=136, x_label=label)
        _whiskers(panel, number, factor * measured[:, axis], 2 * factor * sigma[:, axis], name)
        dots(panel, number, factor * predicted[:, axis], "ink", size=9, ring=True)
        dots(panel, number, factor * measured[:, axis], name, size=6)
        reach = factor * (np.abs(measured[:, axis]) + 2 * sigma[:, axis])
        limits(panel, reach, factor * predicted[:, axis], symmetric=True)
        count_along(panel, count)
        panel.across(0, "muted")
        panel.x.labelled = axis == 2
    unit, factor = _scaled(largest(rest.drift), rest.unit)
    panel = sheet.panel(f"Drift of the bias [{unit}]", top=662, height=136, x_label="time [s]")
    for axis, name in enumerate("xyz"):
        panel.line(rest.t_s[some], factor * rest.drift[some, axis], name, width=1.6)
    limits(panel, factor * rest.drift, symmetric=True)
    ends = finite(rest.t_s)
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
    prefix, factor = prefixed(reach) if unit in _PREFIXED else ("", 1.0)
    return f"{prefix}{readable_unit(unit)}", factor


def dip(table: DipTable) -> str:
    """Angle between magnetic field and horizontal in each attitude, with the estimated one."""
    count = len(table.dip_rad)
    found, estimated = np.degrees(table.dip_rad), float(np.degrees(table.estimated_rad))
    spread = 2 * float(np.degrees(table.sigma_rad))

    sheet = Sheet()
    panel = sheet.panel("Dip of the field below horizontal [°]", top=36, height=220, x_label="attitude")
    if spread > 0:
        panel.strip(estimated - spread, estimated + spread, "after", alpha=0.2)
    panel.across(estimated, "after", width=1.6)
    dots(panel, np.arange(1.0, count + 1), np.asarray(found, dtype=np.float64), "before")
    limits(panel, np.asarray(found, dtype=np.float64), np.array([estimated - spread, estimated + spread]))
    count_along(panel, count)
    alt = f"Dip of the magnetic field in {count} attitudes; estimated {estimated:.2f} degrees."
    return sheet.draw("dip", 320, alt)


def video(curve: PeriodCurve, name: str, period_s: float) -> str:
    """How well the picture repeats after each period, and by how much the platter ran ahead of a constant rate."""
    sheet = Sheet()
    panel = sheet.panel("Likeness of pictures one period apart", top=36, height=180, x_label="period [s]")
    panel.line(curve.period_s, curve.score, "after", width=1.4)
    limits(panel, curve.score)
    panel.x.span(*_ends(curve.period_s))
    panel.x.grid = True
    if np.isfinite(period_s):
        panel.upright(period_s, "accent", width=1.6, dash=(5.0, 3.0))
    degrees = 360 * curve.phase_error_turns
    panel = sheet.panel("Platter ahead of a constant rate [°]", top=320, height=180, x_label="time [s]")
    dots(panel, curve.t_s, degrees, "after", size=4)
    limits(panel, degrees, symmetric=True)
    panel.x.span(*_ends(curve.t_s))
    panel.across(0, "muted")
    alt = f"Video {curve.name}: likeness of pictures over the period between them, and the phase error of the platter."
    return sheet.draw(name, 560, alt)


def _ends(values: Floats) -> tuple[float, float]:
    known = finite(values)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return low, high if high > low else low + 1


def history(found: IterationHistory, name: str) -> str:
    """Residual quadratic form after each step of the paper's iteration."""
    step = np.arange(len(found.q), dtype=np.float64)

    sheet = Sheet()
    panel = sheet.panel("Residual quadratic form q", top=36, height=200, x_label="iteration")
    positive = np.where(found.q > 0, found.q, np.nan)
    panel.line(step, positive, "after", width=1.6)
    dots(panel, step, positive, "after")
    if highest(positive) > 10 * -highest(-positive):
        log_limits(panel, found.q)
    else:
        limits(panel, positive)
    panel.x.span(-0.4, highest(step, 1.0) + 0.4)
    panel.x.most, panel.x.whole = 10, True
    return sheet.draw(name, 300, f"Residual quadratic form over {len(found.q)} steps of the paper's iteration.")
