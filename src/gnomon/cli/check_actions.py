"""What `gnomon check` does: an IMU alone, corners, or images, each with what is known of it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OptionError
from . import commands
from .results import UNUSABLE, USABLE, say_assumptions
from .terminal import Terminal
from .topics import topics_of

if TYPE_CHECKING:
    from ..assess.rig_doctor import RigLook
    from ..findings import Finding
    from ..images import ImageRecording
    from ..models.target import Target
    from ..readers.rig.kalibr_camchain import CameraInput
    from ..readers.rig.kalibr_imu_input import ImuInput
    from ..recording import ImuSamples, Integers, Recording, TriadSamples

_FILES = {"cam": "camchain.yaml", "imu": "imu.yaml", "target": "target.yaml"}
"""Option -> Kalibr's file that is taken from the recording's folder."""


def check(command: commands.Check, terminal: Terminal) -> int:
    """Look at a recording, say what was found, and return the exit code."""
    from ..readers.images.image_recording import holds_images
    from ..readers.rig.camera_folder import holds_corners

    path = command.recording.path
    folder = path / "mav0" if (path / "mav0").is_dir() else path
    if holds_images(path):
        return _check_images(command, terminal)
    if folder.is_dir() and holds_corners(folder):
        return _check_corners(command, terminal)
    stated = [
        f"--{name.replace('_', '-')}"
        for name in ("cam", "imu", "target", "topics", "imu_table")
        if getattr(command, name)
    ]
    if stated and path.exists():
        raise OptionError(
            f"{path}: {', '.join(stated)} {'is' if len(stated) == 1 else 'are'} for recordings with cameras, and there "
            "is none in this one."
        )
    return _check_imu(command, terminal)


# ---- an IMU alone ----


def _check_imu(command: commands.Check, terminal: Terminal) -> int:
    from ..assess.doctor import check
    from ..assess.magnetometer_checks import check_magnetometers
    from ..readers import read

    source = command.recording
    recording = read(*source.paths, columns=source.columns, rate_hz=source.rate, units=source.units)
    inertial = {name: imu for name, imu in recording.imus.items() if imu.magnetometer is None or len(imu.accelerometer)}
    findings = [*check(replace(recording, imus=inertial)), *check_magnetometers(recording)]
    return _told(findings, recording.imus, {}, recording.assumptions, terminal)


# ---- corners ----


def _check_corners(command: commands.Check, terminal: Terminal) -> int:
    from ..calibrate import read_camera_imu, read_camera_views
    from ..readers.rig.camera_folder import holds_imu, recording_folder

    known = _Known.of(command)
    if known.files["cam"] is None or known.files["target"] is None:
        return _check_corner_stamps(command, known, terminal)
    files: dict[str, Any] = dict(known.files)
    path, units = command.recording.path, command.recording.units
    if holds_imu(recording_folder(path)):
        recording, target = read_camera_imu(path, **files, units=units)
    else:
        recording, target = read_camera_views(path, cam=files["cam"], target=files["target"], units=units)
    from ..assess.rig_doctor import check_corners

    findings = check_corners(recording, target)
    return _told(findings, recording.imus, _corner_entries(recording), (*known.taken, *recording.assumptions), terminal)


def _check_corner_stamps(command: commands.Check, known: "_Known", terminal: Terminal) -> int:
    from ..assess.rig_doctor import check_imus, check_stamps_together
    from ..readers.rig.corner_stamps import read_corner_stamps

    found = read_corner_stamps(command.recording.path, command.recording.units)
    findings = [*check_imus(found.imus), *check_stamps_together(found.frames, found.imus, {})]
    missing = " and ".join(f"--{name}" for name in ("cam", "target") if known.files[name] is None)
    assumptions = (*known.taken, *found.assumptions, f"without {missing} only stamps and samples are looked at.")
    cameras = {name: _entry("frames", t, corners=found.corners[name]) for name, t in found.frames.items()}
    return _told(findings, found.imus, cameras, assumptions, terminal)


def _corner_entries(recording: "Recording") -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {}
    for name, frames in recording.cameras.items():
        width, height = frames.camera.resolution
        entries[name] = _entry("frames", frames.t_ns, corners=len(frames.frame), width=width, height=height)
    return entries


# ---- images ----


def _check_images(command: commands.Check, terminal: Terminal) -> int:
    from ..assess.rig_doctor import check_rig
    from ..readers.images.image_recording import open_images

    known = _Known.of(command)
    terminal.progress("opening the recording")
    recording = open_images(
        command.recording.path,
        topics=topics_of(command.topics),
        suggested=known.suggested(),
        units=command.recording.units,
        imu_table=command.imu_table,
        need_imu=False,
    )
    target = known.target()
    cameras = {name: entry.camera for name, entry in known.cameras().items()}
    look = check_rig(recording, target, cameras, progress=terminal.progress)
    terminal.close()
    assumptions = (*known.taken, *known.notes, *recording.assumptions)
    return _told(look.findings, recording.imus, _image_entries(recording, look), assumptions, terminal)


def _image_entries(recording: "ImageRecording", look: "RigLook") -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {}
    for name, found in look.streams.items():
        width, height = found.size or (None, None)
        more = {"board_seen": found.seen} if found.views else {}
        topic = {"topic": recording.streams[name].topic} if recording.streams[name].topic else {}
        entries[name] = _entry(
            "images", found.t_ns, width=width, height=height, looked_at=len(found.looks), **more, **topic
        )
    return entries


# ---- what is known beforehand ----


class _Known:
    """Kalibr's files beside a recording, or as they were named; read when they are asked for."""

    def __init__(self, files: Mapping[str, Any], taken: tuple[str, ...]) -> None:
        self.files = files
        self.taken = taken
        self.notes: list[str] = []
        self._cameras: dict[str, CameraInput] | None = None

    @classmethod
    def of(cls, command: commands.Check) -> "_Known":
        """Return the files that are stated, or lie beside the recording."""
        path = command.recording.path
        folder = path if path.is_dir() else path.parent
        files: dict[str, Any] = {}
        found: list[str] = []
        for option, name in _FILES.items():
            stated: Path | tuple[Path, ...] | None = getattr(command, option) or None
            lies_there = stated is None and (folder / name).is_file()
            files[option] = folder / name if lies_there else stated
            found += [name] if lies_there else []
        listed = " and ".join(part for part in (", ".join(found[:-1]), *found[-1:]) if part)
        return cls(
            files, (f"{listed} in the recording's folder {'is' if len(found) == 1 else 'are'} used.",) * bool(found)
        )

    def cameras(self) -> "dict[str, CameraInput]":
        """Return what camchain.yaml says, or nothing."""
        from ..readers.rig.sensor_inputs import read_cameras

        if self._cameras is None:
            cam = self.files["cam"]
            self._cameras = {} if cam is None else read_cameras(cam, self.notes)
        return self._cameras

    def imus(self) -> "dict[str, ImuInput]":
        """Return what imu.yaml says, or nothing."""
        from ..readers.rig.sensor_inputs import read_imus

        return read_imus(self.files["imu"], self.notes)

    def target(self) -> "Target | None":
        """Return the board, where one is described."""
        from ..readers.rig.kalibr_target import read_target

        target = self.files["target"]
        return None if target is None else read_target(target, self.notes)

    def suggested(self) -> dict[str, str]:
        """Return the topics that Kalibr's files name."""
        cameras = {name: entry.camera.topic for name, entry in self.cameras().items()}
        imus = {name: entry.topic for name, entry in self.imus().items()}
        return {name: topic for name, topic in (cameras | imus).items() if topic}


