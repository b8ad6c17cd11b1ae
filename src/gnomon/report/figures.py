"""Drawing for reports: Matplotlib figures that become inline SVG in the colours and the font of the page.

Colours are drawn as placeholders and replaced by CSS variables, so that one figure serves light, dark and paper. Texts
stay texts and take the page's font; their size is multiplied by `--plot-text`, which the page raises on small screens.
"""

import io
import re
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..recording import Floats
from .numbers import finite, number, power_of_ten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

WIDTH = 760.0
"""Width of every figure in its own units; on a desktop one unit is about one pixel."""

LEFT, RIGHT = 78.0, 14.0
"""Margins for the labels of the y axis and for the last label of the x axis."""

INKS = (
    "ink", "muted", "grid", "paper", "x", "y", "z", "before", "after", "heldout", "accent",
    "t1", "t2", "t3", "t4", "t5",
)  # fmt: skip
"""Colours that page.css defines as --plot-NAME."""

_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gnomon",
    "text.parse_math": False,
    "axes.unicode_minus": True,
    "agg.path.chunksize": 0,
    "path.simplify": True,
}


def ink(name: str) -> str:
    """Return the placeholder of a colour of the page."""
    return f"#c0de{INKS.index(name):02x}"


class Sheet:
    """One figure under construction; positions are in figure units from its top-left corner."""

    def __init__(self, figure: "Figure", height: float) -> None:
        self.figure = figure
        self.height = height

    def panel(
        self, title: str, *, top: float, height: float, left: float = LEFT, right: float = RIGHT, x_label: str = ""
    ) -> "Axes":
        """Return axes with a title above, and an x label below its right end."""
        box = (left / WIDTH, 1 - (top + height) / self.height, (WIDTH - left - right) / WIDTH, height / self.height)
        axes = self.figure.add_axes(box)
        axes.patch.set_visible(False)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        axes.spines["bottom"].set(color=ink("muted"), linewidth=1)
        axes.grid(visible=True, axis="y", color=ink("grid"), linewidth=1)
        axes.set_axisbelow(True)
        axes.tick_params(length=0, labelsize=12, labelcolor=ink("muted"), pad=9)
        axes.tick_params(axis="x", pad=14)  # texts grow upwards on small screens
        axes.xaxis.set_major_formatter(_tick)
        axes.yaxis.set_major_formatter(_tick)
        axes.locator_params(axis="x", nbins=7)
        axes.locator_params(axis="y", nbins=5)
        self.text(title, x=0, y=top - 18, color="ink", weight="bold")
        if x_label:
            self.text(x_label, x=WIDTH - right, y=top + height + 50, color="muted", align="right")
        return axes

    def text(self, text: str, *, x: float, y: float, color: str, align: str = "left", weight: str = "normal") -> None:
        """Write a line of text with its baseline at y."""
        drawable = text.encode("utf-8", "backslashreplace").decode()  # bytes that were no text, shown as escapes
        self.figure.text(
            x / WIDTH, 1 - y / self.height, drawable,
            color=ink(color), ha=align, va="baseline", fontsize=12.5, fontweight=weight,
        )  # fmt: skip


