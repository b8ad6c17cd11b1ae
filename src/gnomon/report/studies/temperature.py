"""The page of the study of the temperature."""

import numpy as np

from ...study.temperature import METHODS, TemperatureStudy, temperature_claims
from ..drawing.figures import Sheet, log_limits
from ..numbers import number_text
from ..page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section
from . import study_page

_SETUP = (
    "Gyroscopes with polynomials of order 0 to 3, white noise of an MPU-6050 or a BMI088 by their data sheets, 1/f "
    "noise and a random walk, and a bias that differs by 0.1 or 1 mrad/s from one switching-on to the next; "
    "thermometers that follow the sensor by 0 to 60 s in steps of 0.01 to 1 K. Of five warm-ups of 15 minutes four are "
    "used, and the change over the fifth is foretold; its mean belongs to the switching-on and is left out.",
    "PX4's method, a cubic by least squares through all samples, and ArduPilot's, a cubic through means of two "
    "seconds, are as their documentation describes them, on the same data; neither knows the thermometer's lag.",
)
_COLORS = dict(zip(METHODS, ("after", "before", "heldout"), strict=True))


def temperature_study_page(study: TemperatureStudy) -> ReportPage:
    """Return the page of the study."""
    return study_page(
        "Biases over the temperature",
        f"{study.runs} simulated sensors, each with five warm-ups, seed {study.seed}",
        tuple(temperature_claims(study)),
        tuple(
            KeyNumber(f"Error by {name}", f"{number_text(1e6 * value, 2)} µrad/s", "of the warm-up left out, rms")
            for name, value in zip(METHODS, study.rms.tolist(), strict=True)
        ),
        (
            Section("errors", "Errors of the warm-up left out", blocks=(_figure(study), _table(study))),
            Section("setup", "How it was simulated", blocks=(Prose(_SETUP),)),
        ),
    )


def _figure(study: TemperatureStudy) -> Figure:
    sheet = Sheet()
    errors = 1e6 * study.errors
    panel = sheet.panel("Error [µrad/s]", top=36, height=240, x_label="sensor, by the error of PX4's method")
    panel.x.span(0.0, float(len(errors) + 1))
    log_limits(panel, *errors.T)
    order = np.argsort(errors[:, 1])
    for k, name in enumerate(METHODS):
        panel.dots(np.arange(1.0, len(errors) + 1), errors[order, k], _COLORS[name], 4)
    drawn = sheet.draw("temperature-errors", 336, "Errors of the change of the bias over a warm-up that was left out.")
    return Figure("Every sensor", drawn, [Legend("dot", _COLORS[name], name) for name in METHODS])


def _table(study: TemperatureStudy) -> ReportTable:
    lags = np.array([outcome.lag_s for outcome in study.outcomes])
    rows: list[tuple[str, ...]] = []
    for lag in np.unique(lags):
        rms = 1e6 * np.sqrt(np.mean(study.errors[lags == lag] ** 2, axis=0))
        rows.append((f"{lag:g}", str(int(np.sum(lags == lag))), *(number_text(one, 2) for one in rms.tolist())))
    return ReportTable(
        "By the lag of the thermometer",
        ("lag [s]", "sensors", *(f"{name} [µrad/s]" for name in METHODS)),
        rows,
        "Rms errors of the change of the bias.",
    )
