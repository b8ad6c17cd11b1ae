"""What a calibration of cameras alone was made of, as the tables of its diagnostics."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...estimate.cameras.layout import board_points
from ...estimate.cameras.rig import CameraRig, RigSolution, RigViews, SeenCorners
from ...frozen import value_class
from ...models.target import Target
from ...options import CameraOptions
from ...recording import CameraFrames, Floats, Integers, Recording
from ...results.calibration import CameraCalibration
from ...results.camera_diagnostics import (
    CamerasDiagnostics,
    CornerFit,
    EstimatedParameter,
    LensTrial,
    NoiseLevel,
    ViewPose,
)
from ...results.sensors import calibration_parameters, element_names
from ...results.trust import Trust

CELLS = (8, 10)
"""Rows and columns into which the image is cut to see where corners were."""

NO_BOARD, FEW, MISFIT, NOT_CHOSEN = (
    "no board found",
    "too few corners",
    "fits badly as a whole",
    "tells nothing that others do not",
)
"""Reasons for which a view is not used."""

_UNITS = {"rotation": "rad", "translation": "m", "focal": "px", "principal": "px"}


@value_class
class LensOpinion:
    """A model that predicts hold-out views of a camera better than the stated one does.

    Attributes
    ----------
    camera, stated, better : name of the camera and of the models
    gain, gain_sigma : of the held-out log-likelihood
    """

    camera: str
    stated: str
    better: str
    gain: float
    gain_sigma: float


@value_class
class CamerasFitSummary:
    """What a calibration of cameras was made of.

    Attributes
    ----------
    recording, target, options : as given
    every : all views that show enough of the board
    start : rig from which the estimation started
    solution : the estimate
    nats : (v,) what each view of the solution told of the lenses
    others : "cam0", ... -> residuals of views and frames that the estimate did not use, about a pose of their own
    misfits : "cam0", ... -> those of these frames that fit badly as a whole
    cameras, names, covariance, scale : what is published, see `PublishedCameras`
    rms_px, unseen_px : "cam0" -> rms of the corners used, and of views that were left out [px]
    trials : models that were tried
    opinions : where another model than the stated one is better
    added : what of the board was estimated since the views prove it
    trust : what the views tell of the uncertainty
    """

    recording: Recording
    target: Target
    options: CameraOptions
    every: RigViews
    start: CameraRig
    solution: RigSolution
    nats: Floats
    others: Mapping[str, SeenCorners]
    misfits: Mapping[str, Integers]
    cameras: Mapping[str, CameraCalibration]
    names: tuple[str, ...]
    covariance: Floats
    scale: float
    rms_px: Mapping[str, float]
    unseen_px: Mapping[str, float]
    trials: tuple[LensTrial, ...]
    opinions: tuple[LensOpinion, ...]
    added: tuple[str, ...]
    trust: Trust

    def sigma(self, name: str) -> float:
        """Return the standard deviation of a scalar; nan where it is not among the names."""
        if name not in self.names:
            return float("nan")
        at = self.names.index(name)
        return float(np.sqrt(max(self.covariance[at, at], 0.0)))


def describe_cameras(evidence: CamerasFitSummary) -> CamerasDiagnostics:
    """Return the tables."""
    solution = evidence.solution
    corners = {name: _corners(evidence, name) for name in solution.rig.cameras}
    rows = parameter_rows(evidence)
    at = [evidence.names.index(row.name) for row in rows if row.status == "estimated"]
    sigma = np.sqrt(np.diag(evidence.covariance)[at])
    shape, points = solution.rig.board, evidence.target.points
    return CamerasDiagnostics(
        corners=corners,
        views=_views(evidence),
        coverage={name: corner_counts(fit) for name, fit in corners.items()},
        trials=evidence.trials,
        parameters=rows,
        correlation=evidence.covariance[np.ix_(at, at)] / np.outer(sigma, sigma),
        noise=tuple(_noise(name, fit) for name, fit in corners.items()),
        steps=solution.steps,
        board_points=points,
        board_shifts=evidence.scale * (board_points(evidence.target, shape) - points),
        trust=evidence.trust,
    )


def corner_counts(fit: CornerFit) -> np.ndarray:
    """Return how many corners that were used lie in each cell of the image, (rows, cols)."""
    used = fit.frame_used[fit.frame] & (fit.weight > 0)
    width, height = fit.resolution
    u, v = fit.pixels[used].T
    ranges = [(-0.5, height - 0.5), (-0.5, width - 0.5)]
    return np.histogram2d(v, u, bins=CELLS, range=ranges)[0].astype(np.int64)


def _corners(evidence: CamerasFitSummary, name: str) -> CornerFit:
    """Return the fit of every corner that was detected, also in frames that were not used."""
    number = tuple(evidence.every.cameras).index(name)
    frames, seen, apart = evidence.every.cameras[name], evidence.solution.corners[name], evidence.others[name]
    count = len(frames.t_ns)
    used = np.zeros(count, dtype=bool)
    used[seen.frame] = True
    residual, weight = np.full((len(frames.frame), 2), np.nan), np.zeros(len(frames.frame))
    for one in (apart, seen):
        at = _places(frames, one)
        residual[at] = one.residual
        weight[at] = one.weight
    weight[~used[frames.frame]] = 0.0
    since = frames.t_ns - min(int(one.t_ns[0]) for one in evidence.every.cameras.values())
    known = np.isfinite(residual[:, 0])
    squares = np.bincount(frames.frame[known], np.sum(residual[known] ** 2, axis=1), count)
    corners = np.bincount(frames.frame, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(squares / (2 * np.bincount(frames.frame[known], minlength=count)))
    return CornerFit(
        frame_t_s=np.asarray(since * 1e-9, dtype=np.float64),
        frame_corners=corners,
        frame_rms=np.asarray(rms, dtype=np.float64),
        frame_used=used,
        frame_reason=_reasons(evidence, number, corners, used),
        frame=frames.frame,
        point=frames.point,
        pixels=frames.pixels,
        residual=residual,
        weight=weight,
        sigma_px=float(evidence.solution.sigma_px[name]),
        resolution=frames.camera.resolution,
        corner_sigma_px=frames.sigma_px,
        quality=frames.quality,
    )


def _places(frames: CameraFrames, seen: SeenCorners) -> Integers:
    """Return where corners stand among all that were detected, (m,)."""
    most = int(max(frames.point.max(initial=0), seen.point.max(initial=0))) + 1
    key, wanted = frames.frame * most + frames.point, seen.frame * most + seen.point
    order = np.argsort(key, kind="stable")
    return order[np.searchsorted(key[order], wanted)]


def _reasons(evidence: CamerasFitSummary, number: int, corners: np.ndarray, used: np.ndarray) -> tuple[str, ...]:
    """Return why each frame of a camera was not used."""
    reasons = np.full(len(corners), FEW, dtype=object)
    gathered = evidence.every.frame[:, number]
    reasons[gathered[gathered >= 0]] = NOT_CHOSEN
    reasons[evidence.misfits[tuple(evidence.cameras)[number]]] = MISFIT
    reasons[corners == 0] = NO_BOARD
    reasons[used] = ""
    return tuple(reasons.tolist())


def _views(evidence: CamerasFitSummary) -> tuple[ViewPose, ...]:
    rig, views = evidence.solution.rig, evidence.solution.views
    seen = np.zeros((len(views), len(rig.cameras)), dtype=bool)
    for number, corners in enumerate(evidence.solution.corners.values()):
        seen[np.unique(corners.view), number] = True
    return tuple(
        ViewPose(
            t_ns=int(views.t_ns[k]),
            cameras=tuple(name for number, name in enumerate(rig.cameras) if seen[k, number]),
            R_target_cam0=rig.R_cam0_target[k].T,
            p_target_cam0=-evidence.scale * rig.R_cam0_target[k].T @ rig.p_cam0_target[k],
            information=float(evidence.nats[k]),
        )
        for k in np.flatnonzero(seen.any(axis=1))
    )


def parameter_rows(evidence: CamerasFitSummary) -> tuple[EstimatedParameter, ...]:
    """Return every scalar that could be estimated."""
    rig, first = evidence.solution.rig, evidence.start
    started = {
        name: replace(camera, camera=first.cameras[name], T_cam_body=first.T_cam_cam0[number])
        for number, (name, camera) in enumerate(evidence.cameras.items())
    }
    starts = dict(calibration_parameters({}, started))
    found: list[EstimatedParameter] = []
    for path, values in calibration_parameters({}, evidence.cameras):
        for name, value, start in zip(
            element_names(path, values.shape), np.ravel(values), np.ravel(starts[path]), strict=True
        ):
            found.append(_row(evidence, name, float(value), float(start), _unit(evidence, name)))
    found.append(_row(evidence, "target.aspect", rig.board.aspect, 0.0, ""))
    found += [_row(evidence, f"target.bow[{k}]", evidence.scale * float(rig.board.bow_m[k]), 0.0, "m") for k in (0, 1)]
    if "target.scale" in evidence.names:
        found.append(_row(evidence, "target.scale", evidence.scale, 1.0, ""))
    return tuple(found)


def _row(evidence: CamerasFitSummary, name: str, value: float, start: float, unit: str) -> EstimatedParameter:
    sigma = evidence.sigma(name)
    held = not sigma > 0
    return EstimatedParameter(
        name=name,
        unit=unit,
        value=value,
        start=start,
        sigma=0.0 if held else sigma,
        prior_sigma=float("inf"),
        status="fixed" if held else "estimated",
    )


def _unit(evidence: CamerasFitSummary, name: str) -> str:
    sensor, _, rest = name.partition(".")
    if ".T_cam_cam0." in name:
        return _UNITS[rest.partition(".")[2].partition("[")[0]]
    camera = evidence.cameras[sensor].camera
    return _UNITS.get(dict(zip(camera.parameter_names, camera.parameter_kinds, strict=True))[rest], "")


def _noise(name: str, fit: CornerFit) -> NoiseLevel:
    told = fit.corner_sigma_px
    return NoiseLevel(
        name=f"{name}.corners",
        unit="px",
        nominal=float("nan") if told is None or not len(told) else float(np.median(told)),
        estimated=fit.sigma_px,
        used=fit.sigma_px,
    )
