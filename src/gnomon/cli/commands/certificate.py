"""The command that makes the certificate of a result."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ...errors import OptionError
from ..command import CalibrationPath, Command, output_option
from ..files import default_folder
from ..results import UNUSABLE, USABLE
from ..terminal import Terminal
from . import compare, verify


@dataclass(frozen=True, kw_only=True)
class Certificate(Command):
    """Make a PDF of a stored result: verdict, what was stated of the sensor, the numbers, their uncertainty budget.

    A FILE that ends in .xml becomes a digital calibration certificate (PTB's DCC) for other programs. What it says of
    sensor, date, place, operator and temperature was stated in the options of the command that calibrated; serial
    number and date must have been for an XML file. A PDF needs Matplotlib, the extra gnomon[certificate].

    Examples
    --------
    $ gnomon certificate recording-imu
    $ gnomon certificate recording-imu -o certificate.xml --country DE
    """

    calibration: CalibrationPath
    """The folder of a result, or its calibration.yaml, noise.yaml, verification.json or comparison.json."""
    output: Annotated[Path | None, output_option("FILE")] = None
    """PDF or XML file to write (default: RESULT-certificate.pdf beside the result)."""
    country: str = "ZZ"
    """Country of the laboratory, by ISO 3166-1, for an XML file; ZZ is none."""

    def run(self, terminal: Terminal) -> int:
        """Write the certificate, and return the exit code of the calibration."""
        from ...formats.own.calibration_file import load
        from ...formats.own.calibration_text import calibration_at, is_noise
        from ...formats.own.noise_file import load_noise
        from ...results.calibration import Calibration

        path = Path(calibration_at(self.calibration))
        judged = {verify.DATA: verify.read_verification, compare.DATA: compare.read_comparison}
        path = next((path / name for name in judged if (path / name).is_file()), path)
        read_result = judged.get(path.name) or (load_noise if is_noise(path) else load)
        result = read_result(path)
        output = self.output or default_folder((self.calibration,), "certificate.pdf")
        if output.suffix.lower() == ".xml":
            from ...writers.digital_certificate import write_digital_certificate

            if not isinstance(result, Calibration):
                raise OptionError(f"{output}: an XML certificate is of a calibration; of anything else make a PDF.")
            write_digital_certificate(result, output, country=self.country)
        else:
            from ...report.certificate_pdf import write_certificate

            write_certificate(result, output)
        terminal.print(f"certificate  {output}")
        terminal.document({"verdict": result.verdict, "file": str(output)})
        return UNUSABLE if result.verdict == "fail" else USABLE
