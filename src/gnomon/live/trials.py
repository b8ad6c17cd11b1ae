"""Checks and calibrations of what was recorded so far, in a process of their own, so that nothing waits for them.

It is started with `python -P -m gnomon.live.trials`: in comes what is to be calibrated, out goes what came of it, until
nothing more is to come.
"""

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from dataclasses import fields, replace
from importlib import import_module
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
_AT_WORK = ("..assess.checks.rig_doctor", "..assess.needs", "..calibrate.camera_imu", "..readers.rig.folder")
"""What takes its time to import, and is wanted when the first question comes."""
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


class Trials:
    """Checks and calibrations in a process, one at a time; to begin takes it several times as long as to check.

    Attributes
    ----------
    outcome : of the last one; None where the process was lost
    """

    def __init__(self) -> None:
        command, place = python_command("gnomon.live.trials"), python_environment()
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=place
        )
        self.outcome: TrialOutcome | None = None
        self._thread = Thread()

    @property
    def at_work(self) -> bool:
        """Whether the last one is not at its end."""
        return self._thread.is_alive()

    @property
    def lost(self) -> bool:
        """Whether the process ended."""
        return self._process.poll() is not None

    def begin(
        self,
        recording: Recording,
        target: Target,
        use: Use | None = None,
        folder: Path | None = None,
        *,
        units: Units | None = None,
        calibrates: bool = True,
    ) -> None:
        """Begin with the next one.

        Parameters
        ----------
        recording : so far
        target : the board
        use : of cameras with an IMU, what they are for
        folder : of those, with the samples and what is known of the IMU
        units : of the samples, as far as they are stated
        calibrates : whether it is more than a check of cameras and IMU together
        """
        stated = {item.name: getattr(target, item.name) for item in fields(target) if item.init}
        message = pickle.dumps((recording, stated, use, folder, units, calibrates))
        self._thread = Thread(target=self._ask, args=(message,), daemon=True)
        self._thread.start()

    def _ask(self, message: bytes) -> None:
        asked, answers, self.outcome = self._process.stdin, self._process.stdout, None
        assert asked is not None
        assert answers is not None
        with suppress(OSError, EOFError, ValueError, pickle.UnpicklingError):  # a ValueError: closed meanwhile
            asked.write(message)
            asked.flush()
            self.outcome = TrialOutcome(**pickle.load(answers))

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        with suppress(OSError), self._process:  # of a request that it no longer reads
            pass
        if self.at_work:
            self._thread.join(timeout=5.0)


def try_calibration(recording: Recording, target: Target, use: Use | None = None) -> TrialOutcome:
    """Calibrate, and return what came of it; what fails is an outcome, too."""
    from ..assess.needs import judge_for_use, needs_of_use
    from ..calibrate.camera_imu import calibrate_camera_imu
    from ..calibrate.cameras import calibrate_cameras
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
    from ..readers.rig.folder import imu_files, read_imu

    stated = folder / "imu.yaml"
    known = read_imus(stated)["imu0"] if stated.is_file() else None
    files = imu_files(folder)["imu0"]
    return {"imu0": read_imu("imu0", files, known, units=units or Units(), sources=[], notes=[])}


def answer_trials() -> None:
    """Answer what comes over the standard input, to its end."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between
    for name in _AT_WORK:
        import_module(name, __package__)
    with suppress(EOFError):
        while True:
            given, stated, use, folder, units, calibrates = pickle.load(sys.stdin.buffer)
            recording = given if folder is None else replace(given, imus=_samples_in(folder, units))
            target = Target(**stated)
            outcome = try_calibration(recording, target, use) if calibrates else TrialOutcome()
            if recording.imus:
                outcome = replace(outcome, faults=check_setup(recording, target))
            found = {item.name: getattr(outcome, item.name) for item in fields(outcome)}
            pickle.dump(found, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()


if __name__ == "__main__":
    answer_trials()
