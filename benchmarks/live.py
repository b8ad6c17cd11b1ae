"""Guided capture, measured without hardware: a simulated hand, a pseudo-terminal, planted faults, kills.

    python benchmarks/live.py hand --seeds 100 200      rests that guidance needs, and whether the result holds;
                                                        it goes on where it was stopped, with `--keep FILE`
    python benchmarks/live.py serial --seconds 600      a pseudo-terminal at 1 kHz
    python benchmarks/live.py faults                    planted faults and healthy captures
    python benchmarks/live.py setup                     what is wrong with camera and IMU together, named early
    python benchmarks/live.py kill                      kill -9 at random moments
    python benchmarks/live.py coach                     CPU time and memory of a long capture
    python benchmarks/live.py rig --seconds 60          a camera at 30 Hz with an IMU at 200 Hz
    python benchmarks/live.py page --seconds 60         from a sample's arrival to the page
    python benchmarks/live.py memory                    24 h of samples, as fast as they are taken
    python benchmarks/live.py memory --of imu --hours 4     and of a guided capture at 200 Hz, or --of rig

The hand turns the sensor to where it is asked to with 10 degrees of noise, pays no attention one time in five, and
takes about 4 s a step. Unguided, it takes attitudes at random, and is told by the same rule when it is enough; the
tutorial asks for 36 to 50.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from itertools import islice, product
from pathlib import Path
from urllib.request import urlopen

import numpy as np
from live_cameras import GREY, STATISTICS, views_of

import gnomon
from gnomon.assess.needs import needs_of_use
from gnomon.live.coach import NoiseCoach
from gnomon.live.hand import SimulatedHand, imu_sentence
from gnomon.live.image_sources import ImageArrival, ImageSource
from gnomon.live.prospect import look_ahead
from gnomon.live.rig_session import MotionCoach, RigCoach, RigSession
from gnomon.live.session import LOOK_S, LiveSession
from gnomon.live.sources import LiveSource, open_source
from gnomon.live.trials import check_setup
from gnomon.options.requirements import USES
from gnomon.results.calibration import calibration_parameters
from gnomon.simulate import CameraImuScenario, Scenario, simulate_camera_imu
from gnomon.simulate.images.board_images import simulated_images

TUTORIAL = 36
LONGEST_S = 400.0
TRIAL_S = 0.5  # until the look after a check, which takes 0.1 s in a process that has begun
UPRIGHT = np.array([0, 0, 9.81, 0, 0, 0])


class Silent(LiveSource):
    """Sends nothing by itself."""

    def arriving_lines(self, stop):
        yield from ()


def guided(folder, seed, use, *, obeys):
    """Return the hand, the state at the end of a capture, and what is foreseen from it without any calibration."""
    hand, session = SimulatedHand(seed), LiveSession(Silent(), folder, USES[use])
    every = round(hand.rate_hz / 2)
    for k, line in enumerate(hand.sample_lines(), 1):
        session.take_line(line)
        if k % every == 0:
            state = session.look_at_arrivals()
            hand.target = state.prospect.target if obeys else None
            if state.confirmed or state.seconds > LONGEST_S:
                break
    session.end_recording()
    return hand, state, look_ahead(session.coach.samples, USES[use])


def captured(seed, use, *, random):
    """Return the figures of one capture that is guided, and of one in attitudes at random where that is asked for."""
    with tempfile.TemporaryDirectory() as place:
        alone = guided(Path(place) / "u", seed, use, obeys=False)[1] if random else None
        hand, state, ahead = guided(Path(place) / "g", seed, use, obeys=True)
        calibration = gnomon.calibrate_imu(gnomon.read(Path(place) / "g")).calibration
    reached = {need.block: need.sigma for need in needs_of_use(calibration, USES[use])}
    pairs = zip(calibration_parameters(calibration.imus), calibration_parameters({"imu0": hand.truth}), strict=True)
    errors = np.concatenate([(found - true).ravel() for (_, found), (_, true) in pairs])
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    return {
        "use": use,
        "seed": seed,
        "rests": len(state.prospect.up),
        "alone": None if alone is None else len(alone.prospect.up),
        "seconds": state.seconds,
        "confirmed": state.confirmed,
        "verdict": gnomon.judge(calibration, use).verdict,
        "worst": float(np.max(np.abs(errors[sigma > 0]) / sigma[sigma > 0])),
        "shown": {one.block: one.sigma / reached[one.block] for one in state.prospect.needs if one.block in reached},
        "foreseen": {one.block: one.sigma / reached[one.block] for one in ahead.needs if one.block in reached},
    }


def study_hand(first, last, kept, *, random):
    """Add the captures of some seeds to those that a file keeps already, and tell all that are there."""
    kept.touch()
    rows = [json.loads(line) for line in kept.read_text().splitlines()]
    there = {(row["seed"], row["use"]) for row in rows}
    with kept.open("a") as file:
        every = product(range(first, last), ("ahrs", "vio"))
        for seed, use in sorted(every, key=lambda one: ((one[0] + (one[1] == "vio")) % 2, one)):  # each seed once first
            if (seed, use) not in there:
                rows.append(captured(seed, use, random=random))
                file.write(json.dumps(rows[-1]) + "\n")
                file.flush()
    for use in ("ahrs", "vio"):
        own = [row for row in rows if row["use"] == use]
        rests, worst = [row["rests"] for row in own], [row["worst"] for row in own]
        alone = [row["alone"] for row in own if row["alone"] is not None]
        ratios = [ratio for row in own for ratio in row["foreseen"].values()]
        shown = [ratio for row in own for ratio in row["shown"].values()]
        least, low, high, most = np.quantile(ratios, [0.0, 0.05, 0.95, 1.0])
        print(
            f"{use}: {len(own)} seeds; rests guided {np.median(rests):.0f} ({min(rests)} to {max(rests)}), "
            + (f"at random {np.median(alone):.0f} ({min(alone)} to {max(alone)}), " if alone else "")
            + f"tutorial {TUTORIAL}; {np.median([row['seconds'] for row in own]):.0f} s; "
            f"verdicts {dict(Counter(row['verdict'] for row in own))}, "
            f"never confirmed {sum(not row['confirmed'] for row in own)}; largest error of 30 parameters "
            f"{np.median(worst):.2f} sigma (median), {max(worst):.2f} (most), beyond 4: {sum(w > 4 for w in worst)}; "
            f"shown at the end over final sigma {min(shown):.2f} to {max(shown):.2f}, "
            f"foreseen without a trial {low:.2f} to {high:.2f} (90 %), {least:.2f} to {most:.2f} (all)",
            flush=True,
        )


def study_serial(seconds, rate_hz=1000):
    """Send a sentence each millisecond through a pseudo-terminal, pulled out and put back half-way."""
    import tty

    place = Path(tempfile.mkdtemp())
    link = place / "port"

    def plugged():
        master, slave = os.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        return master, slave

    master, slave = plugged()
    session = LiveSession(open_source(f"serial:{link}@2000000"), place / "rec", USES["ahrs"])
    session.begin_recording()
    ended, looked = threading.Event(), []

    def look():
        while not ended.wait(0.5):
            before = time.thread_time()
            session.look_at_arrivals()
            looked.append((time.thread_time() - before, [fault.code for fault in session.troubles()]))

    watcher = threading.Thread(target=look)
    watcher.start()
    time.sleep(0.3)
    os.write(master, b"rest of a line\n")
    rng, sent, began = np.random.default_rng(0), 0, time.monotonic()
    first_us = (1 << 32) - int(seconds * 0.3e6)  # micros() begins again on the way
    plugs = 0
    while (now := time.monotonic() - began) < seconds:
        if now > seconds / 2 and not plugs:
            plugs = 1
            time.sleep(0.3)
            os.close(master)
            os.close(slave)
            time.sleep(1.5)
            master, slave = plugged()
            time.sleep(1.5)
            os.write(master, b"rest of a line\n")
            began += 3.3
            continue
        due = int(now * rate_hz) - sent
        lines = [
            imu_sentence((first_us + 1000 * (sent + k)) % (1 << 32), tuple(rng.normal(0, 0.01, 6) + UPRIGHT))
            for k in range(due)
        ]
        if sent % 20_000 < due:
            os.write(master, b"noise\xff\x00\x80 of a plug\n$IMUSI,12,0.1,0.\n")
        for k in range(0, len(lines), 25):
            os.write(master, b"".join(line + b"\n" for line in lines[k : k + 25]))
        sent += due
        time.sleep(0.002)
    time.sleep(1.0)
    ended.set()
    watcher.join()
    session.end_recording()
    os.close(master)
    os.close(slave)
    samples = gnomon.read(place / "rec").imus["imu0"].accelerometer
    told = Counter(code for _, codes in looked for code in codes)
    print(
        f"serial: {sent} sent in {seconds:.0f} s, {len(samples)} read from the folder, {sent - len(samples)} lost; "
        f"{session.recorder.damaged} damaged lines kept apart; told: {dict(told)}; stamps rise: "
        f"{bool((np.diff(samples.t_ns) > 0).all())} over {samples.duration_s:.1f} s; coach "
        f"{sum(cpu for cpu, _ in looked) / seconds:.3f} of a core, slowest look {max(cpu for cpu, _ in looked):.2f} s"
    )


def with_fault(name, hand, rng, from_s):
    """Yield lines of a capture that goes wrong at `from_s`."""
    before = (0.0,) * 6
    for k, line in enumerate(hand.sample_lines()):
        t, *v = (float(x) for x in line.split(b"*")[0].split(b",")[1:8])
        if k >= from_s * hand.rate_hz:
            if name == "dropped" and k % 40 < 8:
                continue
            if name == "throttled" and k % 8:
                continue
            if name == "saturated":
                v[3] = float(np.clip(9.0 * np.sin(k / 40), -4.36, 4.36))
            if name == "no-gravity":
                v[:3] = rng.normal(0, 0.02, 3)
            if name == "rounded":
                v[:3] = [round(x, 1) for x in v[:3]]
            if name == "silent":
                v[3:] = [0.0] * 3
            if name == "repeated" and k % 2:
                v = before
            if name == "too-fast":
                v[4] = 30.0 * np.sin(k / 25)
            if name == "shaking":
                v[:3] = [x + 0.1 * np.sin(k / 5 + j) for j, x in enumerate(v[:3])]
            if name == "clock-back":
                t -= 3e6
            if name == "damaged" and k % 2:
                yield b"\x80\x01\xff\x00garbage"
                continue
        before = v
        yield imu_sentence(int(t) % (1 << 32), tuple(v))


def codes_of(session, state):
    return {fault.code for fault in (*session.troubles(), *state.faults)} | ({state.phase} & {"shaking"})


KILL_SPEED = 40  # times as fast as it was recorded
RATE_HZ = 100.0  # of `gnomon simulate imu`
FAULTS = (
    "dropped", "throttled", "saturated", "no-gravity", "rounded", "silent", "repeated", "too-fast", "shaking",
    "clock-back", "damaged",
)  # fmt: skip


def study_faults(first=0, seeds=10, healthy=20):
    for name in FAULTS:
        delays = []
        for seed in range(first, first + seeds):
            rng = np.random.default_rng(seed)
            from_s = float(rng.uniform(3, 12))
            hand = SimulatedHand(seed)
            with tempfile.TemporaryDirectory() as place:
                session = LiveSession(Silent(), Path(place) / "rec", USES["ahrs"])
                found = None
                lines = with_fault(name, hand, rng, from_s)
                for k, line in enumerate(islice(lines, round((from_s + 6) * hand.rate_hz)), 1):
                    session.take_line(line)
                    step = 12 if name == "throttled" and k > from_s * hand.rate_hz else 100
                    if k % step == 0 and name in codes_of(session, session.look_at_arrivals()):
                        found = session.coach.state.seconds - from_s
                        break
                session.end_recording()
            delays.append(np.inf if found is None else max(found, 0.0))
        print(f"fault {name}: named in {sum(d <= 3 for d in delays)} of {seeds} within 3 s, latest {max(delays):.1f} s")
    told = Counter()
    for seed in range(first, first + healthy):
        hand = SimulatedHand(1000 + seed, Scenario(rate_hz=100.0 if seed % 2 else 200.0))
        with tempfile.TemporaryDirectory() as place:
            session = LiveSession(Silent(), Path(place) / "rec", USES["ahrs"])
            every = round(hand.rate_hz / 2)
            for k, line in enumerate(islice(hand.sample_lines(), round(60 * hand.rate_hz)), 1):
                session.take_line(line)
                if k % every == 0:
                    state = session.look_at_arrivals()
                    hand.target = state.prospect.target
                    told.update(codes_of(session, state))
            session.end_recording()
    print(f"healthy: {healthy} captures of 60 s, false: {dict(told)}")


SWAP = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
SETUPS = {
    "healthy": lambda imu: imu,
    "IMU's clock starts 1000 s earlier, which is no fault": lambda imu: both(imu, lambda t: t - 10**12),
    "IMU's clock fast by 1 %": lambda imu: both(imu, lambda t: t[0] + ((t - t[0]) * 1.01).astype(np.int64)),
    "accelerometer's x and y exchanged": lambda imu: replace(imu, accelerometer=by(imu.accelerometer, SWAP)),
    "gyroscope's x and y exchanged": lambda imu: replace(imu, gyroscope=by(imu.gyroscope, SWAP)),
    "gyroscope's z reversed": lambda imu: replace(imu, gyroscope=by(imu.gyroscope, np.diag([1, 1, -1]))),
    "accelerometer and gyroscope exchanged": lambda imu: replace(
        imu,
        accelerometer=replace(imu.accelerometer, values=imu.gyroscope.values),
        gyroscope=replace(imu.gyroscope, values=imu.accelerometer.values),
    ),
    "gyroscope in deg/s": lambda imu: replace(imu, gyroscope=by(imu.gyroscope, 57.3 * np.eye(3))),
    "accelerometer 60 ms late": lambda imu: replace(
        imu, accelerometer=replace(imu.accelerometer, t_ns=imu.accelerometer.t_ns + 60_000_000)
    ),
}


def both(imu, clock):
    triads = {name: getattr(imu, name) for name in ("accelerometer", "gyroscope")}
    return replace(imu, **{name: replace(triad, t_ns=clock(triad.t_ns)) for name, triad in triads.items()})


def by(triad, matrix):
    return replace(triad, values=triad.values @ np.array(matrix, float).T)


def beginning(recording, seconds):
    """Return what was recorded until then, by the camera's clock."""
    frames, imu = recording.cameras["cam0"], recording.imus["imu0"]
    count = int(np.searchsorted(frames.t_ns, frames.t_ns[0] + int(seconds * 1e9)))
    seen, share = frames.frame < count, count / len(frames.t_ns)
    rows = {name: getattr(frames, name)[seen] for name in ("frame", "point", "pixels")}
    triads = {name: getattr(imu, name) for name in ("accelerometer", "gyroscope")}
    firsts = {
        name: replace(one, t_ns=one.t_ns[: int(share * len(one))], values=one.values[: int(share * len(one))])
        for name, one in triads.items()
    }
    cameras = {"cam0": replace(frames, t_ns=frames.t_ns[:count], **rows)}
    return replace(recording, cameras=cameras, imus={"imu0": replace(imu, **firsts)})


