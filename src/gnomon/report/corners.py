"""Corners of a camera in figures: in the image, over the frames, their residuals, and the frames left out."""

import re
from collections.abc import Mapping
from math import isfinite

import numpy as np

from ..assess.cameras.cameras_tables import NOT_CHOSEN
from ..frozen import value_class
from ..recording import Floats, Integers
from ..results.camera_diagnostics import CornerFit
from .drawing.figures import (
    RIGHT,
    TEXT,
    WIDTH,
    Plot,
    Sheet,
    coarsen_envelope,
    draw_dots,
    draw_envelope,
    draw_histograms,
    half_panel,
    log_limits,
    set_y_limits,
    thin_points,
)
from .drawing.panel import DASHED, Panel, TextStyle
from .numbers import finite_values, fixed_text, highest_finite, largest_magnitude, number_text, positive_or
from .page import Figure, Legend, ReportTable

FIELD_COLUMNS, DENSITY_COLUMNS = 12, 32
"""Cells across the image for mean residuals, and for counts."""
_FEWEST = 8
"""Corners that a mean residual needs."""
_ENOUGH = 100_000
"""Numbers from which a quantile is taken."""


@value_class
class ImageGrid:
    """Cells over an image, row by row.

    Attributes
    ----------
    corner : (n, 2) upper left corners [px]
    size : width and height of a cell [px]
    count : (n,) corners used
    mean : (n, 2) their mean residual [px]; nan where there are too few
    """

    corner: Floats
    size: tuple[float, float]
    count: Floats
    mean: Floats


@value_class
class CornerView:
    """Corners of frames that were used, and that have a residual.

    Attributes
    ----------
    fit : where they come from
    residual : (k, 2) predicted minus detected [px]
    t_s : (k,) [s]
    weighed_down : number of corners whose robust weight is below one
    reach : how far residuals are drawn [px]: four to six sigma, nearly all corners
    density, field : over the image, in fine and in coarse cells
    word : what each is called
    """

    fit: CornerFit
    residual: Floats
    t_s: Floats
    weighed_down: int
    reach: float
    density: ImageGrid
    field: ImageGrid
    word: str = "corner"


