"""Mirrored corners, copies of views and cameras that are not synchronised: each is named, and healthy views are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.cameras.camera_synchronism import JointResiduals, check_synchronism
from gnomon.assess.checks.board_views import without_copies
from gnomon.assess.checks.rig_doctor import check_views
from gnomon.simulate.scenarios.cameras import CamerasScenario

OPTIONS = gnomon.CameraOptions(model=("pinhole-radtan",), board="stated")


def codes(findings):
    return {finding.code for finding in findings}


def with_pixels(recording, change):
    cameras = {name: replace(frames, pixels=change(frames)) for name, frames in recording.cameras.items()}
    return replace(recording, cameras=cameras)


def flipped(axis):
    def change(frames):
        pixels = frames.pixels.copy()
        pixels[:, axis] = frames.camera.resolution[axis] - 1 - pixels[:, axis]
        return pixels

    return change


@pytest.mark.parametrize("kind", ["aprilgrid", "checkerboard", "charuco", "circlegrid"])
@pytest.mark.parametrize("seed", [0, 1])
def test_handedness_is_seen_in_the_corners_of_any_board(kind, seed):
    simulation = gnomon.simulate_cameras(CamerasScenario(views=12, target_type=kind), seed)
    recording, target = simulation.recording, simulation.target
    assert "board-mirrored" not in codes(check_views(recording, target))
    for axis in (0, 1):
        assert "board-mirrored" in codes(check_views(with_pixels(recording, flipped(axis)), target))
    turned = with_pixels(recording, lambda frames: flipped(0)(replace(frames, pixels=flipped(1)(frames))))
    assert "board-mirrored" not in codes(check_views(turned, target))  # upside down is no mirror


def test_a_mirrored_table_never_passes():
    simulation = gnomon.simulate_cameras(CamerasScenario(views=20), 3)
    result = gnomon.calibrate_cameras(with_pixels(simulation.recording, flipped(0)), simulation.target, OPTIONS)
    apart = np.abs(result.calibration.parameter("cam0.intrinsics") - simulation.truth.parameter("cam0.intrinsics"))
    assert apart[2] > 10  # what the residuals do not show
    assert result.calibration.verdict == "warn"
    assert "board-mirrored" in codes(result.calibration.assessment.findings)


def copied(frames, times, step_ns):
    n = len(frames.t_ns)
    return replace(
        frames,
        t_ns=np.concatenate([frames.t_ns + k * step_ns for k in range(times)]),
        frame=np.concatenate([frames.frame + k * n for k in range(times)]),
        point=np.tile(frames.point, times),
        pixels=np.tile(frames.pixels, (times, 1)),
    )


def test_copies_of_views_are_named_and_count_once():
    simulation = gnomon.simulate_cameras(CamerasScenario(views=20), 4)
    recording = simulation.recording
    once = gnomon.calibrate_cameras(recording, simulation.target, OPTIONS).calibration
    cameras = {name: copied(frames, 12, 100_000_000_000) for name, frames in recording.cameras.items()}
    again = gnomon.calibrate_cameras(replace(recording, cameras=cameras), simulation.target, OPTIONS).calibration
    assert "views-copied" in codes(again.assessment.findings)
    assert "views-copied" not in codes(once.assessment.findings)
    assert again.verdict == "warn"
    assert np.array_equal(again.uncertainty.matrix, once.uncertainty.matrix)
    assert again.assessment.cameras.views_used == once.assessment.cameras.views_used


def test_copies_that_were_coded_anew_count_once_in_a_lens_calibration_alone():
    simulation = gnomon.simulate_cameras(CamerasScenario(views=20), 4)
    recording, rng = simulation.recording, np.random.default_rng(1)
    many = {name: copied(frames, 12, 100_000_000_000) for name, frames in recording.cameras.items()}
    anew = {
        name: replace(frames, pixels=frames.pixels + rng.normal(0.0, 0.01, frames.pixels.shape))
        for name, frames in many.items()
    }
    once = gnomon.calibrate_cameras(recording, simulation.target, OPTIONS).calibration
    again = gnomon.calibrate_cameras(replace(recording, cameras=anew), simulation.target, OPTIONS).calibration
    found = [finding for finding in again.assessment.findings if finding.code == "views-copied"]
    assert len(found) == 1
    assert "0.05 px" in found[0].message
    assert again.verdict == "warn"
    assert again.assessment.cameras.views_used == once.assessment.cameras.views_used
    assert np.allclose(np.diag(again.uncertainty.matrix), np.diag(once.uncertainty.matrix), rtol=0.4)
    kept, findings = without_copies(replace(recording, cameras=anew))
    assert not findings
    assert len(kept.cameras["cam0"].frame) == len(anew["cam0"].frame)


def test_one_topic_given_to_two_cameras_is_named():
    recording = gnomon.simulate_cameras(CamerasScenario(views=20, cameras=2), 4).recording
    assert not without_copies(recording)[1]
    one, other = recording.cameras.values()
    twice = {"cam0": one, "cam1": replace(one, camera=other.camera)}
    (found,) = without_copies(replace(recording, cameras=twice))[1]
    assert (found.code, found.severity, found.subject) == ("views-copied", "problem", "cam1")
    assert "same corners" in found.message


def test_views_in_another_order_of_corners_are_copies_too():
    recording = gnomon.simulate_cameras(CamerasScenario(views=4), 5).recording
    frames = recording.cameras["cam0"]
    last = np.flatnonzero(frames.frame == 3)
    first = np.flatnonzero(frames.frame == 0)[::-1]
    kept = np.setdiff1d(np.arange(len(frames.frame)), last)
    order = np.concatenate([kept, first])
    frame = np.concatenate([frames.frame[kept], np.full(len(first), 3)])
    made = replace(frames, frame=frame, point=frames.point[order], pixels=frames.pixels[order])
    found, findings = without_copies(replace(recording, cameras={"cam0": made}))
    assert codes(findings) == {"views-copied"}
    assert 3 not in found.cameras["cam0"].frame


def moving(delay_s, seed=0, share=0.5, speed=200.0):
    """A board that swings by both cameras, and residuals of which the pose takes a share of the delay."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(60) * 0.05
    path = speed / 2 * np.column_stack([np.sin(2 * t_s), np.cos(1.7 * t_s)])
    velocity = speed / 2 * np.column_stack([2 * np.cos(2 * t_s), -1.7 * np.sin(1.7 * t_s)])
    base = rng.uniform(200, 400, (20, 2))
    frame, point = np.repeat(np.arange(60), 20), np.tile(np.arange(20), 60)
    cameras, residuals = {}, {}
    for name, moved in (("cam0", share * delay_s), ("cam1", (share - 1) * delay_s)):
        pixels = path[frame] + base[point] + rng.normal(0, 0.15, (len(frame), 2))
        cameras[name] = gnomon.CameraFrames(
            t_ns=np.rint(t_s * 1e9).astype(np.int64), frame=frame, point=point, pixels=pixels,
            camera=gnomon.Camera.nominal((752, 480)),
        )  # fmt: skip
        residual = velocity[frame] * moved + rng.normal(0, 0.15, (len(frame), 2))
        residuals[name] = JointResiduals(view=frame, frame=frame, point=point, residual=residual)
    return cameras, residuals, dict.fromkeys(cameras, 0.15)


