"""Sections that reports of several kinds share, and their words."""

from collections.abc import Iterable, Iterator, Sequence

from ..recording import Floats
from ..results.calibration import Calibration, Gravity, ImuCalibration, Provenance
from .certificate.tables import budget_table, certificate_tables
from .numbers import number_text, readable_unit
from .page import Code, KeyNumber, Prose, ReportPage, ReportTable, Section, lift_figures, typeset_finding

HEADLINES = {
    "pass": "This calibration is good to use.",
    "warn": "This calibration can be used, with the reservations below.",
    "fail": "Do not use this calibration.",
}
NOISE_HEADLINES = {verdict: line.replace("calibration", "noise") for verdict, line in HEADLINES.items()}
FRAMES = {
    "accel-x": "the x axis of the body is the sensitivity axis of the x accelerometer, and the y accelerometer lies in "
    "the x-y plane (Kalibr's convention)",
    "accel-z": "the z axis of the body is the sensitivity axis of the z accelerometer, and the y accelerometer lies in "
    "the y-z plane (the convention of Tedaldi and of imu_tk)",
    "gyro-x": "the x axis of the body is the sensitivity axis of the x gyroscope, and the y gyroscope lies in the x-y "
    "plane",
    "mag-x": "the x axis of the body is the sensitivity axis of the x magnetometer, and the y magnetometer lies in the "
    "x-y plane",
    "cam0": "x to the right of the image of cam0, y down, z out of its lens",
    "user": "axes of your own, taken from the poses that you named",
}
"""What the body frames mean."""


def gravity_text(gravity: Gravity) -> str:
    """Return the magnitude of gravity with its sigma, if it has one, and its unit."""
    spread = f" ± {number_text(gravity.sigma, 2)}" if gravity.sigma > 0 else ""
    return f"{number_text(gravity.value, 7)}{spread}\u00a0m/s²"


def aligned_matrix(name: str, values: Floats) -> str:
    """Return a matrix as aligned text, rows in brackets."""
    cells = [[f"{v:.9g}" for v in row] for row in values.tolist()]
    width = max(len(cell) for row in cells for cell in row)
    middle = len(cells) // 2
    return "\n".join(
        f"{name if i == middle else ' ' * len(name)} {'=' if i == middle else ' '} "
        f"[ {'  '.join(c.rjust(width) for c in row)} ]"
        for i, row in enumerate(cells)
    )


def calibration_page(
    title: str,
    calibration: Calibration,
    key_numbers: tuple[KeyNumber, ...],
    sections: Iterable[Section | None],
    plots: Sequence[str] = (),
) -> ReportPage:
    """Return the page of a calibration; the first figures of the sections in `plots` stand on page one.

    Sections that there is nothing to say in are None.
    """
    made_by = calibration.provenance.gnomon_version
    budget = budget_table(calibration)
    figures, folded = lift_figures((section for section in sections if section is not None), plots)
    return ReportPage(
        title=title,
        subject=", ".join(source.name for source in calibration.provenance.inputs) or "recording from memory",
        verdict=calibration.verdict,
        headline=HEADLINES[calibration.verdict],
        key_numbers=key_numbers,
        findings=tuple(typeset_finding(f) for f in calibration.assessment.findings if f.code != "assumed"),
        sections=folded,
        front=(*certificate_tables(calibration), *figures, *(budget,) * bool(budget.rows)),
        footer=f"Made by gnomon {made_by}. This file needs no network and no other file.",
    )


def assumptions_section(calibration: Calibration, stated: Iterable[str]) -> Section:
    """Return what was assumed: as stated, as the findings say, and what a prior holds."""
    points = [*stated]
    points += [typeset_finding(one).message for one in calibration.assessment.findings if one.code == "assumed"]
    if held := calibration.assessment.held_by_prior:
        points.append(f"Not determined by this recording, and held by assumption: {', '.join(held)}.")
    return Section("assumptions", "What was assumed", blocks=(Prose(points, points=True),))


