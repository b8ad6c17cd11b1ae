"""Verdict and advice on a calibration of cameras alone: what to trust, what to do next."""

from ..calibration import Assessment, CamerasFit
from ..diagnostics import CamerasDiagnostics
from ..findings import Finding, make_finding
from .camera_views import image_coverage
from .cameras_board import board_findings
from .cameras_checks import ENOUGH_VIEWS
from .cameras_coverage import coverage_findings
from .cameras_findings import lens_findings, view_findings
from .cameras_tables import CamerasEvidence
from .rig_residuals import outlying_corners
from .trust_findings import incomplete, parts_disagree
from .verdict import verdict_of, worst_first


def assess(noticed: tuple[Finding, ...], evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> Assessment:
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
    ordered = worst_first(findings)
    return Assessment(
        verdict=verdict_of(ordered),
        findings=ordered,
        model=" ".join(dict.fromkeys(camera.camera.model for camera in evidence.cameras.values())),
        cameras=_fit(evidence, diagnostics),
    )


def _fit(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> CamerasFit:
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


def _incomplete(evidence: CamerasEvidence) -> list[Finding]:
    """Say where errors that the corners of a view share make parameters scatter."""
    wide, clusters = incomplete(evidence.trust), evidence.trust.clusters
    if not wide or clusters is None:
        return []
    listed = ", ".join(f"{one.block} {one.ratio:.2g} times" for one in wide[:3])
    return [make_finding("model-incomplete/cameras", listed=listed, stretches=clusters.count)]


def _sigma(evidence: CamerasEvidence, name: str) -> float:
    return evidence.sigma(name) if name in evidence.names else 0.0