def draw(name: str, height: float, alt: str, paint: Callable[[Sheet], None]) -> str:
    """Return the SVG of a figure.

    Parameters
    ----------
    name : short name, unique on the page; prefix of the ids in the SVG
    height : height in figure units
    alt : what a person who does not see the figure should know
    paint : draws on the sheet
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(), warnings.catch_warnings():
        # Texts are not drawn as outlines here, so a glyph that Matplotlib's own font lacks does no harm.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        figure = Figure(figsize=(WIDTH / 72, height / 72), dpi=72)
        figure.patch.set_visible(False)
        paint(Sheet(figure, height))
        text = io.StringIO()
        # print_svg itself, since savefig would draw everything twice.
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None, "Creator": None})
    return _inline(text.getvalue(), name, height, alt)


def zigzag(axes: "Axes", t: Floats, low: Floats, high: Floats, color: str) -> None:
    """Draw an envelope (k,) as one line that visits the minimum and the maximum of every bin; nan interrupts it."""
    pairs = np.stack([low, high], axis=1)
    pairs[1::2] = pairs[1::2, ::-1]
    axes.plot(np.repeat(t, 2), pairs.ravel(), color=ink(color), linewidth=0.9, solid_joinstyle="round")


def coarser(t: Floats, low: Floats, high: Floats, bins: int = 900) -> tuple[Floats, Floats, Floats]:
    """Return an envelope (k, ...) in at most so many bins; its extremes are kept, bins without a value are nan."""
    step = -(-len(t) // bins)
    if step <= 1:
        return t, low, high
    starts = np.arange(0, len(t), step)
    ends = np.minimum(starts + step, len(t)) - 1
    with np.errstate(invalid="ignore"):
        return (t[starts] + t[ends]) / 2, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def dots(axes: "Axes", x: Floats, y: Floats, color: str, *, size: float = 7.0, ring: bool = False) -> None:
    """Draw points as one path of round strokes, which takes a tenth of the bytes of markers; `ring` hollows them."""
    kept = np.isfinite(x) & np.isfinite(y)
    gap = np.full(int(kept.sum()), np.nan)
    xs = np.stack([x[kept], x[kept], gap], axis=1).ravel()
    ys = np.stack([y[kept], y[kept], gap], axis=1).ravel()
    for shade, width in ((color, size), ("paper", size - 3.2)) if ring else ((color, size),):
        (line,) = axes.plot(
            xs, ys, color=ink(shade), linewidth=width, solid_capstyle="round", gid="dots", clip_on=False
        )
        line.get_path().should_simplify = False


def cells(
    axes: "Axes", corners: Floats, size: tuple[float, float], *, level: Floats, color: str, clip: "Patch | None" = None
) -> None:
    """Fill rectangles, the stronger the higher their level.

    One path is drawn per level, which takes few bytes and keeps to the colours of the page; rectangles of level zero or
    nan stay empty.

    Parameters
    ----------
    corners : (n, 2) lower left corners, in data units
    size : width and height, in data units
    level : (n,) 0 to 1, shown in eight steps
    clip : shape in data units beyond which nothing is drawn
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    steps = 8
    strength = np.ceil(np.clip(np.nan_to_num(level), 0, 1) * steps).astype(int)
    outline = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * size
    codes = [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY]
    for step in range(1, steps + 1):
        chosen = corners[strength == step]
        if len(chosen):
            vertices = (chosen[:, None] + outline).reshape(-1, 2)
            path = Path(vertices, codes * len(chosen))
            patch = PathPatch(path, facecolor=ink(color), alpha=step / steps, linewidth=0, gid="cells")
            axes.add_artist(patch)  # add_patch would look for limits of the axes, corner by corner
            if clip is not None:
                clip.set_transform(axes.transData)
                patch.set_clip_path(clip)


