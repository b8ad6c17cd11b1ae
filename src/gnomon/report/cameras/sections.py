"""The sections of a camera report: lenses and rig, coverage, residuals, views, what the lens does, and the board."""

from math import degrees, isfinite

import numpy as np

from ...findings import join_names
from ...recording import Floats
from ...results.calibration import Calibration, CamerasFit
from ...results.camera_diagnostics import CamerasDiagnostics, LensTrial
from ..corners import (
    CornerView,
    corner_scatter,
    draw_arrows,
    draw_corner_coverage,
    field_figure,
    frames_figure,
    frames_left_out,
    unseen_places,
)
from ..drawing.figures import WIDTH, Plot, Sheet, draw_dots
from ..drawing.rig import rig_drawing
from ..numbers import (
    MISSING,
    estimate_text,
    finite_values,
    fixed_text,
    largest_magnitude,
    number_text,
    percent_text,
    positive_or,
)
from ..page import Block, Code, Figure, Legend, ParameterTable, ReportTable, Section, aligned_matrix
from ..rig_parameters import lens_groups, pose_groups
from . import lens, views
from .lens import ProjectionSpread, RadialCurve
from .views import epipolar_errors

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
    blocks += _epipolar(calibration, diagnostics)
    lead = "The lens of each camera" + (", and the relative poses of the cameras" if several else "")
    return Section(
        "cameras",
        "Cameras" if several else "Lens",
        f"{lead}, each number with its standard deviation σ. Pixel (0, 0) is the middle of the upper left pixel.",
        blocks,
    )


def _epipolar(calibration: Calibration, diagnostics: CamerasDiagnostics) -> list[ReportTable]:
    first, *others = [name for name in calibration.cameras if name in diagnostics.corners] or [""]
    rows: list[tuple[str, ...]] = []
    for name in others:
        errors = epipolar_errors(calibration, diagnostics.corners, first, name)
        known = finite_values(errors.error)
        if known.size:
            worst = f"{number_text(float(np.quantile(np.abs(known), 0.99)), 2)}\u00a0px"
            sizes = (errors.typical_used, errors.typical_other)
            cells = [f"{number_text(size, 3)}\u00a0px" if isfinite(size) else MISSING for size in sizes]
            rows.append((f"{name} against {first}", str(len(known)), *cells, worst))
    if not rows:
        return []
    return [
        ReportTable(
            "Distance from epipolar lines",
            ("", "corners", "views used", "other views", "99 % below"),
            rows,
            "Where both cameras see a corner at one instant, its place in one image puts it on a line in the "
            "other; no pose and no board take part. Typical distances, 1.48 times the median; they hold the noise of "
            "two corners, √2 times that of one.",
        )
    ]


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


def views_section(diagnostics: CamerasDiagnostics) -> Section | None:
    """Return from where the board was seen; None without views."""
    if not diagnostics.views or not len(diagnostics.board_points):
        return None
    around = views.views_around(diagnostics.views, diagnostics.board_points)
    telling = int(around.telling.sum())
    legend = [Legend("line", "ink", "board"), Legend("line", "after", "cam0 in a view")]
    if telling:
        legend.append(Legend("line", "accent", f"the {telling} most informative views"))
    return Section(
        "views",
        "Views",
        "Tilted views tell the focal length from the distance, views from near and far and turned about the line "
        "of sight tell the rest. Views straight on the board add little.",
        (
            Figure(
                "Cameras around the board",
                views.draw_views_in_space(around),
                legend,
                f"The {len(around.position)} views used, in the frame of the board.",
            ),
            Figure("From above and from the side", views.draw_plans(around), legend),
            Figure(
                "Tilt of the board",
                views.draw_attitudes(around),
                (Legend("dot", "after", "view"),) + ((Legend("dot", "accent", "most informative"),) if telling else ()),
                "Left, from which side of its normal the board was seen, y over x of it, circles every 15°; "
                "right, how far it was tilted against the line of sight. Tilts of 20° to 50° to all sides are the most "
                "informative.",
            ),
            _views_table(around),
        ),
    )


def _views_table(around: views.ViewsAround) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for label, values, unit, factor in (
        ("distance from the board's middle", around.distance, "m", 1.0),
        ("tilt of the board", around.tilt, "°", degrees(1.0)),
        ("turn about the line of sight", around.roll, "°", degrees(1.0)),
    ):
        cells = (float(v) * factor for v in np.quantile(values, (0.0, 0.5, 1.0)))
        rows.append((label, *(f"{number_text(v, 3)}{'' if unit == '°' else chr(160)}{unit}" for v in cells)))
    return ReportTable("In numbers", ("", "smallest", "median", "largest"), rows)


