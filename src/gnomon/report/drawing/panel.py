"""One panel of a figure: lines, areas, dots and texts between two scales, and the pieces of SVG that they become."""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ..numbers import Scale

Align = Literal["left", "center", "right"]
_FAR = 99_999.0
"""Nothing is drawn farther out than this [figure units], where no screen shows it."""
MIDDLE = 0.26
"""Height of the middle of a line of text above its baseline, in sizes of the font."""


def color_variable(name: str) -> str:
    """Return a colour that page.css defines as --plot-NAME, so that one figure serves light, dark and paper."""
    return f"var(--plot-{name})"


def short_number(value: float) -> str:
    """Return a number of figure units with two decimals at most."""
    return f"{round(value, 2) + 0.0:.7g}"


def line_path(x: Floats, y: Floats) -> str:
    """Return the path through places (n,); nan interrupts it."""
    text, places = _pieces(x, y, "M")
    return text % places


def area_path(x: Floats, y: Floats) -> str:
    """Return the path around areas, whose corners (n,) are separated by nan."""
    text, places = _pieces(x, y, "zM")
    return f"{text[1:]}z" % places if text else ""


def _pieces(x: Floats, y: Floats, move: str) -> tuple[str, tuple[float, ...]]:
    """Return the format of a path, in which `move` begins each piece, and its numbers."""
    known = np.isfinite(x) & np.isfinite(y)
    begins = np.flatnonzero((known & ~np.concatenate([[False], known[:-1]]))[known])
    lengths = np.diff(begins, append=np.count_nonzero(known))
    text = "".join([f"{move}%.7g %.7g{' %.7g %.7g' * (length - 1)}" for length in lengths.tolist()])
    return text, _rounded(x[known], y[known])


def dot_path(x: Floats, y: Floats) -> str:
    """Return a path of lines of no length at places (n,), which round ends show as dots."""
    known = np.isfinite(x) & np.isfinite(y)
    return "M%.7g %.7gh0" * int(known.sum()) % _rounded(x[known], y[known])


def box_path(x: Floats, y: Floats) -> str:
    """Return the path around upright rectangles, whose two edges along x and along y are given, (n, 2)."""
    return "M%.7g %.7gH%.7gV%.7gH%.7gz" * len(x) % _rounded(x[:, 0], y[:, 0], x[:, 1], y[:, 1], x[:, 0])


def _rounded(*columns: Floats) -> tuple[float, ...]:
    """Return the numbers of columns (n,), row by row."""
    places = np.round(np.clip(np.stack(columns, axis=1), -_FAR, _FAR), 2) + 0.0  # no minus zero
    return tuple(places.ravel().tolist())


@value_class(eq=True)
class ShapeStyle:
    """How a shape is drawn: its outline, and whether it is filled.

    Attributes
    ----------
    color : page.css defines it as --plot-NAME
    width : of the line in figure units; 0 for none
    dash : lengths of dashes and gaps, in widths of the line
    alpha : opacity of the line, or of the area
    ends : of lines; "miter" for steps with sharp corners
    filled : whether it is an area
    """

    color: str
    width: float = 1.0
    dash: tuple[float, ...] = ()
    alpha: float = 1.0
    ends: Literal["square", "round", "butt", "miter"] = "square"
    filled: bool = False

    def css(self) -> str:
        """Return it for an element of SVG; dashes end where they end."""
        color, opacity = color_variable(self.color), f"opacity:{self.alpha:g}"
        if self.filled:
            style = f"fill:{color}" + (f";fill-{opacity}" if self.alpha < 1 else "")
            return style + (f";stroke:{color};stroke-width:{self.width:g}" if self.width else "")
        style = f"fill:none;stroke:{color}"
        style += "" if self.width == 1 else f";stroke-width:{self.width:g}"
        style += f";stroke-{opacity}" if self.alpha < 1 else ""
        if self.dash:
            return f"{style};stroke-dasharray:{' '.join(short_number(self.width * part) for part in self.dash)}"
        if self.ends == "miter":
            return f"{style};stroke-linejoin:miter"
        return style if self.ends == "butt" else f"{style};stroke-linecap:{self.ends}"


def dot_css(style: ShapeStyle) -> str:
    """Return the style of dots; they keep their size on the screen when a figure is zoomed, so that they come apart."""
    return (
        f"fill:none;stroke:{color_variable(style.color)};stroke-width:calc({style.width:g}px / var(--plot-zoom, 1));"
        "stroke-linecap:round"
    )


@value_class(eq=True)
class TextStyle:
    """How a text is written: colour of page.css, size in figure units, and which part of it stands at its place."""

    color: str
    size: float
    align: Align = "left"
    bold: bool = False

    def css(self) -> str:
        """Return it for an element of SVG; page.css multiplies its size by --plot-text, raised on small screens."""
        anchor = {"left": "", "center": ";text-anchor:middle", "right": ";text-anchor:end"}[self.align]
        weight = ";font-weight:600" if self.bold else ""
        return f"--size:{self.size:g}px{anchor};fill:{color_variable(self.color)}{weight}"


