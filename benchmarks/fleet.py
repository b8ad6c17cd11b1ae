"""Many devices: how fast `gnomon batch` is, what survives kill -9, how fast a large library answers.

python benchmarks/fleet.py devices 1000 --jobs 2     # calibrate so many simulated devices
python benchmarks/fleet.py kill 50                   # end `batch` at random moments, and look what is there
python benchmarks/fleet.py dask 60                   # one worker, two workers, two of which one is killed
python benchmarks/fleet.py library 100000            # history, chart and report of a library
python benchmarks/fleet.py serve 50                  # so many clients at once; --library FILE, else one of 10 000
python benchmarks/fleet.py faults 5                  # the faults of tests/unit/fleet/test_line.py on so many seeds
"""

import argparse
import asyncio
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote, urlsplit

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "unit" / "fleet")]
GNOMON = [sys.executable, "-m", "gnomon"]
ENVIRONMENT = os.environ | {"OPENBLAS_NUM_THREADS": "1"}


def simulated_line(folder, count):
    """Write recordings of 80 s at 100 Hz: 20 rests of 2 s with turns between them."""
    from gnomon.simulate import Scenario, simulate
    from gnomon.writers.recording_file import save_recording

    folder.mkdir()
    scenario = Scenario(intervals=20, t_init_s=6.0, hold_s=(2.0, 2.0), motion_s=(1.0, 1.5))
    for k in range(count):
        save_recording(simulate(scenario, seed=k)[0], folder / f"SN{k:05d}_2026-11-{1 + k % 28:02d}.npz")


def batch(line, output, *options, **more):
    command = [*GNOMON, "batch", str(line), "--kind", "imu", "--for", "ahrs", "-o", str(output), *options]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **more)


def timed_batch(line, output, *options):
    start, before = time.monotonic(), os.times()
    process = batch(line, output, *options)
    process.communicate()
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - start, cpu, calibrations(output)


def calibrations(output):
    """Check the library of a batch, and return how many calibrations it has."""
    place = output / "library.db"
    if not place.exists():
        return 0
    with sqlite3.connect(place) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        if "runs" not in tables:
            return 0
        rows = connection.execute("SELECT serial, folder FROM calibrations").fetchall()
        (runs,) = connection.execute("SELECT count(*) FROM runs").fetchone()
    assert len(rows) == len(set(rows)) == runs, "a calibration without its run, or one twice"
    assert all((Path(folder) / "calibration.yaml").is_file() for _, folder in rows), "a result is lost"
    return len(rows)


def devices(scratch, count, jobs):
    simulated_line(scratch / "line", count)
    wall, cpu, done = timed_batch(scratch / "line", scratch / "out", "--jobs", str(jobs))
    print(f"{done} devices, {jobs} jobs: {wall:.1f} s of wall time, {cpu:.1f} s of CPU, {cpu / count:.3f} s a device")


def kill(scratch, count):
    simulated_line(scratch / "line", 40)
    chance, output, kept = random.Random(1), scratch / "out0", 0
    for number in range(count):
        process = batch(scratch / "line", output, text=True)
        time.sleep(chance.uniform(0.3, 4.0))
        process.kill()
        told = [line for line in process.communicate()[1].splitlines() if "calibrating devices: " in line]
        reported = max((int(line.split(": ")[1].split(" ")[0]) for line in told), default=0)
        done = calibrations(output)
        assert done >= max(reported, kept), f"{reported} were reported and {kept} there, {done} are in the library"
        kept = done
        if done == 40:
            output, kept = scratch / f"out{number + 1}", 0
    wall, _, done = timed_batch(scratch / "line", output)
    assert done == 40
    print(f"{count} kills: nothing lost, nothing twice; the rest of the last batch took {wall:.1f} s")


def dask(scratch, count):
    simulated_line(scratch / "line", count)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"

    def started(kind, *words):
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
        return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def worker():
        return started("worker", address, "--no-nanny", "--nthreads", "1")

    running = [started("scheduler", "--host", "127.0.0.1", "--port", str(port)), worker()]
    try:
        time.sleep(8)
        one, _, done = timed_batch(scratch / "line", scratch / "one", "--scheduler", address)
        running.append(worker())
        time.sleep(8)
        two, _, again = timed_batch(scratch / "line", scratch / "two", "--scheduler", address)
        print(f"one worker {one:.1f} s, two {two:.1f} s: {one / two:.2f} times; {done} and {again} of {count}")
        process = batch(scratch / "line", scratch / "three", "--scheduler", address)
        time.sleep(two / 2)
        running[-1].kill()
        process.communicate()
        print(f"one of two workers killed: {calibrations(scratch / 'three')} of {count}, none twice")
    finally:
        for process in running:
            process.kill()


