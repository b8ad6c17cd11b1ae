"""Write the generated pages of the reference: docs/cli.md, docs/python.md and docs/symptoms.md.

    python docs/make_reference.py

All follow from the code: the commands from their dataclasses, the Python names from `gnomon.__all__` and their
docstrings, the symptoms from the catalogue of findings. A test fails where the pages are older than the code.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import gnomon
from gnomon.cli.arguments import Entry
from gnomon.cli.command import COMMANDS
from gnomon.cli.help import describe_command
from gnomon.findings import read_catalogue
from gnomon.options import (
    CameraImuOptions,
    CameraOptions,
    FrameSelection,
    ImuOptions,
    MagnetometerOptions,
    NoiseOptions,
    TurntableOptions,
)
from gnomon.results.result import Plotted
from gnomon.simulate import (
    CameraImuPlan,
    CameraImuScenario,
    CamerasScenario,
    FieldScenario,
    ImuPlan,
    PoseScenario,
    Scenario,
    TurntableScenario,
)

DOCS = Path(__file__).parent
GENERATED = "<!-- Made by docs/make_reference.py; do not edit. -->"

_CLI_HEAD = """\
# Command line

`gnomon COMMAND --help` says the same. `python -m gnomon` is the same program; `gnomon --version` prints its version
and whether the compiled kernel is used.
Results go to standard output, progress and errors to standard error. Tedaldi 2014, Krebs and Angrisano are in the
[bibliography](theory.md#bibliography).

| exit code | meaning |
|---|---|
| 0 | finished, and usable (verdict pass or warn) |
| 2 | wrong usage: an option that does not exist or makes no sense |
| 3 | bad input, or a place that cannot be written; nothing was written; for `verify`: the recording cannot tell |
| 4 | finished, but the verdict says do not use; for `check`: a problem was found; \
for `compare`: two calibrations contradict each other; for `verify`: the calibration has moved; \
for `plan`, `plan-imu`: such a recording would not do |
| 1 | a bug in gnomon (please report it; `GNOMON_DEBUG=1` shows where) |
| 130, 143, 129 | interrupted (Ctrl-C), asked to end (SIGTERM), terminal closed (SIGHUP); nothing half-written is left |
"""

_PYTHON_HEAD = """\
# Python

Everything public is in the package `gnomon`; nothing is imported before it is used. Values are frozen dataclasses whose
arrays are read-only. Arrays are float64 with samples first, `(n, 3)`. The command line only wraps these names: its
options are the fields of `ImuOptions` and of the other classes of options and scenarios ([cli.md](cli.md) describes
each), and the names of parameters are the paths in [calibration.yaml](files.md#calibrationyaml).
"""

_COMMAND_OF = {
    ImuOptions: "imu",
    CameraImuOptions: "camera-imu",
    CameraOptions: "camera",
    FrameSelection: "camera-imu",
    TurntableOptions: "turntable",
    MagnetometerOptions: "magnetometer",
    NoiseOptions: "noise",
    Scenario: "simulate imu",
    CameraImuScenario: "simulate camera-imu",
    CamerasScenario: "simulate cameras",
    PoseScenario: "simulate poses",
    TurntableScenario: "simulate turntable",
    FieldScenario: "simulate magnetometer",
    CameraImuPlan: "plan",
    ImuPlan: "plan-imu",
}
"""Options -> the command whose help describes each of them."""

_SECTIONS = {
    "What one does": (
        "read",
        "read_camera_imu",
        "read_camera_views",
        "read_turntable",
        "check",
        "calibrate_imu",
        "calibrate_camera_imu",
        "calibrate_cameras",
        "calibrate_temperature",
        "calibrate_turntable",
        "rate_from_video",
        "calibrate_magnetometer",
        "identify_noise",
        "judge",
        "plan",
        "read_hardware",
        "save",
        "save_camera_imu_files",
        "save_camera_files",
        "save_noise",
        "load",
        "load_noise",
        "load_foreign",
        "convert",
        "compare",
        "verify",
        "write_report",
        "write_noise_report",
        "write_comparison_report",
        "write_verification_report",
        "simulate",
        "simulate_camera_imu",
        "simulate_cameras",
        "simulate_poses",
        "simulate_turntable",
        "simulate_magnetometer",
    ),
    "What one chooses": (
        "ImuOptions",
        "CameraImuOptions",
        "CameraOptions",
        "FrameSelection",
        "TurntableOptions",
        "StatedRate",
        "MagnetometerOptions",
        "NoiseOptions",
        "Scenario",
        "CameraImuScenario",
        "CamerasScenario",
        "PoseScenario",
        "TurntableScenario",
        "FieldScenario",
        "CameraImuPlan",
        "ImuPlan",
        "Use",
        "Units",
    ),
    "What was measured": ("Recording", "ImuSamples", "TriadSamples", "Poses", "CameraFrames"),
    "What is known beforehand": ("Target", "Camera", "ImuNoise"),
    "What was learned": (
        "Result",
        "Calibration",
        "ImuCalibration",
        "AccelerometerCalibration",
        "GyroscopeCalibration",
        "MagnetometerCalibration",
        "CameraCalibration",
        "ForeignCalibration",
        "SensorNoise",
        "NoiseResult",
        "PlanResult",
        "Comparison",
        "Verification",
        "PlatterRate",
        "Covariance",
        "Finding",
        "Loss",
    ),
    "What can go wrong": (
        "GnomonError",
        "RecordingError",
        "DetectionError",
        "OptionError",
        "InitialisationError",
        "SolveError",
        "FormatError",
        "OutputError",
    ),
}


def main() -> None:
    """Write both pages."""
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding="utf-8", newline="\n")


def pages() -> dict[str, str]:
    """Return the text of every generated page by its name."""
    return {"cli.md": _cli_page(), "python.md": _python_page(), "symptoms.md": _symptoms_page()}


def _symptoms_page() -> str:
    parts = [GENERATED]
    for entry in read_catalogue():
        if "section" in entry:
            parts.append(f"\n## {entry['section']}\n")
        if "page" in entry or "text" in entry:
            text = entry.get("page", entry.get("text", ""))
            parts.append(_wrapped(text) if text.startswith("- ") else f"\n{text}\n")
        if "when" in entry:
            codes = [entry["code"].partition("/")[0], *entry.get("together", [])]
            names = ", ".join(f'<a\0id="code-{code}"></a>**`{code}`**' for code in codes)
            beyond = "" if entry.get("in_sigmas", True) else "; *not in the sigmas*"
            item = _wrapped(f"- {names} ({entry['when']}{beyond}): {entry['explained']}")
            parts.append(item.replace("\0", " "))  # no line ends within a tag
    return re.sub("\n{3,}", "\n\n", "\n".join(parts)).strip("\n") + "\n"


def _wrapped(item: str) -> str:
    return textwrap.fill(item, 120, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def _cli_page() -> str:
    parts = [GENERATED, _CLI_HEAD]
    for name, command in COMMANDS.items():
        described = describe_command(command, f"gnomon {name}")
        parts += [f"## gnomon {name}", f"```text\n{described.usage}\n```", *described.about]
        parts.append("For example:\n\n```text\n" + "\n".join(described.examples) + "\n```")
        rows = (_row(entry, meaning, default) for entry, meaning, default in described.rows)
        parts.append("| argument | meaning | default |\n|---|---|---|\n" + "\n".join(rows))
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _row(entry: Entry, meaning: str, default: str) -> str:
    values = "" if entry.kind is bool else f" {entry.metavar}{'' if entry.values_each else ' ...'}"
    names = [entry.called + values] if entry.argument.positional else [name + values for name in entry.names]
    written = ", ".join(f"`{name}`" for name in names)
    shown = (
        "required" if entry.default is MISSING and not entry.argument.positional else f"`{default}`" if default else ""
    )
    return "| " + " | ".join(text.replace("|", "\\|") for text in (written, meaning, shown)) + " |"


def _definition(thing: Any) -> Any:
    return ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]


def _paragraphs(doc: str) -> str:
    return "\n\n".join(" ".join(part.split()) for part in inspect.cleandoc(doc).split("\n\n"))


def _python_page() -> str:
    parts = [GENERATED, _PYTHON_HEAD]
    for title, names in _SECTIONS.items():
        parts.append(f"## {title}")
        for name in names:
            thing = getattr(gnomon, name)
            parts += [f"### {name}", *_described(name, thing)]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _described(name: str, thing: Any) -> Iterator[str]:
    if inspect.isclass(thing) and issubclass(thing, Exception):
        base = thing.__mro__[1].__name__
        yield f"{_paragraphs(thing.__doc__ or '')} (a kind of `{base}`)"
        return
    if not inspect.isclass(thing):
        yield _block(f"gnomon.{name}{_signature(thing)}", thing.__doc__)
        return
    yield _block(f"gnomon.{name}", thing.__doc__)
    if is_dataclass(thing):
        yield from _fields_line(thing)
    shared = Plotted.__dict__ if issubclass(thing, Plotted) else {}
    for member, function in {**vars(thing), **shared}.items():
        if member.startswith("_") or not hasattr(function, "__doc__") or not _is_own(function):
            continue
        bare = getattr(function, "fget", None) or getattr(function, "__func__", function)
        signature = "" if isinstance(function, property) else _signature(bare)
        yield _block(f"{name}.{member}{signature}", bare.__doc__)


def _fields_line(thing: Any) -> Iterator[str]:
    """Yield a line with the fields that the docstring does not describe."""
    command = _COMMAND_OF.get(thing)
    described = (
        f", each described under [gnomon {command}](cli.md#gnomon-{command.replace(' ', '-')})" if command else ""
    )
    attributes = (thing.__doc__ or "").partition("Attributes\n")[2]
    names = [field.name for field in fields(thing) if not re.search(rf"^ *[\w, ]*\b{field.name}\b", attributes, re.M)]
    if names:
        also = "Further fields" if attributes else "Fields"
        yield f"{also}{described}: {', '.join(f'`{name}`' for name in names)}."


def _is_own(member: Any) -> bool:
    return isinstance(member, property | classmethod | staticmethod) or inspect.isfunction(member)


def _block(head: str, doc: str | None) -> str:
    text = inspect.cleandoc(doc or "").split("\n\nExamples\n--------")[0]
    return f"```text\n{head}\n\n{textwrap.indent(text, '    ')}".rstrip() + "\n```"


def _signature(function: Any) -> str:
    """Return the signature as its source has it; text from the interpreter differs between versions of Python."""
    node = _definition(function)
    arguments = ast.unparse(node.args).removeprefix("self, ").removeprefix("cls, ")
    arguments = re.sub(r"(?<=: )'([^']*)'", r"\1", arguments)  # of types that are imported when they are needed
    arguments = "" if arguments in ("self", "cls") else arguments.replace("'", '"').replace("=_NO_TOPICS", "={}")
    returns = f" -> {ast.unparse(node.returns)}".replace("'", "").replace('"', "") if node.returns else ""
    one_line = f"({arguments}){returns}"
    return one_line if len(one_line) < 90 else "(\n    " + ",\n    ".join(_split(arguments)) + f",\n){returns}"


def _split(arguments: str) -> Iterator[str]:
    """Yield arguments that commas outside of brackets separate."""
    depth, start = 0, 0
    for i, letter in enumerate(arguments):
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            yield arguments[start:i].strip()
            start = i + 1
    yield arguments[start:].strip()


if __name__ == "__main__":
    main()
