"""Thirty stereo views of EuRoC's AprilGrid against the intrinsics that were published with the data set."""

import numpy as np
import pytest

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.calibrate.steps.camera_reading import read_camera_views
from gnomon.calibrate.steps.camera_views import rms_of
from gnomon.estimate.cameras.first_rig import held_out_residuals
from gnomon.estimate.cameras.layout import stated_shape
from gnomon.estimate.cameras.rig import CameraRig, gathered_views
from gnomon.models.camera import Camera
from gnomon.options import CameraOptions

TARGET = "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
PUBLISHED = {
    "cam0": ((458.654, 457.296, 367.215, 248.375), (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)),
    "cam1": ((457.587, 456.134, 379.999, 255.238), (-0.28368365, 0.07451284, -0.00010473, -3.555e-05)),
}
BASELINE_M = 0.110074


@pytest.fixture(scope="module")
def views(real_data, tmp_path_factory):
    path = tmp_path_factory.mktemp("euroc") / "target.yaml"
    path.write_text(TARGET)
    return read_camera_views(real_data("euroc-cam-april"), target=path, resolution=(752, 480))


def published_rms(recording, target, name):
    """Return the rms of the corners of one camera with its published lens, each view with the pose that suits it."""
    alone = gathered_views({name: recording.cameras[name]}, target)
    intrinsics, coeffs = PUBLISHED[name]
    lens = Camera(
        projection="pinhole",
        intrinsics=np.array(intrinsics),
        distortion="radtan",
        distortion_coeffs=np.array(coeffs),
        resolution=(752, 480),
    )
    rig = CameraRig(
        cameras={name: lens},
        T_cam_cam0=np.eye(4)[None],
        R_cam0_target=np.empty((0, 3, 3)),
        p_cam0_target=np.empty((0, 3)),
        board=stated_shape(target),
    )
    return rms_of(held_out_residuals(alone, rig)[name])


def test_unseen_views_are_predicted_better_than_by_the_published_lenses(views):
    recording, target = views
    calibration = calibrate_cameras(recording, target, CameraOptions(board="stated")).calibration
    unseen = calibration.assessment.cameras.holdout_rms_px
    for name in PUBLISHED:
        assert unseen[name] < 0.5 * published_rms(recording, target, name)
    # Whole-board attitudes differ by five degrees only, and 40 % of the image was seen: the verdict says so.
    codes = {finding.code for finding in calibration.assessment.findings}
    assert {"attitudes-alike", "image-coverage"} <= codes
    assert np.linalg.norm(calibration.cameras["cam1"].T_cam_body[:3, 3]) == pytest.approx(BASELINE_M, abs=1.5e-3)


def test_a_lens_that_does_not_fit_is_named(views):
    recording, target = views
    options = CameraOptions(model=("pinhole-radtan",), board="stated")
    calibration = calibrate_cameras(recording, target, options).calibration
    assert calibration.assessment.findings[0].code == "lens-model"
    for name, (intrinsics, _) in PUBLISHED.items():
        off = calibration.parameter(f"{name}.intrinsics")[:2] - np.array(intrinsics[:2])
        assert (np.abs(off) < 4 * calibration.sigma(f"{name}.intrinsics")[:2]).all()
