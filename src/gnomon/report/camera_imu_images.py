"""Figures of a camera-IMU report that show the corners: in the image, over the frames, and their residuals."""

from collections.abc import Mapping

import numpy as np

from ..diagnostics import CornerFit
from ..recording import Floats
from . import svg
from .camera_imu_corners import CornerView, field_magnification
from .camera_imu_signals import half_panel, histograms
from .figures import RIGHT, WIDTH, Sheet, coarser, dots, limits, log_limits, thinned, zigzag
from .numbers import finite, highest, positive
from .panel import DASHED, Panel

TIMES = ("t1", "t2", "t3", "t4", "t5")
"""Inks of five equal spans of time."""
_DOTS = 1500
_LEAST_MATRIX = 200.0
"""Side of a matrix of few parameters, so that a small screen shows it as well."""


def corner_residuals(name: str, view: CornerView) -> str:
    """Draw the histogram of the residuals of one camera, and their scatter coloured by time."""
    residual, reach, sigma = view.residual, view.reach, positive(view.fit.sigma_px, 0.0)

    sheet = Sheet()
    axes = half_panel(sheet, "Density", 0, top=36, height=314)
    histograms(axes, [(residual[:, 0], "x"), (residual[:, 1], "y")], reach=reach, sigma=sigma)
    sheet.text("residual [px]", x=WIDTH / 2 - 14, y=400, color="muted", align="right")
    scatter = half_panel(sheet, "Scatter, v over u [px]", 1, top=36, height=314)
    scatter.x.grid = True
    _scatter(scatter, view)
    turn = np.linspace(0, 2 * np.pi, 73)
    for radius in (sigma, 2 * sigma, 3 * sigma):
        scatter.line(radius * np.cos(turn), radius * np.sin(turn), "ink")
    scatter.x.span(-reach, reach)
    scatter.y.span(reach, -reach)  # v points down, as in the image
    alt = f"Residuals of {len(residual)} corners of {name}: histograms along u and v, and a scatter coloured by time."
    return sheet.draw(f"corners-{name}", 410, alt)


def _scatter(panel: Panel, view: CornerView) -> None:
    """Draw an even choice of the corners, coloured by time."""
    chosen = np.arange(0, len(view.residual), scatter_step(view))
    chosen = chosen[np.fmax(*np.abs(view.residual[chosen].T)) < view.reach]
    spans = time_spans(view.t_s)
    span = np.clip(np.searchsorted(spans, view.t_s[chosen], side="right") - 1, 0, len(TIMES) - 1)
    for i, color in enumerate(TIMES):
        here = view.residual[chosen[span == i]]
        dots(panel, here[:, 0], here[:, 1], color, size=3.2)


