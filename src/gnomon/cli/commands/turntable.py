"""The commands for a gyroscope on a turntable, and for videos of its platter."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, nan, pi
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...errors import OptionError
from ...options import TurntableOptions
from ...simulate.scenarios.turntable import PlatterScenario, TurntableScenario
from ...units import Units, parse_rate
from ..arguments import Argument
from ..command import CertificateFacts, Command, Flat, ForUse, Report, Seed, output_option
from ..files import default_folder, read_priors, read_use_option, result_folder
from ..results import (
    USABLE,
    common_decimals,
    finding_lines,
    judged_result,
    print_assumptions,
    print_result,
    result_with_reading,
    summary_lines,
    write_result,
)
from ..simulated import truth_name
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...detect.platter.rate import PlatterRate
    from ...findings import Finding
    from ...options import StatedRate
    from ...recording import Recording
    from ...results.result import Result
    from ...results.sensor_diagnostics import PeriodCurve


@dataclass(frozen=True, kw_only=True)
class Turntable(Command):
    """Calibrate a gyroscope from recordings on a turntable, such as a record player.

    Put the sensor on the platter in eighteen orientations, each face down and each edge with a wedge. In each let the
    platter rest for 5 s, turn for half a minute, and rest again.

    Examples
    --------
    $ gnomon turntable recordings/ --rate 33.33rpm
    $ gnomon turntable recordings/ --rate platter.avi
    """

    recordings: Annotated[tuple[Path, ...], Argument(positional=True, metavar="PATH")]
    """One recording of all of it, or one for each orientation or speed; or a folder of these."""
    rate: Annotated[tuple[str, ...], Argument(metavar="RATE")] = ()
    """Speeds of the platter, such as 16rpm, 33.33rpm or 2.0rad/s, or videos of it, which tell the speed. Each steady
    part has the speed nearest to what it shows; FILE=RATE states it for one of several recordings."""
    columns: str | None = None
    """What the columns of a table are, such as "t ax ay az gx gy gz"; _ skips one."""
    sample_rate: float | None = None
    """Sample rate in Hz, for a table without time."""
    units: str | None = None
    """Units of the recordings: "si", "raw" (counts), or a list such as "g deg/s us"; recognised where not given."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-turntable beside the first
    recording)."""
    use: ForUse = None
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)
    options: Annotated[TurntableOptions, Flat] = field(default_factory=TurntableOptions)

    def __post_init__(self) -> None:
        if self.units is not None:
            Units.parse(self.units)

    def lacking(self) -> list[str]:
        """Return what to say where no speed was given."""
        asked = (
            "--rate is missing: how fast the platter turned, such as --rate 33.33rpm, or a video of it. "
            "Where nobody knows, state about how fast and add --free rate.scale."
        )
        return [] if self.rate else [asked]

    def run(self, terminal: Terminal) -> int:
        """Calibrate, write the folder of the result, and return the exit code."""
        from ...calibrate.turntable import calibrate_turntable
        from ...readers.samples.turntable_files import read_turntable, turntable_files

        groups = turntable_files(self.recordings)
        folder = self.output or default_folder(self.recordings[:1], "turntable")
        use = read_use_option(self.use)
        with result_folder(folder, "turntable") as staging:
            known = read_priors(self.options.prior)
            rates, rate_of, videos, noticed = _rates(self, groups, terminal)
            recordings: list[Recording] = []
            table: dict[str, Any] = {"columns": self.columns, "rate_hz": self.sample_rate, "units": self.units}
            for k, files in enumerate(groups):
                which = f"recording {k + 1} of {len(groups)}" if len(groups) > 1 else "the recording"
                terminal.progress(f"reading {which}")
                recordings.append(known.noted_in(read_turntable(*files, **table)))
            first = recordings[0]
            sources, findings = (*first.sources, *known.sources), (*first.findings, *noticed)
            recordings[0] = replace(first, sources=sources, findings=findings)
            assumptions = _assumptions(recordings)
            print_assumptions(assumptions, terminal)  # before anything fails: they often explain why
            result = calibrate_turntable(
                recordings,
                rates,
                replace(self.options, prior=known.stated),
                progress=terminal.progress,
                prior=known.calibrations,
                rate_of=rate_of,
                videos=videos,
            )
            result = result_with_reading(judged_result(result, use), table | self.certificate.stated)
            write_result(result, staging, report=self.report, terminal=terminal)
        return print_result(result.calibration, _summary_lines(result), folder, assumptions, terminal)


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
    from ...options import StatedRate
    from ...units import parse_rate

    path = Path(text)
    if not path.exists():
        value = parse_rate(text)
        stated = command.options.rate_sigma
        return StatedRate(name=text, rate_rad_s=value, sigma_rad_s=nan if stated is None else stated * value), None
    from ...calibrate.platter_rate import rate_from_video

    terminal.progress(f"watching {path.name}")
    seen = rate_from_video(path, progress=terminal.progress)
    return (
        StatedRate(name=path.name, rate_rad_s=seen.rate_rad_s, sigma_rad_s=seen.sigma_rad_s, turns=seen.turns),
        seen,
    )


def _curve(name: str, seen: "PlatterRate") -> "PeriodCurve":
    from ...results.sensor_diagnostics import PeriodCurve

    return PeriodCurve(
        name=name,
        period_s=seen.periods_s,
        score=seen.scores,
        t_s=seen.phase_t_s,
        phase_error_turns=seen.phase_turns,
    )


def _summary_lines(result: "Result") -> Iterator[str]:
    """Yield lines on what the calibration rests on, and the speeds."""
    from ...results.sensor_diagnostics import TriadDiagnostics

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, TriadDiagnostics)
    yield from summary_lines(result.calibration)
    for rate in diagnostics.rates:
        if rate.stated:
            turns = f", {rate.turns:.0f} turns seen" if rate.turns == rate.turns else ""
            speed = f"{rate.stated:.6g} +- {rate.stated_sigma:.2g} rad/s"
            yield f"  {'speed':<18} {rate.name}: {speed} in {rate.parts} parts{turns}"


@dataclass(frozen=True, kw_only=True)
class SimulateTurntable(Command):
    """Make recordings of a simulated sensor on a turntable, and its true calibration beside them (truth.yaml).

    Examples
    --------
    $ gnomon simulate turntable -o turntable
    """

    output: Annotated[Path, output_option("DIR")]
    """Folder for the recordings."""
    seed: Seed = 0
    video: bool = False
    """Make a video of the platter at each speed, too."""
    scenario: Annotated[TurntableScenario, Flat] = field(default_factory=TurntableScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate recordings, write their folder, and return the exit code."""
        from ...formats.own.calibration_text import save
        from ...simulate.turntable import simulate_turntable
        from ...writers.recording_file import save_recording

        scenario, folder = self.scenario, self.output
        with result_folder(folder, own=()) as staging:
            terminal.progress("simulating")
            simulation = simulate_turntable(scenario, self.seed)
            names: list[str] = []
            for k, recording in enumerate(simulation.recordings):
                name = "recording.npz" if len(simulation.recordings) == 1 else f"pose{k + 1:02d}.npz"
                names += [path.name for path in save_recording(recording, staging / name)]
            true = truth_name(folder, names)
            save(simulation.truth, staging / true)
            videos = _save_videos(self, simulation.rates, staging, terminal) if self.video else []
        rates = " ".join(f"{rpm:g}rpm" for rpm in scenario.rpm)
        terminal.print(f"recordings   {folder}: {len(names)} at {rates}, {scenario.poses} orientations")
        for name in videos:
            terminal.print(f"video        {folder / name}")
        terminal.print(f"truth        {folder / true}")
        if max(simulation.rates) > scenario.gyroscope_range:
            limit = (
                f"{scenario.gyroscope_range:.3g} rad/s; --gyroscope-range {1.5 * max(simulation.rates):.2g} is enough"
            )
            terminal.print(f"note         the gyroscope clips at {limit}")
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
    from ...simulate.images.platter_video import simulate_platter_video
    from ...simulate.scenarios.turntable import PlatterScenario
    from ...writers.image_folders import save_video

    names: list[str] = []
    for rpm, rate in zip(command.scenario.rpm, rates, strict=True):
        if rate:
            names.append(f"platter-{rpm:g}rpm.mkv")
            terminal.progress(f"filming {names[-1]}")
            sense = 1.0 if command.scenario.counter_clockwise else -1.0
            film = simulate_platter_video(PlatterScenario(rate_rad_s=sense * rate), command.seed)
            save_video(staging / names[-1], film.images(), film.t_ns)
    return names