def corner_view(fit: CornerFit, word: str = "corner") -> CornerView:
    """Return the corners of a camera, or whatever `word` is seen instead, as the figures need them."""
    kept = np.asarray(fit.frame_used, dtype=bool)[fit.frame]
    for part in (fit.residual, fit.pixels):
        kept &= np.isfinite(part[:, 0]) & np.isfinite(part[:, 1])
    residual, pixels = fit.residual[kept], fit.pixels[kept]
    sizes = np.abs(residual[:: max(1, len(residual) // _ENOUGH)])
    wanted = 1.05 * float(np.quantile(sizes, 0.999)) if sizes.size else 0.0
    sigma = positive_or(fit.sigma_px, 0.0)
    return CornerView(
        fit=fit,
        residual=residual,
        t_s=fit.frame_t_s[fit.frame[kept]],
        weighed_down=int((np.asarray(fit.weight)[kept] < 1).sum()),
        reach=positive_or(float(np.clip(wanted, 4 * sigma, 6 * sigma)), positive_or(wanted)),
        density=_grid(pixels, residual, fit.resolution, DENSITY_COLUMNS),
        field=_grid(pixels, residual, fit.resolution, FIELD_COLUMNS),
        word=word,
    )


def _grid(pixels: Floats, residual: Floats, resolution: tuple[int, int], columns: int) -> ImageGrid:
    width, height = resolution
    rows = max(1, round(columns * height / width))
    size = (width / columns, height / rows)
    column = _cell(pixels[:, 0], size[0], columns)
    place = _cell(pixels[:, 1], size[1], rows) * columns + column
    count = np.bincount(place, minlength=columns * rows).astype(np.float64)
    sums = [np.bincount(place, residual[:, i], minlength=columns * rows) for i in range(2)]
    mean = np.stack(sums, axis=1) / np.where(count < _FEWEST, np.nan, count)[:, None]
    y, x = np.divmod(np.arange(columns * rows), columns)
    corner = np.stack([x * size[0] - 0.5, y * size[1] - 0.5], axis=1)  # pixel 0 reaches from -0.5 to 0.5
    return ImageGrid(corner=corner, size=size, count=count, mean=mean)


def _cell(pixel: Floats, size: float, cells: int) -> Integers:
    return np.clip((pixel + 0.5) / size, 0, cells - 1).astype(np.int64)


def field_magnification(views: Mapping[str, CornerView]) -> float:
    """Return by how much the arrows of all cameras are lengthened: a long one spans most of a cell."""
    wanted: list[float] = []
    for view in views.values():
        size = np.hypot(*view.field.mean.T)
        size = size[np.isfinite(size)]
        if size.size and float(np.quantile(size, 0.95)) > 0:
            wanted.append(0.75 * view.field.size[0] / float(np.quantile(size, 0.95)))
    least = min(wanted, default=1.0)
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * max(step for step in (1, 1.5, 2, 3, 4, 5, 6, 8) if step * power <= least * 1.0001))


_MOST_ROWS = 60


def time_legends(t: Floats) -> tuple[Legend, ...]:
    """Return the inks of five equal spans of time."""
    edges = time_spans(t)
    decimals = 0 if edges[-1] - edges[0] > 20 else 1
    return tuple(
        Legend("dot", color, f"{fixed_text(float(a), decimals)}–{fixed_text(float(b), decimals)} s")
        for color, a, b in zip(TIMES, edges[:-1], edges[1:], strict=True)
    )


def corner_scatter(name: str, view: CornerView) -> Figure:
    """Return the residuals of one camera: their distributions, and their scatter."""
    fit = view.fit
    outside = int((np.fmax(*np.abs(view.residual.T)) > view.reach).sum())
    beyond = f", {outside} lie outside of what is drawn" if outside else ""
    step = scatter_step(view)
    share = f" The scatter shows one {view.word} in {step}." if step > 1 else ""
    normal = Legend("dash", "ink", f"normal, σ = {number_text(fit.sigma_px, 3)} px")
    along = (Legend("line", "x", "u"), Legend("line", "y", "v"))
    return Figure(
        f"{view.word.capitalize()}s of {name}",
        corner_residuals(name, view),
        (*along, normal, *time_legends(view.t_s)),
        f"Predicted minus detected, of {len(view.residual)} {view.word}s; circles at 1, 2 and 3σ. "
        f"{view.weighed_down} fit less well and were weighed down{beyond}.{share}",
    )


def frames_figure(name: str, view: CornerView, word: str = "frame") -> Figure:
    """Return how well every frame fits, over time; `word` is what a frame is called."""
    groups = {key: int(found.sum()) for key, found in view_groups(view.fit).items()}
    empty = int((np.asarray(view.fit.frame_corners) == 0).sum()) if word == "frame" else 0
    total = sum(groups.values()) + empty
    legend = [Legend("dot", "after", "used")]
    legend += [Legend("ring", "heldout", "not needed")] * bool(groups["spare"])
    legend += [Legend("ring", "accent", "left out")] * bool(groups["bad"])
    return Figure(
        f"{word.capitalize()}s of {name}",
        frames_over_time(name, view.fit, word, view.word),
        (*legend, Legend("dash", "ink", f"σ of a {view.word}")),
        f"{groups['used']} of {total} {word}s were used."
        + (f" {empty} show no {view.word}." if empty else "")
        + (
            " The others have a pose of their own and the lens of these."
            if groups["spare"] + groups["bad"] and word == "view"
            else ""
        ),
    )


def field_figure(views: dict[str, CornerView]) -> Figure:
    """Return the mean residual over the images, as arrows."""
    longer = field_magnification(views)
    worst = {name: largest_magnitude(np.hypot(*view.field.mean.T)) for name, view in views.items()}
    longest = "; ".join(f"{name} {number_text(size, 2)} px" for name, size in worst.items() if isfinite(size))
    word = next(iter(views.values())).word
    return Figure(
        "Mean residual over the image",
        draw_residual_field(views),
        caption=f"Arrows from the detected {word}s to the predicted ones, {number_text(longer)} times as long as "
        "they are. "
        "A swirl, or arrows that all point outwards or inwards, speak of intrinsics or a lens model that do not fit "
        "this camera." + (f" The longest: {longest}." if longest else ""),
    )


def frames_left_out(corners: dict[str, CornerFit], title: str = "Frames that were left out") -> list[ReportTable]:
    """Return the reasons for not using frames, each with a count and the first times."""
    rows: list[tuple[str, ...]] = []
    for name, fit in corners.items():
        groups: dict[str, list[tuple[float, str]]] = {}
        for t, used, reason in zip(fit.frame_t_s.tolist(), fit.frame_used, fit.frame_reason, strict=True):
            if not used:
                # Reasons that differ in their numbers alone are one.
                groups.setdefault(re.sub(r"\d+(\.\d+)?", "…", reason), []).append((t, reason))
        for pattern, found in groups.items():
            alike = len({reason for _, reason in found}) == 1
            reason = (found[0][1] if alike else pattern) or "no reason given"
            times = ", ".join(fixed_text(t, 2) for t, _ in found[:6]) + (" …" if len(found) > 6 else "")
            rows.append((f"{name}: {reason}", str(len(found)), times))
    if not rows:
        return []
    more = len(rows) - _MOST_ROWS
    return [
        ReportTable(
            title,
            ("reason", title.split(maxsplit=1)[0].lower(), "at [s]"),
            tuple(rows[:_MOST_ROWS]),
            f"And {more} more reasons." if more > 0 else "",
            prose=True,
        )
    ]


TIMES = ("t1", "t2", "t3", "t4", "t5")
"""Inks of five equal spans of time."""
_DOTS = 1500


def corner_residuals(name: str, view: CornerView) -> Plot:
    """Draw the histogram of the residuals of one camera, and their scatter coloured by time."""
    residual, reach, sigma = view.residual, view.reach, positive_or(view.fit.sigma_px, 0.0)

    sheet = Sheet()
    axes = half_panel(sheet, "Density", 0, top=36, height=314)
    draw_histograms(axes, [(residual[:, 0], "x"), (residual[:, 1], "y")], reach=reach, sigma=sigma)
    sheet.text("residual [px]", x=WIDTH / 2 - 14, y=400, color="muted", align="right")
    scatter = half_panel(sheet, "Scatter, v over u [px]", 1, top=36, height=314)
    scatter.x.grid = True
    _scatter(scatter, view)
    turn = np.linspace(0, 2 * np.pi, 73)
    for radius in (sigma, 2 * sigma, 3 * sigma):
        scatter.line(radius * np.cos(turn), radius * np.sin(turn), "ink")
    scatter.x.span(-reach, reach)
    scatter.y.span(reach, -reach)  # v points down, as in the image
    alt = f"Residuals of {len(residual)} {view.word}s of {name}: histograms along u and v, a scatter coloured by time."
    return sheet.draw(f"corners-{name}", 410, alt)


def _scatter(panel: Panel, view: CornerView) -> None:
    """Draw an even choice of the corners, coloured by time."""
    chosen = np.arange(0, len(view.residual), scatter_step(view))
    chosen = chosen[np.fmax(*np.abs(view.residual[chosen].T)) < view.reach]
    spans = time_spans(view.t_s)
    span = np.clip(np.searchsorted(spans, view.t_s[chosen], side="right") - 1, 0, len(TIMES) - 1)
    for i, color in enumerate(TIMES):
        here = view.residual[chosen[span == i]]
        draw_dots(panel, here[:, 0], here[:, 1], color, size=3.2)


def scatter_step(view: CornerView) -> int:
    """Return how many corners each dot of the scatter stands for."""
    return max(1, -(-len(view.residual) // _DOTS))


def time_spans(t: Floats) -> Floats:
    """Return the six edges of five equal spans of time [s]."""
    known = finite_values(t)
    return np.linspace(known.min(), known.max(), len(TIMES) + 1) if known.size else np.linspace(0, 1, len(TIMES) + 1)


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


def draw_corner_density(views: Mapping[str, CornerView]) -> Plot:
    """Draw how many corners were seen where in the image."""
    sheet = Sheet()
    for panel, view in zip(image_panels(sheet, views), views.values(), strict=True):
        grid = view.density
        level = np.sqrt(grid.count / max(grid.count.max(), 1.0))
        panel.cells(grid.corner, grid.size, level=level, color="after")
    return sheet.draw("density", images_height(views), "Density of the corners over the image of each camera.")


def draw_residual_field(views: Mapping[str, CornerView]) -> Plot:
    """Draw the mean residual over the image, as arrows."""
    longer = field_magnification(views)

    sheet = Sheet()
    for panel, view in zip(image_panels(sheet, views), views.values(), strict=True):
        known = np.isfinite(view.field.mean).all(axis=1)
        centre = view.field.corner[known] + np.array(view.field.size) / 2
        draw_arrows(panel, centre, longer * view.field.mean[known])
        _draw_scale(panel, longer)
    return sheet.draw("field", images_height(views), "Mean residual of the corners over the image, as arrows.")


def draw_arrows(panel: Panel, start: Floats, along: Floats, color: str = "after") -> None:
    """Draw arrows as one path."""
    back = np.array([[-0.3, 0.14], [-0.3, -0.14]])
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    tip = start + along
    barbs = [tip + b[0] * along + b[1] * aside for b in back]
    gap = np.full_like(start, np.nan)
    line = np.stack([start, tip, gap, barbs[0], tip, barbs[1], gap], axis=1).reshape(-1, 2)
    panel.line(line[:, 0], line[:, 1], color, width=1.5, clip=False)


def _draw_scale(panel: Panel, longer: float) -> None:
    """Draw a bar of a round length above the right end of an image, as long as arrows of that length are [px]."""
    right, above = panel.x.high, panel.y.high - 0.03 * (panel.y.low - panel.y.high)
    widest = 0.15 * (right - panel.x.low) / longer
    power = 10.0 ** np.floor(np.log10(widest))
    size = max(step * power for step in (1, 2, 5) if step * power <= widest)
    ends, tick = np.array([right - longer * size, right]), np.full(2, above)
    panel.line(ends, tick, "after", width=1.5, clip=False)
    style = TextStyle(color="muted", size=TEXT, align="right")
    panel.text(f"arrow of {size:g} px", float(ends[0]), above, style, offset=(-6.0, 4.0))


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


def draw_corner_coverage(views: Mapping[str, CornerView], counts: Mapping[str, Floats]) -> Plot:
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
        draw_dots(panel, pixels[:, 0], pixels[:, 1], "after", size=2.4)
        for k, _ in unseen_places(count, 1):
            low = np.array([k % 3 * width, k // 3 * height]) / 3 - 0.5
            high = low + np.array([width, height]) / 3
            box = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
            panel.line(box[:, 0], box[:, 1], "accent", width=1.6, dash=DASHED)
            at = (low + high) / 2
            style = TextStyle(color="accent", size=TEXT, align="center", bold=True)
            panel.text("next", float(at[0]), float(at[1]), style, offset=(0.0, 4.0))
    return sheet.draw("coverage", images_height(views), "Where in the image of each camera corners were used.")


def view_groups(fit: CornerFit) -> dict[str, np.ndarray]:
    """Return which frames with corners were used, which were not needed, and which were left out as bad, (f,) each."""
    used = np.asarray(fit.frame_used, dtype=bool)
    spare = np.array([reason == NOT_CHOSEN for reason in fit.frame_reason], dtype=bool) & ~used
    seen = np.asarray(fit.frame_corners) > 0
    return {"used": used, "spare": spare & seen, "bad": ~used & ~spare & seen}


def frames_over_time(name: str, fit: CornerFit, word: str, point: str = "corner") -> Plot:
    """Draw the residual of every frame over time, those not needed and those left out marked, and its points."""
    groups = view_groups(fit)
    t, order = fit.frame_t_s, np.argsort(fit.frame_t_s, kind="stable")
    good = fit.frame_rms[groups["used"] | groups["spare"]]
    known = finite_values(fit.frame_rms)
    wide = known.size > 0 and float(known.max()) > 8 * positive_or(
        float(np.median(finite_values(good))) if finite_values(good).size else 0.0
    )
    sigma = positive_or(fit.sigma_px, 0.0)
    count = np.asarray(fit.frame_corners, dtype=np.float64)[order]

    sheet = Sheet()
    axes = sheet.panel(f"rms residual of the {word}, per axis [px]", top=36, height=200)
    axes.across(sigma, "ink", width=1.4, dash=DASHED)
    for key, color, ring, size in (
        ("used", "after", False, 5.0), ("spare", "heldout", True, 7.0), ("bad", "accent", True, 7.0),
    ):  # fmt: skip
        draw_dots(axes, *thin_points(t[groups[key]], fit.frame_rms[groups[key]]), color, ring=ring, size=size)
    if wide:
        log_limits(axes, fit.frame_rms, np.array([sigma]))
    else:
        set_y_limits(axes, fit.frame_rms, np.zeros(1))
    below = sheet.panel(f"{point.capitalize()}s in the {word}", top=294, height=96, x_label="time [s]")
    draw_envelope(below, *coarsen_envelope(t[order], count, count, bins=400), "before")
    set_y_limits(below, count, np.zeros(1))
    below.y.most = 3
    for panel in (axes, below):
        panel.x.span(0, positive_or(highest_finite(t)))
        panel.x.timed = True
    axes.x.labelled = False
    alt = f"rms residual and number of {point}s of {len(t)} frames of {name}; {int(groups['used'].sum())} were used."
    return sheet.draw(f"{word}s-{name}", 456, alt)
