"""A recording of cameras and IMUs in front of a board, with Kalibr's files that describe them."""

from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..models.target import Target
from ..recording import CameraFrames, ImuSamples, Recording, Source, TriadSamples
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from .camera_folder import CornerStream, corner_streams, imu_files, recording_folder
from .column_roles import HELP
from .corner_frames import camera_frames
from .corner_table import read_corner_table, read_frame_stamps
from .files import file_source
from .kalibr_camchain import CameraInput, read_camchain
from .kalibr_imu_input import ImuInput, read_imu_input
from .kalibr_target import read_target
from .recognise import IN_MOTION
from .recordings import read_recognising
from .stamps import strayed
from .table import RATE_HELP

_RATE_TOLERANCE = 0.05
_HEADER = "Name the columns in the first line, such as ts_ns,wx,wy,wz,ax,ay,az (ts_ns in nanoseconds)."


def read_camera_imu(
    path: str | PathLike[str],
    *,
    cam: str | PathLike[str],
    imu: str | PathLike[str] | None,
    target: str | PathLike[str],
    units: str | Units | None = None,
) -> tuple[Recording, Target]:
    """Read a recording of cameras and IMUs in front of a calibration board.

    Parameters
    ----------
    path : folder with the corners of each camera, cam0_corners.csv, cam1_corners.csv, ..., and the samples of each
        IMU, imu0.csv, ...; all may be gzipped
    cam : Kalibr's camchain.yaml
    imu : Kalibr's imu.yaml, or None where the noise of the IMU is not known
    target : Kalibr's target.yaml
    units : of the IMU's samples, as for `gnomon.read`

    Returns
    -------
    recording : samples in m/s^2 and rad/s, frames with their corners
    target : the board

    Raises
    ------
    FormatError
        If one of Kalibr's files cannot be read, or is not as it should be.
    RecordingError
        If the recording cannot be read, or does not fit Kalibr's files; the message says where, and what to do.
    OptionError
        If `units` names no unit.
    """
    log = _Log(units=Units.parse(units) if isinstance(units, str) else units or Units())
    board = read_target(target, log.notes)
    known = read_camchain(cam, log.notes)
    noise = {} if imu is None else read_imu_input(imu, log.notes)
    log.sources.extend(file_source(Path(file)) for file in (cam, imu, target) if file is not None)
    folder = recording_folder(Path(path))
    streams = corner_streams(folder)
    imus = {name: _imu(name, file, noise.get(name), log) for name, file in imu_files(folder).items()}
    log.notes.extend(f"{name} of {Path(imu or '').name} has no samples here." for name in noise if name not in imus)
    names = _in_both(streams, known, folder, Path(cam), log)
    cameras = {name: _frames(streams[name], known[name], board, log) for name in names}
    recording = Recording(imus=imus, cameras=cameras, sources=tuple(log.sources), assumptions=tuple(log.notes))
    return recording, board


@dataclass(frozen=True, slots=True, kw_only=True)
class _Log:
    """What was stated, and what was read so far: the files, and sentences on what was assumed."""

    units: Units
    sources: list[Source] = field(default_factory=list[Source])
    notes: list[str] = field(default_factory=list[str])


def _in_both(
    streams: dict[str, CornerStream], known: dict[str, CameraInput], folder: Path, cam: Path, log: _Log
) -> list[str]:
    """Return the cameras that have corners and intrinsics."""
    both = [name for name in known if name in streams]
    if not both:
        raise RecordingError(
            f"{folder}: there are corners of {', '.join(streams)}, but {cam.name} describes {', '.join(known)}. "
            "Rename one of them."
        )
    for name in known:
        if name not in streams:
            log.notes.append(f"{name} of {cam.name} has no corners here and was left out.")
    for name, stream in streams.items():
        if name not in known:
            log.notes.append(f"{stream.corners.name} was left out: {cam.name} does not describe {name}.")
    return both


