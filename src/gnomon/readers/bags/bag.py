"""Format "bag": ROS 1 bags, ROS 2 bags in SQLite or MCAP, and single MCAP files, with images and IMU samples.

Timestamps are those of the messages' headers; the times of receipt are kept beside them. An IMU's samples are read at
once, images when they are asked for. A bag that ends early is read as far as it goes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from os import PathLike
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import ImuSamples, Source, TriadSamples, measurable_numbers
from ...recording.recording import Frame, Grey, ImageRecording, ImageStream
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from ..files import file_source
from ..images.image_pixels import compressed_image, grey_image
from ..rig.folder import in_order
from ..samples.recognise import IN_MOTION
from .messages import COMPRESSED_IMAGE, IMAGE, TEMPERATURE, Wire, compressed_message, image_message, stamp_ns
from .storage import Bag, BrokenBagError, Topic, bag_parts, looks_like_bag, open_indexed, open_sequential
from .survey import ImageTrack, ImuTrack, Track, imu_samples, settle_times, survey_topics
from .topics import (
    Pair,
    Triads,
    camera_topics,
    check_stated,
    common_topic,
    imu_candidates,
    imu_topics,
    list_topics,
    thermometer_topic,
    usable_topics,
)

_NONE: Mapping[str, str] = MappingProxyType({})
_AS_DEFINED = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}


def is_bag_path(path: str | PathLike[str]) -> bool:
    """Return whether a path is a bag.

    A file is one by its first bytes (ROS 1, MCAP, SQLite) or its name (.bag, .mcap, .db3), a folder where its
    metadata.yaml says so or nothing but bags is in it.
    """
    return looks_like_bag(Path(path))


def open_bag(
    path: str | PathLike[str],
    *,
    topics: Mapping[str, str] = _NONE,
    suggested: Mapping[str, str] = _NONE,
    units: Units | None = None,
    need_imu: bool | None = True,
    with_cameras: bool = True,
) -> ImageRecording:
    """Open a bag: read the samples of its IMUs, and prepare the streams of its cameras.

    Parameters
    ----------
    path : a ROS 1 bag, an MCAP file, an SQLite file of ROS 2, or the folder of a ROS 2 bag
    topics : topics of cameras and IMUs as stated, such as {"cam0": "/a", "imu0": "/b"}; an accelerometer and a
        gyroscope that have topics of their own are "/a,/b"
    suggested : the same as Kalibr's files name them; used where the bag holds them
    units : of the IMUs' samples where they are not in m/s^2 and rad/s, as sensor_msgs/Imu has them
    need_imu : whether a bag without IMU is an error; None to pass over IMUs
    with_cameras : whether images are looked at

    Returns
    -------
    streams cam0, ... and samples imu0, ... [m/s^2, rad/s]; `assumptions` say what was chosen, and what is missing of a
    bag that ends early

    Raises
    ------
    RecordingError
        If it cannot be read, it does not tell which topics are meant, or its images are of a kind that is not read.
    OptionError
        If `topics` names something that is neither a camera nor an IMU.
    """
    check_stated(topics)
    notes: list[str] = []
    parts = bag_parts(Path(path), notes)
    order = _Order(topics=topics, suggested=suggested, units=units or Units(), need_imu=need_imu, cameras=with_cameras)
    with ThreadPoolExecutor(max_workers=1) as beside:  # hashing lets other threads run

        @cache
        def hashing() -> "Future[tuple[Source, ...]]":
            return beside.submit(lambda: tuple(file_source(file) for file in parts.files))

        try:
            try:
                return _recording(open_indexed(parts), order, hashing, [*notes])
            except BrokenBagError:
                return _recording(open_sequential(parts, notes), order, hashing, notes)
        except BrokenBagError as error:
            raise RecordingError(f"{path}: cannot be read ({error}). Copy it again.") from None
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror or error}). Copy it again.") from None


def bag_holds_imu(path: str | PathLike[str]) -> bool:
    """Tell by its list of topics whether a bag has samples of an IMU; False for one that has lost its list."""
    try:
        return bool(imu_candidates(open_indexed(bag_parts(Path(path), [])), {}))
    except BrokenBagError:
        return False


def bag_holds_only_imu(path: str | PathLike[str]) -> bool:
    """Tell by its list of topics whether a bag has samples of an IMU and no images; False for one without its list."""
    try:
        bag = open_indexed(bag_parts(Path(path), []))
        return bool(imu_candidates(bag, {})) and not usable_topics(bag, (IMAGE, COMPRESSED_IMAGE))
    except (BrokenBagError, RecordingError):
        return False


@value_class(eq=True)
class _Order:
    """What is wanted of a bag."""

    topics: Mapping[str, str]
    suggested: Mapping[str, str]
    units: Units
    need_imu: bool | None
    cameras: bool


def _recording(
    bag: Bag, order: _Order, hashing: Callable[[], "Future[tuple[Source, ...]]"], notes: list[str]
) -> ImageRecording:
    cameras = camera_topics(bag, order.topics, order.suggested, notes) if order.cameras else {}
    candidates = [] if order.need_imu is None else imu_candidates(bag, order.topics)
    if not candidates and order.need_imu:
        raise RecordingError(
            f"{bag.name}: no topic holds samples of an IMU (sensor_msgs/Imu). Record them in the same bag, or give a "
            f"table of them. It holds:\n{list_topics(bag)}"
        )
    hashed = hashing()  # from here on the whole bag is read anyhow
    thermometers = usable_topics(bag, (TEMPERATURE,)) if candidates else []
    images, samples, warmth = survey_topics(bag, cameras, candidates, thermometers)
    _check_complete([*images.values(), *samples.values(), *warmth.values()])
    triads = {name: track.triads() for name, track in samples.items()}
    pairs = _imu_pairs(bag, triads, order, notes) if triads else {}
    used = [samples[topic.name] for pair in pairs.values() for topic in dict.fromkeys(pair)]
    of = {name: thermometer_topic(thermometers, common_topic(pair), notes) for name, pair in pairs.items()}
    own = {name: warmth[topic.name] for name, topic in of.items() if topic is not None}
    settle_times([*images.values(), *used, *{track.topic.name: track for track in own.values()}.values()], notes)
    arrivals = {name: samples[gyroscope.name].arrivals() for name, (_, gyroscope) in pairs.items()}
    return ImageRecording(
        imus={
            name: replace(
                _imu(name, pair, samples, order, notes), temperature=own[name].samples() if name in own else None
            )
            for name, pair in pairs.items()
        },
        streams={name: _stream(bag, topic, images[topic.name], notes) for name, topic in cameras.items()},
        sources=hashed.result(),
        assumptions=tuple(notes),
        imu_arrivals={name: known for name, known in arrivals.items() if known is not None},
    )


def _imu_pairs(bag: Bag, triads: Mapping[str, Triads], order: _Order, notes: list[str]) -> dict[str, Pair]:
    """Return the topics of the IMUs; none where it is not clear which they are and none is needed."""
    try:
        return imu_topics(bag, triads, (order.topics, order.suggested), notes)
    except RecordingError:
        if order.need_imu:
            raise
        notes.append("the samples of its IMUs were left out, as it is not clear which topic is meant.")
        return {}


def _check_complete(tracks: Sequence[Track]) -> None:
    """Hold what was read against what the index says; parsers pass over damaged places without a word."""
    for track in tracks:
        found = len(track.received) + track.damaged
        if found < track.topic.count:
            raise BrokenBagError(f"{found} of {track.topic.count} messages of {track.topic.name} are there")


def _imu(name: str, pair: Pair, tracks: Mapping[str, ImuTrack], order: _Order, notes: list[str]) -> ImuSamples:
    accelerometer, gyroscope = (tracks[topic.name] for topic in pair)
    samples = imu_samples(accelerometer, gyroscope, common_topic(pair))
    for sensor in ("accelerometer", "gyroscope"):
        if not len(getattr(samples, sensor)) and order.need_imu:
            raise RecordingError(
                f"{gyroscope.where}: the messages hold no {sensor}; both triads are needed. If it has a topic of its "
                f"own, state both, for example --topics {name}=/imu/accel,/imu/gyro."
            )
    return replace(
        samples,
        accelerometer=in_order(_si(samples.accelerometer, "accelerometer", name, order.units, notes), name, notes),
        gyroscope=in_order(_si(samples.gyroscope, "gyroscope", name, order.units, notes), name, notes),
    )


def _si(samples: TriadSamples, sensor: str, name: str, units: Units, notes: list[str]) -> TriadSamples:
    """Return samples in m/s^2 or rad/s; a sentence says where their magnitudes look like another unit."""
    stated = getattr(units, sensor)
    if stated not in {None, _AS_DEFINED[sensor]}:
        factor = (ACCELEROMETER_UNITS_M_S2 if sensor == "accelerometer" else GYROSCOPE_UNITS_RAD_S)[stated]
        if factor is None:
            raise RecordingError(
                f"{name}: the {sensor} is stated to be in raw counts, but m/s^2 and rad/s are needed here. Calibrate "
                "the IMU alone first (gnomon imu) and convert the samples with that (gnomon apply)."
            )
        notes.append(f"{name}: the {sensor} was converted from {stated} to {samples.unit}.")
        return TriadSamples(t_ns=samples.t_ns, values=samples.values * factor, unit=samples.unit)
    sound = measurable_numbers(samples.values).all(axis=1)
    if stated is None and np.count_nonzero(sound) > 1:
        if sensor == "accelerometer":
            unit = IN_MOTION.accelerometer(samples.values[sound])
        else:
            unit = IN_MOTION.gyroscope(samples.values[sound], samples.t_ns[sound], None)
        if unit.unit not in {_AS_DEFINED[sensor], "count"}:
            notes.append(
                f"{name}: sensor_msgs/Imu is in {_AS_DEFINED[sensor]}, but the {sensor} looks like {unit.unit} "
                f'({unit.reason}). If it is, state it: --units "g deg/s".'
            )
    return samples


def _stream(bag: Bag, topic: Topic, track: ImageTrack, notes: list[str]) -> ImageStream:
    times = track.times()[0]
    if not len(times):
        raise RecordingError(f"{track.where}: none of its {topic.count} messages is an image. Record it again.")
    if track.by_receipt and len(times) > 1 and not np.ptp(track.times()[1]):
        raise RecordingError(
            f"{track.where}: the images have no timestamps, neither their own nor the recorder's. Have the driver "
            "timestamp them, and record them again."
        )
    if track.bits is not None and track.bits < 16:
        notes.append(f"{topic.name}: its 16-bit images hold {track.bits} bits; they were scaled by that.")
    source = _Images(
        bag=bag,
        topic=topic,
        where=track.where,
        bits=track.bits,
        by_receipt=track.by_receipt,
        zero_is_missing=track.zero_is_missing,
    )
    return ImageStream(frames=source.frames, count=len(times), topic=topic.name, arrivals=track.arrivals())


@value_class
class _Images:
    """The images of one topic, read anew as often as they are asked for."""

    bag: Bag
    topic: Topic
    where: str
    bits: int | None
    by_receipt: bool
    zero_is_missing: bool

    def frames(self, notes: list[str]) -> Iterator[Frame]:
        """Yield all images in the order in which they were recorded; their pixels are decoded where they are needed."""
        wire = self.topic.wire or "cdr"
        form = _decode_compressed if self.topic.kind == COMPRESSED_IMAGE else _decode_raw
        try:
            for record in self.bag.messages((self.topic.name,)):
                stamp = stamp_ns(record.data, wire)
                if stamp is None or (self.zero_is_missing and stamp == 0):
                    continue
                t_ns = record.received_ns if self.by_receipt else stamp
                where = f"{self.where} at {t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d} s"
                yield Frame(t_ns=t_ns, where=where, decode=partial(form, record.data, wire, where, self.bits))
        except (BrokenBagError, OSError) as error:
            notes.append(f"{self.where}: the images end early, as the bag cannot be read further ({error}).")


def _decode_raw(data: bytes, wire: Wire, where: str, bits: int | None) -> Grey:
    return grey_image(image_message(data, wire, where), where, bits)


def _decode_compressed(data: bytes, wire: Wire, where: str, bits: int | None) -> Grey:
    form, picture = compressed_message(data, wire, where)
    return compressed_image(picture, form, where, bits)
