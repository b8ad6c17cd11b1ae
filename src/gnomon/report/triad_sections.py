"""The sections of a report on a calibration from magnitudes that show how it came about."""

from math import floor, isfinite, log10, pi

import numpy as np

from ..triad_diagnostics import DipTable, GyroscopeAtRest, PoseTable, TriadDiagnostics, TriadRecord, TurntableRate
from . import magnitude_figures, triad_figures
from .imu_parameters import readable_unit
from .imu_sections import MOST_ROWS, SERIES, in_numbers, largest_gap
from .magnitude_units import scaled, shown
from .numbers import MISSING, finite, fixed, largest, number, positive, quantity, rms, with_sigma
from .page import Figure, Legend, Section, Table

COUNTED = {"poses": "pose", "turntable": "steady part", "magnetometer": "stretch"}
"""What one row of a table of poses is, by the kind of calibration; of the magnetometer, samples close together."""
COUNTED_PLURAL = {"poses": "poses", "turntable": "steady parts", "magnetometer": "stretches"}
_SYMBOLS = {"specific force": "|f| − g", "angular rate": "|ω| − rate", "magnetic field": "|h| − field"}
_BAND = Legend("band", "before", "±2σ predicted")
_POINTS = {
    "specific force": ("gravity", "a pose with this direction up would help most"),
    "angular rate": ("the axis of rotation", "mounting the sensor with this direction upwards would help most"),
    "magnetic field": ("the magnetic field", "turning the sensor until the field points there would help most"),
}
_RPM = 60 / (2 * pi)


