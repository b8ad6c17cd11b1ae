"""The result of a calibration: its files, one screen 80 columns wide, the document for programs, exit codes."""

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from .command import TableOptions
from .files import RESULT_FILES
from .terminal import WIDTH, Terminal

if TYPE_CHECKING:
    from ..findings import Finding, Severity
    from ..recording import Floats
    from ..results.calibration import Calibration
    from ..results.result import Result
    from ..results.trust import UncertaintySummary

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from .command import StatedFacts

if TYPE_CHECKING:
    from ..assess.comparison.comparison import Comparison
    from ..assess.comparison.verification import Verification
    from ..options.requirements import Use
    from ..results.calibration import Calibration
    from ..results.result import Result


_MOVED_K = 4.0
"""Change of the chip's temperature from which on a line is told from it."""
USABLE, UNUSABLE = 0, 4
"""Exit codes of work that was finished."""


def exit_code(calibration: "Calibration") -> int:
    """Return the exit code of a calibration that was finished."""
    return UNUSABLE if calibration.verdict == "fail" else USABLE


def write_result(result: "Result", folder: Path, *, report: bool, terminal: Terminal) -> None:
    """Write calibration, diagnostics and, where wanted, the report; the terminal keeps what was calibrated."""
    from ..formats.own.calibration_text import save
    from ..results.result import save_diagnostics

    save(result.calibration, folder / "calibration.yaml")
    save_diagnostics(result.diagnostics, folder / "diagnostics.npz")
    terminal.written = result.calibration
    if report:
        terminal.progress("drawing the report")
        from ..report.page import write_report

        write_report(result, folder / "report.html")


def print_assumptions(assumptions: Sequence[str], terminal: Terminal) -> None:
    """Print what the reader detected or had to assume."""
    for sentence in assumptions:
        terminal.print(f"detected: {sentence}")
    if assumptions:
        terminal.print("")


def print_needs(calibration: "Calibration", terminal: Terminal) -> None:
    """Print what the use needs that the calibration was judged for, and what there is; nothing where there is none."""
    trust = calibration.assessment.trust
    if not trust.needs:
        return
    from ..assess.needs import number_words

    floors = any(need.floor for need in trust.needs)
    terminal.print(
        f"\n{f'known, needed for {trust.use}':<40}{'sigma':>9}{'between*' if floors else '':>10}{'needed':>8}"
    )
    for need in trust.needs:
        limit = f"{number_words(need.needed)} {need.unit}"
        floor = number_words(need.floor) if need.floor else ""
        terminal.print(f"  {need.block:<38}{number_words(need.sigma):>9}{floor:>10}{limit:>15}  {need.verdict}")
    if floors:
        terminal.print("  * usual from one recording to the next (turn-on, mounting); counted but for biases")
    terminal.print("")


def print_result(
    calibration: "Calibration",
    facts: Iterable[str],
    folder: Path,
    assumptions: Sequence[str],
    terminal: Terminal,
    *,
    parameters: bool = True,
    source: TableOptions | None = None,
    more: Mapping[str, Any] | None = None,
) -> int:
    """Print a calibration of an IMU on one screen and as a document, and return the exit code.

    Parameters
    ----------
    facts : lines on what it rests on
    assumptions : of the reader
    parameters : whether they are printed
    source : options of the recording, with which further recordings of the sensor are corrected
    more : of the document
    """
    print_summary(calibration, facts, terminal)
    if parameters:
        terminal.print("\nestimate +- standard deviation; rows: sensor axes, columns: body axes")
        terminal.print("\n".join(parameter_lines(calibration)))
    print_files(folder, terminal)
    if source is not None and calibration.verdict != "fail":
        stated = {"--columns": source.columns, "--rate": source.rate, "--units": source.units}
        options = [word for name, value in stated.items() if value is not None for word in (name, str(value))]
        terminal.print("")
        terminal.propose("apply", folder / "calibration.yaml", "RECORDING", *options, "-o", "corrected.csv")
    propose_temperature(calibration, folder, terminal)
    terminal.document(lambda: {**result_document(calibration, folder, assumptions), **(more or {})})
    return exit_code(calibration)


