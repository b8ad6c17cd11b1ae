"""Figures of a camera-IMU report that show the rig and how it was moved."""

from dataclasses import dataclass

import numpy as np

from ..calibration import Calibration
from ..diagnostics import TrajectoryTrack
from ..geometry.quaternion import rotation_from_quaternion
from ..geometry.rotation_vector import rotation_from_rotvec
from ..recording import Floats, Integers
from . import svg
from .camera_imu_images import TIMES, time_spans
from .camera_imu_signals import AXES, half_panel, histograms
from .figures import SPHERE_HEIGHT, TEXT, WIDTH, LabelPlaces, Sheet, half_size, hemisphere, lambert
from .numbers import finite, highest, number, rms
from .panel import DASHED, Panel

_DEG = 180 / np.pi
_PATCH = 2 * np.sqrt(2) / 25
"""Side of the patches in which axes of rotation are counted, in the equal-area projection."""
_FASTER_THAN = 0.3
"""Share of the rms rate above which a sample says something about the axis of rotation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """How the rig moved.

    Attributes
    ----------
    t_s : (n,) [s from the first stamp of the trajectory]
    rate : (n, 3) angular rate, body frame [deg/s]
    acceleration : (n, 3) linear acceleration, body frame [m/s^2]
    position : (n, 3) of the IMU, in the frame of the target [m]
    """

    t_s: Floats
    rate: Floats
    acceleration: Floats
    position: Floats


def motion_of(track: TrajectoryTrack, gravity_target: Floats) -> Motion:
    """Return the motion; linear acceleration is specific force plus gravity."""
    t = (track.t_ns - track.t_ns[0]) * 1e-9 if len(track.t_ns) else np.empty(0)
    R = rotation_from_quaternion(np.asarray(track.q_target_imu_wxyz))
    acceleration = track.f_imu + np.einsum("nji,j->ni", R, gravity_target)
    return Motion(t_s=t, rate=track.omega_imu * _DEG, acceleration=acceleration, position=track.p_target_imu)


def axes_of_rotation(motion: Motion) -> str:
    """Draw the axes about which the rig turned, in the body frame, where it turned fast enough to tell."""
    speed = np.linalg.norm(motion.rate, axis=1)
    fast = speed > _FASTER_THAN * rms(speed)
    directions = motion.rate[fast] / speed[fast, None]
    counted: dict[float, tuple[Floats, Floats]] = {}
    for side in (1.0, -1.0):
        flat = lambert(directions[(directions[:, 2] >= 0) == (side > 0)], side)
        spots, count = np.unique(np.floor(flat / _PATCH + 0.5), axis=0, return_counts=True)
        counted[side] = spots, count.astype(np.float64)
    most = max(float(count.max(initial=0)) for _, count in counted.values()) or 1.0

    sheet = Sheet()
    for side, (spots, count) in counted.items():
        panel = hemisphere(sheet, side)
        panel.rim = np.sqrt(2)
        panel.cells((spots - 0.5) * _PATCH, (_PATCH, _PATCH), level=np.sqrt(count / most), color="after")
    return sheet.draw("rotation", SPHERE_HEIGHT, "Axes of rotation in the body frame, on two hemispheres.")


def rates(motion: Motion) -> str:
    """Draw histograms of angular rate and linear acceleration per axis."""
    parts = (("Angular rate [°/s]", motion.rate), ("Linear acceleration [m/s²]", motion.acceleration))

    sheet = Sheet()
    for k, (title, values) in enumerate(parts):
        sizes = np.abs(finite(values))
        reach = 1.02 * float(np.quantile(sizes, 0.9995)) if sizes.size and sizes.max() > 0 else 1.0
        axes = half_panel(sheet, title, k, top=36, height=220, left=20)
        histograms(axes, [(values[:, i], axis) for i, axis in enumerate(AXES)], reach=reach, bins=50)
        axes.y.ticks = ()
    return sheet.draw("rates", 300, "Histograms of angular rate and of linear acceleration along the body axes.")


def path(motion: Motion) -> str:
    """Draw the path of the IMU in the target's frame, from the front and along its y axis, coloured by time."""
    kept = _sampled(motion, 1500)
    high = np.array([highest(axis) for axis in motion.position.T])
    low = -np.array([highest(-axis) for axis in motion.position.T])
    span = 0.54 * max(float((high - low).max()), 1e-3)
    spans = time_spans(motion.t_s)
    colour = np.clip(np.searchsorted(spans, motion.t_s[kept], side="right") - 1, 0, len(TIMES) - 1)
    torn = np.diff(motion.t_s[kept], append=np.inf) > 5 * np.median(np.diff(motion.t_s[kept], append=0.0))

    sheet = Sheet()
    for k, (title, across, up) in enumerate((("Plane: y over x [m]", 0, 1), ("Depth: z over x [m]", 0, 2))):
        axes = half_panel(sheet, title, k, top=36, height=314)
        axes.x.grid = True
        for i, name in enumerate(TIMES):
            # A piece reaches to the first point of the next one, and a gap interrupts it.
            piece = (colour == i) | np.concatenate([[False], (colour == i)[:-1]])
            line = motion.position[kept][:, [across, up]].copy()
            line[torn] = np.nan
            axes.line(line[piece, 0], line[piece, 1], name, width=1.3)
        middle = (low + high) / 2
        axes.x.span(middle[across] - span, middle[across] + span)
        axes.y.span(middle[up] - span, middle[up] + span)
    return sheet.draw("path", 396, "Path of the IMU in the frame of the target, from the front and along its y axis.")