def directions_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return where the vector pointed in the body frame, a figure for each triad; None without any direction."""
    figures: list[Figure] = []
    counted, plural = COUNTED[diagnostics.kind], COUNTED_PLURAL[diagnostics.kind]
    for name, record in diagnostics.triads.items():
        used = np.asarray(record.poses.used, dtype=bool)
        there = record.poses.direction[used]
        there = there[np.isfinite(there).all(axis=1)]
        if not len(there):
            continue
        pointed, advice = _POINTS[record.quantity]
        gap, towards = largest_gap(there)
        legend = [Legend("dot", "after", "used")]
        if not used.all():
            legend.append(Legend("ring", "accent", "left out"))
        alt = f"Directions of {pointed} in the body frame in {len(there)} {plural} that were used."
        figures.append(
            Figure(
                f"Directions of {pointed} in the body frame",
                magnitude_figures.directions(f"directions-{name}", record.poses.direction, used, alt),
                legend,
                "Both halves of the sphere in equal-area projection, seen from outside; circles every 30°. The "
                f"emptiest spot is ({towards}), {fixed(gap, 0)}° from the nearest {counted}: {advice}.",
            )
        )
    if not figures:
        return None
    return Section(
        "directions",
        "Directions",
        "Scales, misalignments and biases come apart only if the known vector was measured from many sides. The "
        "more evenly the points are spread, the better.",
        figures,
    )


def triad_section(diagnostics: TriadDiagnostics, name: str, found: int) -> Section | None:
    """Return the errors of one triad's magnitude; None if nothing was used.

    Parameters
    ----------
    found : how many poses there were, of which the table may hold only some
    """
    record = diagnostics.triads[name]
    counted, plural = COUNTED[diagnostics.kind], COUNTED_PLURAL[diagnostics.kind]
    used = np.asarray(record.poses.used, dtype=bool)
    if not used.any():
        return None
    symbol = _SYMBOLS[record.quantity]
    figure = Figure(
        f"Error of the magnitude of {record.quantity}",
        magnitude_figures.magnitude_errors(
            f"errors-{name}",
            record.poses,
            record.si_unit,
            counted,
            f"Error of the magnitude of {record.quantity} in {int(used.sum())} {plural} before and after the fit.",
        ),
        (*SERIES, _BAND),
        f"{symbol} in each {counted}. Before: one nominal scale and no bias, as an uncalibrated sensor reads. "
        f"Held out: the calibration was made without the {counted} that it is tested on."
        + (f" Of {found} {plural} {len(used)} at equal distances are shown here." if len(used) < found else ""),
    )
    rows = tuple(
        (kind, *(shown(value, record.si_unit) for value in values)) for kind, values in in_numbers(record.poses)
    )
    blocks = (figure, Table("In numbers", (symbol, "rms", "mean size", "worst"), rows))
    return Section(
        name, name.capitalize(), _noise_text(record, counted), (*blocks, *_pose_tables(record, counted, plural))
    )


def _noise_text(record: TriadRecord, counted: str) -> str:
    noise = f"By noise alone one {counted} would be known to {shown(record.noise_sigma, record.si_unit)}."
    if record.extra_sigma > 0:
        return (
            f"{noise} What is left after the fit shows {shown(record.extra_sigma, record.si_unit)} more; every sigma "
            "of this report includes it."
        )
    return f"{noise} What is left after the fit shows no more than that."


def _pose_tables(record: TriadRecord, counted: str, plural: str) -> tuple[Table, ...]:
    """Return every pose where they are few, and why some were left out."""
    poses, count = record.poses, len(record.poses.used)
    if count > MOST_ROWS:
        return _reasons(poses, plural)
    used = np.asarray(poses.used, dtype=bool)
    label, factor = scaled(largest(np.concatenate([poses.error_after, poses.error_holdout])), record.si_unit)
    unit = label.removesuffix(" of the field")
    timed = bool(np.isfinite(poses.start_s).any())
    head = [counted, *(["time [s]"] if timed else []), *(f"{axis} [{readable_unit(record.unit)}]" for axis in "xyz")]
    head += [f"after [{unit}]", f"held out [{unit}]", f"σ [{unit}]"]
    decimals = max(0, 5 - floor(log10(positive(largest(poses.measured)))))
    rows: list[tuple[str, ...]] = []
    for i in range(count):
        start, stop = float(poses.start_s[i]), float(poses.stop_s[i])
        row = [poses.name[i] or str(i + 1)]
        row += [_span(start, stop)] if timed else []
        row += [fixed(float(value), decimals) for value in poses.measured[i]]
        errors = (poses.error_after[i], poses.error_holdout[i], poses.sigma[i])
        rows.append((*row, *(number(factor * float(value), 3, trim=False) for value in errors)))
    table = Table(
        f"Every {counted}",
        tuple(head),
        rows,
        faint=frozenset(np.flatnonzero(~used).tolist()),
        caption="" if used.all() else "Those that were left out are set faint.",
        dense=True,
    )
    return (table, *_reasons(poses, plural))


def _span(start_s: float, stop_s: float) -> str:
    """Return when a pose was, or at which instant."""
    if not isfinite(start_s):
        return MISSING
    return f"{number(start_s, 5)} to {number(stop_s, 5)}" if stop_s > start_s else number(start_s, 5)


def _reasons(poses: PoseTable, plural: str) -> tuple[Table, ...]:
    reasons = [reason for reason, used in zip(poses.reason, poses.used, strict=True) if not used]
    if not reasons:
        return ()
    names = {
        reason: [poses.name[i] or str(i + 1) for i, found in enumerate(poses.reason) if found == reason]
        for reason in dict.fromkeys(reasons)
    }
    rows = tuple(
        (reason or MISSING, str(len(which)), ", ".join(which[:5]) + (" …" if len(which) > 5 else ""))
        for reason, which in names.items()
    )
    return (Table("Why they were left out", ("reason", plural, "which"), rows, prose=True),)


def rates_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the speeds of a turntable, and what videos showed; None without any."""
    if not diagnostics.rates:
        return None
    table = Table(
        "Speeds",
        ("speed", "steady parts", "beforehand [rad/s]", "after the fit [rad/s]", "change", "after the fit [rpm]"),
        tuple(_rate_row(rate) for rate in diagnostics.rates),
        "The change is counted in standard deviations of what was known beforehand.",
    )
    figures: list[Figure] = []
    for i, curve in enumerate(diagnostics.videos):
        rate = next((rate for rate in diagnostics.rates if rate.name == curve.name), None)
        period = 2 * pi / abs(rate.stated) if rate is not None and rate.stated else float("nan")
        turns = f" over {number(rate.turns, 4)} turns" if rate is not None and isfinite(rate.turns) else ""
        legend = [Legend("line", "after", "likeness")]
        legend += [Legend("dash", "accent", f"one turn, {number(period, 6)} s")] * isfinite(period)
        figures.append(
            Figure(
                f"Video {curve.name}",
                triad_figures.video(curve, f"video-{i}", period),
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
        (table, *figures),
    )


def _rate_row(rate: TurntableRate) -> tuple[str, ...]:
    if rate.stated == 0 and rate.stated_sigma == 0:
        return rate.name, str(rate.parts), "0", "0", MISSING, "0"
    stated, estimated = with_sigma(rate.stated, rate.stated_sigma), with_sigma(rate.estimated, rate.estimated_sigma)
    change = (rate.estimated - rate.stated) / rate.stated_sigma if rate.stated_sigma > 0 else float("nan")
    rpm = with_sigma(rate.estimated * _RPM, rate.estimated_sigma * _RPM)
    return (
        rate.name,
        str(rate.parts),
        _plus_minus(*stated) + ("" if rate.stated_sigma > 0 else " (exact)"),
        _plus_minus(*estimated),
        f"{fixed(change, 1, sign=True)} σ" if isfinite(change) else MISSING,
        _plus_minus(*rpm),
    )


def _plus_minus(value: str, sigma: str) -> str:
    return f"{value} ± {sigma}" if sigma else value


def at_rest_section(rest: GyroscopeAtRest | None) -> Section | None:
    """Return the gyroscope at rest in several attitudes; None where g-sensitivity did not come from it."""
    if rest is None or not len(rest.t_s):
        return None
    unit = readable_unit(rest.unit)
    legend = (*(Legend("dot", axis, f"{axis} measured, ±2σ") for axis in "xyz"), Legend("ring", "ink", "predicted"))
    figure = Figure(
        "Mean rate at rest in each attitude",
        triad_figures.at_rest(rest),
        legend,
        "Each axis less its mean over all attitudes, so that what depends on the attitude shows. Predicted are "
        "constant bias, drift, g-sensitivity and, where the latitude was stated, the earth's rate. Below, the drift "
        "that was estimated along with them.",
    )
    left, centred = rest.measured - rest.predicted, rest.measured - triad_figures.mean_rate(rest)
    rows = tuple(
        (
            axis,
            *(
                f"{number(value, 3, trim=False)}\u00a0{unit}"
                for value in (rms(centred[:, i]), rms(left[:, i]), largest(left[:, i]), rms(rest.sigma[:, i]))
            ),
        )
        for i, axis in enumerate("xyz")
    )
    head = ("axis", "constant bias, rms", "with g-sensitivity, rms", "worst", "expected (σ)")
    return Section(
        "at-rest",
        "Gyroscope at rest",
        "At rest a gyroscope reads its bias, which depends on the specific force: the static experiment of "
        "document B. Six attitudes or more give the whole g-sensitivity.",
        (figure, Table("Measured against predicted", head, rows)),
    )


def dip_section(dip: DipTable | None) -> Section | None:
    """Return the dip of the field in each attitude; None where the magnetometer was not aligned by it."""
    if dip is None or not len(dip.dip_rad):
        return None
    left = dip.dip_rad - dip.estimated_rad
    value, sigma = with_sigma(float(np.degrees(dip.estimated_rad)), float(np.degrees(dip.sigma_rad)))
    figure = Figure(
        "Dip in each attitude",
        triad_figures.dip(dip),
        (Legend("dot", "before", "measured"), Legend("line", "after", "estimated"), Legend("band", "after", "±2σ")),
        f"Estimated {_plus_minus(value, sigma)}°; attitudes differ from it by "
        f"{number(float(np.degrees(rms(left))), 3)}° rms, {number(float(np.degrees(largest(left))), 3)}° at worst.",
    )
    return Section(
        "dip",
        "Alignment to the accelerometer",
        "Magnitudes cannot tell how the magnetometer lies to the accelerometer. The angle between field and "
        "gravity can: it is the same in every attitude when the two are aligned.",
        (figure,),
    )


_NOISE = {
    "accelerometer.density": ("accelerometer, noise density", "m/s²/√Hz"),
    "accelerometer.mean": ("accelerometer, noise of a mean", "m/s²"),
    "accelerometer.extra": ("accelerometer, scatter of means beyond their noise", "m/s²"),
    "accelerometer.residual": ("accelerometer, residual of |f| − g", "m/s²"),
    "gyroscope.density": ("gyroscope, noise density", "rad/s/√Hz"),
    "gyroscope.mean": ("gyroscope, noise of a mean", "rad/s"),
    "gyroscope.extra": ("gyroscope, scatter of means beyond their noise", "rad/s"),
    "platter.tilt": ("tilt of the platter's axis against the vertical", "rad"),
    "magnetometer.sample_sigma": ("magnetometer, noise of a sample", ""),
    "magnetometer.error_std": ("magnetometer, error of the strength of the field over all samples", "%"),
    "magnetometer.error_spread": ("the same, robustly", "%"),
    "magnetometer.block_s": ("length of what was held out together", "s"),
    "magnetometer.sigma_factor": ("sigmas are larger by, since errors close together are alike", "×"),
}
"""Name of a noise -> what it is, and its unit."""


def noise_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the noise that was found; None if none was."""
    if not diagnostics.noise:
        return None
    rows: list[tuple[str, str]] = []
    for name, value in diagnostics.noise.items():
        words, unit = _NOISE.get(name, (name.replace(".", ", ").replace("_", " "), ""))
        if name == "magnetometer.sample_sigma":
            unit = readable_unit(diagnostics.triads["magnetometer"].unit)
            rows.append((words, f"{number(value, 3)} {unit}"))
        elif unit == "%":
            rows.append((words, f"{number(100 * value, 3)} % of the field"))
        elif unit == "×":
            rows.append((words, f"× {number(value, 3)}"))
        else:
            rows.append((words, quantity(value, unit) if unit else number(value, 3)))
    return Section("noise", "Noise", blocks=(Table("What was found", ("", ""), rows),))


def trials_section(diagnostics: TriadDiagnostics) -> Section | None:
    """Return the models that were compared, and the paper's iteration; None without either."""
    blocks: list[Table | Figure] = []
    record = next(iter(diagnostics.triads.values()))
    if diagnostics.trials:
        rows = [(t.model, str(t.parameters), shown(t.holdout_rms, record.si_unit)) for t in diagnostics.trials]
        blocks.append(
            Table(
                "Models",
                ("model", "parameters", f"{_SYMBOLS[record.quantity]}, held out"),
                rows,
                marked=next((i for i, trial in enumerate(diagnostics.trials) if trial.chosen), None),
                caption="Each model was fitted and tested on data left out of its fit. The model in use is marked.",
            )
        )
    for name, found in diagnostics.triads.items():
        if found.history is not None and finite(found.history.q).size:
            blocks += _history(name, found)
    return Section("choices", "What was tried", blocks=blocks) if blocks else None


def _history(name: str, record: TriadRecord) -> tuple[Figure, Table]:
    """Return the paper's iteration: q over the steps, and X after each of them."""
    assert record.history is not None
    q, X = record.history.q, record.history.parameters
    figure = Figure(
        f"Document C's iteration, {name}",
        triad_figures.history(record.history, f"history-{name}"),
        caption="The quadratic form of the residuals after each step of Eqs. (9) to (11). The iteration stops where a "
        "step changes it no more.",
    )
    unit, si = readable_unit(record.unit), readable_unit(record.si_unit)
    scale = f"{si}/{unit}" if si != unit else "1"
    head = ("step", "q", *(f"{letter} {axis}" for letter in "abk" for axis in "xyz"))
    factors = np.array([1e3] * 3 + [1.0] * 6)
    rows = tuple(
        (str(i), number(float(q[i]), 4), *(number(value, 5) for value in (factors * X[i]).tolist()))
        for i in range(len(q))
    )
    caption = f"Angles a in mrad, biases b in {unit}, scale factors k in {scale}."
    title = "The nine parameters, step by step"
    table = Table(title, head, rows[:MOST_ROWS], caption, dense=True)
    return figure, table
