"""Run the notebooks and write them with what they show: docs/notebooks/*.ipynb, and a page of each for the site.

    python docs/make_notebooks.py [NAME...]

A notebook is written as a script, docs/notebooks/NAME.py, whose cells begin with `# %%`; it runs in a folder of its
own that is thrown away.
"""

import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

FOLDER = Path(__file__).parent / "notebooks"


def run_notebook(source: Path) -> nbformat.NotebookNode:
    """Return the notebook of a script with all that its cells print and draw; a cell that fails raises."""
    notebook = jupytext.read(source)
    notebook.metadata = nbformat.NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"}
    )
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}}).execute()
    for k, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{k}"
        cell.get("metadata", {}).pop("execution", None)  # times of the day
    return notebook


def write_notebook(source: Path) -> None:
    """Write NAME.ipynb, and NAME.md with the pictures beside it."""
    notebook = run_notebook(source)
    nbformat.write(notebook, source.with_suffix(".ipynb"))
    exporter = MarkdownExporter()
    page, found = exporter.from_notebook_node(notebook)
    for name, data in found["outputs"].items():
        page = page.replace(f"({name})", f"({source.stem}-{name})").replace("![png]", "![The figure of the cell above]")
        (FOLDER / f"{source.stem}-{name}").write_bytes(data)
    head = f"<!-- Made by docs/make_notebooks.py from {source.name}; do not edit. -->\n"
    download = f"[This notebook]({source.stem}.ipynb) to download and run.\n"
    title, _, rest = page.lstrip().partition("\n")
    source.with_suffix(".md").write_text(f"{head}\n{title}\n\n{download}{rest}", encoding="utf-8")


if __name__ == "__main__":
    names = sys.argv[1:] or sorted(path.stem for path in FOLDER.glob("*.py"))
    for name in names:
        write_notebook(FOLDER / f"{name}.py")
