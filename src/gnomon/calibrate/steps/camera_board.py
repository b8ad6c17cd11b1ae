"""What of the board is estimated jointly: nothing, its aspect, its bow, or the place of every corner, by evidence.

Aspect and bow are judged by what they bring to views that an estimate has not seen, the places of single corners by
residuals that stay with a corner from view to view (B16, as in a camera-IMU calibration).
"""

from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np

from ...errors import GnomonError
from ...estimate.camera_imu.result.misfits import along_board, common_pattern
from ...estimate.cameras.rig import RigSolution
from ...estimate.cameras.solution import solve_rig
from ...estimate.trust.clusters import CandidateBlock, CandidateStep, model_steps
from ...frozen import value_class
from ...options import CameraOptions
from ...recording import Floats, Integers
from ...results.trust import ModelStep
from .camera_lenses import IndependentViews, time_clusters

_ALONG = {"stated": (), "aspect": ("aspect",), "bow": ("aspect", "bow"), "corners": ("aspect", "bow", "corners")}
"""Option -> what is estimated whatever the views say."""

_CORNERS_CHANCE = 0.005
_CORNERS_SHARE = 0.03
"""Of the residuals' variance, below which a pattern of the corners moves nothing that anybody could see."""


@value_class
class BoardChoice:
    """A solution with what of the board is estimated.

    Attributes
    ----------
    solution : see there
    estimated : what of the board is in it, of "aspect", "bow" and "corners"
    added : the same where the views asked for it, not the options
    steps : what each brings
    failed : why the board could not be looked at, or ""
    """

    solution: RigSolution
    estimated: tuple[str, ...]
    added: tuple[str, ...]
    steps: tuple[ModelStep, ...]
    failed: str = ""


def with_board(solution: RigSolution, options: CameraOptions) -> BoardChoice:
    """Return the solution with what the options or the views say of the board.

    Parameters
    ----------
    solution : with the board as it was stated
    options : see there
    """

    def along(start: RigSolution, board: tuple[str, ...]) -> RigSolution:
        return solve_rig(
            start.views, start.rig, board=board, robust=options.robust, most_iterations=options.max_iterations
        )

    if options.board != "auto":
        stated = _ALONG[options.board]
        found = along(solution, stated) if stated else solution
        return BoardChoice(solution=found, estimated=stated, added=(), steps=())
    try:
        return _by_evidence(solution, along)
    except (GnomonError, np.linalg.LinAlgError) as error:  # a look at the board must not cost the cameras
        return BoardChoice(solution=solution, estimated=(), added=(), steps=(), failed=str(error))


def _by_evidence(solution: RigSolution, along: Callable[[RigSolution, tuple[str, ...]], RigSolution]) -> BoardChoice:
    """Return the solution with what the views prove of the board."""
    wider = along(solution, ("aspect", "bow"))
    steps = _shape_steps(wider)
    added = tuple(step.name for step in steps if step.used)
    if set(added) == {"aspect", "bow"}:
        found = wider
    else:
        found = along(wider if added else solution, added) if added else solution
    corners = _corner_step(found)
    if corners.used:
        added = (*added, "corners")
        found = along(found, added)
    return BoardChoice(solution=found, estimated=added, added=added, steps=(*steps, corners))


def _shape_steps(wider: RigSolution) -> tuple[ModelStep, ...]:
    """Return what aspect and bow bring, from a solution that has both."""
    sums = wider.sums.gathered(time_clusters(IndependentViews.of(wider)))
    values = {"aspect": np.array([wider.rig.board.aspect]), "bow": wider.rig.board.bow_m}
    of_block = {name: _columns(wider.names, f"target.{name}") for name in values}
    always = np.setdiff1d(np.arange(len(wider.names)), np.concatenate(list(of_block.values())))
    candidates = [CandidateBlock(name=name, columns=columns, away=-values[name]) for name, columns in of_block.items()]
    return tuple(_told(step) for step in model_steps(sums, always, candidates))


def _columns(names: Sequence[str], block: str) -> Integers:
    return np.array([k for k, name in enumerate(names) if name.partition("[")[0] == block], dtype=np.int64)


def _told(step: CandidateStep) -> ModelStep:
    return ModelStep(
        name=step.candidate.name,
        parameters=len(step.candidate.columns),
        gain=step.gain,
        gain_sigma=step.gain_sigma,
        needed=step.needed,
        used=step.used,
    )


def _corner_step(solution: RigSolution) -> ModelStep:
    """Return what the places of single corners would bring, by residuals that come back in other views.

    Taking a pattern of size s off residuals of size sigma makes their log-likelihood larger by half the sum of
    s^2 / sigma^2, before anything else is fitted anew; whether the pattern is there, clusters of views tell.
    """
    residual, point, view = _on_board(solution)
    pattern = common_pattern(residual, point, time_clusters(IndependentViews.of(solution))[view])
    gain, least = (len(point) * share / max(1 - share, 0.1) for share in (pattern.share, _CORNERS_SHARE))
    spread = abs(gain / pattern.z) if pattern.z else 0.0
    needed = max(spread * NormalDist().inv_cdf(1 - _CORNERS_CHANCE), least)
    return ModelStep(
        name="corners",
        parameters=3 * len(solution.views.target),
        gain=gain,
        gain_sigma=spread,
        needed=needed,
        used=gain > needed and pattern.chance < _CORNERS_CHANCE,
    )


def _on_board(solution: RigSolution) -> tuple[Floats, Integers, Integers]:
    """Return weighed residuals along the board's axes (m, 2), with point and view of each."""
    rig, points = solution.rig, solution.views.target.points
    found: list[tuple[Floats, Integers, Integers]] = []
    for T, (name, seen) in zip(rig.T_cam_cam0, solution.corners.items(), strict=True):
        R = T[:3, :3] @ rig.R_cam0_target[seen.view]
        at = np.einsum("mij,mj->mi", rig.R_cam0_target[seen.view], points[seen.point]) + rig.p_cam0_target[seen.view]
        image = rig.cameras[name].project(at @ T[:3, :3].T + T[:3, 3])
        assert image.by_point is not None
        counts = image.valid & np.isfinite(seen.residual[:, 0])
        weighed = seen.residual * np.sqrt(seen.weight)[:, None] / (solution.sigma_px[name] * seen.spread)[:, None]
        turned = along_board(image.by_point[counts] @ R[counts][:, :, :2], weighed[counts])
        found.append((turned, seen.point[counts], seen.view[counts]))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))  # pyright: ignore[reportReturnType]
