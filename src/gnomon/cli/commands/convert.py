"""The command that writes a calibration, or a recording of cameras as images, in another format."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast, get_args

from ...errors import GnomonError, OptionError, OutputError
from ...findings import join_names
from ...units import Units
from ..arguments import Argument
from ..command import Command, FileOption, Topics, output_option, topics_of
from ..files import ALL_RESULT_FILES, check_folder, owner_of
from ..results import USABLE, print_assumptions
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...formats.shared.losses import StatedImu
    from ...recording.recording import ImageRecording


CalibrationForm = Literal[
    "imu_tk", "kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis", "px4", "ardupilot", "ros2", "imucal",
    "c-header", "json", "csv",
]  # fmt: skip
RecordingForm = Literal["euroc", "ros1", "ros2", "mcap"]
_HEAD = 4096
_NOISE_FILES = ("imu.yaml", "noise.yaml")
"""Where the noise of an IMU stands in the folder of a result, those that are looked for first before the others."""


@dataclass(frozen=True, kw_only=True)
class Convert(Command):
    """Write a calibration, gnomon's or another project's, in another format, and say what that format cannot hold.

    Or write a recording of cameras and an IMU, whatever it comes in, as a bag or as a folder in EuRoC's layout.

    Examples
    --------
    $ gnomon convert calibration.yaml --to openvins
    $ gnomon convert recording.bag --to euroc
    """

    paths: Annotated[tuple[Path, ...], Argument(positional=True, metavar="PATH")]
    """A calibration.yaml or the folder of a result, or files of another project that make one calibration, such as
    Kalibr's camchain-imucam.yaml and imu.yaml; or a recording: a bag, a folder with images or videos and IMU samples, a
    video."""
    to: CalibrationForm | RecordingForm
    """The format: imu_tk, kalibr, openvins, vins-fusion, orb-slam3, basalt, okvis, px4, ardupilot, ros2 (static
    transforms, camera_info), imucal, c-header, json or csv of a calibration; euroc, ros1, ros2 (SQLite) or mcap of a
    recording."""
    output: Annotated[Path | None, output_option("PATH")] = None
    """Folder for the files, file of a bag (default: beside the calibration or the recording, named after it and the
    format)."""
    imu: Annotated[Path | None, Argument(aliases=("--noise",), metavar="FILE")] = None
    """Kalibr's imu.yaml or gnomon's noise.yaml with the noise and rate that a format wants (default: imu.yaml or
    noise.yaml beside the calibration, where there is one)."""
    accelerometer_lsb_per_g: float | None = None
    """Counts per g by which the driver divides, such as 16384, where the calibration is of counts; PX4 and ArduPilot
    need it."""
    gyroscope_lsb_per_deg_s: float | None = None
    """The same per deg/s of the gyroscope, such as 131."""
    topics: Topics = ()
    """Which topics of a bag are read, such as cam0=/camera/image_raw imu0=/imu/data; found where not given."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where it is not in the recording."""
    units: str | None = None
    """Units of a table of samples: "si", or a list such as "g deg/s us"; recognised where not given."""

    @property
    def path(self) -> Path:
        """The first of the paths, which is the only one but for files of another project."""
        return self.paths[0]

    def __post_init__(self) -> None:
        if not self.paths:
            raise OptionError("nothing to convert is given. Name a calibration.yaml or a recording.")
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)

    def run(self, terminal: Terminal) -> int:
        """Write the calibration or the recording in another format, and return the exit code."""
        of_recordings, of_calibrations = get_args(RecordingForm), get_args(CalibrationForm)
        command = _of_result(self) if self.to in of_calibrations else self
        if self.to in of_recordings and (self.to not in of_calibrations or not _is_text(command.path)):
            return _convert_recording(command, terminal)
        return _convert_calibration(command, terminal)


