"""Sources, each played by the simplest thing that speaks as it does."""

import json
import os
import socket
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from itertools import islice
from pathlib import Path
from threading import Event

import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError, RecordingError
from gnomon.live.coach import MagnetometerCoach
from gnomon.live.hand import SimulatedHand
from gnomon.live.session import LiveSession
from gnomon.live.sources import Pace, PushSource, open_source
from gnomon.options.requirements import USES
from gnomon.simulate import Scenario, simulate
from gnomon.writers.recording_file import save_recording


def collected(source, count, seconds=5.0):
    """Return the first lines that a source sends."""
    stop, found = Event(), []

    def work():
        for arrival in source.arriving_lines(stop):
            found.append(arrival)
            if len(found) >= count:
                stop.set()

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    stop.set()
    thread.join(2.0)
    return found


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_serial_port_loses_nothing_and_comes_back(tmp_path):
    pytest.importorskip("serial")
    import tty

    link = tmp_path / "ttyX"

    def plugged():
        master, slave = os.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        return master, slave

    source, stop, found = open_source(f"serial:{link}@500000"), Event(), []
    reader = threading.Thread(target=lambda: found.extend(source.arriving_lines(stop)), daemon=True)
    lines = list(islice(SimulatedHand(1).sample_lines(), 3000))
    master, slave = plugged()
    reader.start()
    time.sleep(0.2)
    os.write(master, b"5,9.81*half a line\n")
    for k in range(0, 2000, 20):
        os.write(master, b"".join(line + b"\n" for line in lines[k : k + 20]))
    wait_for(lambda: len(found) >= 2000)
    os.close(master)
    os.close(slave)
    wait_for(lambda: "plug it in" in source.trouble)
    master, slave = plugged()
    wait_for(lambda: not source.trouble)
    os.write(master, b"rest of a line\n" + b"".join(line + b"\n" for line in lines[2000:2010]))
    wait_for(lambda: len(found) >= 2010)
    stop.set()
    reader.join(2.0)
    os.close(master)
    os.close(slave)
    assert [arrival.line for arrival in found] == lines[:2010]


def wait_for(true, seconds=5.0):
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    assert true()


def test_a_file_that_grows_is_followed(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"1,2\n3,")

    def append():
        with path.open("ab") as file:
            file.write(b"4\n5,6\n")

    writer = threading.Timer(0.2, append)
    writer.start()
    found = collected(open_source(f"tail:{path}"), 3)
    assert [arrival.line for arrival in found] == [b"1,2", b"3,4", b"5,6"]


def test_datagrams_of_another_sender_are_passed_over():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    source = open_source(f"udp:{port}")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.2", 0)) if sys.platform == "linux" else other.bind(("127.0.0.1", 0))
        one.sendto(b'{"t": 1, "ax": 2}\n{"t": 2, "ax": 3}', ("127.0.0.1", port))
        if sys.platform == "linux":
            other.sendto(b"evil", ("127.0.0.1", port))
        one.sendto(b"last\r\n", ("127.0.0.1", port))
        found = collected(source, 3)
    assert [arrival.line for arrival in found] == [b'{"t": 1, "ax": 2}', b'{"t": 2, "ax": 3}', b"last"]


@pytest.mark.parametrize("gyroscope_rate", [None, 80.0])
def test_a_replayed_recording_is_recorded_as_it_was(tmp_path, gyroscope_rate):
    recording, _ = simulate(Scenario(intervals=2, t_init_s=2.0, gyroscope_rate_hz=gyroscope_rate), 1)
    save_recording(recording, tmp_path / "first.npz")
    source = open_source(f"replay:{tmp_path / 'first.npz'}@1000")
    session = LiveSession(source, tmp_path / "rec", USES["ahrs"])
    session.begin_recording()
    wait_for(lambda: bool(source.trouble))
    session.look_at_arrivals()
    session.end_recording()
    again, first = gnomon.read(tmp_path / "rec").imus["imu0"], recording.imus["imu0"]
    for name in ("accelerometer", "gyroscope"):
        assert np.array_equal(getattr(again, name).values, getattr(first, name).values)
        assert np.array_equal(getattr(again, name).t_ns, getattr(first, name).t_ns)
    assert len(session.coach.samples.gyroscope) == len(first.gyroscope)


