"""Which topics of a bag are the cameras and the IMUs: stated, else suggested by Kalibr's files, else told by names."""

import re
from collections.abc import Mapping, Sequence

from ...errors import OptionError, RecordingError
from ...frozen import value_class
from .messages import COMPRESSED_IMAGE, IMAGE, IMU
from .storage import Bag, Topic

_SENSOR = re.compile(r"(cam|imu)\d+")
_LISTED = 30
_HELP = "State the topics, for example --topics cam0=/camera/image_raw imu0=/imu/data"
_COMPRESSED, _RAW = re.compile(r"/compressed$"), re.compile(r"_?raw$")
_IMAGE_NAMES = ("image_raw", "image_mono", "image", "image_color", "image_rect", "image_rect_color")
_SIDES = {"left": 0, "right": 1}


def check_stated(topics: Mapping[str, str]) -> None:
    """Refuse names that are neither cameras nor IMUs.

    Raises
    ------
    OptionError
        With the name that was found.
    """
    for name in topics:
        if not _SENSOR.fullmatch(name):
            raise OptionError(f'topics: "{name}" is neither a camera nor an IMU. {_HELP}.')


def list_topics(bag: Bag) -> str:
    """Return what a bag holds, one line a topic, cameras and IMUs first."""
    order = sorted(
        bag.topics.values(), key=lambda topic: (topic.kind not in {IMAGE, COMPRESSED_IMAGE, IMU}, topic.name)
    )
    lines = [
        f"  {topic.name}  {topic.kind}  {topic.count} messages"
        + (f"  {(topic.count - 1) / bag.span_s:.4g} Hz" if bag.span_s > 0 and topic.count > 1 else "")
        for topic in order[:_LISTED]
    ]
    more = [f"  and {len(order) - _LISTED} more"] if len(order) > _LISTED else []
    return "\n".join(lines + more) if order else "  no topic at all"


def find_topic(bag: Bag, name: str) -> Topic | None:
    """Return a topic by its name, with or without its first slash; None where the bag does not hold it."""
    plain = name.strip().strip("/")
    return next((topic for key, topic in bag.topics.items() if key.strip("/") == plain), None)


def stated_topic(bag: Bag, sensor: str, name: str, kinds: Sequence[str]) -> Topic:
    """Return the topic that was stated for a camera or an IMU.

    Raises
    ------
    RecordingError
        If it is not there, has another type or no messages.
    """
    topic = find_topic(bag, name)
    if topic is None:
        problem = "is not in this bag"
    elif topic.kind not in kinds or topic.wire is None:
        problem = f"is of type {topic.kind or 'unknown'}, not {' or '.join(kinds)}"
    elif not topic.count:
        problem = "has no messages"
    else:
        return topic
    raise RecordingError(
        f"{bag.name}: {name}, which is stated to be {sensor}, {problem}. It holds:\n{list_topics(bag)}"
    )


def usable_topics(bag: Bag, kinds: Sequence[str]) -> list[Topic]:
    """Return the topics of some types that have messages, in the order of their names."""
    found = [topic for topic in bag.topics.values() if topic.kind in kinds and topic.count and topic.wire is not None]
    return sorted(found, key=lambda topic: topic.name)


