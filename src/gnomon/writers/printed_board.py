"""A board -> files to print it: PDF, SVG, and its target.yaml beside them."""

from os import PathLike
from pathlib import Path

from ..errors import FormatError, OptionError, OutputError
from ..formats.kalibr.target import read_target, target_text
from ..frozen import value_class
from ..models.target import Target
from ..output import write_together
from .board_sheet import board_drawing, tile_board
from .drawing import pdf_bytes, svg_text


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
