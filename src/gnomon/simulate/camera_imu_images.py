"""The images of a simulated recording: each is rendered when it is asked for, at the true lens and the true path."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..images import Frame, Grey, ImageRecording, ImageStream
from ..models.board_pattern import Pattern, board_pattern
from ..models.camera import Camera
from ..recording import Floats
from .camera_imu import CameraImuSimulation
from .camera_imu_path import CameraPath
from .clutter import Wall, cluttered_wall
from .covers import MovingCovers, moving_covers
from .outlines import TrueBoard
from .rendering import Optics, render_moving, usual_light


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Exposures:
    """A camera on its path, and when it exposes.

    Attributes
    ----------
    pattern, board, wall, covers : what it sees
    camera : the true lens
    path : of cam0
    T_cam_cam0 : (4, 4) of this camera
    middle_s : (n,) instants in the middle of the exposure of the top row [s]
    exposure_s : how long it takes
    optics : light, blur and noise
    seed : of the noise; each image has its own
    """

    pattern: Pattern
    board: TrueBoard | None
    wall: Wall | None
    covers: MovingCovers | None
    camera: Camera
    path: CameraPath
    T_cam_cam0: Floats
    middle_s: Floats
    exposure_s: float
    optics: Optics
    seed: tuple[int, ...]

    def image(self, k: int) -> Grey:
        """Return image k; always the same."""
        return render_moving(
            self.pattern,
            self.camera,
            lambda t_s: self._poses(self.middle_s[k] + t_s),
            exposure_s=self.exposure_s,
            board=self.board,
            options=self.optics,
            wall=self.wall,
            covers=self.covers.at(self.middle_s[k]) if self.covers else (),
            rng=np.random.default_rng([*self.seed, k]),
        )

    def _poses(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_cam_target (n, 3, 3) and p_cam_target (n, 3) [m]."""
        R, p = self.path.pose(t_s)
        R_cam0_target = np.swapaxes(R, 1, 2)
        turn, arm = self.T_cam_cam0[:3, :3], self.T_cam_cam0[:3, 3]
        return turn @ R_cam0_target, arm - np.einsum("nij,nj->ni", turn @ R_cam0_target, p)

    def frames(self, name: str, t_ns: list[int], _notes: list[str]) -> Iterator[Frame]:
        for k, stamp in enumerate(t_ns):
            yield Frame(t_ns=stamp, where=f"simulated image {k} of {name}", decode=partial(self.image, k))


def simulated_images(simulation: CameraImuSimulation) -> ImageRecording:
    """Return a simulated recording whose cameras are images: those of `simulation.recording`, with the same stamps.

    A stamp is that of the middle of the exposure, of the top row with a rolling shutter. Errors that a detector makes
    (pixel_noise_px, outliers, shifted_frames) do not concern images; its own come in their place.

    Parameters
    ----------
    simulation : what was simulated; its scenario says how light, blur and noise are
    """
    scenario = simulation.scenario
    target = simulation.target
    pattern = board_pattern(target)
    true = scenario.target_scale * (target.points + simulation.truth_parameters["target.offsets"])
    cameras = simulation.truth.cameras
    streams: dict[str, ImageStream] = {}
    for number, (name, frames) in enumerate(simulation.recording.cameras.items()):
        exposures = _Exposures(
            pattern=pattern,
            board=TrueBoard.of(target, true),
            wall=cluttered_wall(simulation.seed) if scenario.image_clutter else None,
            covers=moving_covers(scenario.covers, (simulation.seed, number), scenario.resolution),
            camera=cameras[name].camera,
            path=simulation.trajectory.path,
            T_cam_cam0=cameras[name].T_cam_imu @ np.linalg.inv(cameras["cam0"].T_cam_imu),
            middle_s=simulation.frames[name].exposure_s,
            exposure_s=scenario.exposure_s,
            optics=usual_light(scenario),
            seed=(simulation.seed, number),
        )
        streams[name] = ImageStream(
            frames=partial(exposures.frames, name, frames.t_ns.tolist()),
            count=len(frames.t_ns),
            topic=frames.camera.topic,
            camera=frames.camera,
        )
    return ImageRecording(imus=simulation.recording.imus, streams=streams)
