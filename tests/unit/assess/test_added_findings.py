"""What the model took up by itself is told, and where something else may look the same."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.assess.cameras.rig_findings import added_findings
from gnomon.estimate.camera_imu.parameters import (
    BoardPoints,
    CameraParameters,
    ImuParameters,
    RigParameters,
    gravity_axes,
)
from gnomon.models.camera import Camera


def parameters(focal_px: float) -> RigParameters:
    camera = Camera(
        projection="pinhole",
        intrinsics=np.array([focal_px, focal_px, 320.0, 240.0]),
        distortion="radtan",
        distortion_coeffs=np.array([-0.28, 0.07, 0.0, 0.0]),
        resolution=(640, 480),
    )
    entry = CameraParameters(name="cam0", R_cam_imu=np.eye(3), p_cam_imu=np.zeros(3), time_shift_s=0.0, camera=camera)
    return RigParameters(
        gravity_axes=gravity_axes(np.array([0.0, -1.0, 0.1])),
        gravity_m_s2=9.81,
        target_scale=1.0,
        imus=(ImuParameters.ideal(),),
        cameras=(entry,),
    )


@pytest.mark.parametrize(
    ("focal_px", "board_told", "severity", "cure"),
    [
        (462.0, True, "info", "Use the lens of this result"),
        (462.0, False, "warning", "See that the board is flat"),
        (500.0, True, "warning", "Check that camchain.yaml is of this camera"),
        (500.0, False, "warning", "Check that camchain.yaml is of this camera"),
    ],
)
def test_a_lens_is_sure_only_where_the_board_can_be_told_from_it(focal_px, board_told, severity, cure):
    (finding,) = added_findings(("intrinsics",), parameters(460.0), parameters(focal_px), board_told=board_told)
    assert (finding.code, finding.severity) == ("lens-found", severity)
    assert cure in finding.cure


@pytest.mark.parametrize(
    ("stretch", "severity"), [(0.0, "info"), (0.003, "info"), (0.006, "warning"), (-0.006, "warning")]
)
def test_a_board_that_one_axis_is_longer_of_leaves_its_size_in_doubt(stretch, severity):
    points = np.stack(np.meshgrid(np.arange(7), np.arange(6), [0]), axis=-1).reshape(-1, 3) * 0.06
    centred = points - points.mean(axis=0)
    offsets = centred * [-stretch / 2, stretch / 2, 0] + 1e-4 * np.random.default_rng(1).standard_normal(points.shape)
    found = replace(parameters(460.0), board=BoardPoints(points=points, offsets=offsets, sigma_m=1e-3))
    (finding,) = added_findings(("board",), parameters(460.0), found, board_told=True)
    assert (finding.code, finding.severity) == ("board-found", severity)
    assert (severity == "warning") == ("longer against x than stated" in finding.message)


def test_how_long_images_were_exposed_is_told():
    found = parameters(460.0)
    found = replace(found, cameras=(replace(found.cameras[0], exposure_s2=1e-4),))
    (finding,) = added_findings(("exposure",), parameters(460.0), found, board_told=True)
    assert (finding.code, finding.severity, finding.subject) == ("exposure-found", "info", "cam0.exposure_squared")
    assert "What cam0 shows is a mean over 10 ms" in finding.message
