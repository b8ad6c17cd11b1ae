"""Corners of several cameras, gathered by the instant at which they were seen."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers
from ..camera_imu.start.board_poses import gather_exposures
from ..camera_imu.terms.corner_sums import Exposures
from .rig import RigViews

_APART_NS = 5_000_000  # timestamps of one instant are not further apart, however slow the cameras


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
