"""The figure that compares parts of a recording, block by block."""

import numpy as np

from ..trust import Splits
from .figures import Sheet, dots
from .numbers import finite, highest
from .panel import DASHED

_ROW, _LEFT, _TOP = 24.0, 270.0, 36.0
_LEAST = 140.0
"""Height of all rows together at least, so that a small screen shows two of them as well."""


def agreement(splits: Splits) -> str:
    """Root mean square of the differences of parts over their standard deviation, a row for each block."""
    names = [block.block for block in splits.blocks] + ["all together"]
    robust = np.array([*(block.z_rms for block in splits.blocks), splits.z_rms])
    ordinary = np.array([*(block.z_rms_ordinary for block in splits.blocks), splits.z_rms_ordinary])
    place = np.arange(0.5, len(names), dtype=np.float64)
    height = max(_ROW * len(names), _LEAST)

    sheet = Sheet()
    label = "z rms (1 is as expected)"
    panel = sheet.panel("", top=_TOP - 18, height=height, left=_LEFT, x_label=label)
    panel.y.ticks, panel.y.grid = (), False
    panel.y.span(len(names), 0)
    panel.x.logarithmic, panel.x.grid = True, True
    ends = finite(np.concatenate([robust, ordinary]))
    ends = ends[ends > 0]
    low = min(float(ends.min()), 0.5) if ends.size else 0.5
    high = max(highest(ends, 2.0), 2.0)
    panel.x.span(0.9 * low, 1.1 * high)
    panel.x.ticks = [tick for tick in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if low <= tick <= high]
    panel.upright(1.0, "accent", width=1.6, dash=DASHED)
    for row, y in enumerate(place.tolist()):
        panel.line(np.array([robust[row], ordinary[row]]), np.full(2, y), "grid", width=2.0)
    dots(panel, ordinary, place, "before", size=9.0, ring=True)
    dots(panel, robust, place, "after", size=9.0)
    for y, name in zip(place, names, strict=True):
        weight = "bold" if name == names[-1] else "normal"
        at = float(panel.y.places(np.array(y))) + 4.0
        sheet.text(name, x=0, y=at, color="ink", weight=weight)
    alt = f"Agreement of parts of the recording in {len(splits.blocks)} blocks of parameters, in standard deviations."
    return sheet.draw("agreement", _TOP + height + 46, alt)
