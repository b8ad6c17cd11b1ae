"""What the report of one sensor says: an IMU by rests and rotations, poses, a turntable, a magnetometer.

There is one list of sections; a page has those for which the result holds something. Signals, the rest at the start and
rotations, which only an IMU has, are drawn here.
"""

from collections.abc import Iterator
from math import asin, degrees, isfinite

import numpy as np

from ...recording.samples import median_of
from ...results.calibration import Calibration, ImuCalibration
from ...results.result import JoinedDiagnostics
from ...results.sensor_diagnostics import (
    AllanCurve,
    DetectorTrace,
    ImuDiagnostics,
    IntervalTable,
    RotationTable,
    SignalEnvelope,
    TriadDiagnostics,
)
from ...units import STANDARD_GRAVITY_M_S2
from ..certificate import calibration_page, parameter_groups
from ..drawing.figures import (
    AXES,
    Plot,
    Sheet,
    coarsen_envelope,
    count_along,
    draw_dots,
    draw_envelope,
    log_limits,
    set_y_limits,
    thin_points,
)
from ..drawing.panel import Panel
from ..numbers import (
    MISSING,
    finite_values,
    fixed_text,
    largest_magnitude,
    magnitude_text,
    number_text,
    quantity_text,
    readable_unit,
    si_prefix,
)
from ..page import (
    FRAMES,
    Code,
    Figure,
    KeyNumber,
    Legend,
    ParameterTable,
    ReportPage,
    ReportTable,
    Section,
    aligned_matrix,
    assumptions_section,
    gravity_text,
    provenance_section,
)
from ..trust import trust_section
from .kinds import at_rest_section, dip_section, iteration_blocks, joined_numbers, joined_sections, rates_section
from .vectors import (
    COUNTED,
    MOST_ROWS,
    SERIES,
    Vectors,
    choices_section,
    directions_section,
    error_rows,
    kind_of,
    known_directions,
    largest_gap,
    magnitude_section,
    noise_section,
    span_text,
    used_rows,
    vectors_of,
)

_MODELS = {
    "basic": "constant gyroscope bias",
    "g-sensitivity": "gyroscope bias linear in specific force",
    "hard-iron": "offset and one scale",
    "full": "offset and every entry of the sensitivity",
}


def static_page(
    calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics | JoinedDiagnostics
) -> ReportPage:
    """Return the page of a calibration of one sensor."""
    if isinstance(diagnostics, JoinedDiagnostics):
        title, trust, numbers = "IMU calibration from several recordings", None, joined_numbers(calibration)
        before, after = joined_sections(diagnostics), ()
        lead = (
            "Means over the recordings. σ is the standard deviation of the sensor on another occasion about the mean: "
            "the scatter between the recordings is in it. Bars show the estimate, whiskers ±2σ."
        )
    else:
        title, trust, numbers = _title(diagnostics), diagnostics.trust, _key_numbers(calibration, diagnostics)
        before, after = (), static_sections(calibration, diagnostics)
        lead = (
            "Each estimate with its standard deviation σ. Bars show the estimate, whiskers ±2σ; the bars of one group "
            "share one scale. Parameters without σ are fixed by the definition of the body frame or by the model."
        )
    sections = (
        Section("parameters", "Parameters", lead, (ParameterTable(parameter_groups(calibration)),)),
        *before,
        trust_section(calibration.assessment, trust),
        *after,
        assumptions_section(calibration, _assumptions(calibration, diagnostics)),
        imu_use_section(calibration),
        provenance_section(calibration.provenance),
    )
    return calibration_page(title, calibration, numbers, sections, ("directions", "accelerometer", "gyroscope"))


def _title(diagnostics: ImuDiagnostics | TriadDiagnostics) -> str:
    if isinstance(diagnostics, ImuDiagnostics):
        return "IMU calibration"
    if diagnostics.kind == "poses":
        return "Accelerometer calibration" if diagnostics.at_rest is None else "Calibration at rest"
    return f"{diagnostics.kind.capitalize()} calibration"


