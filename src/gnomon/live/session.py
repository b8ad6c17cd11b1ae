"""One guided capture: source, recorder and coach at work together."""

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GnomonError, RecordingError
from ..options.requirements import Use
from ..readers.samples.stream_text import ArrivingTable
from ..units import Units
from .coach import Coach, CoachState
from .faults import Fault
from .recorder import Recorder, is_printable
from .sources import LiveSource, SimulatedSource

LOOK_S, TICK_S = 0.5, 0.1
_SILENT_S = 1.5
_HEAD_LINES = 40
_LONGEST_HEAD = 400
_DAMAGED, _LOOKS = 0.2, 6
_TRACE, _TRACE_S = 600, 0.02


class LiveSession:
    """Records what a source sends, and says what to do next.

    Parameters
    ----------
    source : of the samples
    folder : to record in
    use : what the sensor is for
    units, columns, rate_hz : what the lines do not say about themselves
    coach : which kind of
    name : of the file with the samples
    clock : seconds, by which silence is told
    """

    page = "imu"

    def __init__(
        self,
        source: LiveSource,
        folder: Path,
        use: Use,
        *,
        units: Units | None = None,
        columns: str | None = None,
        rate_hz: float | None = None,
        coach: type[Coach] = Coach,
        name: str = "samples",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.source, self.recorder = source, Recorder(folder, name)
        self.coach = coach(use, units)
        self.trouble = ""
        self.stopped = threading.Event()
        self.trace: deque[list[float]] = deque(maxlen=_TRACE)
        self._units, self._columns, self._rate_hz = units or Units(), columns, rate_hz
        self._heads: dict[str, list[bytes]] = {}
        self._tables: dict[str, ArrivingTable] = {}
        self._lock = threading.Lock()
        self._pending: dict[str, list[bytes]] = {}
        self._clock = clock
        self._arrived_s = clock()
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._counts: deque[tuple[int, int]] = deque([(0, 0)], maxlen=_LOOKS)

    @property
    def recorded(self) -> str:
        """What was recorded."""
        return f"{self.recorder.written} lines"

    @property
    def empty(self) -> bool:
        """Whether nothing arrived."""
        return self.recorder.written == 0

    def begin_recording(self) -> None:
        """Begin to receive, in a thread of its own."""
        self._arrived_s = self._clock()
        self._thread.start()

    def end_recording(self) -> None:
        """Stop receiving, and close the files."""
        self.stopped.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self.recorder.close_files()

    def _receive(self) -> None:
        try:
            for line, stream in self.source.arriving_lines(self.stopped):
                self.take_line(line, stream)
        except GnomonError as error:
            self.source.trouble = str(error)
        except OSError as error:
            self.source.trouble = f"Recording ended: {error}. Free some space, and begin again."

    def take_line(self, line: bytes, stream: str = "") -> None:
        """Record a line, and keep it for the coach."""
        if stream and stream == self.coach.unwanted:
            return
        table = self._tables.get(stream)
        if not is_printable(line) or (table is not None and not table.is_row(line)):
            self.recorder.record_damaged(line)
            return
        whole = self.recorder.record_line(line, stream)
        with self._lock:
            self._pending.setdefault(stream, []).append(whole)
        self._arrived_s = self._clock()

    def look_at_arrivals(self) -> CoachState:
        """Take what arrived since the last look, and return what there is to say."""
        self.take_arrivals()
        self.recorder.sync_files()
        self._counts.append((self.recorder.written, self.recorder.damaged))
        state = self.coach.look_at_samples()
        if isinstance(self.source, SimulatedSource):
            self.source.hand.target = state.prospect.target
        return state

    def take_arrivals(self) -> None:
        """Hand the samples in the lines that arrived to the coach and to the page."""
        with self._lock:
            pending, self._pending = self._pending, {}
        for stream, lines in pending.items():
            try:
                self._read(stream, lines)
                self.trouble = ""
            except GnomonError as error:
                self.trouble = str(error)

    def _read(self, stream: str, lines: list[bytes]) -> None:
        table = self._tables.get(stream)
        if table is not None:
            blocks = table.samples_in(b"".join(lines))
        else:
            head = self._heads.setdefault(stream, [])
            head += lines
            if len(head) < _HEAD_LINES:
                return
            try:
                table = ArrivingTable(
                    f"{stream or 'samples'}.log", b"".join(head), self._units, self._columns, self._rate_hz
                )
            except RecordingError:
                del head[: -_LONGEST_HEAD - _HEAD_LINES]
                raise
            self._tables[stream], blocks = table, table.first
            del self._heads[stream]
        self.coach.add_samples(blocks, table.units)
        self._keep_trace(blocks)

    def _keep_trace(self, blocks: "dict[str, Any]") -> None:
        """Keep some of the samples for the page."""
        a, g = (blocks.get(name) for name in (self.coach.leading, "gyroscope"))
        if a is None or not len(a):
            return
        for k, t_s in enumerate((1e-9 * a.t_ns).tolist()):
            if not self.trace or abs(t_s - self.trace[-1][0]) >= _TRACE_S:
                rate = g.values[min(k, len(g) - 1)] if g is not None and len(g) else np.zeros(3)
                self.trace.append([round(float(x), 4) for x in (t_s, *a.values[k], *rate)])

    def troubles(self) -> list[Fault]:
        """Return why nothing can be said, and what is wrong with the source, most important first."""
        found = [Fault(code="source", text=self.source.trouble)] if self.source.trouble else []
        if self.trouble:
            found.append(Fault(code="unread", text=self.trouble))
        if self._clock() - self._arrived_s > _SILENT_S and not found:
            found.append(Fault(code="silence", text="Nothing arrives: is the device sending? Check cable and rate."))
        written, damaged = (self._counts[-1][k] - self._counts[0][k] for k in (0, 1))
        if damaged > _DAMAGED * (written + damaged):
            why = "most likely the baud rate is another one (serial:PORT@BAUD), or the cable is bad."
            found.append(Fault(code="damaged", text=f"{damaged} of {written + damaged} lines are damaged: {why}"))
        return found

    def document(self) -> dict[str, Any]:
        """Return all that the page shows."""
        said = self.coach.state.document()
        said["faults"] = [*([fault.code, fault.text] for fault in self.troubles()), *said["faults"]]
        said["written"], said["damaged"] = self.recorder.written, self.recorder.damaged
        return said
