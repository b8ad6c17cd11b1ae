"""From where the board was seen, and how two cameras of a rig fit together: numbers, figures, sections."""

from collections.abc import Sequence
from math import degrees, isfinite

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec, skew
from ...models.camera import Camera
from ...recording import Floats, Integers
from ...results.calibration import Calibration
from ...results.camera_diagnostics import CamerasDiagnostics, CornerFit, ViewPose
from ..drawing.figures import TEXT, WIDTH, Plot, Sheet, draw_dots, half_panel
from ..drawing.panel import Panel, TextStyle
from ..drawing.rig import fit_to_scale
from ..numbers import MISSING, finite_values, number_text, positive_or
from ..page import Figure, Legend, ReportTable, Section

_MOST_DRAWN = 120
_TELLING = 5
"""Views that stand out in the drawing: the most informative ones for the lenses."""
_HEIGHT = 430.0
_PYRAMID = np.array([[-0.5, -0.34, 0.75], [0.5, -0.34, 0.75], [0.5, 0.34, 0.75], [-0.5, 0.34, 0.75]])
"""Corners of the image in front of a camera, in its own axes, for a pyramid of size one."""
_LOOK = rotation_from_rotvec(np.array([np.radians(22), 0, 0])) @ rotation_from_rotvec(np.array([0, np.radians(36), 0]))


@value_class
class ViewsAround:
    """The views about the middle of the board, z towards the viewer.

    Attributes
    ----------
    position : (v, 3) of cam0 [m]
    axes : (v, 3, 3) its axes as columns
    board : (5, 3) outline of the board, closed [m]
    points : (k, 3) its points [m]
    telling : (v,) whether a view is among the most informative ones
    tilt : (v,) angle between the line of sight and the board's normal [rad]
    seen_from : (v, 2) the part of the direction to the camera in the plane of the board, x and y, as long as the tilt
        [rad]
    distance : (v,) from the middle of the board [m]
    roll : (v,) turn about the line of sight, against the usual one [rad]
    """

    position: Floats
    axes: Floats
    board: Floats
    points: Floats
    telling: np.ndarray
    tilt: Floats
    seen_from: Floats
    distance: Floats
    roll: Floats


