"""One pass over a bag: the timestamps of the images, and the samples of the IMUs."""

from array import array
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from ...errors import RecordingError
from ...progress import tell_parts
from ...recording import Floats, ImuSamples, Integers, TemperatureSamples, TriadSamples
from ...recording.recording import Arrivals
from ..images.image_pixels import (
    bit_depth,
    check_compression,
    check_encoding,
    largest_in_picture,
    largest_value,
    sixteen_bits,
)
from .messages import (
    COMPRESSED_IMAGE,
    ImuBlock,
    Wire,
    compressed_message,
    image_message,
    imu_block,
    stamp_ns,
    temperature_message,
)
from .storage import Bag, BrokenBagError, Topic
from .topics import Triads

_BLOCK = 4096  # messages of an IMU that are kept as bytes
_PICTURES = 20  # compressed pictures of 16 bits that are unpacked to find their depth
_HALF_A_DAY_NS = 12 * 3.6e12
_OTHER_CLOCK_NS = 1e9  # header and recorder differ by more than any transport takes


@dataclass(slots=True, kw_only=True)
class Track:
    """What was found of one topic.

    Attributes
    ----------
    timestamps, received : of each message that has a header [ns]
    damaged : how many have none
    by_receipt : whether the times of receipt take the place of the timestamps
    zero_is_missing : whether a timestamp of zero means that there is none
    """

    where: str
    topic: Topic
    wire: Wire
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    received: "array[int]" = field(default_factory=lambda: array("q"))
    damaged: int = 0
    by_receipt: bool = False
    zero_is_missing: bool = False

    def times(self) -> tuple[Integers, Integers]:
        """Return timestamps and times of receipt of the messages that are used, (n,) each [ns]."""
        stamps, received = np.array(self.stamps, np.int64), np.array(self.received, np.int64)
        keep = self.used(stamps)
        return stamps[keep], received[keep]

    def used(self, stamps: Integers) -> Integers:
        """Return the indices of the messages whose timestamp is one, or does not matter."""
        return np.flatnonzero((stamps != 0) | (not self.zero_is_missing))

    def arrivals(self) -> Arrivals | None:
        """Return the two times of each message; None where one had to take the place of the other."""
        if self.by_receipt:
            return None
        stamps, received = self.times()
        return Arrivals(t_ns=stamps, received_ns=received)


@dataclass(slots=True, kw_only=True)
class ImageTrack(Track):
    """The images of one topic: their timestamps, and the depth of those that have 16 bits."""

    largest: int = 0
    pictures: int = 0
    sixteen: bool | None = None

    def add(self, data: bytes, received_ns: int) -> None:
        """Take the next message."""
        stamp = stamp_ns(data, self.wire)
        if stamp is None:
            self.damaged += 1
            return
        self.stamps.append(stamp)
        self.received.append(received_ns)
        if self.sixteen is not False:
            self._measure(data)

    def _measure(self, data: bytes) -> None:
        """Find the largest value of images of 16 bits; refuse what is not read at the first image."""
        if self.topic.kind == COMPRESSED_IMAGE:
            form, picture = compressed_message(data, self.wire, self.where)
            check_compression(form, self.where)
            with suppress(RecordingError):  # a damaged image is left to the one who wants to see it
                largest = largest_in_picture(picture, self.where)
                self.largest, self.pictures = max(self.largest, largest), self.pictures + 1
                self.sixteen = largest > 0 and self.pictures < _PICTURES
            return
        image = image_message(data, self.wire, self.where)
        check_encoding(image.encoding, self.where)
        self.sixteen = sixteen_bits(image.encoding)
        if self.sixteen:
            with suppress(RecordingError):
                self.largest = max(self.largest, largest_value(image, self.where))

    @property
    def bits(self) -> int | None:
        """How many bits the images have, where they need scaling."""
        return bit_depth(self.largest) if self.largest else None


@dataclass(slots=True, kw_only=True)
class ImuTrack(Track):
    """The samples of one topic."""

    pending: list[tuple[int, bytes]] = field(default_factory=list[tuple[int, bytes]])
    blocks: list[ImuBlock] = field(default_factory=list[ImuBlock])

    def add(self, data: bytes, received_ns: int) -> None:
        """Take the next message."""
        self.pending.append((received_ns, data))
        if len(self.pending) >= _BLOCK:
            self.finish()

    def finish(self) -> None:
        """Read the messages that were taken."""
        block = imu_block([data for _, data in self.pending], self.wire)
        received = np.array([received_ns for received_ns, _ in self.pending], dtype=np.int64)
        self.damaged += len(received) - len(block.place)
        self.received.frombytes(received[block.place].tobytes())
        self.stamps.frombytes(block.t_ns.tobytes())
        self.blocks.append(block)
        self.pending.clear()

    def triads(self) -> Triads:
        """Return which triads there are: neither marked as missing nor zero all the time."""
        said = [
            all(bool(getattr(block, name).all()) for block in self.blocks)
            for name in ("no_accelerometer", "no_gyroscope")
        ]
        with np.errstate(invalid="ignore"):  # damaged numbers may be none
            zero = [
                not any(bool(getattr(block, name).any()) for block in self.blocks)
                for name in ("accelerometer", "gyroscope")
            ]
        return Triads(
            accelerometer=not (said[0] or zero[0]), gyroscope=not (said[1] or zero[1]), said=said[0] or said[1]
        )

    def triad(self, name: str) -> TriadSamples:
        """Return the samples of one triad with the times that are used; none where it is marked as missing."""
        stamps, received = self.times()
        values: Floats = np.concatenate([getattr(block, name) for block in self.blocks])
        missing = np.concatenate([getattr(block, f"no_{name}") for block in self.blocks])
        keep = self.used(np.array(self.stamps, np.int64))
        there = ~missing[keep]
        t_ns = received if self.by_receipt else stamps
        unit = "m/s^2" if name == "accelerometer" else "rad/s"
        return TriadSamples(t_ns=t_ns[there], values=values[keep][there], unit=unit)


