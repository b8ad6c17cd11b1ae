"""What the page on boards shows: drawings of now, descriptions that are read, commands that draw these very boards."""

import importlib.util
import re
import shlex

import pytest

from docs_pages import DOCS, text
from gnomon.cli import main
from gnomon.detect.boards.checkerboard_order import ambiguous_turns
from gnomon.formats.kalibr.target import read_target, target_text
from gnomon.models.target import Target
from gnomon.writers.board_sheet import largest_on

SHOWN = re.compile(r"boards/([\w-]+)\.svg\)(?:\n\n```yaml\n(.*?)```\n\n`gnomon (.*?)`)?", re.DOTALL)


@pytest.fixture(scope="module")
def page_maker():
    spec = importlib.util.spec_from_file_location("make_boards", DOCS / "make_boards.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_drawings_are_up_to_date(page_maker):
    for name, target in page_maker.BOARDS.items():
        drawn = (DOCS / "boards" / f"{name}.svg").read_text(encoding="utf-8")
        assert drawn == page_maker.drawing(target), "run: python docs/make_boards.py"


def test_descriptions_and_commands_are_of_the_boards_that_are_drawn(page_maker, tmp_path):
    shown = {name: (described, command) for name, described, command in SHOWN.findall(text("boards.md"))}
    assert set(shown) == set(page_maker.BOARDS)
    assert sum(bool(described) for described, _ in shown.values()) == len(shown) - 1  # the old pattern has none
    for name, (described, command) in shown.items():
        if not described:
            continue
        (tmp_path / "shown.yaml").write_text(described)
        notes = []
        assert target_text(read_target(tmp_path / "shown.yaml", notes)) == target_text(page_maker.BOARDS[name])
        assert notes == []
        words = shlex.split(command)
        assert main([*words, "-o", str(tmp_path / name), "--json"]) == 0
        assert (tmp_path / f"{name}.yaml").read_text() == target_text(page_maker.BOARDS[name])


def test_sizes_on_paper_and_their_distances():
    page = text("boards.md")
    papers = re.findall(r"(A\d) \(([\d.]+) mm\)", page)
    grid = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.05, tag_spacing=0.3)
    assert [paper for paper, _ in papers] == ["A4", "A3", "A2", "A0"]
    for paper, size in papers:
        assert largest_on(grid, paper).tag_size_m * 1000 == pytest.approx(float(size))
    rows = re.findall(r"\| (\d+) px \| ([\d.]+) m \| ([\d.]+) m \| ([\d.]+) m \| ([\d.]+) m \|", page)
    assert len(rows) == 4
    for focal, *distances in rows:
        for (_, size), distance in zip(papers, distances, strict=True):
            exact = float(focal) * float(size) / 1000 / 25
            assert float(distance) == pytest.approx(exact, rel=0.05)


def test_which_boards_look_the_same_after_a_turn():
    lengths = {"row_spacing_m": 0.1, "col_spacing_m": 0.1}
    assert ambiguous_turns(Target.checkerboard(cols=6, rows=3, **lengths)) == (0,)
    assert ambiguous_turns(Target.checkerboard(cols=7, rows=5, **lengths)) == (0, 2)
    assert ambiguous_turns(Target.circlegrid(cols=6, rows=4, spacing_m=0.1)) == (0, 2)
    assert len(ambiguous_turns(Target.circlegrid(cols=4, rows=4, spacing_m=0.1))) == 4
    for rows, turns in ((5, (0,)), (6, (0, 2))):
        assert ambiguous_turns(Target.circlegrid(cols=4, rows=rows, spacing_m=0.1, asymmetric=True)) == turns