def camera_topics(
    bag: Bag, stated: Mapping[str, str], suggested: Mapping[str, str], notes: list[str]
) -> dict[str, Topic]:
    """Return the topic of each camera, from cam0 on.

    Raises
    ------
    RecordingError
        If there is none, a stated one cannot be used, or it is not clear which ones are the cameras.
    """
    kinds = (IMAGE, COMPRESSED_IMAGE)
    named = {name: stated_topic(bag, name, topic, kinds) for name, topic in stated.items() if name.startswith("cam")}
    if named:
        return dict(sorted(named.items()))
    images = usable_topics(bag, kinds)
    if not images:
        raise RecordingError(f"{bag.name}: no topic holds images ({' or '.join(kinds)}). It holds:\n{list_topics(bag)}")
    wishes = {name: topic for name, topic in suggested.items() if name.startswith("cam")}
    for name, wish in sorted(wishes.items()):
        topic = find_topic(bag, wish)
        if topic is None or topic not in images:  # the same camera, compressed or not
            topic = find_topic(bag, f"{wish}/compressed") or find_topic(bag, _COMPRESSED.sub("", wish))
            if topic in images:
                notes.append(f"{name}: {wish} has no images in this bag; {topic.name if topic else ''} was read.")
        if topic is not None and topic in images:
            named[name] = topic
    if named:
        notes.extend(f"{name}: {wishes[name]} is not in this bag." for name in sorted(wishes) if name not in named)
        left = [topic.name for topic in images if _base(topic) not in {_base(used) for used in named.values()}]
        if left:
            notes.append(f"images of {', '.join(left)} were left out: no camera is said to have them.")
        return named
    return _guessed_cameras(bag, images, wishes, notes)


def _base(topic: Topic) -> str:
    return _COMPRESSED.sub("", topic.name)


def _guessed_cameras(bag: Bag, images: list[Topic], wishes: Mapping[str, str], notes: list[str]) -> dict[str, Topic]:
    cameras = _one_each(images, notes)
    if len(cameras) > 1:
        seen = [topic for topic in cameras if "depth" not in topic.name.lower()]
        notes.extend(f"{topic.name} was left out as depth." for topic in cameras if topic not in seen and seen)
        cameras = seen or cameras
    if len(cameras) == 1:
        name = next(iter(wishes)) if len(wishes) == 1 else "cam0"
        missed = f" ({wishes[name]} is not in this bag)" if name in wishes else ""
        notes.append(f"{name} is {cameras[0].name}, the only camera{missed}.")
        return {name: cameras[0]}
    ordered = sort_by_number(cameras, r"cam(?:era)?[_-]?(\d+)") or _sides(cameras)
    if ordered is None:
        raise RecordingError(
            f"{bag.name}: {len(cameras)} topics hold images, and their names do not tell which camera is cam0. "
            f"{_HELP}. It holds:\n{list_topics(bag)}"
        )
    notes.extend(f"cam{i} is {topic.name}, by its name." for i, topic in enumerate(ordered))
    return {f"cam{i}": topic for i, topic in enumerate(ordered)}


def _one_each(images: list[Topic], notes: list[str]) -> list[Topic]:
    """Return one topic a camera: raw rather than compressed, and of image_proc's versions the first."""
    best: dict[str, Topic] = {}
    for topic in sorted(images, key=lambda topic: (_preference(topic), topic.name)):
        base = _base(topic)
        parent, _, last = base.rpartition("/")
        key = parent if last in _IMAGE_NAMES else base
        if key in best:
            notes.append(f"{topic.name} was left out: it shows the same as {best[key].name}.")
        else:
            best[key] = topic
    return sorted(best.values(), key=lambda topic: topic.name)


def _preference(topic: Topic) -> tuple[int, bool]:
    last = _base(topic).rpartition("/")[2]
    place = _IMAGE_NAMES.index(last) if last in _IMAGE_NAMES else len(_IMAGE_NAMES)
    return place, topic.kind == COMPRESSED_IMAGE


def sort_by_number(topics: list[Topic], pattern: str) -> list[Topic] | None:
    """Return topics in the order of the number in their names; None where one has none, or two have the same."""
    found = [re.search(pattern, topic.name, re.IGNORECASE) for topic in topics]
    numbers = [int(match[1]) for match in found if match]
    if len(numbers) != len(topics) or len(set(numbers)) != len(topics):
        return None
    return [topic for _, topic in sorted(zip(numbers, topics, strict=True), key=lambda pair: pair[0])]


