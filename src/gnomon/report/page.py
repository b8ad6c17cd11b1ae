"""One page for every kind of calibration: verdict, findings, parameters, sections of figures and tables, provenance.

A kind of calibration (imu.py) fills in the values below; the template page.html.jinja knows nothing of sensors.
"""

import base64
import hashlib
import zlib
from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.machinery import SourceFileLoader
from math import isfinite
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat

import jinja2
from markupsafe import Markup

from ..errors import OptionError
from ..findings import Finding, printable_text
from ..frozen import value_class
from ..output import write_whole
from ..recording import Floats
from ..results.calibration import Calibration, Gravity, Provenance, Verdict
from ..results.camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics
from ..results.result import Result
from ..results.sensor_noise import NoiseResult
from ..results.temperature import TemperatureResult
from .drawing.figures import Plot
from .numbers import number_text, with_sigma

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MatplotlibFigure


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


def with_bars(rows: list[Parameter], values: list[tuple[float, float]]) -> tuple[Parameter, ...]:
    """Give rows of one group their bars on a common scale, symmetric about zero."""
    reaches = [abs(v) + 2 * (s if isfinite(s) else 0.0) for v, s in values if isfinite(v)]
    reach = max(reaches, default=0.0)
    if not reach > 0:
        return tuple(rows)

    def place(value: float) -> float:
        return 50 + 49 * value / reach

    result: list[Parameter] = []
    for row, (value, sigma) in zip(rows, values, strict=True):
        spread = 2 * sigma if isfinite(sigma) else 0.0
        bar = Bar(50.0, place(value), place(value - spread), place(value + spread))
        result.append(replace(row, bar=bar if isfinite(value) else None))
    return tuple(result)


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


HEADLINES = {
    "pass": "This calibration is good to use.",
    "warn": "This calibration can be used, with the reservations below.",
    "fail": "Do not use this calibration.",
}
NOISE_HEADLINES = {verdict: line.replace("calibration", "noise") for verdict, line in HEADLINES.items()}
FRAMES = {
    "accel-x": "the x axis of the body is the sensitivity axis of the x accelerometer, and the y accelerometer lies in "
    "the x-y plane (Kalibr's convention)",
    "accel-z": "the z axis of the body is the sensitivity axis of the z accelerometer, and the y accelerometer lies in "
    "the y-z plane (the convention of Tedaldi and of imu_tk)",
    "gyro-x": "the x axis of the body is the sensitivity axis of the x gyroscope, and the y gyroscope lies in the x-y "
    "plane",
    "mag-x": "the x axis of the body is the sensitivity axis of the x magnetometer, and the y magnetometer lies in the "
    "x-y plane",
    "cam0": "x to the right of the image of cam0, y down, z out of its lens",
    "user": "axes of your own, taken from the poses that you named",
}
"""What the body frames mean."""


def gravity_text(gravity: Gravity) -> str:
    """Return the magnitude of gravity with its sigma, if it has one, and its unit."""
    spread = f" ± {number_text(gravity.sigma, 2)}" if gravity.sigma > 0 else ""
    return f"{number_text(gravity.value, 7)}{spread}\u00a0m/s²"


def aligned_matrix(name: str, values: Floats) -> str:
    """Return a matrix as aligned text, rows in brackets."""
    cells = [[f"{v:.9g}" for v in row] for row in values.tolist()]
    width = max(len(cell) for row in cells for cell in row)
    middle = len(cells) // 2
    return "\n".join(
        f"{name if i == middle else ' ' * len(name)} {'=' if i == middle else ' '} "
        f"[ {'  '.join(c.rjust(width) for c in row)} ]"
        for i, row in enumerate(cells)
    )


def assumptions_section(calibration: Calibration, stated: Iterable[str], by: str = "this recording") -> Section:
    """Return what was assumed: as stated, as the findings say, and what a prior holds."""
    points = [*stated]
    points += [typeset_finding(one).message for one in calibration.assessment.findings if one.code == "assumed"]
    if held := calibration.assessment.held_by_prior:
        points.append(f"Not determined by {by}, and held by assumption: {', '.join(held)}.")
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))


def provenance_section(provenance: Provenance) -> Section:
    """Return the section with version, method, options, seed and the hashes of the inputs."""
    rows = [("gnomon", provenance.gnomon_version), ("method", provenance.method)]
    options = ", ".join(f"{name} = {value}" for name, value in provenance.options.items())
    rows.append(("options", options or "all at their defaults"))
    if provenance.seed is not None:
        rows.append(("seed", str(provenance.seed)))
    blocks = [ReportTable("How it was made", ("", ""), rows, prose=True)]
    if provenance.inputs:
        blocks.append(
            ReportTable(
                "Inputs",
                ("file", "SHA-256"),
                tuple((source.name, source.sha256) for source in provenance.inputs),
                "The same inputs, options and version give the same calibration and report, byte for byte.",
                prose=True,
            )
        )
    return Section("provenance", "Provenance", blocks=blocks)


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
    script = (_HERE / "page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    html = load_template("page.html.jinja").render(
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


@cache
def load_template(name: str) -> jinja2.Template:
    """Return a template of this folder, compiled once: that takes longer than to fill it in."""
    environment = jinja2.Environment(
        loader=_Folder(), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name)


def write_report(result: Result, path: str | Path) -> None:
    """Write the report of a calibration as one HTML file that needs neither network nor other files.

    The same result gives the same bytes. The file appears whole or not at all.

    Parameters
    ----------
    result : a calibration and how it came about
    path : file to write; an existing one is replaced

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(result_page(result)))


def result_page(result: Result | NoiseResult | TemperatureResult) -> ReportPage:
    """Return the page that a result's report shows."""
    if isinstance(result, NoiseResult):
        from .noise import noise_page

        return noise_page(result)
    if isinstance(result, TemperatureResult):
        from .temperature import temperature_page

        return temperature_page(result)
    calibration, diagnostics = result.calibration, result.diagnostics
    if isinstance(diagnostics, CameraImuDiagnostics):
        from .camera_imu.page import camera_imu_page

        return camera_imu_page(calibration, diagnostics)
    if isinstance(diagnostics, CamerasDiagnostics):
        from .cameras.page import cameras_page

        return cameras_page(calibration, diagnostics)
    from .static.page import static_page

    return static_page(calibration, diagnostics)


def plot_result(result: Result | NoiseResult | TemperatureResult, name: str) -> "MatplotlibFigure":
    """Draw a figure of a result's report with Matplotlib.

    Parameters
    ----------
    result : what was calibrated
    name : short name of the figure, or the beginning of several, such as "allan", which are drawn below each other

    Raises
    ------
    OptionError
        If the report has no such figure, or Matplotlib is not installed.
    """
    page = result_page(result)
    blocks = [*page.front, *(block for section in page.sections for block in section.blocks)]
    figures = {block.plot.name: block for block in blocks if isinstance(block, Figure)}
    chosen = [figures[name]] if name in figures else [f for key, f in figures.items() if name and key.startswith(name)]
    if not chosen:
        known = "\n".join(f"  {key}: {figure.title}" for key, figure in figures.items())
        raise OptionError(f'there is no figure "{name}" here; there are:\n{known}')
    from .drawing.matplotlib_figure import draw_with_matplotlib

    return draw_with_matplotlib([(figure.title, figure.plot, figure.legend) for figure in chosen])
