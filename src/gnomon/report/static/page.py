"""What the report of one sensor says: an IMU by rests and rotations, poses, a turntable, a magnetometer.

There is one list of sections; a page has those for which the result holds something.
"""

from collections.abc import Iterator
from math import degrees, isfinite

from ...results.calibration import Calibration
from ...results.result import JoinedDiagnostics
from ...results.sensor_diagnostics import ImuDiagnostics, TriadDiagnostics
from ...units import STANDARD_GRAVITY_M_S2
from ..imu_parameters import parameter_groups
from ..numbers import (
    fixed_text,
    magnitude_text,
    number_text,
    quantity_text,
)
from ..page import KeyNumber, ParameterTable, ReportPage, Section
from ..sections import FRAMES, assumptions_section, calibration_page, gravity_text, imu_use_section, provenance_section
from ..trust_section import trust_section
from .joined import joined_numbers, joined_sections
from .sections import known_directions, largest_gap, static_sections
from .vectors import COUNTED, Vectors, kind_of, vectors_of

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
