"""A calibration on one screen, 80 columns wide, in characters that every terminal has; and beside the truth."""

import math
import textwrap
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from ..findings import Finding, Severity
from ..formats.shared.losses import prior_held_names
from ..recording import Floats
from ..results.calibration import Calibration, calibration_parameters, element_names
from ..results.parameters import parameter_unit, unit_ratio
from ..results.trust import UncertaintySummary
from ..writers.evidence_words import counted_things, held_out_errors, rests_on_gravity

if TYPE_CHECKING:
    from rich.table import Table

    from ..results.result import Result


WIDTH = 80
AXES = "xyz"
VERDICTS = {
    "pass": ("usable", "bold green"),
    "warn": ("usable, with reservations", "bold yellow"),
    "fail": ("do not use this calibration", "bold red"),
}
"""What a verdict means, and its style on a terminal."""


def summary_lines(calibration: Calibration) -> Iterator[str]:
    """Yield lines on what the calibration rests on and how well it predicts what it has not seen."""
    found = calibration.assessment
    yield f"  {counted_things(calibration):<18} {found.intervals_used} used of {found.intervals_found}"
    if found.model != "none" and found.rotations_found:
        yield f"  rotations          {found.rotations_used} used of {found.rotations_found}"
    errors = [f"{sensor} {engineering_text(rms, unit)}" for sensor, _, rms, unit in held_out_errors(calibration)]
    if errors:
        yield from _paragraph(f"{', '.join(errors)} (rms)", "  hold-out error     ", " " * 21)
    yield from gravity_lines(calibration)
    if found.model == "none":  # of an accelerometer alone there is but one
        yield f"  body frame         {calibration.frame}"
    else:
        yield f"  model, body frame  {found.model}, {calibration.frame}"


def gravity_lines(calibration: Calibration) -> Iterator[str]:
    """Yield what was taken for gravity, unless a finding tells it."""
    gravity, findings = calibration.gravity, calibration.assessment.findings
    if rests_on_gravity(calibration) and not any(one.code == "gravity" and one.severity != "good" for one in findings):
        sigma = f" +- {gravity.sigma:.2g}" if gravity.sigma else ""
        yield f"  gravity            {gravity.value:.6g}{sigma} m/s^2 ({gravity.source})"


def trust_lines(note: UncertaintySummary) -> Iterator[str]:
    """Yield lines on where the standard deviations come from, and whether parts agree."""
    if note.covariance == "cluster-robust":
        ratios = [ratio for ratio in note.sigma_ratio.values() if math.isfinite(ratio)]
        times = f", {np.median(ratios):.2g} x those of white noise" if ratios else ""
        of = f"clusters of {note.cluster_s:.3g} s" if note.cluster_s else "views"
        yield f"  sigmas             from {note.clusters} {of}{times}"
    if note.recordings:
        yield f"  sigmas             of the sensor on another occasion, from {note.recordings} recordings"
    if math.isfinite(note.split_z):
        yield f"  split-half         consistency, z rms {note.split_z:.2g} (1 expected)"
    if note.added:
        yield f"  added by evidence  {', '.join(note.added)}"


def held_lines(calibration: Calibration) -> Iterator[str]:
    """Yield lines on what is held by an assumption, since the recording does not determine it."""
    held = list(dict.fromkeys(name.split("[")[0] for name in prior_held_names(calibration)))
    if held:
        words = f"{', '.join(held)} (at least in part): held by an assumption, not determined by the recording"
        yield from _paragraph(words, "  not measured       ", " " * 21)


def finding_lines(
    findings: Iterable[Finding], *, good: bool = False, severity: Severity | None = None
) -> Iterator[str]:
    """Yield lines with every finding: what was found, what follows, what to do. Good news only if wanted.

    Assumptions were said while reading; what follows from another finding is named with it. Only those of one severity
    where it is given.
    """
    marks = {"problem": "[!!]", "warning": "[! ]", "info": "[i ]"} | ({"good": "[ok]"} if good else {})
    findings = list(findings)
    for finding in findings:
        if finding.severity not in marks or finding.code == "assumed" or finding.follows_from:
            continue
        if severity not in {None, finding.severity}:
            continue
        found = finding.message if finding.severity == "good" else f"{finding.message} ({finding.label})"
        yield from _paragraph(found, f"  {marks[finding.severity]} ", " " * 7)
        if finding.consequence:
            yield from _paragraph(finding.consequence, " " * 7, " " * 7)
        if following := dict.fromkeys(one.code for one in findings if one.follows_from == finding.code):
            yield from _paragraph(f"From it follow: {', '.join(following)}.", " " * 7, " " * 7)
        if finding.cure:
            yield from _paragraph(finding.cure, " " * 7 + "-> ", " " * 10)


def _paragraph(text: str, first: str, rest: str) -> list[str]:
    return textwrap.wrap(
        text, WIDTH - 1, initial_indent=first, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False
    )