@dataclass(frozen=True, kw_only=True)
class Rate(Command):
    """Measure how fast a platter turns, from a video of it.

    Fix a webcam so that it sees most of the platter, and record for a minute or more at a constant speed. A mark on
    the platter helps, but any print will do.

    Examples
    --------
    $ gnomon rate platter.avi --nominal 33.33rpm
    """

    video: Annotated[Path, Argument(positional=True, metavar="VIDEO")]
    """A video, with a table of its frames' timestamps beside it where there is one (platter.csv of platter.avi)."""
    nominal: Annotated[str | None, Argument(metavar="RATE")] = None
    """What the rate should be within 10 %, such as 33.33rpm or 2.0rad/s; needed where the picture leaves it open."""

    def __post_init__(self) -> None:
        if self.nominal is not None and not parse_rate(self.nominal) > 0:
            raise OptionError(f"--nominal {self.nominal}: a platter that does not turn has no rate in a video.")

    @property
    def nominal_rad_s(self) -> float | None:
        """The nominal rate, where it was stated [rad/s]."""
        return None if self.nominal is None else parse_rate(self.nominal)

    def run(self, terminal: Terminal) -> int:
        """Measure the rate of a platter, say it, and return the exit code."""
        from ...calibrate.platter_rate import rate_from_video

        found = rate_from_video(self.video, self.nominal_rad_s, terminal.progress)
        value, sigma, turns_hz = found.rate_rad_s, found.sigma_rad_s, found.rate_rad_s / (2 * pi)
        start, stop = found.steady_s
        terminal.print(f"rate          {_with_sigma(30 / pi * value, 30 / pi * sigma)} rpm")
        terminal.print(f"              {_with_sigma(value, sigma)} rad/s")
        terminal.print(f"              {_with_sigma(degrees(value), degrees(sigma))} deg/s")
        terminal.print(f"relative      {sigma / value:.1e} (1 sigma), of it the clock of the frames {found.clock:.0e}")
        terminal.print(
            f"steady part   {start:.1f} to {stop:.1f} s of {found.duration_s:.1f} s, {found.turns:.1f} turns"
        )
        terminal.print(
            f"frames        {found.frames_used} of {found.frames} used, {found.frame_rate_hz:.4g} per second"
        )
        terminal.print(f"one turn      {1 / turns_hz:.6g} s")
        terminal.print("\n" + "\n".join(finding_lines(found.findings, good=True)))
        terminal.document(rate_document(found))
        return USABLE


