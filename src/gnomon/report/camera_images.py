"""The section of camera pages on the images themselves: blur, exposure, and how certain the corners are."""

from math import isfinite

import numpy as np

from ..recording import Floats, FrameQuality
from ..results.camera_diagnostics import CornerFit
from .drawing.figures import (
    WIDTH,
    Plot,
    Sheet,
    coarsen_envelope,
    draw_dots,
    draw_envelope,
    half_panel,
    set_y_limits,
    thin_points,
)
from .drawing.panel import DASHED, Panel
from .numbers import finite_values, fixed_text, highest_finite, number_text, positive_or
from .page import Figure, Legend, ReportTable, Section

_BLURRED_PX, _BRIGHT = 1.5, 250.0  # as assess.image_checks has them, and says why
_GROUPS = 8
_FEWEST = 400
"""Corners that a comparison with their residuals needs."""


def images_section(corners: dict[str, CornerFit]) -> Section | None:
    """Return what the images were like; None where the corners were not found in images here."""
    known = {name: fit for name, fit in corners.items() if fit.quality is not None}
    if not known:
        return None
    blocks: list[Figure | ReportTable] = []
    for name, fit in known.items():
        assert fit.quality is not None
        blocks.append(_over_time(name, fit, fit.quality))
        certain = _certainty(name, fit)
        blocks += [] if certain is None else [certain]
    blocks.append(_numbers(known))
    blocks += _dropped(known)
    return Section(
        "images",
        "Images",
        "Sharp, evenly lit images give certain corners. Blur is the standard deviation by which the edges at "
        "the corners are spread; a focused lens and a still camera have 0.5 to 0.8 px.",
        blocks,
    )


def _over_time(name: str, fit: CornerFit, quality: FrameQuality) -> Figure:
    seen = int(np.isfinite(quality.blur_px).sum())
    return Figure(
        f"Images of {name}",
        over_time(name, fit, quality),
        (
            Legend("dot", "after", "blur of a frame"),
            Legend("line", "accent", "the board's white"),
            Legend("line", "before", "its black"),
            Legend("dash", "muted", f"{_BLURRED_PX:g} px; {_BRIGHT:.0f}, where white is clipped"),
        ),
        f"The board was found in {seen} of {len(quality.blur_px)} frames. Beyond {_BLURRED_PX:g} px of blur an "
        "edge is four pixels wide, and corners get lost.",
    )


def over_time(name: str, fit: CornerFit, quality: FrameQuality) -> Plot:
    """Draw blur, exposure and number of corners of every frame over time."""
    order = np.argsort(fit.frame_t_s, kind="stable")
    t = fit.frame_t_s[order]
    blur, black, white = (getattr(quality, key)[order] for key in ("blur_px", "black", "white"))
    count = np.asarray(fit.frame_corners, dtype=np.float64)[order]

    sheet = Sheet()
    panels = [
        sheet.panel("Blur [px]", top=36, height=150),
        sheet.panel("Grey levels", top=240, height=110),
        sheet.panel("Corners in the frame", top=404, height=90, x_label="time [s]"),
    ]
    _level(panels[0], _BLURRED_PX)
    draw_dots(panels[0], *thin_points(t, blur), "after", size=4.0)
    set_y_limits(panels[0], blur, np.array([0.0, _BLURRED_PX]))
    _level(panels[1], _BRIGHT)
    draw_envelope(panels[1], *coarsen_envelope(t, black, black, bins=400), "before")
    draw_envelope(panels[1], *coarsen_envelope(t, white, white, bins=400), "accent")
    panels[1].y.span(0, 260)
    panels[1].y.ticks = (0, 100, 200)
    draw_envelope(panels[2], *coarsen_envelope(t, count, count, bins=400), "after")
    set_y_limits(panels[2], count, np.zeros(1))
    panels[2].y.most = 3
    for panel in panels:
        panel.x.span(0, positive_or(highest_finite(t)))
        panel.x.timed = True
        panel.x.labelled = panel is panels[-1]
    alt = (
        f"Blur, exposure and number of corners of {len(t)} frames of {name}; the median blur is {_median(blur, 2)} px."
    )
    return sheet.draw(f"images-{name}", 560, alt)


def _level(panel: Panel, value: float) -> None:
    panel.across(value, "muted", width=1.2, dash=DASHED)


def _median(values: Floats, digits: int) -> str:
    known = finite_values(values)
    return number_text(float(np.median(known)) if known.size else float("nan"), digits)


