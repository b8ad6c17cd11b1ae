"""What the report says of several recordings of one sensor: how much it changes between them, and each of them."""

from math import degrees, isfinite

import numpy as np

from ...options.requirements import BETWEEN_RECORDINGS, QUANTITIES
from ...results.calibration import Calibration
from ...results.result import JoinedDiagnostics
from ..numbers import (
    MISSING,
    finite_rms,
    number_text,
    quantity_text,
    readable_unit,
)
from ..page import FRAMES, KeyNumber, ReportTable, Section, gravity_text


def joined_numbers(calibration: Calibration) -> tuple[KeyNumber, ...]:
    """Return the key numbers of several recordings that were joined."""
    assessment = calibration.assessment
    between = {name: assessment.trust.between.get(name, 0.0) for name in ("gyroscope_bias", "accelerometer_bias")}
    unseen = quantity_text(assessment.holdout.accelerometer_rms, "m/s²")
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
        KeyNumber("Accelerometer hold-out error", unseen, "rms of |f| − g in intervals left out of the fits"),
        KeyNumber("Gravity", gravity_text(calibration.gravity), calibration.gravity.source),
        KeyNumber("Body frame", calibration.frame, FRAMES.get(calibration.frame, "")),
    )


def _amount(name: str, value: float) -> str:
    unit = QUANTITIES[name]
    return f"{number_text(value / unit.size, 2)}\u00a0{readable_unit(unit.unit)}"


def joined_sections(diagnostics: JoinedDiagnostics) -> tuple[Section, Section]:
    """Return how much the sensor changes from recording to recording, and each recording."""
    return (
        Section(
            "between",
            "What changes between recordings",
            "What a sensor itself changes between two recordings no single recording can tell: its turn-on bias, and "
            "what temperature and mounting do.",
            (_scatter_table(diagnostics),),
        ),
        Section(
            "recordings",
            "Recordings",
            "Each was calibrated for itself; gnomon imu with one of them alone makes its full report.",
            (_recordings_table(diagnostics), _deviations_table(diagnostics)),
        ),
    )


def _scatter_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    recordings, quantities = diagnostics.recordings, np.array(diagnostics.quantity)
    within = np.sqrt(np.mean([one.sigma**2 for one in recordings], axis=0))
    distance = np.array([one.z for one in recordings])
    rows: list[tuple[str, ...]] = []
    for name in dict.fromkeys(diagnostics.quantity):
        at = np.flatnonzero((quantities == name) & (diagnostics.scatter > 0))
        if len(at):
            sizes = (
                float(diagnostics.scatter[at].max()),
                finite_rms(within[at]),
                finite_rms(diagnostics.mean_sigma[at]),
            )
            amounts = (_amount(name, size) for size in (*sizes, BETWEEN_RECORDINGS[name]))
            rows.append((QUANTITIES[name].words, *amounts, number_text(finite_rms(distance[:, at]), 2)))
    return ReportTable(
        "Scatter between recordings (σ)",
        ("quantity", "between recordings", "within one", "of the mean", "usual", "z rms, one left out"),
        rows,
        "Within one: rms sigma that a single recording states. Usual: of consumer sensors; "
        "with few recordings the estimate leans on it. z rms: distance of each recording from what the others "
        "foretell, over its standard deviation; 1 is honest, and with two recordings there is none.",
    )


def _recordings_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    rows = [
        (
            one.name,
            one.verdict,
            str(one.intervals),
            str(one.rotations),
            quantity_text(one.accelerometer_rms, "m/s²"),
            f"{number_text(degrees(one.rotation_rms), 2)}°" if isfinite(one.rotation_rms) else MISSING,
        )
        for one in diagnostics.recordings
    ]
    head = ("recording", "verdict", "intervals", "rotations", "accelerometer hold-out", "gyroscope hold-out")
    return ReportTable("One by one", head, rows)


def _deviations_table(diagnostics: JoinedDiagnostics) -> ReportTable:
    recordings = diagnostics.recordings
    off = [(one.values - diagnostics.mean) / np.where(one.sigma > 0, one.sigma, np.nan) for one in recordings]
    rows = [
        (diagnostics.names[i].removeprefix("imu0."), *(number_text(float(z[i]), 2) for z in off))
        for i in np.flatnonzero(diagnostics.scatter > 0).tolist()
    ]
    return ReportTable(
        "Parameters, recording minus mean, in σ of that recording",
        ("parameter", *(one.name for one in recordings)),
        rows,
        "Large numbers are what the sensor changed. They are part of the published σ.",
        dense=True,
    )