def checked(recording, target, until_s):
    """Yield when the outcome of each early check is there [s], and what it says, as in a guided capture."""
    motion, shown = MotionCoach(USES["vio"]), 0
    coach, sent = (
        RigCoach(target, recording.cameras["cam0"].camera, motion),
        dict.fromkeys(("accelerometer", "gyroscope"), 0),
    )
    ready_s = 0.0
    for seconds in np.arange(LOOK_S, until_s, LOOK_S):
        so_far = beginning(recording, seconds)
        views = views_of(so_far.cameras["cam0"], shown)
        shown += len(views)
        new = {}
        for name, first in sent.items():
            all_of = getattr(so_far.imus["imu0"], name)
            new[name] = replace(all_of, t_ns=all_of.t_ns[first:], values=all_of.values[first:])
            sent[name] = len(all_of)
        motion.add_samples(new, {name: one.unit for name, one in new.items()})
        motion.look_at_samples()
        for t_ns, view in views[:-1]:
            coach.keep_view(t_ns, view, STATISTICS.size)
        coach.look_at_image(views[-1][0], GREY, views[-1][1], STATISTICS, seconds=seconds, rate_hz=20.0)
        if seconds >= ready_s and coach.wants_trial:
            ready_s = seconds + TRIAL_S
            yield ready_s, check_setup(replace(coach.recording_so_far(), imus=so_far.imus), target)


