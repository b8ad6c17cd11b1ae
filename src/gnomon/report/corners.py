"""The corners of cameras: residuals, sums over the image, and what both camera pages say of them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np

from ..recording import Floats, Integers
from ..results.camera_diagnostics import CornerFit
from . import corner_figures as figures
from .numbers import (
    fixed_text,
    largest_magnitude,
    number_text,
    positive_or,
)
from .page import (
    Figure,
    Legend,
    ReportTable,
)

FIELD_COLUMNS, DENSITY_COLUMNS = 12, 32
"""Cells across the image for mean residuals, and for counts."""
_FEWEST = 8
"""Corners that a mean residual needs."""
_ENOUGH = 100_000
"""Numbers from which a quantile is taken."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    edges = figures.time_spans(t)
    decimals = 0 if edges[-1] - edges[0] > 20 else 1
    return tuple(
        Legend("dot", color, f"{fixed_text(float(a), decimals)}–{fixed_text(float(b), decimals)} s")
        for color, a, b in zip(figures.TIMES, edges[:-1], edges[1:], strict=True)
    )


def corner_scatter(name: str, view: CornerView) -> Figure:
    """Return the residuals of one camera: their distributions, and their scatter."""
    fit = view.fit
    outside = int((np.fmax(*np.abs(view.residual.T)) > view.reach).sum())
    beyond = f", {outside} lie outside of what is drawn" if outside else ""
    step = figures.scatter_step(view)
    share = f" The scatter shows one {view.word} in {step}." if step > 1 else ""
    normal = Legend("dash", "ink", f"normal, σ = {number_text(fit.sigma_px, 3)} px")
    along = (Legend("line", "x", "u"), Legend("line", "y", "v"))
    return Figure(
        f"{view.word.capitalize()}s of {name}",
        figures.corner_residuals(name, view),
        (*along, normal, *time_legends(view.t_s)),
        f"Predicted minus detected, of {len(view.residual)} {view.word}s; circles at 1, 2 and 3σ. "
        f"{view.weighed_down} fit less well and were weighed down{beyond}.{share}",
    )


def frames_figure(name: str, view: CornerView, word: str = "frame") -> Figure:
    """Return how well every frame fits, over time; `word` is what a frame is called."""
    groups = {key: int(found.sum()) for key, found in figures.view_groups(view.fit).items()}
    empty = int((np.asarray(view.fit.frame_corners) == 0).sum()) if word == "frame" else 0
    total = sum(groups.values()) + empty
    legend = [Legend("dot", "after", "used")]
    legend += [Legend("ring", "heldout", "not needed")] * bool(groups["spare"])
    legend += [Legend("ring", "accent", "left out")] * bool(groups["bad"])
    return Figure(
        f"{word.capitalize()}s of {name}",
        figures.frames_over_time(name, view.fit, word, view.word),
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
        figures.draw_residual_field(views),
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
