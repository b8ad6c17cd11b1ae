"""A calibration of cameras, alone or with an IMU, on one screen."""

from collections.abc import Iterator
from itertools import pairwise
from math import degrees, hypot, isclose, isfinite

import numpy as np
from rich.table import Table

from ..findings import share_words
from ..formats.shared.entries import baseline_of, value_text
from ..models.camera import knows_lens
from ..models.lens_names import PROGRAMS
from ..models.origin import AXES
from ..recording import Floats
from ..results.calibration import Calibration, CamerasFit
from ..results.camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics
from ..results.result import Result
from .results import common_decimals, gravity_lines


def cameras_lines(result: Result) -> Iterator[str]:
    """Yield lines on what the calibration rests on and how well it predicts views that it has not seen."""
    fit = result.calibration.assessment.cameras
    assert fit is not None
    for name, found in fit.views_found.items():
        rest = "" if fit.converged else ", not converged"
        yield f"  {name:<18} {fit.views_used[name]} of {found} views, {fit.corners_used[name]} corners{rest}"
        yield f"    reprojection     {fit.reprojection_rms_px[name]:.3g} px (rms per axis)"
        if isfinite(fit.holdout_rms_px[name]):
            yield f"    hold-out         {fit.holdout_rms_px[name]:.3g} px"
        yield f"    coverage         {share_words(fit.coverage[name])} of the image"
    yield from _board(fit)
    yield from _readers(result.calibration)


def _readers(calibration: Calibration) -> Iterator[str]:
    """Say which programs read the lenses as they are, and which only one that is fitted anew."""
    reading = programs_reading(calibration)
    others = [name for name in PROGRAMS if name not in reading]
    anew = f"; gnomon convert fits another lens for {', '.join(others)} (or --for PROGRAM)" if others else ""
    yield f"  lens read by       {', '.join(reading) or 'none of the programs'}{anew}"


def programs_reading(calibration: Calibration) -> list[str]:
    """Return the programs that know the models of all lenses."""
    lenses = [camera.camera for camera in calibration.cameras.values()]
    return [name for name in PROGRAMS if all(knows_lens(name, lens) for lens in lenses)]


def _board(fit: CamerasFit) -> Iterator[str]:
    """Say what the views tell of the board."""
    if fit.aspect_sigma:
        decimals = common_decimals(np.array([fit.aspect_sigma]))
        yield f"  board, aspect      {1 + fit.aspect:.{decimals}f} +- {fit.aspect_sigma:.{decimals}f} (y over x)"
    if fit.bow_sigma_m:
        yield f"  board, bow         {1e3 * fit.bow_m:.2f} +- {1e3 * fit.bow_sigma_m:.2f} mm"
    if any("corners" in name or "offsets" in name for name in fit.board_added):
        yield "  board, corners     the place of each was estimated"
    if isfinite(fit.print_scale):
        yield f"  board, true size   {fit.print_scale:.5f} +- {fit.print_scale_sigma:.1g} of the stated one"


def trial_table(result: Result) -> Table:
    """Return the lens models that were tried, with their errors."""
    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CamerasDiagnostics)
    table = Table(title="lens models (* taken)", title_justify="left", title_style="bold", box=None)
    table.add_column("camera")
    table.add_column("model")
    for heading in ("parameters", "hold-out views [px]", "views used [px]"):
        table.add_column(heading, justify="right")
    for trial in diagnostics.trials:
        held_out, used = (_pixels(value) for value in (trial.holdout_rms_px, trial.rms_px))
        table.add_row(trial.camera, trial.model + " *" * trial.chosen, str(trial.parameters), held_out, used)
    return table


def _pixels(value: float) -> str:
    return f"{value:.4f}" if isfinite(value) else "-"


