"""Arguments -> a command; each is made from the fields of a dataclass, in the file that does its work."""

import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module

from .._version import __version__
from ..errors import OptionError
from ..options import check_ranges
from .command import Command
from .parsing.line import help_width, parse_line

DESCRIPTION = f"""Calibrate an IMU, alone or with cameras, without mechanical equipment. gnomon {__version__}.

Exit codes: 0 usable, 2 wrong usage, 3 bad input, 4 finished but the verdict says do not use."""
_CLASSES = {
    "imu": (
        "imu.Imu",
        "Calibrate accelerometer and gyroscope from hand-held recordings, or an accelerometer alone from static poses.",
    ),
    "camera": (
        "camera.CameraCommand",
        "Calibrate the lenses of one camera or several, and their relative poses, from views of a board.",
    ),
    "camera-imu": (
        "camera_imu.CameraImu",
        "Calibrate cameras and an IMU that were waved together in front of a board.",
    ),
    "turntable": (
        "turntable.Turntable",
        "Calibrate a gyroscope from recordings on a turntable, such as a record player.",
    ),
    "rate": ("turntable.Rate", "Measure how fast a platter turns, from a video of it."),
    "magnetometer": (
        "magnetometer.Magnetometer",
        "Calibrate hard and soft iron of a magnetometer from one recording in which it was turned by hand.",
    ),
    "noise": (
        "noise.Noise",
        "Identify the noise of an IMU from a long recording at rest: white noise, bias instability, random walk.",
    ),
    "check": ("check.Check", "Say what a recording holds, what is wrong with it, and how to cure that."),
    "plan": (
        "plan.Plan",
        "Predict how well cameras and an IMU would be calibrated by a recording that is still to be made.",
    ),
    "plan-imu": (
        "plan.PlanImu",
        "Predict how well an IMU would be calibrated by a recording with rests that is still to be made.",
    ),
    "target": (
        "target.PrintTarget",
        "Draw a calibration board as PDF and SVG at true scale, with rulers and its target.yaml.",
    ),
    "show": ("show.Show", "Show a calibration as tables with standard deviations; files of other projects without."),
    "apply": (
        "show.Apply",
        "Turn a recording into specific force and angular rate with a calibration; of any length, in little memory.",
    ),
    "convert": (
        "convert.Convert",
        "Write a calibration, gnomon's or another project's, in another format, and say what that format cannot hold.",
    ),
    "compare": (
        "compare.Compare",
        "Compare calibrations of one rig, made by any program: who agrees, who stands out and in what, and "
        "what repeats.",
    ),
    "simulate": (
        "imu.Simulate",
        "Make a recording of a simulated sensor, and its true calibration beside it (truth.yaml).",
    ),
    "simulate-poses": (
        "poses.SimulatePoses",
        "Make an experiment in which a simulated sensor lies still in one attitude after another, and its truth.",
    ),
    "simulate-turntable": (
        "turntable.SimulateTurntable",
        "Make recordings of a simulated sensor on a turntable, and its true calibration beside them (truth.yaml).",
    ),
    "simulate-platter-video": (
        "turntable.SimulatePlatterVideo",
        "Make a video of a simulated platter, as a webcam sees it.",
    ),
    "simulate-magnetometer": (
        "magnetometer.SimulateMagnetometer",
        "Make a recording of a simulated magnetometer turned by hand, and its true calibration beside it (truth.yaml).",
    ),
    "simulate-noise": (
        "noise.SimulateNoise",
        "Make a long recording of a simulated IMU at rest, with noise of known coefficients.",
    ),
    "simulate-cameras": (
        "camera.SimulateCameras",
        "Make a folder with a recording of simulated cameras in front of a board, and its truth (truth.yaml).",
    ),
    "simulate-camera-imu": (
        "camera_imu.SimulateCameraImu",
        "Make a folder with a recording of simulated cameras and an IMU in front of a board, and its truth "
        "(truth.yaml).",
    ),
    "study": (
        "study.Study",
        "Repeat a published experiment many times with simulated sensors, and say whether its claims hold.",
    ),
    "demo": ("imu.Demo", "Calibrate a simulated recording and compare the result with the truth."),
}
"""Name of a command -> where its class is, and the first sentence of its help, which takes no import to show."""


class _Commands(Mapping[str, type[Command]]):
    """The classes of the commands by name; a file is imported when its command is asked for."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, cls = _CLASSES[name][0].partition(".")
        return getattr(import_module(f".{module}", __package__), cls)

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
    name = arguments[0] if arguments else "--help"
    if name == "--version":
        from ..kernel import describe_kernel

        sys.stdout.write(f"gnomon {__version__} ({describe_kernel()})\n")
        raise SystemExit(0)
    if name in ("-h", "--help"):
        sys.stdout.write(_help())
        raise SystemExit(0)
    if name not in _CLASSES:
        raise OptionError(_no_command(name))
    parsed = parse_line(COMMANDS[name], arguments[1:], f"gnomon {name}")
    check_ranges(parsed)
    return parsed


def _help() -> str:
    """Return what can be done, a sentence for each command."""
    width = help_width()
    indent = max(map(len, _CLASSES)) + 4
    lines = [
        textwrap.fill(f"  {name:<{indent - 2}}{text}", width, subsequent_indent=" " * indent, break_on_hyphens=False)
        for name, (_, text) in _CLASSES.items()
    ]
    head = [textwrap.fill(paragraph, width) for paragraph in DESCRIPTION.split("\n\n")]
    blocks = ["usage: gnomon COMMAND [OPTIONS]", *head, "\n".join(["commands:", *lines])]
    return "\n\n".join([*blocks, "gnomon COMMAND --help shows its options; gnomon --version, the version.\n"])


def _no_command(name: str) -> str:
    near = get_close_matches(name, _CLASSES, 1)
    meant = f"Did you mean {near[0]}?" if near else "gnomon --help lists them."
    what = "option before the command" if name.startswith("-") else "command"
    return f"there is no {what} {name}. {meant}"
