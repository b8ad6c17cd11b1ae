"""A guided capture of a camera with an IMU: what was turned and shaken, and what a calibration of it says."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.live.board_coach import speed_of_corners
from gnomon.live.coach import Coach, NoiseCoach
from gnomon.live.faults import Fault
from gnomon.live.hand import imu_sentence
from gnomon.live.image_sources import CameraSource, ImageArrival, ImageSource, open_rig_sources
from gnomon.live.rig_session import MotionCoach, RigCoach, RigSession
from gnomon.live.sources import LiveSource, PushSource
from gnomon.live.trials import TrialOutcome, Trials, check_setup
from gnomon.options.requirements import GENERAL_RIG
from gnomon.readers.images.image_recording import open_images
from gnomon.recording import TriadSamples
from gnomon.simulate import CameraImuScenario, simulate_camera_imu
from support.live_images import GREY, STATISTICS, views_of

STEP_NS = 5_000_000


class SilentCamera(ImageSource):
    """Takes nothing by itself."""

    def arriving_images(self, stop):
        yield from ()


class SilentImu(LiveSource):
    """Sends nothing by itself."""

    def arriving_lines(self, stop):
        yield from ()


def feed(coach, seconds, rate=(0.0, 0.0, 0.0), shake=(0.0, 0.0, 0.0), start=0, unit=1.0, up=(0.0, 0.0, 1.0)):
    """Send samples of a sensor that is turned to and fro at 1 Hz, and shaken at 3 Hz, and look twice a second."""
    rng = np.random.default_rng(start)
    for first in range(start, start + round(200 * seconds), 100):
        k = np.arange(first, first + 100)[:, None]
        way = np.sin(2 * np.pi * k / 200)
        omega = way * rate + 1e-3 * rng.standard_normal((100, 3))
        force = 9.81 * np.array(up) + np.sin(6 * np.pi * k / 200) * shake + 1e-2 * rng.standard_normal((100, 3))
        t_ns = (10**18 + STEP_NS * k[:, 0]).astype(np.int64)
        samples = {
            "accelerometer": TriadSamples(t_ns=t_ns, values=force / unit, unit="g" if unit > 1 else "m/s^2"),
            "gyroscope": TriadSamples(t_ns=t_ns, values=omega, unit="rad/s"),
        }
        coach.add_samples(samples, {name: one.unit for name, one in samples.items()})
        coach.look_at_samples()
    return start + round(200 * seconds)


@pytest.mark.parametrize("unit", [1.0, 9.80665])
def test_what_is_turned_and_shaken_is_counted_for_each_axis(unit):
    coach = MotionCoach(GENERAL_RIG)
    feed(coach, 10, rate=(2.0, 0.0, 0.0), shake=(0.0, 0.0, 4.0), unit=unit)
    assert coach.turned_s[0] == pytest.approx(9.5, abs=1.5)
    assert coach.shaken_s[2] == pytest.approx(8.5, abs=1.5)
    assert not coach.turned_s[1:].any()
    assert not coach.shaken_s[:2].any()


@pytest.mark.parametrize(("kind", "most"), [(MotionCoach, 2**18), (NoiseCoach, 2**18), (Coach, 2**21)])
def test_a_day_of_samples_needs_no_more_memory_than_minutes(kind, most):
    coach, size, lasts_s = kind(GENERAL_RIG), 60_000, 24 * 3600
    values = np.random.default_rng(0).normal((0.0, 0.0, 9.8), size=(size, 3))
    units = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
    for first in range(0, 50 * lasts_s, size):  # 50 samples a second
        t_ns = (first + np.arange(size)) * 20_000_000
        coach.add_samples({name: TriadSamples(t_ns=t_ns, values=values, unit=unit) for name, unit in units.items()}, {})
    assert all(len(rows._t_ns) <= most for rows in coach._triads.values())
    if kind is NoiseCoach:
        assert coach.look_at_samples().seconds == pytest.approx(lasts_s, rel=0.01), "of all of it"


@pytest.fixture(scope="module")
def waved():
    return simulate_camera_imu(CameraImuScenario(duration_s=31.0, camera_rate_hz=10.0), 2)


def show(coach, waved, frames, first=0):
    for k, view in enumerate(views_of(waved)):
        if first <= k < first + frames:
            stamp = int(waved.recording.cameras["cam0"].t_ns[k])
            state = coach.look_at_image(stamp, GREY, view, STATISTICS, seconds=k / 10, rate_hz=10.0)
    return state


def test_each_axis_is_asked_for_then_a_calibration_is_tried(waved):
    motion = MotionCoach(GENERAL_RIG)
    coach = RigCoach(waved.target, waved.recording.cameras["cam0"].camera, motion)
    sent = feed(motion, 12, rate=(2.0, 0.0, 2.0))
    assert show(coach, waved, 20).phase == "turn y"
    sent = feed(motion, 12, rate=(0.0, 2.0, 0.0), shake=(4.0, 0.0, 4.0), start=sent)
    assert show(coach, waved, 20, first=20).phase == "shake y"
    sent = feed(motion, 12, shake=(0.0, 4.0, 0.0), start=sent)
    assert show(coach, waved, 20, first=40).phase == "roll"
    assert not coach.wants_calibration
    feed(motion, 2, up=(0.0, 1.0, 0.0), start=sent)
    assert show(coach, waved, 20, first=40).phase == "more"
    assert show(coach, waved, 250, first=60).phase == "trying"
    assert coach.wants_trial
    coach.recording_so_far()
    assert not coach.wants_trial, "not before there is more"
    for seconds, wanted in ((1100.0, True), (1300.0, False)):
        coach.state = replace(coach.state, seconds=seconds)
        assert coach.wants_trial == wanted, "what a trial reads is bounded"
    coach.take_outcome(TrialOutcome(verdict="pass", needs=(("translation", 1.5),)))
    assert not show(coach, waved, 1, first=309).confirmed
    coach._tried_s += 2.0
    coach.take_outcome(TrialOutcome(verdict="pass", needs=(("translation", 0.52),)))
    assert not show(coach, waved, 1, first=309).confirmed, "it may fall on"
    coach._tried_s += 2.0
    coach.take_outcome(TrialOutcome(verdict="pass", needs=(("translation", 0.5),)))
    state = show(coach, waved, 1, first=309)
    assert state.confirmed
    assert dict(state.bars)["precision: translation"] == 2.0
    coach.state = replace(state, seconds=coach._tried_s + 31.0)
    assert coach.wants_calibration, "bars follow those who go on"
    coach.take_outcome(TrialOutcome(verdict="pass", needs=(("translation", 0.3),)))
    assert show(coach, waved, 1, first=309).confirmed
    coach.take_outcome(TrialOutcome(verdict="warn", advice="The board moved.", needs=(("translation", 0.3),)))
    assert show(coach, waved, 1, first=309).advice == "The board moved."


def lens_of(simulation):
    return simulation.recording.cameras["cam0"].camera


def test_the_speed_of_the_board_in_the_image_is_shown(waved):
    views = list(islice(views_of(waved), 2))
    same = replace(views[0], pixels=np.add(views[0].pixels, [3.0, 4.0]))
    assert speed_of_corners((0, views[0]), (10**7, same)) == pytest.approx(500.0)
    coach = RigCoach(waved.target, lens_of(waved), MotionCoach(GENERAL_RIG))
    lights = {name: (value, good) for name, value, good in show(coach, waved, 2).document()["lights"]}
    assert lights["speed"][0].endswith(" px/s")
    assert lights["speed"][1]
    stamps = waved.recording.cameras["cam0"].t_ns.tolist()
    fast = replace(views[1], pixels=np.add(views[1].pixels, [150.0, 0.0]))
    state = coach.look_at_image(stamps[2], GREY, fast, STATISTICS, seconds=0.2, rate_hz=10.0)
    assert ["speed", f"{state.speed_px_s:.0f} px/s", False] in state.document()["lights"]


def with_axes(waved, matrix):
    """Return the recording with the gyroscope's axes mixed by a matrix (3, 3)."""
    imu = waved.recording.imus["imu0"]
    gyroscope = replace(imu.gyroscope, values=imu.gyroscope.values @ np.array(matrix, float))
    return replace(waved.recording, imus={"imu0": replace(imu, gyroscope=gyroscope)})


