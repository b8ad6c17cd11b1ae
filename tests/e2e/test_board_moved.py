"""A board that was moved is named; what only looks like it, by poses of few corners or in one camera, is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gnomon import CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.assess.cameras.rig_findings import judged_again
from gnomon.assess.checks.board_views import BoardMove, BoardTurns, board_move
from gnomon.assess.checks.rig_doctor import check_corners
from gnomon.findings import Finding
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.results.camera_diagnostics import SignalFit
from gnomon.simulate.camera_imu_streams import View
from support.healthy import healthy_rig

MOVED_AT_S = 9.0
ONE = CameraImuScenario(
    duration_s=18.0, imu_rate_hz=100.0, camera_rate_hz=15.0, target_cols=4, target_rows=4, random_extrinsics=True
)
TWO = replace(ONE, cameras=2, baseline_m=0.11)
BENT = replace(TWO, focal_error=0.008, principal_point_error_px=4.0, corner_offset_m=5e-4)


def moved(simulation, turn_deg, cameras=("cam0", "cam1"), shift_m=(0.0, 0.0, 0.0)):
    """Return the recording as if the board had been turned about its middle, and shifted."""
    found = {}
    for name, frames in simulation.recording.cameras.items():
        truth, points = simulation.frames[name], simulation.target.points
        middle, true = points.mean(axis=0), simulation.truth.cameras
        turned = (points - middle) @ rotation_from_rotvec(np.radians(turn_deg)).T + middle + shift_m
        view = View(
            path=simulation.trajectory.path,
            T_cam_cam0=true[name].T_cam_imu @ np.linalg.inv(true["cam0"].T_cam_imu),
            camera=true[name].camera,
            points=turned,
        )
        pixels, seen = view.corners(truth.exposure_s)
        later = (truth.exposure_s > MOVED_AT_S)[frames.frame] & (name in cameras)
        there = pixels[frames.frame, frames.point] + frames.pixels - truth.pixels
        kept = ~later | seen[frames.frame, frames.point]
        changed = np.where(later[:, None], there, frames.pixels)[kept]
        found[name] = replace(frames, frame=frames.frame[kept], point=frames.point[kept], pixels=changed)
    return replace(simulation.recording, cameras=found)


def seen_in_part(recording, rng):
    """Return the recording with gaps, after which only some corners of one side of the board are in sight."""
    found = {}
    for name, frames in recording.cameras.items():
        t = (frames.t_ns - frames.t_ns[0]) * 1e-9
        kept = np.ones(len(frames.frame), dtype=bool)
        for start, gap, part in ((4.0, 0.8, 0.6), (8.0, 0.5, 0.7), (13.0, 1.2, 0.5)):
            kept &= ~((t > start) & (t < start + gap))[frames.frame]
            axis, way = rng.integers(0, 2), rng.choice([-1, 1])
            for number in np.flatnonzero((t >= start + gap) & (t < start + gap + part)):
                own = np.flatnonzero(frames.frame == number)
                kept[own[np.argsort(way * frames.pixels[own, axis])][rng.integers(14, 22) :]] = False
        found[name] = replace(frames, frame=frames.frame[kept], point=frames.point[kept], pixels=frames.pixels[kept])
    return replace(recording, cameras=found)


def told(recording, target):
    return [finding for finding in check_corners(recording, target) if finding.code == "board-moved"]


def test_a_board_that_was_out_of_sight_while_the_camera_turned_is_not():
    """How the gyroscope's errors turn it meanwhile is told by all that it read, not by the rate before and after."""
    for seed in (860005, 860010):
        simulation = simulate_camera_imu(healthy_rig(seed), seed)
        assert told(simulation.recording, simulation.target) == []


@pytest.mark.parametrize("turn_deg", [(2.0, 0.0, 0.0), (0.0, -1.2, 0.6)])
def test_a_board_that_was_turned_is_named(turn_deg):
    simulation = simulate_camera_imu(ONE, 3)
    (found,) = told(moved(simulation, turn_deg), simulation.target)
    assert found.severity == "problem"
    assert (
        f"by {np.linalg.norm(turn_deg):.1f}" in found.message or f"by {np.linalg.norm(turn_deg):.2g}" in found.message
    )
    assert ", 9 s after cam0" in found.message


