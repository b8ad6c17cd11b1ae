"""Figures of a camera-IMU report: signals measured and predicted, residuals, biases, and how the rig was moved."""

from collections.abc import Iterable

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_quaternion, tangent_basis
from ...recording import Floats
from ...results.camera_diagnostics import BiasTrack, SceneMap, SignalFit, TrajectoryTrack
from ..corners import TIMES, time_spans
from ..drawing.figures import (
    AXES,
    SPHERE_HEIGHT,
    WIDTH,
    Plot,
    Sheet,
    coarsen_envelope,
    draw_dots,
    draw_envelope,
    draw_histograms,
    half_panel,
    hemisphere_panel,
    lambert_projection,
    set_y_limits,
)
from ..drawing.panel import DASHED, Panel
from ..numbers import finite_rms, finite_values, highest_finite, positive_or, readable_unit, si_prefix

ZOOM_S = 2.0
_FINEST = 400
"""Points per line that a section is drawn with."""


def signal_name(name: str, names: Iterable[str]) -> str:
    """Return "imu0.gyroscope" as it is read: with the IMU where `names` are of several, alone "Gyroscope"."""
    imu, _, triad = name.partition(".")
    several = len({other.partition(".")[0] for other in names}) > 1
    return f"{triad.capitalize()} of {imu}" if several else triad.capitalize() or imu


def signal_residual(fit: SignalFit, predicted: Floats | None) -> Floats:
    """Return measured minus predicted, (n, 3); nan where a sample was not used or nothing was predicted."""
    if predicted is None:
        return np.full_like(fit.measured, np.nan)
    return np.where(np.asarray(fit.used, dtype=bool)[:, None], fit.measured - predicted, np.nan)


def telling_section(fit: SignalFit, length_s: float = ZOOM_S) -> tuple[float, float]:
    """Return start and stop [s] of the section in which the two models differ most, or the model fits worst.

    Sums over the section are compared, so that one with gaps does not win; where the fit itself is looked at, up to
    five sigma of each sample count, so that a single outlier does not decide.
    """
    t = fit.t_s
    if not len(t) or not np.isfinite(t).all():
        return 0.0, length_s
    against = fit.measured if fit.basic is None else fit.basic
    used = np.asarray(fit.used, dtype=bool)
    difference = np.where(used[:, None], (fit.predicted - against) / positive_or(fit.sigma), 0.0)
    score = np.clip(np.nan_to_num(difference), -5, 5) if fit.basic is None else np.nan_to_num(difference)
    total = np.concatenate([[0.0], np.cumsum((score**2).sum(axis=1))])
    stop = np.searchsorted(t, t + length_s)
    start = int(np.argmax(total[stop] - total[:-1]))
    first = max(min(float(t[start]), float(t[-1]) - length_s), float(t[0]))
    return first, first + length_s


def draw_signal_overview(name: str, fit: SignalFit, section: tuple[float, float]) -> Plot:
    """Draw a signal over the whole recording, and what the predictions leave of it, per axis."""
    end = positive_or(highest_finite(fit.t_s))
    model, basic = signal_residual(fit, fit.predicted), signal_residual(fit, fit.basic)
    reach = _reach(fit, model, basic)
    prefix, factor = si_prefix(reach)
    unit = readable_unit(fit.unit)

    sheet = Sheet()
    axes = sheet.panel(f"Measured [{unit}]", top=36, height=190)
    t, low, high = coarsen_envelope(fit.t_s, fit.measured, fit.measured, bins=600)
    for i, axis in enumerate(AXES):
        draw_envelope(axes, t, low[:, i], high[:, i], axis)
    set_y_limits(axes, low, high)
    panels = [axes]
    for i, axis in enumerate(AXES):
        title = f"{axis}: measured − predicted [{prefix}{unit}]"
        panel = sheet.panel(title, top=272 + 132 * i, height=88, x_label="time [s]" if i == 2 else "")
        _noise_band(panel, fit, factor)
        for values, color in ((basic, "accent"), (model, axis)):
            _envelope(panel, fit.t_s, values[:, i] * factor, color)
        panel.y.span(-reach * factor, reach * factor)
        panel.y.most = 3
        panels.append(panel)
    for panel in panels:
        panel.x.span(0, end)
        panel.x.timed = True
        panel.x.labelled = panel is panels[-1]
        for edge in section:
            panel.upright(edge, "ink", dash=DASHED)
    alt = f"{name} over {end:.0f} s, and the residuals of its three axes."
    return sheet.draw(f"overview-{name.replace('.', '-')}", 690, alt)