def study_setup(first, only="", seeds=10, healthy=20, until_s=12.0):
    """Look at the beginnings of captures, of which half have 30 and half 15 frames a second."""
    moments = (3, 4, 6, 8, int(until_s))
    for name, planted in SETUPS.items():
        if only not in name:
            continue
        found, codes = [], Counter()
        for seed in range(first, first + (healthy if name == "healthy" else seeds)):
            scenario = CameraImuScenario(duration_s=until_s + 1, camera_rate_hz=30.0 if seed % 2 else 15.0)
            simulation = simulate_camera_imu(scenario, seed)
            imu = planted(simulation.recording.imus["imu0"])
            recording = replace(simulation.recording, imus={"imu0": imu})
            told = list(checked(recording, simulation.target, until_s))
            found.append(next((at for at, faults in told if faults), np.inf))
            codes.update({fault.code for _, faults in told for fault in faults})
        shares = ", ".join(f"{sum(at <= moment for at in found)} by {moment} s" for moment in moments)
        print(f"{name}: of {len(found)} named {shares}, the last after {max(found)} s; {dict(codes)}", flush=True)


def study_kill(first=0, times=50):
    """Kill a capture of a recording at any moment of it, and calibrate what it left."""
    rng, lost, fewest, outcomes = np.random.default_rng(first), -np.inf, np.inf, Counter()
    program = (
        "import sys,time\nfrom pathlib import Path\nfrom gnomon.live.session import LiveSession\n"
        "from gnomon.live.sources import open_source\nfrom gnomon.options.requirements import USES\n"
        "s=LiveSession(open_source(sys.argv[2]),Path(sys.argv[1]),USES['ahrs'])\ns.begin_recording()\n"
        "while True:\n s.look_at_arrivals(); print(s.recorder.written, flush=True); time.sleep(0.1)\n"
    )
    with tempfile.TemporaryDirectory() as place:
        simulated = f"{place}/whole.npz"
        subprocess.run(
            [sys.executable, "-m", "gnomon", "simulate", "imu", "-o", simulated], check=True, capture_output=True
        )
        whole_s = gnomon.read(simulated).imus["imu0"].accelerometer.duration_s
        for k in range(times):
            folder = Path(place) / f"rec{k}"
            words = [sys.executable, "-c", program, str(folder), f"replay:{simulated}@{KILL_SPEED}"]
            process = subprocess.Popen(words, stdout=subprocess.PIPE)
            while not int(process.stdout.readline()):
                pass  # until there are samples
            time.sleep(rng.uniform(0.1, 1.0) * whole_s / KILL_SPEED)
            process.send_signal(signal.SIGKILL)
            told = [int(line) for line in process.stdout.read().split()]
            process.wait()
            kept = (folder / "samples.log").read_bytes().count(b"\n")
            lost, fewest = max(lost, told[-1] - kept), min(fewest, kept)
            try:
                result = gnomon.calibrate_imu(gnomon.read(folder))
            except gnomon.GnomonError as error:
                part = "more" if kept > whole_s * RATE_HZ / 2 else "less"
                outcomes[f"{type(error).__name__} of {part} than half"] += 1
            else:
                outcomes[f"calibrated: {result.calibration.verdict}"] += 1
    print(f"kill: {times} times; lines lost of those told: {lost} at most; fewest lines {fewest}; {dict(outcomes)}")