def _of_result(command: Convert) -> Convert:
    """Return the command with the calibration of a result's folder in place of the folder, unless images are in it."""
    from ...formats.own.calibration_text import calibration_at

    inside = Path(calibration_at(command.path))
    if inside == command.path or _holds_images(command.path):
        return command
    return replace(command, paths=(inside, *command.paths[1:]))


def _convert_calibration(command: Convert, terminal: Terminal) -> int:
    from ...formats.conversion import convert as write
    from ...formats.conversion import export_texts
    from ...formats.own.calibration_file import load
    from ...formats.own.calibration_text import is_own

    _refuse_recording(command)
    if is_own(command.path):
        if len(command.paths) > 1:
            raise OptionError(f"{command.paths[1]}: of gnomon's own calibrations one at a time is converted.")
        calibration, notes = load(command.path), []
    else:
        from ...formats.foreign_files import load_foreign

        calibration = load_foreign(*command.paths)
        notes = list(calibration.notes)
    scales = {
        "accelerometer_lsb_per_g": command.accelerometer_lsb_per_g,
        "gyroscope_lsb_per_deg_s": command.gyroscope_lsb_per_deg_s,
    }
    imu, said = _noise(command)
    folder = command.output or command.path.parent / command.to
    check_folder(folder)
    paths = [folder / name for name in export_texts(calibration, command.to, imu=imu, **scales).files]
    _spare_inputs(command, paths)
    losses = write(calibration, command.to, folder, imu=imu, **scales)
    files = [str(path) for path in paths]
    for note in (*notes, *said):
        terminal.print(f"note:    {note}")
    for name in files:
        terminal.print(f"written: {name}")
    for loss in losses:
        terminal.print(f"not representable in {command.to}: {loss}")
    terminal.document({"files": files, "notes": [*notes, *said], "losses": losses})
    return USABLE


def _spare_inputs(command: Convert, paths: list[Path]) -> None:
    """Refuse to write over what is converted, and over files of a command's result, which would no longer be one."""
    folder = paths[0].parent
    if owner := owner_of(folder):
        taken = [path.name for path in paths if path.name in ALL_RESULT_FILES and path.exists()]
        if taken:
            raise OutputError(
                f"{folder}: this folder holds a result of gnomon {owner}, whose {', '.join(taken)} would be replaced. "
                f"Choose another folder with -o, such as {folder / command.to}."
            )
    inputs = {path.resolve() for path in command.paths}
    for path in paths:
        if path.resolve() in inputs:
            raise OutputError(f"{path}: this file is converted, and would be replaced. Choose another place with -o.")


def _noise(command: Convert) -> tuple["Mapping[str, StatedImu] | None", list[str]]:
    """Return noise and rate from the file that is given, or that lies beside the calibration, and what to say of it."""
    from ...formats.conversion import WITH_NOISE, stated_imus

    if command.imu is not None:
        if command.to not in WITH_NOISE:
            raise OptionError(
                f"--imu: {command.to} has no place for noise. Those that have are {join_names(WITH_NOISE, 'or')}."
            )
        return stated_imus(command.imu), []
    if command.to not in WITH_NOISE:
        return None, []
    for name in _NOISE_FILES:
        path = command.path.parent / name
        if not path.is_file() or path in command.paths:
            continue
        try:
            return stated_imus(path), [f"noise and rate are taken from {path}."]
        except GnomonError as error:
            return None, [f"{path} beside the calibration was not used: {error}"]
    return None, []


def _convert_recording(command: Convert, terminal: Terminal) -> int:
    from ...readers.images.image_recording import open_images

    _refuse_calibration(command)
    output = command.output or _default_output(command)
    if output.is_file() or (output.is_dir() and any(output.iterdir())):
        raise OutputError(f"{output}: there is something of this name already. Choose another place with -o.")
    terminal.progress("opening the recording")
    recording = open_images(
        command.path,
        topics=topics_of(command.topics),
        units=command.units,
        imu_table=command.imu_table,
        need_imu=False,
    )
    recording = _with_lenses(recording, command.path)
    print_assumptions(recording.assumptions, terminal)
    notes = _write(recording, output, command.to, terminal)
    terminal.print(f"written: {output} ({_summary_lines(recording)})")
    for note in notes:
        terminal.print(f"note:    {note}")
    terminal.document({"files": [str(output)], "assumptions": list(recording.assumptions), "notes": notes})
    return USABLE


