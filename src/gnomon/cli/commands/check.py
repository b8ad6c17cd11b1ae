"""The command that looks at a recording: an IMU alone, corners or images, each with what is known of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...errors import OptionError
from ..command import CamFile, Command, FileOption, Flat, ImuFiles, Input, Topics, topics_of
from ..files import files_beside
from ..results import UNUSABLE, USABLE, finding_lines, print_assumptions
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...assess.checks.rig_doctor import RigSummary
    from ...findings import Finding, Severity
    from ...recording import ImuSamples, Integers, Recording, TriadSamples
    from ...recording.recording import ImageRecording

_STYLES: "dict[Severity, str]" = {"problem": "red", "warning": "yellow", "info": "", "good": "green"}


@dataclass(frozen=True, kw_only=True)
class Check(Command):
    """Say what a recording holds, what is wrong with it, and how to cure that.

    A recording of an IMU alone is judged as one with rests; one with cameras (a bag, a folder of images or corners, a
    video) as one that was waved in front of a board; neither lens nor board need be known.

    Examples
    --------
    $ gnomon check recording.csv
    """

    recording: Annotated[Input, Flat]
    cam: CamFile = None
    """Kalibr's file of the cameras (default: camchain.yaml in the recording's folder, where there is one)."""
    imu: ImuFiles = ()
    """Kalibr's file of the IMU's noise; of several IMUs keyed imu0, imu1, ..., or this option once for each of them
    (default: imu.yaml in the recording's folder, where there is one)."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board, which is then sought in some of the images (default: target.yaml in the recording's
    folder, where there is one)."""
    topics: Topics = ()
    """Topics of a bag, such as cam0=/left/image_raw imu0=/imu/data; guessed where it is clear."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where it is not in the recording of the cameras."""

    def __post_init__(self) -> None:
        topics_of(self.topics)

    def run(self, terminal: Terminal) -> int:
        """Look at a recording, say what was found, and return the exit code."""
        from ...readers.images.image_recording import holds_images
        from ...readers.rig.folder import holds_corners

        path = self.recording.path
        folder = path / "mav0" if (path / "mav0").is_dir() else path
        if holds_images(path) and not _is_bag_of_imu(path):
            return _check_images(self, terminal)
        if folder.is_dir() and holds_corners(folder):
            return _check_corners(self, terminal)
        named = [name for name in ("cam", "imu", "target", "topics", "imu_table") if getattr(self, name)]
        if named and path.exists():
            stated = ", ".join(f"--{name.replace('_', '-')}" for name in named)
            raise OptionError(
                f"{path}: {stated} {'is' if len(named) == 1 else 'are'} for recordings with cameras, and there is none "
                "in this one."
            )
        return _check_imu(self, terminal)


def _is_bag_of_imu(path: Path) -> bool:
    from ...readers.devices.device_log import is_imu_bag

    if not is_imu_bag(path):
        return False
    from ...readers.bags.bag import bag_holds_only_imu

    return bag_holds_only_imu(path)


def _check_imu(command: Check, terminal: Terminal) -> int:
    from ...assess.checks.doctor import check, check_magnetometers
    from ...readers.recordings import read

    source = command.recording
    recording = read(*source.paths, **source.table)
    inertial = {name: imu for name, imu in recording.imus.items() if imu.magnetometer is None or len(imu.accelerometer)}
    findings = [*check(replace(recording, imus=inertial)), *check_magnetometers(recording)]
    kind = _calibration_of(findings, field=any(imu.magnetometer is not None for imu in recording.imus.values()))
    following = (kind, *source.paths, *_table_words(source)) if kind else ()
    return _print_check(findings, recording.imus, {}, recording.assumptions, terminal, following=following)


def _calibration_of(findings: "Sequence[Finding]", *, field: bool) -> str | None:
    """Return the command that a recording of an IMU, perhaps with a magnetometer (field), is good for."""
    rests = {finding.code: finding.severity for finding in findings if finding.code in ("attitudes", "always-static")}
    if "always-static" in rests:
        return "noise"
    if field and rests.get("attitudes") != "good":
        return "magnetometer"
    return "imu" if rests else None


def _table_words(source: Input) -> list[str]:
    """Return the options that say of a table what it does not say itself, as they were stated."""
    rate = None if source.rate is None else f"{source.rate:.12g}"
    stated = {"--columns": source.columns, "--rate": rate, "--units": source.units}
    return [word for name, value in stated.items() if value is not None for word in (name, value)]


