"""Verdict and advice on a calibration of cameras alone: what to trust, what to do next."""

from collections.abc import Iterator
from math import radians

import numpy as np

from ...findings import Finding, join_names, list_first, make_finding
from ...models.camera import Camera
from ...recording import Floats
from ...results.calibration import Assessment, CamerasFit
from ...results.camera_diagnostics import CamerasDiagnostics, CornerFit
from ..checks.board_views import image_coverage
from ..checks.rig_doctor import ENOUGH_VIEWS
from ..verdict import grade_by_limits, most_severe, parts_disagree, underestimated_blocks, with_verdict
from .cameras_tables import MISFIT, CamerasFitSummary, LensOpinion
from .rig_findings import outlying_corners

_COVERED = 0.5  # of the image
_CORNER = 0.25  # of width and height
_UNCERTAIN_PX = 0.3
_SMALL = 0.15  # of the image's diagonal
_ONE_ATTITUDE, _FEW_ATTITUDES = np.radians(2.5), np.radians(8.0)
_FEW_VIEWS = 4
_REGIONS = ("upper left", "upper right", "lower left", "lower right")
_GRID = 12


def coverage_findings(evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of codes image-coverage, image-corners-unseen, board-small and attitudes-alike."""
    findings: list[Finding] = []
    for name, fit in diagnostics.corners.items():
        findings += [*_coverage(name, fit, evidence), *_size(name, fit)]
    return [*findings, *_attitudes(evidence)]


def _coverage(name: str, fit: CornerFit, evidence: CamerasFitSummary) -> list[Finding]:
    pixels = fit.pixels[fit.frame_used[fit.frame] & (fit.weight > 0)]
    share = image_coverage(pixels, fit.resolution)
    empty = unseen_corners(pixels, fit.resolution)
    where = join_names([f"the {region} corner" for region in empty])
    findings: list[Finding] = []
    if share < _COVERED:
        findings.append(
            make_finding(
                "image-coverage/cameras",
                name=name,
                share=share,
                none_in=f", none in {where}" if empty else "",
                where=where or "every part of the image",
            )
        )
    elif empty:
        sigma = max(corner_sigma_px(evidence, name)[_REGIONS.index(region)] for region in empty)
        loud = len(empty) > 1 or sigma > _UNCERTAIN_PX
        findings.append(
            make_finding(
                "image-corners-unseen", severity="warning" if loud else "info", name=name, where=where, sigma=sigma
            )
        )
    return findings


def unseen_corners(pixels: Floats, resolution: tuple[int, int]) -> list[str]:
    """Return the corners of the image, such as "lower left", in which there are no points (m, 2)."""
    x, y = ((pixels + 0.5) / np.array(resolution)).T
    inside = {
        "upper left": (x < _CORNER) & (y < _CORNER),
        "upper right": (x > 1 - _CORNER) & (y < _CORNER),
        "lower left": (x < _CORNER) & (y > 1 - _CORNER),
        "lower right": (x > 1 - _CORNER) & (y > 1 - _CORNER),
    }
    return [region for region in _REGIONS if not inside[region].any()]


def corner_sigma_px(evidence: CamerasFitSummary, name: str) -> Floats:
    """Return how well the lens is known in the four corners of the image, (4,) [px]; nan where the lens sees nothing.

    What a turn of the camera can do is no error of the lens, and taken out.
    """
    camera = evidence.cameras[name].camera
    width, height = camera.resolution
    near, far = _CORNER / 2, 1 - _CORNER / 2
    corners = np.array([[near, near], [far, near], [near, far], [far, far]]) * (width, height)
    grid = np.stack(np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID)), axis=-1).reshape(-1, 2)
    moves = pixel_moves(camera, np.concatenate([corners, grid]))
    names = [f"{name}.{one}" for one in camera.parameter_names]
    at = [evidence.names.index(one) for one in names]
    covariance = evidence.covariance[np.ix_(at, at)]
    variance = np.einsum("mip,pq,miq->m", moves[:4], covariance, moves[:4])
    return np.sqrt(variance / 2)


def pixel_moves(camera: Camera, pixels: Floats) -> Floats:
    """Return the derivative (m, 2, q) of where the rays at pixels (m, 2) are seen, by the lens, turns taken out."""
    rays, valid = camera.unproject(pixels)
    image = camera.project(np.where(valid[:, None], rays, [0.0, 0.0, 1.0]), parameters_jacobian=True)
    assert image.by_parameters is not None
    assert image.by_point is not None
    by_turn = np.cross(image.by_point, np.where(valid[:, None], rays, 0.0)[:, None, :])
    known = valid & image.valid
    turn, lens = by_turn[known].reshape(-1, 3), image.by_parameters[known].reshape(-1, len(camera.parameters))
    gain = np.linalg.lstsq(turn, lens, rcond=None)[0]
    moves = image.by_parameters - by_turn @ gain
    moves[~known] = np.nan
    return moves


def _size(name: str, fit: CornerFit) -> list[Finding]:
    used = np.flatnonzero(fit.frame_used)
    if not len(used):
        return []
    extent = [np.ptp(fit.pixels[fit.frame == k], axis=0) for k in used]
    share = float(np.median(np.linalg.norm(extent, axis=1))) / float(np.hypot(*fit.resolution))
    if share >= _SMALL:
        return []
    return [make_finding("board-small/cameras", name=name, share=share)]


def attitude_spread(evidence: CamerasFitSummary) -> float:
    """Return how much the attitudes of the board differ: rms angle of its normal about their mean [rad]."""
    normals = evidence.solution.rig.R_cam0_target[:, :, 2]
    mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    return float(np.sqrt(np.mean(np.arccos(np.clip(normals @ mean, -1, 1)) ** 2)))


def _attitudes(evidence: CamerasFitSummary) -> Iterator[Finding]:
    spread, count = attitude_spread(evidence), len(evidence.solution.views)
    if spread >= _FEW_ATTITUDES or count < _FEW_VIEWS:
        return
    one = spread < _ONE_ATTITUDE
    yield make_finding(
        "attitudes-alike", alike="one and the same" if one else "nearly the same", count=count, spread=spread
    )


_UNSEEN_WORSE = 1.5
_WELL_TILTED = radians(12.0)
_SHOWN = 5
_NEAR = 1e-4


def lens_findings(evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings on lenses and their places.

    Codes: not-converged, lens-model, reprojection, holdout-reprojection, lens-uncertain, baseline-uncertain.
    """
    findings: list[Finding] = []
    if not evidence.solution.converged:
        findings.append(make_finding("not-converged/cameras", steps=len(evidence.solution.steps)))
    findings += [_other_model(opinion, diagnostics) for opinion in evidence.opinions]
    for name, fit in diagnostics.corners.items():
        findings += [*_residuals(name, fit), *_unseen(name, evidence), *_uncertain(name, fit, evidence)]
    for name in list(evidence.cameras)[1:]:
        findings += _place(name, evidence)
    return findings


def _other_model(opinion: LensOpinion, diagnostics: CamerasDiagnostics) -> Finding:
    """Say that another model than the stated one predicts hold-out views better."""
    px = {trial.model: trial.holdout_rms_px for trial in diagnostics.trials if trial.camera == opinion.camera}
    stated, better = px[opinion.stated], px[opinion.better]
    severity = grade_by_limits("lens model", stated / better)
    return make_finding(
        "lens-model",
        severity="info" if severity == "good" else severity,
        case="worse" if severity != "good" else "",
        camera=opinion.camera,
        stated_model=opinion.stated,
        stated=stated,
        better_model=opinion.better,
        better=better,
        gain=opinion.gain,
        gain_sigma=opinion.gain_sigma,
    )


def _residuals(name: str, fit: CornerFit) -> list[Finding]:
    severity = grade_by_limits("corner residual", fit.sigma_px)
    if severity == "good":
        return []
    return [make_finding("reprojection/cameras", severity=severity, name=name, rms_px=fit.sigma_px)]


def _unseen(name: str, evidence: CamerasFitSummary) -> list[Finding]:
    used, unseen = evidence.rms_px[name], evidence.unseen_px[name]
    if not unseen > _UNSEEN_WORSE * used:
        return []
    return [make_finding("holdout-reprojection", name=name, unseen=unseen, used=used)]


def _uncertain(name: str, fit: CornerFit, evidence: CamerasFitSummary) -> Iterator[Finding]:
    """Say where focal length or principal point are known badly, and what would tell them."""
    camera = evidence.cameras[name].camera
    covariance = _of_lens(name, camera, evidence)
    focal, by_lens = axis_magnification(camera)
    relative = float(np.sqrt(max(by_lens @ covariance @ by_lens, 0.0))) / focal
    kinds = np.array(camera.parameter_kinds)
    centre = float(np.sqrt(np.diag(covariance)[kinds == "principal"].max()))
    severity = most_severe(grade_by_limits("focal length", relative), grade_by_limits("centre", centre))
    if severity == "good":
        return
    yield make_finding(
        "lens-uncertain",
        severity=severity,
        name=name,
        relative=relative,
        centre=centre,
        advice=_what_would_tell(fit, evidence),
    )


def _what_would_tell(fit: CornerFit, evidence: CamerasFitSummary) -> str:
    """Return which motion of the board would determine the lens."""
    if attitude_spread(evidence) < _WELL_TILTED:
        return "Tilt the board by 20 to 45 degrees to all four sides: perspective tells the focal length."
    empty = unseen_corners(fit.pixels[fit.frame_used[fit.frame]], fit.resolution)
    if empty:
        return (
            f"Hold the board into {join_names([f'the {region} corner' for region in empty])} of the image, and nearer."
        )
    return "Take more views, near and far, tilted by 20 to 45 degrees, with the board over half of the image."


def _of_lens(name: str, camera: Camera, evidence: CamerasFitSummary) -> Floats:
    at = [evidence.names.index(f"{name}.{one}") for one in camera.parameter_names]
    return evidence.covariance[np.ix_(at, at)]


def axis_magnification(camera: Camera) -> tuple[float, Floats]:
    """Return by how many px a ray moves per radian on the optical axis, and the derivative (q,) by the lens.

    For a pinhole that is fu; models whose focal length goes together with their shape become comparable.
    """
    rays = np.array([[-_NEAR, 0.0, 1.0], [_NEAR, 0.0, 1.0]])
    image = camera.project(rays, parameters_jacobian=True)
    assert image.by_parameters is not None
    slope = float(image.pixels[1, 0] - image.pixels[0, 0]) / (2 * _NEAR)
    return slope, (image.by_parameters[1, 0] - image.by_parameters[0, 0]) / (2 * _NEAR)


def _place(name: str, evidence: CamerasFitSummary) -> Iterator[Finding]:
    """Say where a camera's place against cam0 is known badly."""
    turn = max(evidence.sigma(f"{name}.T_cam_cam0.rotation[{k}]") for k in range(3))
    apart = max(evidence.sigma(f"{name}.T_cam_cam0.translation[{k}]") for k in range(3))
    length = float(np.linalg.norm(evidence.cameras[name].T_cam_body[:3, 3]))
    severity = most_severe(grade_by_limits("rotation", turn), grade_by_limits("baseline", apart / max(length, 1e-12)))
    if severity == "good":
        return
    yield make_finding(
        "baseline-uncertain",
        severity=severity,
        name=name,
        length=length,
        apart=apart,
        turn=turn,
    )


def view_findings(diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of code views-left-out, which names them."""
    findings: list[Finding] = []
    for name, fit in diagnostics.corners.items():
        left = [k for k, reason in enumerate(fit.frame_reason) if reason == MISFIT]
        if not left:
            continue
        taken = len(left) + int(fit.frame_used.sum())
        severity = grade_by_limits("left out", len(left) / taken)
        which = [f"{k} (at {fit.frame_t_s[k]:.2f} s, off by {fit.frame_rms[k]:.2g} px)" for k in left]
        findings.append(
            make_finding(
                "views-left-out",
                severity="info" if severity == "good" else severity,
                name=name,
                count=len(left),
                taken=taken,
                which=list_first(which, _SHOWN),
            )
        )
    return findings


_ASPECT_WARN, _BOW_WARN = 0.005, 0.005
_SIZE, _SIGNIFICANT = 0.002, 5.0
_CORNERS_WARN = 0.01  # of the distance of two points


def board_findings(evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of codes board-aspect, board-bow, board-found, board-size and board-size-untold."""
    findings: list[Finding] = []
    if "aspect" in evidence.added:
        findings.append(_aspect(evidence))
    if "bow" in evidence.added:
        findings.append(_bow(evidence))
    if "corners" in evidence.added:
        findings.append(_corners(evidence, diagnostics))
    return [*findings, *_cameras_size(evidence)]


def _aspect(evidence: CamerasFitSummary) -> Finding:
    aspect, sigma = evidence.solution.rig.board.aspect, evidence.sigma("target.aspect")
    way = "longer" if aspect > 0 else "shorter"
    return make_finding(
        "board-aspect",
        severity="warning" if abs(aspect) > _ASPECT_WARN else "info",
        aspect=abs(aspect),
        sigma=sigma,
        way=way,
    )


def _bow(evidence: CamerasFitSummary) -> Finding:
    bow = evidence.scale * evidence.solution.rig.board.bow_m
    along = int(np.argmax(np.abs(bow)))
    size = evidence.target.size_m[along]
    way = "towards the viewer" if bow[along] > 0 else "away from the viewer"
    return make_finding(
        "board-bow",
        severity="warning" if abs(bow[along]) > _BOW_WARN * size else "info",
        axis="xy"[along],
        bow=abs(bow[along]),
        sigma=evidence.sigma(f"target.bow[{along}]"),
        way=way,
        size=size,
    )


def _corners(evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics) -> Finding:
    offsets = np.linalg.norm(evidence.solution.rig.board.offsets, axis=1)
    rms, most = 1e3 * float(np.sqrt(np.mean(offsets**2))), 1e3 * float(offsets.max())
    points = diagnostics.board_points
    pitch = 1e3 * float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return make_finding(
        "board-found/cameras", severity="warning" if rms > _CORNERS_WARN * pitch else "info", rms=rms, most=most
    )


def _cameras_size(evidence: CamerasFitSummary) -> list[Finding]:
    if len(evidence.cameras) < 2:
        return []
    if "target.scale" not in evidence.names:
        length = 1e3 * float(np.linalg.norm(list(evidence.cameras.values())[1].T_cam_body[:3, 3]))
        return [make_finding("board-size-untold", length=length, of_length=0.01 * length)]
    off, sigma = evidence.scale - 1, evidence.sigma("target.scale")
    if abs(off) < max(_SIZE, _SIGNIFICANT * sigma):
        return []
    way = "larger" if off > 0 else "smaller"
    return [make_finding("board-size", off=abs(off), sigma=sigma, way=way)]


def assess_cameras(
    noticed: tuple[Finding, ...], evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics
) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    noticed : what was found before the estimation; what was fine is not repeated
    evidence : what the calibration was made of
    diagnostics : its tables
    """
    findings = [
        *(finding for finding in noticed if finding.severity != "good"),
        *coverage_findings(evidence, diagnostics),
        *lens_findings(evidence, diagnostics),
        *board_findings(evidence, diagnostics),
        *view_findings(diagnostics),
        *_few_used(noticed, diagnostics),
        *(finding for name, fit in diagnostics.corners.items() for finding in outlying_corners(name, fit)),
        *_incomplete(evidence),
        *parts_disagree(evidence.trust.splits),
    ]
    assessment = Assessment(
        model=" ".join(dict.fromkeys(camera.camera.model for camera in evidence.cameras.values())),
        cameras=_fit(evidence, diagnostics),
    )
    return with_verdict(assessment, findings)


def _fit(evidence: CamerasFitSummary, diagnostics: CamerasDiagnostics) -> CamerasFit:
    corners, board = diagnostics.corners, evidence.solution.rig.board
    used = {name: fit.frame_used[fit.frame] & (fit.weight > 0) for name, fit in corners.items()}
    models = {name: tuple(one.model for one in diagnostics.trials if one.camera == name) for name in corners}
    along = max((0, 1), key=lambda k: abs(board.bow_m[k]))
    return CamerasFit(
        views_found={name: int((fit.frame_corners > 0).sum()) for name, fit in corners.items()},
        views_used={name: int(fit.frame_used.sum()) for name, fit in corners.items()},
        corners_used={name: int(used[name].sum()) for name in corners},
        reprojection_rms_px=dict(evidence.rms_px),
        holdout_rms_px=dict(evidence.unseen_px),
        coverage={name: image_coverage(fit.pixels[used[name]], fit.resolution) for name, fit in corners.items()},
        models=models,
        board_added=tuple(f"target.{name}" for name in evidence.added),
        aspect=board.aspect,
        aspect_sigma=_sigma(evidence, "target.aspect"),
        bow_m=evidence.scale * float(board.bow_m[along]),
        bow_sigma_m=_sigma(evidence, f"target.bow[{along}]"),
        print_scale=evidence.scale if "target.scale" in evidence.names else float("nan"),
        print_scale_sigma=evidence.sigma("target.scale"),
        converged=evidence.solution.converged,
    )


def _few_used(noticed: tuple[Finding, ...], diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Say that fewer views are used than a test needs, though more were there."""
    if any(finding.code == "views-few" for finding in noticed):
        return []
    counts = {name: int(fit.frame_used.sum()) for name, fit in diagnostics.corners.items()}
    return [
        make_finding("views-few/used", name=name, count=count, enough_views=ENOUGH_VIEWS)
        for name, count in counts.items()
        if count < ENOUGH_VIEWS
    ]


def _incomplete(evidence: CamerasFitSummary) -> list[Finding]:
    """Say where errors that the corners of a view share make parameters scatter."""
    wide, clusters = underestimated_blocks(evidence.trust), evidence.trust.clusters
    if not wide or clusters is None:
        return []
    listed = ", ".join(f"{one.block} {one.ratio:.2g} times" for one in wide[:3])
    return [make_finding("model-incomplete/cameras", listed=listed, stretches=clusters.count)]


def _sigma(evidence: CamerasFitSummary, name: str) -> float:
    return evidence.sigma(name) if name in evidence.names else 0.0
