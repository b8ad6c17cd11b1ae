"""What the report of a calibration from known magnitudes says: accelerometer in poses, turntable, magnetometer."""

import numpy as np

from ..calibration import Calibration
from ..triad_diagnostics import TriadDiagnostics
from . import triad_sections
from .calibration_page import calibration_page
from .imu_parameters import parameter_groups
from .imu_sections import largest_gap
from .magnitude_units import shown
from .numbers import fixed, number, quantity
from .page import KeyNumber, Page, Parameters, Prose, Section
from .provenance import provenance_section
from .trust_section import trust_section
from .usage import use_section
from .wording import FRAMES, gravity_text

_MODELS = {
    "basic": "constant gyroscope bias",
    "g-sensitivity": "gyroscope bias linear in specific force",
    "hard-iron": "offset and one scale",
    "full": "offset and every entry of the sensitivity",
    "none": "",
}


def triad_page(calibration: Calibration, diagnostics: TriadDiagnostics) -> Page:
    """Return the page of a calibration from magnitudes."""
    sections = (
        _parameters(calibration),
        trust_section(calibration.assessment, diagnostics.trust),
        triad_sections.rates_section(diagnostics),
        triad_sections.directions_section(diagnostics),
        *(
            triad_sections.triad_section(diagnostics, name, calibration.assessment.intervals_found)
            for name in diagnostics.triads
        ),
        triad_sections.at_rest_section(diagnostics.at_rest),
        triad_sections.dip_section(diagnostics.dip),
        triad_sections.trials_section(diagnostics),
        triad_sections.noise_section(diagnostics),
        _assumptions(calibration, diagnostics),
        use_section(calibration),
        provenance_section(calibration.provenance),
    )
    return calibration_page(_title(diagnostics), calibration, _key_numbers(calibration, diagnostics), sections)


def _title(diagnostics: TriadDiagnostics) -> str:
    if diagnostics.kind == "poses":
        return "Accelerometer calibration" if diagnostics.at_rest is None else "Calibration at rest"
    return f"{diagnostics.kind.capitalize()} calibration"


def _key_numbers(calibration: Calibration, diagnostics: TriadDiagnostics) -> tuple[KeyNumber, ...]:
    assessment, holdout = calibration.assessment, calibration.assessment.holdout
    counted = triad_sections.COUNTED_PLURAL[diagnostics.kind]
    numbers: list[KeyNumber] = []
    for name, value, symbol in (
        ("accelerometer", holdout.accelerometer_rms, "|f| − g"),
        ("gyroscope", holdout.rate_rms, "|ω| − rate"),
        ("magnetometer", holdout.field_rms, "|h| − 1, in parts of the field,"),
    ):
        if name in diagnostics.triads:
            unit = "" if name == "magnetometer" else diagnostics.triads[name].si_unit
            note = f"rms of {symbol} in {counted} left out of the fit"
            numbers.append(KeyNumber(f"{name.capitalize()} on unseen data", shown(value, unit), note))
    numbers.append(
        KeyNumber(
            f"{counted.capitalize()} used",
            f"{assessment.intervals_used} of {assessment.intervals_found}",
            _spread(diagnostics),
        )
    )
    numbers += _reference(calibration, diagnostics)
    model = _MODELS.get(assessment.model, assessment.model)
    return (*numbers, KeyNumber("Body frame" + (" and model" if model else ""), calibration.frame, model))


def _spread(diagnostics: TriadDiagnostics) -> str:
    """Say how far the emptiest spot of the sphere is from the nearest direction of the first triad."""
    poses = next(iter(diagnostics.triads.values())).poses
    there = poses.direction[poses.used.astype(bool) & np.isfinite(poses.direction).all(axis=1)]
    return f"no direction is farther than {fixed(largest_gap(there)[0], 0)}° from one of them" if len(there) else ""


def _reference(calibration: Calibration, diagnostics: TriadDiagnostics) -> list[KeyNumber]:
    """Return the magnitudes that were known."""
    found: list[KeyNumber] = []
    if diagnostics.kind != "magnetometer" and "accelerometer" in diagnostics.triads:
        source = calibration.gravity.source
        found.append(KeyNumber("Gravity", gravity_text(calibration.gravity), source[:1].upper() + source[1:]))
    if diagnostics.rates:
        fastest = max(diagnostics.rates, key=lambda rate: abs(rate.estimated))
        known = fastest.estimated_sigma > 0 and fastest.estimated != 0
        spread = f"known to {number(100 * fastest.estimated_sigma / abs(fastest.estimated), 2)} %" if known else ""
        speeds = f"fastest of {len(diagnostics.rates)} speeds" if len(diagnostics.rates) > 1 else "the one speed"
        note = ", ".join(filter(None, (speeds, spread)))
        found.append(KeyNumber("Turntable", quantity(abs(fastest.estimated), "rad/s", 6), note))
    if diagnostics.dip is not None:
        degrees = 57.29577951308232
        value, sigma = diagnostics.dip.estimated_rad * degrees, diagnostics.dip.sigma_rad * degrees
        note = "of the field below horizontal, the same in all attitudes"
        found.append(KeyNumber("Dip", f"{number(value, 4)} ± {number(sigma, 2)}°", note))
    return found


def _parameters(calibration: Calibration) -> Section:
    return Section(
        "parameters",
        "Parameters",
        "Each estimate with its standard deviation σ. Bars show the estimate, whiskers ±2σ; the bars of one group "
        "share one scale. Parameters without σ are fixed by the definition of the body frame or by the model.",
        (Parameters(parameter_groups(calibration)),),
    )


def _assumptions(calibration: Calibration, diagnostics: TriadDiagnostics) -> Section:
    gravity, assessment, triads = calibration.gravity, calibration.assessment, diagnostics.triads
    points: list[str] = []
    if "accelerometer" in triads:
        points.append(
            f"Gravity is {gravity_text(gravity)} ({gravity.source}). A relative error of gravity is the same relative "
            "error of every accelerometer scale."
        )
    if diagnostics.kind == "turntable":
        points.append(
            "Between spin-up and stop the turntable turned at one constant rate, the same in all parts at one speed."
        )
    if diagnostics.kind == "magnetometer":
        points += _magnetic(calibration)
    points.append(f"The body frame is {calibration.frame}: {FRAMES.get(calibration.frame, calibration.frame)}.")
    if calibration.frame in ("gyro-x", "mag-x"):
        points.append(
            "Magnitudes alone are the same in every frame: they cannot tell how these axes lie to an accelerometer or "
            "to a housing (document C). Record the accelerometer too, in the same attitudes, to relate the frames."
        )
    points.append(
        "Which way an axis points, and that the axes are right-handed, comes from the order of the columns: magnitudes "
        "cannot tell."
    )
    points += [finding.message for finding in assessment.findings if finding.code == "assumed"]
    if assessment.held_by_prior:
        held = ", ".join(assessment.held_by_prior)
        points.append(f"Not determined by this recording, and held by assumption: {held}.")
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))


def _magnetic(calibration: Calibration) -> list[str]:
    sensors = [imu.magnetometer for imu in calibration.imus.values() if imu.magnetometer is not None]
    points = [
        "The magnetic field was the same, in strength and direction, wherever the sensor was held. What turned with "
        "the sensor, hard and soft iron, is part of the calibration; a field that changes from place to place is not."
    ]
    if any(sensor.field_unit != "uT" for sensor in sensors):
        points.append(
            "The strength of the field was not stated, and is the unit of the calibrated field: give it in µT "
            "(--field) to have the result in µT."
        )
    return points
