"""Lenses, places of cameras and the shape of a board from views, against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from board_views import BOARD, MODELS, STEP_NS, lens, pose, seen
from gnomon.errors import InitialisationError, OptionError, SolveError
from gnomon.estimate.cameras.first_lens import first_lens, fit_lens_model, general_lens
from gnomon.estimate.cameras.first_rig import first_lenses, first_rig, number_views_alike
from gnomon.estimate.cameras.layout import board_points, stated_shape
from gnomon.estimate.cameras.problem import chosen_views
from gnomon.estimate.cameras.rig import gathered_views
from gnomon.estimate.cameras.solution import solve_rig
from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.models.target import Target
from jackknife import jackknife_covariance

ALONE = np.eye(4)[None]


def _errors(solution, cameras, T_cam_cam0) -> np.ndarray:
    """Return how far the lenses and places that were estimated are from the truth, in the order of the names."""
    found = []
    for number, (name, camera) in enumerate(solution.rig.cameras.items()):
        found.append(camera.parameters - cameras[name].parameters)
        if number:
            T, truth = solution.rig.T_cam_cam0[number], T_cam_cam0[number]
            found += [rotvec_from_rotation(truth[:3, :3].T @ T[:3, :3]), T[:3, 3] - truth[:3, 3]]
    return np.concatenate(found)


def _sure(solution, errors: np.ndarray, covariance: np.ndarray, level: float = 1e-3) -> None:
    size = len(errors)
    value = errors @ np.linalg.solve(covariance[:size, :size], errors)
    assert value < chi2.isf(level, size), f"chi2 {value:.1f} of {size}"


@pytest.mark.parametrize("model", MODELS)
def test_lens_is_found_with_no_guess_and_the_truth_is_within_the_covariance(model) -> None:
    cameras = {"cam0": lens(model)}
    views = gathered_views(seen(cameras, ALONE, 30, 11), BOARD)
    solution = solve_rig(views, first_rig(views, {"cam0": model}))
    assert solution.converged
    assert solution.rig.cameras["cam0"].model == model
    assert solution.names == tuple(f"cam0.{name}" for name in cameras["cam0"].parameter_names)
    # The valley of xi, k1 and k2 bends within a few sigmas.
    level = 1e-6 if model == "omni-radtan" else 1e-3
    _sure(solution, _errors(solution, cameras, ALONE), solution.ordinary, level)
    assert solution.sigma_px["cam0"] == pytest.approx(0.2, rel=0.05)


HARD = {
    "long": ("pinhole-radtan", [3000, 2990, 370, 250, -0.3, 2.0, 1e-3, -1e-3]),
    "off centre": ("pinhole-radtan", [460, 458, 250, 330, -0.28, 0.07, 2e-4, -3e-4]),
    "oblong pixels": ("pinhole-radtan", [460, 600, 380, 235, -0.1, 0.02, 0, 0]),
    "220 degrees": ("eucm-none", [0.68, 1.05, 185, 185, 380, 235]),
    "190 degrees": ("ds-none", [-0.25, 0.6, 190, 190, 330, 270]),
    "fisheye": ("pinhole-equidistant", [230, 230, 380, 235, -0.02, 0.01, -0.003, 0.0004]),
}


@pytest.mark.parametrize("what", HARD)
def test_first_lens_of_unusual_cameras_with_wrong_corners(what) -> None:
    model, parameters = HARD[what]
    camera = lens(model).with_parameters(parameters)
    frames = seen({"cam0": camera}, ALONE, 15, 4)["cam0"]
    rng = np.random.default_rng(1)
    wrong = rng.random(len(frames.pixels)) < 0.05
    pixels = frames.pixels + wrong[:, None] * rng.normal(0, 30, frames.pixels.shape)
    views = gathered_views({"cam0": replace(frames, pixels=pixels)}, BOARD)
    solution = solve_rig(views, first_rig(views, {"cam0": model}))
    assert solution.sigma_px["cam0"] == pytest.approx(0.2, rel=0.2)  # the tails of the wrong ones count as far as cut
    _sure(solution, _errors(solution, {"cam0": camera}, ALONE), 1.5 * solution.ordinary)


def test_cameras_in_a_row_of_which_only_neighbours_share_views() -> None:
    cameras = {"cam0": lens("pinhole-radtan"), "cam1": lens("eucm-none"), "cam2": lens("pinhole-equidistant")}
    T = np.stack([np.eye(4), pose([0, -0.6, 0], [-0.1, 0, 0]), pose([0.1, -1.6, 0], [-0.3, 0.02, 0.1])])
    frames = seen(cameras, T, 80, 2)
    views = gathered_views(frames, BOARD)
    both = (views.frame[:, 0] >= 0) & (views.frame[:, 2] >= 0)
    views = views.where(~both)
    solution = solve_rig(views, first_rig(views, {name: one.model for name, one in cameras.items()}))
    errors = _errors(solution, cameras, T)
    assert len(errors) == len(solution.names) == 8 + 6 + 6 + 8 + 6
    _sure(solution, errors, solution.ordinary)


def test_cameras_without_common_views_are_refused() -> None:
    cameras = {"cam0": lens("pinhole-radtan"), "cam1": lens("pinhole-radtan")}
    frames = seen(cameras, np.stack([np.eye(4), pose([0, 0, 0], [-0.1, 0, 0])]), 12, 3)
    frames["cam1"] = replace(frames["cam1"], t_ns=frames["cam1"].t_ns + STEP_NS // 2)
    views = gathered_views(frames, BOARD)
    with pytest.raises(InitialisationError, match="cam1: no views of the board at one instant with cam0"):
        first_rig(views, dict.fromkeys(cameras, "pinhole-radtan"))


def test_a_camera_that_saw_nothing_is_refused() -> None:
    frames = seen({"cam0": lens("pinhole-radtan")}, ALONE, 3, 3)["cam0"]
    nothing = replace(frames, frame=frames.frame[:0], point=frames.point[:0], pixels=frames.pixels[:0])
    with pytest.raises(InitialisationError, match="cam0: no image shows enough of the board"):
        first_rig(gathered_views({"cam0": nothing}, BOARD), {"cam0": "pinhole-radtan"})


def test_an_unknown_model_is_refused() -> None:
    views = gathered_views(seen({"cam0": lens("pinhole-none")}, ALONE, 6, 3), BOARD)
    with pytest.raises(OptionError, match="there is no lens model 'pinhole-brown'"):
        first_lens(views, 0, "pinhole-brown")


def test_one_lens_is_fitted_to_another() -> None:
    camera = lens("ds-none")
    pixels = np.random.default_rng(1).uniform((100, 80), (650, 400), (400, 2))
    other = fit_lens_model(camera, "pinhole-equidistant", pixels)
    apart = other.project(camera.unproject(pixels)[0]).pixels - pixels
    assert np.sqrt(np.mean(apart**2)) < 0.3


def test_bad_frames_are_left_out_and_bad_corners_count_less() -> None:
    cameras = {"cam0": lens("pinhole-radtan")}
    frames = seen(cameras, ALONE, 40, 5)["cam0"]
    rng = np.random.default_rng(2)
    pixels = frames.pixels.copy()
    bad = np.isin(frames.frame, [3, 17])
    pixels[bad] += rng.normal(0, 5, (bad.sum(), 2))
    wrong = ~bad & (rng.random(len(pixels)) < 0.03)
    pixels[wrong] += rng.normal(0, 20, (wrong.sum(), 2))
    views = gathered_views({"cam0": replace(frames, pixels=pixels)}, BOARD)
    solution = solve_rig(views, first_rig(views, {"cam0": "pinhole-radtan"}))
    used = set(solution.corners["cam0"].frame.tolist())
    assert not used & {3, 17}
    assert len(used) == len(set(frames.frame.tolist())) - 2
    _sure(solution, _errors(solution, cameras, ALONE), 1.5 * solution.ordinary)
    plain = solve_rig(views, solution.rig, robust=False)
    assert set(plain.corners["cam0"].frame.tolist()) >= {3, 17}
    assert (plain.corners["cam0"].weight == 1).all()
    assert plain.sigma_px["cam0"] > 1


@pytest.mark.parametrize("imaged", [0, 1])
def test_an_estimation_that_runs_away_is_an_error_that_names_the_target_file(imaged) -> None:
    """As with the target file of another board: no view's corners are imaged, or few; nothing is determined."""
    frames = seen({"cam0": lens("pinhole-radtan")}, ALONE, 6, 5)
    views = gathered_views(frames, BOARD)
    start = first_rig(views, {"cam0": "pinhole-radtan"})
    behind = replace(start, p_cam0_target=np.where(np.arange(6)[:, None] < imaged, 1, -1) * start.p_cam0_target)
    with pytest.raises(SolveError, match=r"runs away.* target file"):
        solve_rig(views, behind)
    with pytest.raises(SolveError, match=r"no poses .* target file"):
        chosen_views(views, replace(start, p_cam0_target=1e-3 * start.p_cam0_target))