def _with_lenses(recording: "ImageRecording", path: Path) -> "ImageRecording":
    """Return the recording with the lenses of camchain.yaml in its folder, where it states none itself."""
    from ...formats.sensor_inputs import read_cameras

    file = (path if path.is_dir() else path.parent) / "camchain.yaml"
    if not file.is_file() or all(stream.camera is not None for stream in recording.streams.values()):
        return recording
    notes: list[str] = [f"{file.name} in the recording's folder tells the lenses."]
    known = read_cameras(file, notes)
    streams = {
        name: replace(stream, camera=known[name].camera) if stream.camera is None and name in known else stream
        for name, stream in recording.streams.items()
    }
    return replace(recording, streams=streams, assumptions=(*recording.assumptions, *notes))


def _write(recording: "ImageRecording", output: Path, form: str, terminal: Terminal) -> list[str]:
    """Write the recording, and return sentences on what was left out."""
    notes: list[str] = []
    if form == "euroc":
        from ...writers.image_folders import save_euroc

        save_euroc(recording, output, terminal.progress, notes)
    else:
        from ...writers.bag_recording import Form, save_bag

        save_bag(recording, output, cast("Form", form), terminal.progress, notes)
    return notes


def _summary_lines(recording: "ImageRecording") -> str:
    images = [f"{name} {stream.count or 'some'} images" for name, stream in recording.streams.items()]
    samples = [f"{name} {len(imu.gyroscope)} samples" for name, imu in recording.imus.items()]
    return ", ".join(images + samples)


def _default_output(command: Convert) -> Path:
    """Return a place beside the recording, named after it and the format."""
    path = command.path.resolve()
    suffix = {"ros1": ".bag", "mcap": ".mcap"}.get(command.to, "")
    return path.with_name(f"{path.name if path.is_dir() else path.stem}-{command.to}{suffix}")


def _refuse_recording(command: Convert) -> None:
    """Refuse to write a recording in a format of calibrations."""
    if command.path.is_dir() or (not _is_calibration(command.path) and _holds_images(command.path)):
        raise OptionError(
            f"{command.path}: this is {'a folder' if command.path.is_dir() else 'a recording'}, and {command.to} is a "
            f"format of calibrations. Recordings are written --to {join_names(get_args(RecordingForm), 'or')}; of a "
            "result, give its folder or the calibration.yaml in it."
        )
    if command.topics or command.units or command.imu_table:
        raise OptionError(f"topics, units and imu-table are of recordings; {command.to} is a format of calibrations.")


def _refuse_calibration(command: Convert) -> None:
    """Refuse to write a calibration in a format of recordings."""
    if _is_calibration(command.path):
        raise OptionError(
            f"{command.path}: this is a calibration, and {command.to} is a format of recordings. Calibrations are "
            f"written --to {join_names(get_args(CalibrationForm), 'or')}."
        )
    if len(command.paths) > 1:
        raise OptionError(f"{command.paths[1]}: of recordings one at a time is converted.")
    if command.imu is not None:
        raise OptionError(f"--imu is of calibrations; {command.to} is a format of recordings.")


def _holds_images(path: Path) -> bool:
    from ...readers.images.image_recording import holds_images

    return holds_images(path)


def _is_calibration(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return b"schema" in head and b"gnomon/" in head


def _is_text(path: Path) -> bool:
    """Return whether a path is a text file, as a calibration is and a recording of images is not."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return b"\0" not in file.read(_HEAD)
