"""What commands that calibrate have in common: their files, their document for programs, their exit codes."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .command_parts import TableOptions
from .places import RESULT_FILES
from .terminal import Terminal

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..diagnostics import Result

USABLE, UNUSABLE = 0, 4
"""Exit codes of work that was finished."""


def exit_code(calibration: "Calibration") -> int:
    """Return the exit code of a calibration that was finished."""
    return UNUSABLE if calibration.verdict == "fail" else USABLE


def write_result(result: "Result", folder: Path, *, report: bool, terminal: Terminal) -> None:
    """Write calibration, diagnostics and, where wanted, the report into a folder."""
    from ..writers import save
    from ..writers.diagnostics_file import save_diagnostics

    save(result.calibration, folder / "calibration.yaml")
    save_diagnostics(result.diagnostics, folder / "diagnostics.npz")
    if report:
        terminal.progress("drawing the report")
        from ..report import write_report

        write_report(result, folder / "report.html")


def say_assumptions(assumptions: Sequence[str], terminal: Terminal) -> None:
    """Say what the reader had to assume."""
    for sentence in assumptions:
        terminal.say(f"understood: {sentence}")
    if assumptions:
        terminal.say("")


def say_verdict(calibration: "Calibration", terminal: Terminal) -> None:
    """Say the verdict and what it means."""
    from . import summary

    meaning, style = summary.VERDICTS[calibration.verdict]
    use = calibration.assessment.trust.use
    terminal.say(f"{calibration.verdict}: {meaning}" + (f" for {use}" if use else ""), style)
    say_needs(calibration, terminal)


def say_needs(calibration: "Calibration", terminal: Terminal) -> None:
    """Say what the use needs that the calibration was judged for, and what there is; nothing where there is none."""
    trust = calibration.assessment.trust
    if not trust.needs:
        return
    from ..assess.needs import number_words

    floors = any(need.floor for need in trust.needs)
    terminal.say(f"\n{f'known, needed for {trust.use}':<40}{'sigma':>9}{'between*' if floors else '':>10}{'needed':>8}")
    for need in trust.needs:
        limit = f"{number_words(need.needed)} {need.unit}"
        floor = number_words(need.floor) if need.floor else ""
        terminal.say(f"  {need.block:<38}{number_words(need.sigma):>9}{floor:>10}{limit:>15}  {need.verdict}")
    if floors:
        terminal.say(
            "  * from one recording to the next, as is usual (turn-on, temperature, mounting): one\n"
            "    recording cannot know it. It counts, but for biases, which every use has to follow."
        )
    terminal.say("")


def say_advice(calibration: "Calibration", terminal: Terminal) -> None:
    """Say the findings, but for good news."""
    from . import summary

    if lines := list(summary.advice(calibration.assessment.findings)):
        terminal.say("\n" + "\n".join(lines))


def say_result(
    calibration: "Calibration", facts: Iterable[str], folder: Path, terminal: Terminal, *, parameters: bool = True
) -> None:
    """Say a result on one screen: verdict, what it rests on, advice, parameters, files."""
    from . import summary

    say_verdict(calibration, terminal)
    terminal.say(
        "\n".join([*facts, *summary.trust_facts(calibration.assessment.trust), *summary.held_facts(calibration)])
    )
    say_advice(calibration, terminal)
    if parameters:
        terminal.say("\nestimate +- standard deviation; rows: sensor axes, columns: body axes")
        terminal.say("\n".join(summary.parameter_lines(calibration)))
    say_files(folder, terminal)


def say_files(folder: Path, terminal: Terminal, names: Sequence[str] = RESULT_FILES) -> None:
    """Say which files were written."""
    terminal.say("")
    there = result_files(folder, names)
    width = max(map(len, there), default=0)
    for stem, path in there.items():
        terminal.say(f"{stem:<{max(width, 12)}} {path}")


def propose_apply(calibration: "Calibration", folder: Path, source: TableOptions, terminal: Terminal) -> None:
    """Say how recordings of the sensor are corrected; with how its columns had to be stated, which they all need."""
    if calibration.verdict == "fail":
        return
    stated = {"--columns": source.columns, "--rate": source.rate, "--units": source.units}
    options = [word for name, value in stated.items() if value is not None for word in (name, str(value))]
    terminal.say("")
    terminal.propose("apply", folder / "calibration.yaml", "RECORDING", *options, "-o", "corrected.csv")


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

    from ..writers.calibration_file import calibration_text

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load(calibration_text(calibration), Loader=loader)
