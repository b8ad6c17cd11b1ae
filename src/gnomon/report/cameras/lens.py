"""What a lens does with angles, and how well that is known: numbers, figures and the section of a camera report."""

from collections.abc import Mapping
from math import degrees, isfinite

import numpy as np

from ...assess.cameras.cameras_tables import CELLS
from ...frozen import value_class
from ...geometry.rotations import skew
from ...models.camera import Camera
from ...recording import Floats
from ...results.calibration import Calibration
from ...results.camera_diagnostics import CamerasDiagnostics, LensTrial
from ..corners import CornerView, image_panels, images_height
from ..drawing.figures import TEXT, WIDTH, Plot, Sheet, draw_dots
from ..drawing.panel import DASHED, TextStyle
from ..numbers import MISSING, finite_values, fixed_text, highest_finite, number_text, positive_or
from ..page import Block, Figure, Legend, ReportTable, Section

SPREAD_COLUMNS = 30
"""Cells across the image in which the standard deviation of a projection is found."""
_AZIMUTHS = 12
_WIDEST = np.radians(68)
"""Angle from the axis beyond which a straightened image is not drawn: it would be endless at 90 degrees."""
_GRID_LINES = 14


@value_class
class ProjectionSpread:
    """How well the image of a ray is known, cell by cell of the image.

    Attributes
    ----------
    corner : (n, 2) upper left corners of the cells [px]
    size : width and height of a cell [px]
    shape : rows and columns of cells
    sigma : (n,) standard deviation per axis of the image of a ray in the middle of the cell, after the turn that fits
        best where corners were seen [px]; nan where the lens has no ray
    fixed : (n,) the same with the camera's axes held fast [px]
    seen : (n,) whether corners were used in the cell or all around it
    """

    corner: Floats
    size: tuple[float, float]
    shape: tuple[int, int]
    sigma: Floats
    fixed: Floats
    seen: np.ndarray


def lens_covariance(calibration: Calibration, name: str) -> Floats:
    """Return the covariance (q, q) of the parameters of a lens, intrinsics first."""
    return calibration.covariance(f"{name}.intrinsics", f"{name}.distortion_coeffs")


def projection_spread(camera: Camera, covariance: Floats, pixels: Floats) -> ProjectionSpread:
    """Return how well the images of rays are known.

    With q(ray; p) the image, d p a change of the lens and r a small turn of the camera, d q = J_p d p + J_r r; the
    turn r is the one for which the sum of |d q|^2 over the cells in which corners were used is least.

    Parameters
    ----------
    camera : the lens
    covariance : (q, q) of its parameters
    pixels : (m, 2) of the corners used [px]
    """
    width, height = camera.resolution
    columns, rows = SPREAD_COLUMNS, max(1, round(SPREAD_COLUMNS * height / width))
    size = (width / columns, height / rows)
    y, x = np.divmod(np.arange(rows * columns), columns)
    corner = np.stack([x * size[0], y * size[1]], axis=1) - 0.5
    middle = corner + np.array(size) / 2
    seen = _with_corners(pixels, middle, camera.resolution)
    by_lens, by_turn, valid = _derivatives(camera, middle)
    fixed = _per_axis(by_lens, covariance)
    used = valid & (seen if (seen & valid).sum() > 2 else True)
    normal = np.einsum("nki,nkj->ij", by_turn[used], by_turn[used])
    pull = np.einsum("nki,nkj->ij", by_turn[used], by_lens[used])
    turned = by_lens - by_turn @ (np.linalg.pinv(normal) @ pull)
    sigma = _per_axis(turned, covariance)
    sigma[~valid] = fixed[~valid] = np.nan
    return ProjectionSpread(corner=corner, size=size, shape=(rows, columns), sigma=sigma, fixed=fixed, seen=seen)


def _with_corners(pixels: Floats, places: Floats, resolution: tuple[int, int]) -> np.ndarray:
    """Tell of places (n, 2) whether there are corners (m, 2) in their cells of the image, by which coverage is told."""
    scale = np.array(CELLS[::-1]) / np.array(resolution)
    last = np.array(CELLS[::-1]) - 1

    def cell(points: Floats) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.clip(np.floor((points + 0.5) * scale), 0, last).astype(np.int64).T
        return y, x

    occupied = np.zeros(CELLS, dtype=np.bool_)
    occupied[cell(pixels)] = True
    return occupied[cell(places)]


def _derivatives(camera: Camera, pixels: Floats) -> tuple[Floats, Floats, np.ndarray]:
    """Return the derivatives of images of rays, by the lens's parameters (n, 2, q) and by a turn of the rays (n, 2, 3).

    The third array (n,) tells where there are any. The rays are those seen at pixels (n, 2) [px].
    """
    rays, valid = camera.unproject(pixels)
    image = camera.project(np.where(valid[:, None], rays, (0.0, 0.0, 1.0)), parameters_jacobian=True)
    assert image.by_parameters is not None
    assert image.by_point is not None
    return image.by_parameters, -image.by_point @ skew(np.nan_to_num(rays)), valid & image.valid