def text_element(
    text: str, x: float, y: float, style: TextStyle | None = None, *, shift: tuple[float, float] = (0.0, 0.0)
) -> str:
    """Return a line of text with its baseline at y; without a style it has that of its group.

    A shift, in heights of the letters, grows with them.
    """
    from markupsafe import escape

    drawable = text.encode("utf-8", "backslashreplace").decode()  # bytes that were no text, shown as escapes
    styled = f' style="{style.css()}"' if style else ""
    moved = f' dx="{shift[0]:.3g}em" dy="{shift[1]:.3g}em"' if any(shift) else ""
    return f'<text{styled} x="{short_number(x)}" y="{short_number(y)}"{moved}>{escape(drawable)}</text>'


DASHED = (4.0, 3.0)
"""Lengths of dashes and gaps, in widths of the line."""
_LABEL = 12.0
"""Size of the labels of ticks."""
_BELOW, _ASIDE, _LOWER = 23.12, 9.0, 4.56
"""Labels have their baseline so far below the panel, where texts grow upwards on small screens, or end so far beside it
with their baseline so far below the tick."""


@value_class
class Shape:
    """A path to be drawn when the limits of the scales are known.

    Attributes
    ----------
    x, y : its points, as `path` takes their places; numbers of the scales
    path : makes it of places
    style : its style
    shares : "x" or "y" where these are shares of the panel instead
    group : class of the element around it, for page.css
    clip : whether it ends at the edges of the panel
    depth : of its points towards the reader in a view of space, in units of the x scale
    """

    x: Floats
    y: Floats
    path: Callable[[Floats, Floats], str]
    style: ShapeStyle
    shares: Literal["", "x", "y"] = ""
    group: str = ""
    clip: bool = True
    depth: Floats | None = None


@value_class(eq=True)
class PanelText:
    """A line of text with its baseline at (x, y) of the scales, moved right and down by figure units.

    `depth` is that of the point it stands at in a view of space; small screens hide `fine` texts.
    """

    text: str
    x: float
    y: float
    style: TextStyle
    offset: tuple[float, float]
    fine: bool
    depth: float | None


