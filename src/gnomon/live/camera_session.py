"""A guided capture of a camera: source, recorder and coach at work together."""

import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..assess.checks.image_checks import measure_image
from ..detect.boards.board import BoardView
from ..detect.boards.board_guess import guess_board
from ..detect.boards.worker import BoardFinder, BoardProcess, ProcessLostError
from ..errors import GnomonError
from ..models.target import Target
from ..recording.images import Grey
from .board_coach import BoardCoach, BoardState
from .faults import Fault
from .image_recorder import ImageRecorder
from .image_sources import ImageArrival, ImageSource
from .recorder import Recorder
from .trials import Trial

_SILENT_S = 3.0
_GAP, _FEWEST = 2.5, 10  # periods between frames, of which one is missing
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
    """How many images are looked at, at most, each time."""

    def __init__(self, source: ImageSource, folder: Path, target: Target) -> None:
        Recorder(folder).close_files()  # the folder is there now, and empty
        self.source, self.folder, self.images = source, folder, ImageRecorder(folder)
        self.coach = self._coach(target)
        self.stopped = threading.Event()
        self.trace: deque[list[float]] = deque()
        self._pending: deque[ImageArrival] = deque(maxlen=self.looks)
        self._stamps: deque[int] = deque(maxlen=60)
        self._first_ns, self._arrived_s = 0, time.monotonic()
        self._shown: Grey | None = None
        self._looked_ns = -1
        self._trial: Trial | None = None
        self._finder: BoardProcess | BoardFinder
        try:
            self._finder = BoardProcess(target)
        except ProcessLostError:
            self._finder = BoardFinder(target)
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def _coach(self, target: Target) -> BoardCoach:
        return BoardCoach(target)

    def begin_recording(self) -> None:
        """Begin to receive, in a thread of its own."""
        self._thread.start()

    def end_recording(self) -> None:
        """Stop receiving, and close the files."""
        self.stopped.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self.images.close_files()
        if isinstance(self._finder, BoardProcess):
            self._finder.close()
        if self._trial is not None:
            self._trial.close()

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
        if arrival.camera == "cam0":
            self._first_ns = self._first_ns or arrival.t_ns
            self._stamps.append(arrival.t_ns)
            self._pending.append(arrival)

    def take_arrivals(self) -> None:
        """Images wait until they are looked at."""

    def look_at_arrivals(self) -> BoardState:
        """Look at the newest image, and return what there is to say."""
        self.images.sync_files()
        self._follow_trial()
        arrivals = [self._pending.popleft() for _ in range(len(self._pending))]
        if not arrivals:
            return self.coach.state
        views = self._views_of([arrival.image for arrival in arrivals])
        for earlier, view in zip(arrivals[:-1], views[:-1], strict=True):
            self.coach.keep_view(earlier.t_ns, view, earlier.image.shape[::-1])
        arrival = arrivals[-1]
        self._looked_ns, self._shown = arrival.t_ns, arrival.image
        state = self.coach.look_at_image(
            arrival.t_ns,
            arrival.image,
            views[-1],
            measure_image(arrival.image),
            seconds=(arrival.t_ns - self._first_ns) * 1e-9,
            rate_hz=1e9 / self._period_ns if len(self._stamps) > 1 else 0.0,
        )
        if unseen := self.coach.wants_guess:
            self.coach.take_guess(guess_board(unseen, self.coach.target))
        return state

    def _views_of(self, images: list[Grey]) -> list[BoardView]:
        with suppress(ProcessLostError):
            return self._finder.views(images, follows=False)
        self._finder = BoardFinder(self.coach.target)
        return self._finder.views(images, follows=False)

    def _follow_trial(self) -> None:
        """Begin a calibration where the views may be enough, and take what came of it."""
        if self._trial is not None and self._trial.ended:
            if self._trial.outcome is not None:
                self.coach.take_outcome(self._trial.outcome)
            self._trial = None
        if self._trial is None and self.coach.wants_trial:
            self._trial = self._begin_trial()

    def _begin_trial(self) -> Trial:
        return Trial(self.coach.recording_so_far(), self.coach.target)

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
        said = self.coach.state.document()
        said["faults"] = [*([fault.code, fault.text] for fault in self.troubles()), *said["faults"]]
        said["written"], said["picture"] = self.images.written, self._looked_ns
        return said

    def picture(self) -> bytes:
        """Return the image that was looked at last, as a small JPEG; nothing before the first."""
        import cv2

        image = self._shown
        if image is None:
            return b""
        if image.shape[1] > _WIDEST:
            size = (_WIDEST, round(image.shape[0] * _WIDEST / image.shape[1]))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
