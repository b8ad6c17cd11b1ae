"""Where samples come from: each source yields the lines that a device sends, as they arrive."""

import json
import math
import re
import socket
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import urlopen

from ..errors import OptionError, RecordingError, install_line
from ..readers.files import first_bytes
from ..recording import ImuSamples, TriadSamples
from ..units import Units
from .hand import SimulatedHand

_BAUD = 115_200
_PIECE = 4096
_WAIT_S = 0.05
_AGAIN_S = 0.5
_HEAD, _LATE_S = 8, 2.0
_CHUNKS = (
    "The file grows by pieces of {:.0f} s, and the advice is as late: record it without chunks (ros2 bag record "
    "--storage-preset-profile fastwrite) or with small ones (rosbag record --chunksize=16)."
)
_FORMS = "serial:PORT[@BAUD], tail:FILE, udp:PORT, phyphox:HOST, http, replay:RECORDING[@SPEED] or simulate[:SEED]"


class Arrival(NamedTuple):
    """A line without its end, and the stream that it belongs to; "" where a line holds all triads."""

    line: bytes
    stream: str = ""


class LiveSource(ABC):
    """Something that sends samples.

    Attributes
    ----------
    trouble : why nothing arrives now, and what to do; "" where all is well
    ended : whether nothing will come any more
    """

    def __init__(self) -> None:
        self.trouble, self.ended = "", False

    @abstractmethod
    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield lines until it ends, or `stop` is set."""


def open_source(text: str, units: Units | None = None) -> LiveSource:
    """Return the source that a text names.

    Parameters
    ----------
    units : of a recording to replay, as far as they are stated

    Raises
    ------
    OptionError
        If there is no such source, or what it needs is not installed.
    """
    if re.match(r"/dev/|COM\d", text):
        raise OptionError(
            f"{text}: this is a serial port. Name it as serial:{text}, with @BAUD where it is not {_BAUD}."
        )
    kind, rest, factor = parse_source(text, _FORMS, numbered=("serial", "replay"))
    makers: dict[str, Callable[[], LiveSource]] = {
        "serial": lambda: SerialSource(rest, factor or _BAUD),
        "tail": lambda: TailSource(Path(rest)),
        "udp": lambda: UdpSource(_whole_number(text, rest, _FORMS)),
        "phyphox": lambda: PhyphoxSource(rest),
        "http": PushSource,
        "replay": lambda: ReplaySource(_recorded(Path(rest), units), Pace(factor or 1)),
        "simulate": lambda: SimulatedSource(_whole_number(text, rest or "0", _FORMS)),
    }
    if kind not in makers or (not rest and kind not in {"http", "simulate"}):
        raise OptionError(f"{text}: there is no such source. Name one as {_FORMS}.")
    return makers[kind]()


def parse_source(text: str, forms: str, numbered: tuple[str, ...] = ()) -> tuple[str, str, int]:
    """Return kind, place, and number of a source, KIND:PLACE@NUMBER; the number is 0 where it is not given.

    Parameters
    ----------
    forms : of sources, for messages
    numbered : kinds that may have a number

    Raises
    ------
    OptionError
        If the number is none.
    """
    kind, _, place = text.partition(":")
    if kind not in numbered or "@" not in place:
        return kind, place, 0
    place, _, number = place.rpartition("@")
    return kind, place, _whole_number(text, number, forms)


def _whole_number(text: str, number: str, forms: str) -> int:
    if not (number.isascii() and number.isdigit() and len(number) < 10):
        raise OptionError(f"{text}: {number} is no whole number. Sources are named {forms}.")
    return int(number)


def _recorded(path: Path, units: Units | None) -> ImuSamples:
    from ..readers.recordings import read

    return read(path, units=units).imus["imu0"]


class Pace:
    """When what was recorded is due again; streams of one recording share it.

    Parameters
    ----------
    speed : times as fast as it was recorded
    """

    def __init__(self, speed: int) -> None:
        self._speed, self._began_s = max(speed, 1), 0.0
        self.begin_ns = 0

    def begins_at(self, t_ns: int) -> None:
        """Take a stream into account, whose first stamp this is [ns]."""
        self.begin_ns = min(self.begin_ns, t_ns) if self.begin_ns else t_ns

    def wait_for(self, t_ns: int, stop: Event) -> bool:
        """Wait until a stamp is due, and return whether it was stopped meanwhile."""
        self._began_s = self._began_s or time.monotonic()
        ahead_s = (t_ns - self.begin_ns) * 1e-9 / self._speed - (time.monotonic() - self._began_s)
        self._began_s -= min(0.0, ahead_s + _WAIT_S)  # the other streams wait for one that is not ready in time
        return (ahead_s > 0.01 and stop.wait(ahead_s)) or stop.is_set()


class _Splitter:
    """Bytes in pieces -> lines; what has no end for too long is given as it is."""

    def __init__(self) -> None:
        self._rest = b""

    def lines_of(self, piece: bytes) -> list[bytes]:
        """Return the lines that a piece completes."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > _PIECE:
            lines, self._rest = [*lines, self._rest], b""
        return [line.rstrip(b"\r") for line in lines if line.strip()]


