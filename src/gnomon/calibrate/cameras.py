"""Cameras that saw a board in view after view: lenses, their places to each other, and what the board is like.

check -> choose the lens models -> first rig -> choose views -> estimate -> board -> hold out -> assess -> Result
"""

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..assess.cameras.camera_synchronism import JointResiduals, check_synchronism
from ..assess.cameras.cameras_tables import CamerasFitSummary, LensOpinion, describe_cameras
from ..assess.cameras.cameras_verdict import assess_cameras
from ..assess.changes import with_changes
from ..assess.checks.board_views import without_copies
from ..assess.checks.rig_doctor import check_views
from ..assess.verdict import comparison_left_out, uncertainty_summary
from ..errors import DetectionError, GnomonError, RecordingError
from ..estimate.cameras.first_rig import held_out_residuals
from ..estimate.cameras.rig import RigViews, gathered_views
from ..estimate.cameras.solution import RigSolution, solve_rig
from ..estimate.trust.changes import estimates_are_judged
from ..findings import Finding
from ..models.target import Target
from ..options import CameraOptions
from ..progress import Progress
from ..recording import Recording
from ..results.calibration import UNSTATED_GRAVITY, Calibration, Covariance, Provenance, covariance_names
from ..results.result import Result
from .steps.camera_board import BoardChoice, with_board
from .steps.camera_lenses import IndependentViews, LensChoice, chosen_lenses, stated_models, time_clusters
from .steps.camera_views import (
    Unseen,
    cross_validate_views,
    first_rig_of_views,
    misfit_frames,
    other_size,
    rms_of,
    select_views,
    unused_residuals,
)
from .steps.cameras_published import check_baseline, publish_cameras
from .steps.preparation import assumption_finding, check_arguments, stated_options

_MOST_TO_SYNCHRONISE = 150
"""Views by which the cameras' clocks are compared."""

_ALIKE_PX = 0.05
"""Views whose corners lie closer to each other than this, root mean square, are the same image once more."""

_FEW = {"views-few"}


def calibrate_cameras(
    recording: Recording,
    target: Target,
    options: CameraOptions | None = None,
    progress: Progress | None = None,
) -> Result:
    """Calibrate one camera or several from views of a board, with no guess of anything.

    Parameters
    ----------
    recording : of cameras that saw the board; their lenses are not looked at
    target : the board
    options : see CameraOptions
    progress : called with a sentence at each step

    Raises
    ------
    RecordingError
        If the recording cannot be used; DetectionError where the board was seen too rarely.
    OptionError
        If an option does not fit the recording.
    InitialisationError
        If no lens explains the views, or cameras share none.
    SolveError
        If the estimation finds no minimum.
    """
    check_arguments("calibrate_cameras", recording, target)
    with threadpool_limits(1, user_api="blas"):  # many small products: more threads only get in each other's way
        return _calibrated(recording, target, options or CameraOptions(), progress or (lambda _: None))