def parameter_table(calibration: Calibration, name: str) -> Table:
    """Return the lens of one camera and its pose to cam0, each number with its standard deviation."""
    calibrated = calibration.cameras[name]
    lens = calibrated.camera
    table = Table(title=f"{name} {lens.model}", title_justify="left", title_style="bold", box=None)
    table.add_column("parameter")
    table.add_column("estimate", justify="right")
    table.add_column("sigma", justify="right")
    table.add_column("unit")
    sigmas = np.concatenate([calibration.sigma(f"{name}.{key}") for key in ("intrinsics", "distortion_coeffs")])
    for symbol, kind, value, sigma in zip(
        lens.parameter_symbols, lens.parameter_kinds, lens.parameters, sigmas, strict=True
    ):
        unit = "px" if kind in ("focal", "principal") else ""
        table.add_row(symbol, *_pair(float(value), float(sigma)), unit)
    if name != calibrated.body:
        T, link = calibrated.T_cam_body, f"{name}.{calibrated.link}"
        moved, turned = calibration.sigma(f"{link}.translation"), calibration.sigma(f"{link}.rotation")
        for axis, value, sigma in zip("xyz", T[:3, 3] * 1e3, moved * 1e3, strict=True):
            table.add_row(f"t_{axis} from cam0", *_pair(float(value), float(sigma)), "mm")
        vector = np.degrees(calibration.parameter(f"{link}.rotation"))
        for axis, value, sigma in zip("xyz", vector, np.degrees(turned), strict=True):
            table.add_row(f"r_{axis} from cam0", *_pair(float(value), float(sigma)), "deg")
    return table


def _pair(value: float, sigma: float) -> tuple[str, str]:
    decimals = max(1 - int(np.floor(np.log10(sigma))), 0) if sigma > 0 else 6
    return f"{value:.{decimals}f}", f"{sigma:.{decimals}f}" if sigma > 0 else "fixed"


def baseline_lines(calibration: Calibration) -> Iterator[str]:
    """Yield how far apart neighbouring cameras are, and by which angle their axes are turned."""
    for first, second in pairwise(calibration.cameras):
        found = baseline_of(calibration, first, second)
        decimals = common_decimals(np.array([1e3 * found.distance_sigma]))
        angle = degrees(float(np.arccos(np.clip((np.trace(found.T[:3, :3]) - 1) / 2, -1.0, 1.0))))
        length = f"{1e3 * found.distance:.{decimals}f} +- {1e3 * found.distance_sigma:.{decimals}f} mm apart"
        yield f"  {first} to {second}       {length}, turned by {angle:.3f} deg"


def camera_imu_lines(result: Result) -> Iterator[str]:
    """Yield lines on what the calibration rests on, how well it fits, and which noise was found."""
    calibration, diagnostics = result.calibration, result.diagnostics
    fit = calibration.assessment.camera_imu
    assert isinstance(diagnostics, CameraImuDiagnostics)
    assert fit is not None
    rest = "" if fit.converged else ", not converged"
    yield f"  trajectory         {fit.duration_s:.1f} s, {diagnostics.knots_per_s:.4g} knots/s{rest}"
    yield f"  model, body frame  {calibration.assessment.model}, {calibration.frame}"
    yield from gravity_lines(calibration)
    tilt = hypot(*(p.sigma for p in diagnostics.parameters if p.name.startswith("gravity.direction")))
    down = " ".join(f"{value:.4f}" for value in diagnostics.gravity_target.tolist())
    where = "gravity on board" if diagnostics.scene is None else "gravity in map"
    yield f"  {where:<18} {down} m/s^2" + (f", +- {degrees(tilt):.2g} deg" if tilt else "")
    what = "corners" if diagnostics.scene is None else f"sightings of {len(diagnostics.scene.points)} landmarks"
    for name, found in fit.frames_found.items():
        yield f"  {name:<18} {fit.frames_used[name]} of {found} frames, {fit.corners_used[name]} {what}"
        yield f"    reprojection     {fit.reprojection_rms_px[name]:.3g} px (rms per axis)"
    yield "  noise found"
    for level in diagnostics.noise:
        if level.name.endswith(".walk"):  # where it matters a finding says so
            continue
        stated = f", stated {level.nominal:.3g} (x {level.estimated / level.nominal:.2f})"
        used = "" if isclose(level.used, level.estimated, rel_tol=0.02) else f"; used {level.used:.3g}"
        yield f"    {level.name:<18} {level.estimated:.3g} {level.unit}{stated * isfinite(level.nominal)}{used}"


def camera_pose_lines(calibration: Calibration) -> Iterator[str]:
    """Yield the pose of every camera with its standard deviations, its time shift, and whatever else was estimated."""
    for name, camera in calibration.cameras.items():
        yield f"  {name} T_cam_imu (p_cam = T_cam_imu p_imu)"
        yield from _pose(calibration, f"{name}.T_cam_imu", camera.T_cam_imu)
        yield from _scalars(calibration, name)
    for first, second in pairwise(calibration.cameras):
        yield from _distance(calibration, first, second)


