"""What the report of an identification of noise says: the page of page.py, filled from a NoiseResult."""

from math import isfinite, sqrt
from pathlib import Path

import numpy as np

from ..output import write_whole
from ..recording import Floats
from ..results.datasheet import DatasheetComparison, StatedNoise
from ..results.sensor_diagnostics import SignalEnvelope
from ..results.sensor_noise import (
    COEFFICIENTS,
    DATASHEET_UNITS,
    FLOOR,
    SENSOR_UNITS,
    SYMBOLS,
    UNITS,
    AllanTable,
    AxisNoise,
    Coefficient,
    NoiseResult,
    SensorNoise,
    TriadNoise,
)
from .certificate import EXPANDED, NUMBER_HEAD, front_tables
from .drawing.figures import AXES, Plot, Sheet, draw_envelope, log_limits, set_y_limits
from .drawing.panel import DASHED, Panel
from .numbers import (
    MISSING,
    finite_values,
    highest_finite,
    number_text,
    quantity_text,
    readable_unit,
    si_prefix,
    with_sigma,
)
from .page import (
    NOISE_HEADLINES,
    Code,
    Figure,
    KeyNumber,
    Legend,
    Prose,
    ReportPage,
    ReportTable,
    Section,
    lift_figures,
    provenance_section,
    render_page,
    typeset_finding,
)

COLORS = {"quantisation": "t1", "white_noise": "t2", "bias_instability": "t3", "random_walk": "t4", "rate_ramp": "t5"}
"""Kind of noise -> colour."""
_MEANING = {
    "white_noise": "scatter of the samples; falls as they are averaged for longer",
    "bias_instability": "1/f noise: what no averaging takes away; the floor of the curve is 0.664 B",
    "random_walk": "how the bias wanders off",
    "quantisation": "rounding of integrated angles or velocities; falls fastest",
    "rate_ramp": "an even drift, mostly of the temperature",
}


