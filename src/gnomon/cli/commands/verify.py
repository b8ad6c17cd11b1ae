"""The command that verifies a calibration by a fresh recording."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...errors import OptionError
from ..arguments import Argument
from ..command import (
    CamFile,
    CertificateFacts,
    Command,
    FileOption,
    Flat,
    ForUse,
    ImuFiles,
    Report,
    TableOptions,
    output_option,
    topics_of,
)
from ..files import default_folder, files_beside, read_use_option, result_folder, sources_of
from ..results import UNUSABLE, USABLE, print_assumptions, print_files, print_findings, result_files, with_statements
from ..terminal import Terminal, json_value

if TYPE_CHECKING:
    from ...assess.comparison.verification import Verification
    from ...formats.foreign import ForeignCalibration
    from ...models.target import Target
    from ...recording import Recording
    from ...results.calibration import Calibration

PAGE, DATA = "report.html", "verification.json"
UNTOLD = 3
"""Exit code where the recording cannot tell."""
_STYLES = {"holds": "bold green", "cannot tell": "bold yellow", "moved": "bold red"}


@dataclass(frozen=True, kw_only=True)
class Verify(Command, TableOptions):
    """Tell whether a calibration still holds, from a short fresh recording; if not, which number moved, and how far.

    The calibration may be of any program that `compare` reads. For an IMU let it rest in twelve attitudes or more, two
    seconds each, with turns between them; for cameras and an IMU wave them in front of the board for half a minute.
    Exit code 4 where the calibration has moved, 3 where the recording cannot tell.

    Examples
    --------
    $ gnomon verify monday-imu today.csv --for ahrs
    $ gnomon verify rig-camera-imu today.bag --target target.yaml
    """

    calibration: Annotated[str, Argument(positional=True, metavar="PATH[+PATH...]")]
    """A calibration.yaml or a result's folder, or another project's files, several of one calibration joined by +."""
    recording: Annotated[Path, Argument(positional=True)]
    """A fresh recording of the same sensors: anything that `imu`, `camera` or `camera-imu` take."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board, for cameras (default: target.yaml in the recording's folder)."""
    cam: CamFile = None
    """Kalibr's file of the cameras, where neither recording nor calibration state their lenses."""
    imu: ImuFiles = ()
    """Kalibr's file of the IMU's noise (default: imu.yaml in the recording's folder, where there is one)."""
    topics: Annotated[tuple[str, ...], Argument(metavar="NAME=TOPIC")] = ()
    """Topics of a bag, such as cam0=/left/image_raw imu0=/imu/data; guessed where it is clear."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for report.html and verification.json (default: NAME-verify beside the recording)."""
    use: ForUse = None
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)

    def run(self, terminal: Terminal) -> int:
        """Verify, write the report, and return the exit code."""
        from ...calibrate.verification import verify
        from ...formats.foreign_files import load_any

        folder = self.output or default_folder((self.recording,), "verify")
        use = read_use_option(self.use)
        ((_, paths),) = sources_of((self.calibration,))
        known = load_any(*paths)
        terminal.progress("reading the recording")
        recording, target = self._read(known, paths, terminal)
        print_assumptions(recording.assumptions, terminal)
        found = verify(known, recording, target, use=use, progress=terminal.progress)
        found = with_statements(found, self.certificate, paths)
        if self.report:
            _write(found, folder, terminal, f"{self.calibration}, verified by {self.recording.name}, for {found.use}")
        _print(found, terminal)
        files = result_files(folder, (PAGE, DATA)) if self.report else {}
        if files:
            print_files(folder, terminal, (PAGE, DATA))
        code = {"holds": USABLE, "moved": UNUSABLE, "cannot tell": UNTOLD}[found.state]
        terminal.document({**json_value(found), "exit_code": code, "files": files})
        return code

    def _read(
        self, known: "Calibration | ForeignCalibration", paths: list[Path], terminal: Terminal
    ) -> "tuple[Recording, Target | None]":
        lenses = {**known.cameras, **getattr(known, "lenses", {})}
        if not lenses:
            from ...readers.recordings import read

            return read(self.recording, **self.table), None
        from ...calibrate.steps.camera_imu_reading import read_camera_imu
        from ...calibrate.steps.camera_reading import read_camera_views

        stated, _ = files_beside(self.recording, {"cam": self.cam, "imu": self.imu, "target": self.target})
        if stated["target"] is None:
            raise OptionError("to verify cameras, name the board that they saw: --target target.yaml.")
        stated["cam"] = stated["cam"] or (paths[0] / "calibration.yaml" if paths[0].is_dir() else paths[0])
        shared: dict[str, Any] = {"units": self.units, "topics": topics_of(self.topics), "progress": terminal.progress}
        if known.imus:
            return read_camera_imu(self.recording, **stated, **shared)
        del stated["imu"]
        return read_camera_views(self.recording, **stated, **shared)


def _write(found: "Verification", folder: Path, terminal: Terminal, subject: str) -> None:
    from ...output import write_whole
    from ...report.comparison import write_verification_report

    with result_folder(folder, "verify", own=(PAGE, DATA)) as staging:
        terminal.progress("drawing the report")
        write_verification_report(found, staging / PAGE, subject)
        write_whole(staging / DATA, json.dumps({"subject": subject, **json_value(found)}, indent=2).encode())


def read_verification(path: Path) -> "Verification":
    """Read verification.json.

    Raises
    ------
    FormatError
        If it cannot be read, or an older version wrote it; the message names the key.
    """
    from ...assess.comparison.verification import Verification
    from ...formats.own.dataclass_file import read_class
    from ...formats.shared.structured import read_json

    root = read_json(path)
    kept = {node.key: node.value for node in root.entries() if node.key != "subject"}
    return read_class(replace(root, value=kept), Verification)


def _print(found: "Verification", terminal: Terminal) -> None:
    from ...assess.comparison.verification import movement_words

    terminal.print(found.headline, _STYLES[found.state])
    for note in found.notes:
        terminal.print(f"  {note}")
    print_findings(found.findings, terminal)
    if not found.blocks:
        return
    rows = [("", "moved by", f"{found.use} needs", "z", ""), *(movement_words(block) for block in found.blocks)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    terminal.print("")
    for row in rows:
        terminal.print(f"  {'  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))}".rstrip())
