"""However cameras are stamped, each of their frames is in one view, and a view holds frames of one instant."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gnomon.estimate.cameras.rig import gathered_views
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames

BOARD = Target.checkerboard(cols=3, rows=3, row_spacing_m=0.1, col_spacing_m=0.1)
CAMERA = Camera.nominal((640, 480))
STAMPS = st.lists(st.integers(0, 2_000_000_000), min_size=0, max_size=30, unique=True).map(sorted)


def _frames(stamps: list[int]) -> CameraFrames:
    count = len(stamps)
    return CameraFrames(
        t_ns=np.array(stamps, dtype=np.int64),
        frame=np.repeat(np.arange(count), len(BOARD)),
        point=np.tile(np.arange(len(BOARD)), count),
        pixels=np.tile(1000 * BOARD.points[:, :2] + 100, (count, 1)),
        camera=CAMERA,
    )


@given(stamps=st.lists(STAMPS, min_size=1, max_size=3))
@settings(max_examples=60, deadline=None)
def test_every_frame_is_in_one_view(stamps) -> None:
    cameras = {f"cam{k}": _frames(one) for k, one in enumerate(stamps)}
    views = gathered_views(cameras, BOARD)
    assert (np.diff(views.t_ns) >= 0).all()
    for number, one in enumerate(stamps):
        used = views.frame[:, number]
        assert sorted(used[used >= 0].tolist()) == list(range(len(one)))
        apart = np.abs(np.array(one, dtype=np.int64)[used[used >= 0]] - views.t_ns[used >= 0])
        assert (apart <= 5_000_000).all()
    assert ((views.frame >= 0).any(axis=1)).all()
