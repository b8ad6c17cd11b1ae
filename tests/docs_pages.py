"""The pages of the documentation, and the commands that they show."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))
_SHELL = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)


def text(name):
    return (DOCS / name).read_text(encoding="utf-8")


def how_to(folder):
    """Return the pages of a folder of docs/how-to, joined in the order of its index."""
    names = re.findall(r"^- \[.*\]\((.+)\)$", text(f"how-to/{folder}/index.md"), re.MULTILINE)
    return "\n".join(text(f"how-to/{folder}/{name}") for name in names)


def shell_commands(page):
    """Yield the words of every `gnomon` command in a page's shell blocks."""
    for block in _SHELL.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["gnomon"]:
                end = next((i for i, word in enumerate(words) if word.startswith((">", "2>"))), len(words))
                yield words[1:end]
