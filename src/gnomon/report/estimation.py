"""The sections of camera pages on the estimation: every scalar, correlations, noise levels and iterations."""

from functools import reduce

import numpy as np

from ..recording import Floats
from ..results.camera_diagnostics import (
    CameraImuDiagnostics,
    CamerasDiagnostics,
    EstimatedParameter,
    NoiseLevel,
    SolverStep,
)
from .drawing import svg
from .drawing.figures import RIGHT, WIDTH, Plot, Sheet
from .drawing.panel import Panel
from .numbers import MISSING, fixed_text, highest_finite, number_text, readable_unit, with_sigma
from .page import Figure, Legend, ReportTable, Section

_MOST_ROWS = 60
_MOST_PAIRS = 12
_STRONG = 0.5
"""Correlation from which a pair is listed."""


def parameters_section(diagnostics: CameraImuDiagnostics | CamerasDiagnostics) -> Section | None:
    """Return every scalar with its sigma, and how they are correlated; None without any."""
    if not diagnostics.parameters:
        return None
    blocks: list[Figure | ReportTable] = [every_parameter(diagnostics)]
    free = [p for p in diagnostics.parameters if p.status in ("estimated", "prior")]
    matrix = np.asarray(diagnostics.correlation, dtype=np.float64)
    if len(free) > 1 and matrix.shape == (len(free), len(free)):
        legend = (Legend("band", "after", "positive"), Legend("band", "heldout", "negative"))
        blocks += [
            Figure(
                "Correlation",
                draw_correlation(_groups(free), matrix),
                legend,
                "The stronger the colour, the stronger the correlation; below 0.05 it is left out. What is "
                "strongly correlated is known better together than each on its own.",
            ),
            _strongest(free, matrix),
        ]
    return Section(
        "parameters",
        "Every parameter",
        "All scalars of the batch estimation, and how strongly they depend on each other.",
        blocks,
    )


_SHORTER = (
    ("T_cam_imu.", ""),
    ("T_cam_cam0.", ""),
    ("T_imu_body.", ""),
    ("time_shift_cam_imu", "time_shift"),
    ("distortion_coeffs", "distortion"),
)


def _groups(free: list[EstimatedParameter]) -> list[tuple[str, list[str]]]:
    """Return consecutive parameters of one block under one name, with what tells them apart."""
    groups: list[tuple[str, list[str]]] = []
    for parameter in free:
        name, _, index = parameter.name.partition("[")
        short = reduce(lambda text, pair: text.replace(*pair), _SHORTER, name)
        if not groups or groups[-1][0] != short:
            groups.append((short, []))
        groups[-1][1].append(index.rstrip("]"))
    return groups


def _strongest(free: list[EstimatedParameter], matrix: Floats) -> ReportTable:
    first, second = np.triu_indices(len(free), 1)
    values = np.nan_to_num(matrix[first, second])
    order = np.argsort(-np.abs(values), kind="stable")
    strong = [k for k in order[:_MOST_PAIRS].tolist() if abs(values[k]) >= _STRONG] or order[:1].tolist()
    return ReportTable(
        "Strongest correlations",
        ("parameter", "with", "correlation"),
        tuple((free[int(first[k])].name, free[int(second[k])].name, fixed_text(float(values[k]), 3)) for k in strong),
    )


def every_parameter(diagnostics: CameraImuDiagnostics | CamerasDiagnostics) -> ReportTable:
    """Return all scalars of the batch estimation with start, sigma, prior and status."""
    rows: list[tuple[str, ...]] = []
    faint: set[int] = set()
    for i, p in enumerate(diagnostics.parameters):
        value, sigma = with_sigma(p.value, p.sigma if p.status != "fixed" else 0.0)
        weak = _not_above(p)
        if weak or p.status == "fixed":
            faint.add(i)
        prior = number_text(p.prior_sigma, 2) if p.prior_sigma > 0 else MISSING
        status = f"{p.status}, ≤ σ" if weak else p.status
        start = p.start if abs(p.start) > 1e-9 * max(abs(p.value), p.sigma) else 0.0  # the rest of a rounding
        rows.append((p.name, value, sigma or MISSING, number_text(start, 6), prior, _unit(p.unit), status))
    return ReportTable(
        "Estimate, start and sigma",
        ("parameter", "value", "σ", "start", "prior σ", "unit", "status"),
        rows,
        dense=True,
        faint=frozenset(faint),
        caption=_ALONE if isinstance(diagnostics, CamerasDiagnostics) else _WITH_IMU,
    )


_ALONE = "Faint: fixed."
_WITH_IMU = (
    "Of rotations and directions the value is the small angle from the start. The priors of estimated parameters are "
    "weak: they only hold what the recording does not determine. Considered: held at what was stated, whose σ is "
    "carried into all others. Faint: fixed, or (≤ σ) an entry of the IMU no farther "
    "from an ideal sensor's than its σ, which Krebs takes for ideal."
)


def _unit(unit: str) -> str:
    return readable_unit(unit).replace("sqrt(Hz)", "√Hz")


