"""Checkerboards that look the same from several ends, numbered alike over time."""

import numpy as np
import pytest

from gnomon.detect.boards.board import BoardView, nothing_seen
from gnomon.detect.boards.checkerboard_order import ambiguous_turns, consistent_order, renumber_view
from gnomon.errors import OptionError
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from rendered import FACING

CAMERA = Camera(
    projection="pinhole",
    intrinsics=np.array([400.0, 400.0, 319.5, 239.5]),
    distortion="radtan",
    distortion_coeffs=np.array([-0.2, 0.05, 0.0, 0.0]),
    resolution=(640, 480),
)


def checkerboard(cols: int, rows: int, row=0.05, col=0.05) -> Target:
    return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=row, col_spacing_m=col)


HALF, QUARTER = checkerboard(7, 5), checkerboard(6, 6)
STEP_NS = 50_000_000


def rotation(t_s: float) -> np.ndarray:
    """Return R_cam_target of a camera in somebody's hands, at up to 2 rad/s."""
    return FACING @ rotation_from_rotvec(
        np.array([0.4 * np.sin(2.1 * t_s), 0.4 * np.sin(1.7 * t_s + 1), 1.2 * np.sin(1.3 * t_s)])
    )


def seen(target: Target, t_s: float, rng=None) -> BoardView:
    R = rotation(t_s)
    p = np.array([0.05 * np.sin(t_s), 0.05 * np.cos(t_s), 0.6]) - R @ target.points.mean(axis=0)
    pixels = CAMERA.project(target.points @ R.T + p).pixels
    point = np.arange(len(target))
    if rng is not None:
        pixels = pixels + rng.normal(0, 0.1, pixels.shape)
        point = np.sort(rng.choice(point, int(0.8 * len(point)), replace=False))
    return BoardView(point=point, pixels=pixels[point], sigma_px=np.full(len(point), 0.1))


def sequence(target: Target, count: int, seed=0, gaps=()):
    """Return views of which the ends are exchanged at random, their timestamps, and by how many quarters."""
    rng = np.random.default_rng(seed)
    t_ns = STEP_NS * np.arange(count)
    turns = rng.choice(ambiguous_turns(target), count)
    views = [renumber_view(seen(target, 1e-9 * t, rng), target, int(turn)) for t, turn in zip(t_ns, turns, strict=True)]
    for first, last in gaps:
        views[first:last] = [nothing_seen()] * (last - first)
    return views, t_ns, turns


def gyroscope(t0_ns: int, t1_ns: int) -> np.ndarray:
    drift = rotation_from_rotvec(np.array([0.0, 0.01, 0.005]) * 1e-9 * (t1_ns - t0_ns))
    return rotation(1e-9 * t1_ns) @ rotation(1e-9 * t0_ns).T @ drift


def test_which_turns_cannot_be_told_apart():
    assert ambiguous_turns(checkerboard(7, 6)) == (0,)
    assert ambiguous_turns(checkerboard(6, 7)) == (0,)
    assert ambiguous_turns(HALF) == (0, 2)
    assert ambiguous_turns(checkerboard(5, 5)) == (0, 2)
    assert ambiguous_turns(QUARTER) == (0, 1, 2, 3)
    assert ambiguous_turns(Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.1, tag_spacing=0.3)) == (0,)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_numbers_are_turned_about_the_normal(turns):
    view, other = seen(QUARTER, 0.3), renumber_view(seen(QUARTER, 0.3), QUARTER, turns)
    assert np.array_equal(np.sort(other.point), np.arange(36))
    middle = QUARTER.points.mean(axis=0)
    Rz = rotation_from_rotvec(np.array([0, 0, turns * np.pi / 2]))
    # R_new = R_old Rz: what the new axes call X_new is Rz X_new in the old ones.
    old = (QUARTER.points - middle) @ Rz.T + middle
    number = np.argmin(np.linalg.norm(QUARTER.points[None] - old[:, None], axis=2), axis=1)
    assert np.array_equal(other.pixels, view.pixels[number])
    assert np.array_equal(renumber_view(other, QUARTER, 4 - turns).pixels, view.pixels)