def _key_numbers(calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics) -> tuple[KeyNumber, ...]:
    assessment, holdout = calibration.assessment, calibration.assessment.holdout
    plural = COUNTED[kind_of(diagnostics)][1]
    if isinstance(diagnostics, ImuDiagnostics):
        milli_g = number_text(1e3 * holdout.accelerometer_rms / STANDARD_GRAVITY_M_S2, 3)
        note = f"rms of |f| − g in intervals left out of the fit; {milli_g} mg"
        numbers = [KeyNumber("Accelerometer hold-out error", quantity_text(holdout.accelerometer_rms, "m/s²"), note)]
        if assessment.model != "none":
            angle = f"{number_text(degrees(holdout.rotation_rms), 3)}°"
            note = f"rms of gravity propagated over rotations left out; {angle}"
            numbers.append(KeyNumber("Gyroscope hold-out error", quantity_text(holdout.rotation_rms, "rad"), note))
    else:
        numbers = [
            KeyNumber(f"{name.capitalize()} hold-out error", magnitude_text(value, diagnostics.triads[name].si_unit
                      if name != "magnetometer" else ""), f"rms of {symbol} in {plural} left out of the fit")
            for name, value, symbol in (
                ("accelerometer", holdout.accelerometer_rms, "|f| − g"),
                ("gyroscope", holdout.rate_rms, "|ω| − rate"),
                ("magnetometer", holdout.field_rms, "|h| − 1, in parts of the field,"),
            )
            if name in diagnostics.triads and isfinite(value)
        ]  # fmt: skip
    counts = f"{assessment.intervals_used} of {assessment.intervals_found}"
    numbers.append(KeyNumber(f"{plural.capitalize()} used", counts, _spread_words(vectors_of(diagnostics)[0])))
    if isinstance(diagnostics, ImuDiagnostics) and assessment.model != "none":
        counts = f"{assessment.rotations_used} of {assessment.rotations_found}"
        numbers.append(KeyNumber("Rotations used", counts, "movements between static intervals"))
    numbers += _references(calibration, diagnostics)
    model = "accelerometer only" if isinstance(diagnostics, ImuDiagnostics) and assessment.model == "none" else ""
    model = model or _MODELS.get(assessment.model, "" if assessment.model == "none" else assessment.model)
    return (*numbers, KeyNumber("Body frame" + (" and model" if model else ""), calibration.frame, model))


def _spread_words(vectors: Vectors) -> str:
    """Say how far the emptiest spot of the sphere is from the nearest direction."""
    there = known_directions(vectors.table)
    return (
        f"no direction is farther than {fixed_text(largest_gap(there)[0], 0)}° from one of them" if len(there) else ""
    )


def _references(calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics) -> Iterator[KeyNumber]:
    """Yield the magnitudes that were known."""
    triads = diagnostics.triads if isinstance(diagnostics, TriadDiagnostics) else {"accelerometer"}
    if kind_of(diagnostics) != "magnetometer" and "accelerometer" in triads:
        source = calibration.gravity.source
        yield KeyNumber("Gravity", gravity_text(calibration.gravity), source[:1].upper() + source[1:])
    if isinstance(diagnostics, ImuDiagnostics):
        return
    if diagnostics.rates:
        fastest = max(diagnostics.rates, key=lambda rate: abs(rate.estimated))
        known = fastest.estimated_sigma > 0 and fastest.estimated != 0
        spread = f"known to {number_text(100 * fastest.estimated_sigma / abs(fastest.estimated), 2)} %" if known else ""
        speeds = f"fastest of {len(diagnostics.rates)} speeds" if len(diagnostics.rates) > 1 else "the one speed"
        note = ", ".join(filter(None, (speeds, spread)))
        yield KeyNumber("Turntable", quantity_text(abs(fastest.estimated), "rad/s", 6), note)
    if diagnostics.dip is not None:
        value, sigma = degrees(diagnostics.dip.estimated_rad), degrees(diagnostics.dip.sigma_rad)
        note = "of the field below horizontal, the same in all attitudes"
        yield KeyNumber("Dip", f"{number_text(value, 4)} ± {number_text(sigma, 2)}°", note)


