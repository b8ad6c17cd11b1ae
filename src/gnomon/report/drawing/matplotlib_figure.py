"""The same figures on Matplotlib, for notebooks and papers, in the colours of the light page."""

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OptionError, install_line
from ...recording import Floats
from .figures import TEXT, WIDTH, Plot
from .panel import Panel, Shape, TextStyle, box_path, dot_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..page import Legend

_POINT = 0.72
"""Points of type per figure unit, of which a hundred are an inch."""
_TITLE, _LEGEND = 34.0, 34.0
"""Room for a title above and for a legend below, in figure units."""
_ENDS: dict[str, Any] = {"square": "projecting", "round": "round", "butt": "butt", "miter": "butt"}


def draw_with_matplotlib(drawings: Sequence[tuple[str, Plot, Sequence["Legend"]]]) -> "Figure":
    """Return a figure of Matplotlib with drawings below each other, each with its title and what its marks mean.

    Raises
    ------
    OptionError
        If Matplotlib is not installed.
    """
    try:
        from matplotlib import pyplot
    except ImportError:
        raise OptionError(f"plots need Matplotlib. Run: {install_line('gnomon[certificate]')}") from None
    heights = [_TITLE + drawing.height + (_LEGEND if legend else 0.0) for _, drawing, legend in drawings]
    whole = sum(heights)
    figure = pyplot.figure(figsize=(WIDTH / 100, whole / 100))
    top = 0.0
    for (title, drawing, legend), height in zip(drawings, heights, strict=True):
        _write(figure, title, TextStyle(color="ink", size=1.15 * TEXT, bold=True), (0.0, top + 0.6 * _TITLE), whole)
        for panel in drawing.panels:
            _draw_panel(figure, panel, top + _TITLE, whole)
        for text in drawing.texts:
            _write(figure, text.text, text.style, (text.x, top + _TITLE + text.y), whole)
        if legend:
            _explain(figure, legend, 1 - (top + height) / whole)
        top += height
    return figure


@cache
def page_colors() -> dict[str, str]:
    """Return the colours of the light page: name of page.css -> hexadecimal."""
    style = (Path(__file__).parents[1] / "page.css").read_text(encoding="utf-8")
    named = dict(re.findall(r"--([\w-]+):\s*([^;]+);", style[: style.index("}")]))
    return {
        name.removeprefix("plot-"): re.sub(r"var\(--([\w-]+)\)", lambda m: named[m.group(1)], value)
        for name, value in named.items()
        if name.startswith("plot-") and name != "plot-text"
    }


def _write(figure: "Figure", text: str, style: TextStyle, place: tuple[float, float], whole: float) -> None:
    """Write a text with its baseline at a place in figure units from the top-left corner."""
    figure.text(place[0] / WIDTH, 1 - place[1] / whole, text, **_type(style))


def _type(style: TextStyle) -> dict[str, Any]:
    """Return how Matplotlib writes a text."""
    return {
        "color": page_colors()[style.color], "fontsize": _POINT * style.size, "horizontalalignment": style.align,
        "verticalalignment": "baseline", "fontweight": "bold" if style.bold else "normal", "parse_math": False,
    }  # fmt: skip


