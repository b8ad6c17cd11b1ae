"""Images -> a folder in EuRoC's layout, which reads back to the same numbers, or a video whose frames have times."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.codec.codec import UnknownCodecError
from av.error import FFmpegError

from ..errors import OptionError, OutputError, RecordingError
from ..formats.shared.yaml_text import yaml_lines
from ..geometry.rotations import inverse_pose
from ..output import atomic_file, whole_folder
from ..processes import results_ahead
from ..progress import Progress, Step
from ..recording import Floats, ImuSamples, Integers
from ..recording.recording import Frame, Grey, ImageRecording, ImageStream

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
        node["T_BS"] = _matrix(inverse_pose(stream.T_cam_imu))
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


def _matrix(T: Floats) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel()}


def _rate(rate_hz: float) -> dict[str, float]:
    return {"rate_hz": round(rate_hz, 6)} if np.isfinite(rate_hz) and rate_hz > 0 else {}


def _save_yaml(path: Path, node: dict[str, Any]) -> None:
    path.write_text("\n".join(yaml_lines(node)) + "\n", encoding="utf-8", newline="\n")


def encode_frames(frames: Iterable[Frame]) -> Iterator[tuple[int, bytes | RecordingError]]:
    """Yield the timestamp [ns] and the PNG of each frame, or what is wrong with it; none is kept."""
    return results_ahead(lambda frame: (frame.t_ns, _png(frame)), frames)


def _png(frame: Frame) -> bytes | RecordingError:
    import cv2

    try:
        image = frame.decode()
    except RecordingError as error:
        return error
    # Of the strategies that lose nothing the fastest by far, and for grey images the smallest, too.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
    return cv2.imencode(".png", image, how)[1].tobytes()


def save_simulated_images(stream: ImageStream, place: Path, progress: Progress | None = None) -> Path:
    """Write the images of a camera into a folder that is not there yet, and return their table.

    Parameters
    ----------
    stream : the images; a few of them are rendered at the same time, and none is kept
    place : the folder, named after the camera
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If the folder is not empty, or cannot be written.
    """
    tell = progress or (lambda _: None)
    every = max(1, stream.count // _TENTHS)
    with whole_folder(place) as folder:
        (folder / "data").mkdir()
        with (folder / "data.csv").open("w", encoding="ascii", newline="") as table:
            table.write("#timestamp [ns],filename\n")
            for number, (t_ns, png) in enumerate(encode_frames(stream.frames([]))):
                if number % every == 0:
                    tell(Step(f"rendering images of {place.name}", number + 1, stream.count))
                if isinstance(png, RecordingError):
                    raise png
                (folder / "data" / f"{t_ns}.png").write_bytes(png)
                table.write(f"{t_ns},{t_ns}.png\n")
    return place / "data.csv"


_TICK = Fraction(1, 60_000)
"""MPEG-4 has no more than 65535 ticks in a second; Matroska rounds to 1 ms."""
_FORMATS = {"mp4": "mp4", "mov": "mov", "mkv": "matroska", "avi": "avi"}
_FIXED = {"avi"}
"""Containers that have a frame rate, and no times."""


def save_video(
    path: str | PathLike[str], images: Iterable[Grey], t_ns: Integers, *, codec: str = "mpeg4", rate_hz: float = 15.0
) -> int:
    """Write images as a video; Matroska and MP4 keep the times of the frames, AVI has only a rate.

    Parameters
    ----------
    path : its suffix, .mp4, .mov, .mkv or .avi, says the container
    images : (height, width) in 8 bits of grey, all of one size
    t_ns : (n,) timestamps, ascending, counted from the first [ns]
    codec : of PyAV, such as "mpeg4", "mjpeg", or "ffv1", which loses nothing
    rate_hz : what the container states as its frame rate

    Returns
    -------
    count : of the frames that were written

    Raises
    ------
    OptionError
        If the suffix is of no container that is known.
    OutputError
        If the file cannot be written.
    """
    suffix = str(path).rpartition(".")[2].lower()
    if suffix not in _FORMATS:
        raise OptionError(f"{path}: a video is written as .{', .'.join(_FORMATS)}; found .{suffix}.")
    rate = Fraction(rate_hz).limit_denominator(1001)
    tick = 1 / rate if suffix in _FIXED else _TICK
    lossless = codec == "ffv1"
    layout = "gray" if lossless else "yuvj420p" if codec == "mjpeg" else "yuv420p"
    count = 0
    try:
        with atomic_file(path) as file, av.open(file, "w", format=_FORMATS[suffix]) as container:
            stream: Any = container.add_stream(codec, rate=rate)
            stream.pix_fmt = layout
            if not lossless:
                stream.bit_rate = 4_000_000
            stream.codec_context.time_base = stream.time_base = tick
            for stamp, image in zip((t_ns - t_ns[0]).tolist(), images, strict=False):
                if count == 0:
                    stream.height, stream.width = image.shape
                frame = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=layout)
                frame.pts = count if suffix in _FIXED else round(stamp * 1e-9 / tick)
                frame.time_base = tick
                container.mux(stream.encode(frame))
                count += 1
            container.mux(stream.encode(None))
    except UnknownCodecError:
        raise OptionError(f"{path}: PyAV has no codec {codec}.") from None
    except FFmpegError as error:
        raise OutputError(f"{path}: the video cannot be written ({error.strerror or error}).") from None
    return count