def _assumptions(
    calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics | JoinedDiagnostics
) -> Iterator[str]:
    gravity, frame = calibration.gravity, calibration.frame
    triads = diagnostics.triads if isinstance(diagnostics, TriadDiagnostics) else {"accelerometer"}
    kind = diagnostics.kind if isinstance(diagnostics, TriadDiagnostics) else ""
    if isinstance(diagnostics, JoinedDiagnostics):
        yield f"Gravity is {gravity_text(gravity)} ({gravity.source}), the same in all recordings."
    elif "accelerometer" in triads:
        relative = 100 * gravity.sigma / gravity.value
        carried = f"; here its σ is {number_text(relative, 2)}\u00a0%" if relative > 0 else ""
        yield (
            f"Gravity is {gravity_text(gravity)} ({gravity.source}). A relative error of gravity is the same relative "
            f"error of every accelerometer scale{carried}."
        )
    if kind == "turntable":
        yield "Between spin-up and stop the turntable turned at one constant rate, the same in all parts at one speed."
    if kind == "magnetometer":
        yield (
            "The magnetic field was the same, in strength and direction, wherever the sensor was held. What turned "
            "with the sensor, hard and soft iron, is part of the calibration; a field that changes from place to place "
            "is not."
        )
        sensors = [imu.magnetometer for imu in calibration.imus.values() if imu.magnetometer is not None]
        if any(sensor.field_unit != "uT" for sensor in sensors):
            yield (
                "The strength of the field was not stated, and is the unit of the calibrated field: give it in µT "
                "(--field) to have the result in µT."
            )
    yield f"The body frame is {frame}: {FRAMES.get(frame, frame)}."
    if isinstance(diagnostics, JoinedDiagnostics):
        yield "All recordings are of one sensor with one setting. Scales and axes agree well enough for that."
        return
    if frame in ("gyro-x", "mag-x"):
        yield (
            "Magnitudes alone are the same in every frame: they cannot tell how these axes lie to an accelerometer or "
            "to a housing (Angrisano). Record the accelerometer too, in the same attitudes, to relate the frames."
        )
    yield (
        "Which way an axis points, and that the axes are right-handed, comes from the order of the columns: magnitudes "
        "cannot tell."
    )
    if isinstance(diagnostics, ImuDiagnostics):
        if calibration.assessment.model != "none":
            yield (
                "A delay between accelerometer and gyroscope cannot be seen in this kind of recording; it is taken as "
                "zero."
            )
        if calibration.assessment.model == "basic":
            yield "The bias of the gyroscope does not depend on specific force."


_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")


def static_sections(
    calibration: Calibration, diagnostics: ImuDiagnostics | TriadDiagnostics
) -> tuple[Section | None, ...]:
    """Return the sections on how the calibration came about, in their order; None where there is nothing to say."""
    imu = diagnostics if isinstance(diagnostics, ImuDiagnostics) else None
    triads = diagnostics if isinstance(diagnostics, TriadDiagnostics) else None
    vectors = vectors_of(diagnostics)
    return (
        _recording_section(imu) if imu else None,
        _rest_section(imu) if imu else None,
        rates_section(triads) if triads else None,
        directions_section(vectors, kind_of(diagnostics)),
        *(magnitude_section(one, kind_of(diagnostics), calibration) for one in vectors),
        _rotations_section(imu.rotations, calibration.gravity.value) if imu else None,
        at_rest_section(triads) if triads else None,
        dip_section(triads) if triads else None,
        choices_section(diagnostics, iteration_blocks(triads) if triads else ()),
        noise_section(diagnostics),
    )


def _recording_section(diagnostics: ImuDiagnostics) -> Section:
    """Return the signals with the static detector, and what it left out."""
    intervals = diagnostics.intervals
    used = used_rows(intervals)
    still = float(np.sum(finite_values(intervals.stop_s[used] - intervals.start_s[used])))
    waves = [Legend("band", "before", "static, used")]
    if not used.all():
        waves.append(Legend("band", "accent", "static, left out"))
    figure = Figure(
        "Signals and static detector",
        draw_raw_signals(diagnostics),
        (*_AXES, *waves, Legend("line", "accent", f"threshold {number_text(diagnostics.detector.multiplier, 3)}")),
        "The signals as recorded, reduced to the minimum and maximum of short stretches; shaded where the sensor "
        f"rests: {int(used.sum())} intervals were used, {number_text(still, 4)} s in all. Below, the variance in a "
        "sliding window relative to its level at rest: where it stays under the threshold, the sensor is static.",
    )
    rejected = np.flatnonzero(~used)
    rows = [
        (str(i + 1), span_text(intervals, i, 5), intervals.reason[i] or MISSING) for i in rejected[:MOST_ROWS].tolist()
    ]
    head, more = ("interval", "time [s]", "reason"), len(rejected) - len(rows)
    caption = f"And {more} more." if more else ""
    left_out = [ReportTable("Static intervals that were left out", head, rows, caption, prose=True)] if rows else []
    return Section("recording", "Recording", blocks=(figure, *left_out))


