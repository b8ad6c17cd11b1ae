"""The drift between the clocks of camera and IMU, by the rotation that both felt."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.checks.clock_checks import check_drift, clock_drift
from gnomon.assess.checks.rig_checks import check_recording_rig
from gnomon.errors import RecordingError
from gnomon.estimate.camera_imu.start.board_poses import board_poses
from gnomon.estimate.camera_imu.start.first_guess import ImuStream
from gnomon.simulate import CameraImuScenario, simulate_camera_imu


@pytest.fixture(scope="module")
def simulated():
    return simulate_camera_imu(CameraImuScenario(duration_s=40), 3)


def stream_of(recording):
    gyroscope = recording.imus["imu0"].gyroscope
    t_s = (gyroscope.t_ns - gyroscope.t_ns[0]) * 1e-9
    return ImuStream(t_s=t_s, rate=gyroscope.values, force=np.zeros_like(gyroscope.values))


def drifting(recording, ppm):
    """Let the camera's clock lose `ppm` on the IMU's, so that the time shift grows."""
    frames = recording.cameras["cam0"]
    passed = frames.t_ns - frames.t_ns[0]
    t_ns = frames.t_ns[0] + np.rint(passed * (1 - 1e-6 * ppm)).astype(np.int64)
    return replace(recording, cameras={"cam0": replace(frames, t_ns=t_ns)})


def found(recording, target, shift_s):
    frames = recording.cameras["cam0"]
    origin = recording.imus["imu0"].gyroscope.t_ns[0]
    poses = board_poses(frames, target, (frames.t_ns - origin) * 1e-9)
    return clock_drift(poses, stream_of(recording), shift_s)


@pytest.mark.parametrize("ppm", [0.0, 100.0, -400.0])
def test_drift(simulated, ppm) -> None:
    shift = simulated.truth.cameras["cam0"].time_shift_cam_imu
    drift = found(drifting(simulated.recording, ppm), simulated.target, shift)
    assert 1e6 * drift.drift == pytest.approx(ppm, abs=3e6 * drift.sigma)
    assert 1e6 * drift.sigma < 25


def test_finding(simulated) -> None:
    steady, fast = (check_recording_rig(drifting(simulated.recording, ppm), simulated.target) for ppm in (0.0, 200.0))
    assert [(finding.severity, finding.code) for finding in steady] == [("good", "clock")]
    assert [(finding.severity, finding.code) for finding in fast] == [("warning", "clock-drift")]
    assert "The clocks of cam0 and imu0 drift apart by +" in fast[0].message
    assert "by the rotation that both felt" in fast[0].message
    assert fast[0].consequence
    assert fast[0].cure


@pytest.mark.parametrize("ppm", [5000.0, -10000.0, 30000.0])
def test_a_drift_beyond_one_time_shift_is_named_before_the_estimation(simulated, ppm) -> None:
    """Of 5000 ppm the streams align badly; of 30000 ppm not at all."""
    recording = drifting(simulated.recording, ppm)
    told = [finding for finding in check_recording_rig(recording, simulated.target) if finding.severity != "good"]
    assert [(finding.severity, finding.code) for finding in told] == [("problem", "clock-drift")]
    drift, _, sigma, _ = told[0].message.partition("drift apart by ")[2].split(maxsplit=3)
    passed = 1 - 1e-6 * ppm  # of the camera's time in a second of the IMU's, by which the time shift is told
    assert float(drift) == pytest.approx(ppm / passed, abs=4 * float(sigma))
    assert float(sigma) < 200
    with pytest.raises(RecordingError, match="drift apart"):
        gnomon.calibrate_camera_imu(recording, simulated.target)


@pytest.mark.long
def test_a_calibration_says_it(simulated) -> None:
    options = gnomon.CameraImuOptions(model="basic", compare=False)
    drifts = drifting(simulated.recording, 300.0)
    calibration = gnomon.calibrate_camera_imu(drifts, simulated.target, options).calibration
    found = {finding.code: finding for finding in calibration.assessment.findings}
    assert found["clock-drift"].severity == "warning"
    assert calibration.verdict != "pass"


def test_too_little_to_tell(simulated) -> None:
    frames = simulated.recording.cameras["cam0"]
    few = frames.frame < 60
    short = replace(frames, frame=frames.frame[few], point=frames.point[few], pixels=frames.pixels[few])
    recording = replace(simulated.recording, cameras={"cam0": short})
    assert found(recording, simulated.target, 0.0) is None
    none = replace(frames, frame=frames.frame[:0], point=frames.point[:0], pixels=frames.pixels[:0])
    poses = board_poses(none, simulated.target, (frames.t_ns - frames.t_ns[0]) * 1e-9)
    assert check_drift("cam0", poses, stream_of(recording), 0.0, "imu0") == []


def test_real_clocks_keep_together(real_data) -> None:
    kalibr = real_data("kalibr-format-samples/openvins_euroc_mav")
    folder = real_data("euroc-imu-april")
    recording, target = gnomon.read_camera_imu(
        folder,
        cam=kalibr / "kalibr_imucam_chain.yaml",
        target=real_data("rendered-camimu") / "a-aprilgrid-full" / "target.yaml",
        imu=None,
    )
    assert {finding.code for finding in check_recording_rig(recording, target)} == {"clock", "tag-spacing"}


def beginning_of(seed, seconds, planted):
    """Return the findings on the first seconds of a recording in which something is wrong with the IMU's timestamps."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=seconds, camera_rate_hz=30.0), seed)
    imu = simulation.recording.imus["imu0"]
    imu = replace(
        imu, **{name: replace(one := getattr(imu, name), t_ns=t_ns(one.t_ns)) for name, t_ns in planted.items()}
    )
    recording = replace(simulation.recording, imus={"imu0": imu})
    return [one for one in check_recording_rig(recording, simulation.target, lens=False) if one.severity != "good"]


def fast(t_ns):
    return t_ns[0] + ((t_ns - t_ns[0]) * 1.01).astype(np.int64)


EARLY = {
    "clock-drift": {"accelerometer": fast, "gyroscope": fast},
    "triads-apart": {"accelerometer": lambda t_ns: t_ns + 60_000_000},
    "": {},
}


@pytest.mark.parametrize("code", EARLY)
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_two_and_a_half_seconds_tell_of_clocks_far_apart(seed, code):
    found = [one for one in beginning_of(seed, 2.5, EARLY[code]) if one.code != "motion-slow"]
    assert {one.code for one in found} == ({code} if code else set())
    if code == "clock-drift":
        assert "ppm" in found[0].message
        ppm = float(found[0].message.split("apart by ")[1].split()[0])
        assert ppm == pytest.approx(10_000, abs=4000)
    if code == "triads-apart":
        assert "accelerometer of imu0 comes" in found[0].message
