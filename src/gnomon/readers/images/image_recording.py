"""Recordings of cameras as images, with an IMU: the format is found by the content, images are only read on demand."""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType

from ...errors import FormatError, OptionError, RecordingError
from ...formats.kalibr.camchain import camera_of
from ...formats.kalibr.imu import ImuInput
from ...formats.shared.foreign_yaml import read_foreign_yaml, read_transform
from ...formats.shared.structured import Node
from ...frozen import value_class
from ...geometry.rotations import inverse_pose
from ...models.camera import Camera
from ...recording import Floats, ImuSamples, frozen_array
from ...recording.recording import ImageRecording, ImageStream
from ...recording.samples import ImuNoise
from ...units import Units
from ..devices.device_log import is_device_log
from ..devices.gpmf import has_gpmf
from ..files import first_bytes
from ..recordings import ReadLog, stated_units
from ..rig.folder import EXPECTED as EXPECTED_IMU
from ..rig.folder import folder_holds_imu as corners_with_imu
from ..rig.folder import holds_corners, imu_tables, imu_tables_beside, read_imu
from .frame_stamps import numbers_in_names
from .image_files import (
    EXPECTED,
    CameraPlace,
    camera_places,
    has_cameras,
    image_names,
    is_image_name,
    is_video,
    video_place,
)

_PACKED = (b"PK\x03\x04", b"\x1f\x8b", b"7z\xbc\xaf", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"Rar!")
_NO_TOPICS: Mapping[str, str] = MappingProxyType({})


def holds_images(path: str | PathLike[str]) -> bool:
    """Tell whether a recording's cameras are images: a bag, a video, or a folder of them without tables of corners."""
    place = Path(path)
    try:
        if place.is_dir():
            root = _root(place)
            return not holds_corners(root) and (has_cameras(root) or _bag_of(place) is not None)
        return place.is_file() and (_bag_of(place) is not None or is_video(place))
    except RecordingError:  # several bags: there are images, and opening them says what is wrong
        return True
    except OSError:
        return False


def refuse_without_cameras(path: Path) -> None:
    """Refuse a recording that has neither images nor corners, with what it is.

    Raises
    ------
    RecordingError
        If it has none, or cannot be read.
    """
    if not holds_images(path) and not (path.is_dir() and holds_corners(_root(path))):
        open_images(path, cameras_alone=True)


def recording_holds_imu(path: str | PathLike[str]) -> bool:
    """Tell whether a recording of cameras, images or corners, has samples of an IMU, too, without reading them."""
    place = Path(path)
    try:
        bag = _bag_of(place)
        if bag is not None:
            from ..bags.bag import bag_holds_imu

            return bag_holds_imu(bag)
        if not place.is_dir():
            return is_video(place) and bool(_tables_of(place, video_place(place)))
        root = _root(place)
        return corners_with_imu(root) if holds_corners(root) else bool(_tables_in(root, camera_places(root, [])))
    except (RecordingError, OSError):  # it was read, but for its IMU, of which nothing is clear
        return False


def tells_no_lens(path: str | PathLike[str]) -> bool:
    """Tell whether a recording certainly does not say which lenses its cameras have; by its layout, nothing is read."""
    place = Path(path)
    try:
        if not place.is_dir() or _bag_of(place) is not None:
            return True
        root = _root(place)
        return holds_corners(root) or all(one.sensor is None for one in camera_places(root, []).values())
    except (RecordingError, OSError):
        return False


def open_images(
    path: str | PathLike[str],
    *,
    topics: Mapping[str, str] = _NO_TOPICS,
    suggested: Mapping[str, str] = _NO_TOPICS,
    units: str | Units | None = None,
    imu_table: str | PathLike[str] | None = None,
    need_imu: bool = True,
    cameras_alone: bool = False,
) -> ImageRecording:
    """Open a recording of cameras as images; the images themselves are read when they are asked for.

    Parameters
    ----------
    path : a ROS 1 or ROS 2 bag; a folder in the layout of EuRoC, TUM-VI or Kalibr, or with images or videos and a
        table of IMU samples; or a video
    topics : stated by the user, "cam0", "imu0", ... -> topic of a bag
    suggested : the same, used where a bag has such a topic
    units : of a table of samples, as for `gnomon.read`; recognised where not given
    imu_table : table of the IMU's samples, where it is not in the recording
    need_imu : whether a recording without IMU is refused
    cameras_alone : whether an IMU is passed over, as are the lenses that the recording states. Images in folders need
        no timestamps then: by the numbers in their names, or their order, those of several cameras belong together

    Raises
    ------
    RecordingError
        If it cannot be read, has no images or no IMU; the message says what was found and what is expected.
    OptionError
        If `units` names no unit, or topics are stated for something that is no bag.
    """
    place = Path(path)
    stated = stated_units(units)
    log = ReadLog(units=stated, cameras_alone=cameras_alone)
    table = None if imu_table is None else Path(imu_table)
    try:
        if not place.exists():
            raise RecordingError(f"{place}: there is no such file or folder. Check the path.")
        return _opened(place, topics, suggested, table, log, need_imu=need_imu and not cameras_alone)
    except OSError as error:
        raise RecordingError(
            f"{error.filename or place}: cannot be read ({error.strerror or error}). Check its permissions."
        ) from None


