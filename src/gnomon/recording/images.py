"""Cameras that were recorded as images: streams of frames that are decoded only where they are needed."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from ..frozen import FrozenMapping, value_class
from ..models.camera import Camera
from . import Floats, ImuSamples, Integers, Source, frozen_array

Grey = NDArray[np.uint8]
"""An image (height, width); [0, 0] is the top left pixel."""


@value_class
class Frame:
    """One image as its file holds it.

    Attributes
    ----------
    t_ns : timestamp of the frame, in the camera's clock [ns]
    where : the file, or file, topic and timestamp, for messages
    decode : returns the image in 8 bits of grey; it may be called in another thread, and raises RecordingError where
        the image is damaged
    """

    t_ns: int
    where: str
    decode: Callable[[], Grey]


@value_class
class Arrivals:
    """When the messages of a stream were stamped, and when they reached the recorder.

    Attributes
    ----------
    t_ns : (n,) timestamps of the sensor's clock [ns]
    received_ns : (n,) of the recorder's clock [ns]
    """

    t_ns: Integers
    received_ns: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, np.int64))
        object.__setattr__(self, "received_ns", frozen_array(self.received_ns, np.int64))


@value_class
class ImageStream:
    """The images of one camera.

    Attributes
    ----------
    frames : yields all of them, in the order in which they were recorded, as often as it is called; the memory that it
        needs does not grow with their number. Where the recording ends early, what can be read is yielded and a
        sentence about the rest goes to the list that is given to it.
    count : how many there seem to be, for progress; zero where nothing tells
    topic : of a bag, else ""
    camera : lens and intrinsics, where the recording itself states them (EuRoC's sensor.yaml)
    T_cam_imu, time_shift_cam_imu_s : guesses of the extrinsics, where the recording states them
    arrivals : where the recorder's clock is known
    """

    frames: Callable[[list[str]], Iterator[Frame]]
    count: int = 0
    topic: str = ""
    camera: Camera | None = None
    T_cam_imu: Floats | None = None
    time_shift_cam_imu_s: float | None = None
    arrivals: Arrivals | None = None


@value_class
class ImageRecording:
    """A recording whose cameras are images still.

    Attributes
    ----------
    imus : mapping from "imu0", ... to ImuSamples; empty where the recording has none
    streams : mapping from "cam0", ... to ImageStream; at least one
    sources : the files that were read, or are to be read: name and hash of all that the images come from
    assumptions : sentences on what the reader had to assume
    imu_arrivals : of the IMUs, where the recorder's clock is known
    """

    imus: Mapping[str, ImuSamples]
    streams: Mapping[str, ImageStream]
    sources: tuple[Source, ...] = ()
    assumptions: tuple[str, ...] = ()
    imu_arrivals: Mapping[str, Arrivals] = field(default_factory=dict[str, Arrivals])

    def __post_init__(self) -> None:
        for name in ("imus", "streams", "imu_arrivals"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))
