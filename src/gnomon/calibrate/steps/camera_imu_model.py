"""Which model a recording asks for: that of the options, and what else it proves to be there (B16).

The model of the IMU, with lever arms of its accelerometers, is estimated first, and beside it is seen what delays of
the accelerometers, errors of the lens and, where corners stay off in the same way from frame to frame, of the board
would do. What predicts clusters of time that were left out better, by more than chance, joins the model; what does not
prove itself in the larger model is taken out again. Lever arms are no such choice: which point T_cam_imu is of must not
hang on the evidence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cache
from statistics import NormalDist

import numpy as np

from ...errors import SolveError
from ...estimate.camera_imu.batch import Measurements, NoiseLevels, RigState, linearize_batch
from ...estimate.camera_imu.choices import (
    ARMS,
    DELAY,
    EXPOSURE,
    EXTRAS,
    LADDER,
    estimation_choices,
    evaluate_nested_models,
    imu_blocks,
    lens_tolerances,
    step_columns,
)
from ...estimate.camera_imu.gauss_newton import apply_step, gauss_newton_step, step_by
from ...estimate.camera_imu.layout import BorderLayout, border_layout
from ...estimate.camera_imu.parameters import OFFSETS, RigParameters
from ...estimate.camera_imu.result.misfits import board_evidence, counting_corners
from ...estimate.camera_imu.result.uncertainty import cluster_sums
from ...estimate.camera_imu.solution import Solution, judged_after, minimise_cost
from ...estimate.camera_imu.start.first_guess import CameraAlignment
from ...estimate.camera_imu.terms.inertial_terms import on_trajectory
from ...estimate.trust.changes import postpone_search
from ...estimate.trust.clusters import ClusterSums, correlation_time, group_into_clusters, leave_clusters_out
from ...findings import Finding
from ...frozen import value_class
from ...models.target import Target
from ...options import CameraImuOptions
from ...progress import Progress, Step
from ...recording import Recording
from ...results.calibration import CameraCalibration, Covariance
from ...results.trust import ModelStep
from ...solve.bordered_band import Workspace

_CODE, _SHUTTER_SIGMAS = "rolling-shutter", 4.0
LINE_DELAY = "line delay"
"""What is added to the model."""


def with_stated_shutters(recording: Recording, options: CameraImuOptions) -> Recording:
    """Return the recording, its cameras with the line delay that the options state."""
    delay_s = options.line_delay
    if delay_s is None:
        return recording
    cameras = {
        name: replace(frames, camera=replace(frames.camera, line_delay_s=delay_s))
        for name, frames in recording.cameras.items()
    }
    return replace(recording, cameras=cameras)


def with_free_landmarks(options: CameraImuOptions, target: Target) -> CameraImuOptions:
    """Return options that estimate where landmarks of a scene are, and how large it is, where there is no board."""
    if target.kind != "landmarks":
        return options
    return replace(options, free=(*options.free, OFFSETS, "target.scale"))


def with_line_delays(
    options: CameraImuOptions, found: Sequence[CameraAlignment], findings: Sequence[Finding]
) -> tuple[CameraImuOptions, bool]:
    """Return options that estimate the line delays that the corners prove, and whether there is one that they added.

    Model "auto" adds those of cameras of which nobody said anything.
    """
    if options.model != "auto" or options.line_delay is not None:
        return options, False
    decided = {text.partition("=")[0] for text in (*options.fix, *options.free, *options.prior)}
    added = [
        f"{look.name}.line_delay"
        for look in found
        if _about(look.name, findings) and not look.frames.camera.line_delay_s
    ]
    added = [name for name in added if name not in decided]
    return replace(options, free=(*options.free, *added)), bool(added)


def proven_lens(options: CameraImuOptions, findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the blocks of the lens where single frames prove it so far off that a model without them tells nothing.

    Model "auto" adds them, as long as the options say nothing of a lens.
    """
    blocks = ("intrinsics", "distortion_coeffs")
    decided = any(block in text for text in (*options.fix, *options.free, *options.prior) for block in blocks)
    far = any(finding.code == "distortion" and finding.severity == "problem" for finding in findings)
    return blocks if options.model == "auto" and far and not decided else ()


