"""The command that compares calibrations."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ...errors import OptionError
from ..arguments import Argument
from ..command import Command, Flat, StatedFacts, output_option
from ..files import default_folder, owner_of, result_folder, sources_of
from ..results import UNUSABLE, USABLE, print_files, print_findings, result_files, with_statements
from ..terminal import Terminal, json_value

if TYPE_CHECKING:
    from ...assess.comparison.comparison import Comparison, Repeatability


PAGE, TABLE, DATA = FILES = ("report.html", "comparison.csv", "comparison.json")
_STYLES = {"pass": "bold green", "warn": "bold yellow", "fail": "bold red"}


@dataclass(frozen=True, kw_only=True)
class Compare(Command):
    """Compare calibrations of one rig, made by any program: who agrees, who stands out and in what, and what repeats.

    Exit code 4 where two calibrations differ by more than the sigmas of both allow.

    Examples
    --------
    $ gnomon compare monday/ tuesday/
    $ gnomon compare gnomon=rig-camera-imu/ kalibr=camchain-imucam.yaml+imu.yaml
    """

    calibrations: Annotated[tuple[str, ...], Argument(positional=True, metavar="[NAME=]PATH[+PATH...]")]
    """At least two: a calibration.yaml or a result's folder; files of other projects, several of one calibration joined
    by + (such as camchain-imucam.yaml+imu.yaml), or the folder that holds them: Kalibr's, OpenVINS', Basalt's,
    imucal's, imu_tk's. NAME= says what it is called (default: the part of the path that tells it from the others)."""
    rename: Annotated[tuple[str, ...], Argument(metavar="NAME.OLD=NEW")] = ()
    """Sensors that are called otherwise in one of them, such as kalibr.cam1=cam0; else they are matched by name."""
    temperature_c: float | None = None
    """Temperature of the chip at which those are compared that know it (default: the reference of each)."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for report.html, comparison.csv and comparison.json (default: NAME-compare beside the first of them)."""
    report: bool = True
    """Do not make the report, nor the tables."""
    certificate: Annotated[StatedFacts, Flat] = field(default_factory=StatedFacts)

    def __post_init__(self) -> None:
        for text in self.rename:
            left, equals, new = text.partition("=")
            if not (equals and new and all(left.rpartition("."))):
                raise OptionError(f"--rename {text}: expected NAME.OLD=NEW, such as kalibr.cam1=cam0.")

    def run(self, terminal: Terminal) -> int:
        """Compare calibrations, and return the exit code."""
        from ...calibrate.comparison import compare as compare_calibrations
        from ...formats.foreign_files import source_names

        sources = sources_of(self.calibrations)
        guessed = source_names([paths for _, paths in sources])
        names = [name or guess for (name, _), guess in zip(sources, guessed, strict=True)]
        renames: dict[str, dict[str, str]] = {}
        for text in self.rename:
            old, _, new = text.partition("=")
            name, _, sensor = old.rpartition(".")
            renames.setdefault(name, {})[sensor] = new
        found = compare_calibrations(
            *(paths for _, paths in sources), names=names, rename=renames, temperature_c=self.temperature_c
        )
        found = with_statements(found, self.certificate, [path for _, paths in sources for path in paths])
        folder = self.output or default_folder((_place(sources[0][1][0]),), "compare")
        if self.report:
            _write(found, folder, terminal)
        _print(found, terminal)
        files = result_files(folder, (PAGE, TABLE)) if self.report else {}
        if files:
            print_files(folder, terminal, (PAGE, TABLE))
        code = UNUSABLE if found.verdict == "fail" else USABLE
        terminal.document({**json_value(found), "exit_code": code, "files": files})
        return code


def _place(path: Path) -> Path:
    """Return the folder of the result that a file is in, or the path as it is."""
    return path.parent if path.is_file() and owner_of(path.parent.absolute()) else path


def _write(found: "Comparison", folder: Path, terminal: Terminal) -> None:
    from ...output import write_whole
    from ...report.comparison import write_comparison_report
    from ...writers.tables import comparison_csv

    with result_folder(folder, "compare", own=FILES) as staging:
        terminal.progress("drawing the report")
        write_comparison_report(found, staging / PAGE)
        write_whole(staging / TABLE, comparison_csv(found))
        write_whole(staging / DATA, json.dumps(json_value(found), indent=2).encode())


def read_comparison(path: Path) -> "Comparison":
    """Read comparison.json.

    Raises
    ------
    FormatError
        If it cannot be read, or an older version wrote it; the message names the key.
    """
    from ...assess.comparison.comparison import Comparison, Repeatability
    from ...formats.own.dataclass_file import number_or_nan, read_class
    from ...formats.shared.structured import Node, read_json

    unknown = {"z_rms": number_or_nan, "limit": number_or_nan}

    def blocks(node: Node) -> tuple[Repeatability, ...]:
        return tuple(read_class(item, Repeatability, own=unknown) for item in node.items())

    return read_class(read_json(path), Comparison, own={**unknown, "blocks": blocks})


def _print(found: "Comparison", terminal: Terminal) -> None:
    terminal.print(f"{found.verdict}: {found.headline}", _STYLES[found.verdict])
    width = max(len(one.name) for one in found.calibrations)
    for one in found.calibrations:
        sigmas = "truth of a simulation" if one.exact else "with sigmas" if one.sigmas else "without sigmas"
        terminal.print(f"  {one.name:<{width}}  {one.format}, {one.frame}, {sigmas}")
    if isfinite(found.z_rms):
        terminal.print(
            f"  {found.compared} differences, z rms {found.z_rms:.2f} (1 expected, up to {found.limit:.2f} is chance)"
        )
    print_findings(found.findings, terminal)
    terminal.print("")
    if found.blocks:
        terminal.print("\n".join(_lines(found)))


def _lines(found: "Comparison") -> Iterator[str]:
    """Yield a table of the blocks, whose columns are as wide as they must be."""
    from ...assess.comparison.comparison import block_words

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
    from ...assess.comparison.comparison import typical_size

    numbers = block.scatter, block.predicted
    pair = [item for item in found.differences if item.path == block.path]
    if len(found.calibrations) == 2 and pair:  # none where only one has the sensor
        numbers = pair[0].values, pair[0].sigmas
    (size, unit), (sigma, _) = (typical_size(block, values) for values in numbers)
    texts = [f"{number:.2g}" if isfinite(number) else "-" for number in (size, sigma)]
    return texts[0], texts[1], unit