def _with_sigma(value: float, sigma: float) -> str:
    import numpy as np

    decimals = common_decimals(np.array([sigma]))
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"


def rate_document(found: "PlatterRate") -> dict[str, Any]:
    """Return what a program is told about the rate."""
    return {
        "exit_code": USABLE,
        "rate_rad_s": found.rate_rad_s,
        "sigma_rad_s": found.sigma_rad_s,
        "rate_rpm": 30 / pi * found.rate_rad_s,
        "sigma_rpm": 30 / pi * found.sigma_rad_s,
        "clock_relative": found.clock,
        "turns": found.turns,
        "steady_s": found.steady_s,
        "duration_s": found.duration_s,
        "frames": found.frames,
        "frames_used": found.frames_used,
        "frame_rate_hz": found.frame_rate_hz,
        "repetitions_per_turn": float(found.per_turn),
        "drift_rad_s": found.drift_rad_s[0],
        "drift_sigma_rad_s": found.drift_rad_s[1],
        "findings": found.findings,
    }


@dataclass(frozen=True, kw_only=True)
class SimulatePlatterVideo(Command):
    """Make a video of a simulated platter, as a webcam sees it.

    Examples
    --------
    $ gnomon simulate platter-video -o platter.avi
    """

    output: Annotated[Path, output_option("FILE")]
    """Video to write: .mkv or .mp4, with the time of each frame, or .avi, which has only a frame rate."""
    seed: Seed = 0
    scenario: Annotated[PlatterScenario, Flat] = field(default_factory=PlatterScenario)

    def run(self, terminal: Terminal) -> int:
        """Draw and write a video, say its true rate, and return the exit code."""
        from ...simulate.images.platter_video import simulate_platter_video as simulated
        from ...writers.image_folders import save_video

        terminal.progress("drawing the frames")
        video = simulated(self.scenario, self.seed)
        with result_folder(self.output.parent, own=()) as staging:
            path = staging / self.output.name
            frames = save_video(path, video.images(), video.t_ns, rate_hz=self.scenario.frame_rate_hz)
        start, stop = video.steady_s
        terminal.print(f"video         {self.output}, {frames} frames")
        terminal.print(f"true rate     {30 / pi * video.rate_rad_s:.6f} rpm from {start:.1f} to {stop:.1f} s")
        terminal.document(
            {
                "video": str(self.output),
                "frames": frames,
                "true_rate_rad_s": video.rate_rad_s,
                "steady_s": video.steady_s,
            }
        )
        return USABLE
