"""Figures of a camera-IMU report that run over time: signals as measured and as predicted, residuals, biases."""

from collections.abc import Iterable

import numpy as np

from ..diagnostics import BiasTrack, SignalFit
from ..recording import Floats
from .figures import WIDTH, Sheet, coarser, limits, zigzag
from .numbers import finite, highest, positive, prefixed, readable_unit
from .panel import DASHED, Panel

AXES = ("x", "y", "z")
ZOOM_S = 2.0
_FINEST = 400
"""Points per line that a section is drawn with."""


def signal_name(name: str, names: Iterable[str]) -> str:
    """Return "imu0.gyroscope" as it is read: with the IMU where `names` are of several, alone "Gyroscope"."""
    imu, _, triad = name.partition(".")
    several = len({other.partition(".")[0] for other in names}) > 1
    return f"{triad.capitalize()} of {imu}" if several else triad.capitalize() or imu


def residual(fit: SignalFit, predicted: Floats | None) -> Floats:
    """Return measured minus predicted, (n, 3); nan where a sample was not used or nothing was predicted."""
    if predicted is None:
        return np.full_like(fit.measured, np.nan)
    return np.where(np.asarray(fit.used, dtype=bool)[:, None], fit.measured - predicted, np.nan)


def telling_section(fit: SignalFit, length_s: float = ZOOM_S) -> tuple[float, float]:
    """Return start and stop [s] of the section in which the two models differ most, or the model fits worst.

    Sums over the section are compared, so that one with gaps does not win; where the fit itself is looked at, up to
    five sigma of each sample count, so that a single outlier does not decide.
    """
    t = fit.t_s
    if not len(t) or not np.isfinite(t).all():
        return 0.0, length_s
    against = fit.measured if fit.basic is None else fit.basic
    used = np.asarray(fit.used, dtype=bool)
    difference = np.where(used[:, None], (fit.predicted - against) / positive(fit.sigma), 0.0)
    score = np.clip(np.nan_to_num(difference), -5, 5) if fit.basic is None else np.nan_to_num(difference)
    total = np.concatenate([[0.0], np.cumsum((score**2).sum(axis=1))])
    stop = np.searchsorted(t, t + length_s)
    start = int(np.argmax(total[stop] - total[:-1]))
    first = max(min(float(t[start]), float(t[-1]) - length_s), float(t[0]))
    return first, first + length_s


def overview(name: str, fit: SignalFit, section: tuple[float, float]) -> str:
    """Draw a signal over the whole recording, and what the predictions leave of it, per axis."""
    end = positive(highest(fit.t_s))
    model, basic = residual(fit, fit.predicted), residual(fit, fit.basic)
    reach = _reach(fit, model, basic)
    prefix, factor = prefixed(reach)
    unit = readable_unit(fit.unit)

    sheet = Sheet()
    axes = sheet.panel(f"Measured [{unit}]", top=36, height=190)
    t, low, high = coarser(fit.t_s, fit.measured, fit.measured, bins=600)
    for i, axis in enumerate(AXES):
        zigzag(axes, t, low[:, i], high[:, i], axis)
    limits(axes, low, high)
    panels = [axes]
    for i, axis in enumerate(AXES):
        title = f"{axis}: measured − predicted [{prefix}{unit}]"
        panel = sheet.panel(title, top=272 + 132 * i, height=88, x_label="time [s]" if i == 2 else "")
        _noise_band(panel, fit, factor)
        for values, color in ((basic, "accent"), (model, axis)):
            _envelope(panel, fit.t_s, values[:, i] * factor, color)
        panel.y.span(-reach * factor, reach * factor)
        panel.y.most = 3
        panels.append(panel)
    for panel in panels:
        panel.x.span(0, end)
        panel.x.labelled = panel is panels[-1]
        for edge in section:
            panel.upright(edge, "ink", dash=DASHED)
    alt = f"{name} over {end:.0f} s, and the residuals of its three axes."
    return sheet.draw(f"overview-{name.replace('.', '-')}", 690, alt)


