"""The page of the study of Angrisano."""

from math import degrees

import numpy as np

from ...recording import Floats
from ...results.result import Booleans
from ...study.angrisano import NAMES, AngrisanoSample, AngrisanoStudy, angrisano_claims, angrisano_group_rms
from ...study.angrisano_trial import GROUPS, TABLE_2, TRUTH, Basin, Journey
from ..drawing.figures import LEFT, Plot, Sheet, draw_dots, set_y_limits
from ..drawing.panel import Panel, TextStyle
from ..numbers import fixed_text, number_text
from ..page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section
from . import study_page

_AXES = ("x", "y", "z")
_SHOWN = (degrees(1.0), 1.0, 1e3)
_UNITS = ("°", "counts", "10⁻³ m/s² per count")
"""How offsets of angles, biases and scale factors are shown."""
_MOST = 12
"""Iterations that a figure shows at most."""
_SETUP = (
    "The simulated sensor is the one that Angrisano found (Table 1, first set): 16 bits, ±50 m/s², misaligned by up "
    "to 0.8°. It lies on the six faces and the twelve edges of a cube, each only roughly: the tilts scatter by 1° or "
    "10° about every axis. Each pose is the mean of one second at 100 Hz, quantised sample by sample.",
    "Angrisano solves Eq. (10) again and again from the datasheet start (12), until the residual form q changes by "
    "less than 0.05 %. Gnomon fits the same poses by maximum likelihood from a closed form, or from the same start "
    "where that is what is compared; its result is written in the nine parameters of Eq. (3).",
    "The rule as printed, (q before − q) / q ≤ 0.0005, is also met when q grows. Fig. 6 shows iterations that went on, "
    "so the rule is taken of the change here; both are shown where it matters.",
)


def angrisano_page(study: AngrisanoStudy) -> ReportPage:
    """Return the page of the study."""
    return study_page(
        "Study of Angrisano",
        f"Angrisano et al.: {study.runs} runs of each of {len(study.samples)} settings, seed {study.seed}",
        tuple(angrisano_claims(study)),
        _key_numbers(study),
        (_sigmas(study), _starts(study), _iterations(study), _setup()),
    )


def _key_numbers(study: AngrisanoStudy) -> tuple[KeyNumber, ...]:
    counts = study.samples[0].iterations
    usual, times = counts.most_common(1)[0]
    fewest, most = min(counts), max(counts)
    outcomes = [outcome for sample in study.samples for outcome in sample.outcomes]
    theirs = sum(outcome.paper_from_start == "converged" for outcome in outcomes) / len(outcomes)
    ours = sum(outcome.same_minimum for outcome in outcomes) / len(outcomes)
    return (
        KeyNumber(
            "Iterations from the datasheet",
            f"{fewest}" if fewest == most else f"{fewest} to {most}",
            f"{usual} in {number_text(100 * times / study.runs, 3)} % of the runs; Angrisano: 4 to 5",
        ),
        KeyNumber(
            "Poor starts, Angrisano's iteration",
            f"{number_text(100 * theirs, 3)} %",
            "end in the right minimum; drawn in Table 2's intervals widened threefold",
        ),
        KeyNumber("Poor starts, gnomon", f"{number_text(100 * ours, 4)} %", "end in the same minimum as without"),
    )


def _sigmas(study: AngrisanoStudy) -> Section:
    single = ReportTable(
        f"Each parameter: {study.samples[0].setting.name}",
        ("", "truth", "σ, Angrisano", "scatter", "ratio", "σ, gnomon", "scatter", "ratio"),
        tuple(_parameter_row(study.samples[0], k) for k in range(9)),
        "Scatter is the rms error over the runs; angles in radians, scale factors in m/s² per count.",
        dense=True,
    )
    return Section(
        "sigmas",
        "Sigmas (Table 1)",
        "Magnitudes need no precise attitudes: 10° do as well as 1° at the same noise. Components, Eq. (4), do: "
        "with attitudes known to 1° they are far worse.",
        (*(_group_table(sample) for sample in study.samples), single),
    )


