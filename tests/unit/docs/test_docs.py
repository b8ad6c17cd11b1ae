"""The examples in the README and the documentation do what they show."""

import doctest
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGES = sorted(path for path in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")) if path.exists())
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_python_examples(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    text = page.read_text(encoding="utf-8")
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start(1))
        if ">>>" not in block[1]:
            compile(block[1], f"{page.name}:{line + 1}", "exec")
            continue
        example = doctest.DocTestParser().get_doctest(block[1], names, page.name, str(page), line)
        report = []
        runner.run(example, out=report.append, clear_globs=False)
        names.update(example.globs)
        assert runner.failures == 0, "".join(report)


@pytest.mark.parametrize("page", sorted(ROOT.glob("docs/how-to/devices/*.md")), ids=lambda page: page.stem)
def test_a_page_on_a_device_leads_on(page):
    assert "](" in page.read_text(encoding="utf-8").rstrip().rpartition("\n\n")[2]
