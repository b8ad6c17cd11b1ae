"""A simulated recording of cameras, alone or with IMUs -> a folder that gnomon reads, with its truth beside it.

cam0_corners.csv.gz   ts_ns, corner_id, u_px, v_px: the corners detected, numbered in Kalibr's order
cam0_frames.csv       ts_ns, corners: every frame, also those without corners
cam0/data.csv, cam0/data/<timestamp>.png    in their place, where the scenario wants images
imu0.csv.gz, ...      the samples of each IMU; imu0-acc.csv.gz and imu0-gyr.csv.gz where triads have timestamps apart
mav0, recording.bag, recording, recording.mcap    images and samples in one of these, where another form is wanted
camchain.yaml, imu.yaml, target.yaml    Kalibr's input: lens, nominal noise (of several IMUs keyed imu0, imu1), board;
                      of cameras alone the sizes of the images and a lens that stands in, beside corners
truth.yaml            what is true, as a calibration file
groundtruth.txt       the true path in the TUM format
scenario.yaml         what was simulated
"""

import gzip
import io
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import OutputError
from ..formats.kalibr.target import target_text
from ..formats.own.calibration_text import calibration_text
from ..formats.own.dataclass_file import options_text
from ..formats.shared.yaml_text import kalibr_yaml
from ..models.camera import Camera
from ..output import atomic_file, write_whole
from ..progress import Progress
from ..recording import CameraFrames, ImuSamples, Recording
from ..recording.recording import Frame, Grey, ImageRecording
from ..results.camera_diagnostics import TrajectoryTrack
from ..simulate.camera_imu import CameraImuSimulation, MotionStatistics
from ..simulate.cameras import CamerasSimulation
from ..simulate.images.board_images import rendered_cameras, simulated_images
from ..simulate.images.room_images import room_images
from ..simulate.scenarios.camera_imu import MOST_IMUS, RoomScenario
from .bag_recording import save_bag
from .image_folders import save_euroc, save_simulated_images
from .kalibr_files import trajectory_text
from .recording_file import save_recording

_WORKERS, _AHEAD = 2, 8
ImageForm = Literal["folder", "euroc", "ros1", "ros2", "mcap"]
PLACES: dict[ImageForm, str] = {"euroc": "mav0", "ros1": "recording.bag", "ros2": "recording", "mcap": "recording.mcap"}
"""What is made in the folder; as "folder", a folder of each camera."""
CAMERA_FILES = (
    *(f"{name}{ending}" for name in ("cam0", "cam1") for ending in ("", "_corners.csv.gz", "_frames.csv")),
    *PLACES.values(),
    *(f"imu{number}{ending}.csv.gz" for number in range(MOST_IMUS) for ending in ("", "-acc", "-gyr")),
)
"""Files and folders of cameras and samples in the folder of a simulated recording; it has some of them."""
_COMPRESSION = 6
_SCENARIO = """\
# What was simulated, with seed {seed}. Units are in the names: _s seconds, _m metres, _px pixels; all others are SI.
# The motion came to a mean rate of {rate:.3f} rad/s, a mean acceleration of {acceleration:.2f} m/s^2{visible}.
"""
_CHAIN = "# Lens of each camera as its owner knows it; what is true stands in truth.yaml.\n"
_NOISE = "# Nominal noise of {}.\n"