def test_what_the_detector_knows_of_corners_weighs_them() -> None:
    cameras = {"cam0": lens("pinhole-radtan")}
    frames = seen(cameras, ALONE, 30, 6, sigma_px=0.1)["cam0"]
    rng = np.random.default_rng(3)
    sigma = np.where(rng.random(len(frames.frame)) < 0.4, 1.0, 0.1)
    noisy = frames.pixels + np.sqrt(sigma**2 - 0.01)[:, None] * rng.standard_normal(frames.pixels.shape)
    views = gathered_views({"cam0": replace(frames, pixels=noisy, sigma_px=sigma)}, BOARD)
    start = first_rig(views, {"cam0": "pinhole-radtan"})
    knowing = solve_rig(views, start)
    alike = solve_rig(gathered_views({"cam0": replace(frames, pixels=noisy)}, BOARD), start)
    assert np.sqrt(np.diag(knowing.ordinary)).sum() < 0.8 * np.sqrt(np.diag(alike.ordinary)).sum()
    assert np.ptp(np.log(knowing.corners["cam0"].spread)) == pytest.approx(np.log(10), rel=0.05)
    _sure(knowing, _errors(knowing, cameras, ALONE), knowing.ordinary)


def test_shape_of_the_board() -> None:
    cameras = {"cam0": lens("pinhole-radtan"), "cam1": lens("pinhole-equidistant")}
    T = np.stack([np.eye(4), pose([0, 0.1, 0], [-0.2, 0, 0])])
    shape = replace(stated_shape(BOARD), aspect=2e-3, bow_m=np.array([1.5e-3, -0.8e-3]))
    views = gathered_views(seen(cameras, T, 40, 7, points=board_points(BOARD, shape)), BOARD)
    start = first_rig(views, {name: camera.model for name, camera in cameras.items()})
    solution = solve_rig(views, start, board=("aspect", "bow"))
    assert solution.names[-3:] == ("target.aspect", "target.bow[0]", "target.bow[1]")
    board = solution.rig.board
    errors = np.array([board.aspect - shape.aspect, *(board.bow_m - shape.bow_m)])
    sigma = np.sqrt(np.diag(solution.ordinary))[-3:]
    assert (np.abs(errors) < 4 * sigma).all()
    assert (sigma < [2e-4, 1e-4, 1e-4]).all()