def test_cameras_must_agree():
    simulation = simulate_camera_imu(TWO, 4)
    (found,) = told(moved(simulation, (2.0, 0.0, 0.0)), simulation.target)
    assert "cam0 and cam1 saw" in found.message
    assert told(moved(simulation, (2.0, 0.0, 0.0), cameras=("cam1",)), simulation.target) == []


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_few_corners_after_a_gap_are_no_turn_of_the_board(seed):
    simulation = simulate_camera_imu(BENT, seed)
    recording = seen_in_part(simulation.recording, np.random.default_rng(seed))
    assert told(recording, simulation.target) == []


def turns(size, *, sigma=2e-3, lasts=True, usual=1e-3):
    t = np.arange(0, 20, 0.1)
    found = usual * np.ones((len(t), 3)) / np.sqrt(3)
    found[95:106] = [size, 0, 0]
    return BoardTurns(
        t_s=t, turn_rad=found, sigma_rad=np.full(len(t), sigma), lasting_rad=found if lasts else np.zeros_like(found)
    )


def test_what_makes_a_move():
    move = board_move({"cam0": turns(0.03)})
    assert move is not None
    assert (move.cameras, move.turn_rad) == (("cam0",), pytest.approx(0.03))
    assert move.t_s == pytest.approx(10.0, abs=0.1)
    assert board_move({"cam0": turns(0.03, lasts=False)}) is None
    assert board_move({"cam0": turns(0.03, sigma=6e-3)}) is None
    assert board_move({"cam0": turns(0.03, usual=6e-3)}) is None
    assert board_move({"cam0": turns(0.03), "cam1": turns(0.0)}) is None
    blind = board_move({"cam0": turns(0.03), "cam1": turns(0.0, sigma=1.0)})
    assert blind is not None
    assert blind.cameras == ("cam0",)
    both = board_move({"cam0": turns(0.03), "cam1": turns(0.031)})
    assert both is not None
    assert both.cameras == ("cam0", "cam1")
    assert board_move({}) is None


MOVE = BoardMove(t_s=10.0, turn_rad=0.03, cameras=("cam0",), after_s=10.0)


def estimated(*, left_out=0, kick=0.0, sigma_px=0.3, z_rms=1.0, added=(), felt=None, changed=()):
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 200
    residual = 0.01 * rng.normal(size=(4000, 3))
    residual[2000:2010, 1] += kick
    fit = SignalFit(
        t_s=t, measured=residual, predicted=np.zeros((4000, 3)), basic=None, used=np.ones(4000, dtype=bool), sigma=0.01,
        unit="rad/s",
    )  # fmt: skip
    signals = {"imu0.gyroscope": fit}
    if felt is not None:
        signals["imu0.accelerometer"] = replace(fit, measured=felt + 0.01 * rng.normal(size=(4000, 3)), unit="m/s^2")
    reasons = ("fits badly as a whole",) * left_out + ("",) * (400 - left_out)
    corners = SimpleNamespace(
        frame_reason=reasons, frame_used=np.array([not reason for reason in reasons]), sigma_px=sigma_px,
        frame_t_s=np.arange(len(reasons)) / 20, frame_corners=np.repeat([0, 16], [20, len(reasons) - 20]),
    )  # fmt: skip
    steps = tuple(SimpleNamespace(name=name, used=True, forced=False) for name in added)
    trust = SimpleNamespace(splits=SimpleNamespace(z_rms=z_rms, limit=1.4), models=steps, changes=changed)
    return SimpleNamespace(signals=signals, corners={"cam0": corners}, trust=trust)