def imu_pose_lines(calibration: Calibration) -> Iterator[str]:
    """Yield the origin of every IMU, pose and clock of those beside imu0, and the clocks of accelerometers."""
    for name, imu in calibration.imus.items():
        yield from _origin(calibration, name)
        if imu.T_imu_body is not None:
            yield f"  {name} T_imu_body (p_{name} = T_imu_body p_imu0)"
            yield from _pose(calibration, f"{name}.T_imu_body", imu.T_imu_body)
            yield f"    time shift       {_shift(calibration, f'{name}.time_shift_imu')} ms (t_imu0 = t_{name} + shift)"
        if imu.accelerometer is not None and imu.accelerometer.time_shift_s is not None:
            shift = _shift(calibration, f"{name}.accelerometer.time_shift")
            yield f"  {name} accelerometer"
            yield f"    time shift       {shift} ms (t_gyr = t_acc + shift)"


def _origin(calibration: Calibration, name: str) -> Iterator[str]:
    """Say of which point of an IMU its poses are, and where its accelerometers sit from there."""
    imu = calibration.imus[name]
    arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
    if arms is None or imu.origin is None:
        return
    yield f"  {name} origin        {imu.origin.words}; from it, in mm"
    sigmas = calibration.sigma(f"{name}.accelerometer.lever_arms_m")
    for axis, arm, sigma in zip(AXES, arms, sigmas, strict=True):
        yield f"    {axis} accelerometer  {_numbers(1e3 * arm, 1e3 * sigma)}"


def _pose(calibration: Calibration, path: str, T: Floats) -> Iterator[str]:
    for row in T[:3]:
        yield "    " + "".join(f"{value:11.6f}" for value in row[:3]) + f"{row[3]:13.6f}"
    rotation = np.degrees(calibration.sigma(f"{path}.rotation"))
    translation = calibration.sigma(f"{path}.translation") * 1e3
    yield f"    rotation         +- {' '.join(f'{value:.2g}' for value in rotation)} deg about the body's x, y, z"
    yield f"    translation      {_numbers(T[:3, 3] * 1e3, translation)} mm"


def _shift(calibration: Calibration, path: str) -> str:
    """Return a time shift in ms; also that of unrelated clocks, days apart."""
    return _numbers(1e3 * np.atleast_1d(calibration.parameter(path)), 1e3 * np.atleast_1d(calibration.sigma(path)))


def _scalars(calibration: Calibration, name: str) -> Iterator[str]:
    """Say the time shift, and what was estimated of the lens, or delays its rows."""
    yield f"    time shift       {_shift(calibration, f'{name}.time_shift_cam_imu')} ms (t_imu = t_cam + shift)"
    delay, sigma = (1e6 * float(of(f"{name}.line_delay")) for of in (calibration.parameter, calibration.sigma))
    if sigma or delay:
        yield f"    {'line_delay':<16} {_value(delay, sigma)} us"
    lens = calibration.cameras[name].camera
    sigmas = np.concatenate([calibration.sigma(f"{name}.{key}") for key in ("intrinsics", "distortion_coeffs")])
    scalars = zip(lens.parameter_symbols, lens.parameter_kinds, lens.parameters.tolist(), sigmas.tolist(), strict=True)
    for symbol, kind, value, sigma in scalars:
        if sigma:
            unit = " px" if kind in ("focal", "principal") else ""
            yield f"    {symbol:<16} {_value(value, sigma)}{unit}"


def _value(value: float, sigma: float) -> str:
    return value_text(value, sigma).replace("±", "+-")


def _distance(calibration: Calibration, first: str, second: str) -> Iterator[str]:
    """Say how far apart two cameras are, and by which angle their axes are turned."""
    one, other = (calibration.cameras[name].T_cam_imu for name in (first, second))
    places = [-T[:3, :3].T @ T[:3, 3] for T in (one, other)]
    apart = float(np.linalg.norm(places[1] - places[0])) * 1e3
    cosine = (np.trace(other[:3, :3] @ one[:3, :3].T) - 1) / 2
    angle = degrees(float(np.arccos(np.clip(cosine, -1.0, 1.0))))
    yield f"  {first} to {second}       {apart:.2f} mm apart, turned by {angle:.3f} deg"


def _numbers(values: Floats, sigmas: Floats) -> str:
    decimals = common_decimals(sigmas)
    cells = zip(values.tolist(), sigmas.tolist(), strict=True)
    return "   ".join(
        f"{value:.{decimals}f}" + (f" +- {sigma:.{decimals}f}" if sigma else "") for value, sigma in cells
    )