def _opened(
    place: Path,
    topics: Mapping[str, str],
    suggested: Mapping[str, str],
    table: Path | None,
    log: ReadLog,
    *,
    need_imu: bool,
) -> ImageRecording:
    bag = _bag_of(place)
    if bag is not None:
        return _from_bag(bag, topics, suggested, table, log, need_imu=need_imu)
    if topics:
        raise OptionError(
            f"{place}: topics were stated ({', '.join(topics)}), but this is no bag; in folders the names of files "
            "tell the cameras apart."
        )
    if place.is_dir():
        return _from_folder(place, table, log, need_imu=need_imu)
    if is_video(place):
        return _from_video(place, table, log, need_imu=need_imu)
    raise RecordingError(f"{place}: {_kind(place)}. Expected {EXPECTED}.")


def _from_bag(
    bag: Path,
    topics: Mapping[str, str],
    suggested: Mapping[str, str],
    table: Path | None,
    log: ReadLog,
    *,
    need_imu: bool,
) -> ImageRecording:
    from ..bags.bag import open_bag  # rosbags takes its time

    needed = None if log.cameras_alone else need_imu and table is None
    recording = open_bag(bag, topics=topics, suggested=suggested, units=log.units, need_imu=needed)
    if table is None:
        return recording
    imus = _imus({"imu0": (table,)}, {}, log)
    log.note(f"the IMU is that of {table.name}, not that of the bag.")
    return replace(
        recording,
        imus=imus,
        imu_arrivals={},
        sources=(*recording.sources, *log.sources),
        assumptions=(*recording.assumptions, *log.notes),
    )


def _from_folder(path: Path, table: Path | None, log: ReadLog, *, need_imu: bool) -> ImageRecording:
    root = _root(path)
    places = camera_places(root, log.notes)
    if log.cameras_alone:
        tables: dict[str, tuple[Path, ...]] = {}
    else:
        tables = _tables_in(root, places) if table is None else {"imu0": (table,)}
    if not places:
        raise RecordingError(f"{path}: no images of a camera in this folder; found {_contents(root)}. {_cure(tables)}")
    streams = {name: _stream(name, place, log) for name, place in places.items()}
    if log.cameras_alone:
        _check_order({place.label: streams[name].count for name, place in places.items() if _in_order_only(place)})
        return ImageRecording(imus={}, streams=streams, sources=tuple(log.sources), assumptions=tuple(log.notes))
    on_body = {} if table is not None else _imu_sensors(root, tuple(tables), log)
    imus = _imus(tables, on_body, log)
    _check_imu(imus, path, log, need_imu=need_imu)
    for name, place in places.items():
        if place.sensor is not None:
            sensor = read_sensor(place.sensor, f"{name}/sensor.yaml", log.notes)
            pose = T_sensor_imu(sensor, on_body.get("imu0", SensorInput())) if table is None else None
            streams[name] = replace(streams[name], camera=sensor.camera, T_cam_imu=pose)
    return ImageRecording(imus=imus, streams=streams, sources=tuple(log.sources), assumptions=tuple(log.notes))


def _from_video(path: Path, table: Path | None, log: ReadLog, *, need_imu: bool) -> ImageRecording:
    place = video_place(path)
    stream = _stream("cam0", place, log)
    if log.cameras_alone:
        return ImageRecording(
            imus={}, streams={"cam0": stream}, sources=tuple(log.sources), assumptions=tuple(log.notes)
        )
    tables = _tables_of(path, place) if table is None else {"imu0": (table,)}
    imus = _imus(tables, {}, log)
    _check_imu(imus, path, log, need_imu=need_imu)
    sources = tuple(dict.fromkeys(log.sources))  # a video with its telemetry is one file
    return ImageRecording(imus=imus, streams={"cam0": stream}, sources=sources, assumptions=tuple(log.notes))


