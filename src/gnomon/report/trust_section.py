"""The section that says how far a calibration can be trusted, the same for every kind of calibration."""

from math import isfinite

import numpy as np

from ..results.calibration import Assessment
from ..results.trust import BlockChange, ModelStep, Need, Splits, Trust, WeakDirection
from .drawing.figures import Plot, Sheet, draw_dots
from .drawing.panel import DASHED
from .numbers import MISSING, finite_values, highest_finite, number_text
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
    usual = float(np.median([ratio.ratio for ratio in known]))
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