def shutters_estimated(
    findings: Sequence[Finding], cameras: Mapping[str, CameraCalibration], uncertainty: Covariance
) -> tuple[Finding, ...]:
    """Return the findings, those on shutters whose line delay was estimated with what came of it."""
    sigmas = dict(zip(uncertainty.names, np.sqrt(np.diag(uncertainty.matrix)).tolist(), strict=True))
    return tuple(_told(finding, cameras, sigmas) if finding.code == _CODE else finding for finding in findings)


def _told(finding: Finding, cameras: Mapping[str, CameraCalibration], sigmas: Mapping[str, float]) -> Finding:
    name = finding.subject.partition(".")[0]
    sigma = sigmas.get(finding.subject, 0.0)
    if not sigma:
        return finding
    delay = cameras[name].camera.line_delay_s
    there = abs(delay) > _SHUTTER_SIGMAS * sigma
    return replace(
        finding,
        severity="info",
        consequence=f"The line delay was estimated jointly: {1e6 * delay:.4g} +- {1e6 * sigma:.2g} us"
        f"{'' if there else ', none; what looked like one is explained by the rest of the model'}.",
        cure=f"State it next time, --line-delay {delay:.4g}." if there else "",
    )


def _about(name: str, findings: Sequence[Finding]) -> bool:
    return any(finding.code == _CODE and finding.subject == f"{name}.line_delay" for finding in findings)


_ROUNDS = 3
"""Larger models that are estimated: what is in one may show, or refute, another block."""

_BOARD = "board"
_BLOCKS = {name: LADDER[name] for name in EXTRAS} | {"k3": ("distortion_coeffs",), _BOARD: ("offsets",)}
_BOARD_CHANCE = 0.01 / (len(EXTRAS) + 1)
_BOARD_SHARE, _LENS_SHARE = 0.02, 0.005
"""Of the corners' variance, which board and lens must explain: less may be the detector's bias that looks the same.
Where it is gnomon's own, whose bias is none, a lens need only be certain."""

_LENS: tuple[str, ...] = ("intrinsics", "k3")
_HIDING, _PROMISING = (DELAY, EXPOSURE), 4.0
"""Standard deviations of its gain, from which on a step is tried in the larger model: what is left out of a model lasts
and makes clusters of time long and few, by which nothing can be proved."""


@value_class
class SelectedModel:
    """A solution with the model that was chosen.

    Attributes
    ----------
    solution : see there
    sums : of its stretches of time
    steps : what each block brings
    added : steps beyond the model of the options that are in it
    tries : blocks on which the recording decided
    board_told : whether it was long enough to tell whether corners of the board lie off their places
    failed : steps that proved themselves, but without which the estimation had to do, with the reason
    """

    solution: Solution
    sums: ClusterSums
    steps: tuple[ModelStep, ...]
    added: tuple[str, ...] = ()
    tries: int = 0
    board_told: bool = True
    failed: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def arms_told(self) -> bool:
        """Whether the recording proves the lever arms that are in the model."""
        return any(step.name == ARMS and step.used and step.gain > step.needed for step in self.steps)


def candidate_blocks(start: RigParameters) -> tuple[str, ...]:
    """Return the blocks beyond the model of which the last linearisations tell what they would do."""
    arms = [f"imu{i}.lever_arms" for i in range(len(start.imus))]
    delays = [f"imu{i}.accelerometer_shift" for i, imu in enumerate(start.imus) if not imu.apart]
    lenses = [
        f"{entry.name}.{block}"
        for entry in start.cameras
        for block in LADDER["intrinsics"]
        if block == "intrinsics" or len(entry.camera.distortion_coeffs)
    ]
    exposures = [f"{entry.name}.exposure_squared" for entry in start.cameras]
    return ("gravity.magnitude", "target.scale", *lenses, *imu_blocks(start), *arms, *delays, *exposures)