def _draw_panel(figure: "Figure", panel: Panel, top: float, whole: float) -> None:
    """Draw a panel whose sheet begins at `top`, in figure units."""
    left, down, width, height = panel.box
    axes = figure.add_axes((left / WIDTH, 1 - (top + down + height) / whole, width / WIDTH, height / whole))
    axes.set_facecolor("none")
    for scale, axis, limit, change in (
        (panel.x, axes.xaxis, axes.set_xlim, axes.set_xscale), (panel.y, axes.yaxis, axes.set_ylim, axes.set_yscale),
    ):  # fmt: skip
        if scale.logarithmic:
            change("log")
        limit(scale.low, scale.high)
        ticks, labels = scale.ticks_within()
        axis.set_ticks(ticks.tolist(), labels if scale.labelled else [""] * len(labels))
        axis.set_ticks([], minor=True)
        axis.set_tick_params(length=0, labelsize=_POINT * 12, labelcolor=page_colors()["muted"])
        if scale.grid:
            axis.grid(visible=True, color=page_colors()["grid"])
    axes.set_axisbelow(True)
    axes.autoscale(False)
    for side, spine in axes.spines.items():
        spine.set_visible(side in panel.frame)
        spine.set_color(page_colors()["muted"])
    for order, shape in enumerate(panel.shapes):
        _draw_shape(axes, shape, panel.rim, order + 3)
    for text in panel.texts:
        axes.annotate(
            text.text, (text.x, text.y), (_POINT * text.offset[0], -_POINT * text.offset[1]),
            textcoords="offset points", annotation_clip=False, **_type(text.style),
        )  # fmt: skip


def _draw_shape(axes: "Axes", shape: Shape, rim: float | None, order: int) -> None:
    """Draw a shape: a line, dots, areas or rectangles."""
    from matplotlib.patches import Circle

    style, color = shape.style, page_colors()[shape.style.color]
    place = {"": axes.transData, "x": axes.get_yaxis_transform(), "y": axes.get_xaxis_transform()}[shape.shares]
    common: dict[str, Any] = {"transform": place, "alpha": style.alpha, "clip_on": shape.clip, "zorder": order}
    if shape.path is dot_path:
        artist = axes.plot(
            shape.x, shape.y, "o", color=color, markersize=_POINT * style.width, markeredgewidth=0, **common
        )[0]
    elif style.filled:
        from matplotlib.collections import PolyCollection

        outlines = _boxes(shape) if shape.path is box_path else _areas(shape)
        artist = axes.add_collection(
            PolyCollection(outlines, facecolor=color, edgecolor=color, linewidth=_POINT * style.width, **common),
            autolim=False,
        )
    else:
        dash: Any = (0, [max(part, 1e-3) for part in style.dash]) if style.dash else "solid"
        ends = "butt" if style.dash else _ENDS[style.ends]
        artist = axes.plot(
            shape.x, shape.y, color=color, linewidth=_POINT * style.width, linestyle=dash,
            solid_capstyle=ends, dash_capstyle="butt", **common,
        )[0]  # fmt: skip
    if rim is not None and shape.clip:
        artist.set_clip_path(Circle((0, 0), rim, transform=axes.transData))


def _boxes(shape: Shape) -> list[Floats]:
    """Return the corners of rectangles, (4, 2) each."""
    return [
        np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
        for x, y in zip(shape.x, shape.y, strict=True)
    ]


def _areas(shape: Shape) -> list[Floats]:
    """Return the corners of areas, (k, 2) each."""
    known = np.isfinite(shape.x) & np.isfinite(shape.y)
    ends = np.flatnonzero(np.diff(known, prepend=False, append=False)).reshape(-1, 2)
    return [np.stack([shape.x[a:b], shape.y[a:b]], axis=1) for a, b in ends.tolist()]


def _explain(figure: "Figure", legend: Sequence["Legend"], bottom: float) -> None:
    """Say below a drawing what its marks mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def mark(item: "Legend") -> Any:
        color = page_colors()[item.color]
        if item.mark == "band":
            return Patch(color=color, alpha=0.3, label=item.label)
        line: Any = {"dash": "--", "dot": "", "ring": ""}.get(item.mark, "-")
        dot = {"dot": "o", "ring": "o"}.get(item.mark, "")
        face = "none" if item.mark == "ring" else color
        return Line2D([], [], color=color, linestyle=line, marker=dot, markerfacecolor=face, label=item.label)

    figure.legend(
        handles=[mark(item) for item in legend], loc="lower center", bbox_to_anchor=(0.5, bottom),
        ncols=min(len(legend), 4), frameon=False, fontsize=_POINT * 12,
    )  # fmt: skip
