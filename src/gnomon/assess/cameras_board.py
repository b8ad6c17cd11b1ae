"""What a calibration of cameras says of the board: its print, its flatness, its size."""

import numpy as np

from ..diagnostics import CamerasDiagnostics
from ..findings import Finding, make_finding
from .cameras_tables import CamerasEvidence

_ASPECT_WARN, _BOW_WARN = 0.005, 0.005
_SIZE, _SIGNIFICANT = 0.002, 5.0
_CORNERS_WARN = 0.01  # of the distance of two points


def board_findings(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of codes board-aspect, board-bow, board-found, board-size and board-size-untold."""
    findings: list[Finding] = []
    if "aspect" in evidence.added:
        findings.append(_aspect(evidence))
    if "bow" in evidence.added:
        findings.append(_bow(evidence))
    if "corners" in evidence.added:
        findings.append(_corners(evidence, diagnostics))
    return [*findings, *_size(evidence)]


def _aspect(evidence: CamerasEvidence) -> Finding:
    aspect, sigma = evidence.solution.rig.board.aspect, evidence.sigma("target.aspect")
    way = "longer" if aspect > 0 else "shorter"
    return make_finding(
        "board-aspect",
        severity="warning" if abs(aspect) > _ASPECT_WARN else "info",
        aspect=abs(aspect),
        sigma=sigma,
        way=way,
    )


def _bow(evidence: CamerasEvidence) -> Finding:
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


def _corners(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> Finding:
    offsets = np.linalg.norm(evidence.solution.rig.board.offsets, axis=1)
    rms, most = 1e3 * float(np.sqrt(np.mean(offsets**2))), 1e3 * float(offsets.max())
    points = diagnostics.board_points
    pitch = 1e3 * float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return make_finding(
        "board-found/cameras", severity="warning" if rms > _CORNERS_WARN * pitch else "info", rms=rms, most=most
    )


def _size(evidence: CamerasEvidence) -> list[Finding]:
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
