"""Where in the image the board was, how it was turned, and where to hold it next."""

from collections.abc import Sequence

import numpy as np

from ..diagnostics import CamerasDiagnostics, CornerFit
from ..findings import Finding, make_finding
from ..models.camera import Camera
from ..recording import Floats
from .camera_views import image_coverage
from .cameras_tables import CamerasEvidence

_COVERED = 0.5  # of the image
_CORNER = 0.25  # of width and height
_UNCERTAIN_PX = 0.3
_SMALL = 0.15  # of the image's diagonal
_ONE_ATTITUDE, _FEW_ATTITUDES = np.radians(2.5), np.radians(8.0)
_FEW_VIEWS = 4
_REGIONS = ("upper left", "upper right", "lower left", "lower right")
_GRID = 12


def coverage_findings(evidence: CamerasEvidence, diagnostics: CamerasDiagnostics) -> list[Finding]:
    """Return findings of codes image-coverage, image-corners-unseen, board-small and attitudes-alike."""
    findings: list[Finding] = []
    for name, fit in diagnostics.corners.items():
        findings += [*_coverage(name, fit, evidence), *_size(name, fit)]
    return [*findings, *_attitudes(evidence)]


def _coverage(name: str, fit: CornerFit, evidence: CamerasEvidence) -> list[Finding]:
    pixels = fit.pixels[fit.frame_used[fit.frame] & (fit.weight > 0)]
    share = image_coverage(pixels, fit.resolution)
    empty = unseen_corners(pixels, fit.resolution)
    where = listed([f"the {region} corner" for region in empty])
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


def corner_sigma_px(evidence: CamerasEvidence, name: str) -> Floats:
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


def attitude_spread(evidence: CamerasEvidence) -> float:
    """Return how much the attitudes of the board differ: rms angle of its normal about their mean [rad]."""
    normals = evidence.solution.rig.R_cam0_target[:, :, 2]
    mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    return float(np.sqrt(np.mean(np.arccos(np.clip(normals @ mean, -1, 1)) ** 2)))


def _attitudes(evidence: CamerasEvidence) -> list[Finding]:
    spread, count = attitude_spread(evidence), len(evidence.solution.views)
    if spread >= _FEW_ATTITUDES or count < _FEW_VIEWS:
        return []
    one = spread < _ONE_ATTITUDE
    return [
        make_finding(
            "attitudes-alike", alike="one and the same" if one else "nearly the same", count=count, spread=spread
        )
    ]


def listed(words: Sequence[str]) -> str:
    """Return "a", "a and b", or "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
