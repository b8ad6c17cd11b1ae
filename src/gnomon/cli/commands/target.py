"""The command that prints boards."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ...errors import OptionError
from ..arguments import Argument
from ..command import (
    Command,
    output_option,
)
from ..results import (
    USABLE,
)
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...models.target import Target


KINDS = ("aprilgrid", "checkerboard", "circlegrid", "charuco")
_TO_METRES = {"": 1.0, "m": 1.0, "cm": 100.0, "mm": 1000.0}
_LONGEST_M = 5.0
_OPTIONS: dict[str, tuple[str, ...]] = {
    "cols": KINDS,
    "rows": KINDS,
    "size": KINDS,
    "spacing": ("aprilgrid",),
    "border_bits": ("aprilgrid",),
    "first": ("aprilgrid", "charuco"),
    "asymmetric": ("circlegrid",),
    "marker": ("charuco",),
    "dictionary": ("charuco",),
    "legacy": ("charuco",),
}


def _optional(metavar: str) -> object:
    return Argument(metavar=metavar)


_ANY_M, _MARKER, _SPACING = 0.1, 0.75, 0.3
_COUNTS = {"aprilgrid": (6, 6), "checkerboard": (9, 6), "circlegrid": (7, 6), "charuco": (7, 9)}
_ASYMMETRIC = (4, 11)
_NEXT = "Print at 100 %, measure both rulers (100 mm), glue it onto glass or aluminium."


@dataclass(frozen=True, kw_only=True)
class PrintTarget(Command):
    """Draw a calibration board as PDF and SVG at true scale, with rulers and its target.yaml.

    Without a size, the board is as large as fits on the paper. Print it at 100 %, measure the rulers, and glue it onto
    something flat.

    Examples
    --------
    $ gnomon target aprilgrid
    $ gnomon target checkerboard --cols 9 --rows 6 --size 30mm --paper A3
    """

    board: Annotated[str, Argument(positional=True, metavar="BOARD")]
    """aprilgrid, checkerboard, circlegrid or charuco; or a target.yaml that describes the board."""
    output: Annotated[Path | None, output_option("FILE")] = None
    """Drawing to write, .pdf or .svg, both where it has no ending; the description stands beside it as .yaml (default:
    named after the board)."""
    cols: Annotated[int | None, _optional("INTEGER")] = None
    """Tags, inner corners, circles, or squares of a ChArUco board from left to right (default: 6, 9, 7, 7; 4 circles of
    an asymmetric grid)."""
    rows: Annotated[int | None, _optional("INTEGER")] = None
    """The same from top to bottom (default: 6, 6, 6, 9; 11 of an asymmetric grid)."""
    size: Annotated[str | None, _optional("LENGTH")] = None
    """Side of a tag or square, or distance of circles, such as 88mm or 0.088 (metres) (default: the largest that fits
    on the paper)."""
    spacing: Annotated[float | None, _optional("NUMBER")] = None
    """Gap between tags over their side (default: 0.3)."""
    border_bits: Annotated[Literal[1, 2] | None, _optional("{1,2}")] = None
    """Border of the tags: 2 as Kalibr prints it, with squares between the tags, or 1: plain tags (default: 2)."""
    first: Annotated[int | None, _optional("INTEGER")] = None
    """Id of the first tag, at the lower left, or of the first marker, at the upper left (default: 0)."""
    asymmetric: bool = False
    """Shift every other row of circles."""
    marker: Annotated[str | None, _optional("LENGTH")] = None
    """Side of a marker of a ChArUco board (default: 0.75 of its square)."""
    dictionary: Annotated[str | None, _optional("NAME")] = None
    """OpenCV's dictionary of the markers (default: 4X4_50)."""
    legacy: bool = False
    """Draw a ChArUco board with an even number of rows as OpenCV before 4.6 did."""
    paper: Annotated[str | None, _optional("PAPER")] = None
    """A5, A4, A3, A2, A1, A0, letter, legal, tabloid, or such as 500x700mm (default: A4 without a size, else the
    smallest of A4 to A0 that holds the board)."""
    tiles: bool = False
    """Divide a board that is larger than the paper into pages to be glued together; one sheet is better."""

    def __post_init__(self) -> None:
        length_m(self.size, "size")
        length_m(self.marker, "marker")
        for name, kinds in _OPTIONS.items():
            if getattr(self, name) in (None, False) or self.board in kinds:
                continue
            flag = f"--{name.replace('_', '-')}"
            if self.board in KINDS:
                raise OptionError(
                    f"{flag} is of a board of kind {' or '.join(kinds)}, and this is one of kind {self.board}."
                )
            raise OptionError(f"{flag} cannot be stated besides the file {self.board}, which describes the board.")
        if self.marker and not self.size:
            raise OptionError("--marker is a length, which needs --size besides it.")
        if self.tiles and not self.size and self.board in KINDS:
            raise OptionError("--tiles needs --size: without it the board is as large as fits on one sheet.")

    def run(self, terminal: Terminal) -> int:
        """Write the drawings of a board and say where."""
        from ...writers.board_sheet import largest_on, save_target

        board, paper = _board(self), self.paper or ""
        if self.board in KINDS and self.size is None:
            paper = paper or "A4"
            board = largest_on(board, paper)
        place = self.output or _default(self, board)
        if place.is_dir():
            place /= _default(self, board).name
        printed = save_target(board, place, paper=paper, tiles=self.tiles)
        width, height = printed.sheet_mm
        sheets = "a sheet" if printed.pages == 1 else f"{printed.pages} sheets"
        terminal.print(board.describe())
        terminal.print(f"on {sheets} of {width:g} x {height:g} mm")
        for file in printed.files:
            terminal.print(f"  {file}")
        terminal.print(_NEXT, "dim")
        terminal.document(
            {
                "files": [str(file) for file in printed.files],
                "board": board.describe(),
                "sheet_mm": list(printed.sheet_mm),
                "pages": printed.pages,
            }
        )
        return USABLE


