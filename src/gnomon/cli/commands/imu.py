"""The command that calibrates an IMU alone."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ...options import ImuOptions
from ..command import (
    CertificateFacts,
    Command,
    Flat,
    ForUse,
    PosesInput,
    Report,
    output_option,
)
from ..files import check_folder, default_folder, read_priors, read_use_option, result_folder
from ..results import judged_result, print_assumptions, print_result, result_with_reading, summary_lines, write_result
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...recording import Recording


@dataclass(frozen=True, kw_only=True)
class Imu(Command):
    """Calibrate accelerometer and gyroscope from hand-held recordings, or an accelerometer alone from static poses.

    Let the sensor rest for about 50 s, then turn it by hand into many different attitudes and let it rest for a few
    seconds in each. Several recordings of one sensor, such as of several days, join as recordings: what the sensor
    itself changes from one to the next (turn-on bias, temperature) is estimated, and is in the sigmas.

    Examples
    --------
    $ gnomon imu recording.csv
    $ gnomon imu monday.csv tuesday.csv --for ahrs
    $ gnomon imu log.txt --columns "t ax ay az gx gy gz" --units "g deg/s ms"
    """

    recording: Annotated[PosesInput, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-imu beside the recording)."""
    use: ForUse = None
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)
    options: Annotated[ImuOptions, Flat] = field(default_factory=ImuOptions)

    def run(self, terminal: Terminal) -> int:
        """Calibrate, write the folder of the result, and return the exit code."""
        from ...calibrate.imu import calibrate_imu
        from ...readers.recordings import read_several

        source = self.recording
        check_folder(self.output or default_folder(source.paths, "imu"))  # before the work
        use = read_use_option(self.use)
        terminal.progress("reading the recording")
        known = read_priors(self.options.prior)
        recordings = read_several(*source.paths, **source.table)
        recordings = [known.known_of(recording) for recording in recordings]
        assumptions = _assumptions(recordings)
        print_assumptions(assumptions, terminal)  # before anything fails: they often explain why
        folder = self.output or default_folder(source.paths, "imu", joined=len(recordings) > 1)
        with result_folder(folder, "imu") as staging:
            options = replace(self.options, prior=known.stated)
            result = calibrate_imu(recordings, options, progress=terminal.progress, prior=known.calibrations)
            result = result_with_reading(judged_result(result, use), source.table | self.certificate.stated)
            write_result(result, staging, report=self.report, terminal=terminal)
        lines = summary_lines(result.calibration)
        return print_result(result.calibration, lines, folder, assumptions, terminal, source=source)


def _assumptions(recordings: "Sequence[Recording]") -> list[str]:
    """Return what had to be assumed; of several recordings each once, with those of which it was."""
    from ...calibrate.steps.preparation import recording_names

    if len(recordings) == 1:
        return list(recordings[0].assumptions)
    of: dict[str, list[str]] = {}
    for name, recording in zip(recording_names(recordings), recordings, strict=True):
        for sentence in recording.assumptions:
            of.setdefault(sentence.removeprefix(f"{name}: "), []).append(name)
    words = ["all recordings" if len(names) == len(recordings) else ", ".join(names) for names in of.values()]
    return [f"{who}: {sentence}" for who, sentence in zip(words, of, strict=True)]
