"""What `gnomon study` does: carry out, write a page and tables, say which claims hold."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from .places import result_folder
from .results import USABLE
from .studies import STUDIES, Found, Parts, StudyEntry
from .study_command import Study
from .study_count import StudyCount
from .study_journal import FileJournal, study_journal
from .terminal import Terminal

if TYPE_CHECKING:
    from ..study.tables import Claim

PAGE = "study.html"
_OLD_JOURNAL = "unfinished.journal"  # of gnomon before studies kept it


def study(command: Study, terminal: Terminal) -> int:
    """Carry out a study, write its folder, and return the exit code.

    A claim that does not hold is a result like any other: the exit code is that of work which was finished.
    """
    if command.name is None:
        return _list_studies(terminal)
    entry = STUDIES[command.name]
    folder = command.output or Path(f"gnomon-study-{command.name}")
    every = {f"{table}.csv" for known in STUDIES.values() for table in known.tables}
    with result_folder(folder, "study", own=(PAGE, _OLD_JOURNAL, *every)) as staging:
        parts = entry.load()
        with study_journal(folder, command.name, terminal.progress) as journal:
            found = _carried_out(command, parts, entry, journal, terminal)
        names = _write(found, parts, staging, terminal)
    terminal.close()
    stated = list(parts.claims(found))
    _say_claims(stated, terminal)
    terminal.say(f"page   {folder / PAGE}")
    terminal.document(
        {
            "study": command.name,
            "runs": found.runs,
            "seed": found.seed,
            "claims": [asdict(claim) for claim in stated],
            "files": {Path(name).stem: str(folder / name) for name in names},
        }
    )
    return USABLE


def _carried_out(command: Study, parts: Parts, entry: StudyEntry, journal: FileJournal, terminal: Terminal) -> Found:
    from ..study.runs import Workers

    count = StudyCount(terminal, entry.stages)
    try:
        return parts.carry_out(
            runs=command.runs or entry.runs,
            workers=Workers(jobs=command.jobs, scheduler=command.scheduler or "", journal=journal, count=count),
            seed=command.seed,
            progress=count.progress,
        )
    except KeyboardInterrupt as stop:
        if len(journal) == 0:
            raise
        raise KeyboardInterrupt(f"interrupted; {journal.kept}") from stop
    finally:
        count.close()


def _write(found: Found, parts: Parts, staging: Path, terminal: Terminal) -> list[str]:
    """Write tables and page, and return the names of the files."""
    from ..output import write_whole
    from ..report.page import render

    contents: dict[str, str | bytes] = {f"{table.name}.csv": table.csv() for table in parts.tables(found)}
    terminal.progress("drawing the page")
    contents[PAGE] = render(parts.page(found))
    for name, content in contents.items():
        write_whole(staging / name, content)
    return sorted(contents)


def _say_claims(stated: "Sequence[Claim]", terminal: Terminal) -> None:
    for claim in stated:
        word = "too few runs to tell:" if claim.holds is None else "holds " if claim.holds else "FAILS "
        terminal.say(f"{word} {claim.claim}", "bold red" if claim.holds is False else "")
        terminal.say(f"       expected {claim.expected}; found {claim.found}", "dim")
    terminal.say("")


def _list_studies(terminal: Terminal) -> int:
    for name, entry in STUDIES.items():
        terminal.say(name, "bold")
        terminal.say(f"  {entry.about}")
        terminal.say(f"  {entry.runs} {entry.counted}: about {entry.minutes:g} minutes on one core", "dim")
    terminal.say("")
    terminal.say("gnomon study NAME --jobs N; --runs FEWER for a glance.")
    terminal.document(
        {
            "studies": {
                name: {
                    "about": entry.about,
                    "runs": entry.runs,
                    "counted": entry.counted,
                    "minutes": entry.minutes,
                    "tables": entry.tables,
                }
                for name, entry in STUDIES.items()
            }
        }
    )
    return USABLE