def _per_axis(slopes: Floats, covariance: Floats) -> Floats:
    """Return standard deviations (n,) of what has two components and the derivatives (n, 2, q), rms over the two."""
    variance = np.einsum("nki,ij,nkj->n", slopes, covariance, slopes) / 2
    return np.sqrt(np.fmax(variance, 0.0))


@value_class
class RadialCurve:
    """Distance of an image from that of the optical axis, over the angle of the ray to it, mean over all directions.

    Attributes
    ----------
    angle : (n,) [rad]
    radius, sigma : (n,) [px], and its standard deviation
    focal, focal_sigma : slope of the radius at the axis, and its standard deviation [px per rad]
    reach : angle of the farthest corner used [rad]; zero without one
    edges : angle of the upper or lower edge of the image, of a side, and of a corner, the nearest of each [rad]
    """

    angle: Floats
    radius: Floats
    sigma: Floats
    focal: float
    focal_sigma: float
    reach: float
    edges: tuple[float, float, float]


def radial_curve(camera: Camera, covariance: Floats, pixels: Floats) -> RadialCurve:
    """Return radius over angle; `pixels` (m, 2) are those of the corners used [px]."""
    width, height = camera.resolution
    middle = camera.intrinsics[-2:]
    places = np.array([(middle[0], 0), (middle[0], height - 1), (0, middle[1]), (width - 1, middle[1])])
    ends = _angles(camera, np.concatenate([places, [(a, b) for a in (0, width - 1) for b in (0, height - 1)]]))
    edges = tuple(
        float(np.nanmin(part)) if np.isfinite(part).any() else np.nan for part in (ends[:2], ends[2:4], ends[4:])
    )
    seen = finite_values(_angles(camera, pixels[:: max(1, len(pixels) // 20_000)]))
    most = float(np.nanmax(ends)) if np.isfinite(ends).any() else 1.0
    angle = np.linspace(0.0, most, 121)
    around = np.linspace(0, 2 * np.pi, _AZIMUTHS, endpoint=False)
    across = np.stack([np.cos(around), np.sin(around), np.zeros(_AZIMUTHS)], axis=1)
    rays = np.sin(angle)[:, None, None] * across + np.cos(angle)[:, None, None] * (0.0, 0.0, 1.0)
    image = camera.project(rays.reshape(-1, 3), parameters_jacobian=True)
    assert image.by_parameters is not None
    pixel, slopes = image.pixels.reshape(121, -1, 2), image.by_parameters.reshape(121, _AZIMUTHS, 2, -1)
    away = pixel - pixel[0, 0]
    radius = np.linalg.norm(away, axis=2)
    outwards = away / np.where(radius > 0, radius, 1.0)[..., None]
    by_lens = np.einsum("nak,nakq->nq", outwards, slopes - slopes[0, 0]) / _AZIMUTHS
    spread = np.sqrt(np.fmax(np.einsum("ni,ij,nj->n", by_lens, covariance, by_lens), 0.0))
    mean = radius.mean(axis=1)
    return RadialCurve(
        angle=angle,
        radius=mean,
        sigma=np.where(np.isfinite(mean), spread, np.nan),
        focal=float(mean[1] / angle[1]),
        focal_sigma=float(spread[1] / angle[1]),
        reach=float(seen.max()) if seen.size else 0.0,
        edges=(edges[0], edges[1], edges[2]),
    )


def _angles(camera: Camera, pixels: Floats) -> Floats:
    """Return the angles (n,) of the rays seen at pixels (n, 2) to the optical axis [rad]; nan without a ray."""
    rays, _ = camera.unproject(pixels)
    return np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Return the angles from left to right and from top to bottom, through the principal point [rad].

    They are nan where the lens has no ray at the edge.
    """
    width, height = camera.resolution
    u, v = camera.intrinsics[-2:]
    left, right, top, bottom = _angles(camera, np.array([(0, v), (width - 1, v), (u, 0), (u, height - 1)])).tolist()
    return left + right, top + bottom


def focal_at_axis(camera: Camera) -> Floats:
    """Return how many pixels a radian at the optical axis is along u and along v, (2,) [px]; a pinhole's fu and fv."""
    by_point = camera.project(np.array([[0.0, 0.0, 1.0]])).by_point
    assert by_point is not None
    return np.diag(by_point[0])


def undistorted_grid(camera: Camera) -> list[Floats]:
    """Return columns and rows of pixels as a pinhole with the same middle would see them, (n, 2) [px].

    What lies more than 68 degrees off the axis is left out (nan).
    """
    width, height = camera.resolution
    focal = focal_at_axis(camera)
    step = max(width, height) / _GRID_LINES
    lines: list[Floats] = []
    for along, across in ((0, 1), (1, 0)):
        ends = (width - 1, height - 1)
        run = np.linspace(0, ends[across], 61)
        for at in np.linspace(0, ends[along], 1 + max(2, round(ends[along] / step))):
            line = np.empty((61, 2))
            line[:, along], line[:, across] = at, run
            rays, valid = camera.unproject(line)
            kept = valid & (rays[:, 2] > np.cos(_WIDEST))
            with np.errstate(invalid="ignore", divide="ignore"):
                flat = focal * rays[:, :2] / rays[:, 2:] + camera.intrinsics[-2:]
            lines.append(np.where(kept[:, None], flat, np.nan))
    return lines


_LEVELS = 8
_NUMBERS = (3, 5)
"""Numbers written over an image: down and across; across where it is small, as many as down."""
_ROW, _LEFT, _LEAST = 26.0, 220.0, 150.0
"""Height of a row, where the rows begin, and how high all rows are together at least, for small screens."""


def draw_lens_curve(name: str, found: RadialCurve) -> Plot:
    """Draw radius over angle with those of an ideal pinhole and of equal angles, and its standard deviation below."""
    angle = np.degrees(found.angle)
    top = 1.06 * positive_or(highest_finite(found.radius))

    sheet = Sheet()
    axes = sheet.panel("Distance from the image of the axis [px]", top=36, height=230)
    narrow = found.angle < np.radians(85)
    axes.line(angle[narrow], found.focal * np.tan(found.angle[narrow]), "before", width=1.4, dash=DASHED)
    axes.line(angle, found.focal * found.angle, "heldout", width=1.4, dash=DASHED)
    axes.line(angle, found.radius, "after", width=2.2)
    axes.y.span(0, top)
    below = sheet.panel("σ of it [px]", top=324, height=130, x_label="angle to the axis [°]")
    below.band(angle, np.zeros(len(angle)), found.sigma, "after", alpha=0.3)
    below.line(angle, found.sigma, "after", width=1.6)
    below.y.span(0, 1.1 * positive_or(highest_finite(found.sigma)))
    below.y.most = 4
    for panel in (axes, below):
        panel.x.span(0, angle[-1])
        if found.reach > 0:
            panel.upright(degrees(found.reach), "accent", width=1.4)
        for edge in found.edges[:2]:
            if np.isfinite(edge):
                panel.upright(degrees(edge), "muted", width=1.2, dash=DASHED)
    axes.x.labelled = False
    alt = f"Distance from the image of the optical axis over the angle of the ray, lens of {name}, and its sigma."
    return sheet.draw(f"curve-{name}", 518, alt)


def draw_lens_grid(name: str, camera: Camera) -> Plot:
    """Draw rows and columns of pixels as they lie when the image is straightened, and the frame of the image."""
    lines = undistorted_grid(camera)
    drawn = np.concatenate(lines)
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    width, height = camera.resolution
    frame = np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1), (0, 0)], dtype=np.float64)
    both = np.concatenate([drawn, frame])
    low, high = both.min(axis=0), both.max(axis=0)
    tall = float(np.clip(WIDTH * (high[1] - low[1]) / positive_or(high[0] - low[0]), 200, 560))
    scale = max((high[0] - low[0]) / (WIDTH - 24), (high[1] - low[1]) / (tall - 24))
    middle = (low + high) / 2

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=tall)
    panel.x.span(middle[0] - scale * WIDTH / 2, middle[0] + scale * WIDTH / 2)
    panel.y.span(middle[1] + scale * tall / 2, middle[1] - scale * tall / 2)
    for line in lines:
        panel.line(line[:, 0], line[:, 1], "after", width=1.1)
    panel.line(frame[:, 0], frame[:, 1], "ink", width=1.6, dash=DASHED)
    sheet.text(f"{width} x {height} px", x=WIDTH, y=tall + 20, color="muted", align="right")
    return sheet.draw(f"grid-{name}", tall + 26, f"The pixels of {name} after its lens was taken off.")


