"""What the report of a calibration of cameras alone says: the page of page.py, filled from a Result."""

from collections.abc import Mapping
from math import isfinite

import numpy as np

from ..calibration import Calibration, CamerasFit
from ..diagnostics import CamerasDiagnostics
from . import cameras_sections as sections
from .camera_imu_corners import CornerView, corner_view
from .camera_imu_quality import images_section
from .camera_imu_sections import noise_table, parameters_section, steps_table
from .cameras_board import board_section
from .cameras_lens import ProjectionSpread, RadialCurve, field_of_view, lens_covariance, projection_spread, radial_curve
from .cameras_parameters import pose_numbers
from .cameras_use import use_section
from .numbers import MISSING, finite, number, share, with_sigma
from .page import KeyNumber, Page, Prose, Section, typeset
from .sections import calibration_page, provenance_section
from .trust_section import trust_section

_WHOLE = 0.97
"""Share of the image that corners reached from which it is taken for all of it."""


def cameras_page(calibration: Calibration, diagnostics: CamerasDiagnostics) -> Page:
    """Return the page of a calibration of cameras alone."""
    fit = calibration.assessment.cameras
    views = {
        name: corner_view(diagnostics.corners[name]) for name in calibration.cameras if name in diagnostics.corners
    }
    curves, spreads = _lenses(calibration, views)
    parts = (
        sections.cameras_section(calibration, diagnostics),
        trust_section(calibration.assessment, diagnostics.trust),
        sections.coverage_section(diagnostics, views, fit) if views else None,
        sections.residuals_section(diagnostics, views),
        sections.views_section(diagnostics),
        sections.lens_section(calibration, diagnostics, views, curves, spreads),
        board_section(fit, diagnostics) if fit is not None else None,
        images_section(diagnostics.corners),
        parameters_section(diagnostics),
        _solution(diagnostics, converged=fit is None or fit.converged),
        _assumptions(calibration, fit),
        use_section(calibration),
        provenance_section(calibration.provenance),
    )
    return calibration_page("Camera calibration", calibration, _key_numbers(calibration, fit, curves, spreads), parts)


def _lenses(
    calibration: Calibration, views: dict[str, CornerView]
) -> tuple[dict[str, RadialCurve], dict[str, ProjectionSpread]]:
    """Return what each lens does, and how well its projection is known where it was estimated."""
    curves: dict[str, RadialCurve] = {}
    spreads: dict[str, ProjectionSpread] = {}
    for name, entry in calibration.cameras.items():
        covariance = np.nan_to_num(lens_covariance(calibration, name))
        fit = views[name].fit if name in views else None
        pixels = np.empty((0, 2)) if fit is None else fit.pixels[np.asarray(fit.frame_used, dtype=bool)[fit.frame]]
        curves[name] = radial_curve(entry.camera, covariance, pixels)
        if fit is not None and covariance.any():
            spreads[name] = projection_spread(entry.camera, covariance, pixels)
    return curves, spreads


def _key_numbers(
    calibration: Calibration,
    fit: CamerasFit | None,
    curves: dict[str, RadialCurve],
    spreads: dict[str, ProjectionSpread],
) -> tuple[KeyNumber, ...]:
    numbers = [*_fit_numbers(fit)] if fit is not None else []
    numbers.append(_focal(calibration, curves))
    if spreads:
        numbers.append(_certainty(spreads))
    others = [name for name, camera in calibration.cameras.items() if name != camera.body]
    if others:
        values, sigmas = pose_numbers(calibration, others[0])
        text, sigma = with_sigma(float(values[3]), float(sigmas[3]))
        note = "; ".join(f"{name} {number(float(pose_numbers(calibration, name)[0][3]), 5)} mm" for name in others[1:])
        value = f"{text}{f' ± {sigma}' if sigma else ''}\u00a0mm"
        numbers.append(KeyNumber(f"Baseline to {others[0]}", value, note or "from cam0"))
    else:
        lens = next(iter(calibration.cameras.values())).camera
        wide, high = (f"{number(float(np.degrees(v)), 3)}°" for v in field_of_view(lens))
        numbers.append(KeyNumber("Field of view", f"{wide} × {high}", "across, from top to bottom"))
    return tuple(numbers)


