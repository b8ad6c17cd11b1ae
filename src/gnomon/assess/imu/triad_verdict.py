"""What verdicts on calibrations from known magnitudes have in common: accelerometer poses, turntable, magnetometer."""

from collections.abc import Sequence

import numpy as np

from ...estimate.triads.triad import TriadFit
from ...estimate.triads.triad_poses import S_
from ...estimate.triads.triad_trust import merge_trusts
from ...estimate.trust.cluster_trust import RobustCovariance
from ...findings import Finding, make_finding
from ...recording import Floats
from ..verdict import bias_findings, model_incomplete, parts_disagree

_BEYOND_NOISE = 3.0  # times the noise of a mean, from where the noise is not the story
_SCATTER_WARN = 2e-3  # of the magnitude
_FEW_REDUNDANT = 3


def relative_sigmas(fit: TriadFit, covariance: Floats | None = None) -> Floats:
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
    sigma = np.sqrt(np.maximum(np.diag(given), 0.0)).reshape(3, 3)
    return np.asarray(sigma / np.linalg.norm(fit.sensitivity, axis=1)[:, None], dtype=np.float64)


def triad_trust_findings(trusts: Sequence[tuple[RobustCovariance, TriadFit]]) -> list[Finding]:
    """Say where errors are larger than independent ones, whether parts agree, and which biases changed."""
    trust = merge_trusts([one.trust for one, _ in trusts])
    findings = [*model_incomplete(trust), *parts_disagree(trust.splits)]
    for one, fit in trusts:
        scale = float(np.abs(np.linalg.det(fit.sensitivity))) ** (1 / 3)
        findings += bias_findings(one.instabilities, {found.block.split(".")[1]: scale for found in one.instabilities})
    return findings


def redundancy_findings(fit: TriadFit) -> list[Finding]:
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


def scatter_findings(fit: TriadFit, noise_sigma: float, magnitude: float, unit: str) -> list[Finding]:
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