def _frames(stream: CornerStream, known: CameraInput, target: Target, log: _Log) -> CameraFrames:
    table = read_corner_table(stream.corners, log.units.time)
    log.sources.append(table.file.source)
    log.notes.extend(table.notes)
    all_stamps = None
    if stream.frames is not None:
        all_stamps, source, note = read_frame_stamps(stream.frames, log.units.time)
        log.sources.append(source)
        log.notes.extend(text for text in (note,) if text)
    return camera_frames(table, all_stamps, known, target, log.notes)


def _imu(name: str, file: Path, known: ImuInput | None, log: _Log) -> ImuSamples:
    try:
        recording = read_recognising(IN_MOTION, file, units=log.units)
    except RecordingError as error:  # there are no options here for tables that say too little
        raise RecordingError(str(error).replace(HELP, _HEADER).replace(RATE_HELP, _HEADER)) from None
    log.sources.extend(recording.sources)
    log.notes.extend(note if name == "imu0" else f"{name}: {note}" for note in recording.assumptions)
    samples = recording.imus["imu0"]
    if not len(samples.gyroscope):
        raise RecordingError(f"{file.name}: found no gyroscope; both triads of the IMU are needed.")
    accelerometer = _in_order(_si(samples.accelerometer, "accelerometer", file, log), name, log)
    gyroscope = _in_order(_si(samples.gyroscope, "gyroscope", file, log), name, log)
    if known is None:
        return ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope)
    stated, found = known.update_rate_hz, gyroscope.rate_hz
    if stated is not None and abs(found / stated - 1) > _RATE_TOLERANCE:
        log.notes.append(
            f"{name}: its samples come at {found:.4g} Hz, not at the stated update_rate of {stated:g} Hz; "
            "the noise densities do not depend on it."
        )
    return ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope, noise=known.noise, topic=known.topic)


def _si(samples: TriadSamples, sensor: str, file: Path, log: _Log) -> TriadSamples:
    """Return samples in m/s^2 or rad/s."""
    table = ACCELEROMETER_UNITS_M_S2 if sensor == "accelerometer" else GYROSCOPE_UNITS_RAD_S
    si = next(iter(table))
    factor = table[samples.unit]
    if factor is None:
        raise RecordingError(
            f"{file.name}: the {sensor} is in raw counts, but m/s^2 and rad/s are needed here. If it is in another "
            'unit, state it, for example --units "g deg/s". If these are counts, calibrate the IMU alone first '
            "(gnomon imu) and convert the samples with that (gnomon apply)."
        )
    if factor == 1:
        return replace(samples, unit=si)
    log.notes.append(f"{file.name}: the {sensor} was converted from {samples.unit} to {si}.")
    return replace(samples, values=samples.values * factor, unit=si)


def _in_order(samples: TriadSamples, name: str, log: _Log) -> TriadSamples:
    """Return samples in the order of time; of those that share a stamp the order of the file stays."""
    far = strayed(samples.t_ns)
    if far is not None:
        raise RecordingError(
            f"{name}: the stamp of sample {far}, {samples.t_ns[far]} ns, is more than half a day from the middle of "
            f"the others, {int(np.median(samples.t_ns))} ns. Mend or remove this sample."
        )
    steps = np.diff(samples.t_ns)
    backward = np.flatnonzero(steps < 0)
    if not len(backward):
        return samples
    order = np.argsort(samples.t_ns, kind="stable")
    # Samples that were only out of order make few breaks; two times that ran side by side make one at every sample.
    if np.count_nonzero(np.diff(order) != 1) > 3 * len(backward):
        first = int(backward[0])
        raise RecordingError(
            f"{name}: the stamps jump back by {-steps[first] * 1e-9:.6g} s after sample {first} and then run through "
            "times that were there before. The clock was set anew: cut the recording there."
        )
    note = f"{name}: the stamps go back at {len(backward)} of {len(samples)} samples, which were sorted."
    if note not in log.notes:  # both triads mostly share their stamps
        log.notes.append(note)
    return replace(samples, t_ns=samples.t_ns[order], values=samples.values[order])
