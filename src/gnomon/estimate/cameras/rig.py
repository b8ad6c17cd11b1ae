"""What is estimated from views of a board, and what it is estimated from.

    pixel = lens_c( T_cam_cam0 (R_cam0_target s(p) + p_cam0_target) ) + noise,    s(p): where point p truly is

Each view, an instant at which one camera or several saw the board, has a pose of its own; the lenses, the poses of the
cameras to the first one and the shape of the board are shared by all views.
"""

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans, Camera
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers
from ...results.camera_diagnostics import SolverStep
from ..camera_imu.start.board_poses import gather_exposures
from ..camera_imu.terms.visual_terms import CornerSums, Exposures
from ..trust.clusters import ClusterSums

_APART_NS = 5_000_000  # timestamps of one instant are not further apart, however slow the cameras


@value_class
class RigViews:
    """The corners of all cameras, gathered by the instant at which they were seen.

    Attributes
    ----------
    target : the board
    cameras : "cam0", ... -> its frames, all of them; the lens in them stands for resolution and topic alone
    t_ns : (v,) timestamp of each view [ns], ascending
    frame : (v, c) which frame of each camera it is; negative where the camera has none that can be used
    """

    target: Target
    cameras: Mapping[str, CameraFrames]
    t_ns: Integers
    frame: Integers

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, kept: np.ndarray) -> "RigViews":
        """Return some of the views, (v,) bool or indices in ascending order."""
        return RigViews(target=self.target, cameras=self.cameras, t_ns=self.t_ns[kept], frame=self.frame[kept])


@value_class
class BoardShape:
    """How the board differs from what was stated.

    Attributes
    ----------
    aspect : scale along y over that along x, minus 1
    bow_m : (2,) how far the middle bulges towards the viewer against the ends of the board's middle line along x, and
        along y [m]
    offsets : (k, 3) from the nominal place of each point to where it is, beside aspect and bow [m]
    """

    aspect: float
    bow_m: Floats
    offsets: Floats


@value_class
class CameraRig:
    """Everything that the views depend on.

    Attributes
    ----------
    cameras : "cam0", ... -> lens
    T_cam_cam0 : (c, 4, 4) from cam0's coordinates to each camera's [m]; that of cam0 is I
    R_cam0_target, p_cam0_target : (v, 3, 3) and (v, 3) pose of the board in cam0's frame in each view [m]
    board : its shape
    """

    cameras: Mapping[str, Camera]
    T_cam_cam0: Floats
    R_cam0_target: Floats
    p_cam0_target: Floats
    board: BoardShape


@value_class
class SeenCorners:
    """The corners of one camera at a rig.

    Attributes
    ----------
    view : (m,) view of each corner
    frame, point : (m,) its frame in the recording, and its number on the board
    pixels : (m, 2) as detected [px]
    residual : (m, 2) predicted minus detected [px]; nan where the lens has no image of it
    weight : (m,) robust weight, 0 to 1
    spread : (m,) standard deviation of each corner over that of a usual one
    """

    view: Integers
    frame: Integers
    point: Integers
    pixels: Floats
    residual: Floats
    weight: Floats
    spread: Floats


@value_class
class RigSolution:
    """The minimum, and how certain it is.

    Attributes
    ----------
    views : what it was estimated from
    rig : the estimate
    names : (p,) shared scalars that were estimated, the poses of the views apart: "cam0.intrinsics[0]",
        "cam0.distortion_coeffs[0]", "cam1.T_cam_cam0.rotation[0]" (small rotation on the right), "cam1.T_cam_cam0.
        translation[0]", "target.aspect", "target.bow[0]", "target.offsets[0,0]"
    sums : pull and information of each view at the estimate, its pose eliminated: by them follow the covariance that
        holds where the errors of a view are correlated, halves, and smaller models
    ordinary : (p, p) covariance for independent errors
    corners : "cam0", ... -> residuals
    sigma_px : "cam0", ... -> standard deviation of a corner per axis, from the residuals
    steps : iterations
    converged : whether they came to rest
    """

    views: RigViews
    rig: CameraRig
    names: tuple[str, ...]
    sums: ClusterSums
    ordinary: Floats
    corners: Mapping[str, SeenCorners]
    sigma_px: Mapping[str, float]
    steps: tuple[SolverStep, ...] = field(default=())
    converged: bool = True