def scatter_step(view: CornerView) -> int:
    """Return how many corners each dot of the scatter stands for."""
    return max(1, -(-len(view.residual) // _DOTS))


def time_spans(t: Floats) -> Floats:
    """Return the six edges of five equal spans of time [s]."""
    known = finite(t)
    return np.linspace(known.min(), known.max(), len(TIMES) + 1) if known.size else np.linspace(0, 1, len(TIMES) + 1)


def frames(name: str, fit: CornerFit) -> str:
    """Draw the residual of every frame over time, those left out marked, and the number of corners in it."""
    used = np.asarray(fit.frame_used, dtype=bool)
    t = fit.frame_t_s
    order = np.argsort(t, kind="stable")
    known = finite(fit.frame_rms)
    wide = known.size > 0 and float(known.max()) > 8 * float(np.median(known))
    sigma = positive(fit.sigma_px, 0.0)

    sheet = Sheet()
    axes = sheet.panel("rms residual of the frame [px]", top=36, height=190)
    axes.across(sigma, "ink", width=1.4, dash=DASHED)
    for chosen, color, ring, size in ((used, "after", False, 4.0), (~used, "accent", True, 7.0)):
        dots(axes, *thinned(t[chosen], fit.frame_rms[chosen]), color, ring=ring, size=size)
    if wide:
        log_limits(axes, fit.frame_rms, np.array([sigma]))
    else:
        limits(axes, fit.frame_rms, np.zeros(1))
    below = sheet.panel("Corners in the frame", top=284, height=96, x_label="time [s]")
    count = np.asarray(fit.frame_corners, dtype=np.float64)[order]
    zigzag(below, *coarser(t[order], count, count, bins=400), "before")
    limits(below, count, np.zeros(1))
    below.y.most = 3
    for panel in (axes, below):
        panel.x.span(0, positive(highest(t)))
    axes.x.labelled = False
    alt = f"rms residual and number of corners of {len(t)} frames of {name}; {int((~used).sum())} were left out."
    return sheet.draw(f"frames-{name}", 446, alt)


def image_panels(sheet: Sheet, views: Mapping[str, CornerView]) -> list[Panel]:
    """Return panels in pixels, one per camera: a single image large, several in two columns."""
    panels: list[Panel] = []
    top = 36.0
    for k, (name, view) in enumerate(views.items()):
        alone = len(views) == 1
        left = 60.0 if alone else 56.0 + (k % 2) * WIDTH / 2
        width, height = _image_size(view, alone=alone)
        panel = sheet.panel("", top=top, height=height, left=left, right=WIDTH - left - width)
        sheet.text("Image [px]" if alone else f"{name} [px]", x=0 if alone else left - 56, y=top - 18, color="ink",
                   weight="bold")  # fmt: skip
        panel.y.grid = False
        panel.frame = ("left", "right", "top", "bottom")
        panel.x.span(-0.5, view.fit.resolution[0] - 0.5)
        panel.y.span(view.fit.resolution[1] - 0.5, -0.5)
        panel.x.most, panel.y.most = (5, 5) if alone else (4, 3)
        panels.append(panel)
        if k % 2:
            top += height + 92
    return panels


def _image_size(view: CornerView, *, alone: bool) -> tuple[float, float]:
    width = WIDTH - 60 - RIGHT - 70 if alone else WIDTH / 2 - 70
    return width, width * view.fit.resolution[1] / view.fit.resolution[0]


def images_height(views: Mapping[str, CornerView]) -> float:
    """Return the height of a sheet of image panels."""
    alone = len(views) == 1
    heights = [_image_size(view, alone=alone)[1] for view in views.values()]
    rows = [max(heights[i : i + 2]) for i in range(0, len(heights), 2)]
    return 36 + sum(rows) + 92 * (len(rows) - 1) + 44


def density(views: Mapping[str, CornerView]) -> str:
    """Draw how many corners were seen where in the image."""
    sheet = Sheet()
    for panel, view in zip(image_panels(sheet, views), views.values(), strict=True):
        grid = view.density
        level = np.sqrt(grid.count / max(grid.count.max(), 1.0))
        panel.cells(grid.corner, grid.size, level=level, color="after")
    return sheet.draw("density", images_height(views), "Density of the corners over the image of each camera.")


def field(views: Mapping[str, CornerView]) -> str:
    """Draw the mean residual over the image, as arrows."""
    longer = field_magnification(views)

    sheet = Sheet()
    for panel, view in zip(image_panels(sheet, views), views.values(), strict=True):
        known = np.isfinite(view.field.mean).all(axis=1)
        centre = view.field.corner[known] + np.array(view.field.size) / 2
        arrows(panel, centre, longer * view.field.mean[known])
    return sheet.draw("field", images_height(views), "Mean residual of the corners over the image, as arrows.")


def arrows(panel: Panel, start: Floats, along: Floats, color: str = "after") -> None:
    """Draw arrows as one path."""
    back = np.array([[-0.3, 0.14], [-0.3, -0.14]])
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    tip = start + along
    barbs = [tip + b[0] * along + b[1] * aside for b in back]
    gap = np.full_like(start, np.nan)
    line = np.stack([start, tip, gap, barbs[0], tip, barbs[1], gap], axis=1).reshape(-1, 2)
    panel.line(line[:, 0], line[:, 1], color, width=1.5, clip=False)


def correlation(labels: list[tuple[str, list[str]]], matrix: Floats) -> str:
    """Draw a correlation matrix; labels are groups of parameters: (name of the group, names of its entries)."""
    count = len(matrix)
    left = 232.0
    pitch = min((WIDTH - left - RIGHT) / max(count, 1), max(24.0, _LEAST_MATRIX / max(count, 1)))
    size = pitch * count

    sheet = Sheet()
    panel = sheet.panel("", top=20, height=size, left=left, right=WIDTH - left - size)
    panel.x.span(0, count)
    panel.y.span(count, 0)
    panel.x.ticks = panel.y.ticks = ()
    y, x = np.divmod(np.arange(count * count), count)
    corners = np.stack([x, y], axis=1).astype(np.float64)
    values = np.where(x == y, 0.0, np.nan_to_num(matrix.ravel()))
    for sign, color in ((1, "after"), (-1, "heldout")):
        strength = np.where(sign * values >= 0.05, sign * values, 0.0)
        panel.cells(corners, (1.0, 1.0), level=strength, color=color)
    panel.cells(corners[x == y], (1.0, 1.0), level=np.ones(count), color="grid")
    _separate(panel, labels, count)
    _name_groups(sheet, labels, left - 26, pitch)
    row = 0
    for _, entries in labels:
        for entry in entries if pitch >= 8 else ():
            y = row + entries.index(entry) + 0.5
            font = min(10.0, 0.8 * pitch)
            style = svg.text_style("muted", font, "right")
            panel.text(entry, 0, y, style, offset=(-5, svg.MIDDLE * font), fine=True)
        row += len(entries)
    strongest = highest(np.abs(matrix[~np.eye(count, dtype=bool)]))
    alt = f"Correlation matrix of {count} parameters; the strongest correlation is {strongest:.2f}."
    return sheet.draw("correlation", size + 30, alt)


def _separate(panel: Panel, labels: list[tuple[str, list[str]]], count: int) -> None:
    """Draw lines between groups."""
    for edge in np.cumsum([len(entries) for _, entries in labels])[:-1].tolist():
        x, y = np.array([0, count, np.nan, edge, edge]), np.array([edge, edge, np.nan, 0, count])
        panel.line(x, y, "muted", width=0.7, alpha=0.5)


def _name_groups(sheet: Sheet, labels: list[tuple[str, list[str]]], right: float, pitch: float) -> None:
    """Write the name of each group at its middle, where there is room for it."""
    row, free_from = 0, 0.0
    for name, entries in labels:
        middle = 20 + pitch * (row + len(entries) / 2) + 4
        if middle >= free_from:
            sheet.text(name, x=right, y=middle, color="ink", align="right")
            free_from = middle + 13
        row += len(entries)