def _sampled(motion: Motion, most: int) -> Integers:
    return np.arange(0, len(motion.t_s), max(1, -(-len(motion.t_s) // most)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Body:
    """Something with axes: its name, its origin (3,) and its axes as columns (3, 3), in the first camera's frame."""

    name: str
    origin: Floats
    axes: Floats
    image: bool = False


def _body(name: str, T: Floats, *, image: bool = False) -> _Body:
    """Return what has the pose T (4, 4) in the first camera's frame."""
    return _Body(name=name, origin=T[:3, 3], axes=T[:3, :3], image=image)


def rig(calibration: Calibration) -> str:
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
    _fit(panel, _flat(np.concatenate([np.array(origins), *corners, *tips])))
    links = [np.stack([bodies[0].origin, body.origin]) for body in bodies[1:]]
    for link in links:
        ends = _flat(link)
        panel.line(ends[:, 0], ends[:, 1], "muted", width=1.2, dash=DASHED)
    edges: list[Floats] = []
    for body, image in zip(cameras, corners, strict=True):
        edges += [np.stack([body.origin, corner]) for corner in image]
        edges += [image[[k, (k + 1) % 4]] for k in range(4)]
    for edge in edges:
        flat = _flat(edge)
        panel.line(flat[:, 0], flat[:, 1], "before", width=1.1)
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


def _flat(points: Floats) -> Floats:
    """Project points (n, 3) of the first camera's frame (x right, y down) to the page (n, 2), y up."""
    return (points @ _LOOK.T)[:, :2] * (1, -1)


def _label(panel: Panel, bodies: list[_Body], links: list[Floats], lines: Floats, length: float) -> None:
    """Write the names of the bodies, and how far they are from the first one where there is room for it."""

    def on_page(points: Floats) -> Floats:
        flat = _flat(points)
        return np.column_stack([panel.x.places(flat[:, 0]), panel.y.places(flat[:, 1])])

    drawn = on_page(lines.reshape(-1, 3)).reshape(-1, 2, 2)
    places = LabelPlaces(drawn[np.isfinite(drawn).all(axis=(1, 2))], WIDTH, _HEIGHT)
    for body in bodies:
        base = on_page(body.origin[None])[0]
        if np.isfinite(base).all():
            ring = half_size(body.name) + 4.0
            place = places.take(body.name, np.concatenate([base + reach * ring * _AROUND for reach in (1.0, 1.4, 1.9)]))
            _write(panel, body.name, body.origin, place - base, color="ink", bold=True)
    for link in links:
        start, stop = on_page(link)
        if not np.linalg.norm(np.diff(_flat(link), axis=0)) > 1.5 * length:
            continue
        far = f"{number(1e3 * float(np.linalg.norm(link[1] - link[0])), 3)} mm"
        aside = np.array([stop[1] - start[1], start[0] - stop[0]]) / np.linalg.norm(stop - start)
        aside *= float(np.abs(aside) @ half_size(far)) + 2.0
        middles = [start + share * (stop - start) for share in (0.5, 0.6, 0.4, 0.7, 0.3, 0.8, 0.2)]
        place = places.take_free(far, np.array([middle + side * aside for middle in middles for side in (1, -1)]))
        if place is not None:
            _write(panel, far, link[0], place - start)


def _write(panel: Panel, text: str, at: Floats, offset: Floats, *, color: str = "muted", bold: bool = False) -> None:
    """Write a text about a point (3,) that is moved by an offset (right, down) in figure units."""
    x, y = _flat(at[None])[0].tolist()
    place = float(offset[0]), svg.MIDDLE * TEXT + float(offset[1])
    panel.text(text, x, y, svg.text_style(color, TEXT, "center", bold=bold), offset=place)


def _triad(panel: Panel, body: _Body, length: float) -> None:
    """Draw three axes as arrows."""
    base = _flat(body.origin[None])[0]
    tips = _flat(body.origin + length * body.axes.T)
    for tip, name in zip(tips, AXES, strict=True):
        along = tip - base
        aside = np.array([-along[1], along[0]])
        head = 0.12 * length / (float(np.linalg.norm(along)) or 1.0)
        barbs = [tip - head * along + sign * 0.55 * head * aside for sign in (1, -1)]
        line = np.stack([base, tip, barbs[0], tip, barbs[1]])
        panel.line(line[:, 0], line[:, 1], name, width=2.6, ends="round")


def _fit(panel: Panel, drawn: Floats) -> None:
    """Give the panel limits that hold all points, to scale, with room for labels."""
    known = drawn[np.isfinite(drawn).all(axis=1)]
    if not len(known):
        return
    low, high = known.min(axis=0), known.max(axis=0)
    middle, size = (low + high) / 2, high - low
    scale = max(size[0] / (WIDTH - 150), size[1] / (_HEIGHT - 70), 1e-9)
    panel.x.span(middle[0] - scale * WIDTH / 2, middle[0] + scale * WIDTH / 2)
    panel.y.span(middle[1] - scale * _HEIGHT / 2, middle[1] + scale * _HEIGHT / 2)
