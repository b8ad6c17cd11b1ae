"""The data doctor's look at cameras beside IMUs before anything is estimated: as images, corners, or timestamps.

Of images all timestamps are looked at, and the pictures of some frames, evenly spread.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from ...detect.boards.board import BoardView, tag_spacing
from ...errors import RecordingError
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.camera import Camera
from ...models.target import Target
from ...progress import Progress, Step
from ...recording import CameraFrames, FrameQuality, ImuSamples, Integers, Recording
from ...recording.recording import Frame, Grey, ImageRecording, ImageStream
from .board_views import FEWEST_CORNERS, BoardSightings, board_sightings, check_handedness
from .clock_checks import check_epochs
from .image_checks import (
    BoardDetections,
    ImageStatistics,
    check_looks,
    check_quality,
    check_sight,
    check_sizes,
    corner_boxes,
    measure_image,
)
from .recorder_clocks import check_clocks
from .rig_checks import check_recording_rig
from .rig_streams import (
    all_stamps,
    check_cameras,
    check_common_time,
    check_moving_imu,
    check_rhythm,
    imu_stamps,
    imus_to_align,
    unusable_frames_finding,
)

SAMPLE = 60
"""Frames of each camera whose pictures are looked at."""

_FEWEST_FRAMES = 10
_FEWEST_CORNERS = 6
_DAMAGED_SHARE = 0.1
_KEPT = 8  # pictures that are kept to say which board they show
Detector = Callable[[Grey], BoardView]


@value_class
class StreamSummary:
    """What was found in the images of one camera.

    Attributes
    ----------
    topic : of a bag, else ""
    t_ns : (n,) timestamps of all frames, in the order of the recording [ns]
    looked_ns : (k,) timestamps of the frames whose pictures were looked at [ns]
    looks : (k,) what they are like
    views : (k,) what they show of the board; empty where no board was stated
    damaged : sentences on pictures that cannot be decoded
    notes : sentences of the reader, such as where the recording ends early
    other_board : what the images show in place of the stated board, where that was never found; else ""
    """

    topic: str
    t_ns: Integers
    looked_ns: Integers
    looks: tuple[ImageStatistics, ...]
    views: tuple[BoardView, ...]
    damaged: tuple[str, ...]
    notes: tuple[str, ...]
    other_board: str = ""

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the images, where one could be decoded."""
        return self.looks[0].size if self.looks else None

    @property
    def seen(self) -> int:
        """Number of looks in which the board was found."""
        return sum(len(view) >= _FEWEST_CORNERS for view in self.views)


@value_class
class RigSummary:
    """A recording of images as the doctor saw it: stream by stream, and the findings."""

    streams: Mapping[str, StreamSummary]
    findings: tuple[Finding, ...]


def check_rig(
    recording: ImageRecording,
    target: Target | None = None,
    cameras: Mapping[str, Camera] | None = None,
    *,
    sample: int = SAMPLE,
    progress: Progress | None = None,
) -> RigSummary:
    """Look at a recording of images and IMUs and say what is good or bad about it.

    Codes: imu-missing, images-missing, images-incomplete, images-damaged, image-size, images-same, images,
    motion-blur, out-of-focus, images-bright, images-dark, images-flat, corners-dropped, corners-uncertain,
    board-missing, board-rare, frames-backward, those of the rhythm of frames, of `check_clocks` and `check_epochs`, and
    of `check_moving_imu`.

    Parameters
    ----------
    recording : images and samples
    target : the board, where it is known; it is sought in the sample then
    cameras : what is known of the cameras beforehand, by name
    sample : number of frames of each camera whose pictures are looked at
    progress : called with a sentence at each step
    """
    tell = progress or (lambda _: None)
    streams: dict[str, StreamSummary] = {}
    for name, stream in recording.streams.items():
        streams[name] = _looked_at(name, stream, target, sample, tell)
    findings = check_imus(recording.imus)
    for name, look in streams.items():
        camera = (cameras or {}).get(name) or recording.streams[name].camera
        findings += _check_stream(name, look, camera, target)
    stamps = {name: look.t_ns for name, look in streams.items()}
    shifts = {name: stream.time_shift_cam_imu_s or 0.0 for name, stream in recording.streams.items()}
    findings += check_stamps_together(stamps, recording.imus, shifts)
    known = {name: stream.arrivals for name, stream in recording.streams.items() if stream.arrivals is not None}
    findings += check_clocks({**known, **recording.imu_arrivals})
    return RigSummary(streams=streams, findings=_each_once(findings))


