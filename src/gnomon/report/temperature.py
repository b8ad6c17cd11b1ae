"""What the report of a sensor over its temperature says: the page of page.py, filled from a TemperatureResult."""

from pathlib import Path

import numpy as np

from .._version import __version__
from ..output import write_whole
from ..results.result import Booleans
from ..results.temperature import AxisOverTemperature, TemperatureResult, TriadOverTemperature
from .certificate import certificate_tables
from .drawing.figures import AXES, Sheet, set_y_limits
from .numbers import number_text
from .page import (
    Figure,
    KeyNumber,
    Legend,
    Prose,
    ReportPage,
    ReportTable,
    Section,
    provenance_section,
    render_page,
    typeset_finding,
)

_HEADLINES = {
    "pass": "The temperature's effect is known.",
    "warn": "The temperature's effect is known, with the reservations below.",
    "fail": "The temperature's effect is not known.",
}
_UNITS = {"gyroscope": (1e3, "mrad/s"), "accelerometer": (1e3, "mm/s²")}
_RELATIVE = (1e2, "%")


def write_temperature_report(result: TemperatureResult, path: str | Path) -> None:
    """Write the report of a sensor over its temperature as one HTML file that needs neither network nor other files.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(temperature_page(result)))


def temperature_page(result: TemperatureResult) -> ReportPage:
    """Return the page of a sensor over its temperature."""
    calibration = result.calibration
    found = next(iter(calibration.imus.values())).temperature
    assert found is not None
    lag = f"{result.lag_s:.0f} ± {result.lag_sigma_s:.0f} s" if result.lag_s else "none found"
    figures = [
        _figure(name, kind, triad, found.reference_degc)
        for kind, triads in (("bias", result.triads), ("scale", result.sensitivities))
        for name, triad in triads.items()
    ]
    return ReportPage(
        title="An IMU over its temperature",
        subject=", ".join(result.names),
        verdict=calibration.verdict,
        headline=_HEADLINES[calibration.verdict],
        key_numbers=(
            KeyNumber(
                "Recorded",
                f"{result.low_degc:.1f} to {result.high_degc:.1f} °C".replace("-", "−"),
                f"used from {found.low_degc:.1f} to {found.high_degc:.1f} °C".replace("-", "−"),
            ),
            KeyNumber("Reference", f"{found.reference_degc:.1f} °C", "sensitivities and biases hold here"),
            KeyNumber("Lag of the thermometer", lag),
        ),
        findings=tuple(typeset_finding(finding) for finding in calibration.assessment.findings),
        front=(*certificate_tables(calibration), *figures),
        sections=(
            *_residual_sections(result),
            Section("numbers", "Numbers", blocks=[_coefficients(result), _scatter(result)]),
            Section("method", "How this was found", blocks=[_method()]),
            provenance_section(calibration.provenance),
        ),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def _figure(name: str, kind: str, triad: TriadOverTemperature, reference_degc: float) -> Figure:
    factor, unit = _UNITS[name] if kind == "bias" else _RELATIVE
    sheet = Sheet()
    panel = sheet.panel(f"Change of the {kind} [{unit}]", top=36, height=260, x_label="temperature [°C]")
    for axis, color in zip(triad.axes, AXES, strict=True):
        low, high = axis.change - 2 * axis.sigma, axis.change + 2 * axis.sigma
        panel.band(axis.at_degc, factor * low, factor * high, color, alpha=0.2)
        panel.dots(axis.degc, factor * axis.values, color, 3)
        panel.line(axis.at_degc, factor * axis.change, color, width=1.8)
    panel.upright(reference_degc, "accent", width=1.2, dash=(5.0, 3.0))
    ends = np.concatenate([axis.at_degc[[0, -1]] for axis in triad.axes])
    panel.x.span(float(ends.min()), float(ends.max()))
    set_y_limits(panel, *(factor * np.concatenate([axis.values, axis.change]) for axis in triad.axes))
    alt = f"Change of the {name}'s {kind} over the temperature: what was measured, polynomials of order {triad.order}."
    measured = (
        "means of some seconds" if len(np.unique(triad.axes[0].warm_up)) < len(triad.axes[0].degc) else "recordings"
    )
    legend = [Legend("line", axis, axis) for axis in AXES]
    legend += [Legend("dot", "ink", measured), Legend("band", "before", "±2 σ")]
    legend.append(Legend("dash", "accent", "reference"))
    drawn = sheet.draw(f"temperature-{name}-{kind}", 356, alt)
    return Figure(f"{name.capitalize()}, {kind} over the temperature", drawn, legend)


def _residual_sections(result: TemperatureResult) -> list[Section]:
    """Return the section on what the polynomials leave of warm-ups at rest; none where there are none."""
    figures = [
        _residuals(name, triad)
        for name, triad in result.triads.items()
        if len(np.unique(triad.axes[0].warm_up)) < len(triad.axes[0].degc)
    ]
    return [Section("residuals", "Before and after", blocks=figures)] if figures else []


def _residuals(name: str, triad: TriadOverTemperature) -> Figure:
    """Draw the bias over the temperature before and after, on one scale, by whether the temperature rises or falls."""
    factor, unit = _UNITS[name]
    degc = np.concatenate([axis.degc for axis in triad.axes])
    rises = np.concatenate([_rises(axis) for axis in triad.axes])
    before = np.concatenate([axis.values - axis.values.mean() for axis in triad.axes])
    after = before - np.concatenate([np.interp(axis.degc, axis.at_degc, axis.change) for axis in triad.axes])
    after = np.concatenate([part - part.mean() for part in np.split(after, 3)])
    sheet = Sheet()
    for top, title, values in ((36, "Before", before), (286, "After", after)):
        x_label = "temperature [°C]" if title == "After" else ""
        panel = sheet.panel(f"{title} [{unit}]", top=top, height=170, x_label=x_label)
        for branch, color in ((rises, "accent"), (~rises, "heldout")):
            panel.dots(degc[branch], factor * values[branch], color, 3)
        panel.x.span(float(degc.min()), float(degc.max()))
        set_y_limits(panel, factor * before, factor * after)
    rms = [float(factor * np.sqrt(np.mean(values**2))) for values in (before, after)]
    told = f"rms {number_text(rms[0], 3)} {unit} before, {number_text(rms[1], 3)} {unit} after"
    drawn = sheet.draw(f"residual-{name}", 516, f"Bias of the {name} over the temperature before and after: {told}.")
    legend = [Legend("dot", "accent", "while it rises"), Legend("dot", "heldout", "while it falls")]
    caption = f"All axes, means over bins, the mean left out: {told}."
    return Figure(f"{name.capitalize()}, what the polynomials leave", drawn, legend, caption)


def _rises(axis: AxisOverTemperature) -> Booleans:
    """Return of each bin whether the temperature rises there, (n,)."""
    parts = np.split(axis.degc, np.flatnonzero(np.diff(axis.warm_up)) + 1)
    slopes = [np.gradient(part) if len(part) > 1 else np.ones(1) for part in parts]
    return np.asarray(np.concatenate(slopes) >= 0)


def _coefficients(result: TemperatureResult) -> ReportTable:
    calibration = result.calibration
    name, sensor = next(iter(calibration.imus.items()))
    assert sensor.temperature is not None
    rows: list[tuple[str, ...]] = []
    for part, coefficients in sensor.temperature.parts():
        path = f"{name}.temperature.{part}"
        for (j, *which), row in zip(np.ndindex(coefficients.shape[:-1]), coefficients.reshape(-1, 3), strict=True):
            sigma = calibration.sigma(path)[(j, *which)]
            cells = (f"{value:.4g} ± {one:.2g}" for value, one in zip(row, sigma, strict=True))
            of = "".join(f", row {'xyz'[k]}" for k in which)
            rows.append((f"{part.replace('_', ', ')}{of}, (T - T_ref)^{j + 1}", *cells))
    return ReportTable(
        "Coefficients",
        ("", "x", "y", "z"),
        rows,
        "Biases in the unit of the recording, sensitivities relative, per K to that power; ± one standard deviation.",
    )


def _scatter(result: TemperatureResult) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    every = [(name, triad, *_UNITS[name]) for name, triad in result.triads.items()]
    every += [(f"{name}, scale", triad, *_RELATIVE) for name, triad in result.sensitivities.items()]
    for name, triad, factor, unit in every:
        for label, values in (
            ("from one switching-on to the next", triad.turn_on),
            ("rising against falling", triad.branches),
            ("recordings against the others, worst [σ]", np.max(triad.left_out_z, axis=0) / factor),
        ):
            cells = ("not told" if np.isnan(value) else f"{factor * value:.3g}" for value in values.tolist())
            rows.append((f"{name}: {label}" + ("" if "σ" in label else f" [{unit}]"), *cells))
    return ReportTable("What the temperature does not explain", ("", "x", "y", "z"), rows)


def _method() -> Prose:
    return Prose(
        (
            "Bias = its value at the reference + polynomial of T - T_ref + what this switching-on adds + a random walk "
            "+ white noise. The variances are those of largest restricted likelihood (Patterson and Thompson, 1971), "
            "and the polynomials follow by generalised least squares. The thermometer's steps are smoothed away, and "
            "its lag is found along with the biases.",
            "Of recordings in which the sensor was turned each is calibrated for itself; polynomials through their "
            "numbers follow by least squares, weighted with their covariances and with what differs from one "
            "switching-on to the next.",
            "Beyond the range nothing is known; polynomials run away there.",
        )
    )
