"""What the report of one sensor from several recordings says: the mean, what changes between them, each of them."""

from math import degrees, isfinite

import numpy as np

from ..calibration import Calibration
from ..diagnostics import JoinedDiagnostics, JoinedRecording
from ..recording import Floats
from ..requirements import BETWEEN_RECORDINGS, QUANTITIES
from .calibration_page import calibration_page
from .imu_parameters import parameter_groups, readable_unit
from .numbers import MISSING, number, quantity, rms
from .page import KeyNumber, Page, Parameters, Prose, Section, Table
from .provenance import provenance_section
from .trust_section import trust_section
from .usage import use_section
from .wording import FRAMES, gravity_text


def joined_page(calibration: Calibration, diagnostics: JoinedDiagnostics) -> Page:
    """Return the page of a calibration from several recordings of one sensor."""
    sections = (
        Section(
            "parameters",
            "Parameters",
            "Means over the recordings. σ is the standard deviation of the sensor on another occasion about the "
            "mean: the scatter between the recordings is in it. Bars show the estimate, whiskers ±2σ.",
            (Parameters(parameter_groups(calibration)),),
        ),
        _between(diagnostics),
        _recordings(diagnostics),
        trust_section(calibration.assessment, None),
        _assumptions(calibration),
        use_section(calibration),
        provenance_section(calibration.provenance),
    )
    return calibration_page("IMU calibration from several recordings", calibration, _key_numbers(calibration), sections)


def _key_numbers(calibration: Calibration) -> tuple[KeyNumber, ...]:
    assessment = calibration.assessment
    between = {name: assessment.trust.between.get(name, 0.0) for name in ("gyroscope_bias", "accelerometer_bias")}
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
        KeyNumber(
            "Accelerometer on unseen data",
            quantity(assessment.holdout.accelerometer_rms, "m/s²"),
            "rms of |f| − g in intervals left out of the fits",
        ),
        KeyNumber("Gravity", gravity_text(calibration.gravity), calibration.gravity.source),
        KeyNumber("Body frame", calibration.frame, FRAMES.get(calibration.frame, "")),
    )


def _amount(name: str, value: float) -> str:
    unit = QUANTITIES[name]
    return f"{number(value / unit.size, 2)}\u00a0{readable_unit(unit.unit)}"


def _between(diagnostics: JoinedDiagnostics) -> Section:
    """Return the section on how much the sensor changes from recording to recording."""
    quantities = np.array(diagnostics.quantity)
    within = np.sqrt(np.mean([one.sigma**2 for one in diagnostics.recordings], axis=0))
    distance = np.array([one.z for one in diagnostics.recordings])
    rows: list[tuple[str, ...]] = []
    for name in dict.fromkeys(diagnostics.quantity):
        at = np.flatnonzero((quantities == name) & (diagnostics.scatter > 0))
        if len(at):
            rows.append(
                (
                    QUANTITIES[name].words,
                    _amount(name, float(diagnostics.scatter[at].max())),
                    _amount(name, rms(within[at])),
                    _amount(name, rms(diagnostics.mean_sigma[at])),
                    _amount(name, BETWEEN_RECORDINGS[name]),
                    number(rms(distance[:, at]), 2),
                )
            )
    return Section(
        "between",
        "What changes between recordings",
        "What a sensor itself changes between two recordings no single recording can tell: its turn-on bias, and "
        "what temperature and mounting do.",
        (
            Table(
                "Scatter between recordings (σ)",
                ("quantity", "between recordings", "within one", "of the mean", "usual", "z rms, one left out"),
                rows,
                "Within one: rms sigma that a single recording states. Usual: of consumer sensors; "
                "with few recordings the estimate leans on it. z rms: distance of each recording from what the others "
                "foretell, over its standard deviation; 1 is honest, and with two recordings there is none.",
            ),
        ),
    )


def _recordings(diagnostics: JoinedDiagnostics) -> Section:
    return Section(
        "recordings",
        "Recordings",
        "Each was calibrated for itself; gnomon imu with one of them alone makes its full report.",
        (
            Table(
                "One by one",
                ("recording", "verdict", "intervals", "rotations", "accelerometer unseen", "gyroscope unseen"),
                tuple(_row(one) for one in diagnostics.recordings),
            ),
            Table(
                "Parameters, recording minus mean, in σ of that recording",
                ("parameter", *(one.name for one in diagnostics.recordings)),
                tuple(_deviations(diagnostics)),
                "Large numbers are what the sensor changed. They are part of the published σ.",
                dense=True,
            ),
        ),
    )


def _row(one: JoinedRecording) -> tuple[str, ...]:
    angle = f"{number(degrees(one.rotation_rms), 2)}°" if isfinite(one.rotation_rms) else MISSING
    return (
        one.name,
        one.verdict,
        str(one.intervals),
        str(one.rotations),
        quantity(one.accelerometer_rms, "m/s²"),
        angle,
    )


def _deviations(diagnostics: JoinedDiagnostics) -> list[tuple[str, ...]]:
    values = np.array([one.values for one in diagnostics.recordings])
    sigmas = np.array([one.sigma for one in diagnostics.recordings])
    rows: list[tuple[str, ...]] = []
    for i in np.flatnonzero(diagnostics.scatter > 0):
        off: Floats = (values[:, i] - diagnostics.mean[i]) / sigmas[:, i]
        rows.append((diagnostics.names[i].removeprefix("imu0."), *(number(float(z), 2) for z in off)))
    return rows


def _assumptions(calibration: Calibration) -> Section:
    points = [
        f"Gravity is {gravity_text(calibration.gravity)} ({calibration.gravity.source}), the same in all recordings.",
        f"The body frame is {calibration.frame}: {FRAMES.get(calibration.frame, calibration.frame)}.",
        "All recordings are of one sensor with one setting. Scales and axes agree well enough for that.",
    ]
    points += [finding.message for finding in calibration.assessment.findings if finding.code == "assumed"]
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))
