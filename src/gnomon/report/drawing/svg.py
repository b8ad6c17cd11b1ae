"""Pieces of SVG: paths with two decimals, their styles in the colours of the page, and texts."""

from typing import Literal

import numpy as np

from ...frozen import value_class
from ...recording import Floats

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
