"""The board that goes with a simulated recording."""

from ..models.target import Target
from .seen_board import SeenBoard


def stated_board(scenario: SeenBoard) -> Target:
    """Return the board that goes with the recording; the true one is `target_scale` times as large."""
    cols, rows, size = scenario.target_cols, scenario.target_rows, scenario.target_size_m
    if scenario.target_type == "aprilgrid":
        return Target.aprilgrid(tag_cols=cols, tag_rows=rows, tag_size_m=size, tag_spacing=scenario.target_spacing)
    if scenario.target_type == "checkerboard":
        return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=size, col_spacing_m=size)
    if scenario.target_type == "charuco":
        marker = scenario.marker_share * size
        return Target.charuco(
            cols=cols, rows=rows, square_size_m=size, marker_size_m=marker, dictionary=scenario.dictionary
        )
    return Target.circlegrid(cols=cols, rows=rows, spacing_m=size, asymmetric=scenario.target_asymmetric)
