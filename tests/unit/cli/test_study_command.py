"""`gnomon study`: the list, options, progress, and going on after an interrupt; with a study that takes no time."""

import inspect
import json
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from gnomon.cli import main
from gnomon.cli.commands.study import STUDIES, StudyEntry, StudyFunctions, tell_stage
from gnomon.cli.terminal import Terminal
from gnomon.progress import Step
from gnomon.report.page import KeyNumber, render_page
from gnomon.report.studies import study_page
from gnomon.study.journal import JOURNAL
from gnomon.study.runs import Claim, StudyTable, carry_out, claims_table, ratio_agrees, run_seeds, scatter_bounds
from study_work import Task, drawn


@dataclass(frozen=True, kw_only=True)
class Found:
    runs: int
    seed: int
    largest: list[float]


class Quick:
    """A study of a few runs that can be stopped on the way."""

    def __init__(self):
        self.began = []
        self.stop_at = None

    def carry_out(self, *, runs, workers, seed, progress):
        tasks = [Task(seed=number) for number in run_seeds(seed, runs)]
        outcomes = carry_out(self.work(), tasks, workers=workers, progress=progress, name="draw")
        return Found(runs=runs, seed=seed, largest=[float(o.matrix.max()) for o in outcomes])

    def work(self):
        def drawn_here(task):
            if len(self.began) == self.stop_at:
                raise KeyboardInterrupt
            self.began.append(task.seed)
            return drawn(task)

        drawn_here.__module__, drawn_here.__qualname__ = drawn.__module__, drawn.__qualname__
        drawn_here.__annotations__ = drawn.__annotations__
        return drawn_here

    def claims(self, found):
        yield Claim(claim="drawn in m/s^2", expected="> 0", found=str(min(found.largest)), holds=min(found.largest) > 0)
        yield Claim(claim="never", expected="0", found="1", holds=False)

    def tables(self, found):
        yield StudyTable(name="largest", head=("largest",), rows=[(x,) for x in found.largest])

    def page(self, found):
        number = KeyNumber(label="runs", value=str(found.runs))
        return study_page("A study", "quick", tuple(self.claims(found)), (number,), ())


@pytest.fixture
def quick(monkeypatch, tmp_path):
    made = Quick()
    parts = StudyFunctions(carry_out=made.carry_out, claims=made.claims, tables=made.tables, page=made.page)
    entry = StudyEntry(
        about="nothing at all",
        counted="draws",
        runs=6,
        minutes=0.1,
        stages=("draw",),
        tables=("largest",),
        load=lambda: parts,
    )
    monkeypatch.setattr("gnomon.cli.commands.study.STUDIES", {"quick": entry, **STUDIES})
    monkeypatch.chdir(tmp_path)
    return made


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_without_a_name_the_studies_are_listed_with_what_they_cost(capsys):
    assert main(["study"]) == 0
    out = capsys.readouterr().out
    for name, entry in STUDIES.items():
        assert f"{name}\n  {entry.about}\n  {entry.runs} {entry.counted}: about" in out
    assert main(["study", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["studies"]
    assert set(listed) == set(STUDIES)
    assert all(study["minutes"] > 0 for study in listed.values())


@pytest.mark.parametrize("name", list(STUDIES))
def test_every_study_can_be_loaded(name):
    parts = STUDIES[name].load()
    assert callable(parts.carry_out)
    assert "claims" in STUDIES[name].tables


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["tedaldy"], "Did you mean tedaldi"),
        (["unheard"], "There are: tedaldi"),
        (["tedaldi", "--jobs", "2", "--scheduler", "tcp://host:8786"], "Leave out --jobs"),
        (["tedaldi", "--runs", "1"], "runs 1"),
        (["tedaldi", "--scheduler", ""], "--scheduler is empty"),
    ],
)
def test_impossible_options_are_refused(arguments, word, capsys):
    assert main(["study", *arguments]) == 2
    assert word in " ".join(capsys.readouterr().err.replace("│", " ").split())


