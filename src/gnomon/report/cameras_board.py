"""The section of a camera report on the board: how its shape differs from what was stated."""

from math import isfinite

import numpy as np

from ..calibration import CamerasFit
from ..diagnostics import CamerasDiagnostics
from ..recording import Floats
from .camera_imu_images import arrows
from .camera_imu_parameters import plus_minus
from .figures import WIDTH, Sheet, dots
from .numbers import MISSING, largest, number, positive
from .page import Block, Figure, Legend, Section, Table

_STEPS = 4
"""Sizes of the dots that show how far a point is out of the plane."""
_TO_SPEAK_OF = 0.05
"""Share of the largest shift from which shifts in the plane are drawn."""
_SHAPES = {"target.aspect": "aspect", "target.bow": "bow", "target.corners": "place of every point"}


def board_section(fit: CamerasFit, diagnostics: CamerasDiagnostics) -> Section:
    """Return what was found of the board."""
    shifts = np.asarray(diagnostics.board_shifts, dtype=np.float64)
    blocks: list[Block] = []
    added = ", ".join(_SHAPES.get(name, name) for name in fit.board_added)
    if shifts.any():
        blocks.append(_figure(diagnostics.board_points, shifts))
    blocks.append(_numbers(fit, shifts))
    lead = (
        f"The views prove that the board is not as stated; estimated: {added}."
        if added
        else "The board was taken as stated: flat, and its points where the file says. Nothing else was estimated."
    )
    return Section("board", "Board", lead, blocks)


def _numbers(fit: CamerasFit, shifts: Floats) -> Table:
    def row(name: str, value: float, sigma: float, unit: str, meaning: str) -> tuple[str, ...]:
        held = not (isfinite(value) and sigma > 0)
        text = "not estimated" if held else f"{plus_minus(value, sigma, sign=True)} {unit}".replace(" ", "\u00a0")
        return name, text, meaning

    rows = [
        row("aspect", 1e3 * fit.aspect, 1e3 * fit.aspect_sigma, "‰", "scale of y over that of x, minus 1"),
        row("bow", 1e3 * fit.bow_m, 1e3 * fit.bow_sigma_m, "mm", "of the middle, towards the viewer"),
        row("print scale", 1e3 * (fit.print_scale - 1), 1e3 * fit.print_scale_sigma, "‰",
            "true size over stated, minus 1; needs --baseline"),
    ]  # fmt: skip
    for name, part in (("largest shift in the plane", shifts[:, :2]), ("largest shift out of it", shifts[:, 2:])):
        size = largest(np.linalg.norm(part, axis=1)) if len(part) else float("nan")
        text = f"{number(1e3 * size, 2)}\u00a0mm" if size > 0 else MISSING
        rows.append((name, text, "of a point"))
    return Table("In numbers", ("", "found", "what it is"), rows, remarked=True)


def _figure(points: Floats, shifts: Floats) -> Figure:
    longer = _magnification(points, shifts)
    high = 1e3 * largest(shifts[:, 2])
    drawn = f"Arrows are {number(longer)} times as long as the shifts. " if longer else ""
    return Figure(
        "Where the points of the board are",
        board(points, shifts, longer),
        (
            Legend("dot", "after", "above the plane (+z)"),
            Legend("dot", "heldout", "below it (−z)"),
            *((Legend("line", "ink", "shift in the plane"),) if longer else ()),
        ),
        f"{drawn}The larger a dot, the farther its point is out of the plane, up to {number(high, 2)} mm. What "
        "a shift, a turn and a common scale of all points do is part of the poses, and was taken off.",
    )


def _magnification(points: Floats, shifts: Floats) -> float:
    """Return by how much arrows are lengthened, a round number; zero without shifts in the plane to speak of."""
    most = largest(np.linalg.norm(shifts[:, :2], axis=1))
    if not most > _TO_SPEAK_OF * largest(shifts):
        return 0.0
    wanted = 0.06 * positive(float(np.ptp(points[:, :2], axis=0).max())) / most
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * 1.0001))


def board(points: Floats, shifts: Floats, longer: float) -> str:
    """Draw the points with dots for how high they are and arrows for how they are shifted in the plane."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    room = 0.09 * positive(float((high - low).max()))
    low, high = low - room, high + room
    width = min(WIDTH - 90, 470 * (high[0] - low[0]) / (high[1] - low[1]))
    height = width * (high[1] - low[1]) / (high[0] - low[0])
    up, most = shifts[:, 2], positive(largest(shifts[:, 2]))

    sheet = Sheet()
    panel = sheet.panel("Board: y over x [m]", top=36, height=height, left=62, right=WIDTH - 62 - width)
    panel.x.grid = True
    panel.x.span(low[0], high[0])
    panel.y.span(low[1], high[1])
    for color, sign in (("after", 1.0), ("heldout", -1.0)):
        step = np.ceil(_STEPS * np.clip(sign * up / most, 0, 1)).astype(int)
        for k in range(1, _STEPS + 1):
            dots(panel, points[step == k, 0], points[step == k, 1], color, size=2.5 + 3.0 * k)
    dots(panel, points[:, 0], points[:, 1], "ink", size=1.6)
    if longer:
        arrows(panel, points[:, :2], longer * shifts[:, :2], "ink")
    return sheet.draw("board", height + 84, f"Shifts of the {len(points)} points of the board.")
