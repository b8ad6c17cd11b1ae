"""What the report of a calibration of cameras alone says: the page of page.py, filled from a Result."""

from collections.abc import Mapping
from math import isfinite

import numpy as np

from ...models.camera import Camera
from ...recording import Floats
from ...results.calibration import Calibration, CamerasFit
from ...results.camera_diagnostics import CamerasDiagnostics
from ..camera_images import images_section
from ..certificate import calibration_page
from ..corners import CornerView, corner_view
from ..numbers import MISSING, estimate_text, finite_values, number_text, percent_text
from ..page import Code, KeyNumber, ReportPage, Section, assumptions_section, provenance_section
from ..rig_parameters import pose_numbers
from ..trust import noise_table, parameters_section, steps_table, trust_section
from . import sections
from .lens import ProjectionSpread, RadialCurve, field_of_view, lens_covariance, projection_spread, radial_curve

_WHOLE = 0.97
"""Share of the image that corners reached from which it is taken for all of it."""


def cameras_page(calibration: Calibration, diagnostics: CamerasDiagnostics) -> ReportPage:
    """Return the page of a calibration of cameras alone."""
    fit = calibration.assessment.cameras
    views = {
        name: corner_view(diagnostics.corners[name]) for name in calibration.cameras if name in diagnostics.corners
    }
    curves, spreads = _lenses(calibration, views)
    parts = (
        sections.lenses_section(calibration, diagnostics),
        trust_section(calibration.assessment, diagnostics.trust),
        sections.cameras_coverage_section(diagnostics, views, fit) if views else None,
        sections.cameras_residuals_section(diagnostics, views),
        sections.views_section(diagnostics),
        sections.lens_section(calibration, diagnostics, views, curves, spreads),
        sections.board_section(fit, diagnostics) if fit is not None else None,
        images_section(diagnostics.corners),
        parameters_section(diagnostics),
        _solution(diagnostics, converged=fit is None or fit.converged),
        _assumptions(calibration, fit),
        cameras_use_section(calibration),
        provenance_section(calibration.provenance),
    )
    numbers = _key_numbers(calibration, fit, curves, spreads)
    return calibration_page("Camera calibration", calibration, numbers, parts, ("coverage", "residuals", "lens"))


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
        note = "; ".join(
            f"{name} {number_text(float(pose_numbers(calibration, name)[0][3]), 5)} mm" for name in others[1:]
        )
        value = f"{estimate_text(float(values[3]), float(sigmas[3]))}\u00a0mm"
        numbers.append(KeyNumber(f"Baseline to {others[0]}", value, note or "from cam0"))
    else:
        lens = next(iter(calibration.cameras.values())).camera
        wide, high = (f"{number_text(float(np.degrees(v)), 3)}°" for v in field_of_view(lens))
        numbers.append(KeyNumber("Field of view", f"{wide} × {high}", "across, from top to bottom"))
    return tuple(numbers)


