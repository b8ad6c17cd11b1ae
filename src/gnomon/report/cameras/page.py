"""The report of a calibration of cameras alone: its page, and sections on lenses, coverage, residuals and the board."""

from collections.abc import Mapping
from math import isfinite

import numpy as np

from ...findings import join_names
from ...models.camera import Camera
from ...recording import Floats
from ...results.calibration import Calibration, CamerasFit
from ...results.camera_diagnostics import CamerasDiagnostics
from ..camera_images import images_section
from ..certificate import calibration_page
from ..corners import (
    CornerView,
    corner_scatter,
    corner_view,
    draw_arrows,
    draw_corner_coverage,
    field_figure,
    frames_figure,
    frames_left_out,
    unseen_places,
)
from ..drawing.figures import WIDTH, Plot, Sheet, draw_dots
from ..drawing.rig import rig_drawing
from ..numbers import MISSING, estimate_text, finite_values, largest_magnitude, number_text, percent_text, positive_or
from ..page import (
    Block,
    Code,
    Figure,
    KeyNumber,
    Legend,
    ParameterTable,
    ReportPage,
    ReportTable,
    Section,
    aligned_matrix,
    assumptions_section,
    provenance_section,
)
from ..rig_parameters import lens_groups, pose_groups, pose_numbers
from ..trust import noise_table, parameters_section, steps_table, trust_section
from .lens import (
    ProjectionSpread,
    RadialCurve,
    field_of_view,
    lens_covariance,
    lens_section,
    projection_spread,
    radial_curve,
)
from .views import epipolar_tables, views_section

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
        lenses_section(calibration, diagnostics),
        trust_section(calibration.assessment, diagnostics.trust),
        cameras_coverage_section(diagnostics, views, fit) if views else None,
        cameras_residuals_section(diagnostics, views),
        views_section(diagnostics),
        lens_section(calibration, diagnostics, views, curves, spreads),
        board_section(fit, diagnostics) if fit is not None else None,
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


_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")


def lenses_section(calibration: Calibration, diagnostics: CamerasDiagnostics) -> Section:
    """Return the lenses, and where the cameras sit to the first one."""
    several = len(calibration.cameras) > 1
    blocks: list[Block] = [
        ParameterTable(title=name if several else "", groups=lens_groups(calibration, name))
        for name in calibration.cameras
    ]
    if several:
        first = next(iter(calibration.cameras))
        blocks.append(
            Figure(
                "The rig",
                rig_drawing(calibration),
                _AXES,
                f"The frames of the cameras, to scale, seen from behind {first}, a little from above. A "
                "camera's z looks out of the lens, x to the right of its image, y down.",
            )
        )
    for name, camera in calibration.cameras.items():
        if groups := pose_groups(calibration, name):
            blocks += [
                ParameterTable(title=f"{name} against {camera.body}", groups=groups),
                Code(
                    f"{camera.link} of {name}: p_cam = {camera.link} p_{camera.body}, in metres",
                    aligned_matrix(camera.link, camera.T_cam_body),
                ),
            ]
    blocks += epipolar_tables(calibration, diagnostics)
    lead = "The lens of each camera" + (", and the relative poses of the cameras" if several else "")
    return Section(
        "cameras",
        "Cameras" if several else "Lens",
        f"{lead}, each number with its standard deviation σ. Pixel (0, 0) is the middle of the upper left pixel.",
        blocks,
    )


def cameras_coverage_section(
    diagnostics: CamerasDiagnostics, views: dict[str, CornerView], fit: CamerasFit | None
) -> Section:
    """Return where in the image corners were used."""
    counts = {name: diagnostics.coverage.get(name, np.ones((1, 1))) for name in views}
    shares = {name: float(np.mean(np.asarray(count) > 0)) for name, count in counts.items()}
    if fit is not None:
        shares |= {name: part for name, part in fit.coverage.items() if name in shares}
    reached = "; ".join(f"{name} {percent_text(part)}" for name, part in shares.items())
    return Section(
        "coverage",
        "Coverage",
        "Where there were no corners nothing tests the lens: its model is carried on there by its formula alone.",
        (
            Figure(
                "Corners in the image",
                draw_corner_coverage(views, counts),
                (
                    Legend("dot", "after", "corner used"),
                    Legend("band", "accent", "cell without any"),
                    Legend("dash", "accent", "hold the board there next"),
                ),
                f"Share of the cells with corners: {reached}. {_next_views(counts)}",
            ),
        ),
    )


def _next_views(counts: dict[str, Floats]) -> str:
    parts = [
        f"{name} in the {join_names([place for _, place in found])}"
        for name, count in counts.items()
        if (found := unseen_places(count))
    ]
    if not parts:
        return "No larger part of an image is without corners."
    return f"Hold the board where corners are missing: {'; '.join(parts)} of the image. Tilt it there to both sides."


def cameras_residuals_section(diagnostics: CamerasDiagnostics, views: dict[str, CornerView]) -> Section:
    """Return what is left of the corners: over the image, their scatter, and view by view."""
    blocks: list[Block] = [field_figure(views)] if views else []
    for name, view in views.items():
        blocks += [corner_scatter(name, view), frames_figure(name, view, "view")]
    blocks += frames_left_out(diagnostics.corners, "Views that were not used")
    return Section(
        "residuals",
        "Residuals",
        "Residuals that look like noise, without a pattern over the image and alike in views used and held out, "
        "say that the lens model is right and does not follow the noise.",
        blocks,
    )