def _noise_band(panel: Panel, fit: SignalFit, factor: float) -> None:
    reach = 2 * positive_or(fit.sigma, 0.0) * factor
    panel.strip(-reach, reach, "before", alpha=0.22)


def _envelope(panel: Panel, t: Floats, values: Floats, color: str) -> None:
    """Fill between the smallest and the largest value of short stretches."""
    t, low, high = coarsen_envelope(t, values, values, bins=300)
    panel.band(t, low, high, color, edge=0.6)


def _reach(fit: SignalFit, *residuals: Floats) -> float:
    """Return how far a residual panel has to reach: to the largest, unless that is an outlier beyond comparison."""
    values = np.abs(finite_values(np.concatenate([part.ravel() for part in residuals])))
    most = min(float(values.max()), 6 * float(np.quantile(values, 0.99))) if values.size else 0.0
    return 1.08 * positive_or(max(most, 3 * positive_or(fit.sigma, 0.0)))


def section_figure(name: str, fit: SignalFit, section: tuple[float, float]) -> Plot:
    """Draw a section of a signal as measured and as predicted, and the residual (Krebs, Figs. 5.6, B.9-B.14)."""
    first, last = np.searchsorted(fit.t_s, section)
    near = slice(int(first), int(last))
    t, measured = fit.t_s[near], fit.measured[near]
    predictions = (fit.predicted,) if fit.basic is None else (fit.basic, fit.predicted)
    left = [signal_residual(fit, values)[near] for values in predictions]
    reach = _reach(fit, *left)
    prefix, factor = si_prefix(reach)
    unit = readable_unit(fit.unit)

    sheet = Sheet()
    for i, axis in enumerate(AXES):
        colors = (axis,) if fit.basic is None else ("accent", axis)
        top = 36 + 292 * i
        axes = sheet.panel(f"{axis} [{unit}]", top=top, height=138)
        _line(axes, t, measured[:, i], "before", width=3.4)
        for values, color in zip(predictions, colors, strict=True):
            _line(axes, t, values[near, i], color)
        set_y_limits(axes, measured[:, i], *(values[near, i] for values in predictions))
        title = f"measured − predicted [{prefix}{unit}]"
        below = sheet.panel(title, top=top + 178, height=70, x_label="time [s]" if i == 2 else "")
        _noise_band(below, fit, factor)
        for values, color in zip(left, colors, strict=True):
            _line(below, t, values[:, i] * factor, color)
        below.y.span(-reach * factor, reach * factor)
        below.y.most = 3
        for panel in (axes, below):
            panel.x.span(*section)
            panel.x.timed = True
            panel.x.labelled = panel is below and i == 2
    alt = f"{name} between {section[0]:.1f} and {section[1]:.1f} s: measured and predicted, and their difference."
    return sheet.draw(f"section-{name.replace('.', '-')}", 930, alt)


def _line(panel: Panel, t: Floats, values: Floats, color: str, width: float = 1.3) -> None:
    """Draw a line; where it has too many points, its envelope. A wide line is a pale one."""
    if len(t) <= 2 * _FINEST:
        alpha = 0.55 if width > 2 else 1.0
        panel.line(t, values, color, width=width, alpha=alpha)
    else:
        draw_envelope(panel, *coarsen_envelope(t, values, values, bins=_FINEST), color)


