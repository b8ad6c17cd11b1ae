"""A check or a calibration of what was recorded so far, in a process of its own, so that nothing waits for it.

It is started with `python -P -m gnomon.live.trials`: in comes what is to be calibrated, out goes what came of it.
"""

import os
import pickle
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from threading import Thread

from ..frozen import value_class
from ..models.target import Target
from ..options.requirements import GENERAL_RIG, Use
from ..processes import python_command, python_environment
from ..recording import ImuSamples, Recording
from ..units import Units
from .faults import Fault

_NICE = 10
_PASSED_OVER = frozenset({"stream-short", "frames-few", "motion-slow", "frame-gaps", "frame-rate", "frame-jitter"})
"""Findings of `gnomon check` that a longer recording mends, as a warning that clocks drift; or of images that were not
looked at: those that did not arrive are told elsewhere."""


@value_class(eq=True)
class TrialOutcome:
    """What came of a check, and of a calibration.

    Attributes
    ----------
    verdict : "pass", "warn" or "fail"; "" of a check alone
    advice : what to do, by its most severe finding; "" where nothing is wrong
    needs : what the use needs -> standard deviation over it
    faults : what is wrong with cameras and IMU together
    """

    verdict: str = ""
    advice: str = ""
    needs: tuple[tuple[str, float], ...] = ()
    faults: tuple[Fault, ...] = ()


class Trial:
    """One check or calibration, at work from now on.

    Parameters
    ----------
    recording : so far
    target : the board
    use : of cameras with an IMU, what they are for
    folder : of those, with the samples and what is known of the IMU
    units : of the samples, as far as they are stated
    calibrates : whether it is more than a check of cameras and IMU together
    """

    def __init__(
        self,
        recording: Recording,
        target: Target,
        use: Use | None = None,
        folder: Path | None = None,
        units: Units | None = None,
        *,
        calibrates: bool = True,
    ) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        stated = {item.name: getattr(target, item.name) for item in fields(target) if item.init}
        self._message = pickle.dumps((recording, stated, use, folder, units, calibrates))
        self.outcome: TrialOutcome | None = None
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether it came to an end; there is an outcome then, unless the process was lost."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        command, place = python_command("gnomon.live.trials"), python_environment()
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=place
        )
        answer, _ = self._process.communicate(self._message)
        if self._process.returncode == 0:
            self.outcome = TrialOutcome(**pickle.loads(answer))


def try_calibration(recording: Recording, target: Target, use: Use | None = None) -> TrialOutcome:
    """Calibrate, and return what came of it; what fails is an outcome, too."""
    from ..assess.needs import judge_for_use, needs_of_use
    from ..calibrate import calibrate_camera_imu, calibrate_cameras
    from ..errors import GnomonError

    try:
        if not recording.imus:
            calibration = calibrate_cameras(recording, target).calibration
        else:
            stated = None if use == GENERAL_RIG else use
            calibration = judge_for_use(calibrate_camera_imu(recording, target).calibration, stated)
    except GnomonError as error:
        return TrialOutcome(verdict="fail", advice=str(error))
    findings = sorted(
        (finding for finding in calibration.assessment.findings if finding.severity in {"problem", "warning"}),
        key=lambda finding: finding.severity != "problem",
    )
    needs = () if use is None else needs_of_use(calibration, use)
    return TrialOutcome(
        verdict=calibration.verdict,
        advice=f"{findings[0].message} {findings[0].cure}" if findings else "",
        needs=tuple((need.block, need.sigma / need.needed) for need in needs),
    )


def check_setup(recording: Recording, target: Target) -> tuple[Fault, ...]:
    """Check what was recorded so far, and return what no longer recording would mend."""
    from ..assess.checks.rig_doctor import check_corners

    return tuple(
        Fault(code=finding.code, text=f"{finding.message} {finding.cure}")
        for finding in check_corners(recording, target)
        if finding.severity in {"problem", "warning"} and finding.code not in _PASSED_OVER
        if (finding.severity, finding.code) != ("warning", "clock-drift")
    )


def _samples_in(folder: Path, units: Units | None) -> dict[str, ImuSamples]:
    """Return the samples so far, as the ordinary command reads them."""
    from ..formats.sensor_inputs import read_imus
    from ..readers.rig.camera_folder import imu_files
    from ..readers.rig.imu_stream import read_imu

    stated = folder / "imu.yaml"
    known = read_imus(stated)["imu0"] if stated.is_file() else None
    files = imu_files(folder)["imu0"]
    return {"imu0": read_imu("imu0", files, known, units=units or Units(), sources=[], notes=[])}


def answer_request() -> None:
    """Answer what comes over the standard input."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between
    recording, stated, use, folder, units, calibrates = pickle.load(sys.stdin.buffer)
    if folder is not None:
        recording = replace(recording, imus=_samples_in(folder, units))
    target = Target(**stated)
    outcome = try_calibration(recording, target, use) if calibrates else TrialOutcome()
    if recording.imus:
        outcome = replace(outcome, faults=check_setup(recording, target))
    found = {item.name: getattr(outcome, item.name) for item in fields(outcome)}
    pickle.dump(found, answers, protocol=pickle.HIGHEST_PROTOCOL)
    answers.flush()


if __name__ == "__main__":
    answer_request()
