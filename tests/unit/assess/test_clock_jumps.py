"""A clock that jumps while camera and IMU record: said by `check` and by the calibration, and no gap taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, judge, simulate_camera_imu
from gnomon.assess.checks.rig_doctor import check_corners
from gnomon.errors import RecordingError

SCENARIO = CameraImuScenario(duration_s=20.0, target_cols=4, target_rows=4, random_extrinsics=True)


@pytest.fixture(scope="module")
def simulation():
    return simulate_camera_imu(SCENARIO, 21)


def with_imu(recording, at_s, by_s, lost_s=0.0):
    """Set the IMU's clock at a time, and lose the samples of some time after it."""

    def changed(triad):
        t_s = (triad.t_ns - triad.t_ns[0]) * 1e-9
        kept = (t_s < at_s) | (t_s >= at_s + lost_s)
        t_ns = triad.t_ns + np.where(t_s >= at_s, round(by_s * 1e9), 0)
        return replace(triad, t_ns=t_ns[kept], values=triad.values[kept])

    imu = recording.imus["imu0"]
    imu = replace(imu, gyroscope=changed(imu.gyroscope), accelerometer=changed(imu.accelerometer))
    return replace(recording, imus={"imu0": imu})


def with_camera(recording, at_s, by_s):
    frames = recording.cameras["cam0"]
    later = (frames.t_ns - frames.t_ns[0]) * 1e-9 >= at_s
    frames = replace(frames, t_ns=frames.t_ns + np.where(later, round(by_s * 1e9), 0))
    return replace(recording, cameras={"cam0": frames})


def jumps(recording, target):
    return [finding for finding in check_corners(recording, target) if finding.code == "clock-jump"]


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
def test_a_gyroscope_whose_range_changes_is_no_jump(simulation, factor) -> None:
    imu = simulation.recording.imus["imu0"]
    values = imu.gyroscope.values.copy()
    values[2400:] *= factor  # after 12 of 20 s
    imu = replace(imu, gyroscope=replace(imu.gyroscope, values=values))
    recording = replace(simulation.recording, imus={"imu0": imu})
    found, *others = [one for one in check_corners(recording, simulation.target) if one.severity == "problem"]
    assert (found.code, others) == ("gyroscope-range-changed", [])
    told = float(found.message.partition("to show ")[2].split()[0])
    assert told == pytest.approx(factor, rel=0.1)
    at_s = float(found.message.partition("between ")[2].split()[0])
    assert at_s == pytest.approx(12, abs=1)
    with pytest.raises(RecordingError, match="began to show"):
        calibrate_camera_imu(recording, simulation.target)


@pytest.mark.parametrize(("what", "at_s"), [("x", 12), ("y", 5.5), ("y", 15.5), ("z", 5.5), ("recording", 12)])
def test_where_camera_and_gyroscope_cease_to_show_one_rotation_is_told(simulation, what, at_s) -> None:
    """Of the early ones most cannot be aligned as a whole; the late ones can, and look like a few wrong frames."""
    recording = simulation.recording
    imu = recording.imus["imu0"]
    values = imu.gyroscope.values.copy()
    first = round(200 * at_s)  # of 20 s
    if what == "recording":
        values[first:] = values[first:][::-1].copy()
    else:
        values[first:, "xyz".index(what)] *= -1
    imu = replace(imu, gyroscope=replace(imu.gyroscope, values=values))
    edited = replace(recording, imus={"imu0": imu})
    found = next(one for one in check_corners(edited, simulation.target) if one.severity == "problem")
    assert (found.code, found.subject) == ("rotation-breaks", "cam0")
    assert float(found.message.split()[1]) == pytest.approx(at_s, abs=1.5)
    if (what, at_s) == ("y", 5.5):
        with pytest.raises(RecordingError, match="cease, or begin"):
            calibrate_camera_imu(edited, simulation.target)
    assert not any(one.code == "rotation-breaks" for one in check_corners(recording, simulation.target))


@pytest.mark.parametrize(
    ("stream", "at_s", "by_s", "said"),
    [
        ("imu", 10, 1.0, "about 10 s after"),
        ("imu", 10, 0.3, "about 10 s after"),
        ("imu", 5, 5.0, "about 5 s after"),
        ("camera", 8, 1.0, "about 8 s after"),
        ("camera", 8, 0.1, "about 8 s after"),
    ],
)
def test_a_jump_is_told_with_stream_time_and_size(simulation, stream, at_s, by_s, said) -> None:
    edit, name = (with_imu, "imu0") if stream == "imu" else (with_camera, "cam0")
    (found,) = jumps(edit(simulation.recording, at_s, by_s), simulation.target)
    assert found.severity == "problem"
    assert found.subject == name
    assert said in found.message
    assert f"it is {name} that jumped" in found.message
    size, unit = found.message.split(" jumped by ")[1].split()[:2]
    assert float(size) * (1e-3 if unit == "ms" else 1) == pytest.approx(by_s, abs=0.01)


@pytest.mark.parametrize("by_s", [0.02, 0.05])
def test_a_short_jump_is_told_once(simulation, by_s) -> None:
    (found,) = jumps(with_imu(simulation.recording, 10, by_s), simulation.target)
    assert found.severity == "problem"


@pytest.mark.parametrize("lost_s", [0.0, 0.5, 3.0])
def test_lost_samples_are_no_jump(simulation, lost_s) -> None:
    assert not jumps(with_imu(simulation.recording, 9, 0.0, lost_s), simulation.target)


@pytest.mark.parametrize(("edit", "by_s"), [(with_imu, 5e-3), (with_camera, -5e-3)])
def test_the_calibration_tells_of_a_jump_that_is_too_short_for_the_check(simulation, edit, by_s) -> None:
    recording = edit(simulation.recording, 12, by_s)
    result = calibrate_camera_imu(recording, simulation.target, CameraImuOptions(gravity=SCENARIO.gravity))
    loud = [one.code for one in result.calibration.assessment.findings if one.severity in ("warning", "problem")]
    assert loud == ["clock-jump", "stream-short"]
    (change,) = result.calibration.assessment.trust.changes
    assert change.at_s == pytest.approx(12, abs=0.8)
    assert change.size == pytest.approx(5e-3, rel=0.1)
    judged = judge(result.calibration, "general").assessment.findings
    assert [one.subject for one in judged if one.code == "clock-jump"] == ["cam0.time_shift_cam_imu"]


@pytest.mark.parametrize(("at_s", "by_s"), [(10, 1.0), (10, 0.3), (5, 5.0)])
def test_the_calibration_stops_with_what_the_check_says(simulation, at_s, by_s) -> None:
    recording = with_imu(simulation.recording, at_s, by_s)
    (said,) = jumps(recording, simulation.target)
    with pytest.raises(RecordingError) as stopped:
        calibrate_camera_imu(recording, simulation.target, CameraImuOptions(gravity=SCENARIO.gravity))
    assert said.message in str(stopped.value)
