"""What verdicts on calibrations of any kind have in common."""

from ..calibration import Gravity, Verdict
from ..findings import Finding, Severity, make_finding
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
            make_finding(
                "gravity/assumed",
                gravity=gravity.value,
                source=gravity.source,
                least=least,
                most=most,
                off=abs(gravity.value / STANDARD_GRAVITY_M_S2 - 1),
            )
        ]
    if relative < 1e-3:
        return [make_finding("gravity/known", gravity=gravity.value, source=gravity.source)]
    return [
        make_finding(
            "gravity/implausible", gravity=gravity.value, sigma=gravity.sigma, source=gravity.source, relative=relative
        )
    ]
