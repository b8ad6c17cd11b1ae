"""The command that prints boards, as a dataclass from which its options and its help are made."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..errors import OptionError
from .command_parts import Switch, output_option

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
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True, kw_only=True)
class PrintTarget:
    """Draw a calibration board as PDF and SVG at true scale, with rulers and its target.yaml.

    Without a size, the board is as large as fits on the paper. Print it at 100 %, measure the rulers, and glue it onto
    something flat.
    """

    board: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BOARD", help_behavior_hint="")]
    """aprilgrid, checkerboard, circlegrid or charuco; or a target.yaml that describes the board."""
    output: Annotated[Path | None, output_option("FILE")] = None
    """Drawing to write, .pdf or .svg, both where it has no ending; the description stands beside it as .yaml (default:
    named after the board)."""
    cols: Annotated[int | None, _optional("INT")] = None
    """Tags, inner corners, circles, or squares of a ChArUco board from left to right (default: 6, 9, 7, 7; 4 circles of
    an asymmetric grid)."""
    rows: Annotated[int | None, _optional("INT")] = None
    """The same from top to bottom (default: 6, 6, 6, 9; 11 of an asymmetric grid)."""
    size: Annotated[str | None, _optional("LENGTH")] = None
    """Side of a tag or square, or distance of circles, such as 88mm or 0.088 (metres) (default: the largest that fits
    on the paper)."""
    spacing: Annotated[float | None, _optional("FLOAT")] = None
    """Gap between tags over their side (default: 0.3)."""
    border_bits: Annotated[Literal[1, 2] | None, _optional("{1,2}")] = None
    """Border of the tags: 2 as Kalibr prints it, with squares between the tags, or 1: plain tags (default: 2)."""
    first: Annotated[int | None, _optional("INT")] = None
    """Id of the first tag, at the lower left, or of the first marker, at the upper left (default: 0)."""
    asymmetric: Annotated[bool, Switch] = False
    """Shift every other row of circles."""
    marker: Annotated[str | None, _optional("LENGTH")] = None
    """Side of a marker of a ChArUco board (default: 0.75 of its square)."""
    dictionary: Annotated[str | None, _optional("NAME")] = None
    """OpenCV's dictionary of the markers (default: 4X4_50)."""
    legacy: Annotated[bool, Switch] = False
    """Draw a ChArUco board with an even number of rows as OpenCV before 4.6 did."""
    paper: Annotated[str | None, _optional("PAPER")] = None
    """A5, A4, A3, A2, A1, A0, letter, legal, tabloid, or such as 500x700mm (default: A4 without a size, else the
    smallest of A4 to A0 that holds the board)."""
    tiles: Annotated[bool, Switch] = False
    """Divide a board that is larger than the paper into pages to be glued together; one sheet is better."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

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