def test_axes_that_were_exchanged_are_named_by_an_early_check(waved):
    exchanged = check_setup(with_axes(waved, [[0, 1, 0], [1, 0, 0], [0, 0, 1]]), waved.target)
    assert [fault.code for fault in exchanged] == ["axes-differ"]
    assert check_setup(waved.recording, waved.target) == ()


def beginning(recording, seconds):
    """Return what was recorded until then, by the camera's clock."""
    frames, imu = recording.cameras["cam0"], recording.imus["imu0"]
    count = int(np.searchsorted(frames.t_ns, frames.t_ns[0] + int(seconds * 1e9)))
    rows = {name: getattr(frames, name)[frames.frame < count] for name in ("frame", "point", "pixels")}
    samples = {
        name: replace(one, t_ns=one.t_ns[: int(200 * seconds)], values=one.values[: int(200 * seconds)])
        for name, one in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
    }
    cameras = {"cam0": replace(frames, t_ns=frames.t_ns[:count], **rows)}
    return replace(recording, cameras=cameras, imus={"imu0": replace(imu, **samples)})


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], "x measures about +y"),
        (np.diag([1, 1, -1]), "sign"),
        (-np.eye(3), "mirror"),
        (np.eye(3), ""),
    ],
)
def test_axes_of_the_accelerometer_are_told_within_three_seconds(waved, matrix, words):
    imu = waved.recording.imus["imu0"]
    accelerometer = replace(imu.accelerometer, values=imu.accelerometer.values @ np.array(matrix, float))
    recording = replace(waved.recording, imus={"imu0": replace(imu, accelerometer=accelerometer)})
    told = [fault.text for fault in check_setup(beginning(recording, 3.0), waved.target)]
    assert len(told) == bool(words), told
    assert all(words in text for text in told)


