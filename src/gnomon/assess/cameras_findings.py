"""What a calibration of cameras says of lenses and views: what was found, what follows, what to do next."""

from math import degrees, radians

import numpy as np

from ..diagnostics import CamerasDiagnostics, CornerFit
from ..findings import Finding, Severity
from ..models.camera import Camera
from ..recording import Floats
from .cameras_coverage import attitude_spread, listed, unseen_corners
from .cameras_tables import MISFIT, CamerasEvidence, LensOpinion
from .verdict import graded

_PIXELS_WARN, _PIXELS_FAIL = 1.0, 3.0
_WORSE_WARN, _WORSE_FAIL = 1.03, 3.0
_FOCAL_WARN, _FOCAL_FAIL = 0.003, 0.03
_CENTRE_WARN_PX, _CENTRE_FAIL_PX = 2.0, 15.0
_ROTATION_WARN_RAD, _ROTATION_FAIL_RAD = radians(0.1), radians(1.0)
_BASELINE_WARN, _BASELINE_FAIL = 0.01, 0.1
_LEFT_OUT_WARN, _LEFT_OUT_FAIL = 0.25, 0.6
_UNSEEN_WORSE = 1.5
_WELL_TILTED = radians(12.0)
_SHOWN = 5
_NEAR = 1e-4


