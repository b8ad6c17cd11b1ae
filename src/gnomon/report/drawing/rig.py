"""Drawings in space: the cameras and IMUs of a rig; the accelerometers of one IMU, its origin and the camera.

They are to scale, and labels stand where few lines are.
"""

from collections.abc import Sequence

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec
from ...recording import Floats
from ...results.calibration import Calibration
from ..numbers import number_text
from ..page import Figure, Legend
from .figures import AXES, TEXT, WIDTH, Plot, Sheet
from .panel import DASHED, MIDDLE, Panel, TextStyle

_APART = 2.5  # figure units between the points by which lines are seen
_LETTER = 0.62  # width of a letter over its size
_ROOM = 1.25  # letters are larger on small screens
_LATER = 0.1  # cost of a later candidate
_COVERED = 12.0  # units of lines under a label beyond which it cannot be read


class LabelPlaces:
    """Hands out places for labels, in figure units (right, down).

    Parameters
    ----------
    lines : (n, 2, 2) ends of everything that is drawn
    width, height : of the drawing
    """

    def __init__(self, lines: Floats, width: float, height: float) -> None:
        steps = [np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / _APART))[:, None] for a, b in lines]
        points = [a + step * (b - a) for (a, b), step in zip(lines, steps, strict=True)]
        self._points = np.concatenate(points) if points else np.empty((0, 2))
        self._edge = np.array([width, height])
        self._taken: list[tuple[Floats, Floats]] = []

    def take(self, text: str, candidates: Floats) -> Floats:
        """Return the centre (2,) of the best place for a text, earlier candidates (n, 2) first."""
        best, _ = self._best(text, candidates)
        self._taken.append((best, half_size(text)))
        return best

    def take_free(self, text: str, candidates: Floats) -> Floats | None:
        """Return the same, and None where the text could not be read in any place."""
        best, cost = self._best(text, candidates)
        if cost > _COVERED:
            return None
        self._taken.append((best, half_size(text)))
        return best

    def _best(self, text: str, candidates: Floats) -> tuple[Floats, float]:
        costs = [self._cost(centre, half_size(text)) for centre in candidates]
        best = int(np.argmin(np.array(costs) + _LATER * np.arange(len(costs))))
        return candidates[best], costs[best]

    def _cost(self, centre: Floats, half: Floats) -> float:
        """Return units of lines under a label, more where it lies on another one or over the edge."""
        covered = _APART * float(np.count_nonzero((np.abs(self._points - centre) < half).all(axis=1)))
        shared = [np.clip(half + other_half - np.abs(centre - other), 0, None) for other, other_half in self._taken]
        beyond = np.clip(half - centre, 0, None) + np.clip(centre + half - self._edge, 0, None)
        return covered + 3 * sum(float(np.prod(s)) for s in shared) + 10 * float(beyond.sum())


def half_size(text: str) -> Floats:
    """Return half of the width and of the height (2,) that a label takes, with some room."""
    return 0.5 * _ROOM * TEXT * np.array([_LETTER * len(text), 1.0])


def fit_to_scale(panel: Panel, drawn: Floats, height: float, room: tuple[float, float]) -> None:
    """Give a panel as wide as the sheet limits that hold all points (n, 2), to scale, with room for labels.

    A third column is their depth towards the reader, who can then turn what is drawn.
    """
    known = drawn[np.isfinite(drawn).all(axis=1)]
    if not len(known):
        return
    low, high = known.min(axis=0), known.max(axis=0)
    middle, size = (low + high) / 2, high - low
    panel.middle_depth = float(middle[2]) if len(middle) > 2 else None
    scale = max(size[0] / (WIDTH - room[0]), size[1] / (height - room[1]), 1e-9)
    panel.x.span(middle[0] - scale * WIDTH / 2, middle[0] + scale * WIDTH / 2)
    panel.y.span(middle[1] - scale * height / 2, middle[1] + scale * height / 2)


@value_class
class _Body:
    """Something with axes: its name, its origin (3,) and its axes as columns (3, 3), in the first camera's frame."""

    name: str
    origin: Floats
    axes: Floats
    image: bool = False


def _body(name: str, T: Floats, *, image: bool = False) -> _Body:
    """Return what has the pose T (4, 4) in the first camera's frame."""
    return _Body(name=name, origin=T[:3, 3], axes=T[:3, :3], image=image)


