"""What was known beforehand, and whether the recording agrees with it."""

import numpy as np

from ..evidence import NAMES, Evidence, Known
from ..findings import Finding
from ..recording import Floats

_SURE = 3.7  # sigmas of a normal variable: one healthy recording of ten thousand


def prior_findings(known: Evidence, values: Floats, covariance: Floats) -> list[Finding]:
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
            findings.append(
                Finding(
                    severity="warning",
                    code="prior-disagrees",
                    message=f"The recording contradicts what was stated beforehand: chi squared {chi2:.0f} for "
                    f"{degrees} directions, most of all in {NAMES[worst]}.",
                    consequence="The result lies between the two and agrees with neither.",
                    cure="Calibrate without --prior and compare; the sensor may be another one, or have changed.",
                )
            )
    return findings


def prior_used(known: Evidence) -> list[Finding]:
    """Return what was taken from elsewhere; nothing where nothing was."""
    if not known:
        return []
    paths = {NAMES[i].partition("[")[0].removeprefix("imu0.") for part in known.known for i in part.index}
    held = {NAMES[i].partition("[")[0].removeprefix("imu0.") for i in np.flatnonzero(known.fixed)}
    parts = [f"known beforehand: {', '.join(sorted(paths))}"] if paths else []
    parts += [f"held: {', '.join(sorted(held))}"] if held else []
    return [
        Finding(
            severity="info",
            code="prior-used",
            message=f"The result rests on other evidence than this recording, too; {'; '.join(parts)}.",
        )
    ]


def _disagreement(part: Known, values: Floats, covariance: Floats) -> tuple[float, int, int]:
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
