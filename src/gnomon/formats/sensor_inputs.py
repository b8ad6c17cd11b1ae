"""What a camera-IMU calibration is told of its sensors beforehand, in whichever file it stands."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..recording import KnownRig, Source, frozen_array, shared_sources
from .basalt import basalt_of, is_basalt
from .foreign import ForeignCalibration
from .kalibr.camchain import CameraInput, cameras_of, is_kalibr_cam_results
from .kalibr.imu import ImuInput, read_imu_input
from .kalibr.results import read_cam_results
from .own.calibration_file import load
from .own.calibration_text import is_noise, is_own
from .shared.foreign_yaml import read_foreign_yaml
from .shared.structured import read_json, read_structured_text

ImuFiles = str | PathLike[str] | Sequence[str | PathLike[str]]
"""One file of all IMUs, or one of each."""


def read_cameras(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, CameraInput]:
    """Read cameras, told by the content of the file.

    Parameters
    ----------
    path : Kalibr's camchain.yaml or camchain-imucam.yaml, OpenVINS' kalibr_imucam_chain.yaml, Kalibr's results-cam.txt
        with camchain.yaml beside it, Basalt's calibration JSON, or gnomon's calibration.yaml; the latter's covariance
        of intrinsics and distortion coefficients comes along, where they were estimated
    notes : where sentences on what was passed over, or taken, are appended

    Returns
    -------
    mapping from "cam0", "cam1", ... to CameraInput

    Raises
    ------
    FormatError
        If the file cannot be read, is none of these, or describes no camera.
    """
    said: list[str] = [] if notes is None else notes
    text = read_structured_text(path)
    if (found := _basalt(path, text)) is not None:
        return _of_basalt(path, found, said)
    if is_kalibr_cam_results(text):
        return read_cam_results(path, said)
    root = read_foreign_yaml(path, said)
    if isinstance(root.value, dict) and "schema" in root.value:
        return _own(path)
    return cameras_of(root, said)


def read_rig(path: str | PathLike[str]) -> KnownRig | None:
    """Return what a calibration of cameras alone, of gnomon's own, knows of the cameras together; None of other files.

    Raises
    ------
    FormatError
        If it is such a file, and not as it should be.
    """
    if not is_own(path):
        return None
    calibration = load(path)
    covariance = calibration.uncertainty.matrix
    if calibration.imus or not np.isfinite(covariance).all():
        return None
    poses = {name: camera.T_cam_body for name, camera in calibration.cameras.items() if name != camera.body}
    return KnownRig(T_cam_cam0=poses, names=calibration.uncertainty.names, covariance=covariance)


def made_from(path: str | PathLike[str], sources: Collection[Source]) -> bool:
    """Tell whether a calibration of gnomon's own was made from one of the files that are read now."""
    return is_own(path) and bool(shared_sources(sources, load(path).provenance.inputs))


def imu_paths(files: ImuFiles | None) -> tuple[Path, ...]:
    """Return the files of IMUs that are given as one path, several, or None."""
    if files is None:
        return ()
    return (Path(files),) if isinstance(files, str | PathLike) else tuple(map(Path, files))


def read_imus(files: ImuFiles | None, notes: list[str] | None = None) -> dict[str, ImuInput]:
    """Read the noise of IMUs, told by the content of the files.

    Parameters
    ----------
    files : Kalibr's imu.yaml (what it takes, or what it wrote), OpenVINS' kalibr_imu_chain.yaml, EuRoC's sensor.yaml,
        or Basalt's calibration JSON; or several of them, of imu0, imu1, ... one each, as Kalibr takes them; or None
    notes : where sentences on what was passed over are appended

    Returns
    -------
    mapping from "imu0", "imu1", ... to ImuInput

    Raises
    ------
    FormatError
        If a file cannot be read, is none of these, a noise is missing or not above zero, or one of several files is of
        several IMUs.
    """
    said: list[str] = [] if notes is None else notes
    paths = imu_paths(files)
    if len(paths) == 1:
        return _read_imus(paths[0], said)
    found: dict[str, ImuInput] = {}
    for number, path in enumerate(paths):
        mine = _read_imus(path, said)
        if len(mine) > 1:
            raise FormatError(
                f"{path}: this file is of {', '.join(mine)}, and one of {len(paths)} files. Give one file of all IMUs, "
                "or one of each in their order, imu0 first."
            )
        found[f"imu{number}"] = next(iter(mine.values()))
    return found


