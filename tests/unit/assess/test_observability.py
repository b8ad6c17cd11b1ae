"""Weak directions in words, for recordings whose motion lacks something."""

import numpy as np
import pytest

from gnomon import CameraImuPlan, ImuPlan, plan
from gnomon.assess.cameras.camera_imu_verdict import through_stated_focal
from gnomon.assess.directions import axis_words, duration_text
from gnomon.assess.observability import LIMITS, known_of, weak_directions
from gnomon.calibrate.predicted import planned_camera_imu
from gnomon.recording.samples import consumer_mems
from gnomon.simulate.planned import usual_rig

RATE_HZ = 100.0


def waved(**changes):
    """Return the calibration that a plan would give, which knows what its motion tells."""
    what = CameraImuPlan(**{"duration_s": 20.0, "camera_rate_hz": 10.0, **changes})
    return planned_camera_imu(what, usual_rig(), consumer_mems(), RATE_HZ), what


def weak(limits=LIMITS, stated=None, **changes):
    found, what = waved(**changes)
    known = known_of(found.imus, found.cameras, found.uncertainty.matrix, stated=stated, duration_s=what.duration_s)
    return weak_directions(known, limits)


@pytest.mark.parametrize("motion", ["gentle", "normal", "rolling", "shaky"])
def test_healthy_motions_leave_nothing_weak(motion):
    assert weak(motion=motion) == ()


def test_turning_about_one_axis():
    found = weak(motion="one-axis")
    assert all(one.held for one in found)
    translation = next(one for one in found if "translation" in one.words)
    assert translation.words == (
        "The translation of cam0 against the IMU along its optical axis is not known: rotation about its x axis "
        "(right) and y axis (down) is missing."
    )
    assert translation.cure.startswith("Turn cam0 about its x axis (right) and y axis (down) for ")
    assert translation.determined < 0.1
    name, share = translation.shares[0]
    assert name == "cam0.T_cam_imu.translation[2]"
    assert abs(share) > 0.9
    gyroscope = next(one for one in found if "gyroscope" in one.words)
    assert "one axis only, the IMU's x axis (the camera's optical axis)" in gyroscope.words
    assert gyroscope.cure.startswith("Turn the rig about the camera's x axis (right) and y axis (down)")
    assert len(found) == 2


@pytest.mark.parametrize(("axes", "along"), [("y", "y axis (down)"), ("x", "x axis (right)")])
def test_the_axis_that_it_turned_about_is_named(axes, along):
    found = weak(turn_axes=axes)
    assert f"along its {along} is not known" in next(one.words for one in found if "translation" in one.words)


def test_moving_without_turning():
    found = weak(motion="translation")
    words = " ".join(one.words for one in found)
    assert "The translation of cam0 against the IMU is not known: the rig hardly turned." in words
    assert "The scales and axes of the gyroscope are not known: it hardly turned." in words
    assert "accelerometer" not in words  # it was shaken along all axes
    assert all("Turn" in one.cure and "all three axes" in one.cure for one in found)


def test_a_vehicle_on_a_floor():
    found = weak(motion="planar", turning=3.0, distance_m=1.2)
    words = {one.words.partition(" is not known")[0].partition(" are not known")[0]: one for one in found}
    vertical = "the IMU's z axis (the camera's y axis, down)"
    assert words["The translation of cam0 against the IMU along its y axis (down)"].held
    trade = words["The z scale of the accelerometer"]
    assert "trades with its bias" in trade.words
    assert trade.cure.startswith(f"Tilt it so that {vertical} points up, down and level")
    assert f"one axis only, {vertical}" in words["The scales and axes of the gyroscope"].words
    assert f"the force along {vertical} hardly changed" in words["The g-sensitivity of the gyroscope"].words


def test_at_rest_nothing_is_known():
    found = weak(motion="static")
    words = " ".join(one.words for one in found)
    for what in ("rotation of cam0", "translation of cam0", "time shift of cam0", "gyroscope", "accelerometer"):
        assert what in words
    assert all(one.held for one in found)


