"""A recording of cameras as images and IMUs -> a folder in EuRoC's layout, which reads back to the same numbers.

    mav0/cam0/data.csv, data/<timestamp>.png, sensor.yaml      of each camera; PNG without loss, in 8 bits of grey
    mav0/imu0/data.csv, sensor.yaml                        of each IMU

T_BS of sensor.yaml maps coordinates of the sensor to those of the body, which is imu0.
"""

from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OptionError, RecordingError
from ..formats.shared.yaml_text import yaml_lines
from ..output import whole_folder
from ..progress import Progress, Step
from ..recording import Floats, ImuSamples
from ..recording.frames import ImageStream
from ..recording.recording import ImageRecording
from .video import encode_frames

_FRAMES = "#timestamp [ns],filename\n"
_SAMPLES = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)
_CHUNK = 20_000
_DISTORTIONS = {"radtan": "radial-tangential"}
_TENTHS = 10


def save_euroc(
    recording: ImageRecording,
    folder: str | PathLike[str],
    progress: Progress | None = None,
    notes: list[str] | None = None,
) -> None:
    """Write a recording as a folder in EuRoC's layout, image by image.

    Parameters
    ----------
    recording : cameras as images, and IMUs in m/s^2 and rad/s
    folder : made; it must not be there, or be empty
    progress : called with a sentence now and then
    notes : where sentences on what was left out are appended; without it an image that cannot be read is an error

    Raises
    ------
    OptionError
        If the triads of an IMU have timestamps of their own, for which the format has no room.
    RecordingError
        If an image cannot be read, or with `notes` none of a camera's.
    OutputError
        If the folder is not empty, or cannot be written.
    """
    tell = progress or (lambda _: None)
    for name, imu in recording.imus.items():
        _refuse_own_stamps(name, imu)
    with whole_folder(folder) as place:
        for name, imu in recording.imus.items():
            _save_imu(imu, place / "mav0" / name)
        for name, stream in recording.streams.items():
            _save_camera(name, stream, place / "mav0" / name, notes, tell)


def _refuse_own_stamps(name: str, imu: ImuSamples) -> None:
    a, g = imu.accelerometer, imu.gyroscope
    if not np.array_equal(a.t_ns, g.t_ns):
        raise OptionError(
            f"{name}: accelerometer ({len(a)} samples) and gyroscope ({len(g)} samples) have timestamps of their own; "
            "EuRoC's table holds one row for both, and samples are not interpolated here. Write a bag instead "
            "(--to ros1, ros2 or mcap)."
        )


def _save_imu(imu: ImuSamples, place: Path) -> None:
    place.mkdir(parents=True)
    a, g = imu.accelerometer, imu.gyroscope
    with (place / "data.csv").open("w", encoding="ascii", newline="") as text:
        text.write(_SAMPLES)
        for first in range(0, len(a), _CHUNK):
            part = slice(first, first + _CHUNK)
            columns = [a.t_ns[part].tolist(), *g.values[part].T.tolist(), *a.values[part].T.tolist()]
            text.writelines(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))
    node: dict[str, Any] = {"sensor_type": "imu"}
    node |= {"T_BS": _matrix(np.eye(4))} if place.name == "imu0" else {}  # where another one sits is not known
    node |= _rate(g.rate_hz) | ({} if imu.noise is None else asdict(imu.noise))
    _save_yaml(place / "sensor.yaml", node)


def _save_camera(name: str, stream: ImageStream, place: Path, notes: list[str] | None, tell: Progress) -> None:
    said: list[str] = [] if notes is None else notes
    (place / "data").mkdir(parents=True)
    written: list[int] = []
    damaged: list[str] = []
    twice = 0
    every = max(1, stream.count // _TENTHS) if stream.count else 100
    with (place / "data.csv").open("w", encoding="ascii", newline="") as table:
        table.write(_FRAMES)
        for number, (t_ns, png) in enumerate(encode_frames(stream.frames(said))):
            if number % every == 0:
                tell(Step(f"writing images of {name}", number + 1, stream.count))
            if isinstance(png, RecordingError):
                if notes is None:
                    raise png
                damaged.append(str(png))
                continue
            try:
                with (place / "data" / f"{t_ns}.png").open("xb") as file:
                    file.write(png)
            except FileExistsError:
                twice += 1
                continue
            table.write(f"{t_ns},{t_ns}.png\n")
            written.append(t_ns)
    if not written:
        raise RecordingError(f"{name}: none of its images can be read." + (f" {damaged[0]}" if damaged else ""))
    if damaged:
        said.append(f"{name}: {len(damaged)} images cannot be read and were left out; the first: {damaged[0]}")
    if twice:
        said.append(f"{name}: {twice} images have the timestamp of another one and were left out.")
    node = _camera_node(name, stream, written, said)
    if node:
        _save_yaml(place / "sensor.yaml", node)


def _camera_node(name: str, stream: ImageStream, stamps: list[int], notes: list[str]) -> dict[str, Any]:
    """Return what is known of a camera, in EuRoC's names; empty where nothing is."""
    if stream.time_shift_cam_imu_s:
        notes.append(f"{name}: the stated time shift of {stream.time_shift_cam_imu_s:g} s has no place in this format.")
    camera = stream.camera
    if camera is None and stream.T_cam_imu is None:
        return {}
    node: dict[str, Any] = {"sensor_type": "camera"}
    if stream.T_cam_imu is not None:
        node["T_BS"] = _matrix(_inverse(stream.T_cam_imu))
    if len(stamps) > 1:
        node |= _rate(1e9 / float(np.median(np.diff(sorted(stamps)))))
    if camera is None:
        return node
    node |= {
        "resolution": np.array(camera.resolution),
        "camera_model": camera.projection,
        "intrinsics": camera.intrinsics,
        "distortion_model": _DISTORTIONS.get(camera.distortion, camera.distortion),
    }
    if len(camera.distortion_coeffs):
        node["distortion_coefficients"] = camera.distortion_coeffs
    return node | ({"line_delay": camera.line_delay_s} if camera.line_delay_s else {})


def _inverse(T: Floats) -> Floats:
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def _matrix(T: Floats) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel()}


def _rate(rate_hz: float) -> dict[str, float]:
    return {"rate_hz": round(rate_hz, 6)} if np.isfinite(rate_hz) and rate_hz > 0 else {}


def _save_yaml(path: Path, node: dict[str, Any]) -> None:
    path.write_text("\n".join(yaml_lines(node)) + "\n", encoding="utf-8", newline="\n")