@value_class
class CameraCorners:
    """The corners of one camera that take part.

    Attributes
    ----------
    name : "cam0", ...
    camera : its number in `RigViews.frame`
    exposures : one a frame, in the order of views
    view : (e,) view of each exposure
    own_sigma_px : (m,) standard deviation of each corner as its detector knows it [px], or None
    """

    name: str
    camera: int
    exposures: Exposures
    view: Integers
    own_sigma_px: Floats | None

    def __len__(self) -> int:
        return len(self.view)

    @property
    def point(self) -> Integers:
        """Number of each corner on the target, (m,)."""
        assert self.exposures.point is not None
        return self.exposures.point

    @property
    def of_corner(self) -> Integers:
        """View of each corner, (m,)."""
        return self.view[self.exposures.of_corner]

    def with_residuals(self, sums: CornerSums, spread: Floats | float) -> SeenCorners:
        """Return the corners (m,) with their residuals of some sums, and their `spread`, (m,) or one for all."""
        return SeenCorners(
            view=self.of_corner,
            frame=self.exposures.frame[self.exposures.of_corner],
            point=self.point,
            pixels=self.exposures.pixels,
            residual=sums.residual,
            weight=sums.weight,
            spread=np.broadcast_to(spread, len(self.point)),
        )

    def only(self, chosen: Booleans) -> "CameraCorners":
        """Return the corners of some exposures, (e,)."""
        kept = chosen[self.exposures.of_corner]
        old, lengths = self.exposures, np.diff(self.exposures.start)[chosen]
        return replace(
            self,
            view=self.view[chosen],
            own_sigma_px=None if self.own_sigma_px is None else self.own_sigma_px[kept],
            exposures=Exposures(
                frame=old.frame[chosen],
                start=np.concatenate([[0], np.cumsum(lengths)]),
                points=old.points[kept],
                pixels=old.pixels[kept],
                delay_rows=old.delay_rows[chosen],
                spread=None if old.spread is None else old.spread[kept],
                point=self.point[kept],
            ),
        )


def gathered_views(cameras: Mapping[str, CameraFrames], target: Target) -> RigViews:
    """Return the frames with enough corners, those of one instant gathered in a view.

    Timestamps of one instant are equal, or the nearest to each other, not further apart than half the time between
    frames and a few milliseconds.

    Parameters
    ----------
    cameras : "cam0", ... -> its frames
    target : the board
    """
    t_ns, frame = np.empty(0, np.int64), np.empty((0, len(cameras)), np.int64)
    for number, frames in enumerate(cameras.values()):
        usable = gather_exposures(frames, target).frame
        t_ns, frame = _with_camera(t_ns, frame, number, frames.t_ns, usable)
    return RigViews(target=target, cameras=dict(cameras), t_ns=t_ns, frame=frame)


def _with_camera(
    t_ns: Integers, frame: Integers, number: int, stamps: Integers, usable: Integers
) -> tuple[Integers, Integers]:
    """Return views and their frames with those of one more camera, in the order of time."""
    own = stamps[usable]
    place = np.full(len(own), -1)
    if len(t_ns) and len(own):
        nearest = _nearest(t_ns, own)
        mutual = _nearest(own, t_ns)[nearest] == np.arange(len(own))
        apart = np.abs(t_ns[nearest] - own)
        place = np.where(mutual & (2 * apart <= min(_step(stamps), 2 * _APART_NS)), nearest, -1)
    grown = np.full((len(t_ns) + int(np.sum(place < 0)), frame.shape[1]), -1)
    grown[: len(t_ns)] = frame
    times = np.concatenate([t_ns, own[place < 0]])
    place[place < 0] = np.arange(len(t_ns), len(times))
    grown[place, number] = usable
    order = np.argsort(times, kind="stable")
    return times[order], grown[order]


def _nearest(sorted_ns: Integers, wanted: Integers) -> Integers:
    """Return the index of the nearest of sorted timestamps."""
    after = np.clip(np.searchsorted(sorted_ns, wanted), 1, max(len(sorted_ns) - 1, 1))
    after = np.minimum(after, len(sorted_ns) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - sorted_ns[before] <= sorted_ns[after] - wanted, before, after)