def length_m(text: str | None, name: str) -> float | None:
    """Return a length in metres; None where none is stated.

    Raises
    ------
    OptionError
        If it is none, or longer than boards are.

    Examples
    --------
    >>> length_m("88mm", "size"), length_m("0.088", "size"), length_m("2.5 cm", "size")
    (0.088, 0.088, 0.025)
    """
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d*\.?\d+(?:e-?\d+)?|\d+\.)\s*(m|cm|mm)?\s*", text)
    if found is None or not float(found[1]) > 0:
        raise OptionError(f'{name} "{text}": expected a length such as 88mm or 0.088 (metres).')
    value = float(found[1]) / _TO_METRES[found[2] or ""]
    if value > _LONGEST_M:
        meant = f" Was {found[1]}mm meant?" if not found[2] else ""
        raise OptionError(f'{name} "{text}" is {value:g} m, which no board has.{meant}')
    return value


def _default(command: PrintTarget, board: "Target") -> Path:
    if command.board in KINDS:
        return Path(f"{board.kind}-{board.cols}x{board.rows}")
    return Path(command.board).with_suffix("")


def _board(command: PrintTarget) -> "Target":
    """Return the board that is asked for; of any size where none is stated."""
    from ...models.target import Target

    if command.board not in KINDS:
        return _described(command.board)
    size = length_m(command.size, "size") or _ANY_M
    usual = _ASYMMETRIC if command.asymmetric else _COUNTS[command.board]
    cols, rows = _stated(command.cols, usual[0]), _stated(command.rows, usual[1])
    first = _stated(command.first, 0)
    match command.board:
        case "aprilgrid":
            return Target.aprilgrid(
                tag_cols=cols,
                tag_rows=rows,
                tag_size_m=size,
                tag_spacing=_stated(command.spacing, _SPACING),
                border_bits=command.border_bits or 2,
                first_tag=first,
            )
        case "checkerboard":
            return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=size, col_spacing_m=size)
        case "circlegrid":
            return Target.circlegrid(cols=cols, rows=rows, spacing_m=size, asymmetric=command.asymmetric)
        case _:
            from ...formats.kalibr.target import dictionary_name

            return Target.charuco(
                cols=cols,
                rows=rows,
                square_size_m=size,
                marker_size_m=length_m(command.marker, "marker") or round(_MARKER * size, 9),
                dictionary=dictionary_name(command.dictionary or "4X4_50"),
                first_marker=first,
                legacy=command.legacy,
            )


def _stated(value: Any, usual: Any) -> Any:
    return usual if value is None else value


def _described(name: str) -> "Target":
    from ...formats.kalibr.target import read_target

    if not Path(name).exists():
        raise OptionError(f"{name}: there is neither such a board nor such a file. Boards are {', '.join(KINDS)}.")
    return read_target(name)
