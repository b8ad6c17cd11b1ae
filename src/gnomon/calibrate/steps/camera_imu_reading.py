"""A recording of cameras and an IMU in front of a board -> samples and corners, whatever it was recorded as.

read target, lenses and noise -> open the recording -> find the board in the images -> Recording

A folder that holds corners already, which another program detected, is read as it is.
"""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType

from ...assess.checks.recorder_clocks import check_clocks
from ...errors import OptionError, RecordingError
from ...findings import Finding, make_finding
from ...formats.kalibr.camchain import CameraInput
from ...formats.kalibr.imu import ImuInput
from ...formats.kalibr.target import read_target
from ...formats.sensor_inputs import ImuFiles, imu_paths, made_from, read_cameras, read_imus, read_rig
from ...models.target import Target
from ...options import FrameSelection
from ...readers.files import file_source
from ...readers.images.frame_stamps import select_frames, select_images
from ...readers.images.image_recording import open_images
from ...readers.rig.folder import holds_corners, read_corner_recording, recording_folder, with_stated
from ...recording import CameraFrames, ImuSamples, KnownRig, Recording
from ...recording.recording import ImageRecording, ImageStream
from ...units import Units
from .camera_reading import Progress, read_camera_corners, stated_cameras

_RATE_TOLERANCE = 0.05
NO_BOARD = "none"
"""What is stated in place of a board's file where there is none."""

_WIDE = 1e4  # of the variances of what the same data told: a ten-thousandth of them is left
_NO_TOPICS: Mapping[str, str] = MappingProxyType({})


def read_camera_imu(
    path: str | PathLike[str],
    *,
    target: str | PathLike[str],
    cam: str | PathLike[str] | None = None,
    imu: ImuFiles | None = None,
    units: str | Units | None = None,
    topics: Mapping[str, str] = _NO_TOPICS,
    imu_table: str | PathLike[str] | None = None,
    selection: FrameSelection | None = None,
    workers: int | None = None,
    cache: str | PathLike[str] | None = None,
    progress: Progress | None = None,
) -> tuple[Recording, Target]:
    """Read a recording of cameras and IMUs in front of a calibration board, and find the board in its images.

    Parameters
    ----------
    path : a ROS 1 bag, a ROS 2 bag (sqlite or MCAP), a folder in the layout of EuRoC, TUM-VI or Kalibr, a folder of
        images or videos with a table of samples, a video; or a folder with the corners of each camera,
        cam0_corners.csv, cam1_corners.csv, ..., and the samples of each IMU, imu0.csv, ...
    target : Kalibr's target.yaml; or "none": there was no board, and the landmarks of the scene are mapped from the
        images of the first camera; others find them again, if their poses to it are stated
    cam : Kalibr's camchain.yaml, a calibration.yaml of gnomon, or another project's file of the cameras; not needed
        where the recording states the lenses itself, as EuRoC's does
    imu : Kalibr's imu.yaml, keyed imu0, imu1, ... or a file of each; None where the noise of the IMUs is not known
    units : of the IMU's samples, as for `gnomon.read`; bags are in SI units
    topics : "cam0", "imu0", ... -> topic of a bag; guessed where it is clear
    imu_table : table of the IMU's samples, where it is not in the recording
    selection : which of the frames are taken; all where not given
    workers : how many look for the board at once; as many as there are cores where not given
    cache : folder in which the corners are kept, so that the same images need not be looked at again
    progress : called with a sentence from time to time

    Returns
    -------
    recording : samples in m/s^2 and rad/s, frames with their corners
    target : the board

    Raises
    ------
    FormatError
        If one of the files that describe the rig cannot be read, or is not as it should be.
    RecordingError
        If the recording cannot be read, or does not fit those files; the message says where, and what to do.
    DetectionError
        If the board is in none of the images of a camera.
    OptionError
        If an option does not fit.
    """
    chosen = selection or FrameSelection()
    if str(target) != NO_BOARD and Path(path).is_dir() and holds_corners(recording_folder(Path(path))):
        if cam is None:
            raise OptionError(
                "--cam is missing: Kalibr's file of the cameras and their intrinsics. Name it, or put it into "
                f"{path} as camchain.yaml; gnomon camera makes one of the same corners."
            )
        recording, board = read_corner_recording(path, cam=cam, imu=imu, target=target, units=units)
        if chosen != FrameSelection():
            recording = select_frames(recording, chosen)
        return _with_rig(recording, cam), board
    notes: list[str] = []
    board = None if str(target) == NO_BOARD else read_target(target, notes)
    stated = {} if cam is None else read_cameras(cam, notes)
    noise = read_imus(imu, notes)
    suggested = {name: entry.camera.topic for name, entry in stated.items() if entry.camera.topic}
    suggested |= {name: entry.topic for name, entry in noise.items() if entry.topic}
    images = open_images(path, topics=topics, suggested=suggested, units=units, imu_table=imu_table)
    images = select_images(images, chosen)
    known = _known_cameras(images, stated, Path(path), cam, notes)
    tell = progress or (lambda _: None)
    cameras: dict[str, CameraFrames] = {}
    scene: tuple[Finding, ...] = ()
    if board is None:
        cameras, board, scene = _mapped(images, known, tell, notes)
        known = {}
    for name, entry in known.items():
        found = read_camera_corners(images, name, entry, board, workers=workers, cache=cache, progress=tell)
        cameras[name] = found.frames
        notes.extend(found.notes)
    stated_files = (cam, *imu_paths(imu), None if board.kind == "landmarks" else target)
    files = [Path(file) for file in stated_files if file is not None]
    recording = Recording(
        imus={name: _with_noise(name, samples, noise.get(name), notes) for name, samples in images.imus.items()},
        cameras=cameras,
        sources=(*(file_source(file) for file in files), *images.sources),
        assumptions=(*images.assumptions, *notes),
        findings=(*scene, *_clocks(images, tuple(cameras))),
    )
    return _with_rig(recording, cam), board


