"""A guided capture, from the lines of a sensor to advice and to a recording that calibrates."""

import os
import signal
import subprocess
import sys
from itertools import islice

import numpy as np
import pytest

import gnomon
from gnomon.assess.needs import needs_of_use
from gnomon.errors import OutputError
from gnomon.live.coach import MagnetometerCoach, NoiseCoach, words_of_attitude
from gnomon.live.hand import SimulatedHand, imu_sentence
from gnomon.live.recorder import Recorder
from gnomon.live.session import LiveSession
from gnomon.live.sources import LiveSource
from gnomon.options.requirements import USES
from gnomon.simulate import Scenario


class Silent(LiveSource):
    """Sends nothing by itself."""

    def arriving_lines(self, stop):
        yield from ()


class Clock:
    """Stands still unless it is moved on: how long a look takes on a busy machine is no silence of the sensor."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


def session_in(folder, use="ahrs", **options):
    return LiveSession(Silent(), folder / "rec", USES[use], clock=Clock(), **options)


def follow(session, hand, seconds, lines=None, until=lambda state: False):
    """Send what a hand does, and look twice a second; return what was said."""
    said = []
    source = lines or hand.sample_lines()
    for k, line in enumerate(islice(source, round(seconds * hand.rate_hz)), 1):
        session._clock.now_s = k / hand.rate_hz
        session.take_line(line)
        if k % round(hand.rate_hz / 2) == 0:
            state = session.look_at_arrivals()
            said.append((state, [fault.code for fault in (*session.troubles(), *state.faults)]))
            hand.target = state.prospect.target
            if until(state):
                break
    return said


@pytest.mark.long
def test_a_hand_that_follows_the_advice_ends_with_a_calibration_that_serves(tmp_path):
    session, hand = session_in(tmp_path, "vio"), SimulatedHand(1)
    said = follow(session, hand, 180, until=lambda state: state.confirmed)
    state = said[-1][0]
    assert state.confirmed
    assert len(state.prospect.up) <= 0.6 * 36, "the tutorial asks for 36 to 50 attitudes"
    session.end_recording()
    result = gnomon.calibrate_imu(gnomon.read(session.recorder.folder))
    reached = needs_of_use(result.calibration, USES["vio"])
    for foreseen, found in zip(state.prospect.needs, reached, strict=True):
        assert found.sigma == pytest.approx(foreseen.sigma, rel=0.2), found.block
    assert all(need.verdict == "pass" for need in reached)
    assert not {code for _, codes in said for code in codes}, "nothing was wrong"


@pytest.mark.long
def test_the_first_bars_are_what_a_calibration_reaches(tmp_path):
    session, hand = session_in(tmp_path, "vio"), SimulatedHand(2)
    state = follow(session, hand, 90, until=lambda state: state.prospect.needs)[-1][0]
    session.end_recording()
    assert 7 <= len(state.prospect.up) <= 8
    recording = gnomon.Recording(imus={"imu0": session.coach.samples})
    reached = needs_of_use(gnomon.calibrate_imu(recording).calibration, USES["vio"])
    assert {need.block: need.sigma for need in state.prospect.needs} == pytest.approx(
        {need.block: need.sigma for need in reached}
    )
    assert not state.confirmed


@pytest.mark.long
def test_what_more_rests_do_not_mend_is_told_and_holds_nobody_up(tmp_path):
    session, hand = session_in(tmp_path), SimulatedHand(4)
    unplugged = (line for k, line in enumerate(hand.sample_lines()) if not 5200 <= k < 5400)
    said = follow(session, hand, 140, unplugged, until=lambda state: state.confirmed)
    session.end_recording()
    state = said[-1][0]
    assert state.confirmed
    assert 12 <= len(state.prospect.up) <= 15
    (stays,) = [fault.text for fault in state.faults if fault.code == "stays"]
    assert "gap" in stays


def test_the_first_rest_is_asked_for_then_another_side(tmp_path):
    session, hand = session_in(tmp_path), SimulatedHand(2)
    said = follow(session, hand, 25)
    phases = [state.phase for state, _ in said]
    assert phases[4] == "first rest"
    assert "turn" in phases
    target = said[-1][0].prospect.target
    assert np.count_nonzero(target) == 1
    assert "lie still" in said[8][0].advice


SECONDS = 6.0


def planted(name, hand):
    """Return lines with a fault from the third second on."""
    rng, before = np.random.default_rng(1), [0.0] * 6

    def numbers(line):
        return [float(x) for x in line.split(b"*")[0].split(b",")[1:8]]

    for k, line in enumerate(islice(hand.sample_lines(), round(SECONDS * hand.rate_hz))):
        t, *v = numbers(line)
        late = k >= 3 * hand.rate_hz
        if name == "dropped" and late and k % 40 < 12:
            continue
        if name == "throttled" and k % 8:
            continue
        if name == "saturated" and late:
            v[3] = float(np.clip(9.0 * np.sin(k / 40), -4.36, 4.36))
        if name == "no-gravity":
            v[:3] = list(rng.normal(0, 0.02, 3))
        if name == "rounded":
            v[:3] = [round(x, 1) for x in v[:3]]
        if name == "silent":
            v[3:] = [0.0] * 3
        if name == "repeated" and k % 2:
            v = before
        if name == "too-fast" and late:
            v[4] = 25.0 + 0.01 * rng.normal()
        if name == "shaking" and late:
            v[:3] = [x + 0.1 * np.sin(k / 5 + j) for j, x in enumerate(v[:3])]
        if name == "clock-back" and late:
            t -= 3e6
        if name == "bursts" and late:
            t -= k % 4 * 4500  # four samples within 2 ms, and none for 18 ms
        if name == "damaged" and late and k % 2:
            yield b"\x80\x01\xff\x00garbage"
            continue
        before = v
        yield imu_sentence(int(t), tuple(v))


@pytest.mark.parametrize(
    "name",
    [
        "dropped", "throttled", "saturated", "no-gravity", "rounded", "silent", "repeated", "too-fast", "clock-back",
        "damaged", "bursts",
    ],
)  # fmt: skip
def test_faults_are_named_within_three_seconds(tmp_path, name):
    session, hand = session_in(tmp_path), SimulatedHand(3)
    said = follow(session, hand, SECONDS, lines=planted(name, hand))
    assert name in {code for _, codes in said for code in codes}


def test_a_rest_that_shakes_is_named(tmp_path):
    session, hand = session_in(tmp_path), SimulatedHand(3)
    said = follow(session, hand, SECONDS, lines=planted("shaking", hand))
    assert "shaking" in {state.phase for state, _ in said}


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_wrong_with_what_is_right(tmp_path, seed):
    session, hand = session_in(tmp_path), SimulatedHand(seed, Scenario(rate_hz=100.0))
    said = follow(session, hand, 40)
    assert not {code for _, codes in said for code in codes}


def test_silence_is_named_and_ends_with_the_next_sample(tmp_path):
    session, hand = session_in(tmp_path), SimulatedHand(5)
    follow(session, hand, 3)
    session._clock.now_s += 1.4
    assert not session.troubles()
    session._clock.now_s += 0.2
    assert [fault.code for fault in session.troubles()] == ["silence"]
    session.take_line(next(iter(hand.sample_lines())))
    assert not session.troubles()


def test_damage_in_a_plain_table_does_not_spoil_the_file(tmp_path):
    session, hand = session_in(tmp_path), SimulatedHand(5)
    session.take_line(b"t [us],ax [m/s^2],ay,az,gx [rad/s],gy,gz")
    for k, line in enumerate(islice(hand.sample_lines(), 1000)):
        row = b",".join(line.split(b"*")[0].split(b",")[1:8])
        session.take_line(row)
        if k % 50 == 49:
            session.look_at_arrivals()
            for bad in (row[:20], b"12,3", row + b",9", b"\xff\x00" + row, b"Brownout detector was triggered"):
                session.take_line(bad)
    session.end_recording()
    recording = gnomon.read(session.recorder.folder)
    assert len(recording.imus["imu0"].accelerometer) == 1000
    assert session.recorder.damaged == 100


def test_both_clocks_are_in_the_file(tmp_path):
    recorder = Recorder(tmp_path / "rec")
    recorder.record_line(b"1,2,3", host_ns=1_763_897_696_123_456_789)
    recorder.close_files()
    assert (tmp_path / "rec/samples.log").read_bytes() == b"2025-11-23 11:34:56.123456 -> 1,2,3\n"


def test_a_recording_is_never_written_over(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        Recorder(tmp_path)


def test_the_words_name_the_side_that_is_up():
    assert words_of_attitude(np.array([0.0, 1.0, 0.0])) == "on its right edge (+y up)"


KILLED = """
import sys, time
from pathlib import Path
from gnomon.live.hand import SimulatedHand
from gnomon.live.coach import MagnetometerCoach, NoiseCoach
from gnomon.live.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]))
for k, line in enumerate(SimulatedHand(1).sample_lines()):
    recorder.record_line(line)
    if k % 100 == 0:
        recorder.sync_files()
        print(k, flush=True)
        time.sleep(0.002)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_what_was_recorded_survives_a_kill(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "rec")], stdout=subprocess.PIPE)
    for _ in range(8):
        last = int(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    lines = (tmp_path / "rec/samples.log").read_bytes().splitlines()
    assert len(lines) > last
    assert len(gnomon.read(tmp_path / "rec").imus["imu0"].accelerometer) >= len(lines) - 1


def test_a_magnetometer_is_turned_until_all_directions_were_seen(tmp_path):
    recording, _ = gnomon.simulate_magnetometer(gnomon.FieldScenario(), 1)
    magnetometer = recording.imus["imu0"].magnetometer
    session = LiveSession(Silent(), tmp_path / "rec", USES["ahrs"], coach=MagnetometerCoach)
    session.take_line(b"time [ns],mx [uT],my,mz")
    targets = []
    for k, (t_ns, row) in enumerate(zip(magnetometer.t_ns.tolist(), magnetometer.values.tolist(), strict=True)):
        session.take_line(f"{t_ns},{','.join(map(repr, row))}".encode())
        if k % 50 == 49:
            state = session.look_at_arrivals()
            targets.append(state.prospect.target)
            assert not state.faults
    session.end_recording()
    assert len(state.prospect.up) > 20
    assert state.known == f", {len(state.prospect.up)} directions"
    assert any(target is not None for target in targets)
    assert state.confirmed == (state.prospect.target is None)


def test_a_sensor_that_is_touched_is_left_alone_for_longer(tmp_path):
    session, hand = session_in(tmp_path, coach=NoiseCoach), SimulatedHand(1)
    said = follow(session, hand, 26)
    assert "180 min" in said[10][0].advice
    assert not said[10][0].known, "nothing is counted"
    assert "touched" not in said[-12][0].advice
    assert "touched at 2" in said[-1][0].advice
