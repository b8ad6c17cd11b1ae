"""What a camera-IMU estimation says of single faults: wrong corners, a bias that ran away, a trajectory in pieces."""

from collections.abc import Sequence

import numpy as np

from ..diagnostics import BiasTrack, CameraImuDiagnostics, CornerFit
from ..findings import Finding

_FAR = 5.0  # sigmas
_FAR_INFO, _FAR_WARN = 0.005, 0.05
_ENDS = 0.15  # of the recording, over which the bias of its start and its end are taken
_WALKS, _LEAST_RAD_S = 5.0, np.radians(0.1)


def residual_findings(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Return findings of codes corners-outlying and gyroscope-drift."""
    findings = [finding for name, fit in diagnostics.corners.items() for finding in outlying_corners(name, fit)]
    for name, track in diagnostics.biases.items():
        if name.endswith(".gyroscope"):
            findings += _drift(name, track)
    return findings


def outlying_corners(name: str, fit: CornerFit) -> list[Finding]:
    """Return what to say where many corners lie far from where they should."""
    used = fit.frame_used[fit.frame] & np.isfinite(fit.residual[:, 0])
    if not used.any():
        return []
    size = np.linalg.norm(fit.residual[used], axis=1)
    far = size > _FAR * fit.sigma_px
    share = float(far.mean())
    if share < _FAR_INFO:
        return []
    many = share > _FAR_WARN
    return [
        Finding(
            severity="warning" if many else "info",
            code="corners-outlying",
            message=f"{100 * share:.2g} % of the corners of {name} lie more than {_FAR:.0f} sigma "
            f"({_FAR * fit.sigma_px:.2g} px) from where they should, {np.median(size[far]):.2g} px as a rule.",
            consequence="They count less and do little harm, as long as they are few and on no one side.",
            cure="Look at where they are (report): reflections, edges of the board, tags of other boards."
            if many
            else "",
        )
    ]


def _drift(name: str, track: BiasTrack) -> list[Finding]:
    """Say where a gyroscope's bias ran from one value to another, further than its random walk goes."""
    part = max(1, round(_ENDS * len(track.t_s)))
    change = track.value[-part:].mean(axis=0) - track.value[:part].mean(axis=0)
    size = float(np.linalg.norm(change))
    walked = track.random_walk * np.sqrt(3 * max(float(np.ptp(track.t_s)), 1e-9))
    if not size > max(_WALKS * walked, _LEAST_RAD_S):
        return []
    return [
        Finding(
            severity="warning",
            code="gyroscope-drift",
            message=f"The bias of {name} drifted by {np.degrees(size):.2g} deg/s from the start to the end of the "
            f"recording, {size / max(walked, 1e-12):.2g} times as far as its random walk goes.",
            consequence="The drift is followed, and the published bias is its mean; it will be another one tomorrow.",
            cure="Let the sensor warm up for ten minutes before you record, or state a larger gyroscope_random_walk in "
            "imu.yaml.",
        )
    ]


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
        Finding(
            severity="info",
            code="trajectory-cut",
            message=f"The trajectory was cut into {segments} pieces, at gaps of "
            f"{first if others else 'the IMU'} or where it turned by more than a full turn.",
            consequence=f"{lost if others else 'Nothing'} is lost but the little that a piece's ends tell.",
            cure=f"If it is {first} that lost samples, let another one be the first IMU." if others else "",
        )
    ]
