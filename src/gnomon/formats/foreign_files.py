"""Calibration files of other projects, told apart by their content and put together."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..errors import FormatError
from ..results.calibration import Calibration, CameraCalibration
from ..results.sensors import calibration_parameters
from .basalt import basalt_of, is_basalt
from .flight_controllers import is_flight_parameters, read_flight_parameters
from .foreign import ForeignCalibration, recognised_frame
from .imu_tk import is_imu_tk, read_imu_tk, stated_triad
from .imucal import read_imucal
from .kalibr.camchain import CameraInput, cameras_of, is_kalibr_cam_results
from .kalibr.imu import imus_of
from .kalibr.results import is_kalibr_results, read_cam_results, read_kalibr_results
from .kalibr.target import target_of
from .okvis import is_okvis, okvis_of
from .orb_slam3 import is_orb_slam3, orb_slam3_of
from .own.calibration_file import load
from .own.calibration_text import is_noise, is_own
from .own.other_forms import read_parameter_csv
from .ros2 import camera_info_of, is_camera_info, is_launch, launch_of
from .shared.foreign_yaml import read_foreign_yaml
from .shared.structured import Node, read_json, read_structured_text
from .vins_fusion import is_vins, is_vins_lens, lens_of, vins_of

__all__ = ["FORMATS", "is_own", "load_foreign"]

FORMATS = (
    "Kalibr's camchain.yaml, camchain-imucam.yaml, imu.yaml, target.yaml, results-imucam.txt and results-cam.txt, "
    "OpenVINS' kalibr_imucam_chain.yaml and kalibr_imu_chain.yaml, Basalt's calibration JSON, imu_tk's .calib, "
    "imucal's JSON, the configurations of VINS-Fusion, ORB-SLAM3 and OKVIS, ROS 2's static transforms and camera_info, "
    "parameters of PX4 and ArduPilot, gnomon's csv"
)
_LAYOUTS: tuple[tuple[Callable[[Node], bool], Callable[[Node, list[str]], ForeignCalibration]], ...] = (
    (is_vins, vins_of),
    (is_vins_lens, lens_of),
    (is_orb_slam3, orb_slam3_of),
    (is_okvis, okvis_of),
    (is_launch, launch_of),
    (is_camera_info, camera_info_of),
)
"""What tells a YAML file, and what reads it."""
_DIGITS = "results-imucam"  # of the format whose numbers are printed with eight digits

_T = TypeVar("_T")


def load_foreign(path: str | PathLike[str], *others: str | PathLike[str]) -> ForeignCalibration:
    """Read a calibration from files of another project.

    What each file is, is told by its content; what several of them say is put together, such as camchain-imucam.yaml,
    imu.yaml and results-imucam.txt of one calibration.

    Parameters
    ----------
    path, others : Kalibr's camchain.yaml, camchain-imucam.yaml, imu.yaml, target.yaml, results-imucam.txt and
        results-cam.txt; OpenVINS' kalibr_imucam_chain.yaml and kalibr_imu_chain.yaml; Basalt's calibration JSON;
        imu_tk's .calib files, that of the accelerometer first; imucal's JSON; the configurations of VINS-Fusion,
        ORB-SLAM3 and OKVIS; ROS 2's launch file with static transforms and its camera_info; parameters of PX4 and of
        ArduPilot; gnomon's csv

    Raises
    ------
    FormatError
        If a file cannot be read, is none of these, is not as its format says, or two files contradict each other.

    Examples
    --------
    >>> found = load_foreign("camchain-imucam.yaml", "imu.yaml")  # doctest: +SKIP
    >>> found.cameras["cam0"].time_shift_cam_imu  # doctest: +SKIP
    0.007005771199616974
    """
    paths = (path, *others)
    texts = [read_structured_text(file) for file in paths]
    try:
        with np.errstate(all="ignore"):
            found = _read_all(paths, texts)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise FormatError(f"{path}: its numbers are of no calibration ({error}). Was it written completely?") from error
    _refuse_endless(found, path)
    return found


def _read_all(paths: Sequence[str | PathLike[str]], texts: Sequence[str]) -> ForeignCalibration:
    if all(is_imu_tk(text) for text in texts) and len(paths) <= 2:
        return _read_triads(paths, texts)
    return _joined([_read(file, text) for file, text in zip(paths, texts, strict=True)], paths)


def _refuse_endless(found: ForeignCalibration, path: str | PathLike[str]) -> None:
    """Refuse numbers whose inverse or product is not finite."""
    for name, value in calibration_parameters(found.imus):
        if not np.isfinite(value).all():
            raise FormatError(f"{path}: {name} is not finite with the numbers in it. Was it written completely?")


def _read_triads(paths: Sequence[str | PathLike[str]], texts: Sequence[str]) -> ForeignCalibration:
    """Read one or two of imu_tk's files; what they are of is told by a comment of gnomon's, or by their order."""
    told = [stated_triad(text) for text in texts]
    if told == ["gyroscope"]:
        return read_imu_tk(gyroscope=paths[0])
    return read_imu_tk(*(reversed(paths) if told[0] == "gyroscope" else paths))


def _read(path: str | PathLike[str], text: str) -> ForeignCalibration:
    notes: list[str] = []
    kinds: tuple[tuple[bool, Callable[[str | PathLike[str]], ForeignCalibration]], ...] = (
        (is_imu_tk(text), lambda file: _read_triads((file,), (text,))),
        (text.startswith("name,value,sigma,unit"), read_parameter_csv),
        (text.lstrip().startswith("{"), _read_json),
        (is_kalibr_cam_results(text), lambda file: _cameras(read_cam_results(file, notes), notes)),
        (is_kalibr_results(text), read_kalibr_results),
        (is_flight_parameters(text), read_flight_parameters),
    )
    return next((read for told, read in kinds if told), _read_yaml)(path)


def _read_json(path: str | PathLike[str]) -> ForeignCalibration:
    root = read_json(path)
    if is_own(path):
        raise root.fail("this is gnomon's own calibration. Read it with gnomon.load.")
    if is_basalt(root):
        return basalt_of(root)
    if isinstance(root.value, dict) and "cal_type" in root.value:
        return read_imucal(path)
    raise _unknown(path)


def _read_yaml(path: str | PathLike[str]) -> ForeignCalibration:
    """Read one of Kalibr's yaml files; one that holds cameras and IMUs together, too."""
    notes: list[str] = []
    try:
        root = read_foreign_yaml(path, notes)
    except FormatError as error:
        raise FormatError(f"{error} Readable are {FORMATS}.") from None
    keys: list[str] = [str(key) for key in root.value] if isinstance(root.value, dict) else []
    if "schema" in keys:
        raise root.fail("this is gnomon's own calibration. Read it with gnomon.load.")
    if "target_type" in keys:
        target = target_of(root, notes)
        return ForeignCalibration(imus={}, frame="accel-x", notes=tuple(notes), target=target, format="Kalibr, board")
    for told, read in _LAYOUTS:
        if told(root):
            return read(root, notes)
    parts: list[ForeignCalibration] = []
    for prefix, flat, read in (("imu", "accelerometer_noise_density", imus_of), ("cam", "camera_model", _chain)):
        named = [key for key in keys if re.fullmatch(rf"{prefix}\d+", key)]
        if named or flat in keys:
            part = replace(root, value={key: root.value[key] for key in named}) if named else root
            parts.append(read(part, []))
    if not parts:
        raise _unknown(path)
    others = [key for key in keys if not re.fullmatch(r"(cam|imu)\d+", key)]
    if others and any(re.fullmatch(r"(cam|imu)\d+", key) for key in keys):
        notes.append(f"{Path(path).name}: {', '.join(others)} {'was' if len(others) == 1 else 'were'} passed over.")
    found = _joined(parts, (path,) * len(parts))
    return replace(found, notes=(*notes, *found.notes))