@dataclass(slots=True, kw_only=True)
class ThermometerTrack(Track):
    """The readings of one topic."""

    values: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, data: bytes, received_ns: int) -> None:
        """Take the next message."""
        stamp, value = stamp_ns(data, self.wire), temperature_message(data, self.wire)
        if stamp is None or value is None:
            self.damaged += 1
            return
        self.stamps.append(stamp)
        self.received.append(received_ns)
        self.values.append(value)

    def samples(self) -> TemperatureSamples | None:
        """Return the readings that are numbers, in the order of time; None of fewer than two."""
        stamps, received = self.times()
        values = np.array(self.values)[self.used(np.array(self.stamps, np.int64))]
        t_ns = received if self.by_receipt else stamps
        order = np.argsort(t_ns, kind="stable")[np.isfinite(values[np.argsort(t_ns, kind="stable")])]
        if len(order) < 2:
            return None
        return TemperatureSamples(t_ns=t_ns[order], values=values[order], unit="degC")


def imu_samples(accelerometer: ImuTrack, gyroscope: ImuTrack, topic: str) -> ImuSamples:
    """Return the samples of an IMU whose triads may come in topics of their own."""
    return ImuSamples(
        accelerometer=accelerometer.triad("accelerometer"), gyroscope=gyroscope.triad("gyroscope"), topic=topic
    )


def survey_topics(
    bag: Bag, cameras: Mapping[str, Topic], imus: list[Topic], thermometers: list[Topic]
) -> tuple[dict[str, ImageTrack], dict[str, ImuTrack], dict[str, ThermometerTrack]]:
    """Pass once over a bag, and return what was found of each topic, by its name.

    Raises
    ------
    RecordingError
        If the images are of a kind that is not read.
    BrokenBagError
        If the bag cannot be read to its end by its index.
    """
    images: dict[str, ImageTrack] = {}
    samples: dict[str, ImuTrack] = {}
    for topic in cameras.values():
        images[topic.name] = ImageTrack(where=f"{bag.name}: {topic.name}", topic=topic, wire=topic.wire or "cdr")
    for topic in imus:
        samples[topic.name] = ImuTrack(where=f"{bag.name}: {topic.name}", topic=topic, wire=topic.wire or "cdr")
    warmth = {
        topic.name: ThermometerTrack(where=f"{bag.name}: {topic.name}", topic=topic, wire=topic.wire or "cdr")
        for topic in thermometers
    }
    tracks: dict[str, ImageTrack | ImuTrack | ThermometerTrack] = {**images, **samples, **warmth}
    try:
        count = sum(track.topic.count for track in tracks.values())
        for record in tell_parts(f"reading {bag.name}", bag.messages(tracks.keys()), count):
            tracks[record.channel.topic].add(record.data, record.received_ns)
        for track in samples.values():
            track.finish()
    except OverflowError as error:
        raise BrokenBagError(f"a time of receipt that does not fit 64 bits ({error})") from None
    return images, samples, warmth


def settle_times(tracks: list[Track], notes: list[str]) -> None:
    """Choose between timestamps and times of receipt, for all topics that are used.

    Timestamps of the sensors are used. Where a topic has none (all are zero) its times of receipt take their place, and
    with it those of all topics whose timestamps are in another clock than the recorder's.
    """
    for track in tracks:
        stamps = np.array(track.stamps, dtype=np.int64)
        zeros = int(np.count_nonzero(stamps == 0))
        if zeros == len(stamps) > 0:
            track.by_receipt = True
            notes.append(
                f"{track.topic.name}: all timestamps are zero; the times at which the recorder received the messages "
                "were used. They jitter: expect larger residuals, and have the driver timestamp its messages."
            )
        elif zeros and abs(float(np.median(stamps))) > _HALF_A_DAY_NS:
            track.zero_is_missing = True
            notes.append(f"{track.topic.name}: {zeros} of {len(stamps)} messages have no timestamp and were left out.")
        if track.damaged:
            notes.append(f"{track.topic.name}: {track.damaged} damaged messages were left out.")
    if not any(track.by_receipt for track in tracks):
        return
    for track in tracks:
        stamps, received = track.times()
        if not track.by_receipt and len(stamps) and abs(float(np.median(received - stamps))) > _OTHER_CLOCK_NS:
            track.by_receipt = True
            notes.append(
                f"{track.topic.name}: its timestamps are not in the recorder's clock; since other messages have no "
                "timestamps, the times of receipt were used here, too."
            )
