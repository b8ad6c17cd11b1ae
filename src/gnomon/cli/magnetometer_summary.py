"""A magnetometer's calibration on one screen."""

from collections.abc import Iterator

import numpy as np

from ..calibration import Calibration
from ..recording import Floats
from ..triad_diagnostics import TriadDiagnostics
from .summary import common_decimals


def facts(calibration: Calibration, diagnostics: TriadDiagnostics) -> Iterator[str]:
    """Yield lines on hard and soft iron, dip, and how well the strength of the field is predicted."""
    found = calibration.assessment
    sensor = calibration.imus["imu0"].magnetometer
    assert sensor is not None
    sigma = calibration.sigma("imu0.magnetometer.bias")
    yield f"  hard iron          {_numbers(sensor.bias, sigma)} {sensor.unit}"
    shape, spread = soft_iron(sensor.sensitivity), _sigma(sensor.sensitivity, calibration)
    yield f"  soft iron          {_numbers(100 * shape[:3], 100 * spread[:3])} % (scales)"
    yield f"                     {_numbers(1e3 * shape[3:], 1e3 * spread[3:])} mrad (xy xz yz)"
    if diagnostics.dip is not None:
        dip = np.degrees([diagnostics.dip.estimated_rad, diagnostics.dip.sigma_rad])
        yield f"  dip of the field   {dip[0]:.2f} +- {dip[1]:.2f} deg below the horizontal"
    noise = diagnostics.noise
    yield f"  strength, samples  {100 * noise['magnetometer.error_std']:.3g} % rms, robustly " + (
        f"{100 * noise['magnetometer.error_spread']:.3g} %"
    )
    yield f"  error on unseen    {100 * found.holdout.field_rms:.3g} % of the field (rms)"
    yield f"  stretches          {found.intervals_used} used of {found.intervals_found}"
    yield f"  model, body frame  {found.model}, {calibration.frame}; field in {sensor.field_unit}"


def soft_iron(sensitivity: Floats) -> Floats:
    """Return how far the scales of x, y, z are off their mean, then the axes off square, xy xz yz [rad], (6,)."""
    length = np.linalg.norm(sensitivity, axis=1)
    rows = sensitivity / length[:, None]
    cosines = np.array([rows[0] @ rows[1], rows[0] @ rows[2], rows[1] @ rows[2]])
    return np.concatenate([length / length.mean() - 1, np.arcsin(np.clip(cosines, -1, 1))])


def _sigma(sensitivity: Floats, calibration: Calibration) -> Floats:
    """Return the sigmas of `soft_iron`, (6,)."""
    step = 1e-6 * float(np.abs(sensitivity).max())
    moves = step * np.eye(9).reshape(9, 3, 3)
    jacobian = np.stack([soft_iron(sensitivity + m) - soft_iron(sensitivity - m) for m in moves], axis=1) / (2 * step)
    covariance = jacobian @ calibration.covariance("imu0.magnetometer.sensitivity") @ jacobian.T
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _numbers(values: Floats, sigma: Floats) -> str:
    decimals = common_decimals(sigma)
    return "  ".join(f"{v:.{decimals}f} +- {s:.{decimals}f}" for v, s in zip(values, sigma, strict=True))