def _certainty(name: str, fit: CornerFit) -> Figure | None:
    if fit.corner_sigma_px is None or len(finite_values(fit.corner_sigma_px)) < _FEWEST:
        return None
    groups = _by_sigma(fit)
    ratio = float(np.median(groups[1] / groups[0])) if len(groups[0]) else float("nan")
    compared = (
        f" Residuals are {number_text(ratio, 2)} times as large (median of the groups); what is more than 1 comes from "
        "errors of the lens, the board and the timestamps as well."
        if isfinite(ratio)
        else ""
    )
    return Figure(
        f"How certain the corners of {name} are",
        draw_corner_sigmas(name, fit, groups),
        (
            Legend("line", "after", "share of corners"),
            Legend("dot", "after", "robust rms of a group of corners"),
            Legend("dash", "ink", "as the detector says"),
        ),
        "Left, the standard deviations that the detector gave each corner; right, the residuals of corners "
        f"with like standard deviations.{compared}",
    )


def _by_sigma(fit: CornerFit) -> tuple[Floats, Floats]:
    """Return the median sigma of groups of corners, and the robust scatter of their residuals, (g,) each [px]."""
    assert fit.corner_sigma_px is not None
    used = np.asarray(fit.frame_used, dtype=bool)[fit.frame] & np.isfinite(fit.residual).all(axis=1)
    sigma, residual = fit.corner_sigma_px[used], fit.residual[used]
    if len(sigma) < _FEWEST:
        return np.empty(0), np.empty(0)
    parts = np.array_split(np.argsort(sigma, kind="stable"), _GROUPS)
    median = np.array([float(np.median(sigma[part])) for part in parts])
    scatter = np.array([1.4826 * float(np.median(np.abs(residual[part]))) for part in parts])
    return median, scatter


def draw_corner_sigmas(name: str, fit: CornerFit, groups: tuple[Floats, Floats]) -> Plot:
    """Draw the distribution of the corners' standard deviations, and their residuals against them."""
    assert fit.corner_sigma_px is not None
    known = finite_values(fit.corner_sigma_px)
    reach = positive_or(float(np.quantile(known, 0.99)))
    sigma, scatter = groups

    sheet = Sheet()
    axes = half_panel(sheet, "Density", 0, top=36, height=200)
    edges = np.linspace(0, reach, 61)
    density = np.histogram(known, edges)[0] / (len(known) * (edges[1] - edges[0]))
    axes.steps(density, edges, "after")
    axes.x.span(0, reach)
    axes.y.span(0, 1.05 * positive_or(float(density.max())))
    sheet.text("σ of a corner [px]", x=WIDTH / 2 - 14, y=286, color="muted", align="right")
    other = half_panel(sheet, "Scatter of the residuals [px]", 1, top=36, height=200)
    most = 1.1 * positive_or(max(highest_finite(scatter), highest_finite(sigma)), reach)
    widest = 1.1 * positive_or(highest_finite(sigma), reach)
    diagonal = np.array([0.0, widest])
    other.line(diagonal, diagonal, "ink", width=1.4, dash=DASHED)
    draw_dots(other, sigma, scatter, "after")
    other.x.span(0, widest)
    other.y.span(0, most)
    sheet.text("σ of a corner [px]", x=WIDTH - 14, y=286, color="muted", align="right")
    alt = f"Standard deviations of {len(known)} corners of {name}, and the scatter of their residuals against them."
    return sheet.draw(f"certainty-{name}", 300, alt)


def _numbers(known: dict[str, CornerFit]) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for name, fit in known.items():
        quality = fit.quality
        assert quality is not None
        blur = finite_values(quality.blur_px)
        worst = f"{number_text(float(np.quantile(blur, 0.9)), 2)} px" if blur.size else number_text(float("nan"))
        blurred = (
            f"{fixed_text(100 * float(np.mean(blur > _BLURRED_PX)), 0)} %" if blur.size else number_text(float("nan"))
        )
        sigma = number_text(float("nan")) if fit.corner_sigma_px is None else f"{_median(fit.corner_sigma_px, 2)} px"
        seen = f"{fixed_text(100 * float(np.mean(np.asarray(fit.frame_corners) > 0)), 0)} %"
        rows.append((name, seen, f"{_median(quality.blur_px, 2)} px", worst, blurred,
                     _median(quality.black, 3), _median(quality.white, 3), sigma))  # fmt: skip
    return ReportTable(
        "In numbers",
        ("camera", "board in", "blur", "blur, 90 %", f"> {_BLURRED_PX:g} px", "black", "white", "σ of a corner"),
        rows,
        "Medians over the frames in which the board was found, but for the blur that 90 % of them stay below.",
    )


def _dropped(known: dict[str, CornerFit]) -> list[ReportTable]:
    rows: list[tuple[str, ...]] = []
    for name, fit in known.items():
        assert fit.quality is not None
        total = sum(fit.quality.dropped.values()) + len(fit.frame)
        for reason, count in sorted(fit.quality.dropped.items(), key=lambda item: -item[1]):
            if count:
                rows.append((f"{name}: {reason}", str(count), f"{number_text(100 * count / total, 2)} %"))
    if not rows:
        return []
    return [
        ReportTable(
            "Corners that were found and left out",
            ("reason", "corners", "share"),
            rows,
            "Shares are of all corners of the camera that were found.",
        )
    ]
