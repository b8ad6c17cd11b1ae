"""The command that makes the certificate of a result."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..command import CalibrationPath, Command, output_option
from ..results import exit_code
from ..terminal import Terminal


@dataclass(frozen=True, kw_only=True)
class Certificate(Command):
    """Make a PDF of a stored result: verdict, what was stated of the sensor, the numbers, their uncertainty budget.

    What it says of sensor, date, place, operator and temperature was stated in the options of the command that
    calibrated. Needs Matplotlib: pip install "gnomon[certificate]".

    Examples
    --------
    $ gnomon certificate recording-imu -o certificate.pdf
    """

    calibration: CalibrationPath
    """The folder of a result, or its calibration.yaml."""
    output: Annotated[Path, output_option("FILE")]
    """PDF file to write."""

    def run(self, terminal: Terminal) -> int:
        """Write the certificate, and return the exit code of the calibration."""
        from ...formats.own.calibration_file import calibration_at, load
        from ...report.certificate.pdf import write_certificate

        calibration = load(calibration_at(self.calibration))
        write_certificate(calibration, self.output)
        terminal.print(f"certificate  {self.output}")
        terminal.document({"verdict": calibration.verdict, "file": str(self.output)})
        return exit_code(calibration)