def select_model(
    solution: Solution,
    options: CameraImuOptions,
    tell: Progress,
    *,
    lens: Sequence[str] = (),
    own_detector: bool = True,
) -> SelectedModel:
    """Return the solution with the blocks that the recording asks for.

    Parameters
    ----------
    solution : with the model of the options, and the columns of `candidate_blocks`
    options : model "auto" adds blocks by evidence; the others are estimated as they are
    tell : called with a sentence at each step
    lens : the blocks that the solution has beyond the model of the options, see `proven_lens`
    own_detector : whether no detector's bias may pass for a lens
    """
    share = 0.0 if own_detector else _LENS_SHARE
    stated = _stated(solution, options)
    if _BOARD not in stated and postpone_search(lambda: [step for step in [_board_step(solution)] if step.used]):
        stated[_BOARD] = False
    base = cache(lambda: _judged(solution, stated, share))
    steps = {} if _BOARD in stated else {_BOARD: solution.proven or _board_step(solution)}
    asked, may_have_k3 = _asked(steps, stated), "k3" not in stated and _may_have_k3(solution)
    if not ((asked or lens) and (may_have_k3 or solution.paused)):  # else judged beside k3, or after the next step
        steps |= {step.name: step for step in base().steps}
        asked = _asked(steps, stated, promising=True)
    beside: Solution | None = None
    if solution.paused or (may_have_k3 and ({"intrinsics", _BOARD} & set(asked) or lens)):
        beside = _seen_beside(solution, options, lens, k3=may_have_k3, board=_BOARD in asked)
        after = replace(beside, state=apply_step(beside.state, beside.layout, beside.step))
        steps |= {step.name: step for step in _judged(after, stated, share).steps}
        del after
        asked = _asked(steps, stated, promising=True)
    judged: SelectedModel | None = None
    inside: tuple[str, ...] = ()
    asked, failed, rounds = _in_turn(asked, inside), dict[str, str](), _ROUNDS
    while rounds and asked != inside:
        stage = f"estimating along: {', '.join(asked) or 'none of them'}"
        tell(Step(stage, 0, 100))
        try:
            if asked or solution.paused:
                larger, beside = (
                    _larger_model(solution, asked, options, lens, beside),
                    None,
                )  # once; its memory is used up
                judged = _judged(_estimated(larger, options, tell, stage, rests=solution.converged), stated, share)
            else:
                judged = base()
        except SolveError as error:
            if not asked:
                raise
            failed[min(asked, key=lambda name: steps[name].gain - steps[name].needed)] = str(error)
        else:
            rounds, inside = rounds - 1, asked
            steps |= {step.name: step for step in judged.steps}
            if _BOARD not in stated and set(_LENS) & set(asked):
                steps[_BOARD] = _board_step(judged.solution)
        asked = _in_turn(tuple(name for name in _asked(steps, stated) if name not in failed), inside)
    told = [
        replace(step, forced=options.model != "auto" or step.name not in LADDER or step.name in EXTRAS)
        if step.name in stated
        else replace(step, used=step.name in inside)
        for step in steps.values()
    ]
    told.sort(key=lambda step: (*LADDER, _BOARD).index(step.name))
    return replace(
        judged or base(),
        steps=tuple(told),
        added=(*(_LENS[:1] if lens else ()), *inside),
        tries=len(steps.keys() - stated.keys()) + bool(lens),
        board_told=_BOARD in stated or steps[_BOARD].gain_sigma > 0,
        failed=failed,
    )


def _in_turn(asked: tuple[str, ...], inside: tuple[str, ...]) -> tuple[str, ...]:
    """Return the steps to take next: the exposure last, for what is left out of lens and board may look like one."""
    others = tuple(name for name in asked if name != EXPOSURE)
    return asked if EXPOSURE in inside or set(others) <= set(inside) else others


def _asked(steps: Mapping[str, ModelStep], stated: Mapping[str, bool], *, promising: bool = False) -> tuple[str, ...]:
    """Return the steps that prove themselves, or promise to, of those that nobody has decided on."""
    return tuple(
        name
        for name in (*EXTRAS, _BOARD)
        if name not in stated
        and (step := steps.get(name)) is not None
        and (step.used or (promising and name in _HIDING and step.gain > _PROMISING * step.gain_sigma > 0))
    )