def parameter_lines(calibration: Calibration) -> Iterator[str]:
    """Yield every parameter with its standard deviation, a row for each sensor axis."""
    for path, value in calibration_parameters(calibration.imus):
        sigma = calibration.sigma(path)
        if value.ndim == 0 or ".T_imu_body." in path or (calibration.cameras and path.endswith(".lever_arms_m")):
            continue  # poses, clocks and places stand with those of the cameras
        if path.endswith(".g_sensitivity") and calibration.assessment.model not in {"g-sensitivity", "full"}:
            continue
        if calibration.cameras and path.endswith("sensitivity") and not sigma.any():
            continue  # an ideal sensor, by the choice of the model
        title, unit = path.replace(".", " "), parameter_unit(calibration, path)
        if ".temperature." not in path:
            yield from _block(title, unit, value, sigma)
            continue
        for power, pair in enumerate(zip(value, sigma, strict=True), 1):
            yield from _block(
                f"{title}, (T - T_ref)^{power}", unit_ratio(unit, f"K^{power}" if power > 1 else "K"), *pair
            )
    for name, imu in calibration.imus.items():
        if (found := imu.temperature) is not None:
            known = f"known from {found.low_degc:.1f} to {found.high_degc:.1f} degC"
            yield f"  {name} at T_ref = {found.reference_degc:.2f} degC, {known}"


def _block(title: str, unit: str, value: Floats, sigma: Floats) -> Iterator[str]:
    power = common_power(value, sigma)
    scale = f"10^{power} " if power else ""
    yield f"  {title} [{scale}{unit}]"
    scaled, scaled_sigma = value / 10.0**power, sigma / 10.0**power
    decimals = common_decimals(scaled_sigma)
    if value.ndim == 1:  # one number an axis: in one row
        yield _row(" ", scaled, scaled_sigma, decimals)
        return
    for axis, row, row_sigma in zip(AXES, scaled, scaled_sigma, strict=True):
        yield _row(axis, row, row_sigma, decimals)


def _row(axis: str, values: Floats, sigmas: Floats, decimals: int) -> str:
    cells = "".join(_cell(*pair, decimals) for pair in zip(values, sigmas, strict=True))
    return f"   {axis} {cells}".rstrip()


def _cell(value: float, sigma: float, decimals: int) -> str:
    if not sigma > 0:  # fixed by the frame, or known
        return f"{value:.{decimals}f}".rjust(13) + " " * 11
    return f"{value:.{decimals}f}".rjust(13) + f" +- {sigma:.{decimals}f}".ljust(11)


def common_power(value: Floats, sigma: Floats) -> int:
    """Return a power of ten, a multiple of three, that makes the largest number of a block easy to read."""
    largest = float(np.max(np.maximum(np.abs(value), sigma), initial=0.0))
    if largest == 0 or 0.1 <= largest < 1e6:
        return 0
    return 3 * math.floor(math.log10(largest) / 3)


def common_decimals(sigma: Floats) -> int:
    """Return so many decimals that the smallest sigma of a block has two digits, but no more than six."""
    estimated = sigma[sigma > 0]
    if not len(estimated):
        return 6
    return min(max(1 - math.floor(math.log10(float(estimated.min()))), 0), 6)


def engineering_text(value: float, unit: str) -> str:
    """Return a number with its unit and a fitting prefix, such as "2.65 mrad".

    Examples
    --------
    >>> engineering_text(0.00265, "rad"), engineering_text(0.0015, "m/s^2"), engineering_text(float("nan"), "rad")
    ('2.65 mrad', '1.5 mm/s^2', 'unknown')
    """
    if not math.isfinite(value):
        return "unknown"
    if unit == "%":
        return f"{value:.3g} %"
    for prefix, factor in (("", 1.0), ("m", 1e3), ("u", 1e6)):
        if abs(value) * factor >= 0.5 or value == 0:
            return f"{value * factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"


