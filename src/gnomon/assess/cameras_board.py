"""What a calibration of cameras says of the board: its print, its flatness, its size."""

import numpy as np

from ..diagnostics import CamerasDiagnostics
from ..findings import Finding
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
    return Finding(
        severity="warning" if abs(aspect) > _ASPECT_WARN else "info",
        code="board-aspect",
        message=f"The board is {1e3 * abs(aspect):.3g} +- {1e3 * sigma:.1g} permille {way} along its y axis, against "
        "its x axis, than target.yaml states.",
        consequence="The model has taken that up, with x as stated. If y is right instead, all lengths are wrong by as "
        "much; with one camera alone that concerns the poses of the board only.",
        cure="Print without scaling to the page; measure the board along both axes.",
    )


def _bow(evidence: CamerasEvidence) -> Finding:
    bow = evidence.scale * evidence.solution.rig.board.bow_m
    along = int(np.argmax(np.abs(bow)))
    size = evidence.target.size_m[along]
    way = "towards the viewer" if bow[along] > 0 else "away from the viewer"
    return Finding(
        severity="warning" if abs(bow[along]) > _BOW_WARN * size else "info",
        code="board-bow",
        message=f"The board is not flat: along {'xy'[along]} its middle bulges by {1e3 * abs(bow[along]):.2g} +- "
        f"{1e3 * evidence.sigma(f'target.bow[{along}]'):.1g} mm {way}, over {1e3 * size:.0f} mm.",
        consequence="The model has taken that up, as a parabola that stays the same in all views.",
        cure="Glue the board onto glass, aluminium or a thick panel.",
    )


def _corners(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> Finding:
    offsets = np.linalg.norm(evidence.solution.rig.board.offsets, axis=1)
    rms, most = 1e3 * float(np.sqrt(np.mean(offsets**2))), 1e3 * float(offsets.max())
    points = diagnostics.board_points
    pitch = 1e3 * float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return Finding(
        severity="warning" if rms > _CORNERS_WARN * pitch else "info",
        code="board-found",
        message=f"Corners of the board lie {rms:.2g} mm (rms, at most {most:.2g} mm) from their places, in all views.",
        consequence="Print, plate or detector; the corners' places were estimated along.",
        cure="A flat board, printed sharply and lit evenly, needs less of it; check the spacing in target.yaml.",
    )


def _size(evidence: CamerasEvidence) -> list[Finding]:
    if len(evidence.cameras) < 2:
        return []
    if "target.scale" not in evidence.names:
        length = 1e3 * float(np.linalg.norm(list(evidence.cameras.values())[1].T_cam_body[:3, 3]))
        return [
            Finding(
                severity="info",
                code="board-size-untold",
                message=f"Only the stated size of the board tells metres: were it 1 % larger, the distance of the "
                f"cameras, {length:.2f} mm, would be {0.01 * length:.2f} mm more.",
                cure="Measure the board over many squares, or state the distance of the cameras with --baseline.",
            )
        ]
    off, sigma = evidence.scale - 1, evidence.sigma("target.scale")
    if abs(off) < max(_SIZE, _SIGNIFICANT * sigma):
        return []
    way = "larger" if off > 0 else "smaller"
    return [
        Finding(
            severity="warning",
            code="board-size",
            message=f"By the stated distance of the cameras the board is {100 * abs(off):.2g} +- {100 * sigma:.1g} % "
            f"{way} than target.yaml states.",
            consequence="All lengths of this result follow the stated distance, and the lenses depend on neither.",
            cure="Measure the board over many squares and correct target.yaml, or the baseline.",
        )
    ]
