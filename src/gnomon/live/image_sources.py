"""Where images come from: each source yields them as they arrive."""

import heapq
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from threading import Event
from typing import NamedTuple

from ..errors import OptionError, RecordingError
from ..formats.own.dataclass_file import read_options
from ..models.target import Target
from ..readers.images.image_recording import open_images
from ..recording.recording import Frame, Grey, ImageRecording
from ..simulate import CameraImuScenario, simulate_camera_imu
from ..simulate.camera_imu import CameraImuSimulation
from ..simulate.cameras import simulate_cameras
from ..simulate.images.board_images import rendered_cameras, simulated_images
from ..simulate.scenarios.cameras import CamerasScenario
from ..units import Units
from .sources import LiveSource, Pace, ReplaySource, open_source, parse_source

_AGAIN_S = 0.5
_NUMBERED_S = 0.5
_NUMBERED_NS = 1_000_000  # stamps that are closer than that count the images
_FORMS = "camera:INDEX, camera:URL, replay:RECORDING[@SPEED] or simulate[:SEED or scenario.yaml]"
SHOWN = CamerasScenario(
    views=1200,
    between=10,
    rate_hz=10.0,
    fill=(0.25, 0.6),
    resolution=(640, 480),
    intrinsics=(430.0, 429.0, 312.5, 242.0),
    distortion_coeffs=(-0.12, 0.03, 0.0002, 0.0),
)
"""What `simulate` shows: a board in another attitude every second, for two minutes."""

WAVED = CameraImuScenario(duration_s=90.0, camera_rate_hz=10.0)
"""The same of a rig that is waved before the board."""
_RIG_FORMS = (
    "replay:RECORDING[@SPEED] or simulate[:SEED or scenario.yaml], which have both; or a source of images, then one of "
    "samples, such as camera:0 serial:/dev/ttyUSB0"
)


class ImageArrival(NamedTuple):
    """An image, when it was taken [ns], and the camera that took it."""

    t_ns: int
    image: Grey
    camera: str = "cam0"


class ImageSource(ABC):
    """Something that takes images.

    Attributes
    ----------
    trouble : why nothing arrives now, and what to do; "" where all is well
    ended : whether nothing will come any more
    target : the board, where the source knows it
    place : of what is replayed; "" else
    """

    def __init__(self, target: Target | None = None, place: str = "") -> None:
        self.trouble, self.ended, self.target, self.place = "", False, target, place

    @abstractmethod
    def arriving_images(self, stop: Event) -> Iterator[ImageArrival]:
        """Yield images until it ends, or `stop` is set."""


def open_image_source(text: str) -> ImageSource:
    """Return the source that a text names.

    Raises
    ------
    OptionError
        If there is no such source.
    RecordingError
        If a recording cannot be replayed.
    """
    kind, where, number = parse_source(text, _FORMS, numbered=("replay",))
    if kind == "camera" and where:
        return CameraSource(where)
    if kind == "replay" and where:
        return ReplayImages(open_images(Path(where), cameras_alone=True), Pace(number or 1), place=where)
    if kind == "simulate":
        scenario, seed = SHOWN, 0
        if where.isdigit():
            seed = int(where)
        elif where:
            scenario = read_options(where, CamerasScenario)
        simulation = simulate_cameras(replace(scenario, images=True), seed)
        return ReplayImages(rendered_cameras(simulation), Pace(1), simulation.target)
    raise OptionError(f"{text}: there is no such source of images. Name one as {_FORMS}.")


def open_rig_sources(texts: Sequence[str], units: Units | None = None) -> tuple[ImageSource, LiveSource]:
    """Return the sources of images and of the samples of an IMU: of one recording, or one each.

    Parameters
    ----------
    texts : a recording to replay or what is simulated; or the source of images, then that of samples
    units : of samples, as far as they are stated

    Raises
    ------
    OptionError
        If there is no such source.
    RecordingError
        If a recording cannot be replayed.
    """
    if len(texts) == 2:
        first, second = sorted(texts, key=_place)
        return open_image_source(first), open_source(second, units)
    kind, where, number = parse_source(texts[0], _RIG_FORMS, numbered=("replay",))
    if len(texts) > 2 or kind not in {"replay", "simulate"}:
        raise OptionError(f"{' '.join(texts)}: expected {_RIG_FORMS}.")
    pace, target = Pace(number or 1), None
    if kind == "replay":
        recording = open_images(Path(where), units=units)
    else:
        simulation = simulate_rig(where)
        recording, target = simulated_images(simulation), simulation.target
    images = ReplayImages(recording, pace, target, where if kind == "replay" else "")
    return images, ReplaySource(recording.imus["imu0"], pace)