def test_an_interrupted_study_goes_on_and_ends_as_if_it_never_was(quick, capsys, tmp_path):
    assert main(["study", "quick", "-o", "whole"]) == 0
    whole = files(tmp_path / "whole")
    assert set(whole) == {"study.html", "largest.csv", JOURNAL}
    capsys.readouterr()
    quick.began.clear()
    quick.stop_at = 4
    assert main(["study", "quick", "-o", "part"]) == 130
    assert set(files(tmp_path / "part")) == {JOURNAL}
    err = capsys.readouterr().err
    assert err.splitlines()[-1] == (
        "gnomon: interrupted; 4 runs that are done are kept, and the same command goes on from there."
    )
    quick.stop_at = None
    assert main(["study", "quick", "-o", "part"]) == 0
    assert "draw: 4 of 6 were done before and are taken over" in capsys.readouterr().err
    assert len(quick.began) == 6
    assert files(tmp_path / "part") == whole


def test_more_runs_take_over_fewer_and_another_seed_none(quick, tmp_path):
    quick.stop_at = 3
    assert main(["study", "quick"]) == 130
    quick.stop_at = 5
    assert main(["study", "quick", "--seed", "1"]) == 130
    assert len(quick.began) == 5
    quick.stop_at = None
    assert main(["study", "quick", "--runs", "8"]) == 0
    assert quick.began == [*run_seeds(0, 3), *run_seeds(1, 2), *run_seeds(0, 8)[3:]]
    assert (tmp_path / "gnomon-study-quick" / "largest.csv").read_text().count("\n") == 9


def test_a_finished_study_is_shown_again_from_its_journal_unless_something_changed(quick, tmp_path, monkeypatch):
    folder = tmp_path / "gnomon-study-quick"
    assert main(["study", "quick"]) == 0
    first = files(folder)
    quick.began.clear()
    (folder / "study.html").unlink()
    assert main(["study", "quick"]) == 0
    assert quick.began == []
    assert files(folder) == first
    assert main(["study", "quick", "--runs", "7"]) == 0
    assert quick.began == run_seeds(0, 7)[6:]
    quick.began.clear()
    monkeypatch.setattr("gnomon.study.journal._sources", lambda: "changed")
    assert main(["study", "quick"]) == 0
    assert quick.began == run_seeds(0, 6)


def test_what_few_runs_cannot_tell_is_neither_held_nor_failed(quick, capsys, tmp_path):
    def claims(found):
        least, most = scatter_bounds(found.runs, 0.15)
        yield Claim(claim="alike", expected="about 1", found="1.5", holds=ratio_agrees(least < 1.5 < most, least, most))

    quick.claims = claims
    page = quick.page(Found(runs=6, seed=0, largest=[1.0]))
    assert (page.verdict, page.headline) == ("warn", "0 of 1 claims hold; 1 cannot be told from so few runs.")
    assert claims_table(claims(Found(runs=6, seed=0, largest=[]))).csv().endswith(",1.5,\n")
    assert [claim.holds for runs in (6, 500) for claim in claims(Found(runs=runs, seed=0, largest=[]))] == [None, False]


def test_claims_can_be_read_on_a_narrow_screen(quick):
    html = render_page(quick.page(Found(runs=6, seed=0, largest=[1.0]))).decode()
    assert '<th scope="row" data-head="Holds">no</th><td data-head="Claim">never</td>' in html
    assert re.search(r"max-width: 520px.*\.stacked td::before \{ content: attr\(data-head\)", html, re.DOTALL)


@pytest.mark.parametrize("name", list(STUDIES))
def test_stages_are_those_of_the_study(name):
    source = Path(inspect.getfile(STUDIES[name].load().carry_out)).read_text()
    stages = re.findall(r'carry_out\([^"]*name="([^"]+)"|run_each\("([^"]+)"', source)
    assert tuple(stage or each for stage, each in stages) == STUDIES[name].stages


def test_progress_says_which_stage_of_how_many(capsys):
    terminal = Terminal()
    for name in ("run", "scan"):
        for done in (1, 2, 3):
            tell_stage(terminal, ("run", "scan"), Step(name, done, 3))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "stage 1 of 2: run: 1 of 3"
    assert lines[-1] == "stage 2 of 2: scan: 3 of 3"


def test_a_claim_that_fails_is_a_result_like_any_other(quick, capsys):
    assert main(["study", "quick", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [claim["holds"] for claim in document["claims"]] == [True, False]
    assert document["runs"] == 6
    assert set(document["files"]) == {"study", "largest"}


def test_nothing_is_left_where_nothing_was_done(quick, capsys, tmp_path):
    quick.stop_at = 0
    assert main(["study", "quick", "-o", "none"]) == 130
    assert capsys.readouterr().err.splitlines()[-1].startswith("gnomon: interrupted;")
    assert not (tmp_path / "none").exists()
