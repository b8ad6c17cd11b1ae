"""Products of poses and the offsets of a board's corners."""

import numpy as np
import pytest

from gnomon.estimate.camera_imu.terms.board_terms import PoseProducts


@pytest.mark.parametrize("seen", [0.05, 1.0], ids=["sparse", "dense"])
def test_blocks_act_on_the_poses_of_their_exposures(seen):
    rng = np.random.default_rng(1)
    exposures, points = 150, 20
    chosen = np.argwhere(rng.random((exposures, points)) < seen)
    by_twist = rng.normal(size=(len(chosen), 6, 3))
    blocks = rng.normal(size=(exposures, 6, 6))
    products = PoseProducts(place=chosen[:, 0], point=chosen[:, 1], by_twist=by_twist.copy(), shape=(exposures, points))
    found = products.turned(blocks)
    whole = np.zeros((exposures, 6, points, 3))
    whole[chosen[:, 0], :, chosen[:, 1]] = np.einsum("nij,njk->nik", blocks[chosen[:, 0]], by_twist)
    whole = whole.reshape(6 * exposures, -1)
    assert isinstance(found.rows(slice(3, 9)), np.ndarray) == (seen == 1.0)
    np.testing.assert_allclose(found.rows(slice(3, 9)) @ np.eye(3 * points), whole[18:54], atol=1e-12)
    np.testing.assert_allclose(found.times(np.eye(3 * points)).reshape(whole.shape), whole, atol=1e-12)
    poses = rng.normal(size=(150, 6, 4))
    np.testing.assert_allclose(found.pull(poses, 5, 145), whole[30:870].T @ poses[5:145].reshape(-1, 4), atol=1e-11)


def test_a_camera_without_a_used_frame_has_none():
    none = np.zeros(0, dtype=np.int64)
    found = PoseProducts(place=none, point=none, by_twist=np.zeros((0, 6, 3)), shape=(0, 20))
    found = found.turned(np.zeros((0, 6, 6)))
    assert found.times(np.ones((60, 2))).shape == (0, 6, 2)
    assert not found.pull(np.zeros((0, 6, 2)), 0, 0).any()
