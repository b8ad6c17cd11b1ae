"""Figures of a camera report over the image and over the views: where corners were seen, and how well views fit."""

from collections.abc import Mapping

import numpy as np

from ..assess.cameras_tables import NOT_CHOSEN
from ..diagnostics import CornerFit
from ..recording import Floats
from . import svg
from .camera_imu_corners import CornerView
from .camera_imu_images import image_panels, images_height
from .figures import TEXT, Sheet, coarser, dots, limits, log_limits, thinned, zigzag
from .numbers import finite, highest, positive
from .panel import DASHED

_DOTS = 1600
_PLACES = ("upper left", "upper middle", "upper right", "middle left", "middle", "middle right",
           "lower left", "lower middle", "lower right")  # fmt: skip
_MUCH_UNSEEN = 0.3
"""Share of a ninth of the image without corners from which it is named."""
_MOST_NAMED = 3


def unseen_places(count: Floats, most: int = _MOST_NAMED) -> list[tuple[int, str]]:
    """Return the ninths of the image that lack most of their corners, the worst first: (index, name).

    Parameters
    ----------
    count : (rows, cols) corners used in each cell of the image
    """
    rows, cols = count.shape
    y = np.minimum(3 * np.arange(rows) // max(rows, 1), 2)
    x = np.minimum(3 * np.arange(cols) // max(cols, 1), 2)
    empty = np.asarray(count == 0, dtype=np.float64)
    share = np.array([_mean(empty[np.ix_(y == i, x == j)]) for i in range(3) for j in range(3)])
    worst = np.argsort(-share, kind="stable")[:most].tolist()
    return [(k, _PLACES[k]) for k in worst if share[k] >= _MUCH_UNSEEN]


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else 0.0


def coverage(views: Mapping[str, CornerView], counts: Mapping[str, Floats]) -> str:
    """Draw the corners used, the cells without any, and where to hold the board next."""
    sheet = Sheet()
    for panel, (name, view) in zip(image_panels(sheet, views), views.items(), strict=True):
        count = counts[name]
        rows, cols = count.shape
        width, height = view.fit.resolution
        size = (width / cols, height / rows)
        y, x = np.nonzero(count == 0)
        corner = np.stack([x * size[0], y * size[1]], axis=1) - 0.5
        panel.cells(corner, size, level=np.full(len(x), 0.25), color="accent")
        kept = np.asarray(view.fit.frame_used, dtype=bool)[view.fit.frame]
        pixels = view.fit.pixels[kept]
        pixels = pixels[:: max(1, -(-len(pixels) // _DOTS))]
        dots(panel, pixels[:, 0], pixels[:, 1], "after", size=2.4)
        for k, _ in unseen_places(count, 1):
            low = np.array([k % 3 * width, k // 3 * height]) / 3 - 0.5
            high = low + np.array([width, height]) / 3
            box = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
            panel.line(box[:, 0], box[:, 1], "accent", width=1.6, dash=DASHED)
            at = (low + high) / 2
            style = svg.text_style("accent", TEXT, "center", bold=True)
            panel.text("next", float(at[0]), float(at[1]), style, offset=(0.0, 4.0))
    return sheet.draw("coverage", images_height(views), "Where in the image of each camera corners were used.")


def view_groups(fit: CornerFit) -> dict[str, np.ndarray]:
    """Return which frames with corners were used, which were not needed, and which were left out as bad, (f,) each."""
    used = np.asarray(fit.frame_used, dtype=bool)
    spare = np.array([reason == NOT_CHOSEN for reason in fit.frame_reason], dtype=bool) & ~used
    seen = np.asarray(fit.frame_corners) > 0
    return {"used": used, "spare": spare & seen, "bad": ~used & ~spare & seen}


def views_over_time(name: str, fit: CornerFit) -> str:
    """Draw the residual of every view over time, those not needed and those left out marked, and its corners."""
    groups = view_groups(fit)
    t, order = fit.frame_t_s, np.argsort(fit.frame_t_s, kind="stable")
    good = fit.frame_rms[groups["used"] | groups["spare"]]
    known = finite(fit.frame_rms)
    wide = known.size > 0 and float(known.max()) > 8 * positive(
        float(np.median(finite(good))) if finite(good).size else 0.0
    )
    sigma = positive(fit.sigma_px, 0.0)
    count = np.asarray(fit.frame_corners, dtype=np.float64)[order]

    sheet = Sheet()
    axes = sheet.panel("rms residual of the view, per axis [px]", top=36, height=200)
    axes.across(sigma, "ink", width=1.4, dash=DASHED)
    for key, color, ring, size in (
        ("used", "after", False, 5.0), ("spare", "heldout", True, 7.0), ("bad", "accent", True, 7.0),
    ):  # fmt: skip
        dots(axes, *thinned(t[groups[key]], fit.frame_rms[groups[key]]), color, ring=ring, size=size)
    if wide:
        log_limits(axes, fit.frame_rms, np.array([sigma]))
    else:
        limits(axes, fit.frame_rms, np.zeros(1))
    below = sheet.panel("Corners in the view", top=294, height=96, x_label="time [s]")
    zigzag(below, *coarser(t[order], count, count, bins=400), "before")
    limits(below, count, np.zeros(1))
    below.y.most = 3
    for panel in (axes, below):
        panel.x.span(0, positive(highest(t)))
    axes.x.labelled = False
    alt = f"rms residual and number of corners of {len(t)} frames of {name}; {int(groups['used'].sum())} were used."
    return sheet.draw(f"views-{name}", 456, alt)