def _read_imus(path: Path, said: list[str]) -> dict[str, ImuInput]:
    if (found := _basalt(path, read_structured_text(path))) is not None:
        said.extend(found.notes)
        return _noise_of_basalt(path, found, said)
    return read_imu_input(path, said)


def _basalt(path: str | PathLike[str], text: str) -> ForeignCalibration | None:
    """Return Basalt's calibration, or None of anything else, such as YAML in flow style, which begins like JSON."""
    if not text.lstrip().startswith("{"):
        return None
    try:
        root = read_json(path)
    except FormatError as error:
        with suppress(FormatError):
            read_foreign_yaml(path, [])
            return None
        raise error from None
    return basalt_of(root) if is_basalt(root) else None


def _own(path: str | PathLike[str]) -> dict[str, CameraInput]:
    calibration = load(path)
    if not calibration.cameras:
        raise FormatError(
            f"{path}: this calibration of gnomon's is of an IMU alone. Give one with cameras, or a camchain.yaml."
        )
    cameras: dict[str, CameraInput] = {}
    for name, found in calibration.cameras.items():
        covariance = calibration.covariance(f"{name}.intrinsics", f"{name}.distortion_coeffs")
        known = np.isfinite(covariance).all() and (np.diag(covariance) > 0).any()
        cameras[name] = CameraInput(
            camera=found.camera,
            T_cam_imu=found.T_cam_imu if found.body == "imu0" else None,
            time_shift_cam_imu_s=found.time_shift_cam_imu if found.body == "imu0" else None,
            lens_covariance=frozen_array(covariance) if known else None,
            T_cam_cam0=found.T_cam_body if found.body == "cam0" else None,
        )
    return cameras


def _of_basalt(path: str | PathLike[str], found: ForeignCalibration, notes: list[str]) -> dict[str, CameraInput]:
    notes.extend(found.notes)
    if not found.cameras:
        raise FormatError(f"{path}: this calibration of Basalt's holds no camera.")
    return {
        name: CameraInput(
            camera=camera.camera, T_cam_imu=camera.T_cam_imu, time_shift_cam_imu_s=camera.time_shift_cam_imu
        )
        for name, camera in found.cameras.items()
    }


def _noise_of_basalt(path: str | PathLike[str], found: ForeignCalibration, notes: list[str]) -> dict[str, ImuInput]:
    data = found.imu_data["imu0"]
    if data.noise is None:
        raise FormatError(f"{path}: no usable accel_noise_std, accel_bias_std, gyro_noise_std and gyro_bias_std in it.")
    notes.append(f"{Path(path).name}: the sensor model in it was passed over; it is estimated anew.")
    return {"imu0": ImuInput(noise=data.noise, update_rate_hz=data.update_rate_hz, topic="")}


def read_imu_noise(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, ImuInput]:
    """Read noise, rate and topic of IMUs, told by the content of the file.

    Parameters
    ----------
    path : gnomon's noise.yaml, Kalibr's imu.yaml, OpenVINS' kalibr_imu_chain.yaml, EuRoC's sensor.yaml or Basalt's JSON
    notes : where sentences on what was passed over are appended

    Returns
    -------
    mapping from "imu0", "imu1", ... to ImuInput

    Raises
    ------
    FormatError
        If the file cannot be read, is none of these, or a noise is missing or not above zero.
    OptionError
        If a noise.yaml is that of one sensor alone.
    """
    if not is_noise(path):
        return read_imus(path, notes)
    from .own.noise_file import load_noise

    noise = load_noise(path)
    rates = [triad.rate_hz for triad in (noise.gyroscope, noise.accelerometer) if triad is not None]
    return {"imu0": ImuInput(noise=noise.imu_noise(), update_rate_hz=rates[0], topic="")}