def rig_drawing(calibration: Calibration) -> Plot:
    """Draw the IMUs, if any, and the cameras to scale, as triads, from behind the first camera, a little from above."""
    first = next(iter(calibration.cameras.values())).T_cam_body
    bodies = [_Body(name="imu0", origin=first[:3, 3], axes=first[:3, :3])] if calibration.imus else []
    for name, imu in calibration.imus.items():
        if imu.T_imu_body is not None:
            bodies.append(_body(name, first @ np.linalg.inv(imu.T_imu_body)))
    for name, camera in calibration.cameras.items():
        bodies.append(_body(name, first @ np.linalg.inv(camera.T_cam_body), image=True))
    origins = [body.origin for body in bodies]
    apart = max(float(np.linalg.norm(a - b)) for a in origins for b in origins)
    length = 0.4 * apart if np.isfinite(apart) and apart > 1e-6 else 0.02

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=_HEIGHT)
    cameras = [body for body in bodies if body.image]
    corners = [body.origin + length * (_FRUSTUM @ body.axes.T) for body in cameras]
    tips = [body.origin + length * body.axes.T for body in bodies]
    fit_to_scale(panel, _seen(np.concatenate([np.array(origins), *corners, *tips])), _HEIGHT, room=(150, 70))
    links = [np.stack([bodies[0].origin, body.origin]) for body in bodies[1:]]
    for link in links:
        _line(panel, _seen(link), "muted", width=1.2, dash=DASHED)
    edges: list[Floats] = []
    for body, image in zip(cameras, corners, strict=True):
        edges += [np.stack([body.origin, corner]) for corner in image]
        edges += [image[[k, (k + 1) % 4]] for k in range(4)]
    for edge in edges:
        _line(panel, _seen(edge), "before", width=1.1)
    for body in bodies:
        _triad(panel, body, length)
    axes = [np.stack([body.origin, tip]) for body, ends in zip(bodies, tips, strict=True) for tip in ends]
    _label(panel, bodies, links, np.array([*edges, *axes, *links]), length)
    names = ", ".join(body.name for body in bodies)
    return sheet.draw("rig", _HEIGHT, f"The axes of {names} in space, drawn to scale.")


_HEIGHT = 380.0
_FRUSTUM = np.array([[-0.5, -0.36, 0.8], [0.5, -0.36, 0.8], [0.5, 0.36, 0.8], [-0.5, 0.36, 0.8]])
"""Corners of the image in front of a camera, in its own axes, for a triad of length one."""
_AROUND = np.column_stack([f(np.linspace(0, 2 * np.pi, 32, endpoint=False)) for f in (np.cos, np.sin)])
_LOOK = rotation_from_rotvec(np.array([np.radians(24), 0, 0])) @ rotation_from_rotvec(np.array([0, np.radians(-38), 0]))


def _seen(points: Floats) -> Floats:
    """Return points (..., 3) of the first camera's frame (x right, y down) as right, up and towards the reader."""
    return points @ _LOOK.T * (1, -1, -1)


def _line(panel: Panel, points: Floats, color: str, *, width: float, dash: Sequence[float] = ()) -> None:
    """Draw a line through points (n, 3) as they are seen."""
    panel.line(points[:, 0], points[:, 1], color, width=width, dash=dash, depth=points[:, 2])


def _on_page(panel: Panel, points: Floats) -> Floats:
    """Return where points (..., 3), as they are seen, are drawn, (..., 2) in figure units."""
    return np.stack([panel.x.places(points[..., 0]), panel.y.places(points[..., 1])], axis=-1)


def _name(panel: Panel, places: LabelPlaces, text: str, point: Floats, room: float, *, bold: bool) -> None:
    """Write a text beside a point (3,) as it is seen, off the lines."""
    base, ring = _on_page(panel, point), half_size(text) + room
    if np.isfinite(base).all():
        place = places.take(text, np.concatenate([base + reach * ring * _AROUND for reach in (1.0, 1.4, 1.9)]))
        _write(panel, text, point, place - base, color="ink", bold=bold)


def _label(panel: Panel, bodies: list[_Body], links: list[Floats], lines: Floats, length: float) -> None:
    """Write the names of the bodies, and how far they are from the first one where there is room for it."""
    drawn = _on_page(panel, _seen(lines))
    places = LabelPlaces(drawn[np.isfinite(drawn).all(axis=(1, 2))], WIDTH, _HEIGHT)
    for body in bodies:
        _name(panel, places, body.name, _seen(body.origin), 4.0, bold=True)
    for link in links:
        start, stop = _on_page(panel, _seen(link))
        if not np.linalg.norm(np.diff(_seen(link), axis=0)) > 1.5 * length:
            continue
        far = f"{number_text(1e3 * float(np.linalg.norm(link[1] - link[0])), 3)} mm"
        aside = np.array([stop[1] - start[1], start[0] - stop[0]]) / np.linalg.norm(stop - start)
        aside *= float(np.abs(aside) @ half_size(far)) + 2.0
        middles = [start + share * (stop - start) for share in (0.5, 0.6, 0.4, 0.7, 0.3, 0.8, 0.2)]
        place = places.take_free(far, np.array([middle + side * aside for middle in middles for side in (1, -1)]))
        if place is not None:
            share = float((place - start) @ (stop - start) / np.sum((stop - start) ** 2))
            at = start + share * (stop - start)
            _write(panel, far, _seen(link[0] + share * (link[1] - link[0])), place - at)


def _write(panel: Panel, text: str, at: Floats, offset: Floats, *, color: str = "muted", bold: bool = False) -> None:
    """Write a text about a point (3,), as it is seen, moved by an offset (right, down) in figure units."""
    x, y, depth = at.tolist()
    place = float(offset[0]), MIDDLE * TEXT + float(offset[1])
    style = TextStyle(color=color, size=TEXT, align="center", bold=bold)
    panel.text(text, x, y, style, offset=place, depth=depth)


