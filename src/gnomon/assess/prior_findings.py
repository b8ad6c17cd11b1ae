"""What was known beforehand, and whether the recording agrees with it."""

import numpy as np

from ..findings import Finding, make_finding
from ..recording import Floats
from .priors import NAMES, KnownScalars, Prior

_TELLS = 0.1  # information of the recording against that of the prior, from which on it can contradict it
_SURE = 3.7  # sigmas of a normal variable: one healthy recording of ten thousand


def prior_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether the recording contradicts it.

    Parameters
    ----------
    values : (n,) estimate from the recording alone, of the first n of the 45 scalars in the order of `evidence.NAMES`
    covariance : (n, n)
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        chi2, degrees, worst = _disagreement(part, values, covariance)
        if chi2 > _limit(degrees):
            findings.append(make_finding("prior-disagrees/imu", chi2=chi2, degrees=degrees, worst_name=NAMES[worst]))
    return findings


def cameras_disagree(
    names: tuple[str, ...], difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats
) -> list[Finding]:
    """Return whether a recording contradicts what was known of its cameras, which the estimate rests on, too.

    Parameters
    ----------
    names : (n,) scalars
    difference : (n,) estimate minus prior
    prior : (n, n) covariance of the prior
    ordinary, covariance : (n, n) of the estimate, for independent errors and as it is published
    """
    chi2, degrees = _pulled(difference, prior, ordinary, covariance)
    if not degrees or chi2 <= _limit(degrees):
        return []
    worst = int(np.argmax(np.abs(difference) / np.sqrt(np.diag(prior))))
    return [make_finding("prior-disagrees/cameras", chi2=chi2, degrees=degrees, worst_name=names[worst])]


def pulled_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether an estimate that rests on it, too, contradicts it.

    For recordings that determine too little on their own.

    Parameters
    ----------
    values, covariance : as for `prior_findings`, of the estimate from both
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        shown = part.index < len(values)
        index = part.index[shown]
        estimated = covariance[np.ix_(index, index)]
        difference = values[index] - part.mean[shown]
        prior = np.asarray(np.linalg.inv(part.precision)[np.ix_(shown, shown)], dtype=np.float64)
        chi2, degrees = _pulled(difference, prior, estimated, estimated)
        if degrees and chi2 > _limit(degrees):
            worst = NAMES[int(index[np.argmax(np.abs(difference) / np.sqrt(np.diag(prior)))])]
            findings.append(make_finding("prior-disagrees/rig", chi2=chi2, degrees=degrees, worst=worst))
    return findings


def _pulled(difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats) -> tuple[float, int]:
    """Return chi squared of recording minus prior, from an estimate that both made, and its degrees of freedom.

    In coordinates in which the prior's covariance is I and the recording's information diagonal, lambda, the estimate
    differs from the prior by w, and the recording alone would by w (1 + 1 / lambda), with the variance 1 + f / lambda
    where f is by how much its errors are larger than independent ones.
    """
    left = np.linalg.inv(np.linalg.cholesky(prior))
    kept, axes = np.linalg.eigh(left @ ordinary @ left.T)  # 1 / (1 + lambda)
    told = kept < 1 / (1 + _TELLS)
    if not told.any():
        return 0.0, 0
    information = 1 / np.maximum(kept[told], 1e-12) - 1
    white = axes[:, told].T @ left
    wider = np.maximum(np.einsum("ij,jk,ik->i", white, covariance, white) / kept[told], 1.0)
    by_recording = (white @ difference) ** 2 * (1 + 1 / information) ** 2
    return float(np.sum(by_recording / (1 + wider / information))), int(told.sum())


def prior_used(known: Prior) -> list[Finding]:
    """Return what was taken from elsewhere; nothing where nothing was."""
    if not known:
        return []
    paths = {NAMES[i].partition("[")[0].removeprefix("imu0.") for part in known.known for i in part.index}
    held = {NAMES[i].partition("[")[0].removeprefix("imu0.") for i in np.flatnonzero(known.fixed)}
    parts = [f"known beforehand: {', '.join(sorted(paths))}"] if paths else []
    parts += [f"held: {', '.join(sorted(held))}"] if held else []
    return [make_finding("prior-used", parts="; ".join(parts))]


def _disagreement(part: KnownScalars, values: Floats, covariance: Floats) -> tuple[float, int, int]:
    """Return chi squared of recording minus prior, its degrees of freedom, and the place of the worst scalar."""
    shown = part.index < len(values)
    index = part.index[shown]
    difference = values[index] - part.mean[shown]
    joint = covariance[np.ix_(index, index)] + np.linalg.inv(part.precision)[np.ix_(shown, shown)]
    sigma = np.sqrt(np.diag(joint))
    z = difference / sigma
    chi2 = z @ np.linalg.solve(joint / np.outer(sigma, sigma), z)
    return float(chi2), len(z), int(index[np.argmax(np.abs(z))])


def _limit(degrees: int) -> float:
    """Return the quantile of chi squared, by Wilson and Hilferty's approximation."""
    return degrees * (1 - 2 / (9 * degrees) + _SURE * np.sqrt(2 / (9 * degrees))) ** 3