def magnetometer_lines(result: "Result") -> Iterator[str]:
    """Yield lines on hard and soft iron, dip, and how well the strength of the field is predicted."""
    from ..results.sensor_diagnostics import TriadDiagnostics

    calibration, diagnostics = result.calibration, result.diagnostics
    assert isinstance(diagnostics, TriadDiagnostics)
    found = calibration.assessment
    sensor = calibration.imus["imu0"].magnetometer
    assert sensor is not None
    sigma = calibration.sigma("imu0.magnetometer.bias")
    yield f"  hard iron          {_numbers(sensor.bias, sigma)} {sensor.unit}"
    shape, spread = soft_iron(sensor.sensitivity), _sigma(sensor.sensitivity, calibration)
    yield f"  soft iron          {_numbers(100 * shape[:3], 100 * spread[:3])} % (scales)"
    yield f"                     {_numbers(1e3 * shape[3:], 1e3 * spread[3:])} mrad (xy xz yz)"
    if diagnostics.dip is not None:
        dip = np.degrees([diagnostics.dip.estimated_rad, diagnostics.dip.sigma_rad])
        yield f"  dip of the field   {dip[0]:.2f} +- {dip[1]:.2f} deg below the horizontal"
    noise = diagnostics.noise
    yield f"  strength, samples  {100 * noise['magnetometer.error_std']:.3g} % rms, robustly " + (
        f"{100 * noise['magnetometer.error_spread']:.3g} %"
    )
    yield f"  hold-out error     {100 * found.holdout.field_rms:.3g} % of the field (rms)"
    yield f"  stretches          {found.intervals_used} used of {found.intervals_found}"
    yield f"  model, body frame  {found.model}, {calibration.frame}; field in {sensor.field_unit}"


def soft_iron(sensitivity: Floats) -> Floats:
    """Return how far the scales of x, y, z are off their mean, then the axes off square, xy xz yz [rad], (6,)."""
    length = np.linalg.norm(sensitivity, axis=1)
    rows = sensitivity / length[:, None]
    cosines = np.array([rows[0] @ rows[1], rows[0] @ rows[2], rows[1] @ rows[2]])
    return np.concatenate([length / length.mean() - 1, np.arcsin(np.clip(cosines, -1, 1))])


def _sigma(sensitivity: Floats, calibration: Calibration) -> Floats:
    """Return the sigmas of `soft_iron`, (6,)."""
    step = 1e-6 * float(np.abs(sensitivity).max())
    moves = step * np.eye(9).reshape(9, 3, 3)
    jacobian = np.stack([soft_iron(sensitivity + m) - soft_iron(sensitivity - m) for m in moves], axis=1) / (2 * step)
    covariance = jacobian @ calibration.covariance("imu0.magnetometer.sensitivity") @ jacobian.T
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _numbers(values: Floats, sigma: Floats) -> str:
    decimals = common_decimals(sigma)
    return "  ".join(f"{v:.{decimals}f} +- {s:.{decimals}f}" for v, s in zip(values, sigma, strict=True))


def compare_with_truth(estimate: Calibration, truth: Calibration) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, estimate, sigma and truth of every scalar that was estimated."""
    true = truth.in_frame(estimate.frame)
    known = dict(calibration_parameters(true.imus))
    for path, value in calibration_parameters(estimate.imus):
        names = element_names(path, value.shape)
        truly = known.get(path, np.zeros_like(value))  # without lever arms they are zero
        columns = value.ravel(), estimate.sigma(path).ravel(), truly.ravel()
        for name, number, sigma, expected in zip(names, *columns, strict=True):
            if sigma > 0:
                yield name, float(number), float(sigma), float(expected)


def comparison_table(estimate: Calibration, truth: Calibration) -> "Table":
    """Return a table of estimates, their sigmas, the truth, and the errors in sigmas."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, title="estimate and truth", pad_edge=False)
    table.add_column("parameter", max_width=26)
    for title in ("estimate", "sigma", "truth", "error/sigma"):
        table.add_column(title, justify="right", no_wrap=True)
    for path, rows in groupby(compare_with_truth(estimate, truth), key=lambda row: row[0].split("[", maxsplit=1)[0]):
        block = list(rows)
        numbers = np.array([row[1:] for row in block])
        power = common_power(numbers[:, 0], numbers[:, 1])
        decimals = common_decimals(numbers[:, 1] / 10.0**power)
        scale = f"10^{power} " if power else ""
        unit = f"[{scale}{parameter_unit(estimate, path)}]"
        table.add_row(Text(path.removeprefix("imu0."), style="bold"), *[""] * 4)
        table.add_row(Text(f"  {unit}"), *[""] * 4)
        for name, number, sigma, expected in block:
            cells = [f"{value / 10.0**power:.{decimals}f}" for value in (number, sigma, expected)]
            element = name.removeprefix(path)
            table.add_row(Text(f"  {element}"), *cells, f"{(number - expected) / sigma:+.2f}")
        table.add_section()
    return table


def comparison_sentence(estimate: Calibration, truth: Calibration) -> str:
    """Return how large the errors are for their sigmas."""
    ratios = np.array(
        [(number - expected) / sigma for _, number, sigma, expected in compare_with_truth(estimate, truth)]
    )
    return f"{len(ratios)} parameters: rms of error/sigma {np.sqrt(np.mean(ratios**2)):.2f}, where 1 is expected.\n"


def comparison_document(estimate: Calibration, truth: Calibration) -> list[dict[str, Any]]:
    """Return the same for a program."""
    keys = ("parameter", "estimate", "sigma", "truth")
    return [dict(zip(keys, row, strict=True)) for row in compare_with_truth(estimate, truth)]
