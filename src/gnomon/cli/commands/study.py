"""The command that repeats published experiments; of each there is an entry in STUDIES, and study/NAME.py."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from ...errors import OptionError
from ...frozen import value_class
from ...progress import as_step
from ..arguments import Argument
from ..command import Command, Seed, output_option
from ..files import result_folder
from ..results import USABLE
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...report.page import ReportPage
    from ...study.journal import FileJournal
    from ...study.runs import Claim, Progress, StudyTable, Workers


class Found(Protocol):
    """What every study tells of itself."""

    @property
    def runs(self) -> int:
        """How many there were, as --runs counts them."""
        ...

    @property
    def seed(self) -> int:
        """Where the random numbers came from."""
        ...


class CarryOut(Protocol):
    """A study's function."""

    def __call__(self, *, runs: int, workers: "Workers", seed: int, progress: "Progress | None") -> Any:
        """Carry it out."""
        ...


@value_class(eq=True)
class StudyFunctions:
    """The functions of a study.

    Attributes
    ----------
    carry_out : does the runs, and returns what was found
    claims, tables, page : of what was found
    """

    carry_out: CarryOut
    claims: Callable[[Any], "Iterable[Claim]"]
    tables: Callable[[Any], "Iterable[StudyTable]"]
    page: Callable[[Any], "ReportPage"]


@value_class(eq=True)
class StudyEntry:
    """A study, as far as it can be told without loading it.

    Attributes
    ----------
    about : one sentence
    counted : what --runs counts
    runs : how many of them the published numbers need
    minutes : that these take on one core
    stages : what it does one after the other, as progress names it
    tables : names of its tables
    load : returns its functions
    """

    about: str
    counted: str
    runs: int
    minutes: float
    stages: tuple[str, ...]
    tables: tuple[str, ...]
    load: Callable[[], StudyFunctions]


def _angrisano() -> StudyFunctions:
    from ...report.studies.angrisano import angrisano_page
    from ...study.angrisano import angrisano_claims, angrisano_tables, study_angrisano

    return StudyFunctions(
        carry_out=study_angrisano, claims=angrisano_claims, tables=angrisano_tables, page=angrisano_page
    )


def _circuit() -> StudyFunctions:
    from ...report.studies.circuit import circuit_page
    from ...study.circuit import circuit_claims, circuit_tables, study_circuit

    return StudyFunctions(carry_out=study_circuit, claims=circuit_claims, tables=circuit_tables, page=circuit_page)


def _krebs() -> StudyFunctions:
    from ...report.studies.krebs import krebs_page
    from ...study.krebs import study_krebs
    from ...study.krebs_claims import krebs_claims, krebs_tables

    return StudyFunctions(carry_out=study_krebs, claims=krebs_claims, tables=krebs_tables, page=krebs_page)


def _tedaldi() -> StudyFunctions:
    from ...report.studies.tedaldi import tedaldi_page
    from ...study.tedaldi import study_tedaldi, tedaldi_claims, tedaldi_tables

    return StudyFunctions(carry_out=study_tedaldi, claims=tedaldi_claims, tables=tedaldi_tables, page=tedaldi_page)


def _temperature() -> StudyFunctions:
    from ...report.studies.temperature import temperature_study_page
    from ...study.temperature import study_temperature, temperature_claims, temperature_tables

    return StudyFunctions(
        carry_out=study_temperature, claims=temperature_claims, tables=temperature_tables, page=temperature_study_page
    )


STUDIES: Mapping[str, StudyEntry] = {
    "tedaldi": StudyEntry(
        about="Tedaldi 2014, an IMU from rests and rotations: Tables 4.1 to 4.5, gnomon beside what was published",
        counted="recordings of each of 40 parameter sets",
        runs=30,
        minutes=15,
        stages=("recording",),
        tables=("claims", "parameters", "tedaldi_2014", "signals"),
        load=_tedaldi,
    ),
    "krebs": StudyEntry(
        about="Krebs, camera and IMU before a board: its sigmas at three noise levels, and what neglect costs",
        counted="recordings of 90 s of each of seven series",
        runs=100,
        minutes=50,
        stages=("recording", "changed parameter", "setting", "recording without noise"),
        tables=("claims", "parameters", "table_5_3", "runs", "independence", "settings"),
        load=_krebs,
    ),
    "angrisano": StudyEntry(
        about="Angrisano, the accelerometer from magnitudes: its sigmas, and the starts from which it converges",
        counted="experiments of each of three settings",
        runs=500,
        minutes=15,
        stages=("experiment", "scan of starts"),
        tables=("claims", "parameters", "runs", "starts", "iterations"),
        load=_angrisano,
    ),
    "circuit": StudyEntry(
        about="odometry on walks of 60 to 120 m: what calibrations of different depth, and errors of each part, cost",
        counted="rigs, each with a walk",
        runs=30,
        minutes=20,
        stages=("rig", "walk with parts off", "walk at the limits"),
        tables=("claims", "levels", "walks", "parts"),
        load=_circuit,
    ),
    "temperature": StudyEntry(
        about="biases over the temperature: gnomon beside the methods of PX4 and ArduPilot, on a warm-up left out",
        counted="sensors, each with five warm-ups",
        runs=100,
        minutes=12,
        stages=("sensor", "sensor that does not change"),
        tables=("claims", "warm_ups"),
        load=_temperature,
    ),
}
"""The studies by their names."""
PAGE = "study.html"
_OLD_JOURNAL = "unfinished.journal"  # of gnomon before studies kept it


