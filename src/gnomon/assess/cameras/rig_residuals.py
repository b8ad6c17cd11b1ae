"""What a camera-IMU estimation says of single faults: wrong corners, a bias that ran away, a trajectory in pieces."""

from collections.abc import Sequence

import numpy as np

from ...findings import Finding, make_finding
from ...recording import Integers
from ...results.camera_diagnostics import BiasTrack, CameraImuDiagnostics, CornerFit, SignalFit
from ...results.result import Booleans

_FAR = 5.0  # sigmas
_FAR_INFO, _FAR_WARN = 0.005, 0.05
_OFTEN, _FEW, _NEARLY_ALL = 0.2, 0.1, 0.8  # of a point's sightings, of the board's points, of all far ones
_ENDS = 0.15  # of the recording, over which the bias of its start and its end are taken
_WALKS, _LEAST_RAD_S = 5.0, np.radians(0.1)
_APART_S, _WANDERS = 0.1, 0.5  # beyond what knots leave of fast motion; of sound recordings it is 0


def residual_findings(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Return findings of codes corners-outlying, gyroscope-drift and residuals-wander."""
    points = "corners" if diagnostics.scene is None else "landmarks"
    findings = [finding for name, fit in diagnostics.corners.items() for finding in outlying_corners(name, fit, points)]
    for name, track in diagnostics.biases.items():
        if name.endswith(".gyroscope"):
            findings += _drift(name, track)
    return findings + [
        finding for name, fit in diagnostics.signals.items() for finding in wandering_residuals(name, fit)
    ]


def wandering_residuals(name: str, fit: SignalFit) -> list[Finding]:
    """Say where a gyroscope's residuals last: no noise, and no bias that walks, is left over like that."""
    apart = max(round(_APART_S * (len(fit.t_s) - 1) / max(float(np.ptp(fit.t_s)), 1e-9)), 1)
    if not name.endswith(".gyroscope"):
        return []
    # Vibration comes back after a whole period, and not in between.
    correlation = min(residual_correlation(fit, max(apart // part, 1)) for part in (1, 2, 3, 4, 5, apart))
    if correlation < _WANDERS:
        return []
    return [make_finding("residuals-wander", name=name, correlation=correlation, apart_s=_APART_S)]


def residual_correlation(fit: SignalFit, apart: int = 1) -> float:
    """Return the correlation of the residuals of a triad that are so many samples apart."""
    residual = (fit.measured - fit.predicted)[fit.used]
    power = float(np.sum(residual**2))
    return float(np.sum(residual[apart:] * residual[:-apart])) / power if power > 0 else 0.0


def outlying_corners(name: str, fit: CornerFit, points: str = "corners") -> list[Finding]:
    """Return what to say where many corners, or whatever `points` are seen instead, lie far from where they should."""
    used = fit.frame_used[fit.frame] & np.isfinite(fit.residual[:, 0])
    if not used.any():
        return []
    size = np.linalg.norm(fit.residual[used], axis=1)
    far = size > _FAR * fit.sigma_px
    share = float(far.mean())
    if share < _FAR_INFO:
        return []
    many, place = share > _FAR_WARN, _one_place(fit.point[used], far) if points == "corners" else ""
    return [
        make_finding(
            "corners-outlying",
            severity="warning" if many else "info",
            case="place" if place else "many" if many else "",
            place=f" Nearly all of these are number {place} of the board." if place else "",
            share=share,
            points=points,
            name=name,
            far=_FAR,
            far_px=_FAR * fit.sigma_px,
            median_size=np.median(size[far]),
        )
    ]


def _one_place(point: Integers, far: Booleans) -> str:
    """Return the numbers of the few points of a board that are far so often that they make nearly all of what is."""
    seen, bad = np.bincount(point), np.bincount(point[far], minlength=int(point.max()) + 1)
    often = np.flatnonzero(bad > _OFTEN * np.maximum(seen, 1))
    few = len(often) <= _FEW * np.count_nonzero(seen) and bad[often].sum() > _NEARLY_ALL * far.sum()
    return ", ".join(map(str, often)) if few else ""


def _drift(name: str, track: BiasTrack) -> list[Finding]:
    """Say where a gyroscope's bias ran from one value to another, further than its random walk goes."""
    part = max(1, round(_ENDS * len(track.t_s)))
    change = track.value[-part:].mean(axis=0) - track.value[:part].mean(axis=0)
    size = float(np.linalg.norm(change))
    walked = track.random_walk * np.sqrt(3 * max(float(np.ptp(track.t_s)), 1e-9))
    if not size > max(_WALKS * walked, _LEAST_RAD_S):
        return []
    return [make_finding("gyroscope-drift/rig", name=name, size=size, ratio=size / max(walked, 1e-12))]


def cut_findings(segments: int, imus: Sequence[str]) -> list[Finding]:
    """Say that the trajectory has several pieces, and what that costs where there are several IMUs.

    Code: trajectory-cut.
    """
    if segments == 1:
        return []
    first, *others = imus
    lost = (
        f"In a gap of {first} neither frames nor the samples of {', '.join(others)} are used; apart from that nothing"
    )
    return [
        make_finding(
            "trajectory-cut",
            case="others" if others else "",
            segments=segments,
            first=first if others else "the IMU",
            lost=lost if others else "Nothing",
            imu=first,
        )
    ]
