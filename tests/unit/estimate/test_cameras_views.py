"""Corners gathered by the instant at which they were seen."""

from dataclasses import replace

import numpy as np
import pytest

from board_views import BOARD, STEP_NS, lens, pose, seen
from gnomon.estimate.cameras.rig import camera_corners, gathered_views, renumber_camera, views_alike
from gnomon.recording import CameraFrames

PAIR = {"cam0": lens("pinhole-radtan"), "cam1": lens("pinhole-radtan")}
APART = np.stack([np.eye(4), pose([0.0, 0.05, 0.0], [-0.1, 0.0, 0.0])])


@pytest.fixture(scope="module")
def frames():
    return seen(PAIR, APART, 12, 1)


@pytest.mark.parametrize("offset_ns", [0, 3_000, -2_500_000])
def test_frames_of_one_instant_are_one_view(frames, offset_ns) -> None:
    late = {**frames, "cam1": replace(frames["cam1"], t_ns=frames["cam1"].t_ns + offset_ns)}
    views = gathered_views(late, BOARD)
    both = (views.frame >= 0).all(axis=1)
    assert both.sum() > 6
    assert (views.frame[both, 0] == views.frame[both, 1]).all()
    assert (np.diff(views.t_ns) > 0).all()


def test_frames_further_apart_than_a_few_milliseconds_are_not(frames) -> None:
    late = {**frames, "cam1": replace(frames["cam1"], t_ns=frames["cam1"].t_ns + 20_000_000)}
    assert not (gathered_views(late, BOARD).frame >= 0).all(axis=1).any()


def test_fast_cameras_are_not_joined_with_the_neighbouring_frame(frames) -> None:
    fast = {name: replace(one, t_ns=one.t_ns // (STEP_NS // 4_000_000)) for name, one in frames.items()}  # 250 Hz
    fast["cam1"] = replace(fast["cam1"], t_ns=fast["cam1"].t_ns + 3_000_000)  # nearer to the next frame of cam0
    views = gathered_views(fast, BOARD)
    both = (views.frame >= 0).all(axis=1)
    assert (views.frame[both, 0] == views.frame[both, 1] + 1).all()


def test_every_usable_frame_is_in_one_view(frames) -> None:
    views = gathered_views(frames, BOARD)
    for number, one in enumerate(frames.values()):
        used = views.frame[views.frame[:, number] >= 0, number]
        assert sorted(set(used.tolist())) == sorted(used.tolist()) == sorted(set(one.frame.tolist()))


def test_frames_with_too_few_corners_or_on_one_line_are_left_out() -> None:
    few, line, good = np.arange(5), np.arange(8), np.array([0, 1, 2, 8, 9, 10, 16, 17])
    point = np.concatenate([few, line, good])
    frames = CameraFrames(
        t_ns=np.arange(3) * STEP_NS,
        frame=np.repeat([0, 1, 2], [5, 8, 8]),
        point=point,
        pixels=400 * BOARD.points[point, :2] + 100,
        camera=lens("pinhole-none"),
    )
    views = gathered_views({"cam0": frames}, BOARD)
    assert views.frame.tolist() == [[2]]


def test_corners_of_some_views_are_those_of_their_frames(frames) -> None:
    views = gathered_views(frames, BOARD).where(np.array([1, 4, 7]))
    for corners, one in zip(camera_corners(views), frames.values(), strict=True):
        assert set(corners.view.tolist()) <= {0, 1, 2}
        for k, frame in enumerate(corners.exposures.frame):
            mine = one.frame == frame
            start, stop = corners.exposures.start[k : k + 2]
            np.testing.assert_array_equal(corners.exposures.pixels[start:stop], one.pixels[mine])
            np.testing.assert_array_equal(corners.point[start:stop], one.point[mine])


def test_renumbering_a_view_moves_its_points_and_no_other(frames) -> None:
    views = gathered_views(frames, BOARD)
    turned = len(BOARD) - 1 - np.arange(len(BOARD))
    way = np.zeros(len(views), np.int64)
    at = int(np.flatnonzero(views.frame[:, 1] >= 0)[2])
    way[at] = 1
    changed = renumber_camera(views, 1, way, np.stack([np.arange(len(BOARD)), turned]))
    before, after = views.cameras["cam1"], changed.cameras["cam1"]
    mine = before.frame == views.frame[at, 1]
    np.testing.assert_array_equal(after.point[~mine], before.point[~mine])
    np.testing.assert_array_equal(after.point[mine], np.sort(turned[before.point[mine]]))
    np.testing.assert_array_equal(after.pixels[mine], before.pixels[mine][::-1])


def test_views_are_alike_until_the_board_has_moved(frames) -> None:
    views = gathered_views({"cam0": frames["cam0"]}, BOARD)
    mine = frames["cam0"].frame == views.frame[0, 0]
    pixels = frames["cam0"].pixels[mine]
    still = CameraFrames(
        t_ns=np.arange(6) * STEP_NS,
        frame=np.repeat(np.arange(6), mine.sum()),
        point=np.tile(frames["cam0"].point[mine], 6),
        pixels=np.concatenate([pixels + np.array([dx, 0.0]) for dx in (0, 5, 20, 90, 95, 400)]),
        camera=lens("pinhole-none"),
    )
    assert views_alike(gathered_views({"cam0": still}, BOARD)).tolist() == [0, 0, 0, 1, 1, 2]
