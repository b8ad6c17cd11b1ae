"""The figures of a noise report."""

import numpy as np

from ..diagnostics import SignalEnvelope
from ..recording import Floats
from ..sensor_noise import AllanTable, AxisNoise, TriadNoise
from .figures import Sheet, limits, log_limits, zigzag
from .numbers import finite, highest, prefixed
from .panel import DASHED, Panel

AXES = ("x", "y", "z")
COLORS = {"quantisation": "t1", "white_noise": "t2", "bias_instability": "t3", "random_walk": "t4", "rate_ramp": "t5"}
"""Kind of noise -> colour."""

_DENSE = 160


def allan(sensor: str, unit: str, curve: AllanTable, noise: TriadNoise, t_init_s: float) -> str:
    """Allan deviation of three axes with its interval, and the noise that was found (document A, Fig. 3.2)."""
    prefix, factor = prefixed(float(np.median(curve.deviation[curve.deviation > 0])))

    sheet = Sheet()
    panel = sheet.panel(f"Allan deviation [{prefix}{unit}]", top=36, height=330, x_label="averaging time [s]")
    for i, name in enumerate(AXES):
        panel.band(curve.tau_s, curve.lower[:, i] * factor, curve.upper[:, i] * factor, name, alpha=0.16)
    tau = _dense(curve.tau_s)
    for axis, name in zip(noise.axes, AXES, strict=True):
        used = tau[tau >= axis.fitted_from_s]
        panel.line(used, axis.deviation(used) * factor, name, width=1.2, dash=DASHED)
    for i, name in enumerate(AXES):
        panel.line(curve.tau_s, curve.deviation[:, i] * factor, name, width=1.8)
        panel.dots(curve.tau_s, curve.deviation[:, i] * factor, name, 5)
    _scales(panel, curve, curve.deviation * factor)
    if np.isfinite(t_init_s):
        panel.upright(t_init_s, "accent", width=1.6, dash=(5.0, 3.0))
    alt = f"Allan deviation of the {sensor}'s axes x, y, z over averaging time, with the noise that was fitted."
    return sheet.draw(f"allan-{sensor}", 426, alt)


def parts(sensor: str, unit: str, curve: AllanTable, axes: tuple[AxisNoise, ...]) -> str:
    """Allan deviation of each axis, taken apart into the kinds of noise."""
    prefix, factor = prefixed(float(np.median(curve.deviation[curve.deviation > 0])))

    sheet = Sheet()
    for i, (axis, name) in enumerate(zip(axes, AXES, strict=True)):
        label = "averaging time [s]" if i == 2 else ""
        panel = sheet.panel(f"{name} [{prefix}{unit}]", top=36 + 232 * i, height=180, x_label=label)
        panel.band(curve.tau_s, curve.lower[:, i] * factor, curve.upper[:, i] * factor, "before", alpha=0.22)
        tau = _dense(curve.tau_s)
        for kind, deviation in axis.parts(tau).items():
            panel.line(tau, deviation * factor, COLORS[kind], width=1.3)
        used = tau[tau >= axis.fitted_from_s]
        panel.line(used, axis.deviation(used) * factor, "ink", width=1.2, dash=DASHED)
        panel.dots(curve.tau_s, curve.deviation[:, i] * factor, "ink", 5)
        _scales(panel, curve, curve.deviation[:, i] * factor)
        panel.x.labelled = i == 2
    alt = f"Allan deviation of each axis of the {sensor} with the curves of the kinds of noise it is made of."
    return sheet.draw(f"parts-{sensor}", 750, alt)


def means(sensor: str, unit: str, signal: SignalEnvelope) -> str:
    """Means of about a second over the recording, about their median."""
    middle = np.median(signal.low, axis=0)
    low, high = signal.low - middle, signal.high - middle
    prefix, factor = prefixed(highest(np.abs(np.concatenate([low, high])), 1.0))

    sheet = Sheet()
    panel = sheet.panel(f"{sensor}, about its mean [{prefix}{unit}]", top=36, height=200, x_label="time [s]")
    for i, name in enumerate(AXES):
        zigzag(panel, signal.t_s, low[:, i] * factor, high[:, i] * factor, name)
    limits(panel, low * factor, high * factor)
    panel.x.span(0, highest(signal.t_s, 1.0))
    return sheet.draw(f"means-{sensor}", 296, f"Means of the {sensor}'s samples over time.")


def _dense(tau_s: Floats) -> Floats:
    return np.geomspace(tau_s[0], tau_s[-1], _DENSE)


def _scales(panel: Panel, curve: AllanTable, deviation: Floats) -> None:
    log_limits(panel, deviation)
    panel.x.logarithmic, panel.x.grid = True, True
    tau = finite(curve.tau_s)
    panel.x.span(float(tau.min()), float(max(tau.max(), 1.05 * tau.min())))
