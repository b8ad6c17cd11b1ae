"""Sections of a report on a turntable, a sensor at rest in several attitudes, or a magnetometer."""

from math import degrees, isfinite, pi

import numpy as np

from ...results.sensor_diagnostics import TriadDiagnostics
from ..numbers import (
    MISSING,
    estimate_text,
    finite_rms,
    fixed_text,
    largest_magnitude,
    number_text,
    readable_unit,
)
from ..page import Figure, Legend, ReportTable, Section
from . import figures


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
                figures.draw_video_repeats(curve, f"video-{i}", period),
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
        figures.at_rest(rest),
        (*(Legend("dot", axis, f"{axis} measured, ±2σ") for axis in "xyz"), Legend("ring", "ink", "predicted")),
        "Each axis less its mean over all attitudes, so that what depends on the attitude shows. Predicted are "
        "constant bias, drift, g-sensitivity and, where the latitude was stated, the earth's rate. Below, the drift "
        "that was estimated jointly with them.",
    )
    left, centred = rest.measured - rest.predicted, rest.measured - figures.mean_rate(rest)
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
        figures.draw_field_dip(dip),
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