def _files(command: Check) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return Kalibr's files as they are stated or lie beside the recording, and a sentence on the latter."""
    return files_beside(command.recording.path, {"cam": command.cam, "imu": command.imu, "target": command.target})


def _check_corners(command: Check, terminal: Terminal) -> int:
    from ...calibrate.steps.camera_imu_reading import read_camera_imu
    from ...calibrate.steps.camera_reading import read_camera_views
    from ...readers.rig.folder import folder_holds_imu, recording_folder

    files, taken = _files(command)
    if files["cam"] is None or files["target"] is None:
        return _check_corner_stamps(command, files, taken, terminal)
    path, units = command.recording.path, command.recording.units
    if folder_holds_imu(recording_folder(path)):
        recording, target = read_camera_imu(path, **files, units=units)
    else:
        recording, target = read_camera_views(path, cam=files["cam"], target=files["target"], units=units)
    from ...assess.checks.rig_doctor import check_corners

    findings = check_corners(recording, target)
    assumptions, following = (*taken, *recording.assumptions), _following(command, files, imu=bool(recording.imus))
    return _print_check(
        findings, recording.imus, _corner_entries(recording), assumptions, terminal, following=following
    )


def _following(command: Check, files: Mapping[str, Any], *, imu: bool) -> tuple[str | Path, ...]:
    """Return the command that goes on from a recording with cameras: their lenses first, where nothing tells them."""
    from ...readers.images.image_recording import tells_no_lens

    path = command.recording.path
    where = ["--topics", *command.topics] if command.topics else []
    board = ["--target", files["target"] if command.target else "TARGET"]
    if files["target"] is not None and command.target is None:
        board = []  # it lies beside the recording
    if not imu or (files["cam"] is None and tells_no_lens(path)):
        return ("camera", path, *board, *where)
    stated = [word for name in ("cam", "imu") if getattr(command, name) for word in _words(name, files[name])]
    table = ["--imu-table", command.imu_table] if command.imu_table is not None else []
    return ("camera-imu", path, *stated, *board, *where, *table)


def _words(name: str, value: Any) -> list[str | Path]:
    paths = value if isinstance(value, tuple) else (value,)
    return [word for path in paths for word in (f"--{name}", path)]


def _check_corner_stamps(command: Check, files: Mapping[str, Any], taken: tuple[str, ...], terminal: Terminal) -> int:
    from ...assess.checks.rig_doctor import check_imus, check_stamps_together
    from ...readers.rig.folder import read_corner_stamps

    found = read_corner_stamps(command.recording.path, command.recording.units)
    findings = [*check_imus(found.imus), *check_stamps_together(found.frames, found.imus, {})]
    missing = " and ".join(f"--{name}" for name in ("cam", "target") if files[name] is None)
    assumptions = (*taken, *found.assumptions, f"without {missing} only timestamps and samples are looked at.")
    cameras = {name: _entry("frames", t, corners=found.corners[name]) for name, t in found.frames.items()}
    following = _following(command, files, imu=bool(found.imus))
    return _print_check(findings, found.imus, cameras, assumptions, terminal, following=following)


def _corner_entries(recording: "Recording") -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {}
    for name, frames in recording.cameras.items():
        width, height = frames.camera.resolution
        entries[name] = _entry("frames", frames.t_ns, corners=len(frames.frame), width=width, height=height)
    return entries


def _check_images(command: Check, terminal: Terminal) -> int:
    from ...assess.checks.rig_doctor import check_rig
    from ...formats.kalibr.target import read_target
    from ...formats.sensor_inputs import read_cameras, read_imus
    from ...readers.images.image_recording import open_images

    files, taken = _files(command)
    notes: list[str] = []
    cameras = {} if files["cam"] is None else read_cameras(files["cam"], notes)
    topics = {name: entry.camera.topic for name, entry in cameras.items()}
    topics |= {name: entry.topic for name, entry in read_imus(files["imu"], notes).items()}
    terminal.progress("opening the recording")
    recording = open_images(
        command.recording.path,
        topics=topics_of(command.topics),
        suggested={name: topic for name, topic in topics.items() if topic},
        units=command.recording.units,
        imu_table=command.imu_table,
        need_imu=False,
    )
    target = None if files["target"] is None else read_target(files["target"], notes)
    lenses = {name: entry.camera for name, entry in cameras.items()}
    look = check_rig(recording, target, lenses, progress=terminal.progress)
    assumptions = (*taken, *notes, *recording.assumptions)
    entries, following = _image_entries(recording, look), _following(command, files, imu=bool(recording.imus))
    return _print_check(look.findings, recording.imus, entries, assumptions, terminal, following=following)


