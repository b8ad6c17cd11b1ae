"""Pieces of SVG: paths with two decimals, their styles in the colours of the page, and texts."""

from collections.abc import Sequence

import numpy as np

from ...recording import Floats

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


def stroke_style(
    color: str, width: float, *, dash: Sequence[float] = (), alpha: float = 1.0, ends: str = "square"
) -> str:
    """Return the style of a line; dashes and gaps are in widths of the line, and dashes end where they end."""
    style = f"fill:none;stroke:{color_variable(color)}"
    style += "" if width == 1 else f";stroke-width:{width:g}"
    style += f";stroke-opacity:{alpha:g}" if alpha < 1 else ""
    if dash:
        return f"{style};stroke-dasharray:{' '.join(short_number(width * part) for part in dash)}"
    return style if ends == "butt" else f"{style};stroke-linecap:{ends}"


def dot_stroke(color: str, size: float) -> str:
    """Return the style of dots; they keep their size on the screen when a figure is zoomed, so that they come apart."""
    return (
        f"fill:none;stroke:{color_variable(color)};stroke-width:calc({size:g}px / var(--plot-zoom, 1));"
        "stroke-linecap:round"
    )


def fill_style(color: str, *, alpha: float = 1.0, edge: float = 0.0) -> str:
    """Return the style of an area, with an outline of this width in its colour."""
    style = f"fill:{color_variable(color)}" + (f";fill-opacity:{alpha:g}" if alpha < 1 else "")
    return style + (f";stroke:{color_variable(color)};stroke-width:{edge:g}" if edge else "")


def text_style(color: str, size: float, align: str, *, bold: bool = False) -> str:
    """Return the style of a text; page.css multiplies its size by --plot-text, which it raises on small screens."""
    anchor = {"left": "", "center": ";text-anchor:middle", "right": ";text-anchor:end"}[align]
    return f"--size:{size:g}px{anchor};fill:{color_variable(color)}{';font-weight:600' if bold else ''}"


def text_element(text: str, x: float, y: float, style: str = "") -> str:
    """Return a line of text with its baseline at y; without a style it has that of its group."""
    from markupsafe import escape

    drawable = text.encode("utf-8", "backslashreplace").decode()  # bytes that were no text, shown as escapes
    styled = f' style="{style}"' if style else ""
    return f'<text{styled} x="{short_number(x)}" y="{short_number(y)}">{escape(drawable)}</text>'