def _mapped(
    images: ImageRecording, known: Mapping[str, CameraInput], tell: Progress, notes: list[str]
) -> tuple[dict[str, CameraFrames], Target, tuple[Finding, ...]]:
    """Return what cameras saw of the landmarks of a scene, these, and what is wrong with them."""
    from .landmark_map import map_landmarks, relative_pose

    if not images.imus:
        raise RecordingError("without a board the IMU's samples are needed already to map the scene. Give --imu-table.")
    first = next(iter(known))
    placed = {name: entry for name, entry in known.items() if relative_pose(known[first], entry)}
    notes.extend(
        f"the images of {other} were left out: nothing states its pose to {first}, which maps the scene. gnomon camera "
        "finds it before a board; give its calibration.yaml as --cam, or T_cn_cnm1 in camchain.yaml."
        for other in known.keys() - placed.keys()
    )
    return map_landmarks(images.streams, placed, next(iter(images.imus.values())), tell)


def _with_rig(recording: Recording, cam: str | PathLike[str] | None) -> Recording:
    """Return the recording with what a calibration of its cameras alone tells of them together, where there is one."""
    if cam is None:
        return recording
    known = read_rig(cam)
    rig = None if known is None else known.of(recording.cameras)
    if made_from(cam, recording.sources):
        return _without_prior(recording, rig, Path(cam).name)
    if rig is None:
        return recording
    what = "the lenses and the poses of the cameras to each other" if rig.T_cam_cam0 else "the lenses"
    said = f"{what} are known by {Path(cam).name}, and estimated jointly with its covariance as their prior."
    return replace(recording, rig=rig, assumptions=(*recording.assumptions, said))


def _without_prior(recording: Recording, rig: KnownRig | None, name: str) -> Recording:
    """Return a recording whose cameras were calibrated from this very recording, which therefore is no prior of it.

    Lenses and poses start there and are estimated jointly; their covariance is made so wide that it adds nothing.
    """
    finding = make_finding("prior-same-data", name=name)
    cameras = {
        camera: frames
        if frames.lens_covariance is None
        else replace(frames, lens_covariance=_WIDE * frames.lens_covariance)
        for camera, frames in recording.cameras.items()
    }
    rig = None if rig is None else replace(rig, covariance=_WIDE * rig.covariance)
    return replace(recording, cameras=cameras, rig=rig, findings=(*recording.findings, finding))


def _clocks(images: ImageRecording, cameras: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return what is wrong with the clocks of cameras and IMUs, where the recorder's clock is known."""
    arrivals = {name: images.streams[name].arrivals for name in cameras} | dict(images.imu_arrivals)
    known = {name: stream for name, stream in arrivals.items() if stream is not None}
    return tuple(finding for finding in check_clocks(known) if finding.severity in {"warning", "problem"})


def _known_cameras(
    images: ImageRecording,
    stated: Mapping[str, CameraInput],
    path: Path,
    cam: str | PathLike[str] | None,
    notes: list[str],
) -> dict[str, CameraInput]:
    """Return the cameras that have images and a lens: as it is stated, else as the recording says."""
    if not stated:
        known = {name: _as_recorded(stream) for name, stream in images.streams.items()}
        unknown = [name for name, entry in known.items() if entry is None]
        if unknown:
            raise OptionError(
                f"{path}: the recording does not tell the lens of {', '.join(unknown)}. Give Kalibr's camchain.yaml "
                "with --cam, or the calibration.yaml that gnomon camera makes of images of the board."
            )
        notes.append("the lenses are those that the recording states.")
        return {name: entry for name, entry in known.items() if entry is not None}
    assert cam is not None
    return stated_cameras(images, stated, path, Path(cam).name, notes)


def _as_recorded(stream: ImageStream) -> CameraInput | None:
    if stream.camera is None:
        return None
    return CameraInput(
        camera=stream.camera, T_cam_imu=stream.T_cam_imu, time_shift_cam_imu_s=stream.time_shift_cam_imu_s
    )


def _with_noise(name: str, samples: ImuSamples, stated: ImuInput | None, notes: list[str]) -> ImuSamples:
    if stated is None:
        return samples
    rate = samples.gyroscope.rate_hz
    if stated.update_rate_hz is not None and abs(rate / stated.update_rate_hz - 1) > _RATE_TOLERANCE:
        notes.append(
            f"{name}: its samples come at {rate:.4g} Hz, not at the stated update_rate of {stated.update_rate_hz:g} "
            "Hz; the noise densities do not depend on it."
        )
    return with_stated(samples, stated)
