"""Which views a calibration of cameras rests on, and where it starts from."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...detect.boards.board import BoardView
from ...detect.boards.checkerboard_order import ambiguous_turns, renumber_view
from ...estimate.cameras.first_rig import at_poses, first_rig, held_out_residuals, merge_corners, number_views_alike
from ...estimate.cameras.layout import POSE, SharedLayout
from ...estimate.cameras.problem import chosen_views
from ...estimate.cameras.rig import CameraRig, RigSolution, RigViews, SeenCorners, gathered_views
from ...estimate.trust.clusters import leave_clusters_out
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.camera import Camera
from ...models.target import Target
from ...recording import Floats, Integers

_FOLDS = 5
_MOST_TO_CHOOSE_BY = 40  # views by which the lens model is chosen
_BAD = 4.0
"""Median distance of the corners of a frame over the usual one, from which on it fits badly as a whole."""

_SIZES = (1 / 2, 2 / 3, 3 / 4, 1 / 3, 1 / 4, 2.0, 3 / 2, 4 / 3)
_FITS = 1.5
"""The same, up to which it fits at another size."""

_FEWEST_OF_A_SIZE, _SHARE_OF_A_SIZE = 2, 0.02
"""Frames, and their share of all; fewer are blurred ones that any size fits by chance."""


@value_class
class Start:
    """Where the estimation of all cameras starts from.

    Attributes
    ----------
    every : all views that show enough of the board, their corners numbered alike
    posed : a rig with the poses of all of them
    used : (u,) which of the views are used, ascending
    nats : (u,) what each told of the lenses when it was chosen
    """

    every: RigViews
    posed: CameraRig
    used: Integers
    nats: Floats

    @property
    def views(self) -> RigViews:
        """The views that are used."""
        return self.every.where(self.used)

    @property
    def rig(self) -> CameraRig:
        """The rig of the views that are used."""
        return _of(self.posed, self.used)


def select_views(views: RigViews, name: str) -> RigViews:
    """Return views of one camera alone by which its lens model is chosen, evenly spread over time."""
    own = gathered_views({name: views.cameras[name]}, views.target)
    return own.where(
        np.unique(np.linspace(0, len(own) - 1, min(len(own), _MOST_TO_CHOOSE_BY)).round().astype(np.int64))
    )


def first_rig_of_views(views: RigViews, lenses: Mapping[str, Camera], most: int | None) -> Start:
    """Return a first rig with lenses that are known about, and the most informative views for them.

    Parameters
    ----------
    views : all of them
    lenses : "cam0", ... -> lens, about right
    most : number of views; until further ones add next to nothing where it is None

    Raises
    ------
    InitialisationError
        If cameras share too few views.
    SolveError
        If the lenses do not suit the views at all.
    """
    views = number_views_alike(views, lenses, _numberings(views.target))
    rig = first_rig(views, {}, lenses)
    chosen = chosen_views(views, rig, most)
    return Start(every=views, posed=rig, used=chosen.index, nats=chosen.nats)


def _numberings(target: Target) -> Integers:
    """Return the ways (k, n) in which the points of a board can be counted that looks the same from several ends."""
    count = np.arange(len(target))
    whole = BoardView(
        point=count, pixels=np.column_stack([count, count]).astype(np.float64), sigma_px=np.ones(len(count))
    )
    return np.array([np.argsort(renumber_view(whole, target, turns).pixels[:, 0]) for turns in ambiguous_turns(target)])


def _of(rig: CameraRig, index: Integers) -> CameraRig:
    """Return the rig of some of its views."""
    return replace(rig, R_cam0_target=rig.R_cam0_target[index], p_cam0_target=rig.p_cam0_target[index])


def kept_views(solution: RigSolution) -> RigViews:
    """Return the views of a solution without the frames that it left out as misfits."""
    views = solution.views
    frame = np.full_like(views.frame, -1)
    for number, seen in enumerate(solution.corners.values()):
        inside = np.unique(seen.view)
        frame[inside, number] = views.frame[inside, number]
    return replace(views, frame=frame)


def unused_residuals(start: Start, solution: RigSolution) -> dict[str, SeenCorners]:
    """Return the residuals of what a solution did not use, each view with the pose that suits it best.

    Parameters
    ----------
    start : all views, and their poses in the first rig
    solution : of some of them
    """
    every, frame = start.every, start.every.frame.copy()
    for number, seen in enumerate(solution.corners.values()):
        frame[np.isin(frame[:, number], seen.frame), number] = -1
    rest = np.flatnonzero((frame >= 0).any(axis=1))
    return held_out_residuals(replace(every, frame=frame).where(rest), solution.rig, _of(start.posed, rest))


def misfit_frames(solution: RigSolution, others: Mapping[str, SeenCorners]) -> dict[str, Integers]:
    """Return the frames of each camera that fit badly as a whole, chosen or not.

    Parameters
    ----------
    solution : estimate
    others : residuals of what it did not use, see `unused_residuals`
    """
    found: dict[str, Integers] = {}
    for name, seen in solution.corners.items():
        frame, middle = _middles(others[name])
        found[name] = frame[~(middle < _BAD * max(_usual(seen), 1e-9))]
    return found


def other_size(every: RigViews, solution: RigSolution, bad: Mapping[str, Integers]) -> Finding | None:
    """Say that images of one camera have two sizes, where frames that fit badly would fit at another size.

    Parameters
    ----------
    every : all views
    solution : estimate
    bad : frames of each camera that fit badly
    """
    for number, (name, frames) in enumerate(every.cameras.items()):
        kept = np.isin(every.frame[:, number], bad[name])
        fewest = max(_FEWEST_OF_A_SIZE, _SHARE_OF_A_SIZE * len(frames.t_ns), kept.sum() / 2)
        if kept.sum() < fewest:
            continue
        frame = np.full_like(every.frame, -1)
        frame[kept, number] = every.frame[kept, number]
        alone = replace(every, frame=frame).where(np.flatnonzero(kept))
        width, height = frames.camera.resolution
        for factor in _SIZES:
            pixels = (frames.pixels + 0.5) / factor - 0.5
            scaled = replace(alone, cameras={**alone.cameras, name: replace(frames, pixels=pixels)})
            _, middle = _middles(held_out_residuals(scaled, solution.rig)[name])
            count = int(np.sum(middle < _FITS * _usual(solution.corners[name])))
            if count >= fewest:
                return make_finding(
                    "image-sizes-mixed",
                    name=name,
                    differing=count,
                    frames=len(frames.t_ns),
                    width_px=factor * width,
                    height_px=factor * height,
                    width=width,
                    height=height,
                    image=int(bad[name][0]),
                )
    return None


def _usual(seen: SeenCorners) -> float:
    distance = np.linalg.norm(seen.residual, axis=1)
    return float(np.median(distance[np.isfinite(distance)]))


def _middles(seen: SeenCorners) -> tuple[Integers, Floats]:
    """Return frames, and the median distance of the corners in each [px]; infinite where the lens images too few."""
    frame, which = np.unique(seen.frame, return_inverse=True)
    distance = np.linalg.norm(seen.residual, axis=1)
    distance[~np.isfinite(distance)] = np.inf
    order = np.lexsort((distance, which))
    count = np.bincount(which, minlength=len(frame))
    return frame, distance[order][np.cumsum(count) - count + count // 2] if len(frame) else np.empty(0)


@value_class
class Unseen:
    """How well lenses, places and board predict views that were left out, each with a pose of its own.

    Attributes
    ----------
    rms_px, rms_used_px : "cam0" -> rms of the corners of hold-out views, and of those used, per axis [px]
    """

    rms_px: Mapping[str, float]
    rms_used_px: Mapping[str, float]


def cross_validate_views(solution: RigSolution, cluster: Integers, board: tuple[str, ...]) -> Unseen:
    """Leave out every fifth cluster of views in turn, and look at those left out as the others foresee them.

    What the others say alone follows from the sums of the views, without estimating anew.

    Parameters
    ----------
    solution : of the views, misfits left out already
    cluster : (v,) number of the cluster of each view
    board : what of its shape is estimated
    """
    views, rig, parts = kept_views(solution), solution.rig, []
    fold = cluster % min(_FOLDS, int(cluster[-1]) + 1)
    every = {name: np.arange(len(camera.parameters)) for name, camera in rig.cameras.items()}
    layout = SharedLayout.of(rig.cameras, every, board, len(views.target))
    estimated = np.flatnonzero(np.isin(layout.names(rig.cameras), solution.names))
    for number, move in enumerate(leave_clusters_out(solution.sums.gathered(fold))):
        out = np.flatnonzero(fold == number)
        step = np.zeros(layout.size)
        step[estimated] = move
        without = layout.moved(_of(rig, out), np.zeros((len(out), POSE)), step)
        parts.append(at_poses(views.where(out), without))
    return Unseen(
        rms_px={name: rms_of(merge_corners([part[name] for part in parts])) for name in solution.corners},
        rms_used_px={name: rms_of(seen) for name, seen in solution.corners.items()},
    )


def rms_of(seen: SeenCorners) -> float:
    """Return the rms of corners per axis, of all that the lens can image [px]; nan where there are none."""
    residual = seen.residual[np.isfinite(seen.residual[:, 0])]
    return float(np.sqrt(np.mean(residual**2))) if len(residual) else float("nan")