class SerialSource(LiveSource):
    """A serial port, opened again after it was unplugged.

    Parameters
    ----------
    port : such as /dev/ttyUSB0 or COM3
    baud : its rate
    """

    def __init__(self, port: str, baud: int) -> None:
        super().__init__()
        try:
            import serial
        except ImportError:
            raise OptionError(f"serial:{port}: this needs pyserial. Run: {install_line('gnomon[live]')}") from None
        self._serial, self.port, self.baud = serial, port, baud

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield lines; the first one may be cut, and is left out."""
        while not stop.is_set():
            try:
                with self._serial.Serial(self.port, self.baud, timeout=_WAIT_S) as port:
                    self.trouble = ""
                    splitter, first = _Splitter(), True
                    while not stop.is_set():
                        piece = port.read(max(1, min(port.in_waiting, _PIECE)))
                        lines = splitter.lines_of(piece)
                        for line in lines[1:] if first else lines:
                            yield Arrival(line)
                        first = first and not lines
            except (OSError, self._serial.SerialException):
                self.trouble = (
                    f"{self.port} is not there: plug it in, and close other programs that use it. {_ports_found()}"
                )
                stop.wait(_AGAIN_S)


def _ports_found() -> str:
    from serial.tools.list_ports import comports

    ports = ", ".join(port.device for port in comports())
    return f"Found: {ports}." if ports else "No serial port is there."


class TailSource(LiveSource):
    """A text file, an MCAP file or a ROS 1 bag that another program writes.

    Parameters
    ----------
    path : of the file, which may be made later
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield the lines that are there, and those that are added; of a bag a line for each sample of its IMU."""
        from .bag_tail import bag_lines, is_bag  # imports this one

        while not stop.is_set() and not (self.path.is_file() and self.path.stat().st_size >= _HEAD):
            if self.path.is_dir():
                raise RecordingError(f"{self.path} is a folder: name the file in it that grows.")
            self.trouble = f"{self.path} is not there yet, or empty."
            stop.wait(_AGAIN_S)
        if stop.is_set():
            return
        self.trouble = ""
        if is_bag(first_bytes(self.path, _HEAD)):
            yield from self._followed(bag_lines, stop)
            self.trouble, self.ended = f"{self.path.name} is complete: stop.", True
            return
        splitter = _Splitter()
        with self.path.open("rb") as file:
            while not stop.is_set():
                piece = file.read(_PIECE)
                for line in splitter.lines_of(piece):
                    yield Arrival(line)
                if not piece:
                    stop.wait(_WAIT_S)

    def _followed(
        self, lines: Callable[[Path, Callable[[], bool]], Iterator[Arrival]], stop: Event
    ) -> Iterator[Arrival]:
        """Yield what arrives in a bag, and say where seconds of it come at once."""
        came: list[int] = []
        pieces = 0

        def wait() -> bool:
            nonlocal pieces
            if came:
                late_s = 1e-9 * (came[-1] - came[0]) * (pieces > 0)  # at first comes what was there before
                self.trouble = _CHUNKS.format(late_s) if late_s > _LATE_S else ""
                pieces += 1
                came.clear()
            return not stop.wait(_WAIT_S)

        for arrival in lines(self.path, wait):
            if arrival.line[:1].isdigit():
                came[1:] = [int(arrival.line.partition(b",")[0])]
            yield arrival


class UdpSource(LiveSource):
    """Datagrams of one line or more, JSON or CSV; those of the first sender alone.

    Parameters
    ----------
    port : to listen at
    """

    def __init__(self, port: int) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("", port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise OptionError(f"udp:{port}: cannot listen there ({error}). Choose another port.") from None
        self._socket.settimeout(_WAIT_S)

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield the lines of each datagram."""
        sender: str | None = None
        with self._socket:
            while not stop.is_set():
                with suppress(TimeoutError):
                    data, (host, _) = self._socket.recvfrom(65_536)
                    sender = sender or host
                    if host == sender:
                        for line in data.split(b"\n"):
                            if line.strip():
                                yield Arrival(line.rstrip(b"\r"))