def _chain(root: Node, notes: list[str]) -> ForeignCalibration:
    return _cameras(cameras_of(root, notes), notes)


def _cameras(found: Mapping[str, CameraInput], notes: list[str]) -> ForeignCalibration:
    placed: dict[str, CameraCalibration] = {}
    if len(found) > 1 and all(camera.T_cam_imu is None and camera.T_cam_cam0 is not None for camera in found.values()):
        for name, camera in found.items():
            assert camera.T_cam_cam0 is not None
            placed[name] = CameraCalibration(
                T_cam_body=camera.T_cam_cam0, time_shift_cam_imu=0.0, camera=camera.camera, body="cam0"
            )
        return ForeignCalibration(
            imus={}, frame="cam0", notes=tuple(notes), cameras=placed, format="Kalibr, cameras without an IMU"
        )
    for name, camera in found.items():
        if camera.T_cam_imu is None:
            continue
        if camera.time_shift_cam_imu_s is None:
            notes.append(f"The time shift of {name} is not stated; taken: zero.")
        placed[name] = CameraCalibration(
            T_cam_body=camera.T_cam_imu, time_shift_cam_imu=camera.time_shift_cam_imu_s or 0.0, camera=camera.camera
        )
    lenses = {name: camera.camera for name, camera in found.items() if name not in placed}
    return ForeignCalibration(
        imus={}, frame="accel-x", notes=tuple(notes), cameras=placed, lenses=lenses, format="Kalibr, cameras"
    )