def _sides(topics: list[Topic]) -> list[Topic] | None:
    sides = {_SIDES.get(word): topic for topic in topics for word in re.findall(r"left|right", topic.name.lower())}
    return [sides[0], sides[1]] if len(topics) == 2 and set(sides) == {0, 1} and sides[0] != sides[1] else None


def thermometer_topic(thermometers: Sequence[Topic], imu: str, notes: list[str]) -> Topic | None:
    """Return, of the topics of thermometers, the one of an IMU; None where none is named like it.

    Parameters
    ----------
    imu : topic of the IMU
    notes : where a sentence on what was chosen is appended
    """
    parent = imu.rpartition("/")[0] or imu  # "/imu/data" and "/imu/temperature", "/imu0" and "/imu0/temperature"
    own = [topic for topic in thermometers if topic.name.startswith((f"{parent}/", f"{imu}/", f"{imu}_"))]
    if not own and len(thermometers) == 1 and "imu" in thermometers[0].name.lower():
        own = list(thermometers)
    left = [topic.name for topic in thermometers if topic not in own[:1]]
    if left:
        notes.append(f"thermometers that were left out, as not of {imu} by their names: {', '.join(left)}.")
    if own:
        notes.append(f"{own[0].name} is the thermometer of {imu}, by its name.")
    return own[0] if own else None


def imu_candidates(bag: Bag, stated: Mapping[str, str]) -> list[Topic]:
    """Return the topics that have to be read to find the IMUs.

    Raises
    ------
    RecordingError
        If a stated one cannot be used.
    """
    for name, topics in stated.items():
        if name.startswith("imu"):
            for topic in topics.split(","):
                stated_topic(bag, name, topic, (IMU,))
    return usable_topics(bag, (IMU,))


@value_class(eq=True)
class Triads:
    """Which triads the messages of a topic hold, and whether they themselves say that one of them is missing."""

    accelerometer: bool
    gyroscope: bool
    said: bool = False


Pair = tuple[Topic, Topic]
"""The topics of an IMU's accelerometer and gyroscope; mostly one topic is both."""


def imu_topics(
    bag: Bag,
    held_triads: Mapping[str, Triads],
    wishes: tuple[Mapping[str, str], Mapping[str, str]],
    notes: list[str],
) -> dict[str, Pair]:
    """Return the topics of accelerometer and gyroscope of each IMU, from imu0 on.

    Parameters
    ----------
    bag : for its topics, and for messages
    held_triads : of each topic that may be an IMU
    wishes : topics as stated and as suggested; an accelerometer and a gyroscope apart are "/a,/b"
    notes : where sentences on what was chosen are appended

    Raises
    ------
    RecordingError
        If it is not clear which topic is the IMU.
    """
    pairs, alone = _pairs([bag.topics[name] for name in held_triads], held_triads)
    stated, suggested = ({k: v for k, v in wish.items() if k.startswith("imu")} for wish in wishes)
    if stated:
        found = {name: _wished(pairs + alone, wish, held_triads) for name, wish in sorted(stated.items())}
        return {name: pair for name, pair in found.items() if pair is not None}
    found = {name: _wished(pairs, wish, held_triads) for name, wish in sorted(suggested.items())}
    known = {name: pair for name, pair in found.items() if pair is not None}
    notes.extend(f"{name}: {suggested[name]} is not in this bag." for name in found if name not in known)
    if known:
        return known
    guessed = _guessed_imus(bag, pairs or alone, notes)
    if len(guessed) == len(suggested) == 1:  # named as Kalibr's file names it
        return dict(zip(suggested, guessed.values(), strict=True))
    return guessed


