"""The certificate of a stored calibration as a PDF of two pages (A4): the numbers, and their uncertainty budget."""

import io
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..assess.comparison.comparison import Comparison
from ..assess.comparison.verification import Verification
from ..errors import OptionError, install_line
from ..findings import printable_text
from ..output import write_whole
from ..results.calibration import Calibration
from ..results.sensor_noise import SensorNoise
from .certificate import budget_table, certificate_tables, front_tables
from .comparison import compared_tables, verified_tables
from .noise import noise_numbers
from .page import HEADLINES, NOISE_HEADLINES, ReportTable, typeset_finding

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_WIDTH, _HEIGHT = 8.27, 11.69
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.09, 0.91, 0.955, 0.05
_LINE = 0.0148
"""Height of a line of text, in heights of the page."""
_COLUMNS = {
    2: (0.0, 0.3),
    3: (0.0, 0.72, 1.0),
    4: (0.0, 0.6, 0.82, 1.0),
    5: (0.0, 0.56, 0.74, 0.81, 1.0),
    6: (0.0, 0.42, 0.56, 0.64, 0.82, 1.0),
    7: (0.0, 0.36, 0.58, 0.70, 0.815, 0.91, 1.0),
}
"""Number of columns -> where they begin, or end where they hold numbers, in widths of the text."""
_BESIDE_BUDGET = 8
"""Lines of the page that its title, head and caption take."""
_INK, _MUTED = "#17202a", "#57636f"
_TONES = {"pass": "#1a6b3c", "warn": "#8a5a00", "fail": "#b3261e"}
_SIZE, _SMALL = 9.0, 7.8

Certified = Calibration | SensorNoise | Verification | Comparison


def write_certificate(result: Certified, path: str | Path) -> None:
    """Write the certificate of a calibration, or of noise, a verification or a comparison, which have no budget.

    The same one gives the same bytes.

    Raises
    ------
    OptionError
        If Matplotlib is not installed.
    OutputError
        If the file cannot be written.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_pdf import PdfPages
        from matplotlib.figure import Figure
    except ImportError:
        raise OptionError(f"a certificate needs Matplotlib. Run: {install_line('gnomon[certificate]')}") from None
    stream = io.BytesIO()
    with rc_context({"font.family": "DejaVu Sans", "pdf.fonttype": 42, "text.parse_math": False}):
        sheets = [Figure(figsize=(_WIDTH, _HEIGHT)) for _ in range(2 if isinstance(result, Calibration) else 1)]
        _Sheet(sheets[0]).fill(result)
        if isinstance(result, Calibration):
            _Sheet(sheets[1]).fill_budget(result)
        with PdfPages(stream, metadata={"CreationDate": None, "Title": "Calibration certificate"}) as pages:
            for sheet in sheets:
                pages.savefig(sheet)
    write_whole(path, stream.getvalue())


def page_one(result: Certified) -> tuple[ReportTable, ...]:
    """Return the tables of page one."""
    if isinstance(result, Verification):
        return verified_tables(result)
    if isinstance(result, Comparison):
        return compared_tables(result)
    if isinstance(result, SensorNoise):
        return front_tables(result, (noise_numbers(result),))
    return certificate_tables(result)


class _Sheet:
    """Writes from the top of the page to its bottom."""

    def __init__(self, figure: "Figure") -> None:
        self._figure, self._y = figure, _TOP

    def fill(self, result: Certified) -> None:
        """Write verdict and findings, the numbers, inputs."""
        verdict, provenance, title = result.verdict, result.provenance, "Calibration certificate"
        findings = result.assessment.findings if isinstance(result, Calibration) else result.findings
        if isinstance(result, Verification):
            title, headline = "Certificate of verification", f"{result.headline[:1].upper()}{result.headline[1:]}."
        elif isinstance(result, Comparison):
            title, headline = "Certificate of comparison", result.headline
        elif isinstance(result, SensorNoise):
            title, headline = "Certificate of noise", NOISE_HEADLINES[verdict]
        else:
            headline = HEADLINES[verdict]
        self._text(title, size=18, bold=True, step=2.2)
        for line in textwrap.wrap(f"{verdict.capitalize()}. {headline}", 76):
            self._text(line, size=12, color=_TONES[verdict], bold=True, step=1.3)
        self._y -= 0.5 * _LINE
        pressing = [f for f in findings if f.severity in ("warning", "problem")]
        for finding in pressing[:4]:
            self._wrapped(f"{finding.severity}: {typeset_finding(finding).message}")
        if len(pressing) > 4:
            self._wrapped(f"{len(pressing) - 4} more findings are in the report.")
        for table in page_one(result):
            self._table(table)
        self._y = max(min(self._y, 0.16), _BOTTOM + 2 * _LINE)
        for source in provenance.inputs[:5]:
            self._wrapped(f"Input {source.name}, SHA-256 {source.sha256}")
        if (more := len(provenance.inputs) - 5) > 0:
            self._wrapped(f"{more} more inputs and their hashes are in the stored result.")
        self._wrapped(f"Made by gnomon {provenance.gnomon_version}, method {provenance.method}.")

    def fill_budget(self, calibration: Calibration) -> None:
        """Write the uncertainty budget, as much of it as a page holds."""
        budget = budget_table(calibration)
        rows = int((_TOP - _BOTTOM) / _LINE) - _BESIDE_BUDGET
        self._table(replace(budget, rows=budget.rows[:rows]))
        if len(budget.rows) > rows:
            self._wrapped("The rest of the budget is in the report.")

    def _table(self, table: ReportTable) -> None:
        self._y -= 0.6 * _LINE
        self._text(table.title, size=11, bold=True, step=1.3)
        rows = [row for row in (table.head, *table.rows) if any(row)]
        for k, row in enumerate(rows):
            chosen = table.marked is not None and k == table.marked + 1
            for column, (place, cell) in enumerate(zip(_COLUMNS[len(row)], row, strict=True)):
                number = column > 0 and len(row) > 2
                color = _MUTED if row is table.head or k - 1 in table.faint else _INK
                self._put(cell, place, align="right" if number else "left", color=color, bold=chosen)
            self._y -= _LINE
        if table.caption:
            self._wrapped(table.caption)

    def _wrapped(self, text: str) -> None:
        for line in textwrap.wrap(text, 112):
            self._text(line, size=_SMALL, color=_MUTED, step=0.85)

    def _text(self, text: str, *, size: float, color: str = _INK, bold: bool = False, step: float = 1.0) -> None:
        self._put(text, 0.0, size=size, color=color, bold=bold)
        self._y -= step * _LINE

    def _put(
        self,
        text: str,
        place: float,
        *,
        size: float = _SIZE,
        color: str = _INK,
        bold: bool = False,
        align: str = "left",
    ) -> None:
        x = _LEFT + place * (_RIGHT - _LEFT)
        weight = "bold" if bold else "normal"
        self._figure.text(x, self._y, printable_text(text), size=size, color=color, weight=weight, ha=align, va="top")