def propose_temperature(calibration: "Calibration", folder: Path, terminal: Terminal) -> None:
    """Propose to find what the temperature does, where it moved while the sensor was recorded."""
    span = calibration.provenance.options.get("chip_range_degc", "0 to 0").split(" to ")
    if any(imu.temperature is not None and imu.temperature.of("magnetometer") for imu in calibration.imus.values()):
        return
    if calibration.verdict != "fail" and float(span[1]) - float(span[0]) >= _MOVED_K:
        terminal.propose("temperature", "WARM-UP", "--calibration", folder / "calibration.yaml")


def print_summary(calibration: "Calibration", facts: Iterable[str], terminal: Terminal) -> None:
    """Print the verdict and what it means, what the calibration rests on, and the findings."""
    meaning, style = VERDICTS[calibration.verdict]
    trust = calibration.assessment.trust
    terminal.print(f"{calibration.verdict}: {meaning}" + (f" for {trust.use}" if trust.use else ""), style)
    print_needs(calibration, terminal)
    terminal.print("\n".join([*facts, *trust_lines(trust), *held_lines(calibration)]))
    print_findings(calibration.assessment.findings, terminal)


def print_findings(findings: "Sequence[Finding]", terminal: Terminal) -> None:
    """Print findings, but for good news."""
    if lines := list(finding_lines(findings)):
        terminal.print("\n" + "\n".join(lines))


def print_files(folder: Path, terminal: Terminal, names: Sequence[str] = RESULT_FILES) -> None:
    """Print which files were written."""
    terminal.print("")
    there = result_files(folder, names)
    width = max(map(len, there), default=0)
    for stem, path in there.items():
        terminal.print(f"{stem:<{max(width, 12)}} {path}")


def result_files(folder: Path, names: Sequence[str] = RESULT_FILES) -> dict[str, str]:
    """Return the files of a result that are there, by their names without suffix."""
    return {Path(name).stem: str(folder / name) for name in names if (folder / name).exists()}


def result_document(
    calibration: "Calibration", folder: Path, assumptions: Sequence[str], names: Sequence[str] = RESULT_FILES
) -> Mapping[str, Any]:
    """Return what a program is told about a result."""
    return {
        "verdict": calibration.verdict,
        "exit_code": exit_code(calibration),
        "assumptions": list(assumptions),
        "files": result_files(folder, names),
        "calibration": calibration_document(calibration),
    }


def calibration_document(calibration: "Calibration") -> dict[str, Any]:
    """Return what calibration.yaml holds."""
    import yaml

    from ..formats.own.calibration_text import calibration_text

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load(calibration_text(calibration), Loader=loader)


# ---- lines of the screen, in characters that every terminal has ----

VERDICTS = {
    "pass": ("usable", "bold green"),
    "warn": ("usable, with reservations", "bold yellow"),
    "fail": ("do not use this calibration", "bold red"),
}
"""What a verdict means, and its style on a terminal."""


def summary_lines(calibration: "Calibration") -> Iterator[str]:
    """Yield lines on what the calibration rests on and how well it predicts what it has not seen."""
    from ..results.result import counted_things, held_out_errors

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


def gravity_lines(calibration: "Calibration") -> Iterator[str]:
    """Yield what was taken for gravity, unless a finding tells it."""
    from ..results.result import rests_on_gravity

    gravity, findings = calibration.gravity, calibration.assessment.findings
    if rests_on_gravity(calibration) and not any(one.code == "gravity" and one.severity != "good" for one in findings):
        sigma = f" +- {gravity.sigma:.2g}" if gravity.sigma else ""
        yield f"  gravity            {gravity.value:.6g}{sigma} m/s^2 ({gravity.source})"


def trust_lines(note: "UncertaintySummary") -> Iterator[str]:
    """Yield lines on where the standard deviations come from, and whether parts agree."""
    if note.covariance == "cluster-robust":
        ratios = [ratio for ratio in note.sigma_ratio.values() if math.isfinite(ratio)]
        times = f", {median(ratios):.2g} x those of white noise" if ratios else ""
        of = f"clusters of {note.cluster_s:.3g} s" if note.cluster_s else "views"
        yield f"  sigmas             from {note.clusters} {of}{times}"
    if note.recordings:
        yield f"  sigmas             of the sensor on another occasion, from {note.recordings} recordings"
    if math.isfinite(note.split_z):
        yield f"  split-half         consistency, z rms {note.split_z:.2g} (1 expected)"
    if note.added:
        yield f"  added by evidence  {', '.join(note.added)}"


