"""The sections of a camera-IMU report that show how well the estimate explains the recording, and what that covers."""

import numpy as np

from ...recording import Floats
from ...results.camera_diagnostics import CameraImuDiagnostics, SignalFit
from ..corners import (
    CornerView,
    corner_scatter,
    draw_corner_density,
    field_figure,
    frames_figure,
    frames_left_out,
    time_legends,
)
from ..numbers import (
    finite_rms,
    finite_values,
    fixed_text,
    largest_magnitude,
    number_text,
    percent_text,
    positive_or,
    quantity_text,
    readable_unit,
)
from ..page import Figure, Legend, ReportTable, Section
from . import signals
from .signals import signal_name

_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
_PREDICTED = tuple(Legend("line", axis, f"predicted {axis}") for axis in "xyz")
_BASIC = Legend("line", "accent", "basic model")
_BAND = Legend("band", "before", "±2σ of one sample")


def fit_section(diagnostics: CameraImuDiagnostics) -> Section | None:
    """Return measured signals against predicted ones, over all and in the most telling section; None without any."""
    if not diagnostics.signals:
        return None
    blocks: list[Figure | ReportTable] = []
    for name, fit in diagnostics.signals.items():
        blocks += _signal_figures(name, fit, signal_name(name, diagnostics.signals))
    blocks.append(_misfit(diagnostics))
    lead = "If the model is right, the trajectory that explains the images also predicts what the IMU reads."
    if any(fit.basic is not None for fit in diagnostics.signals.values()):
        lead += " The basic model, shown for comparison, takes the IMU for ideal but for its biases."
    return Section("fit", "Measured against predicted", lead, blocks)


def _signal_figures(name: str, fit: SignalFit, shown: str) -> tuple[Figure, Figure]:
    section = signals.telling_section(fit)
    basic = () if fit.basic is None else (_BASIC,)
    reason = "the two models differ most" if basic else "the model fits worst"
    return (
        Figure(
            f"{shown} over the recording",
            signals.draw_signal_overview(name, fit, section),
            (*_AXES, *basic, _BAND, Legend("dash", "ink", "section below")),
            _bands(fit),
        ),
        Figure(
            f"{shown}, {fixed_text(section[0], 1)} to {fixed_text(section[1], 1)} s",
            signals.section_figure(name, fit, section),
            (Legend("band", "before", "measured"), *_PREDICTED, *basic, _BAND),
            f"The section in which {reason}: what was measured, what the trajectory and the calibration "
            "predict, and the difference.",
        ),
    )


def _bands(fit: SignalFit) -> str:
    used = np.asarray(fit.used, dtype=bool)
    missing = int((~used).sum())
    text = "Residuals are drawn as bands between the smallest and the largest of short stretches"
    text += "." if fit.basic is None else ": in the axis's colour for the model, behind it for the basic model."
    if missing:
        text += f" {missing} of {len(used)} samples were not used: saturated, or outside the trajectory."
    return text


def _misfit(diagnostics: CameraImuDiagnostics) -> ReportTable:
    """Return the residuals in numbers."""
    rows: list[tuple[str, ...]] = []
    compared = any(fit.basic is not None for fit in diagnostics.signals.values())
    for name, fit in diagnostics.signals.items():
        unit = readable_unit(fit.unit)
        model, basic = (signals.signal_residual(fit, p) for p in (fit.predicted, fit.basic))
        apart = np.full_like(model, np.nan) if fit.basic is None else fit.predicted - fit.basic
        for i, axis in enumerate("xyz"):
            row = [f"{signal_name(name, diagnostics.signals)} {axis}", quantity_text(finite_rms(model[:, i]), unit)]
            if compared:
                row += [
                    quantity_text(finite_rms(basic[:, i]), unit),
                    quantity_text(largest_magnitude(apart[:, i]), unit),
                ]
            rows.append((*row, quantity_text(fit.sigma, unit)))
    compare = ("rms, basic model", "models differ by up to") if compared else ()
    return ReportTable("In numbers", ("residual", "rms", *compare, "expected (σ)"), rows)


def camera_imu_residuals_section(diagnostics: CameraImuDiagnostics, views: dict[str, CornerView]) -> Section:
    """Return what is left of samples and corners: distributions, over time, and over the image."""
    blocks: list[Figure | ReportTable] = []
    for name, view in views.items():
        blocks += [corner_scatter(name, view), frames_figure(name, view)]
    if views:
        blocks.append(field_figure(views))
    if diagnostics.signals:
        shares = ", ".join(
            _beyond(fit, signal_name(name, diagnostics.signals)) for name, fit in diagnostics.signals.items()
        )
        blocks.append(
            Figure(
                "Samples of the IMU",
                signals.draw_normalised_residuals(diagnostics.signals),
                (*_AXES, Legend("dash", "ink", "standard normal")),
                "Measured minus predicted, over the σ that was used. Beyond 3σ lie 0.27 % of normal residuals; "
                f"here, {shares}. Where knots are dense, the trajectory follows part of the noise, and what is left is "
                "narrower.",
            )
        )
    blocks += frames_left_out(diagnostics.corners)
    return Section(
        "residuals",
        "Residuals",
        "Residuals that look like noise of the size that was assumed say that the model explains the recording. A "
        "pattern over time or over the image says that something is not modelled.",
        blocks,
    )


def _beyond(fit: SignalFit, shown: str) -> str:
    values = finite_values(signals.signal_residual(fit, fit.predicted)) / positive_or(fit.sigma)
    share = float(np.mean(np.abs(values) > 3)) if values.size else float("nan")
    return f"{number_text(100 * share, 2)} % of the {shown.lower()}'s"


