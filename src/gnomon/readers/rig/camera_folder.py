"""What a recording of cameras and IMUs holds: which file is which stream, by its name.

EuRoC's sensor.yaml, one for each camera and each IMU: lens, place on the body, and noise.

T_BS maps coordinates of the sensor to those of the body, p_body = T_BS @ p_sensor. What such a file states is of help
only: whatever cannot be used is passed over with a note.
"""

import re
from dataclasses import replace
from pathlib import Path

from ...errors import FormatError, OptionError, RecordingError
from ...formats.kalibr.camchain import camera_of
from ...formats.kalibr.imu import ImuInput
from ...formats.shared.baselines import inverse_pose
from ...formats.shared.foreign_yaml import read_foreign_yaml, read_transform
from ...formats.shared.structured import Node
from ...frozen import value_class
from ...models.camera import Camera
from ...models.noise import ImuNoise
from ...recording import Floats, frozen_array
from ..files import NPZ_MAGIC, first_bytes, read_text_file
from ..samples.column_names import column_roles
from ..samples.text_table import sniff_layout

_KALIBR_NAMES = {"distortion_coefficients": "distortion_coeffs", "projection_model": "camera_model"}
_NOISE = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
)


@value_class
class SensorInput:
    """What the sensor.yaml of one sensor says.

    Attributes
    ----------
    T_body_sensor : (4, 4) p_body = T_body_sensor @ p_sensor [m], or None
    camera : lens and intrinsics of a camera, or None
    imu : noise and rate of an IMU, or None
    """

    T_body_sensor: Floats | None = None
    camera: Camera | None = None
    imu: ImuInput | None = None


def read_sensor(path: Path, where: str, notes: list[str]) -> SensorInput:
    """Read a sensor.yaml.

    Parameters
    ----------
    path : the file
    where : its name for notes, such as "cam0/sensor.yaml"
    notes : where sentences on what was passed over are appended
    """
    try:
        node = replace(read_foreign_yaml(path, notes), file=where)
        keys = {_KALIBR_NAMES.get(child.key, child.key): child for child in node.entries()}
    except FormatError as error:
        notes.append(f"{where} was passed over: {error}")
        return SensorInput()
    camera = imu = None
    if "intrinsics" in keys:
        try:
            camera = camera_of(node, {key: _sides(child) for key, child in keys.items()}, notes)
        except FormatError as error:
            notes.append(f"The lens was not taken from {error}")
    if _NOISE[0] in keys:
        try:
            imu = _imu_input(keys)
        except (FormatError, OptionError) as error:
            notes.append(f"The noise of the IMU was not taken from {error}")
    return SensorInput(T_body_sensor=_pose(keys, notes), camera=camera, imu=imu)


def T_sensor_imu(sensor: SensorInput, imu: SensorInput) -> Floats | None:
    """Return p_sensor = T @ p_imu from the places of both on the body; an IMU without place is the body itself."""
    if sensor.T_body_sensor is None:
        return None
    T_sensor_body = inverse_pose(sensor.T_body_sensor)
    return frozen_array(T_sensor_body if imu.T_body_sensor is None else T_sensor_body @ imu.T_body_sensor)


def _pose(keys: dict[str, Node], notes: list[str]) -> Floats | None:
    node = keys.get("T_BS")
    if node is None:
        return None
    try:
        return read_transform(node)
    except FormatError as error:
        notes.append(f"The place on the body was not taken from {error}")
        return None


def _sides(node: Node) -> Node:
    """Return the resolution as a list, where it is written as width and height."""
    if node.key == "resolution" and isinstance(node.value, dict) and {"width", "height"} == set(node.value):
        return replace(node, value=[node.value["width"], node.value["height"]])
    return node


def _imu_input(keys: dict[str, Node]) -> ImuInput:
    missing = [name for name in _NOISE if name not in keys]
    if missing:
        raise keys[_NOISE[0]].fail(f"{missing[0]} is missing beside it.")
    noise = ImuNoise(**{name: keys[name].number() for name in _NOISE})
    rate = keys["rate_hz"].number() if "rate_hz" in keys else None
    return ImuInput(noise=noise, update_rate_hz=rate if rate is not None and rate > 0 else None, topic="")


_TABLE = r"\.(csv|txt|tsv|dat)(\.gz)?"
_CORNERS = re.compile(rf"(cam\d+)[-_/]corners{_TABLE}", re.IGNORECASE)
_FRAMES = re.compile(rf"(cam\d+)[-_/]frames{_TABLE}", re.IGNORECASE)
_IMU = re.compile(rf"(imu\d*)(/data)?({_TABLE}|\.log|\.npz)", re.IGNORECASE)
_TRIADS = tuple(re.compile(rf"(imu\d*)[-_/]{word}[a-z]*({_TABLE}|\.log)", re.IGNORECASE) for word in ("acc", "gyr"))
_EXPECTED = "cam0_corners.csv (ts_ns,tag_id,corner_idx,u_px,v_px), cam1_corners.csv, ... and imu0.csv, also gzipped"


@value_class(eq=True)
class CornerStream:
    """Files of one camera whose corners were detected beforehand.

    Attributes
    ----------
    corners : table with one row a corner
    frames : table with one row a frame, also of frames without corners; None where there is none
    """

    corners: Path
    frames: Path | None


def corner_streams(folder: Path) -> dict[str, CornerStream]:
    """Return the cameras, "cam0", "cam1", ..., whose corners are in a folder.

    Raises
    ------
    RecordingError
        If there are none.
    """
    corners, frames = _matching(folder, _CORNERS, r"cam\d+"), _matching(folder, _FRAMES, r"cam\d+")
    if corners:
        return {name: CornerStream(corners=path, frames=frames.get(name)) for name, path in corners.items()}
    raise RecordingError(f"{folder}: no corners of a camera in this folder. Expected {_EXPECTED}.")


