"""The notebooks of the documentation are those that were run, run again, and their pages and pictures are theirs."""

import importlib.util
import json
import re
import sys

import pytest

from docs_pages import DOCS

NOTEBOOKS = sorted(path.stem for path in (DOCS / "notebooks").glob("*.py"))


def script_cells(name):
    """Return kind and text of the cells of a script."""
    text = (DOCS / "notebooks" / f"{name}.py").read_text(encoding="utf-8")
    cells = []
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        prose = "markdown" in head
        lines = [line.removeprefix("#").removeprefix(" ") if prose else line for line in body.strip().splitlines()]
        cells.append(("markdown" if prose else "code", "\n".join(lines)))
    return cells


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_was_run_as_it_is_written(name):
    notebook = json.loads((DOCS / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]] == script_cells(name)
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= (name != "trust-and-compare")
    page = (DOCS / "notebooks" / f"{name}.md").read_text(encoding="utf-8")
    for picture in re.findall(r"\]\(([^)]*\.png)\)", page):
        assert (DOCS / "notebooks" / picture).stat().st_size > 1000


@pytest.mark.long
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("matplotlib").use("Agg")
    seen = {}
    for kind, text in script_cells(name):
        if kind == "code":
            exec(compile(text, f"{name}.py", "exec"), seen)
    sys.modules["matplotlib.pyplot"].close("all") if "matplotlib.pyplot" in sys.modules else None


def test_the_animations_are_those_that_are_drawn(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("make_movements", DOCS / "make_movements.py")
    drawing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(drawing)
    monkeypatch.setattr(drawing, "FOLDER", tmp_path)
    drawing.draw_all()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for path in (DOCS / "movements").iterdir())
    for name in names:
        assert (tmp_path / name).read_bytes() == (DOCS / "movements" / name).read_bytes()