def draw_ray_sigmas(views: Mapping[str, CornerView], found: Mapping[str, ProjectionSpread]) -> Plot:
    """Draw the standard deviation of the image of a ray over the image, with numbers; grey where no corners were."""
    values = np.concatenate([finite_values(one.sigma) for one in found.values()])
    low, high = (float(values.min()), float(values.max())) if values.size and values.min() > 0 else (1.0, 2.0)
    step = np.log(positive_or(high / low, 2.0)) / _LEVELS or 1.0

    sheet = Sheet()
    for panel, one in zip(image_panels(sheet, views), found.values(), strict=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            level = np.clip((np.floor(np.log(one.sigma / low) / step) + 1) / _LEVELS, 1 / _LEVELS, 1.0)
        for color, shown in (("heldout", one.seen), ("before", ~one.seen)):
            panel.cells(one.corner[shown], one.size, level=0.62 * level[shown], color=color)
        edge = _rim(one)
        panel.line(edge[:, 0], edge[:, 1], "ink", width=1.3, ends="square")
        down, across = _NUMBERS if len(found) == 1 else (_NUMBERS[0],) * 2
        rows, columns = one.shape
        for i in np.linspace(0, rows - 1, 2 * down + 1)[1::2].astype(int).tolist():
            for j in np.linspace(0, columns - 1, 2 * across + 1)[1::2].astype(int).tolist():
                k = i * columns + j
                if np.isfinite(one.sigma[k]):
                    at = one.corner[k] + np.array(one.size) / 2
                    seen = bool(one.seen[k])
                    style = TextStyle(color="ink" if seen else "muted", size=TEXT, align="center", bold=seen)
                    text = number_text(float(one.sigma[k]), 2, trim=False)
                    panel.text(text, float(at[0]), float(at[1]), style, offset=(0.0, 4.0))
    return sheet.draw("spread", images_height(views), "Standard deviation of the image of a ray over the image.")


def _rim(one: ProjectionSpread) -> np.ndarray:
    """Return the edges between cells with corners and cells without, (n, 2) [px], separated by nan."""
    rows, columns = one.shape
    seen = one.seen.reshape(rows, columns)
    width, height = one.size
    lines: list[np.ndarray] = []
    for i, j in zip(*np.nonzero(seen[:, 1:] != seen[:, :-1]), strict=True):
        x = (j + 1) * width - 0.5
        lines.append(np.array([(x, i * height - 0.5), (x, (i + 1) * height - 0.5), (np.nan, np.nan)]))
    for i, j in zip(*np.nonzero(seen[1:] != seen[:-1]), strict=True):
        y = (i + 1) * height - 0.5
        lines.append(np.array([(j * width - 0.5, y), ((j + 1) * width - 0.5, y), (np.nan, np.nan)]))
    return np.concatenate(lines) if lines else np.full((1, 2), np.nan)


def draw_lens_trials(name: str, tried: list[LensTrial]) -> Plot:
    """Draw the residuals of the lens models that were tried on one camera, held out and used, a row each."""
    height = max(_ROW * len(tried), _LEAST)

    sheet = Sheet()
    panel = sheet.panel("", top=18, height=height, left=_LEFT, right=60, x_label="rms per axis [px]")
    held = np.array([trial.holdout_rms_px for trial in tried])
    used = np.array([trial.rms_px for trial in tried])
    panel.x.span(*_span(np.concatenate([held, used])))
    panel.x.logarithmic, panel.x.grid = True, True
    ticks = [t for t in _TICKS if panel.x.low <= t <= panel.x.high]
    panel.x.ticks = ticks if len(ticks) < 8 else [t for t in ticks if f"{t:e}"[0] in "125" and f"{t:e}"[2] == "0"]
    panel.y.logarithmic, panel.y.grid, panel.y.ticks = False, False, ()
    panel.y.span(len(tried), 0)
    y = np.arange(0.5, len(tried))
    for row, place in enumerate(y.tolist()):
        panel.line(np.array([held[row], used[row]]), np.full(2, place), "grid", width=2.0)
    draw_dots(panel, used, y, "before", size=13.0, ring=True)
    draw_dots(panel, held, y, "after", size=7.0)
    for trial, place in zip(tried, y, strict=True):
        at = float(panel.y.places(np.array(place))) + 4.0
        weight = "bold" if trial.chosen else "normal"
        text = trial.model + ("" if np.isfinite(trial.holdout_rms_px) else " (no fit)")
        sheet.text(text, x=0, y=at, color="ink", weight=weight)
    return sheet.draw(f"trials-{name}", height + 78, f"Held-out residuals of {len(tried)} lens models of {name}.")


_TICKS = [step * 10.0**k for k in range(-3, 4) for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)]


def _span(values: np.ndarray) -> tuple[float, float]:
    known = finite_values(values)
    known = known[known > 0]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.1, 1.0)
    return 0.8 * low, max(1.25 * high, 2.0 * low)


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
        draw_ray_sigmas({name: views[name] for name in spreads}, spreads),
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
        draw_lens_curve(name, found),
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
        draw_lens_grid(name, calibration.cameras[name].camera),
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
                draw_lens_trials(name, tried),
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