def _noise_band(panel: Panel, fit: SignalFit, factor: float) -> None:
    reach = 2 * positive(fit.sigma, 0.0) * factor
    panel.strip(-reach, reach, "before", alpha=0.22)


def _envelope(panel: Panel, t: Floats, values: Floats, color: str) -> None:
    """Fill between the smallest and the largest value of short stretches."""
    t, low, high = coarser(t, values, values, bins=300)
    panel.band(t, low, high, color, edge=0.6)


def _reach(fit: SignalFit, *residuals: Floats) -> float:
    """Return how far a residual panel has to reach: to the largest, unless that is an outlier beyond comparison."""
    values = np.abs(finite(np.concatenate([part.ravel() for part in residuals])))
    most = min(float(values.max()), 6 * float(np.quantile(values, 0.99))) if values.size else 0.0
    return 1.08 * positive(max(most, 3 * positive(fit.sigma, 0.0)))


def section_figure(name: str, fit: SignalFit, section: tuple[float, float]) -> str:
    """Draw a section of a signal as measured and as predicted, and the residual (document B, Figs. 5.6, B.9-B.14)."""
    first, last = np.searchsorted(fit.t_s, section)
    near = slice(int(first), int(last))
    t, measured = fit.t_s[near], fit.measured[near]
    predictions = (fit.predicted,) if fit.basic is None else (fit.basic, fit.predicted)
    left = [residual(fit, values)[near] for values in predictions]
    reach = _reach(fit, *left)
    prefix, factor = prefixed(reach)
    unit = readable_unit(fit.unit)

    sheet = Sheet()
    for i, axis in enumerate(AXES):
        colors = (axis,) if fit.basic is None else ("accent", axis)
        top = 36 + 292 * i
        axes = sheet.panel(f"{axis} [{unit}]", top=top, height=138)
        _line(axes, t, measured[:, i], "before", width=3.4)
        for values, color in zip(predictions, colors, strict=True):
            _line(axes, t, values[near, i], color)
        limits(axes, measured[:, i], *(values[near, i] for values in predictions))
        title = f"measured − predicted [{prefix}{unit}]"
        below = sheet.panel(title, top=top + 178, height=70, x_label="time [s]" if i == 2 else "")
        _noise_band(below, fit, factor)
        for values, color in zip(left, colors, strict=True):
            _line(below, t, values[:, i] * factor, color)
        below.y.span(-reach * factor, reach * factor)
        below.y.most = 3
        for panel in (axes, below):
            panel.x.span(*section)
            panel.x.labelled = panel is below and i == 2
    alt = f"{name} between {section[0]:.1f} and {section[1]:.1f} s: measured and predicted, and their difference."
    return sheet.draw(f"section-{name.replace('.', '-')}", 930, alt)


def _line(panel: Panel, t: Floats, values: Floats, color: str, width: float = 1.3) -> None:
    """Draw a line; where it has too many points, its envelope. A wide line is a pale one."""
    if len(t) <= 2 * _FINEST:
        alpha = 0.55 if width > 2 else 1.0
        panel.line(t, values, color, width=width, alpha=alpha)
    else:
        zigzag(panel, *coarser(t, values, values, bins=_FINEST), color)


