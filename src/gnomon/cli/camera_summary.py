"""A calibration of cameras alone on one screen."""

from collections.abc import Iterator
from itertools import pairwise
from math import degrees, isfinite

import numpy as np
from rich.table import Table

from ..calibration import Calibration, CamerasFit
from ..diagnostics import CamerasDiagnostics, Result
from ..models.lens_programs import PROGRAMS, knows
from ..units import share_words
from ..writers.baselines import baseline_of
from .summary import common_decimals


def facts(result: Result) -> Iterator[str]:
    """Yield lines on what the calibration rests on and how well it predicts views that it has not seen."""
    fit = result.calibration.assessment.cameras
    assert fit is not None
    for name, found in fit.views_found.items():
        rest = "" if fit.converged else ", not converged"
        yield f"  {name:<18} {fit.views_used[name]} of {found} views, {fit.corners_used[name]} corners{rest}"
        yield f"    reprojection     {fit.reprojection_rms_px[name]:.3g} px (rms per axis)"
        if isfinite(fit.holdout_rms_px[name]):
            yield f"    on unseen views  {fit.holdout_rms_px[name]:.3g} px"
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
    return [name for name in PROGRAMS if all(knows(name, lens) for lens in lenses)]


def _board(fit: CamerasFit) -> Iterator[str]:
    """Say what the views tell of the board."""
    if fit.aspect_sigma:
        yield f"  board, y over x    1 {fit.aspect:+.2g} +- {fit.aspect_sigma:.1g}"
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
    for heading in ("parameters", "unseen views [px]", "views used [px]"):
        table.add_column(heading, justify="right")
    for trial in diagnostics.trials:
        unseen, used = (_pixels(value) for value in (trial.holdout_rms_px, trial.rms_px))
        table.add_row(trial.camera, trial.model + " *" * trial.chosen, str(trial.parameters), unseen, used)
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
