"""Drawing for reports: figures of panels, which become inline SVG in the colours and the font of the page.

Colours are CSS variables, so that one figure serves light, dark and paper. Texts take the page's font; their size is
multiplied by `--plot-text`, which the page raises on small screens. (A drawing library took as long for the figures of
one report as the calibration itself: 0.8 s to load, 0.15 s a figure; this takes 0.01 s a figure.)
"""

import numpy as np

from ..recording import Floats
from . import svg
from .numbers import finite
from .panel import Panel

WIDTH = 760.0
"""Width of every figure in its own units; on a desktop one unit is about one pixel."""

LEFT, RIGHT = 78.0, 14.0
"""Margins for the labels of the y axis and for the last label of the x axis."""

TEXT = 12.5
"""Size of titles and names in figure units."""


class Sheet:
    """One figure under construction; positions are in figure units from its top-left corner."""

    def __init__(self) -> None:
        self.panels: list[Panel] = []
        self._texts: list[str] = []

    def panel(
        self, title: str, *, top: float, height: float, left: float = LEFT, right: float = RIGHT, x_label: str = ""
    ) -> Panel:
        """Return a panel with a title above, and an x label below its right end."""
        panel = Panel(left, top, WIDTH - left - right, height)
        self.panels.append(panel)
        self.text(title, x=0, y=top - 18, color="ink", weight="bold")
        if x_label:
            self.text(x_label, x=WIDTH - right, y=top + height + 50, color="muted", align="right")
        return panel

    def bare_panel(self, *, left: float, top: float, width: float, height: float) -> Panel:
        """Return a panel without ticks and edges."""
        panel = Panel(left, top, width, height)
        panel.x.ticks, panel.y.ticks, panel.frame = (), (), ()
        self.panels.append(panel)
        return panel

    def text(self, text: str, *, x: float, y: float, color: str, align: str = "left", weight: str = "normal") -> None:
        """Write a line of text with its baseline at y."""
        if text:
            self._texts.append(svg.text_element(text, x, y, svg.text_style(color, TEXT, align, bold=weight == "bold")))

    def draw(self, name: str, height: float, alt: str) -> str:
        """Return the SVG of the figure.

        Parameters
        ----------
        name : short name, unique on the page; prefix of the ids in the SVG
        height : height in figure units
        alt : what a person who does not see the figure should know
        """
        from markupsafe import escape

        frame = f'viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{escape(alt)}"'
        panels = (panel.svg(f"{name}-{i}") for i, panel in enumerate(self.panels))
        return f'<svg class="plot" {frame}>{"".join([*panels, *self._texts])}</svg>'


def zigzag(panel: Panel, t: Floats, low: Floats, high: Floats, color: str) -> None:
    """Draw an envelope (k,) as one line that visits the minimum and the maximum of every bin; nan interrupts it."""
    pairs = np.stack([low, high], axis=1)
    pairs[1::2] = pairs[1::2, ::-1]
    panel.line(np.repeat(t, 2), pairs.ravel(), color, width=0.9)


def coarser(t: Floats, low: Floats, high: Floats, bins: int = 900) -> tuple[Floats, Floats, Floats]:
    """Return an envelope (k, ...) in at most so many bins; its extremes are kept, bins without a value are nan."""
    step = -(-len(t) // bins)
    if step <= 1:
        return t, low, high
    starts = np.arange(0, len(t), step)
    ends = np.minimum(starts + step, len(t)) - 1
    with np.errstate(invalid="ignore"):
        return (t[starts] + t[ends]) / 2, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def dots(panel: Panel, x: Floats, y: Floats, color: str, *, size: float = 7.0, ring: bool = False) -> None:
    """Draw points; `ring` hollows them."""
    panel.dots(x, y, color, size)
    if ring:
        panel.dots(x, y, "paper", size - 3.2)


def thinned(x: Floats, y: Floats, bins: int = 300) -> tuple[Floats, Floats]:
    """Return points (n,) such that each of so many equal groups keeps its smallest and its largest y."""
    step = -(-len(x) // bins)
    if step <= 2:
        return x, y
    groups = np.concatenate([y, np.full(-len(y) % step, np.nan)]).reshape(-1, step)
    known = np.isfinite(groups)
    low, high = np.where(known, groups, np.inf).argmin(axis=1), np.where(known, groups, -np.inf).argmax(axis=1)
    first = np.arange(0, len(y), step)
    kept = np.unique(np.stack([first + low, first + high])[:, known.any(axis=1)])
    return x[kept], y[kept]


def log_limits(panel: Panel, *series: Floats) -> None:
    """Make the y scale logarithmic over whole decades that hold all positive values, with a little room."""
    values = np.concatenate([finite(s) for s in series])
    values = values[values > 0]
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    bottom, top = np.floor(np.log10(low)), np.ceil(np.log10(high))
    top = max(top, bottom + 1)
    room = 0.05 * (top - bottom)
    panel.y.logarithmic = True
    panel.y.span(10.0 ** (bottom - room), 10.0 ** (top + room))


def limits(panel: Panel, *series: Floats, symmetric: bool = False) -> None:
    """Give the y axis a little room around all finite values."""
    values = np.concatenate([finite(s) for s in series])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if symmetric:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    panel.y.span(low - room, high + room)
