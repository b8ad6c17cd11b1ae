"""The images of simulated cameras: each is rendered when it is asked for, at the true lens and the true pose."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec
from ...models.board_pattern import BoardPattern, board_pattern
from ...models.camera import Camera
from ...recording import Floats
from ...recording.recording import Frame, Grey, ImageRecording, ImageStream
from ..camera_imu import CameraImuSimulation
from ..cameras import CamerasSimulation
from .board_outlines import TrueBoard
from .clutter import MovingOccluders, Wall, cluttered_wall, moving_occluders
from .rendering import Optics, render_moving, usual_light

_BLURRED = 30.0  # times the motion of other views


class _Views(Protocol):
    """Where the board is while each camera, by its name, takes image k."""

    exposure_s: float

    def at_s(self, name: str, k: int) -> float:
        """Return when it is taken, for what moves before the board [s]."""
        ...

    def lens(self, name: str, k: int) -> Camera:
        """Return the true lens."""
        ...

    def pose(self, name: str, k: int, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_cam_target (n, 3, 3) and p_cam_target (n, 3) [m] at t_s (n,) from the middle of the exposure."""
        ...


@value_class
class _Scene:
    """What a camera sees, and how: light, blur and noise; `seed` is that of the noise."""

    name: str
    views: _Views
    pattern: BoardPattern
    board: TrueBoard | None
    wall: Wall | None
    occluders: MovingOccluders | None
    optics: Optics
    seed: tuple[int, int]

    def image(self, k: int) -> Grey:
        """Return image k; always the same."""
        return render_moving(
            self.pattern,
            self.views.lens(self.name, k),
            partial(self.views.pose, self.name, k),
            exposure_s=self.views.exposure_s,
            board=self.board,
            options=self.optics,
            wall=self.wall,
            occluders=self.occluders.at(self.views.at_s(self.name, k)) if self.occluders else (),
            rng=np.random.default_rng([*self.seed, k]),
        )

    def frames(self, t_ns: list[int], _notes: list[str]) -> Iterator[Frame]:
        for k, stamp in enumerate(t_ns):
            yield Frame(t_ns=stamp, where=f"simulated image {k} of {self.name}", decode=partial(self.image, k))


def _streams(
    simulation: CameraImuSimulation | CamerasSimulation, views: _Views, points: Floats, *, lenses_stated: bool
) -> dict[str, ImageStream]:
    """Return the images of each camera; `points` (k, 3) are where those of the board truly are [m]."""
    scenario, target, seed = simulation.scenario, simulation.target, simulation.seed
    streams: dict[str, ImageStream] = {}
    for number, (name, frames) in enumerate(simulation.recording.cameras.items()):
        scene = _Scene(
            name=name,
            views=views,
            pattern=board_pattern(target),
            board=TrueBoard.of(target, points),
            wall=cluttered_wall(seed) if scenario.image_clutter else None,
            occluders=moving_occluders(scenario.covers, (seed, number), scenario.resolution),
            optics=usual_light(scenario),
            seed=(seed, number),
        )
        streams[name] = ImageStream(
            frames=partial(scene.frames, frames.t_ns.tolist()),
            count=len(frames.t_ns),
            topic=frames.camera.topic,
            camera=frames.camera if lenses_stated else None,
        )
    return streams


def simulated_images(simulation: CameraImuSimulation) -> ImageRecording:
    """Return a simulated recording whose cameras are images: those of `simulation.recording`, with the same timestamps.

    A timestamp is that of the middle of the exposure, of the top row with a rolling shutter. Errors that a detector
    makes (pixel_noise_px, outliers, shifted_frames) do not concern images; its own come in their place.

    Parameters
    ----------
    simulation : what was simulated; its scenario says how light, blur and noise are
    """
    points = simulation.target.points + simulation.truth_parameters["target.offsets"]
    views = ViewsOnPath(simulation=simulation, exposure_s=simulation.scenario.exposure_s)
    streams = _streams(simulation, views, simulation.scenario.target_scale * points, lenses_stated=True)
    return ImageRecording(imus=simulation.recording.imus, streams=streams)