def lens_findings(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings on lenses and their places.

    Codes: not-converged, lens-model, reprojection, holdout-reprojection, lens-uncertain, baseline-uncertain.
    """
    findings: list[Finding] = []
    if not evidence.solution.converged:
        findings.append(
            Finding(
                severity="problem",
                code="not-converged",
                message=f"The estimation did not come to rest within {len(evidence.solution.steps)} iterations.",
                consequence="Its parameters are not a minimum.",
                cure="Take more views, tilted and in every part of the image; check the target file; allow more with "
                "--max-iterations.",
            )
        )
    findings += [_other_model(opinion, diagnostics) for opinion in evidence.opinions]
    for name, fit in diagnostics.corners.items():
        findings += [*_residuals(name, fit), *_unseen(name, evidence), *_uncertain(name, fit, evidence)]
    for name in list(evidence.cameras)[1:]:
        findings += _place(name, evidence)
    return findings


def _other_model(opinion: LensOpinion, diagnostics: CamerasDiagnostics) -> Finding:
    """Say that another model than the stated one predicts unseen views better."""
    px = {trial.model: trial.holdout_rms_px for trial in diagnostics.trials if trial.camera == opinion.camera}
    stated, better = px[opinion.stated], px[opinion.better]
    grade = graded(stated / better, _WORSE_WARN, _WORSE_FAIL)
    return Finding(
        severity="info" if grade == "good" else grade,
        code="lens-model",
        message=f"{opinion.camera}: {opinion.stated}, as stated, predicts views that it has not seen to {stated:.3g} "
        f"px (rms per axis), {opinion.better} to {better:.3g} px; its log-likelihood there is larger by "
        f"{opinion.gain:.3g} +- {opinion.gain_sigma:.2g}.",
        consequence="What the model cannot bend goes into focal length, poses and board."
        if grade != "good"
        else "The difference is certain, and too small to matter.",
        cure=f"Give --model {opinion.camera}={opinion.better}, or have it chosen without --model, --among and --for."
        if grade != "good"
        else "",
    )


def _residuals(name: str, fit: CornerFit) -> list[Finding]:
    grade = graded(fit.sigma_px, _PIXELS_WARN, _PIXELS_FAIL)
    if grade == "good":
        return []
    return [
        Finding(
            severity=grade,
            code="reprojection",
            message=f"Corners of {name} lie {fit.sigma_px:.2g} px (one sigma, per axis) from where they should; 0.05 "
            "to 0.5 px is usual.",
            consequence="No lens model that was tried is that of this camera, or the board is not the stated one.",
            cure="Check target.yaml: kind, rows and columns, spacing. Check that all images are of one camera with one "
            "zoom and one focus, and that they are sharp.",
        )
    ]


def _unseen(name: str, evidence: CamerasEvidence) -> list[Finding]:
    used, unseen = evidence.rms_px[name], evidence.unseen_px[name]
    if not unseen > _UNSEEN_WORSE * used:
        return []
    return [
        Finding(
            severity="warning",
            code="holdout-reprojection",
            message=f"{name}: views that the estimate has not seen are off by {unseen:.2g} px (rms per axis), those "
            f"it was made from by {used:.2g} px.",
            consequence="The lens follows the views at hand more than the camera: too few of them, or one among them "
            "that nothing else supports.",
            cure="Take more views: 20 to 60, tilted, near and far, in every part of the image.",
        )
    ]


def _uncertain(name: str, fit: CornerFit, evidence: CamerasEvidence) -> list[Finding]:
    """Say where focal length or principal point are known badly, and what would tell them."""
    camera = evidence.cameras[name].camera
    covariance = _of_lens(name, camera, evidence)
    focal, by_lens = magnification(camera)
    relative = float(np.sqrt(max(by_lens @ covariance @ by_lens, 0.0))) / focal
    kinds = np.array(camera.parameter_kinds)
    centre = float(np.sqrt(np.diag(covariance)[kinds == "principal"].max()))
    grades: tuple[Severity, ...] = (
        graded(relative, _FOCAL_WARN, _FOCAL_FAIL),
        graded(centre, _CENTRE_WARN_PX, _CENTRE_FAIL_PX),
    )
    if grades == ("good", "good"):
        return []
    return [
        Finding(
            severity="problem" if "problem" in grades else "warning",
            code="lens-uncertain",
            message=f"{name}: the focal length is known to {100 * relative:.2g} % only, the principal point to "
            f"{centre:.2g} px (one sigma).",
            consequence="Distances and directions by this camera are wrong by as much.",
            cure=_what_would_tell(fit, evidence),
        )
    ]


def _what_would_tell(fit: CornerFit, evidence: CamerasEvidence) -> str:
    """Return which motion of the board would determine the lens."""
    if attitude_spread(evidence) < _WELL_TILTED:
        return "Tilt the board by 20 to 45 degrees to all four sides: perspective tells the focal length."
    empty = unseen_corners(fit.pixels[fit.frame_used[fit.frame]], fit.resolution)
    if empty:
        return f"Hold the board into {listed([f'the {region} corner' for region in empty])} of the image, and nearer."
    return "Take more views, near and far, tilted by 20 to 45 degrees, with the board over half of the image."


def _of_lens(name: str, camera: Camera, evidence: CamerasEvidence) -> Floats:
    at = [evidence.names.index(f"{name}.{one}") for one in camera.parameter_names]
    return evidence.covariance[np.ix_(at, at)]


def magnification(camera: Camera) -> tuple[float, Floats]:
    """Return by how many px a ray moves per radian on the optical axis, and the derivative (q,) by the lens.

    For a pinhole that is fu; models whose focal length goes together with their shape become comparable.
    """
    rays = np.array([[-_NEAR, 0.0, 1.0], [_NEAR, 0.0, 1.0]])
    image = camera.project(rays, parameters_jacobian=True)
    assert image.by_parameters is not None
    slope = float(image.pixels[1, 0] - image.pixels[0, 0]) / (2 * _NEAR)
    return slope, (image.by_parameters[1, 0] - image.by_parameters[0, 0]) / (2 * _NEAR)


def _place(name: str, evidence: CamerasEvidence) -> list[Finding]:
    """Say where a camera's place against cam0 is known badly."""
    turn = max(evidence.sigma(f"{name}.T_cam_cam0.rotation[{k}]") for k in range(3))
    apart = max(evidence.sigma(f"{name}.T_cam_cam0.translation[{k}]") for k in range(3))
    length = float(np.linalg.norm(evidence.cameras[name].T_cam_body[:3, 3]))
    grades = {
        graded(turn, _ROTATION_WARN_RAD, _ROTATION_FAIL_RAD),
        graded(apart / max(length, 1e-12), _BASELINE_WARN, _BASELINE_FAIL),
    }
    if grades == {"good"}:
        return []
    return [
        Finding(
            severity="problem" if "problem" in grades else "warning",
            code="baseline-uncertain",
            message=f"{name}: its place against cam0, {1e3 * length:.4g} mm away, is known to {1e3 * apart:.2g} mm and "
            f"{degrees(turn):.2g} degrees only (one sigma).",
            consequence="Depth by both cameras is wrong by as many per cent.",
            cure="Take more views that both cameras see, with the board near and far.",
        )
    ]


def view_findings(diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of code views-left-out, which names them."""
    findings: list[Finding] = []
    for name, fit in diagnostics.corners.items():
        left = [k for k, reason in enumerate(fit.frame_reason) if reason == MISFIT]
        if not left:
            continue
        taken = len(left) + int(fit.frame_used.sum())
        grade = graded(len(left) / taken, _LEFT_OUT_WARN, _LEFT_OUT_FAIL)
        which = ", ".join(f"{k} (at {fit.frame_t_s[k]:.2f} s, off by {fit.frame_rms[k]:.2g} px)" for k in left[:_SHOWN])
        more = f" and {len(left) - _SHOWN} more" if len(left) > _SHOWN else ""
        findings.append(
            Finding(
                severity="info" if grade == "good" else grade,
                code="views-left-out",
                message=f"{name}: {len(left)} of {taken} views were left out since they fit badly as a whole (blurred, "
                f"or misdetected): image {which}{more}, counted from 0.",
                consequence="" if grade == "good" else "What is left may be too little, or a biased choice.",
                cure=""
                if grade == "good"
                else "Hold board and camera still for each picture, with more light and a short exposure.",
            )
        )
    return findings