def _rest_section(diagnostics: ImuDiagnostics) -> Section | None:
    """Return the Allan plot with advice on the initial rest; None without a gyroscope at rest."""
    curve = diagnostics.allan
    if curve is None or not finite_values(curve.deviation).size:
        return None
    legend = [*_AXES]
    static = f"The recording starts with {number_text(curve.static_s, 3)} s at rest"
    if isfinite(curve.t_init_s):
        legend.append(Legend("dash", "accent", f"advised T_init {number_text(curve.t_init_s, 3)} s"))
        advice = f"The curves flatten at an averaging time of {number_text(curve.t_init_s, 3)} s. {static}: " + (
            "long enough." if curve.static_s >= curve.t_init_s else "rest longer before the first movement next time."
        )
    else:
        advice = (
            f"{static}, too short to see where the curves flatten. "
            "A longer rest before the first movement, such as 50 s, would tell."
        )
    return Section(
        "rest",
        "Rest at the start",
        "The Allan deviation shows how the mean of the gyroscope settles as it is averaged for longer. Where the "
        "three curves flatten, a longer initial rest would not make the bias any better known.",
        (Figure("Gyroscope at rest", draw_allan(curve), legend, advice),),
    )


def _rotations_section(rotations: RotationTable, gravity: float) -> Section | None:
    """Return the errors of the gyroscope over the rotations; None if no rotation was used."""
    used = used_rows(rotations)
    if not used.any():
        return None
    figure = Figure(
        "Gravity carried along by the gyroscope",
        rotation_errors(rotations),
        SERIES,
        "For each rotation, gravity before it is carried along by integrating the gyroscope, and compared with "
        "gravity measured after it. Before: one scale for all axes and the bias of the first interval. An error that "
        "grows with the angle speaks of scale or misalignment, one that does not of bias or noise.",
    )
    rows: list[tuple[str, ...]] = []
    for name, values in error_rows(rotations):
        # |u_a - u_g| is the chord of the angle between the two unit vectors.
        angle = degrees(2 * asin(min(values[2] / 2, 1.0))) if isfinite(values[2]) else float("nan")
        shown = f"{number_text(angle, 3)}°" if isfinite(angle) else MISSING
        rows.append(
            (name, *(quantity_text(v, "rad") for v in values), shown, quantity_text(values[0] * gravity, "m/s²"))
        )
    head = ("measured against propagated", "rms", "mean", "worst", "worst angle", "rms as magnitude")
    reasons = [reason for reason, one in zip(rotations.reason, used, strict=True) if not one]
    most = sorted(dict.fromkeys(reasons), key=lambda reason: -reasons.count(reason))[:5]
    listed = "; ".join(f"{reason or 'no reason given'} ({reasons.count(reason)})" for reason in most)
    lead = f"{len(reasons)} of {len(used)} rotations were left out: {listed}." if reasons else ""
    return Section("gyroscope", "Gyroscope", lead, (figure, ReportTable("In numbers", head, rows)))


