"""A page as HTML: one page for every kind of calibration, which knows nothing of sensors.

Every text is escaped here; only the figures, which `figures.draw` makes, are taken as they are.
"""

import base64
import hashlib
from collections.abc import Iterable
from html import escape
from pathlib import Path

from ..findings import Finding, printable
from .page import (
    Bar,
    Block,
    Code,
    Figure,
    KeyNumber,
    Legend,
    Page,
    Parameter,
    ParameterGroup,
    Parameters,
    Prose,
    Section,
    Table,
)

_HERE = Path(__file__).parent
_MARKS = {
    "dot": '<circle cx="11" cy="6" r="4" class="fill"/>',
    "ring": '<circle cx="11" cy="6" r="3.4"/>',
    "band": '<rect x="1" y="1" width="20" height="10" class="fill faint"/>',
    "square-wave": '<path d="M1 10H6V2H16V10H21"/>',
    "dash": '<path d="M1 6H21" stroke-dasharray="5 3"/>',
    "line": '<path d="M1 6H21"/>',
}
_GOOD = '<circle cx="10" cy="10" r="9"/><path d="M5.8 10.4L8.8 13.4L14.2 7"/>'
_WARNING = '<path class="shape" d="M10 1.6L19 18H1Z"/><path d="M10 7.4V12M10 14.6V15"/>'
_PROBLEM = (
    '<path class="shape" d="M6.2 1H13.8L19 6.2V13.8L13.8 19H6.2L1 13.8V6.2Z"/>'
    '<path d="M6.8 6.8L13.2 13.2M13.2 6.8L6.8 13.2"/>'
)
_INFO = '<circle cx="10" cy="10" r="9"/><path d="M10 9V14.4M10 5.6V6"/>'
_ICONS = {"good": _GOOD, "pass": _GOOD, "warning": _WARNING, "warn": _WARNING, "problem": _PROBLEM, "fail": _PROBLEM}
_CALM = ("good", "info")
_BRAND = (
    '<a class="brand" href="#top" aria-label="gnomon, top of the report">\n'
    '    <svg viewBox="0 0 32 32" aria-hidden="true"><path class="z" d="M14 19V3M10.8 7L14 2.6L17.2 7"/>'
    '<path class="y" d="M14 19L28.4 23.6M24.2 25.6L29 23.8L25.8 19.8"/>'
    '<path class="x" d="M14 19L4.2 27.6M5 23L3.4 28.3L8.8 27.6"/></svg>\n'
    "    gnomon</a>"
)
_PARAMETER_HEAD = (
    '<thead><tr><th scope="col">Parameter</th><th scope="col">Estimate ± σ</th><th scope="col">Reads as</th>'
    '<th scope="col"><span class="unseen">Drawn with error bar</span></th></tr></thead>'
)
_HINT = (
    '<p class="hint" hidden>Figures: click or tap one, then zoom with the wheel or two fingers (or + and −), drag to '
    "move, double-click for all of it.</p>"
)