def study_coach(minutes):
    hand = SimulatedHand(1)
    with tempfile.TemporaryDirectory() as place:
        session = LiveSession(Silent(), Path(place) / "rec", USES["vio"])
        cpu, slowest, seconds = 0.0, 0.0, 60 * minutes
        for k, line in enumerate(islice(hand.sample_lines(), round(seconds * hand.rate_hz)), 1):
            session.take_line(line)
            if k % 100 == 0:
                before = time.process_time()
                hand.target = session.look_at_arrivals().prospect.target
                took = time.process_time() - before
                cpu, slowest = cpu + took, max(slowest, took)
            if k % round(60 * hand.rate_hz) == 0 and k // round(60 * hand.rate_hz) in (2, 5, 10, 20, 30):
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                share = cpu / (k / hand.rate_hz)
                print(f"coach: {k / hand.rate_hz / 60:.0f} min at 200 Hz: {share:.3f} of a core, slowest look "
                      f"{slowest:.2f} s, {peak:.0f} MB", flush=True)  # fmt: skip
        session.end_recording()


def study_page(seconds):
    """Run the command with a page, and hold the moment a browser is sent a sample against that of its arrival."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "rec"
        words = [sys.executable, "-m", "gnomon", "live", "imu", "simulate:1", "--no-report", "-o", str(folder)]
        quiet = {**os.environ, "BROWSER": "true"}
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=quiet, text=True)
        address = process.stdout.readline().split()[1]
        came = {}
        with urlopen(address.replace("/?", "/events?")) as events:
            end = time.monotonic() + seconds
            for line in events:
                if line.startswith(b"data: [["):
                    now_ns = time.time_ns()
                    came.update({round(1e4 * row[0]): now_ns for row in json.loads(line[6:])})
                if time.monotonic() > end:
                    break
        process.kill()
        process.wait()
        late_ms = []
        for line in (folder / "samples.log").read_text().splitlines():
            stamp, _, said = line.partition(" -> ")
            there = came.get(round(int(said.split(",")[1]) / 100)) if said.startswith("$IMUSI") else None
            if there is not None:
                arrived = datetime.fromisoformat(stamp).replace(tzinfo=UTC).timestamp()
                late_ms.append(1e-6 * there - 1e3 * arrived)
    median, p95, most = np.quantile(late_ms, [0.5, 0.95, 1.0])
    print(f"page: {len(late_ms)} samples in {seconds:.0f} s; sent {median:.0f} ms after their arrival (median), "
          f"{p95:.0f} (p95), {most:.0f} (most)")  # fmt: skip


def resident_mb(process="self"):
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def lines_of_noise(seconds, rate_hz):
    """Yield the lines of a sensor that is left alone."""
    rng = np.random.default_rng(1)
    rows = [",".join(f"{value:.6f}" for value in rng.normal(UPRIGHT, 0.01)).encode() for _ in range(6000)]
    yield b"t_us,ax,ay,az,gx,gy,gz"
    for k in range(1, 1 + seconds * rate_hz):
        yield b"%d,%s" % (k * 1_000_000 // rate_hz, rows[k % len(rows)])


def study_memory(hours=24, rate_hz=20):
    """Take a day of lines of a sensor that is left alone, and look every 2 s of it."""
    with tempfile.TemporaryDirectory() as place:
        session = LiveSession(Silent(), Path(place) / "rec", USES["ahrs"], coach=NoiseCoach)
        for k, line in enumerate(lines_of_noise(hours * 3600, rate_hz)):
            session.take_line(line)
            if k and k % (2 * rate_hz) == 0:
                state = session.look_at_arrivals()
            if k and (k % (6 * 3600 * rate_hz) == 0 or k == 3600 * rate_hz):
                print(f"memory: {state.seconds / 3600:.0f} h at {rate_hz} Hz: {resident_mb():.0f} MB", flush=True)
        session.end_recording()


def study_memory_imu(hours):
    """Take hours of lines at 200 Hz: a guided capture, and then one turn a minute; look every 0.5 s of it."""
    with tempfile.TemporaryDirectory() as place:
        hand, session = SimulatedHand(1), LiveSession(Silent(), Path(place) / "rec", USES["vio"])
        every, looks_s = round(LOOK_S * hand.rate_hz), 0.0
        for k, line in enumerate(islice(hand.sample_lines(), round(hours * 3600 * hand.rate_hz)), 1):
            session.take_line(line)
            if k % every == 0:
                before_s = time.process_time()
                state = session.look_at_arrivals()
                looks_s += time.process_time() - before_s
                hand.target, hand.hold_s = state.prospect.target, 60.0 if state.confirmed else hand.hold_s
            if k % round(900 * hand.rate_hz) == 0:
                share = looks_s / state.seconds
                print(f"memory: imu, {state.seconds / 3600:.2f} h at 200 Hz, {len(state.prospect.up)} rests: "
                      f"{resident_mb():.0f} MB, {share:.3f} of a core", flush=True)  # fmt: skip
        session.end_recording()


def study_memory_rig(hours, camera_rate_hz=5):
    """Take images and lines of a rig as fast as they are looked at; images are deleted once they are written."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=8.0, camera_rate_hz=float(camera_rate_hz)), 1)
    images = [frame.decode() for frame in simulated_images(simulation).streams["cam0"].frames([])]
    hand, target = SimulatedHand(1), simulation.target
    lines = hand.sample_lines()
    with tempfile.TemporaryDirectory() as place:
        lenses, use = {"cam0": simulation.recording.cameras["cam0"].camera}, USES["vio"]
        source = PacedImages(images, 10**18)
        session = RigSession(source, Silent(), Path(place) / "rec", target, lenses=lenses, use=use)
        for k in range(round(hours * 3600 * camera_rate_hz)):
            session.take_image(
                ImageArrival(10**18 + k * 10**9 // camera_rate_hz, source.images[k % len(source.images)])
            )
            for line in islice(lines, round(hand.rate_hz / camera_rate_hz)):
                session.samples.take_line(line)
            if k % 3 == 2:
                session.look_at_arrivals()
                session.document()
            if k % (camera_rate_hz * 600) == camera_rate_hz * 600 - 1:
                for written in sorted((Path(place) / "rec").rglob("*.png"))[:-600]:
                    written.unlink()
                trials_mb = resident_mb(session._trials._process.pid) if session._trials else 0.0
                print(f"memory: rig, {(k + 1) / camera_rate_hz / 60:.0f} min, {session.images.written} images, "
                      f"{session.samples.recorder.written} samples: {resident_mb():.0f} MB, and {trials_mb:.0f} MB of "
                      "what checks it", flush=True)  # fmt: skip
        session.end_recording()


class PacedImages(ImageSource):
    """Images that were rendered before, in the order of time and back again, at 30 Hz whatever becomes of them."""

    def __init__(self, images, begin_ns, rate_hz=30.0):
        super().__init__()
        self.images, self.begin_ns, self.rate_hz, self.late_s = [*images, *images[::-1]], begin_ns, rate_hz, []
        self.taken = 0

    def arriving_images(self, stop):
        began_s = time.monotonic()
        while not stop.is_set():
            due_s = self.taken / self.rate_hz
            ahead_s = due_s - (time.monotonic() - began_s)
            if ahead_s > 0:
                stop.wait(ahead_s)
            self.late_s.append(time.monotonic() - began_s - due_s)
            yield ImageArrival(self.begin_ns + round(due_s * 1e9), self.images[self.taken % len(self.images)])
            self.taken += 1


def study_rig(seconds):
    """Record a camera at 30 Hz and an IMU at 200 Hz, both in real time, and look at them as the command does."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=4.0, camera_rate_hz=30.0), 1)
    frames = simulated_images(simulation).streams["cam0"].frames([])
    images = [frame.decode() for frame in frames]
    source, hand = PacedImages(images, 10**18), open_source("simulate:1")
    with tempfile.TemporaryDirectory() as place:
        lenses, use = {"cam0": simulation.recording.cameras["cam0"].camera}, USES["vio"]
        session = RigSession(source, hand, Path(place) / "rec", simulation.target, lenses=lenses, use=use)
        cpu_s, looks = time.process_time(), []
        session.begin_recording()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.5)
            began_s = time.monotonic()
            session.look_at_arrivals()
            session.document()
            session.picture()
            looks.append(time.monotonic() - began_s)
        session.end_recording()
        cpu_s = time.process_time() - cpu_s
        there = len(list((Path(place) / "rec/cam0").glob("*.png")))
    late_ms = 1e3 * np.quantile(source.late_s, [0.5, 0.95, 1.0])
    print(
        f"{len(source.late_s)} frames due, {session.images.written} taken, {there} in the folder; "
        f"{session.samples.recorder.written} samples, {session.samples.recorder.damaged} damaged"
    )
    print(f"a frame is taken {late_ms[0]:.0f} ms late (median), {late_ms[1]:.0f} (p95), {late_ms[2]:.0f} (most)")
    print(
        f"a look takes {1e3 * np.median(looks):.0f} ms (median), {1e3 * max(looks):.0f} (most); "
        f"{cpu_s / seconds:.2f} of a core, and {resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime / seconds:.2f} "
        f"in processes; {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hand", "serial", "faults", "setup", "kill", "coach", "rig", "page", "memory"))
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 200), metavar=("FIRST", "LAST"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--only", default="", help="part of the name of a setup")
    parser.add_argument("--hours", type=int, default=24, help="of memory")
    parser.add_argument("--of", choices=("noise", "imu", "rig"), default="noise", help="whose memory")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "live-hand.jsonl", metavar="FILE")
    parser.add_argument("--random", action="store_true", help="attitudes at random, too")
    given = parser.parse_args()
    if given.what == "hand":
        study_hand(*given.seeds, given.keep, random=given.random)
    elif given.what == "serial":
        study_serial(given.seconds)
    elif given.what == "faults":
        study_faults(given.seeds[0])
    elif given.what == "setup":
        study_setup(given.seeds[0], given.only)
    elif given.what == "kill":
        study_kill(given.seeds[0])
    elif given.what == "rig":
        study_rig(given.seconds)
    elif given.what == "page":
        study_page(given.seconds)
    elif given.what == "memory":
        {"noise": study_memory, "imu": study_memory_imu, "rig": study_memory_rig}[given.of](given.hours)
    else:
        study_coach(given.minutes)


if __name__ == "__main__":
    main()
