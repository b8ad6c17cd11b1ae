"""An import tells what it brings: a public name is defined in one module, a function has more than one word."""

import re
from collections import Counter
from pathlib import Path

import gnomon

# `export` of every format, and `main`: of the package, and of the command line.
MOST_SHARED = 2
# `export` of every format, what `import gnomon` offers (`read`, `save`, ...), and `main`, `skew`, `irls`.
MOST_BARE = 28
DEFINITION = re.compile(r"^(?:async )?(def|class) ([A-Za-z]\w*)", re.MULTILINE)


def definitions():
    """Return "def" or "class", name and module of everything public that a module defines."""
    root = Path(gnomon.__file__).parent
    for path in sorted(root.rglob("*.py")):
        for kind, name in DEFINITION.findall(path.read_text(encoding="utf-8")):
            yield kind, name, path.relative_to(root).as_posix()


def test_public_names_are_defined_in_one_module():
    count = Counter(name for name, _ in {(name, module) for _, name, module in definitions()})
    shared = sorted(name for name, modules in count.items() if modules > 1)
    assert 0 < len(shared) <= MOST_SHARED, shared


def test_functions_are_not_named_by_one_bare_word():
    bare = [f"{module}: {name}" for kind, name, module in definitions() if kind == "def" and "_" not in name]
    assert 0 < len(bare) <= MOST_BARE, bare
