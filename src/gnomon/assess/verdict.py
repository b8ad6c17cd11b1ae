"""What verdicts on calibrations of any kind have in common."""

from ..calibration import Gravity, Verdict
from ..findings import Finding, Severity
from ..units import STANDARD_GRAVITY_M_S2
from .causes import SEVERITIES, causes_first

_ON_EARTH_M_S2 = 9.76, 9.84

__all__ = ["SEVERITIES", "graded", "gravity_findings", "verdict_of", "worst_first"]


def verdict_of(findings: tuple[Finding, ...]) -> Verdict:
    """Return fail where a problem was found, warn where a warning was, else pass."""
    severities = {finding.severity for finding in findings}
    return "fail" if "problem" in severities else "warn" if "warning" in severities else "pass"


def graded(value: float, warn: float, fail: float) -> Severity:
    """Return "problem" beyond fail, "warning" beyond warn, "good" else."""
    return "problem" if not value <= fail else "warning" if value > warn else "good"


def worst_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings by severity, causes before what follows from them; see `causes`."""
    return causes_first(findings)


def gravity_findings(gravity: Gravity) -> list[Finding]:
    """Say aloud what was taken for gravity."""
    relative = gravity.sigma / gravity.value
    least, most = _ON_EARTH_M_S2
    if not least - gravity.sigma < gravity.value < most + gravity.sigma:
        return [
            Finding(
                severity="warning",
                code="gravity",
                message=f"Gravity is {gravity.value:.5f} m/s^2 ({gravity.source}); on Earth it is {least} to {most}.",
                consequence=f"All accelerometer scales are wrong by up to "
                f"{100 * abs(gravity.value / STANDARD_GRAVITY_M_S2 - 1):.2g} %, and what correlates with them.",
                cure="State --latitude (and --altitude), or the local value in m/s^2 with --gravity.",
            )
        ]
    if relative < 1e-3:
        return [
            Finding(
                severity="good",
                code="gravity",
                message=f"Gravity is {gravity.value:.5f} m/s^2 ({gravity.source}).",
            )
        ]
    return [
        Finding(
            severity="info",
            code="gravity",
            message=f"Gravity is taken as {gravity.value:.5f} +- {gravity.sigma:.2g} m/s^2 ({gravity.source}).",
            consequence=f"All accelerometer scales share this {100 * relative:.1f} % uncertainty.",
            cure="State --latitude (and --altitude), or --gravity, to remove it.",
        )
    ]
