"""What verdicts on calibrations from known magnitudes have in common: accelerometer poses, turntable, magnetometer."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...estimate.triads.triad_poses import S_
from ...estimate.trust.parts import RobustCovariance
from ...findings import Finding, make_finding
from ...recording import Floats
from ...results.result import Booleans
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from ..priors import NAMES, TRIADS
from ..verdict import bias_findings, model_incomplete, parts_disagree

if TYPE_CHECKING:
    from ...estimate.triads.triad import TriadFit

_BEYOND_NOISE = 3.0  # times the noise of a mean, from where the noise is not the story
_SCATTER_WARN = 2e-3  # of the magnitude
_FEW_REDUNDANT = 3
_UNIT_FACTOR = 1.5


ATTITUDES = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if i or j or k], float)
"""Axes that point up, or down, or halfway, (26, 3)."""


def attitude_words(attitude: Floats) -> str:
    """Name one of `ATTITUDES`, such as "x up and z down (tilted halfway)"."""
    ups = [f"{axis} {'up' if value > 0 else 'down'}" for axis, value in zip("xyz", attitude, strict=True) if value]
    return " and ".join(ups) + (" (tilted halfway)" if len(ups) > 1 else "")


def mean_scale(sensitivity: Floats) -> float:
    """Return the geometric mean of the scales of a sensitivity (3, 3)."""
    return float(np.abs(np.linalg.det(sensitivity))) ** (1 / 3)


def entry_sigmas(sensitivity: Floats, covariance: Floats) -> Floats:
    """Return the sigmas of the entries of a sensitivity relative to its rows, (3, 3), from their covariance (9, 9)."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(3, 3)
    return sigma / np.linalg.norm(sensitivity, axis=1)[:, None]


def scale_and_angle(sigma: Floats) -> tuple[float, float]:
    """Return the largest relative sigma of the scales, on the diagonal of (3, 3), and of the angles beside it."""
    return float(np.diag(sigma).max()), float(sigma[~np.eye(3, dtype=bool)].max())


def held_names(triad: str, held: Booleans) -> tuple[str, ...]:
    """Return the paths of those scalars of a triad that only an assumption holds."""
    return tuple(name for name, flag in zip(NAMES[TRIADS[triad]], held, strict=True) if flag)


def relative_sigmas(fit: "TriadFit", covariance: Floats | None = None) -> Floats:
    """Return the sigmas of the sensitivity's entries relative to its rows, (3, 3).

    Where the common scale of all axes is unknown they are those at a given common scale, which is the cube root of the
    determinant.

    Parameters
    ----------
    fit : of one triad
    covariance : (9, 9) of the sensitivity, where it is not that of the fit
    """
    given = fit.covariance[S_, S_] if covariance is None else covariance
    if not fit.scale_known:
        by_scale = np.linalg.inv(fit.sensitivity).T.ravel() / 3  # d log det^(1/3)
        common = given @ by_scale
        given = given - np.outer(common, common) / float(by_scale @ common)
    return entry_sigmas(fit.sensitivity, given)


def unit_findings(triad: Literal["accelerometer", "gyroscope"], sensitivity: Floats, unit: str) -> list[Finding]:
    """Warn where one scale is far from the others, or all from what the unit says, which counts say nothing of."""
    table = ACCELEROMETER_UNITS_M_S2 if triad == "accelerometer" else GYROSCOPE_UNITS_RAD_S
    nominal = table.get(unit)
    scales = np.linalg.norm(sensitivity, axis=1)
    usual = float(np.median(scales))
    odd = int(np.argmax(np.abs(np.log(scales / usual))))
    if not 1 / _UNIT_FACTOR < scales[odd] / usual < _UNIT_FACTOR:
        return [make_finding("unit/axis", triad=triad, axis="xyz"[odd], ratio=scales[odd] / usual)]
    ratio = mean_scale(sensitivity) * (nominal or np.nan)
    if 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR or not np.isfinite(ratio):
        return []
    others = [name for name, size in table.items() if size and 0.8 < ratio / (nominal or 1) * size < 1.25]
    by_rate = triad == "gyroscope" and not others
    fits = f" Its values look like {others[0]}." if others else ""
    if by_rate:
        fits = f" So they would be if the sample rate were {ratio:.3g} times what the timestamps say."
    return [make_finding("unit/far", triad=triad, ratio=ratio, unit=unit, fits=fits, case="rate" if by_rate else "")]


def triad_trust_findings(trusts: Sequence["tuple[RobustCovariance, TriadFit]"]) -> list[Finding]:
    """Say where errors are larger than independent ones, whether parts agree, and which biases changed."""
    from ...estimate.triads.triad_trust import merge_trusts  # not of an IMU that was turned by hand

    trust = merge_trusts([one.trust for one, _ in trusts])
    findings = [*model_incomplete(trust), *parts_disagree(trust.splits)]
    for one, fit in trusts:
        scale = mean_scale(fit.sensitivity)
        findings += bias_findings(one.instabilities, {found.block.split(".")[1]: scale for found in one.instabilities})
    return findings


def redundancy_findings(fit: "TriadFit") -> list[Finding]:
    """Say that there are hardly more poses than unknowns; nothing else shows errors."""
    if fit.degrees_of_freedom >= _FEW_REDUNDANT:
        return []
    return [
        make_finding(
            "few-redundant",
            equations=int(fit.equations[fit.used].sum()),
            unknowns=int(fit.free.sum()),
            degrees_of_freedom=max(fit.degrees_of_freedom, 0),
        )
    ]


def scatter_findings(fit: "TriadFit", noise_sigma: float, magnitude: float, unit: str) -> list[Finding]:
    """Say that the residuals are larger than the noise at rest, and what that means.

    Parameters
    ----------
    fit : of one triad
    noise_sigma : typical sigma of a mean by the noise at rest [SI]
    magnitude : typical magnitude [SI]
    unit : of both
    """
    if not noise_sigma > 0 or fit.extra_sigma <= _BEYOND_NOISE * noise_sigma:
        return []
    return [
        make_finding(
            "beyond-noise/magnitude",
            severity="warning" if fit.extra_sigma > _SCATTER_WARN * magnitude else "info",
            extra_sigma=fit.extra_sigma,
            unit=unit,
            ratio=fit.extra_sigma / noise_sigma,
        )
    ]
