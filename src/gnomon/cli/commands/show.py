"""The commands that use a calibration: show it, apply it to a recording, make its certificate."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from ...errors import OptionError
from ...units import Units
from ..command import (
    CalibrationPath,
    Command,
    Flat,
    Input,
    output_option,
    use_option,
)
from ..files import default_folder
from ..results import (
    USABLE,
    calibration_document,
    finding_lines,
    held_lines,
    print_assumptions,
    print_needs,
)
from ..terminal import WIDTH, Terminal

if TYPE_CHECKING:
    from ...writers.tables import ParameterRows

from typing import TYPE_CHECKING, Any

from ...errors import RecordingError

if TYPE_CHECKING:
    from ...results.calibration import Calibration


from ..results import UNUSABLE
from . import compare, verify


@dataclass(frozen=True, kw_only=True)
class Show(Command):
    """Show a calibration as tables with standard deviations; files of other projects without.

    Examples
    --------
    $ gnomon show calibration.yaml
    $ gnomon show calibration.yaml --form kalibr
    """

    calibration: CalibrationPath
    """A calibration.yaml, a noise.yaml, or a file of another project: Kalibr's camchain, imu and target yaml and
    results-imucam.txt, OpenVINS' chains, Basalt's or imucal's JSON, imu_tk's .calib."""
    form: Literal["sensitivity", "kalibr", "tedaldi", "krebs", "angrisano"] = "sensitivity"
    """Form of the sensor model: gnomon's own, Kalibr's, or that of Tedaldi 2014, Krebs or Angrisano (see Theory)."""
    use: Annotated[
        str | None,
        use_option(
            "Judge it for vio, ahrs, gimbal, phone, or a YAML file that states what is needed; general takes back what "
            "it was judged for."
        ),
    ] = None

    def run(self, terminal: Terminal) -> int:
        """Print the tables, and return the exit code."""
        from ...formats.own.calibration_file import load
        from ...formats.own.calibration_text import calibration_at, is_noise, is_own
        from ...writers.tables import form_tables, summary_table

        path = Path(calibration_at(self.calibration))
        own = is_own(path)
        if self.use is not None and (not own or is_noise(path)):
            raise OptionError(
                f"{path}: only a calibration.yaml of gnomon's can be judged for a use: it has the standard "
                "deviations. Leave out --for."
            )
        if not own:
            return _show_foreign(path, self.form, terminal)
        if is_noise(path):
            from .noise import show_noise

            return show_noise(path, terminal)
        calibration = load(path)
        if self.use is not None:
            from ...calibrate.judging import judge

            calibration = judge(calibration, self.use)
        print_needs(calibration, terminal)
        _print_tables((summary_table(calibration), *form_tables(calibration, self.form)), terminal)
        if lines := [*held_lines(calibration), *finding_lines(calibration.assessment.findings)]:
            terminal.print("\n".join(lines))
        terminal.document(lambda: calibration_document(calibration))
        return USABLE


def _show_foreign(path: Path, form: str, terminal: Terminal) -> int:
    from ...formats.foreign_files import load_foreign
    from ...writers.tables import foreign_document, foreign_tables

    foreign = load_foreign(path)
    print_assumptions(foreign.notes, terminal)
    _print_tables(foreign_tables(foreign, form), terminal)
    terminal.document(foreign_document(foreign))
    return USABLE


def _print_tables(tables: "Sequence[ParameterRows]", terminal: Terminal) -> None:
    for table in tables:
        names = max(len(row.name) for row in table.rows)
        values = max(len(row.value) for row in table.rows)
        terminal.print(table.title, "bold")
        terminal.print("\n".join(textwrap.wrap(table.note, WIDTH - 1)), "dim")
        for row in table.rows:
            terminal.print(f"  {row.name:<{names}}  {row.value:>{values}}  {row.unit}".rstrip())
        terminal.print("")


@dataclass(frozen=True, kw_only=True)
class Apply(Command):
    """Turn a recording into specific force and angular rate with a calibration; of any length, in little memory.

    Examples
    --------
    $ gnomon apply calibration.yaml recording.csv
    $ gnomon apply calibration.yaml recording.csv -o corrected.csv
    """

    calibration: CalibrationPath
    """A calibration.yaml."""
    recording: Annotated[Input, Flat]
    output: Annotated[Path | None, output_option("FILE")] = None
    """CSV file to write (default: NAME-calibrated.csv beside the recording)."""
    imu: str | None = None
    """Which IMU of a calibration of several recorded the samples, such as imu1; told by the name of the file, as of
    imu1.csv or imu1/data.csv, where not given."""
    temperature_c: float | None = None
    """Temperature of the chip, for a calibration that depends on it and a recording without a thermometer."""
    strict: bool = False
    """Refuse a recording whose temperature leaves the range in which the calibration knows it."""

    def run(self, terminal: Terminal) -> int:
        """Write the corrected samples of a recording, and return the exit code."""
        from ...formats.own.calibration_file import load
        from ...writers.apply import apply_files

        source = self.recording
        calibration = load(self.calibration)
        imus = calibration.imus
        if not imus:
            raise OptionError(
                f"{self.calibration}: this calibration is of cameras alone; only samples of an IMU are corrected. Give "
                "the calibration of the IMU."
            )
        name = _chosen_imu(self, tuple(imus))
        imu = imus[name]
        tables = _tables(source.paths, name)
        kept = remembered_reading(calibration, tables)
        stated = {option: value for option, value in source.table.items() if value is not None}
        reading = {"units": None} | kept | stated
        if kept.keys() - stated.keys():
            told = ", ".join(f"--{name.removesuffix('_hz')} {kept[name]}" for name in kept if name not in stated)
            terminal.warn(f"read as the recording of the calibration: {told}.")
        units = reading.pop("units")
        units = None if units is None else Units.parse(units)
        output = self.output or default_folder(source.paths, "calibrated.csv")
        if output.suffix.lower() in (".npz", ".mat", ".parquet"):
            raise OptionError(f"{output}: samples are written as a CSV table. Name the file so, {output.stem}.csv.")
        terminal.progress("correcting the samples")
        rows = apply_files(
            imu, *tables, output=output, imu=name, units=units, temperature_c=self.temperature_c,
            strict=self.strict, warn=terminal.warn, **reading,
        )  # fmt: skip
        terminal.print(f"{rows} rows in {output}")
        if imu.accelerometer is not None and imu.accelerometer.lever_arms_m is not None:
            terminal.print(
                "Lever arms were not applied: each component of the specific force is that at its accelerometer."
            )
        terminal.document({"rows": rows, "file": str(output)})
        return USABLE


def _chosen_imu(command: Apply, imus: tuple[str, ...]) -> str:
    """Return which IMU of a calibration recorded the samples: as stated, the only one, or by the name of the file."""
    known = f"{command.calibration}: this calibration is of {', '.join(imus)}"
    if command.imu is not None:
        if command.imu not in imus:
            raise OptionError(f"{known}, not of {command.imu}. Choose one of them with --imu.")
        return command.imu
    if len(imus) == 1:
        return imus[0]
    path = command.recording.path
    called = path.parent.name if path.stem == "data" else path.name
    named = [name for name in imus if re.match(rf"{name}(?!\d)", called)]
    if len(named) != 1:
        raise OptionError(f"{known}. Say with --imu which of them recorded {path}.")
    return named[0]


def _tables(paths: Sequence[Path], imu: str) -> Sequence[Path]:
    """Return the tables of one IMU of a folder of several; of anything else the paths themselves."""
    from ...readers.rig.folder import folder_holds_imu, imu_files, recording_folder

    if len(paths) != 1 or not paths[0].is_dir() or not folder_holds_imu(recording_folder(paths[0])):
        return paths
    files = imu_files(recording_folder(paths[0]))
    if len(files) == 1 and imu == "imu0":
        return paths
    if imu not in files:
        raise OptionError(f"{paths[0]}: there are samples of {', '.join(files)}, and none of {imu}. Give its table.")
    return files[imu]


def remembered_reading(calibration: "Calibration", paths: Sequence[Path]) -> dict[str, Any]:
    """Return how a calibration's recording was read, for tables without a header, which say as little as that one did.

    Nothing is returned for other recordings, which tell themselves what their columns are.
    """
    from ...readers.files import first_bytes
    from ...readers.samples.text_table import has_header

    options = calibration.provenance.options
    known: dict[str, Any] = {name: options[name] for name in ("columns", "rate_hz", "units") if name in options}
    if not known or not all(path.is_file() for path in paths):
        return {}
    try:
        if any(has_header(path.name, first_bytes(path, _HEAD_BYTES)) for path in paths):
            return {}
    except RecordingError:  # no table of text
        return {}
    return known | ({"rate_hz": float(known["rate_hz"])} if "rate_hz" in known else {})


_HEAD_BYTES = 65_536


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