def _pairs(candidates: list[Topic], triads: Mapping[str, Triads]) -> tuple[list[Pair], list[Pair]]:
    """Return the IMUs, and the topics that hold one triad without another topic for the other triad."""
    whole: list[Pair] = []
    apart: tuple[list[Topic], list[Topic]] = ([], [])
    for topic in candidates:
        found = triads[topic.name]
        if found.accelerometer == found.gyroscope:
            whole.append((topic, topic))
        else:
            apart[found.gyroscope].append(topic)
    if len(apart[0]) == len(apart[1]) == 1:
        together = [(apart[0][0], apart[1][0])]
    else:
        together = [(a, g) for a in apart[0] for g in apart[1] if _without_triad(a) == _without_triad(g)]
    used = {topic.name for pair in together for topic in pair}
    alone = [topic for topic in (*apart[0], *apart[1]) if topic.name not in used]
    # A triad that reads zero all the time is there all the same, unless the messages say that it is not.
    whole += [(topic, topic) for topic in alone if not triads[topic.name].said]
    return whole + together, [(topic, topic) for topic in alone if triads[topic.name].said]


def _without_triad(topic: Topic) -> str:
    return re.sub(r"(?i)accelerometer|accel|acc|gyroscope|gyro", "", topic.name)


def _wished(pairs: list[Pair], wish: str, triads: Mapping[str, Triads]) -> Pair | None:
    """Return the IMU that a topic belongs to, or the folder of topics that holds its two triads."""
    names = {part.strip().strip("/") for part in wish.split(",")}
    for pair in pairs:
        mine = {topic.name.strip("/") for topic in pair}
        if names <= mine or names == {common_topic(pair).strip("/")}:
            return pair
    every = {topic.name.strip("/"): topic for pair in pairs for topic in pair}
    if len(names) == 2 and names <= set(every):
        first, second = (every[part.strip().strip("/")] for part in wish.split(","))
        return (first, second) if triads[second.name].gyroscope else (second, first)
    return None


def common_topic(pair: Pair) -> str:
    """Return the topic of an IMU; of one whose triads come apart, what their names have in common if that tells."""
    first, second = (topic.name for topic in pair)
    if first == second:
        return first
    parents = {name.rpartition("/")[0] for name in (first, second)}
    return parents.pop() if len(parents) == 1 and "" not in parents else second


def _guessed_imus(bag: Bag, pairs: list[Pair], notes: list[str]) -> dict[str, Pair]:
    ordered = _by_number(pairs)
    if ordered is None:
        pairs = _without_doubles(pairs, notes)
        ordered = _by_number(pairs)
    if ordered is None:
        raise RecordingError(
            f"{bag.name}: {len(pairs)} topics may be the IMU, and their names do not tell which one is. {_HELP}. "
            f"It holds:\n{list_topics(bag)}"
        )
    notes.extend(
        f"imu{i} is {a.name}." if a == g else f"imu{i} is {a.name} (accelerometer) and {g.name} (gyroscope)."
        for i, (a, g) in enumerate(ordered)
    )
    return {f"imu{i}": pair for i, pair in enumerate(ordered)}


def _by_number(pairs: list[Pair]) -> list[Pair] | None:
    if len(pairs) < 2:
        return pairs
    ordered = sort_by_number([gyroscope for _, gyroscope in pairs], r"imu[_-]?(\d+)")
    return None if ordered is None else sorted(pairs, key=lambda pair: ordered.index(pair[1]))


def _without_doubles(pairs: list[Pair], notes: list[str]) -> list[Pair]:
    """Return the IMUs without those that are there in another form: put together from two topics, or filtered."""
    whole = [pair for pair in pairs if pair[0] == pair[1]]
    if whole and len(whole) < len(pairs):
        notes.append(f"accelerometer and gyroscope apart were left out: {whole[0][0].name} holds both.")
    pairs = list(whole or pairs)
    raw = {_RAW.sub("", pair[0].name).rstrip("/"): pair for pair in pairs if _RAW.search(pair[0].name)}
    for pair in list(pairs):
        better = raw.get(pair[0].name.rstrip("/"))
        if better is not None and better != pair:
            notes.append(f"{pair[0].name} was left out: by its name it is the filtered form of {better[0].name}.")
            pairs.remove(pair)
    return pairs