def thinned(x: Floats, y: Floats, bins: int = 300) -> tuple[Floats, Floats]:
    """Return points (n,) such that each of so many equal groups keeps its smallest and its largest y."""
    step = -(-len(x) // bins)
    if step <= 2:
        return x, y
    kept: list[int] = []
    for start in range(0, len(x), step):
        part = y[start : start + step]
        if np.isfinite(part).any():
            kept += sorted({start + int(np.nanargmin(part)), start + int(np.nanargmax(part))})
    return x[kept], y[kept]


def log_limits(axes: "Axes", *series: Floats) -> None:
    """Make the y axis logarithmic over whole decades that hold all positive values, with a little room."""
    from matplotlib.ticker import LogLocator, NullLocator

    values = np.concatenate([finite(s) for s in series])
    values = values[values > 0]
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    bottom, top = np.floor(np.log10(low)), np.ceil(np.log10(high))
    axes.set_yscale("log")
    top = max(top, bottom + 1)
    room = 0.05 * (top - bottom)
    axes.set_ylim(10.0 ** (bottom - room), 10.0 ** (top + room))
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(_decade)


def limits(axes: "Axes", *series: Floats, symmetric: bool = False) -> None:
    """Give the y axis a little room around all finite values."""
    values = np.concatenate([finite(s) for s in series])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if symmetric:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    axes.set_ylim(low - room, high + room)


def _tick(value: float, _position: Any = None) -> str:
    return number(value, 6)


def _decade(value: float, _position: Any = None) -> str:
    return number(value, 3) if 1e-4 < value < 1e4 else power_of_ten(round(np.log10(value)))


_TAG = re.compile(r"<[^>]+>")
_PATH = re.compile(r' d="([^"]*)"')
_PLACE = re.compile(r' (x|y)="(-?\d+\.\d+)"')
_DECIMALS = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_STYLE = re.compile(r' style="([^"]*)"')
_INK = re.compile(r"#c0de([0-9a-f]{2})")
_REFERENCE = re.compile(r'(href="|url\()#([^")]+)')


def _inline(svg: str, name: str, height: float, alt: str) -> str:
    """Turn a file of Matplotlib into an element of the page: small, themed, with ids of its own."""
    from markupsafe import escape

    body = svg[svg.index("<svg") : svg.rindex("</svg>")]
    body = body[body.index(">") + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>|<defs>\s*<style.*?</style>\s*</defs>", "", body, count=2, flags=re.DOTALL)
    # Angle brackets in texts are escaped, so that every match is a tag and no text is touched.
    used = {found[1] for tag in _TAG.findall(body) for found in _REFERENCE.findall(tag)}
    body = _TAG.sub(lambda m: _tag(m[0], name, used), body)
    # Dots keep their size on the screen when a figure is zoomed, so that neighbours come apart.
    body = re.sub(r'(class="dots">\s*<path [^>]*?stroke-width: )([\d.]+)', r"\1calc(\2px / var(--plot-zoom, 1))", body)
    body = re.sub(r">\s+<", "><", body.strip())
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{escape(alt)}" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">{body}</svg>'
    )


def _tag(tag: str, name: str, used: set[str]) -> str:
    """Return a tag with the page's colours and fonts, and with ids that belong to this figure or none."""
    tag = re.sub(r' id="(dots|fine|cells)"', r' class="\1"', tag)
    tag = re.sub(r' id="([^"]*)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", tag)
    tag = _REFERENCE.sub(rf"\1#{name}-\2", tag)
    tag = _PATH.sub(lambda m: f' d="{_short_path(m[1])}"', tag)
    tag = _PLACE.sub(lambda m: f' {m[1]}="{_short(m[2])}"', tag)
    if tag.startswith("<text"):
        tag = _STYLE.sub(lambda m: f' style="{_text_style(m[1])}"', tag)
        tag = re.sub(r' transform="rotate\(-?0 [^)]*\)"', "", tag)
    return _INK.sub(lambda m: f"var(--plot-{INKS[int(m[1], 16)]})", tag)


def _short(text: str) -> str:
    return f"{float(text):.2f}".rstrip("0").rstrip(".")


def _short_path(path: str) -> str:
    """Return a path with two decimals, and without the L that a line command implies."""
    path = _DECIMALS.sub(lambda m: _short(m[0]), path)
    commands = [line.strip() for line in path.splitlines()]
    parts = [
        command[2:] if command.startswith("L ") and i and commands[i - 1].startswith("L ") else command
        for i, command in enumerate(commands)
    ]
    return " ".join(part for part in parts if part)


def _text_style(style: str) -> str:
    """Return the style of a text with the page's font; its size becomes a variable."""
    size = re.search(r"([\d.]+)px", style)
    kept = [part.strip() for part in style.split(";") if part.strip().startswith(("text-anchor", "fill"))]
    weight = ["font-weight: 600"] if re.search(r"font(-weight)?: (bold|700)", style) else []
    return "; ".join([f"--size: {size[1] if size else '12'}px", *kept, *weight])
