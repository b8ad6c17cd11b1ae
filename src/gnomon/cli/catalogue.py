"""Arguments -> a command; each is made from the fields of a dataclass, in the file of `commands` that does its work."""

import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module

from .._version import __version__
from ..errors import OptionError
from ..findings import join_names
from ..options import check_ranges
from .command import Command
from .parsing.line import help_width, parse_line

ABOUT = "Calibrate an IMU, alone or with cameras, without mechanical equipment."
_LAST = "gnomon COMMAND --help shows the options of a command, and examples."
_EXIT_CODES = "Exit codes: 0 usable, 2 wrong usage, 3 bad input, 4 the verdict says no."
_GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "calibrate": {
        "imu": ("imu.Imu", "an IMU that was turned by hand and held still; or static poses"),
        "camera-imu": ("camera_imu.CameraImu", "cameras and an IMU, waved in front of a board"),
        "camera": ("camera.CameraCommand", "lenses and relative poses of cameras, from views of a board"),
        "turntable": ("turntable.Turntable", "a gyroscope on a turntable, such as a record player"),
        "magnetometer": ("magnetometer.Magnetometer", "a magnetometer that was turned by hand"),
        "noise": ("noise.Noise", "the noise of an IMU, from a long recording at rest"),
        "temperature": ("temperature.Temperature", "how an IMU changes with its temperature"),
    },
    "prepare": {
        "live": ("live.Live", "record a sensor with guidance on what to do next"),
        "check": ("check.Check", "what a recording holds, and what is wrong with it"),
        "plan": ("plan.Plan", "how well a recording of cameras and an IMU would calibrate them"),
        "plan-imu": ("plan.PlanImu", "how well a recording with rests would calibrate an IMU"),
        "target": ("target.PrintTarget", "draw a calibration board at true scale, to print"),
        "rate": ("turntable.Rate", "how fast a platter turns, from a video"),
    },
    "use": {
        "show": ("show.Show", "a calibration as tables with standard deviations"),
        "certificate": ("certificate.Certificate", "page one of a result's report as a PDF"),
        "apply": ("show.Apply", "correct a recording with a calibration"),
        "convert": ("convert.Convert", "write a calibration or recording in another format"),
        "compare": ("compare.Compare", "calibrations of one rig, made by any program"),
        "verify": ("verify.Verify", "whether a calibration still holds, by a fresh recording"),
        "batch": ("batch.Batch", "calibrate many devices, a recording each, into a library"),
        "library": ("library.LibraryCommand", "a library of many devices: list, history, chart, report, export"),
    },
    "try": {
        "demo": ("simulated_imu.Demo", "calibrate a simulated recording, and compare it with the truth"),
        "simulate imu": ("simulated_imu.Simulate", "a recording by hand, and its truth"),
        "simulate poses": ("poses.SimulatePoses", "one static attitude after another"),
        "simulate turntable": ("turntable.SimulateTurntable", "recordings on a turntable"),
        "simulate platter-video": ("turntable.SimulatePlatterVideo", "a video of a turntable"),
        "simulate magnetometer": ("magnetometer.SimulateMagnetometer", "a magnetometer turned by hand"),
        "simulate noise": ("noise.SimulateNoise", "a long recording at rest"),
        "simulate temperature": (
            "temperature.SimulateTemperature",
            "an IMU over its temperature, with its thermometer",
        ),
        "simulate cameras": ("camera.SimulateCameras", "cameras in front of a board"),
        "simulate camera-imu": ("camera_imu.SimulateCameraImu", "cameras and an IMU in front of a board"),
        "simulate room": ("camera_imu.SimulateRoom", "a camera and an IMU in a room, without a board"),
        "study": ("study.Study", "repeat a published experiment many times"),
        "completion": ("completion.Completion", "complete commands and options with the tab key"),
    },
}
"""Name of a command -> where its class is, and what it is about, which takes no import to show."""
_CLASSES = {name: place for group in _GROUPS.values() for name, (place, _) in group.items()}
SIMULATED = [name.partition(" ")[2] for name in _CLASSES if " " in name]
"""What can be simulated."""


_MEANT = {
    **dict.fromkeys(("calibrate", "calib", "cal"), "imu, camera-imu, camera, turntable, magnetometer or noise"),
    "accel": "imu", "accelerometer": "imu", "gyro": "imu or turntable", "gyroscope": "imu or turntable",
    "mag": "magnetometer", "compass": "magnetometer", "allan": "noise", "lens": "camera", "intrinsics": "camera",
    "extrinsics": "camera-imu", "stereo": "camera", "board": "target", "record": "live", "read": "check",
    "info": "check", "validate": "verify or check", "export": "convert", "correct": "apply", "diff": "compare",
    "report": "show or certificate", "print": "show", "generate": "simulate",
}  # fmt: skip
"""What other programs and people call it -> the command."""


