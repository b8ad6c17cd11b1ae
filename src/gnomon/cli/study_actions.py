"""What `gnomon study` does: carry out, write a page and tables, say which claims hold."""

from dataclasses import asdict
from pathlib import Path

from .places import result_folder
from .results import USABLE
from .study_command import Study
from .terminal import Terminal

PAGE = "study.html"
TABLES = ("claims", "parameters", "runs", "starts", "iterations")
RUNS = {"angrisano": 500}


def study(command: Study, terminal: Terminal) -> int:
    """Carry out a study, write its folder, and return the exit code."""
    from ..output import write_whole
    from ..report.page import render
    from ..report.study_angrisano import angrisano_page
    from ..study.angrisano import claims, study_angrisano, tables
    from ..study.runs import Workers

    folder = command.output or Path(f"gnomon-study-{command.name}")
    with result_folder(folder, own=(PAGE, *(f"{name}.csv" for name in TABLES))) as staging:
        found = study_angrisano(
            runs=command.runs or RUNS[command.name],
            workers=Workers(jobs=command.jobs),
            seed=command.seed,
            progress=terminal.progress,
        )
        for table in tables(found):
            write_whole(staging / f"{table.name}.csv", table.csv())
        terminal.progress("drawing the page")
        write_whole(staging / PAGE, render(angrisano_page(found)))
        names = sorted(path.name for path in staging.iterdir())
    terminal.close()
    stated = list(claims(found))
    for claim in stated:
        terminal.say(f"{'holds' if claim.holds else 'FAILS'}  {claim.claim}", "" if claim.holds else "bold red")
        terminal.say(f"       expected {claim.expected}; found {claim.found}", "dim")
    terminal.say("")
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
