"""A board -> files to print it: its black areas as paths without seams, on sheets of paper, and its target.yaml."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import ceil, floor
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FormatError, OptionError, OutputError
from ..formats.kalibr.target import read_target, target_lines, target_text
from ..frozen import value_class
from ..models.board_pattern import BoardPattern, board_pattern
from ..models.target import Target
from ..output import write_together
from ..recording import Floats
from .drawing import Drawing, PaperPage, Words, pdf_bytes, svg_text

Place = tuple[int, int]
_STEP_M = 1e-9  # corners that are nearer are one


def board_paths(pattern: BoardPattern) -> list[Floats]:
    """Return closed paths (n, 2) [m] around all that is black; to their left it is black, and holes are inside others.

    Corners between edges of the same direction are left out. Where two cells touch with their corners alone the paths
    do so, too.
    """
    order = np.argsort(pattern.area, kind="stable")
    starts = np.flatnonzero(np.diff(pattern.area[order])) + 1
    return [path for edges in np.split(pattern.edges[order], starts) for path in _traced(edges)]


def _traced(edges: Floats) -> list[Floats]:
    """Return the closed paths that edges (n, 4) of one area make."""
    places = np.rint(edges / _STEP_M).astype(np.int64)
    where: dict[Place, Floats] = {}
    ahead: dict[Place, list[Place]] = {}
    for (x0, y0, x1, y1), edge in zip(places.tolist(), edges, strict=True):
        where[x0, y0] = edge[:2]
        ahead.setdefault((x0, y0), []).append((x1, y1))
    paths: list[Floats] = []
    while ahead:
        start = at = before = next(iter(ahead))
        path: list[Place] = []
        while at != start or not path:
            path.append(at)
            choice = ahead[at]
            after = choice[0] if len(choice) == 1 else max(choice, key=partial(_left, before, at))
            choice.remove(after)
            if not choice:
                del ahead[at]
            before, at = at, after
        paths.append(np.array([where[place] for place in _corners(path)]))
    return paths


def _left(before: Place, at: Place, after: Place) -> int:
    """Return how far a way turns to the left."""
    return (at[0] - before[0]) * (after[1] - at[1]) - (at[1] - before[1]) * (after[0] - at[0])


def _corners(path: list[Place]) -> list[Place]:
    """Return the places at which a closed path turns."""
    around = zip([path[-1], *path[:-1]], path, [*path[1:], path[0]], strict=True)
    return [at for before, at, after in around if _left(before, at, after) != 0]


Size = tuple[float, float]
PAPERS: dict[str, Size] = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
"""Width and height of sheets, upright [mm]."""
_USUAL = ("A4", "A3", "A2", "A1", "A0")  # tried where no paper is stated
_LARGEST_MM = 5000.0  # of a page of a PDF: 14400 points
_MARGIN = 5.0  # which printers leave white
_LEFT, _BELOW = 17.0, 33.0  # room of the upright ruler, and of the level one with the words
_WIDE = 190.0  # from this width on, words and target.yaml stand side by side
_SMALLEST: Size = (125.0, 120.0)
_YAML_X, _YAML_ROWS = 118.0, 30.0
_ORIGIN, _RULER = 6.0, 100
_TICKS = ((10, 4.0), (5, 2.5), (1, 1.5))  # lengths of the ticks at multiples of so many millimetres
_LINE, _TITLE, _FINE = 2.4, 3.4, 2.2  # heights of fonts
_TITLE_WIDTH, _LETTER = 88.0, 0.56  # room of the title, and the mean width of a letter over its height
_ROUNDED_M = 0.0005  # a size that is chosen to fit is a multiple of this
_CUT, _CUT_GAP = 2.5, 0.5
_TILE_MARGIN, _OVERLAP = 10.0, 10.0
_TO_DO = (
    "Print at 100 % (actual size). Measure both rulers: each is 100 mm long.",
    "If they are not, measure the board and write its lengths into target.yaml.",
    "Glue it flat onto glass or an aluminium plate, without bubbles.",
)
_SIDES = {"aprilgrid": "tag_size_m", "circlegrid": "spacing_m", "charuco": "square_size_m"}


def paper_size(paper: str) -> Size:
    """Return width and height of a sheet of paper [mm].

    Parameters
    ----------
    paper : "A4", "letter", ..., or such as "500x700mm"

    Raises
    ------
    OptionError
        If there is no such paper.
    """
    known = {name.lower(): size for name, size in PAPERS.items()}
    plain = paper.strip().lower()
    if plain in known:
        return known[plain]
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*x\s*(\d+(?:\.\d+)?)\s*(?:mm)?", plain)
    if found is None:
        raise OptionError(
            f'paper "{paper}": expected one of {", ".join(PAPERS)}, or width and height such as 500x700mm.'
        )
    size = float(found[1]), float(found[2])
    if not all(least <= side <= _LARGEST_MM for least, side in zip(sorted(_SMALLEST), sorted(size), strict=True)):
        raise OptionError(
            f'paper "{paper}": expected {min(_SMALLEST):g} x {max(_SMALLEST):g} mm at least, for the rulers, and '
            f"{_LARGEST_MM:g} mm at most."
        )
    return size


def largest_on(target: Target, paper: str) -> Target:
    """Return a board of the same kind and counts whose squares are as large as fit on a sheet of paper.

    The side of a tag or square, or the distance of circles, becomes a multiple of 0.5 mm; the other lengths keep
    their ratio to it.

    Raises
    ------
    OptionError
        If there is no such paper, or it is too small for such a board.
    """
    name = _SIDES.get(target.kind, "row_spacing_m")
    side = getattr(target, name)
    extent = _extent(board_pattern(target), target)
    factor = max(
        min(free / length for free, length in zip(_free(size), extent, strict=True))
        for size in _turned(paper_size(paper))
    )
    rounded = floor(factor * side / _ROUNDED_M + 1e-6) * _ROUNDED_M
    if rounded <= 0:
        raise OptionError(f"a {target.kind} of {target.cols} x {target.rows} does not fit on {paper}.")
    return _scaled(target, round(rounded, 9) / side)


def board_drawing(target: Target, paper: str = "") -> Drawing:
    """Return the drawing of a board on its sheet.

    Parameters
    ----------
    target : the board
    paper : the sheet, upright or across, as `paper_size` takes it; without it the smallest of A4, A3, ..., A0, or one
        of the board's own size where that is too small

    Raises
    ------
    OptionError
        If the board does not fit on the paper, or has more tags than there are.
    """
    pattern = board_pattern(target)
    extent = _extent(pattern, target)
    size = _sheet(extent, paper) if paper else _least_sheet(extent)
    return _drawn(target, pattern, size)


def tile_board(target: Target, paper: str) -> tuple[Drawing, tuple[PaperPage, ...]]:
    """Return a board on one large sheet of its own size, and the pages of a smaller paper that make it up.

    Pages overlap by 10 mm. They come row by row from the upper left.

    Raises
    ------
    OptionError
        If there is no such paper, or the board has more tags than there are.
    """
    pattern = board_pattern(target)
    drawing = _drawn(target, pattern, _own_sheet(_extent(pattern, target)))
    size = min(_turned(paper_size(paper)), key=lambda size: int(np.prod(_tiles(drawing.size, size))))
    cols, rows = _tiles(drawing.size, size)
    return drawing, tuple(
        _tile(drawing.size, size, (col, row), (cols, rows)) for row in range(rows) for col in range(cols)
    )


def _tiles(whole: Size, paper: Size) -> tuple[int, int]:
    cols, rows = (
        max(1, ceil((length - _OVERLAP) / (side - 2 * _TILE_MARGIN - _OVERLAP) - 1e-9))
        for length, side in zip(whole, paper, strict=True)
    )
    return cols, rows


def _tile(whole: Size, paper: Size, place: tuple[int, int], count: tuple[int, int]) -> PaperPage:
    """Return one page; what is cut off is at its left and at its top, what is covered at its right and below."""
    col, row = place
    low, (right, top) = _TILE_MARGIN, (side - _TILE_MARGIN for side in paper)
    x = col * (right - low - _OVERLAP)
    y = whole[1] - (top - low) - row * (top - low - _OVERLAP)
    upright = [low] * (col > 0) + [right - _OVERLAP] * (col < count[0] - 1)
    level = [top] * (row > 0) + [low + _OVERLAP] * (row < count[1] - 1)
    words = f"Row {row + 1} of {count[1]}, column {col + 1} of {count[0]}."
    if count != (1, 1):
        words += " Cut off the left and the upper margin at their marks, and glue it where the marks of the others are."
    return PaperPage(
        size=paper,
        offset=(low - x, low - y),
        window=(low, low, right, top),
        marks=[(at, edge, at, edge + step) for at in upright for edge, step in ((low - 1, -5), (top + 1, 5))]
        + [(edge, at, edge + step, at) for at in level for edge, step in ((low - 1, -5), (right + 1, 5))],
        words=(Words(x=low, y=4.5, text=words, height=_LINE),),
    )


def _turned(size: Size) -> tuple[Size, Size]:
    """Return a size as it was stated, and turned by a quarter."""
    return size, (size[1], size[0])


def _below(width: float) -> float:
    return _BELOW if width >= _WIDE else _BELOW + _YAML_ROWS


def _free(size: Size) -> Size:
    """Return what is free for a board on a sheet."""
    return size[0] - _LEFT - _MARGIN, size[1] - _below(size[0]) - _MARGIN


def _fits(extent: Size, size: Size) -> bool:
    least = all(side >= least for side, least in zip(size, _SMALLEST, strict=True))
    return least and all(length <= free + 1e-6 for length, free in zip(extent, _free(size), strict=True))


def _sheet(extent: Size, paper: str) -> Size:
    for size in _turned(paper_size(paper)):
        if _fits(extent, size):
            return size
    own = _own_sheet(extent)
    would = next((name for name in _USUAL if any(_fits(extent, size) for size in _turned(PAPERS[name]))), None)
    other = f"paper {would}" if would else f"paper {ceil(own[0])}x{ceil(own[1])}mm"
    raise OptionError(
        f"the board is {extent[0]:.5g} x {extent[1]:.5g} mm with its white rim and does not fit on {paper} with its "
        f"rulers and words. Choose {other}, smaller squares, or tiles of {paper} to be glued together."
    )


def _least_sheet(extent: Size) -> Size:
    standard = (size for name in _USUAL for size in _turned(PAPERS[name]) if _fits(extent, size))
    return next(standard, _own_sheet(extent))


def _own_sheet(extent: Size) -> Size:
    size = max(_WIDE, extent[0] + _LEFT + _MARGIN), max(_SMALLEST[1], extent[1] + _BELOW + _MARGIN)
    if max(size) > _LARGEST_MM:
        raise OptionError(f"the board is {extent[0]:.5g} x {extent[1]:.5g} mm; {_LARGEST_MM:g} mm is the most.")
    return size


def sheet_rotation(target: Target) -> Floats:
    """Return the matrix from the board's frame to the sheet's."""
    level = target.kind in {"aprilgrid", "charuco"} or target.asymmetric
    return np.eye(2) if level else np.array([[0.0, 1.0], [-1.0, 0.0]])


def _extent(pattern: BoardPattern, target: Target) -> Size:
    """Return width and height of the board on the sheet, its white rim included [mm]."""
    width, height = 1000 * np.abs(sheet_rotation(target) @ (pattern.sheet[2:] - pattern.sheet[:2]))
    return float(width), float(height)


def _scaled(target: Target, factor: float) -> Target:
    lengths = ("tag_size_m", "row_spacing_m", "col_spacing_m", "spacing_m", "square_size_m", "marker_size_m")
    return replace(target, **{name: round(getattr(target, name) * factor, 9) for name in lengths})


def _drawn(target: Target, pattern: BoardPattern, size: Size) -> Drawing:
    width, height = _extent(pattern, target)
    below = _below(size[0])
    low = np.array([max(_LEFT, (size[0] - width) / 2), below + (size[1] - _MARGIN - below - height) / 2])
    turn = sheet_rotation(target)
    corners = 1000 * pattern.sheet.reshape(2, 2) @ turn.T
    shift = low - corners.min(axis=0)
    areas = [1000 * path @ turn.T + shift for path in board_paths(pattern)]
    lines = [*_rulers(), *_cut_marks(low[0], low[1], low[0] + width, low[1] + height)]
    return Drawing(size=size, areas=[*areas, _arrow()], lines=np.array(lines), words=tuple(_words(target, size)))


def _rulers() -> Iterator[tuple[float, float, float, float]]:
    """Yield the lines of a level and an upright ruler with a common zero."""
    o, end = _ORIGIN, _ORIGIN + _RULER
    yield from ((o, o, end, o), (o, o, o, end))
    for k in range(1, _RULER + 1):
        length = next(length for step, length in _TICKS if k % step == 0)
        yield from ((o + k, o, o + k, o + length), (o, o + k, o + length, o + k))


def _cut_marks(x0: float, y0: float, x1: float, y1: float) -> Iterator[tuple[float, float, float, float]]:
    for x, across in ((x0, -1), (x1, 1)):
        for y, up in ((y0, -1), (y1, 1)):
            yield (x + across * _CUT_GAP, y, x + across * (_CUT_GAP + _CUT), y)
            yield (x, y + up * _CUT_GAP, x, y + up * (_CUT_GAP + _CUT))


def _arrow() -> Floats:
    """Return an arrow that points up, before the title."""
    shape = np.array([[-0.5, 0], [0.5, 0], [0.5, 3], [1.6, 3], [0, 5.6], [-1.6, 3], [-0.5, 3]])
    return shape + np.array([_LEFT + 3.6, 25.2])


def _words(target: Target, size: Size) -> Iterator[Words]:
    for k in range(0, _RULER + 1, 10):
        left = _ORIGIN + k - (0.3 if k == 0 else 0.6 if k < 100 else 0.9) * _FINE
        if k:
            yield Words(x=left, y=_ORIGIN + 4.8, text=str(k), height=_FINE)
            yield Words(x=_ORIGIN + 4.8, y=_ORIGIN + k - 0.36 * _FINE, text=str(k), height=_FINE)
    yield Words(x=_ORIGIN + _RULER + 2, y=_ORIGIN, text="mm", height=_FINE)
    title = target.describe()
    height = min(_TITLE, _TITLE_WIDTH / (_LETTER * len(title)))
    yield Words(x=_LEFT + 8, y=26.4, text=title, height=round(height, 2), font="Helvetica-Bold")
    for k, line in enumerate((f"This side up: {_axes(target)}.", *_TO_DO)):
        yield Words(x=_LEFT + 2, y=22.4 - 3.1 * k, text=line, height=_LINE)
    beside = size[0] >= _WIDE
    x, top = (_YAML_X, 28.0) if beside else (_LEFT + 2, _BELOW + _YAML_ROWS - 6)
    for k, line in enumerate(target_lines(target)):
        yield Words(x=x, y=top - 3.2 * k, text=line, height=2.6, font="Courier")


def _axes(target: Target) -> str:
    """Return where the axes of the board's frame are on the sheet."""
    if target.kind == "aprilgrid":
        return f"x right, y up, from the lower left corner of tag {target.first_tag}"
    if target.kind == "charuco":
        return "x right, y up, from the lower left inner corner"
    if target.asymmetric:
        return "x right, y up, from the circle at the lower left"
    first = "inner corner" if target.kind == "checkerboard" else "circle"
    return f"x down, y right, from the {first} at the upper left"


