"""Images of a board -> its corners.

for every camera: read frames -> decode and detect, several at a time -> number flipped boards alike -> CameraFrames

Frames are handed out in runs of consecutive ones, so that a detector may track the board from frame to frame; the runs
do not depend on the number of workers, and neither does the result.
"""

import os
from collections import Counter, deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from queue import Empty, SimpleQueue

import numpy as np
from threadpoolctl import threadpool_limits

from ...detect.boards.board import DIFFERS, NOT_WITH_NEIGHBOURS, BoardView, nothing_seen, tag_spacing
from ...detect.boards.worker import BoardFinder, BoardProcess, ProcessLostError
from ...errors import DetectionError, RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...frozen import value_class
from ...models.camera import Camera
from ...models.target import Target
from ...progress import Progress, Step
from ...recording import CameraFrames, FrameQuality
from ...recording.recording import Frame, Grey, ImageStream

Processes = SimpleQueue[BoardProcess]

_RUN, _RUN_PX = (8, 32), 16e6  # consecutive frames that one worker takes, and pixels of them that bound the memory
_DECODED = 2  # frames of a run that are decoded at once, and held by each worker
_MANY_IMAGES = 40  # from which on it pays to start processes, which takes as long as some twenty images
_WAITING = 1  # runs that are read ahead
_SAMPLES = 12  # images that are looked at to say which board they show
_TOLD = 10  # times that progress is told
_MANY = 0.15  # share of the corners that are not where their neighbours say, from which on the board is doubted
_OTHER_GAP = 0.03  # of the side of a tag


@value_class
class CameraImages:
    """The images of one camera, and what is known of it.

    Attributes
    ----------
    name : "cam0", "cam1", ...
    stream : its images
    known : lens, intrinsics, and guesses of the extrinsics
    lens_known : whether what is known is its lens, rather than a stand-in for the size of its images
    """

    name: str
    stream: ImageStream
    known: CameraInput
    lens_known: bool = True


@value_class
class _Seen:
    """What became of one frame."""

    t_ns: int
    where: str
    view: BoardView
    size: tuple[int, int] | None
    damage: str = ""


@value_class
class BoardCorners:
    """The corners of one camera, and what there is to say about its images."""

    frames: CameraFrames
    notes: tuple[str, ...]


