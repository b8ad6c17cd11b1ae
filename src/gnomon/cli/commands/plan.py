"""The commands that plan a recording."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...simulate.planned import CameraImuPlan, ImuPlan
from ..command import CamFile, Command, FileOption, Flat, PlannedUse
from ..files import read_use_option
from ..results import UNUSABLE, USABLE, print_assumptions, print_findings
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...calibrate.planning import PlanResult


_VERDICTS = {
    "pass": ("such a recording would do", "bold green"),
    "warn": ("such a recording would not quite do", "bold yellow"),
    "fail": ("such a recording would not do", "bold red"),
}
_HELPS = 0.95  # of the worst quantity: what lowers it by less is not worth a word


@dataclass(frozen=True, kw_only=True)
class Plan(Command):
    """Predict how well cameras and an IMU would be calibrated by a recording that is still to be made.

    Nothing is recorded: the motion is simulated, and the estimation's own equations tell the standard deviations.

    Examples
    --------
    $ gnomon plan --for vio
    """

    cam: CamFile = None
    """Kalibr's file of the cameras, or a calibration.yaml (default: one camera of 640 x 480 px)."""
    imu: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the IMU's noise (default: that of a consumer sensor); of several IMUs the first is planned."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board (default: an AprilGrid of 6 x 6 tags of 88 mm)."""
    use: PlannedUse = None
    seed: int = 0
    """Of the path, of which only kind and size are planned."""
    plan: Annotated[CameraImuPlan, Flat] = field(default_factory=CameraImuPlan)

    def run(self, terminal: Terminal) -> int:
        """Predict a recording, print what it would tell and what would help, and return the exit code."""
        return _plan(self, terminal)


@dataclass(frozen=True, kw_only=True)
class PlanImu(Command):
    """Predict how well an IMU would be calibrated by a recording with rests that is still to be made.

    Examples
    --------
    $ gnomon plan-imu --for ahrs
    """

    imu: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the IMU's noise (default: that of a consumer sensor)."""
    use: PlannedUse = None
    seed: int = 0
    """Of the attitudes, of which only number and spread are planned."""
    plan: Annotated[ImuPlan, Flat] = field(default_factory=ImuPlan)

    def run(self, terminal: Terminal) -> int:
        """Predict a recording, print what it would tell and what would help, and return the exit code."""
        return _plan(self, terminal)


def _plan(command: Plan | PlanImu, terminal: Terminal) -> int:
    """Predict a recording, say what it would tell and what would help, and return the exit code."""
    from ...calibrate.planning import plan as predicted
    from ...calibrate.planning import read_hardware

    use = read_use_option(command.use)
    if isinstance(command, Plan):
        hardware = read_hardware(command.cam, command.target, command.imu)
    else:
        hardware = read_hardware(imu=command.imu)
    others = ", ".join(hardware.others)
    assumptions = [f"{command.imu}: its first IMU is planned; of {others} nothing is predicted."] if others else []
    print_assumptions(assumptions, terminal)
    result = predicted(command.plan, hardware, use, seed=command.seed, progress=terminal.progress)
    _print(result, terminal)
    terminal.document({**_document(result), "assumptions": assumptions})
    return UNUSABLE if result.calibration.verdict == "fail" else USABLE


def _print(result: "PlanResult", terminal: Terminal) -> None:
    from ...assess.needs import achieved_quantities, number_words
    from ...options.requirements import QUANTITIES

    calibration = result.calibration
    use = calibration.assessment.trust.use
    meaning, style = _VERDICTS[calibration.verdict]
    terminal.print(f"{calibration.verdict}: {meaning}" + (f" for {use}" if use else ""), style)
    needed = {need.block: need for need in result.needs}
    terminal.print(f"\n{'predicted standard deviation':<44}{'needed':>12}")
    for offer in achieved_quantities(calibration):
        if not offer.sigma > 0:
            continue
        quantity = QUANTITIES[offer.quantity]
        predicted = f"{number_words(offer.sigma / quantity.size)} {quantity.unit}"
        need = needed.get(offer.words)
        limit = "" if need is None else f"{number_words(need.needed)}  {need.verdict}"
        terminal.print(f"  {offer.words:<38}{predicted:>16}{limit:>14}".rstrip())
    print_findings(calibration.assessment.findings, terminal)
    helpful = [change for change in result.changes if change.worst < _HELPS * change.before]
    if helpful:
        terminal.print("\nwhat would help, the worst quantity over what is needed of it")
    for change in helpful:
        terminal.print(f"  {number_words(change.before)} -> {number_words(change.worst)}  {change.words}")


def _document(result: "PlanResult") -> dict[str, Any]:
    from ...results.calibration import calibration_parameters

    calibration = result.calibration
    return {
        "verdict": calibration.verdict,
        "exit_code": UNUSABLE if calibration.verdict == "fail" else USABLE,
        "use": calibration.assessment.trust.use,
        "needs": result.needs,
        "sigma": {
            path: calibration.sigma(path) for path, _ in calibration_parameters(calibration.imus, calibration.cameras)
        },
        "weak": result.weak,
        "findings": calibration.assessment.findings,
        "changes": result.changes,
    }
