"""The sphere of directions, drawn as two hemispheres in Lambert's equal-area projection."""

from typing import TYPE_CHECKING

import numpy as np

from ..recording import Floats
from .figures import WIDTH, Sheet, ink

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPHERE_HEIGHT = 390.0
"""Height of a figure of two hemispheres in figure units."""


def hemisphere(sheet: Sheet, side: float) -> "Axes":
    """Return the axes of the upper (side +1, left) or the lower (side -1, right) hemisphere; points as of `lambert`."""
    size, margin, top = 296.0, 42.0, 62.0
    left = 0.0 if side > 0 else WIDTH / 2
    box = ((left + margin) / WIDTH, 1 - (top + size) / sheet.height, size / WIDTH, size / sheet.height)
    axes = sheet.figure.add_axes(box)
    axes.set_axis_off()
    axes.set_xlim(-1.43, 1.43)
    axes.set_ylim(-1.43, 1.43)
    turn = np.linspace(0, 2 * np.pi, 91)
    for polar_deg, color in ((30, "grid"), (60, "grid"), (90, "muted")):
        radius = 2 * np.sin(np.radians(polar_deg) / 2)
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=ink(color), linewidth=1)
    for x, y in ((np.sqrt(2), 0), (0, np.sqrt(2))):
        axes.plot([-x, x], [-y, y], color=ink("grid"), linewidth=1)
    centre, y_up = left + margin + size / 2, "+y" if side > 0 else "−y"
    y_down = "−y" if side > 0 else "+y"
    middle = top + size / 2 + 4
    for text, x, y in ((y_up, centre, top - 5), (y_down, centre, top + size + 20)):
        sheet.text(text, x=x, y=y, color="muted", align="center")
    sheet.text("−x", x=left + margin - 5, y=middle, color="muted", align="right")
    sheet.text("+x", x=left + margin + size + 5, y=middle, color="muted")
    sheet.text("Above (z up)" if side > 0 else "Below (z down)", x=left, y=20, color="ink", weight="bold")
    return axes


def lambert(directions: Floats, side: float) -> Floats:
    """Project unit vectors (n, 3) of one hemisphere, seen from outside, to the plane (n, 2); its rim is at √2."""
    with np.errstate(invalid="ignore"):
        stretch = np.sqrt(2 / (1 + np.clip(side * directions[:, 2], 0, 1)))
    return np.stack([directions[:, 0] * stretch, side * directions[:, 1] * stretch], axis=1)