def detect_corners(
    images: CameraImages, target: Target, *, workers: int | None = None, progress: Progress | None = None
) -> BoardCorners:
    """Find a board in all images of a camera.

    Parameters
    ----------
    images : of the camera
    target : the board
    workers : how many look at once, each in a process of its own, where there are many images; as many as there are
        cores where not given
    progress : called with a sentence from time to time

    Raises
    ------
    RecordingError
        If there are no images, none of them can be read, or they are not of the size for which the lens is stated.
    DetectionError
        If the board is in none of them.
    OptionError
        If the board has markers of a dictionary that does not exist.
    """
    notes: list[str] = []
    tell = progress or (lambda _: None)
    seen: list[_Seen] = []
    step = max(images.stream.count // _TOLD, 1)
    for item in _all_frames(images, notes, target, workers or os.cpu_count() or 1):
        _check_size(images, item, seen)
        if len(seen) % step == 0:
            tell(Step(f"finding the board in the images of {images.name}", len(seen), images.stream.count))
        seen.append(item)
    _check(images, seen, target, notes)
    seen = _in_order(images.name, seen, notes)
    views = _numbered_alike(seen, target, images.known.camera if images.lens_known else None)
    return BoardCorners(frames=_camera_frames(seen, views, images.known), notes=tuple(notes))


def _all_frames(images: CameraImages, notes: list[str], target: Target, workers: int) -> Iterator[_Seen]:
    """Yield what every frame shows, in the order of the recording."""
    source, count = images.stream.frames(notes), images.stream.count
    width, height = images.known.camera.resolution
    length = int(np.clip(_RUN_PX / (width * height), *_RUN))
    waiting: deque[Future[list[_Seen]]] = deque()
    workers = workers if count >= _MANY_IMAGES else 1  # threads alone only wait for each other
    with _one_thread_each(), _processes(target, workers) as processes:
        pool = ThreadPoolExecutor(workers, thread_name_prefix="gnomon-board")
        try:
            while True:
                while len(waiting) < workers + _WAITING and (run := list(islice(source, length))):
                    waiting.append(pool.submit(_run, run, target, processes))
                if not waiting:
                    return
                yield from waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _processes(target: Target, workers: int) -> Generator[Processes]:
    """Give processes that find the board, of which each run of frames borrows one; one worker is this one itself."""
    free: Processes = SimpleQueue()
    started: list[BoardProcess] = []
    try:
        for _ in range(workers - 1):
            try:
                started.append(BoardProcess(target))
            except ProcessLostError:
                break
            free.put(started[-1])
        yield free
    finally:
        for process in started:
            process.close()


@contextmanager
def _one_thread_each() -> Generator[None]:
    """Let the libraries below use one thread: the images already share the cores."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        cv2.setNumThreads(before)


def _run(frames: list[Frame], target: Target, processes: Processes) -> list[_Seen]:
    """Return what consecutive frames show: decoded here, looked at in a process that is free, else here."""
    try:
        process = processes.get_nowait()
        found = _looked_at(frames, process)
    except (Empty, ProcessLostError):  # a process that was lost is not put back
        return _looked_at(frames, BoardFinder(target))
    processes.put(process)
    return found


def _looked_at(frames: list[Frame], finder: BoardProcess | BoardFinder) -> list[_Seen]:
    found: list[_Seen] = []
    for first in range(0, len(frames), _DECODED):
        some = frames[first : first + _DECODED]
        images = [_decoded(frame) for frame in some]
        views = iter(finder.views([image for image in images if not isinstance(image, str)], follows=first > 0))
        found += [
            _Seen(t_ns=frame.t_ns, where=frame.where, view=nothing_seen(), size=None, damage=image)
            if isinstance(image, str)
            else _Seen(t_ns=frame.t_ns, where=frame.where, view=next(views), size=(image.shape[1], image.shape[0]))
            for frame, image in zip(some, images, strict=True)
        ]
    return found


def _decoded(frame: Frame) -> Grey | str:
    """Return the image, or what is wrong with it."""
    try:
        return frame.decode()
    except RecordingError as error:
        return str(error)


def _check_size(images: CameraImages, item: _Seen, before: list[_Seen]) -> None:
    wanted = images.known.camera.resolution
    if item.size is None or item.size == wanted:
        return
    if not images.lens_known:
        other = next((other for other in before if other.size is not None), None)
        found = f"{item.where} of {item.size[0]} x {item.size[1]} px"
        than = f"{other.where} of {wanted[0]} x {wanted[1]} px" if other else f"{wanted[0]} x {wanted[1]} px stated"
        raise RecordingError(
            f"{images.name}: the images are of different sizes, such as {than} and {found}. One lens is calibrated at "
            "one image size: keep the images of one size, and do not crop, scale or turn any of them."
        )
    sizes = dict.fromkeys(size for size in (*(other.size for other in before), item.size) if size is not None)
    found = " and ".join(f"{width} x {height}" for width, height in sizes)
    raise RecordingError(
        f"{images.name}: the images are of {found} px, but its intrinsics are for {wanted[0]} x {wanted[1]} px. "
        "Give the intrinsics of this camera at this image size."
    )


def _check(images: CameraImages, seen: list[_Seen], target: Target, notes: list[str]) -> None:
    """Refuse images that are of no use, and note those that were left out."""
    name = images.name
    if not seen:
        raise RecordingError(f"{name}: there are no images. {' '.join(notes)}".rstrip())
    damaged = [item.damage for item in seen if item.size is None]
    if len(damaged) == len(seen):
        raise RecordingError(
            f"{name}: none of the {len(seen)} images can be read. The first: {damaged[0]} Copy the recording again."
        )
    if damaged:
        notes.append(
            f"{name}: {len(damaged)} of {len(seen)} images cannot be read and were left out. The first: {damaged[0]}"
        )
    if not any(len(item.view) for item in seen):
        raise DetectionError(
            f"{name}: the board of the target file, {target.describe()}, is in none of {len(seen)} images. "
            f"{_what_they_show(images.stream, len(seen), target)}"
        )
    _check_board(images, [item.view for item in seen], target)


def _check_board(images: CameraImages, views: list[BoardView], target: Target) -> None:
    """Refuse an AprilGrid that the images contradict: other columns, another first tag, or another gap."""
    if target.kind != "aprilgrid":
        return
    found = sum(len(view) for view in views)
    misplaced = sum(view.dropped.get(NOT_WITH_NEIGHBOURS, 0) for view in views)
    if misplaced > _MANY * (found + misplaced):
        shown = _what_they_show(images.stream, len(views), target)
        if DIFFERS in shown:
            raise DetectionError(
                f"{images.name}: {misplaced} of {found + misplaced} corners are not where the board of the target "
                f"file, {target.describe()}, has them in these images. {shown} Correct the target file."
            )
    gap = tag_spacing(views, target)
    if gap is not None and abs(gap - target.tag_spacing) > _OTHER_GAP:
        raise DetectionError(
            f"{images.name}: in the images the gap between the tags is {gap:.2f} of the side of a tag, but the target "
            f"file says tagSpacing: {target.tag_spacing:g}. Measure the board, and correct the file."
        )


def _what_they_show(stream: ImageStream, count: int, target: Target) -> str:
    from ...detect.boards.board_guess import guess_board

    step = max(count // _SAMPLES, 1)
    images: list[Grey] = []
    for frame in islice(stream.frames([]), step // 2, None, step):
        try:
            images.append(frame.decode())
        except RecordingError:
            continue
    return guess_board(images, target)


def _in_order(name: str, seen: list[_Seen], notes: list[str]) -> list[_Seen]:
    """Return the frames in the order of time; of those with one timestamp the first."""
    stamps = np.array([item.t_ns for item in seen], dtype=np.int64)
    if (np.diff(stamps) > 0).all():
        return seen
    if len(seen) > 1 and (stamps == stamps[0]).all():
        raise RecordingError(
            f"{name}: all {len(seen)} images have the same timestamp, {stamps[0]} ns. Record them with the time at "
            "which they were taken."
        )
    backward = int(np.count_nonzero(np.diff(stamps) < 0))
    if backward:
        notes.append(f"{name}: the timestamps go back at {backward} of {len(seen)} images, which were sorted.")
    order = np.argsort(stamps, kind="stable")
    once = np.concatenate([[True], np.diff(stamps[order]) > 0])
    if not once.all():
        notes.append(
            f"{name}: left out {int((~once).sum())} of {len(seen)} images, whose timestamps were there before."
        )
    return [seen[i] for i in order[once]]


def _numbered_alike(seen: list[_Seen], target: Target, camera: Camera | None) -> tuple[BoardView, ...]:
    """Return the views with their corners numbered from one end of the board, as far as the images tell it.

    Without a lens the motion in the image tells it, and where that is not certain the numbers stay as they were found;
    several cameras are then numbered alike where they are brought together.
    """
    views = tuple(item.view for item in seen)
    if target.kind not in {"checkerboard", "circlegrid"}:
        return views
    from ...detect.boards.checkerboard_order import consistent_order

    t_ns = np.array([item.t_ns for item in seen], dtype=np.int64)
    return consistent_order(views, t_ns, target, camera=camera).views


def _camera_frames(seen: list[_Seen], views: tuple[BoardView, ...], known: CameraInput) -> CameraFrames:
    corners = [len(view) for view in views]
    dropped: Counter[str] = Counter()
    for view in views:
        dropped.update(view.dropped)
    return CameraFrames(
        t_ns=np.array([item.t_ns for item in seen], dtype=np.int64),
        frame=np.repeat(np.arange(len(views)), corners),
        point=np.concatenate([view.point for view in views]),
        pixels=np.concatenate([view.pixels for view in views]),
        sigma_px=np.concatenate([view.sigma_px for view in views]),
        camera=known.camera,
        T_cam_imu=known.T_cam_imu,
        time_shift_cam_imu_s=known.time_shift_cam_imu_s,
        lens_covariance=known.lens_covariance,
        quality=FrameQuality(
            blur_px=np.array([view.blur_px for view in views]),
            black=np.array([view.black for view in views]),
            white=np.array([view.white for view in views]),
            dropped=dropped,
        ),
    )