def _group_table(sample: AngrisanoSample) -> ReportTable:
    shown = np.array([degrees(1) * 60, 1.0, 1e7])
    rows = {
        "σ, Angrisano's method": angrisano_group_rms(sample.sigma("paper")),
        "its scatter": angrisano_group_rms(sample.scatter("paper")),
        "σ, gnomon": angrisano_group_rms(sample.sigma("ours")),
        "scatter of gnomon": angrisano_group_rms(sample.scatter("ours")),
        "scatter of components, Eq. (4)": angrisano_group_rms(sample.scatter("components")),
    }
    if sample.setting.table_1 is not None:
        rows = {"σ in Table 1": np.array(sample.setting.table_1), **rows}
    noise = 1e3 * sample.setting.scenario.accelerometer_noise_density
    return ReportTable(
        f"{sample.setting.name[:1].upper()}{sample.setting.name[1:]}; noise of a mean {number_text(noise)} mm/s²",
        ("rms over the three axes", "angles [′]", "biases [count]", "scale factors [10⁻⁷]"),
        tuple((name, *(number_text(v, 3) for v in shown * values)) for name, values in rows.items()),
        marked=0 if sample.setting.table_1 is not None else None,
    )


def _parameter_row(sample: AngrisanoSample, k: int) -> tuple[str, ...]:
    cells = [NAMES[k], number_text(float(TRUTH[k]), 6)]
    for method in ("paper", "ours"):
        sigma, scatter = float(sample.sigma(method)[k]), float(sample.scatter(method)[k])
        cells += [number_text(sigma, 3), number_text(scatter, 3), fixed_text(sigma / scatter, 3)]
    return tuple(cells)


def _starts(study: AngrisanoStudy) -> Section:
    rows = [
        (
            f"{group} [{unit.removesuffix(' per count')}]",
            _interval(shown * TABLE_2[k]),
            _interval(shown * study.interval(k, "paper")),
            _interval(shown * study.interval(k, "printed")),
            _interval(shown * study.interval(k, "ours")),
        )
        for k, (group, unit, shown) in enumerate(zip(GROUPS, _UNITS, _SHOWN, strict=True))
    ]
    return Section(
        "starts",
        "Basin of convergence (Table 2)",
        "All three parameters of a group are moved by the same offset from the datasheet start. An interval holds "
        "the offsets about zero from which every start led to the right minimum.",
        (
            Figure(
                "Offsets from which the right minimum was found",
                _basins(study.basins[0]),
                (
                    Legend("band", "before", "Angrisano, Table 2"),
                    Legend("band", "y", "its iteration, repeated here; and with the stop rule as printed"),
                    Legend("band", "x", "gnomon"),
                ),
                "One experiment. Below zero and above it the steps differ: each side reaches three times as "
                "far as Table 2. Gaps are starts that led elsewhere.",
            ),
            ReportTable(
                f"Intervals, median over {len(study.basins)} of the experiments",
                ("", "Table 2", "iteration", "as printed", "gnomon"),
                rows,
                "Gnomon's intervals are all that was tried.",
            ),
        ),
    )


def _interval(ends: Floats) -> str:
    return f"{number_text(float(ends[0]), 3)} to +{number_text(float(ends[1]), 3)}"


def _basins(basins: tuple[Basin, ...]) -> Plot:
    sheet = Sheet()
    for k, basin in enumerate(basins):
        title = f"{basin.group[:1].upper()}{basin.group[1:]}: offset [{_UNITS[k]}]"
        _basin(sheet.panel(title, top=36.0 + 178 * k, height=112, left=LEFT + 52, right=44), basin, k)
    alt = "Offsets of the start from which Angrisano's iteration and gnomon find the right minimum, three groups."
    return sheet.draw("basins", 36 + 3 * 178, alt)


def _basin(panel: Panel, basin: Basin, group: int) -> None:
    low, high = TABLE_2[group]
    place, ours = _places(basin.offset, group), _places(basin.ours_offset, group)
    rows = (
        ("Table 2", place, np.abs(place) <= 1, "before"),
        ("iteration", place, basin.paper, "y"),
        ("as printed", place, basin.printed, "y"),
        ("gnomon", ours, basin.ours, "x"),
    )
    panel.x.span(place[0], place[-1])
    panel.y.span(-0.6, len(rows) - 0.4)
    panel.y.ticks, panel.y.grid, panel.x.ticks = (), False, ()
    for row, (name, tried, found, color) in enumerate(reversed(rows)):
        _strip(panel, tried, found, row, color)
        panel.text(name, float(place[0]), row, TextStyle(color="muted", size=12, align="right"), offset=(-8.0, 4.0))
    for at in range(round(place[0]), round(place[-1]) + 1):
        label = number_text(float(_SHOWN[group] * (at * high if at > 0 else -at * low)), 3)
        panel.text(label, float(at), -0.6, TextStyle(color="muted", size=12, align="center"), offset=(0.0, 18.0))
    panel.upright(0.0, "muted")


