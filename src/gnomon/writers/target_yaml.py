"""A board -> Kalibr's target.yaml, which `gnomon.readers.rig.kalibr_target` reads back to the same board.

What Kalibr does not know, tags with a border of 1 bit or other ids and ChArUco boards, has keys of its own.
"""

from typing import Any

from ..models.target import Target
from .yaml_text import yaml_lines


def target_text(target: Target) -> str:
    """Return the text of target.yaml, with lengths in metres."""
    return "\n".join(target_lines(target)) + "\n"


def target_lines(target: Target) -> tuple[str, ...]:
    """Return the lines of target.yaml; they are the caption of a printed board."""
    return tuple(yaml_lines({"target_type": target.kind} | _board(target)))


def _board(target: Target) -> dict[str, Any]:
    if target.kind == "aprilgrid":
        node = {"tagCols": target.cols, "tagRows": target.rows, "tagSize": target.tag_size_m}
        node |= {"tagSpacing": target.tag_spacing}
        plain = {"tagBorderBits": target.border_bits} if target.border_bits != 2 else {}
        return node | plain | ({"codeOffset": target.first_tag} if target.first_tag else {})
    if target.kind == "charuco":
        node = {"squareCols": target.cols, "squareRows": target.rows, "squareSize": target.square_size_m}
        node |= {"markerSize": target.marker_size_m, "dictionary": target.dictionary}
        first = {"firstMarker": target.first_tag} if target.first_tag else {}
        return node | first | ({"legacyPattern": True} if target.legacy else {})
    node = {"targetCols": target.cols, "targetRows": target.rows}
    if target.kind == "checkerboard":
        return node | {"rowSpacingMeters": target.row_spacing_m, "colSpacingMeters": target.col_spacing_m}
    return node | {"spacingMeters": target.spacing_m, "asymmetricGrid": target.asymmetric}