@pytest.mark.parametrize("delay_ms", [-20.0, -2.0, 1.0, 4.0])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_cameras_that_expose_at_other_instants(delay_ms, share):
    (found,) = check_synchronism(*moving(1e-3 * delay_ms, share=share))
    assert found.code == "cameras-unsynchronised"
    stated_ms = float(re.search(r"about ([\d.]+) ms", found.message)[1])
    assert stated_ms == pytest.approx(abs(delay_ms), rel=0.1)
    assert ("later" in found.message) == (delay_ms > 0)
    assert found.severity == ("problem" if abs(delay_ms) > 10 else "warning")


@pytest.mark.parametrize("seed", range(10))
def test_synchronised_cameras_are_not_blamed(seed):
    assert check_synchronism(*moving(0.0, seed)) == []


def test_a_board_that_stands_still_tells_nothing_of_the_clocks():
    cameras, residuals, sigma = moving(0.02, speed=1e-3)
    assert check_synchronism(cameras, residuals, sigma) == []


def test_a_stereo_recording_with_a_late_camera_is_told_as_such():
    simulation = gnomon.simulate_cameras(CamerasScenario(views=60, cameras=2, between=6), 1)
    cameras = {}
    for name, frames in simulation.recording.cameras.items():
        t_ns = np.arange(len(frames.t_ns)) * 50_000_000
        pixels = frames.pixels
        if name == "cam1":  # 10 ms late: on the way to the next frame
            table = np.full((len(t_ns) + 1, frames.point.max() + 1, 2), np.nan)
            table[frames.frame, frames.point] = pixels
            pixels = pixels + (table[frames.frame + 1, frames.point] - pixels) * 0.2
        kept = np.isfinite(pixels[:, 0])
        cameras[name] = replace(
            frames, t_ns=t_ns, frame=frames.frame[kept], point=frames.point[kept], pixels=pixels[kept]
        )
    recording = replace(simulation.recording, cameras=cameras)
    calibration = gnomon.calibrate_cameras(recording, simulation.target, OPTIONS).calibration
    assert calibration.verdict == "fail"
    assert calibration.assessment.findings[0].code == "cameras-unsynchronised"
    assert "cam1 took its images about" in calibration.assessment.findings[0].message
