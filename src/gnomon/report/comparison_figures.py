"""The figure of a comparison: every scalar of every calibration in its sigmas."""

import numpy as np

from ..assess.comparison import Comparison, Repeatability
from ..assess.comparison_words import block_words
from ..recording import Floats
from . import svg
from .figures import RIGHT, Sheet, dots
from .panel import Panel

COLORS = ("x", "y", "z", "accent", "t1", "t5")
"""Of the first calibrations; more than these are drawn alike, but for those that stand out."""
OTHERS = "before"

_ROW = 50.0
_MOST_SIGMAS = 12.0


def color_of(comparison: Comparison, name: str) -> str:
    """Return the colour of a calibration."""
    names = [one.name for one in comparison.calibrations]
    if len(names) <= len(COLORS):
        return COLORS[names.index(name)]
    return COLORS[comparison.outside.index(name) % len(COLORS)] if name in comparison.outside else OTHERS


def drawn_blocks(comparison: Comparison) -> list[Repeatability]:
    """Return the blocks that the figure shows: those with sigmas and two values."""
    return [block for block in comparison.blocks if len(block.names) > 1 and np.isfinite(block.predicted).any()]


def truth_of(comparison: Comparison) -> str:
    """Return the name of the one calibration that is exact, against which the others are drawn; "" without one."""
    exact = [one.name for one in comparison.calibrations if one.exact]
    return exact[0] if len(exact) == 1 and all(exact[0] in block.names for block in drawn_blocks(comparison)) else ""


def deviations(comparison: Comparison) -> str:
    """Deviation of every scalar from the truth, else from the mean, in predicted sigmas, a line for each block."""
    zero = "the truth" if truth_of(comparison) else "the mean"
    blocks = drawn_blocks(comparison)
    height = _ROW * len(blocks)

    sheet = Sheet()
    panel = sheet.panel(f"Deviation from {zero}, in sigmas", top=36, height=height, left=RIGHT, x_label="sigmas")
    reach = _reach(comparison, blocks)
    panel.x.span(-reach, reach)
    panel.x.grid = True
    panel.y.span(len(blocks) - 0.5, -0.5)
    panel.y.ticks, panel.y.grid = (), False
    panel.upright(0.0, "muted")
    for row, block in enumerate(blocks):
        style = svg.text_style("muted", 12, "left")
        panel.text(block_words(block.path), -reach, row - 0.5, style, offset=(2.0, 15.0))
        _draw_block(panel, comparison, block, row, reach)
    count = len(comparison.calibrations)
    alt = f"Deviations of {count} calibrations in {len(blocks)} blocks from {zero}, in sigmas."
    return sheet.draw("deviations", height + 100, alt)


def _in_sigmas(comparison: Comparison, block: Repeatability) -> Floats:
    """Return the deviations (m, k) of the calibrations of a block in its predicted sigmas."""
    truth = truth_of(comparison)
    zero = block.values[block.names.index(truth)] if truth else block.mean
    with np.errstate(invalid="ignore", divide="ignore"):
        return (block.values - zero) / block.predicted


def _reach(comparison: Comparison, blocks: list[Repeatability]) -> float:
    sizes = [np.abs(_in_sigmas(comparison, block)) for block in blocks]
    largest = max((float(np.nanmax(size)) for size in sizes if np.isfinite(size).any()), default=1.0)
    return float(min(max(1.1 * largest, 3.0), _MOST_SIGMAS))


def _draw_block(panel: Panel, comparison: Comparison, block: Repeatability, row: int, reach: float) -> None:
    """Draw a block; what lies beyond the edge is drawn on it, hollow."""
    shown = [name for name in block.names if name != truth_of(comparison)]
    count, deviation = len(shown), _in_sigmas(comparison, block)
    for i, name in enumerate(shown):
        sigmas = deviation[block.names.index(name)]
        sigmas = sigmas[np.isfinite(sigmas)]
        place = np.full(len(sigmas), row + 0.2 + 0.5 * ((i + 0.5) / count - 0.5))
        inside = np.abs(sigmas) <= reach
        color = color_of(comparison, name)
        dots(panel, sigmas[inside], place[inside], color, size=5.5)
        dots(panel, np.clip(sigmas[~inside], -reach, reach), place[~inside], color, size=7.5, ring=True)