class _Commands(Mapping[str, type[Command]]):
    """The classes of the commands by name; a file is imported when its command is asked for."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, cls = _CLASSES[name].partition(".")
        return getattr(import_module(f".commands.{module}", __package__), cls)

    def __iter__(self) -> Iterator[str]:
        return iter(_CLASSES)

    def __len__(self) -> int:
        return len(_CLASSES)


COMMANDS: Mapping[str, type[Command]] = _Commands()


def parse_command(arguments: Sequence[str]) -> Command:
    """Return the command that the arguments ask for.

    Raises
    ------
    SystemExit
        After printing help (0), or what is wrong with the arguments (2).
    OptionError
        If the value of an option makes no sense.
    FormatError
        If a file of options cannot be read.
    """
    words = list(arguments) or ["--help"]
    if words[0] == "help":  # gnomon help imu, as of git
        words = [*words[1:], "--help"]
    if words[0] in ("-V", "--version", "version"):
        from ..kernel import describe_kernel

        sys.stdout.write(f"gnomon {__version__} ({describe_kernel()})\n")
        raise SystemExit(0)
    if words[0] in ("-h", "--help"):
        sys.stdout.write(_help())
        raise SystemExit(0)
    if words in (["simulate", "--help"], ["simulate", "-h"]):
        sys.stdout.write(_simulate_help())
        raise SystemExit(0)
    name, words = _split_name(words)
    parsed = parse_line(COMMANDS[name], words, f"gnomon {name}")
    check_ranges(parsed)
    return parsed


def _split_name(words: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the name of the command, of one word or two, and the words after it."""
    first, *others = words
    kind = first.removeprefix("simulate-") if first.startswith("simulate-") else ""
    if first == "simulate":
        is_kind = bool(others) and not others[0].startswith("-")
        kind, others = (others[0], others[1:]) if is_kind else ("imu", others)
    if kind in SIMULATED and [*words] != ["simulate"]:
        return f"simulate {kind}", others
    if kind:
        near = [] if kind in SIMULATED else get_close_matches(kind, SIMULATED, 1)
        meant = f" Did you mean {near[0]}?" if near else ""
        raise OptionError(f"gnomon simulate KIND: KIND is one of {join_names(SIMULATED, 'or')}.{meant}")
    if first in _CLASSES:
        return first, others
    if first.startswith("-"):
        near = get_close_matches(first, ["--version", "--help"], 1)
        meant = f"Did you mean {near[0]}?" if near else "Options stand behind it; gnomon COMMAND --help lists them."
        raise OptionError(f"there is no option {first} before the command. {meant}")
    near = get_close_matches(first, _CLASSES, 1, cutoff=0.65)
    meant = _MEANT.get(first.lower()) or next(iter(near), None)
    raise OptionError(
        f"there is no command {first}. {f'Did you mean {meant}?' if meant else 'gnomon --help lists them.'}"
    )


def _simulate_help() -> str:
    """Return what can be simulated, a line for each kind."""
    kinds = [f"  {name.partition(' ')[2]:<15}{about}" for name, (_, about) in _GROUPS["try"].items() if " " in name]
    last = ["examples:", "  gnomon simulate imu -o recording.npz", "  gnomon simulate camera-imu -o rig"]
    last += ["", "gnomon simulate KIND --help shows the options of a kind, and more examples."]
    return "\n".join(["usage: gnomon simulate KIND [OPTIONS]", "", "kinds:", *kinds, "", *last]) + "\n"


def _help() -> str:
    """Return what can be done, a line for each command."""
    width, indent = help_width(), max(len(name) for name in _CLASSES if " " not in name) + 4
    blocks = ["usage: gnomon COMMAND [OPTIONS]", f"{ABOUT} gnomon {__version__}"]
    for title, group in _GROUPS.items():
        lines = [(name, about) for name, (_, about) in group.items() if " " not in name]
        if title == "try":
            lines.insert(1, ("simulate KIND", f"a recording: {join_names(SIMULATED, 'or')}"))
        filled = [
            textwrap.fill(f"  {name:<{indent - 2}}{about}", width, subsequent_indent=" " * indent)
            for name, about in lines
        ]
        blocks.append("\n".join([f"{title}:", *filled]))
    return "\n\n".join([*blocks, _LAST + "\n" + textwrap.fill(_EXIT_CODES, width)]) + "\n"