# ---- what is said ----


def _entry(what: str, t_ns: "Integers", **more: Any) -> dict[str, Any]:
    import numpy as np

    steps = np.diff(np.unique(t_ns)).astype(np.float64)
    return {
        what: len(t_ns),
        "duration_s": float(np.ptp(t_ns)) * 1e-9 if len(t_ns) else 0.0,
        "rate_hz": float(1e9 / np.median(steps)) if len(steps) else float("nan"),
        **more,
    }


def _told(
    findings: "Sequence[Finding]",
    imus: "Mapping[str, ImuSamples]",
    cameras: Mapping[str, Mapping[str, Any]],
    assumptions: Sequence[str],
    terminal: Terminal,
) -> int:
    """Say what a recording holds and what was found, and return the exit code."""
    code = UNUSABLE if any(finding.severity == "problem" for finding in findings) else USABLE
    say_assumptions(assumptions, terminal)
    for name, entry in cameras.items():
        terminal.say(_camera_line(name, entry))
    for name, imu in imus.items():
        for triad, samples in _triads(imu).items():
            topic = f", topic {imu.topic}" if imu.topic else ""
            terminal.say(
                f"{name} {triad:<13} {len(samples)} samples, {samples.duration_s:.1f} s at {samples.rate_hz:.6g} Hz, "
                f"in {samples.unit}{topic}"
            )
    _say_findings(findings, terminal)
    document = {
        "exit_code": code,
        "assumptions": list(assumptions),
        "imus": {
            name: {
                triad: {
                    "samples": len(samples),
                    "rate_hz": samples.rate_hz,
                    "duration_s": samples.duration_s,
                    "unit": samples.unit,
                }
                for triad, samples in _triads(imu).items()
            }
            for name, imu in imus.items()
        },
        **({"cameras": cameras} if cameras else {}),
        "findings": [asdict(finding) for finding in findings],
    }
    terminal.document(document)
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


def _say_findings(findings: "Sequence[Finding]", terminal: Terminal) -> None:
    from . import summary

    styles = {"problem": "red", "warning": "yellow", "info": "", "good": "green"}
    for severity, style in styles.items():
        chosen = [finding for finding in findings if finding.severity == severity]
        if chosen:
            terminal.say("\n" + "\n".join(summary.advice(chosen, good=True)), style)