class ReplaySource(LiveSource):
    """The samples of a recording, sent again as fast as it was recorded, or some times faster.

    Parameters
    ----------
    imu : all of them
    pace : how fast
    """

    def __init__(self, imu: ImuSamples, pace: Pace) -> None:
        super().__init__()
        triads = {"accelerometer": imu.accelerometer, "gyroscope": imu.gyroscope, "magnetometer": imu.magnetometer}
        self._there = {name: triad for name, triad in triads.items() if triad is not None and len(triad)}
        self._pace = pace
        pace.begins_at(min(int(triad.t_ns[0]) for triad in self._there.values()))

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield a line for each sample, after one with the names of the columns."""
        there = self._there
        rows = sorted(_rows(there), key=lambda row: row[0])
        for name in dict.fromkeys(stream for _, _, stream in rows):
            yield Arrival(_header({name: there[name]} if name else there), name)
        for t_ns, line, stream in rows:
            if self._pace.wait_for(t_ns, stop):
                return
            yield Arrival(line, stream)
        self.trouble, self.ended = "The recording is at its end: stop.", True


def _rows(triads: Mapping[str, TriadSamples]) -> Iterator[tuple[int, bytes, str]]:
    """Yield stamp, line and stream of each sample; triads with the same stamps share lines."""
    first = next(iter(triads.values()))
    alike = all(len(one) == len(first) and (one.t_ns == first.t_ns).all() for one in triads.values())
    groups = [("", list(triads.values()))] if alike else [(name, [one]) for name, one in triads.items()]
    for stream, group in groups:
        for k, t_ns in enumerate(group[0].t_ns.tolist()):
            numbers = [repr(value) for one in group for value in one.values[k].tolist()]
            yield t_ns, f"{t_ns},{','.join(numbers)}".encode(), stream


def _header(triads: Mapping[str, TriadSamples]) -> bytes:
    names = [f"{name} {axis} [{triad.unit}]" for name, triad in triads.items() for axis in "xyz"]
    return ",".join(["time [ns]", *names]).encode()


class SimulatedSource(LiveSource):
    """A sensor in a hand that does what the coach says, to try everything without a sensor.

    Parameters
    ----------
    seed : of both
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.hand = SimulatedHand(seed)

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield lines in real time."""
        began_s = time.monotonic()
        for k, line in enumerate(self.hand.sample_lines()):
            ahead_s = k / self.hand.rate_hz - (time.monotonic() - began_s)
            if (ahead_s > 0.02 and stop.wait(ahead_s)) or stop.is_set():
                return
            yield Arrival(line)


class PhyphoxSource(LiveSource):
    """The remote access of phyphox on a phone in the same network (its wiki, "Remote-interface communication").

    The experiment must use the accelerometer (with g) and the gyroscope.

    Parameters
    ----------
    host : such as 192.168.1.20 or 192.168.1.20:8080
    """

    def __init__(self, host: str) -> None:
        super().__init__()
        if not host.replace(".", "").replace(":", "").replace("-", "").isalnum():
            raise OptionError(f"phyphox:{host}: expected a host, such as phyphox:192.168.1.20:8080.")
        self._url = f"http://{host}"

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield a line for each sample of each sensor, after the names of its columns."""
        last: dict[str, float] = {}
        buffers: dict[str, list[str]] = {}
        while not stop.is_set():
            try:
                if not buffers:
                    buffers = self._buffers()
                    self._fetched("/control?cmd=start")
                for sensor, names in buffers.items():
                    yield from self._new_rows(sensor, names, last)
                self.trouble = ""
            except (URLError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                self.trouble = f"phyphox does not answer ({error}): allow remote access in its menu, and start it."
                stop.wait(_AGAIN_S)
            stop.wait(_WAIT_S)

    def _fetched(self, path: str) -> Any:
        with urlopen(self._url + path, timeout=3) as answer:
            return json.loads(answer.read(16 << 20))

    def _buffers(self) -> dict[str, list[str]]:
        """Return the buffers of time, x, y and z of each sensor."""
        found: dict[str, list[str]] = {}
        for sensor in self._fetched("/config")["inputs"]:
            if sensor["source"] not in {"accelerometer", "gyroscope", "magnetic_field"}:
                continue
            outputs = {key: name for output in sensor["outputs"] for key, name in output.items()}
            name = "magnetometer" if sensor["source"] == "magnetic_field" else sensor["source"]
            found[name] = [outputs["t"], outputs["x"], outputs["y"], outputs["z"]]
        if "accelerometer" not in found:
            raise KeyError("its experiment has no accelerometer")
        return found

    def _new_rows(self, sensor: str, names: list[str], last: dict[str, float]) -> Iterator[Arrival]:
        t, *axes = (quote(name) for name in names)
        since = last.get(sensor, -1.0)
        wanted = f"{t}={since!r}&" + "&".join(f"{axis}={since!r}|{t}" for axis in axes)
        answer = self._fetched(f"/get?{wanted}")["buffer"]
        columns = [answer[name]["buffer"] for name in names]
        unit = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}.get(sensor, "uT")
        if sensor not in last:
            yield Arrival(",".join(["time [s]", *(f"{sensor} {axis} [{unit}]" for axis in "xyz")]).encode(), sensor)
            last[sensor] = since
        for row in zip(*columns, strict=False):
            if all(isinstance(value, float | int) and math.isfinite(value) for value in row) and row[0] > last[sensor]:
                last[sensor] = row[0]
                yield Arrival(",".join(repr(float(value)) for value in row).encode(), sensor)


