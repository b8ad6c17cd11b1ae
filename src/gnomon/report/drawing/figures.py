"""Drawing for reports: figures of panels, which become inline SVG in the colours and the font of the page.

Colours are CSS variables, so that one figure serves light, dark and paper. Texts take the page's font; their size is
multiplied by `--plot-text`, which the page raises on small screens. (A drawing library took as long for the figures of
one report as the calibration itself: 0.8 s to load, 0.15 s a figure; this takes 0.01 s a figure.)
"""

from collections.abc import Sequence

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ..numbers import finite_values, positive_or
from .panel import DASHED, Align, Panel, TextStyle, text_element

AXES = ("x", "y", "z")
WIDTH = 760.0
"""Width of every figure in its own units; on a desktop one unit is about one pixel."""
LEFT, RIGHT = 78.0, 14.0
"""Margins for the labels of the y axis and for the last label of the x axis."""
TEXT = 12.5
"""Size of titles and names in figure units."""


@value_class(eq=True, kw_only=False)
class SheetText:
    """A line of text beside the panels, with its baseline at y, in figure units."""

    text: str
    x: float
    y: float
    style: TextStyle


@value_class(kw_only=False)
class Plot:
    """A finished figure, which becomes SVG for a page, or is drawn by Matplotlib.

    Attributes
    ----------
    name : short name, unique on the page; prefix of the ids in the SVG
    height : in figure units
    alt : what a person who does not see the figure should know
    panels, texts : what is drawn
    """

    name: str
    height: float
    alt: str
    panels: Sequence[Panel]
    texts: Sequence[SheetText]

    @property
    def svg(self) -> str:
        """The figure as an SVG element in the colours of the page."""
        from markupsafe import escape

        frame = f'viewBox="0 0 {WIDTH:g} {self.height:g}" role="img" aria-label="{escape(self.alt)}"'
        panels = [panel.svg(f"{self.name}-{i}") for i, panel in enumerate(self.panels)]
        texts = [text_element(text.text, text.x, text.y, text.style) for text in self.texts]
        return f'<svg class="plot" {frame}>{"".join([*panels, *texts])}</svg>'


class Sheet:
    """One figure under construction; positions are in figure units from its top-left corner."""

    def __init__(self) -> None:
        self.panels: list[Panel] = []
        self._texts: list[SheetText] = []

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

    def text(self, text: str, *, x: float, y: float, color: str, align: Align = "left", weight: str = "normal") -> None:
        """Write a line of text with its baseline at y."""
        if text:
            style = TextStyle(color=color, size=TEXT, align=align, bold=weight == "bold")
            self._texts.append(SheetText(text, x, y, style))

    def draw(self, name: str, height: float, alt: str) -> Plot:
        """Return the finished figure; the parameters are those of `Plot`."""
        return Plot(name, height, alt, tuple(self.panels), tuple(self._texts))


def draw_envelope(panel: Panel, t: Floats, low: Floats, high: Floats, color: str) -> None:
    """Draw an envelope (k,) as one line that visits the minimum and the maximum of every bin; nan interrupts it."""
    pairs = np.stack([low, high], axis=1)
    pairs[1::2] = pairs[1::2, ::-1]
    panel.line(np.repeat(t, 2), pairs.ravel(), color, width=0.9)


