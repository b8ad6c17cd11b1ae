"""A guided capture of a camera, from images of a board to advice and to a recording that calibrates."""

from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from gnomon.detect.boards.board import NOT_WITH_NEIGHBOURS, BoardView, nothing_seen
from gnomon.errors import OptionError
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.live.board_coach import BoardCoach
from gnomon.live.camera_session import CameraSession
from gnomon.live.image_sources import SHOWN, CameraSource, ImageArrival, ImageSource, ReplayImages, open_image_source
from gnomon.live.recorder import ImageRecorder
from gnomon.live.sources import Pace
from gnomon.live.trials import TrialOutcome, Trials, try_calibration
from gnomon.models.camera import Camera
from gnomon.readers.images.image_recording import open_images
from gnomon.recording.recording import Frame, ImageRecording, ImageStream
from gnomon.simulate.cameras import simulate_cameras
from support.live_images import GREY, STATISTICS, views_of


class Silent(ImageSource):
    """Takes nothing by itself."""

    def arriving_images(self, stop):
        yield from ()


@pytest.fixture(scope="module")
def shown():
    return simulate_cameras(replace(SHOWN, views=120, between=1), 5)


def look(coach, k, view, statistics=STATISTICS):
    return coach.look_at_image(10**9 * k, GREY, view, statistics, seconds=float(k), rate_hz=10.0)


def test_what_is_missing_is_asked_for_until_a_calibration_is_tried(shown):
    coach, phases, regions = BoardCoach(shown.target), [], []
    for k, view in enumerate(views_of(shown)):
        state = look(coach, k, view)
        phases.append(state.phase)
        regions.append(state.region)
        if coach.wants_trial:
            break
    assert phases[0] == "place"
    assert regions[0] in {"upper left", "upper right", "lower left", "lower right"}
    assert phases[-1] == "trying"
    assert all(share >= 1 for _, share in state.bars)
    assert len(phases) < 80
    outcome = try_calibration(coach.recording_so_far(), shown.target)
    assert outcome == TrialOutcome(verdict="pass")
    coach.take_outcome(outcome)
    assert look(coach, 200, view).confirmed


def test_views_that_are_alike_count_once(shown):
    coach, view = BoardCoach(shown.target), next(views_of(shown))
    for k in range(5):
        assert look(coach, k, view).views == 1


@pytest.mark.parametrize(("axis", "edges"), [(1, ("left", "right")), (0, ("upper", "lower"))])
@pytest.mark.parametrize("way", [-1, 1])
def test_the_edge_that_is_nearer_is_not_asked_for(shown, axis, edges, way):
    points = shown.target.points - shown.target.points.mean(axis=0)
    turned = points * [1, -1, -1] @ rotation_from_rotvec(way * 0.5 * np.eye(3)[axis]).T + [0, 0, 1.0]
    pixels = Camera.nominal(SHOWN.resolution).project(turned).pixels
    along = pixels[:, 1 - axis]
    nearer_first = turned[along < np.quantile(along, 0.2), 2].mean() < turned[along > np.quantile(along, 0.8), 2].mean()
    coach, count = BoardCoach(shown.target), len(points)
    view = BoardView(point=np.arange(count), pixels=pixels, sigma_px=np.full(count, 0.1), blur_px=0.7)
    look(coach, 0, view)
    assert set(coach._untilted()) == {"left", "right", "upper", "lower"} - {edges[0 if nearer_first else 1]}


@pytest.mark.parametrize(
    ("code", "changes"),
    [("dark", {"high": 30.0}), ("blurred", {"blur_px": 4.0}), ("bright", {"high": 255.0, "clipped": 0.9})],
)
def test_why_the_board_is_not_found_is_named(shown, code, changes):
    coach = BoardCoach(shown.target)
    for k in range(4):
        state = look(coach, k, nothing_seen(), replace(STATISTICS, **changes))
    assert code in {fault.code for fault in state.faults}
    assert state.phase == "searching"


