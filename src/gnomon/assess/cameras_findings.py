"""What a calibration of cameras says of lenses and views: what was found, what follows, what to do next."""

from math import radians

import numpy as np

from ..diagnostics import CamerasDiagnostics, CornerFit
from ..findings import Finding, Severity, make_finding
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
        findings.append(make_finding("not-converged/cameras", steps=len(evidence.solution.steps)))
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
    return make_finding(
        "lens-model",
        severity="info" if grade == "good" else grade,
        case="grade-good" if grade != "good" else "",
        camera=opinion.camera,
        stated_model=opinion.stated,
        stated=stated,
        better_model=opinion.better,
        better=better,
        gain=opinion.gain,
        gain_sigma=opinion.gain_sigma,
    )


def _residuals(name: str, fit: CornerFit) -> list[Finding]:
    grade = graded(fit.sigma_px, _PIXELS_WARN, _PIXELS_FAIL)
    if grade == "good":
        return []
    return [make_finding("reprojection/cameras", severity=grade, name=name, rms_px=fit.sigma_px)]


def _unseen(name: str, evidence: CamerasEvidence) -> list[Finding]:
    used, unseen = evidence.rms_px[name], evidence.unseen_px[name]
    if not unseen > _UNSEEN_WORSE * used:
        return []
    return [make_finding("holdout-reprojection", name=name, unseen=unseen, used=used)]


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
        make_finding(
            "lens-uncertain",
            severity="problem" if "problem" in grades else "warning",
            name=name,
            relative=relative,
            centre=centre,
            advice=_what_would_tell(fit, evidence),
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
        make_finding(
            "baseline-uncertain",
            severity="problem" if "problem" in grades else "warning",
            name=name,
            length=length,
            apart=apart,
            turn=turn,
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
            make_finding(
                "views-left-out",
                severity="info" if grade == "good" else grade,
                name=name,
                count=len(left),
                taken=taken,
                which=which,
                more=more,
            )
        )
    return findings
