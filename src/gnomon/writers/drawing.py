"""A drawing in millimetres, and the same as PDF and as SVG at true scale.

The origin is at the lower left, y is up. A PDF needs no more than filled paths, lines and two of the fonts that every
viewer has; its numbers are millimetres, too, under one matrix, so that nothing is rounded on the way.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field
from html import escape
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..recording import Floats

POINTS_PER_MM = 72 / 25.4
"""A PDF's unit is the point, 1/72 inch."""

Font = Literal["Helvetica", "Helvetica-Bold", "Courier"]

_FONTS: dict[Font, str] = {
    "Helvetica": 'font-family="Helvetica, Arial, sans-serif"',
    "Helvetica-Bold": 'font-family="Helvetica, Arial, sans-serif" font-weight="bold"',
    "Courier": "font-family=\"Courier, 'Courier New', monospace\"",
}


@value_class(eq=True)
class Words:
    """One line of text: where its baseline begins and how high its font is [mm]."""

    x: float
    y: float
    text: str
    height: float
    font: Font = "Helvetica"


@value_class
class Drawing:
    """What is on a sheet.

    Attributes
    ----------
    size : width and height of the sheet [mm]
    areas : closed paths (n, 2) around what is black [mm]; holes run the other way round
    lines : pieces (n, 4), x0, y0, x1, y1 [mm], in black and `line_width` wide
    words : lines of text
    """

    size: tuple[float, float]
    areas: Sequence[Floats]
    lines: Floats = field(default_factory=lambda: np.empty((0, 4)))
    words: Sequence[Words] = ()
    line_width: float = 0.15


@value_class(eq=True)
class PaperPage:
    """A sheet of paper, and where on it a part of a drawing comes.

    Attributes
    ----------
    size : width and height [mm]
    offset : of the drawing's origin from that of the page [mm]
    window : x0, y0, x1, y1 of the page that shows the drawing [mm]; all of it where there is none
    marks : pieces (x0, y0, x1, y1) that are drawn besides [mm]
    words : text that is written besides
    """

    size: tuple[float, float]
    offset: tuple[float, float] = (0.0, 0.0)
    window: tuple[float, float, float, float] | None = None
    marks: Sequence[tuple[float, float, float, float]] = ()
    words: Sequence[Words] = ()


def svg_text(drawing: Drawing, title: str) -> str:
    """Return the drawing as SVG; its units are millimetres."""
    width, height = (_number(side) for side in drawing.size)

    def down(points: Floats) -> Floats:
        return points * [1, -1] + [0, drawing.size[1]]

    size = f'width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        f"<title>{escape(title)}</title>",
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        f'<path id="board" d="{"".join(_svg_path(down(area)) for area in drawing.areas)}"/>',
    ]
    if len(drawing.lines):
        pieces = (down(piece.reshape(2, 2)) for piece in drawing.lines)
        path = "".join(f"M{_pair(a)}L{_pair(b)}" for a, b in pieces)
        lines.append(f'<path id="lines" d="{path}" fill="none" stroke="#000" stroke-width="{drawing.line_width}"/>')
    for words in drawing.words:
        x, y = down(np.array([words.x, words.y]))
        place = f'x="{_number(x)}" y="{_number(y)}" font-size="{words.height}"'
        lines.append(f'<text {place} {_FONTS[words.font]} xml:space="preserve">{escape(words.text)}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def pdf_bytes(drawing: Drawing, title: str, pages: Sequence[PaperPage] = ()) -> bytes:
    """Return the drawing as PDF: on one page of its own size, or on others, of which each shows its part.

    Viewers are asked not to scale it when they print.
    """
    pages = pages or (PaperPage(size=drawing.size),)
    fonts = " ".join(f"/F{k} << /Type /Font /Subtype /Type1 /BaseFont /{name} /Encoding /WinAnsiEncoding >>"
                     for k, name in enumerate(_FONTS))  # fmt: skip
    box = f"[0 0 {' '.join(map(_number, drawing.size))}]"
    form = f"/Type /XObject /Subtype /Form /BBox {box} /Resources << /Font << {fonts} >> >>"
    first = 5  # number of the first page's object; its content is the next
    kids = " ".join(f"{first + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None /PickTrayByPDFSize true >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>".encode(),
        f"<< /Title ({_escaped(title)}) /Creator (gnomon) >>".encode("cp1252"),
        _stream("\n".join(_pdf_drawing(drawing)), form),
    ]
    for k, page in enumerate(pages):
        media = " ".join(_number(side * POINTS_PER_MM) for side in page.size)
        resources = f"<< /XObject << /Sheet 4 0 R >> /Font << {fonts} >> >>"
        number = first + 2 * k + 1
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {media}] /Resources {resources} "
            f"/Contents {number} 0 R >>".encode()
        )
        objects.append(_stream("\n".join(_pdf_page(page, drawing.line_width))))
    return _pdf_file(objects)


def _pdf_page(page: PaperPage, line_width: float) -> Iterator[str]:
    yield f"{POINTS_PER_MM:.12f} 0 0 {POINTS_PER_MM:.12f} 0 0 cm"
    yield "q"
    if page.window is not None:
        x0, y0, x1, y1 = page.window
        yield f"{_number(x0)} {_number(y0)} {_number(x1 - x0)} {_number(y1 - y0)} re W n"
    yield f"1 0 0 1 {_number(page.offset[0])} {_number(page.offset[1])} cm /Sheet Do Q"
    yield from _pdf_lines(np.array(page.marks).reshape(-1, 4), line_width)
    yield from _pdf_words(page.words)


def _pdf_drawing(drawing: Drawing) -> Iterator[str]:
    for area in drawing.areas:
        first, *others = (f"{_number(x)} {_number(y)}" for x, y in area)
        yield f"{first} m {' '.join(f'{pair} l' for pair in others)} h"
    yield "f"  # all at once: what is black is filled whatever the order
    yield from _pdf_lines(drawing.lines, drawing.line_width)
    yield from _pdf_words(drawing.words)


def _pdf_lines(lines: Floats, width: float) -> Iterator[str]:
    if len(lines):
        yield f"{width} w"
        yield from (f"{_number(a)} {_number(b)} m {_number(c)} {_number(d)} l" for a, b, c, d in lines)
        yield "S"


def _pdf_words(lines: Sequence[Words]) -> Iterator[str]:
    for words in lines:
        font = list(_FONTS).index(words.font)
        place = f"/F{font} {_number(words.height)} Tf {_number(words.x)} {_number(words.y)} Td"
        yield f"BT {place} ({_escaped(words.text)}) Tj ET"


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "()\\" else c for c in text)


def _stream(content: str, entries: str = "") -> bytes:
    data = content.encode("cp1252")
    return f"<< {entries} /Length {len(data)} >>\nstream\n".encode() + data + b"\nendstream"


def _pdf_file(objects: Sequence[bytes]) -> bytes:
    """Return a PDF of these objects, the first of which is the catalogue and the third the information."""
    out = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n")
    places: list[int] = []
    for number, content in enumerate(objects, start=1):
        places.append(len(out))
        out += f"{number} 0 obj\n".encode() + content + b"\nendobj\n"
    start = len(out)
    out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
    out += b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
    out += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R /Info 3 0 R >>\nstartxref\n{start}\n%%EOF\n".encode()
    return bytes(out)


def _svg_path(points: Floats) -> str:
    first, *others = (_pair(point) for point in points)
    return f"M{first}L{' '.join(others)}z"


def _pair(point: Floats) -> str:
    return f"{_number(point[0])},{_number(point[1])}"


def _number(value: float) -> str:
    """Return a length with a nanometre's digits and no exponent."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