def _fit_numbers(fit: CamerasFit) -> tuple[KeyNumber, KeyNumber, KeyNumber]:
    several = len(fit.views_used) > 1
    used = _pooled(fit.corners_used, fit.reprojection_rms_px)
    held = _pooled(fit.corners_used, fit.holdout_rms_px)
    each = "; ".join(f"{name} {number(rms, 3)}" for name, rms in fit.holdout_rms_px.items())
    known = f"per axis, of views that the estimate had not seen; of those it had {number(used, 3)} px"
    unknown = f"no view was held out; of the views used {number(used, 3)} px"
    counts = "; ".join(f"{name} {used} of {fit.views_found[name]}" for name, used in fit.views_used.items())
    least = min(fit.coverage, key=lambda name: fit.coverage[name], default="")
    shares = "; ".join(f"{name} {share(part)}" for name, part in fit.coverage.items())
    return (
        KeyNumber(
            "Hold-out reprojection",
            f"{number(held, 3, trim=False)}\u00a0px" if isfinite(held) else MISSING,
            (known if isfinite(held) else unknown) + (f" ({each})" if several and isfinite(held) else ""),
        ),
        KeyNumber(
            "Views used",
            f"{max(fit.views_used.values(), default=0)} of {max(fit.views_found.values(), default=0)}",
            f"{sum(fit.corners_used.values())} corners" + (f": {counts}" if several else ""),
        ),
        KeyNumber(
            "Image covered",
            share(fit.coverage[least]) if least else MISSING,
            shares if several else "of its cells hold corners that were used",
        ),
    )


def _pooled(corners: Mapping[str, int], rms_px: Mapping[str, float]) -> float:
    """Return the root mean square over all cameras, by their numbers of corners [px]; nan without any."""
    known = [name for name, rms in rms_px.items() if isfinite(rms) and corners.get(name)]
    total = sum(corners[name] for name in known)
    return float(np.sqrt(sum(corners[name] * rms_px[name] ** 2 for name in known) / total)) if total else float("nan")


def _focal(calibration: Calibration, curves: dict[str, RadialCurve]) -> KeyNumber:
    name, curve = next(iter(curves.items()))
    text, sigma = with_sigma(curve.focal, curve.focal_sigma)
    models = ", ".join(dict.fromkeys(entry.camera.model for entry in calibration.cameras.values()))
    return KeyNumber(
        f"Focal length of {name}",
        f"{text}{f' ± {sigma}' if sigma else ''}\u00a0px",
        f"at the axis, mean of u and v; {models}",
    )


def _certainty(spreads: dict[str, ProjectionSpread]) -> KeyNumber:
    """Return how well the image of a ray is known, of the worst camera."""

    def median(one: ProjectionSpread) -> float:
        known = finite(one.sigma[one.seen])
        return float(np.median(known)) if known.size else float("nan")

    name = max(spreads, key=lambda name: np.nan_to_num(median(spreads[name])))
    one = spreads[name]
    most = float(np.max(finite(one.sigma[one.seen]), initial=0.0))
    beyond = "; nothing tests it elsewhere" if np.mean(one.seen) < _WHOLE else ""
    return KeyNumber(
        "σ of the projection",
        f"{number(median(spreads[name]), 2)}\u00a0px",
        f"where {name} saw corners, at most {number(most, 2)} px{beyond}",
    )


def _solution(diagnostics: CamerasDiagnostics, *, converged: bool) -> Section:
    blocks = [*noise_table(diagnostics.noise, "motion blur"), *steps_table(diagnostics.steps, converged=converged)]
    return Section("solution", "Noise and solution", blocks=blocks)


def _assumptions(calibration: Calibration, fit: CamerasFit | None) -> Section:
    added = () if fit is None else fit.board_added
    shape = "" if any(name != "target.aspect" for name in added) else "flat and "
    points = [
        "Frames: the body frame is that of cam0. Lengths in metres, angles in radians unless another unit stands by."
    ]
    if fit is None or not isfinite(fit.print_scale):
        points.append(
            f"The board is {shape}as large as its file says. Lenses do not depend on its size; an error of it is the "
            "same relative error of every length, the baselines included. A ruler along the board settles it."
        )
    points.append("The board is rigid: it has the same shape in all views.")
    if len(calibration.cameras) > 1:
        points.append("The cameras are fixed to each other, and images with one stamp were taken at one instant.")
    for name, entry in calibration.cameras.items():
        points.append(f"All rows of an image of {name} are exposed at once, or the camera stood still.")
        if not calibration.sigma(f"{name}.intrinsics").any():
            points.append(f"The lens of {name} ({entry.camera.model}) is as given; it was not estimated.")
    points += [typeset(finding).message for finding in calibration.assessment.findings if finding.code == "assumed"]
    if held := calibration.assessment.held_by_prior:
        points.append(f"Not determined by these views, and held by assumption: {', '.join(held)}.")
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))