@pytest.mark.parametrize("target", [HALF, QUARTER, checkerboard(5, 5)])
@pytest.mark.parametrize("camera", [None, CAMERA])
def test_ends_are_followed_from_frame_to_frame(target, camera):
    views, t_ns, turns = sequence(target, 200)
    ordered = consistent_order(views, t_ns, target, camera=camera)
    assert ordered.certain
    assert len(set((ordered.turns + turns) % 4)) == 1
    assert (ordered.piece == 0).all()
    again = consistent_order(ordered.views, t_ns, target, camera=camera)
    assert not again.turns.any()


def test_a_short_gap_is_bridged_and_a_long_one_is_not():
    views, t_ns, turns = sequence(HALF, 200, gaps=[(40, 42), (100, 160)])
    ordered = consistent_order(views, t_ns, HALF)
    assert not ordered.certain
    assert (ordered.piece[40:42] == -1).all()
    assert set(ordered.piece[:100]) == {-1, 0}
    assert set(ordered.piece[160:]) == {1}
    assert ordered.probability[0] == 1
    assert 0.4 < ordered.probability[1] < 0.999
    for part in (ordered.piece == 0, ordered.piece == 1):
        assert len(set((ordered.turns + turns)[part] % 4)) == 1


@pytest.mark.parametrize("target", [HALF, QUARTER])
@pytest.mark.parametrize("seed", range(4))
def test_the_gyroscope_bridges_long_gaps(target, seed):
    views, t_ns, turns = sequence(target, 160, seed, gaps=[(50, 130)])
    ordered = consistent_order(views, t_ns, target, camera=CAMERA, turned=gyroscope)
    assert ordered.certain
    assert len(set((ordered.turns + turns)[ordered.piece == 0] % 4)) == 1
    unknown = consistent_order(views, t_ns, target, camera=CAMERA, turned=lambda first, second: None)
    assert not unknown.certain


def test_a_wrong_view_does_not_mislead_those_after_it():
    views, t_ns, turns = sequence(HALF, 60)
    sideways = np.column_stack([views[30].pixels[:, 1], 640 - views[30].pixels[:, 0]])
    views[30] = BoardView(point=views[30].point, pixels=sideways, sigma_px=views[30].sigma_px)
    ordered = consistent_order(views, t_ns, HALF)
    others = np.arange(60) != 30
    assert len(set(ordered.piece[others])) == 1
    assert ordered.piece[30] != ordered.piece[29]
    assert len(set((ordered.turns + turns)[others] % 4)) == 1


def test_colours_that_tell_the_ends_leave_nothing_to_do():
    target = checkerboard(7, 6)
    views, t_ns, _ = sequence(target, 5)
    views[2] = nothing_seen()
    ordered = consistent_order(views, t_ns, target)
    assert ordered.views == tuple(views)
    assert ordered.piece.tolist() == [0, 0, -1, 0, 0]
    assert ordered.certain


@pytest.mark.parametrize(("row", "col"), [(0.05, 0.04), (0.04, 0.05)])
def test_a_square_board_of_oblongs_is_stretched_along_the_right_axis(row, col):
    target = checkerboard(6, 6, row, col)
    views, t_ns, turns = sequence(target, 100)
    ordered = consistent_order(views, t_ns, target)
    assert (ordered.turns + turns)[0] % 2 == 0
    assert len(set((ordered.turns + turns) % 4)) == 1


def test_little_or_nothing_to_order():
    assert consistent_order([], np.empty(0, np.int64), HALF).certain
    nothing = consistent_order([nothing_seen()] * 3, STEP_NS * np.arange(3), HALF)
    assert nothing.piece.tolist() == [-1, -1, -1]
    assert nothing.certain
    one = consistent_order([seen(HALF, 0.0)], np.zeros(1, np.int64), HALF)
    assert one.piece.tolist() == [0]


def test_the_gyroscope_needs_the_lens():
    views, t_ns, _ = sequence(HALF, 3)
    with pytest.raises(OptionError, match="intrinsics"):
        consistent_order(views, t_ns, HALF, turned=gyroscope)
