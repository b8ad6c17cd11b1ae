"""What the report of an IMU calibration says: the page of page.py, filled from a Result."""

from math import degrees

from ..calibration import Calibration
from ..diagnostics import ImuDiagnostics
from ..units import STANDARD_GRAVITY_M_S2
from . import imu_sections
from .calibration_page import calibration_page
from .imu_parameters import parameter_groups
from .numbers import number, quantity
from .page import KeyNumber, Page, Parameters, Prose, Section
from .provenance import provenance_section
from .trust_section import trust_section
from .usage import use_section
from .wording import FRAMES, gravity_text

_MODELS = {
    "basic": "constant gyroscope bias",
    "g-sensitivity": "gyroscope bias linear in specific force",
    "none": "accelerometer only",
}


def imu_page(calibration: Calibration, diagnostics: ImuDiagnostics) -> Page:
    """Return the page of an IMU calibration."""
    sections = (
        _parameters(calibration),
        trust_section(calibration.assessment, diagnostics.trust),
        imu_sections.recording_section(diagnostics),
        imu_sections.rest_section(diagnostics),
        imu_sections.attitudes_section(diagnostics.intervals),
        imu_sections.accelerometer_section(diagnostics.intervals),
        imu_sections.gyroscope_section(diagnostics.rotations, calibration.gravity.value),
        imu_sections.choices_section(diagnostics),
        imu_sections.noise_section(diagnostics.noise),
        _assumptions(calibration),
        use_section(calibration),
        provenance_section(calibration.provenance),
    )
    return calibration_page("IMU calibration", calibration, _key_numbers(calibration), sections)


def _key_numbers(calibration: Calibration) -> tuple[KeyNumber, ...]:
    assessment, gravity = calibration.assessment, calibration.gravity
    force, turn = assessment.holdout.accelerometer_rms, assessment.holdout.rotation_rms
    milli_g, angle = number(1e3 * force / STANDARD_GRAVITY_M_S2, 3), number(degrees(turn), 3)
    numbers = [
        KeyNumber(
            "Accelerometer on unseen data",
            quantity(force, "m/s²"),
            f"rms of |f| − g in intervals left out of the fit; {milli_g} mg",
        ),
        KeyNumber(
            "Gyroscope on unseen data",
            quantity(turn, "rad"),
            f"rms of gravity propagated over rotations left out; {angle}°",
        ),
        KeyNumber(
            "Static intervals used",
            f"{assessment.intervals_used} of {assessment.intervals_found}",
            "attitudes in which gravity was measured",
        ),
        KeyNumber(
            "Rotations used",
            f"{assessment.rotations_used} of {assessment.rotations_found}",
            "movements between static intervals",
        ),
        KeyNumber("Gravity", gravity_text(gravity), gravity.source[:1].upper() + gravity.source[1:]),
        KeyNumber("Body frame and model", calibration.frame, _MODELS.get(assessment.model, assessment.model)),
    ]
    if assessment.model == "none":
        numbers = [n for n in numbers if n.label not in ("Gyroscope on unseen data", "Rotations used")]
    return tuple(numbers)


def _parameters(calibration: Calibration) -> Section:
    return Section(
        "parameters",
        "Parameters",
        "Each estimate with its standard deviation σ. Bars show the estimate, whiskers ±2σ; the bars of one group "
        "share one scale. Parameters without σ are fixed by the definition of the body frame or by the model.",
        (Parameters(parameter_groups(calibration)),),
    )


def _assumptions(calibration: Calibration) -> Section:
    gravity, assessment = calibration.gravity, calibration.assessment
    relative = 100 * gravity.sigma / gravity.value
    carried = f"; here its σ is {number(relative, 2)}\u00a0%" if relative > 0 else ""
    frame = FRAMES.get(calibration.frame, calibration.frame)
    points = [
        f"Gravity is {gravity_text(gravity)} ({gravity.source}). A relative error of gravity is the same relative "
        f"error of every accelerometer scale{carried}.",
        f"The body frame is {calibration.frame}: {frame}.",
        "Which way an axis points, and that the axes are right-handed, comes from the order of the columns: gravity "
        "alone cannot tell.",
    ]
    if assessment.model != "none":
        points.append(
            "A delay between accelerometer and gyroscope cannot be seen in this kind of recording; it is taken as zero."
        )
    if assessment.model == "basic":
        points.append("The bias of the gyroscope does not depend on specific force.")
    points += [finding.message for finding in assessment.findings if finding.code == "assumed"]
    if assessment.held_by_prior:
        held = ", ".join(assessment.held_by_prior)
        points.append(f"Not determined by this recording, and held by assumption: {held}.")
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))