def draw_raw_signals(diagnostics: ImuDiagnostics) -> Plot:
    """Raw signals with the static detector over them (Tedaldi 2014, Fig. 3.1), and its statistic (Eq. 3.9)."""
    gyroscope = diagnostics.gyroscope
    ends = finite_values(np.concatenate([diagnostics.accelerometer.t_s, diagnostics.intervals.stop_s]))
    duration = float(ends.max()) if ends.size and ends.max() > 0 else 1.0
    height = 292.0 if gyroscope is None else 554.0

    sheet = Sheet()
    top = 36.0
    for name, signal in (("Accelerometer", diagnostics.accelerometer), ("Gyroscope", gyroscope)):
        if signal is None:
            continue
        axes = sheet.panel(f"{name} [{readable_unit(signal.unit)}]", top=top, height=210)
        _signal(axes, signal, diagnostics.intervals)
        axes.x.span(0, duration)
        axes.x.labelled = False
        axes.x.timed = True
        top += 262
    axes = sheet.panel("Variance over resting variance", top=top, height=170, x_label="time [s]")
    _statistic(axes, diagnostics.detector)
    axes.x.span(0, duration)
    axes.x.timed = True
    alt = (
        f"Raw signals over {duration:.0f} s; shaded where the recording is static: "
        f"{len(diagnostics.intervals.start_s)} intervals. Below, the detector's statistic against its threshold."
    )
    return sheet.draw("signals", height + 270 - 36, alt)


def _signal(panel: Panel, signal: SignalEnvelope, intervals: IntervalTable) -> None:
    t, low, high = coarsen_envelope(signal.t_s, signal.low, signal.high)
    for i, name in enumerate(AXES):
        draw_envelope(panel, t, low[:, i], high[:, i], name)
    set_y_limits(panel, low, high)
    used = np.asarray(intervals.used, dtype=bool)
    for chosen, color in ((used, "before"), (~used, "accent")):
        panel.shade(intervals.start_s[chosen], intervals.stop_s[chosen], color, alpha=0.3)


def _statistic(panel: Panel, trace: DetectorTrace) -> None:
    statistic = np.where(trace.statistic > 0, trace.statistic, np.nan)
    t, low, high = coarsen_envelope(trace.t_s, statistic, statistic)
    draw_envelope(panel, t, low, high, "before")
    log_limits(panel, statistic, np.array([trace.multiplier]))
    if trace.multiplier > 0:
        panel.across(trace.multiplier, "accent", width=1.6)


def draw_allan(curve: AllanCurve) -> Plot:
    """Allan deviation of the three gyroscope axes (Tedaldi 2014, Fig. 3.2), with the advised T_init."""
    sheet = Sheet()
    prefix, factor = si_prefix(
        float(median_of(finite_values(curve.deviation))) if finite_values(curve.deviation).size else 1.0
    )
    title = f"Allan deviation [{prefix}rad/s]"
    axes = sheet.panel(title, top=36, height=290, x_label="averaging time [s]")
    axes.x.grid = True
    positive = np.where(curve.deviation > 0, curve.deviation * factor, np.nan)
    for i, name in enumerate(AXES):
        axes.line(curve.tau_s, positive[:, i], name, width=1.8)
    log_limits(axes, positive)
    axes.x.logarithmic = True
    taus = finite_values(curve.tau_s)
    taus = taus[taus > 0]
    bounds = (float(taus.min()), float(taus.max())) if taus.size else (1.0, 10.0)
    axes.x.span(bounds[0], max(bounds[1], 1.05 * bounds[0]))
    axes.x.ticks = [step * 10.0**k for k in range(-9, 9) for step in (1, 2, 5)]
    if np.isfinite(curve.t_init_s):
        axes.upright(curve.t_init_s, "accent", width=1.6, dash=(5.0, 3.0))
    alt = f"Allan deviation of the gyroscope axes x, y, z over averaging time, from {curve.static_s:.0f} s at rest."
    return sheet.draw("allan", 386, alt)


def rotation_errors(rotations: RotationTable) -> Plot:
    """|u_a - u_g| per rotation and over the angle turned: before, after, held out."""
    used = np.asarray(rotations.used, dtype=bool)
    number_of = np.asarray(np.flatnonzero(used) + 1, dtype=np.float64)
    degrees = np.asarray(np.degrees(rotations.angle_rad[used]), dtype=np.float64)

    sheet = Sheet()
    title = "Measured against propagated gravity [mrad]"
    panels = (
        (sheet.panel(title, top=36, height=220, x_label="rotation"), number_of),
        (sheet.panel(title, top=364, height=220, x_label="angle by which gravity turned [°]"), degrees),
    )
    series = (
        (rotations.error_before[used], "before", False, 7.0),
        (rotations.error_holdout[used], "heldout", True, 7.0),
        (rotations.error_after[used], "after", False, 5.0),
    )
    for axes, x in panels:
        for values, color, ring, size in series:
            positive = np.where(values > 0, values * 1e3, np.nan)
            draw_dots(axes, *thin_points(x, positive), color, size=size, ring=ring)
        log_limits(axes, *(values * 1e3 for values, _, _, _ in series))
    count_along(panels[0][0], len(used))
    panels[1][0].x.span(0, max(largest_magnitude(degrees) * 1.04, 1.0) if finite_values(degrees).size else 180.0)
    alt = f"Difference of measured and gyro-propagated gravity over {int(used.sum())} rotations, before and after."
    return sheet.draw("rotations", 644, alt)


