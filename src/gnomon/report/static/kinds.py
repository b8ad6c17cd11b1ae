"""What only some results on one sensor show: several recordings, a turntable, rest in many attitudes, a dip."""

from math import degrees, isfinite, pi

import numpy as np

from ...options.requirements import BETWEEN_RECORDINGS, QUANTITIES
from ...recording import Floats
from ...results.calibration import Calibration
from ...results.result import JoinedDiagnostics
from ...results.sensor_diagnostics import (
    DipTable,
    GyroscopeAtRest,
    IterationHistory,
    PeriodCurve,
    TriadDiagnostics,
    TriadRecord,
)
from ..drawing.figures import Plot, Sheet, count_along, draw_dots, log_limits, set_y_limits
from ..drawing.panel import Panel
from ..numbers import (
    MISSING,
    estimate_text,
    finite_rms,
    finite_values,
    fixed_text,
    highest_finite,
    largest_magnitude,
    number_text,
    quantity_text,
    readable_unit,
    si_prefix,
)
from ..page import FRAMES, Figure, KeyNumber, Legend, ReportTable, Section, gravity_text
from .vectors import MOST_ROWS


def joined_numbers(calibration: Calibration) -> tuple[KeyNumber, ...]:
    """Return the key numbers of several recordings that were joined."""
    assessment = calibration.assessment
    between = {name: assessment.trust.between.get(name, 0.0) for name in ("gyroscope_bias", "accelerometer_bias")}
    unseen = quantity_text(assessment.holdout.accelerometer_rms, "m/s²")
    return (
        KeyNumber("Recordings", str(assessment.trust.recordings), "each calibrated for itself, then joined"),
        *(
            KeyNumber(
                f"Turn-on {QUANTITIES[name].words}",
                f"± {_amount(name, value)}",
                "standard deviation from recording to recording",
            )
            for name, value in between.items()
            if value > 0
        ),
        KeyNumber("Accelerometer hold-out error", unseen, "rms of |f| − g in intervals left out of the fits"),
        KeyNumber("Gravity", gravity_text(calibration.gravity), calibration.gravity.source),
        KeyNumber("Body frame", calibration.frame, FRAMES.get(calibration.frame, "")),
    )


def _amount(name: str, value: float) -> str:
    unit = QUANTITIES[name]
    return f"{number_text(value / unit.size, 2)}\u00a0{readable_unit(unit.unit)}"


def joined_sections(diagnostics: JoinedDiagnostics) -> tuple[Section, Section]:
    """Return how much the sensor changes from recording to recording, and each recording."""
    return (
        Section(
            "between",
            "What changes between recordings",
            "What a sensor itself changes between two recordings no single recording can tell: its turn-on bias, and "
            "what temperature and mounting do.",
            (_scatter_table(diagnostics),),
        ),
        Section(
            "recordings",
            "Recordings",
            "Each was calibrated for itself; gnomon imu with one of them alone makes its full report.",
            (_recordings_table(diagnostics), _deviations_table(diagnostics)),
        ),
    )


def _scatter_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    recordings, quantities = diagnostics.recordings, np.array(diagnostics.quantity)
    within = np.sqrt(np.mean([one.sigma**2 for one in recordings], axis=0))
    distance = np.array([one.z for one in recordings])
    rows: list[tuple[str, ...]] = []
    for name in dict.fromkeys(diagnostics.quantity):
        at = np.flatnonzero((quantities == name) & (diagnostics.scatter > 0))
        if len(at):
            sizes = (
                float(diagnostics.scatter[at].max()),
                finite_rms(within[at]),
                finite_rms(diagnostics.mean_sigma[at]),
            )
            amounts = (_amount(name, size) for size in (*sizes, BETWEEN_RECORDINGS[name]))
            rows.append((QUANTITIES[name].words, *amounts, number_text(finite_rms(distance[:, at]), 2)))
    return ReportTable(
        "Scatter between recordings (σ)",
        ("quantity", "between recordings", "within one", "of the mean", "usual", "z rms, one left out"),
        rows,
        "Within one: rms sigma that a single recording states. Usual: of consumer sensors; "
        "with few recordings the estimate leans on it. z rms: distance of each recording from what the others "
        "foretell, over its standard deviation; 1 is honest, and with two recordings there is none.",
    )


def _recordings_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    rows = [
        (
            one.name,
            one.verdict,
            str(one.intervals),
            str(one.rotations),
            quantity_text(one.accelerometer_rms, "m/s²"),
            f"{number_text(degrees(one.rotation_rms), 2)}°" if isfinite(one.rotation_rms) else MISSING,
        )
        for one in diagnostics.recordings
    ]
    head = ("recording", "verdict", "intervals", "rotations", "accelerometer hold-out", "gyroscope hold-out")
    return ReportTable("One by one", head, rows)


