"""The images of a simulated recording: each is rendered when it is asked for, at the true lens and the true path."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..images import Frame, Grey, ImageRecording, ImageStream
from ..models.board_pattern import Pattern, board_pattern
from ..models.camera import Camera
from ..models.target import Target
from ..recording import Floats
from .camera_imu import CameraImuSimulation
from .camera_imu_path import CameraPath
from .clutter import Wall, cluttered_wall
from .rendering import Optics, render

_STEP_PX = 0.75  # between the instants of an exposure
_MOST_INSTANTS = 16
_LIGHT = Optics(white=205.0, black=28.0, background=90.0, vignetting=0.25, gradient=(0.08, -0.05))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Exposures:
    """A camera on its path, and when it exposes.

    Attributes
    ----------
    pattern, wall : what it sees
    camera : the true lens
    path : of cam0
    T_cam_cam0 : (4, 4) of this camera
    middle_s : (n,) instants in the middle of the exposure of the top row [s]
    exposure_s : how long it takes
    optics : light, blur and noise
    seed : of the noise; each image has its own
    """

    pattern: Pattern
    wall: Wall | None
    camera: Camera
    path: CameraPath
    T_cam_cam0: Floats
    middle_s: Floats
    exposure_s: float
    optics: Optics
    seed: tuple[int, ...]

    def image(self, k: int) -> Grey:
        """Return image k; always the same."""
        count = self._instants(k)
        instants = self.middle_s[k] + self.exposure_s * ((np.arange(count) + 0.5) / count - 0.5)
        delay_s, height = self.camera.line_delay_s, self.camera.resolution[1]
        rows = delay_s * np.arange(height if delay_s else 1)
        R, p = self._poses((instants[:, None] + rows).ravel())
        return render(
            self.pattern,
            self.camera,
            R.reshape(count, len(rows), 3, 3),
            p.reshape(count, len(rows), 3),
            options=self.optics,
            wall=self.wall,
            rng=np.random.default_rng([*self.seed, k]),
        )

    def _instants(self, k: int) -> int:
        """Return at how many instants the board has to be drawn, so that it moves little between them."""
        R, p = self._poses(self.middle_s[k] + self.exposure_s * np.array([-0.5, 0.5]))
        x0, y0, x1, y1 = self.pattern.sheet
        corners = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0), ((x0 + x1) / 2, (y0 + y1) / 2, 0)])
        ends = [self.camera.project(corners @ R[i].T + p[i], point_jacobian=False).pixels for i in range(2)]
        moved = np.linalg.norm(ends[1] - ends[0], axis=1)
        longest = float(np.max(moved[np.isfinite(moved)], initial=0.0))
        return int(np.clip(np.ceil(longest / _STEP_PX), 1, _MOST_INSTANTS))

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
    pattern = board_pattern(_scaled(simulation.target, scenario.target_scale))
    cameras = simulation.truth.cameras
    streams: dict[str, ImageStream] = {}
    for number, (name, frames) in enumerate(simulation.recording.cameras.items()):
        exposures = _Exposures(
            pattern=pattern,
            wall=cluttered_wall(simulation.seed) if scenario.image_clutter else None,
            camera=cameras[name].camera,
            path=simulation.trajectory.path,
            T_cam_cam0=cameras[name].T_cam_imu @ np.linalg.inv(cameras["cam0"].T_cam_imu),
            middle_s=simulation.frames[name].exposure_s,
            exposure_s=scenario.exposure_s,
            optics=replace(_LIGHT, blur_px=scenario.blur_px, noise=scenario.image_noise),
            seed=(simulation.seed, number),
        )
        streams[name] = ImageStream(
            frames=partial(exposures.frames, name, frames.t_ns.tolist()),
            count=len(frames.t_ns),
            topic=frames.camera.topic,
            camera=frames.camera,
        )
    return ImageRecording(imus=simulation.recording.imus, streams=streams)


def _scaled(target: Target, scale: float) -> Target:
    """Return a board all of whose lengths are so many times as large."""
    lengths = ("tag_size_m", "row_spacing_m", "col_spacing_m", "spacing_m")
    return replace(target, **{name: scale * getattr(target, name) for name in lengths})