_MEANT = {"accelerometer": "specific force f", "gyroscope": "angular rate ω", "magnetometer": "magnetic field h"}


def imu_use_section(calibration: Calibration) -> Section:
    """Return commands, a few lines of Python, and the formulas with their numbers."""
    imus = calibration.imus
    to = "kalibr" if all(imu.accelerometer is not None for imu in imus.values()) else "csv"
    blocks = [
        Code(
            "On the command line",
            "gnomon apply calibration.yaml RECORDING -o calibrated.csv\n"
            "gnomon show calibration.yaml\n"
            f"gnomon convert calibration.yaml --to {to}",
        )
    ]
    for name, imu in imus.items():
        blocks.append(
            Code(
                "In Python" if len(imus) == 1 else f"In Python, {name}",
                "import gnomon\n\n"
                'calibration = gnomon.load("calibration.yaml")\n'
                f'samples = gnomon.{_reader(imu)}("RECORDING").imus[{name!r}]\n'
                f"calibrated = calibration.imus[{name!r}].apply(samples)\n"
                f"# {_units(imu)}, in the body frame",
            )
        )
        blocks += _formulas(imu)
    meant = [text for triad, text in _MEANT.items() if any(getattr(imu, triad) is not None for imu in imus.values())]
    listed = " and ".join(filter(None, (", ".join(meant[:-1]), meant[-1])))
    return Section(
        "use", "How to use it", f"The calibration maps what the sensor reads to {listed} in the body frame.", blocks
    )


def _reader(imu: ImuCalibration) -> str:
    alone = imu.accelerometer is None and imu.magnetometer is None
    return "read_turntable" if alone else "read"


def _units(imu: ImuCalibration) -> str:
    units = ["m/s²"] if imu.accelerometer is not None else []
    units += ["rad/s"] if imu.gyroscope is not None else []
    if imu.magnetometer is not None:
        units.append("µT" if imu.magnetometer.field_unit == "uT" else "in units of the local field")
    return " and ".join(filter(None, (", ".join(units[:-1]), units[-1])))


def _formulas(imu: ImuCalibration) -> Iterator[Code]:
    if (accelerometer := imu.accelerometer) is not None:
        text = "m = S f + b          f = S⁻¹ (m − b)\n\n" + aligned_matrix("S", accelerometer.sensitivity)
        text += "\n\n" + aligned_matrix("b", accelerometer.bias[:, None])
        yield Code(f"Accelerometer: m in {accelerometer.unit}, f in m/s²", text)
    if (gyroscope := imu.gyroscope) is not None:
        felt = imu.accelerometer is not None or bool(gyroscope.g_sensitivity.any())
        text = "y = S ω + b + G f    ω = S⁻¹ (y − b − G f)" if felt else "y = S ω + b          ω = S⁻¹ (y − b)"
        text += "\n\n" + aligned_matrix("S", gyroscope.sensitivity)
        text += "\n\n" + aligned_matrix("b", gyroscope.bias[:, None])
        text += "\n\n" + aligned_matrix("G", gyroscope.g_sensitivity) if felt else ""
        yield Code(f"Gyroscope: y in {gyroscope.unit}, ω in rad/s", text)
    if (magnetometer := imu.magnetometer) is not None:
        text = "c = S h + b          h = S⁻¹ (c − b)\n\n" + aligned_matrix("S", magnetometer.sensitivity)
        text += "\n\n" + aligned_matrix("b", magnetometer.bias[:, None])
        field = "µT" if magnetometer.field_unit == "uT" else "units of the local field"
        yield Code(f"Magnetometer: c in {readable_unit(magnetometer.unit)}, h in {field}", text)