def test_a_short_recording_only_has_to_go_on():
    limits = {**LIMITS, "translation": 1e-3}
    found = weak(limits, duration_s=4.0)
    assert found
    assert all("the recording is short" in one.words for one in found)
    assert all(one.cure.startswith("Go on with the same motion for ") for one in found)
    assert not any(one.held for one in found)
    assert weak(limits, duration_s=60.0) == ()


def test_the_seconds_that_are_asked_for_are_enough():
    limits = {**LIMITS, "rotation": np.radians(0.05)}
    (rotation,) = [one for one in weak(limits, duration_s=4.0) if "rotation of cam0" in one.words]
    seconds = float(rotation.cure.partition(" for ")[2].partition(" s more")[0])
    before, after = (waved(duration_s=4.0 + more)[0].sigma("cam0.T_cam_imu.rotation").max() for more in (0, seconds))
    assert after < limits["rotation"] < before


def rig_with_lens(*, focal_sigma_px, through):
    """Return what is known of a rig whose translation along the optical axis follows the focal length."""
    found, _ = waved(duration_s=5.0, free=("cam0.intrinsics",))
    names = found.uncertainty.names
    covariance = np.diag(np.full(len(names), 1e-12))
    focal, across, along = (
        names.index(f"cam0.{name}")
        for name in ("intrinsics[0]", "T_cam_imu.translation[0]", "T_cam_imu.translation[2]")
    )
    metres_per_px = 2e-3
    covariance[focal, focal] = focal_sigma_px**2
    covariance[along, along] = (metres_per_px * focal_sigma_px) ** 2 + through**2
    covariance[focal, along] = covariance[along, focal] = metres_per_px * focal_sigma_px**2
    covariance[across, across] = 1e-6
    return known_of(found.imus, found.cameras, covariance, stated={"cam0.intrinsics": 3.0}, duration_s=60.0)


def test_a_translation_that_follows_a_focal_length_known_beforehand():
    (found,) = weak_directions(rig_with_lens(focal_sigma_px=2.9, through=1e-3))
    assert "along its optical axis is known only through the focal length" in found.words
    assert "nearer to the board" in found.cure
    assert found.held
    assert found.determined < 0.1
    assert dict(found.shares)["cam0.intrinsics[0]"] == pytest.approx(1.0, abs=0.1)
    assert weak_directions(rig_with_lens(focal_sigma_px=2.9, through=1e-2)) == ()  # known by itself
    assert weak_directions(rig_with_lens(focal_sigma_px=0.5, through=1e-3)) == ()  # the recording tells the lens


def test_a_translation_that_follows_the_focal_length_that_was_stated():
    sigma = np.full(3, 1e-3)
    found = through_stated_focal("cam0", np.array([0.0, 0.1e-3, -9e-3]), sigma)  # a board three metres away
    assert "along its optical axis is known only through the focal length that was stated" in found.words
    assert "9 mm" in found.words
    assert not found.held
    assert through_stated_focal("cam0", np.array([0.0, 0.1e-3, -2.5e-3]), sigma) is None  # near
    assert through_stated_focal("cam0", np.array([0.0, 0.0, -9e-3]), 10 * sigma) is None  # worse known than that


def test_an_imu_that_was_tilted_about_one_axis():
    found = plan(ImuPlan(attitudes="one-axis"), changes=False).weak
    words = " ".join(one.words for one in found)
    assert "accelerometer are not known: the force along the IMU's y axis hardly changed" in words
    assert any("y axis points up, down and level" in one.cure for one in found)
    assert plan(ImuPlan(), changes=False).weak == ()


def test_axes_have_the_names_that_people_know():
    assert axis_words(np.array([0.1, -0.99, 0.0]), of_camera=True) == "y axis (down)"
    assert axis_words(np.array([0.0, 0.0, -1.0]), of_camera=False) == "z axis"
    assert axis_words(np.array([0.7, -0.7, 0.0]), of_camera=False) == "diagonal of x axis and y axis"
    assert [duration_text(seconds) for seconds in (2.0, 21.0, 100.0, 1e4)] == [
        "10 s more",
        "25 s more",
        "120 s more",
        "",
    ]