def _deviations_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    recordings = diagnostics.recordings
    off = [(one.values - diagnostics.mean) / np.where(one.sigma > 0, one.sigma, np.nan) for one in recordings]
    rows = [
        (diagnostics.names[i].removeprefix("imu0."), *(number_text(float(z[i]), 2) for z in off))
        for i in np.flatnonzero(diagnostics.scatter > 0).tolist()
    ]
    return ReportTable(
        "Parameters, recording minus mean, in σ of that recording",
        ("parameter", *(one.name for one in recordings)),
        rows,
        "Large numbers are what the sensor changed. They are part of the published σ.",
        dense=True,
    )


def rates_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the speeds of a turntable, and what videos showed; None without any."""
    if not diagnostics.rates:
        return None
    rows: list[tuple[str, ...]] = []
    for rate in diagnostics.rates:
        if rate.stated == 0 and rate.stated_sigma == 0:
            rows.append((rate.name, str(rate.parts), "0", "0", MISSING, "0"))
            continue
        exact = "" if rate.stated_sigma > 0 else " (exact)"
        change = (rate.estimated - rate.stated) / rate.stated_sigma if rate.stated_sigma > 0 else float("nan")
        rows.append((
            rate.name,
            str(rate.parts),
            estimate_text(rate.stated, rate.stated_sigma) + exact,
            estimate_text(rate.estimated, rate.estimated_sigma),
            f"{fixed_text(change, 1, sign=True)} σ" if isfinite(change) else MISSING,
            estimate_text(rate.estimated * 30 / pi, rate.estimated_sigma * 30 / pi),
        ))  # fmt: skip
    head = ("speed", "steady parts", "beforehand [rad/s]", "after the fit [rad/s]", "change", "after the fit [rpm]")
    caption = "The change is counted in standard deviations of what was known beforehand."
    blocks: list[ReportTable | Figure] = [ReportTable("Speeds", head, rows, caption)]
    for i, curve in enumerate(diagnostics.videos):
        rate = next((rate for rate in diagnostics.rates if rate.name == curve.name), None)
        period = 2 * pi / abs(rate.stated) if rate is not None and rate.stated else float("nan")
        turns = f" over {number_text(rate.turns, 4)} turns" if rate is not None and isfinite(rate.turns) else ""
        legend = [Legend("line", "after", "likeness")]
        legend += [Legend("dash", "accent", f"one turn, {number_text(period, 6)} s")] * isfinite(period)
        blocks.append(
            Figure(
                f"Video {curve.name}",
                draw_video_repeats(curve, f"video-{i}", period),
                legend,
                "Above: how well the picture repeats after a time; after whole turns it does best. Below: "
                f"where the platter was against one that turns at a constant rate{turns}. A slow wave is a speed that "
                "varies, steps are frames that were lost.",
            )
        )
    return Section(
        "speeds",
        "Speed of the turntable",
        "The rate of the turntable is the reference of every scale: a relative error of the rate is the same "
        "relative error of all three scales.",
        blocks,
    )


def at_rest_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the gyroscope at rest in several attitudes; None where g-sensitivity did not come from it."""
    rest = diagnostics.at_rest
    if rest is None or not len(rest.t_s):
        return None
    unit = readable_unit(rest.unit)
    figure = Figure(
        "Mean rate at rest in each attitude",
        at_rest(rest),
        (*(Legend("dot", axis, f"{axis} measured, ±2σ") for axis in "xyz"), Legend("ring", "ink", "predicted")),
        "Each axis less its mean over all attitudes, so that what depends on the attitude shows. Predicted are "
        "constant bias, drift, g-sensitivity and, where the latitude was stated, the earth's rate. Below, the drift "
        "that was estimated jointly with them.",
    )
    left, centred = rest.measured - rest.predicted, rest.measured - mean_rate(rest)
    rows: list[tuple[str, ...]] = []
    for i, axis in enumerate("xyz"):
        values = (
            finite_rms(centred[:, i]),
            finite_rms(left[:, i]),
            largest_magnitude(left[:, i]),
            finite_rms(rest.sigma[:, i]),
        )
        rows.append((axis, *(f"{number_text(value, 3, trim=False)}\u00a0{unit}" for value in values)))
    head = ("axis", "constant bias, rms", "with g-sensitivity, rms", "worst", "expected (σ)")
    return Section(
        "at-rest",
        "Gyroscope at rest",
        "At rest a gyroscope reads its bias, which depends on the specific force: the static experiment of Krebs. Six "
        "attitudes or more give the whole g-sensitivity.",
        (figure, ReportTable("Measured against predicted", head, rows)),
    )


