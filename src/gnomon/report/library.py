"""The report of a line of devices, and the pages over a library that is served: they only read a bounded part of it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import urlencode

import numpy as np

from .._version import __version__
from ..assess.verdict import verdict_of
from ..errors import install_line
from ..fleet.charts import control_charts
from ..fleet.entries import LibraryEntry, LineTable, line_table
from ..fleet.library import Library
from ..fleet.line import CHANCE, LineAssessment, days_of
from ..fleet.statistics import (
    GaugeStudy,
    Population,
    gauge_study,
    largest_change,
    normal_limit,
    process_capability,
    robust_population,
    wilson_interval,
)
from ..local_server import LocalServer
from ..output import write_whole
from .drawing.figures import DASHED, Sheet, draw_dots, set_y_limits, thin_points
from .numbers import MISSING, number_text, percent_text, with_sigma
from .page import (
    Block,
    Figure,
    KeyNumber,
    Legend,
    Prose,
    ReportPage,
    ReportTable,
    Section,
    load_template,
    printable_page,
    render_page,
    typeset_finding,
)

_CHARTS = 6
_WORST = 50
_EQUAL = 1e-9  # of what is needed: sigmas that scatter by less are equal but for rounding
_HEIGHT = 180.0


def write_line_report(line: LineAssessment, path: str | Path) -> None:
    """Write the report of a line as one HTML file that needs neither network nor other files.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(line_page(line)))