def test_a_board_too_small_or_blurred_is_named(shown):
    coach, view = BoardCoach(shown.target), next(views_of(shown))
    small = replace(view, pixels=100 + 0.1 * view.pixels)
    assert "small" in {fault.code for fault in look(coach, 0, small).faults}
    blurred = look(coach, 1, replace(view, blur_px=3.0))
    assert "blurred" in {fault.code for fault in blurred.faults}
    assert blurred.views == 1, "only the sharp one is kept"


def test_another_board_is_named_once_it_was_not_found_for_long(shown):
    coach = BoardCoach(shown.target)
    asked = []
    for k in range(12):
        look(coach, k, nothing_seen())
        asked.append(len(coach.wants_guess))
    assert np.count_nonzero(asked) == 1
    coach.take_guess("They show a checkerboard.")
    assert "They show a checkerboard." in look(coach, 13, nothing_seen()).faults[-1].text


def test_a_board_with_other_rows_or_columns_is_not_taken_for_the_stated_one(shown):
    view = next(views_of(shown))
    odd = replace(view, dropped={NOT_WITH_NEIGHBOURS: len(view)})
    coach = BoardCoach(shown.target)
    assert [look(coach, k, odd).phase for k in range(6)][-1] == "searching"
    assert coach.wants_guess
    assert look(BoardCoach(shown.target), 0, replace(view, dropped={NOT_WITH_NEIGHBOURS: 4})).views == 1


def test_nothing_is_wrong_with_what_is_right(shown):
    coach = BoardCoach(shown.target)
    assert not [fault for k, view in enumerate(views_of(shown)) for fault in look(coach, k, view).faults]


def test_a_trial_has_a_process_of_its_own(shown):
    trials = Trials()
    for _ in range(2):  # of which the second need not wait for the process to begin
        trials.begin(shown.recording, shown.target)
        trials._thread.join()
        assert not trials.at_work
        assert trials.outcome.verdict == "pass"
    trials.begin(shown.recording, shown.target)
    trials.close()
    assert not trials.at_work
    assert trials.outcome is None
    assert trials.lost


def test_what_is_recorded_is_read_again_as_it_was(tmp_path):
    recorder = ImageRecorder(tmp_path)
    stamps = [1_700_000_000_000_000_001 + 33_333_333 * k for k in range(5)]
    for k, t_ns in enumerate(stamps):
        recorder.record_image(t_ns, np.roll(GREY, k, axis=1))
    recorder.sync_files(at_once=True)
    (tmp_path / "cam0/.1700000009.png.part").write_bytes(b"half")
    (tmp_path / "cam0/1700000009000000000.png").write_bytes(b"")  # of a computer that lost its power
    frames = list(open_images(tmp_path, need_imu=False).streams["cam0"].frames([]))
    recorder.close_files()
    assert [frame.t_ns for frame in frames] == stamps
    assert all((frame.decode() == np.roll(GREY, k, axis=1)).all() for k, frame in enumerate(frames))


class Prepared:
    """Finds what was prepared, one view for each image."""

    def __init__(self, views):
        self.views_left = views

    def views(self, images, *, follows):
        return [next(self.views_left) for _ in images]


class Told:
    """Trials that have ended as they were told to."""

    begun, outcome, at_work, lost = [], TrialOutcome(verdict="fail", advice="Not yet."), False, False

    def begin(self, recording, target):
        self.begun.append(recording)

    def close(self):
        pass