def views_around(views: Sequence[ViewPose], points: Floats) -> ViewsAround:
    """Return the views about the board's points (k, 3) [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    position = np.array([view.p_target_cam0 for view in views]).reshape(-1, 3) - middle
    axes = np.array([view.R_target_cam0 for view in views]).reshape(-1, 3, 3)
    # A board whose z points away from the viewer is turned about its x axis, so that the cameras are in front of it.
    front = np.diag([1.0, -1.0, -1.0]) if len(position) and np.median(position[:, 2]) < 0 else np.eye(3)
    position, axes, placed = position @ front, front @ axes, (points - middle) @ front
    (a, b, _), (c, d, _) = placed.min(axis=0), placed.max(axis=0)
    board = np.array([(a, b, 0), (c, b, 0), (c, d, 0), (a, d, 0), (a, b, 0)])
    sight = axes[:, :, 2]
    across = np.hypot(sight[:, 0], sight[:, 1])
    tilt = np.arctan2(across, -sight[:, 2])
    return ViewsAround(
        position=position,
        axes=axes,
        board=board,
        points=placed,
        telling=_telling(np.array([view.information for view in views])),
        tilt=tilt,
        seen_from=-sight[:, :2] * (tilt / np.where(across > 0, across, 1.0))[:, None],
        distance=np.linalg.norm(position, axis=1),
        roll=_roll(axes),
    )


def _telling(information: Floats) -> np.ndarray:
    order = np.argsort(-np.nan_to_num(information), kind="stable")[:_TELLING]
    found = np.zeros(len(information), dtype=np.bool_)
    found[order] = np.isfinite(information[order])
    return found


def _roll(axes: Floats) -> Floats:
    """Return turns about the line of sight against their mean direction, -pi to pi [rad]."""
    if not len(axes):
        return np.empty(0)
    turn = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    usual = np.angle(np.mean(np.exp(1j * turn)))
    return np.angle(np.exp(1j * (turn - usual)))


def _pyramids(around: ViewsAround) -> tuple[Floats, Floats]:
    """Return the outlines of evenly chosen views, (n, 11, 3), which one stroke can draw, and which tell most (n,)."""
    step = max(1, -(-len(around.position) // _MOST_DRAWN))
    chosen = np.union1d(np.arange(0, len(around.position), step), np.flatnonzero(around.telling))
    size = 0.07 * positive_or(float(np.median(around.distance[chosen])) if len(chosen) else 0.0)
    tips = around.position[chosen, None]
    image = tips + size * _PYRAMID @ np.swapaxes(around.axes[chosen], 1, 2)
    outline = np.concatenate([tips, image[:, [0, 1]], tips, image[:, [2, 1, 2, 3]], tips, image[:, [3, 0]]], axis=1)
    return outline, around.telling[chosen]


def draw_views_in_space(around: ViewsAround) -> Plot:
    """Draw the cameras as pyramids about the board, seen from the side, a little from above."""
    outlines, telling = _pyramids(around)

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=_HEIGHT)
    board, flat = _seen(around.board), _seen(outlines)
    fit_to_scale(panel, np.concatenate([board, flat.reshape(-1, 3)]), _HEIGHT, room=(60, 40))
    panel.line(board[:, 0], board[:, 1], "ink", width=1.6, depth=board[:, 2])
    wide = f"{number_text(float(np.ptp(around.board[:, 0])), 3)} m"
    x, y, depth = board[:2].mean(axis=0).tolist()
    panel.text(wide, x, y, TextStyle(color="muted", size=TEXT, align="center"), offset=(0.0, 28.0), depth=depth)
    points = _seen(around.points)
    panel.dots(points[:, 0], points[:, 1], "before", 2.2, depth=points[:, 2])
    _draw_outlines(panel, flat, telling)
    return sheet.draw("scene", _HEIGHT, f"{len(around.position)} views of the board, as pyramids around it.")


def _seen(points: Floats) -> Floats:
    """Return points (..., 3) as right, up and towards the reader."""
    return points @ _LOOK.T


def _draw_outlines(panel: Panel, flat: Floats, telling: np.ndarray) -> None:
    """Draw outlines (n, 11, 2 or 3), the most informative ones above the others."""
    for color, width, chosen in (("after", 0.8, ~telling), ("accent", 1.5, telling)):
        gap = np.full((int(chosen.sum()), 1, flat.shape[2]), np.nan)
        line = np.concatenate([flat[chosen], gap], axis=1).reshape(-1, flat.shape[2])
        panel.line(line[:, 0], line[:, 1], color, width=width, depth=line[:, 2] if flat.shape[2] > 2 else None)


def draw_plans(around: ViewsAround) -> Plot:
    """Draw the cameras and the board from above and from the side."""
    outlines, telling = _pyramids(around)
    drawn = np.concatenate([outlines.reshape(-1, 3), around.board])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    span, middle = 0.54 * positive_or(float((high - low).max())), (low + high) / 2

    sheet = Sheet()
    for k, (title, right, up) in enumerate((("From above: z over x [m]", 0, 2), ("From the side: y over z [m]", 2, 1))):
        axes = half_panel(sheet, title, k, top=36, height=314)
        axes.x.grid = True
        axes.line(around.board[:, right], around.board[:, up], "ink", width=3.0)
        _draw_outlines(axes, outlines[..., [right, up]], telling)
        axes.x.span(middle[right] - span, middle[right] + span)
        axes.y.span(middle[up] - span, middle[up] + span)
    return sheet.draw("plans", 396, "The views and the board from above and from the side.")


def draw_attitudes(around: ViewsAround) -> Plot:
    """Draw towards which side the board was tilted, and how often by how much."""
    degrees = np.degrees(around.seen_from)
    reach = max(10.0 * np.ceil(float(np.degrees(around.tilt.max(initial=0.0))) / 10 + 0.2), 30.0)

    sheet = Sheet()
    axes = half_panel(sheet, "Seen from [°]", 0, top=36, height=314)
    axes.x.grid = True
    turn = np.linspace(0, 2 * np.pi, 73)
    for radius in np.arange(15.0, reach, 15.0):
        axes.line(radius * np.cos(turn), radius * np.sin(turn), "grid")
    for color, chosen in (("after", ~around.telling), ("accent", around.telling)):
        draw_dots(axes, degrees[chosen, 0], degrees[chosen, 1], color, size=6.0)
    axes.x.span(-reach, reach)
    axes.y.span(-reach, reach)
    edges = np.arange(0.0, reach + 1e-9, 5.0)
    other = half_panel(sheet, "Views over tilt [°]", 1, top=36, height=314)
    count = np.histogram(np.degrees(around.tilt), edges)[0].astype(np.float64)
    other.steps(count, edges, "after")
    other.x.span(0, edges[-1])
    other.y.span(0, 1.08 * positive_or(float(count.max())))
    other.y.whole = True
    return sheet.draw("attitudes", 396, f"Tilt of the board against the line of sight in {len(degrees)} views.")


_SAME_S = 1e-3
"""Frames of two cameras whose timestamps differ by less show the same instant."""


@value_class
class EpipolarErrors:
    """Corners that two cameras saw at one instant.

    Attributes
    ----------
    error : (m,) signed distance of the corner in the second image from the epipolar line of that in the first [px]
    used : (m,) whether both frames were used by the estimate
    """

    error: Floats
    used: np.ndarray

    @property
    def typical_used(self) -> float:
        """Robust standard deviation about zero over the views used [px]."""
        return _typical(self.error[self.used])

    @property
    def typical_other(self) -> float:
        """The same over the other views [px]; nan without any."""
        return _typical(self.error[~self.used])


def _typical(errors: Floats) -> float:
    """Return 1.4826 times the median distance from zero, the rms of normal errors whatever a few others are."""
    known = finite_values(errors)
    return 1.4826 * float(np.median(np.abs(known))) if known.size else float("nan")


def epipolar_errors(calibration: Calibration, corners: dict[str, CornerFit], first: str, second: str) -> EpipolarErrors:
    """Return the errors of all corners that both cameras saw at one instant; no pose and no board take part in them.

    With rays a and b of the first and the second camera, c = b' [t]x R a vanishes; c over its derivative by the place
    of the corner in the second image, along the steepest direction, is the distance from the line there.
    """
    one, other = corners[first], corners[second]
    pairs = _common(one, other)
    cameras = calibration.cameras
    T = cameras[second].T_cam_body @ np.linalg.inv(cameras[first].T_cam_body)
    a, sees = cameras[first].camera.unproject(one.pixels[pairs[0]])
    lens = cameras[second].camera
    b, too = lens.unproject(other.pixels[pairs[1]])
    kept = sees & too
    a, b, pairs = a[kept], b[kept], (pairs[0][kept], pairs[1][kept])
    normal = a @ (skew(T[:3, 3]) @ T[:3, :3]).T
    used = np.asarray(one.frame_used, dtype=bool)[one.frame[pairs[0]]]
    used &= np.asarray(other.frame_used, dtype=bool)[other.frame[pairs[1]]]
    return EpipolarErrors(error=_distance(lens, b, normal), used=used)


def _distance(lens: Camera, rays: Floats, normal: Floats) -> Floats:
    """Return rays . normal over its derivative by the pixels of the rays (m,) [px]."""
    by_ray = lens.project(rays).by_point
    assert by_ray is not None
    slope = np.linalg.norm(np.einsum("mi,mij->mj", normal, np.linalg.pinv(by_ray)), axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(slope > 0, np.sum(rays * normal, axis=1) / slope, np.nan)


def _common(one: CornerFit, other: CornerFit) -> tuple[Integers, Integers]:
    """Return the places in both lists of corners of what both saw at one instant, frames that fit badly apart."""
    if not len(other.frame_t_s) or not len(one.frame):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    order = np.argsort(other.frame_t_s, kind="stable")
    after = np.searchsorted(other.frame_t_s[order], one.frame_t_s).clip(1, max(len(order) - 1, 1))
    near = np.stack([order[after - 1], order[np.fmin(after, len(order) - 1)]])
    apart = np.abs(other.frame_t_s[near] - one.frame_t_s)
    match = np.where(apart.min(axis=0) < _SAME_S, near[apart.argmin(axis=0), np.arange(near.shape[1])], -1)
    points = 1 + max(int(one.point.max(initial=0)), int(other.point.max(initial=0)))
    frame = match[one.frame]
    there = (frame >= 0) & np.isfinite(one.residual).all(axis=1)
    wanted = np.where(there, frame * points + one.point, -1)
    found = np.where(np.isfinite(other.residual).all(axis=1), other.frame * points + other.point, -2)
    _, first, second = np.intersect1d(wanted, found, return_indices=True)
    return first, second


def views_section(diagnostics: CamerasDiagnostics) -> Section | None:
    """Return from where the board was seen; None without views."""
    if not diagnostics.views or not len(diagnostics.board_points):
        return None
    around = views_around(diagnostics.views, diagnostics.board_points)
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
                draw_views_in_space(around),
                legend,
                f"The {len(around.position)} views used, in the frame of the board.",
            ),
            Figure("From above and from the side", draw_plans(around), legend),
            Figure(
                "Tilt of the board",
                draw_attitudes(around),
                (Legend("dot", "after", "view"),) + ((Legend("dot", "accent", "most informative"),) if telling else ()),
                "Left, from which side of its normal the board was seen, y over x of it, circles every 15°; "
                "right, how far it was tilted against the line of sight. Tilts of 20° to 50° to all sides are the most "
                "informative.",
            ),
            _views_table(around),
        ),
    )


def _views_table(around: ViewsAround) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for label, values, unit, factor in (
        ("distance from the board's middle", around.distance, "m", 1.0),
        ("tilt of the board", around.tilt, "°", degrees(1.0)),
        ("turn about the line of sight", around.roll, "°", degrees(1.0)),
    ):
        cells = (float(v) * factor for v in np.quantile(values, (0.0, 0.5, 1.0)))
        rows.append((label, *(f"{number_text(v, 3)}{'' if unit == '°' else chr(160)}{unit}" for v in cells)))
    return ReportTable("In numbers", ("", "smallest", "median", "largest"), rows)


def epipolar_tables(calibration: Calibration, diagnostics: CamerasDiagnostics) -> list[ReportTable]:
    """Return how far corners lie from the epipolar lines of those in another camera; none without two cameras."""
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