def write_noise_report(result: NoiseResult, path: str | Path, compared: DatasheetComparison | None = None) -> None:
    """Write the report of an identification of noise as one HTML file that needs neither network nor other files.

    Parameters
    ----------
    compared : with a data sheet

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(noise_page(result, compared)))


def noise_page(result: NoiseResult, compared: DatasheetComparison | None = None) -> ReportPage:
    """Return the page of an identification of noise."""
    noise = result.noise
    names = ", ".join(source.name for source in noise.provenance.inputs) or "recording from memory"
    sections = [_coefficients(result), *(_curves(result, sensor, compared) for sensor in noise.triads)]
    if compared is not None:
        sections.append(_datasheet(compared))
    figures, folded = lift_figures(sections, tuple(noise.triads))
    return ReportPage(
        title="Noise of an IMU",
        subject=names,
        verdict=noise.verdict,
        headline=NOISE_HEADLINES[noise.verdict],
        key_numbers=_key_numbers(result),
        findings=tuple(typeset_finding(finding) for finding in noise.findings if finding.code != "assumed"),
        sections=(*folded, _conventions(), _use(), provenance_section(noise.provenance)),
        footer=f"Made by gnomon {noise.provenance.gnomon_version}. This file needs no network and no other file.",
        front=(*front_tables(noise, (noise_numbers(noise),)), *figures),
    )


def noise_numbers(noise: SensorNoise) -> ReportTable:
    """Return white noise and random walk of each axis for page one."""
    rows: list[tuple[str, ...]] = []
    for sensor, triad in noise.triads.items():
        for kind in ("white_noise", "random_walk"):
            for axis, own in zip("xyz", triad.axes, strict=True):
                found = own.coefficients()[kind]
                value, expanded = f"< {number_text(found.bound, 2)}", MISSING
                if found.found:
                    value, expanded = with_sigma(found.value, 2 * found.sigma)
                name = f"{sensor.capitalize()} {kind.replace('_', ' ')} {axis}"
                rows.append((name, value, expanded, readable_unit(UNITS[sensor][kind])))
    note = f"{EXPANDED} Without U: not seen, an upper bound (about 97 %)."
    return ReportTable("The numbers that matter", NUMBER_HEAD, rows, note, dense=True)


def _key_numbers(result: NoiseResult) -> tuple[KeyNumber, ...]:
    numbers: list[KeyNumber] = []
    for sensor, triad in result.noise.triads.items():
        density = readable_unit(UNITS[sensor]["white_noise"])
        walk = readable_unit(UNITS[sensor]["random_walk"])
        scatter = quantity_text(triad.noise_density * sqrt(triad.rate_hz), readable_unit(SENSOR_UNITS[sensor]))
        datasheet = ", ".join(
            f"{number_text(factor * triad.noise_density, 3)}\u00a0{readable_unit(unit)}"
            for unit, factor in DATASHEET_UNITS[sensor]["white_noise"]
        )
        bound = "" if triad.random_walk_found else "at most "
        numbers += [
            KeyNumber(
                f"{sensor.capitalize()} white noise",
                quantity_text(triad.noise_density, density),
                f"root mean square of the axes; {datasheet}; {scatter} a sample",
            ),
            KeyNumber(
                f"{sensor.capitalize()} random walk",
                f"{bound}{quantity_text(triad.random_walk, walk)}",
                "of the axes that show one" if triad.random_walk_found else "none was seen",
            ),
        ]
    triad = next(iter(result.noise.triads.values()))
    numbers.append(
        KeyNumber(
            "Recording",
            f"{number_text(triad.duration_s / 3600, 3)} h",
            f"at {number_text(triad.rate_hz, 5)} Hz; averaging times up to {number_text(triad.tau_s[1], 3)} s",
        )
    )
    if isfinite(result.noise.t_init_s):
        numbers.append(
            KeyNumber(
                "Initial rest", f"{number_text(result.noise.t_init_s, 3)} s", "advised T_init of a calibration by hand"
            )
        )
    return tuple(numbers)


def _coefficients(result: NoiseResult) -> Section:
    tables = tuple(_table(sensor, triad) for sensor, triad in result.noise.triads.items())
    return Section(
        "coefficients",
        "Coefficients",
        "Each with its standard deviation. Where the recording does not show a kind of noise, an upper bound is "
        "given instead (about 97 %). Below the SI units stand those of data sheets; their bias instability is the "
        "floor of the Allan deviation, 0.664 B, or B, and few say which.",
        tables,
    )


def _table(sensor: str, triad: TriadNoise) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for name in COEFFICIENTS:
        axes = [axis.coefficients()[name] for axis in triad.axes]
        rows.append(
            (f"{name.replace('_', ' ')} {SYMBOLS[name]}", *map(_text, axes), readable_unit(UNITS[sensor][name]))
        )
        for unit, factor in DATASHEET_UNITS[sensor].get(name, ()):
            rows.append(("", *(_text(one.scaled(factor)) for one in axes), readable_unit(unit)))
    misfit = ("misfit of the curve", *(f"{number_text(100 * axis.misfit, 2)} %" for axis in triad.axes), "")
    return ReportTable(sensor.capitalize(), ("", *AXES, "unit"), (*rows, misfit), dense=True)


def _text(found: Coefficient) -> str:
    if not found.found:
        return f"< {number_text(found.bound, 2)}"
    value, sigma = with_sigma(found.value, found.sigma)
    return f"{value} ± {sigma}"


def _datasheet(compared: DatasheetComparison) -> Section:
    rows = [
        (
            f"{one.sensor} {one.label.replace('sqrt(2)', '√2')}",
            f"{'< ' if one.bound else ''}{number_text(one.found, 3)}",
            number_text(one.stated, 3),
            number_text(one.expected, 3),
            f"{'< ' if one.bound else ''}{number_text(one.ratio, 2)}",
            readable_unit(one.unit),
        )
        for one in compared.quantities
    ]
    lead = (
        f"{compared.sheet.source}. Root mean square of the axes. Data sheets state densities of a one-sided spectrum, "
        "√2 N; the bias stability is the floor of the Allan deviation. A ratio well above one tells of vibration, "
        "aliasing, the supply, a wide measuring range, or of another unit; one well below, of a filter."
    )
    table = ReportTable(compared.sheet.name, ("", "found", "stated", "expected", "ratio", "unit"), rows)
    prose = (Prose(compared.words(), points=True),) if compared.words() else ()
    return Section("datasheet", "Against the data sheet", lead, (table, *prose))


def _curves(result: NoiseResult, sensor: str, compared: DatasheetComparison | None) -> Section:
    noise, curve, unit = result.noise.triads[sensor], result.curves[sensor], readable_unit(SENSOR_UNITS[sensor])
    t_init_s = result.noise.t_init_s if sensor == "gyroscope" else float("nan")
    legend = [Legend("line", axis, axis) for axis in AXES]
    legend += [Legend("band", "before", "95 % interval"), Legend("dash", "ink", "noise that was found")]
    if isfinite(t_init_s):
        legend.append(Legend("dash", "accent", f"advised T_init {number_text(t_init_s, 3)} s"))
    legend.append(Legend("dash", "muted", "slopes −½ (N at 1 s), 0 (0.664 B), +½ (K at 3 s)"))
    stated = None if compared is None else compared.sheet.sensors.get(sensor)
    if compared is not None and stated is not None:
        legend.append(Legend("line", "t5", f"data sheet {compared.sheet.name}"))
    kinds = [kind for kind in COEFFICIENTS if any(axis.coefficients()[kind].found for axis in noise.axes)]
    blocks = [
        Figure(
            f"Allan deviation of the {sensor}",
            draw_sensor_allan(sensor, unit, curve, noise, t_init_s=t_init_s, stated=stated),
            legend,
            "How far means over neighbouring stretches differ, by the length of the stretch (overlapping "
            "estimate). Long averaging times rest on few independent stretches, hence the wide interval. "
            f"{_lowest(curve, unit)}",
        ),
        Figure(
            "What it is made of",
            draw_noise_parts(sensor, unit, curve, noise.axes),
            (
                *(Legend("line", COLORS[kind], kind.replace("_", " ")) for kind in kinds),
                Legend("dot", "ink", "observed"),
                Legend("dash", "ink", "all together"),
            ),
        ),
    ]
    if sensor in result.signals:
        blocks.append(
            Figure(
                "Over time",
                draw_means(sensor, unit, result.signals[sensor]),
                tuple(legend[:3]),
                "Means of about a second, about their median: what moved or warmed the sensor shows here.",
            )
        )
    return Section(sensor, sensor.capitalize(), blocks=blocks)


def _conventions() -> Section:
    points = [f"{name.replace('_', ' ')} {SYMBOLS[name]}: {_MEANING[name]}." for name in COEFFICIENTS]
    points += [
        "The Allan variance is 3 Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3 + R² τ²/2 (IEEE 952).",
        "Densities are of continuous time and do not depend on the sample rate. One sample scatters by N √rate, and "
        "from one sample to the next the bias walks by K/√rate.",
        "The fit knows how estimates at different averaging times scatter together. An even drift is taken out first.",
        "imu.yaml has one number for three axes: the root of their mean square; of the random walk that of the axes "
        "that show one, or of the upper bounds where none does.",
    ]
    prose = Prose(points, points=True)
    return Section("conventions", "What the numbers mean", blocks=(prose,))


def _use() -> Section:
    return Section(
        "use",
        "How to use it",
        blocks=(
            Code("On the command line", "gnomon camera-imu RECORDING --imu imu.yaml"),
            Code(
                "In Python",
                'import gnomon\n\nnoise = gnomon.load_noise("noise.yaml")\n'
                "noise.gyroscope.axes[0].white_noise.value  # rad/s/√Hz\n"
                "noise.imu_noise()  # one number for three axes, as in imu.yaml",
            ),
        ),
    )


_DENSE = 160


def _lowest(curve: AllanTable, unit: str) -> str:
    tau, deviation = lowest_deviation(curve)
    return f"It is lowest at {number_text(tau, 3)} s: {quantity_text(deviation, unit)}."


def lowest_deviation(curve: AllanTable) -> tuple[float, float]:
    """Return at which averaging time the root mean square of the axes is lowest, and how low."""
    together = np.sqrt(np.mean(curve.deviation**2, axis=1))
    k = int(np.argmin(together))
    return float(curve.tau_s[k]), float(together[k])


def draw_sensor_allan(
    sensor: str,
    unit: str,
    curve: AllanTable,
    noise: TriadNoise,
    *,
    t_init_s: float = float("nan"),
    stated: StatedNoise | None = None,
) -> Plot:
    """Allan deviation of three axes with its interval, and the noise that was found (Tedaldi 2014, Fig. 3.2).

    Uprights stand where N and K are read, at 1 s and 3 s, thin lines have the slopes of N, B and K, a ring marks the
    minimum, and what a data sheet states is drawn beside them.
    """
    prefix, factor = si_prefix(float(np.median(curve.deviation[curve.deviation > 0])))

    sheet = Sheet()
    panel = sheet.panel(f"Allan deviation [{prefix}{unit}]", top=36, height=330, x_label="averaging time [s]")
    for i, name in enumerate(AXES):
        panel.band(curve.tau_s, curve.lower[:, i] * factor, curve.upper[:, i] * factor, name, alpha=0.16)
    tau = _dense(curve.tau_s)
    for axis, name in zip(noise.axes, AXES, strict=True):
        used = tau[tau >= axis.fitted_from_s]
        panel.line(used, axis.deviation(used) * factor, name, width=1.2, dash=DASHED)
    for i, name in enumerate(AXES):
        panel.line(curve.tau_s, curve.deviation[:, i] * factor, name, width=1.8)
        panel.dots(curve.tau_s, curve.deviation[:, i] * factor, name, 5)
    _scales(panel, curve, curve.deviation * factor)
    _draw_slopes(panel, tau, noise, factor)
    if stated is not None:
        panel.line(tau, stated.white_noise / np.sqrt(tau) * factor, "t5", width=1.6)
        panel.line(tau, np.full(len(tau), stated.bias_stability * factor), "t5", width=1.6)
    low_s, low = lowest_deviation(curve)
    panel.dots(np.array([low_s]), np.array([low * factor]), "ink", 8)
    if np.isfinite(t_init_s):
        panel.upright(t_init_s, "accent", width=1.6, dash=(5.0, 3.0))
    alt = f"Allan deviation of the {sensor}'s axes x, y, z over averaging time, with the noise that was fitted."
    return sheet.draw(f"allan-{sensor}", 426, alt)


def _draw_slopes(panel: Panel, tau: Floats, noise: TriadNoise, factor: float) -> None:
    """Draw the slopes of white noise, bias instability and random walk, and where the first and the last are read."""
    floors = [axis.bias_instability.value for axis in noise.axes if axis.bias_instability.found]
    panel.line(tau, noise.noise_density / np.sqrt(tau) * factor, "muted", width=0.8, dash=DASHED)
    if floors:
        floor = FLOOR * float(np.sqrt(np.mean(np.square(floors))))
        panel.line(tau, np.full(len(tau), floor * factor), "muted", width=0.8, dash=DASHED)
    if noise.random_walk_found:
        panel.line(tau, noise.random_walk * np.sqrt(tau / 3) * factor, "muted", width=0.8, dash=DASHED)
    for place in (1.0, 3.0):
        if tau[0] < place < tau[-1]:
            panel.upright(place, "muted", width=0.8, dash=(1.0, 3.0))


def draw_noise_parts(sensor: str, unit: str, curve: AllanTable, axes: tuple[AxisNoise, ...]) -> Plot:
    """Allan deviation of each axis, taken apart into the kinds of noise."""
    prefix, factor = si_prefix(float(np.median(curve.deviation[curve.deviation > 0])))

    sheet = Sheet()
    for i, (axis, name) in enumerate(zip(axes, AXES, strict=True)):
        label = "averaging time [s]" if i == 2 else ""
        panel = sheet.panel(f"{name} [{prefix}{unit}]", top=36 + 232 * i, height=180, x_label=label)
        panel.band(curve.tau_s, curve.lower[:, i] * factor, curve.upper[:, i] * factor, "before", alpha=0.22)
        tau = _dense(curve.tau_s)
        for kind, deviation in axis.parts(tau).items():
            panel.line(tau, deviation * factor, COLORS[kind], width=1.3)
        used = tau[tau >= axis.fitted_from_s]
        panel.line(used, axis.deviation(used) * factor, "ink", width=1.2, dash=DASHED)
        panel.dots(curve.tau_s, curve.deviation[:, i] * factor, "ink", 5)
        _scales(panel, curve, curve.deviation[:, i] * factor)
        panel.x.labelled = i == 2
    alt = f"Allan deviation of each axis of the {sensor} with the curves of the kinds of noise it is made of."
    return sheet.draw(f"parts-{sensor}", 750, alt)


def draw_means(sensor: str, unit: str, signal: SignalEnvelope) -> Plot:
    """Means of about a second over the recording, about their median."""
    middle = np.median(signal.low, axis=0)
    low, high = signal.low - middle, signal.high - middle
    prefix, factor = si_prefix(highest_finite(np.abs(np.concatenate([low, high])), 1.0))

    sheet = Sheet()
    panel = sheet.panel(f"{sensor}, about its mean [{prefix}{unit}]", top=36, height=200, x_label="time [s]")
    for i, name in enumerate(AXES):
        draw_envelope(panel, signal.t_s, low[:, i] * factor, high[:, i] * factor, name)
    set_y_limits(panel, low * factor, high * factor)
    panel.x.span(0, highest_finite(signal.t_s, 1.0))
    return sheet.draw(f"means-{sensor}", 296, f"Means of the {sensor}'s samples over time.")


def _dense(tau_s: Floats) -> Floats:
    return np.geomspace(tau_s[0], tau_s[-1], _DENSE)


def _scales(panel: Panel, curve: AllanTable, deviation: Floats) -> None:
    log_limits(panel, deviation)
    panel.x.logarithmic, panel.x.grid = True, True
    tau = finite_values(curve.tau_s)
    panel.x.span(float(tau.min()), float(max(tau.max(), 1.05 * tau.min())))
