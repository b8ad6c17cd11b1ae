"""Bags of ROS 1 and ROS 2 as topics and messages: by their index through rosbags, or record by record."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

from ...errors import FormatError, RecordingError
from ...formats.shared.structured import parse_yaml, read_structured_text
from ...frozen import value_class
from ..files import first_bytes
from .messages import Wire, bound_rosbags
from .salvage import (
    MCAP_MAGIC,
    ROS1_MAGIC,
    SQLITE_MAGIC,
    WIRES,
    Channel,
    Outcome,
    Record,
    kind_of_type,
    read_records,
    unpack_zstd,
)

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

Form = Literal["ros1", "mcap", "sqlite", "zstd"]
_MAGIC: dict[bytes, Form] = {
    ROS1_MAGIC: "ros1",
    MCAP_MAGIC: "mcap",
    SQLITE_MAGIC: "sqlite",
    b"\x28\xb5\x2f\xfd": "zstd",
}
_SUFFIXES = (".bag", ".mcap", ".db3", ".active")
_ZSTD = b"\x28\xb5\x2f\xfd"
METADATA = "metadata.yaml"
_INFORMATION = "rosbag2_bagfile_information"
_SPLIT = re.compile(r"_\d+$")
_LONGEST_NAME = 250  # that a file can have


class BrokenBagError(Exception):
    """A bag cannot be read by its index; what there is of it may be found record by record."""


@value_class(eq=True)
class Topic:
    """What a bag holds of one topic; `wire` is None where its messages are laid out in an unknown way."""

    name: str
    kind: str
    wire: Wire | None
    count: int


@value_class
class Bag:
    """Topics and messages of a recording.

    Attributes
    ----------
    name : of the file or folder, for messages
    files : those that hold the messages
    span_s : from the first to the last message [s]
    messages : yields the messages of some topics, as often as it is called; raises BrokenBagError where it cannot
    """

    name: str
    files: tuple[Path, ...]
    topics: Mapping[str, Topic]
    span_s: float
    messages: Callable[[Collection[str]], Iterator[Record]]


@value_class(eq=True)
class BagParts:
    """The files of a bag, and the folder whose metadata.yaml describes them."""

    path: Path
    form: Form
    files: tuple[Path, ...]
    described: bool = False


def form_of(path: Path) -> Form | None:
    """Return what a file is by its first bytes; None where it is no bag.

    Raises
    ------
    RecordingError
        If the file is not there, cannot be opened, or is empty.
    """
    head = first_bytes(path, 16)
    return next((form for magic, form in _MAGIC.items() if head.startswith(magic)), None)


def looks_like_bag(path: Path) -> bool:
    """Return whether a path is a bag: a file by its first bytes, a folder by metadata.yaml or if all in it are bags.

    A file that has the name of a bag is one too, so that `bag_parts` can tell what is wrong with it.
    """
    try:
        if path.is_dir():
            inside = {file for file in path.iterdir() if file.name != METADATA and not file.name.startswith(".")}
            return _information(path) is not None or (bool(inside) and set(_bags_in(path)) == inside)
        return path.is_file() and (path.suffix.lower() in _SUFFIXES or form_of(path) not in {None, "zstd"})
    except (OSError, RecordingError):
        return False


def bag_parts(path: Path, notes: list[str]) -> BagParts:
    """Return the files that make up a bag.

    Raises
    ------
    RecordingError
        If there is none, one of them is missing or empty, or they are compressed in an unknown way.
    """
    if not path.is_dir():
        form = form_of(path)
        if form is None:
            raise RecordingError(
                f"{path}: this is neither a ROS 1 bag (version 2.0), nor an MCAP file, nor a ROS 2 bag in SQLite; it "
                f"begins with {first_bytes(path, 13)!r}. Was it copied completely?"
            )
        if form == "zstd":
            raise RecordingError(f"{path}: this file is compressed with zstd. Unpack it first: zstd -d {path.name}")
        return BagParts(path=path, form=form, files=(path,))
    information = _information(path)
    if information is not None:
        _check_compression(path, information)
        listed = information.get("relative_file_paths")
        names = [PurePosixPath(str(name)[:_LONGEST_NAME]).name for name in listed] if isinstance(listed, list) else []
        missing = [name for name in names if not (path / name).is_file()]
        if missing or not names:
            raise RecordingError(
                f"{path}: {METADATA} names {', '.join(missing) or 'no file'}, which is not there. Copy the whole "
                "folder."
            )
        files = tuple(path / name for name in names)
        return BagParts(path=path, form=form_of(files[0]) or "sqlite", files=files, described=True)
    found = _bags_in(path)
    if not found:
        raise RecordingError(
            f"{path}: no bag in this folder. Expected {METADATA} with .db3 or .mcap files, or a .bag file."
        )
    files, form = tuple(sorted(found, key=_by_number)), found[next(iter(found))]
    stems = {_SPLIT.sub("", file.stem) for file in files}
    if len(set(found.values())) > 1 or len(stems) > 1:
        raise RecordingError(
            f"{path}: {len(files)} bags in this folder ({', '.join(file.name for file in files[:8])}). Name the one to "
            "read."
        )
    if form != "ros1":
        notes.append(f"{path.name}: there is no {METADATA}; the recorder was probably stopped before it wrote it.")
    return BagParts(path=path, form=form, files=files)


def _information(folder: Path) -> dict[str, Any] | None:
    """Return what metadata.yaml says of a bag; None where there is none that says anything."""
    if not (folder / METADATA).is_file():
        return None
    try:
        found = parse_yaml(read_structured_text(folder / METADATA), folder / METADATA)
    except FormatError:
        return None
    information = found.get(_INFORMATION) if isinstance(found, dict) else None
    return information if isinstance(information, dict) else None


def _check_compression(folder: Path, information: dict[str, Any]) -> None:
    mode, form = (str(information.get(f"compression_{key}") or "").lower() for key in ("mode", "format"))
    if mode not in {"", "none"} and form != "zstd":
        raise RecordingError(
            f'{folder}: {METADATA} says that each {mode} is compressed with "{form}", which gnomon does not know; it '
            "reads zstd and uncompressed bags. Write it anew without compression (ros2 bag convert)."
        )


def _bags_in(folder: Path) -> dict[Path, Form]:
    found: dict[Path, Form] = {}
    for file in sorted(folder.iterdir()):
        if file.is_file() and file.suffix in _SUFFIXES and file.stat().st_size:
            form = form_of(file)
            if form is not None:
                found[file] = form
    return found


def _by_number(file: Path) -> tuple[int, str]:
    number = re.search(r"_(\d+)$", file.stem)
    return int(number[1]) if number else -1, file.name


def open_indexed(parts: BagParts) -> Bag:
    """Return a bag that rosbags reads by its index.

    Raises
    ------
    BrokenBagError
        If rosbags cannot read it.
    """

    def readers() -> "list[Reader1 | Reader2]":
        bound_rosbags()
        if parts.form == "ros1":
            from rosbags.rosbag1 import Reader as Reader1

            return [Reader1(file) for file in parts.files]
        from rosbags.rosbag2 import Reader as Reader2

        return [Reader2(file) for file in ((parts.path,) if parts.described else parts.files)]

    def messages(wanted: Collection[str]) -> Iterator[Record]:
        """Yield the messages of some topics, by the index of the bag."""
        try:
            with ExitStack() as stack:
                for reader in readers():
                    stack.enter_context(reader)
                    chosen = [link for link in reader.connections if link.topic in wanted]
                    channels = {link.topic: _channel(link) for link in chosen}
                    if chosen:  # none would mean all
                        for link, received, data in reader.messages(chosen):
                            yield Record(channels[link.topic], received, data)
        except Exception as error:  # a damaged file makes its parser stumble in many ways
            raise BrokenBagError(str(error)) from error

    topics: dict[str, Topic] = {}
    try:
        with ExitStack() as stack:
            opened = [stack.enter_context(reader) for reader in readers()]
            links = [link for reader in opened for link in reader.connections]
            for link in links:
                named: list[Any] = [link.topic, link.msgtype]  # whatever metadata.yaml has there
                if not all(isinstance(name, str) for name in named):
                    raise BrokenBagError(f"topic and type {named} are no names")  # noqa: TRY301
                channel, before = _channel(link), topics.get(link.topic)
                topics[link.topic] = Topic(
                    name=link.topic,
                    kind=channel.kind,
                    wire=channel.wire,
                    count=link.msgcount + (before.count if before else 0),
                )
            full = [reader for reader in opened if reader.message_count]
            start, end = min((r.start_time for r in full), default=0), max((r.end_time for r in full), default=0)
    except Exception as error:
        raise BrokenBagError(str(error)) from error
    return Bag(
        name=parts.path.name, files=parts.files, topics=topics, span_s=max(end - start, 0) * 1e-9, messages=messages
    )


def _channel(link: Any) -> Channel:
    wire = WIRES.get(getattr(link.ext, "serialization_format", "ros1"))
    return Channel(topic=link.topic, kind=kind_of_type(link.msgtype), wire=wire)


@dataclass(slots=True)
class _Count:
    channel: Channel
    messages: int = 0


@dataclass(slots=True)
class _Tally:
    """What one pass over all records found."""

    topics: dict[str, _Count] = field(default_factory=dict[str, _Count])
    first_ns: int | None = None
    last_ns: int = 0

    def add(self, record: Record) -> None:
        self.topics.setdefault(record.channel.topic, _Count(record.channel)).messages += 1
        self.first_ns = record.received_ns if self.first_ns is None else min(self.first_ns, record.received_ns)
        self.last_ns = max(self.last_ns, record.received_ns)


def open_sequential(parts: BagParts, notes: list[str]) -> Bag:
    """Return a bag that is read record by record, as far as it goes; a sentence says where it ends early.

    Raises
    ------
    RecordingError
        If nothing can be read, or something is compressed in an unknown way.
    """
    tally = _Tally()
    for file in parts.files:
        if form_of(file) == "zstd":
            raise RecordingError(f"{file}: cannot be unpacked; the file is damaged. Copy it again.")
        outcome, before = Outcome(), sum(count.messages for count in tally.topics.values())
        for record in read_records(file, None, outcome):
            tally.add(record)
        found = sum(count.messages for count in tally.topics.values()) - before
        notes.extend(_sentences(file, found, outcome))
    if not tally.topics:
        raise RecordingError(f"{parts.path}: no message can be read; the file is damaged or cut off. Copy it again.")

    def messages(wanted: Collection[str]) -> Iterator[Record]:
        for file in parts.files:
            for record in read_records(file, wanted, Outcome()):
                if record.channel.wire == "cdr" and record.data.startswith(_ZSTD):
                    yield record._replace(data=_unpacked(record.data))
                elif record.channel.topic in wanted:
                    yield record

    return Bag(
        name=parts.path.name,
        files=parts.files,
        topics={
            name: Topic(name=name, kind=count.channel.kind, wire=count.channel.wire, count=count.messages)
            for name, count in tally.topics.items()
        },
        span_s=(tally.last_ns - (tally.first_ns or 0)) * 1e-9,
        messages=messages,
    )


def _unpacked(data: bytes) -> bytes:
    try:
        return unpack_zstd(data)
    except Exception as error:
        raise BrokenBagError(str(error)) from error


def _sentences(file: Path, found: int, outcome: Outcome) -> Iterator[str]:
    if outcome.damaged:
        chunks = "1 damaged chunk was" if outcome.damaged == 1 else f"{outcome.damaged} damaged chunks were"
        yield f"{file.name}: {chunks} left out, with all that was in it."
    if not outcome.complete:
        much = (
            f"{100 * outcome.read / outcome.size:.3g} % of its {outcome.size} bytes" if outcome.read else "a part of it"
        )
        yield (
            f"{file.name} ends early: it was cut off, or the recorder was stopped before it closed the file; "
            f"{found} messages were read from {much}."
        )