@dataclass(frozen=True, kw_only=True)
class Study(Command):
    """Repeat an experiment many times with simulated sensors, and say whether what is claimed holds.

    A study that was interrupted goes on where it was when the same command is given again. Without a name, list the
    studies and what they cost.

    Examples
    --------
    $ gnomon study
    $ gnomon study tedaldi --jobs 2
    """

    name: Annotated[
        str | None,
        Argument(positional=True, metavar=f"{{{','.join(STUDIES)}}}"),
    ] = None
    """tedaldi: the simulations of Tedaldi 2014. krebs: those of Krebs. angrisano: the experiment of Angrisano.
    circuit: a rig carried round a circuit, with and without its calibration. temperature: biases over the temperature,
    beside the methods of PX4 and ArduPilot."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for study.html and the tables as CSV (default: gnomon-study-NAME)."""
    runs: int | None = None
    """How many runs of each kind (the list says what is counted); as many as the published numbers need where not
    given."""
    jobs: int = 1
    """Processes that share them; the result does not depend on it."""
    scheduler: Annotated[str | None, Argument(metavar="ADDRESS")] = None
    """Let the workers of an existing Dask cluster do them, such as tcp://host:8786; needs gnomon[dask]."""
    seed: Seed = 0

    def __post_init__(self) -> None:
        if self.name is not None and self.name not in STUDIES:
            near = get_close_matches(self.name, STUDIES, 1)
            meant = f"Did you mean {near[0]}?" if near else f"There are: {', '.join(STUDIES)}."
            raise OptionError(f"there is no study {self.name}. {meant}")
        if self.runs is not None and self.runs < 2:
            raise OptionError(f"runs {self.runs} must be at least 2, since one has no scatter.")
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")
        if self.jobs > 1 and self.scheduler is not None:
            raise OptionError("the workers of --scheduler do all the work. Leave out --jobs.")
        if self.scheduler is not None and not self.scheduler.strip():
            raise OptionError("--scheduler is empty. Give the address that the scheduler prints, tcp://host:8786.")

    def run(self, terminal: Terminal) -> int:
        """Carry out a study, write its folder, and return the exit code.

        A claim that does not hold is a result like any other: the exit code is that of work which was finished.
        """
        from ...study.journal import study_journal

        if self.name is None:
            return _list_studies(terminal)
        entry = STUDIES[self.name]
        folder = self.output or Path(f"gnomon-study-{self.name}")
        every = {f"{table}.csv" for known in STUDIES.values() for table in known.tables}
        with result_folder(folder, "study", own=(PAGE, _OLD_JOURNAL, *every)) as staging:
            parts = entry.load()
            with study_journal(folder, self.name, terminal.progress) as journal:
                found = _carried_out(self, parts, entry, journal, terminal)
            names = _write(found, parts, staging, terminal)
        stated = list(parts.claims(found))
        _print_claims(stated, terminal)
        terminal.print(f"page   {folder / PAGE}")
        terminal.document(
            {
                "study": self.name,
                "runs": found.runs,
                "seed": found.seed,
                "claims": stated,
                "files": {Path(name).stem: str(folder / name) for name in names},
            }
        )
        return USABLE


def _carried_out(
    command: Study, parts: StudyFunctions, entry: StudyEntry, journal: "FileJournal", terminal: Terminal
) -> Found:
    from ...study.runs import Workers

    try:
        return parts.carry_out(
            runs=command.runs or entry.runs,
            workers=Workers(jobs=command.jobs, scheduler=command.scheduler or "", journal=journal),
            seed=command.seed,
            progress=partial(tell_stage, terminal, entry.stages),
        )
    except KeyboardInterrupt as stop:
        if len(journal) == 0:
            raise
        raise KeyboardInterrupt(f"interrupted; {journal.kept}") from stop


def tell_stage(terminal: Terminal, stages: tuple[str, ...], sentence: str) -> None:
    """Tell a step of a study, with its place among the stages."""
    step = as_step(sentence)
    if step.stage in stages and len(stages) > 1:
        step = step.within(f"stage {stages.index(step.stage) + 1} of {len(stages)}")
    terminal.progress(step)


def _write(found: Found, parts: StudyFunctions, staging: Path, terminal: Terminal) -> list[str]:
    """Write tables and page, and return the names of the files."""
    from ...output import write_whole
    from ...report.page import render_page

    contents: dict[str, str | bytes] = {f"{table.name}.csv": table.csv() for table in parts.tables(found)}
    terminal.progress("drawing the page")
    contents[PAGE] = render_page(parts.page(found))
    for name, content in contents.items():
        write_whole(staging / name, content)
    return sorted(contents)


def _print_claims(stated: "Sequence[Claim]", terminal: Terminal) -> None:
    for claim in stated:
        word = "too few runs to tell:" if claim.holds is None else "holds " if claim.holds else "FAILS "
        terminal.print(f"{word} {claim.claim}", "bold red" if claim.holds is False else "")
        terminal.print(f"       expected {claim.expected}; found {claim.found}", "dim")
    terminal.print("")


def _list_studies(terminal: Terminal) -> int:
    for name, entry in STUDIES.items():
        terminal.print(name, "bold")
        terminal.print(f"  {entry.about}")
        terminal.print(f"  {entry.runs} {entry.counted}: about {entry.minutes:g} minutes on one core", "dim")
    terminal.print("")
    terminal.print("gnomon study NAME --jobs N; --runs FEWER for a glance.")
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


# _TOLD = 20  # lines at most, where there is no terminal
