"""The sphere of directions, drawn as two hemispheres in Lambert's equal-area projection."""

import numpy as np

from ..recording import Floats
from .figures import WIDTH, Sheet
from .panel import Panel

SPHERE_HEIGHT = 390.0
"""Height of a figure of two hemispheres in figure units."""


def hemisphere(sheet: Sheet, side: float) -> Panel:
    """Return the panel of the upper (side +1, left) or lower (side -1, right) hemisphere; points as of `lambert`."""
    size, margin, top = 296.0, 42.0, 62.0
    left = 0.0 if side > 0 else WIDTH / 2
    panel = sheet.bare_panel(left=left + margin, top=top, width=size, height=size)
    panel.x.span(-1.43, 1.43)
    panel.y.span(-1.43, 1.43)
    turn = np.linspace(0, 2 * np.pi, 91)
    for polar_deg, color in ((30, "grid"), (60, "grid"), (90, "muted")):
        radius = 2 * np.sin(np.radians(polar_deg) / 2)
        panel.line(radius * np.cos(turn), radius * np.sin(turn), color, clip=False)
    for x, y in ((np.sqrt(2), 0), (0, np.sqrt(2))):
        panel.line(np.array([-x, x]), np.array([-y, y]), "grid")
    centre, y_up = left + margin + size / 2, "+y" if side > 0 else "−y"
    y_down = "−y" if side > 0 else "+y"
    middle = top + size / 2 + 4
    for text, x, y in ((y_up, centre, top - 5), (y_down, centre, top + size + 20)):
        sheet.text(text, x=x, y=y, color="muted", align="center")
    sheet.text("−x", x=left + margin - 5, y=middle, color="muted", align="right")
    sheet.text("+x", x=left + margin + size + 5, y=middle, color="muted")
    sheet.text("Above (z up)" if side > 0 else "Below (z down)", x=left, y=20, color="ink", weight="bold")
    return panel


def lambert(directions: Floats, side: float) -> Floats:
    """Project unit vectors (n, 3) of one hemisphere, seen from outside, to the plane (n, 2); its rim is at √2."""
    with np.errstate(invalid="ignore"):
        stretch = np.sqrt(2 / (1 + np.clip(side * directions[:, 2], 0, 1)))
    return np.stack([directions[:, 0] * stretch, side * directions[:, 1] * stretch], axis=1)