_PUSHED = {  # Sensor Logger's names, in lower case
    "totalacceleration": ("accelerometer", "m/s^2"),
    "accelerometeruncalibrated": ("accelerometer", "g"),
    "gyroscope": ("gyroscope", "rad/s"),
    "gyroscopeuncalibrated": ("gyroscope", "rad/s"),
    "magnetometer": ("magnetometer", "uT"),
    "magnetometeruncalibrated": ("magnetometer", "uT"),
}


class PushSource(LiveSource):
    """What Sensor Logger on a phone pushes by HTTP to /push of the page's address."""

    def __init__(self) -> None:
        super().__init__()
        self.trouble = "Nothing was pushed yet: enter the address of this page, with /push, in Sensor Logger."
        self._waiting: deque[Arrival] = deque()
        self._chosen: dict[str, str] = {}
        self._more = Event()

    def take_push(self, body: bytes) -> int:
        """Take a document of Sensor Logger, and return how many samples it held.

        Raises
        ------
        RecordingError
            If it is none.
        """
        try:
            entries = json.loads(body)["payload"]
            found = [(entry["name"].lower(), int(entry["time"]), entry["values"]) for entry in entries]
            rows = [
                (name, t_ns, [float(values[axis]) for axis in "xyz"])
                for name, t_ns, values in found
                if name in _PUSHED and all(axis in values for axis in "xyz")
            ]
            if not all(math.isfinite(value) and 0 <= t_ns < 1 << 63 for _, t_ns, xyz in rows for value in xyz):
                raise ValueError("it holds what no sensor measures")  # noqa: TRY301
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            raise RecordingError("this is no document of Sensor Logger: payload, name, time, values.") from None
        arrivals: list[Arrival] = []
        for name, t_ns, xyz in sorted(rows, key=lambda row: row[1]):
            stream, unit = _PUSHED[name]
            if stream not in self._chosen:
                self._chosen[stream] = name
                columns = ["time [ns]", *(f"{stream} {axis} [{unit}]" for axis in "xyz")]
                arrivals.append(Arrival(",".join(columns).encode(), stream))
            if self._chosen[stream] == name:
                arrivals.append(Arrival(f"{t_ns},{','.join(map(repr, xyz))}".encode(), stream))
        told = {name for name, _, _ in found}
        if "accelerometer" in told and "accelerometer" not in self._chosen:
            self.trouble = "Gravity was taken off: switch on Total Acceleration in Sensor Logger too."
        elif arrivals:
            self.trouble = ""
        self._waiting.extend(arrivals)
        self._more.set()
        return len(rows)

    def arriving_lines(self, stop: Event) -> Iterator[Arrival]:
        """Yield what was pushed."""
        while not stop.is_set():
            if self._more.wait(_WAIT_S):
                self._more.clear()
            while self._waiting:
                yield self._waiting.popleft()