def _step(stamps: Integers) -> float:
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else float(2 * _APART_NS)


def camera_corners(views: RigViews) -> tuple[CameraCorners, ...]:
    """Return the corners that the views hold, camera by camera."""
    return tuple(view_corners(views, number) for number in range(len(views.cameras)))


def view_corners(views: RigViews, number: int) -> CameraCorners:
    """Return the corners that the views hold of one camera."""
    name = tuple(views.cameras)[number]
    frames = views.cameras[name]
    view = np.flatnonzero(views.frame[:, number] >= 0)
    frame = views.frame[view, number]
    first = np.searchsorted(frames.frame, frame, side="left")
    lengths = np.searchsorted(frames.frame, frame, side="right") - first
    start = np.concatenate([[0], np.cumsum(lengths)])
    chosen = np.arange(start[-1]) + np.repeat(first - start[:-1], lengths)
    point = frames.point[chosen]
    return CameraCorners(
        name=name,
        camera=number,
        exposures=Exposures(
            frame=frame,
            start=start,
            points=views.target.points[point],
            pixels=frames.pixels[chosen],
            delay_rows=np.zeros(len(frame)),
            point=point,
        ),
        view=view,
        own_sigma_px=None if frames.sigma_px is None else frames.sigma_px[chosen],
    )


def renumber_camera(views: RigViews, number: int, way: Integers, numberings: Integers) -> RigViews:
    """Return the views with the points of one camera's frames counted in another way.

    Parameters
    ----------
    views : to be changed
    number : of the camera
    way : (v,) which numbering each view's frame gets
    numberings : (k, n) the number of each of the board's points in each way of counting
    """
    name = tuple(views.cameras)[number]
    frames = views.cameras[name]
    of_frame = np.zeros(len(frames.t_ns), np.int64)
    seen = views.frame[:, number] >= 0
    of_frame[views.frame[seen, number]] = way[seen]
    point = numberings[of_frame[frames.frame], frames.point]
    order = np.lexsort((point, frames.frame))
    changed = replace(
        frames,
        point=point[order],
        pixels=frames.pixels[order],
        sigma_px=None if frames.sigma_px is None else frames.sigma_px[order],
    )
    return replace(views, cameras={**views.cameras, name: changed})


_MOVED = 0.1  # of the image's width
_PAUSE_NS = 2_000_000_000


def views_alike(views: RigViews) -> Integers:
    """Return the number of the cluster of each view, (v,), ascending: consecutive views that look alike.

    Their corners err alike, and they count as one where the covariance is taken from the scatter: a detector's error
    depends on where in the image a corner is, how large and how tilted the board is and how it moves. Consecutive
    frames of a video share all of that until the board has moved on. A new cluster begins where the board's points have
    moved by a tenth of the image's width since its first view, in some camera, or where two seconds passed without a
    view.
    """
    places = [_places(views, number) for number in range(len(views.cameras))]
    widths = [frames.camera.resolution[0] for frames in views.cameras.values()]
    cluster, first = np.zeros(len(views), np.int64), 0
    for k in range(1, len(views)):
        moved = [_moved(place[first], place[k]) / width for place, width in zip(places, widths, strict=True)]
        on = not any(np.isfinite(moved)) or np.nanmax(moved) > _MOVED or views.t_ns[k] - views.t_ns[k - 1] > _PAUSE_NS
        cluster[k] = cluster[k - 1] + on
        first = k if on else first
    return cluster


def _places(views: RigViews, number: int) -> Floats:
    """Return where each view of a camera has each point of the board, (v, n, 2) [px]; nan where it has not."""
    frames = tuple(views.cameras.values())[number]
    seen = np.flatnonzero(views.frame[:, number] >= 0)
    of_frame = np.full(len(frames.t_ns), -1)
    of_frame[views.frame[seen, number]] = seen
    view = of_frame[frames.frame]
    found = np.full((len(views), len(views.target), 2), np.nan)
    found[view[view >= 0], frames.point[view >= 0]] = frames.pixels[view >= 0]
    return found


def _moved(before: Floats, after: Floats) -> float:
    """Return the median distance of the points that both hold; nan where these are none."""
    both = np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])
    return float(np.median(np.linalg.norm(after[both] - before[both], axis=1))) if both.any() else float("nan")