def held_lines(calibration: "Calibration") -> Iterator[str]:
    """Yield lines on what is held by an assumption, since the recording does not determine it."""
    from ..results.result import prior_held_names

    held = list(dict.fromkeys(name.split("[")[0] for name in prior_held_names(calibration)))
    if held:
        words = f"{', '.join(held)} (at least in part): held by an assumption, not determined by the recording"
        yield from _paragraph(words, "  not measured       ", " " * 21)


def finding_lines(
    findings: "Iterable[Finding]", *, good: bool = False, severity: "Severity | None" = None
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


def parameter_lines(calibration: "Calibration") -> Iterator[str]:
    """Yield every parameter with its standard deviation, a row for each sensor axis."""
    from ..results.calibration import calibration_parameters
    from ..results.sensors import parameter_unit, unit_ratio

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


def _block(title: str, unit: str, value: "Floats", sigma: "Floats") -> Iterator[str]:
    power = common_power(value, sigma)
    scale = f"10^{power} " if power else ""
    yield f"  {title} [{scale}{unit}]"
    scaled, scaled_sigma = value / 10.0**power, sigma / 10.0**power
    decimals = common_decimals(scaled_sigma)
    if value.ndim == 1:  # one number an axis: in one row
        yield _row(" ", scaled, scaled_sigma, decimals)
        return
    for axis, row, row_sigma in zip("xyz", scaled, scaled_sigma, strict=True):
        yield _row(axis, row, row_sigma, decimals)


def _row(axis: str, values: "Floats", sigmas: "Floats", decimals: int) -> str:
    cells = "".join(_cell(*pair, decimals) for pair in zip(values, sigmas, strict=True))
    return f"   {axis} {cells}".rstrip()


def _cell(value: float, sigma: float, decimals: int) -> str:
    if not sigma > 0:  # fixed by the frame, or known
        return f"{value:.{decimals}f}".rjust(13) + " " * 11
    return f"{value:.{decimals}f}".rjust(13) + f" +- {sigma:.{decimals}f}".ljust(11)


def common_power(value: "Floats", sigma: "Floats") -> int:
    """Return a power of ten, a multiple of three, that makes the largest number of a block easy to read."""
    largest = float(max(abs(value).max(initial=0.0), sigma.max(initial=0.0)))
    if largest == 0 or 0.1 <= largest < 1e6:
        return 0
    return 3 * math.floor(math.log10(largest) / 3)


def common_decimals(sigma: "Floats") -> int:
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


Certified = TypeVar("Certified", "Calibration", "Comparison", "Verification")


def judged_result(result: "Result", use: "Use | None") -> "Result":
    """Return a result whose calibration is judged for a use, where one is stated."""
    if use is None:
        return result
    from ..calibrate.judging import judge

    return replace(result, calibration=judge(result.calibration, use))


def result_with_reading(result: "Result", table: Mapping[str, Any]) -> "Result":
    """Return a result whose calibration remembers what was stated of its recording, such as how it was read."""
    stated = {name: str(value) for name, value in table.items() if value is not None}
    calibration = result.calibration
    provenance = replace(calibration.provenance, options={**calibration.provenance.options, **stated})
    return replace(result, calibration=replace(calibration, provenance=provenance))


def with_statements(found: Certified, facts: StatedFacts, paths: Iterable[Path] = ()) -> Certified:
    """Return it with what a certificate says: what was stated, and the files of the calibrations."""
    from ..formats.own.calibration_text import calibration_at
    from ..readers.files import file_source

    stated = {name: str(value) for name, value in facts.stated.items() if value is not None}
    inputs = list(found.provenance.inputs)
    for path in paths:
        file = Path(calibration_at(path))
        if file.is_file():
            called = f"{file.absolute().parent.name}/{file.name}" if file.name == "calibration.yaml" else file.name
            inputs.append(replace(file_source(file), name=called))
    made = found.provenance
    return replace(found, provenance=replace(made, inputs=tuple(inputs), options={**made.options, **stated}))
