"""Views that were held out, and most informative views."""

from dataclasses import replace

import numpy as np
import pytest

from board_views import BOARD, lens, pose, seen
from gnomon.estimate.cameras.first_rig import held_out_residuals, merge_corners, posed_rig
from gnomon.estimate.cameras.problem import chosen_views
from gnomon.estimate.cameras.rig import SeenCorners, gathered_views
from gnomon.estimate.cameras.solution import solve_rig

PAIR = {"cam0": lens("pinhole-radtan"), "cam1": lens("ds-none")}
APART = np.stack([np.eye(4), pose([0.02, -0.2, 0.0], [-0.1, 0.0, 0.02])])


@pytest.fixture(scope="module")
def views():
    return gathered_views(seen(PAIR, APART, 40, 21), BOARD)


@pytest.fixture(scope="module")
def solution(views):
    return solve_rig(views, posed_rig(views, PAIR, APART))


def test_views_at_the_true_rig_scatter_as_their_noise(views) -> None:
    rig = posed_rig(views.where(np.arange(2)), PAIR, APART)
    found = held_out_residuals(views, rig)
    for seen_corners in found.values():
        freedom = 1 - 6 * len(views) / sum(2 * len(one.point) for one in found.values())
        rms_px = np.sqrt(np.mean(seen_corners.residual**2))
        assert rms_px == pytest.approx(0.2 * np.sqrt(freedom), rel=0.05)


def _corners(distance: np.ndarray) -> SeenCorners:
    n = len(distance)
    return SeenCorners(
        view=np.repeat([0, 1], n // 2),
        frame=np.repeat([0, 1], n // 2),
        point=np.arange(n),
        pixels=np.zeros((n, 2)),
        residual=np.stack([distance, np.zeros(n)], axis=1),
        weight=np.ones(n),
        spread=np.ones(n),
    )


def test_parts_are_counted_on() -> None:
    one = _corners(np.full(4, 0.1))
    assert merge_corners([one, one]).view.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


def test_greedy_choice_takes_what_adds_most(views, solution) -> None:
    sums = solution.sums
    chosen = chosen_views(views, solution, most=6)
    scale = 1 / np.sqrt(np.diag(sums.total))
    known = sums.prior_information * scale * scale[:, None] + 1e-9 * np.eye(len(scale))
    parts = sums.information * scale * scale[:, None]
    taken: dict[int, float] = {}
    for _ in range(6):
        before = np.linalg.slogdet(known)[1]
        gains = 0.5 * (np.linalg.slogdet(known + parts)[1] - before)
        gains[list(taken)] = -np.inf
        best = int(np.argmax(gains))
        taken[best] = float(gains[best])
        known = known + parts[best]
    assert chosen.index.tolist() == sorted(taken)
    np.testing.assert_allclose(chosen.nats, [taken[k] for k in sorted(taken)], rtol=1e-9)


def test_views_that_repeat_each_other_are_left_out() -> None:
    cameras = {"cam0": lens("pinhole-radtan")}
    frames = seen(cameras, np.eye(4)[None], 25, 3)["cam0"]
    times = 40
    step = frames.t_ns[-1] + 100_000_000
    many = replace(
        frames,
        t_ns=np.concatenate([frames.t_ns + k * step for k in range(times)]),
        frame=np.concatenate([frames.frame + 25 * k for k in range(times)]),
        point=np.tile(frames.point, times),
        pixels=np.tile(frames.pixels, (times, 1)),
    )
    views = gathered_views({"cam0": many}, BOARD)
    chosen = chosen_views(views, posed_rig(views, cameras, np.eye(4)[None]))
    assert 60 < len(chosen.index) < 250
    best = chosen_views(views, posed_rig(views, cameras, np.eye(4)[None]), most=10)
    assert len(best.index) == 10
    assert len(set((best.index % 25).tolist())) > 5