_SHAPES = (".S_a", ".S_g", ".M_a", ".M_g", ".q_bg", ".B_g")


def _not_above(parameter: EstimatedParameter) -> bool:
    """Return whether an entry of the IMU is estimated, and no farther from an ideal sensor's than its sigma."""
    if parameter.status == "fixed" or not any(f"{shape}[" in parameter.name for shape in _SHAPES):
        return False
    ideal = 1.0 if ".S_" in parameter.name and abs(parameter.value) > 0.5 else 0.0
    return abs(parameter.value - ideal) <= parameter.sigma


_LEAST_MATRIX = 200.0
"""Side of a matrix of few parameters, so that a small screen shows it as well."""


def draw_correlation(labels: list[tuple[str, list[str]]], matrix: Floats) -> Plot:
    """Draw a correlation matrix; labels are groups of parameters: (name of the group, names of its entries)."""
    count = len(matrix)
    left = 232.0
    pitch = min((WIDTH - left - RIGHT) / max(count, 1), max(24.0, _LEAST_MATRIX / max(count, 1)))
    size = pitch * count

    sheet = Sheet()
    panel = sheet.panel("", top=20, height=size, left=left, right=WIDTH - left - size)
    panel.x.span(0, count)
    panel.y.span(count, 0)
    panel.x.ticks = panel.y.ticks = ()
    y, x = np.divmod(np.arange(count * count), count)
    corners = np.stack([x, y], axis=1).astype(np.float64)
    values = np.where(x == y, 0.0, np.nan_to_num(matrix.ravel()))
    for sign, color in ((1, "after"), (-1, "heldout")):
        strength = np.where(sign * values >= 0.05, sign * values, 0.0)
        panel.cells(corners, (1.0, 1.0), level=strength, color=color)
    panel.cells(corners[x == y], (1.0, 1.0), level=np.ones(count), color="grid")
    _separate(panel, labels, count)
    _name_groups(sheet, labels, left - 26, pitch)
    row = 0
    for _, entries in labels:
        for entry in entries if pitch >= 8 else ():
            y = row + entries.index(entry) + 0.5
            font = min(10.0, 0.8 * pitch)
            style = svg.TextStyle(color="muted", size=font, align="right")
            panel.text(entry, 0, y, style, offset=(-5, svg.MIDDLE * font), fine=True)
        row += len(entries)
    strongest = highest_finite(np.abs(matrix[~np.eye(count, dtype=bool)]))
    alt = f"Correlation matrix of {count} parameters; the strongest correlation is {strongest:.2f}."
    return sheet.draw("correlation", size + 30, alt)


def _separate(panel: Panel, labels: list[tuple[str, list[str]]], count: int) -> None:
    """Draw lines between groups."""
    for edge in np.cumsum([len(entries) for _, entries in labels])[:-1].tolist():
        x, y = np.array([0, count, np.nan, edge, edge]), np.array([edge, edge, np.nan, 0, count])
        panel.line(x, y, "muted", width=0.7, alpha=0.5)


def _name_groups(sheet: Sheet, labels: list[tuple[str, list[str]]], right: float, pitch: float) -> None:
    """Write the name of each group at its middle, where there is room for it."""
    row, free_from = 0, 0.0
    for name, entries in labels:
        middle = 20 + pitch * (row + len(entries) / 2) + 4
        if middle >= free_from:
            sheet.text(name, x=right, y=middle, color="ink", align="right")
            free_from = middle + 13
        row += len(entries)


def noise_table(noise: tuple[NoiseLevel, ...], example: str = "vibration") -> list[ReportTable]:
    """Return noise levels as stated, found and used; none without any."""
    if not noise:
        return []
    return [
        ReportTable(
            "Noise",
            ("of", "stated", "found in the residuals", "used", "unit"),
            tuple(_noise_row(level) for level in noise),
            f"Noise found in the residuals holds all that the model does not explain, such as {example}.",
        )
    ]


def _noise_row(level: NoiseLevel) -> tuple[str, ...]:
    sensor, _, what = level.name.partition(".")
    unit = readable_unit(level.unit).replace("sqrt(Hz)", "√Hz")
    return (f"{sensor} {what}", *(number_text(v, 3) for v in (level.nominal, level.estimated, level.used)), unit)


def steps_table(steps: tuple[SolverStep, ...], *, converged: bool) -> list[ReportTable]:
    """Return the iterations of the solver; none without any."""
    if not steps:
        return []
    rows = tuple(
        (
            str(i + 1),
            number_text(s.cost, 7),
            number_text(s.largest_step, 3),
            number_text(s.damping, 2),
            _ACCEPTED[s.accepted],
        )
        for i, s in enumerate(steps[:_MOST_ROWS])
    )
    return [
        ReportTable(
            "Iterations",
            ("", "cost before", "largest step [σ]", "damping", ""),
            rows,
            "The solver came to rest." if converged else "The solver did not come to rest.",
        )
    ]


_ACCEPTED = {True: "accepted", False: "rejected"}