def holds_corners(folder: Path) -> bool:
    """Tell whether a folder holds tables of corners that were detected beforehand."""
    return bool(_matching(folder, _CORNERS, r"cam\d+"))


def imu_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Return the IMUs, "imu0", "imu1", ..., whose samples are in a folder.

    Returns
    -------
    name -> its table; or those of accelerometer and gyroscope, such as imu0-acc.csv and imu0-gyr.csv

    Raises
    ------
    RecordingError
        If there are none.
    """
    found = _imu_files(folder)
    if not found:
        raise RecordingError(f"{folder}: no samples of an IMU in this folder. Expected {_EXPECTED}.")
    return found


def folder_holds_imu(folder: Path) -> bool:
    """Tell whether a folder of corners holds samples of an IMU, too."""
    return bool(_imu_files(folder))


def _imu_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    whole, accelerometer, gyroscope = (_matching(folder, pattern, r"imu\d*") for pattern in (_IMU, *_TRIADS))
    pairs = {name: (accelerometer[name], gyroscope[name]) for name in accelerometer if name in gyroscope}
    found = pairs | {name: (path,) for name, path in whole.items()}
    named = {("imu0" if name == "imu" else name): files for name, files in found.items()}
    return dict(sorted(named.items(), key=lambda item: (len(item[0]), item[0])))


def recording_folder(path: Path) -> Path:
    """Return the folder of a recording; of EuRoC's layout the folder mav0 in it.

    Raises
    ------
    RecordingError
        If it is no folder.
    """
    if path.is_dir():
        return path / "mav0" if (path / "mav0").is_dir() else path
    problem = (
        "this is a file, and the recording of a camera and an IMU is a folder" if path.exists() else "no such folder"
    )
    raise RecordingError(f"{path}: {problem}. Expected a folder with {_EXPECTED}.")


def _matching(folder: Path, pattern: re.Pattern[str], inside: str = "") -> dict[str, Path]:
    """Return name -> file, in the order of their numbers; of the same stream twice the shorter name, unpacked.

    Folders whose names match `inside` are looked into; those of images may hold very many files.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        inner = [path]
        if path.is_dir():
            looked_into = re.fullmatch(inside, path.name, re.IGNORECASE) is not None
            inner = sorted(path.glob("*")) + sorted(path.glob("data/*")) if looked_into else []
        for file in inner:
            match = pattern.fullmatch(file.relative_to(folder).as_posix())
            if match and file.is_file():
                found.setdefault(match[1].lower(), file)
    return dict(sorted(found.items(), key=lambda item: (len(item[0]), item[0])))


_IMU_TABLE = re.compile(r".*\.(csv|txt|tsv|dat|log|npz)(\.gz)?", re.IGNORECASE)
_PAIR = (re.compile(r"acc", re.IGNORECASE), re.compile(r"gyr", re.IGNORECASE))
EXPECTED = "imu0.csv or imu0/data.csv, with the first line ts_ns,wx,wy,wz,ax,ay,az"


def imu_tables(root: Path, others: set[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of each IMU, "imu0", "imu1", ..., of a folder: by their names, else by their content.

    Parameters
    ----------
    root : the folder
    others : tables in it that are something else

    Returns
    -------
    name -> one table, or those of accelerometer and gyroscope; empty where there are none

    Raises
    ------
    RecordingError
        If several tables may be the IMU's.
    """
    named = _named(root)
    if named:
        return named
    tables = [path for path in sorted(root.iterdir()) if _is_table(path) and path not in others]
    return _pair(tables) or _only([path for path in tables if _triads(path) == 2], root)


def imu_tables_beside(video: Path, others: set[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of each IMU beside a video: called imu0, imu1, ..., or after the video.

    Raises
    ------
    RecordingError
        If several tables may be the IMU's.
    """
    own = [
        path
        for path in sorted(video.parent.iterdir())
        if path.name.startswith(video.stem) and _is_table(path) and path not in others
    ]
    both = [path for path in own if _triads(path) == 2]
    return _pair(own) or _only(both, video.parent) or _named(video.parent)


def _pair(tables: list[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of accelerometer and gyroscope, where there is just one of each."""
    pair = [[path for path in tables if word.search(path.name) and _triads(path) == 1] for word in _PAIR]
    if [len(files) for files in pair] == [1, 1] and pair[0] != pair[1]:
        return {"imu0": (pair[0][0], pair[1][0])}
    return {}


def _named(root: Path) -> dict[str, tuple[Path, ...]]:
    try:
        return imu_files(root)
    except RecordingError:
        return {}


def _only(found: list[Path], root: Path) -> dict[str, tuple[Path, ...]]:
    if len(found) > 1:
        listed = ", ".join(path.name for path in found[:6]) + (", ..." if len(found) > 6 else "")
        raise RecordingError(f"{root}: {len(found)} tables may be the IMU's ({listed}). Name the right one imu0.csv.")
    return {"imu0": (found[0],)} if found else {}


def _is_table(path: Path) -> bool:
    return _IMU_TABLE.fullmatch(path.name) is not None and not path.name.startswith(".") and path.is_file()


def _triads(path: Path) -> int:
    """Return how many triads of a sensor a table holds; zero where it is something else."""
    try:
        if first_bytes(path).startswith(NPZ_MAGIC):
            return 2 if "imu" in path.name.lower() else 0
        file = read_text_file(path)
        found = column_roles(sniff_layout(file), None, file.name)
    except RecordingError:
        return 0
    return sum(triad.quantity != "magnetometer" for triad in found.triads) if found.time else 0