def coarsen_envelope(t: Floats, low: Floats, high: Floats, bins: int = 900) -> tuple[Floats, Floats, Floats]:
    """Return an envelope (k, ...) in at most so many bins; its extremes are kept, bins without a value are nan."""
    step = -(-len(t) // bins)
    if step <= 1:
        return t, low, high
    starts = np.arange(0, len(t), step)
    ends = np.minimum(starts + step, len(t)) - 1
    with np.errstate(invalid="ignore"):
        return (t[starts] + t[ends]) / 2, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def draw_dots(panel: Panel, x: Floats, y: Floats, color: str, *, size: float = 7.0, ring: bool = False) -> None:
    """Draw points; `ring` hollows them."""
    panel.dots(x, y, color, size)
    if ring:
        panel.dots(x, y, "paper", size - 3.2)


def thin_points(x: Floats, y: Floats, bins: int = 300) -> tuple[Floats, Floats]:
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
    values = np.concatenate([finite_values(s) for s in series])
    values = values[values > 0]
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    bottom, top = np.floor(np.log10(low)), np.ceil(np.log10(high))
    top = max(top, bottom + 1)
    room = 0.05 * (top - bottom)
    panel.y.logarithmic = True
    panel.y.span(10.0 ** (bottom - room), 10.0 ** (top + room))


def set_y_limits(panel: Panel, *series: Floats, symmetric: bool = False) -> None:
    """Give the y axis a little room around all finite values."""
    values = np.concatenate([finite_values(s) for s in series])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if symmetric:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    panel.y.span(low - room, high + room)


def count_along(panel: Panel, count: int) -> None:
    """Let the x scale count from one."""
    panel.x.span(0.4, max(count, 1) + 0.6)
    panel.x.most, panel.x.whole = 8, True


SPHERE_HEIGHT = 390.0
"""Height of a figure of two hemispheres in figure units."""


def hemisphere_panel(sheet: Sheet, side: float) -> Panel:
    """Return the panel of the upper (side +1, left) or lower (side -1, right) hemisphere of `lambert_projection`."""
    size, margin, top = 296.0, 42.0, 62.0
    left = 0.0 if side > 0 else WIDTH / 2
    panel = sheet.bare_panel(left=left + margin, top=top, width=size, height=size)
    panel.x.span(-1.43, 1.43)
    panel.y.span(-1.43, 1.43)
    turn = np.linspace(0, 2 * np.pi, 91)
    for polar_deg, color in ((30, "grid"), (60, "grid"), (90, "muted")):
        radius = 2 * np.sin(np.radians(polar_deg) / 2)
        panel.line(radius * np.cos(turn), radius * np.sin(turn), color, clip=False)
    for x, y in ((np.sqrt(2), 0), (0, np.sqrt(2))):
        panel.line(np.array([-x, x]), np.array([-y, y]), "grid")
    centre, y_up = left + margin + size / 2, "+y" if side > 0 else "−y"
    y_down = "−y" if side > 0 else "+y"
    middle = top + size / 2 + 4
    for text, x, y in ((y_up, centre, top - 5), (y_down, centre, top + size + 20)):
        sheet.text(text, x=x, y=y, color="muted", align="center")
    sheet.text("−x", x=left + margin - 5, y=middle, color="muted", align="right")
    sheet.text("+x", x=left + margin + size + 5, y=middle, color="muted")
    sheet.text("Above (z up)" if side > 0 else "Below (z down)", x=left, y=20, color="ink", weight="bold")
    return panel


def lambert_projection(directions: Floats, side: float) -> Floats:
    """Project unit vectors (n, 3) of one hemisphere, seen from outside, to the plane (n, 2); its rim is at √2."""
    with np.errstate(invalid="ignore"):
        stretch = np.sqrt(2 / (1 + np.clip(side * directions[:, 2], 0, 1)))
    return np.stack([directions[:, 0] * stretch, side * directions[:, 1] * stretch], axis=1)


def half_panel(sheet: Sheet, title: str, place: int, *, top: float, height: float, left: float = 62.0) -> Panel:
    """Return a panel of half the width of the sheet, on the left for even places and on the right for odd ones."""
    edge = (place % 2) * WIDTH / 2
    panel = sheet.panel("", top=top, height=height, left=edge + left, right=WIDTH / 2 - edge + 14)
    panel.x.most = 5
    sheet.text(title, x=edge, y=top - 18, color="ink", weight="bold")
    return panel


def draw_histograms(
    panel: Panel, series: list[tuple[Floats, str]], *, reach: float, sigma: float = 0.0, bins: int = 60
) -> None:
    """Draw the densities of values as steps within ±reach, and that of a normal distribution of this sigma, if any."""
    edges = np.linspace(-reach, reach, bins + 1)
    top = 0.0
    for values, color in series:
        kept = finite_values(values)
        density = np.histogram(kept, edges)[0] / max(len(kept), 1) / (edges[1] - edges[0])
        panel.steps(density, edges, color)
        top = max(top, float(density.max()))
    if sigma > 0:
        x = np.linspace(-reach, reach, 121)
        density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        panel.line(x, density, "ink", width=1.4, dash=DASHED)
        top = max(top, float(density.max()))
    panel.x.span(-reach, reach)
    panel.y.span(0, 1.05 * positive_or(top))