def _triad(panel: Panel, body: _Body, length: float) -> None:
    """Draw three axes as arrows."""
    base = _seen(body.origin)
    for tip, name in zip(_seen(body.origin + length * body.axes.T), AXES, strict=True):
        _arrow(panel, np.stack([base, tip]), name, 2.6, head=0.12 * length)


def _arrow(panel: Panel, ends: Floats, color: str, width: float, *, head: float, dash: Sequence[float] = ()) -> None:
    """Draw an arrow from ends[0] to ends[1], (2, 3) as they are seen, whose head is so long on the page."""
    _line(panel, ends, color, width=width, dash=dash)
    along = ends[1] - ends[0]
    flat = float(np.linalg.norm(along[:2])) or 1.0
    back = head * along / flat
    aside = 0.55 * head * np.array([-along[1], along[0], 0.0]) / flat
    barbs = np.stack([ends[1] - back + aside, ends[1], ends[1] - back - aside])
    _line(panel, barbs, color, width=width)


_IMU_HEIGHT = 320.0
_LEAST_MM = 2.0


def origin_figure(calibration: Calibration, name: str) -> Figure | None:
    """Return the drawing of an IMU whose accelerometers have lever arms and that a camera goes with; else None."""
    imu = calibration.imus[name]
    arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
    if arms is None or not calibration.cameras or imu.T_imu_body is not None:
        return None
    where = "a point between them" if imu.origin is None else imu.origin.words
    camera, T = next((name, entry.T_cam_imu) for name, entry in calibration.cameras.items())
    sigma = 1e3 * calibration.sigma(f"{name}.accelerometer.lever_arms_m")
    far = number_text(1e3 * float(np.linalg.norm(T[:3, 3])), 4)
    return Figure(
        f"The accelerometers of {name}, and its origin",
        _drawing(1e3 * arms, sigma, T[:3, :3], T[:3, 3], camera),
        tuple(Legend("line", axis, f"{axis} accelerometer") for axis in AXES),
        f"The origin, to which T_cam_imu refers, is {where}. Arrows show the axes along which the "
        f"accelerometers feel, whiskers the places' ±σ along the IMU's axes; seen from behind {camera}, a little from "
        f"above. The dashed arrow points to {camera}, {far} mm away and not to scale.",
    )


def _drawing(arms: Floats, sigma: Floats, R_cam_imu: Floats, p_cam_imu: Floats, camera: str) -> Plot:
    """Return the drawing of places (3, 3) with sigmas [mm], IMU's axes, and the camera's direction."""
    length = max(_LEAST_MM, 0.45 * float(np.abs(arms).max()))

    def seen(points: Floats) -> Floats:
        """Return points (n, 3) of the IMU's axes [mm] as they are seen."""
        return _seen(points @ R_cam_imu.T)

    towards = -R_cam_imu.T @ p_cam_imu
    towards = 2.2 * length * towards / max(float(np.linalg.norm(towards)), 1e-12)
    lines: list[tuple[str, Floats, float]] = []
    for k, (place, spread) in enumerate(zip(arms, sigma, strict=True)):
        lines.append(("muted", np.stack([np.zeros(3), place]), 1.0))
        lines += [("before", place + np.outer([-1, 1], spread[i] * np.eye(3)[i]), 3.0) for i in range(3)]
        lines.append((AXES[k], np.stack([place, place + length * np.eye(3)[k]]), 2.6))
    lines.append(("ink", np.stack([np.zeros(3), towards]), 1.6))
    drawn = np.array([seen(line) for _, line, _ in lines])

    sheet = Sheet()
    panel = sheet.bare_panel(left=0, top=0, width=WIDTH, height=_IMU_HEIGHT)
    fit_to_scale(panel, drawn.reshape(-1, 3), _IMU_HEIGHT, room=(180, 70))
    for (color, _, width), ends in zip(lines, drawn, strict=True):
        dash = DASHED if color in ("muted", "ink") else ()
        if color in ("ink", *AXES):
            _arrow(panel, ends, color, width, head=0.14 * length, dash=dash)
        else:
            _line(panel, ends, color, width=width, dash=dash)
    points = seen(np.vstack([arms, np.zeros((1, 3))]))
    for point, color, size in zip(points, (*AXES, "ink"), (9.0, 9.0, 9.0, 11.0), strict=True):
        panel.dots(point[:1], point[1:2], color, size, depth=point[2:])
    places = LabelPlaces(_on_page(panel, drawn), WIDTH, _IMU_HEIGHT)
    texts = (*(f"{axis} accelerometer" for axis in AXES), "origin", f"to {camera}")
    for text, point in zip(texts, np.vstack([points, seen(towards[None])]), strict=True):
        _name(panel, places, text, point, 6.0, bold=text == "origin")
    return sheet.draw("imu-origin", _IMU_HEIGHT, "Where the accelerometers, the origin and the camera are.")