def provenance_section(provenance: Provenance) -> Section:
    """Return the section with version, method, options, seed and the hashes of the inputs."""
    rows = [("gnomon", provenance.gnomon_version), ("method", provenance.method)]
    options = ", ".join(f"{name} = {value}" for name, value in provenance.options.items())
    rows.append(("options", options or "all at their defaults"))
    if provenance.seed is not None:
        rows.append(("seed", str(provenance.seed)))
    blocks = [ReportTable("How it was made", ("", ""), rows, prose=True)]
    if provenance.inputs:
        blocks.append(
            ReportTable(
                "Inputs",
                ("file", "SHA-256"),
                tuple((source.name, source.sha256) for source in provenance.inputs),
                "The same inputs, options and version give the same calibration and report, byte for byte.",
                prose=True,
            )
        )
    return Section("provenance", "Provenance", blocks=blocks)


_MEANT = {"accelerometer": "specific force f", "gyroscope": "angular rate ω", "magnetometer": "magnetic field h"}


def imu_use_section(calibration: Calibration) -> Section:
    """Return commands, a few lines of Python, and the formulas with their numbers."""
    imus = calibration.imus
    to = "kalibr" if all(imu.accelerometer is not None for imu in imus.values()) else "csv"
    blocks = [
        Code(
            "On the command line",
            "gnomon apply calibration.yaml RECORDING -o calibrated.csv\n"
            "gnomon show calibration.yaml\n"
            f"gnomon convert calibration.yaml --to {to}",
        )
    ]
    for name, imu in imus.items():
        blocks.append(
            Code(
                "In Python" if len(imus) == 1 else f"In Python, {name}",
                "import gnomon\n\n"
                'calibration = gnomon.load("calibration.yaml")\n'
                f'samples = gnomon.{_reader(imu)}("RECORDING").imus[{name!r}]\n'
                f"calibrated = calibration.imus[{name!r}].apply(samples)\n"
                f"# {_units(imu)}, in the body frame",
            )
        )
        blocks += _formulas(imu)
    meant = [text for triad, text in _MEANT.items() if any(getattr(imu, triad) is not None for imu in imus.values())]
    listed = " and ".join(filter(None, (", ".join(meant[:-1]), meant[-1])))
    return Section(
        "use", "How to use it", f"The calibration maps what the sensor reads to {listed} in the body frame.", blocks
    )


def _reader(imu: ImuCalibration) -> str:
    alone = imu.accelerometer is None and imu.magnetometer is None
    return "read_turntable" if alone else "read"


def _units(imu: ImuCalibration) -> str:
    units = ["m/s²"] if imu.accelerometer is not None else []
    units += ["rad/s"] if imu.gyroscope is not None else []
    if imu.magnetometer is not None:
        units.append("µT" if imu.magnetometer.field_unit == "uT" else "in units of the local field")
    return " and ".join(filter(None, (", ".join(units[:-1]), units[-1])))


def _formulas(imu: ImuCalibration) -> Iterator[Code]:
    if (accelerometer := imu.accelerometer) is not None:
        text = "m = S f + b          f = S⁻¹ (m − b)\n\n" + aligned_matrix("S", accelerometer.sensitivity)
        text += "\n\n" + aligned_matrix("b", accelerometer.bias[:, None])
        yield Code(f"Accelerometer: m in {accelerometer.unit}, f in m/s²", text)
    if (gyroscope := imu.gyroscope) is not None:
        felt = imu.accelerometer is not None or bool(gyroscope.g_sensitivity.any())
        text = "y = S ω + b + G f    ω = S⁻¹ (y − b − G f)" if felt else "y = S ω + b          ω = S⁻¹ (y − b)"
        text += "\n\n" + aligned_matrix("S", gyroscope.sensitivity)
        text += "\n\n" + aligned_matrix("b", gyroscope.bias[:, None])
        text += "\n\n" + aligned_matrix("G", gyroscope.g_sensitivity) if felt else ""
        yield Code(f"Gyroscope: y in {gyroscope.unit}, ω in rad/s", text)
    if (magnetometer := imu.magnetometer) is not None:
        text = "c = S h + b          h = S⁻¹ (c − b)\n\n" + aligned_matrix("S", magnetometer.sensitivity)
        text += "\n\n" + aligned_matrix("b", magnetometer.bias[:, None])
        field = "µT" if magnetometer.field_unit == "uT" else "units of the local field"
        yield Code(f"Magnetometer: c in {readable_unit(magnetometer.unit)}, h in {field}", text)
