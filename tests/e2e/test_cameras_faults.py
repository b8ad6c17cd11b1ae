"""Views of a board with something wrong with them: the cause is named, first and with what to do."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.errors import DetectionError, InitialisationError, OptionError, RecordingError
from gnomon.models.target import Target
from gnomon.options import CameraOptions
from gnomon.recording import Recording
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.scenarios.cameras import USUAL_LENSES, CamerasScenario


def calibrated(scenario, seed=1, target=None, **options):
    simulation = simulate_cameras(scenario, seed)
    return calibrate_cameras(simulation.recording, target or simulation.target, CameraOptions(**options))


def loud(result):
    findings = result.calibration.assessment.findings
    return [finding for finding in findings if finding.severity in ("warning", "problem")]


def test_two_views_are_refused():
    with pytest.raises(DetectionError, match=r"2 images.*fewer than 3 views.*tilted"):
        calibrated(CamerasScenario(views=2))


def test_few_views_are_named():
    result = calibrated(CamerasScenario(views=6))
    assert loud(result)[0].code == "views-few"
    assert "20 to 60 views" in loud(result)[0].cure


@pytest.mark.parametrize(("attitude", "verdict"), [("facing", "fail"), ("one", "warn")])
def test_one_attitude_is_named(attitude, verdict):
    result = calibrated(CamerasScenario(views=25, attitude=attitude), model=("pinhole-radtan",))
    assert loud(result)[0].code == "attitudes-alike"
    assert "Tilt the board" in loud(result)[0].cure
    assert result.calibration.verdict == verdict


def test_a_board_in_the_middle_is_named_with_the_corners_to_go_to():
    result = calibrated(CamerasScenario(views=25, spread=0.1, fill=(0.2, 0.3)))
    coverage = next(finding for finding in loud(result) if finding.code == "image-coverage")
    assert "the lower left corner" in coverage.cure


def test_a_tiny_board_is_named_first():
    result = calibrated(CamerasScenario(views=25, spread=0.1, fill=(0.06, 0.1)))
    assert loud(result)[0].code == "board-small"


def test_a_wrong_lens_model_is_named_with_numbers():
    intrinsics, coeffs = USUAL_LENSES["pinhole-equidistant"]
    scenario = CamerasScenario(views=25, distortion="equidistant", intrinsics=intrinsics, distortion_coeffs=coeffs)
    result = calibrated(scenario, model=("pinhole-radtan",))
    assert result.calibration.verdict == "fail"
    first = loud(result)[0]
    assert first.code == "lens-model"
    assert "px (rms per axis)" in first.message
    assert "--model cam0=" in first.cure
    assert [finding.code for finding in loud(result)] == ["lens-model"]


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_images_of_two_sizes_are_refused(share):
    with pytest.raises(RecordingError, match=r"not one size.*376 x 240 px, the others of 752 x 480"):
        calibrated(CamerasScenario(views=25, resized_views=share))


def test_a_board_larger_than_told_is_named_by_the_baseline():
    scenario = CamerasScenario(views=20, cameras=2, target_scale=1.02)
    first = loud(calibrated(scenario, baseline=0.11, model=("pinhole-radtan",)))[0]
    assert first.code == "board-size"
    assert "2 +- 0.1 % larger" in first.message


def test_without_a_baseline_the_size_of_the_board_is_said_to_be_untold():
    result = calibrated(CamerasScenario(views=20, cameras=2, target_scale=1.02), model=("pinhole-radtan",))
    assert "board-size-untold" in [finding.code for finding in result.calibration.assessment.findings]


def test_a_wrong_gap_between_the_tags_is_refused():
    wrong = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.25)
    with pytest.raises(RecordingError, match=r"gap between the tags is 0\.30.*tagSpacing 0\.25"):
        calibrated(CamerasScenario(views=20), target=wrong)


def test_ids_that_are_not_on_the_board_are_refused():
    smaller = Target.aprilgrid(tag_cols=5, tag_rows=5, tag_size_m=0.088, tag_spacing=0.3)
    with pytest.raises(RecordingError, match="not on the target"):
        calibrated(CamerasScenario(views=20), target=smaller)


def test_blurred_views_are_left_out_and_named():
    simulation = simulate_cameras(CamerasScenario(views=30, blurred_views=0.15), 1)
    result = calibrate_cameras(simulation.recording, simulation.target, CameraOptions(model=("pinhole-radtan",)))
    left = [k for k, reason in enumerate(result.diagnostics.corners["cam0"].frame_reason) if "fits badly" in reason]
    assert left == np.flatnonzero(simulation.blurred).tolist()
    named = next(one for one in result.calibration.assessment.findings if one.code == "views-left-out")
    assert all(f"{k} (at " in named.message for k in left[:5])


def test_outliers_do_no_harm():
    simulation = simulate_cameras(CamerasScenario(views=30, outliers=0.03), 1)
    calibration = calibrate_cameras(
        simulation.recording, simulation.target, CameraOptions(model=("pinhole-radtan",))
    ).calibration
    off = calibration.parameter("cam0.intrinsics") - simulation.truth.parameter("cam0.intrinsics")
    assert (np.abs(off) < 4.5 * calibration.sigma("cam0.intrinsics")).all()


def test_cameras_without_common_views_are_refused():
    with pytest.raises(InitialisationError, match="calibrate each alone"):
        calibrated(CamerasScenario(views=24, cameras=2, shared_views=False), model=("pinhole-radtan",))


def test_a_recording_without_cameras_is_refused():
    target = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
    with pytest.raises(RecordingError, match="no camera"):
        calibrate_cameras(Recording(imus={}), target)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": ("pinhole-ratan",)}, "Did you mean pinhole-radtan"),
        ({"model": ("cam3=pinhole-radtan",)}, "there is no cam3"),
        ({"model": ("pinhole-radtan", "cam0=ds-none")}, "Keep one"),
        ({"baseline": 0.1}, "one camera"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, message):
    with pytest.raises(OptionError, match=message):
        calibrated(CamerasScenario(views=10), **options)


def test_frames_in_no_order_are_refused():
    simulation = simulate_cameras(CamerasScenario(views=12), 1)
    frames = simulation.recording.cameras["cam0"]
    backward = replace(simulation.recording, cameras={"cam0": replace(frames, t_ns=frames.t_ns[::-1])})
    with pytest.raises(RecordingError, match="not later"):
        calibrate_cameras(backward, simulation.target)
