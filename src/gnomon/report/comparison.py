"""What the reports of a comparison and of a verification say: the page of page.py, filled from them."""

from collections.abc import Iterator
from math import isfinite
from pathlib import Path

import numpy as np

from .._version import __version__
from ..assess.comparison.comparison import Comparison, Difference, Repeatability, block_words, shown_unit, typical_size
from ..assess.comparison.verification import Verification, movement_words
from ..geometry.rotations import quaternion_from_rotation
from ..output import write_whole
from ..recording import Floats
from .certificate import front_tables
from .drawing.figures import RIGHT, Plot, Sheet, draw_dots
from .drawing.panel import Panel, TextStyle
from .numbers import MISSING, fixed_text, number_text, readable_unit
from .page import (
    Block,
    Figure,
    KeyNumber,
    Legend,
    Prose,
    ReportPage,
    ReportTable,
    Section,
    lift_figures,
    render_page,
    typeset_finding,
)

_MOST_PAIRS = 10  # calibrations of which all pairs are shown
_AGREEMENT = (
    ("pass", "they differ by no more than chance"),
    ("warn", "they agree, with the reservations named under What to do"),
    ("fail", "two of them differ by more than the standard deviations of both allow"),
)


def write_comparison_report(comparison: Comparison, path: str | Path) -> None:
    """Write the report of a comparison as one HTML file that needs neither network nor other files.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(comparison_page(comparison)))


def comparison_page(comparison: Comparison) -> ReportPage:
    """Return the page of a comparison."""
    details = [_blocks(comparison), *_biases(comparison), *_lenses(comparison), _calibrations(comparison)]
    figures, folded = lift_figures([_summary(comparison), *details, _conventions(comparison)], ("agreement",))
    return ReportPage(
        title="Comparison of calibrations",
        subject=", ".join(one.name for one in comparison.calibrations),
        verdict=comparison.verdict,
        headline=comparison.headline,
        key_numbers=_key_numbers(comparison),
        findings=tuple(typeset_finding(finding) for finding in comparison.findings),
        front=(*compared_tables(comparison), *figures),
        sections=folded,
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def compared_tables(comparison: Comparison) -> tuple[ReportTable, ...]:
    """Return the tables of page one of a comparison."""
    return front_tables(comparison, (_compared(comparison), _scatter(comparison)), _AGREEMENT)


def _compared(comparison: Comparison) -> ReportTable:
    rows = [(one.name, one.format, one.stated_sigmas, one.verdict or MISSING) for one in comparison.calibrations]
    return ReportTable("What was compared", ("name", "format", "standard deviations", "verdict"), rows, prose=True)


def _scatter(comparison: Comparison) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    every = len(comparison.calibrations)
    for block in comparison.blocks:
        (scatter, unit), (predicted, _) = (typical_size(block, values) for values in (block.scatter, block.predicted))
        z_rms = f"{number_text(block.z_rms, 3)} (≤ {number_text(block.limit, 3)})" if isfinite(block.z_rms) else MISSING
        notes = ["not judged"] * (not block.judged) + [f"by {len(block.names)} of {every}"] * (len(block.names) < every)
        notes += [f"held by {', '.join(block.assumed)}"] * bool(block.assumed)
        sizes = (number_text(scatter, 2), number_text(predicted, 2), readable_unit(unit))
        rows.append((block_words(block.path), *sizes, z_rms, ", ".join(notes)))
    return ReportTable(
        "Scatter against predicted sigma",
        ("block", "scatter", "predicted σ", "unit", "z rms", "remark"),
        rows,
        "Scatter: standard deviation over the calibrations, root mean square over the scalars of the block, of a lens "
        "over those in px. z rms: scatter over predicted sigma, scalar by scalar; in brackets what honest sigmas "
        "exceed in one of a hundred comparisons. Biases are new at each start, and not judged.",
        dense=True,
        stacked=True,
        remarked=True,
    )


def _key_numbers(comparison: Comparison) -> tuple[KeyNumber, ...]:
    known = [item for item in comparison.differences if isfinite(item.largest) and not item.path.endswith("bias")]
    stating = sum(one.sigmas for one in comparison.calibrations)
    numbers = [KeyNumber("Calibrations", str(len(comparison.calibrations)), f"{stating} with sigmas")]
    if isfinite(comparison.z_rms):
        numbers.append(
            KeyNumber(
                "z rms",
                number_text(comparison.z_rms, 3),
                f"1 is honest; up to {number_text(comparison.limit, 3)} is chance",
            )
        )
    if known:
        worst = max(known, key=lambda item: item.largest)
        numbers.append(
            KeyNumber(
                "Largest difference",
                f"{number_text(worst.largest, 3)} σ",
                f"{block_words(worst.path)}; up to {number_text(comparison.z_limit, 2)} σ is chance",
            )
        )
    return tuple(numbers)


def _summary(comparison: Comparison) -> Section:
    blocks: list[Block] = []
    if drawn_blocks(comparison):
        truth = truth_of(comparison)
        names = [one.name for one in comparison.calibrations if one.name != truth]
        zero = f"{truth}, the truth of a simulation," if truth else "the mean of the calibrations"
        legend = dict.fromkeys((color_of(comparison, name), name) for name in names)
        if len({color for color, _ in legend}) < len(names):
            legend = {item: None for item in legend if item[1] in comparison.outside} | {("before", "the others"): None}
        blocks.append(
            Figure(
                "All scalars",
                draw_deviations(comparison),
                tuple(Legend("dot", color, label) for color, label in legend),
                f"Every dot is a scalar: its deviation from {zero} over the root mean square of the stated "
                "sigmas. Hollow dots lie beyond the edge.",
            )
        )
    if 2 < len(comparison.calibrations) <= _MOST_PAIRS:
        blocks.append(_pairs(comparison))
    return Section("agreement", "Agreement", blocks=blocks)


def _pairs(comparison: Comparison) -> ReportTable:
    names = [one.name for one in comparison.calibrations]
    judged = {block.path for block in comparison.blocks if block.judged}

    def cell(first: str, second: str) -> str:
        found = [i for i in comparison.differences if {i.first, i.second} == {first, second} and i.path in judged]
        known = [item for item in found if isfinite(item.largest)]
        if not known:
            return MISSING
        worst = max(known, key=lambda item: item.largest)
        return f"{number_text(worst.largest, 3)} σ, {block_words(worst.path)}"

    rows = tuple((one, *(cell(one, other) if one != other else "" for other in names)) for one in names)
    caption = f"Up to {number_text(comparison.z_limit, 2)} σ is chance."
    return ReportTable("Largest difference of each pair", ("", *names), rows, caption, prose=True)


def _blocks(comparison: Comparison) -> Section:
    tables = tuple(_table(comparison, block) for block in comparison.blocks if block.judged)
    frame = comparison.frame
    where = f"Poses are to {frame}." if frame.startswith("cam") else f"Body frame {frame}."
    return Section(
        "repeatability",
        "Repeatability",
        f"{where} Tables as in Krebs, appendix B.2: every calibration, the mean of "
        "all, and their standard deviation beside the one that was predicted.",
        tables or (Prose(("No block was estimated.",)),),
    )


def _biases(comparison: Comparison) -> Iterator[Section]:
    tables = tuple(_table(comparison, block) for block in comparison.blocks if not block.judged)
    if tables:
        yield Section(
            "biases",
            "Biases",
            "Biases change from one switching on to the next: their scatter is the instability of the sensor, and "
            "no error of a calibration.",
            tables,
        )


def _table(comparison: Comparison, block: Repeatability) -> ReportTable:
    factor, unit = shown_unit(block.kind, block.unit)
    scalars = list(zip(factor * block.values.T, factor * block.sigmas.T, strict=True))
    decimals = [_decimals(sigmas, values) for values, sigmas in scalars]
    columns = [_column(*scalar, digits) for scalar, digits in zip(scalars, decimals, strict=True)]
    rows = [(name, *(column[i] for column in columns)) for i, name in enumerate(block.names)]
    if len(block.names) > 1:
        for label, values in (("mean", block.mean), ("scatter σ", block.scatter), ("predicted σ", block.predicted)):
            cells = (
                fixed_text(factor * float(v), d + (label != "mean")) for v, d in zip(values, decimals, strict=True)
            )
            rows.append((label, *cells))
    if len(block.names) == 2:
        rows += _difference_rows(comparison.difference(*block.names, block.path), factor, decimals)
    of = f" [{readable_unit(unit)}]" if unit not in {"", "1"} else ""
    caption = ""
    if block.reference is not None:
        w, x, y, z = quaternion_from_rotation(block.reference)
        caption = (
            f"Small rotations about the axes of {_axes_of(block.path)} against the mean, whose quaternion (w, x, y, z) "
            f"is {', '.join(fixed_text(float(v), 7) for v in (w, x, y, z))}."
        )
    if block.assumed:
        caption += f" Held at an ideal or a given value by {', '.join(block.assumed)}."
    title = block_words(block.path)
    return ReportTable(
        f"{title[0].upper()}{title[1:]}{of}",
        ("", *block.elements),
        rows,
        caption.strip(),
        dense=True,
        faint=frozenset(range(len(block.names), len(rows))),
    )


def _axes_of(path: str) -> str:
    """Return whose axes the rotations of a block are about: those of the body, or of the camera in the middle."""
    _, *middle, _ = path.split(".")
    return middle[0] if middle and middle[0].startswith("cam") else "the body"


def _difference_rows(item: Difference, factor: float, decimals: list[int]) -> list[tuple[str, ...]]:
    difference = (fixed_text(factor * float(v), d, sign=True) for v, d in zip(item.values, decimals, strict=True))
    rows: list[tuple[str, ...]] = [(f"{item.first} − {item.second}", *difference)]
    if isfinite(item.largest):
        rows.append(("in sigmas", *(fixed_text(float(z), 1, sign=True) for z in item.z)))
    return rows


def _column(values: Floats, sigmas: Floats, decimals: int) -> list[str]:
    """Return the texts of one scalar in all calibrations."""
    return [
        fixed_text(float(value), decimals) + (f" ± {fixed_text(float(sigma), decimals)}" if isfinite(sigma) else "")
        for value, sigma in zip(values, sigmas, strict=True)
    ]


def _decimals(sigmas: Floats, values: Floats) -> int:
    """Return so many decimals that the smallest sigma has two digits; without sigmas the scatter."""
    known = sigmas[np.isfinite(sigmas) & (sigmas > 0)]
    spread = float(known.min()) if known.size else 0.05 * float(np.ptp(values)) or 1e-3 * float(np.max(np.abs(values)))
    if not spread > 0:
        return 6
    return int(min(max(1 - np.floor(np.log10(spread)), 0), 9))


def _lenses(comparison: Comparison) -> Iterator[Section]:
    rows: list[tuple[str, ...]] = []
    for lens in comparison.lenses:
        pixels = (number_text(value, 2) for value in (lens.rms_px, lens.largest_px, lens.turned_rms_px))
        turn = number_text(float(np.degrees(np.linalg.norm(lens.turn))), 2)
        numbers = ("the same", "", "", "") if lens.same else (*pixels, turn)
        rows.append((lens.camera, lens.first, lens.second, " / ".join(dict.fromkeys(lens.models)), *numbers))
    if rows:
        table = ReportTable(
            "Where both would see one ray",
            ("camera", "first", "second", "models", "rms [px]", "largest [px]", "rms, turned [px]", "turn [°]"),
            rows,
            "Distance of the two images of a ray over the image. A turn of the camera is no error of its lens, "
            "since its pose includes it: the last columns are what is left after the best turn, and that turn.",
            dense=True,
        )
        yield Section("lenses", "Lenses", blocks=(table,))


def _calibrations(comparison: Comparison) -> Section:
    rows = tuple(
        (
            one.name,
            one.format,
            one.verdict or MISSING,
            one.frame,
            one.stated_sigmas,
            one.gravity.replace("m/s^2", "m/s²").replace("+-", "±") or MISSING,
            ", ".join(one.sensors),
            ", ".join(f"{source.name} ({source.sha256[:8]})" for source in one.inputs) or MISSING,
        )
        for one in comparison.calibrations
    )
    table = ReportTable(
        "What was compared",
        ("name", "format", "verdict", "body frame", "sigmas", "gravity", "sensors", "recording"),
        rows,
        prose=True,
    )
    notes = tuple(f"{one.name}: {note}" for one in comparison.calibrations for note in one.notes)
    return Section("calibrations", "Calibrations", blocks=(table, *([Prose(notes, points=True)] if notes else [])))


def _conventions(comparison: Comparison) -> Section:
    with_imu = any(sensor.startswith("imu") for one in comparison.calibrations for sensor in one.sensors)
    forms = (
        f"All calibrations were brought into body frame {comparison.frame} and into the form of Krebs: measured = "
        "S M R x + b, with scales S, M unit lower triangular (yz, zy, zx), and R the rotation from body to triad.",
        "p_cam = T_cam_imu p_imu; t_imu = t_cam + time shift. The rotation of a camera is that from body to camera; "
        "differences of rotations are rotation vectors about the body's axes.",
    )
    if not with_imu:
        forms = (
            f"The poses of cameras are to {comparison.frame}: p_cam1 = T_cam1_{comparison.frame} p_{comparison.frame}, "
            "with x to the right of its image, y down, z out of the lens; differences of rotations are rotation "
            "vectors about these axes.",
        )
    points = (
        *forms,
        "A difference has the variances of both calibrations, less what both share by the same assumed gravity. Where "
        "one states no sigmas it is held against those of the other; where neither does, against those of the rest.",
        f"All {comparison.compared} differences of scalars together exceed {number_text(comparison.z_limit, 3)} σ "
        "in one of a hundred comparisons of honest calibrations; beyond that two calibrations differ.",
    )
    return Section("conventions", "Conventions", blocks=(Prose(points, points=True),))


COLORS = ("x", "y", "z", "accent", "t1", "t5")
"""Of the first calibrations; more than these are drawn alike, but for those that stand out."""
OTHERS = "before"
_ROW = 50.0
_MOST_SIGMAS = 12.0


def color_of(comparison: Comparison, name: str) -> str:
    """Return the colour of a calibration."""
    names = [one.name for one in comparison.calibrations]
    if len(names) <= len(COLORS):
        return COLORS[names.index(name)]
    return COLORS[comparison.outside.index(name) % len(COLORS)] if name in comparison.outside else OTHERS


def drawn_blocks(comparison: Comparison) -> list[Repeatability]:
    """Return the blocks that the figure shows: those with sigmas and two values."""
    return [block for block in comparison.blocks if len(block.names) > 1 and np.isfinite(block.predicted).any()]


def truth_of(comparison: Comparison) -> str:
    """Return the name of the one calibration that is exact, against which the others are drawn; "" without one."""
    exact = [one.name for one in comparison.calibrations if one.exact]
    return exact[0] if len(exact) == 1 and all(exact[0] in block.names for block in drawn_blocks(comparison)) else ""


def draw_deviations(comparison: Comparison) -> Plot:
    """Deviation of every scalar from the truth, else from the mean, in predicted sigmas, a line for each block."""
    zero = "the truth" if truth_of(comparison) else "the mean"
    blocks = drawn_blocks(comparison)
    height = _ROW * len(blocks)

    sheet = Sheet()
    panel = sheet.panel(f"Deviation from {zero}, in sigmas", top=36, height=height, left=RIGHT, x_label="sigmas")
    reach = _reach(comparison, blocks)
    panel.x.span(-reach, reach)
    panel.x.grid = True
    panel.y.span(len(blocks) - 0.5, -0.5)
    panel.y.ticks, panel.y.grid = (), False
    panel.upright(0.0, "muted")
    for row, block in enumerate(blocks):
        style = TextStyle(color="muted", size=12, align="left")
        panel.text(block_words(block.path), -reach, row - 0.5, style, offset=(2.0, 15.0))
        _draw_block(panel, comparison, block, row, reach)
    count = len(comparison.calibrations)
    alt = f"Deviations of {count} calibrations in {len(blocks)} blocks from {zero}, in sigmas."
    return sheet.draw("deviations", height + 100, alt)


def _in_sigmas(comparison: Comparison, block: Repeatability) -> Floats:
    """Return the deviations (m, k) of the calibrations of a block in its predicted sigmas."""
    truth = truth_of(comparison)
    zero = block.values[block.names.index(truth)] if truth else block.mean
    with np.errstate(invalid="ignore", divide="ignore"):
        return (block.values - zero) / block.predicted


def _reach(comparison: Comparison, blocks: list[Repeatability]) -> float:
    sizes = [np.abs(_in_sigmas(comparison, block)) for block in blocks]
    largest = max((float(np.nanmax(size)) for size in sizes if np.isfinite(size).any()), default=1.0)
    return float(min(max(1.1 * largest, 3.0), _MOST_SIGMAS))


def _draw_block(panel: Panel, comparison: Comparison, block: Repeatability, row: int, reach: float) -> None:
    """Draw a block; what lies beyond the edge is drawn on it, hollow."""
    shown = [name for name in block.names if name != truth_of(comparison)]
    count, deviation = len(shown), _in_sigmas(comparison, block)
    for i, name in enumerate(shown):
        sigmas = deviation[block.names.index(name)]
        sigmas = sigmas[np.isfinite(sigmas)]
        place = np.full(len(sigmas), row + 0.2 + 0.5 * ((i + 0.5) / count - 0.5))
        inside = np.abs(sigmas) <= reach
        color = color_of(comparison, name)
        draw_dots(panel, sigmas[inside], place[inside], color, size=5.5)
        draw_dots(panel, np.clip(sigmas[~inside], -reach, reach), place[~inside], color, size=7.5, ring=True)


def write_verification_report(verification: Verification, path: str | Path, subject: str = "") -> None:
    """Write the report of a verification as one HTML file that needs neither network nor other files.

    Parameters
    ----------
    subject : what was verified, and by which recording

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(verification_page(verification, subject)))


