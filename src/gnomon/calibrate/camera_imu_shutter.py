"""Rolling shutters that nobody stated: the corners prove them, and the line delay is estimated jointly.

Every frame's pose is free in that proof (`assess.rig_lens`), so that no error of IMU or clock can pass for a shutter:
six standard deviations, and 1 ms from the first row to the last, below which an error of the lens may look the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..calibration import CameraCalibration, Covariance
from ..estimate.camera_imu.first_guess import Look
from ..findings import Finding
from ..options import CameraImuOptions
from ..recording import Recording

_CODE = "rolling-shutter"
LINE_DELAY = "line delay"
"""What is added to the model."""


def with_stated_shutters(recording: Recording, options: CameraImuOptions) -> Recording:
    """Return the recording, its cameras with the line delay that the options state."""
    delay_s = options.line_delay
    if delay_s is None:
        return recording
    cameras = {
        name: replace(frames, camera=replace(frames.camera, line_delay_s=delay_s))
        for name, frames in recording.cameras.items()
    }
    return replace(recording, cameras=cameras)


def with_line_delays(
    options: CameraImuOptions, found: Sequence[Look], findings: Sequence[Finding]
) -> tuple[CameraImuOptions, bool]:
    """Return options that estimate the line delays that the corners prove, and whether there is one that they added.

    Model "auto" adds those of cameras of which nobody said anything.
    """
    if options.model != "auto" or options.line_delay is not None:
        return options, False
    decided = {text.partition("=")[0] for text in (*options.fix, *options.free, *options.prior)}
    added = [
        f"{look.name}.line_delay"
        for look in found
        if _about(look.name, findings) and not look.frames.camera.line_delay_s
    ]
    added = [name for name in added if name not in decided]
    return replace(options, free=(*options.free, *added)), bool(added)


def shutters_estimated(
    findings: Sequence[Finding], cameras: Mapping[str, CameraCalibration], uncertainty: Covariance
) -> tuple[Finding, ...]:
    """Return the findings, those on shutters whose line delay was estimated with what came of it."""
    sigmas = dict(zip(uncertainty.names, np.sqrt(np.diag(uncertainty.matrix)).tolist(), strict=True))
    return tuple(_told(finding, cameras, sigmas) if finding.code == _CODE else finding for finding in findings)


def _told(finding: Finding, cameras: Mapping[str, CameraCalibration], sigmas: Mapping[str, float]) -> Finding:
    name = finding.subject.partition(".")[0]
    sigma = sigmas.get(finding.subject, 0.0)
    if not sigma:
        return finding
    delay = cameras[name].camera.line_delay_s
    return replace(
        finding,
        severity="info",
        consequence=f"The line delay was estimated jointly: {1e6 * delay:.4g} +- {1e6 * sigma:.2g} us.",
        cure=f"State it next time, --line-delay {delay:.4g}.",
    )


def _about(name: str, findings: Sequence[Finding]) -> bool:
    return any(finding.code == _CODE and finding.subject == f"{name}.line_delay" for finding in findings)