@value_class(eq=True)
class PrintedTarget:
    """What was written to print a board.

    Attributes
    ----------
    files : the drawings, and the description last
    sheet_mm : width and height of the sheet, or of each page where there are several [mm]
    pages : number of pages of the PDF
    """

    files: tuple[Path, ...]
    sheet_mm: tuple[float, float]
    pages: int = 1


def save_target(target: Target, path: str | PathLike[str], *, paper: str = "", tiles: bool = False) -> PrintedTarget:
    """Write a board as it is printed, at true scale, and its target.yaml beside it.

    Parameters
    ----------
    target : the board
    path : "board.pdf" or "board.svg"; "board" for both. The description is board.yaml.
    paper : "A4", "A3", ..., "letter", or such as "500x700mm"; without it the smallest sheet that holds the board
    tiles : whether the PDF has pages of that paper, A4 where none is stated, to be glued together; an SVG is one sheet

    Raises
    ------
    OptionError
        If the board does not fit on the paper, has more tags than there are, or the ending is another one.
    OutputError
        If a file cannot be written, or there is a description of another board by that name.

    Examples
    --------
    >>> board = Target.charuco(cols=7, rows=9, square_size_m=0.03, marker_size_m=0.0225)
    >>> printed = save_target(board, "board.pdf")  # doctest: +SKIP
    >>> [file.name for file in printed.files], printed.sheet_mm  # doctest: +SKIP
    (['board.pdf', 'board.yaml'], (297.0, 420.0))
    """
    place = Path(path)
    ending = place.suffix.lower()
    if ending not in {"", ".pdf", ".svg"}:
        raise OptionError(f"{place}: boards are drawn as .pdf or .svg; a name without an ending gets both.")
    drawing, pages = tile_board(target, paper or "A4") if tiles else (board_drawing(target, paper), ())
    title = target.describe()
    contents: dict[str, str | bytes] = {}
    if ending != ".svg":
        contents[".pdf"] = pdf_bytes(drawing, title, pages)
    if ending != ".pdf":
        contents[".svg"] = svg_text(drawing, title)
    description = place.with_suffix(".yaml")
    if not _describes(description, target):
        contents[".yaml"] = target_text(target)
    files = {suffix: place if suffix == ending else place.with_suffix(suffix) for suffix in contents}
    write_together(place.parent, {files[suffix].name: content for suffix, content in contents.items()})
    drawn = tuple(file for suffix, file in files.items() if suffix != ".yaml")
    sheet = pages[0].size if pages else drawing.size
    return PrintedTarget(files=(*drawn, description), sheet_mm=sheet, pages=len(pages) or 1)


def _describes(path: Path, target: Target) -> bool:
    """Tell whether there is a description of this very board already; it is left as it is, with its comments."""
    if not path.exists():
        return False
    try:
        found = read_target(path)
    except FormatError:
        found = None
    if found is not None and target_text(found) == target_text(target):
        return True
    what = "no board" if found is None else f"another board ({found.describe()})"
    raise OutputError(f"{path}: this file exists and describes {what}. Remove it, or choose another name with -o.")
