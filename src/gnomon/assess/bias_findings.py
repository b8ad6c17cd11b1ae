"""Biases that change while a recording lasts: what their sigma covers and what it does not."""

from collections.abc import Mapping, Sequence

from ..estimate.trust.cluster_trust import Instability
from ..findings import Finding, make_finding

_SHOWN_IN = {"accelerometer": "m/s^2", "gyroscope": "rad/s", "magnetometer": "of the field"}


def bias_findings(instabilities: Sequence[Instability], per_si: Mapping[str, float]) -> list[Finding]:
    """Say which biases differ between parts of the recording that follow each other, and by how much.

    Parameters
    ----------
    instabilities : of the biases
    per_si : triad -> its unit per SI unit
    """
    findings: list[Finding] = []
    for one in instabilities:
        if not one.proven:
            continue
        triad = one.block.split(".")[1]
        scale = 1 / per_si[triad]
        findings.append(
            make_finding(
                "bias-instability/recordings",
                triad=triad,
                moved=scale * one.size,
                unit=_SHOWN_IN[triad],
                where=one.where,
                sigmas=one.size / one.sigma,
            )
        )
    return findings