class Panel:
    """A rectangle with an x and a y scale, in figure units from the top-left corner of the figure.

    What is drawn in it is given in numbers of the scales, whose limits may be set later. Areas lie below lines, and
    both in the order in which they are drawn.

    Attributes
    ----------
    x, y : the scales
    frame : edges that are drawn
    rim : radius about the point (0, 0) beyond which nothing is drawn, for a scale of equal steps; None for no rim
    middle_depth : depth about which a view of space is turned; None where the panel shows no space
    box : left, top, width and height
    texts : what is written in it
    """

    def __init__(self, left: float, top: float, width: float, height: float) -> None:
        self.x = Scale(left, width, 7)
        self.y = Scale(top + height, -height, 5)
        self.y.grid = True
        self.frame: Sequence[Literal["left", "right", "top", "bottom"]] = ("bottom",)
        self.rim: float | None = None
        self.middle_depth: float | None = None
        self.box = (left, top, width, height)
        self._left, self._top, self._width, self._height = self.box
        self._areas: list[Shape] = []
        self._lines: list[Shape] = []
        self.texts: list[PanelText] = []

    def line(
        self,
        x: Floats,
        y: Floats,
        color: str,
        *,
        width: float = 1.0,
        dash: Sequence[float] = (),
        alpha: float = 1.0,
        ends: Literal["square", "round"] = "square",
        clip: bool = True,
        depth: Floats | None = None,
    ) -> None:
        """Draw a line through points (n,); nan interrupts it. `depth` (n,) lets a reader turn it in space."""
        style = ShapeStyle(color=color, width=width, dash=tuple(dash), alpha=alpha, ends=ends)
        self._lines.append(Shape(x=x, y=y, path=line_path, style=style, clip=clip, depth=depth))

    def across(self, value: float, color: str, *, width: float = 1.0, dash: Sequence[float] = ()) -> None:
        """Draw a line from the left edge to the right one at a number of the y scale."""
        style = ShapeStyle(color=color, width=width, dash=tuple(dash))
        ends = np.array([0.0, 1.0])
        self._lines.append(Shape(x=ends, y=np.full(2, value), path=line_path, style=style, shares="x"))

    def upright(self, value: float, color: str, *, width: float = 1.0, dash: Sequence[float] = ()) -> None:
        """Draw a line from the bottom to the top at a number of the x scale."""
        style = ShapeStyle(color=color, width=width, dash=tuple(dash))
        ends = np.array([0.0, 1.0])
        self._lines.append(Shape(x=np.full(2, value), y=ends, path=line_path, style=style, shares="y"))

    def shade(self, start: Floats, stop: Floats, color: str, *, alpha: float) -> None:
        """Fill from the bottom to the top between numbers (n,) of the x scale."""
        if len(start):
            x, y = np.stack([start, stop], axis=1), np.tile([0.0, 1.0], (len(start), 1))
            style = ShapeStyle(color=color, width=0.0, alpha=alpha, filled=True)
            self._areas.append(Shape(x=x, y=y, path=box_path, style=style, shares="y"))

    def steps(self, height: Floats, edges: Floats, color: str) -> None:
        """Draw heights (n,) between edges (n + 1,)."""
        style = ShapeStyle(color=color, width=1.5, ends="miter")
        x, y = np.repeat(edges, 2)[1:-1], np.repeat(height, 2)
        self._areas.append(Shape(x=x, y=y, path=line_path, style=style))

    def dots(self, x: Floats, y: Floats, color: str, size: float, *, depth: Floats | None = None) -> None:
        """Draw points (n,) as one path of round strokes, which takes a tenth of the bytes of markers."""
        style = ShapeStyle(color=color, width=size)
        self._lines.append(Shape(x=x, y=y, path=dot_path, style=style, group="dots", clip=False, depth=depth))

    def strip(self, low: float, high: float, color: str, *, alpha: float) -> None:
        """Fill between two numbers of the y scale, from the left edge to the right one."""
        x, y, style = (
            np.array([[0.0, 1.0]]),
            np.array([[low, high]]),
            ShapeStyle(color=color, width=0.0, alpha=alpha, filled=True),
        )
        self._areas.append(Shape(x=x, y=y, path=box_path, style=style, shares="x"))

    def band(self, x: Floats, low: Floats, high: Floats, color: str, *, alpha: float = 1.0, edge: float = 0.0) -> None:
        """Fill between two lines (n,), wherever both are known; `edge` is the width of the outline."""
        known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        ends = np.flatnonzero(np.diff(known, prepend=False, append=False)).reshape(-1, 2)
        pieces = [
            np.stack([np.concatenate([x[a:b], x[a:b][::-1]]), np.concatenate([low[a:b], high[a:b][::-1]])])
            for a, b in ends.tolist()
        ]
        gap = np.full((2, 1), np.nan)
        outline = np.concatenate([part for piece in pieces for part in (piece, gap)], axis=1) if pieces else gap
        style = ShapeStyle(color=color, width=edge, alpha=alpha, filled=True)
        self._areas.append(Shape(x=outline[0], y=outline[1], path=area_path, style=style))

    def cells(self, corners: Floats, size: tuple[float, float], *, level: Floats, color: str) -> None:
        """Fill rectangles, the stronger the higher their level; those of level zero or nan stay empty.

        One path is drawn per level, which takes few bytes and keeps to the colours of the page.

        Parameters
        ----------
        corners : (n, 2) corners with the smallest numbers
        size : width and height
        level : (n,) 0 to 1, shown in eight steps
        color : at level one
        """
        steps = 8
        strength = np.ceil(np.clip(np.nan_to_num(level), 0, 1) * steps).astype(int)
        for step in range(1, steps + 1):
            chosen = corners[strength == step]
            if len(chosen):
                x, y = (np.stack([chosen[:, i], chosen[:, i] + size[i]], axis=1) for i in range(2))
                style = ShapeStyle(color=color, width=0.0, alpha=step / steps, filled=True)
                self._areas.append(Shape(x=x, y=y, path=box_path, style=style, group="cells"))

    def text(
        self,
        text: str,
        x: float,
        y: float,
        style: TextStyle,
        *,
        offset: tuple[float, float] = (0.0, 0.0),
        fine: bool = False,
        depth: float | None = None,
    ) -> None:
        """Write a line of text with its baseline at a point, moved by figure units; small screens hide `fine` ones."""
        self.texts.append(PanelText(text=text, x=x, y=y, style=style, offset=offset, fine=fine, depth=depth))

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """What is drawn in it, from below to above."""
        return *self._areas, *self._lines

    def svg(self, name: str) -> str:
        """Return all of it as an SVG element; `name` is unique on the page."""
        parts = [
            f'<g{self._numbers()}><clipPath id="{name}">{self._clip()}</clipPath>',
            self._grid(),
            *(self._drawn(shape, name) for shape in self.shapes),
            self._frame(),
            *self._labels(),
        ]
        return "".join([*parts, *map(self._written, self.texts), "</g>"])

    def _written(self, text: PanelText) -> str:
        """Return a text as an element; one of space keeps the point that it belongs to."""
        at = float(self.x.places(np.array(text.x))), float(self.y.places(np.array(text.y)))
        if text.depth is None:
            element = text_element(text.text, at[0] + text.offset[0], at[1] + text.offset[1], text.style)
        else:
            shift = text.offset[0] / text.style.size, text.offset[1] / text.style.size
            element = text_element(text.text, *at, text.style, shift=shift)
            place = " ".join(map(short_number, (*at, float(self._depth(np.array(text.depth))))))
            element = f'<g data-place="{place}">{element}</g>'
        return f'<g class="fine">{element}</g>' if text.fine else element

    def _depth(self, depth: Floats) -> Floats:
        """Return depths (n,) about the middle in figure units."""
        unit = float(self.x.places(np.ones(())) - self.x.places(np.zeros(())))
        return (depth - (self.middle_depth or 0.0)) * unit

    def _depths(self, shape: Shape) -> str:
        """Return the depths of the points that are drawn."""
        depth = np.zeros(0) if shape.depth is None else shape.depth
        return " ".join(map(short_number, self._depth(depth[np.isfinite(shape.x) & np.isfinite(shape.y)]).tolist()))

    def _numbers(self) -> str:
        """Return the attribute that tells page.js which numbers places stand for: box, then low, high, log, known."""
        if self.middle_depth is not None:
            return f' data-space="{self._left + self._width / 2:g} {self._top + self._height / 2:g}"'
        if self.rim is not None:
            return ""
        ends = [(s.low, s.high, s.logarithmic, s.labelled and bool(s.marks())) for s in (self.x, self.y)]
        numbers = f' data-panel="{" ".join(f"{value:.9g}" for value in (*self.box, *ends[0], *ends[1]))}"'
        return f"{numbers} data-time" if self.x.timed else numbers

    def _clip(self) -> str:
        if self.rim is None:
            return '<rect x="{}" y="{}" width="{}" height="{}"/>'.format(*map(short_number, self.box))
        x, y = (float(scale.places(np.zeros(()))) for scale in (self.x, self.y))
        reach = float(self.x.places(np.array(self.rim))) - x
        return f'<circle cx="{short_number(x)}" cy="{short_number(y)}" r="{short_number(reach)}"/>'

    def _drawn(self, shape: Shape, name: str) -> str:
        x, y = (
            scale.shares(values) if shape.shares == direction else scale.places(values)
            for scale, values, direction in ((self.x, shape.x, "x"), (self.y, shape.y, "y"))
        )
        path = shape.path(x, y)
        if not path:
            return ""
        style = dot_css(shape.style) if shape.path is dot_path else shape.style.css()
        clip = f' clip-path="url(#{name})"' if shape.clip else ""
        depth = "" if shape.depth is None else f' data-depth="{self._depths(shape)}"'
        element = f'<path d="{path}"{clip}{depth} style="{style}"/>'
        return f'<g class="{shape.group}">{element}</g>' if shape.group else element

    def _grid(self) -> str:
        left, right, top, bottom = self._edges()
        lines = [f"M{short_number(x)} {bottom}V{top}" for x, _ in self.x.marks()] if self.x.grid else []
        lines += [f"M{left} {short_number(y)}H{right}" for y, _ in self.y.marks()] if self.y.grid else []
        return f'<path d="{"".join(lines)}" style="{ShapeStyle(color="grid", ends="butt").css()}"/>' if lines else ""

    def _edges(self) -> tuple[str, str, str, str]:
        """Return left, right, top and bottom."""
        edges = (self._left, self._left + self._width, self._top, self._top + self._height)
        left, right, top, bottom = map(short_number, edges)
        return left, right, top, bottom

    def _frame(self) -> str:
        left, right, top, bottom = self._edges()
        sides = {"left": f"M{left} {bottom}V{top}", "right": f"M{right} {bottom}V{top}",
                 "bottom": f"M{left} {bottom}H{right}", "top": f"M{left} {top}H{right}"}  # fmt: skip
        path = "".join(sides[side] for side in self.frame)
        return f'<path d="{path}" style="{ShapeStyle(color="muted").css()}"/>' if path else ""

    def _labels(self) -> list[str]:
        """Return the labels of both scales."""
        groups: list[str] = []
        aligned: tuple[tuple[Scale, Align], ...] = ((self.x, "center"), (self.y, "right"))
        below, aside = self._top + self._height + _BELOW, self._left - _ASIDE
        for scale, align in aligned:
            if scale.labelled and (marks := scale.marks()):
                texts = [
                    text_element(label, *((place, below) if scale is self.x else (aside, place + _LOWER)))
                    for place, label in marks
                ]
                style = TextStyle(color="muted", size=_LABEL, align=align).css()
                groups.append(f'<g style="{style}">{"".join(texts)}</g>')
        return groups