@pytest.mark.parametrize(
    ("of", "severity"),
    [
        ({}, "warning"),
        ({"kick": 0.4}, "problem"),
        ({"left_out": 40}, "problem"),
        ({"sigma_px": 1.5}, "problem"),
        ({"z_rms": 1.6}, "problem"),
        ({"added": ("board",)}, "problem"),
    ],
    ids=str,
)
def test_a_fit_that_explains_the_frames_is_not_failed_by_what_was_seen_before_it(of, severity):
    (found,) = judged_again([], MOVE, estimated(**of), converged=True)
    assert (found.code, found.severity) == ("board-moved", severity)
    (unsettled,) = judged_again([], MOVE, estimated(**of), converged=False)
    assert unsettled.severity == "problem"
    jump = Finding(severity="problem", code="clock-jump", message="It jumped.", consequence="No.", cure="Cut.")
    other = replace(jump, code="axes-differ")
    found = judged_again([jump, other], None, estimated(**{**of, "kick": 0.0}), converged=True)
    assert found[0].severity == ("problem" if severity == "problem" and "kick" not in of else "warning")
    assert found[1].severity == "problem"


@pytest.mark.parametrize(
    ("added", "severity"), [((), "warning"), (("intrinsics",), "warning"), (("board",), "problem")]
)
def test_a_lens_that_was_estimated_does_not_fail_its_result(added, severity):
    bent = Finding(severity="problem", code="distortion", message="Bent.", consequence="Poses are bent.", cure="Check.")
    (found,) = judged_again([bent], None, estimated(added=added), converged=True)
    assert found.severity == severity
    assert ("lens was estimated" in found.consequence) == (added == ("intrinsics",))
    (unfit,) = judged_again([bent], None, estimated(added=added, left_out=40), converged=True)
    assert unfit == bent


def test_a_board_that_was_shifted_is_named():
    simulation = simulate_camera_imu(ONE, 5)
    shifted = moved(simulation, (0.0, 0.0, 0.0), shift_m=(0.006, -0.008, 0.0))
    assert told(shifted, simulation.target) == []
    assessment = calibrate_camera_imu(shifted, simulation.target).calibration.assessment
    (found,) = [finding for finding in assessment.findings if finding.code == "board-moved"]
    assert assessment.verdict == "warn"
    assert ", 9 s after cam0" in found.message
    assert 5 < float(found.message.partition(" mm")[0].rpartition(" ")[2]) < 12


def felt(*, shift_m=0.0, kick_m_s=0.0):
    """Return what an accelerometer did not feel of a shift within 0.4 s, and what it felt too much of a knock."""
    t = np.arange(4000) / 200
    s = np.clip((t - 10.0) / 0.4, -0.5, 0.5)
    knock = np.where((t >= 10.0) & (t < 10.05), kick_m_s / 0.05, 0.0)
    return np.stack([knock - shift_m * 2 * np.pi * np.sin(2 * np.pi * s) / 0.4**2, 0 * t, 0 * t], axis=1)


def test_what_makes_a_shift():
    (found,) = judged_again([], None, estimated(felt=felt(shift_m=0.01)), converged=True)
    assert (found.code, found.severity) == ("board-moved", "warning")
    assert "by 10 mm" in found.message or "by 9." in found.message
    assert ", 9 s after cam0" in found.message
    assert judged_again([], None, estimated(felt=felt()), converged=True) == []
    assert judged_again([], None, estimated(felt=felt(shift_m=1e-3)), converged=True) == []
    assert judged_again([], None, estimated(felt=felt(kick_m_s=0.1)), converged=True) == []
    slipped = (SimpleNamespace(block="cam0.T_cam_imu.translation"),)
    assert judged_again([], None, estimated(felt=felt(shift_m=0.01), changed=slipped), converged=True) == []
    late = Finding(severity="warning", code="frames-late", message="Some are late.", consequence="No.", cure="Stamp.")
    assert judged_again([late], None, estimated(felt=felt(shift_m=0.01)), converged=True) == [late]
    (turned,) = judged_again([], MOVE, estimated(felt=felt(shift_m=0.01)), converged=False)
    assert "turned" in turned.message