def _tables_in(root: Path, places: Mapping[str, CameraPlace]) -> dict[str, tuple[Path, ...]]:
    """Return what holds the samples of each IMU of a folder: the log of a phone's app, or tables; or the only video."""
    if is_device_log((root,)):
        return {"imu0": (root,)}
    tables = imu_tables(root, _stamp_tables(places))
    videos = [place.video for place in places.values() if place.video is not None]
    if not tables and len(places) == len(videos) == 1 and has_gpmf(videos[0]):
        return {"imu0": (videos[0],)}
    return tables


def _tables_of(video: Path, place: CameraPlace) -> dict[str, tuple[Path, ...]]:
    """Return what holds the samples of the IMU of a video: tables beside it, or its own telemetry."""
    return imu_tables_beside(video, _stamp_tables({"cam0": place})) or ({"imu0": (video,)} if has_gpmf(video) else {})


def _stream(name: str, place: CameraPlace, log: ReadLog) -> ImageStream:
    if place.video is None:
        from .image_files import folder_stream

        return folder_stream(name, place, log)
    from .video import video_stream  # PyAV takes its time

    return video_stream(name, place, log)


# ---- EuRoC's sensor.yaml, one for each camera and each IMU: lens, place on the body, and noise ----
#
# T_BS maps coordinates of the sensor to those of the body, p_body = T_BS @ p_sensor. What such a file states is of help
# only: whatever cannot be used is passed over with a note.

_KALIBR_NAMES = {"distortion_coefficients": "distortion_coeffs", "projection_model": "camera_model"}
_NOISE = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
)


@value_class
class SensorInput:
    """What the sensor.yaml of one sensor says.

    Attributes
    ----------
    T_body_sensor : (4, 4) p_body = T_body_sensor @ p_sensor [m], or None
    camera : lens and intrinsics of a camera, or None
    imu : noise and rate of an IMU, or None
    """

    T_body_sensor: Floats | None = None
    camera: Camera | None = None
    imu: ImuInput | None = None


def read_sensor(path: Path, where: str, notes: list[str]) -> SensorInput:
    """Read a sensor.yaml.

    Parameters
    ----------
    path : the file
    where : its name for notes, such as "cam0/sensor.yaml"
    notes : where sentences on what was passed over are appended
    """
    try:
        node = replace(read_foreign_yaml(path, notes), file=where)
        keys = {_KALIBR_NAMES.get(child.key, child.key): child for child in node.entries()}
    except FormatError as error:
        notes.append(f"{where} was passed over: {error}")
        return SensorInput()
    camera = imu = None
    if "intrinsics" in keys:
        try:
            camera = camera_of(node, {key: _sides(child) for key, child in keys.items()}, notes)
        except FormatError as error:
            notes.append(f"The lens was not taken from {error}")
    if _NOISE[0] in keys:
        try:
            imu = _imu_input(keys)
        except (FormatError, OptionError) as error:
            notes.append(f"The noise of the IMU was not taken from {error}")
    return SensorInput(T_body_sensor=_pose(keys, notes), camera=camera, imu=imu)


def T_sensor_imu(sensor: SensorInput, imu: SensorInput) -> Floats | None:
    """Return p_sensor = T @ p_imu from the places of both on the body; an IMU without place is the body itself."""
    if sensor.T_body_sensor is None:
        return None
    T_sensor_body = inverse_pose(sensor.T_body_sensor)
    return frozen_array(T_sensor_body if imu.T_body_sensor is None else T_sensor_body @ imu.T_body_sensor)


def _pose(keys: dict[str, Node], notes: list[str]) -> Floats | None:
    node = keys.get("T_BS")
    if node is None:
        return None
    try:
        return read_transform(node)
    except FormatError as error:
        notes.append(f"The place on the body was not taken from {error}")
        return None


def _sides(node: Node) -> Node:
    """Return the resolution as a list, where it is written as width and height."""
    if node.key == "resolution" and isinstance(node.value, dict) and {"width", "height"} == set(node.value):
        return replace(node, value=[node.value["width"], node.value["height"]])
    return node