@dataclass(slots=True, kw_only=True, eq=False)
class ViewsOnPath:
    """Views of cameras on the path of cam0."""

    simulation: CameraImuSimulation
    exposure_s: float

    def at_s(self, name: str, k: int) -> float:
        """Return the middle of the exposure [s]."""
        return float(self.simulation.frames[name].exposure_s[k])

    def lens(self, name: str, k: int) -> Camera:
        """Return the true lens."""
        return self.simulation.truth.cameras[name].camera

    def pose(self, name: str, k: int, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_cam_target (n, 3, 3) and p_cam_target (n, 3) [m] at t_s (n,) from the middle of the exposure."""
        R, p = self.simulation.trajectory.path.pose(self.at_s(name, k) + t_s)
        cameras = self.simulation.truth.cameras
        T_cam_cam0 = cameras[name].T_cam_imu @ np.linalg.inv(cameras["cam0"].T_cam_imu)
        turned = T_cam_cam0[:3, :3] @ np.swapaxes(R, 1, 2)
        return turned, T_cam_cam0[:3, 3] - np.einsum("nij,nj->ni", turned, p)


def rendered_cameras(simulation: CamerasSimulation) -> ImageRecording:
    """Return a simulated recording of cameras as images: those of `simulation.recording`, with the same timestamps.

    A timestamp is that of the middle of the exposure. Of cameras that take turns, the others see the board, too: what
    is told of detected corners (`CamerasScenario.pixel_noise_px`, outliers, shared_views) does not concern images.

    Parameters
    ----------
    simulation : what was simulated; its scenario says how light, motion, blur and noise are
    """
    views = _HeldViews.of(simulation)
    return ImageRecording(imus={}, streams=_streams(simulation, views, simulation.points, lenses_stated=False))


@dataclass(slots=True, kw_only=True, eq=False)
class _HeldViews:
    """Views of a board that a hand holds while images are exposed.

    Attributes
    ----------
    simulation : the views
    middle : (3,) of the board, about which it turns [m]
    turn, move : (v, 3) how the board turns and moves during each exposure, in cam0's frame [rad], [m]
    exposure_s : any, since it is the length of the motion that is stated
    """

    simulation: CamerasSimulation
    middle: Floats
    turn: Floats
    move: Floats
    exposure_s: float = 0.01

    @classmethod
    def of(cls, simulation: CamerasSimulation) -> "_HeldViews":
        """Return motions in any direction, as long as the scenario says."""
        scenario, count, sheet = simulation.scenario, len(simulation.t_ns), board_pattern(simulation.target).sheet
        middle = np.append((sheet[:2] + sheet[2:]) / 2, 0.0)
        turn, move = np.random.default_rng([simulation.seed, count, 1]).standard_normal((2, count, 3))
        turn, move = (ways / np.linalg.norm(ways, axis=1, keepdims=True) for ways in (turn, move))
        held = simulation.R_cam0_target @ middle + simulation.p_cam0_target
        lens = simulation.truth.cameras["cam0"].camera
        length_px = scenario.motion_px * np.where(simulation.blurred, _BLURRED, 1.0)
        size_m = length_px * np.linalg.norm(held, axis=1) / (lens.resolution[0] / 2)  # a lens of 90 degrees; roughly
        turn *= (size_m / (float(np.linalg.norm(sheet[2:] - sheet[:2])) / 2))[:, None]
        return cls(simulation=simulation, middle=middle, turn=turn, move=move * size_m[:, None])

    def at_s(self, name: str, k: int) -> float:
        return float(k)

    def lens(self, name: str, k: int) -> Camera:
        camera = self.simulation.truth.cameras[name].camera
        if not self.simulation.resized[k]:
            return camera
        intrinsics = camera.intrinsics.copy()
        intrinsics[-4:-2] /= 2
        intrinsics[-2:] = (intrinsics[-2:] + 0.5) / 2 - 0.5
        width, height = camera.resolution
        return replace(camera, intrinsics=intrinsics, resolution=(width // 2, height // 2))

    def pose(self, name: str, k: int, t_s: Floats) -> tuple[Floats, Floats]:
        part = t_s[:, None] / self.exposure_s
        R_cam0_target, p_cam0_target = self.simulation.R_cam0_target[k], self.simulation.p_cam0_target[k]
        turned = rotation_from_rotvec(part * self.turn[k]) @ R_cam0_target
        held = R_cam0_target @ self.middle + p_cam0_target + part * self.move[k]
        T_cam_cam0 = self.simulation.truth.cameras[name].T_cam_body
        R, p = T_cam_cam0[:3, :3], T_cam_cam0[:3, 3]
        return R @ turned, (held - turned @ self.middle) @ R.T + p
