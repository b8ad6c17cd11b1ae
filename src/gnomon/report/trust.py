"""How far an estimate can be trusted: what its use needs, where sigmas come from; every scalar, correlations, noise."""

from functools import reduce
from math import isfinite

import numpy as np

from ..recording import Floats
from ..recording.samples import median_of
from ..results.calibration import Assessment
from ..results.camera_diagnostics import (
    CameraImuDiagnostics,
    CamerasDiagnostics,
    EstimatedParameter,
    NoiseLevel,
    SolverStep,
)
from ..results.trust import BlockChange, ModelStep, Need, Splits, Trust, WeakDirection
from .drawing.figures import RIGHT, WIDTH, Plot, Sheet, draw_dots
from .drawing.panel import DASHED, MIDDLE, Panel, TextStyle
from .numbers import MISSING, finite_values, fixed_text, highest_finite, number_text, readable_unit, with_sigma
from .page import Block, Figure, Legend, Prose, ReportTable, Section

_OPEN = 2.0
"""Sigmas that are larger than the ordinary ones by more than this say that the model is incomplete."""
_SHOWN = 3
"""Blocks that one model step is said to have moved."""
_VERDICTS = {"pass": "enough", "warn": "not quite", "fail": "not enough"}


def trust_section(assessment: Assessment, trust: Trust | None) -> Section | None:
    """Return what the recording tells of its own calibration; None without anything."""
    blocks: list[Block] = []
    note = assessment.trust
    if note.needs:
        blocks.append(_needs(note.use, note.needs))
    if trust is not None:
        blocks.append(_origin(trust))
        if trust.splits is not None:
            blocks += _splits(trust.splits)
        if trust.models:
            blocks.append(_models(trust.models))
        if trust.weak:
            blocks.append(_weak(trust.weak))
    if not blocks:
        return None
    return Section(
        "trust",
        "Can it be trusted?",
        "What the recording tells of its own calibration: whether it is good enough for its use, how the standard "
        "deviations were found, and whether parts of the recording, each calibrated for itself, agree within them.",
        blocks,
    )


def _needs(use: str, needs: tuple[Need, ...]) -> ReportTable:
    floors = any(need.floor for need in needs)

    def floor(need: Need) -> tuple[str, ...]:
        return ((_amount(need.floor, need.unit) if need.floor else MISSING),) if floors else ()

    rows = tuple(
        (
            need.block,
            _amount(need.sigma, need.unit),
            *floor(need),
            _amount(need.needed, need.unit),
            _VERDICTS[need.verdict],
        )
        for need in needs
    )
    said = (
        " Between recordings: what is usual from one to the next (turn-on, temperature, mounting), which one recording "
        "cannot know. It counts, but for biases, which every use has to follow."
    )
    return ReportTable(
        f"What {use} needs" if use else "What is needed",
        ("", "σ of this calibration", *(("between recordings",) if floors else ()), "needed", "verdict"),
        rows,
        faint=frozenset(i for i, need in enumerate(needs) if need.verdict == "pass"),
        caption="What to do about those that are not enough stands at the top." + (said if floors else ""),
    )


def _amount(value: float, unit: str) -> str:
    """Return a standard deviation with its unit, which does not break from it."""
    return f"{number_text(value, 2)}\u00a0{unit}".replace("m/s^2", "m/s²").replace("\u00a0deg", "°")


def _origin(trust: Trust) -> Prose:
    """Say where the standard deviations come from."""
    if trust.clusters is None:
        return Prose(("The standard deviations hold if all errors are independent of each other.",))
    clusters = trust.clusters
    text = (
        f"The standard deviations come from leaving out each of {clusters.count} clusters of "
        f"{number_text(clusters.length_s, 3)}\u00a0s in turn (cluster-robust, CR3), so that errors which last for "
        "seconds count as what they are."
    )
    known = [ratio for ratio in trust.ratios if isfinite(ratio.ratio)]
    if not known:
        return Prose((text,))
    usual = float(median_of([ratio.ratio for ratio in known]))
    text += f" They are {number_text(usual, 2)} times those for independent errors (median of the blocks)"
    wide = sorted((r for r in known if r.ratio > _OPEN), key=lambda r: -r.ratio)[:_SHOWN]
    if not wide:
        return Prose((f"{text}: the model explains the recording.",))
    names = ", ".join(f"{ratio.block} ({number_text(ratio.ratio, 2)} times)" for ratio in wide)
    return Prose((f"{text}. Most: {names}. There errors last, or the model leaves something out.",))


