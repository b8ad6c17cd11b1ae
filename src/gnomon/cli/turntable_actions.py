"""What the commands for a gyroscope on a turntable do."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OptionError
from .places import default_folder, result_folder, truth_name
from .prior_files import read_priors
from .results import (
    USABLE,
    exit_code,
    result_document,
    say_assumptions,
    say_result,
    write_result,
)
from .terminal import Terminal
from .turntable_command import SimulateTurntable, Turntable
from .use_option import judged_result, read_use_option

if TYPE_CHECKING:
    from ..detect.platter.rate import PlatterRate
    from ..diagnostics import Result
    from ..findings import Finding
    from ..recording import Recording
    from ..triad_diagnostics import PeriodCurve
    from ..triad_options import StatedRate


def turntable(command: Turntable, terminal: Terminal) -> int:
    """Calibrate, write the folder of the result, and return the exit code."""
    from ..calibrate.turntable import calibrate_turntable
    from ..readers.samples.turntable_files import turntable_files

    groups = turntable_files(command.recordings)
    folder = command.output or default_folder(command.recordings[:1], "turntable")
    use = read_use_option(command.use)
    with result_folder(folder, "turntable") as staging:
        known = read_priors(command.options.prior)
        rates, rate_of, videos, noticed = _rates(command, groups, terminal)
        recordings = [known.noted_in(recording) for recording in _read(command, groups, terminal)]
        first = recordings[0]
        recordings[0] = replace(first, sources=(*first.sources, *known.sources), findings=(*first.findings, *noticed))
        assumptions = _assumptions(recordings)
        terminal.close()
        say_assumptions(assumptions, terminal)  # before anything fails: they often explain why
        result = calibrate_turntable(
            recordings,
            rates,
            replace(command.options, prior=known.stated),
            progress=terminal.progress,
            prior=known.calibrations,
            rate_of=rate_of,
            videos=videos,
        )
        result = judged_result(result, use)
        write_result(result, staging, report=command.report, terminal=terminal)
    terminal.close()
    say_result(result.calibration, _facts(result), folder, terminal)
    terminal.document(result_document(result.calibration, folder, assumptions))
    return exit_code(result.calibration)


def _read(command: Turntable, groups: Sequence[tuple[Path, ...]], terminal: Terminal) -> "list[Recording]":
    from ..readers.samples.turntable_files import read_turntable

    recordings: list[Recording] = []
    for k, files in enumerate(groups):
        terminal.progress(f"reading recording {k + 1} of {len(groups)}" if len(groups) > 1 else "reading the recording")
        recordings.append(
            read_turntable(*files, columns=command.columns, rate_hz=command.sample_rate, units=command.units)
        )
    return recordings


def _assumptions(recordings: "Sequence[Recording]") -> tuple[str, ...]:
    """Return what the reader had to assume, each sentence once however many files it is true of."""
    files: dict[str, list[str]] = {}
    for recording in recordings:
        name = recording.sources[0].name
        for text in recording.assumptions:
            files.setdefault(text.removeprefix(f"{name}: "), []).append(name)
    return tuple(text if len(names) == len(recordings) else f"{names[0]}: {text}" for text, names in files.items())


def _rates(
    command: Turntable, groups: Sequence[tuple[Path, ...]], terminal: Terminal
) -> "tuple[list[StatedRate], list[StatedRate | None], tuple[PeriodCurve, ...], list[Finding]]":
    """Return speeds that occur, the speed of each recording where it is stated, what videos showed, and findings."""
    places = {name: k for k, files in enumerate(groups) for path in files for name in (path.name, path.stem, str(path))}
    rates: list[StatedRate] = []
    rate_of: list[StatedRate | None] = [None] * len(groups)
    videos: list[PeriodCurve] = []
    findings: list[Finding] = []
    for text in command.rate:
        name, equals, value = text.rpartition("=")
        if equals and name not in places:
            known = ", ".join(path.name for files in groups[:6] for path in files)
            raise OptionError(f"--rate {text}: {name} is none of the recordings ({known}). Write FILE=RATE.")
        rate, seen = _rate(value, command, terminal)
        if seen is not None:
            videos.append(_curve(rate.name, seen))
            findings += seen.findings
        if equals:
            rate_of[places[name]] = rate
        else:
            rates.append(rate)
    return rates, rate_of, tuple(videos), findings


def _rate(text: str, command: Turntable, terminal: Terminal) -> "tuple[StatedRate, PlatterRate | None]":
    """Return a speed as stated, or as a video shows it with what else it showed."""
    from ..triad_options import StatedRate
    from ..units import parse_rate

    path = Path(text)
    if not path.exists():
        value = parse_rate(text)
        stated = command.options.rate_sigma
        return StatedRate(name=text, rate_rad_s=value, sigma_rad_s=nan if stated is None else stated * value), None
    from ..calibrate.platter_rate import rate_from_video

    terminal.progress(f"watching {path.name}")
    seen = rate_from_video(path, progress=terminal.progress)
    return (
        StatedRate(name=path.name, rate_rad_s=seen.rate_rad_s, sigma_rad_s=seen.sigma_rad_s, turns=seen.turns),
        seen,
    )


def _curve(name: str, seen: "PlatterRate") -> "PeriodCurve":
    from ..triad_diagnostics import PeriodCurve

    return PeriodCurve(
        name=name,
        period_s=seen.periods_s,
        score=seen.scores,
        t_s=seen.phase_t_s,
        phase_error_turns=seen.phase_turns,
    )


def _facts(result: "Result") -> Iterator[str]:
    """Yield lines on what the calibration rests on, and the speeds."""
    from ..triad_diagnostics import TriadDiagnostics
    from . import summary

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, TriadDiagnostics)
    yield from summary.facts(result.calibration)
    for rate in diagnostics.rates:
        if rate.stated:
            turns = f", {rate.turns:.0f} turns seen" if rate.turns == rate.turns else ""
            speed = f"{rate.stated:.6g} +- {rate.stated_sigma:.2g} rad/s"
            yield f"  {'speed':<18} {rate.name}: {speed} in {rate.parts} parts{turns}"


def simulate_turntable(command: SimulateTurntable, terminal: Terminal) -> int:
    """Simulate recordings, write their folder, and return the exit code."""
    from ..simulate.turntable import simulated_turntable
    from ..writers import save
    from ..writers.recording_file import save_recording

    scenario, folder = command.scenario, command.output
    with result_folder(folder, own=()) as staging:
        terminal.progress("simulating")
        simulation = simulated_turntable(scenario, command.seed)
        names: list[str] = []
        for k, recording in enumerate(simulation.recordings):
            name = "recording.npz" if len(simulation.recordings) == 1 else f"pose{k + 1:02d}.npz"
            names += [path.name for path in save_recording(recording, staging / name)]
        true = truth_name(folder, names)
        save(simulation.truth, staging / true)
        videos = _save_videos(command, simulation.rates, staging, terminal) if command.video else []
    terminal.close()
    rates = " ".join(f"{rpm:g}rpm" for rpm in scenario.rpm)
    terminal.say(f"recordings   {folder}: {len(names)} at {rates}, {scenario.poses} orientations")
    for name in videos:
        terminal.say(f"video        {folder / name}")
    terminal.say(f"truth        {folder / true}")
    terminal.propose("turntable", *(folder / name for name in names), "--rate", *rates.split())
    terminal.document(
        {
            "recordings": [str(folder / name) for name in names],
            "videos": [str(folder / name) for name in videos],
            "rates_rad_s": list(simulation.rates),
            "truth": str(folder / true),
        }
    )
    return USABLE


def _save_videos(command: SimulateTurntable, rates: Sequence[float], staging: Path, terminal: Terminal) -> list[str]:
    """Write a video of the platter at each speed, and return the names of the files."""
    from ..simulate.platter_scenario import PlatterScenario
    from ..simulate.platter_video import simulate_platter_video
    from ..writers.video import save_video

    names: list[str] = []
    for rpm, rate in zip(command.scenario.rpm, rates, strict=True):
        if rate:
            names.append(f"platter-{rpm:g}rpm.mkv")
            terminal.progress(f"filming {names[-1]}")
            sense = 1.0 if command.scenario.counter_clockwise else -1.0
            film = simulate_platter_video(PlatterScenario(rate_rad_s=sense * rate), command.seed)
            save_video(staging / names[-1], film.images(), film.t_ns)
    return names