def test_places_of_the_points_of_the_board() -> None:
    cameras = {"cam0": lens("pinhole-radtan")}
    shift = 3e-4 * np.random.default_rng(1).standard_normal((len(BOARD), 3)) * (1, 1, 0.3)
    views = gathered_views(seen(cameras, ALONE, 40, 8, points=BOARD.points + shift), BOARD)
    start = first_rig(views, {"cam0": "pinhole-radtan"})
    solution = solve_rig(views, start, board=("corners",))
    assert solution.sigma_px["cam0"] == pytest.approx(0.2, rel=0.05)
    # Up to a shift, a turn and a size of the whole board, which no view tells.
    basis = np.concatenate([np.tile(np.eye(3), (1, len(BOARD))).reshape(3, -1), [BOARD.points.ravel()]])
    turns = [np.cross(axis, BOARD.points).ravel() for axis in np.eye(3)]
    span = np.linalg.qr(np.concatenate([basis, turns]).T)[0]
    left = (solution.rig.board.offsets - shift).ravel()
    left -= span @ (span.T @ left)
    sigma = np.sqrt(np.diag(solution.ordinary))[8:]
    z = left / sigma
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.25)
    _sure(solution, _errors(solution, cameras, ALONE), solution.ordinary)


def test_one_attitude_leaves_lenses_open_but_does_not_run_away() -> None:
    cameras = {"cam0": lens("pinhole-none")}
    frames = seen(cameras, ALONE, 1, 9, tilt=0.0)["cam0"]
    same = replace(
        frames,
        t_ns=np.arange(6) * STEP_NS,
        frame=np.repeat(np.arange(6), len(frames.point)),
        point=np.tile(frames.point, 6),
        pixels=np.tile(frames.pixels, (6, 1)) + np.random.default_rng(1).normal(0, 0.2, (6 * len(frames.point), 2)),
    )
    solution = solve_rig(one := gathered_views({"cam0": same}, BOARD), first_rig(one, {"cam0": "pinhole-radtan"}))
    assert np.isfinite(solution.rig.cameras["cam0"].parameters).all()
    assert 30 < solution.rig.cameras["cam0"].parameters[0] < 5000


