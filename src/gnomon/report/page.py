"""One page for every kind of calibration: verdict, findings, parameters, sections of figures and tables, provenance.

A kind of calibration (imu.py) fills in the values below; the template page.html.jinja knows nothing of sensors.
"""

import base64
import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, SupportsFloat

from ..findings import Finding, printable_text
from ..frozen import value_class
from ..results.calibration import Verdict
from .drawing.figures import Plot
from .numbers import with_sigma

if TYPE_CHECKING:
    from jinja2 import Template

_HERE = Path(__file__).parent


@value_class(eq=True, kw_only=False)
class KeyNumber:
    """A number that a reader should see first, with the sentence that explains it."""

    label: str
    value: str
    note: str = ""


@value_class(eq=True, kw_only=False)
class Bar:
    """A value and its two-sigma whisker, in percent of the width of the cell; `zero` is where zero lies."""

    zero: float
    value: float
    low: float
    high: float


@value_class(eq=True, kw_only=False)
class Parameter:
    """One line of the parameter table; texts are formatted, `sigma` and `expanded` (two sigma) empty for the fixed."""

    name: str
    value: str
    sigma: str
    unit: str
    reads_as: str = ""
    note: str = ""
    bar: Bar | None = None
    expanded: str = ""


def parameter_line(
    name: str,
    value: SupportsFloat,
    sigma: SupportsFloat,
    unit: str,
    *,
    reads_as: str = "",
    note: str = "",
    sign: bool = False,
) -> Parameter:
    """Return the line of a number with its standard deviation, which says how many digits are shown."""
    texts = with_sigma(float(value), float(sigma), sign=sign)
    return Parameter(name, *texts, unit, reads_as, note, expanded=with_sigma(float(value), 2 * float(sigma))[1])


@value_class(eq=True, kw_only=False)
class ParameterGroup:
    """Parameters that are compared with each other, and the unit of their bars."""

    title: str
    note: str
    rows: Sequence[Parameter]


@value_class(eq=True, kw_only=False)
class Legend:
    """What a mark in a figure means; page.css defines `color` as --plot-COLOR."""

    mark: Literal["line", "dash", "band", "dot", "ring"]
    color: str
    label: str


@value_class(eq=True, kw_only=False)
class Figure:
    """A drawing with its legend and caption."""

    title: str
    plot: Plot
    legend: Sequence[Legend] = ()
    caption: str = ""
    kind: str = "figure"

    @property
    def svg(self) -> str:
        """The drawing as an SVG element."""
        return self.plot.svg


@value_class(eq=True, kw_only=False)
class ReportTable:
    """Rows of texts; the first column is the row's name.

    `marked` is the index of the row that was chosen, `faint` are those of rows that matter less. A `dense` table is set
    small, since it has many rows or columns. The last column of a `remarked` table holds remarks, which may break. On
    a narrow screen the cells of a `stacked` table stand below each other, each with its head before it.
    """

    title: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    caption: str = ""
    marked: int | None = None
    faint: frozenset[int] = frozenset()
    prose: bool = False
    stacked: bool = False
    dense: bool = False
    remarked: bool = False
    kind: str = "table"


@value_class(eq=True, kw_only=False)
class Prose:
    """Paragraphs, or a list of points."""

    lines: Sequence[str]
    points: bool = False
    kind: str = "prose"


@value_class(eq=True, kw_only=False)
class Code:
    """Something to copy."""

    title: str
    text: str
    kind: str = "code"


@value_class(eq=True, kw_only=False)
class ParameterTable:
    """The parameter table, with a title of its own where the section has several."""

    groups: Sequence[ParameterGroup]
    title: str = ""
    caption: str = ""
    kind: str = "parameters"


Block = Figure | ReportTable | Prose | Code | ParameterTable


@value_class(eq=True, kw_only=False)
class Section:
    """A heading with what belongs under it; `anchor` is its name in links."""

    anchor: str
    title: str
    lead: str = ""
    blocks: Sequence[Block] = ()


@value_class(eq=True)
class ReportPage:
    """A whole report; `front` stands on page one, which is the certificate, and the sections are folded below it."""

    title: str
    subject: str
    verdict: Verdict
    headline: str
    key_numbers: tuple[KeyNumber, ...]
    findings: tuple[Finding, ...]
    sections: tuple[Section, ...]
    footer: str
    front: tuple[Block, ...] = ()


def lift_figures(sections: Iterable[Section], anchors: Sequence[str]) -> tuple[tuple[Figure, ...], tuple[Section, ...]]:
    """Take the first figure out of each of these sections, in their order, and return them and what is left."""
    left = {section.anchor: section for section in sections}
    lifted: list[Figure] = []
    for anchor in anchors:
        blocks = left[anchor].blocks if anchor in left else ()
        figure = next((block for block in blocks if isinstance(block, Figure)), None)
        if figure is not None:
            lifted.append(figure)
            left[anchor] = replace(left[anchor], blocks=[block for block in blocks if block is not figure])
    return tuple(lifted), tuple(section for section in left.values() if section.blocks)


def typeset_finding(finding: Finding) -> Finding:
    """Return a finding, written for any terminal, with the signs that a page can show."""

    def fine(text: str) -> str:
        return text.replace("m/s^2", "m/s²").replace(" +- ", " ± ").replace(" deg/s", "\u00a0°/s")

    return replace(
        finding, message=fine(finding.message), consequence=fine(finding.consequence), cure=fine(finding.cure)
    )


def render_page(page: ReportPage) -> bytes:
    """Return the page as one UTF-8 HTML document that refers to nothing outside itself."""
    from markupsafe import Markup

    script = (_HERE / "page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    html = page_template("page.html.jinja").render(
        page=page,
        style=Markup((_HERE / "page.css").read_text(encoding="utf-8")),
        script=Markup(script),
        # The page may run this one script and load nothing, whatever a file name might try to smuggle in.
        policy=f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'",
    )
    return printable_page(html)


def printable_page(html: str) -> bytes:
    """Return a page as UTF-8; what is no text, or would steer a terminal that shows the file, is shown as escapes."""
    return printable_text(html).encode("utf-8", "backslashreplace")


@cache
def page_template(name: str) -> "Template":
    """Return a template of this folder, compiled once: that takes longer than to fill it in."""
    from .templates import load_template

    return load_template(name)