def _image_entries(recording: "ImageRecording", look: "RigSummary") -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {}
    for name, found in look.streams.items():
        width, height = found.size or (None, None)
        more = {"board_seen": found.seen} if found.views else {}
        topic = {"topic": recording.streams[name].topic} if recording.streams[name].topic else {}
        entries[name] = _entry(
            "images", found.t_ns, width=width, height=height, looked_at=len(found.looks), **more, **topic
        )
    return entries


def _entry(what: str, t_ns: "Integers", **more: Any) -> dict[str, Any]:
    import numpy as np

    steps = np.diff(np.unique(t_ns)).astype(np.float64)
    return {
        what: len(t_ns),
        "duration_s": float(np.ptp(t_ns)) * 1e-9 if len(t_ns) else 0.0,
        "rate_hz": float(1e9 / np.median(steps)) if len(steps) else float("nan"),
        **more,
    }


def _print_check(
    findings: "Sequence[Finding]",
    imus: "Mapping[str, ImuSamples]",
    cameras: Mapping[str, Mapping[str, Any]],
    assumptions: Sequence[str],
    terminal: Terminal,
    *,
    following: Sequence[str | Path] = (),
) -> int:
    """Print what a recording holds, what was found, and which command follows; return the exit code."""
    problems = {finding.code for finding in findings if finding.severity == "problem"}
    code = UNUSABLE if problems else USABLE
    print_assumptions(assumptions, terminal)
    for name, entry in cameras.items():
        terminal.print(_camera_line(name, entry))
    for name, imu in imus.items():
        for triad, samples in _triads(imu).items():
            if not len(samples):
                continue
            topic = f", topic {imu.topic}" if imu.topic else ""
            terminal.print(
                f"{name} {triad:<13} {len(samples)} samples, {samples.duration_s:.1f} s at {samples.rate_hz:.6g} Hz, "
                f"in {samples.unit}{topic}"
            )
    told = [one for one in findings if (one.severity, one.code) != ("good", "rate")]
    for severity, style in _STYLES.items():
        if lines := list(finding_lines(told, good=True, severity=severity)):
            terminal.print("\n" + "\n".join(lines), style)
    if following and problems <= {"always-static"}:  # which is what noise asks for
        terminal.print("")
        terminal.propose(*following)
    numbers = ("samples", "rate_hz", "duration_s", "unit")
    described = {
        name: {
            triad: dict(zip(numbers, (len(one), one.rate_hz, one.duration_s, one.unit), strict=True))
            for triad, one in _triads(imu).items()
        }
        for name, imu in imus.items()
    }
    terminal.document(
        {
            "exit_code": code,
            "assumptions": list(assumptions),
            "imus": described,
            **({"cameras": cameras} if cameras else {}),
            "findings": findings,
        }
    )
    return code


def _triads(imu: "ImuSamples") -> "dict[str, TriadSamples]":
    """Return the triads of an IMU; the magnetometer only where there is one, and the others unless it is alone."""
    inertial = {"accelerometer": imu.accelerometer, "gyroscope": imu.gyroscope}
    if imu.magnetometer is None:
        return inertial
    return {name: samples for name, samples in inertial.items() if len(samples)} | {"magnetometer": imu.magnetometer}


def _camera_line(name: str, entry: Mapping[str, Any]) -> str:
    what = "images" if "images" in entry else "frames"
    size = f" of {entry['width']} x {entry['height']} px" if entry.get("width") else ""
    parts = [f"{entry[what]} {what}{size}, {entry['duration_s']:.1f} s at {entry['rate_hz']:.4g} Hz"]
    if "corners" in entry:
        parts.append(f"{entry['corners']} corners")
    if "looked_at" in entry:
        seen = f", the board in {entry['board_seen']} of them" if "board_seen" in entry else ""
        parts.append(f"{entry['looked_at']} looked at{seen}")
    if "topic" in entry:
        parts.append(f"topic {entry['topic']}")
    return f"{name:<18} {', '.join(parts)}"
