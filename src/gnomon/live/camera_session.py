"""A guided capture of a camera: source, recorder and coach at work together."""

import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..assess.checks.image_checks import measure_image
from ..detect.boards.board import BoardView
from ..detect.boards.board_guess import guess_board
from ..detect.boards.worker import BoardFinder, BoardProcess, ProcessLostError
from ..errors import GnomonError
from ..models.target import Target
from ..recording import CameraFrames, Recording
from ..recording.recording import Grey
from .board_coach import BoardCoach, BoardState
from .faults import Fault
from .image_sources import ImageArrival, ImageSource
from .recorder import ImageRecorder, Recorder
from .trials import TrialOutcome, Trials

_SILENT_S = 3.0
_GAP, _FEWEST = 2.5, 10  # periods between frames, of which one is missing
_TOGETHER, _MORE = 10, 1.3  # views of several cameras at once; times as many before they are tried again
_WIDEST = 640
_QUALITY = 70


class CameraSession:
    """Records the images of a camera, and says what to do next.

    Parameters
    ----------
    source : of the images
    folder : to record in
    target : the board
    """

    page = "camera"
    looks = 1
    """How many images of a camera are looked at, at most, each time."""
    joined = True
    """Whether several cameras are told to see the board at once, and where they are to each other is tried."""

    def __init__(self, source: ImageSource, folder: Path, target: Target) -> None:
        Recorder(folder).close_files()  # the folder is there now, and empty
        self.source, self.folder, self.images = source, folder, ImageRecorder(folder)
        self._target, self._guided, self._state = target, "cam0", BoardState()
        first = self._coach("cam0")
        assert first is not None
        self.coaches = {"cam0": first}
        self.stopped = threading.Event()
        self.trace: deque[list[float]] = deque()
        self._pending: dict[str, deque[ImageArrival]] = {}
        self._stamps: deque[int] = deque(maxlen=60)
        self._first_ns, self._arrived_s = 0, time.monotonic()
        self._looked: dict[str, ImageArrival] = {}
        self._trials: Trials | None = None
        self._tried: str | None = None
        self._together: list[dict[str, tuple[int, BoardView]]] = []
        self._joint, self._joint_tried = TrialOutcome(), 0
        self._finder: BoardProcess | BoardFinder
        try:
            self._finder = BoardProcess(target)
        except ProcessLostError:
            self._finder = BoardFinder(target)
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def _coach(self, camera: str) -> BoardCoach | None:
        """Return the coach of a camera; None where it is recorded alone."""
        return BoardCoach(self._target, camera)

    @property
    def coach(self) -> BoardCoach:
        """The coach of the camera that is guided now."""
        return self.coaches[self._guided]

    def begin_recording(self) -> None:
        """Begin to receive, in a thread of its own."""
        self._arrived_s = time.monotonic()
        self._thread.start()

    def end_recording(self) -> None:
        """Stop receiving, and close the files."""
        self.stopped.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self.images.close_files()
        if isinstance(self._finder, BoardProcess):
            self._finder.close()
        if self._trials is not None:
            self._trials.close()

    @property
    def recorded(self) -> str:
        """What was recorded."""
        return f"{self.images.written} images"

    @property
    def empty(self) -> bool:
        """Whether nothing arrived."""
        return self.images.written == 0

    def _receive(self) -> None:
        try:
            for arrival in self.source.arriving_images(self.stopped):
                self.take_image(arrival)
        except GnomonError as error:
            self.source.trouble = str(error)
        except OSError as error:
            self.source.trouble = f"Recording ended: {error}. Free some space, and begin again."

    def take_image(self, arrival: ImageArrival) -> None:
        """Record an image, and keep it for the coach until the next one."""
        self.images.record_image(*arrival)
        self._arrived_s = time.monotonic()
        self._first_ns = self._first_ns or arrival.t_ns
        if arrival.camera == "cam0":
            self._stamps.append(arrival.t_ns)
        self._pending.setdefault(arrival.camera, deque(maxlen=self.looks)).append(arrival)

    def take_arrivals(self) -> None:
        """Images wait until they are looked at."""

    def look_at_arrivals(self) -> BoardState:
        """Look at the newest image of each camera, and return what there is to say of the first that needs more."""
        self.images.sync_files()
        self._follow_trial()
        known, seen = sum(coach.state.views for coach in self.coaches.values()), dict[str, tuple[int, BoardView]]()
        for name, waiting in list(self._pending.items()):
            if name not in self.coaches and (coach := self._coach(name)) is not None:
                self.coaches[name] = coach
            if waiting and name in self.coaches:
                arrivals = [waiting.popleft() for _ in range(len(waiting))]
                view = self._look(self.coaches[name], arrivals)
                if self.coaches[name].in_sight:
                    seen[name] = arrivals[-1].t_ns, view
        if self.joined and sum(coach.state.views for coach in self.coaches.values()) > known:
            self._keep_together(seen)
        unserved = {name: one.state.phase for name, one in self.coaches.items() if not one.state.confirmed}
        self._guided = next((n for n, phase in unserved.items() if phase != "trying"), next(iter(unserved), "cam0"))
        self._state = self.coach.state
        if len(self.coaches) > 1:
            said = f"{self._guided}: {self._state.advice}"
            self._state = replace(self._state, advice=said, confirmed=not unserved)
            if self.joined and not unserved:
                self._state = self._said_together(self._state)
        return self._state

    def _keep_together(self, seen: dict[str, tuple[int, BoardView]]) -> None:
        """Keep the views of cameras that see the board at once."""
        stamps = [t_ns for t_ns, _ in seen.values()]
        if len(stamps) > 1 and len(self._stamps) > 1 and 2 * (max(stamps) - min(stamps)) < self._period_ns:
            self._together.append(seen)

    def _said_together(self, state: BoardState) -> BoardState:
        """Return what there is to say of cameras that are known one by one: where they are to each other."""
        bars = (*state.bars, ("seen together", len(self._together) / _TOGETHER))
        if self._joint.verdict == "pass":
            said = "Enough: lenses and places of the cameras are known well. Stop, or go on for more."
            return replace(state, advice=said, bars=bars)
        more, said = _TOGETHER - len(self._together), self._joint.advice
        if more > 0:
            said = f"Show the board to all cameras at once, elsewhere and tilted; {more} more view{'s' * (more > 1)}."
        return replace(
            state,
            advice=said or "Go on: the cameras are calibrated together meanwhile.",
            phase="together",
            bars=bars,
            confirmed=False,
        )

    def _look(self, coach: BoardCoach, arrivals: list[ImageArrival]) -> BoardView:
        """Look at what arrived of a camera, and return what the newest image shows."""
        views = self._views_of([arrival.image for arrival in arrivals])
        for earlier, view in zip(arrivals[:-1], views[:-1], strict=True):
            coach.keep_view(earlier.t_ns, view, earlier.image.shape[::-1])
        arrival = self._looked[coach.camera] = arrivals[-1]
        coach.look_at_image(
            arrival.t_ns,
            arrival.image,
            views[-1],
            measure_image(arrival.image),
            seconds=(arrival.t_ns - self._first_ns) * 1e-9,
            rate_hz=1e9 / self._period_ns if len(self._stamps) > 1 else 0.0,
        )
        if unseen := coach.wants_guess:
            coach.take_guess(guess_board(unseen, self._target))
        return views[-1]

    def _views_of(self, images: list[Grey]) -> list[BoardView]:
        with suppress(ProcessLostError):
            return self._finder.views(images, follows=False)
        self._finder = BoardFinder(self._target)
        return self._finder.views(images, follows=False)

    def _follow_trial(self) -> None:
        """Begin a calibration where the views may be enough, and take what came of it."""
        if self._trials is not None and self._tried is not None and not self._trials.at_work:
            if self._trials.outcome is not None and self._tried:
                self.coaches[self._tried].take_outcome(self._trials.outcome)
            elif self._trials.outcome is not None:
                self._joint = self._trials.outcome
            self._tried = None
        wanting = next((name for name, coach in self.coaches.items() if coach.wants_trial), None)
        together = len(self._together) >= max(_TOGETHER, _MORE * self._joint_tried)
        if wanting is None and self._state.phase == "together" and together:
            wanting, self._joint_tried = "", len(self._together)
        if self._tried is None and wanting is not None:
            with suppress(OSError):  # no memory for a process: later, perhaps
                self._begin_trial([self.coaches[wanting]] if wanting else list(self.coaches.values()))
                self._tried = wanting

    def _begin_trial(self, coaches: list[BoardCoach]) -> None:
        cameras = dict[str, CameraFrames]()
        for coach in coaches:
            shared = [seen[coach.camera] for seen in self._together if coach.camera in seen and len(coaches) > 1]
            cameras |= coach.recording_so_far(shared).cameras
        self._ready_trials().begin(Recording(imus={}, cameras=cameras), self._target)

    def _ready_trials(self) -> Trials:
        """Return what makes trials, another one where it was lost."""
        if self._trials is not None and self._trials.lost:
            self._trials.close()
            self._trials = None
        self._trials = self._trials or Trials()
        return self._trials

    @property
    def _period_ns(self) -> float:
        return float(np.median(np.diff(self._stamps)))

    def troubles(self) -> list[Fault]:
        """Return why nothing can be said, and what is wrong with the source, most important first."""
        if self.source.trouble:
            return [Fault(code="source", text=self.source.trouble)]
        if time.monotonic() - self._arrived_s > _SILENT_S:
            return [Fault(code="silence", text="No image arrives: is the camera switched on?")]
        steps = np.diff(list(self._stamps))
        lost = int(np.rint(steps[steps > _GAP * self._period_ns] / self._period_ns - 1).sum()) if len(steps) else 0
        if lost and len(steps) >= _FEWEST:
            text = f"{lost} of the last images are missing: ask for fewer or smaller ones, or close other programs."
            return [Fault(code="dropped", text=text)]
        return []

    def document(self) -> dict[str, Any]:
        """Return all that the page shows."""
        said = self._state.document()
        said["faults"] = [*([fault.code, fault.text] for fault in self.troubles()), *said["faults"]]
        looked = self._looked.get(self._guided)
        said["written"], said["picture"] = self.images.written, f"{looked.camera}-{looked.t_ns}" if looked else ""
        return said

    def picture(self) -> bytes:
        """Return the image that was looked at last, as a small JPEG; nothing before the first."""
        import cv2

        if self._guided not in self._looked:
            return b""
        image = self._looked[self._guided].image
        if image.shape[1] > _WIDEST:
            size = (_WIDEST, round(image.shape[0] * _WIDEST / image.shape[1]))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
