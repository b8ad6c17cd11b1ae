"""What commands that calibrate have in common: what they write and print, their document for programs, exit codes."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .command import TableOptions
from .output_folder import RESULT_FILES
from .terminal import Terminal

if TYPE_CHECKING:
    from ..findings import Finding
    from ..results.calibration import Calibration
    from ..results.result import Result


_MOVED_K = 4.0
"""Change of the chip's temperature from which on a line is told from it."""
USABLE, UNUSABLE = 0, 4
"""Exit codes of work that was finished."""


def exit_code(calibration: "Calibration") -> int:
    """Return the exit code of a calibration that was finished."""
    return UNUSABLE if calibration.verdict == "fail" else USABLE


def write_result(result: "Result", folder: Path, *, report: bool, terminal: Terminal) -> None:
    """Write calibration, diagnostics and, where wanted, the report; the terminal keeps what was calibrated."""
    from ..formats.own.calibration_text import save
    from ..writers.diagnostics_file import save_diagnostics

    save(result.calibration, folder / "calibration.yaml")
    save_diagnostics(result.diagnostics, folder / "diagnostics.npz")
    terminal.written = result.calibration
    if report:
        terminal.progress("drawing the report")
        from ..report.page import write_report

        write_report(result, folder / "report.html")


def print_assumptions(assumptions: Sequence[str], terminal: Terminal) -> None:
    """Print what the reader detected or had to assume."""
    for sentence in assumptions:
        terminal.print(f"detected: {sentence}")
    if assumptions:
        terminal.print("")


def print_needs(calibration: "Calibration", terminal: Terminal) -> None:
    """Print what the use needs that the calibration was judged for, and what there is; nothing where there is none."""
    trust = calibration.assessment.trust
    if not trust.needs:
        return
    from ..assess.needs import number_words

    floors = any(need.floor for need in trust.needs)
    terminal.print(
        f"\n{f'known, needed for {trust.use}':<40}{'sigma':>9}{'between*' if floors else '':>10}{'needed':>8}"
    )
    for need in trust.needs:
        limit = f"{number_words(need.needed)} {need.unit}"
        floor = number_words(need.floor) if need.floor else ""
        terminal.print(f"  {need.block:<38}{number_words(need.sigma):>9}{floor:>10}{limit:>15}  {need.verdict}")
    if floors:
        terminal.print("  * usual from one recording to the next (turn-on, mounting); counted but for biases")
    terminal.print("")


def print_result(
    calibration: "Calibration",
    facts: Iterable[str],
    folder: Path,
    assumptions: Sequence[str],
    terminal: Terminal,
    *,
    parameters: bool = True,
    source: TableOptions | None = None,
    more: Mapping[str, Any] | None = None,
) -> int:
    """Print a calibration of an IMU on one screen and as a document, and return the exit code.

    Parameters
    ----------
    facts : lines on what it rests on
    assumptions : of the reader
    parameters : whether they are printed
    source : options of the recording, with which further recordings of the sensor are corrected
    more : of the document
    """
    from . import summary

    print_summary(calibration, facts, terminal)
    if parameters:
        terminal.print("\nestimate +- standard deviation; rows: sensor axes, columns: body axes")
        terminal.print("\n".join(summary.parameter_lines(calibration)))
    print_files(folder, terminal)
    if source is not None and calibration.verdict != "fail":
        stated = {"--columns": source.columns, "--rate": source.rate, "--units": source.units}
        options = [word for name, value in stated.items() if value is not None for word in (name, str(value))]
        terminal.print("")
        terminal.propose("apply", folder / "calibration.yaml", "RECORDING", *options, "-o", "corrected.csv")
    propose_temperature(calibration, folder, terminal)
    terminal.document(lambda: {**result_document(calibration, folder, assumptions), **(more or {})})
    return exit_code(calibration)


def propose_temperature(calibration: "Calibration", folder: Path, terminal: Terminal) -> None:
    """Propose to find what the temperature does, where it moved while the sensor was recorded."""
    span = calibration.provenance.options.get("chip_range_degc", "0 to 0").split(" to ")
    if any(imu.temperature is not None and imu.temperature.of("magnetometer") for imu in calibration.imus.values()):
        return
    if calibration.verdict != "fail" and float(span[1]) - float(span[0]) >= _MOVED_K:
        terminal.propose("temperature", "WARM-UP", "--calibration", folder / "calibration.yaml")


def print_summary(calibration: "Calibration", facts: Iterable[str], terminal: Terminal) -> None:
    """Print the verdict and what it means, what the calibration rests on, and the findings."""
    from . import summary

    meaning, style = summary.VERDICTS[calibration.verdict]
    trust = calibration.assessment.trust
    terminal.print(f"{calibration.verdict}: {meaning}" + (f" for {trust.use}" if trust.use else ""), style)
    print_needs(calibration, terminal)
    terminal.print("\n".join([*facts, *summary.trust_lines(trust), *summary.held_lines(calibration)]))
    print_findings(calibration.assessment.findings, terminal)


def print_findings(findings: "Sequence[Finding]", terminal: Terminal) -> None:
    """Print findings, but for good news."""
    from . import summary

    if lines := list(summary.finding_lines(findings)):
        terminal.print("\n" + "\n".join(lines))


def print_files(folder: Path, terminal: Terminal, names: Sequence[str] = RESULT_FILES) -> None:
    """Print which files were written."""
    terminal.print("")
    there = result_files(folder, names)
    width = max(map(len, there), default=0)
    for stem, path in there.items():
        terminal.print(f"{stem:<{max(width, 12)}} {path}")


def result_files(folder: Path, names: Sequence[str] = RESULT_FILES) -> dict[str, str]:
    """Return the files of a result that are there, by their names without suffix."""
    return {Path(name).stem: str(folder / name) for name in names if (folder / name).exists()}


def result_document(
    calibration: "Calibration", folder: Path, assumptions: Sequence[str], names: Sequence[str] = RESULT_FILES
) -> Mapping[str, Any]:
    """Return what a program is told about a result."""
    return {
        "verdict": calibration.verdict,
        "exit_code": exit_code(calibration),
        "assumptions": list(assumptions),
        "files": result_files(folder, names),
        "calibration": calibration_document(calibration),
    }


def calibration_document(calibration: "Calibration") -> dict[str, Any]:
    """Return what calibration.yaml holds."""
    import yaml

    from ..formats.own.calibration_text import calibration_text

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load(calibration_text(calibration), Loader=loader)
