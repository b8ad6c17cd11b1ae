"""Figures of a camera report that show a lens: angle to radius, straightened, its uncertainty, and models compared."""

from collections.abc import Mapping
from math import degrees

import numpy as np

from ..diagnostics import LensTrial
from ..models.camera import Camera
from . import svg
from .camera_imu_corners import CornerView
from .camera_imu_images import image_panels, images_height
from .cameras_lens import ProjectionSpread, RadialCurve, straightened
from .figures import TEXT, WIDTH, Sheet, dots
from .numbers import finite, highest, number, positive
from .panel import DASHED

_LEVELS = 8
_NUMBERS = (3, 5)
"""Numbers written over an image: down and across; across where it is small, as many as down."""
_ROW, _LEFT, _LEAST = 26.0, 220.0, 150.0
"""Height of a row, where the rows begin, and how high all rows are together at least, for small screens."""


def curve(name: str, found: RadialCurve) -> str:
    """Draw radius over angle with those of an ideal pinhole and of equal angles, and its standard deviation below."""
    angle = np.degrees(found.angle)
    top = 1.06 * positive(highest(found.radius))

    sheet = Sheet()
    axes = sheet.panel("Distance from the image of the axis [px]", top=36, height=230)
    narrow = found.angle < np.radians(85)
    axes.line(angle[narrow], found.focal * np.tan(found.angle[narrow]), "before", width=1.4, dash=DASHED)
    axes.line(angle, found.focal * found.angle, "heldout", width=1.4, dash=DASHED)
    axes.line(angle, found.radius, "after", width=2.2)
    axes.y.span(0, top)
    below = sheet.panel("σ of it [px]", top=324, height=130, x_label="angle to the axis [°]")
    below.band(angle, np.zeros(len(angle)), found.sigma, "after", alpha=0.3)
    below.line(angle, found.sigma, "after", width=1.6)
    below.y.span(0, 1.1 * positive(highest(found.sigma)))
    below.y.most = 4
    for panel in (axes, below):
        panel.x.span(0, angle[-1])
        if found.reach > 0:
            panel.upright(degrees(found.reach), "accent", width=1.4)
        for edge in found.edges[:2]:
            if np.isfinite(edge):
                panel.upright(degrees(edge), "muted", width=1.2, dash=DASHED)
    axes.x.labelled = False
    alt = f"Distance from the image of the optical axis over the angle of the ray, lens of {name}, and its sigma."
    return sheet.draw(f"curve-{name}", 518, alt)


def grid(name: str, camera: Camera) -> str:
    """Draw rows and columns of pixels as they lie when the image is straightened, and the frame of the image."""
    lines = straightened(camera)
    drawn = np.concatenate(lines)
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    width, height = camera.resolution
    frame = np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1), (0, 0)], dtype=np.float64)
    both = np.concatenate([drawn, frame])
    low, high = both.min(axis=0), both.max(axis=0)
    tall = float(np.clip(WIDTH * (high[1] - low[1]) / positive(high[0] - low[0]), 200, 560))
    scale = max((high[0] - low[0]) / (WIDTH - 24), (high[1] - low[1]) / (tall - 24))
    middle = (low + high) / 2

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=tall)
    panel.x.span(middle[0] - scale * WIDTH / 2, middle[0] + scale * WIDTH / 2)
    panel.y.span(middle[1] + scale * tall / 2, middle[1] - scale * tall / 2)
    for line in lines:
        panel.line(line[:, 0], line[:, 1], "after", width=1.1)
    panel.line(frame[:, 0], frame[:, 1], "ink", width=1.6, dash=DASHED)
    sheet.text(f"{width} x {height} px", x=WIDTH, y=tall + 20, color="muted", align="right")
    return sheet.draw(f"grid-{name}", tall + 26, f"The pixels of {name} after its lens was taken off.")