def verification_page(verification: Verification, subject: str = "") -> ReportPage:
    """Return the page of a verification; see `write_verification_report`."""
    untold = sum(one.state == "cannot tell" for one in verification.blocks)
    return ReportPage(
        title="Does the calibration still hold?",
        subject=subject or verification.use,
        verdict=verification.verdict,
        headline=verification.headline[:1].upper() + verification.headline[1:],
        key_numbers=(
            KeyNumber("Blocks", str(len(verification.blocks))),
            KeyNumber("Moved", str(len(verification.moved))),
            KeyNumber("Not told", str(untold), "a longer recording may tell" if untold else ""),
        ),
        findings=tuple(typeset_finding(finding) for finding in verification.findings),
        front=verified_tables(verification),
        sections=(
            Section(
                "method",
                "How this was found",
                blocks=[
                    Prose(
                        (
                            "The same numbers were estimated from the fresh recording, and the difference was held "
                            "against the covariances of both. Each block was freed by itself (score test of Rao, "
                            "1948); the least probable one is taken as moved, and the others are asked again beside it "
                            "until none is certain, at one false alarm in a hundred calibrations that hold.",
                            *verification.notes,
                        )
                    )
                ],
            ),
        ),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def verified_tables(verification: Verification) -> tuple[ReportTable, ...]:
    """Return the tables of page one of a verification."""
    return front_tables(verification, (_moved(verification),))


def _moved(verification: Verification) -> ReportTable:
    return ReportTable(
        "Block by block",
        ("block", "moved by (± 1 σ)", f"{verification.use} needs", "z", "state"),
        [tuple(map(readable_unit, movement_words(block))) for block in verification.blocks],
        "By how much the recording finds each block elsewhere if all others hold, but those that moved; U is "
        "twice the ± (k = 2, about 95 %). z: standard deviations of a single number that are as improbable; from "
        f"{verification.certain_z:.1f} on a block moved for certain. Biases are new at each start: their ± includes "
        "what is usual.",
        dense=True,
        stacked=True,
    )