def _may_have_k3(solution: Solution) -> bool:
    return any(entry.camera.distortion == "radtan" for entry in solution.state.parameters.cameras)


def _stated(solution: Solution, options: CameraImuOptions) -> dict[str, bool]:
    """Return step -> whether it is in the model, for those of the IMU and those that the options decide."""
    columns = solution.layout
    found = {name: bool(columns.free[step_columns(columns, name)].any()) for name in LADDER}
    found[_BOARD] = any(columns.free[columns.dense :])
    if options.model != "auto":
        return found
    held = {
        name
        for name, blocks in _BLOCKS.items()
        if any(part in given for given in options.fix for part in (*blocks, name))
    }
    return {name: inside for name, inside in found.items() if inside or name not in _BLOCKS or name in held}


def _judged(solution: Solution, stated: Mapping[str, bool], share: float) -> SelectedModel:
    """Return the solution with what each block brings in clusters of time that were left out."""
    found, columns = cluster_sums(solution), solution.layout
    free = columns.free_index[columns.free_index < columns.dense]
    blocks = [name.partition("[")[0] for name in np.array(columns.names)[free]]
    number = np.unique(blocks, return_inverse=True)[1].astype(np.int64)
    lasts = correlation_time(leave_clusters_out(found.of_parameters(free)), number)
    clusters, _ = group_into_clusters(found, max(lasts, 1))
    least = dict.fromkeys(_LENS, _gain(solution, share))
    steps = evaluate_nested_models(clusters[0], solution.layout, solution.state.parameters, stated, least)
    return SelectedModel(solution=solution, sums=found, steps=steps)


def proven_board(solution: Solution, options: CameraImuOptions) -> ModelStep | None:
    """Return what proves that corners of the board lie off their places, None where nothing does or it is decided."""
    step = None if _BOARD in _stated(solution, options) else _board_step(solution)
    return step if step is not None and step.used else None


def _board_step(solution: Solution) -> ModelStep:
    """Return what the corners of the board would bring, by residuals that stay the same from frame to frame.

    Taking a pattern of size s off residuals of size sigma makes their log-likelihood larger by half the sum of
    s^2 / sigma^2, before anything else is fitted anew; whether the pattern is there, clusters of time tell. Where the
    corners were estimated, they are put back to their places first: does the lens do without them?
    """
    board = solution.state.parameters.board
    if board is not None and board.offsets.any():
        parameters = replace(solution.state.parameters, board=replace(board, offsets=np.zeros_like(board.offsets)))
        solution = replace(solution, state=replace(solution.state, parameters=parameters))
    pattern = board_evidence(counting_corners(solution))
    gain, least = _gain(solution, pattern.share), _gain(solution, _BOARD_SHARE)
    spread = abs(gain / pattern.z) if pattern.z else 0.0
    needed = max(spread * NormalDist().inv_cdf(1 - _BOARD_CHANCE), least)
    return ModelStep(
        name=_BOARD,
        parameters=0 if board is None else board.offsets.size,
        gain=gain,
        gain_sigma=spread,
        needed=needed,
        used=gain > needed,
    )


def _gain(solution: Solution, share: float) -> float:
    """Return by how much the log-likelihood grows where a share of the corners' variance is explained."""
    corners = sum(
        int(fit.valid[inside].sum()) for fit, inside in zip(solution.lin.sums, solution.lin.inside, strict=True)
    )
    return corners * share / max(1 - share, 0.1)


def _seen_beside(
    solution: Solution, options: CameraImuOptions, lens: Sequence[str], *, k3: bool, board: bool
) -> Solution:
    """Return the same state, linearised with columns for a third radial coefficient or the board, which are held."""
    state, origin = _with_k3(solution) if k3 else (solution.state, solution.layout.start)
    chosen = estimation_choices(origin, options, added=lens)
    held = (*candidate_blocks(origin), *((OFFSETS,) if board else ()))
    columns = border_layout(origin, chosen.status, lens_tolerances(origin) | chosen.prior_sigma, held)
    spare = solution.lin.system.workspace if solution.paused else solution.spare_workspace()
    lin = linearize_batch(solution.measurements, state, columns, solution.noise, probing=True, workspace=spare)
    return replace(solution, state=state, layout=columns, lin=lin, step=gauss_newton_step(lin))


