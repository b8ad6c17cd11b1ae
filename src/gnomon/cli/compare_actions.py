"""What `gnomon compare` does: read, compare, write a page and a table, say who agrees."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .compare_command import Compare, renames_of, sources_of
from .places import default_folder, owner_of, result_folder
from .results import UNUSABLE, USABLE, result_files
from .terminal import Terminal

if TYPE_CHECKING:
    from ..assess.comparison import Comparison, Repeatability

PAGE, TABLE = "report.html", "comparison.csv"
_STYLES = {"pass": "bold green", "warn": "bold yellow", "fail": "bold red"}


def compare(command: Compare, terminal: Terminal) -> int:
    """Compare calibrations, and return the exit code."""
    from ..calibrate.comparison import compare as compare_calibrations
    from ..readers.own.calibration_sources import source_names

    sources = sources_of(command.calibrations)
    guessed = source_names([paths for _, paths in sources])
    names = [name or guess for (name, _), guess in zip(sources, guessed, strict=True)]
    found = compare_calibrations(*(paths for _, paths in sources), names=names, rename=renames_of(command.rename))
    folder = command.output or default_folder((_place(sources[0][1][0]),), "compare")
    if command.report:
        _write(found, folder, terminal)
    terminal.close()
    _say(found, terminal)
    files = result_files(folder, (PAGE, TABLE)) if command.report else {}
    if files:
        terminal.say("")
    for path in files.values():
        terminal.say(f"written: {path}")
    code = UNUSABLE if found.verdict == "fail" else USABLE
    terminal.document({**_document(found), "exit_code": code, "files": files})
    return code


def _place(path: Path) -> Path:
    """Return the folder of the result that a file is in, or the path as it is."""
    return path.parent if path.is_file() and owner_of(path.parent.absolute()) else path


def _write(found: "Comparison", folder: Path, terminal: Terminal) -> None:
    from ..output import write_whole
    from ..report.comparison import write_comparison_report
    from ..writers.comparison_table import comparison_csv

    with result_folder(folder, "compare", own=(PAGE, TABLE)) as staging:
        terminal.progress("drawing the report")
        write_comparison_report(found, staging / PAGE)
        write_whole(staging / TABLE, comparison_csv(found))


def _say(found: "Comparison", terminal: Terminal) -> None:
    from . import summary

    terminal.say(f"{found.verdict}: {found.headline}", _STYLES[found.verdict])
    width = max(len(one.name) for one in found.calibrations)
    for one in found.calibrations:
        sigmas = "truth of a simulation" if one.exact else "with sigmas" if one.sigmas else "without sigmas"
        terminal.say(f"  {one.name:<{width}}  {one.format}, {one.frame}, {sigmas}")
    if isfinite(found.z_rms):
        terminal.say(
            f"  {found.compared} differences, z rms {found.z_rms:.2f} (1 expected, up to {found.limit:.2f} is chance)"
        )
    if lines := list(summary.advice(found.findings)):
        terminal.say("\n" + "\n".join(lines))
    terminal.say("")
    if found.blocks:
        terminal.say("\n".join(_lines(found)))


def _lines(found: "Comparison") -> Iterator[str]:
    """Yield a table of the blocks, whose columns are as wide as they must be."""
    from ..assess.comparison_words import block_words

    two = len(found.calibrations) == 2
    rows = [("", "differ" if two else "scatter", "sigma", "", "z rms", "max |z|")]
    for block in found.blocks:
        known = [item.largest for item in found.differences if item.path == block.path and isfinite(item.largest)]
        ratios = (f"{block.z_rms:.2f}" if isfinite(block.z_rms) else "-", f"{max(known):.1f}" if known else "-")
        rows.append((block_words(block.path), *_sizes(found, block), *ratios))
    padded = [
        [cell.ljust(max(map(len, column))) if i in {0, 3} else cell.rjust(max(map(len, column))) for cell in column]
        for i, column in enumerate(zip(*rows, strict=True))
    ]
    for cells in zip(*padded, strict=True):
        yield f"  {'  '.join(cells)}".rstrip()


def _sizes(found: "Comparison", block: "Repeatability") -> tuple[str, str, str]:
    """Return how far a block scatters, or two differ, its sigma, and the unit; root mean squares over its scalars."""
    from ..assess.comparison_words import typical_size

    numbers = block.scatter, block.predicted
    pair = [item for item in found.differences if item.path == block.path]
    if len(found.calibrations) == 2 and pair:  # none where only one has the sensor
        numbers = pair[0].values, pair[0].sigmas
    (size, unit), (sigma, _) = (typical_size(block, values) for values in numbers)
    texts = [f"{number:.2g}" if isfinite(number) else "-" for number in (size, sigma)]
    return texts[0], texts[1], unit


def _document(value: Any) -> Any:
    """Return values as mappings and lists."""
    if is_dataclass(value):
        return {field.name: _document(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _document(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, list | tuple):
        return [_document(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return value