def test_an_early_check_needs_motion_and_the_board_and_its_faults_are_shown(waved):
    motion = MotionCoach(GENERAL_RIG)
    coach = RigCoach(waved.target, waved.recording.cameras["cam0"].camera, motion)
    show(coach, waved, 60)
    assert not coach.wants_trial, "nothing was turned"
    feed(motion, 12, rate=(2.0, 0.0, 2.0))
    assert coach.wants_trial
    assert not coach.wants_calibration
    coach.recording_so_far()
    assert not coach.wants_trial, "not at once again"
    coach.take_outcome(TrialOutcome(faults=(Fault(code="clock-jump", text="The clock jumps."),)))
    assert "clock-jump" in {fault.code for fault in show(coach, waved, 1, first=60).faults}
    coach.take_outcome(TrialOutcome())
    assert "clock-jump" not in {fault.code for fault in show(coach, waved, 1, first=61).faults}


@pytest.mark.long
def test_a_trial_reads_the_samples_as_the_ordinary_command_does(tmp_path, waved):
    session = RigSession(
        SilentCamera(),
        SilentImu(),
        tmp_path / "rec",
        waved.target,
        lenses={"cam0": waved.recording.cameras["cam0"].camera},
        use=GENERAL_RIG,
    )
    session.samples.take_line(b"time [ns],ax [m/s^2],ay,az,gx [rad/s],gy,gz")
    imu = waved.recording.imus["imu0"]
    rows = np.hstack([imu.accelerometer.values, imu.gyroscope.values]).tolist()
    for t_ns, row in zip(imu.gyroscope.t_ns.tolist(), rows, strict=True):
        session.samples.take_line(f"{t_ns},{','.join(map(repr, row))}".encode())
    show(session.coach, waved, 310)
    trial = Trials()
    trial.begin(session.coach.recording_so_far(), waved.target, GENERAL_RIG, session.folder)
    trial._thread.join()
    session.end_recording()
    trial.close()
    assert trial.outcome.verdict == "pass"
    assert {name.split()[0] for name, _ in trial.outcome.needs} == {"rotation", "translation", "time"}
    assert all(0 < ratio < 1 for _, ratio in trial.outcome.needs)


def test_both_streams_are_read_again_as_they_were(tmp_path, waved):
    session = RigSession(
        SilentCamera(), SilentImu(), tmp_path / "rec", waved.target, lenses={"cam0": lens_of(waved)}, use=GENERAL_RIG
    )
    for k in range(100):
        session.samples.take_line(imu_sentence(5000 * k, (0.1, 0.2, 9.8, 0.1 * (k % 7), 0.2, 0.3, 25.0)))
        if k % 10 == 0:
            session.take_image(ImageArrival(10**18 + STEP_NS * k, GREY))
    assert session.recorded == "10 images and 100 lines"
    session.end_recording()
    found = open_images(tmp_path / "rec")
    assert found.streams["cam0"].count == 10
    assert len(found.imus["imu0"].gyroscope) == 100


def test_streams_of_one_recording_keep_their_places_in_time(tmp_path, monkeypatch):
    scenario = CameraImuScenario(duration_s=0.5, camera_rate_hz=10.0, target_cols=2, target_rows=2)
    monkeypatch.setattr("gnomon.live.image_sources.WAVED", scenario)
    images, samples = open_rig_sources(["simulate:1"])
    assert images._pace is samples._pace
    assert images.target is not None


def test_which_of_two_sources_has_the_images_is_told_by_their_kinds():
    images, samples = open_rig_sources(["http", "camera:0"])
    assert isinstance(images, CameraSource)
    assert isinstance(samples, PushSource)


@pytest.mark.parametrize("texts", [["camera:0"], ["simulate", "simulate", "simulate"], ["serial:/dev/ttyUSB0"]])
def test_sources_that_are_not_both_are_named(texts):
    with pytest.raises(OptionError, match="images"):
        open_rig_sources(texts)