def dip_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the dip of the field in each attitude; None where the magnetometer was not aligned by it."""
    dip = diagnostics.dip
    if dip is None or not len(dip.dip_rad):
        return None
    left = np.degrees(dip.dip_rad - dip.estimated_rad)
    figure = Figure(
        "Dip in each attitude",
        draw_field_dip(dip),
        (Legend("dot", "before", "measured"), Legend("line", "after", "estimated"), Legend("band", "after", "±2σ")),
        f"Estimated {estimate_text(degrees(dip.estimated_rad), degrees(dip.sigma_rad))}°; attitudes differ from it by "
        f"{number_text(finite_rms(left), 3)}° rms, {number_text(largest_magnitude(left), 3)}° at worst.",
    )
    return Section(
        "dip",
        "Alignment to the accelerometer",
        "Magnitudes cannot tell how the magnetometer lies to the accelerometer. The angle between field and "
        "gravity can: it is the same in every attitude when the two are aligned.",
        (figure,),
    )


_PREFIXED = ("rad/s", "deg/s")
_MOST = 300
"""Attitudes beyond this are drawn only in part."""


def mean_rate(rest: GyroscopeAtRest) -> Floats:
    """Return the mean over all attitudes, (3,) [unit]; zero where nothing is known."""
    known = np.isfinite(rest.measured)
    return np.where(known, rest.measured, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def at_rest(rest: GyroscopeAtRest) -> Plot:
    """Gyroscope at rest in each attitude, measured and predicted, an axis a panel; the drift of its bias below."""
    count = len(rest.t_s)
    some = slice(None, None, -(-count // _MOST))
    number = np.arange(1.0, count + 1)[some]
    measured, predicted, sigma = rest.measured[some], rest.predicted[some], rest.sigma[some]
    centre = mean_rate(rest)
    measured, predicted = measured - centre, predicted - centre

    sheet = Sheet()
    unit, factor = _scaled(largest_magnitude(np.concatenate([measured, predicted])), rest.unit)
    for axis, name in enumerate("xyz"):
        top = 36.0 + 190 * axis
        label = "attitude" if axis == 2 else ""
        panel = sheet.panel(f"{name} axis, less its mean [{unit}]", top=top, height=136, x_label=label)
        _whiskers(panel, number, factor * measured[:, axis], 2 * factor * sigma[:, axis], name)
        draw_dots(panel, number, factor * predicted[:, axis], "ink", size=9, ring=True)
        draw_dots(panel, number, factor * measured[:, axis], name, size=6)
        reach = factor * (np.abs(measured[:, axis]) + 2 * sigma[:, axis])
        set_y_limits(panel, reach, factor * predicted[:, axis], symmetric=True)
        count_along(panel, count)
        panel.across(0, "muted")
        panel.x.labelled = axis == 2
    unit, factor = _scaled(largest_magnitude(rest.drift), rest.unit)
    panel = sheet.panel(f"Drift of the bias [{unit}]", top=662, height=136, x_label="time [s]")
    for axis, name in enumerate("xyz"):
        panel.line(rest.t_s[some], factor * rest.drift[some, axis], name, width=1.6)
    set_y_limits(panel, factor * rest.drift, symmetric=True)
    ends = finite_values(rest.t_s)
    panel.x.span(*(ends.min(), max(ends.max(), ends.min() + 1)) if ends.size else (0, 1))
    panel.across(0, "muted")
    alt = f"Mean rate of the gyroscope at rest in {count} attitudes, measured and predicted, and the drift of its bias."
    return sheet.draw("at-rest", 858, alt)


def _whiskers(panel: Panel, x: Floats, y: Floats, reach: Floats, color: str) -> None:
    gap = np.full(len(x), np.nan)
    ends = np.stack([y - reach, y + reach, gap], axis=1).ravel()
    panel.line(np.stack([x, x, gap], axis=1).ravel(), ends, color, width=1.4, alpha=0.7)


def _scaled(reach: float, unit: str) -> tuple[str, float]:
    """Return the unit of a recording with a prefix, where it takes one, and the factor to it."""
    prefix, factor = si_prefix(reach) if unit in _PREFIXED else ("", 1.0)
    return f"{prefix}{readable_unit(unit)}", factor


def draw_field_dip(table: DipTable) -> Plot:
    """Angle between magnetic field and horizontal in each attitude, with the estimated one."""
    count = len(table.dip_rad)
    found, estimated = np.degrees(table.dip_rad), float(np.degrees(table.estimated_rad))
    spread = 2 * float(np.degrees(table.sigma_rad))

    sheet = Sheet()
    panel = sheet.panel("Dip of the field below horizontal [°]", top=36, height=220, x_label="attitude")
    if spread > 0:
        panel.strip(estimated - spread, estimated + spread, "after", alpha=0.2)
    panel.across(estimated, "after", width=1.6)
    draw_dots(panel, np.arange(1.0, count + 1), np.asarray(found, dtype=np.float64), "before")
    set_y_limits(panel, np.asarray(found, dtype=np.float64), np.array([estimated - spread, estimated + spread]))
    count_along(panel, count)
    alt = f"Dip of the magnetic field in {count} attitudes; estimated {estimated:.2f} degrees."
    return sheet.draw("dip", 320, alt)


def draw_video_repeats(curve: PeriodCurve, name: str, period_s: float) -> Plot:
    """How well the picture repeats after each period, and by how much the platter ran ahead of a constant rate."""
    sheet = Sheet()
    panel = sheet.panel("Likeness of pictures one period apart", top=36, height=180, x_label="period [s]")
    panel.line(curve.period_s, curve.score, "after", width=1.4)
    set_y_limits(panel, curve.score)
    panel.x.span(*_ends(curve.period_s))
    panel.x.grid = True
    if np.isfinite(period_s):
        panel.upright(period_s, "accent", width=1.6, dash=(5.0, 3.0))
    degrees = 360 * curve.phase_error_turns
    panel = sheet.panel("Platter ahead of a constant rate [°]", top=320, height=180, x_label="time [s]")
    draw_dots(panel, curve.t_s, degrees, "after", size=4)
    set_y_limits(panel, degrees, symmetric=True)
    panel.x.span(*_ends(curve.t_s))
    panel.across(0, "muted")
    alt = f"Video {curve.name}: likeness of pictures over the period between them, and the phase error of the platter."
    return sheet.draw(name, 560, alt)


def _ends(values: Floats) -> tuple[float, float]:
    known = finite_values(values)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return low, high if high > low else low + 1


def draw_fit_history(found: IterationHistory, name: str) -> Plot:
    """Residual quadratic form after each step of the paper's iteration."""
    step = np.arange(len(found.q), dtype=np.float64)

    sheet = Sheet()
    panel = sheet.panel("Residual quadratic form q", top=36, height=200, x_label="iteration")
    positive = np.where(found.q > 0, found.q, np.nan)
    panel.line(step, positive, "after", width=1.6)
    draw_dots(panel, step, positive, "after")
    if highest_finite(positive) > 10 * -highest_finite(-positive):
        log_limits(panel, found.q)
    else:
        set_y_limits(panel, positive)
    panel.x.span(-0.4, highest_finite(step, 1.0) + 0.4)
    panel.x.most, panel.x.whole = 10, True
    return sheet.draw(name, 300, f"Residual quadratic form over {len(found.q)} steps of the paper's iteration.")