def _place(text: str) -> int:
    """Return where a source belongs among two: a camera first, what has no images last."""
    kind = text.partition(":")[0]
    return 0 if kind == "camera" else 2 if kind in {"serial", "tail", "udp", "phyphox", "http"} else 1


def simulate_rig(where: str) -> CameraImuSimulation:
    """Return what `simulate:WHERE` shows of a rig: with that seed, or of that scenario.yaml."""
    scenario, seed = WAVED, int(where) if where.isdigit() else 0
    if where and not where.isdigit():
        scenario = read_options(where, CameraImuScenario)
    return simulate_camera_imu(replace(scenario, images=True), seed)


class ReplayImages(ImageSource):
    """A recording, simulated or not, whose images come again as fast as they were taken, or some times faster.

    Parameters
    ----------
    recording : whose images are decoded when their time comes
    pace : how fast
    target : the board, where it is known
    place : of the recording, where it has one

    Raises
    ------
    RecordingError
        If there are no images in it.
    """

    def __init__(self, recording: ImageRecording, pace: Pace, target: Target | None = None, place: str = "") -> None:
        super().__init__(target, place)
        self._streams, self._pace = recording.streams, pace
        first = [next(stream.frames([]), None) for stream in self._streams.values()]
        stamps = [frame.t_ns for frame in first if frame is not None]
        if not stamps:
            raise RecordingError("there are no images to replay.")
        pace.begins_at(min(stamps))
        heads = [list(islice(stream.frames([]), 3)) for stream in self._streams.values()]
        self._numbered = any(b.t_ns - a.t_ns < _NUMBERED_NS for head in heads for a, b in pairwise(head))

    def arriving_images(self, stop: Event) -> Iterator[ImageArrival]:
        """Yield the images of all cameras in the order of time; those that are numbered alone, two a second."""
        streams = [self._frames_of(name) for name in self._streams]
        for t_ns, _, name, frame in heapq.merge(*streams):
            if self._pace.wait_for(t_ns, stop):
                return
            try:
                image = frame.decode()
            except RecordingError as error:
                self.trouble = str(error)
                continue
            yield ImageArrival(t_ns, image, name)
        self.trouble, self.ended = "The recording is at its end: stop.", True

    def _frames_of(self, name: str) -> Iterator[tuple[int, int, str, Frame]]:
        begin_ns, step_ns = self._pace.begin_ns, round(_NUMBERED_S * 1e9)
        for k, frame in enumerate(self._streams[name].frames([])):
            yield (begin_ns + k * step_ns if self._numbered else frame.t_ns), k, name, frame


class CameraSource(ImageSource):
    """A camera of this computer, or one that sends a stream; opened again after it was unplugged.

    Parameters
    ----------
    where : its number, 0, 1, ..., or an address that FFmpeg knows, such as rtsp://192.168.1.20/stream; of several
        cameras their numbers, 0,1
    """

    def __init__(self, where: str) -> None:
        super().__init__()
        if Path(where).is_file():
            raise OptionError(f"camera:{where}: this is a file. Replay it with replay:{where}.")
        several = where.split(",")
        self.where = several if all(part.isdigit() for part in several) else [where]

    def arriving_images(self, stop: Event) -> Iterator[ImageArrival]:
        """Yield images in grey, with the computer's time at which they arrived: monotonic, in ns since 1970.

        Several cameras are asked for their images at once; they are fetched and decoded after that.
        """
        import cv2

        since_1970_ns = time.time_ns() - time.monotonic_ns()
        while not stop.is_set():
            cameras = [cv2.VideoCapture(int(place) if place.isdigit() else place) for place in self.where]  # pyright: ignore[reportArgumentType, reportCallIssue]
            without = 0
            while not stop.is_set():
                stamps = [since_1970_ns + time.monotonic_ns() if camera.grab() else 0 for camera in cameras]
                if 0 in stamps:
                    without = stamps.index(0)
                    break
                for k, (t_ns, camera) in enumerate(zip(stamps, cameras, strict=True)):
                    there, image = camera.retrieve()
                    if there:
                        self.trouble = ""
                        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
                        yield ImageArrival(t_ns, grey, f"cam{k}")  # pyright: ignore[reportArgumentType]
            for camera in cameras:
                camera.release()
            lost = self.where[without]
            self.trouble = f"camera:{lost} gives no images: plug it in, and close other programs that use it."
            stop.wait(_AGAIN_S)
