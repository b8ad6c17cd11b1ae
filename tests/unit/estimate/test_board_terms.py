"""Products of poses and the offsets of a board's corners."""

import numpy as np
import pytest

from gnomon.estimate.camera_imu.terms.board_terms import multiply_blocks, spread_out


@pytest.mark.parametrize("seen", [0.1, 1.0], ids=["sparse", "dense"])
def test_blocks_act_on_the_poses_of_their_exposures(seen):
    rng = np.random.default_rng(1)
    exposures, points = 7, 20
    chosen = np.argwhere(rng.random((exposures, points)) < seen)
    by_twist = rng.normal(size=(len(chosen), 6, 3))
    blocks = rng.normal(size=(exposures, 6, 6))
    found = multiply_blocks(blocks, spread_out(chosen[:, 0], chosen[:, 1], by_twist, (exposures, points)))
    whole = np.zeros((exposures, 6, points, 3))
    whole[chosen[:, 0], :, chosen[:, 1]] = np.einsum("nij,njk->nik", blocks[chosen[:, 0]], by_twist)
    assert isinstance(found, np.ndarray) == (seen == 1.0)
    np.testing.assert_allclose(found @ np.eye(3 * points), whole.reshape(6 * exposures, -1), atol=1e-12)


def test_a_camera_without_a_used_frame_has_none():
    none = np.zeros(0, dtype=np.int64)
    found = multiply_blocks(np.zeros((0, 6, 6)), spread_out(none, none, np.zeros((0, 6, 3)), (0, 20)))
    assert (found @ np.ones((60, 2))).shape == (0, 2)
