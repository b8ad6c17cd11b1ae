"""A module can be imported first: no module needs, on import, one that needs it."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import gnomon

ROOT = Path(gnomon.__file__).parent


def statements_on_import(body):
    """Yield the import statements that run when a module is imported: not in functions, not for types only."""
    for node in body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from statements_on_import(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for part in ("body", "orelse", "handlers", "finalbody"):
                yield from statements_on_import(getattr(node, part, []))


def imported_modules(name, path, source, names):
    """Return the modules of the package that `source`, the text of module `name`, imports."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in statements_on_import(ast.parse(source).body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in names)
            continue
        above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
        base = ".".join([*above, *([node.module] if node.module else [])])
        # `from . import part` needs the part, not only the package that is being imported already.
        parts = {f"{base}.{alias.name}" for alias in node.names} & names
        yield from parts
        if base in names and len(parts) < len(node.names):
            yield base


def import_graph(files):
    """Return the modules that each module of `files`, paths by name of the module, imports."""
    return {
        name: set(imported_modules(name, path, path.read_text(encoding="utf-8"), set(files))) - {name}
        for name, path in files.items()
    }


def modules_of(root, package):
    """Return the path of every module below `root` by its full name."""
    named = {}
    for path in root.rglob("*.py"):
        parts = path.relative_to(root).with_suffix("").parts
        named[".".join((package, *(parts[:-1] if parts[-1] == "__init__" else parts)))] = path
    return named


def test_no_module_imports_in_a_circle():
    files = modules_of(ROOT, "gnomon")
    graph = import_graph(files)
    assert "gnomon.report.drawing.figures" in graph["gnomon.report.corners"]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_a_circle_is_found(tmp_path):
    (tmp_path / "one.py").write_text("from . import two\n", encoding="utf-8")
    (tmp_path / "two.py").write_text("try:\n    from .one import x\nexcept ImportError:\n    x = 1\n", encoding="utf-8")
    with pytest.raises(CycleError):
        TopologicalSorter(import_graph(modules_of(tmp_path, "p"))).prepare()
    (tmp_path / "two.py").write_text("def later():\n    from .one import x\n    return x\n", encoding="utf-8")
    TopologicalSorter(import_graph(modules_of(tmp_path, "p"))).prepare()