def _places(offset: Floats, group: int) -> Floats:
    """Return where offsets are drawn: in parts of Table 2's limits, so that both sides get half of the width."""
    low, high = TABLE_2[group]
    return np.where(offset < 0, -offset / low, offset / high)


def _strip(panel: Panel, place: Floats, found: Booleans, row: int, color: str) -> None:
    """Fill the row where `found`, half a step to either side of every place (m,)."""
    edges = np.concatenate([place[:1], 0.5 * (place[1:] + place[:-1]), place[-1:]])
    x = np.stack([edges[:-1], edges[1:]], axis=1)[found].ravel()
    gaps = np.flatnonzero(x[1:-1:2] != x[2::2]) if len(x) else np.empty(0, dtype=int)
    starts = np.concatenate([x[:1], x[2::2][gaps]])
    stops = np.concatenate([x[1:-1:2][gaps], x[-1:]])
    for a, b in zip(starts, stops, strict=True):
        panel.band(np.array([a, b]), np.full(2, row - 0.32), np.full(2, row + 0.32), color, alpha=0.75)


def _iterations(study: AngrisanoStudy) -> Section:
    figures = [
        Figure(
            f"{title}: {journey.name} ({journey.fit.iterations} iterations, {journey.fit.status})",
            _journey(f"journey-{k}", journey),
            (
                *(Legend("line", axis, axis) for axis in _AXES),
                Legend("dash", "muted", "truth"),
                Legend("ring", "ink", "gnomon from the same start"),
            ),
        )
        for k, (title, journey) in enumerate(zip(("Fig. 4", "Fig. 5", "Fig. 6"), study.journeys, strict=True))
    ]
    return Section(
        "iterations",
        "Iterations (Figs. 4 to 6)",
        "The figures of Angrisano drawn again from one simulated experiment.",
        figures,
    )


def _journey(name: str, journey: Journey) -> Plot:
    visited = journey.fit.visited[: _MOST + 1]
    steps = np.arange(len(visited), dtype=np.float64)
    panels = (("Angles [°]", 0, _SHOWN[0]), ("Biases [count]", 3, 1.0), ("Scale factors [10⁻³ m/s² per count]", 6, 1e3))

    sheet = Sheet()
    top = 36.0
    for title, first, shown in panels:
        last = first == 6
        panel = sheet.panel(title, top=top, height=130, x_label="iteration" if last else "")
        group = slice(first, first + 3)
        values, ours = shown * visited[:, group], shown * journey.ours[group]
        for k, axis in enumerate(_AXES):
            panel.across(float(shown * TRUTH[first + k]), "muted", dash=(4.0, 4.0))
            panel.line(steps, values[:, k], axis, width=1.6)
        draw_dots(panel, np.full(3, steps[-1] + 0.6), ours, "ink", ring=True)
        near = values if journey.fit.converged else _near(values, ours)
        set_y_limits(panel, near, ours)
        for k, axis in enumerate(_AXES):
            draw_dots(panel, steps, near[:, k], axis, size=5.0)
        panel.x.span(-0.2, steps[-1] + 0.9)
        panel.x.whole, panel.x.labelled = True, last
        top += 186
    alt = f"Angrisano's iteration {journey.name}: angles, biases and scale factors after each iteration."
    return sheet.draw(name, 36 + 3 * 186 + 20, alt)


def _near(values: Floats, ours: Floats) -> Floats:
    """Return values (m, 3) of an iteration that got lost, nan where they are too far away to be shown."""
    middle, reach = float(np.mean(ours)), 3 * float(np.ptp(np.concatenate([values[0], ours])))
    return np.where(np.abs(values - middle) <= reach, values, np.nan)


def _setup() -> Section:
    return Section("setup", "How it was simulated", blocks=(Prose(_SETUP),))