def test_each_camera_is_guided_until_all_are_known(tmp_path, shown, monkeypatch):
    monkeypatch.setattr("gnomon.live.camera_session.Trials", Told)
    session, views = CameraSession(Silent(), tmp_path / "rec", shown.target), list(views_of(shown))
    session._finder.close()
    session._finder = Prepared(view for view in views for _ in range(2))
    for k in range(6):
        for name in ("cam0", "cam1"):
            session.take_image(ImageArrival(10**18 + 10**8 * k, GREY, name))
        state = session.look_at_arrivals()
    assert state.advice.startswith("cam0: ")
    first = session.document()["picture"]
    session.coaches["cam0"].take_outcome(TrialOutcome(verdict="pass"))
    for name in ("cam0", "cam1"):
        session.take_image(ImageArrival(10**18 + 10**9, GREY, name))
    state = session.look_at_arrivals()
    assert state.advice.startswith("cam1: ")
    assert not state.confirmed
    assert first.startswith("cam0-")
    assert session.document()["picture"].startswith("cam1-")
    session.coaches["cam1"].take_outcome(TrialOutcome(verdict="pass"))
    for name in ("cam0", "cam1"):
        session.take_image(ImageArrival(10**18 + 2 * 10**9, GREY, name))
    state = session.look_at_arrivals()
    assert (state.phase, state.confirmed) == ("together", False)
    assert "to all cameras at once" in state.advice
    for k in range(20, 100):
        for name in ("cam0", "cam1"):
            session.take_image(ImageArrival(10**18 + 10**8 * k, GREY, name))
        state = session.look_at_arrivals()
        if "Not yet." in state.advice:
            Told.outcome = TrialOutcome(verdict="pass")
    first, second = (Told.begun[-1].cameras[name] for name in ("cam0", "cam1"))
    assert len(np.intersect1d(first.t_ns, second.t_ns)) >= 10
    assert len(Told.begun) == 2, "again with more views alone"
    assert state.confirmed
    session.end_recording()


def test_missing_frames_are_named(tmp_path, shown):
    session = CameraSession(Silent(), tmp_path / "rec", shown.target)
    for k in range(30):
        if k not in {20, 21, 22}:
            session.take_image(ImageArrival(10**18 + 33_000_000 * k, GREY))
    assert [fault.code for fault in session.troubles()] == ["dropped"]
    assert "3 of the last" in session.troubles()[0].text
    session.end_recording()


def recorded(stamps):
    frames = [Frame(t_ns=t_ns, where="", decode=lambda: GREY) for t_ns in stamps]
    return ImageRecording(imus={}, streams={"cam0": ImageStream(frames=lambda _: iter(frames))})


@pytest.mark.parametrize(
    ("stamps", "step_ns"), [([10**18 + 10**6 * k for k in range(4)], 10**6), ([0, 1, 2], 5 * 10**8)]
)
def test_images_that_are_only_numbered_come_twice_a_second(stamps, step_ns):
    source = ReplayImages(recorded(stamps), Pace(1000))
    arrived = [arrival.t_ns for arrival in source.arriving_images(Event())]
    assert np.diff(arrived).tolist() == [step_ns] * (len(stamps) - 1)
    assert source.ended


class Plugged:
    """A camera of OpenCV's that is unplugged after two images."""

    def __init__(self, place):
        self.place, self.left = place, 2

    def grab(self):
        self.left -= 1
        return self.left >= 0

    def retrieve(self):
        return True, np.dstack([GREY, GREY, GREY])

    def release(self):
        pass


def test_a_camera_is_opened_again_after_it_was_unplugged(monkeypatch):
    import cv2

    opened = []
    monkeypatch.setattr(cv2, "VideoCapture", lambda place: opened.append(place) or Plugged(place))
    monkeypatch.setattr("gnomon.live.image_sources._AGAIN_S", 0.0)
    source, stop = CameraSource("1"), Event()
    found = [arrival for _, arrival in zip(range(5), source.arriving_images(stop), strict=False)]
    assert opened[:2] == [1, 1]
    assert (found[0].image == GREY).all()
    assert (np.diff([arrival.t_ns for arrival in found]) > 0).all()


def test_several_cameras_are_one_source(monkeypatch):
    import cv2

    monkeypatch.setattr(cv2, "VideoCapture", Plugged)
    monkeypatch.setattr("gnomon.live.image_sources._AGAIN_S", 0.0)
    found = [arrival for _, arrival in zip(range(4), CameraSource("0,2").arriving_images(Event()), strict=False)]
    assert [arrival.camera for arrival in found] == ["cam0", "cam1", "cam0", "cam1"]


@pytest.mark.parametrize("text", ["usb:1", "camera:", "replay:", "replay:x@y", "camera:tests/unit/live/test_camera.py"])
def test_a_source_that_is_none_is_named(text):
    with pytest.raises(OptionError):
        open_image_source(text)
