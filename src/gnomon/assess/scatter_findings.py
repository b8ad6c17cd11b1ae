"""Scatter well beyond the sensor's white noise at rest, which a fit takes into its sigmas."""

import numpy as np

from ..estimate.multiposition.noise_levels import rotation_variance
from ..findings import Finding
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
        Finding(
            severity="warning" if extra > _ROTATION_WARN_RAD else "info",
            code="beyond-noise",
            message=f"Rotations scatter by {1e3 * extra:.2g} mrad, {extra / noise:.0f} times what the gyroscope's "
            f"white noise at rest makes of them ({1e3 * noise:.2g} mrad).",
            consequence="All sigmas contain it as if it were noise; as a rule it is not, and errs the same way in many "
            "rotations.",
            cure="Look for the cause: gyroscope or accelerometer were remounted or knocked, the scale drifted while it "
            "warmed up, the gyroscope feels accelerations (--model g-sensitivity) or vibration, or its clock is not "
            "that of the accelerometer. Turn more slowly, and record again to compare.",
        )
    ]