def camera_imu_coverage_section(diagnostics: CameraImuDiagnostics, views: dict[str, CornerView]) -> Section:
    """Return what the recording covers: the image, rotation, acceleration, and the path."""
    blocks: list[Figure | ReportTable] = []
    if views:
        word = next(iter(views.values())).word
        shares = {name: float(np.mean(view.density.count > 0)) for name, view in views.items()}
        reached = "; ".join(f"{name} {percent_text(part)}" for name, part in shares.items())
        blocks.append(
            Figure(
                f"{word.capitalize()}s in the image",
                draw_corner_density(views),
                caption=f"The stronger the colour, the more {word}s. Share of the image that they reached: "
                f"{reached}. Elsewhere nothing tests the lens.",
            )
        )
    if len(diagnostics.trajectory.t_ns) > 1:
        blocks += _motion(
            signals.rig_motion(diagnostics.trajectory, diagnostics.gravity_target),
            before_board=diagnostics.scene is None,
        )
    return Section(
        "coverage",
        "Coverage",
        "Each parameter needs its own motion: rotation about all axes for the attitude of the cameras and for the "
        "gyroscope, acceleration along all axes for the accelerometer, and fast turning for the translation.",
        blocks,
    )


def _motion(motion: signals.RigMotion, *, before_board: bool) -> list[Figure | ReportTable]:
    rows: list[tuple[str, ...]] = []
    for label, values, unit in (("Angular rate", motion.rate, "°/s"), ("Acceleration", motion.acceleration, "m/s²")):
        for measure, of in (("rms", finite_rms), ("largest", largest_magnitude)):
            rows.append(
                (f"{label}, {measure}", *(f"{number_text(of(v), 3, trim=False)}\u00a0{unit}" for v in values.T))
            )
    return [
        Figure(
            "Axes of rotation",
            signals.axes_of_rotation(motion),
            caption="Directions of the angular rate in the body frame, wherever the rig turned at more than a third of "
            "its rms rate. The stronger the colour, the longer it did.",
        ),
        Figure(
            "Rate and acceleration along the body axes",
            signals.draw_motion_histograms(motion),
            _AXES,
            "How often which value occurred; gravity is not part of the acceleration.",
        ),
        ReportTable("In numbers", ("body axis", *"xyz"), rows),
        Figure(
            "Path of the IMU",
            signals.draw_imu_path(motion),
            time_legends(motion.t_s),
            "In the frame of the target: x and y in its plane, z along its normal."
            if before_board
            else "In the frame of the map, whose axes are any.",
        ),
    ]


def scene_section(diagnostics: CameraImuDiagnostics) -> Section | None:
    """Return the map of a scene without a board, and how its landmarks were seen; None before a board."""
    scene = diagnostics.scene
    if scene is None or not diagnostics.corners:
        return None
    fit = next(iter(diagnostics.corners.values()))
    used = np.asarray(fit.frame_used, dtype=bool)
    kept = used[fit.frame]
    sightings = np.bincount(fit.point[kept], minlength=len(scene.points)).astype(np.float64)
    in_frame = np.bincount(fit.frame[kept], minlength=len(used))[used].astype(np.float64)
    rows = [
        _spread("images in which a landmark is seen", sightings, ""),
        _spread("landmarks in an image", in_frame, ""),
        _spread("distance of a landmark from the middle of the path", _distances(diagnostics, scene.points), "m"),
        _spread("σ of a landmark's place, its worst axis", scene.sigma.max(axis=1), "m"),
    ]
    return Section(
        "scene",
        "The scene",
        f"{len(scene.points)} landmarks stand in for the corners of a board; their places were estimated jointly.",
        (
            Figure(
                "Map",
                signals.draw_scene(diagnostics.trajectory, diagnostics.gravity_target, scene, sightings),
                (Legend("dot", "before", "landmark"), Legend("dot", "accent", "seen in few images"),
                 *time_legends(_since_start(diagnostics))),
                "Landmarks, and the path of the IMU coloured by time. Down is known from gravity; the heading is any.",
            ),
            ReportTable("In numbers", ("", "least", "median", "most"), rows),
        ),
    )  # fmt: skip


def _spread(name: str, values: Floats, unit: str) -> tuple[str, ...]:
    known = finite_values(values)
    if not known.size:
        return (name, *("",) * 3)
    return (name, *(quantity_text(float(v), unit) if unit else number_text(float(v), 3)
                    for v in (known.min(), np.median(known), known.max())))  # fmt: skip


def _distances(diagnostics: CameraImuDiagnostics, points: Floats) -> Floats:
    return np.linalg.norm(points - np.nanmean(diagnostics.trajectory.p_target_imu, axis=0), axis=1)


def _since_start(diagnostics: CameraImuDiagnostics) -> Floats:
    t_ns = diagnostics.trajectory.t_ns
    return np.asarray((t_ns - t_ns[0]) * 1e-9, np.float64)


def biases_section(diagnostics: CameraImuDiagnostics) -> Section | None:
    """Return the biases over time; None without any."""
    if not diagnostics.biases:
        return None
    walks = "; ".join(
        f"{signal_name(name, diagnostics.biases).lower()} {number_text(bias.random_walk, 3)} "
        f"{readable_unit(bias.unit)} per √s"
        for name, bias in diagnostics.biases.items()
    )
    figure = Figure(
        "About their means",
        signals.bias_figure(diagnostics.biases),
        (
            *_AXES,
            Legend("band", "before", "±σ, in the axis's colour"),
            Legend("dash", "muted", "±3σ of the random walk"),
        ),
        f"The random walk that was assumed: {walks}. A bias that runs out of its bounds speaks of a larger "
        "walk, of a sensor that was still warming up, or of an error that the bias has taken on.",
    )
    return Section("biases", "Biases", blocks=(figure,))
