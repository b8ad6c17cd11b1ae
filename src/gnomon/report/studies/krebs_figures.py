"""The figures of the study of Krebs: histograms and fitted normal distributions, three axes side by side."""

from collections.abc import Sequence

import numpy as np

from ...recording import Floats
from ...study.krebs import KrebsSample, KrebsStudy
from ...study.krebs_thesis import KrebsRig, group_columns
from ..drawing.figures import WIDTH, Plot, Sheet
from ..drawing.panel import Panel
from ..numbers import finite_values, positive_or

AXES = ("x", "y", "z")
LEVELS = ("t1", "t3", "t5")
"""Colours of S1, S2 and S3."""
_DASHED = (4.0, 3.0)
_GAP, _TOP, _HEIGHT = 32.0, 40.0, 118.0
_PITCH = _HEIGHT + 84


def _histograms(name: str, samples: Sequence[KrebsSample], symbol: str, *, unit: str, truth: Floats) -> Plot:
    """Draw histograms of the estimates of a vector, a row for each series, with fitted normal distributions.

    Parameters
    ----------
    unit : of what is shown, a thousandth of that of the estimates
    truth : (3,), marked by a line; the errors count from there
    """
    place = group_columns(symbol)

    sheet = Sheet()
    for row, sample in enumerate(samples):
        for k, axis in enumerate(AXES):
            values = 1e3 * (truth[k] + sample.errors[:, place.start + k])
            panel = _third(sheet, f"{sample.series.name}: {axis} [{unit}]", row, k)
            _histogram(panel, values, axis)
            _normal(panel, values, "ink")
            panel.upright(1e3 * float(truth[k]), "accent", width=1.6, dash=_DASHED)
    alt = f"Histograms of {symbol} in {unit} of {', '.join(sample.series.name for sample in samples)}, three axes."
    return sheet.draw(name, _PITCH * len(samples), alt)


def noise_levels(study: KrebsStudy) -> Plot:
    """Draw the fitted distributions of p_cb at each noise level, with pixel noise and without it (Fig. 5.3)."""
    sheet = Sheet()
    for row, (samples, title) in enumerate(
        ((study.noise_levels, "with pixel noise"), (study.without_pixel_noise, "without"))
    ):
        for k, axis in enumerate(AXES):
            panel = _third(sheet, f"{axis} [mm], {title}", row, k)
            reach = 3.5e3 * max(float(sample.scatter[group_columns("p_cb").start + k]) for sample in study.noise_levels)
            for sample, color in zip(samples, LEVELS, strict=True):
                _normal(panel, 1e3 * sample.errors[:, group_columns("p_cb").start + k], color, peak=1.0)
            panel.upright(0.0, "accent", width=1.6, dash=_DASHED)
            panel.x.span(-reach, reach)
            panel.y.span(0.0, 1.08)
    return sheet.draw("levels", 2 * _PITCH, "Normal distributions of the error of p_cb at three noise levels.")


def draw_model_neglect(study: KrebsStudy) -> Plot:
    """Draw the histograms of p_cb's error with the extended and with the basic model (Fig. 5.4)."""
    sheet = Sheet()
    for k, axis in enumerate(AXES):
        at = group_columns("p_cb").start + k
        panel = _third(sheet, f"{axis} [mm]", 0, k)
        both = [1e3 * sample.errors[:, at] for sample in (study.samples[0], study.basic)]
        edges = _edges(np.concatenate(both))
        for values, color in zip(both, ("x", "z"), strict=True):
            _histogram(panel, values, color, edges)
            _normal(panel, values, color)
        panel.upright(0.0, "accent", width=1.6, dash=_DASHED)
    return sheet.draw("neglect", _PITCH, "Error of p_cb with the extended and with the basic model.")


def _third(sheet: Sheet, title: str, row: int, k: int) -> Panel:
    """Return the panel of an axis in a row of three."""
    width = (WIDTH - 2 * _GAP) / 3
    left, top = k * (width + _GAP), _TOP + _PITCH * row
    panel = sheet.panel("", top=top, height=_HEIGHT, left=left, right=WIDTH - left - width)
    panel.x.most, panel.y.ticks, panel.y.grid = 3, (), False
    sheet.text(title, x=left, y=top - 16, color="ink", weight="bold")
    return panel


def _edges(values: Floats) -> Floats:
    kept = finite_values(values)
    low, high = (float(kept.min()), float(kept.max())) if kept.size else (0.0, 1.0)
    room = 0.06 * (high - low) or 0.5
    return np.linspace(low - room, high + room, 6 + round(2 * np.sqrt(max(len(kept), 1))))


def _histogram(panel: Panel, values: Floats, color: str, edges: Floats | None = None) -> None:
    """Fill the density of values; the panel grows with it."""
    edges = _edges(values) if edges is None else edges
    kept = finite_values(values)
    density = np.histogram(kept, edges)[0] / max(len(kept), 1) / (edges[1] - edges[0])
    panel.band(np.repeat(edges, 2)[1:-1], np.zeros(2 * len(density)), np.repeat(density, 2), color, alpha=0.4)
    _hold(panel, edges[0], edges[-1], float(density.max()))


def _normal(panel: Panel, values: Floats, color: str, *, peak: float | None = None) -> None:
    """Draw the normal distribution that is fitted to values, with its density or with a peak of this height."""
    kept = finite_values(values)
    middle, sigma = float(kept.mean()), positive_or(float(kept.std(ddof=1)))
    x = middle + sigma * np.linspace(-4, 4, 161)
    height = 1 / (sigma * np.sqrt(2 * np.pi)) if peak is None else peak
    panel.line(x, height * np.exp(-0.5 * ((x - middle) / sigma) ** 2), color, width=1.5)
    _hold(panel, middle - 3 * sigma, middle + 3 * sigma, height)


def _hold(panel: Panel, low: float, high: float, top: float) -> None:
    """Let the panel reach at least so far; a new one reaches from 0 to 1."""
    fresh = (panel.x.low, panel.x.high, panel.y.high) == (0.0, 1.0, 1.0)
    ends = (low, high) if fresh else (min(low, panel.x.low), max(high, panel.x.high))
    panel.x.span(*ends)
    panel.y.span(0.0, 1.06 * top if fresh else max(1.06 * top, panel.y.high))


def draw_translation(study: KrebsStudy) -> Plot:
    """Draw p_cb at each noise level (Figs. 5.2 and B.1)."""
    return _histograms("p-cb", study.noise_levels, "p_cb", unit="mm", truth=KrebsRig().T_cam_imu[:3, 3])


def draw_scale_errors(study: KrebsStudy) -> Plot:
    """Draw the errors of S_a at each noise level (Fig. B.2)."""
    return _histograms("s-a", study.noise_levels, "S_a", unit="10⁻³", truth=np.zeros(3))
