"""Biases that change while a recording lasts: what their sigma covers and what it does not."""

from collections.abc import Mapping, Sequence

from ..estimate.trust.cluster_trust import Instability
from ..findings import Finding

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
            Finding(
                severity="info",
                code="bias-instability",
                message=f"The {triad}'s bias changed during the recording by {scale * one.size:.2g} "
                f"{_SHOWN_IN[triad]} ({one.where}), {one.size / one.sigma:.1f} times what its noise explains.",
                consequence="The bias given is the mean over this recording, and so is its sigma. After the next "
                "switching on, or in another warmth, expect a change at least as large.",
                cure="Let the sensor warm up before recording, and estimate the bias anew wherever the sensor is used.",
            )
        )
    return findings