def _calibrated(recording: Recording, target: Target, options: CameraOptions, tell: Progress) -> Result:
    tell("checking the recording")
    recording, copied = without_copies(recording, alike_px=_ALIKE_PX)
    noticed = (*copied, *_checked(recording, target))
    models = stated_models(options.model, tuple(recording.cameras))
    check_baseline(options, len(recording.cameras))
    every = gathered_views(recording.cameras, target)
    tell("choosing the lens model")
    lenses = (
        chosen_lenses(
            {name: select_views(every, name) for name in recording.cameras},
            models,
            among=options.among,
            robust=options.robust,
            most_iterations=options.max_iterations,
        )
        if estimates_are_judged()
        else [LensChoice(camera=name, lens=frames.camera) for name, frames in recording.cameras.items()]
    )
    tell("choosing views")
    start = first_rig_of_views(every, {lens.camera: lens.lens for lens in lenses}, options.views)
    tell("estimating")
    first = solve_rig(start.views, start.rig, robust=options.robust, most_iterations=options.max_iterations)
    # What a wrong lens cannot bend would go into the board.
    board = with_board(first, options if all(lens.fits for lens in lenses) else replace(options, board="stated"))
    solution = board.solution
    tell("testing it on views that it has not seen")
    independent = IndependentViews.of(solution)
    left_out, uncompared = _tested(board, independent)
    others = unused_residuals(start.every, solution)
    bad = misfit_frames(solution, others)
    mixed = other_size(start.every, solution, bad)
    if mixed is not None:
        raise RecordingError(str(mixed))
    tell("assessing the result")
    apart = _synchronism(start.every, solution)
    result = publish_cameras(solution, options, independent)
    evidence = CamerasFitSummary(
        recording=recording,
        target=target,
        options=options,
        every=start.every,
        start=start.rig,
        solution=solution,
        nats=start.nats,
        others=others,
        misfits=bad,
        cameras=result.cameras,
        names=result.names,
        covariance=result.covariance,
        scale=result.scale,
        rms_px=left_out.rms_used_px,
        unseen_px=left_out.rms_px,
        trials=tuple(trial for lens in lenses for trial in lens.trials),
        opinions=tuple(_opinion(lens) for lens in lenses if lens.better),
        added=board.added,
        trust=replace(result.trust, models=board.steps),
    )
    diagnostics = describe_cameras(evidence)
    assessment = assess_cameras((*apart, *noticed, *uncompared), evidence, diagnostics)
    note = uncertainty_summary(evidence.trust)
    calibration = Calibration(
        imus={},
        cameras=result.cameras,
        frame="cam0",
        gravity=UNSTATED_GRAVITY,
        uncertainty=Covariance(names=covariance_names({}, result.cameras), matrix=result.of_cameras),
        assessment=replace(assessment, trust=replace(note, added=board.added, tries=len(board.steps))),
        provenance=Provenance(method="cameras", inputs=recording.sources, options=stated_options(options)),
    )
    return Result(calibration=with_changes(calibration, evidence.trust), diagnostics=diagnostics)


def _tested(board: BoardChoice, views: IndependentViews) -> tuple[Unseen, list[Finding]]:
    """Return how well views that were left out are predicted, and what of such comparisons could not be made."""
    solution = board.solution
    uncompared = [comparison_left_out("another shape of the board", board.failed)] if board.failed else []
    if estimates_are_judged():
        try:
            return cross_validate_views(solution, time_clusters(views), board.estimated), uncompared
        except (GnomonError, np.linalg.LinAlgError) as error:
            uncompared.append(comparison_left_out("views that were left out", str(error)))
    used = {name: rms_of(seen) for name, seen in solution.corners.items()}
    return Unseen(rms_px=dict.fromkeys(used, float("nan")), rms_used_px=used), uncompared


def _synchronism(every: RigViews, solution: RigSolution) -> list[Finding]:
    """Return what residuals about common poses tell of the clocks of several cameras."""
    together = np.flatnonzero((every.frame >= 0).sum(axis=1) > 1)
    if len(every.cameras) < 2 or not len(together):
        return []
    chosen = together[:: max(len(together) // _MOST_TO_SYNCHRONISE, 1)]
    seen = held_out_residuals(every.where(chosen), solution.rig)
    residuals = {
        name: JointResiduals(view=one.view, frame=one.frame, point=one.point, residual=one.residual)
        for name, one in seen.items()
    }
    return check_synchronism(every.cameras, residuals, solution.sigma_px)


def _checked(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Return what there is to say of the views before anything is estimated."""
    found = (*recording.findings, *check_views(recording, target))
    for finding in found:
        if finding.severity == "problem":
            raise (DetectionError if finding.code in _FEW else RecordingError)(str(finding))
    return (*found, *map(assumption_finding, recording.assumptions))


def _opinion(lens: LensChoice) -> LensOpinion:
    return LensOpinion(
        camera=lens.camera, stated=lens.lens.model, better=lens.better, gain=lens.gain, gain_sigma=lens.gain_sigma
    )