def _fit_numbers(fit: CamerasFit) -> tuple[KeyNumber, KeyNumber, KeyNumber]:
    several = len(fit.views_used) > 1
    used = _pooled(fit.corners_used, fit.reprojection_rms_px)
    held = _pooled(fit.corners_used, fit.holdout_rms_px)
    each = "; ".join(f"{name} {number_text(rms, 3)}" for name, rms in fit.holdout_rms_px.items())
    known = f"per axis, of views that the estimate had not seen; of those it had {number_text(used, 3)} px"
    unknown = f"no view was held out; of the views used {number_text(used, 3)} px"
    counts = "; ".join(f"{name} {used} of {fit.views_found[name]}" for name, used in fit.views_used.items())
    least = min(fit.coverage, key=lambda name: fit.coverage[name], default="")
    shares = "; ".join(f"{name} {percent_text(part)}" for name, part in fit.coverage.items())
    return (
        KeyNumber(
            "Hold-out reprojection",
            f"{number_text(held, 3, trim=False)}\u00a0px" if isfinite(held) else MISSING,
            (known if isfinite(held) else unknown) + (f" ({each})" if several and isfinite(held) else ""),
        ),
        KeyNumber(
            "Views used",
            f"{max(fit.views_used.values(), default=0)} of {max(fit.views_found.values(), default=0)}",
            f"{sum(fit.corners_used.values())} corners" + (f": {counts}" if several else ""),
        ),
        KeyNumber(
            "Image covered",
            percent_text(fit.coverage[least]) if least else MISSING,
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
    models = ", ".join(dict.fromkeys(entry.camera.model for entry in calibration.cameras.values()))
    return KeyNumber(
        f"Focal length of {name}",
        f"{estimate_text(curve.focal, curve.focal_sigma)}\u00a0px",
        f"at the axis, mean of u and v; {models}",
    )


def _certainty(spreads: dict[str, ProjectionSpread]) -> KeyNumber:
    """Return how well the image of a ray is known, of the worst camera."""

    def median(one: ProjectionSpread) -> float:
        known = finite_values(one.sigma[one.seen])
        return float(np.median(known)) if known.size else float("nan")

    name = max(spreads, key=lambda name: np.nan_to_num(median(spreads[name])))
    one = spreads[name]
    most = float(np.max(finite_values(one.sigma[one.seen]), initial=0.0))
    beyond = "; nothing tests it elsewhere" if np.mean(one.seen) < _WHOLE else ""
    return KeyNumber(
        "σ of the projection",
        f"{number_text(median(spreads[name]), 2)}\u00a0px",
        f"where {name} saw corners, at most {number_text(most, 2)} px{beyond}",
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
        points.append("The cameras are fixed to each other, and images with one timestamp were taken at one instant.")
    for name, entry in calibration.cameras.items():
        points.append(f"All rows of an image of {name} are exposed at once, or the camera stood still.")
        if not calibration.sigma(f"{name}.intrinsics").any():
            points.append(f"The lens of {name} ({entry.camera.model}) is as given; it was not estimated.")
    return assumptions_section(calibration, points, by="these views")


PROJECTION_FORMULAS = {
    "pinhole": "m = (x, y) / z",
    "omni": "m = (x, y) / (ξ ρ + z),  ρ = |p|",
    "eucm": "m = (x, y) / (α d + (1 − α) z),  d = √(β (x² + y²) + z²)",
    "ds": "m = (x, y) / (α d₂ + (1 − α) z₂),  z₂ = ξ ρ + z,  d₂ = √(x² + y² + z₂²),  ρ = |p|",
}
DISTORTION_FORMULAS = {
    "none": "d = m",
    "radtan": "s = |m|²,  d = (1 + k1 s + k2 s²) m + (2 p1 mx my + p2 (s + 2 mx²), 2 p2 mx my + p1 (s + 2 my²))",
    "radtan5": "s = |m|²,  d = (1 + k1 s + k2 s² + k3 s³) m + (2 p1 mx my + p2 (s + 2 mx²), 2 p2 mx my + "
    "p1 (s + 2 my²))",
    "equidistant": "θ = atan |m|,  d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) m / |m|",
    "fov": "d = atan(2 |m| tan(w/2)) m / (w |m|)",
}
_FILES = """\
calibration.yaml      everything, with covariance, findings and origin
camchain.yaml         lenses and baselines, as Kalibr writes them
results-cam.txt       summary, as Kalibr writes it
diagnostics.npz       the numbers behind the figures of this report"""


def cameras_use_section(calibration: Calibration) -> Section:
    """Return files, formulas and code for each lens, and what to do next."""
    blocks = [Code("Files beside this report", _FILES), Code("Next: the same cameras with an IMU", NEXT)]
    for name, entry in calibration.cameras.items():
        of = f" of {name}" if len(calibration.cameras) > 1 else ""
        blocks.append(Code(f"The lens{of}: from p = (x, y, z) in its frame to pixels", _formula(entry.camera)))
        if opencv := _opencv(entry.camera):
            blocks.append(Code(f"In OpenCV{of}", opencv))
    blocks.append(Code("In Python: straighten an image, whatever the lens", _python(calibration)))
    for name, entry in calibration.cameras.items():
        blocks.append(Code(f"{name} in Kalibr's camchain.yaml", _camchain(calibration, name, entry.camera)))
    return Section(
        "use",
        "How to use it",
        "A camera's x points to the right of its image, y down, z out of the lens; lengths are in metres, pixels "
        "are counted from the middle of the upper left one.",
        blocks,
    )


NEXT = """\
gnomon camera-imu RECORDING --cam calibration.yaml --imu imu.yaml --target target.yaml
gnomon show calibration.yaml
gnomon compare calibration.yaml ANOTHER/calibration.yaml"""


def _formula(camera: Camera) -> str:
    names, values = camera.parameter_symbols, camera.parameters.tolist()
    numbers = [f"{name} = {value:.10g}" for name, value in zip(names, values, strict=True)]
    split = len(camera.intrinsics)
    rows = [
        PROJECTION_FORMULAS[camera.projection],
        DISTORTION_FORMULAS[camera.distortion],
        "u = fu dx + pu,  v = fv dy + pv",
        "",
    ]
    rows += [", ".join(numbers[:split])] + ([", ".join(numbers[split:])] if numbers[split:] else [])
    return "\n".join(rows)


def _opencv(camera: Camera) -> str:
    """Return the lens as OpenCV has it; "" where it has none like it."""
    if camera.projection != "pinhole" or camera.distortion == "fov":
        return ""
    fu, fv, pu, pv = (f"{value:.10g}" for value in camera.intrinsics.tolist())
    coeffs = ", ".join(f"{value:.10g}" for value in camera.distortion_coeffs.tolist())
    fisheye = camera.distortion == "equidistant"
    call = "cv2.fisheye.undistortImage(image, K, d, Knew=K)" if fisheye else "cv2.undistort(image, K, d)"
    return (
        "import cv2\nimport numpy as np\n\n"
        f"K = np.array([[{fu}, 0, {pu}], [0, {fv}, {pv}], [0, 0, 1]])\n"
        f"d = np.array([{coeffs}])\n"
        f"straight = {call}"
    )


def _python(calibration: Calibration) -> str:
    name = next(iter(calibration.cameras))
    return (
        "import cv2\nimport gnomon\nimport numpy as np\n\n"
        'calibration = gnomon.load("calibration.yaml")\n'
        f"lens = calibration.cameras[{name!r}].camera\n"
        f'sigma = calibration.sigma("{name}.intrinsics")\n'
        "width, height = lens.resolution\n"
        "v, u = np.mgrid[:height, :width].astype(float)\n"
        "pu, pv = lens.intrinsics[-2:]\n"
        "focal = lens.project(np.array([[0.0, 0.0, 1.0]])).by_point[0]  # px per radian at the axis\n"
        "rays = np.stack([(u - pu) / focal[0, 0], (v - pv) / focal[1, 1], np.ones_like(u)], axis=-1).reshape(-1, 3)\n"
        "at = lens.project(rays).pixels.reshape(height, width, 2).astype(np.float32)\n"
        "straight = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)"
    )


def _camchain(calibration: Calibration, name: str, camera: Camera) -> str:
    def row(values: Floats) -> str:
        return f"[{', '.join(f'{value:.12g}' for value in values.tolist())}]"

    lines = [
        f"{name}:",
        f"  camera_model: {camera.projection}",
        f"  intrinsics: {row(camera.intrinsics)}",
        f"  distortion_model: {camera.distortion}",
        f"  distortion_coeffs: {row(camera.distortion_coeffs)}",
        f"  resolution: [{camera.resolution[0]}, {camera.resolution[1]}]",
        f"  rostopic: {camera.topic or '/' + name + '/image_raw'}",
    ]
    before = list(calibration.cameras)[: list(calibration.cameras).index(name)]
    if before:
        T_before = calibration.cameras[before[-1]].T_cam_body
        T = calibration.cameras[name].T_cam_body @ np.linalg.inv(T_before)
        lines += ["  T_cn_cnm1:", *(f"  - {row(values)}" for values in T)]
    return "\n".join(lines)