def render(page: Page) -> bytes:
    """Return the page as one UTF-8 HTML document that refers to nothing outside itself."""
    style, script = ((_HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    # The page may run this one script and load nothing, whatever a file name might try to smuggle in.
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    # A file name may hold bytes that are no text, or steer a terminal that shows the file; they are shown as escapes.
    return printable(_document(page, style, script, policy)).encode("utf-8", "backslashreplace")


def _document(page: Page, style: str, script: str, policy: str) -> str:
    links = [_link("verdict", "Verdict"), *(_link(section.anchor, section.title) for section in page.sections)]
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="generator" content="gnomon">
<title>{escape(page.title)}: {page.verdict} – {escape(page.subject)}</title>
<link rel="icon" href="data:,">
<style>
{style}
</style>
</head>
<body>
<header class="masthead">
  {_BRAND}
  <span class="kind">{escape(page.title)}</span>
</header>
<div class="layout">
<nav aria-label="Sections">
  <ol>
{_lines(links)}
  </ol>
</nav>
<main id="top">
{_verdict(page)}
{_lines(map(_section, page.sections))}
<footer>
{_HINT}
<p>{escape(page.footer)}</p>
</footer>
</main>
</div>
<script>{script}</script>
</body>
</html>
"""


def _lines(parts: Iterable[str]) -> str:
    return "\n".join(part for part in parts if part)


def _element(tag: str, text: str, *, kind: str = "") -> str:
    """Return a text in an element, nothing where it is empty."""
    name = f' class="{kind}"' if kind else ""
    return f"<{tag}{name}>{escape(text)}</{tag}>" if text else ""


def _link(anchor: str, title: str) -> str:
    return f'    <li><a href="#{escape(anchor)}">{escape(title)}</a></li>'


def _icon(severity: str) -> str:
    return f'<svg class="icon" viewBox="0 0 20 20" aria-hidden="true">{_ICONS.get(severity, _INFO)}</svg>'


def _verdict(page: Page) -> str:
    pressing = [finding for finding in page.findings if finding.severity not in _CALM]
    calm = [finding for finding in page.findings if finding.severity in _CALM]
    title = f"<b>{page.verdict.capitalize()}.</b> {escape(page.headline)}"
    return _lines(
        [
            '<section id="verdict" aria-labelledby="verdict-title">',
            f'  <p class="subject">{escape(page.subject)}</p>',
            f'  <h1 id="verdict-title" class="verdict {page.verdict}">{_icon(page.verdict)}<span>{title}</span></h1>',
            '  <dl class="numbers">',
            *map(_key_number, page.key_numbers),
            "  </dl>",
            _findings("What to do", pressing),
            _findings("Good to know", calm),
            "</section>",
        ]
    )


def _key_number(item: KeyNumber) -> str:
    note = _element("dd", item.note, kind="note")
    return f"    <div><dt>{escape(item.label)}</dt><dd>{escape(item.value)}</dd>{note}</div>"


def _findings(title: str, findings: list[Finding]) -> str:
    if not findings:
        return ""
    return f'  <h2 class="small">{title}</h2>\n  <ul class="findings">{"".join(map(_finding, findings))}</ul>'


def _finding(item: Finding) -> str:
    cure = f'<p class="cure"><span aria-hidden="true">→</span> {escape(item.cure)}</p>' if item.cure else ""
    what = f'<span class="unseen">{item.severity}: </span>{escape(item.message)}'
    return _lines(
        [
            f'<li class="finding {item.severity}">',
            f"  {_icon(item.severity)}",
            "  <div>",
            f'    <p class="what">{what}</p>',
            _element("p", item.consequence, kind="consequence"),
            cure,
            "  </div>",
            "</li>\n",
        ]
    )


def _section(section: Section) -> str:
    anchor = escape(section.anchor)
    return _lines(
        [
            f'<section id="{anchor}" aria-labelledby="{anchor}-title">',
            f'  <h2 id="{anchor}-title">{escape(section.title)}</h2>',
            _element("p", section.lead, kind="lead"),
            *map(_block, section.blocks),
            "</section>",
        ]
    )


def _block(block: Block) -> str:
    match block:
        case Figure():
            return _figure(block)
        case Table():
            return _table(block)
        case Parameters():
            return _parameters(block)
        case Code():
            text = f'<pre class="scroll" tabindex="0"><code>{escape(block.text)}</code></pre>'
            return f'<div class="block"><h3>{escape(block.title)}</h3>{text}</div>'
        case Prose():
            tag = "li" if block.points else "p"
            lines = "".join(f"<{tag}>{escape(line)}</{tag}>" for line in block.lines)
            return f'<ul class="points">{lines}</ul>' if block.points else lines


def _figure(block: Figure) -> str:
    legend = "".join(f"<li>{_swatch(item)}{escape(item.label)}</li>" for item in block.legend)
    return _lines(
        [
            "<figure>",
            f"  <h3>{escape(block.title)}</h3>",
            f'  <ul class="legend">{legend}</ul>' if legend else "",
            f'  <div class="canvas">{block.svg}</div>',
            _element("figcaption", block.caption),
            "</figure>",
        ]
    )


def _swatch(item: Legend) -> str:
    style = f"--swatch: var(--plot-{escape(item.color)})"
    return f'<svg class="swatch" viewBox="0 0 22 12" aria-hidden="true" style="{style}">{_MARKS[item.mark]}</svg>'


def _scroll(label: str, kind: str, parts: Iterable[str]) -> list[str]:
    """Return the lines of a table that scrolls sideways."""
    region = f'  <div class="scroll" role="region" tabindex="0" aria-label="{escape(label)}">'
    return [region, f'    <table class="{kind}">', *parts, "    </table>", "  </div>"]


def _table(block: Table) -> str:
    kind = "prose" if block.prose else "data dense" if block.dense else "data"
    kind += " remarked" * block.remarked + " stacked" * block.stacked
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in block.head) if any(block.head) else ""
    rows = [_row(block, number) for number in range(len(block.rows))]
    body = [f"      <thead><tr>{head}</tr></thead>" if head else "", "      <tbody>", *rows, "      </tbody>"]
    return _lines(
        [
            f'<div class="block">\n  <h3>{escape(block.title)}</h3>',
            *_scroll(block.title, kind, body),
            _element("p", block.caption, kind="caption"),
            "</div>",
        ]
    )


def _row(block: Table, number: int) -> str:
    kind = ' class="marked"' if number == block.marked else ' class="faint"' if number in block.faint else ""
    cells: list[str] = []
    for column, cell in enumerate(block.rows[number]):
        head = f' data-head="{escape(block.head[column])}"' if block.stacked else ""
        text = escape(cell)
        cells.append(f'<th scope="row"{head}>{text}</th>' if column == 0 else f"<td{head}>{text}</td>")
    return f"      <tr{kind}>{''.join(cells)}</tr>"


def _parameters(block: Parameters) -> str:
    return _lines(
        [
            '<div class="block">',
            _element("h3", block.title),
            *_scroll(block.title or "Parameters", "parameters", [_PARAMETER_HEAD, *map(_group, block.groups)]),
            _element("p", block.caption, kind="caption"),
            "</div>",
        ]
    )


def _group(group: ParameterGroup) -> str:
    note = f" {_element('span', group.note)}" if group.note else ""
    head = f'<tr class="group"><th colspan="4" scope="rowgroup">{escape(group.title)}{note}</th></tr>'
    return _lines(["<tbody>", head, *map(_parameter, group.rows), "</tbody>"])


def _parameter(row: Parameter) -> str:
    sigma = f' <span class="sigma">± {escape(row.sigma)}</span>' if row.sigma else ""
    note = f" {_element('span', row.note, kind='note')}" if row.note else ""
    return _lines(
        [
            f'<tr>\n<th scope="row">{escape(row.name)}</th>',
            f'<td class="estimate">{escape(row.value)}{sigma} <span class="unit">{escape(row.unit)}</span></td>',
            f'<td class="reads">{escape(row.reads_as)}{note}</td>',
            f'<td class="drawn">{_bar(row.bar) if row.bar else ""}</td>\n</tr>',
        ]
    )


def _bar(item: Bar) -> str:
    ends = "".join(f"M{end:.2f} 3V11" for end in (item.low, item.high))
    return _lines(
        [
            '<svg class="bar" viewBox="0 0 100 14" preserveAspectRatio="none" aria-hidden="true">',
            f'  <rect class="value" x="{min(item.zero, item.value):.2f}" y="4" '
            f'width="{abs(item.value - item.zero):.2f}" height="6"/>',
            f'  <path class="zero" d="M{item.zero:.2f} 0V14"/>',
            f'  <path class="whisker" d="M{item.low:.2f} 7H{item.high:.2f}{ends}"/>',
            "</svg>",
        ]
    )
