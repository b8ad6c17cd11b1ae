"""Scatter well beyond the sensor's white noise at rest, which a fit takes into its sigmas."""

import numpy as np

from ..estimate.multiposition.noise_levels import rotation_variance
from ..findings import Finding, make_finding
from .imu_tables import ImuEvidence

_BEYOND_NOISE = 3.0  # times the noise; healthy recordings of cheap sensors reach two
_ROTATION_WARN_RAD = 3e-3  # what general use needs of a gyroscope's axes


def rotation_scatter(evidence: ImuEvidence) -> list[Finding]:
    """Say that rotations end further from the measured gravity than the gyroscope's noise at rest explains."""
    fit = evidence.fit
    if not fit.rotation_used.any():
        return []
    noise = float(np.sqrt(np.median(rotation_variance(fit.data, fit.state)[fit.rotation_used])))
    extra = float(np.sqrt(fit.extra.rotation))
    if extra <= _BEYOND_NOISE * noise:
        return []
    return [
        make_finding(
            "beyond-noise/rotations",
            severity="warning" if extra > _ROTATION_WARN_RAD else "info",
            extra=extra,
            ratio=extra / noise,
            noise=noise,
        )
    ]
