"""Sections on what was tried before the result, and on the noise that was found."""

import numpy as np

from ...results.sensor_diagnostics import ImuDiagnostics, TriadDiagnostics, TriadRecord
from ..numbers import (
    finite_values,
    magnitude_text,
    number_text,
    quantity_text,
    readable_unit,
)
from ..page import Figure, ReportTable, Section
from . import figures
from .vectors import MOST_ROWS, VECTOR_QUANTITIES, vectors_of


def choices_section(diagnostics: ImuDiagnostics | TriadDiagnostics) -> Section | None:
    """Return the thresholds and models that were tried, and Angrisano's iteration; None without any."""
    blocks: list[ReportTable | Figure] = []
    if isinstance(diagnostics, ImuDiagnostics):
        detector = diagnostics.detector
        if detector.candidates.size:
            candidates = np.atleast_2d(detector.candidates)[:MOST_ROWS]
            chosen = np.flatnonzero(np.isclose(candidates[:, 0], detector.multiplier))
            blocks.append(
                ReportTable(
                    "Threshold of the static detector",
                    ("multiplier", "static intervals", "held-out rms", "criterion"),
                    [
                        (number_text(a), number_text(b, 6), quantity_text(c, "m/s²"), number_text(d, 5))
                        for a, b, c, d in candidates.tolist()
                    ],
                    "The threshold is a multiple of the resting variance. The chosen one is marked; a smaller "
                    "criterion is better, and it does not favour a threshold that keeps less data.",
                    marked=int(chosen[0]) if len(chosen) else None,
                )
            )
        errors = ("accelerometer, held out", "rotations, held out")
        rows = [
            (
                t.model,
                str(t.parameters),
                quantity_text(t.accelerometer_rms, "m/s²"),
                quantity_text(t.rotation_rms, "rad"),
            )
            for t in diagnostics.trials
        ]
    else:
        first = vectors_of(diagnostics)[0]
        errors = (f"{VECTOR_QUANTITIES[first.quantity][0]}, held out",)
        rows = [(t.model, str(t.parameters), magnitude_text(t.holdout_rms, first.si_unit)) for t in diagnostics.trials]
    if rows:
        caption = "Each model was fitted and tested on data left out of its fit. The model in use is marked."
        marked = next((i for i, trial in enumerate(diagnostics.trials) if trial.chosen), None)
        blocks.append(ReportTable("Models", ("model", "parameters", *errors), rows, caption, marked=marked))
    if isinstance(diagnostics, TriadDiagnostics):
        for name, found in diagnostics.triads.items():
            if found.history is not None and finite_values(found.history.q).size:
                blocks += _history(name, found)
    return Section("choices", "What was tried", blocks=blocks) if blocks else None


def _history(name: str, record: TriadRecord) -> tuple[Figure, ReportTable]:
    """Return the iteration of Angrisano's paper: q over the steps, and X after each of them."""
    assert record.history is not None
    q, X = record.history.q, record.history.parameters
    figure = Figure(
        f"Angrisano's iteration, {name}",
        figures.draw_fit_history(record.history, f"history-{name}"),
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


_NOISE = {
    "density": ("{}, noise density", "{}/√Hz"),
    "between_intervals": ("{}, scatter between static intervals", "{}"),
    "mean": ("{}, noise of a mean", "{}"),
    "extra": ("{}, scatter of means beyond their noise", "{}"),
    "accelerometer.residual": ("accelerometer, residual of |f| − g", "m/s²"),
    "rotation.beyond_noise": ("rotations, error beyond the noise", "rad"),
    "platter.tilt": ("tilt of the platter's axis against the vertical", "rad"),
    "magnetometer.sample_sigma": ("magnetometer, noise of a sample", "recorded"),
    "magnetometer.error_std": ("magnetometer, error of the strength of the field over all samples", "%"),
    "magnetometer.error_spread": ("the same, robustly", "%"),
    "magnetometer.block_s": ("length of what was held out together", "s"),
    "magnetometer.sigma_factor": ("sigmas are larger by, since errors close together are alike", "×"),
}
"""Name of a noise, or its last part -> what it is, and its unit, of the triad that its first part names."""


def noise_section(diagnostics: ImuDiagnostics | TriadDiagnostics) -> Section | None:
    """Return the noise that was found; None if none was."""
    rows: list[tuple[str, str]] = []
    for name, value in diagnostics.noise.items():
        triad, _, kind = name.partition(".")
        words, unit = _NOISE.get(name) or _NOISE.get(kind) or (name.replace(".", ", ").replace("_", " "), "")
        unit = unit.format({"accelerometer": "m/s²", "gyroscope": "rad/s"}.get(triad, ""))
        if unit == "recorded" and isinstance(diagnostics, TriadDiagnostics):
            text = f"{number_text(value, 3)} {readable_unit(diagnostics.triads['magnetometer'].unit)}"
        elif unit == "%":
            text = f"{number_text(100 * value, 3)} % of the field"
        elif unit == "×":
            text = f"× {number_text(value, 3)}"
        else:
            text = quantity_text(value, unit) if unit else number_text(value, 3)
        rows.append((words.format(triad), text))
    return Section("noise", "Noise", blocks=(ReportTable("What was found", ("", ""), rows),)) if rows else None