def _splits(splits: Splits) -> list[Block]:
    cut = " and ".join(splits.splits)
    rows = tuple(
        (
            block.block,
            str(block.comparisons),
            number_text(block.z_rms, 2, trim=False),
            number_text(block.z_rms_ordinary, 2, trim=False),
            f"{number_text(block.largest, 2, trim=False)} {block.where}".strip(),
        )
        for block in splits.blocks
    )
    pooled = ("all together", str(sum(b.comparisons for b in splits.blocks)))
    pooled += (number_text(splits.z_rms, 2, trim=False), number_text(splits.z_rms_ordinary, 2, trim=False))
    pooled += (f"limit {number_text(splits.limit, 2)}" if isfinite(splits.limit) else MISSING,)
    return [
        Figure(
            "Do parts of the recording agree?",
            draw_agreement(splits),
            (
                Legend("dot", "after", "published σ"),
                Legend("ring", "before", "σ for independent errors"),
                Legend("dash", "accent", "as expected"),
            ),
            f"The recording was cut into {cut}, each part calibrated for itself. z is the difference of two "
            "parts over its standard deviation; its rms is 1 where the standard deviations are right.",
        ),
        ReportTable(
            f"Differences of {cut} over their standard deviation",
            ("", "differences", "z rms", "z rms, independent errors", "largest |z|"),
            (*rows, pooled),
            "The limit is what right standard deviations exceed in one of a hundred recordings. Errors that "
            "all parts share, as those of a wrong lens, do not show here.",
            dense=True,
            remarked=True,
        ),
    ]


def _models(models: tuple[ModelStep, ...]) -> ReportTable:
    rows = tuple(
        (
            step.name,
            str(step.parameters),
            f"{number_text(step.gain, 4)} ± {number_text(step.gain_sigma, 2)}" if isfinite(step.gain) else MISSING,
            number_text(step.needed, 3),
            _decision(step),
            "; ".join(
                f"{change.block} {_change(change)} ({number_text(change.sigmas, 2)}\u00a0σ)"
                for change in step.changes[:_SHOWN]
            )
            or MISSING,
        )
        for step in models
    )
    return ReportTable(
        "What the model holds, by evidence",
        ("block", "parameters", "gain on hold-out data", "needed", "in the model", "what it moves most"),
        rows,
        faint=frozenset(i for i, step in enumerate(models) if not step.used),
        caption="Each block is judged by the log-likelihood of clusters of time that were left out of the estimate, "
        "beyond the model of the blocks used before it. What is needed grows with the number of blocks tried.",
        dense=True,
        remarked=True,
    )


def _change(change: BlockChange) -> str:
    """Return by how much a block moved, with its unit, where it has one."""
    unit = "" if change.unit == "1" else change.unit
    return f"{number_text(change.change, 2)}\u00a0{unit}".rstrip("\u00a0")


def _decision(step: ModelStep) -> str:
    if step.forced:
        return "yes, as stated" if step.used else "no, as stated"
    return "no" if not step.used else "yes" if step.gain > step.needed else "yes, always"


def _weak(weak: tuple[WeakDirection, ...]) -> ReportTable:
    def held(direction: WeakDirection) -> str:
        return (
            "held by an assumption"
            if direction.held
            else f"{number_text(100 * direction.determined, 2)}\u00a0% determined"
        )

    return ReportTable(
        "What the recording hardly determines",
        ("how far", "what", "what to do"),
        tuple((held(direction), direction.words, direction.cure) for direction in weak),
        prose=True,
    )


_ROW, _LEFT, _TOP = 24.0, 270.0, 36.0
_LEAST = 140.0
"""Height of all rows together at least, so that a small screen shows two of them as well."""


def draw_agreement(splits: Splits) -> Plot:
    """Root mean square of the differences of parts over their standard deviation, a row for each block."""
    names = [block.block for block in splits.blocks] + ["all together"]
    robust = np.array([*(block.z_rms for block in splits.blocks), splits.z_rms])
    ordinary = np.array([*(block.z_rms_ordinary for block in splits.blocks), splits.z_rms_ordinary])
    place = np.arange(0.5, len(names), dtype=np.float64)
    height = max(_ROW * len(names), _LEAST)

    sheet = Sheet()
    label = "z rms (1 is as expected)"
    panel = sheet.panel("", top=_TOP - 18, height=height, left=_LEFT, x_label=label)
    panel.y.ticks, panel.y.grid = (), False
    panel.y.span(len(names), 0)
    panel.x.logarithmic, panel.x.grid = True, True
    ends = finite_values(np.concatenate([robust, ordinary]))
    ends = ends[ends > 0]
    low = min(float(ends.min()), 0.5) if ends.size else 0.5
    high = max(highest_finite(ends, 2.0), 2.0)
    panel.x.span(0.9 * low, 1.1 * high)
    panel.x.ticks = [tick for tick in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if low <= tick <= high]
    panel.upright(1.0, "accent", width=1.6, dash=DASHED)
    for row, y in enumerate(place.tolist()):
        panel.line(np.array([robust[row], ordinary[row]]), np.full(2, y), "grid", width=2.0)
    draw_dots(panel, ordinary, place, "before", size=9.0, ring=True)
    draw_dots(panel, robust, place, "after", size=9.0)
    for y, name in zip(place, names, strict=True):
        weight = "bold" if name == names[-1] else "normal"
        at = float(panel.y.places(np.array(y))) + 4.0
        sheet.text(name, x=0, y=at, color="ink", weight=weight)
    alt = f"Agreement of parts of the recording in {len(splits.blocks)} blocks of parameters, in standard deviations."
    return sheet.draw("agreement", _TOP + height + 46, alt)


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
        rows.append((p.name, value, sigma or MISSING, number_text(start, 6), prior, readable_unit(p.unit), status))
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
            style = TextStyle(color="muted", size=font, align="right")
            panel.text(entry, 0, y, style, offset=(-5, MIDDLE * font), fine=True)
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
    unit = readable_unit(level.unit)
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
