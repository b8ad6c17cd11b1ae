"""The report of a line: the page of page.py, of what a library's results tell; it hardly grows with their number."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from .._version import __version__
from ..assess.verdict import verdict_of
from ..fleet.charts import control_charts
from ..fleet.entries import LineTable
from ..fleet.line import LineAssessment, days_of
from ..fleet.statistics import GaugeStudy, Population, gauge_study, process_capability, wilson_interval
from ..output import write_whole
from .drawing.figures import DASHED, Sheet, draw_dots, set_y_limits, thin_points
from .numbers import MISSING, number_text, percent_text, with_sigma
from .page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section, render_page, typeset_finding

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