def _unknown(path: str | PathLike[str]) -> FormatError:
    return FormatError(f"{path}: this is no calibration file that gnomon knows. Readable are {FORMATS}.")


def _joined(parts: Sequence[ForeignCalibration], paths: Sequence[str | PathLike[str]]) -> ForeignCalibration:
    """Return what several files say together; what results-imucam.txt repeats is taken from the others."""
    if len(parts) == 1:
        return parts[0]
    pairs = sorted(zip(parts, paths, strict=True), key=lambda pair: _DIGITS in pair[0].format)
    exact = sum(_DIGITS not in part.format for part in parts)

    def together(values: Callable[[ForeignCalibration], Mapping[str, _T]]) -> dict[str, _T]:
        return _together([(values(part), path) for part, path in pairs], exact)

    imus, cameras = together(lambda part: part.imus), together(lambda part: part.cameras)
    lenses = together(lambda part: part.lenses)
    if imus:  # of cameras that were calibrated without one only the lenses belong to it
        lenses |= {name: camera.camera for name, camera in cameras.items() if camera.body == "cam0"}
        cameras = {name: camera for name, camera in cameras.items() if camera.body == "imu0"}
    frames = {part.frame for part, _ in pairs if part.imus}
    return ForeignCalibration(
        imus=imus,
        frame=frames.pop()
        if len(frames) == 1
        else recognised_frame(imus)
        if imus or not cameras
        else pairs[0][0].frame,
        sigmas=together(lambda part: part.sigmas),
        notes=tuple(dict.fromkeys(note for part, _ in pairs[: exact or None] for note in part.notes)),
        cameras=cameras,
        lenses={name: lens for name, lens in lenses.items() if name not in cameras},
        imu_data=together(lambda part: part.imu_data),
        gravity_target=next((part.gravity_target for part, _ in pairs if part.gravity_target is not None), None),
        residuals=together(lambda part: part.residuals),
        target=next((part.target for part, _ in pairs if part.target is not None), None),
        format=" + ".join(dict.fromkeys(part.format for part, _ in pairs)),
        guessed_sizes=frozenset[str]().union(*(part.guessed_sizes for part in parts))
        - {name for part in parts for name in (*part.cameras, *part.lenses) if name not in part.guessed_sizes},
    )


def _together(parts: Sequence[tuple[Mapping[str, _T], str | PathLike[str]]], exact: int) -> dict[str, _T]:
    """Return all entries; of the first `exact` files, no two may have the same one."""
    found: dict[str, _T] = {}
    origin: dict[str, str | PathLike[str]] = {}
    for i, (part, path) in enumerate(parts):
        for name, value in part.items():
            if name in found and (i < exact or exact == 0):
                raise FormatError(f"{path} and {origin[name]} both describe {name}. Give one of them.")
            if name not in found:
                found[name], origin[name] = value, path
    return found


