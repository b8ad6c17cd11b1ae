"""The images of simulated cameras without an IMU: each is rendered when it is asked for, at the true lens and pose."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..geometry.rotation_vector import rotation_from_rotvec
from ..images import Frame, Grey, ImageRecording, ImageStream
from ..models.board_pattern import Pattern, board_pattern
from ..models.camera import Booleans, Camera
from ..recording import Floats
from .cameras import CamerasSimulation
from .clutter import Wall, cluttered_wall
from .covers import MovingCovers, moving_covers
from .outlines import TrueBoard
from .rendering import Optics, render_moving, usual_light

_EXPOSURE_S = 0.01  # any: it is the length of the motion that is stated
_BLURRED = 30.0  # times the motion of other views


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Views:
    """The views of one camera.

    Attributes
    ----------
    pattern, board, wall, covers : what it sees
    camera : the true lens
    T_cam_cam0 : (4, 4) of this camera
    R_cam0_target, p_cam0_target : (v, 3, 3) and (v, 3) pose of the board in the middle of each exposure [m]
    turn, move : (v, 3) and (v, 3) how the board turns and moves during each exposure, in cam0's frame [rad], [m]
    half : (v,) whether the image has half the size
    optics : light, blur and noise
    seed : of the noise; each image has its own
    """

    pattern: Pattern
    board: TrueBoard | None
    wall: Wall | None
    covers: MovingCovers | None
    camera: Camera
    T_cam_cam0: Floats
    R_cam0_target: Floats
    p_cam0_target: Floats
    turn: Floats
    move: Floats
    half: Booleans
    optics: Optics
    seed: tuple[int, ...]

    def image(self, k: int) -> Grey:
        """Return image k; always the same."""
        return render_moving(
            self.pattern,
            _halved(self.camera) if self.half[k] else self.camera,
            partial(self._poses, k),
            exposure_s=_EXPOSURE_S,
            board=self.board,
            options=self.optics,
            wall=self.wall,
            covers=self.covers.at(float(k)) if self.covers else (),
            rng=np.random.default_rng([*self.seed, k]),
        )

    def _poses(self, k: int, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_cam_target (n, 3, 3) and p_cam_target (n, 3) [m] of view k: the board turns about its middle."""
        part = t_s[:, None] / _EXPOSURE_S
        middle = _middle(self.pattern)
        turned = rotation_from_rotvec(part * self.turn[k]) @ self.R_cam0_target[k]
        held = self.R_cam0_target[k] @ middle + self.p_cam0_target[k] + part * self.move[k]
        R, p = self.T_cam_cam0[:3, :3], self.T_cam_cam0[:3, 3]
        return R @ turned, (held - turned @ middle) @ R.T + p

    def frames(self, name: str, t_ns: list[int], _notes: list[str]) -> Iterator[Frame]:
        for k, stamp in enumerate(t_ns):
            yield Frame(t_ns=stamp, where=f"simulated image {k} of {name}", decode=partial(self.image, k))


def rendered_cameras(simulation: CamerasSimulation) -> ImageRecording:
    """Return a simulated recording of cameras as images: those of `simulation.recording`, with the same stamps.

    A stamp is that of the middle of the exposure. Of cameras that take turns, the others see the board, too: what is
    told of detected corners (`CamerasScenario.pixel_noise_px`, outliers, shared_views) does not concern images.

    Parameters
    ----------
    simulation : what was simulated; its scenario says how light, motion, blur and noise are
    """
    scenario, target = simulation.scenario, simulation.target
    pattern, board = board_pattern(target), TrueBoard.of(target, simulation.points)
    turn, move = _motion(simulation, pattern)
    streams: dict[str, ImageStream] = {}
    for number, (name, camera) in enumerate(simulation.truth.cameras.items()):
        views = _Views(
            pattern=pattern,
            board=board,
            wall=cluttered_wall(simulation.seed) if scenario.image_clutter else None,
            covers=moving_covers(scenario.covers, (simulation.seed, number), scenario.resolution),
            camera=camera.camera,
            T_cam_cam0=camera.T_cam_body,
            R_cam0_target=simulation.R_cam0_target,
            p_cam0_target=simulation.p_cam0_target,
            turn=turn,
            move=move,
            half=simulation.resized,
            optics=usual_light(scenario),
            seed=(simulation.seed, number),
        )
        streams[name] = ImageStream(
            frames=partial(views.frames, name, simulation.t_ns.tolist()),
            count=len(simulation.t_ns),
            topic=camera.camera.topic,
        )
    return ImageRecording(imus={}, streams=streams)


def _middle(pattern: Pattern) -> Floats:
    return np.append((pattern.sheet[:2] + pattern.sheet[2:]) / 2, 0.0)


def _motion(simulation: CamerasSimulation, pattern: Pattern) -> tuple[Floats, Floats]:
    """Return how the board turns (v, 3) [rad] and moves (v, 3) [m] during each exposure, in any direction."""
    scenario, count = simulation.scenario, len(simulation.t_ns)
    turn, move = np.random.default_rng([simulation.seed, count, 1]).standard_normal((2, count, 3))
    turn, move = (ways / np.linalg.norm(ways, axis=1, keepdims=True) for ways in (turn, move))
    held = simulation.R_cam0_target @ _middle(pattern) + simulation.p_cam0_target
    lens = simulation.truth.cameras["cam0"].camera
    length_px = scenario.motion_px * np.where(simulation.blurred, _BLURRED, 1.0)
    size_m = length_px * np.linalg.norm(held, axis=1) / (lens.resolution[0] / 2)  # a lens of 90 degrees; roughly
    reach_m = float(np.linalg.norm(pattern.sheet[2:] - pattern.sheet[:2])) / 2
    return turn * (size_m / reach_m)[:, None], move * size_m[:, None]


def _halved(camera: Camera) -> Camera:
    """Return the lens with an image of half the size."""
    intrinsics = camera.intrinsics.copy()
    intrinsics[-4:-2] /= 2
    intrinsics[-2:] = (intrinsics[-2:] + 0.5) / 2 - 0.5
    width, height = camera.resolution
    return replace(camera, intrinsics=intrinsics, resolution=(width // 2, height // 2))
