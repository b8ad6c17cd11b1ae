"""Corners that lie far from where they should, anywhere or at one place of the board."""

import numpy as np
import pytest

from gnomon.assess.cameras.rig_findings import outlying_corners
from gnomon.results.camera_diagnostics import CornerFit

FRAMES, POINTS = 50, 48


def corners(far: np.ndarray) -> CornerFit:
    """Return corners (frames, points) of which some are 60 px from where they should be."""
    residual = 0.1 * np.random.default_rng(1).standard_normal((FRAMES * POINTS, 2))
    residual[far.ravel(), 0] += 60.0
    return CornerFit(
        frame_t_s=np.arange(FRAMES) / 20.0,
        frame_corners=np.full(FRAMES, POINTS),
        frame_rms=np.full(FRAMES, 0.1),
        frame_used=np.ones(FRAMES, dtype=bool),
        frame_reason=np.full(FRAMES, "", dtype=object),
        frame=np.repeat(np.arange(FRAMES), POINTS),
        point=np.tile(np.arange(POINTS), FRAMES),
        pixels=np.zeros((FRAMES * POINTS, 2)),
        residual=residual,
        weight=np.ones(FRAMES * POINTS),
        sigma_px=0.1,
        resolution=(752, 480),
    )


@pytest.mark.parametrize("points", ["corners", "landmarks"])
def test_a_tag_whose_number_is_there_twice_is_told_by_its_corners(points) -> None:
    far = np.zeros((FRAMES, POINTS), dtype=bool)
    far[::2, 12:16] = True
    (finding,) = outlying_corners("cam0", corners(far), points)
    assert ("number 12, 13, 14, 15 of the board" in finding.message) == (points == "corners")
    assert ("a tag's number there twice" in finding.cure) == (points == "corners")


def test_corners_that_are_far_anywhere_are_of_no_place() -> None:
    far = np.random.default_rng(2).random((FRAMES, POINTS)) < 0.04
    (finding,) = outlying_corners("cam0", corners(far))
    assert "number" not in finding.message
    assert not outlying_corners("cam0", corners(np.zeros((FRAMES, POINTS), dtype=bool)))