def save_camera_imu_recording(
    simulation: CameraImuSimulation,
    folder: str | PathLike[str],
    progress: Progress | None = None,
    form: ImageForm = "folder",
    room: RoomScenario | None = None,
) -> tuple[Path, ...]:
    """Write a simulated recording and its truth into a folder, which is made, and return the files.

    Of images, which are rendered now, the tables are returned.

    Parameters
    ----------
    simulation : what was simulated
    folder : an earlier recording in it is replaced
    progress : called with a sentence now and then
    form : of a recording as images
    room : what its images show instead of the board, which is then not written; `simulation` is of its `rig`

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{place}: this folder cannot be made ({error.strerror or error}). Choose another place."
        ) from error
    recording = simulation.recording
    _clear(place)
    written: list[Path] = []
    if not simulation.scenario.images or form == "folder":
        for name, samples in recording.imus.items():
            written += save_recording(Recording(imus={name: samples}), place / f"{name}.csv.gz")
    if simulation.scenario.images:
        images = simulated_images(simulation) if room is None else room_images(room, simulation)
        written += save_images(images, place, form, progress)
    else:
        for name, frames in recording.cameras.items():
            written += save_frames(frames, place, name)
    for name, text in simulated_texts(simulation, room):
        write_whole(place / name, text)
        written.append(place / name)
    return tuple(written)


def _clear(place: Path) -> None:
    """Remove the cameras of an earlier simulated recording, which may have had more of them, or another kind."""
    if not (place / "scenario.yaml").exists():
        return
    for name in CAMERA_FILES:
        if (place / name).is_dir() and not (place / name).is_symlink():
            shutil.rmtree(place / name, ignore_errors=True)
        else:
            (place / name).unlink(missing_ok=True)


def save_frames(frames: CameraFrames, place: Path, name: str) -> tuple[Path, Path]:
    """Write the corners of a camera, and the list of its frames; return both files."""
    corners, listed = place / f"{name}_corners.csv.gz", place / f"{name}_frames.csv"
    columns = [frames.t_ns[frames.frame], frames.point, *frames.pixels.T]
    with (
        atomic_file(corners) as raw,
        gzip.GzipFile("", "wb", _COMPRESSION, raw, mtime=0) as packed,  # no time in it: always the same bytes
        io.TextIOWrapper(packed, encoding="ascii", newline="") as text,
    ):
        text.write("ts_ns,corner_id,u_px,v_px\n")
        rows = zip(*(column.tolist() for column in columns), strict=True)
        text.writelines(f"{stamp},{point},{u!r},{v!r}\n" for stamp, point, u, v in rows)
    counts = np.bincount(frames.frame, minlength=len(frames.t_ns))
    rows = zip(frames.t_ns.tolist(), counts.tolist(), strict=True)
    write_whole(listed, "ts_ns,corners\n" + "".join(f"{stamp},{count}\n" for stamp, count in rows))
    return corners, listed


def simulated_texts(simulation: CameraImuSimulation, room: RoomScenario | None = None) -> Iterator[tuple[str, str]]:
    """Yield name and text of the small files beside a recording: what is known beforehand, and what is true."""
    recording, found = simulation.recording, simulation.statistics
    chain = {name: camera_node(frames.camera) for name, frames in recording.cameras.items()}
    if room is not None and len(chain) > 1:  # without a board nothing else tells it
        poses = [camera.T_cam_imu for camera in simulation.truth.cameras.values()]
        chain["cam1"]["T_cn_cnm1"] = poses[1] @ np.linalg.inv(poses[0])
    yield "camchain.yaml", _CHAIN + kalibr_yaml(chain)
    yield "imu.yaml", _noise_text(simulation)
    if room is None:
        yield "target.yaml", target_text(simulation.target)
    yield "truth.yaml", calibration_text(simulation.truth)
    yield "groundtruth.txt", trajectory_text(_track(simulation))
    head = _SCENARIO.format(
        seed=simulation.seed,
        rate=found.mean_rate_rad_s,
        acceleration=found.mean_acceleration_m_s2,
        visible="" if room else f",\n# and {_visible(found)} of the board's points seen",
    )
    yield "scenario.yaml", head + options_text(room or simulation.scenario)


def _visible(found: MotionStatistics) -> str:
    return ", ".join(f"{100 * part:.0f} % ({name})" for name, part in found.visible.items())


def camera_node(camera: Camera) -> dict[str, Any]:
    """Return a lens as an entry of Kalibr's camchain.yaml."""
    node: dict[str, Any] = {
        "cam_overlaps": [],
        "camera_model": camera.projection,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_model": camera.distortion,
        "intrinsics": camera.intrinsics,
        "resolution": np.array(camera.resolution),
        "rostopic": camera.topic,
    }
    return node | ({"line_delay": camera.line_delay_s} if camera.line_delay_s else {})


def _noise_text(simulation: CameraImuSimulation) -> str:
    """Return the text of imu.yaml, of several IMUs keyed by their names."""
    scenario, imus = simulation.scenario, simulation.recording.imus
    further_hz = scenario.further_imu_rate_hz or scenario.imu_rate_hz
    nodes = {
        name: _imu_node(samples, scenario.imu_rate_hz if name == "imu0" else further_hz)
        for name, samples in imus.items()
    }
    return _NOISE.format("the IMU" if len(imus) == 1 else "the IMUs") + kalibr_yaml(
        nodes["imu0"] if len(imus) == 1 else nodes
    )


