"""A camera-IMU calibration on one screen."""

from collections.abc import Iterator
from itertools import pairwise
from math import degrees, hypot, isclose, isfinite

import numpy as np

from ..calibration import Calibration
from ..diagnostics import CameraImuDiagnostics, Result
from ..models.origin import AXES
from ..recording import Floats
from ..writers.camera_entries import camera_entries
from ..writers.tables import value_text
from .summary import common_decimals


def facts(result: Result) -> Iterator[str]:
    """Yield lines on what the calibration rests on, how well it fits, and which noise was found."""
    calibration, diagnostics = result.calibration, result.diagnostics
    fit = calibration.assessment.camera_imu
    assert isinstance(diagnostics, CameraImuDiagnostics)
    assert fit is not None
    rest = "" if fit.converged else ", not converged"
    yield f"  trajectory         {fit.duration_s:.1f} s, {diagnostics.knots_per_s:.4g} knots/s{rest}"
    yield f"  model, body frame  {calibration.assessment.model}, {calibration.frame}"
    gravity = calibration.gravity
    sigma = f" +- {gravity.sigma:.2g}" if gravity.sigma else ""
    yield f"  gravity            {gravity.value:.6g}{sigma} m/s^2 ({gravity.source})"
    tilt = hypot(*(p.sigma for p in diagnostics.parameters if p.name.startswith("gravity.direction")))
    down = " ".join(f"{value:.4f}" for value in diagnostics.gravity_target.tolist())
    yield f"    on the board     {down} m/s^2" + (f", +- {degrees(tilt):.2g} deg" if tilt else "")
    for name, found in fit.frames_found.items():
        yield f"  {name:<18} {fit.frames_used[name]} of {found} frames, {fit.corners_used[name]} corners"
        yield f"    reprojection     {fit.reprojection_rms_px[name]:.3g} px (rms per axis)"
    yield "  noise found"
    for level in diagnostics.noise:
        if level.name.endswith(".walk"):  # where it matters a finding says so
            continue
        stated = f", stated {level.nominal:.3g} (x {level.estimated / level.nominal:.2f})"
        used = "" if isclose(level.used, level.estimated, rel_tol=0.02) else f"; used {level.used:.3g}"
        yield f"    {level.name:<18} {level.estimated:.3g} {level.unit}{stated * isfinite(level.nominal)}{used}"


def camera_lines(calibration: Calibration) -> Iterator[str]:
    """Yield the pose of every camera with its standard deviations, its time shift, and whatever else was estimated."""
    for name, camera in calibration.cameras.items():
        yield f"  {name} T_cam_imu (p_cam = T_cam_imu p_imu)"
        yield from _pose(calibration, f"{name}.T_cam_imu", camera.T_cam_imu)
        yield from _scalars(calibration, name)
    for first, second in pairwise(calibration.cameras):
        yield from _distance(calibration, first, second)


def imu_lines(calibration: Calibration) -> Iterator[str]:
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
    for entry, sigma in camera_entries(calibration, name):
        value = value_text(entry.value, sigma).replace("±", "+-")
        if entry.name == "time_shift_cam_imu":
            yield f"    time shift       {_shift(calibration, f'{name}.{entry.name}')} ms (t_imu = t_cam + shift)"
        elif entry.name.startswith(("R_", "t_", "p_")):
            continue
        elif sigma or (entry.name == "line_delay" and entry.value):
            yield f"    {entry.name:<16} {value} {entry.unit}".removesuffix(" 1")


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
