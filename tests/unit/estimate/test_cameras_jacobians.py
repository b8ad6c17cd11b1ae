"""Every column of the normal equations of views against numerical derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from board_views import BOARD, MODELS, lens, pose, seen
from gnomon.estimate.camera_imu.terms.visual_terms import CornerNoise
from gnomon.estimate.cameras.first_rig import posed_rig
from gnomon.estimate.cameras.layout import POSE, SharedLayout, offsets_information, stated_shape
from gnomon.estimate.cameras.normal import accumulate_normal_equations, eliminate_poses, view_sums
from gnomon.estimate.cameras.rig import camera_corners, gathered_views

APART = np.stack([np.eye(4), pose([0.02, -0.15, 0.3], [-0.1, 0.02, 0.03])])
EVERYTHING = ("aspect", "bow", "corners")


def _problem(model: str, board=EVERYTHING):
    cameras = {"cam0": lens("pinhole-radtan"), "cam1": lens(model)}
    views = gathered_views(seen(cameras, APART, 3, 5, fewest=16), BOARD)
    rng = np.random.default_rng(2)
    shape = replace(
        stated_shape(BOARD),
        aspect=0.01,
        bow_m=np.array([2e-3, -1e-3]),
        offsets=1e-3 * rng.standard_normal((len(BOARD), 3)),
    )
    rig = replace(posed_rig(views, cameras, APART), board=shape)
    own = {name: np.arange(len(camera.parameters)) for name, camera in cameras.items()}
    layout = SharedLayout.of(cameras, own, board, len(BOARD))
    noise = dict.fromkeys(cameras, CornerNoise(sigma_px=0.5, huber=np.inf))
    return camera_corners(views), rig, layout, noise


def _steps(layout: SharedLayout, rig) -> np.ndarray:
    """Return a small step of each shared column."""
    sizes = np.full(layout.size, 1e-6)
    for name, camera in rig.cameras.items():
        sizes[layout.lens[name]] = [1e-3 if abs(value) > 50 else 1e-6 for value in camera.parameters]
    return sizes


@pytest.mark.parametrize("model", MODELS)
def test_gradient_of_every_column(model) -> None:
    # The points of the board have columns of their own with one of the models.
    corners, rig, layout, noise = _problem(model, EVERYTHING if model == "ds-none" else ("aspect", "bow"))
    at = accumulate_normal_equations(corners, BOARD, rig, layout, noise)
    views, still = len(at.cost), np.zeros((len(at.cost), POSE))

    def cost(poses, shared):
        return accumulate_normal_equations(corners, BOARD, layout.moved(rig, poses, shared), layout, noise).cost

    gradients = at.gradients()
    sizes = _steps(layout, rig)
    for k in [*range(layout.narrow), *range(layout.offsets.start, layout.size, 13)]:
        step = np.zeros(layout.size)
        step[k] = sizes[k]
        numerical = (cost(still, step) - cost(still, -step)) / (2 * sizes[k])
        np.testing.assert_allclose(gradients[:, k], numerical, rtol=2e-5, atol=2e-5 * np.abs(gradients[:, k]).max())
    for k in range(POSE):
        step = np.zeros((views, POSE))
        step[:, k] = 1e-6
        nothing = np.zeros(layout.size)
        numerical = (cost(step, nothing) - cost(-step, nothing)) / 2e-6
        np.testing.assert_allclose(at.pose_gradient[:, k], numerical, rtol=2e-5, atol=1e-4)


def test_information_is_the_derivative_of_the_gradient_where_the_residuals_are_small() -> None:
    corners, rig, layout, noise = _problem("ds-none")
    exact = [
        replace(
            one,
            exposures=replace(
                one.exposures,
                pixels=one.exposures.pixels
                + accumulate_normal_equations(corners, BOARD, rig, layout, noise).sums[k].residual,
            ),
        )
        for k, one in enumerate(corners)
    ]
    at = accumulate_normal_equations(exact, BOARD, rig, layout, noise)
    shared, border, sizes = at.shared(), at.border, _steps(layout, rig)
    still = np.zeros((len(at.cost), POSE))
    for k in (0, 5, 9, 14, layout.aspect.start, layout.bow.start, layout.offsets.start + 40):
        step = np.zeros(layout.size)
        step[k] = sizes[k]
        two = [
            accumulate_normal_equations(exact, BOARD, layout.moved(rig, still, sign * step), layout, noise)
            for sign in (1, -1)
        ]
        slope = (two[0].gradients() - two[1].gradients()).sum(axis=0) / (2 * sizes[k])
        scale = np.sqrt(np.diag(shared) * shared[k, k])
        np.testing.assert_allclose(slope / scale, shared[k] / scale, atol=2e-5)
        slope = (two[0].pose_gradient - two[1].pose_gradient) / (2 * sizes[k])
        size = np.sqrt(np.einsum("vii->vi", at.pose) * shared[k, k])
        np.testing.assert_allclose(slope / size, border[:, :, k] / size, atol=2e-5)


def test_sums_of_views_add_up_to_the_reduced_equations() -> None:
    corners, rig, layout, noise = _problem("eucm-none")
    at = accumulate_normal_equations(corners, BOARD, rig, layout, noise)
    equations = eliminate_poses(at)
    pull, information = view_sums(at)
    size = np.sqrt(np.diag(at.shared()))
    np.testing.assert_allclose(
        information.sum(axis=0) / size / size[:, None], equations.information / size / size[:, None], atol=1e-10
    )
    np.testing.assert_allclose(-pull.sum(axis=0) / size, equations.gradient / size, atol=1e-8)


def test_offsets_hold_no_motion_of_the_whole_board() -> None:
    layout = SharedLayout.of(
        {"cam0": lens("pinhole-none")}, {"cam0": np.arange(4)}, ("aspect", "bow", "corners"), len(BOARD)
    )
    moves = layout.board_moves(BOARD)
    information = offsets_information(BOARD, moves)
    free = np.linalg.eigvalsh(information)[0]
    shift = np.tile([0.0, 0.0, 1.0], len(BOARD)) / np.sqrt(len(BOARD))
    turn = np.cross([0.0, 0.0, 1.0], BOARD.points - BOARD.points.mean(axis=0)).ravel()
    for move in (shift, turn / np.linalg.norm(turn), *(move.ravel() / np.linalg.norm(move) for move in moves)):
        assert move @ information @ move > 1e5 * free


def test_steps_stay_within_what_the_models_allow() -> None:
    cameras = {"cam0": lens("ds-none")}
    views = gathered_views(seen(cameras, np.eye(4)[None], 2, 3), BOARD)
    rig = posed_rig(views, cameras, np.eye(4)[None])
    layout = SharedLayout.of(cameras, {"cam0": np.arange(6)}, (), len(BOARD))
    far = np.array([5.0, 5.0, -1e5, 0.0, 0.0, 0.0])
    moved = layout.moved(rig, np.zeros((2, POSE)), far).cameras["cam0"]
    assert moved.parameters[0] == 1.0
    assert moved.parameters[1] == 1.0
    assert moved.parameters[2] > 0