OWN_FILE = "calibration.yaml"
_KALIBR = ("camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
_SUFFIXES = {".yaml", ".yml", ".json", ".txt", ".calib", ".csv", ".params", ".parm", ".param"}
_LARGEST = 4_000_000  # bytes of a calibration file; tables of samples are passed over
_MOST_FILES = 200
_SHOWN = 5  # folders that a message names

AnyPath = str | PathLike[str]


def load_any(*paths: AnyPath) -> Calibration | ForeignCalibration:
    """Read a calibration, gnomon's own or another project's.

    Parameters
    ----------
    paths : a calibration.yaml; files of one calibration of another project; or one folder: gnomon's result, what Kalibr
        wrote of one calibration, or a folder in which everything else that is a calibration file belongs together

    Raises
    ------
    FormatError
        If there is no such file, it cannot be read, is no calibration, or what several say contradicts each other.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir():
        files = files_of_folder(files[0])
    for path in files:
        if path.is_dir():
            raise FormatError(f"{path}: this is a folder, which cannot be joined with files. Name the files in it.")
        if not path.is_file():
            raise FormatError(f"{path}: there is no such file or folder.")
    own = [path for path in files if is_own(path)]
    if not own:
        return load_foreign(*files)
    if len(files) > 1:
        raise FormatError(f"{own[0]}: gnomon's own calibration is one file and cannot be joined with others.")
    if is_noise(own[0]):
        raise FormatError(f"{own[0]}: this holds noise only. Give a calibration.yaml.")
    return load(own[0])


def files_of_folder(folder: Path) -> list[Path]:
    """Return the files of the one calibration in a folder.

    Raises
    ------
    FormatError
        If there is none, or there are several.
    """
    if (folder / OWN_FILE).is_file():
        return [folder / OWN_FILE]
    for first in _KALIBR[::2]:
        chains = sorted(folder.glob(f"*{first}"))
        if len(chains) > 1:
            raise FormatError(
                f"{folder}: there are several calibrations, {', '.join(path.name for path in chains)}. Name the files "
                f"of one, joined by +, such as {chains[0]}+{folder / chains[0].name.replace(first, _KALIBR[1])}."
            )
        if chains:
            prefix = chains[0].name.removesuffix(first)
            return [path for name in _KALIBR if (path := folder / f"{prefix}{name}").is_file()]
    candidates = _candidates(folder)
    own = [path for path in candidates if _is_own_calibration(path)]
    found = own if len(own) == 1 else [path for path in candidates if _readable(path)]
    if not found:
        inside = sorted(path.name for path in folder.iterdir() if path.is_dir())
        which = f"one of the folders in it ({', '.join(inside[:_SHOWN])})" if inside else "a calibration.yaml"
        raise FormatError(f"{folder}: there is no calibration file in this folder. Name {which}.")
    return found


def _candidates(folder: Path) -> list[Path]:
    files = (path for path in sorted(folder.iterdir()) if path.suffix.lower() in _SUFFIXES and path.is_file())
    return [path for path in files if path.stat().st_size <= _LARGEST][:_MOST_FILES]


def _is_own_calibration(path: Path) -> bool:
    try:
        return is_own(path) and not is_noise(path)
    except FormatError:  # no text
        return False


def _readable(path: Path) -> bool:
    try:
        found = load_foreign(path)
    except FormatError:
        return False
    return bool(found.imus or found.cameras or found.lenses)


_RESULT_OF = re.compile(r"-(gnomon|imu|camera|camera-imu|turntable|magnetometer|noise)$")
"""How the folder of a result ends that is named after its recording and its command."""


def source_names(sources: Sequence[Sequence[AnyPath]]) -> list[str]:
    """Return a short name for each source, by where their paths differ.

    Examples
    --------
    >>> source_names([["run1-camera-imu/calibration.yaml"], ["kalibr/scale-misalignment"]])
    ['run1', 'scale-misalignment']
    >>> source_names([["a/kalibr"], ["b/kalibr"]])
    ['a', 'b']
    """
    whole = [_telling_parts(Path(source[0])) for source in sources]
    short = [[*parts[:-1], _RESULT_OF.sub("", parts[-1]) or parts[-1]] for parts in whole]
    parts = short if len(set(map(tuple, short))) == len(set(map(tuple, whole))) else whole
    names = ["" for _ in parts]
    for i, own in enumerate(parts):
        for length in range(1, len(own) + 1):
            tail = own[-length:]
            if sum(other[-length:] == tail for other in parts) == 1:
                names[i] = tail[0] if sum(tail[0] in other for other in parts) == 1 else "/".join(tail)
                break
        names[i] = names[i] or "/".join(own)
    return names


def _telling_parts(path: Path) -> list[str]:
    """Return the parts of a path that tell a calibration, without what all results are called."""
    parts = [part for part in path.parts if part not in {"/", "\\", ".", ".."}] or [path.absolute().name]
    if len(parts) > 1 and parts[-1] == OWN_FILE:
        parts = parts[:-1]
    return parts