def _imu_input(keys: dict[str, Node]) -> ImuInput:
    missing = [name for name in _NOISE if name not in keys]
    if missing:
        raise keys[_NOISE[0]].fail(f"{missing[0]} is missing beside it.")
    noise = ImuNoise(**{name: keys[name].number() for name in _NOISE})
    rate = keys["rate_hz"].number() if "rate_hz" in keys else None
    return ImuInput(noise=noise, update_rate_hz=rate if rate is not None and rate > 0 else None, topic="")


# ---- samples beside the images ----


def _imus(
    tables: Mapping[str, tuple[Path, ...]], on_body: Mapping[str, SensorInput], log: ReadLog
) -> dict[str, ImuSamples]:
    first = on_body.get(next(iter(tables), ""), SensorInput())
    imus: dict[str, ImuSamples] = {}
    for name, files in tables.items():
        known = on_body.get(name, SensorInput())
        samples = read_imu(name, files, known.imu, units=log.units, sources=log.sources, notes=log.notes)
        imus[name] = replace(samples, T_imu_body=T_sensor_imu(known, first)) if imus else samples
    return imus


def _imu_sensors(root: Path, names: tuple[str, ...], log: ReadLog) -> dict[str, SensorInput]:
    paths = {name: root / name / "sensor.yaml" for name in names}
    return {name: read_sensor(path, f"{name}/sensor.yaml", log.notes) for name, path in paths.items() if path.is_file()}


def _check_imu(imus: Mapping[str, ImuSamples], path: Path, log: ReadLog, *, need_imu: bool) -> None:
    if imus:
        return
    beside = "beside this video" if path.is_file() else "in this folder"
    if need_imu:
        raise RecordingError(f"{path}: there are images, but no samples of an IMU {beside}. Expected {EXPECTED_IMU}.")
    log.note(f"there are no samples of an IMU {beside}.")


def _in_order_only(place: CameraPlace) -> bool:
    """Tell whether nothing but their order says which images were taken together with those of another camera."""
    if place.folder is None or place.table is not None:
        return False
    return numbers_in_names(sorted(image_names(place.folder, place.prefix))) is None


def _check_order(counts: Mapping[str, int]) -> None:
    if len(set(counts.values())) > 1:
        found = " and ".join(f"{count} images in {label}" for label, count in counts.items())
        raise RecordingError(
            f"there are {found}, and their names hold no numbers that tell which of them were taken together. Number "
            "them, such as left01.png and right01.png, or name them after their timestamps in nanoseconds."
        )


def _stamp_tables(places: Mapping[str, CameraPlace]) -> set[Path]:
    return {place.table for place in places.values() if place.table is not None}


def _root(folder: Path) -> Path:
    """Return the folder in which the sensors are: of EuRoC's layout mav0."""
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _bag_of(path: Path) -> Path | None:
    """Return the bag that is meant: the path itself, or the only bag in a folder without images; None without one."""
    from ..bags.bag import is_bag_path  # rosbags takes its time

    if is_bag_path(path):
        return path
    if not path.is_dir() or has_cameras(_root(path)):
        return None
    bags = [inner for inner in sorted(path.iterdir()) if not inner.name.startswith(".") and is_bag_path(inner)]
    if len(bags) > 1:
        listed = ", ".join(bag.name for bag in bags[:6]) + (", ..." if len(bags) > 6 else "")
        raise RecordingError(f"{path}: there are {len(bags)} bags in this folder ({listed}). Give the one to read.")
    return bags[0] if bags else None


def _kind(path: Path) -> str:
    """Return what a file seems to be."""
    if is_image_name(path.name):
        return "this is one image; a recording is the folder of them"
    head = first_bytes(path)
    if path.suffix == ".npz":
        return "this is an NPZ file, which holds no images"
    if head.startswith(_PACKED) or head[257:262] == b"ustar":
        return "this is packed; unpack it first"
    return f"this is a {'binary file of an unknown kind' if bytes(1) in head else 'text file, which holds no images'}"


def _contents(folder: Path) -> str:
    names = sorted(f"{path.name}/" if path.is_dir() else path.name for path in folder.iterdir())
    return (", ".join(names[:6]) + (", ..." if len(names) > 6 else "")) if names else "nothing at all"


def _cure(tables: Mapping[str, tuple[Path, ...]]) -> str:
    if tables:
        return f"There are samples of an IMU, but calibrating it alone is another command. Expected {EXPECTED}."
    return f"Expected {EXPECTED}."