def check_corners(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Look at a recording of IMUs and of cameras whose corners were detected, before anything is estimated from it.

    Codes: those of `check_cameras`, `check_epochs` and `check_recording_rig`; without an IMU those of `check_views`.
    """
    if not recording.imus:
        return (*check_imus({}), *check_views(recording, target))
    findings = [*check_cameras(recording, target), *check_epochs(all_stamps(recording))]
    problems = {finding.code for finding in findings if finding.severity == "problem"}
    if problems <= {"stream-short"}:  # three seconds tell of axes and clocks, and of no lens
        findings += check_recording_rig(recording, target, lens=not problems)
    return _each_once(findings)


def check_imus(imus: Mapping[str, ImuSamples]) -> list[Finding]:
    """Return findings on IMUs that moved with cameras; having none is told (code imu-missing)."""
    if not imus:
        return [make_finding("imu-missing")]
    return [finding for name, imu in imus.items() for finding in check_moving_imu(name, imu)]


def check_stamps_together(
    stamps: Mapping[str, Integers], imus: Mapping[str, ImuSamples], shifts: Mapping[str, float]
) -> list[Finding]:
    """Return findings on the timestamps of cameras, each for itself and all against the IMUs'.

    Parameters
    ----------
    stamps : "cam0", ... -> (n,) [ns], in the order of the recording
    shifts : t_imu - t_cam, where it was stated [s]
    """
    epochs = check_epochs({**stamps, **imu_stamps(imus)})
    findings = list(epochs)
    if any(finding.severity == "problem" for finding in epochs):
        return findings  # all that follows would be about wrong timestamps
    for name, t_ns in stamps.items():
        ordered = np.unique(t_ns)
        findings += _order(name, t_ns)
        if imus and len(ordered) >= 3:  # alone, cameras may take their views when they like
            findings += check_rhythm(name, ordered)
        for imu in imus_to_align(name, stamps, imus):
            findings += check_common_time(name, ordered, imu, imus[imu], shifts.get(name, 0.0))
    return findings


def _each_once(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings without those that another look at the same timestamps found as well."""
    return tuple(dict.fromkeys(findings))


def _order(name: str, t_ns: Integers) -> Iterator[Finding]:
    back = np.flatnonzero(np.diff(t_ns) <= 0)
    if not len(back):
        return
    yield make_finding("frames-backward/images", name=name, frame=int(back[0]) + 1, count=len(back), frames=len(t_ns))


# ---- pictures ----


class _Sample:
    """What was gathered from the pictures of some frames; the pictures themselves are let go, but for a few."""

    def __init__(self, detector: Detector | None) -> None:
        self.detector = detector
        self.t_ns: list[int] = []
        self.looks: list[ImageStatistics] = []
        self.views: list[BoardView] = []
        self.damaged: list[str] = []
        self.unseen: list[Grey] = []

    def look(self, frame: Frame, *, keep: bool) -> None:
        """Look at a frame; keep its picture where that was asked for, until the board is seen."""
        try:
            image = frame.decode()
        except RecordingError as error:
            self.damaged.append(str(error))
            return
        self.t_ns.append(frame.t_ns)
        self.looks.append(measure_image(image))
        if self.detector is None:
            return
        self.views.append(self.detector(image))
        if keep:
            self.unseen.append(image)
        if any(len(view) >= _FEWEST_CORNERS for view in self.views):
            self.unseen.clear()


def _looked_at(name: str, stream: ImageStream, target: Target | None, sample: int, tell: Progress) -> StreamSummary:
    notes: list[str] = []
    stamps: list[int] = []
    count = stream.count or sum(1 for _ in stream.frames([]))
    chosen = np.unique(np.linspace(0, max(count - 1, 0), max(sample, 2)).astype(np.int64)).tolist()
    kept = set(chosen[:: max(1, len(chosen) // _KEPT)])
    gathered, wanted = _Sample(None if target is None else _detector(target)), set(chosen)
    for number, frame in enumerate(stream.frames(notes)):
        stamps.append(frame.t_ns)
        if number in wanted:
            tell(Step(f"looking at the images of {name}", len(gathered.t_ns), len(wanted)))
            gathered.look(frame, keep=number in kept)
    return StreamSummary(
        topic=stream.topic,
        t_ns=np.array(stamps, dtype=np.int64),
        looked_ns=np.array(gathered.t_ns, dtype=np.int64),
        looks=tuple(gathered.looks),
        views=tuple(gathered.views),
        damaged=tuple(gathered.damaged),
        notes=tuple(notes),
        other_board=_other_board(gathered.unseen, target),
    )


def _other_board(images: list[Grey], target: Target | None) -> str:
    """Return a sentence on the board that images show in place of the stated one; "" where there are none."""
    if target is None or not images:
        return ""
    from ...detect.boards.board_guess import guess_board

    return guess_board(images, target)


def _detector(target: Target) -> Detector:
    """Return what finds a board in an image of its own, not in one that follows another."""
    if target.kind == "checkerboard":
        from ...detect.boards.checkerboard import detect_checkerboard

        return lambda image: detect_checkerboard(image, target)
    from ...detect.boards.worker import make_detector

    return make_detector(target)


def _check_stream(name: str, look: StreamSummary, camera: Camera | None, target: Target | None) -> list[Finding]:
    findings = [_incomplete(name, note) for note in look.notes]
    if len(look.t_ns) < _FEWEST_FRAMES:
        findings.append(make_finding("images-missing", name=name, count=len(look.t_ns)))
    findings += _damaged(name, look)
    if not look.looks:
        return findings
    findings += check_sizes(name, look.looks, camera)
    if not look.seen:
        findings += _board_missing(name, look, target)
        return findings + check_looks(name, look.looks)
    return findings + _board(name, look)


def _incomplete(name: str, note: str) -> Finding:
    return make_finding("images-incomplete", case="named" if name in note else "", note=note, name=name)


def _damaged(name: str, look: StreamSummary) -> Iterator[Finding]:
    if not look.damaged:
        return
    tried = len(look.damaged) + len(look.looks)
    share = len(look.damaged) / tried
    yield make_finding(
        "images-damaged",
        severity="problem" if not look.looks else "warning",
        case="all" if not look.looks else "few" if share < _DAMAGED_SHARE else "",
        name=name,
        count=len(look.damaged),
        tried=tried,
        first=look.damaged[0],
    )


def _board_missing(name: str, look: StreamSummary, target: Target | None) -> Iterator[Finding]:
    if target is None or not look.views:
        return
    yield make_finding(
        "board-missing",
        name=name,
        board=target.describe(),
        images=len(look.views),
        other_board=look.other_board,
    )


def _board(name: str, look: StreamSummary) -> list[Finding]:
    """Return findings on the images by what they show of the board."""
    views = look.views
    size = [len(view) for view in views]
    dropped: Counter[str] = Counter()
    for view in views:
        dropped.update(dict(view.dropped))
    quality = FrameQuality(
        blur_px=np.array([view.blur_px for view in views]),
        black=np.array([view.black for view in views]),
        white=np.array([view.white for view in views]),
        dropped=dropped,
    )
    frame = np.repeat(np.arange(len(views)), size)
    sigma = np.concatenate([view.sigma_px for view in views])
    pixels = np.concatenate([view.pixels for view in views])
    sight = BoardDetections(
        t_ns=look.looked_ns,
        seen=np.array(size) >= _FEWEST_CORNERS,
        box_px=corner_boxes(frame, pixels, len(views)),
        blur_px=quality.blur_px,
        resolution=look.looks[0].size,
        consecutive=False,
    )
    return [*check_quality(name, quality, len(sigma), sigma), *check_sight(name, sight)]


_OTHER_GAP = 0.03
_MOST_LOOKED_AT = 60
FEWEST_VIEWS = 3
"""Fewer views of a plane do not determine the intrinsics of a pinhole."""


ENOUGH_VIEWS = 10


def check_views(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Look at the views of a board and say what is good or bad about them.

    Codes: cameras-missing, frames-backward, corners-unknown, corners-outside, views, views-few, board-mirrored,
    tag-spacing, and those of the images.

    Returns
    -------
    Findings camera by camera; severity "problem" means that they cannot be calibrated.
    """
    if not recording.cameras:
        return (make_finding("cameras-missing/views"),)
    return tuple(
        finding for name, frames in recording.cameras.items() for finding in _cameras_check_camera(name, frames, target)
    )


def _cameras_check_camera(name: str, frames: CameraFrames, target: Target) -> list[Finding]:
    wrong = unusable_frames_finding(name, frames, target)
    if wrong is not None:
        return [wrong]
    seen = board_sightings(frames, target)
    findings = [_cameras_count(name, frames, seen)]
    if frames.quality is not None:
        findings += check_quality(name, frames.quality, len(frames.frame), frames.sigma_px)
    if findings[0].severity != "problem":
        findings += check_handedness(name, frames, seen.frame[seen.usable], target)
        findings += _spacing(name, frames, seen.frame[seen.usable], target)
    return findings


def _cameras_count(name: str, frames: CameraFrames, seen: BoardSightings) -> Finding:
    usable = int(np.count_nonzero(seen.usable))
    message = (
        f"{name}: {len(frames.t_ns)} images, the board in {usable} of them ({FEWEST_CORNERS} corners or more, not on "
        "one line)."
    )
    if usable >= ENOUGH_VIEWS:
        return make_finding("views", message=message)
    few = usable < FEWEST_VIEWS
    return make_finding(
        "views-few/found",
        severity="problem" if few else "warning",
        case="few" if few else "",
        message=message,
        fewest_views=FEWEST_VIEWS,
    )


def _spacing(name: str, frames: CameraFrames, usable: Integers, target: Target) -> list[Finding]:
    """Say that the gap between the tags contradicts the images, whatever the lens."""
    if target.kind != "aprilgrid":
        return []
    chosen = usable[:: max(len(usable) // _MOST_LOOKED_AT, 1)]
    ends = np.searchsorted(frames.frame, [chosen, chosen + 1])
    gap = tag_spacing([_board_view(frames, first, last) for first, last in ends.T], target)
    if gap is None or abs(gap - target.tag_spacing) <= _OTHER_GAP:
        return []
    return [make_finding("tag-spacing/implausible", name=name, gap=gap, tag_spacing=target.tag_spacing)]


def _board_view(frames: CameraFrames, first: int, last: int) -> BoardView:
    order = first + np.argsort(frames.point[first:last])
    return BoardView(point=frames.point[order], pixels=frames.pixels[order], sigma_px=np.ones(len(order)))