def _with_k3(solution: Solution) -> tuple[RigState, RigParameters]:
    """Return state and start values whose lenses have a third radial coefficient."""

    def wider(parameters: RigParameters) -> RigParameters:
        return replace(parameters, cameras=tuple(entry.with_k3() for entry in parameters.cameras))

    state = solution.state
    return replace(state, parameters=wider(state.parameters)), wider(solution.layout.start)


@value_class
class _LargerModel:
    """A model with further blocks, and where its estimation starts.

    Attributes
    ----------
    columns, extended : see `minimise_cost`
    before : largest and length of the step that led to the start, None where it was estimated by a smaller model
    """

    measurements: Measurements
    state: RigState
    columns: BorderLayout
    extended: BorderLayout
    noise: NoiseLevels
    workspace: Workspace
    before: tuple[float, float] | None = None


def _larger_model(
    solution: Solution, asked: Sequence[str], options: CameraImuOptions, lens: Sequence[str], beside: Solution | None
) -> _LargerModel:
    """Return the model with further blocks than a solution.

    Parameters
    ----------
    beside : linearised with columns for blocks that may be asked for; where these are the ones, it starts after the
        step from there
    """
    state, origin = _with_k3(solution) if "k3" in asked else (solution.state, solution.layout.start)
    chosen = estimation_choices(origin, options, added=[*lens, *(block for name in asked for block in _BLOCKS[name])])
    measurements = solution.measurements
    if DELAY in asked:
        grid = state.trajectory.grid
        inertial = (
            one for data in measurements.inertial for one in on_trajectory(data, state.parameters, chosen.status, grid)
        )
        measurements = replace(measurements, inertial=tuple(inertial))
    larger = _LargerModel(
        measurements=measurements,
        state=state,
        columns=border_layout(origin, chosen.status, chosen.prior_sigma),
        extended=border_layout(
            origin, chosen.status, lens_tolerances(origin) | chosen.prior_sigma, candidate_blocks(origin)
        ),
        noise=solution.noise,
        workspace=solution.spare_workspace(),
    )
    if beside is None or DELAY in asked or options.noise == "nominal" or solution.noise.lasting:
        return larger
    return _after_step(larger, beside, robust=options.robust) or larger


def _after_step(larger: _LargerModel, beside: Solution, *, robust: bool) -> _LargerModel | None:
    """Return a model that starts after a step, with frames and noise as they are there.

    None where the equations have not its columns, or corners fit no better after the step.
    """
    columns, measured = larger.extended, beside.layout
    same = measured.names == columns.names
    if not same or not np.array_equal(measured.prior_information, columns.prior_information):
        return None
    step = step_by(beside.step.factor, columns)
    try:
        state = apply_step(beside.state, columns, step)
    except SolveError:
        return None
    measurements, noise = judged_after(larger.measurements, state, columns, larger.noise, step)
    if not all(a < b for a, b in zip(noise.pixel_sigma, larger.noise.pixel_sigma, strict=True)):
        return None
    return replace(
        larger,
        state=state,
        noise=noise,
        measurements=measurements if robust else larger.measurements,
        workspace=beside.lin.system.workspace,
        before=(step.largest, step.length),
    )


def _estimated(larger: _LargerModel, options: CameraImuOptions, tell: Progress, stage: str, *, rests: bool) -> Solution:
    """Return the solution of a larger model.

    Parameters
    ----------
    rests : whether the one without its blocks came to rest

    Raises
    ------
    SolveError
        If it finds no minimum, or does not come to rest where the one without them did.
    """
    found = minimise_cost(
        larger.measurements,
        larger.state,
        larger.columns,
        larger.extended,
        larger.noise,
        estimate_noise=options.noise != "nominal",
        estimate_walks=options.noise == "coloured",
        gate=options.robust,
        max_iterations=options.max_iterations,
        tell=tell,
        stage=stage,
        workspace=larger.workspace,
        before=larger.before,
    )
    if rests and not found.converged:
        raise SolveError("it did not come to rest.")
    return found