def normalised(signals: dict[str, SignalFit]) -> str:
    """Draw histograms of the residuals over their sigma, per axis, with the standard normal distribution."""
    names = list(signals)
    pitch, top = 330.0, 36.0

    sheet = Sheet()
    for k, name in enumerate(names):
        fit = signals[name]
        left = residual(fit, fit.predicted) / positive(fit.sigma)
        axes = half_panel(sheet, signal_name(name, signals), k, top=top + pitch * (k // 2), height=230)
        histograms(axes, [(left[:, i], axis) for i, axis in enumerate(AXES)], reach=5.0, sigma=1.0)
        x, y = (k % 2 + 1) * WIDTH / 2 - 14, top + pitch * (k // 2) + 280
        sheet.text("residual / σ", x=x, y=y, color="muted", align="right")
    alt = "Histograms of the residuals of the IMU, divided by their sigma, against the standard normal distribution."
    return sheet.draw("normalised", pitch * -(-len(names) // 2), alt)


def half_panel(sheet: Sheet, title: str, place: int, *, top: float, height: float, left: float = 62.0) -> Panel:
    """Return a panel of half the width of the sheet, on the left for even places and on the right for odd ones."""
    edge = (place % 2) * WIDTH / 2
    panel = sheet.panel("", top=top, height=height, left=edge + left, right=WIDTH / 2 - edge + 14)
    panel.x.most = 5
    sheet.text(title, x=edge, y=top - 18, color="ink", weight="bold")
    return panel


def histograms(
    panel: Panel, series: list[tuple[Floats, str]], *, reach: float, sigma: float = 0.0, bins: int = 60
) -> None:
    """Draw the densities of values as steps within ±reach, and that of a normal distribution of this sigma, if any."""
    edges = np.linspace(-reach, reach, bins + 1)
    top = 0.0
    for values, color in series:
        kept = finite(values)
        density = np.histogram(kept, edges)[0] / max(len(kept), 1) / (edges[1] - edges[0])
        panel.steps(density, edges, color)
        top = max(top, float(density.max()))
    if sigma > 0:
        x = np.linspace(-reach, reach, 121)
        density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        panel.line(x, density, "ink", width=1.4, dash=DASHED)
        top = max(top, float(density.max()))
    panel.x.span(-reach, reach)
    panel.y.span(0, 1.05 * positive(top))


def bias_figure(biases: dict[str, BiasTrack]) -> str:
    """Draw the biases less their means, with sigma bands, and the bounds of the random walk that was assumed."""
    pitch = 258.0
    last = list(biases)[-1]

    sheet = Sheet()
    for k, (name, track) in enumerate(biases.items()):
        middle = np.array([float(np.mean(finite(v))) if finite(v).size else 0.0 for v in track.value.T])
        deviation = track.value - middle
        walked = 3 * track.random_walk * np.sqrt(np.fmax(track.t_s, 0.0))
        reach = _bias_reach(deviation, track.sigma, walked)
        prefix, factor = prefixed(reach)
        title = f"{signal_name(name, biases)}: bias − mean [{prefix}{readable_unit(track.unit)}]"
        panel = sheet.panel(title, top=36 + pitch * k, height=206, x_label="time [s]" if name == last else "")
        for sign in (-1, 1):
            panel.line(track.t_s, sign * walked * factor, "muted", width=1.2, dash=DASHED)
        for i, axis in enumerate(AXES):
            low, high = deviation[:, i] - track.sigma[:, i], deviation[:, i] + track.sigma[:, i]
            t, low, high = coarser(track.t_s, low, high, bins=250)
            panel.band(t, low * factor, high * factor, axis, alpha=0.16)
        for i, axis in enumerate(AXES):
            t, low, high = coarser(track.t_s, deviation[:, i], deviation[:, i], bins=400)
            panel.line(t, (low + high) / 2 * factor, axis, width=1.6)
        panel.y.span(-reach * factor, reach * factor)
        panel.x.span(0, positive(highest(track.t_s)))
        panel.x.labelled = name == last
    alt = "Biases of the IMU over time, about their means, with one sigma; dashed, three sigma of the random walk."
    return sheet.draw("biases", pitch * len(biases) + 42, alt)


def _bias_reach(value: Floats, sigma: Floats, walked: Floats) -> float:
    """Return a reach that holds values and bands, and the bounds too unless they dwarf them."""
    inner = highest(np.abs(value) + np.nan_to_num(sigma))
    outer = highest(walked)
    return 1.08 * positive(min(max(inner, outer), 6 * inner) if inner else outer)
