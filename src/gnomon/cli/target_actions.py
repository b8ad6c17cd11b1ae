"""What `gnomon target` does."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OptionError
from . import target_command
from .results import USABLE
from .target_command import KINDS, length_m
from .terminal import Terminal

if TYPE_CHECKING:
    from ..models.target import Target

_ANY_M, _MARKER, _SPACING = 0.1, 0.75, 0.3
_COUNTS = {"aprilgrid": (6, 6), "checkerboard": (9, 6), "circlegrid": (7, 6), "charuco": (7, 9)}
_ASYMMETRIC = (4, 11)
_NEXT = "Print at 100 %, measure both rulers (100 mm), glue it onto glass or aluminium."


def print_target(command: target_command.PrintTarget, terminal: Terminal) -> int:
    """Write the drawings of a board and say where."""
    from ..writers.board_sheet import largest_on
    from ..writers.printed_board import save_target

    board, paper = _board(command), command.paper or ""
    if command.board in KINDS and command.size is None:
        paper = paper or "A4"
        board = largest_on(board, paper)
    place = command.output or _default(command, board)
    if place.is_dir():
        place /= _default(command, board).name
    printed = save_target(board, place, paper=paper, tiles=command.tiles)
    width, height = printed.sheet_mm
    sheets = "a sheet" if printed.pages == 1 else f"{printed.pages} sheets"
    terminal.say(board.describe())
    terminal.say(f"on {sheets} of {width:g} x {height:g} mm")
    for file in printed.files:
        terminal.say(f"  {file}")
    terminal.say(_NEXT, "dim")
    terminal.document(
        {
            "files": [str(file) for file in printed.files],
            "board": board.describe(),
            "sheet_mm": list(printed.sheet_mm),
            "pages": printed.pages,
        }
    )
    return USABLE


def _default(command: target_command.PrintTarget, board: "Target") -> Path:
    if command.board in KINDS:
        return Path(f"{board.kind}-{board.cols}x{board.rows}")
    return Path(command.board).with_suffix("")


def _board(command: target_command.PrintTarget) -> "Target":
    """Return the board that is asked for; of any size where none is stated."""
    from ..models.target import Target

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
            from ..readers.rig.kalibr_target import dictionary_name

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
    from ..readers.rig.kalibr_target import read_target

    if not Path(name).exists():
        raise OptionError(f"{name}: there is neither such a board nor such a file. Boards are {', '.join(KINDS)}.")
    return read_target(name)
