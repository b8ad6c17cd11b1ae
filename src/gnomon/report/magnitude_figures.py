"""Figures of a triad that measured a vector of known magnitude: where it pointed, and what is left of its magnitude."""

import numpy as np
from numpy.typing import NDArray

from ..diagnostics import IntervalTable
from ..recording import Floats, Integers
from ..triad_diagnostics import PoseTable
from . import svg
from .figures import Sheet, coarser, dots, limits
from .magnitude_units import scaled
from .numbers import largest
from .panel import Panel
from .sphere import SPHERE_HEIGHT, hemisphere, lambert


def directions(name: str, direction: Floats, used: NDArray[np.bool_], alt: str) -> str:
    """Directions (n, 3) in the body frame on two hemispheres in Lambert's equal-area projection.

    Parameters
    ----------
    name : of the figure, unique on the page
    used : (n,) bool
    alt : what a person who does not see the figure should know
    """
    known = np.isfinite(direction).all(axis=1)
    used = np.asarray(used, dtype=bool) & known
    labelled = len(used) <= 60

    sheet = Sheet()
    for side in (1.0, -1.0):
        axes = hemisphere(sheet, side)
        here = known & ((direction[:, 2] >= 0) == (side > 0))
        flat = lambert(direction, side)
        for chosen, color, ring in ((here & ~used, "accent", True), (here & used, "after", False)):
            # Directions closer than a dot is wide add nothing to see.
            spots = np.unique(np.round(flat[chosen] / 0.02) * 0.02, axis=0) if not labelled else flat[chosen]
            dots(axes, spots[:, 0], spots[:, 1], color, size=9 if labelled else 5, ring=ring and labelled)
        if labelled:
            for x, y, names in _labels(flat, np.flatnonzero(here)):
                axes.text(names, x, y, svg.text_style("muted", 9.5, "left"), fine=True)
    return sheet.draw(name, SPHERE_HEIGHT, alt)


_CHARACTER, _LINE, _DOT, _APART = 0.054, 0.075, 0.04, 0.06
"""Width and height of a character of a label, half a dot, and the distance of a label, in units of the projection."""
_AXIS_NAMES = ((0.0, 1.5), (0.0, -1.5), (1.55, 0.0), (-1.55, 0.0))


def _labels(flat: Floats, indices: Integers) -> list[tuple[float, float, str]]:
    """Return where labels begin, and their texts; points that nearly coincide share one, such as "3, 9, 17"."""
    groups: list[list[int]] = []
    for i in indices.tolist():
        near = next((g for g in groups if np.hypot(*(flat[g[0]] - flat[i])) < 0.11), None)
        if near is None:
            groups.append([i])
        else:
            near.append(i)
    taken = [(x - 0.1, y - 0.08, x + 0.1, y + 0.08) for x, y in _AXIS_NAMES]
    taken += [(x - _DOT, y - _DOT, x + _DOT, y + _DOT) for x, y in flat[indices].tolist()]
    labels: list[tuple[float, float, str]] = []
    for group in groups:
        names = ", ".join(str(i + 1) for i in group[:3]) + (" …" if len(group) > 3 else "")
        x, y = flat[max(group, key=lambda i: float(flat[i, 0]))].tolist()
        box = min(_boxes(x, y, _CHARACTER * len(names)), key=lambda box: _covered(box, taken))
        taken.append(box)
        labels.append((box[0], box[1], names))
    return labels


_Box = tuple[float, float, float, float]


def _boxes(x: float, y: float, width: float) -> list[_Box]:
    """Return where a label may stand about a point, left, bottom, right and top, the best place first."""
    half = _LINE / 2
    beside = [(x + _APART, y - half), (x - _APART - width, y - half)]
    over = [(x - width / 2, y + _APART), (x - width / 2, y - _APART - _LINE)]
    corners = [
        (x + side * _APART - (width if side < 0 else 0), y + up) for side in (0.6, -0.6) for up in (half, -2 * half)
    ]
    return [(left, low, left + width, low + _LINE) for left, low in (*beside, *over, *corners)]


def _covered(box: _Box, taken: list[_Box]) -> float:
    """Return how much of a box others cover."""
    return sum(
        max(0.0, min(box[2], other[2]) - max(box[0], other[0]))
        * max(0.0, min(box[3], other[3]) - max(box[1], other[1]))
        for other in taken
    )


def magnitude_errors(name: str, table: IntervalTable | PoseTable, si_unit: str, x_label: str, alt: str) -> str:
    """Error of a magnitude per pose or interval: before, after, and when it was held out.

    Parameters
    ----------
    name : of the figure, unique on the page
    si_unit : of the errors, as in `TriadRecord`
    x_label : what is counted along x
    alt : what a person who does not see the figure should know
    """
    used = np.asarray(table.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)
    few = len(number_of) <= 300

    sheet = Sheet()
    before, after = table.error_before[used], table.error_after[used]
    heldout, sigma = table.error_holdout[used], table.sigma[used]
    unit, factor = scaled(largest(np.concatenate([before, after])), si_unit)
    axes = sheet.panel(f"Before and after [{unit}]", top=36, height=180)
    for values, color in ((before, "before"), (after, "after")):
        dots(axes, *_some(number_of, values * factor), color, size=7 if few else 4)
    limits(axes, before * factor, after * factor, symmetric=True)
    unit, factor = scaled(largest(np.concatenate([after, heldout])), si_unit)
    close = sheet.panel(f"After, magnified [{unit}]", top=270, height=220, x_label=x_label)
    _band(close, number_of, 2 * sigma * factor)
    dots(close, *_some(number_of, heldout * factor), "heldout", size=7 if few else 5, ring=True)
    dots(close, *_some(number_of, after * factor), "after", size=5 if few else 3)
    limits(close, after * factor, heldout * factor, symmetric=True)
    for panel in (axes, close):
        over_index(panel, len(used))
    axes.x.labelled = False
    return sheet.draw(name, 550, alt)


def _some(x: Floats, y: Floats, most: int = 600) -> tuple[Floats, Floats]:
    """Return points (n,), of many such only some at equal distances, and the farthest of all."""
    step = -(-len(x) // most)
    if step <= 1:
        return x, y
    far = np.argsort(-np.nan_to_num(np.abs(y)), kind="stable")[:20]
    kept = np.union1d(np.arange(0, len(x), step), far)
    return x[kept], y[kept]


def _band(panel: Panel, x: Floats, reach: Floats) -> None:
    """Shade ±reach around zero."""
    t, _, high = coarser(x, reach, reach, bins=300)
    between = (t[1:] + t[:-1]) / 2
    edges = np.sort(np.concatenate([t[:1], between, between, t[-1:]]))
    panel.band(edges, -np.repeat(high, 2), np.repeat(high, 2), "before", alpha=0.22)


def over_index(panel: Panel, count: int) -> None:
    """Let the x scale count from one, and draw zero of the y scale."""
    count_along(panel, count)
    panel.across(0, "muted")


def count_along(panel: Panel, count: int) -> None:
    """Let the x scale count from one."""
    panel.x.span(0.4, max(count, 1) + 0.6)
    panel.x.most, panel.x.whole = 8, True
