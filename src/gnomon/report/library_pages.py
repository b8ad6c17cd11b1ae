"""Pages over a library that is served: devices, one device, control charts. They only read, and only a bounded part.

What they show was written by whoever added to the library, so that every text is escaped, and no page has a script.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import urlencode

from ..errors import install_line
from ..fleet.entries import LibraryEntry, LineTable, line_table
from ..fleet.library import Library
from ..fleet.line import CHANCE
from ..fleet.statistics import Population, largest_change, normal_limit, robust_population
from ..local_server import LocalServer
from .line import chart_figure
from .numbers import MISSING, with_sigma
from .page import Block, ReportTable, page_template, printable_page

_ROWS = 50
"""Devices on a page."""
_NEWEST = 200
"""Calibrations of a device that are shown."""
_CHARTED = 2000
"""Calibrations that a chart shows, the newest."""
_CAPTION = (
    f"Charts show the newest {_CHARTED} results as they are, limits from their own spread. gnomon library report "
    "looks at all of them, and takes stations that are off and changes in time out of mean and spread first."
)
_LONGEST = 64
"""Characters of a search."""
_MOST_PAGES = 1_000_000
_POLICY = "style-src 'self'; style-src-attr 'unsafe-inline'; img-src data:; form-action 'self'"


class LibraryPages:
    """Makes the pages of a library; LookupError where there is no such device or parameter.

    Parameters
    ----------
    library : opened for reading
    name : of the library, as a person knows it
    kind : only calibrations of this command; None for all
    """

    def __init__(self, library: Library, name: str, kind: str | None = None) -> None:
        self._library, self._name, self._kind = library, name, kind
        self._lock = Lock()
        self._of_state = lru_cache(maxsize=512)(self._render)

    def page(self, what: str, wanted: str = "", number: int = 1) -> bytes:
        """Return the page `what`: "devices", "device" or "chart"; it is made once until something is added."""
        with self._lock:
            return self._of_state(self._library.state(), what, wanted, number)

    def prepare(self) -> None:
        """Make the pages that take longest, so that the first visitor does not wait."""
        self.page("devices")
        self.page("chart")

    def _render(self, state: int, what: str, wanted: str, number: int) -> bytes:
        if what == "devices":
            return self._devices(wanted, number)
        return self._device(wanted) if what == "device" else self._chart(state, wanted)

    def _devices(self, search: str, number: int) -> bytes:
        skip = _ROWS * (number - 1)
        found = self._library.serials(containing=search, kind=self._kind, skip=skip, most=_ROWS + 1)
        shown = dict(found[:_ROWS])
        newest = {entry.serial: entry for entry in self._library.entries(serial=list(shown), kind=self._kind)}
        rows = [
            (_link("device", "serial", serial), str(shown[serial]), *_facts(entry), ", ".join(entry.findings[:4]))
            for serial, entry in sorted(newest.items())
        ]
        head = ("serial number", "results", "last", "kind", "verdict", "station", "its findings")
        links = {"previous": number - 1} if number > 1 else {}
        links |= {"next": number + 1} if len(found) > _ROWS else {}
        addresses = {word: "./?" + urlencode({"serial": search, "page": to}) for word, to in links.items()}
        table = ReportTable(f"Page {number}", head, rows, "" if rows else "None.", dense=True, remarked=True)
        return self._filled("Devices", [table], search=search, links=addresses)

    def _device(self, serial: str) -> bytes:
        entries = list(self._library.entries(serial=serial, kind=self._kind, newest=_NEWEST, details=True))
        if not entries:
            raise LookupError
        last = entries[-1]
        facts = [
            ("use", last.use or "general use"),
            ("operator", last.operator or MISSING),
            ("gnomon", last.version),
            ("folder", last.folder),
            *(("file", f"{name}, SHA-256 {digest}") for name, digest in last.inputs),
        ]
        blocks: list[Block] = [
            ReportTable("History", ("date", "kind", "verdict", "station", "largest change"), list(_history(entries))),
            ReportTable("Newest result", ("parameter", "estimate", "σ", "unit"), list(_parameters(last)), dense=True),
            ReportTable("Where it is from", (), facts, prose=True),
        ]
        return self._filled(serial, blocks)

    def _chart(self, state: int, name: str) -> bytes:
        table, first = self._newest(state)
        if name not in table.names and name:
            raise LookupError
        blocks: list[Block] = []
        if name:
            k = table.names.index(name)
            blocks.append(chart_figure(table, first, k, _population(table, first, k)))
        rows = [(_link("chart", "name", of), unit) for of, unit in zip(table.names, table.units, strict=True)]
        blocks.append(ReportTable("Parameters", ("parameter", "unit"), rows, _CAPTION))
        return self._filled(name or "Charts", blocks)

    @lru_cache(maxsize=1)  # noqa: B019 - there is one
    def _newest(self, _state: int) -> tuple[LineTable, list[int]]:
        table = line_table(list(self._library.entries(kind=self._kind, newest=_CHARTED)))
        rows = {entry.serial: row for row, entry in reversed(list(enumerate(table.entries)))}
        return table, sorted(rows.values())

    def _filled(
        self, title: str, blocks: Sequence[Block], *, search: str | None = None, links: dict[str, str] | None = None
    ) -> bytes:
        template = page_template("library.html.jinja")
        values = {"title": title, "subject": self._name, "blocks": blocks, "search": search, "links": links or {}}
        return printable_page(template.render(values))


class LibraryServer(LocalServer):
    """Serves the pages of a library, read-only; see `LocalServer`."""

    def __init__(self, pages: LibraryPages, *, port: int = 0, lan: bool = False) -> None:
        self._pages = pages
        shown = {"/": self._devices, "/device": self._device, "/chart": self._chart, "/page.css": self._style}
        install = f"Run: {install_line('gnomon[serve]')}"
        super().__init__(
            [(path, "GET", do) for path, do in shown.items()], policy=_POLICY, install=install, port=port, lan=lan
        )

    async def _devices(self, request: Any) -> Any:
        number = _asked(request, "page") or "1"
        if not (number.isascii() and number.isdigit() and len(number) < 8 and 0 < int(number) <= _MOST_PAGES):
            return self.say("There is no such page.", 400)
        return await self._shown("devices", _asked(request, "serial"), int(number))

    async def _device(self, request: Any) -> Any:
        return await self._shown("device", _asked(request, "serial"), limit=4096)

    async def _chart(self, request: Any) -> Any:
        return await self._shown("chart", _asked(request, "name"), limit=4096)

    async def _style(self, _request: Any) -> Any:
        return self.answer((Path(__file__).parent / "page.css").read_bytes(), "text/css")

    async def _shown(self, what: str, wanted: str, number: int = 1, *, limit: int = _LONGEST) -> Any:
        from starlette.concurrency import run_in_threadpool

        if len(wanted) > limit or "\0" in wanted:
            return self.say("That is no name.", 400)
        try:
            content = await run_in_threadpool(self._pages.page, what, wanted, number)
        except LookupError:
            return self.say("There is no such entry in the library.", 404)
        return self.answer(content, "text/html", first=True)


def _asked(request: Any, name: str) -> str:
    """Return a value of the query, "" where there is none."""
    return str(request.query_params.get(name, ""))


@lru_cache(maxsize=4096)
def _link(page: str, key: str, value: str) -> str:
    from markupsafe import Markup

    return Markup('<a href="{}?{}">{}</a>').format(page, urlencode({key: value}), value)


def _facts(entry: LibraryEntry) -> tuple[str, ...]:
    return entry.measured or MISSING, entry.kind, entry.verdict, entry.station or MISSING


def _history(entries: Sequence[LibraryEntry]) -> Iterator[tuple[str, ...]]:
    for before, entry in reversed(list(zip([None, *entries], entries, strict=False))):
        change = None if before is None else largest_change(before, entry)
        words = MISSING if change is None else f"{change.name} {change.size:+.3g} {change.unit}, z {change.z:.1f}"
        yield (*_facts(entry), words)


def _parameters(entry: LibraryEntry) -> Iterator[tuple[str, ...]]:
    numbers = zip(entry.names, entry.values.tolist(), entry.published_sigmas.tolist(), entry.units, strict=True)
    for name, value, sigma, unit in numbers:
        yield (_link("chart", "name", name), *with_sigma(value, sigma), unit)


def _population(table: LineTable, first: Sequence[int], k: int) -> Population:
    limit = normal_limit(CHANCE / max(len(first), 1))
    return robust_population(table.values[list(first), k], table.sigmas[list(first), k], limit)
