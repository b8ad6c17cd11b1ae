"""The drawing of one IMU: where its three accelerometers sit, which point its origin is, and where the camera is."""

import numpy as np

from ..calibration import Calibration
from ..geometry.rotation_vector import rotation_from_rotvec
from ..models.origin import AXES
from ..recording import Floats
from . import svg
from .figures import TEXT, WIDTH, LabelPlaces, Sheet, half_size
from .numbers import number
from .page import Figure, Legend
from .panel import DASHED, Panel

_HEIGHT = 320.0
_LEAST_MM = 2.0
_LOOK = rotation_from_rotvec(np.array([np.radians(24), 0, 0])) @ rotation_from_rotvec(np.array([0, np.radians(-38), 0]))
_AROUND = np.column_stack([f(np.linspace(0, 2 * np.pi, 24, endpoint=False)) for f in (np.cos, np.sin)])


def origin_figure(calibration: Calibration, name: str) -> Figure | None:
    """Return the drawing of an IMU whose accelerometers have lever arms and that a camera goes with; else None."""
    imu = calibration.imus[name]
    arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
    if arms is None or not calibration.cameras or imu.T_imu_body is not None:
        return None
    where = "a point between them" if imu.origin is None else imu.origin.words
    camera, T = next((name, entry.T_cam_imu) for name, entry in calibration.cameras.items())
    sigma = 1e3 * calibration.sigma(f"{name}.accelerometer.lever_arms_m")
    far = number(1e3 * float(np.linalg.norm(T[:3, 3])), 4)
    return Figure(
        f"The accelerometers of {name}, and its origin",
        _drawing(1e3 * arms, sigma, T[:3, :3], T[:3, 3], camera),
        tuple(Legend("line", axis, f"{axis} accelerometer") for axis in AXES),
        f"The origin, to which T_cam_imu refers, is {where}. Arrows show the axes along which the "
        f"accelerometers feel, whiskers the places' ±σ along the IMU's axes; seen from behind {camera}, a little from "
        f"above. The dashed arrow points to {camera}, {far} mm away and not to scale.",
    )


def _drawing(arms: Floats, sigma: Floats, R_cam_imu: Floats, p_cam_imu: Floats, camera: str) -> str:
    """Return the drawing of places (3, 3) with sigmas [mm], IMU's axes, and the camera's direction."""
    length = max(_LEAST_MM, 0.45 * float(np.abs(arms).max()))

    def flat(points: Floats) -> Floats:
        """Project points (n, 3) of the IMU's axes [mm] to the page (n, 2), y up."""
        return (points @ R_cam_imu.T @ _LOOK.T)[:, :2] * (1, -1)

    towards = -R_cam_imu.T @ p_cam_imu
    towards = 2.2 * length * towards / max(float(np.linalg.norm(towards)), 1e-12)
    lines: list[tuple[str, Floats, float]] = []
    for k, (place, spread) in enumerate(zip(arms, sigma, strict=True)):
        lines.append(("muted", np.stack([np.zeros(3), place]), 1.0))
        lines += [("before", place + np.outer([-1, 1], spread[i] * np.eye(3)[i]), 3.0) for i in range(3)]
        lines.append((AXES[k], np.stack([place, place + length * np.eye(3)[k]]), 2.6))
    lines.append(("ink", np.stack([np.zeros(3), towards]), 1.6))
    drawn = np.array([flat(line) for _, line, _ in lines])

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=_HEIGHT)
    _fit(panel, drawn.reshape(-1, 2))
    for (color, _, width), ends in zip(lines, drawn, strict=True):
        dash = DASHED if color in ("muted", "ink") else ()
        panel.line(ends[:, 0], ends[:, 1], color, width=width, dash=dash)
        if color in ("ink", *AXES):
            _head(panel, ends, color, width)
    points = flat(np.vstack([arms, np.zeros((1, 3))]))
    for point, color, size in zip(points, (*AXES, "ink"), (9.0, 9.0, 9.0, 11.0), strict=True):
        panel.dots(point[:1], point[1:], color, size)
    texts = (*(f"{axis} accelerometer" for axis in AXES), "origin", f"to {camera}")
    _name(panel, texts, np.vstack([points, flat(towards[None])]), drawn)
    return sheet.draw("imu-origin", _HEIGHT, "Where the accelerometers, the origin and the camera are.")


def _head(panel: Panel, ends: Floats, color: str, width: float) -> None:
    """Draw the head of an arrow from ends[0] to ends[1], (2, 2)."""
    along = ends[1] - ends[0]
    aside = np.array([-along[1], along[0]])
    barbs = [ends[1] - 0.14 * along + sign * 0.08 * aside for sign in (1, -1)]
    line = np.stack([barbs[0], ends[1], barbs[1]])
    panel.line(line[:, 0], line[:, 1], color, width=width, ends="round")


def _name(panel: Panel, texts: tuple[str, ...], points: Floats, drawn: Floats) -> None:
    """Write texts beside points (n, 2), off the lines (m, 2, 2)."""

    def on_page(places: Floats) -> Floats:
        return np.stack([panel.x.places(places[..., 0]), panel.y.places(places[..., 1])], axis=-1)

    labels = LabelPlaces(on_page(drawn), WIDTH, _HEIGHT)
    for text, point in zip(texts, points, strict=True):
        base, ring = on_page(point), half_size(text) + 6.0
        place = labels.take(text, np.concatenate([base + reach * ring * _AROUND for reach in (1.0, 1.4, 1.9)]))
        offset = place - base
        style = svg.text_style("ink", TEXT, "center", bold=text == "origin")
        x, y = point.tolist()
        panel.text(text, x, y, style, offset=(float(offset[0]), svg.MIDDLE * TEXT + float(offset[1])))


def _fit(panel: Panel, drawn: Floats) -> None:
    """Give the panel limits that hold all points (n, 2), to scale, with room for labels."""
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    middle, size = (low + high) / 2, high - low
    scale = max(size[0] / (WIDTH - 180), size[1] / (_HEIGHT - 70), 1e-9)
    panel.x.span(middle[0] - scale * WIDTH / 2, middle[0] + scale * WIDTH / 2)
    panel.y.span(middle[1] - scale * _HEIGHT / 2, middle[1] + scale * _HEIGHT / 2)