@pytest.mark.parametrize("kind", ["even", "square"])
def test_boards_that_look_the_same_from_two_ends_are_numbered_alike_by_all_cameras(kind) -> None:
    side = {"even": (7, 9), "square": (6, 6)}[kind]
    board = Target.checkerboard(cols=side[0], rows=side[1], row_spacing_m=0.05, col_spacing_m=0.05)
    numbers = np.arange(len(board)).reshape(board.rows, board.cols)
    turns = (0, 2) if kind == "even" else (0, 1, 2, 3)
    numberings = np.stack([np.argsort(np.rot90(numbers, -turn).ravel()) for turn in turns])
    cameras = {"cam0": lens("pinhole-radtan"), "cam1": lens("pinhole-equidistant")}
    T = np.stack([np.eye(4), pose([0.02, -0.1, 0.01], [-0.11, 0.0, 0.0])])
    frames = seen(cameras, T, 40, 3, target=board, fewest=len(board))
    rng = np.random.default_rng(1)
    for name, one in frames.items():
        way = rng.integers(len(turns), size=40)
        point = numberings[way[one.frame], one.point]
        order = np.lexsort((point, one.frame))
        frames[name] = replace(one, point=point[order], pixels=one.pixels[order])
    views = gathered_views(frames, board)
    lenses = first_lenses(views, {name: camera.model for name, camera in cameras.items()})
    views = number_views_alike(views, lenses, numberings)
    solution = solve_rig(views, first_rig(views, {name: one.model for name, one in lenses.items()}, lenses))
    assert max(solution.sigma_px.values()) < 0.25
    _sure(solution, _errors(solution, cameras, T), solution.ordinary)


def _joint(model: str, seeds: range, views: int, common_px: float) -> tuple[float, float, int]:
    """Return the sums of chi2 with the ordinary and with the cluster covariance, and the degrees of freedom."""
    cameras = {"cam0": lens(model)}
    ordinary = clustered = 0.0
    for seed in seeds:
        found = gathered_views(seen(cameras, ALONE, views, seed, common_px=common_px), BOARD)
        solution = solve_rig(found, first_rig(found, {"cam0": model}, cameras))
        errors = _errors(solution, cameras, ALONE)
        ordinary += errors @ np.linalg.solve(solution.ordinary, errors)
        clustered += errors @ np.linalg.solve(jackknife_covariance(solution.sums), errors)
    return ordinary, clustered, len(seeds) * len(errors)


def test_covariances_hold_for_white_noise() -> None:
    ordinary, clustered, freedom = _joint("pinhole-fov", range(12), 30, 0.0)
    assert chi2.isf(0.999, freedom) < ordinary < chi2.isf(0.001, freedom)
    # Squares over a covariance that 30 views tell have longer tails than chi2.
    assert 0.5 * freedom < clustered < 2 * freedom


def test_cluster_covariance_holds_where_the_corners_of_a_view_err_alike() -> None:
    ordinary, clustered, freedom = _joint("pinhole-fov", range(12), 30, 0.3)
    assert ordinary > 3 * freedom
    assert 0.4 * freedom < clustered < 2 * freedom


# Of omni-radtan xi and k1, k2 do nearly the same: each scalar is within its sigma, but the valley in which they go
# together bends so much within a few sigmas that the joint chi2 does not hold.
@pytest.mark.slow
@pytest.mark.parametrize("model", [model for model in MODELS if model != "omni-radtan"])
def test_covariances_of_every_model(model) -> None:
    ordinary, clustered, freedom = _joint(model, range(50), 60, 0.0)
    assert chi2.isf(0.9995, freedom) < ordinary < chi2.isf(0.0005, freedom)
    assert 0.7 * freedom < clustered < 1.6 * freedom


def test_general_lens_needs_no_more_than_three_views() -> None:
    camera = lens("pinhole-none")
    views = gathered_views(seen({"cam0": camera}, ALONE, 3, 12), BOARD)
    assert general_lens(views, 0).parameters[2] == pytest.approx(460, rel=0.05)