def line_page(line: LineAssessment) -> ReportPage:
    """Return the page of a line."""
    entries, devices = line.table.entries, len(line.first)
    newest = {entry.serial: entry for entry in entries}
    verdicts = Counter(entry.verdict for entry in newest.values())
    usable = devices - verdicts["fail"]
    told = ", ".join(f"{verdicts[verdict]} {verdict}" for verdict in ("pass", "warn", "fail"))
    again = f"{line.repeats} measurements were repetitions" if line.repeats else "each measured once"
    low, high = wilson_interval(usable, devices)
    uses = ", ".join(sorted({entry.use or "general use" for entry in entries}))
    counts = Counter(finding.code for finding in line.findings)
    return ReportPage(
        title="Line report",
        subject=f"{devices} devices, {len(entries)} results; judged for {uses}" if devices else "no results",
        verdict=verdict_of(line.findings),
        headline=_headline(counts),
        key_numbers=(
            KeyNumber("Devices", str(devices), again),
            KeyNumber(
                "Yield",
                percent_text(usable / max(devices, 1)),
                f"{told}; 95 %: {percent_text(low)} to {percent_text(high)}",
            ),
            KeyNumber("Findings", str(len(line.findings))),
        ),
        findings=tuple(typeset_finding(finding) for finding in line.findings),
        front=(_needs_table(line),),
        sections=tuple(section for section in _sections(line) if section.blocks),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def _headline(counts: Counter[str]) -> str:
    if not counts:
        return "The line is as it was, and no device is unlike the others, as far as these results tell."
    return "Found: " + ", ".join(f"{count} x {code.removeprefix('line-')}" for code, count in counts.items()) + "."


def _sections(line: LineAssessment) -> Iterator[Section]:
    yield Section(
        "charts",
        "In the order of measurement",
        blocks=[chart_figure(line.table, line.first, k, line.populations[k]) for k in _charted(line)],
    )
    yield Section("population", "The population", blocks=[_population_table(line)] if line.table.names else [])
    yield Section("worst", "Devices most unlike the others", blocks=[_worst_table(line)] if line.first else [])
    yield Section("stations", "Stations", blocks=[_station_table(line)] if line.first else [])
    method = (
        "Values are compared by their own sigmas, less the part of gravity that all share; mean and spread are those "
        "of random effects (DerSimonian and Laird 1986), without what is farther off than one of a thousand lines.",
        "Stations, steps and drifts are looked for one after the other, and each is taken off before the next.",
        "Cpk is that of the achieved sigma against what the use needs, an upper limit. %GRR: standard deviation of the "
        "gauge over that of all (AIAG), where five devices were measured twice at each of several stations.",
        "Individuals: mean +- 2.66 times the mean moving range, outliers left out. EWMA: weight 0.2, limits at three "
        "standard deviations. A chart over many devices crosses them by chance.",
    )
    yield Section("method", "How this was found", blocks=[Prose(method)])


def _needs_table(line: LineAssessment) -> ReportTable:
    """Return how well what the use needs is known, over the newest result of each device."""
    newest = {entry.serial: entry for entry in line.table.entries}
    of: dict[tuple[str, float, str], list[tuple[float, str]]] = {}
    for entry in newest.values():
        for block, sigma, needed, unit, verdict in entry.needs:
            of.setdefault((block, needed, unit), []).append((sigma, verdict))
    rows: list[tuple[str, ...]] = []
    for (block, needed, unit), known in of.items():
        sigmas = np.array([sigma for sigma, _ in known])
        spread = float(sigmas.std(ddof=1)) if len(sigmas) > 1 else 0.0
        cpk = process_capability(float(sigmas.mean()), spread, upper=needed).cpk if spread > _EQUAL * needed else np.nan
        passed = sum(verdict == "pass" for _, verdict in known)
        median = number_text(float(np.median(sigmas)), 2)
        cells = (number_text(needed, 2), median, number_text(float(sigmas.max()), 2), unit, number_text(cpk, 3))
        rows.append((block, *cells, f"{passed} of {len(known)}"))
    head = ("known, needed", "needed", "median sigma", "largest", "unit", "Cpk", "pass")
    caption = "" if rows else "General use states no needs; gnomon batch --for USE judges for one that does."
    return ReportTable("What the use needs", head, rows, caption, dense=True)


def _population_table(line: LineAssessment) -> ReportTable:
    table = line.table
    gauge = _gauge_studies(line)
    rows = [
        (
            name,
            *with_sigma(known.mean, known.mean_sigma),
            number_text(known.spread, 3),
            number_text(float(np.nanmedian(table.sigmas[:, k])), 2),
            number_text(float(line.reproducibility[k]), 2),
            percent_text(gauge[k].share) if k in gauge else MISSING,
            table.units[k],
        )
        for k, (name, known) in enumerate(zip(table.names, line.populations, strict=True))
    ]
    head = ("parameter", "mean", "sigma of it", "spread of devices", "own sigma", "repeated", "%GRR", "unit")
    caption = "Repeated: standard deviation of a device from one measurement to the next, its own sigma taken off."
    return ReportTable("Over all devices", head, rows, caption, dense=True)


def _gauge_studies(line: LineAssessment) -> dict[int, GaugeStudy]:
    """Return the gauge study of each scalar over the devices that were measured twice at each of several stations."""
    cells: dict[str, dict[str, list[int]]] = {}
    for row, entry in enumerate(line.table.entries):
        cells.setdefault(entry.serial, {}).setdefault(entry.station, []).append(row)
    stations = sorted({entry.station for entry in line.table.entries})
    crossed = [of for of in cells.values() if len(of) == len(stations) and min(map(len, of.values())) >= 2]
    if len(stations) < 2 or len(crossed) < 5:
        return {}
    rows = np.array([[of[station][:2] for station in stations] for of in crossed])
    values = {k: line.table.values[rows, k] for k in range(len(line.table.names))}
    return {k: gauge_study(y) for k, y in values.items() if np.isfinite(y).all() and np.ptp(y) > 0}


def _worst_table(line: LineAssessment) -> ReportTable:
    order = sorted(range(len(line.worst)), key=lambda row: -line.worst[row])[:_WORST]
    rows = [
        (
            (entry := line.table.entries[row]).serial,
            entry.measured or MISSING,
            entry.station or MISSING,
            entry.verdict,
            number_text(float(line.worst[row]), 3),
            line.table.names[line.worst_scalar[row]] if line.table.names else MISSING,
            ", ".join(entry.findings[:4]),
        )
        for row in order
    ]
    head = ("serial number", "date", "station", "verdict", "|z|", "of", "its own findings")
    return ReportTable(f"The {len(rows)} farthest", head, rows, dense=True, remarked=True)


def _station_table(line: LineAssessment) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for station in sorted({entry.station for entry in line.table.entries}):
        own = [entry for entry in line.table.entries if entry.station == station]
        counts = Counter(entry.verdict for entry in own)
        off = [f"{line.table.names[k]} {o.offset:+.3g} ± {o.sigma:.2g}" for k, o in line.stations if o.group == station]
        rows.append(
            (station or MISSING, str(len(own)), *(str(counts[v]) for v in ("pass", "warn", "fail")), "; ".join(off))
        )
    return ReportTable("By station", ("station", "results", "pass", "warn", "fail", "off by"), rows, remarked=True)


def _charted(line: LineAssessment) -> Sequence[int]:
    """Return the scalars that are drawn: those of findings, then those whose devices differ most for their sigmas."""
    named = [line.table.names.index(f.subject) for f in line.findings if f.subject in line.table.names]
    own = np.nanmedian(line.table.sigmas, axis=0) if line.first else np.empty(0)
    ratio = [known.spread / max(float(s), 1e-300) for known, s in zip(line.populations, own, strict=True)]
    rest = sorted(range(len(ratio)), key=lambda k: -ratio[k])
    return [k for k in dict.fromkeys([*named, *rest]) if line.populations[k].count > 1][:_CHARTS]


def chart_figure(table: LineTable, first: Sequence[int], k: int, known: Population) -> Figure:
    """Return the control chart of the scalar k; see `control_charts`."""
    rows = [row for row in first if np.isfinite(table.values[row, k])]
    y = table.values[rows, k]
    individuals, chart = control_charts(table, first, k, known)
    x, name = np.arange(1.0, len(y) + 1), table.names[k]
    sheet = Sheet()
    panel = sheet.panel(f"{name} [{table.units[k]}]", top=38, height=_HEIGHT, x_label="device, in the order of dates")
    panel.x.span(0, len(y) + 1)
    reach = 4 * float(np.median(np.hypot(known.spread, table.sigmas[rows, k])))
    limits = (individuals.lower[:1], individuals.upper[:1])
    set_y_limits(panel, np.clip(y, known.mean - 2 * reach, known.mean + 2 * reach), chart.upper, chart.lower, *limits)
    draw_dots(panel, *thin_points(x, y), "muted", size=3.0)
    panel.line(*thin_points(x, chart.points), "x", width=1.6)
    some = np.unique(np.linspace(0, len(y) - 1, 60).astype(int))
    for edge in (chart.lower, chart.upper):
        panel.line(x[some], edge[some], "ink", width=1.0, dash=DASHED)
    for edge in (individuals.lower, individuals.upper):
        panel.line(x[[0, -1]], edge[[0, -1]], "muted", width=1.0)
    days = days_of([table.entries[row] for row in rows])
    caption = (
        f"{len(individuals.signals)} of {len(y)} devices and {len(chart.signals)} averages are beyond their limits; "
        f"{int(days.max() - days.min())} days."
    )
    legend = (
        Legend("dot", "muted", "device"),
        Legend("line", "muted", "limits of individuals"),
        Legend("line", "x", "EWMA"),
        Legend("dash", "ink", "its limits"),
    )
    return Figure(name, sheet.draw(f"chart-{k}", _HEIGHT + 96, f"control chart of {name}"), legend, caption)


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
        template = load_template("library.html.jinja")
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