def iteration_blocks(diagnostics: TriadDiagnostics) -> list[Figure | ReportTable]:
    """Return Angrisano's iteration of each triad that was calibrated by it."""
    return [
        block
        for name, found in diagnostics.triads.items()
        if found.history is not None and finite_values(found.history.q).size
        for block in _iteration(name, found, found.history)
    ]


def _iteration(name: str, record: TriadRecord, history: IterationHistory) -> tuple[Figure, ReportTable]:
    """Return the iteration of Angrisano's paper: q over the steps, and X after each of them."""
    q, X = history.q, history.parameters
    figure = Figure(
        f"Angrisano's iteration, {name}",
        draw_fit_history(history, f"history-{name}"),
        caption="The quadratic form of the residuals after each step of Eqs. (9) to (11). The iteration stops where a "
        "step changes it no more.",
    )
    unit, si = readable_unit(record.unit), readable_unit(record.si_unit)
    head = ("step", "q", *(f"{letter} {axis}" for letter in "abk" for axis in "xyz"))
    scaled = X * np.array([1e3] * 3 + [1.0] * 6)
    rows = [
        (str(i), number_text(float(value), 4), *(number_text(x, 5) for x in scaled[i].tolist()))
        for i, value in enumerate(q[:MOST_ROWS])
    ]
    scale = f"{si}/{unit}" if si != unit else "1"
    caption = f"Angles a in mrad, biases b in {unit}, scale factors k in {scale}."
    return figure, ReportTable("The nine parameters, step by step", head, rows, caption, dense=True)