def spread(views: Mapping[str, CornerView], found: Mapping[str, ProjectionSpread]) -> str:
    """Draw the standard deviation of the image of a ray over the image, with numbers; grey where no corners were."""
    values = np.concatenate([finite(one.sigma) for one in found.values()])
    low, high = (float(values.min()), float(values.max())) if values.size and values.min() > 0 else (1.0, 2.0)
    step = np.log(positive(high / low, 2.0)) / _LEVELS or 1.0

    sheet = Sheet()
    for panel, one in zip(image_panels(sheet, views), found.values(), strict=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            level = np.clip((np.floor(np.log(one.sigma / low) / step) + 1) / _LEVELS, 1 / _LEVELS, 1.0)
        for color, shown in (("heldout", one.seen), ("before", ~one.seen)):
            panel.cells(one.corner[shown], one.size, level=0.62 * level[shown], color=color)
        edge = _rim(one)
        panel.line(edge[:, 0], edge[:, 1], "ink", width=1.3, ends="square")
        down, across = _NUMBERS if len(found) == 1 else (_NUMBERS[0],) * 2
        rows, columns = one.shape
        for i in np.linspace(0, rows - 1, 2 * down + 1)[1::2].astype(int).tolist():
            for j in np.linspace(0, columns - 1, 2 * across + 1)[1::2].astype(int).tolist():
                k = i * columns + j
                if np.isfinite(one.sigma[k]):
                    at = one.corner[k] + np.array(one.size) / 2
                    seen = bool(one.seen[k])
                    style = svg.text_style("ink" if seen else "muted", TEXT, "center", bold=seen)
                    text = number(float(one.sigma[k]), 2, trim=False)
                    panel.text(text, float(at[0]), float(at[1]), style, offset=(0.0, 4.0))
    return sheet.draw("spread", images_height(views), "Standard deviation of the image of a ray over the image.")


def _rim(one: ProjectionSpread) -> np.ndarray:
    """Return the edges between cells with corners and cells without, (n, 2) [px], separated by nan."""
    rows, columns = one.shape
    seen = one.seen.reshape(rows, columns)
    width, height = one.size
    lines: list[np.ndarray] = []
    for i, j in zip(*np.nonzero(seen[:, 1:] != seen[:, :-1]), strict=True):
        x = (j + 1) * width - 0.5
        lines.append(np.array([(x, i * height - 0.5), (x, (i + 1) * height - 0.5), (np.nan, np.nan)]))
    for i, j in zip(*np.nonzero(seen[1:] != seen[:-1]), strict=True):
        y = (i + 1) * height - 0.5
        lines.append(np.array([(j * width - 0.5, y), ((j + 1) * width - 0.5, y), (np.nan, np.nan)]))
    return np.concatenate(lines) if lines else np.full((1, 2), np.nan)


def trials(name: str, tried: list[LensTrial]) -> str:
    """Draw the residuals of the lens models that were tried on one camera, held out and used, a row each."""
    height = max(_ROW * len(tried), _LEAST)

    sheet = Sheet()
    panel = sheet.panel("", top=18, height=height, left=_LEFT, right=60, x_label="rms per axis [px]")
    held = np.array([trial.holdout_rms_px for trial in tried])
    used = np.array([trial.rms_px for trial in tried])
    panel.x.span(*_span(np.concatenate([held, used])))
    panel.x.logarithmic, panel.x.grid = True, True
    ticks = [t for t in _TICKS if panel.x.low <= t <= panel.x.high]
    panel.x.ticks = ticks if len(ticks) < 8 else [t for t in ticks if f"{t:e}"[0] in "125" and f"{t:e}"[2] == "0"]
    panel.y.logarithmic, panel.y.grid, panel.y.ticks = False, False, ()
    panel.y.span(len(tried), 0)
    y = np.arange(0.5, len(tried))
    for row, place in enumerate(y.tolist()):
        panel.line(np.array([held[row], used[row]]), np.full(2, place), "grid", width=2.0)
    dots(panel, used, y, "before", size=13.0, ring=True)
    dots(panel, held, y, "after", size=7.0)
    for trial, place in zip(tried, y, strict=True):
        at = float(panel.y.places(np.array(place))) + 4.0
        weight = "bold" if trial.chosen else "normal"
        text = trial.model + ("" if np.isfinite(trial.holdout_rms_px) else " (no fit)")
        sheet.text(text, x=0, y=at, color="ink", weight=weight)
    return sheet.draw(f"trials-{name}", height + 78, f"Held-out residuals of {len(tried)} lens models of {name}.")


_TICKS = [step * 10.0**k for k in range(-3, 4) for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)]


def _span(values: np.ndarray) -> tuple[float, float]:
    known = finite(values)
    known = known[known > 0]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.1, 1.0)
    return 0.8 * low, max(1.25 * high, 2.0 * low)