def _imu_node(samples: ImuSamples, rate_hz: float) -> dict[str, Any]:
    assert samples.noise is not None
    return {**asdict(samples.noise), "update_rate": float(rate_hz), "rostopic": samples.topic}


def _track(simulation: CameraImuSimulation) -> TrajectoryTrack:
    true = simulation.trajectory
    return TrajectoryTrack(
        t_ns=simulation.recording.imus["imu0"].gyroscope.t_ns,
        p_target_imu=true.p_target_imu,
        q_target_imu_wxyz=true.q_target_imu_wxyz,
        omega_imu=true.omega_imu,
        f_imu=true.f_imu,
    )


CAMERAS_FILES = (
    *(f"cam{i}{ending}" for i in range(3) for ending in ("", "_corners.csv.gz", "_frames.csv")),
    *PLACES.values(),
    *("camchain.yaml", "target.yaml", "truth.yaml", "scenario.yaml"),
)
"""Files and folders of a simulated recording of cameras; it has some of them."""
_STAND_IN_CHAIN = "# Sizes of the images; the lenses only stand in, what is true of them stands in truth.yaml.\n"
_LENS_SCENARIO = "# What was simulated, with seed {seed}. Units are in the names: _s seconds, _m metres, _px pixels.\n"


def save_cameras_recording(
    simulation: CamerasSimulation,
    folder: Path,
    form: ImageForm = "folder",
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Write a simulated recording and its truth into a folder that is there, and return the files.

    Of images, which are rendered now, the tables are returned.

    Parameters
    ----------
    simulation : what was simulated
    folder : nothing of the recording's names is in it
    form : of images; corners, where the scenario wants no images, are always written as tables
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    written: list[Path] = []
    texts: dict[str, str] = {}
    if simulation.scenario.images:
        written += save_images(rendered_cameras(simulation), folder, form, progress)
    else:
        for name, frames in simulation.recording.cameras.items():
            written += save_frames(frames, folder, name)
        chain = {name: camera_node(frames.camera) for name, frames in simulation.recording.cameras.items()}
        texts["camchain.yaml"] = _STAND_IN_CHAIN + kalibr_yaml(chain)
    texts["target.yaml"] = target_text(simulation.target)
    texts["truth.yaml"] = calibration_text(simulation.truth)
    texts["scenario.yaml"] = _LENS_SCENARIO.format(seed=simulation.seed) + options_text(simulation.scenario)
    for name, text in texts.items():
        write_whole(folder / name, text)
        written.append(folder / name)
    return tuple(written)


def save_images(
    recording: ImageRecording, folder: Path, form: ImageForm, progress: Progress | None = None
) -> tuple[Path, ...]:
    """Write images, and what was recorded with them, into a folder; return the files, of images their tables.

    Parameters
    ----------
    recording : in the form "folder" its images alone
    folder : it is there, and has nothing in it of the same names
    form : "folder" (cam0/data.csv and cam0/data/<timestamp>.png), "euroc" (the same in mav0, with sensor.yaml), "ros1",
        "ros2" (SQLite) or "mcap"
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    if form == "folder":
        return tuple(
            save_simulated_images(stream, folder / name, progress) for name, stream in recording.streams.items()
        )
    if form == "euroc":
        made = folder / ".euroc"
        save_euroc(recording, made, progress)
        (made / "mav0").replace(folder / "mav0")
        made.rmdir()
        return tuple(sorted((folder / "mav0").glob("*/*.*")))
    streams = {
        name: replace(stream, frames=partial(_ahead, stream.frames)) for name, stream in recording.streams.items()
    }
    save_bag(replace(recording, streams=streams), folder / PLACES[form], form, progress)
    return (folder / PLACES[form],)


def _ahead(frames: Callable[[list[str]], Iterator[Frame]], notes: list[str]) -> Iterator[Frame]:
    """Yield the frames; a few of the next ones are being decoded meanwhile."""
    waiting: deque[tuple[Frame, Future[Grey]]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for frame in frames(notes):
            waiting.append((frame, pool.submit(frame.decode)))
            if len(waiting) >= _AHEAD:
                yield _decoded(*waiting.popleft())
        for pair in waiting:
            yield _decoded(*pair)


def _decoded(frame: Frame, image: "Future[Grey]") -> Frame:
    return Frame(t_ns=frame.t_ns, where=frame.where, decode=image.result)