def library(scratch, count, place):
    from fleet_line import healthy_line
    from gnomon.fleet.library import Library

    if place is None:
        place = scratch / "line.db"
        entries = healthy_line(count - count // 6, 5, again=count // 6, stations=("A", "B", "C"))
        start = time.process_time()
        with Library(str(place), create=True) as opened:
            opened.add(*entries)
        size, cpu = place.stat().st_size / 1e6, time.process_time() - start
        print(f"{count} calibrations of 12 scalars: {size:.0f} MB, added in {cpu:.0f} s of CPU")
    for words in (["history", "SN00042"], ["chart", "imu0.gyroscope.bias[0]"], ["report", str(scratch / "line.html")]):
        start, before = time.monotonic(), os.times()
        command = [*GNOMON, "library", *words, "--library", str(place)]
        subprocess.run(command, env=ENVIRONMENT, capture_output=True, check=True)
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        print(f"{words[0]}: {time.monotonic() - start:.2f} s of wall time, {cpu:.2f} s of CPU")
    print(f"report: {(scratch / 'line.html').stat().st_size / 1e6:.2f} MB")


def serve(scratch, clients, place):
    """Ask for pages, each client as fast as it is answered, then once a second, then from a new library."""
    from fleet_line import NAMES, healthy_line
    from gnomon.fleet.library import Library

    if place is None:
        place = scratch / "line.db"
        with Library(str(place), create=True) as opened:
            opened.add(*healthy_line(9000, 5, again=1000))
    process = subprocess.Popen(
        [*GNOMON, "library", "serve", "--library", str(place)], env=ENVIRONMENT, stdout=subprocess.PIPE, text=True
    )
    try:
        address = urlsplit(process.stdout.readline().split()[-1])
        pages = ["/", "/?page=7", "/?serial=42", "/chart", *(f"/chart?name={quote(name)}" for name in NAMES)]
        for pause_s, each in ((1.0, 10), (0.0, 20)):
            waits = asyncio.run(ask_for_pages(address, pages, clients, each, pause_s))
            p50, p95, worst = (1e3 * waits[min(int(q * len(waits)), len(waits) - 1)] for q in (0.5, 0.95, 1))
            pace = "one page a second each" if pause_s else "without a pause"
            print(
                f"{clients} clients, {pace}: {len(waits)} pages, median {p50:.0f} ms, p95 {p95:.0f}, worst {worst:.0f}"
            )
    finally:
        process.terminate()
        process.wait()
        spent = os.times()
        print(f"server: {spent.children_user + spent.children_system:.1f} s of CPU with its start")


async def ask_for_pages(address, pages, clients, each, pause_s):
    """Return the sorted waits [s]; half of the pages are of devices that nobody asked for before."""

    async def client(number):
        chance, waits = random.Random(number), []
        await asyncio.sleep(pause_s * chance.random())
        for _ in range(each):
            device = f"/device?serial=SN{chance.randrange(8000):05d}"
            path = device if chance.random() < 0.5 else chance.choice(pages)
            start = time.monotonic()
            reader, writer = await asyncio.open_connection(address.hostname, address.port)
            token = f"{'&' if '?' in path else '?'}{address.query}"
            writer.write(f"GET {path}{token} HTTP/1.1\r\nHost: {address.netloc}\r\nConnection: close\r\n\r\n".encode())
            answer = await reader.read()
            assert answer.startswith(b"HTTP/1.1 200"), answer[:200]
            waits.append(time.monotonic() - start)
            writer.close()
            await asyncio.sleep(pause_s)
        return waits

    return sorted(wait for waits in await asyncio.gather(*map(client, range(clients))) for wait in waits)


def faults(_scratch, seeds, first):
    from test_line import FAULTS, healthy_line, named

    missed, beside = Counter(), 0
    for seed in range(seeds):
        for number, (fault, (code, words, change)) in enumerate(FAULTS.items()):
            line = healthy_line(200, first + 100 * seed + number, again=40, stations=("A", "B", "C"))
            line = [replace(entry, inputs=()) for entry in line] if fault == "same numbers" else line
            found = named(change(line))
            missed[fault] += not any(name == code and words in message for name, message in found)
            beside += any(name != code for name, _ in found)
    print(f"{seeds * len(FAULTS)} lines with a fault: {sum(missed.values())} not named, {beside} with another beside")
    alarms = sum(len(named(healthy_line(1000, first + 67_000 + seed, again=100))) for seed in range(4 * seeds))
    print(f"{4 * seeds} healthy lines of 1000 devices: {alarms} false alarms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("devices", "kill", "dask", "library", "serve", "faults"))
    parser.add_argument("count", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--library", type=Path)
    parser.add_argument("--first", type=int, default=10_000, help="seed of the lines with faults")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with tempfile.TemporaryDirectory() as folder:
        more = {"devices": (given.jobs,), "serve": (given.library,), "library": (given.library,)}
        more["faults"] = (given.first,)
        globals()[given.what](Path(folder), given.count, *more.get(given.what, ()))
