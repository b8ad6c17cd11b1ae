"""The templates of the pages, compiled once: their bytecode is kept beside that of the modules, as import keeps it."""

import zlib
from collections.abc import Mapping, MutableMapping
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

import jinja2

_HERE = Path(__file__).parent


class _Kept(SourceFileLoader):
    """Makes the code of a template where there is none of this file, or of this version of Jinja, and keeps it."""

    def __init__(self, name: str, environment: jinja2.Environment) -> None:
        super().__init__(name, str(_HERE / name))
        self._environment = environment

    def path_stats(self, path: str) -> Mapping[str, Any]:
        """Return what the kept code must be of: time and size of the file, and with them the version of Jinja."""
        stats = super().path_stats(path)
        return {**stats, "mtime": int(stats["mtime"]) ^ zlib.crc32(jinja2.__version__.encode())}

    def source_to_code(self, data: Any, path: Any) -> CodeType:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the code that Jinja makes of a template."""
        return self._environment.compile(bytes(data).decode("utf-8"), self.name, str(path))


class _Folder(jinja2.BaseLoader):
    """Templates of this folder."""

    def load(
        self,
        environment: jinja2.Environment,
        name: str,
        globals: MutableMapping[str, Any] | None = None,  # noqa: A002 - as Jinja calls it
    ) -> jinja2.Template:
        """Return a template."""
        code = _Kept(name, environment).get_code(name)
        assert code is not None
        return environment.template_class.from_code(environment, code, environment.make_globals(globals))


def load_template(name: str) -> jinja2.Template:
    """Return a template of this folder."""
    environment = jinja2.Environment(
        loader=_Folder(), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name)