def lens_section(
    calibration: Calibration,
    diagnostics: CamerasDiagnostics,
    views: dict[str, CornerView],
    curves: dict[str, RadialCurve],
    spreads: dict[str, ProjectionSpread],
) -> Section:
    """Return what each lens does, how well that is known, and which models were tried."""
    blocks: list[Block] = []
    if spreads:
        blocks += [_spread_figure(views, spreads), _spread_table(spreads)]
    for name, curve in curves.items():
        blocks += [_curve_figure(name, curve, known=name in spreads), _grid_figure(calibration, name)]
    for name in calibration.cameras:
        blocks += _trials(name, [trial for trial in diagnostics.trials if trial.camera == name])
    return Section(
        "lens",
        "What the lens does",
        "How well the image of a ray is known, from ray to pixel, and the models that were compared.",
        blocks,
    )


def _spread_figure(views: dict[str, CornerView], spreads: dict[str, ProjectionSpread]) -> Figure:
    return Figure(
        "Uncertainty of the projection [px]",
        lens.draw_ray_sigmas({name: views[name] for name in spreads}, spreads),
        (
            Legend("band", "heldout", "with corners: the stronger, the less certain"),
            Legend("band", "before", "without corners, by the formula of the model alone"),
        ),
        "1σ per axis of where the image of a ray lies, carried from the covariance of the lens. A small turn "
        "of the camera that a change of the lens can be taken for was taken off, since every use estimates an attitude "
        "with the lens. It counts noise alone: where there were corners an error of the lens model shows in the "
        "residuals, and where there were none nothing shows it, and it may be many times larger.",
    )


def _spread_table(spreads: dict[str, ProjectionSpread]) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for name, one in spreads.items():
        known = np.isfinite(one.sigma)
        parts = (one.sigma[known & one.seen], one.sigma[known & ~one.seen], one.fixed[known & one.seen])
        cells = [f"{number_text(float(np.median(part)), 2)}\u00a0px" if len(part) else MISSING for part in parts]
        rows.append(
            (
                name,
                cells[0],
                cells[1],
                f"{number_text(float(np.max(one.sigma[known], initial=0.0)), 2)}\u00a0px",
                cells[2],
            )
        )
    return ReportTable(
        "Uncertainty of the projection in numbers",
        ("", "with corners", "without corners", "largest", "axes held fast"),
        rows,
        "Medians over the parts of the image with and without corners; the last column, with corners, holds "
        "the small turn too.",
    )


def _curve_figure(name: str, found: RadialCurve, *, known: bool) -> Figure:
    high, wide = (f"{fixed_text(degrees(edge), 1)}°" if isfinite(edge) else MISSING for edge in found.edges[:2])
    return Figure(
        f"From ray to pixel, {name}",
        lens.draw_lens_curve(name, found),
        (
            Legend("line", "after", "this lens"),
            Legend("dash", "before", "pinhole, f tan θ"),
            Legend("dash", "heldout", "equal angles, f θ"),
            Legend("line", "accent", "farthest corner used"),
            Legend("dash", "muted", "nearest edges of the image"),
        ),
        f"Mean over all directions about the optical axis; focal length {number_text(found.focal, 5)} px at it. "
        f"The image ends at {high} above or below and at {wide} aside."
        + ("" if known else " The lens was given; no σ is known."),
    )


def _grid_figure(calibration: Calibration, name: str) -> Figure:
    return Figure(
        f"The image of {name}, straightened",
        lens.draw_lens_grid(name, calibration.cameras[name].camera),
        (Legend("line", "after", "rows and columns of pixels"), Legend("dash", "ink", "frame of the image")),
        "Where rows and columns of the image lie in that of a pinhole with the same focal length and principal "
        "point. Rays more than 68° off the axis are left out.",
    )


def _trials(name: str, tried: list[LensTrial]) -> list[Block]:
    if not tried:
        return []
    tried = sorted(tried, key=lambda t: (not isfinite(t.holdout_rms_px), t.holdout_rms_px, t.parameters))
    chosen = next((t for t in tried if t.chosen), None)

    def against(trial: LensTrial, key: str) -> str:
        if chosen is None or not isfinite(ratio := getattr(trial, key) / getattr(chosen, key)):
            return MISSING
        return "taken" if trial is chosen else f"{fixed_text(100 * (ratio - 1), 1, sign=True)}\u00a0%"

    rows = tuple(
        (t.model, str(t.parameters), *(against(t, key) for key in ("holdout_rms_px", "rms_px"))) for t in tried
    )
    blocks: list[Block] = []
    if len(tried) > 1:
        blocks.append(
            Figure(
                f"Lens models tried on {name}",
                lens.draw_lens_trials(name, tried),
                (Legend("dot", "after", "views held out"), Legend("ring", "before", "views used")),
            )
        )
    blocks.append(
        ReportTable(
            f"Lens models of {name} in numbers",
            ("model", "parameters", "views held out", "views used"),
            rows,
            marked=tried.index(chosen) if chosen is not None else None,
            caption="rms residual per axis. Views held out took no part in the estimate and have a pose of their own. "
            "Of models that fit them alike the smallest is taken.",
        )
    )
    return blocks


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
