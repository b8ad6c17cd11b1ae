"""Figures of corners with their captions, and the frames left out: what both camera pages show of them."""

import re
from math import isfinite

import numpy as np

from ..recording import Floats
from ..results.camera_diagnostics import CornerFit
from . import corner_figures as figures
from .corner_view import CornerView, field_magnification
from .numbers import fixed_text, largest_magnitude, number_text
from .page import Figure, Legend, ReportTable

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
