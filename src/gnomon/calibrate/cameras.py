"""Cameras that saw a board in view after view: lenses, their places to each other, and what the board is like.

check -> choose the lens models -> first rig -> choose views -> estimate -> board -> hold out -> assess -> Result
"""

from collections.abc import Mapping
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
from ..errors import DetectionError, GnomonError, OptionError, RecordingError
from ..estimate.cameras.first_rig import held_out_residuals
from ..estimate.cameras.rig import RigViews, gathered_views
from ..estimate.cameras.solution import RigSolution, solve_rig
from ..estimate.trust.changes import estimates_are_judged
from ..estimate.trust.parts import robust_covariance
from ..findings import Finding
from ..frozen import value_class
from ..models.target import Target
from ..options import CameraOptions
from ..progress import Progress
from ..recording import Floats, Recording
from ..results.calibration import (
    UNSTATED_GRAVITY,
    Calibration,
    CameraCalibration,
    Covariance,
    Provenance,
    covariance_names,
)
from ..results.result import Result
from ..results.trust import Trust
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
    others = unused_residuals(start, solution)
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


SCALE = "target.scale"
"""Name of the true size of the board over the stated one."""


_BOARD = ("target.aspect", "target.bow")


@value_class
class PublishedCameras:
    """Cameras with the covariance of their scalars, and of what is known of the board after them.

    Attributes
    ----------
    cameras : "cam0", ... -> camera, in frame "cam0"
    names : (n,) scalars of the cameras as `covariance_names` has them; then "target.aspect" and "target.bow[0]", ...
        where they were estimated, and "target.scale" where a baseline tells it
    covariance : (n, n); zero rows where a scalar was held
    scale : true over stated size of the board; 1 where no baseline tells it
    trust : what the views tell of the uncertainty of the cameras
    """

    cameras: Mapping[str, CameraCalibration]
    names: tuple[str, ...]
    covariance: Floats
    scale: float
    trust: Trust

    @property
    def of_cameras(self) -> Floats:
        """Covariance of the scalars of the cameras alone."""
        count = len(covariance_names({}, self.cameras))
        return self.covariance[:count, :count]

    def sigma(self, name: str) -> float:
        """Return the standard deviation of a scalar; nan where it is not among the names."""
        if name not in self.names:
            return float("nan")
        at = self.names.index(name)
        return float(np.sqrt(max(self.covariance[at, at], 0.0)))


def check_baseline(options: CameraOptions, cameras: int) -> None:
    """Refuse a baseline that is none.

    Raises
    ------
    OptionError
        If a baseline was stated for a single camera.
    """
    if options.baseline is not None and cameras < 2:
        raise OptionError("baseline: it is the distance of cam1 from cam0, and this recording is of one camera.")


def publish_cameras(solution: RigSolution, options: CameraOptions, views: IndependentViews) -> PublishedCameras:
    """Return what the estimate says, in frame "cam0"."""
    rig, known = solution.rig, options.baseline is not None
    length = float(np.linalg.norm(rig.T_cam_cam0[1, :3, 3])) if known else 1.0
    scale = options.baseline / length if options.baseline is not None else 1.0
    cameras: dict[str, CameraCalibration] = {}
    for T, (name, camera) in zip(rig.T_cam_cam0, rig.cameras.items(), strict=True):
        placed = T.copy()
        placed[:3, 3] *= scale
        cameras[name] = CameraCalibration(T_cam_body=placed, time_shift_cam_imu=0.0, camera=camera, body="cam0")
    board = tuple(name for name in solution.names if name.partition("[")[0] in _BOARD)
    names = (*covariance_names({}, cameras), *board, *((SCALE,) if known else ()))
    jacobian, metric = _by_estimate(names, solution), _metric(names, solution)
    if known:
        by_length = (
            -scale / length**2 * rig.T_cam_cam0[1, :3, 3] @ _by_estimate(_translation(list(cameras)[1]), solution)
        )
        jacobian = np.where(metric != 0, scale, 1.0)[:, None] * jacobian + np.outer(metric, by_length)
    ordinary = jacobian @ solution.ordinary @ jacobian.T
    if known:
        by_baseline = options.baseline_sigma * metric / length
        ordinary += np.outer(by_baseline, by_baseline)
    found = robust_covariance(
        views.sums,
        jacobian,
        names,
        ordinary,
        biases=(),
        widened=options.covariance == "robust",
        single=solution.sums,
        order=solution.views.frame.max(axis=1),
        moves=views.moves,
    )
    return PublishedCameras(
        cameras=cameras,
        names=names,
        covariance=0.5 * (found.covariance + found.covariance.T),
        scale=scale,
        trust=_of_cameras(found.trust),
    )


def _translation(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.T_cam_cam0.translation[{k}]" for k in range(3))


def _by_estimate(names: tuple[str, ...], solution: RigSolution) -> Floats:
    """Return the derivative (n, p) of scalars by those of the estimate, before any scale."""
    column = {name: k for k, name in enumerate(solution.names)}
    jacobian = np.zeros((len(names), len(column)))
    for row, name in enumerate(names):
        if name in column:
            jacobian[row, column[name]] = 1.0
    return jacobian


def _metric(names: tuple[str, ...], solution: RigSolution) -> Floats:
    """Return the estimates (n,) of the scalars that grow with the size of the board; of this size itself 1."""
    rig = solution.rig
    values = {SCALE: 1.0} | {f"target.bow[{k}]": float(bow) for k, bow in enumerate(rig.board.bow_m)}
    for T, name in zip(rig.T_cam_cam0, rig.cameras, strict=True):
        values |= dict(zip(_translation(name), T[:3, 3].tolist(), strict=True))
    return np.array([values.get(name, 0.0) for name in names])


def _of_cameras(trust: Trust) -> Trust:
    """Return the trust in the cameras alone."""
    inside = np.array([not name.startswith("target.") for name in trust.names], dtype=bool)
    return replace(
        trust,
        names=tuple(np.array(trust.names, dtype=object)[inside]),
        ordinary_sigma=trust.ordinary_sigma[inside],
        sigma=trust.sigma[inside],
        ratios=tuple(one for one in trust.ratios if not one.block.startswith("target.")),
        changes=tuple(one for one in trust.changes if not one.block.startswith("target.")),
    )