def draw_normalised_residuals(signals: dict[str, SignalFit]) -> Plot:
    """Draw histograms of the residuals over their sigma, per axis, with the standard normal distribution."""
    names = list(signals)
    pitch, top = 330.0, 36.0

    sheet = Sheet()
    for k, name in enumerate(names):
        fit = signals[name]
        left = signal_residual(fit, fit.predicted) / positive_or(fit.sigma)
        axes = half_panel(sheet, signal_name(name, signals), k, top=top + pitch * (k // 2), height=230)
        draw_histograms(axes, [(left[:, i], axis) for i, axis in enumerate(AXES)], reach=5.0, sigma=1.0)
        x, y = (k % 2 + 1) * WIDTH / 2 - 14, top + pitch * (k // 2) + 280
        sheet.text("residual / σ", x=x, y=y, color="muted", align="right")
    alt = "Histograms of the residuals of the IMU, divided by their sigma, against the standard normal distribution."
    return sheet.draw("normalised", pitch * -(-len(names) // 2), alt)


def bias_figure(biases: dict[str, BiasTrack]) -> Plot:
    """Draw the biases less their means, with sigma bands, and the bounds of the random walk that was assumed."""
    pitch = 258.0
    last = list(biases)[-1]

    sheet = Sheet()
    for k, (name, track) in enumerate(biases.items()):
        middle = np.array([float(np.mean(finite_values(v))) if finite_values(v).size else 0.0 for v in track.value.T])
        deviation = track.value - middle
        walked = 3 * track.random_walk * np.sqrt(np.fmax(track.t_s, 0.0))
        reach = _bias_reach(deviation, track.sigma, walked)
        prefix, factor = si_prefix(reach)
        title = f"{signal_name(name, biases)}: bias − mean [{prefix}{readable_unit(track.unit)}]"
        panel = sheet.panel(title, top=36 + pitch * k, height=206, x_label="time [s]" if name == last else "")
        for sign in (-1, 1):
            panel.line(track.t_s, sign * walked * factor, "muted", width=1.2, dash=DASHED)
        for i, axis in enumerate(AXES):
            low, high = deviation[:, i] - track.sigma[:, i], deviation[:, i] + track.sigma[:, i]
            t, low, high = coarsen_envelope(track.t_s, low, high, bins=250)
            panel.band(t, low * factor, high * factor, axis, alpha=0.16)
        for i, axis in enumerate(AXES):
            t, low, high = coarsen_envelope(track.t_s, deviation[:, i], deviation[:, i], bins=400)
            panel.line(t, (low + high) / 2 * factor, axis, width=1.6)
        panel.y.span(-reach * factor, reach * factor)
        panel.x.span(0, positive_or(highest_finite(track.t_s)))
        panel.x.timed = True
        panel.x.labelled = name == last
    alt = "Biases of the IMU over time, about their means, with one sigma; dashed, three sigma of the random walk."
    return sheet.draw("biases", pitch * len(biases) + 42, alt)


def _bias_reach(value: Floats, sigma: Floats, walked: Floats) -> float:
    """Return a reach that holds values and bands, and the bounds too unless they dwarf them."""
    inner = highest_finite(np.abs(value) + np.nan_to_num(sigma))
    outer = highest_finite(walked)
    return 1.08 * positive_or(min(max(inner, outer), 6 * inner) if inner else outer)


_DEG = 180 / np.pi
_PATCH = 2 * np.sqrt(2) / 25
"""Side of the patches in which axes of rotation are counted, in the equal-area projection."""
_FASTER_THAN = 0.3
"""Share of the rms rate above which a sample says something about the axis of rotation."""


@value_class
class RigMotion:
    """How the rig moved.

    Attributes
    ----------
    t_s : (n,) [s from the first timestamp of the trajectory]
    rate : (n, 3) angular rate, body frame [deg/s]
    acceleration : (n, 3) linear acceleration, body frame [m/s^2]
    position : (n, 3) of the IMU, in the frame of the target [m]
    """

    t_s: Floats
    rate: Floats
    acceleration: Floats
    position: Floats


def rig_motion(track: TrajectoryTrack, gravity_target: Floats) -> RigMotion:
    """Return the motion; linear acceleration is specific force plus gravity."""
    t = (track.t_ns - track.t_ns[0]) * 1e-9 if len(track.t_ns) else np.empty(0)
    R = rotation_from_quaternion(np.asarray(track.q_target_imu_wxyz))
    acceleration = track.f_imu + np.einsum("nji,j->ni", R, gravity_target)
    return RigMotion(t_s=t, rate=track.omega_imu * _DEG, acceleration=acceleration, position=track.p_target_imu)


def axes_of_rotation(motion: RigMotion) -> Plot:
    """Draw the axes about which the rig turned, in the body frame, where it turned fast enough to tell."""
    speed = np.linalg.norm(motion.rate, axis=1)
    fast = speed > _FASTER_THAN * finite_rms(speed)
    directions = motion.rate[fast] / speed[fast, None]
    counted: dict[float, tuple[Floats, Floats]] = {}
    for side in (1.0, -1.0):
        flat = lambert_projection(directions[(directions[:, 2] >= 0) == (side > 0)], side)
        spots, count = np.unique(np.floor(flat / _PATCH + 0.5), axis=0, return_counts=True)
        counted[side] = spots, count.astype(np.float64)
    most = max(float(count.max(initial=0)) for _, count in counted.values()) or 1.0

    sheet = Sheet()
    for side, (spots, count) in counted.items():
        panel = hemisphere_panel(sheet, side)
        panel.rim = np.sqrt(2)
        panel.cells((spots - 0.5) * _PATCH, (_PATCH, _PATCH), level=np.sqrt(count / most), color="after")
    return sheet.draw("rotation", SPHERE_HEIGHT, "Axes of rotation in the body frame, on two hemispheres.")


def draw_motion_histograms(motion: RigMotion) -> Plot:
    """Draw histograms of angular rate and linear acceleration per axis."""
    parts = (("Angular rate [°/s]", motion.rate), ("Linear acceleration [m/s²]", motion.acceleration))

    sheet = Sheet()
    for k, (title, values) in enumerate(parts):
        sizes = np.abs(finite_values(values))
        reach = 1.02 * float(np.quantile(sizes, 0.9995)) if sizes.size and sizes.max() > 0 else 1.0
        axes = half_panel(sheet, title, k, top=36, height=220, left=20)
        draw_histograms(axes, [(values[:, i], axis) for i, axis in enumerate(AXES)], reach=reach, bins=50)
        axes.y.ticks = ()
    return sheet.draw("rates", 300, "Histograms of angular rate and of linear acceleration along the body axes.")


def draw_imu_path(motion: RigMotion) -> Plot:
    """Draw the path of the IMU in the target's frame, from the front and along its y axis, coloured by time."""
    kept = np.arange(0, len(motion.t_s), max(1, -(-len(motion.t_s) // 1500)))
    high = np.array([highest_finite(axis) for axis in motion.position.T])
    low = -np.array([highest_finite(-axis) for axis in motion.position.T])
    span = 0.54 * max(float((high - low).max()), 1e-3)
    spans = time_spans(motion.t_s)
    colour = np.clip(np.searchsorted(spans, motion.t_s[kept], side="right") - 1, 0, len(TIMES) - 1)
    torn = np.diff(motion.t_s[kept], append=np.inf) > 5 * np.median(np.diff(motion.t_s[kept], append=0.0))

    sheet = Sheet()
    for k, (title, across, up) in enumerate((("Plane: y over x [m]", 0, 1), ("Depth: z over x [m]", 0, 2))):
        axes = half_panel(sheet, title, k, top=36, height=314)
        axes.x.grid = True
        for i, name in enumerate(TIMES):
            # A piece reaches to the first point of the next one, and a gap interrupts it.
            piece = (colour == i) | np.concatenate([[False], (colour == i)[:-1]])
            line = motion.position[kept][:, [across, up]].copy()
            line[torn] = np.nan
            axes.line(line[piece, 0], line[piece, 1], name, width=1.3)
        middle = (low + high) / 2
        axes.x.span(middle[across] - span, middle[across] + span)
        axes.y.span(middle[up] - span, middle[up] + span)
    return sheet.draw("path", 396, "Path of the IMU in the frame of the target, from the front and along its y axis.")


def draw_scene(trajectory: TrajectoryTrack, gravity: Floats, scene: SceneMap, sightings: Floats) -> Plot:
    """Draw the landmarks of a scene and the path of the IMU, from above and from the side.

    Parameters
    ----------
    trajectory : of the IMU
    gravity : (3,) in the same frame
    scene : the landmarks, k of them
    sightings : (k,) images in which each was seen
    """
    up = -gravity / np.linalg.norm(gravity)
    axes = np.concatenate([tangent_basis(up), up[:, None]], axis=1)
    step = max(1, len(trajectory.t_ns) // 1500)
    t_s, path = (trajectory.t_ns[::step] - trajectory.t_ns[0]) * 1e-9, trajectory.p_target_imu[::step] @ axes
    points = scene.points @ axes
    few = sightings < 0.2 * np.median(sightings)
    drawn = np.concatenate([points, path[np.isfinite(path).all(axis=1)]])
    middle, span = (drawn.max(axis=0) + drawn.min(axis=0)) / 2, 0.54 * float(np.ptp(drawn, axis=0).max())
    spans = time_spans(np.asarray(t_s, np.float64))
    sheet = Sheet()
    for k, (title, across, upward) in enumerate((("From above [m]", 0, 1), ("From the side [m]", 0, 2))):
        panel = half_panel(sheet, title, k, top=36, height=314)
        panel.x.grid = True
        for i, name in enumerate(TIMES):
            piece = (t_s >= spans[i]) & (t_s <= spans[i + 1])
            panel.line(path[piece, across], path[piece, upward], name, width=1.3)
        draw_dots(panel, points[~few, across], points[~few, upward], "before", size=3.5)
        draw_dots(panel, points[few, across], points[few, upward], "accent", size=3.5)
        panel.x.span(middle[across] - span, middle[across] + span)
        panel.y.span(middle[upward] - span, middle[upward] + span)
    return sheet.draw("scene", 396, f"Map of {len(points)} landmarks and the path, from above and from the side.")