class Phyphox(BaseHTTPRequestHandler):
    """Three samples more at each request."""

    time_s = 0.0

    def do_GET(self):
        if self.path == "/config":
            answer = {
                "inputs": [
                    {"source": kind, "outputs": [{"x": f"{n}X"}, {"y": f"{n}Y"}, {"z": f"{n}Z"}, {"t": f"{n}_time"}]}
                    for kind, n in (("accelerometer", "acc"), ("gyroscope", "gyr"))
                ]
            }
        elif self.path.startswith("/control"):
            answer = {"result": True}
        else:
            wanted = [part.split("=")[0] for part in self.path.split("?")[1].split("&")]
            times = [Phyphox.time_s + 0.01 * k for k in range(1, 4)]
            Phyphox.time_s = times[-1]
            values = {name: times if name.endswith("time") else [9.8, 9.7, None] for name in wanted}
            answer = {"buffer": {name: {"buffer": own} for name, own in values.items()}}
        body = json.dumps(answer).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


def test_streams_of_a_recording_wait_for_one_that_is_not_ready():
    pace, stop = Pace(1), Event()
    pace.begins_at(1)
    pace.wait_for(1, stop)
    pace._began_s -= 10.0  # an image took 10 s until it was there
    pace.wait_for(1, stop)
    began = time.monotonic()
    pace.wait_for(400_000_001, stop)
    assert time.monotonic() - began > 0.3


def test_phyphox_is_asked_for_what_is_new():
    server = HTTPServer(("127.0.0.1", 0), Phyphox)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    found = collected(open_source(f"phyphox:127.0.0.1:{server.server_port}"), 6)
    server.shutdown()
    server.server_close()
    assert found[0] == (
        b"time [s],accelerometer x [m/s^2],accelerometer y [m/s^2],accelerometer z [m/s^2]",
        "accelerometer",
    )
    assert {arrival.stream for arrival in found} == {"accelerometer", "gyroscope"}
    assert found[1].line.count(b",") == 3


def pushed(name, t_ns, x=1.0):
    return {"name": name, "time": t_ns, "values": {"x": x, "y": 2.0, "z": 3.0}}


def test_sensor_logger_is_understood_and_gravity_asked_for():
    source = PushSource()
    assert source.take_push(json.dumps({"payload": [pushed("accelerometer", 5)]}).encode()) == 0
    assert "Total Acceleration" in source.trouble
    entries = [pushed("gyroscope", 7), pushed("totalacceleration", 6), pushed("gyroscopeuncalibrated", 8)]
    assert source.take_push(json.dumps({"payload": entries}).encode()) == 3
    assert not source.trouble
    found = collected(source, 4)
    assert [arrival.stream for arrival in found] == ["accelerometer", "accelerometer", "gyroscope", "gyroscope"]
    assert found[1].line == b"6,1.0,2.0,3.0"


@pytest.mark.parametrize(
    "body", [b"", b"[]", b'{"payload": 3}', b'{"payload": [{"name": 1}]}', b"\xff", b'{"payload": [null]}']
)
def test_a_push_that_is_none_is_refused(body):
    with pytest.raises(RecordingError, match="Sensor Logger"):
        PushSource().take_push(body)


@pytest.mark.parametrize(
    "text", ["", "serial", "serial:", "usb:3", "replay:x@fast", "udp:x", "udp:99999", "phyphox:a/b"]
)
def test_what_is_no_source_is_refused(text):
    with pytest.raises(OptionError):
        open_source(text)


def test_a_missing_file_is_waited_for(tmp_path):
    source = open_source(f"tail:{Path(tmp_path) / 'none'}")
    assert collected(source, 1, 0.2) == []
    assert "not there" in source.trouble


def test_a_magnetometer_of_its_own_rate_is_recorded_so_that_it_is_read_again(tmp_path):
    recording, _ = gnomon.simulate_magnetometer(gnomon.FieldScenario(), 1)
    save_recording(recording, tmp_path / "first.npz")
    source = open_source(f"replay:{tmp_path / 'first.npz'}@100000")
    session = LiveSession(source, tmp_path / "rec", USES["ahrs"], coach=MagnetometerCoach)
    session.begin_recording()
    wait_for(lambda: bool(source.trouble))
    session.end_recording()
    again, first = gnomon.read(tmp_path / "rec").imus["imu0"], recording.imus["imu0"]
    assert np.array_equal(again.magnetometer.values, first.magnetometer.values)
    assert np.array_equal(again.accelerometer.values, first.accelerometer.values)
