"""The studies there are. Another one is an entry here, a room's file study/NAME.py and a page report/study_NAME.py."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from ..report.page import Page
    from ..study.runs import Progress, Workers
    from ..study.tables import Claim, StudyTable


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The functions of a study.

    Attributes
    ----------
    carry_out : does the runs, and returns what was found
    claims, tables, page : of what was found
    """

    carry_out: CarryOut
    claims: Callable[[Any], "Iterable[Claim]"]
    tables: Callable[[Any], "Iterable[StudyTable]"]
    page: Callable[[Any], "Page"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyEntry:
    """A study, as far as it can be told without loading it.

    Attributes
    ----------
    about : one sentence
    counted : what --runs counts
    runs : how many of them the document's numbers need
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
    load: Callable[[], Parts]


def _angrisano() -> Parts:
    from ..report.study_angrisano import angrisano_page
    from ..study.angrisano import claims, study_angrisano, tables

    return Parts(carry_out=study_angrisano, claims=claims, tables=tables, page=angrisano_page)


def _krebs() -> Parts:
    from ..report.study_krebs import krebs_page
    from ..study.krebs import study_krebs
    from ..study.krebs_claims import claims, tables

    return Parts(carry_out=study_krebs, claims=claims, tables=tables, page=krebs_page)


def _tedaldi() -> Parts:
    from ..report.study_tedaldi import tedaldi_page
    from ..study.tedaldi import study_tedaldi
    from ..study.tedaldi_claims import claims, tables

    return Parts(carry_out=study_tedaldi, claims=claims, tables=tables, page=tedaldi_page)


STUDIES: Mapping[str, StudyEntry] = {
    "tedaldi": StudyEntry(
        about="document A, an IMU from rests and rotations: Tables 4.1 to 4.5, gnomon beside what was published",
        counted="recordings of each of 40 parameter sets",
        runs=30,
        minutes=15,
        stages=("recording",),
        tables=("claims", "parameters", "document_a", "signals"),
        load=_tedaldi,
    ),
    "krebs": StudyEntry(
        about="document B, camera and IMU before a board: its sigmas at three noise levels, and what neglect costs",
        counted="recordings of 90 s of each of seven series",
        runs=100,
        minutes=50,
        stages=("recording", "changed parameter", "setting", "recording without noise"),
        tables=("claims", "parameters", "table_5_3", "runs", "independence", "settings"),
        load=_krebs,
    ),
    "angrisano": StudyEntry(
        about="document C, the accelerometer from magnitudes: its sigmas, and the starts from which it converges",
        counted="experiments of each of three settings",
        runs=500,
        minutes=15,
        stages=("experiment", "scan of starts"),
        tables=("claims", "parameters", "runs", "starts", "iterations"),
        load=_angrisano,
    ),
}
"""The studies by their names."""
