"""Images of a furnished room: what a camera records while it is carried about in it.

Walls and furniture are rectangles with a texture. Seen from o along a ray d, the plane through c with the normal n is
met at the inverse distance q d, and there a texture's axis a through c reads (u d) / (q d), with

    q = n / (n . (c - o)),     u = ((o - c) . a) q + a,

so that three products a pixel tell what it shows, and the greatest inverse distance tells which rectangle.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Self

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec
from ...models.camera import Camera
from ...recording import Floats
from ...recording.recording import Frame, Grey, ImageRecording, ImageStream
from ..camera_imu import CameraImuSimulation
from ..scenarios.camera_imu import RoomScenario, Surface
from ..walk import half_axes
from .board_images import ViewsOnPath
from .board_outlines import MotionSegment, Pose, Singles
from .rendering import add_noise, light_falloff, pixel_rays, usual_light

_TEXEL_M = {True: 0.0025, False: 0.0012}  # of walls, of furniture
_MOST_TEXELS = 8000  # along a side
_OCTAVES = ((256, 22.0), (64, 16.0), (16, 14.0), (6, 12.0), (2, 8.0))  # cells [texels], standard deviation [levels]
_SPOTS_PER_MEGATEXEL = 220
_TILE = 96  # texels, of a surface that repeats itself
_GRID = 8  # px between the rays that tell what is seen at all
_STEP_PX = 0.8  # between the instants of an exposure
_SHARPEST = 1.3  # texels to a pixel, from which on a coarser level is looked up
_MIRROR, _REFLECTED = (
    4,
    0.9,
)  # number of the wall that the rig faces, and what it shows of the light where it is a mirror
_ASIDE_M = 5.0  # that a room is wider than the way round
_PERSON_M, _STRIDE_M = (0.5, 1.7, 0.3), (1.0, 0.0, 0.3)
_SIDES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # axis of the normal, and those of the texture


@value_class
class Surfaces:
    """Rectangles of a box, seen from outside or, of a room, from inside.

    Attributes
    ----------
    corner : (6, 3) where the texture of each starts [m]
    axes : (6, 2, 3) unit vectors along it
    normal : (6, 3) to the side from which it is seen
    size : (6, 2) [m]
    levels : for each, the texture, and that at half the size, ...
    texel_m : side of a texel of the finest level
    swing, pulsation : (3,) how far it moves to both sides [m], and how fast [rad/s]
    """

    corner: Floats
    axes: Floats
    normal: Floats
    size: Floats
    levels: tuple[tuple[Grey, ...], ...]
    texel_m: float
    swing: Floats
    pulsation: Floats

    @classmethod
    def box(
        cls,
        middle: Floats,
        R: Floats,
        size: Floats,
        surface: Surface,
        rng: np.random.Generator,
        *,
        inside: bool = False,
        swing: Floats | None = None,
    ) -> Self:
        """Return the faces of a box; a room is seen from its inside."""
        corners: list[Floats] = []
        axes: list[Floats] = []
        normals: list[Floats] = []
        sizes: list[Floats] = []
        for axis, along, across in _SIDES:
            for side in (-1.0, 1.0):
                start = np.zeros(3)
                start[[axis, along, across]] = side * size[axis] / 2, -size[along] / 2, -size[across] / 2
                corners.append(middle + R @ start)
                axes.append(R[:, [along, across]].T)
                normals.append(R[:, axis] * (-side if inside else side))
                sizes.append(size[[along, across]])
        texel_m = max(_TEXEL_M[inside], float(size.max()) / _MOST_TEXELS)
        return cls(
            corner=np.array(corners),
            axes=np.array(axes),
            normal=np.array(normals),
            size=np.array(sizes),
            levels=tuple(texture_levels(_texture(extent / texel_m, surface, rng)) for extent in sizes),
            texel_m=texel_m,
            swing=np.zeros(3) if swing is None else swing,
            pulsation=rng.uniform(0.5, 1.5, 3),
        )

    def reflected(self, place: Floats, normal: Floats) -> Self:
        """Return what a mirror shows of it, through a place (3,), with a normal (3,)."""
        turn = np.eye(3) - 2 * np.outer(normal, normal)
        return replace(
            self,
            corner=place + (self.corner - place) @ turn,
            axes=self.axes @ turn,
            normal=self.normal @ turn,
            swing=self.swing @ turn,
        )

    def maps(self, o: Floats, t_s: float) -> Floats:
        """Return u, v and q of each face from places o (k, 3), (6, k, 3, 3); zero from where it is not seen."""
        away = self.corner[:, None] + self.swing * np.sin(self.pulsation * t_s) - o  # (6, k, 3)
        depth = np.einsum("fkj,fj->fk", away, self.normal)
        facing = depth < 0
        q = self.normal[:, None] / np.where(facing, depth, -np.inf)[..., None]
        u = -np.einsum("fkj,faj->fka", away, self.axes)[..., None] * q[:, :, None] + self.axes[:, None]
        return np.concatenate([u, q[:, :, None]], axis=2) * facing[..., None, None]


def _texture(size: Floats, surface: Surface, rng: np.random.Generator) -> Grey:
    """Return a texture of a size (2,) [texels], its rows along the second axis."""
    import cv2

    width, height = np.maximum(np.ceil(size), 2).astype(int).tolist()
    if surface == "repeated":
        tile = _texture(np.array([_TILE, _TILE]), "rich", np.random.default_rng(0))
        return np.tile(tile, (height // _TILE + 1, width // _TILE + 1))[:height, :width].copy()
    grey = np.full((height, width), rng.uniform(90, 160), np.float32)
    if surface == "plain":
        return grey.astype(np.uint8)
    for cell, level in _OCTAVES:
        shape = (height // cell + 2, width // cell + 2)
        part = rng.normal(0.0, level, shape).astype(np.float32)
        larger = cv2.resize(part, (shape[1] * cell, shape[0] * cell), interpolation=cv2.INTER_CUBIC)
        grey += larger[:height, :width]
    texels = np.clip(grey, 0, 255).astype(np.uint8)
    for _ in range(max(4, round(_SPOTS_PER_MEGATEXEL * width * height / 1e6))):
        middle = rng.uniform(0, (width, height)).tolist()
        extent = np.exp(rng.uniform(np.log(5), np.log(120), 2)).tolist()
        spot = cv2.RotatedRect(middle, extent, float(rng.uniform(0, 180)))
        cv2.fillPoly(texels, [np.rint(spot.points()).astype(np.int32)], int(rng.integers(5, 250)), cv2.LINE_AA)
    return texels


def texture_levels(texture: Grey) -> tuple[Grey, ...]:
    """Return a texture, and the same at half the size again and again."""
    import cv2

    levels = [texture]
    while min(levels[-1].shape) >= 8:
        height, width = levels[-1].shape
        even = levels[-1][: height // 2 * 2, : width // 2 * 2]
        levels.append(np.asarray(cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8))
    return tuple(levels)


def furnished_room(
    scenario: RoomScenario, middle: Floats, seed: int, half: Floats | None = None
) -> tuple[Surfaces, ...]:
    """Return the walls of a room and what stands in it.

    Parameters
    ----------
    scenario : what the room is like
    middle : (3,) where the rig is waved [m]
    seed : every random number follows from it
    half : (2,) half axes of the ellipse round which it is walked, along x and z [m]; None where it is waved
    """
    rng = np.random.default_rng([seed, 77])
    way = np.zeros(3) if half is None else np.array([abs(half[0]), 0.0, abs(half[1])])
    room = np.maximum(scenario.room_m, 2 * way + _ASIDE_M * (way > 0))
    found = [Surfaces.box(middle, np.eye(3), room, scenario.surface, rng, inside=True)]
    for k in range(scenario.furniture + scenario.moving):
        size = rng.uniform(0.15, 0.55, 3)
        # the first three stand before the camera; all clear of the hand's reach
        angle = rng.uniform(-0.6, 0.6) if k < 3 and half is None else rng.uniform(-np.pi, np.pi)
        away = way + (rng.uniform(0.75, 0.95) + np.linalg.norm(size) / 2) * (1 if half is None else rng.choice([-1, 1]))
        place = np.array([away[0] * np.sin(angle), rng.uniform(-0.45, 0.25), -away[2] * np.cos(angle)])
        place = np.clip(place, -(room - size) / 2, (room - size) / 2)
        R = rotation_from_rotvec(np.array([0.0, rng.uniform(-np.pi, np.pi), 0.0]))
        swing = None if k < scenario.furniture else rng.uniform(0.2, 0.5) * np.array([1.0, 0.5, 0.3])
        found.append(Surfaces.box(middle + place, R, size, scenario.surface, rng, swing=swing))
    for _ in range(scenario.people):
        place = np.array([rng.uniform(-0.8, 0.8), (_PERSON_M[1] - room[1]) / 2, -rng.uniform(1.0, 1.5)])
        turned = rotation_from_rotvec(np.array([0.0, rng.uniform(-np.pi, np.pi), 0.0]))
        stride = np.array(_STRIDE_M)
        found.append(Surfaces.box(middle + place, turned, np.array(_PERSON_M), scenario.surface, rng, swing=stride))
    return tuple(found)


def render_room(
    room: tuple[Surfaces, ...],
    camera: Camera,
    R_cam_room: Floats,
    p_cam_room: Floats,
    t_s: float = 0.0,
    *,
    mirror: bool = False,
) -> Singles:
    """Return the grey levels (height, width) that a camera sees at one instant, without lens blur and noise.

    Parameters
    ----------
    room : walls and furniture
    camera : the lens
    R_cam_room, p_cam_room : (k, 3, 3) and (k, 3) pose of the room [m], of each row, or one of all
    t_s : when, for what moves
    mirror : whether the wall that the rig faces shows what is before it
    """
    rays = pixel_rays(camera)
    pose = R_cam_room, -np.einsum("kji,kj->ki", R_cam_room, p_cam_room)
    scene, nearest = _drawn(room, rays, *pose, t_s)
    if mirror:
        walls = room[0]
        wall = (walls.maps(pose[1], t_s)[_MIRROR] @ np.swapaxes(R_cam_room, 1, 2)).astype(np.float32)
        inverse = np.matmul(wall[:, 2:], rays)[:, 0]
        behind, _ = _drawn(
            tuple(one.reflected(walls.corner[_MIRROR], walls.normal[_MIRROR]) for one in room), rays, *pose, t_s
        )
        np.copyto(scene, _REFLECTED * behind, where=(inverse > 0) & (inverse >= (1 - 1e-4) * nearest))
    return scene


def _drawn(
    room: tuple[Surfaces, ...], rays: Singles, R_cam_room: Floats, o: Floats, t_s: float
) -> tuple[Singles, Singles]:
    """Return grey levels and inverse distances (height, width) along rays from places o (k, 3)."""
    import cv2

    scene = np.zeros((rays.shape[0], rays.shape[2]), np.float32)
    nearest = np.zeros_like(scene)
    for surfaces in room:
        maps = (surfaces.maps(o, t_s) @ np.swapaxes(R_cam_room, 1, 2)).astype(np.float32)
        for k, face in enumerate(maps):
            extent = surfaces.size[k].astype(np.float32)
            seen = _seen(face, rays, extent, surfaces.texel_m)
            if seen is None:
                continue
            (rows, cols), level = seen
            met = np.matmul(face if len(face) == 1 else face[rows], rays[rows, :, cols])
            inverse = met[:, 2]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                u, v = met[:, 0] / inverse, met[:, 1] / inverse
            near, part = nearest[rows, cols], scene[rows, cols]
            front = (inverse > near) & (u >= 0) & (u <= extent[0]) & (v >= 0) & (v <= extent[1])
            texel_m = np.float32(surfaces.texel_m * 2**level)
            texture = surfaces.levels[k][level]
            grey = cv2.remap(
                texture, u / texel_m - 0.5, v / texel_m - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            np.copyto(part, grey, where=front)
            np.copyto(near, inverse, where=front)
    return scene, nearest


def _seen(face: Singles, rays: Singles, extent: Singles, texel_m: float) -> tuple[tuple[slice, slice], int] | None:
    """Return the part of the image in which a face may be seen, and the level of its texture; None where nowhere."""
    if not face.any():
        return None
    height, _, width = rays.shape
    thin = rays[::_GRID, :, ::_GRID]
    met = np.matmul(face if len(face) == 1 else face[::_GRID], thin)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        uv = met[:, :2] / met[:, 2:]
    around = 0.15 * extent[:, None]
    inside = (met[:, 2] > 0) & ((uv >= -around) & (uv <= extent[:, None] + around)).all(axis=1)
    if not inside.any():
        return None
    row, col = np.nonzero(inside)
    rows = slice(max(0, _GRID * (int(row.min()) - 1)), min(height, _GRID * (int(row.max()) + 2)))
    cols = slice(max(0, _GRID * (int(col.min()) - 1)), min(width, _GRID * (int(col.max()) + 2)))
    step = np.abs(np.diff(uv, axis=2)).max(axis=1)[inside[:, 1:] & inside[:, :-1]] / (_GRID * texel_m)
    texels = float(np.median(step)) if len(step) else 1.0
    return (rows, cols), int(
        np.clip(
            np.floor(np.log2(max(texels / _SHARPEST, 1e-3)) + 1),
            0,
            max(0, int(np.log2(float(extent.min()) / texel_m)) - 3),
        )
    )


@value_class
class _RoomView:
    """What a camera sees of a room on its path."""

    name: str
    room: tuple[Surfaces, ...]
    scenario: RoomScenario
    simulation: CameraImuSimulation

    def image(self, k: int) -> Grey:
        """Return image k; always the same."""
        import cv2

        views = ViewsOnPath(simulation=self.simulation, exposure_s=self.scenario.exposure_s)
        camera, t_s, pose = views.lens(self.name, k), views.at_s(self.name, k), partial(views.pose, self.name, k)
        movement = MotionSegment.during(self.scenario.exposure_s, camera, pose, _points(camera, pose), _STEP_PX)
        scene = np.zeros(camera.resolution[::-1], np.float32)
        for instant in range(movement.instants):
            at_s = t_s + float(movement.at_s[instant])
            scene += render_room(self.room, camera, *movement.rows(instant), at_s, mirror=self.scenario.mirror)
        optics = usual_light(self.simulation.scenario)
        scene *= light_falloff(camera.resolution, optics.vignetting, optics.gradient)
        scene *= np.float32(self.scenario.light / movement.instants)
        if self.scenario.blur_px:
            scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), self.scenario.blur_px), np.float32)
        if self.scenario.image_noise:
            add_noise(scene, optics, np.random.default_rng([self.simulation.seed, k, int(self.name[3:])]))
        return np.asarray(cv2.convertScaleAbs(np.maximum(scene, 0, out=scene)), dtype=np.uint8)

    def frames(self, t_ns: list[int], _notes: list[str]) -> Iterator[Frame]:
        for k, stamp in enumerate(t_ns):
            yield Frame(t_ns=stamp, where=f"simulated image {k} of {self.name}", decode=partial(self.image, k))


def _points(camera: Camera, pose: Pose) -> Floats:
    """Return points of the room (25, 3) [m], an arm's length away, all over the image."""
    width, height = camera.resolution
    u, v = np.meshgrid(np.linspace(0, width - 1, 5), np.linspace(0, height - 1, 5))
    rays = np.nan_to_num(camera.unproject(np.column_stack([u.ravel(), v.ravel()]))[0])
    R, p = pose(np.zeros(1))
    return (rays - p[0]) @ R[0]


def room_images(scenario: RoomScenario, simulation: CameraImuSimulation) -> ImageRecording:
    """Return a rig that was simulated by `scenario.rig()` with images of the room, each rendered when it is asked for.

    Parameters
    ----------
    scenario : what the room is like
    simulation : the rig in it
    """
    middle = simulation.trajectory.path.middle + np.array([0.0, 0.0, simulation.scenario.distance_m])
    half = half_axes(simulation.trajectory.path) if scenario.motion == "walk" else None
    room = furnished_room(scenario, middle, simulation.seed, half)
    streams: dict[str, ImageStream] = {}
    for name, recorded in simulation.recording.cameras.items():
        view = _RoomView(name=name, room=room, scenario=scenario, simulation=simulation)
        streams[name] = ImageStream(
            frames=partial(view.frames, recorded.t_ns.tolist()), count=len(recorded.t_ns), camera=recorded.camera
        )
    return ImageRecording(imus=simulation.recording.imus, streams=streams)
