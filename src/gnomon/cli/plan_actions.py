"""What `gnomon plan` and `gnomon plan-imu` do."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from . import plan_command
from .results import UNUSABLE, USABLE, say_assumptions
from .terminal import Terminal
from .use_option import read_use_option

if TYPE_CHECKING:
    from pathlib import Path

    from ..calibrate.planning import PlanResult

_VERDICTS = {
    "pass": ("such a recording would do", "bold green"),
    "warn": ("such a recording would not quite do", "bold yellow"),
    "fail": ("such a recording would not do", "bold red"),
}


def plan(command: plan_command.Plan | plan_command.PlanImu, terminal: Terminal) -> int:
    """Predict a recording, say what it would tell and what would help, and return the exit code."""
    from ..calibrate.planning import plan as predicted
    from ..calibrate.planning import read_hardware

    use = read_use_option(command.use)
    if isinstance(command, plan_command.Plan):
        hardware = read_hardware(command.cam, command.target, command.imu)
    else:
        hardware = read_hardware(imu=command.imu)
    assumptions = _unplanned(command.imu, hardware.others)
    say_assumptions(assumptions, terminal)
    result = predicted(command.plan, hardware, use, seed=command.seed, progress=terminal.progress)
    terminal.close()
    _say(result, terminal)
    terminal.document({**_document(result), "assumptions": assumptions})
    return UNUSABLE if result.calibration.verdict == "fail" else USABLE


def _unplanned(imu: "Path | None", others: tuple[str, ...]) -> list[str]:
    """Return a sentence on the IMUs of a file that are not planned."""
    return [f"{imu}: its first IMU is planned; of {', '.join(others)} nothing is predicted."] if others else []


def _say(result: "PlanResult", terminal: Terminal) -> None:
    from ..assess.needs import number_words, offers
    from ..requirements import QUANTITIES
    from . import summary

    calibration = result.calibration
    use = calibration.assessment.trust.use
    meaning, style = _VERDICTS[calibration.verdict]
    terminal.say(f"{calibration.verdict}: {meaning}" + (f" for {use}" if use else ""), style)
    needed = {need.block: need for need in result.needs}
    terminal.say(f"\n{'predicted standard deviation':<44}{'needed':>12}")
    for offer in offers(calibration):
        if not offer.sigma > 0:
            continue
        quantity = QUANTITIES[offer.quantity]
        predicted = f"{number_words(offer.sigma / quantity.size)} {quantity.unit}"
        need = needed.get(offer.words)
        limit = "" if need is None else f"{number_words(need.needed)}  {need.verdict}"
        terminal.say(f"  {offer.words:<38}{predicted:>16}{limit:>14}".rstrip())
    if lines := list(summary.advice(calibration.assessment.findings)):
        terminal.say("\n" + "\n".join(lines))
    if result.changes:
        terminal.say("\nwhat would help, the worst quantity over what is needed of it")
    for change in result.changes:
        terminal.say(f"  {number_words(change.before)} -> {number_words(change.worst)}  {change.words}")


def _document(result: "PlanResult") -> dict[str, Any]:
    from ..calibration import parameters

    calibration = result.calibration
    return {
        "verdict": calibration.verdict,
        "exit_code": UNUSABLE if calibration.verdict == "fail" else USABLE,
        "use": calibration.assessment.trust.use,
        "needs": [asdict(need) for need in result.needs],
        "sigma": {path: calibration.sigma(path) for path, _ in parameters(calibration.imus, calibration.cameras)},
        "weak": [asdict(weak) for weak in result.weak],
        "findings": [asdict(finding) for finding in calibration.assessment.findings],
        "changes": [asdict(change) for change in result.changes],
    }