_STEPS = 4
"""Sizes of the dots that show how far a point is out of the plane."""
_TO_SPEAK_OF = 0.05
"""Share of the largest shift from which shifts in the plane are drawn."""
_SHAPES = {"target.aspect": "aspect", "target.bow": "bow", "target.corners": "place of every point"}


def board_section(fit: CamerasFit, diagnostics: CamerasDiagnostics) -> Section:
    """Return what was found of the board."""
    shifts = np.asarray(diagnostics.board_shifts, dtype=np.float64)
    blocks: list[Block] = []
    added = ", ".join(_SHAPES.get(name, name) for name in fit.board_added)
    if shifts.any():
        blocks.append(_figure(diagnostics.board_points, shifts))
    blocks.append(_numbers(fit, shifts))
    lead = (
        f"The views prove that the board is not as stated; estimated: {added}."
        if added
        else "The board was taken as stated: flat, and its points where the file says. Nothing else was estimated."
    )
    return Section("board", "Board", lead, blocks)


def _numbers(fit: CamerasFit, shifts: Floats) -> ReportTable:
    def row(name: str, value: float, sigma: float, unit: str, meaning: str) -> tuple[str, ...]:
        held = not (isfinite(value) and sigma > 0)
        text = "not estimated" if held else f"{estimate_text(value, sigma, sign=True)} {unit}".replace(" ", "\u00a0")
        return name, text, meaning

    rows = [
        row("aspect", 100 * fit.aspect, 100 * fit.aspect_sigma, "%", "scale of y over that of x, minus 1"),
        row("bow", 1e3 * fit.bow_m, 1e3 * fit.bow_sigma_m, "mm", "of the middle, towards the viewer"),
        row("print scale", 100 * (fit.print_scale - 1), 100 * fit.print_scale_sigma, "%",
            "true size over stated, minus 1; needs --baseline"),
    ]  # fmt: skip
    for name, part in (("largest shift in the plane", shifts[:, :2]), ("largest shift out of it", shifts[:, 2:])):
        size = largest_magnitude(np.linalg.norm(part, axis=1)) if len(part) else float("nan")
        text = f"{number_text(1e3 * size, 2)}\u00a0mm" if size > 0 else MISSING
        rows.append((name, text, "of a point"))
    return ReportTable("In numbers", ("", "found", "what it is"), rows, remarked=True)


def _figure(points: Floats, shifts: Floats) -> Figure:
    longer = _magnification(points, shifts)
    high = 1e3 * largest_magnitude(shifts[:, 2])
    drawn = f"Arrows are {number_text(longer)} times as long as the shifts. " if longer else ""
    return Figure(
        "Where the points of the board are",
        draw_board_shape(points, shifts, longer),
        (
            Legend("dot", "after", "above the plane (+z)"),
            Legend("dot", "heldout", "below it (−z)"),
            *((Legend("line", "ink", "shift in the plane"),) if longer else ()),
        ),
        f"{drawn}The larger a dot, the farther its point is out of the plane, up to {number_text(high, 2)} mm. What "
        "a shift, a turn and a common scale of all points do is part of the poses, and was taken off.",
    )


def _magnification(points: Floats, shifts: Floats) -> float:
    """Return by how much arrows are lengthened, a round number; zero without shifts in the plane to speak of."""
    most = largest_magnitude(np.linalg.norm(shifts[:, :2], axis=1))
    if not most > _TO_SPEAK_OF * largest_magnitude(shifts):
        return 0.0
    wanted = 0.06 * positive_or(float(np.ptp(points[:, :2], axis=0).max())) / most
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * 1.0001))


def draw_board_shape(points: Floats, shifts: Floats, longer: float) -> Plot:
    """Draw the points with dots for how high they are and arrows for how they are shifted in the plane."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    room = 0.09 * positive_or(float((high - low).max()))
    low, high = low - room, high + room
    width = min(WIDTH - 90, 470 * (high[0] - low[0]) / (high[1] - low[1]))
    height = width * (high[1] - low[1]) / (high[0] - low[0])
    up, most = shifts[:, 2], positive_or(largest_magnitude(shifts[:, 2]))

    sheet = Sheet()
    panel = sheet.panel("Board: y over x [m]", top=36, height=height, left=62, right=WIDTH - 62 - width)
    panel.x.grid = True
    panel.x.span(low[0], high[0])
    panel.y.span(low[1], high[1])
    for color, sign in (("after", 1.0), ("heldout", -1.0)):
        step = np.ceil(_STEPS * np.clip(sign * up / most, 0, 1)).astype(int)
        for k in range(1, _STEPS + 1):
            draw_dots(panel, points[step == k, 0], points[step == k, 1], color, size=2.5 + 3.0 * k)
    draw_dots(panel, points[:, 0], points[:, 1], "ink", size=1.6)
    if longer:
        draw_arrows(panel, points[:, :2], longer * shifts[:, :2], "ink")
    return sheet.draw("board", height + 84, f"Shifts of the {len(points)} points of the board.")
